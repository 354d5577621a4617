//! Self-supervised training: teacher, heads, masks, centers and schedules do what they say, against loops
//! written by hand; interrupted it ends with the same bits; hard input has a stated result.

use crate::support::{
    Batches, batch_of, dataset, everything, fit, flat, in_step, loader as load_batches, resume,
    rooms, state, stop_at, trainer_by, views,
};
use candle_core::{Device, Tensor};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_datasets::{
    InputFeatures, MaskShape, MaskWeight, Masked, Masking, SceneLoader, TrainBatch, View, ViewKind,
};
use scenesplat_losses::self_supervised::GaussianDistance;
use scenesplat_models::{
    BackboneConfig, Compute, Forward, LevelOptions, ModelConfig, ParamStore, PointCloud,
    PointTransformerV3Config,
};
use scenesplat_trainers::checkpoint::newest_checkpoint;
use scenesplat_trainers::tasks::self_supervised::{
    Balance, Compat, DinoTerm, IbotCrossEntropyTerm, IbotTerm, LanguageAlignmentTerm,
    MaskedGaussiansTerm, Prototypes, SelfDistillationTerm, SelfSupervised, SelfSupervisedConfig,
    SimDinoRowsTerm, SimDinoTerm, TermConfig,
};
use scenesplat_trainers::{
    AfterStep, CosineSchedule, HasBackbone, OneCycle, StepContext, StepOutput, TrainError, Trainer,
    TrainerConfig, TrainingModule, WithWeightDecay,
};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::OnceLock;

fn model(decoder: bool) -> ModelConfig {
    let decoder: &[[usize; 3]] = if decoder { &[[1, 8, 1]] } else { &[] };
    let config = PointTransformerV3Config {
        in_channels: 11,
        drop_path: 0.1,
        mask_token: true,
        ..PointTransformerV3Config::language()
    };
    let config = config.with_stages(&[[1, 8, 1], [1, 16, 2]], decoder, 32);
    ModelConfig { grid_size: 0.25, ..ModelConfig::new(config) }
}

/// An encoder alone, without mask token and drop path.
fn unmasked() -> ModelConfig {
    let mut network = model(false);
    if let BackboneConfig::PointTransformerV3(config) = &mut network.backbone {
        (config.mask_token, config.drop_path) = (false, 0.0);
    }
    network
}

fn prototypes(balance: Balance) -> Prototypes {
    Prototypes { count: 12, hidden: 16, out: 8, balance, ..Prototypes::default() }
}

fn masked_gaussians(distance: GaussianDistance) -> TermConfig {
    TermConfig::MaskedGaussians(MaskedGaussiansTerm { distance, ..MaskedGaussiansTerm::default() })
}

fn simdino() -> TermConfig {
    TermConfig::SimDino(SimDinoTerm { hidden: 16, out: 8, ..SimDinoTerm::default() })
}

fn dino() -> TermConfig {
    TermConfig::Dino(DinoTerm { weight: 0.5, prototypes: prototypes(Balance::Centering(0.9)) })
}

fn ibot() -> TermConfig {
    TermConfig::Ibot(IbotTerm { hidden: 16, out: 8, ..IbotTerm::default() })
}

fn ibot_ce() -> TermConfig {
    let prototypes = prototypes(Balance::SinkhornKnopp(3));
    TermConfig::IbotCrossEntropy(IbotCrossEntropyTerm { weight: 1.0, prototypes })
}

fn distillation() -> TermConfig {
    TermConfig::SelfDistillation(SelfDistillationTerm {
        prototypes: prototypes(Balance::SinkhornKnopp(3)),
        up_cast: 1,
        max_distance: 0.5,
        ..SelfDistillationTerm::default()
    })
}

fn simdino_rows() -> TermConfig {
    TermConfig::SimDinoRows(SimDinoRowsTerm {
        hidden: 16,
        out: 8,
        max_rows: 50,
        up_cast: 1,
        max_distance: 0.5,
        ..SimDinoRowsTerm::default()
    })
}

fn masking(ratio: f64) -> Masking {
    let shape = MaskShape::Patches(0.5);
    Masking { shape, ratio: [ratio; 2], scenes: 1.0, weight: MaskWeight::PerGaussian }
}

fn settings(terms: Vec<TermConfig>) -> SelfSupervisedConfig {
    SelfSupervisedConfig { masking: Some(masking(0.4)), terms, ..SelfSupervisedConfig::default() }
}

fn all_terms() -> Vec<TermConfig> {
    vec![
        masked_gaussians(GaussianDistance::Fitted),
        simdino(),
        dino(),
        ibot(),
        ibot_ce(),
        distillation(),
        simdino_rows(),
    ]
}

fn module(settings: &SelfSupervisedConfig, model: &ModelConfig) -> SelfSupervised {
    let input = InputFeatures::default();
    SelfSupervised::new(settings, model, &input, ParamStore::trainable(3), 3).unwrap()
}

fn loader(workers: usize) -> SceneLoader {
    load_batches(dataset(rooms(6, 1200, 1), &views(0.5), 7), 2, workers)
}

fn first_batch() -> &'static TrainBatch {
    static BATCH: OnceLock<TrainBatch> = OnceLock::new();
    BATCH.get_or_init(|| loader(0).batches(0, 0).next().unwrap().unwrap())
}

fn trainer(module: &SelfSupervised, epochs: u64, dir: Option<&Path>) -> Trainer {
    let schedule =
        WithWeightDecay { rate: OneCycle::default(), decay: CosineSchedule::weight_decay() };
    let mut config = TrainerConfig { seed: 5, epochs, log_every: 1, ..Default::default() };
    config.checkpoint.dir = dir.map(Path::to_owned);
    trainer_by(module, config, 0.003, 0.001, schedule)
}

/// Takes the first step.
fn train_one_step(module: &SelfSupervised, epochs: u64) {
    let trainer = trainer(module, epochs, None).with_callback(stop_at(1));
    assert_eq!(fit(trainer, module, loader(0)).unwrap().step, 1);
}

fn values(store: &ParamStore) -> BTreeMap<String, Vec<f32>> {
    state(store).into_iter().collect()
}

fn one_step(module: &SelfSupervised, batch: &TrainBatch) -> StepOutput {
    in_step(|cx| module.training_step(batch, cx).unwrap())
}

/// A step with its masks.
fn masked_step(module: &SelfSupervised, views: &[View]) -> (Vec<Option<Masked>>, StepOutput) {
    in_step(|cx: &mut StepContext<'_>| {
        let masks = module.masks(views, cx).unwrap();
        let out = module.step_with_masks(views, &masks, cx).unwrap();
        (masks, out)
    })
}

/// Input rows of the masked Gaussians of all views.
fn masked_rows<'a>(
    views: &'a [View],
    masks: &'a [Option<Masked>],
) -> impl Iterator<Item = &'a [f32]> {
    views.iter().zip(masks).flat_map(|(view, masked)| {
        let hidden = masked.iter().flat_map(|masked| &masked.hidden);
        let rows = view.batch.feat.chunks_exact(11).zip(hidden);
        rows.filter(|(_, hidden)| **hidden).map(|(row, _)| row)
    })
}

fn term(out: &StepOutput, name: &str) -> Option<f64> {
    out.terms.iter().find(|(n, _)| n == name).map(|(_, v)| *v)
}

#[test]
fn every_term_teaches_every_parameter() {
    // The trainer refuses a parameter without gradient before the first update.
    for (terms, decoder) in [
        (all_terms(), true),
        (vec![masked_gaussians(GaussianDistance::Fitted)], true),
        (vec![masked_gaussians(GaussianDistance::Fitted), simdino(), ibot()], true),
        (vec![ibot_ce(), masked_gaussians(GaussianDistance::Fitted)], false),
        (vec![distillation()], false),
        (vec![simdino(), distillation(), dino()], false),
    ] {
        train_one_step(&module(&settings(terms), &model(decoder)), 1);
    }
}

#[test]
fn masked_sizes_are_compared_as_logarithms_whatever_axis_they_stand_at() {
    let terms = vec![masked_gaussians(GaussianDistance::Ellipsoid)];
    let module = module(&settings(terms), &model(false));
    // A head that gives its bias.
    let layers = module.params().parameters();
    let (weight, bias) =
        (&layers["heads.masked_gaussians.3.weight"], &layers["heads.masked_gaussians.3.bias"]);
    weight.set(&weight.zeros_like().unwrap()).unwrap();
    let guess = [-4.0f64, -4.5, -6.0];
    let values: Vec<f32> = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
        .into_iter()
        .chain(guess.map(|v| v as f32))
        .collect();
    bias.set(&Tensor::new(values, bias.device()).unwrap()).unwrap();

    let views = &first_batch().views;
    let (masks, out) = masked_step(&module, views);
    let (mut sum, mut count) = (0.0, 0);
    for row in masked_rows(views, &masks) {
        // Color, opacity, quaternion, sizes: the last three of eleven.
        let mut logs: Vec<f64> = row[8..].iter().map(|v| f64::from(*v).max(1e-4).ln()).collect();
        logs.sort_by(|a, b| b.total_cmp(a));
        for (log, guess) in logs.iter().zip(guess) {
            let d = (guess - log).abs();
            sum += if d < 0.1 { d * d / 0.2 } else { d - 0.05 };
            count += 1;
        }
    }
    assert!(count > 300, "{count} sizes");
    let got = term(&out, "masked_gaussians/scale").unwrap();
    let want = sum / f64::from(count);
    assert!((got - want).abs() < 1e-5 * want, "{got}, not {want}");
}

#[test]
fn the_teacher_is_a_copy_that_follows_after_the_step() {
    let module = module(&settings(vec![simdino(), ibot()]), &model(true));
    let teacher = module.teacher().unwrap();
    let (student_before, before) = (values(module.params()), values(teacher));
    for (name, value) in &before {
        assert_eq!(value, &student_before[name], "{name}: a copy at the start");
    }
    assert!(!before.contains_key("mask_token"));
    assert!(before.keys().any(|name| name.starts_with("heads.sim_dino.")));
    train_one_step(&module, 3);
    // m(0) of 0.9 → 1, and the student as the optimizer left it.
    let (after, now) = (values(teacher), values(module.params()));
    let mut moved = 0;
    for name in teacher.parameters().keys() {
        for ((a, b), s) in after[name].iter().zip(&before[name]).zip(&now[name]) {
            let want = 0.9 * b + 0.1 * s;
            assert!((a - want).abs() <= 1e-6 * want.abs().max(1.0), "{name}: {a}, not {want}");
            moved += usize::from(a != b);
        }
    }
    assert!(moved > 1000);
    // Its batch statistics are those of what it saw itself.
    let buffer = "embedding.stem.norm.running_mean";
    assert_ne!(after[buffer], before[buffer]);
    assert_ne!(after[buffer], now[buffer]);
}

#[test]
fn a_teacher_begins_with_the_statistics_of_a_trained_student() {
    let params = ParamStore::trainable(3);
    model(false).build(params.builder()).unwrap();
    for (name, var) in params.buffers() {
        let by = if name.ends_with("running_mean") { 0.25 } else { 0.5 };
        var.set(&(var.as_detached_tensor() + by).unwrap()).unwrap();
    }
    let trained = values(&params);
    let (config, input) = (settings(vec![simdino()]), InputFeatures::default());
    let module = SelfSupervised::new(&config, &model(false), &input, params, 3).unwrap();
    let teacher = module.teacher().unwrap();
    let own = values(teacher);
    assert!(teacher.buffers().len() > 4);
    for name in teacher.buffers().keys() {
        assert_eq!(own[name], trained[name], "{name}");
    }
}

#[test]
fn frozen_statistics_stay_as_they_are_in_a_step() {
    let module = module(&settings(vec![simdino(), ibot()]), &model(true));
    let buffers = module.params().buffers();
    let all = || -> BTreeMap<String, Vec<f32>> {
        let of = |(name, var): (&String, &candle_core::Var)| {
            let var = var.to_dtype(candle_core::DType::F32).unwrap();
            (name.clone(), var.flatten_all().unwrap().to_vec1().unwrap())
        };
        module.params().buffers().iter().map(of).collect()
    };
    let before = all();
    in_step(|cx| {
        cx.forward.frozen = scenesplat_models::FrozenStatistics::new(buffers.values());
        module.training_step(first_batch(), cx).unwrap();
    });
    assert_eq!(all(), before);
    // Without it they move.
    in_step(|cx| module.training_step(first_batch(), cx).unwrap());
    assert_ne!(all(), before);
}

#[test]
fn the_teacher_drops_no_path() {
    // Its batch statistics after a step are of its own activations, which no path of the student changes.
    let statistics = |drop_path: f64, compat: Compat| {
        let mut network = model(false);
        if let BackboneConfig::PointTransformerV3(config) = &mut network.backbone {
            // Rates rise from 0 over the blocks: before the last statistics there must be a second one.
            *config = config.clone().with_stages(&[[2, 8, 1], [1, 16, 2]], &[], 32);
            config.drop_path = drop_path;
            // Of one curve there is no order to draw, so that the student's draws leave the teacher's as they are.
            config.order.truncate(1);
        }
        let config = SelfSupervisedConfig { compat, ..settings(vec![simdino()]) };
        let module = module(&config, &network);
        one_step(&module, first_batch());
        let teacher = module.teacher().unwrap();
        let all = values(teacher);
        teacher.buffers().keys().map(|name| all[name].clone()).collect::<Vec<_>>()
    };
    let whole = statistics(0.0, Compat::None);
    assert!(whole.iter().flatten().any(|v| *v != 0.0 && *v != 1.0));
    assert_eq!(statistics(0.6, Compat::None), whole);
    // The original's does.
    assert_ne!(statistics(0.6, Compat::Original), statistics(0.0, Compat::Original));
}

#[test]
fn momentum_goes_by_the_step() {
    let momentum = CosineSchedule::new(0.5, 1.0);
    let config = SelfSupervisedConfig { momentum, masking: None, ..settings(vec![simdino()]) };
    let module = module(&config, &unmasked());
    let name = "heads.sim_dino.mlp.0.weight";
    let student = module.params().parameters()[name].clone();
    student.set(&(student.as_detached_tensor() + 1.0).unwrap()).unwrap();
    let at = |step: u64| {
        let read = |store: &ParamStore| values(store)[name][0];
        let (s, t) = (read(module.params()), read(module.teacher().unwrap()));
        let trained = module.params().parameters();
        module.after_step(&AfterStep { step, total_steps: 4, trained: &trained }).unwrap();
        // The share of the way that is left.
        (s - read(module.teacher().unwrap())) / (s - t)
    };
    // 1 + ½ (0.5 − 1)(1 + cos(π n/4)).
    for (step, want) in [(0, 0.5), (2, 0.75), (4, 1.0)] {
        let got = at(step);
        assert!((got - want).abs() < 1e-4, "step {step}: {got}, not {want}");
    }
}

#[test]
fn heads_are_trained_but_not_those_of_the_original() {
    for compat in [Compat::None, Compat::Original] {
        let terms = vec![masked_gaussians(GaussianDistance::Fitted), simdino(), ibot()];
        let config = SelfSupervisedConfig { compat, ..settings(terms) };
        let module = module(&config, &model(true));
        let heads = |m: &SelfSupervised| {
            let all = everything(m).into_iter();
            all.filter(|(name, _)| name.contains("heads.") && !name.starts_with("teacher/"))
                .collect::<Vec<_>>()
        };
        let before = heads(&module);
        assert!(!before.is_empty());
        train_one_step(&module, 1);
        let same = before == heads(&module);
        assert_eq!(same, compat == Compat::Original);
        let of_teacher = module.teacher().unwrap().parameters();
        let has_heads = of_teacher.keys().any(|name| name.starts_with("heads."));
        assert_eq!(has_heads, compat == Compat::None);
    }
    let config =
        SelfSupervisedConfig { compat: Compat::Original, ..settings(vec![simdino(), ibot()]) };
    let module = module(&config, &model(true));
    let name = "enc.enc0.block0.attn.qkv.weight";
    let (own, other) = (values(module.params()), values(module.teacher().unwrap()));
    assert_ne!(own[name], other[name], "the original's teacher begins elsewhere");
}

#[test]
fn masked_rows_are_what_the_reconstruction_is_measured_at() {
    // By hand: the head's output of the masked rows, against their inputs, mean over all channels.
    let terms = vec![masked_gaussians(GaussianDistance::MeanSquare)];
    let module = module(&settings(terms), &model(true));
    for (name, var) in module.params().parameters() {
        if name.starts_with("heads.masked_gaussians.3.") {
            // The last layer gives zeros: what is left are the targets.
            var.set(&var.zeros_like().unwrap()).unwrap();
        }
    }
    let views = &first_batch().views;
    let (masks, out) = masked_step(&module, views);
    let rows: Vec<&[f32]> = masked_rows(views, &masks).collect();
    let squares = rows.iter().flat_map(|row| *row).map(|v| f64::from(*v).powi(2)).sum::<f64>();
    let want = squares / (rows.len() * 11) as f64;
    let got = term(&out, "masked_gaussians").unwrap();
    assert!((got - want).abs() < 1e-5 * want, "{got}, not {want}");
    for (view, masked) in views.iter().zip(&masks) {
        assert_eq!(masked.is_some(), view.kind == ViewKind::Global);
        let Some(masked) = masked else { continue };
        // 0.5 m patches of augmented places: whole cells are hidden.
        let cell = |i: usize| view.batch.coord[i].map(|v| (f64::from(v) / 0.5).floor() as i64);
        let scene = |i: usize| view.batch.offsets.iter().filter(|o| **o <= i).count();
        let mut of_cell = BTreeMap::new();
        for (i, hidden) in masked.hidden.iter().enumerate() {
            assert_eq!(*of_cell.entry((scene(i), cell(i))).or_insert(*hidden), *hidden);
        }
    }
    // Both global views have masks of their own, and each step others.
    let hidden = |m: &Option<Masked>| m.as_ref().unwrap().hidden.clone();
    let share = |h: &[bool]| h.iter().filter(|h| **h).count() as f64 / h.len() as f64;
    assert!((0.1..0.8).contains(&share(&hidden(&masks[0]))));
    let next = in_step(|cx| {
        cx.step = 1;
        module.masks(views, cx).unwrap()
    });
    assert_ne!(hidden(&masks[0]), hidden(&next[0]));
}

#[test]
fn what_is_masked_is_not_seen() {
    // The mask token stands for what is hidden: other inputs there change nothing that the student makes.
    let module = module(&settings(vec![ibot()]), &model(true));
    let backbone = module.backbone();
    let view = &first_batch().views[0].batch;
    let points = |other: bool, hidden: &[bool]| {
        let mut feat = view.feat.clone();
        for (row, _) in feat.chunks_exact_mut(11).zip(hidden).filter(|(_, h)| other && **h) {
            row.fill(0.75);
        }
        let feat = Tensor::from_vec(feat, (view.len(), 11), &Device::Cpu).unwrap();
        PointCloud::new(view.grid_coord.clone(), feat, view.offsets.clone()).unwrap()
    };
    let rows = |other: bool, hidden: &[bool], with: bool| {
        let options = LevelOptions { mask: with.then_some(hidden), decoder: true };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut cx = Forward::eval(&mut rng);
        let levels = backbone.forward_levels(&points(other, hidden), options, &mut cx).unwrap();
        flat(levels.decoder().unwrap())
    };
    // All hidden: the stem's convolution reads neighbors, which are what a mask leaves to be read.
    let all = vec![true; view.len()];
    assert_eq!(rows(false, &all, true), rows(true, &all, true));
    assert_ne!(rows(false, &all, false), rows(true, &all, false));
}

#[test]
fn simdino_compares_other_views_of_the_same_scene() {
    // By hand from the vectors of both networks, which are one network at the start but for drop path
    // and what is masked: without both, compression is the mean cosine between different views.
    let config = SelfSupervisedConfig { masking: None, ..settings(vec![simdino()]) };
    let module = module(&config, &unmasked());
    let batch = first_batch();
    let mut same = batch.clone();
    // Every view is the first one: all cosines are 1.
    let first = same.views[0].clone();
    for view in &mut same.views {
        let kind = view.kind;
        *view = View { kind, ..first.clone() };
    }
    // Curve orders are shuffled from pass to pass, so equal views differ a little.
    let out = one_step(&module, &same);
    let alike = term(&out, "sim_dino/compression").unwrap();
    assert!(alike > 0.999, "{alike}");
    let out = one_step(&module, batch);
    let other = term(&out, "sim_dino/compression").unwrap();
    assert!(other < alike, "{other}");
    // −0.1 · compression − coding rate.
    let rate = term(&out, "sim_dino/coding_rate").unwrap();
    let total = term(&out, "sim_dino").unwrap();
    assert!((total + 0.1 * other + rate).abs() < 1e-5);
}

#[test]
fn weights_scale_their_terms() {
    let heavier = |weight| {
        TermConfig::SimDino(SimDinoTerm { weight, hidden: 16, out: 8, ..SimDinoTerm::default() })
    };
    let loss = |weight| {
        let terms = vec![masked_gaussians(GaussianDistance::Fitted), heavier(weight), ibot()];
        let out = one_step(&module(&settings(terms), &model(true)), first_batch());
        let sum = term(&out, "masked_gaussians").unwrap()
            + weight * term(&out, "sim_dino").unwrap()
            + term(&out, "ibot").unwrap();
        let loss = f64::from(out.loss.to_scalar::<f32>().unwrap());
        assert!((loss - sum).abs() < 1e-5 * sum.abs().max(1.0), "{loss}, not {sum}");
        loss
    };
    assert_ne!(loss(1.0), loss(3.0));
}

#[test]
fn interrupted_anywhere_it_ends_with_the_same_bits() {
    let config = SelfSupervisedConfig {
        mask_size: Some(CosineSchedule { warmup: 0.5, warmup_from: 0.3, from: 0.6, to: 0.6 }),
        mask_ratio: Some(CosineSchedule { warmup: 0.5, warmup_from: 0.2, from: 0.5, to: 0.5 }),
        ..settings(all_terms())
    };
    let build = || module(&config, &model(true));
    let whole = build();
    fit(trainer(&whole, 2, None), &whole, loader(0)).unwrap();
    let want = everything(&whole);
    assert!(want.iter().any(|(name, v)| name == "centers/dino" && v.iter().any(|v| *v != 0.0)));
    for (stop, workers) in [(1, 1), (3, 3), (4, 0)] {
        let dir = tempfile::tempdir().unwrap();
        let part = build();
        let first = trainer(&part, 2, Some(dir.path())).with_callback(stop_at(stop));
        assert_eq!(fit(first, &part, loader(workers)).unwrap().step, stop);
        let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
        for file in ["teacher.safetensors", "centers.safetensors"] {
            assert!(newest.join(file).is_file(), "{file}");
        }
        let rest = build();
        resume(trainer(&rest, 2, Some(dir.path())), dir.path(), &rest, loader(workers));
        assert!(want == everything(&rest), "stopped at {stop}, {workers} workers");
    }
}

#[test]
fn hard_batches_have_finite_losses_and_gradients() {
    let line = |n: usize| (0..n).map(|i| [i as f32 * 0.3, 0.0, 0.0]).collect::<Vec<_>>();
    let module = module(&settings(all_terms()), &model(true));
    for (what, scenes) in [
        ("one row", vec![line(1)]),
        ("two rows", vec![line(2)]),
        ("one row a scene", vec![line(1), line(1)]),
        ("identical scenes", vec![line(40), line(40)]),
        ("all in one cell", vec![vec![[0.1; 3]; 30], line(30)]),
        ("one scene", vec![line(50)]),
        ("a scene without rows beside one", vec![vec![], line(20)]),
    ] {
        let out = one_step(&module, &batch_of(&scenes, &views(0.5)));
        let loss = out.loss.to_scalar::<f32>().unwrap();
        assert!(loss.is_finite(), "{what}: {loss}");
        assert!(out.counted_rows > 0, "{what}");
        let grads = out.loss.backward().unwrap();
        for (name, var) in module.params().parameters() {
            let Some(grad) = grads.get(&var) else { continue };
            assert!(flat(grad).iter().all(|v| v.is_finite()), "{what}: {name}");
        }
    }
    let nothing = batch_of(&[vec![]], &views(0.5));
    assert!(module.is_empty(&nothing), "no rows: the batch is passed over");
    let beside = batch_of(&[vec![], line(20)], &views(0.5));
    assert!(beside.views.iter().all(|view| view.batch.ids == ["scene-1"]), "left out of all views");
}

#[test]
fn a_value_that_is_not_finite_is_named() {
    let module = module(&settings(all_terms()), &model(true));
    let before = everything(&module);
    let poisoned = |_, _| {
        let mut batch = first_batch().clone();
        batch.views[1].batch.feat[5 * 11 + 3] = f32::NAN;
        batch
    };
    let error = fit(trainer(&module, 1, None), &module, Batches(3, poisoned)).unwrap_err();
    let TrainError::Step { scenes, suspects, .. } = &error else { panic!("{error}") };
    assert_eq!(scenes.len(), 2);
    let named = suspects.join("; ");
    assert!(named.contains(&format!("{}: feat 3 of row 5 is NaN", scenes[0])), "{named}");
    let buffers = |name: &str| name.contains("running_") || name.contains("batches");
    for ((name, old), (_, new)) in before.iter().zip(&everything(&module)) {
        assert!(old == new || buffers(name), "{name}: the step was not taken");
    }
}

#[test]
fn all_masked_none_masked() {
    let config =
        |ratio| SelfSupervisedConfig { masking: Some(masking(ratio)), ..settings(all_terms()) };
    let all = one_step(&module(&config(1.0), &model(true)), first_batch());
    assert!(term(&all, "ibot").is_some() && term(&all, "masked_gaussians").is_some());
    assert!(all.loss.to_scalar::<f32>().unwrap().is_finite());
    // Nothing masked: terms of masked Gaussians are off, the others are not.
    let none = one_step(&module(&config(0.0), &model(true)), first_batch());
    for name in ["ibot", "ibot_cross_entropy", "masked_gaussians"] {
        assert_eq!(term(&none, name), None, "{name}");
    }
    assert!(term(&none, "sim_dino").is_some() && term(&none, "self_distillation").is_some());
}

#[test]
fn masks_are_switched_off_by_a_word() {
    let read = |text: &str| serde_json::from_str::<SelfSupervisedConfig>(text);
    assert_eq!(read(r#"{ "masking": "none" }"#).unwrap().masking, None);
    assert_eq!(read("{}").unwrap().masking, Some(Masking::default()));
    // What a run writes down is read as what it was.
    for masking in [None, Some(masking(0.3))] {
        let config = SelfSupervisedConfig { masking, ..settings(vec![simdino()]) };
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(read(&text).unwrap(), config, "{text}");
    }
    for (text, says) in [
        (r#"{ "masking": "nothing" }"#, "\"nothing\", expected a table of shape"),
        (r#"{ "masking": { "shap": "gaussians" } }"#, "`shap`"),
        (r#"{ "masking": 3 }"#, "or \"none\""),
    ] {
        let error = read(text).unwrap_err().to_string();
        assert!(error.contains(says), "{text}: {error}");
    }
}

#[test]
fn bf16_is_near_f32() {
    let mut network = model(true);
    let f32 = one_step(&module(&settings(all_terms()), &network), first_batch());
    let precision = "bf16".parse().unwrap();
    network.backbone.get_mut().set_compute(Compute { precision, ..Compute::default() });
    let bf16 = one_step(&module(&settings(all_terms()), &network), first_batch());
    for (name, value) in f32.terms.iter().filter(|(name, _)| !name.contains('/')) {
        let other = term(&bf16, name).unwrap();
        assert!((value - other).abs() < 0.05 * value.abs().max(0.2), "{name}: {value} {other}");
    }
}

#[test]
fn terms_and_networks_that_do_not_fit_are_refused() {
    let refused = |settings: &SelfSupervisedConfig, model: &ModelConfig| {
        let input = InputFeatures::default();
        let built = SelfSupervised::new(settings, model, &input, ParamStore::trainable(3), 3);
        built.err().unwrap().to_string()
    };
    let good = settings(vec![masked_gaussians(GaussianDistance::Fitted)]);
    assert!(refused(&settings(vec![]), &model(true)).contains("terms"));
    assert!(refused(&settings(vec![ibot(), ibot()]), &model(true)).contains("twice"));
    let no_mask = SelfSupervisedConfig { masking: None, ..good.clone() };
    assert!(refused(&no_mask, &model(true)).contains("masking"));
    assert!(refused(&settings(vec![simdino()]), &model(true)).contains("dec_depths"));
    assert!(refused(&good, &model(true).with_classes(3)).contains("num_classes"));
    let far = SelfDistillationTerm { up_cast: 2, ..SelfDistillationTerm::default() };
    let far = settings(vec![TermConfig::SelfDistillation(far)]);
    assert!(refused(&far, &model(false)).contains("up_cast"));
    let few = SimDinoRowsTerm { up_cast: 2, ..SimDinoRowsTerm::default() };
    let few = settings(vec![TermConfig::SimDinoRows(few)]);
    assert!(refused(&few, &model(false)).contains("sim_dino_rows.up_cast"));
    for (term, field) in [
        (SimDinoRowsTerm { epsilon: 0.0, ..SimDinoRowsTerm::default() }, "epsilon"),
        (SimDinoRowsTerm { max_rows: 0, ..SimDinoRowsTerm::default() }, "max_rows"),
        (SimDinoRowsTerm { shares: [0.0; 3], ..SimDinoRowsTerm::default() }, "shares"),
        (SimDinoRowsTerm { max_distance: f64::NAN, ..SimDinoRowsTerm::default() }, "max_distance"),
    ] {
        let bad = settings(vec![TermConfig::SimDinoRows(term)]);
        assert!(refused(&bad, &model(false)).contains(field), "{field}");
    }
    // Language features that the scenes do not have.
    let alignment = TermConfig::LanguageAlignment(LanguageAlignmentTerm::default());
    let module = module(&settings(vec![alignment]), &model(true));
    let error = in_step(|cx| module.training_step(first_batch(), cx).err().unwrap().to_string());
    assert!(error.contains("lang_feat"), "{error}");
}
