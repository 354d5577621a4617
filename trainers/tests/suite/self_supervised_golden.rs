//! A whole step of the original's self-supervised training: losses, gradients of every parameter, batch
//! statistics.

use crate::support::values;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_datasets::{InputFeatures, Masked, TrainBatch, View, ViewKind};
use scenesplat_models::point_transformer_v3::{BatchRule, PoolingReduce};
use scenesplat_models::weights::hashed_parameter;
use scenesplat_models::{Forward, ModelConfig, Orders, ParamStore, PointTransformerV3Config};
use scenesplat_test_support::Golden;
use scenesplat_trainers::tasks::self_supervised::{
    Compat, IbotTerm, MaskedGaussiansTerm, SelfSupervised, SelfSupervisedConfig, SimDinoTerm,
    TermConfig,
};
use scenesplat_trainers::{StepContext, StepOutput, TrainingModule};

const TERMS: [(&str, &str); 3] = [
    ("heads.sim_dino", "dino_head"),
    ("heads.ibot", "ibot_head"),
    ("heads.masked_gaussians", "mae_head"),
];

/// The original's name of one of our parameters.
fn original(name: &str, half: &str) -> String {
    for (ours, theirs) in TERMS {
        if let Some(rest) = name.strip_prefix(ours) {
            return format!("{theirs}{rest}");
        }
    }
    format!("{half}.{name}")
}

fn model() -> ModelConfig {
    ModelConfig::new(
        PointTransformerV3Config {
            in_channels: 11,
            drop_path: 0.0,
            pooling: PoolingReduce::Max,
            mask_token: true,
            batch_rule: BatchRule::SharedDepthAndPatch,
            ..PointTransformerV3Config::language()
        }
        .with_stages(&[[1, 16, 2], [1, 32, 2], [2, 48, 4]], &[[1, 16, 2], [1, 32, 2]], 64),
    )
}

fn view(g: &Golden, name: &str, kind: ViewKind) -> View {
    let cells: Vec<i32> = g.ints(&format!("in.{name}_grid_coord"));
    let grid_coord: Vec<[i32; 3]> = cells.as_chunks().0.to_vec();
    let ends: Vec<usize> = g.ints(&format!("in.{name}_offset"));
    let origin: Vec<[f32; 3]> = grid_coord.iter().map(|c| c.map(|v| v as f32 * 0.02)).collect();
    let batch = TrainBatch {
        ids: (1..=ends.len()).map(|i| format!("scene-{i}")).collect(),
        coord: origin.clone(),
        grid_coord,
        feat: g.f32s(&format!("in.{name}_feat")),
        channels: 11,
        offsets: [vec![0], ends].concat(),
        ..TrainBatch::default()
    };
    let origin_row = (0..origin.len() as u32).collect();
    View { kind, batch, origin, origin_row }
}

fn masked(g: &Golden, i: usize) -> Masked {
    let hidden: Vec<bool> = g.f64s(&format!("in.mask{i}")).iter().map(|v| *v != 0.0).collect();
    let mut stored = g.f64s(&format!("in.mask_weight{i}")).into_iter();
    let weights = hidden.iter().map(|h| if *h { stored.next().unwrap() } else { 0.0 }).collect();
    assert!(stored.next().is_none());
    Masked { hidden, weights }
}

/// Student, teacher and heads with the parameters that the original was run with.
fn module(terms: Vec<TermConfig>, seed: u64) -> SelfSupervised {
    let config = SelfSupervisedConfig { compat: Compat::Original, terms, ..<_>::default() };
    let params = ParamStore::trainable(1);
    let module =
        SelfSupervised::new(&config, &model(), &InputFeatures::default(), params, 1).unwrap();
    for (store, half) in [
        (Some(module.params()), "backbone_student"),
        (module.untrained_heads(), ""),
        (module.teacher(), "backbone_teacher"),
    ] {
        for (name, var) in store.into_iter().flat_map(|s| [s.parameters(), s.buffers()]).flatten() {
            let value = hashed_parameter(&original(&name, half), var.dims(), seed).unwrap();
            var.set(&value).unwrap();
        }
    }
    module
}

fn step(g: &Golden, module: &SelfSupervised) -> StepOutput {
    let names = ["global_crop0", "global_crop1", "local_crop0", "local_crop1", "local_crop2"];
    let kind = |i| if i < 2 { ViewKind::Global } else { ViewKind::Local };
    let views: Vec<View> =
        names.iter().enumerate().map(|(i, name)| view(g, name, kind(i))).collect();
    let masks = [Some(masked(g, 0)), Some(masked(g, 1)), None, None, None];
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let forward = Forward { orders: Orders::Listed, ..Forward::train(&mut rng) };
    let mut cx = StepContext { forward, progress: 0.0, step: 0, total_steps: 10, seed: 0 };
    module.step_with_masks(&views, &masks, &mut cx).unwrap()
}

fn run(case: &str, terms: Vec<TermConfig>) {
    let Some(g) = Golden::network(case) else { return };
    let module = module(terms, g.number("seed") as u64);
    let out = step(&g, &module);
    g.compare("out.loss", &values(&out.loss));
    for (ours, theirs) in [
        ("sim_dino", "out.dino_mcr_loss"),
        ("sim_dino/compression", "out.dino_mcr_comp_loss"),
        ("sim_dino/global_compression", "out.dino_mcr_global_comp_loss"),
        ("ibot", "out.sim_ibot_patch_loss"),
        ("masked_gaussians", "out.global_mae_loss"),
    ] {
        let got = out.terms.iter().find(|(name, _)| name == ours);
        assert_eq!(got.is_some(), g.has(theirs), "{ours}");
        if let Some((_, value)) = got {
            // Compression is logged as a loss there, with the other sign.
            let want = g.f64s(theirs)[0];
            let sign = if ours.contains("compression") && want * value < 0.0 { -1.0 } else { 1.0 };
            g.compare(theirs, &[sign * value]);
        }
    }
    compare_gradients(&g, &module, &out);
    let halves =
        [(Some(module.params()), "backbone_student"), (module.teacher(), "backbone_teacher")];
    for (store, half) in halves {
        for (name, var) in store.into_iter().flat_map(ParamStore::buffers) {
            let key = format!("buf.{}", original(&name, half));
            if g.has(&key) {
                g.compare(&key, &values(var.as_tensor()));
            }
        }
    }
}

fn compare_gradients(g: &Golden, module: &SelfSupervised, out: &StepOutput) {
    // Of values that the manifest does not call unstable.
    let allowed = |name: &str| g.has(name).then(|| g.tolerance(name, 0.0)).flatten();
    let grads = out.loss.backward().unwrap();
    let stores = [Some(module.params()), module.untrained_heads()];
    let (mut compared, mut beyond) = (0, Vec::new());
    for (name, var) in stores.into_iter().flatten().flat_map(ParamStore::parameters) {
        let name = original(&name, "backbone_student");
        let grad = grads.get(&var).unwrap_or_else(|| panic!("{name}: no gradient"));
        let grad = values(grad);
        let norm = grad.iter().map(|v| v * v).sum::<f64>().sqrt();
        let (whole, short) = (format!("grad.{name}"), format!("gradnorm.{name}"));
        if allowed(&whole).is_some() {
            g.compare(&whole, &grad);
            compared += 1;
        }
        if let Some(own) = allowed(&short) {
            compared += 1;
            // A norm's tolerance is made of one difference, which may be small by chance. Norms differ by
            // no more than gradients do: where these are stored, they decide.
            let by_elements = allowed(&whole).unwrap_or(0.0) * (grad.len() as f64).sqrt();
            let off = (norm - g.f64s(&short)[0]).abs();
            if off > by_elements {
                g.compare(&short, &[norm]);
            } else if off > own {
                beyond.push(short);
            }
        }
    }
    let stored = g.names("grad").into_iter().filter(|name| allowed(name).is_some());
    assert_eq!(compared, stored.count(), "every stored gradient is compared");
    println!("norms beyond their own tolerance, not beyond that of their elements: {beyond:?}");
}

#[test]
fn simdino_ibot_and_masked_gaussians_together() {
    let terms = vec![
        TermConfig::SimDino(SimDinoTerm::default()),
        TermConfig::Ibot(IbotTerm::default()),
        TermConfig::MaskedGaussians(MaskedGaussiansTerm::default()),
    ];
    run("h_ssl_e2e", terms);
}

#[test]
fn masked_gaussians_alone() {
    run("h_maeonly_ssl_e2e", vec![TermConfig::MaskedGaussians(MaskedGaussiansTerm::default())]);
}
