//! Terms of self-supervised training by hand: from the rows of both networks and their heads to the number, in f64.

use crate::support::{dataset, in_step, loader, rooms, views};
use candle_core::{Device, Tensor};
use half::f16;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_datasets::{
    InputFeatures, MaskShape, MaskWeight, Masked, Masking, TrainBatch, View,
};
use scenesplat_models::self_supervised_heads::{
    ProjectionHead, ProjectionShape, PrototypeHead, ReconstructionHead,
};
use scenesplat_models::{
    Backbone, BackboneConfig, Compute, Forward, LevelOptions, ModelConfig, ParamStore, PointCloud,
    PointTransformerV3Config,
};
use scenesplat_scene::LanguageFeatures;
use scenesplat_trainers::tasks::self_supervised::{
    Balance, Compat, DinoTerm, IbotCrossEntropyTerm, IbotTerm, LanguageAlignmentTerm,
    MaskedGaussiansTerm, Prototypes, SelfSupervised, SelfSupervisedConfig, SimDinoTerm, TermConfig,
};
use scenesplat_trainers::{CosineSchedule, HasBackbone, StepOutput, TrainingModule};

type Rows = Vec<Vec<f64>>;

const HIDDEN: usize = 12;
const OUT: usize = 6;
/// Channels of all scales at the voxels, and of the coarsest.
const WIDTHS: [usize; 2] = [8 + 16, 16];

pub fn model() -> ModelConfig {
    let config = PointTransformerV3Config {
        in_channels: 11,
        drop_path: 0.0,
        mask_token: true,
        ..PointTransformerV3Config::language()
    };
    let config = config.with_stages(&[[1, 8, 1], [1, 16, 2]], &[], 32);
    ModelConfig { grid_size: 0.25, ..ModelConfig::new(config) }
}

pub fn prototypes() -> Prototypes {
    Prototypes {
        count: 5,
        hidden: HIDDEN,
        out: OUT,
        student_temperature: 0.2,
        teacher_temperature: CosineSchedule::new(0.3, 0.4),
        balance: Balance::Centering(0.75),
    }
}

pub fn terms() -> Vec<TermConfig> {
    let (hidden, out) = (HIDDEN, OUT);
    vec![
        TermConfig::SimDino(SimDinoTerm {
            weight: 0.5,
            hidden,
            out,
            coefficient: 0.3,
            epsilon: 0.4,
            ..<_>::default()
        }),
        TermConfig::Dino(DinoTerm { weight: 2.0, prototypes: prototypes() }),
        TermConfig::Ibot(IbotTerm { weight: 3.0, hidden, out }),
        TermConfig::IbotCrossEntropy(IbotCrossEntropyTerm {
            weight: 0.25,
            prototypes: prototypes(),
        }),
        TermConfig::MaskedGaussians(MaskedGaussiansTerm { weight: 1.5, ..<_>::default() }),
        TermConfig::LanguageAlignment(LanguageAlignmentTerm {
            weight: 0.75,
            out: 3,
            hidden: 7,
            masked_only: true,
        }),
    ]
}

pub fn masking() -> Masking {
    // Scenes count what they weigh: unequal weights from scene to scene.
    Masking {
        shape: MaskShape::Patches(0.5),
        ratio: [0.2, 0.6],
        scenes: 1.0,
        weight: MaskWeight::PerPatch,
    }
}

pub fn module(terms: Vec<TermConfig>, compat: Compat) -> SelfSupervised {
    let config = SelfSupervisedConfig { masking: Some(masking()), compat, terms, ..<_>::default() };
    let input = InputFeatures::default();
    let module =
        SelfSupervised::new(&config, &model(), &input, ParamStore::trainable(3), 3).unwrap();
    // A student that has left its teacher behind, and heads that tell rows apart.
    for (i, (_, var)) in module.params().parameters().into_iter().enumerate() {
        let factor = 1.0 + 0.3 * ((i % 3) as f64 - 1.0);
        var.set(&(var.as_detached_tensor() * factor).unwrap()).unwrap();
    }
    for store in [Some(module.params()), module.teacher()].into_iter().flatten() {
        for (name, var) in store.parameters() {
            if name.starts_with("heads.") && name.contains(".mlp.") && name.ends_with("weight") {
                var.set(&(var.as_detached_tensor() * 10.0).unwrap()).unwrap();
            }
        }
    }
    module
}

/// Two scenes with language features of three numbers, of which some rows have none.
fn batch() -> TrainBatch {
    let data = dataset(rooms(2, 700, 1), &views(0.6), 7);
    let mut batch = loader(data, 2, 0).batches(0, 0).next().unwrap().unwrap();
    for (v, view) in batch.views.iter_mut().enumerate() {
        let n = view.batch.len();
        let value = |i: usize| f16::from_f64(((i * 7 + v) as f64 * 0.37).sin());
        view.batch.lang_feat =
            Some(LanguageFeatures { values: (0..n * 3).map(value).collect(), dim: 3 });
        view.batch.valid_feat = Some((0..n).map(|row| row % 4 != v).collect());
    }
    batch
}

fn rows_of(tensor: &Tensor) -> Rows {
    let rows = tensor.to_vec2::<f32>().unwrap();
    rows.into_iter().map(|row| row.into_iter().map(f64::from).collect()).collect()
}

fn tensor(rows: &Rows) -> Tensor {
    let values: Vec<f32> = rows.iter().flatten().map(|v| *v as f32).collect();
    Tensor::from_vec(values, (rows.len(), rows[0].len()), &Device::Cpu).unwrap()
}

/// Rows at the voxels, and the mean of the coarsest rows of each scene.
fn look(
    network: &dyn Backbone,
    view: &View,
    mask: Option<&Masked>,
    rng: &mut ChaCha8Rng,
) -> [Rows; 2] {
    let batch = &view.batch;
    let feat = Tensor::from_vec(batch.feat.clone(), (batch.len(), 11), &Device::Cpu).unwrap();
    let points = PointCloud::new(batch.grid_coord.clone(), feat, batch.offsets.clone()).unwrap();
    let options = LevelOptions { mask: mask.map(|m| m.hidden.as_slice()), decoder: false };
    let levels = network.forward_levels(&points, options, &mut Forward::train(rng)).unwrap();
    let coarsest = levels.encoder().last().unwrap();
    let all = rows_of(&coarsest.feat);
    let mean = |range: &[usize]| -> Vec<f64> {
        let scene = &all[range[0]..range[1]];
        let sum = |c: usize| scene.iter().map(|row| row[c]).sum::<f64>() / scene.len() as f64;
        (0..WIDTHS[1]).map(sum).collect()
    };
    let scenes = coarsest.offsets.windows(2).map(mean).collect();
    [rows_of(&levels.up_cast(0).unwrap()), scenes]
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn cosine(a: &[f64], b: &[f64]) -> f64 {
    dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
}

fn softmax(row: &[f64], temperature: f64) -> Vec<f64> {
    let each: Vec<f64> = row.iter().map(|v| (v / temperature).exp()).collect();
    let sum: f64 = each.iter().sum();
    each.into_iter().map(|v| v / sum).collect()
}

fn cross_entropy(student: &[f64], teacher: &[f64]) -> f64 {
    let (p, q) = (softmax(student, 0.2), softmax(teacher, 0.3));
    -q.iter().zip(p).map(|(q, p)| q * p.ln()).sum::<f64>()
}

/// Entropy of the mean distribution over its largest.
fn evenness(teacher: &[&Vec<f64>]) -> f64 {
    let all: Vec<Vec<f64>> = teacher.iter().map(|row| softmax(row, 0.3)).collect();
    let mean = |k: usize| all.iter().map(|row| row[k]).sum::<f64>() / all.len() as f64;
    -(0..5).map(|k| mean(k) * mean(k).ln()).sum::<f64>() / 5f64.ln()
}

/// ½ log det(I + d / (b ε) Zᵀ Z) · (d + b) / (d b), by elimination.
fn coding_rate(z: &Rows, epsilon: f64) -> f64 {
    let (b, d) = (z.len() as f64, z[0].len());
    let entry = |i: usize, j: usize| {
        let sum: f64 = z.iter().map(|row| row[i] * row[j]).sum();
        d as f64 / (b * epsilon) * sum + f64::from(u8::from(i == j))
    };
    let mut m: Rows = (0..d).map(|i| (0..d).map(|j| entry(i, j)).collect()).collect();
    let mut log_det = 0.0;
    for i in 0..d {
        let pivot = m[i].clone();
        log_det += pivot[i].ln();
        for line in &mut m[i + 1..] {
            let factor = line[i] / pivot[i];
            line.iter_mut().zip(&pivot).for_each(|(v, p)| *v -= factor * p);
        }
    }
    0.5 * log_det * (d as f64 + b) / (d as f64 * b)
}

fn term(out: &StepOutput, name: &str) -> f64 {
    out.terms.iter().find(|(n, _)| n == name).unwrap_or_else(|| panic!("{name}: {:?}", out.terms)).1
}

#[test]
fn every_term_is_the_one_computed_by_hand() {
    let (module, batch) = (module(terms(), Compat::None), batch());
    let views = &batch.views;
    let (masks, out) = in_step(|cx| {
        let masks = module.masks(views, cx).unwrap();
        let out = module.step_with_masks(views, &masks, cx).unwrap();
        (masks, out)
    });
    let mut of_teacher = model();
    if let BackboneConfig::PointTransformerV3(config) = &mut of_teacher.backbone {
        config.mask_token = false;
    }
    let stores = [module.params(), module.teacher().unwrap()];
    let network = of_teacher.build(stores[1].builder()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let student: Vec<[Rows; 2]> = views
        .iter()
        .zip(&masks)
        .map(|(view, mask)| look(module.backbone(), view, mask.as_ref(), &mut rng))
        .collect();
    let teacher: Vec<[Rows; 2]> =
        views[..2].iter().map(|view| look(network.as_ref(), view, None, &mut rng)).collect();
    let head = |store: &ParamStore, name: &str, rows: &Rows| -> Rows {
        let vb = store.builder().pp("heads").pp(name);
        let shape = ProjectionShape { channels: rows[0].len(), hidden: HIDDEN, out: OUT };
        let (rows, compute) = (tensor(rows), Compute::default());
        rows_of(&match name {
            "sim_dino" | "ibot" => {
                ProjectionHead::new(shape, compute, &vb).unwrap().forward(&rows).unwrap()
            }
            "masked_gaussians" => ReconstructionHead::new(WIDTHS[0], 11, compute, &vb)
                .unwrap()
                .forward(&rows)
                .unwrap(),
            "language_alignment" => {
                let head = ReconstructionHead::with_hidden(WIDTHS[0], 7, 3, compute, &vb).unwrap();
                head.forward(&rows).unwrap()
            }
            _ => PrototypeHead::new(shape, 5, compute, &vb).unwrap().forward(&rows).unwrap(),
        })
    };
    let near = |name: &str, want: f64| {
        let got = term(&out, name);
        assert!((got - want).abs() < 2e-4 * want.abs().max(0.1), "{name}: {got}, by hand {want}");
    };

    // Vectors of scenes: the mean over pairs of a teacher's view with another view of the student.
    let scenes = |name: &str| -> [Vec<Rows>; 2] {
        let all = |i: usize, seen: &[[Rows; 2]]| {
            seen.iter().map(|s| head(stores[i], name, &s[1])).collect()
        };
        [all(0, &student), all(1, &teacher)]
    };
    let [s, t] = scenes("sim_dino");
    let mean_of = |of: &dyn Fn(&[f64], &[f64]) -> f64, s: &Rows, t: &Rows| {
        s.iter().zip(t).map(|(a, b)| of(a, b)).sum::<f64>() / s.len() as f64
    };
    let pairs: Vec<(usize, usize)> =
        (0..2).flat_map(|t| (0..4).filter(move |s| *s != t).map(move |s| (t, s))).collect();
    let compression = pairs.iter().map(|(i, j)| mean_of(&dot, &s[*j], &t[*i])).sum::<f64>() / 6.0;
    near("sim_dino/compression", compression);
    near(
        "sim_dino/global_compression",
        (mean_of(&dot, &s[1], &t[0]) + mean_of(&dot, &s[0], &t[1])) / 2.0,
    );
    let middle = |v: usize| -> Rows {
        let pairs = s[v].iter().zip(&t[v]);
        pairs.map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a + b) / 2.0).collect()).collect()
    };
    let rate = (coding_rate(&middle(0), 0.4) + coding_rate(&middle(1), 0.4)) / 2.0;
    near("sim_dino/coding_rate", rate);
    near("sim_dino", -0.3 * compression - rate);
    let [s, t] = scenes("dino");
    let dino =
        pairs.iter().map(|(i, j)| mean_of(&cross_entropy, &s[*j], &t[*i])).sum::<f64>() / 6.0;
    near("dino", dino);
    near("dino/prototypes_used", evenness(&t.iter().flatten().collect::<Vec<_>>()));

    // Masked rows of both global views, each with its own weight.
    let (mut own, mut other, mut weights, mut inputs) =
        (Rows::new(), Rows::new(), Vec::new(), Rows::new());
    for (v, mask) in masks.iter().take(2).enumerate() {
        let mask = mask.as_ref().unwrap();
        for row in (0..mask.hidden.len()).filter(|row| mask.hidden[*row]) {
            own.push(student[v][0][row].clone());
            other.push(teacher[v][0][row].clone());
            weights.push(mask.weights[row]);
            inputs.push(
                views[v].batch.feat[row * 11..][..11].iter().map(|x| f64::from(*x)).collect(),
            );
        }
    }
    assert!(masks[2..].iter().all(Option::is_none));
    assert!(weights.iter().any(|w| (w - weights[0]).abs() > 1e-3), "weights differ");
    let [s, t] = [head(stores[0], "ibot", &own), head(stores[1], "ibot", &other)];
    near("ibot", -(0..s.len()).map(|i| weights[i] * cosine(&s[i], &t[i])).sum::<f64>());
    let name = "ibot_cross_entropy";
    let [s, t] = [head(stores[0], name, &own), head(stores[1], name, &other)];
    let sum: f64 = weights.iter().sum();
    near(name, (0..s.len()).map(|i| weights[i] / sum * cross_entropy(&s[i], &t[i])).sum::<f64>());
    near("ibot_cross_entropy/prototypes_used", evenness(&t.iter().collect::<Vec<_>>()));

    // Squares of what the head gives and the input, over all channels and by attribute.
    let made = head(stores[0], "masked_gaussians", &own);
    let square = |columns: std::ops::Range<usize>| {
        let count = (made.len() * columns.len()) as f64;
        let row = |(a, b): (&Vec<f64>, &Vec<f64>)| -> f64 {
            columns.clone().map(|c| (a[c] - b[c]).powi(2)).sum()
        };
        made.iter().zip(&inputs).map(row).sum::<f64>() / count
    };
    near("masked_gaussians", square(0..11));
    for (name, columns) in [("color", 0..3), ("opacity", 3..4), ("quat", 4..8), ("scale", 8..11)] {
        near(&format!("masked_gaussians/{name}"), square(columns));
    }

    // Features of masked rows that have one.
    let (mut rows, mut features) = (Rows::new(), Rows::new());
    for (v, mask) in masks.iter().take(2).enumerate() {
        let (view, hidden) = (&views[v].batch, &mask.as_ref().unwrap().hidden);
        for row in
            (0..view.len()).filter(|row| hidden[*row] && view.valid_feat.as_ref().unwrap()[*row])
        {
            rows.push(student[v][0][row].clone());
            let values = &view.lang_feat.as_ref().unwrap().values[row * 3..][..3];
            features.push(values.iter().map(|v| v.to_f64()).collect());
        }
    }
    let made = head(stores[0], "language_alignment", &rows);
    let mean = |of: &dyn Fn(&[f64], &[f64]) -> f64| mean_of(of, &made, &features);
    let apart = mean(&|a, b| 1.0 - cosine(a, b));
    let squares = mean(&|a, b| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum());
    near("language_alignment/cosine", apart);
    near("language_alignment/l2", squares);
    near("language_alignment", apart + squares);

    let loss: f64 = terms().iter().map(|t| t.weight() * term(&out, t.name())).sum();
    assert!(
        (f64::from(out.loss.to_scalar::<f32>().unwrap()) - loss).abs() < 1e-4 * loss.abs().max(1.0)
    );
    let all: usize = views.iter().map(|view| view.batch.len()).sum();
    assert_eq!((out.rows, out.counted_rows), (all, own.len()));
    // The rows that a collapse would show in are those of the first view.
    let features = rows_of(&out.features.unwrap());
    assert_eq!((features.len(), features[0].len()), (views[0].batch.len(), WIDTHS[0]));
}

#[test]
fn the_original_reconstructs_the_first_view_and_rounds_its_weights() {
    let only = || vec![terms()[2].clone(), terms()[4].clone()];
    let batch = batch();
    let run = |compat| {
        let module = module(only(), compat);
        let heads = module.untrained_heads().unwrap_or(module.params()).parameters();
        // The last layer gives zeros: what is left are the inputs.
        for name in ["heads.masked_gaussians.3.weight", "heads.masked_gaussians.3.bias"] {
            heads[name].set(&heads[name].zeros_like().unwrap()).unwrap();
        }
        in_step(|cx| {
            let masks = module.masks(&batch.views, cx).unwrap();
            let out = module.step_with_masks(&batch.views, &masks, cx).unwrap();
            // Another view, seed or step has other masks.
            let hidden =
                |masks: &[Option<Masked>], v: usize| masks[v].as_ref().unwrap().hidden.clone();
            let same = [batch.views[0].clone(), batch.views[0].clone()];
            let twins = module.masks(&same, cx).unwrap();
            assert!(twins[0] == masks[0] && hidden(&twins, 0) != hidden(&twins, 1));
            cx.seed += 1;
            assert_ne!(hidden(&module.masks(&batch.views, cx).unwrap(), 0), hidden(&masks, 0));
            (masks, term(&out, "masked_gaussians"))
        })
    };
    for compat in [Compat::None, Compat::Original] {
        let (masks, got) = run(compat);
        let views = if compat == Compat::Original { 1 } else { 2 };
        let (mut sum, mut count, mut rounded) = (0.0, 0.0, true);
        for (view, mask) in batch.views.iter().zip(&masks).take(views) {
            let mask = mask.as_ref().unwrap();
            rounded &= mask.weights.iter().all(|w| f16::from_f64(*w).to_f64() == *w);
            for row in (0..mask.hidden.len()).filter(|row| mask.hidden[*row]) {
                sum +=
                    view.batch.feat[row * 11..][..11].iter().map(|v| f64::from(v * v)).sum::<f64>();
                count += 11.0;
            }
        }
        assert!(
            (got - sum / count).abs() < 1e-5 * got,
            "{compat:?}: {got}, by hand {}",
            sum / count
        );
        assert_eq!(rounded, compat == Compat::Original);
    }
}
