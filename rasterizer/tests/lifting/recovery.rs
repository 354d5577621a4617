//! A small version of the experiment with planted labels; the large one is an example.

use super::planted::{Planted, Size};
use scenesplat_rasterizer::lifting::{FinaliseSettings, LiftSettings, Robust};

#[test]
fn planted_labels_come_back() {
    let size = Size { gaussians: 20_000, views: 20, picture: [160, 120], room: 0 };
    let planted = Planted::new(size);
    assert!(planted.num_objects() > 10);
    let mut lifter = planted.lifter(0.0, LiftSettings::default()).unwrap();
    let clean = planted.recover(&mut lifter, &FinaliseSettings::default()).unwrap();
    println!(
        "clean: mass {:.4}, Gaussians {:.4} of {}, error {:.4}, disagreement {:.3}",
        clean.mass,
        clean.gaussians,
        clean.covered,
        clean.error,
        clean.disagreement.unwrap()
    );
    let mut lifter = planted.lifter(0.2, LiftSettings::default()).unwrap();
    for (name, settings) in
        [("mean", FinaliseSettings::default()), ("robust", FinaliseSettings::robust())]
    {
        let noisy = planted.recover(&mut lifter, &settings).unwrap();
        println!(
            "{name}: mass {:.4}, Gaussians {:.4}, error {:.4}, disagreement {:.3}",
            noisy.mass,
            noisy.gaussians,
            noisy.error,
            noisy.disagreement.unwrap()
        );
    }
    assert!(!Robust::default().decide(clean.disagreement));
}
