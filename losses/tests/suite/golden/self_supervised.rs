//! Losses of self-supervision.

use super::{check, tensor, var};
use candle_core::Tensor;
use scenesplat_losses::self_supervised::{
    AttributeColumns, Expansion, GaussianDistance, SimDino, masked_cosine, masked_cross_entropy,
    masked_gaussians, sim_dino, view_cross_entropy,
};
use scenesplat_models::self_supervised_heads::{
    ProjectionHead, ProjectionShape, ReconstructionHead,
};
use scenesplat_models::weights::WeightSource;
use scenesplat_models::{Compute, ParamStore};
use scenesplat_test_support::Golden;

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
    let Some(g) = Golden::network("h_simdino_pool_head") else { return };
    let head = projection(&g, 304);
    let global = var(&g, "in.student_global");
    let local = var(&g, "in.local");
    let views_first = |t: &Tensor| t.transpose(0, 1).unwrap().contiguous().unwrap();
    let student = Tensor::cat(&[&views_first(&global), local.as_tensor()], 0).unwrap();
    let teacher = through(&head, &views_first(&tensor(&g, "in.teacher_global")));
    let out = sim_dino(&through(&head, &student), &teacher, &SimDino::default()).unwrap().unwrap();
    g.compare("out.comp_loss", &[out.compression]);
    g.compare("out.expa_loss", &[out.expansion]);
    check(&g, &out.loss, &[("student_global", &global), ("local", &local)]);
}

#[test]
fn ibot_of_decoder_features() {
    let Some(g) = Golden::network("h_ibot_patch_head") else { return };
    let head = projection(&g, 310);
    let [s0, s1] = ["in.s0", "in.s1"].map(|name| var(&g, name));
    let both = |a: &Tensor, b: &Tensor| head.forward(&Tensor::cat(&[a, b], 0).unwrap()).unwrap();
    let teacher = both(&tensor(&g, "in.t0"), &tensor(&g, "in.t1"));
    let weights = [g.f64s("in.w0"), g.f64s("in.w1")].concat();
    let loss = masked_cosine(&both(&s0, &s1), &teacher, &weights).unwrap().unwrap();
    check(&g, &loss, &[("s0", &s0), ("s1", &s1)]);
}

#[test]
fn masked_modelling_with_its_head() {
    let Some(g) = Golden::network("h_mgm_mae") else { return };
    let store = ParamStore::trainable_from(WeightSource::hashed(306, ""), 0);
    let head = ReconstructionHead::new(24, 11, Compute::EXACT, &store.builder()).unwrap();
    let feat = var(&g, "in.feat");
    let pred = head.forward(&feat).unwrap();
    super::compare(&g, "out.pred", &pred);
    let distance = GaussianDistance::MeanSquare;
    let (loss, _) =
        masked_gaussians(&pred, &tensor(&g, "in.target"), None, &attributes(), distance)
            .unwrap()
            .unwrap();
    check(&g, &loss, &[("feat", &feat)]);
    // Heads are trained here: each parameter has a gradient.
    let grads = loss.backward().unwrap();
    assert!(store.parameters().iter().all(|(_, var)| grads.get(var).is_some()));
}

#[test]
fn simdino() {
    for case in ["basic", "expa0", "B1", "identical", "zeros", "huge", "unnormalized_flag"] {
        let Some(g) = Golden::network(&format!("h_simdino_{case}")) else { return };
        let number = |key: &str| g.config()[key].as_f64().unwrap();
        let student_alone = number("expa_type") == 0.0;
        let settings = SimDino {
            coefficient: number("coeff"),
            epsilon: number("eps"),
            expansion: if student_alone { Expansion::Student } else { Expansion::default() },
            normalized: g.config()["normalized"].as_bool().unwrap(),
        };
        let student = var(&g, "in.student");
        let out = sim_dino(&student, &tensor(&g, "in.teacher"), &settings).unwrap().unwrap();
        g.compare("out.comp_loss", &[out.compression]);
        g.compare("out.global_comp_loss", &[out.global_compression]);
        if case == "huge" {
            // NaN there: its factorisation is f32. The value is that of numpy in f64, on the smaller side.
            assert!(g.f64s("out.loss")[0].is_nan());
            assert!((out.expansion - 12.857_869_377_878_895).abs() < 1e-9, "{}", out.expansion);
            continue;
        }
        g.compare("out.expa_loss", &[out.expansion]);
        check(&g, &out.loss, &[("student", &student)]);
    }
}

#[test]
fn ibot_cosine() {
    for case in ["basic", "identical", "zeros", "huge"] {
        let Some(g) = Golden::network(&format!("h_ibot_cos_{case}")) else { return };
        let student = var(&g, "in.student");
        let loss = masked_cosine(&student, &tensor(&g, "in.teacher"), &g.f64s("in.weight"))
            .unwrap()
            .unwrap();
        check(&g, &loss, &[("student", &student)]);
    }
}

#[test]
fn ibot_cross_entropy() {
    let Some(g) = Golden::network("h_ibot_ce") else { return };
    let student = var(&g, "in.student");
    let loss = masked_cross_entropy(&student, &tensor(&g, "in.teacher"), &g.f64s("in.weight"), 0.1);
    check(&g, &loss.unwrap().unwrap(), &[("student", &student)]);
}

#[test]
fn dino_cross_entropy() {
    let Some(g) = Golden::network("h_dino_ce") else { return };
    let student = var(&g, "in.student");
    let loss = view_cross_entropy(&student, &tensor(&g, "in.teacher"), 0.1, true).unwrap().unwrap();
    check(&g, &loss, &[("student", &student)]);
}

#[test]
fn masked_modelling() {
    for case in ["mse", "mse_identical", "mse_huge"] {
        let Some(g) = Golden::network(&format!("h_mgm_{case}")) else { return };
        let pred = var(&g, "in.pred");
        let target = tensor(&g, "in.target");
        let distance = GaussianDistance::MeanSquare;
        let (loss, _) =
            masked_gaussians(&pred, &target, None, &attributes(), distance).unwrap().unwrap();
        check(&g, &loss, &[("pred", &pred)]);
    }
}
