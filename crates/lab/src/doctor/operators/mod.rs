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

use super::case::{Case, in_areas};

pub(super) fn cases() -> Vec<Case> {
    let areas: [(&str, fn() -> Vec<Case>); 14] = [
        ("products", products::cases),
        ("attention", attention::cases),
        ("norms", norms::cases),
        ("activations", activations::cases),
        ("convolution", sparse::convolutions),
        ("segments", sparse::segments),
        ("voxels", grids::cases),
        ("curves", curves::cases),
        ("neighbours", neighbours::cases),
        ("losses", losses::cases),
        ("losses", hard_losses::cases),
        ("metrics", metrics::cases),
        ("pictures", pictures::cases),
        ("optimizers", optimizers::cases),
    ];
    in_areas(&areas)
}
