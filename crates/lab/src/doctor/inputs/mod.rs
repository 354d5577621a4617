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
    let all = [
        poison::cases,
        quaternions::cases,
        columns::cases,
        containers::cases,
        round_trips::cases,
        voxels::cases,
        claims::cases,
        attacks::cases,
    ];
    all.into_iter().flat_map(|cases| cases()).collect()
}
