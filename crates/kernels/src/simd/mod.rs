//! Vector registers of the CPU, chosen at run time.
//!
//! Two ways to use them. Plain loops are written once and compiled for each instruction set by
//! [`compiled_for`], with results of the same bits everywhere. The hot kernels of this crate are
//! generic over the register type and instantiated inside a function that enables its instructions;
//! different sets may differ in the last bits there (fused or separate multiply–add). Either way
//! results do not depend on the thread count.

mod compiled;
mod isa;
mod vector;

pub use compiled::{compiled, compiled_for};
pub use isa::Isa;
pub(crate) use vector::{Plain, Vector, dispatch};
