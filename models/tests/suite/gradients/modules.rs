//! Modules of the network, with all their parameters.

use super::check::{
    F32_EPS, Statistics, Values, check_normed, check_part, cloud, flat, store, var,
};
use super::layers::drop_factors;
use super::slow;
use crate::support::{frozen, observed, rng};
use candle_core::Tensor;
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::segment::Reduce;
use scenesplat_kernels::serialization::Curve;
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use scenesplat_models::layers::NormKind;
use scenesplat_models::point_transformer_v3::{
    BatchRule, Block, BlockShape, Embedding, SerializedAttention, SerializedPooling,
    SerializedUnpooling,
};
use scenesplat_models::{
    Compute, Forward, Mode, PointCloud, PointTransformerV3, PointTransformerV3Config,
};
use std::collections::BTreeMap;
use std::sync::Arc;

const CHANNELS: usize = 6;
const HEADS: usize = 2;
const PATCH: usize = 7;
const ORDER: usize = 2;

fn attention(v: &Values, x: &[f64], cloud: &SerializedCloud, prefix: &str) -> Vec<f64> {
    let named = |name: &str| &v[&format!("{prefix}{name}")];
    let qkv = slow::linear(x, CHANNELS, named("qkv.weight"), Some(named("qkv.bias")));
    let heads = Heads { count: HEADS, dim: CHANNELS / HEADS };
    let order = &cloud.order(ORDER).order;
    let attended = slow::attention(&qkv, heads, &cloud.patches(PATCH), order);
    slow::linear(&attended, CHANNELS, named("proj.weight"), Some(named("proj.bias")))
}

#[test]
pub fn serialized_attention() {
    let (cloud, store) = (cloud(), store());
    let module = SerializedAttention::new(
        CHANNELS,
        HEADS,
        PATCH,
        ORDER,
        BatchRule::SharedDepth,
        Compute::default(),
        store.builder(),
    )
    .unwrap();
    let n = cloud.len();
    let (x, r) = (var("x", &[n, CHANNELS]), var("r", &[n, CHANNELS]));
    let out = module.forward(x.as_tensor().clone(), &cloud, Some(&r)).unwrap();
    // A key's bias moves all logits of a query alike: its third of the gradient is zero, and small
    // beside the rest.
    check_part("attention", F32_EPS, &store, &[("x", &x), ("r", &r)], &out, |v| {
        slow::add(&attention(v, &v["x"], &cloud, ""), &v["r"])
    });
}

/// A block by its formula; `factors` are those of the two branches.
fn block(v: &Values, cloud: &SerializedCloud, factors: &[Vec<f64>; 2]) -> Vec<f64> {
    let linear = |x: &[f64], name: &str| {
        let (w, b) = (&v[&format!("{name}.weight")], &v[&format!("{name}.bias")]);
        slow::linear(x, w.len() / b.len(), w, Some(b))
    };
    let norm = |x: &[f64], name: &str| {
        slow::layer_norm(x, &v[&format!("{name}.weight")], &v[&format!("{name}.bias")])
    };
    let x = &v["x"];
    let conv_input = v.get("conv_input").unwrap_or(x);
    let y = slow::conv(conv_input, CHANNELS, &v["cpe.0.weight"], Some(&v["cpe.0.bias"]), cloud, 3);
    let x = slow::add(&norm(&linear(&y, "cpe.1"), "cpe.2"), x);
    let branch = attention(v, &norm(&x, "norm1.0"), cloud, "attn.");
    let x = slow::add_scaled(&branch, &factors[0], &x);
    let hidden = slow::gelu(&linear(&norm(&x, "norm2.0"), "mlp.0.fc1"));
    slow::add_scaled(&linear(&hidden, "mlp.0.fc2"), &factors[1], &x)
}

#[test]
pub fn blocks() {
    for (case, mode, drop_path, stale) in [
        ("block", Mode::Eval, 0.3, false),
        ("block, convolution of other rows", Mode::Train, 0.0, true),
        ("block with drop path", Mode::Train, 0.3, false),
    ] {
        let (cloud, store) = (cloud(), store());
        let shape = BlockShape {
            channels: CHANNELS,
            num_heads: HEADS,
            patch_size: PATCH,
            mlp_ratio: 2,
            drop_path,
            order: ORDER,
            batch_rule: BatchRule::SharedDepth,
            compute: Compute::default(),
        };
        let module = Block::new(shape, store.builder()).unwrap();
        let n = cloud.len();
        let (x, other) = (var("x", &[n, CHANNELS]), var("conv_input", &[n, CHANNELS]));
        let factors = match mode {
            Mode::Train => {
                let mut rng = rng(4);
                [(); 2].map(|()| drop_factors(drop_path, n, &mut rng))
            }
            Mode::Eval => [vec![1.0; n], vec![1.0; n]],
        };
        let mut rng = rng(4);
        let mut cx = Forward { mode, ..Forward::eval(&mut rng) };
        let conv_input = stale.then(|| other.as_tensor().clone());
        let out = module.forward(x.as_tensor().clone(), conv_input, &cloud, &mut cx).unwrap();
        let mut inputs = vec![("x", &x)];
        if stale {
            inputs.push(("conv_input", &other));
        }
        check_part(case, F32_EPS, &store, &inputs, &out, |v| block(v, &cloud, &factors));
    }
}

#[test]
pub fn embedding() {
    for mode in [Mode::Train, Mode::Eval] {
        let (cloud, store) = (cloud(), store());
        let module = Embedding::convolution(2, 4, Compute::default(), store.builder()).unwrap();
        let given = Statistics::of(&store, "stem.norm.", mode);
        let x = var("x", &[cloud.len(), 2]);
        let mut rng = rng(4);
        let cx = Forward { mode, ..Forward::eval(&mut rng) };
        let out = module.forward(&x, &cloud, &cx).unwrap();
        check_part(&format!("embedding {mode:?}"), F32_EPS, &store, &[("x", &x)], &out, |v| {
            let y = slow::conv(&v["x"], 2, &v["stem.conv.weight"], None, &cloud, 5);
            let y = slow::batch_norm(&y, &v["stem.norm.weight"], &v["stem.norm.bias"], given.get());
            slow::gelu(&y)
        });
    }
}

#[test]
pub fn pooling() {
    for mode in [Mode::Train, Mode::Eval] {
        for (how, stride) in [(Reduce::Mean, 2), (Reduce::Max, 2), (Reduce::Mean, 4)] {
            let (cloud, store) = (cloud(), store());
            let module = SerializedPooling::new(
                3,
                5,
                stride,
                how,
                NormKind::Batch,
                Compute::default(),
                store.builder(),
            )
            .unwrap();
            let given = Statistics::of(&store, "norm.0.", mode);
            let x = var("x", &[cloud.len(), 3]);
            let mut rng = rng(4);
            let cx = Forward { mode, ..Forward::eval(&mut rng) };
            let (out, _, groups) = module.forward(&x, &cloud, &cx).unwrap();
            let case = format!("pooling {how:?} {stride} {mode:?}");
            let fixed: &[&str] = if mode == Mode::Train { &["proj.bias"] } else { &[] };
            check_normed(&case, &store, fixed, &[("x", &x)], &out, |v| {
                let y = slow::linear(&v["x"], 3, &v["proj.weight"], Some(&v["proj.bias"]));
                let y = slow::reduce(&y, 5, &groups, how);
                let y = slow::batch_norm(&y, &v["norm.0.weight"], &v["norm.0.bias"], given.get());
                slow::gelu(&y)
            });
        }
    }
}

#[test]
pub fn unpooling() {
    for mode in [Mode::Train, Mode::Eval] {
        let (cloud, store) = (cloud(), store());
        let (_, groups) = cloud.pool(1);
        let groups = Arc::new(groups);
        let module =
            SerializedUnpooling::new(4, 3, 5, NormKind::Batch, Compute::default(), store.builder())
                .unwrap();
        let statistics = ["proj.1.", "proj_skip.1."].map(|norm| Statistics::of(&store, norm, mode));
        let (coarse, fine) = (var("coarse", &[groups.len(), 4]), var("fine", &[cloud.len(), 3]));
        let mut rng = rng(4);
        let cx = Forward { mode, ..Forward::eval(&mut rng) };
        let out = module.forward(&coarse, &fine, groups.clone(), &cx).unwrap();
        let branch = |v: &Values, x: &[f64], name: &str, which: usize| {
            let named = |what: &str| &v[&format!("{name}.{what}")];
            let k = named("0.weight").len() / named("0.bias").len();
            let y = slow::linear(x, k, named("0.weight"), Some(named("0.bias")));
            let given = statistics[which].get();
            slow::gelu(&slow::batch_norm(&y, named("1.weight"), named("1.bias"), given))
        };
        let fixed: &[&str] =
            if mode == Mode::Train { &["proj.0.bias", "proj_skip.0.bias"] } else { &[] };
        let inputs = [("coarse", &coarse), ("fine", &fine)];
        check_normed(&format!("unpooling {mode:?}"), &store, fixed, &inputs, &out.sum, |v| {
            let up = slow::gather(&branch(v, &v["coarse"], "proj", 0), 5, groups.inverse());
            slow::add(&branch(v, &v["fine"], "proj_skip", 1), &up)
        });
    }
}

/// Of each stage, not only of a block that is handed its rows: weights were trained with it.
#[test]
fn decoder_stages_begin_with_the_skip_branch() {
    let config = PointTransformerV3Config {
        in_channels: 2,
        mlp_ratio: 2,
        ..PointTransformerV3Config::language()
    }
    .with_stages(
        &[[1, 4, 2], [1, 6, 2], [1, 8, 2]],
        &[[2, CHANNELS, HEADS], [1, 4, HEADS]],
        PATCH,
    );
    let network = frozen(|vb| PointTransformerV3::new(&config, vb));
    // In the order in which the network holds them, so that what it shows needs no rearranging.
    let mut cells: Vec<[i32; 3]> = (0..60).map(|i| [i % 5, i / 5 % 4, i / 20]).collect();
    cells.sort_by_key(|c| Curve::Z.code(c.map(|v| v as u32), 3));
    let offsets = vec![0, cells.len()];
    let feat = var("x", &[cells.len(), 2]).as_detached_tensor();
    let points = PointCloud::new(cells.clone(), feat, offsets.clone()).unwrap();
    let seen: BTreeMap<String, Tensor> = observed(&network, &points).into_iter().collect();

    let shape = BlockShape {
        channels: CHANNELS,
        num_heads: HEADS,
        patch_size: PATCH,
        mlp_ratio: 2,
        drop_path: 0.0,
        order: 0,
        batch_rule: config.batch_rule,
        compute: Compute::default(),
    };
    let block = frozen(|vb| Block::new(shape, vb.pp("dec.dec0.block0")));
    let cloud = SerializedCloud::new(cells, offsets, &Curve::ALL, CurveDepth::PerScene).unwrap();
    let apply = |conv_input: Option<Tensor>| {
        let mut rng = rng(4);
        let (x, cx) = (seen["dec.dec0.up"].clone(), &mut Forward::eval(&mut rng));
        flat(&block.forward(x, conv_input, &cloud, cx).unwrap())
    };
    let shown = flat(&seen["dec.dec0.block0"]);
    assert_eq!(shown, apply(Some(seen["dec.dec0.up.skip"].clone())));
    // Another input makes a difference, so the equality says something.
    assert_ne!(shown, apply(None));
}
