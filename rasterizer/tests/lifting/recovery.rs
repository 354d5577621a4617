//! A small version of the experiment with planted labels; the large one is an example.

use super::planted::{Planted, Recovered, Size};
use scenesplat_rasterizer::lifting::{DepthTolerance, FinaliseSettings, LiftSettings, Robust};

fn lift(planted: &Planted, wrong: f64, settings: &FinaliseSettings) -> Recovered {
    lift_with(planted, wrong, settings, LiftSettings::default())
}

fn lift_with(
    planted: &Planted,
    wrong: f64,
    settings: &FinaliseSettings,
    lifting: LiftSettings,
) -> Recovered {
    let mut lifter = planted.lifter(wrong, lifting).unwrap();
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
    // What is hidden no longer takes the name of what hides it.
    let agreeing = LiftSettings { depth: Some(DepthTolerance::RENDERED), ..Default::default() };
    let seen = lift_with(&planted, 0.0, &mean, agreeing);
    assert!(seen.mass > 0.98 && seen.mass > clean.mass && seen.covered > 15_000);
    assert!(1.0 - seen.gaussians < 0.7 * (1.0 - clean.gaussians));
    // Every second picture shows as much, wrong names or not.
    for wrong in [0.0, 0.2] {
        let effect = planted.depth_effect(wrong, 2).unwrap();
        println!("{wrong} wrong: {effect:?}");
        assert!(effect.helps() && effect.kept > 0.7, "{effect:?}");
    }
    let (noisy, guarded) = (lift(&planted, 0.2, &mean), lift(&planted, 0.2, &robust));
    assert!(guards(&noisy));
    assert!(guarded.mass > noisy.mass && guarded.error < noisy.error);
}
