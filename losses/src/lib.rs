//! Losses on candle tensors.

mod cosine;
mod error;
mod l2;
mod loss;
mod objective;
mod rows;
mod scalar_op;
mod values;
mod vector;

pub use cosine::{CosineLoss, cosine};
pub use error::LossError;
pub use l2::{L2Loss, l2};
pub use loss::{IGNORE, Loss, LossInput};
pub use objective::{Objective, ObjectiveOutput, OffTerm, Term};
pub use rows::Reduction;
pub use values::first_not_finite;
