//! Level 2: operators, losses and metrics against f64.

#![allow(clippy::type_complexity, reason = "tables of names, origins and functions")]

mod activations;
mod attention;
mod compare;
mod curves;
mod grids;
mod hard_losses;
mod losses;
mod metrics;
mod neighbours;
mod norms;
mod optimizers;
mod pictures;
mod products;
mod sparse;

use super::case::Case;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = products::cases();
    cases.extend(attention::cases());
    cases.extend(norms::cases());
    cases.extend(activations::cases());
    cases.extend(sparse::cases());
    cases.extend(grids::cases());
    cases.extend(curves::cases());
    cases.extend(neighbours::cases());
    cases.extend(losses::cases());
    cases.extend(hard_losses::cases());
    cases.extend(metrics::cases());
    cases.extend(pictures::cases());
    cases.extend(optimizers::cases());
    cases
}
