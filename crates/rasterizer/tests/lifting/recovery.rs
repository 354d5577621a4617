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

#[test]
fn guarding_waits_for_contradiction_and_leaves_the_others_as_they_are() {
    let size = Size { gaussians: 20_000, views: 20, picture: [160, 120], room: 0 };
    let planted = Planted::new(size);
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
        // What it gains is kept.
        assert!(wrong < 0.2 || some.error < mean.error - 0.8 * (mean.error - all.error));
        let rows = |lifter: &mut _, settings: &FinaliseSettings| {
            let mut out = Vec::new();
            let lifter: &mut scenesplat_rasterizer::lifting::Lifter<'_> = lifter;
            lifter
                .features(0, settings, |block| {
                    let rows = block.features.chunks_exact(super::planted::DIM);
                    out.extend(rows.map(<[f32]>::to_vec).zip(block.guarded.clone()));
                    Ok(())
                })
                .unwrap();
            out
        };
        let (before, after) =
            (rows(&mut lifter, &FinaliseSettings::default()), rows(&mut lifter, &there));
        let guarded = after.iter().filter(|(_, guarded)| *guarded).count();
        assert!(before.iter().zip(&after).all(|(b, a)| a.1 || b.0 == a.0));
        assert!(guarded > 0 && guarded < size.gaussians * 7 / 10, "{guarded}");
        shares.push((share, severity));
    }
    assert!(shares.is_sorted_by(|a, b| a.0 < b.0 && a.1 <= b.1), "{shares:?}");
    assert!(shares[0].1 < 1.0 && shares[2].1 > 2.5, "{shares:?}");
}
