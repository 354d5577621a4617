//! Level 2: operators, losses and metrics against f64.

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
    let all = [
        products::cases,
        attention::cases,
        norms::cases,
        activations::cases,
        sparse::convolutions,
        sparse::segments,
        grids::cases,
        curves::cases,
        neighbours::cases,
        losses::cases,
        hard_losses::cases,
        metrics::cases,
        pictures::cases,
        optimizers::cases,
    ];
    all.into_iter().flat_map(|cases| cases()).collect()
}
