//! Shortcuts of the last decoder stage: what they compute, by hand from the parts of the full network.

use crate::support::{Scene, batch, eval, frozen, observed, refusal, rng, rows};
use scenesplat_kernels::serialization::Curve;
use scenesplat_models::{
    Architecture, Backbone, Compute, Forward, LastStage, LitePtConfig, ModelConfig, Orders,
    ParamStore, PointCloud, PointTransformerV1Config, PointTransformerV2Config,
    PointTransformerV3Config, Shortcuts,
};
use std::collections::BTreeMap;

fn config(shortcuts: Shortcuts) -> PointTransformerV3Config {
    PointTransformerV3Config {
        in_channels: 3,
        mlp_ratio: 2,
        shortcuts,
        ..PointTransformerV3Config::language()
    }
    .with_stages(&[[1, 8, 2], [1, 16, 4], [1, 24, 3]], &[[2, 24, 2], [1, 16, 2]], 64)
}

fn build(shortcuts: Shortcuts) -> Box<dyn Backbone> {
    frozen(|vb| ModelConfig::new(config(shortcuts)).build(vb))
}

/// Two walls, and what lies in a second scene of the batch.
fn points(second: bool) -> PointCloud {
    let mut cells: Vec<[i32; 3]> = (0..400).map(|i| [i % 20, i / 20, 0]).collect();
    cells.extend((0..300).map(|i| [0, i % 20, 1 + i / 20]));
    let walls = Scene::new(cells, 3, "feat", 1);
    let other = (0..90).map(|i| [i % 9, i / 9, i % 4]).collect();
    let other = Scene::new(other, 3, "other", 1);
    if second { batch(&[&walls, &other]) } else { batch(&[&walls]) }
}

fn run(model: &dyn Backbone, points: &PointCloud) -> Vec<Vec<f32>> {
    rows(&eval(model, points))
}

/// What a network shows of its inside.
fn seen(model: &dyn Backbone, points: &PointCloud) -> BTreeMap<String, Vec<Vec<f32>>> {
    observed(model, points).into_iter().map(|(name, t)| (name, rows(&t))).collect()
}

const COARSE: Shortcuts = Shortcuts { stage: LastStage::Coarse, rank: None };

fn rank(rank: usize) -> Shortcuts {
    Shortcuts { rank: Some(rank), ..Shortcuts::default() }
}

fn cosine(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

#[test]
fn the_last_stage_begins_with_the_means_of_its_cells() {
    let points = points(false);
    let (full, coarse) = (build(Shortcuts::default()), build(COARSE));
    let (full, coarse) = (seen(&*full, &points), seen(&*coarse, &points));
    // Nothing before it is touched.
    for (name, rows) in &full {
        if !name.starts_with("dec.dec0") {
            assert_eq!(rows, &coarse[name], "{name}");
        }
    }
    let cells = morton(&points);
    let groups = groups(&cells);
    for name in ["dec.dec0.up", "dec.dec0.up.skip"] {
        assert_eq!((full[name].len(), coarse[name].len()), (700, groups.len()), "{name}");
        for (group, got) in groups.iter().zip(&coarse[name]) {
            for (channel, got) in got.iter().enumerate() {
                let sum: f64 = group.iter().map(|&r| f64::from(full[name][r][channel])).sum();
                let want = sum / group.len() as f64;
                assert!((f64::from(*got) - want).abs() < 1e-5, "{name}: {got} {want}");
            }
        }
    }
    assert_eq!(coarse["dec.dec0.block1"].len(), groups.len());
    assert_eq!(coarse["dec.dec0"].len(), 700);
}

/// Voxels in Morton order, as rows are inside the network.
fn morton(points: &PointCloud) -> Vec<[i32; 3]> {
    let mut cells: Vec<[i32; 3]> = points.grid_coord.to_vec();
    cells.sort_by_key(|c| Curve::Z.code(c.map(|v| v as u32), 21));
    cells
}

/// Rows of each coarse cell: in Morton order they follow each other.
fn groups(cells: &[[i32; 3]]) -> Vec<Vec<usize>> {
    let rows: Vec<usize> = (0..cells.len()).collect();
    let parent = |row: usize| cells[row].map(|v| v / 2);
    rows.chunk_by(|&a, &b| parent(a) == parent(b)).map(<[usize]>::to_vec).collect()
}

/// Each voxel gets its own skip row and what the blocks made of the cells around it: a value between theirs.
#[test]
fn rows_of_a_coarse_stage_come_back_between_those_of_the_cells_around() {
    let points = points(false);
    let (full, coarse) = (build(Shortcuts::default()), build(COARSE));
    let (full, coarse) = (seen(&*full, &points), seen(&*coarse, &points));
    let cells = morton(&points);
    let groups = groups(&cells);
    let made: Vec<Vec<f32>> = coarse["dec.dec0.block1"]
        .iter()
        .zip(&coarse["dec.dec0.up.skip"])
        .map(|(x, p)| x.iter().zip(p).map(|(x, p)| x - p).collect())
        .collect();
    let parents: Vec<[i32; 3]> = groups.iter().map(|g| cells[g[0]].map(|v| v / 2)).collect();
    let mut near = 0;
    for (own, group) in groups.iter().enumerate() {
        let around = (0..groups.len())
            .filter(|&g| (0..3).all(|axis| (parents[g][axis] - parents[own][axis]).abs() <= 1));
        let unknown = vec![(f32::INFINITY, f32::NEG_INFINITY); 24];
        let bounds: Vec<(f32, f32)> = around.fold(unknown, |bounds, g| {
            bounds.iter().zip(&made[g]).map(|((l, h), v)| (l.min(*v), h.max(*v))).collect()
        });
        for &row in group {
            let (out, skip) = (&coarse["dec.dec0"][row], &full["dec.dec0.up.skip"][row]);
            let change: Vec<f32> = out.iter().zip(skip).map(|(y, s)| y - s).collect();
            for (value, (low, high)) in change.iter().zip(&bounds) {
                assert!(*value >= low - 1e-4 && *value <= high + 1e-4, "{low} {value} {high}");
            }
            near += usize::from(made[own].iter().zip(&change).any(|(a, b)| (a - b).abs() > 1e-4));
        }
    }
    assert!(near > 600, "neighbors have a part in {near} voxels");
}

#[test]
fn scenes_of_a_batch_do_not_meet() {
    for shortcuts in [COARSE, rank(6), Shortcuts { rank: Some(6), ..COARSE }] {
        let model = build(shortcuts);
        let alone = points(false);
        // One example for both.
        let calibrated = model.calibrated(&alone).unwrap();
        let model = calibrated.as_ref().map_or(&*model, |c| &*c.backbone);
        let (alone, both) = (run(model, &alone), run(model, &points(true)));
        assert_eq!(alone, both[..700], "{shortcuts:?}");
        assert!(both.iter().flatten().all(|v| v.is_finite()));
    }
}

#[test]
fn a_single_voxel_has_a_coarse_stage_too() {
    let one = batch(&[&Scene::new(vec![[0; 3]], 3, "feat", 1)]);
    // There the coarse voxel is the fine one.
    let (full, coarse) = (run(&*build(Shortcuts::default()), &one), run(&*build(COARSE), &one));
    for (a, b) in full[0].iter().zip(&coarse[0]) {
        assert!((a - b).abs() < 1e-5, "{a} {b}");
    }
}

#[test]
fn ranks_wait_for_an_example_and_full_rank_changes_nothing() {
    let points = points(false);
    let full = run(&*build(Shortcuts::default()), &points);
    let waiting = build(rank(24));
    assert!(waiting.needs_example() && !build(COARSE).needs_example());
    assert!(build(COARSE).calibrated(&points).unwrap().is_none());
    let error = refusal(&*waiting, &points);
    assert!(error.contains("example"), "{error}");
    let mut before = -1.0;
    for (r, least) in [(2, 0.0), (12, 0.5), (24, 0.999_999)] {
        let found = build(rank(r)).calibrated(&points).unwrap().unwrap();
        assert!(!found.backbone.needs_example());
        let names: Vec<&str> = found.kept.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["dec.dec0.block0", "dec.dec0.block1"]);
        assert!(found.kept.iter().all(|(_, part)| *part >= least && *part <= 1.0 + 1e-9));
        let out = run(&*found.backbone, &points);
        let agreement = full.iter().zip(&out).map(|(a, b)| cosine(a, b)).sum::<f64>() / 700.0;
        assert!(agreement > before, "rank {r}: {agreement} after {before}");
        before = agreement;
        // The same example decides the same.
        let again = build(rank(r)).calibrated(&points).unwrap().unwrap();
        assert_eq!(out, run(&*again.backbone, &points));
        assert_eq!(found.kept, again.kept);
    }
    assert!(before > 1.0 - 1e-6, "{before}");
}

#[test]
fn layers_that_are_not_joined_have_a_rank_too() {
    let points = points(false);
    let build = |shortcuts| {
        let config = PointTransformerV3Config { compute: Compute::EXACT, ..config(shortcuts) };
        frozen(|vb| ModelConfig::new(config).build(vb))
    };
    let full = run(&*build(Shortcuts::default()), &points);
    let found = build(rank(24)).calibrated(&points).unwrap().unwrap();
    for (a, b) in full.iter().zip(&run(&*found.backbone, &points)) {
        assert!(cosine(a, b) > 1.0 - 1e-6);
    }
}

#[test]
fn shortcuts_are_for_inference_and_for_networks_that_have_such_a_stage() {
    let store = ParamStore::trainable(1);
    let error = ModelConfig::new(config(rank(4))).build(store.builder()).err().unwrap();
    assert!(error.to_string().contains("cannot be trained"), "{error}");
    let store = ParamStore::trainable(1);
    let model = ModelConfig::new(config(COARSE)).build(store.builder()).unwrap();
    let mut rng = rng(0);
    let mut cx = Forward { orders: Orders::Listed, ..Forward::train(&mut rng) };
    let error = model.forward(&points(false), &mut cx).unwrap_err().to_string();
    assert!(error.contains("cannot be trained"), "{error}");

    let mut others: Vec<Box<dyn Architecture>> = vec![
        Box::new(PointTransformerV1Config::default()),
        Box::new(PointTransformerV2Config::default()),
        Box::new(LitePtConfig::small_with_decoder()),
        Box::new(PointTransformerV3Config {
            dec_depths: vec![],
            dec_channels: vec![],
            dec_num_head: vec![],
            dec_patch_size: vec![],
            ..config(Shortcuts::default())
        }),
        Box::new(PointTransformerV3Config {
            dec_depths: vec![0, 1],
            ..config(Shortcuts::default())
        }),
    ];
    for other in &mut others {
        assert!(
            other.set_last_stage(LastStage::Coarse).unwrap_err().contains("last decoder stage")
        );
        assert!(other.set_rank(4).unwrap_err().contains("last decoder stage"));
    }
    let mut own = config(Shortcuts::default());
    assert!(own.set_rank(25).unwrap_err().contains("1 to 24"));
    own.set_rank(24).unwrap();
    own.set_last_stage(LastStage::Coarse).unwrap();
    assert_eq!(own.shortcuts, Shortcuts { stage: LastStage::Coarse, rank: Some(24) });
    // No part of what a file says.
    let text = serde_json::to_string(&own).unwrap();
    assert!(!text.contains("shortcut") && !text.contains("rank"), "{text}");
}

#[test]
fn shortcuts_cost_what_is_counted() {
    let cells: Vec<[i32; 3]> = points(false).grid_coord.to_vec();
    let work = |shortcuts| {
        let all = Architecture::multiply_adds(&config(shortcuts), &cells, true).unwrap();
        (all.stem, all.rest)
    };
    let full = work(Shortcuts::default());
    assert_eq!(full.0, work(COARSE).0);
    assert!(work(COARSE).1 < full.1 / 2, "{:?} of {full:?}", work(COARSE));
    // Two convolutions of p pairs: p c² becomes (p + n) c r.
    let saved = |r: u64| full.1 as i64 - work(rank(r as usize)).1 as i64;
    let (c, n) = (24i64, 700i64);
    let pairs = (saved(1) + 2 * n * c) / (2 * (c * c - c));
    for r in [1, 5, 24] {
        let want = 2 * (pairs * c * c - (pairs + n) * c * r);
        assert_eq!(saved(r as u64), want, "rank {r}");
    }
    let cost = |shortcuts| Architecture::cost(&config(shortcuts));
    let [all, coarse, low] = [Shortcuts::default(), COARSE, rank(6)].map(cost);
    assert!(coarse.work_per_voxel() < 0.6 * all.work_per_voxel());
    assert!(low.work_per_voxel() < all.work_per_voxel());
    assert!(coarse.bytes_per_voxel < all.bytes_per_voxel);
    assert!(low.bytes_per_voxel <= all.bytes_per_voxel);
}
