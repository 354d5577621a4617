//! Losses of self-supervision.

use crate::support::Golden;
use candle_core::{DType, Tensor, Var};
use scenesplat_losses::self_supervised::{
    AttributeColumns, Expansion, GaussianDistance, SimDino, masked_cosine, masked_cross_entropy,
    masked_gaussians, sim_dino, view_cross_entropy,
};
use scenesplat_models::self_supervised_heads::{
    ProjectionHead, ProjectionShape, ReconstructionHead,
};
use scenesplat_models::weights::WeightSource;
use scenesplat_models::{Compute, ParamStore};

fn weights(g: &Golden, name: &str) -> Vec<f64> {
    g.floats(name).iter().map(|w| f64::from(*w)).collect()
}

fn attributes() -> [AttributeColumns; 4] {
    let of = |name: &str, columns, is_rotation| AttributeColumns {
        name: name.to_owned(),
        columns,
        is_rotation,
        is_size: name == "scale",
    };
    [
        of("color", 0..3, false),
        of("opacity", 3..4, false),
        of("quat", 4..8, true),
        of("scale", 8..11, false),
    ]
}

/// A head with the weights that the original was run with.
fn projection(g: &Golden, seed: u64) -> ProjectionHead {
    let width = |key: &str| g.config()["head"][key].as_u64().unwrap() as usize;
    let shape =
        ProjectionShape { channels: width("in_dim"), hidden: width("hidden"), out: width("out") };
    let store = ParamStore::trainable_from(WeightSource::hashed(seed, ""), 0);
    ProjectionHead::new(shape, Compute::EXACT, &store.builder()).unwrap()
}

/// Views as they are pooled, `[.., .., C]`, through a head.
fn through(head: &ProjectionHead, views: &Tensor) -> Tensor {
    let (a, b, c) = views.dims3().unwrap();
    let out = head.forward(&views.reshape((a * b, c)).unwrap()).unwrap();
    out.reshape((a, b, out.dim(1).unwrap())).unwrap()
}

#[test]
fn simdino_of_pooled_features() {
    let Some(g) = Golden::open("h_simdino_pool_head.safetensors") else { return };
    let head = projection(&g, 304);
    let global = Var::from_tensor(&g.tensor("in.student_global")).unwrap();
    let local = Var::from_tensor(&g.tensor("in.local")).unwrap();
    let views_first = |t: &Tensor| t.transpose(0, 1).unwrap().contiguous().unwrap();
    let student = Tensor::cat(&[&views_first(&global), local.as_tensor()], 0).unwrap();
    let teacher = through(&head, &views_first(&g.tensor("in.teacher_global")));
    let out = sim_dino(&through(&head, &student), &teacher, &SimDino::default()).unwrap().unwrap();
    g.compare("out.comp_loss", &[out.compression as f32]);
    g.compare("out.expa_loss", &[out.expansion as f32]);
    g.compare("out.loss", &[out.loss.to_scalar().unwrap()]);
    let grads = out.loss.backward().unwrap();
    g.compare_tensor("grad.student_global", grads.get(&global).unwrap());
    g.compare_tensor("grad.local", grads.get(&local).unwrap());
}

#[test]
fn ibot_of_decoder_features() {
    let Some(g) = Golden::open("h_ibot_patch_head.safetensors") else { return };
    let head = projection(&g, 310);
    let [s0, s1] = ["in.s0", "in.s1"].map(|name| Var::from_tensor(&g.tensor(name)).unwrap());
    let both = |a: &Tensor, b: &Tensor| head.forward(&Tensor::cat(&[a, b], 0).unwrap()).unwrap();
    let teacher = both(&g.tensor("in.t0"), &g.tensor("in.t1"));
    let weights = [weights(&g, "in.w0"), weights(&g, "in.w1")].concat();
    let loss = masked_cosine(&both(&s0, &s1), &teacher, &weights).unwrap().unwrap();
    g.compare("out.loss", &[loss.to_scalar().unwrap()]);
    let grads = loss.backward().unwrap();
    g.compare_tensor("grad.s0", grads.get(&s0).unwrap());
    g.compare_tensor("grad.s1", grads.get(&s1).unwrap());
}

#[test]
fn masked_modelling_with_its_head() {
    let Some(g) = Golden::open("h_mgm_mae.safetensors") else { return };
    let store = ParamStore::trainable_from(WeightSource::hashed(306, ""), 0);
    let head = ReconstructionHead::new(24, 11, Compute::EXACT, &store.builder()).unwrap();
    let feat = Var::from_tensor(&g.tensor("in.feat")).unwrap();
    let pred = head.forward(&feat).unwrap();
    g.compare_tensor("out.pred", &pred);
    let distance = GaussianDistance::MeanSquare;
    let (loss, _) = masked_gaussians(&pred, &g.tensor("in.target"), None, &attributes(), distance)
        .unwrap()
        .unwrap();
    check(&g, "feat", &feat, &loss);
    // Heads are trained here: each parameter has a gradient.
    let grads = loss.backward().unwrap();
    assert!(store.parameters().iter().all(|(_, var)| grads.get(var).is_some()));
}

fn check(g: &Golden, of: &str, var: &Var, loss: &Tensor) {
    g.compare("out.loss", &[loss.to_scalar().unwrap()]);
    g.compare_tensor(&format!("grad.{of}"), loss.backward().unwrap().get(var).unwrap());
}

#[test]
fn simdino() {
    for case in ["basic", "expa0", "B1", "identical", "zeros", "huge", "unnormalized_flag"] {
        let Some(g) = Golden::open(&format!("h_simdino_{case}.safetensors")) else { return };
        let number = |key: &str| g.config()[key].as_f64().unwrap();
        let student_alone = number("expa_type") == 0.0;
        let settings = SimDino {
            coefficient: number("coeff"),
            epsilon: number("eps"),
            expansion: if student_alone { Expansion::Student } else { Expansion::default() },
            normalized: g.config()["normalized"].as_bool().unwrap(),
        };
        let student = Var::from_tensor(&g.tensor("in.student")).unwrap();
        let out = sim_dino(&student, &g.tensor("in.teacher"), &settings).unwrap().unwrap();
        g.compare("out.comp_loss", &[out.compression as f32]);
        g.compare("out.global_comp_loss", &[out.global_compression as f32]);
        if case == "huge" {
            // NaN there: its factorisation is f32. The value is that of numpy in f64, on the smaller side.
            assert!(g.floats("out.loss")[0].is_nan());
            assert!((out.expansion - 12.857_869_377_878_895).abs() < 1e-9, "{}", out.expansion);
            continue;
        }
        g.compare("out.expa_loss", &[out.expansion as f32]);
        check(&g, "student", &student, &out.loss);
    }
}

#[test]
fn ibot_cosine() {
    for case in ["basic", "identical", "zeros", "huge"] {
        let Some(g) = Golden::open(&format!("h_ibot_cos_{case}.safetensors")) else { return };
        let student = Var::from_tensor(&g.tensor("in.student")).unwrap();
        let loss = masked_cosine(&student, &g.tensor("in.teacher"), &weights(&g, "in.weight"))
            .unwrap()
            .unwrap();
        check(&g, "student", &student, &loss);
    }
}

#[test]
fn ibot_cross_entropy() {
    let Some(g) = Golden::open("h_ibot_ce.safetensors") else { return };
    let student = Var::from_tensor(&g.tensor("in.student")).unwrap();
    let loss =
        masked_cross_entropy(&student, &g.tensor("in.teacher"), &weights(&g, "in.weight"), 0.1);
    check(&g, "student", &student, &loss.unwrap().unwrap());
}

#[test]
fn dino_cross_entropy() {
    let Some(g) = Golden::open("h_dino_ce.safetensors") else { return };
    let student = Var::from_tensor(&g.tensor("in.student")).unwrap();
    let loss = view_cross_entropy(&student, &g.tensor("in.teacher"), 0.1, true).unwrap().unwrap();
    check(&g, "student", &student, &loss);
}

#[test]
fn masked_modelling() {
    for case in ["mse", "mse_identical", "mse_huge"] {
        let Some(g) = Golden::open(&format!("h_mgm_{case}.safetensors")) else { return };
        let pred = Var::from_tensor(&g.tensor("in.pred")).unwrap();
        let target = g.tensor("in.target").to_dtype(DType::F32).unwrap();
        let distance = GaussianDistance::MeanSquare;
        let (loss, _) =
            masked_gaussians(&pred, &target, None, &attributes(), distance).unwrap().unwrap();
        check(&g, "pred", &pred, &loss);
    }
}
