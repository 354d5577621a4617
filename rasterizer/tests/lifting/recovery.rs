//! A small version of the experiment with planted labels; the large one is an example.

use super::planted::{Planted, Recovered, Size};
use scenesplat_rasterizer::lifting::{FinaliseSettings, LiftSettings, Robust};

fn lift(planted: &Planted, wrong: f64, settings: &FinaliseSettings) -> Recovered {
    let mut lifter = planted.lifter(wrong, LiftSettings::default()).unwrap();
    let found = planted.recover(&mut lifter, settings).unwrap();
    println!(
        "{wrong} wrong: mass {:.4}, Gaussians {:.4} of {}, error {:.4}, disagreement {:.3}",
        found.mass,
        found.gaussians,
        found.covered,
        found.error,
        found.disagreement.unwrap()
    );
    found
}

#[test]
fn planted_labels_come_back() {
    let size = Size { gaussians: 20_000, views: 20, picture: [160, 120], room: 0 };
    let planted = Planted::new(size);
    assert!(planted.num_objects() > 10);
    let (mean, robust) = (FinaliseSettings::default(), FinaliseSettings::robust());
    let guards = |found: &Recovered| Robust::default().decide(found.disagreement);
    let clean = lift(&planted, 0.0, &mean);
    // Pictures this small leave few pixels to an object: the example has larger ones.
    assert!(clean.mass > 0.97 && clean.gaussians > 0.92 && clean.covered > 15_000);
    assert!(!guards(&clean));
    let (noisy, guarded) = (lift(&planted, 0.2, &mean), lift(&planted, 0.2, &robust));
    assert!(guards(&noisy));
    assert!(guarded.mass > noisy.mass && guarded.error < noisy.error);
}
