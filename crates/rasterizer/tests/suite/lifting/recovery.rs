//! A small version of the experiment with planted labels; the large one is an example.

use super::planted::{Planted, Recovered, Size};
use scenesplat_rasterizer::lifting::{DepthTolerance, FinaliseSettings, LiftSettings, Robust};

fn planted() -> Planted {
    Planted::new(Size { gaussians: 20_000, views: 20, picture: [160, 120], room: 0 })
}

fn lift(
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
    let planted = planted();
    assert!(planted.num_objects() > 10);
    let (mean, robust) = (FinaliseSettings::default(), FinaliseSettings::robust());
    let guards = |found: &Recovered| Robust::default().decide(found.disagreement);
    let clean = lift(&planted, 0.0, &mean, LiftSettings::default());
    // Pictures this small leave few pixels to an object: the example has larger ones.
    assert!(clean.mass > 0.97 && clean.gaussians > 0.92 && clean.covered > 15_000);
    assert!(!guards(&clean));
    // What is hidden no longer takes the name of what hides it.
    let agreeing = LiftSettings { depth: Some(DepthTolerance::RENDERED), ..Default::default() };
    let seen = lift(&planted, 0.0, &mean, agreeing);
    assert!(seen.mass > 0.98 && seen.mass > clean.mass && seen.covered > 15_000);
    assert!(1.0 - seen.gaussians < 0.7 * (1.0 - clean.gaussians));
    // Every second picture shows as much, wrong names or not.
    for wrong in [0.0, 0.2] {
        let effect = planted.depth_effect(wrong, 2).unwrap();
        println!("{wrong} wrong: {effect:?}");
        assert!(effect.helps() && effect.kept > 0.7, "{effect:?}");
    }
    let [noisy, guarded] =
        [mean, robust].map(|settings| lift(&planted, 0.2, &settings, LiftSettings::default()));
    assert!(guards(&noisy));
    assert!(guarded.mass > noisy.mass && guarded.error < noisy.error);
}

#[test]
fn guarding_waits_for_contradiction_and_leaves_the_others_as_they_are() {
    let planted = planted();
    let mut shares = Vec::new();
    for wrong in [0.0, 0.05, 0.2] {
        let agreeing = LiftSettings { depth: Some(DepthTolerance::RENDERED), ..Default::default() };
        let mut lifter = planted.lifter(wrong, agreeing).unwrap();
        let measured = lifter.disagreement(0).unwrap();
        let (share, severity) = (measured.conflicting().unwrap(), measured.severity());
        let limit = measured.conflict().unwrap() as f32;
        let everywhere = FinaliseSettings::robust();
        let there = FinaliseSettings { guard_above: Some(limit), ..everywhere };
        let [mean, all, some] = [FinaliseSettings::default(), everywhere, there]
            .map(|settings| planted.recover(&mut lifter, &settings).unwrap());
        println!(
            "{wrong} wrong: {share:.3} contradict each other, severity {severity:.2}; error of the mean \
             {:.4}, guarded everywhere {:.4}, there {:.4}",
            mean.error, all.error, some.error
        );
        // Its gain is kept.
        assert!(wrong < 0.2 || some.error < mean.error - 0.8 * (mean.error - all.error));
        let [before, after] = [FinaliseSettings::default(), there].map(|settings| {
            let mut out = Vec::new();
            lifter
                .features(0, &settings, |block| {
                    let rows = block.features.chunks_exact(super::planted::DIM);
                    out.extend(rows.map(<[f32]>::to_vec).zip(block.guarded.clone()));
                    Ok(())
                })
                .unwrap();
            out
        });
        let guarded = after.iter().filter(|(_, guarded)| *guarded).count();
        assert!(before.iter().zip(&after).all(|(b, a)| a.1 || b.0 == a.0));
        assert!(guarded > 0 && guarded < 20_000 * 7 / 10, "{guarded}");
        shares.push((share, severity));
    }
    assert!(shares.is_sorted_by(|a, b| a.0 < b.0 && a.1 <= b.1), "{shares:?}");
    assert!(shares[0].1 < 1.0 && shares[2].1 > 2.5, "{shares:?}");
}
