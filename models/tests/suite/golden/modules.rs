//! Group e: attention, block, embedding, pooling, unpooling with their gradients.

use crate::support::devices::here;
use crate::support::{Tensors, rng};
use candle_core::{Tensor, Var};
use scenesplat_kernels::segment::{Groups, Reduce, reduce};
use scenesplat_kernels::serialization::Curve;
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use scenesplat_models::layers::NormKind;
use scenesplat_models::point_transformer_v3::{
    BatchRule, Block, BlockShape, Embedding, SerializedAttention, SerializedPooling,
    SerializedUnpooling,
};
use scenesplat_models::{Compute, Forward, ParamStore, weights::WeightSource};
use scenesplat_test_support::Golden;
use std::sync::Arc;

fn cloud(g: &Golden) -> SerializedCloud {
    let cloud = SerializedCloud::new(
        g.cells("in.grid_coord"),
        g.offsets("in.offset"),
        &Curve::ALL,
        CurveDepth::WholeBatch,
    )
    .unwrap();
    if g.has("in.serialized_order") {
        let orders: Vec<u32> = (0..4).flat_map(|i| cloud.order(i).order.to_vec()).collect();
        g.compare_ints("in.serialized_order", &orders);
    }
    cloud
}

/// A case, and its weights.
fn open(case: &str) -> Option<(Golden, ParamStore)> {
    let g = Golden::network(case)?;
    let weights = Golden::network(&format!("{case}.weights"))?.weights();
    Some((g, ParamStore::trainable_from(WeightSource::tensors(weights), 0).on(&here())))
}

fn var(g: &Golden, name: &str) -> Var {
    Var::from_tensor(&g.tensor(name)).unwrap()
}

/// Compares the output, then the gradients of ⟨out, R⟩ for inputs and all parameters.
fn check(g: &Golden, store: &ParamStore, inputs: &[(&str, &Var)], out: &Tensor) {
    let report = store.report();
    assert!(report.is_complete(), "{}: {report}", g.file());
    g.compare_tensor("out.feat", out);
    let grads = (out * g.tensor("in.R")).unwrap().sum_all().unwrap().backward().unwrap();
    let parameters = store.parameters();
    let stored = g.names("grad.").len();
    assert_eq!(stored, parameters.len() + inputs.len(), "{}: gradients", g.file());
    let parameters = parameters.iter().map(|(name, var)| (name.as_str(), var));
    for (name, var) in parameters.chain(inputs.iter().copied()) {
        g.compare_tensor(&format!("grad.{name}"), grads.get(var).unwrap());
    }
}

#[test]
pub fn attention() {
    for case in ["single", "small_cloud", "exact", "multi", "multi_flash", "multi_noflash"] {
        let Some((g, store)) = open(&format!("e_attn_{case}")) else { return };
        let cloud = cloud(&g);
        // The original without flash attention cuts all scenes by the smallest one.
        let flash = g.config()["flash"].as_bool().unwrap_or(false);
        let rule = if flash { BatchRule::SharedDepth } else { BatchRule::SharedDepthAndPatch };
        let module = SerializedAttention::new(
            g.number("channels"),
            g.number("num_heads"),
            g.number("patch_size"),
            g.number("order_index"),
            rule,
            Compute::default(),
            store.builder(),
        )
        .unwrap();
        let x = var(&g, "in.feat");
        let out = module.forward(x.as_tensor().clone(), &cloud, None).unwrap();
        check(&g, &store, &[("in.feat", &x)], &out);
    }
}

#[test]
pub fn block() {
    for case in ["e_block", "e_block_multi", "e_block_stale_sparse"] {
        let Some((g, store)) = open(case) else { return };
        let cloud = cloud(&g);
        let shape = BlockShape {
            channels: g.number("channels"),
            num_heads: g.number("num_heads"),
            patch_size: g.number("patch_size"),
            mlp_ratio: 4,
            drop_path: 0.0,
            order: g.number("order_index"),
            batch_rule: BatchRule::SharedDepthAndPatch,
            compute: Compute::default(),
        };
        let module = Block::new(shape, store.builder()).unwrap();
        let x = var(&g, "in.feat");
        let stale = g.has("in.sparse_feat").then(|| var(&g, "in.sparse_feat"));
        let mut rng = rng(0);
        let out = module
            .forward(
                x.as_tensor().clone(),
                stale.as_ref().map(|s| s.as_tensor().clone()),
                &cloud,
                &mut Forward::eval(&mut rng),
            )
            .unwrap();
        let mut inputs = vec![("in.feat", &x)];
        inputs.extend(stale.as_ref().map(|s| ("in.sparse_feat", s)));
        check(&g, &store, &inputs, &out);
    }
}

#[test]
pub fn embedding() {
    let Some((g, store)) = open("e_embedding") else { return };
    let cloud = cloud(&g);
    let module = Embedding::convolution(
        g.number("in_channels"),
        g.number("embed_channels"),
        Compute::default(),
        store.builder(),
    )
    .unwrap();
    let x = var(&g, "in.feat");
    let mut rng = rng(0);
    let out = module.forward(x.as_tensor(), &cloud, &Forward::eval(&mut rng)).unwrap();
    check(&g, &store, &[("in.feat", &x)], &out);
}

#[test]
pub fn pooling() {
    for case in ["e_pooling_mean", "e_pooling_max", "e_pooling_stride4"] {
        let Some((g, store)) = open(case) else { return };
        let cloud = cloud(&g);
        let how = if g.config()["reduce"] == "max" { Reduce::Max } else { Reduce::Mean };
        let module = SerializedPooling::new(
            g.number("in_channels"),
            g.number("out_channels"),
            g.number("stride"),
            how,
            NormKind::Batch,
            Compute::default(),
            store.builder(),
        )
        .unwrap();
        let x = var(&g, "in.feat");
        let mut rng = rng(0);
        let (out, coarse, groups) =
            module.forward(x.as_tensor(), &cloud, &Forward::eval(&mut rng)).unwrap();
        check(&g, &store, &[("in.feat", &x)], &out);
        g.compare_ints("out.pooling_inverse", groups.inverse());
        g.compare_ints("out.batch", &coarse.scene_of_rows());
        g.compare_ints("out.serialized_depth", &coarse.depth()[..1]);
        let cells: Vec<i32> = coarse.grid_coord().iter().flatten().copied().collect();
        g.compare_ints("out.grid_coord", &cells);
        let orders: Vec<u32> = (0..4).flat_map(|i| coarse.order(i).order.to_vec()).collect();
        g.compare_ints("out.serialized_order", &orders);
        // Positions (2 cm voxels there) are averaged like any rows.
        let coord: Vec<f32> =
            cloud.grid_coord().iter().flatten().map(|v| *v as f32 * 0.02).collect();
        let mut mean = vec![0.0; coarse.len() * 3];
        reduce(&coord, 3, &groups, Reduce::Mean, &mut mean);
        g.compare("out.coord", &mean);
    }
}

#[test]
pub fn unpooling() {
    let Some((g, store)) = open("e_unpooling") else { return };
    let module = SerializedUnpooling::new(
        g.number("in_channels"),
        g.number("skip_channels"),
        g.number("out_channels"),
        NormKind::Batch,
        Compute::default(),
        store.builder(),
    )
    .unwrap();
    let inverse: Vec<u32> = g.ints("in.pooling_inverse");
    let mut rows: Vec<u32> = (0..inverse.len() as u32).collect();
    rows.sort_by_key(|r| inverse[*r as usize]);
    let below = |group: usize| inverse.iter().filter(|&&g| (g as usize) < group).count() as u32;
    let offsets = (0..=g.shape("in.low_feat")[0]).map(below).collect();
    let groups = Groups::new(rows, offsets).unwrap();
    assert_eq!(groups.inverse(), inverse);
    let groups = Arc::new(groups);
    let fine = var(&g, "in.feat");
    let coarse = var(&g, "in.low_feat");
    let mut rng = rng(0);
    let out = module
        .forward(coarse.as_tensor(), fine.as_tensor(), groups, &Forward::eval(&mut rng))
        .unwrap();
    g.compare_tensor("out.sparse_feat", &out.skip);
    check(&g, &store, &[("in.feat", &fine), ("in.low_feat", &coarse)], &out.sum);
}
