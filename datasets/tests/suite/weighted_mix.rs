//! Mixing datasets: how often each comes, and that nothing depends on how batches are made.

use scenesplat_datasets::transforms::{build_transforms, validation};
use scenesplat_datasets::{
    BatchLoader, InputFeatures, LoaderSettings, MixRule, SceneDataset, SceneLoader, SyntheticRooms,
    TrainBatch, WeightedMix,
};
use scenesplat_rooms::SyntheticRoomSettings;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Rooms of a seed of their own, one a batch.
fn loader(rooms: usize, seed: u64, workers: usize) -> SceneLoader {
    let source = Arc::new(
        SyntheticRooms::new(rooms, SyntheticRoomSettings::with_count(300, 0), 100 * seed).unwrap(),
    );
    let transforms = build_transforms(&validation(0.1)).unwrap();
    let dataset = SceneDataset::new(source, transforms, seed, 1).unwrap();
    let settings = LoaderSettings {
        batch_size: 1,
        seed,
        workers,
        mix_probability: 0.0,
        ..LoaderSettings::default()
    };
    SceneLoader::new(Arc::new(dataset), InputFeatures::default(), settings).unwrap()
}

fn mix(counts: [usize; 3], weights: [usize; 3], rule: MixRule, workers: usize) -> WeightedMix {
    let loaders = (1..).zip(counts).map(|(seed, n)| loader(n, seed, workers)).collect();
    WeightedMix::new(loaders, weights.to_vec(), rule).unwrap()
}

fn all(mix: &mut WeightedMix, epoch: u64, skip: usize) -> Vec<TrainBatch> {
    mix.epoch(epoch, skip).map(Result::unwrap).collect()
}

#[test]
fn the_original_s_rounds() {
    // (len / 3) · 7 + len mod 3 batches, as its loader counts them.
    for (main, expected) in [(6, 14), (7, 15), (2, 2), (3, 7)] {
        let mix = mix([main, 2, 5], [3, 2, 2], MixRule::MainFirst, 0);
        let plan = mix.plan();
        assert_eq!((plan.len(), mix.batches_per_epoch()), (expected, expected));
        assert_eq!(plan.iter().filter(|&&d| d == 0).count(), main);
    }
    let plan = mix([7, 2, 5], [3, 2, 2], MixRule::MainFirst, 0).plan();
    assert_eq!(plan, [0, 0, 0, 1, 1, 2, 2, 0, 0, 0, 1, 1, 2, 2, 0]);
}

#[test]
fn proportional_holds_every_scene_as_often_as_its_weight() {
    let mut mix = mix([4, 2, 3], [1, 2, 1], MixRule::Proportional, 2);
    assert_eq!(mix.plan(), [0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1]);
    let mut seen = BTreeMap::new();
    let batches = all(&mut mix, 0, 0);
    assert_eq!(batches.len(), mix.batches_per_epoch());
    for (batch, dataset) in batches.iter().zip(mix.plan()) {
        *seen.entry((dataset, batch.ids[0].clone())).or_insert(0) += 1;
    }
    assert_eq!(seen.len(), 9);
    for ((dataset, id), times) in seen {
        assert_eq!(times, [1, 2, 1][dataset], "{dataset} {id}");
    }
}

#[test]
fn workers_and_skips_change_nothing() {
    for rule in [MixRule::Proportional, MixRule::MainFirst] {
        let expected = all(&mut mix([4, 2, 3], [2, 3, 1], rule, 0), 1, 0);
        for workers in [0, 1, 3] {
            let mut mix = mix([4, 2, 3], [2, 3, 1], rule, workers);
            assert_eq!(all(&mut mix, 1, 0), expected);
            for skip in [1, 5, expected.len(), 100] {
                assert_eq!(all(&mut mix, 1, skip), expected[skip.min(expected.len())..]);
            }
        }
    }
}

#[test]
fn a_dataset_that_begins_anew_has_another_order() {
    let mut mix = mix([8, 4, 4], [1, 1, 1], MixRule::MainFirst, 0);
    let mut orders = Vec::new();
    for epoch in 0..3 {
        let plan = mix.plan();
        let ids = all(&mut mix, epoch, 0).into_iter().map(|b| b.ids[0].clone());
        let ids: Vec<String> = ids.zip(plan).filter(|(_, d)| *d == 1).map(|(id, _)| id).collect();
        orders.extend(ids.chunks(4).map(<[String]>::to_vec));
    }
    assert_eq!(orders.len(), 6);
    let first = orders[0].clone();
    for order in &mut orders {
        let mut sorted = order.clone();
        sorted.sort();
        assert_eq!(sorted, ["room-000000", "room-000001", "room-000002", "room-000003"]);
    }
    assert!(orders.iter().any(|order| *order != first), "epochs differ");
    let mut passes = orders.chunks(2);
    assert!(passes.any(|pair| pair[0] != pair[1]), "and so do the passes of an epoch");
}

#[test]
fn weights_that_cannot_be_are_named() {
    let made =
        |weights: Vec<usize>| WeightedMix::new(vec![loader(2, 1, 0)], weights, MixRule::MainFirst);
    assert!(made(vec![1]).is_ok());
    for wrong in [vec![], vec![1, 2], vec![0], vec![usize::MAX]] {
        assert!(made(wrong).err().unwrap().to_string().contains("weights"));
    }
    assert!(WeightedMix::new(vec![], vec![], MixRule::Proportional).is_err());
}
