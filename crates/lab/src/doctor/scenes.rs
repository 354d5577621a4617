//! Level 4: whole scenes through the network that comes with the program.

use super::case::{Case, Finding};
use super::noise::Noise;
use super::table::case;
use super::trial::{Failure, ensure};
use candle_core::{Device, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scenesplat::inference::SceneFeatures;
use scenesplat::labels::{Classes, label_with_vote};
use scenesplat::{Network, SceneEncoder, WeightOptions, Weights, embedded};
use scenesplat_kernels::Precision;
use scenesplat_models::weights::WeightSource;
use scenesplat_models::{
    Backbone, Compute, Forward, ModelConfig, ParamStore, PointCloud, PointTransformerV3Config,
};
use scenesplat_rooms::{SyntheticRoomSettings, generate};
use scenesplat_scene::GaussianScene;

/// A furnished room that no training saw, of so many Gaussians.
fn room(gaussians: usize) -> Result<GaussianScene, Failure> {
    let settings = SyntheticRoomSettings {
        seed: 4711,
        room: 2,
        num_gaussians: Some(gaussians),
        points_share: 0.0,
        ..SyntheticRoomSettings::default()
    };
    Ok(generate(&settings)?.scene)
}

/// One that is small enough for a test of seconds.
pub(super) fn small_room() -> Result<GaussianScene, Failure> {
    room(4000)
}

/// The network inside the program.
pub(super) fn network(precision: Precision) -> Result<Network, Failure> {
    let config = embedded::config()?.with_compute(Compute { precision, ..Compute::default() });
    Ok(Network::load(config, &Weights::Embedded, WeightOptions::default())?)
}

/// Features of a scene by the network inside the program.
pub(super) fn encode(scene: &GaussianScene) -> Result<SceneFeatures, Failure> {
    encode_in(Precision::F32, scene)
}

fn encode_in(precision: Precision, scene: &GaussianScene) -> Result<SceneFeatures, Failure> {
    Ok(SceneEncoder::new(&network(precision)?).encode(scene, &mut |_| Ok(()))?)
}

/// How far rows are from unit length; a row that is not finite is none.
pub(super) fn finite_unit_rows(features: &SceneFeatures, rows: usize) -> Result<Finding, Failure> {
    ensure!(features.len() == rows, "{} rows for {rows} Gaussians", features.len());
    let values = features.gaussian_rows(0..rows)?;
    let mut found = Finding::right();
    for (row, values) in values.chunks_exact(features.width()).enumerate() {
        let norm = values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        found.add((norm - 1.0).abs(), || format!("row {row} has norm {norm}"));
    }
    Ok(found)
}

/// That a row for each Gaussian is there, finite and of unit length.
pub(super) fn check_features(features: &SceneFeatures, rows: usize) -> Result<(), Failure> {
    let finite = finite_unit_rows(features, rows)?;
    ensure!(finite.error <= 1e-5, "features: {}", finite.worst);
    Ok(())
}

/// Labels of a scene by the network's own vocabulary, with the usual vote.
fn labels(scene: &GaussianScene) -> Result<Vec<i32>, Failure> {
    let features = encode(scene)?;
    check_features(&features, scene.len())?;
    let texts = embedded::vocabulary()?.class_table();
    let found = label_with_vote(
        &features,
        Classes::Texts(&texts),
        &scenesplat_metrics::ZeroShotOptions::default(),
        &scene.coord,
        25,
    )?;
    Ok(found.labels)
}

pub(super) fn cases() -> Vec<Case> {
    let precisions = [Precision::F32Split, Precision::Bf16, Precision::Int8]
        .map(|precision| case(format!("room-in-{precision}"), move |_| in_precision(precision)));
    damaged().chain(company()).chain(precisions).collect()
}

/// A change of a room, and which of its Gaussians it takes away.
type Change = fn(&mut GaussianScene, &mut Noise) -> Vec<bool>;

/// Rooms with the faults that captures have; what is far away must not notice.
fn damaged() -> impl Iterator<Item = Case> {
    let damages: [(&str, Change); 5] = [
        ("room-with-a-hole", |scene, _| in_corner(scene)),
        ("room-with-a-hole-inside", |scene, _| {
            let mut gone = in_corner(scene);
            outermost(scene).for_each(|row| gone[row] = false);
            gone
        }),
        ("room-with-floaters", |scene, rng| {
            // Everything in the corner hangs somewhere in the corner.
            change_corner(scene, |scene, row| {
                scene.coord[row][2] += 0.5 * (rng.float() + 1.0);
                scene.opacity_logit[row] = -2.0;
            })
        }),
        ("room-with-blurred-corner", |scene, _| {
            change_corner(scene, |scene, row| scene.log_scale[row][0] += 1.5)
        }),
        ("room-with-clipped-corner", |scene, _| {
            change_corner(scene, |scene, row| scene.sh_dc[row] = [1.8; 3])
        }),
    ];
    damages.into_iter().map(|(name, change)| case(name, move |_| damage(change)))
}

/// Changes the Gaussians in the corner, and takes none away.
fn change_corner(
    scene: &mut GaussianScene,
    mut change: impl FnMut(&mut GaussianScene, usize),
) -> Vec<bool> {
    let there = in_corner(scene);
    (0..scene.len()).filter(|&row| there[row]).for_each(|row| change(scene, row));
    vec![false; there.len()]
}

/// Side of the damaged corner, meters.
const CORNER: f32 = 1.0;
/// What is farther from the corner than this is far away, meters.
const FAR: f32 = 1.5;

/// The Gaussians near the vertical edge of the room at its largest x and y.
fn in_corner(scene: &GaussianScene) -> Vec<bool> {
    let edge = edge(scene);
    scene.coord.iter().map(|p| p[0] > edge[0] - CORNER && p[1] > edge[1] - CORNER).collect()
}

/// The Gaussians at either end of each axis: what the bounding box hangs on.
fn outermost(scene: &GaussianScene) -> impl Iterator<Item = usize> + '_ {
    let along = move |axis: usize, sign: f32| {
        let at = move |row: &usize| sign * scene.coord[*row][axis];
        (0..scene.len()).max_by(move |a, b| at(a).total_cmp(&at(b)))
    };
    (0..6).filter_map(move |i| along(i / 2, if i % 2 == 0 { 1.0 } else { -1.0 }))
}

fn edge(scene: &GaussianScene) -> [f32; 2] {
    [0, 1].map(|axis| scene.coord.iter().map(|p| p[axis]).fold(f32::MIN, f32::max))
}

fn damage(change: Change) -> Result<Finding, Failure> {
    let room = room(20_000)?;
    let edge = edge(&room);
    let mut hurt = room.clone();
    let removed = change(&mut hurt, &mut Noise::new(3));
    let kept: Vec<usize> = (0..room.len()).filter(|&row| !removed[row]).collect();
    let hurt = hurt.select_rows(&kept)?;
    let (before, after) = (labels(&room)?, labels(&hurt)?);
    let (mut all, mut changed) = (0, 0);
    for (i, &row) in kept.iter().enumerate() {
        let p = room.coord[row];
        let near = (0..2).all(|axis| p[axis] > edge[axis] - CORNER - FAR);
        if !near {
            all += 1;
            changed += usize::from(before[row] != after[i]);
        }
    }
    ensure!(all > room.len() / 4, "only {all} Gaussians are far away");
    let error = f64::from(changed as u32) / f64::from(all as u32);
    Ok(Finding::of(error, format!("{changed} of {all} labels far away changed")))
}

/// Batch mates and threads: the same bits.
fn company() -> [Case; 5] {
    [
        case("beside-another-scene", |_| beside_another(700, 2500)),
        case("beside-a-single-voxel", |_| beside_another(301, 1)),
        case("network-on-threads", |t| {
            let scene = cells(1500, 4);
            t.one_and_many(|| forward(&*tiny()?, &[&scene])).map(drop)
        }),
        case("room-on-threads", |t| {
            let room = small_room()?;
            t.one_and_many(|| Ok(encode(&room)?.gaussian_rows(0..room.len())?)).map(drop)
        }),
        case("same-room-twice", |_| {
            let room = small_room()?;
            let rows = |features: SceneFeatures| features.gaussian_rows(0..room.len());
            let (a, b) = (rows(encode(&room)?)?, rows(encode(&room)?)?);
            ensure!(a == b, "the second run gives other features");
            Ok(())
        }),
    ]
}

/// A network of three scales with values from a hash.
fn tiny() -> Result<Box<dyn Backbone>, Failure> {
    let config = PointTransformerV3Config {
        in_channels: CHANNELS,
        mlp_ratio: 2,
        ..PointTransformerV3Config::language()
    }
    .with_stages(&[[2, 8, 2], [1, 16, 4], [1, 24, 3]], &[[1, 20, 2], [2, 16, 2]], 16);
    let store = ParamStore::frozen(WeightSource::hashed(5, ""));
    Ok(ModelConfig::new(config).build(store.builder())?)
}

/// What a voxel of [`cells`] has.
const CHANNELS: usize = 3;

/// Different voxels without an order, dense enough to have neighbors, and numbers for them.
fn cells(count: usize, seed: u64) -> (Vec<[i32; 3]>, Vec<f32>) {
    let mut rng = Noise::new(seed);
    let side = (f64::from(count as u32) * 4.0).cbrt().ceil() as usize + 1;
    let mut taken = std::collections::BTreeSet::new();
    let mut cells = Vec::with_capacity(count);
    while cells.len() < count {
        let cell = [(); 3].map(|()| rng.below(side) as i32);
        if taken.insert(cell) {
            cells.push(cell);
        }
    }
    let feat = (0..count * CHANNELS).map(|_| rng.float()).collect();
    (cells, feat)
}

/// Features of a batch, scene after scene.
fn forward(
    model: &dyn Backbone,
    scenes: &[&(Vec<[i32; 3]>, Vec<f32>)],
) -> Result<Vec<f32>, Failure> {
    let (mut all, mut feat, mut offsets) = (Vec::new(), Vec::new(), vec![0]);
    for (cells, values) in scenes {
        all.extend_from_slice(cells);
        feat.extend_from_slice(values);
        offsets.push(all.len());
    }
    let feat = Tensor::from_vec(feat, (all.len(), CHANNELS), &Device::Cpu)?;
    let points = PointCloud::new(all, feat, offsets)?;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    Ok(model.forward(&points, &mut Forward::eval(&mut rng))?.flatten_all()?.to_vec1()?)
}

fn beside_another(own: usize, mate: usize) -> Result<(), Failure> {
    let (scene, mate) = (cells(own, 1), cells(mate, 2));
    let model = tiny()?;
    let alone = forward(&*model, &[&scene])?;
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let first = forward(&*model, &[&scene, &mate])?;
    ensure!(bits(&first[..alone.len()]) == bits(&alone), "other bits in front of another scene");
    let last = forward(&*model, &[&mate, &scene])?;
    let start = last.len() - alone.len();
    ensure!(bits(&last[start..]) == bits(&alone), "other bits behind another scene");
    ensure!(alone.iter().all(|v| v.is_finite()), "not finite");
    Ok(())
}

fn in_precision(precision: Precision) -> Result<Finding, Failure> {
    let room = small_room()?;
    let (exact, reduced) = (encode(&room)?, encode_in(precision, &room)?);
    let (rows, width) = (room.len(), exact.width());
    let (a, b) = (exact.gaussian_rows(0..rows)?, reduced.gaussian_rows(0..rows)?);
    let mut cosines: Vec<f64> = a
        .chunks_exact(width)
        .zip(b.chunks_exact(width))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum())
        .collect();
    ensure!(cosines.iter().all(|c| c.is_finite()), "features are not finite");
    cosines.sort_by(f64::total_cmp);
    let (median, least) = (cosines[rows / 2], cosines[0]);
    Ok(Finding::of((1.0 - median).max(0.0), format!("least cosine {least:.6}")))
}
