//! The loader: the same batches however they are made, and what becomes of broken scenes.

use scenesplat_datasets::transforms::{build_transforms, language_pretraining};
use scenesplat_datasets::{
    BatchLoader, BrokenScenes, DataError, Dataset, InputFeatures, LoaderSettings, Sample,
    SceneDataset, SceneLoader, SourceConfig, SyntheticRooms, TrainBatch,
};
use scenesplat_rooms::SyntheticRoomSettings;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

fn rooms(count: usize) -> Arc<SceneDataset> {
    let source = Arc::new(
        SyntheticRooms::new(count, SyntheticRoomSettings::with_count(1500, 0), 3).unwrap(),
    );
    let transforms = build_transforms(&language_pretraining(0.05)).unwrap();
    Arc::new(SceneDataset::new(source, transforms, 11, 1).unwrap())
}

fn loader(dataset: Arc<dyn Dataset>, settings: LoaderSettings) -> SceneLoader {
    SceneLoader::new(dataset, InputFeatures::default(), settings).unwrap()
}

fn settings(workers: usize) -> LoaderSettings {
    LoaderSettings { workers, prefetch: 3, seed: 9, mix_probability: 0.5, ..<_>::default() }
}

fn all(loader: &mut dyn BatchLoader<TrainBatch>, epoch: u64, skip: usize) -> Vec<TrainBatch> {
    loader.epoch(epoch, skip).map(Result::unwrap).collect()
}

/// A dataset of one Gaussian a scene, for what is done around samples.
#[derive(Default)]
struct Fake {
    ids: Vec<String>,
    made: AtomicUsize,
    active: AtomicUsize,
    delay: Duration,
    broken: BTreeSet<usize>,
    panics: BTreeSet<usize>,
}

impl Fake {
    fn new(count: usize) -> Self {
        let ids = (0..count).map(|i| format!("scene-{i}")).collect();
        Self { ids, ..Self::default() }
    }
}

impl Dataset for Fake {
    fn len(&self) -> usize {
        self.ids.len()
    }

    fn get(&self, epoch: u64, index: usize) -> Result<Sample, DataError> {
        self.made.fetch_add(1, Ordering::SeqCst);
        self.active.fetch_add(1, Ordering::SeqCst);
        std::thread::sleep(self.delay);
        self.active.fetch_sub(1, Ordering::SeqCst);
        assert!(!self.panics.contains(&index), "an index out of range, say");
        if self.broken.contains(&index) {
            return Err(DataError::UnknownScene { id: self.ids[index].clone(), known: 0 });
        }
        Ok(Sample {
            id: self.ids[index].clone(),
            coord: vec![[epoch as f32, index as f32, 0.0]],
            color: vec![[1.0; 3]],
            opacity: vec![0.5],
            scale: vec![[0.1; 3]],
            quat: vec![[1.0, 0.0, 0.0, 0.0]],
            grid_coord: vec![[0; 3]],
            grid_size: 0.1,
            ..Sample::default()
        })
    }

    fn id(&self, index: usize) -> &str {
        &self.ids[index]
    }
}

fn plain(workers: usize, batch_size: usize) -> LoaderSettings {
    LoaderSettings { workers, batch_size, mix_probability: 0.0, ..<_>::default() }
}

fn skipping(workers: usize, batch_size: usize) -> LoaderSettings {
    let broken_scenes = BrokenScenes::Skip;
    LoaderSettings { shuffle: false, broken_scenes, ..plain(workers, batch_size) }
}

#[test]
fn batches_are_the_same_for_any_number_of_workers_and_after_skip() {
    let expected = all(&mut loader(rooms(9), settings(0)), 2, 0);
    assert_eq!(expected.len(), 4, "nine scenes, two a batch, the last dropped");
    let mixed = expected.iter().filter(|b| b.num_samples() == 1).count();
    assert!(mixed > 0 && mixed < 4, "half of the batches are mixed, here {mixed}");
    for workers in [0, 1, 3] {
        let mut loader = loader(rooms(9), settings(workers));
        assert_eq!(all(&mut loader, 2, 0), expected, "{workers} workers");
        for skip in [1, 3, 4, 7] {
            let rest = &expected[skip.min(4)..];
            assert_eq!(all(&mut loader, 2, skip), rest, "{workers} workers after {skip}");
        }
    }
}

#[test]
fn threads_of_kernels_change_nothing() {
    let expected = all(&mut loader(rooms(4), settings(0)), 0, 0);
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let got = pool.install(|| all(&mut loader(rooms(4), settings(0)), 0, 0));
        assert_eq!(got, expected);
    }
}

#[test]
fn every_scene_comes_once_an_epoch_in_an_order_of_its_own() {
    let order = |epoch, seed| -> Vec<String> {
        let settings = LoaderSettings { drop_last: false, seed, ..plain(2, 4) };
        all(&mut loader(Arc::new(Fake::new(10)), settings), epoch, 0)
            .into_iter()
            .flat_map(|b| b.ids)
            .collect()
    };
    let first = order(0, 1);
    let expected: BTreeSet<String> = (0..10).map(|i| format!("scene-{i}")).collect();
    assert_eq!(first.iter().cloned().collect::<BTreeSet<_>>(), expected);
    assert_eq!(first, order(0, 1));
    assert_ne!(first, order(1, 1));
    assert_ne!(first, order(0, 2));
    let evaluation = LoaderSettings { workers: 2, ..LoaderSettings::evaluation() };
    let mut loader = loader(Arc::new(Fake::new(3)), evaluation);
    let ids: Vec<String> = all(&mut loader, 5, 0).into_iter().flat_map(|b| b.ids).collect();
    assert_eq!(ids, ["scene-0", "scene-1", "scene-2"]);
}

#[test]
fn a_broken_scene_stops_the_epoch_and_is_named() {
    for workers in [0, 1, 3] {
        let fake = Fake { broken: [5].into(), ..Fake::new(12) };
        let mut loader =
            loader(Arc::new(fake), LoaderSettings { shuffle: false, ..plain(workers, 2) });
        let batches: Vec<_> = loader.epoch(0, 0).collect();
        assert_eq!(batches.len(), 3, "two batches, then the error");
        let error = batches[2].as_ref().unwrap_err();
        assert!(error.to_string().contains("scene-5"), "{error}");
    }
}

#[test]
fn broken_scenes_are_left_out_only_if_told_so() {
    for workers in [0, 2] {
        let fake = Fake { broken: [1, 4, 5].into(), ..Fake::new(6) };
        let mut loader = loader(Arc::new(fake), skipping(workers, 2));
        let sizes: Vec<usize> =
            all(&mut loader, 0, 0).iter().map(TrainBatch::num_samples).collect();
        assert_eq!(sizes, [1, 2, 0]);
        let skipped = loader.skipped();
        assert_eq!(skipped.keys().collect::<Vec<_>>(), ["scene-1", "scene-4", "scene-5"]);
        assert!(skipped.values().all(|s| s.times == 1 && s.reason.contains("no scene is called")));
        all(&mut loader, 1, 2);
        assert_eq!(loader.skipped()["scene-4"].times, 2);
        assert_eq!(loader.skipped()["scene-1"].times, 1);
    }
}

#[test]
fn a_panic_is_an_error_that_names_the_scene() {
    for workers in [0, 1, 3] {
        let fake = Fake { panics: [2].into(), ..Fake::new(6) };
        let mut loader = loader(Arc::new(fake), skipping(workers, 1));
        let batches: Vec<_> = loader.epoch(0, 0).collect();
        assert_eq!(batches.len(), 3);
        let error = batches[2].as_ref().unwrap_err();
        assert!(
            matches!(error, DataError::Panicked { id, message }
                if id == "scene-2" && message.contains("out of range")),
            "{error}"
        );
    }
}

#[test]
fn dropping_stops_the_workers_and_what_waits_is_bounded() {
    let fake = Arc::new(Fake { delay: Duration::from_millis(5), ..Fake::new(1000) });
    let settings = LoaderSettings { prefetch: 4, ..plain(3, 1) };
    let mut loader = loader(Arc::<Fake>::clone(&fake), settings);
    let mut batches = loader.epoch(0, 0);
    for given in 1..=3 {
        batches.next().unwrap().unwrap();
        std::thread::sleep(Duration::from_millis(100));
        // Never more than four made or being made beside what was handed over.
        let made = fake.made.load(Ordering::SeqCst);
        assert!((given + 1..=given + 4).contains(&made), "{made} after {given}");
    }
    batches.next().unwrap().unwrap();
    drop(batches);
    assert_eq!(fake.active.load(Ordering::SeqCst), 0, "workers have ended");
    let made = fake.made.load(Ordering::SeqCst);
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(fake.made.load(Ordering::SeqCst), made, "no worker is left");
    assert!(made <= 8);
}

#[test]
fn an_iterator_that_nobody_asks_makes_nothing() {
    let fake = Arc::new(Fake::new(10));
    drop(loader(Arc::<Fake>::clone(&fake), plain(3, 1)).epoch(0, 0));
    assert_eq!(fake.made.load(Ordering::SeqCst), 0);
}

#[test]
fn settings_that_cannot_be_are_named() {
    let refused = |settings: LoaderSettings, count| {
        let made = SceneLoader::new(Arc::new(Fake::new(count)), <_>::default(), settings);
        made.err().unwrap().to_string()
    };
    let base = LoaderSettings::default;
    assert!(refused(LoaderSettings { batch_size: 0, ..base() }, 5).contains("batch_size"));
    assert!(refused(LoaderSettings { prefetch: 0, ..base() }, 5).contains("prefetch"));
    assert!(refused(LoaderSettings { workers: 5000, ..base() }, 5).contains("workers"));
    let nan = LoaderSettings { mix_probability: f64::NAN, ..base() };
    assert!(refused(nan, 5).contains("mix_probability"));
    assert!(refused(LoaderSettings { batch_size: 8, ..base() }, 5).contains("drop_last"));
    assert!(refused(base(), 0).contains("0 scenes"));
    let text = r#"{"workers": 1, "worker": 2}"#;
    assert!(serde_json::from_str::<LoaderSettings>(text).is_err());
}

#[test]
fn real_scenes_become_batches() {
    let Some(objects) = crate::shared("real/objects") else { return };
    let config = serde_json::json!({"type": "generic", "root": objects});
    let config: SourceConfig = serde_json::from_value(config).unwrap();
    let transforms = build_transforms(&language_pretraining(0.02)).unwrap();
    let dataset = Arc::new(config.dataset(transforms, 1, 1).unwrap());
    assert!(dataset.len() >= 5, "{}", dataset.len());
    let settings =
        LoaderSettings { broken_scenes: BrokenScenes::Skip, drop_last: false, ..settings(2) };
    let mut loader = loader(dataset, settings);
    let mut rows = 0;
    for batch in all(&mut loader, 0, 0) {
        assert_eq!(batch.feat.len(), batch.len() * batch.channels);
        assert!(batch.feat.iter().all(|v| v.is_finite()));
        for scene in batch.offsets.windows(2) {
            let cells = &batch.grid_coord[scene[0]..scene[1]];
            let distinct: BTreeSet<_> = cells.iter().collect();
            assert_eq!(distinct.len(), cells.len(), "no cell twice, mixed or not");
        }
        rows += batch.len();
    }
    let skipped = loader.skipped();
    assert!(rows > 10_000 && skipped.is_empty(), "{skipped:#?}");
}
