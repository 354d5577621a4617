//! Level 1: files that a user may have, and files that nobody should have.

mod attacks;
mod claims;
mod columns;
mod containers;
pub(super) mod files;
mod poison;
mod quaternions;
mod round_trips;
mod voxels;

use super::case::{Case, Finding, Level, in_areas};
use super::trial::{Failure, Trial};

pub(super) fn cases() -> Vec<Case> {
    in_areas(&[
        ("values", poison::cases),
        ("rotations", quaternions::cases),
        ("columns", columns::cases),
        ("containers", containers::cases),
        ("formats", round_trips::cases),
        ("shapes", voxels::cases),
        ("claims", claims::cases),
        ("attacks", attacks::cases),
    ])
}

/// A case of a file or scene that comes in.
fn input<T: Into<Finding>>(
    name: impl Into<String>,
    origin: &'static str,
    check: impl Fn(&Trial<'_>) -> Result<T, Failure> + Send + Sync + 'static,
) -> Case {
    Case { origin, ..Case::new(name, Level::Inputs, check) }
}
