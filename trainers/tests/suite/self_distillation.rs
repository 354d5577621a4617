//! Self-distillation against a reference written by hand: rows of a scale, their places, the nearest row of
//! the other view by trying all, and the shares of the pairs; with a fault in the reference it differs.

use crate::support::{dataset, in_step, loader, rooms, views};
use candle_core::{Device, Tensor};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_datasets::{
    InputFeatures, MaskShape, MaskWeight, Masked, Masking, TrainBatch, View, ViewKind,
};
use scenesplat_losses::self_supervised::{Expansion, masked_cross_entropy, sinkhorn_knopp};
use scenesplat_models::self_supervised_heads::{ProjectionHead, ProjectionShape, PrototypeHead};
use scenesplat_models::{
    Backbone, BackboneConfig, Compute, Forward, LevelOptions, Levels, ModelConfig, ParamStore,
    PointCloud, PointTransformerV3Config,
};
use scenesplat_trainers::tasks::self_supervised::{
    Balance, Prototypes, SelfDistillationTerm, SelfSupervised, SelfSupervisedConfig,
    SimDinoRowsTerm, TermConfig,
};
use scenesplat_trainers::{CosineSchedule, HasBackbone, TrainingModule};

const GRID: f64 = 0.25;
/// Scales are 0.25, 0.5 and 1 m; rows are compared at the middle one.
const LEVEL: usize = 1;
const CHANNELS: usize = 11;
const SHARES: [f64; 3] = [0.2, 0.3, 0.5];
/// Below half of a cell's diagonal, so that some rows have no partner.
const MAX_DISTANCE: f64 = 0.2;
const HEAD: ProjectionShape = ProjectionShape { channels: 16 + 24, hidden: 16, out: 8 };
const PROTOTYPES: usize = 12;
const TAU_STUDENT: f64 = 0.1;
const TAU_TEACHER: f64 = 0.06;
const SEED: u64 = 1;

fn model() -> ModelConfig {
    let config = PointTransformerV3Config {
        in_channels: CHANNELS,
        drop_path: 0.0,
        mask_token: true,
        ..PointTransformerV3Config::language()
    }
    .with_stages(&[[1, 8, 1], [1, 16, 2], [1, 24, 2]], &[], 32);
    ModelConfig { grid_size: GRID, ..ModelConfig::new(config) }
}

fn self_distillation_term() -> TermConfig {
    let prototypes = Prototypes {
        count: PROTOTYPES,
        hidden: HEAD.hidden,
        out: HEAD.out,
        student_temperature: TAU_STUDENT,
        teacher_temperature: CosineSchedule::new(TAU_TEACHER, TAU_TEACHER),
        balance: Balance::SinkhornKnopp(3),
    };
    TermConfig::SelfDistillation(SelfDistillationTerm {
        weight: 1.0,
        prototypes,
        up_cast: 1,
        max_distance: MAX_DISTANCE,
        shares: SHARES,
    })
}

/// Fewer rows than most pairs match, so that some are left out.
const MOST_ROWS: usize = 40;

fn sim_dino_rows_term() -> TermConfig {
    TermConfig::SimDinoRows(SimDinoRowsTerm {
        hidden: HEAD.hidden,
        out: HEAD.out,
        coefficient: 3.0,
        epsilon: 0.1,
        expansion: Expansion::Student,
        max_rows: MOST_ROWS,
        up_cast: 1,
        max_distance: MAX_DISTANCE,
        shares: SHARES,
        ..SimDinoRowsTerm::default()
    })
}

fn module(term: TermConfig) -> SelfSupervised {
    let masking = Masking {
        shape: MaskShape::Patches(0.5),
        ratio: [0.5; 2],
        scenes: 1.0,
        weight: MaskWeight::PerGaussian,
    };
    let config = SelfSupervisedConfig {
        masking: Some(masking),
        terms: vec![term],
        ..SelfSupervisedConfig::default()
    };
    let input = InputFeatures::default();
    let built = SelfSupervised::new(&config, &model(), &input, ParamStore::trainable(3), 3);
    let module = built.unwrap();
    // A student that has left its teacher behind.
    for (i, (_, var)) in module.params().parameters().into_iter().enumerate() {
        let factor = 1.0 + 0.2 * ((i % 3) as f64 - 1.0);
        var.set(&(var.as_detached_tensor() * factor).unwrap()).unwrap();
    }
    // First prototypes lie close together for what first heads give; farther apart, faults show.
    for store in [module.params(), module.teacher().unwrap()] {
        for (name, var) in store.parameters() {
            if name.starts_with("heads.") && name.contains(".mlp.") && name.ends_with("weight") {
                var.set(&(var.as_detached_tensor() * 20.0).unwrap()).unwrap();
            }
        }
    }
    module
}

fn first_batch() -> TrainBatch {
    let data = dataset(rooms(2, 1500, 1), &views(0.6), 7);
    loader(data, 2, 0).batches(0, 0).next().unwrap().unwrap()
}

/// What the reference does otherwise, to see that the comparison would notice.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    None,
    /// The teacher's logits for local views by its head for masked ones.
    OneHeadOfTheTeacher,
    /// The shares of the same and the other view, one in the place of the other.
    SharesSwapped,
    /// Rows however far from each other.
    AnyDistance,
    /// The teacher sees what the student sees.
    MaskedTeacher,
    /// Rows with zeros in the place of the coarser scale.
    NoCoarserScale,
    /// Rows compared with those of the other scene, too.
    AcrossScenes,
    /// The first rows of a pair in the place of those evenly along it; of rows of SimDINO alone.
    FirstRows,
    /// All rows of a pair; of rows of SimDINO alone.
    AllRows,
    /// Local views against the last global view.
    LocalAgainstLast,
    /// Rows of the teacher by the numbers that the student's have: passes number rows each by the curve
    /// that it drew first.
    RowNumbersOfTheStudent,
}

/// A view of one network at the middle scale.
struct Rows {
    /// That scale's rows beside those of the coarser one. `[M, C]`
    feat: Tensor,
    /// Mean place before augmentation. `[M, 3]`
    place: Vec<[f64; 3]>,
    /// Scene of each row. `[M]`
    scene: Vec<usize>,
    /// Row of each of the view's Gaussians. `[N]`
    of_gaussian: Vec<u32>,
}

fn look(
    network: &dyn Backbone,
    view: &View,
    mask: Option<&Masked>,
    rng: &mut ChaCha8Rng,
    fault: Fault,
) -> Rows {
    let batch = &view.batch;
    let feat = Tensor::from_vec(batch.feat.clone(), (batch.len(), CHANNELS), &Device::Cpu).unwrap();
    let points = PointCloud::new(batch.grid_coord.clone(), feat, batch.offsets.clone()).unwrap();
    let options = LevelOptions { mask: mask.map(|m| m.hidden.as_slice()), decoder: false };
    let levels: Levels =
        network.forward_levels(&points, options, &mut Forward::train(rng)).unwrap();
    let (here, coarser) = (&levels.encoder()[LEVEL], &levels.encoder()[LEVEL + 1]);
    let parent = here.parents.as_ref().unwrap().inverse();
    let own = here.feat.to_vec2::<f32>().unwrap();
    let above = coarser.feat.to_vec2::<f32>().unwrap();
    let rows: Vec<f32> = (own.iter().zip(parent))
        .flat_map(|(row, &parent)| {
            let above = &above[parent as usize];
            let gone = vec![0.0; above.len()];
            let above = if fault == Fault::NoCoarserScale { &gone } else { above };
            row.iter().chain(above).copied().collect::<Vec<_>>()
        })
        .collect();
    let feat = Tensor::from_vec(rows, (own.len(), HEAD.channels), &Device::Cpu).unwrap();
    let mut sums = vec![[0.0; 4]; own.len()];
    let of_gaussian = levels.rows_at(LEVEL).unwrap();
    for (&row, place) in of_gaussian.iter().zip(&view.origin) {
        (0..3).for_each(|a| sums[row as usize][a] += f64::from(place[a]));
        sums[row as usize][3] += 1.0;
    }
    let place = sums.iter().map(|s| [0, 1, 2].map(|a| f64::from((s[a] / s[3]) as f32))).collect();
    let scene = (0..own.len()).map(|row| here.offsets[1..].iter().filter(|o| **o <= row).count());
    Rows { feat, place, scene: scene.collect(), of_gaussian }
}

/// For each row of `from` the nearest of `to`, by trying all.
fn partners(from: &Rows, to: &Rows, fault: Fault) -> Vec<(u32, u32)> {
    let mut found = Vec::new();
    for (row, place) in from.place.iter().enumerate() {
        let mut best = (f64::INFINITY, 0);
        for (other, there) in to.place.iter().enumerate() {
            let distance: f64 = (0..3).map(|a| (place[a] - there[a]).powi(2)).sum::<f64>().sqrt();
            let same = fault == Fault::AcrossScenes || from.scene[row] == to.scene[other];
            if same && distance < best.0 {
                best = (distance, other);
            }
        }
        if best.0 < MAX_DISTANCE || fault == Fault::AnyDistance && best.0.is_finite() {
            found.push((row as u32, best.1 as u32));
        }
    }
    found
}

/// The rows of two passes over a view that hold the same Gaussians.
fn same_cells(one: &Rows, other: &Rows, fault: Fault) -> Vec<(u32, u32)> {
    let rows = 0..one.place.len() as u32;
    if fault == Fault::RowNumbersOfTheStudent {
        return rows.map(|row| (row, row)).collect();
    }
    let first = |row: u32| one.of_gaussian.iter().position(|r| *r == row).unwrap();
    rows.map(|row| (row, other.of_gaussian[first(row)])).collect()
}

fn sinkhorn_cost(
    [student, teacher]: [&ParamStore; 2],
    [own, of_teacher]: [&str; 2],
    rows: &Tensor,
    with: &Tensor,
) -> f64 {
    let head = |store: &ParamStore, name: &str| {
        let vb = store.builder().pp("heads").pp("self_distillation").pp(name);
        PrototypeHead::new(HEAD, PROTOTYPES, Compute::default(), &vb).unwrap()
    };
    let logits = head(student, own).forward(rows).unwrap();
    let targets = head(teacher, of_teacher).forward(with).unwrap();
    let targets = sinkhorn_knopp(&targets, TAU_TEACHER, 3).unwrap();
    let count = rows.dim(0).unwrap();
    let weights = vec![1.0 / count as f64; count];
    let cost = masked_cross_entropy(&logits, &targets, &weights, TAU_STUDENT).unwrap().unwrap();
    f64::from(cost.to_scalar::<f32>().unwrap())
}

/// `−3 · mean cosine − (D + N)/(D N) · ½ log det(I + D/(0.1 N) ZᵀZ)`, the determinant by elimination.
fn coding_rate_cost([student, teacher]: [&ParamStore; 2], rows: &Tensor, with: &Tensor) -> f64 {
    let vectors = |store: &ParamStore, rows: &Tensor| {
        let vb = store.builder().pp("heads").pp("sim_dino_rows");
        let head = ProjectionHead::new(HEAD, Compute::default(), &vb).unwrap();
        head.forward(rows).unwrap().to_vec2::<f32>().unwrap()
    };
    let (z, t) = (vectors(student, rows), vectors(teacher, with));
    let (n, d) = (z.len() as f64, HEAD.out);
    let dot = |a: &[f32], b: &[f32]| -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    };
    let cosine = z.iter().zip(&t).map(|(a, b)| dot(a, b)).sum::<f64>() / n;
    let mut m = vec![vec![0.0; d]; d];
    for (i, line) in m.iter_mut().enumerate() {
        for (j, v) in line.iter_mut().enumerate() {
            let sum: f64 = z.iter().map(|r| f64::from(r[i]) * f64::from(r[j])).sum();
            *v = d as f64 / (0.1 * n) * sum + f64::from(u8::from(i == j));
        }
    }
    let mut log_det = 0.0;
    for i in 0..d {
        let pivot = m[i].clone();
        log_det += pivot[i].ln();
        for line in &mut m[i + 1..] {
            let factor = line[i] / pivot[i];
            line.iter_mut().zip(&pivot).for_each(|(v, p)| *v -= factor * p);
        }
    }
    -3.0 * cosine - (d as f64 + n) / (d as f64 * n) * 0.5 * log_det
}

/// At most [`MOST_ROWS`] pairs: of `n` the ones with number `i n / MOST_ROWS`.
fn thinned(pairs: &[(u32, u32)], fault: Fault) -> Vec<(u32, u32)> {
    let n = pairs.len();
    if n <= MOST_ROWS || fault == Fault::AllRows {
        return pairs.to_vec();
    }
    let at = |i: usize| if fault == Fault::FirstRows { i } else { i * n / MOST_ROWS };
    (0..MOST_ROWS).map(|i| pairs[at(i)]).collect()
}

/// Rows of all views by the student, and of the global ones by the teacher.
fn rows_of_both(
    module: &SelfSupervised,
    batch: &TrainBatch,
    masks: &[Option<Masked>],
    fault: Fault,
) -> [Vec<Rows>; 2] {
    let teacher_params = module.teacher().unwrap();
    let mut of_teacher = model();
    if let BackboneConfig::PointTransformerV3(config) = &mut of_teacher.backbone {
        config.mask_token = fault == Fault::MaskedTeacher;
    }
    if fault == Fault::MaskedTeacher {
        let token = module.params().parameters()["mask_token"].as_detached_tensor();
        let own = teacher_params.builder().get(token.dims(), "mask_token").unwrap();
        assert_eq!(own.dims(), token.dims());
    }
    let network = of_teacher.build(teacher_params.builder()).unwrap();
    // Both networks shuffle their curve orders by one generator, one view after the other.
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let views = batch.views.iter().zip(masks);
    let student = views
        .map(|(view, mask)| look(module.backbone(), view, mask.as_ref(), &mut rng, fault))
        .collect();
    let teacher = (0..2)
        .map(|i| {
            let mask = masks[i].as_ref().filter(|_| fault == Fault::MaskedTeacher);
            look(network.as_ref(), &batch.views[i], mask, &mut rng, fault)
        })
        .collect();
    [student, teacher]
}

/// The term, and how many rows have a partner in the pairs of different views, of how many.
fn reference(
    module: &SelfSupervised,
    batch: &TrainBatch,
    masks: &[Option<Masked>],
    fault: Fault,
) -> (f64, [usize; 2]) {
    let is_distillation =
        module.params().parameters().keys().any(|name| name.starts_with("heads.self_dist"));
    let stores = [module.params(), module.teacher().unwrap()];
    let [student, teacher] = rows_of_both(module, batch, masks, fault);
    let [mut same, mut other, local] = SHARES;
    if fault == Fault::SharesSwapped {
        (same, other) = (other, same);
    }
    let last = usize::from(fault == Fault::LocalAgainstLast);
    // (share, student's view, teacher's view): two global views, two local ones.
    let pairs = [
        (same / 2.0, 0, 0),
        (same / 2.0, 1, 1),
        (other / 2.0, 0, 1),
        (other / 2.0, 1, 0),
        (local / 2.0, 2, last),
        (local / 2.0, 3, last),
    ];
    let (mut sum, mut matched) = (0.0, [0, 0]);
    for (share, view, with) in pairs {
        let own = if view < 2 { "masked" } else { "local" };
        let teachers = if fault == Fault::OneHeadOfTheTeacher { "masked" } else { own };
        let pairs = if view == with {
            same_cells(&student[view], &teacher[with], fault)
        } else {
            let places = match fault {
                Fault::RowNumbersOfTheStudent => &student[with],
                _ => &teacher[with],
            };
            let found = partners(&student[view], places, fault);
            matched = [matched[0] + found.len(), matched[1] + student[view].place.len()];
            found
        };
        assert!(!pairs.is_empty());
        let pairs = if is_distillation { pairs } else { thinned(&pairs, fault) };
        let (rows, with_rows): (Vec<u32>, Vec<u32>) = pairs.into_iter().unzip();
        let pick = |rows: Vec<u32>, of: &Tensor| {
            of.index_select(&Tensor::new(rows, &Device::Cpu).unwrap(), 0).unwrap()
        };
        let rows = pick(rows, &student[view].feat);
        let with = pick(with_rows, &teacher[with].feat);
        sum += share
            * match is_distillation {
                true => sinkhorn_cost(stores, [own, teachers], &rows, &with),
                false => coding_rate_cost(stores, &rows, &with),
            };
    }
    (sum, matched)
}

/// The term of a step, the same by hand, and for each fault what comes of that; with how many rows have
/// a partner in the pairs of different views, and of how many.
fn compared(term: TermConfig, faults: &[Fault]) -> (f64, f64, Vec<f64>, [usize; 2]) {
    let name = term.name();
    let (module, batch) = (module(term), first_batch());
    let (masks, out) = in_step(|cx| {
        let masks = module.masks(&batch.views, cx).unwrap();
        let out = module.step_with_masks(&batch.views, &masks, cx).unwrap();
        (masks, out)
    });
    let kinds: Vec<ViewKind> = batch.views.iter().map(|view| view.kind).collect();
    let (global, local) = (ViewKind::Global, ViewKind::Local);
    assert_eq!(kinds, [global, global, local, local]);
    let got = out.terms.iter().find(|(term, _)| term == name).unwrap().1;
    let (want, matched) = reference(&module, &batch, &masks, Fault::None);
    let wrong = faults.iter().map(|fault| reference(&module, &batch, &masks, *fault).0);
    (got, want, wrong.collect(), matched)
}

#[test]
fn self_distillation_is_what_trying_all_rows_gives() {
    let faults = [
        Fault::OneHeadOfTheTeacher,
        Fault::SharesSwapped,
        Fault::AnyDistance,
        Fault::MaskedTeacher,
        Fault::NoCoarserScale,
        Fault::AcrossScenes,
        Fault::LocalAgainstLast,
        Fault::RowNumbersOfTheStudent,
    ];
    let (got, want, wrong, [matched, of]) = compared(self_distillation_term(), &faults);
    assert!((got - want).abs() < 1e-5 * want, "{got}, not {want}");
    assert!(matched > 50 && of - matched > 50, "{matched} of {of}: some rows match, some do not");
    for (fault, wrong) in faults.iter().zip(wrong) {
        assert!((wrong - got).abs() > 1e-3 * want, "{fault:?}: {wrong} and {got}");
    }
}

#[test]
fn simdino_of_rows_is_what_trying_all_rows_gives() {
    let faults = [
        Fault::SharesSwapped,
        Fault::AnyDistance,
        Fault::MaskedTeacher,
        Fault::NoCoarserScale,
        Fault::LocalAgainstLast,
        Fault::RowNumbersOfTheStudent,
        Fault::FirstRows,
        Fault::AllRows,
    ];
    let (got, want, wrong, _) = compared(sim_dino_rows_term(), &faults);
    assert!((got - want).abs() < 1e-5 * want.abs(), "{got}, not {want}");
    for (fault, wrong) in faults.iter().zip(wrong) {
        assert!((wrong - got).abs() > 1e-4 * want.abs(), "{fault:?}: {wrong} and {got}");
    }
}
