//! The same scene gives the same bits, whatever runs beside it; and inputs that nobody expects.

use crate::support::devices::here;
use crate::support::{
    Scene, batch, bits, eval, flat, frozen, gradients, is_finite, refusal, rng, rows, trainable,
    with_threads,
};
use candle_core::{DType, Tensor, Var};
use rand::Rng;
use scenesplat_models::{
    Backbone, Forward, ModelConfig, Orders, ParamStore, PointCloud, PointTransformerV3Config,
};
use std::collections::{BTreeMap, BTreeSet};

/// Two ways to compute a value in f32 (packed for inference, or with gradients) differ by roundings
/// that add up over some 60 operations.
const F32_PATHS: f32 = 1e-5;
const CHANNELS: usize = 3;
const PATCH: usize = 16;
const LAST_CELL: i32 = (1 << 21) - 1;

fn config() -> PointTransformerV3Config {
    PointTransformerV3Config {
        in_channels: CHANNELS,
        mlp_ratio: 2,
        ..PointTransformerV3Config::language()
    }
    .with_stages(&[[2, 8, 2], [1, 16, 4], [1, 24, 3]], &[[1, 20, 2], [2, 16, 2]], PATCH)
}

fn packed() -> Box<dyn Backbone> {
    frozen(|vb| ModelConfig::new(config()).build(vb))
}

fn with_gradients(config: PointTransformerV3Config) -> (ParamStore, Box<dyn Backbone>) {
    trainable(|vb| ModelConfig::new(config).build(vb))
}

/// The packed network and the one with gradients.
fn both() -> [(&'static str, Box<dyn Backbone>); 2] {
    [("packed", packed()), ("with gradients", with_gradients(config()).1)]
}

type Cells = Vec<[i32; 3]>;

fn scene(cells: Cells, seed: u64) -> Scene {
    Scene::new(cells, CHANNELS, "feat", seed)
}

/// Different voxels in random order, dense enough to have neighbors.
fn random(n: usize, seed: u64) -> Scene {
    let mut rng = rng(seed);
    let side = ((n * 4) as f64).cbrt().ceil() as i32 + 1;
    let mut taken = BTreeSet::new();
    let mut cells = Vec::new();
    while cells.len() < n {
        let cell = [(); 3].map(|()| rng.random_range(0..side));
        if taken.insert(cell) {
            cells.push(cell);
        }
    }
    scene(cells, seed)
}

fn filled(scene: &Scene, value: f32) -> Scene {
    Scene { feat: vec![value; scene.feat.len()], ..scene.clone() }
}

fn features(model: &dyn Backbone, scenes: &[&Scene]) -> Vec<Vec<f32>> {
    rows(&eval(model, &batch(scenes)))
}

/// Bits of all values; NaN equals NaN only with the same bits.
fn row_bits(rows: &[Vec<f32>]) -> Vec<u32> {
    rows.iter().flatten().map(|v| v.to_bits()).collect()
}

/// Equal bits; equal values on a device, whose library may choose another order of sums for another number of rows.
fn same(rows: &[Vec<f32>], want: &[Vec<f32>]) -> bool {
    if here().is_cpu() {
        return row_bits(rows) == row_bits(want);
    }
    let mut values = rows.iter().flatten().zip(want.iter().flatten());
    rows.len() == want.len() && values.all(|(a, b)| (a - b).abs() < 1e-5)
}

#[test]
fn any_number_of_threads() {
    let scenes = [random(3000, 1), random(37, 2)];
    let points = batch(&scenes.iter().collect::<Vec<_>>());
    for (_, model) in both() {
        let expected = bits(&eval(&*model, &points));
        assert_eq!(bits(&eval(&*model, &points)), expected, "a second run");
        for threads in [1, 2, 3, 5] {
            let got = with_threads(threads, || bits(&eval(&*model, &points)));
            assert!(got == expected, "{threads} threads");
        }
    }
    let points = batch(&[&random(500, 3)]);
    let [one, three] = [1, 3].map(|n| with_threads(n, || bits(&eval(&*packed(), &points))));
    assert_eq!(one, three, "packing");
}

/// Curves, patches and pooling belong to each scene, and no operation mixes rows of two scenes or
/// rounds a row differently for its place.
#[test]
fn any_company_in_a_batch() {
    let far = scene(vec![[LAST_CELL; 3], [0; 3]], 8);
    let (scene, one, two, large) = (random(700, 4), random(1, 5), random(2, 6), random(5000, 7));
    let batches: [&[&Scene]; 9] = [
        &[&scene, &one],
        &[&one, &scene],
        &[&two, &scene, &one],
        &[&scene, &large],
        &[&large, &scene],
        &[&one, &scene, &large],
        &[&large, &two, &scene],
        &[&far, &scene, &far],
        &[&scene, &scene],
    ];
    for (path, model) in both() {
        let model = &*model;
        let alone = row_bits(&features(model, &[&scene]));
        for (i, scenes) in batches.iter().enumerate() {
            let rows = features(model, scenes);
            let mut first = 0;
            for s in *scenes {
                let n = s.cells.len();
                if n == scene.cells.len() {
                    assert!(row_bits(&rows[first..first + n]) == alone, "{path}: batch {i}");
                }
                first += n;
            }
        }
        // Small ones are no exception.
        let alone = row_bits(&features(model, &[&one]));
        assert_eq!(row_bits(&features(model, &[&large, &one])[5000..]), alone);
        let alone = row_bits(&features(model, &[&two]));
        assert_eq!(row_bits(&features(model, &[&large, &two, &one])[5000..5002]), alone);
    }
}

/// Products of wide layers are cut into blocks; where the cuts are must not depend on other rows.
#[test]
fn wide_layers_in_any_company_with_any_number_of_threads() {
    let wide = PointTransformerV3Config {
        enc_channels: vec![32, 64, 128],
        enc_num_head: vec![2, 4, 8],
        enc_patch_size: vec![256; 3],
        dec_channels: vec![384, 192],
        dec_num_head: vec![8, 4],
        dec_patch_size: vec![256; 2],
        mlp_ratio: 4,
        ..config()
    };
    let wide = ModelConfig::new(wide);
    let with_gradients = trainable(|vb| wide.build(vb)).1;
    let models = [("packed", frozen(|vb| wide.build(vb))), ("with gradients", with_gradients)];
    let (scene, one, mate) = (random(301, 30), random(1, 31), random(1100, 32));
    for (path, model) in models {
        let alone = row_bits(&features(&*model, &[&scene]));
        let single = row_bits(&features(&*model, &[&one]));
        for threads in [1, 3] {
            let batch = [&one, &mate, &scene];
            let rows = with_threads(threads, || features(&*model, &batch));
            assert!(row_bits(&rows[..1]) == single, "{path}: one voxel, {threads} threads");
            assert!(row_bits(&rows[1101..]) == alone, "{path}: {threads} threads");
        }
    }
}

#[test]
fn a_scene_without_voxels_changes_nothing() {
    let (scene, empty) = (random(100, 9), random(0, 0));
    let model = &*packed();
    let alone = row_bits(&features(model, &[&scene]));
    for scenes in [&[&empty, &scene][..], &[&scene, &empty], &[&empty, &scene, &empty]] {
        assert_eq!(row_bits(&features(model, scenes)), alone);
    }
}

/// Rows are sorted inside, so the order in which they come makes no difference at all.
#[test]
fn any_order_of_the_rows() {
    let (scene, mate) = (random(900, 10), random(50, 11));
    let model = &*packed();
    let expected = features(model, &[&mate, &scene]);
    let mut rng = rng(12);
    for _ in 0..3 {
        let mut order: Vec<usize> = (0..900).collect();
        for i in (1..order.len()).rev() {
            order.swap(i, rng.random_range(0..=i));
        }
        let got = features(model, &[&mate, &scene.in_order(&order)]);
        assert_eq!(row_bits(&got[..50]), row_bits(&expected[..50]));
        for (position, &row) in order.iter().enumerate() {
            assert_eq!(
                row_bits(&got[50 + position..=50 + position]),
                row_bits(&expected[50 + row..=50 + row])
            );
        }
    }
}

/// Output, gradients and batch statistics of a training step.
fn step(scenes: &[&Scene]) -> BTreeMap<String, Vec<u32>> {
    let (store, model) = with_gradients(config());
    let out = model.forward(&batch(scenes), &mut Forward::train(&mut rng(3))).unwrap();
    let grads = gradients(&store, &out, 1).into_iter();
    let grads = grads.map(|(name, g)| (name, g.into_iter().map(f32::to_bits).collect()));
    let mut all = BTreeMap::from([("output".to_owned(), bits(&out))]);
    all.extend(grads);
    all.extend(store.buffers().into_iter().map(|(name, var)| (name, bits(&var))));
    all
}

/// Without drop path the order of the curves is all that a step draws; several patches, so that it
/// shows.
#[test]
fn training_walks_the_curves_in_an_order_of_each_step() {
    let scene = random(200, 15);
    let config = PointTransformerV3Config { drop_path: 0.0, ..config() };
    let (_, model) = with_gradients(config);
    let points = batch(&[&scene]);
    let run = |seed: u64, orders: Option<Orders>| {
        let mut rng = rng(seed);
        let mut cx = Forward::train(&mut rng);
        cx.orders = orders.unwrap_or(cx.orders);
        bits(&model.forward(&points, &mut cx).unwrap())
    };
    assert!(run(1, None) == run(1, None));
    assert!(run(1, None) != run(2, None), "every step walks alike");
    assert!(run(1, Some(Orders::Listed)) == run(2, Some(Orders::Listed)));
}

#[test]
fn gradients_with_any_number_of_threads() {
    let scenes = [random(2500, 13), random(40, 14)];
    let scenes: Vec<&Scene> = scenes.iter().collect();
    let expected = with_threads(1, || step(&scenes));
    assert!(expected.values().flatten().all(|v| f32::from_bits(*v).is_finite()));
    for threads in [1, 3, 4] {
        let got = with_threads(threads, || step(&scenes));
        for (name, values) in &got {
            assert!(*values == expected[name], "{name} with {threads} threads");
        }
    }
}

/// Both paths agree, rows are finite and of unit length.
fn assert_sound(case: &str, scene: &Scene) {
    let [packed, with_gradients] = both().map(|(_, model)| features(&*model, &[scene]));
    assert_eq!(packed.len(), scene.cells.len(), "{case}");
    for (row, (a, b)) in packed.iter().zip(&with_gradients).enumerate() {
        let norm = a.iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!((norm - 1.0).abs() < F32_PATHS, "{case}: row {row} has length {norm}");
        for (a, b) in a.iter().zip(b) {
            assert!((a - b).abs() < F32_PATHS, "{case}: row {row}: {a} and {b}");
        }
    }
}

#[test]
pub fn few_voxels_and_odd_places() {
    let last = LAST_CELL;
    let places: [(&str, Cells); 11] = [
        ("one voxel", vec![[3, 1, 4]]),
        ("one voxel at the origin", vec![[0; 3]]),
        ("one voxel at the end", vec![[last; 3]]),
        ("two neighbors", vec![[7, 7, 7], [7, 7, 8]]),
        ("two far apart", vec![[0; 3], [last; 3]]),
        ("a line along x", (0..50).map(|i| [i, 0, 0]).collect()),
        ("a line along z", (0..50).map(|i| [5, 5, 49 - i]).collect()),
        ("a diagonal", (0..50).map(|i| [i; 3]).collect()),
        ("a line at the end", (0..50).map(|i| [last, last - i, last]).collect()),
        ("a plane", (0..400).map(|i| [i % 20, 3, i / 20]).collect()),
        ("a full block", (0..512).map(|i| [i % 8, i / 8 % 8, i / 64]).collect()),
    ];
    for (case, cells) in places {
        assert_sound(case, &scene(cells, 15));
    }
}

#[test]
pub fn about_as_many_voxels_as_a_patch_holds() {
    for n in [PATCH - 1, PATCH, PATCH + 1, 2 * PATCH - 1, 2 * PATCH, 2 * PATCH + 1] {
        assert_sound(&format!("{n} voxels"), &random(n, 16));
    }
}

/// Mixed training scenes put two rows into one voxel: each row keeps its own center, and to the
/// neighbors the first row of the input stands for the voxel.
#[test]
pub fn rows_that_share_a_voxel() {
    let mut scene = random(200, 17);
    scene.cells[150] = scene.cells[3];
    scene.cells[199] = scene.cells[3];
    assert_sound("three rows in a voxel", &scene);
    assert_sound("all rows in a voxel", &self::scene(vec![[9; 3]; 40], 18));
    assert_sound("two equal rows", &filled(&self::scene(vec![[2; 3]; 2], 1), 0.5));
}

#[test]
pub fn features_of_any_finite_size() {
    let scene = random(120, 19);
    for value in [0.0, -0.0, 1e-30, f32::MIN_POSITIVE, f32::from_bits(1), 1e4] {
        assert_sound(&format!("all {value:e}"), &filled(&scene, value));
    }
    for factor in [1e-30f32, 1e-10, 1e5, 1e10, 1e20, 1e30] {
        let mut scaled = scene.clone();
        scaled.feat.iter_mut().for_each(|v| *v *= factor);
        assert_sound(&format!("times {factor:e}"), &scaled);
    }
}

/// NaN, infinity and sums that overflow make rows of their scene NaN, never rows of another.
#[test]
pub fn damaged_values_stay_in_their_scene() {
    let (good, mate) = (random(300, 20), random(80, 21));
    for (_, model) in both() {
        let model = &*model;
        let alone = features(model, &[&good]);
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
            let mut bad = mate.clone();
            bad.feat[40 * CHANNELS + 1] = value;
            for (scenes, at) in
                [(&[&bad, &good][..], 80), (&[&good, &bad], 0), (&[&bad, &good, &bad], 80)]
            {
                let rows = features(model, scenes);
                assert!(same(&rows[at..at + 300], &alone), "{value} spread to another scene");
            }
            // The row itself does not look healthy.
            if !value.is_finite() {
                let rows = features(model, &[&bad]);
                assert!(rows[40].iter().all(|v| v.is_nan()), "{value} became {:?}", rows[40]);
            }
            _ = features(model, &[&filled(&bad, value)]);
        }
    }
}

#[test]
fn what_is_refused() {
    let feat = |rows: usize, columns: usize, dtype: DType| {
        Tensor::zeros((rows, columns), dtype, &here()).unwrap()
    };
    let cells = |n: i32| (0..n).map(|i| [i, 0, 0]).collect::<Cells>();
    let new =
        |cells: Cells, feat: Tensor, offsets: Vec<usize>| PointCloud::new(cells, feat, offsets);

    // At the door.
    for dtype in [DType::F16, DType::BF16, DType::F64, DType::U32] {
        let message = PointCloud::single(cells(2), feat(2, 3, dtype)).unwrap_err().to_string();
        assert!(
            message.contains("expected f32") && message.contains(&format!("{dtype:?}")),
            "{message}"
        );
    }
    for (rows, offsets) in [(3, vec![0, 2]), (2, vec![0, 3]), (2, vec![0]), (2, vec![])] {
        assert!(new(cells(2), feat(rows, 3, DType::F32), offsets).is_err());
    }
    let flat = Tensor::zeros(6, DType::F32, &here()).unwrap();
    assert!(PointCloud::single(cells(2), flat).is_err());

    // In the network, for the fields are public.
    let network = &*packed();
    let refusal = |points: &PointCloud| refusal(network, points);
    let nobody = PointCloud::single(vec![], feat(0, 3, DType::F32)).unwrap();
    assert!(refusal(&nobody).contains("without any voxel"));
    let narrow = PointCloud::single(cells(2), feat(2, 2, DType::F32)).unwrap();
    assert!(refusal(&narrow).contains("expected [N, 3], got [2, 2]"));
    let good = PointCloud::single(cells(3), feat(3, 3, DType::F32)).unwrap();
    for dtype in [DType::F16, DType::BF16, DType::F64] {
        let message = refusal(&PointCloud { feat: feat(3, 3, dtype), ..good.clone() });
        assert!(message.contains("expected f32"), "{message}");
    }
    for offsets in [vec![0, 2, 1, 3], vec![1, 3], vec![0, 2], vec![0, 9], vec![3], vec![]] {
        let message = refusal(&PointCloud { offsets: offsets.clone().into(), ..good.clone() });
        assert!(message.contains("offset"), "{offsets:?}: {message}");
    }
    let message = refusal(&PointCloud { grid_coord: cells(2).into(), ..good.clone() });
    assert!(!message.is_empty());
    for (value, axis) in [(-1, 0), (LAST_CELL + 1, 1), (i32::MAX, 2), (i32::MIN, 2)] {
        let mut outside = cells(3);
        outside[1][axis] = value;
        let message = refusal(&PointCloud { grid_coord: outside.into(), ..good.clone() });
        assert!(message.contains(&value.to_string()), "{message}");
    }
}

/// A batch may be, or pool down to, a single voxel: its batch norms use what they remember.
#[test]
pub fn training_on_a_single_voxel() {
    let shape = PointTransformerV3Config { drop_path: 0.0, ..config() };
    let (store, model) = with_gradients(shape);
    let statistics = || -> Vec<(String, Vec<f32>)> {
        let value = |(name, v): (String, Var)| (name, flat(&v));
        store.buffers().into_iter().map(value).collect()
    };
    let before = statistics();
    let single = random(1, 1);
    let train =
        |scene: &Scene| model.forward(&batch(&[scene]), &mut Forward::train(&mut rng(0))).unwrap();
    let out = train(&single);
    assert_eq!(before, statistics(), "one row has no statistics to remember");
    let remembered = eval(&*model, &batch(&[&single]));
    assert_eq!(rows(&out), rows(&remembered), "the remembered statistics, as in evaluation");
    // Two voxels that pool into one leave a single row at the next scale.
    let pair = scene(vec![[0; 3], [1, 0, 0]], 1);
    for scene in [&single, &pair] {
        let out = train(scene);
        assert!(is_finite(&out));
        for (name, grad) in gradients(&store, &out, 1) {
            assert!(grad.iter().all(|v| v.is_finite()), "{name}");
        }
    }
    assert_ne!(before, statistics(), "two rows have");
    let message = packed().forward(&batch(&[&pair]), &mut Forward::train(&mut rng(0)));
    let message = message.unwrap_err().to_string();
    assert!(message.contains("trainable"), "{message}");
}

/// Regression of the trainable path: non-contiguous features are read as what they show.
#[test]
fn transposed_features() {
    let points = batch(&[&random(64, 22)]);
    let columns = points.feat.t().unwrap().contiguous().unwrap().t().unwrap();
    assert!(!columns.is_contiguous());
    for (path, model) in both() {
        let got = eval(&*model, &PointCloud { feat: columns.clone(), ..points.clone() });
        assert_eq!(bits(&got), bits(&eval(&*model, &points)), "{path}");
    }
}
