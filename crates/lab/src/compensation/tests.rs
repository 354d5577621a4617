//! What is left out changes nothing else, and what is withheld is where it should be.

use super::*;
use scenesplat::alignment::{Alignment, AlignmentSettings};
use scenesplat::embedded;
use scenesplat::labels::{Classes, label_with_vote};
use scenesplat::{Network, NetworkConfig, SceneEncoder, SceneFeatures, WeightOptions, Weights};
use scenesplat_datasets::effects::plan::{EffectPlan, PlanSection};
use scenesplat_datasets::effects::simulate;
use scenesplat_metrics::ZeroShotOptions;
use scenesplat_rooms::{SyntheticRoomSettings, generate};
use std::sync::OnceLock;

const ALL: Consumer = Consumer { network: true, labels: true };

fn room() -> GaussianScene {
    generate(&SyntheticRoomSettings::with_count(3000, 21)).unwrap().scene
}

fn network() -> &'static Network {
    static NETWORK: OnceLock<Network> = OnceLock::new();
    NETWORK.get_or_init(|| {
        Network::load(NetworkConfig::tiny(), &Weights::Seeded(0), WeightOptions::default()).unwrap()
    })
}

fn encoded(scene: &GaussianScene, kept: &[usize]) -> SceneFeatures {
    // A part may lie a little otherwise than the whole.
    let alignment = Alignment::of(scene, &AlignmentSettings { as_is: true, ..Default::default() });
    SceneEncoder::new(network()).encode_kept(scene, alignment, kept, &mut |_| Ok(())).unwrap()
}

fn rows(features: &SceneFeatures) -> Vec<f32> {
    features.gaussian_rows(0..features.len()).unwrap()
}

/// The room with three Gaussians that belong to nothing, one of them far outside of it.
fn with_floaters() -> (GaussianScene, [usize; 3]) {
    let mut scene = room();
    let added = [[60.0, 1.0, 1.0], [2.0, 40.0, 1.0], [-25.0, 0.0, 30.0]];
    let first = scene.len();
    let rows: Vec<usize> = (0..first).chain([0; 3]).collect();
    scene = scene.select_rows(&rows).unwrap();
    let places = [first, first + 1, first + 2];
    places.iter().zip(added).for_each(|(&row, place)| scene.coord[row] = place);
    (scene, places)
}

#[test]
fn a_part_is_read_as_if_the_rest_were_not_there() {
    let (scene, added) = with_floaters();
    let kept: Vec<usize> = (0..added[0]).collect();
    let part = encoded(&scene, &kept);
    let alone = encoded(&room(), &kept);
    let width = alone.width();
    let (part_rows, alone_rows) = (rows(&part), rows(&alone));
    assert!(part_rows[..alone_rows.len()] == alone_rows[..]);
    assert_eq!(part.summary, alone.summary);
    // By hand: the nearest that was read.
    for row in added {
        let apart = |p: &[f32; 3]| -> f64 {
            (0..3).map(|a| (f64::from(p[a]) - f64::from(scene.coord[row][a])).powi(2)).sum()
        };
        let all: Vec<f64> = kept.iter().map(|&row| apart(&scene.coord[row])).collect();
        let least = all.iter().copied().fold(f64::MAX, f64::min);
        let nearest = all.iter().position(|d| *d == least).unwrap();
        let [own, of_it] = [row, nearest].map(|r| &part_rows[r * width..(r + 1) * width]);
        assert_eq!(own, of_it);
    }
    let voters = part.voters().unwrap();
    assert!(voters.iter().zip(0..).all(|(&votes, row)| votes == (row < added[0])));
    // What is read decides voxels: with the strays, the box and so the borders are others.
    assert!(
        rows(&encoded(&scene, &(0..scene.len()).collect::<Vec<_>>()))[..100 * width]
            != alone_rows[..100 * width]
    );
    assert!(alone.voters().is_none());
    // A part in the middle: rows are those of the scene.
    let odd: Vec<usize> = (0..3000).filter(|row| row % 3 == 1).collect();
    let middle = encoded(&room(), &odd);
    assert!(middle.sampled().iter().all(|row| row % 3 == 1) && middle.len() == 3000);
    let coord = room().select_rows(&odd).unwrap();
    let of_part = rows(&encoded(&coord, &(0..1000).collect::<Vec<_>>()));
    assert!(rows(&middle)[width..2 * width] == of_part[..width]);
}

#[test]
fn rows_that_are_none_are_refused() {
    let scene = room();
    let encoder = SceneEncoder::new(network());
    for kept in [&[0, 3000][..], &[5, 4], &[5, 5], &[]] {
        let alignment = Alignment::of(&scene, &Default::default());
        let error = encoder.encode_kept(&scene, alignment, kept, &mut |_| Ok(())).unwrap_err();
        let text = error.to_string();
        assert!(text.contains("ascending rows below 3000") || kept.is_empty(), "{text}");
    }
}

#[test]
fn floaters_are_left_out_when_asked_and_answered_for_by_their_neighbours() {
    let (scene, added) = with_floaters();
    let mut plan = plan_of(&scene, 1.0, ALL, &"floaters=on".parse().unwrap()).unwrap();
    let about = Compensation::of(&mut plan, &scene);
    let kept = about.kept(scene.len());
    assert!(added.iter().all(|row| !kept.contains(row)));
    assert_eq!(about.num_left_out(), scene.len() - kept.len());
    assert_eq!(plan.of(Effect::Floaters).unwrap().changed, Some(about.num_left_out()));
    // None of them votes: whatever they answer, the others say the same.
    let network =
        Network::load(embedded::config().unwrap(), &Weights::Embedded, WeightOptions::default())
            .unwrap();
    let texts = embedded::vocabulary().unwrap().class_table();
    let label = |scene: &GaussianScene, kept: &[usize]| {
        let alignment = Alignment::of(scene, &Default::default());
        let features =
            SceneEncoder::new(&network).encode_kept(scene, alignment, kept, &mut |_| Ok(()));
        let (classes, options) = (Classes::Texts(&texts), ZeroShotOptions::default());
        label_with_vote(&features.unwrap(), classes, &options, &scene.coord, 5).unwrap().labels
    };
    let labels = label(&scene, &kept);
    let alone = scene.select_rows(&kept).unwrap();
    let all: Vec<usize> = (0..alone.len()).collect();
    let expected = label(&alone, &all);
    assert_eq!(kept.iter().map(|&row| labels[row]).collect::<Vec<_>>(), expected);
    assert!(added.iter().all(|&row| labels[row] >= 0));
}

#[test]
fn rims_are_where_the_gaps_are_and_a_stored_plan_finds_them_again() {
    let clean = generate(&SyntheticRoomSettings::with_count(16_000, 1004)).unwrap().scene;
    let holes = simulate(&clean, &"holes=4".parse().unwrap(), 3).unwrap();
    let scene = holes.scene;
    let mut section = plan_of(&scene, 1.0, ALL, &"holes=on".parse().unwrap()).unwrap();
    let about = Compensation::of(&mut section, &scene);
    assert_eq!(about.withheld().len(), scene.len());
    let count = about.num_withheld();
    assert!(count > 20 && count < scene.len() / 3, "{count} of {}", scene.len());
    // Most of what is withheld is near to something that is missing now.
    let there: std::collections::HashSet<usize> = holes.source.into_iter().flatten().collect();
    let missing: Vec<[f32; 3]> =
        (0..clean.len()).filter(|row| !there.contains(row)).map(|row| clean.coord[row]).collect();
    let near = |p: &[f32; 3]| {
        let square = |m: &[f32; 3]| (0..3).map(|a| (p[a] - m[a]).powi(2)).sum::<f32>();
        missing.iter().any(|m| square(m) < 0.4 * 0.4)
    };
    let rims = scene.coord.iter().zip(about.withheld()).filter(|(_, is)| **is).map(|(p, _)| p);
    let right = rims.filter(|p| near(p)).count();
    assert!(right * 10 > count * 7, "{right} of {count}");

    let mut plan = EffectPlan::new(scene.len());
    plan.put(section.clone());
    let text = serde_json::to_string(&plan).unwrap();
    let back: EffectPlan = serde_json::from_str(&text).unwrap();
    let mut again = back.replayed(scene.len(), &modules(ALL)).unwrap();
    assert_eq!(Compensation::of(&mut again, &scene), about);
    assert_eq!(again.decisions, section.decisions);
    assert_eq!(again.seconds, None);
    let refused = back.replayed(scene.len(), &modules(Consumer { labels: false, ..ALL }));
    assert!(refused.unwrap_err().to_string().contains("acted on here: floaters"));
}

#[test]
fn what_is_off_costs_nothing() {
    let scene = room();
    for choices in ["holes=off,floaters=off", "auto"] {
        let mut plan: PlanSection = plan_of(&scene, 1.0, ALL, &choices.parse().unwrap()).unwrap();
        let about = Compensation::of(&mut plan, &scene);
        assert_eq!(about, Compensation::default());
        assert!(about.withheld().is_empty() && about.num_withheld() == 0);
        assert_eq!(about.kept(3), [0, 1, 2]);
        assert!(plan.decisions.iter().all(|d| d.changed == Some(0)));
        // Nothing of it is on by itself, so that nobody looks at the scene.
        assert_eq!(plan.seconds, None);
    }
    let none = Consumer { network: false, labels: false };
    let error = plan_of(&scene, 1.0, none, &"floaters=on".parse().unwrap()).unwrap_err();
    assert!(error.to_string().contains("acted on here: none"), "{error}");
}
