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

use super::case::Case;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = poison::cases();
    cases.extend(quaternions::cases());
    cases.extend(columns::cases());
    cases.extend(containers::cases());
    cases.extend(round_trips::cases());
    cases.extend(voxels::cases());
    cases.extend(claims::cases());
    cases.extend(attacks::cases());
    cases
}
