//! Group e: attention, block, embedding, pooling, unpooling with their gradients.

use crate::support::Golden;
use crate::support_device::device;
use candle_core::backprop::GradStore;
use candle_core::{Tensor, Var};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scenesplat_kernels::segment::{Groups, Reduce, reduce};
use scenesplat_kernels::serialization::Curve;
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use scenesplat_models::point_transformer_v3::{
    BatchRule, Block, BlockShape, Embedding, SerializedAttention, SerializedPooling,
    SerializedUnpooling,
};
use scenesplat_models::{Compute, Forward, ParamStore, weights::WeightSource};
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

fn store(case: &str) -> ParamStore {
    let weights = Golden::open(&format!("{case}.weights.safetensors")).unwrap();
    ParamStore::trainable_from(WeightSource::tensors(weights.weights("")), 0).on(&device())
}

fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(0)
}

/// Compares the output, then the gradients of ⟨out, R⟩ for inputs and all parameters.
fn check(g: &Golden, store: &ParamStore, inputs: &[(&str, &Var)], out: &Tensor) {
    let report = store.report();
    assert!(report.is_complete(), "{}: {report}", g.file);
    g.compare_tensor("out.feat", out);
    let grads = (out * g.tensor("in.R")).unwrap().sum_all().unwrap().backward().unwrap();
    let gradient = |grads: &GradStore, v: &Var| grads.get(v).unwrap().clone();
    for (name, var) in inputs {
        g.compare_tensor(&format!("grad.{name}"), &gradient(&grads, var));
    }
    let parameters = store.parameters();
    let wanted = g.names("grad.");
    assert_eq!(wanted.len(), parameters.len() + inputs.len(), "{}: gradients", g.file);
    for (name, var) in parameters {
        g.compare_tensor(&format!("grad.{name}"), &gradient(&grads, &var));
    }
}

#[test]
pub fn attention() {
    for case in ["single", "small_cloud", "exact", "multi", "multi_flash", "multi_noflash"] {
        let case = format!("e_attn_{case}");
        let Some(g) = Golden::open(&format!("{case}.safetensors")) else { return };
        let cloud = cloud(&g);
        // The original without flash attention cuts all scenes by the smallest one.
        let flash = g.config()["flash"].as_bool().unwrap_or(false);
        let rule = if flash { BatchRule::SharedDepth } else { BatchRule::SharedDepthAndPatch };
        let store = store(&case);
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
        let x = Var::from_tensor(&g.tensor("in.feat")).unwrap();
        let out = module.forward(x.as_tensor().clone(), &cloud, None).unwrap();
        check(&g, &store, &[("in.feat", &x)], &out);
    }
}

#[test]
pub fn block() {
    for case in ["e_block", "e_block_multi", "e_block_stale_sparse"] {
        let Some(g) = Golden::open(&format!("{case}.safetensors")) else { return };
        let cloud = cloud(&g);
        let store = store(case);
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
        let x = Var::from_tensor(&g.tensor("in.feat")).unwrap();
        let stale =
            g.has("in.sparse_feat").then(|| Var::from_tensor(&g.tensor("in.sparse_feat")).unwrap());
        let mut rng = rng();
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
    let Some(g) = Golden::open("e_embedding.safetensors") else { return };
    let cloud = cloud(&g);
    let store = store("e_embedding");
    let module = Embedding::new(
        g.number("in_channels"),
        g.number("embed_channels"),
        Compute::default(),
        store.builder(),
    )
    .unwrap();
    let x = Var::from_tensor(&g.tensor("in.feat")).unwrap();
    let mut rng = rng();
    let out = module.forward(x.as_tensor(), &cloud, &Forward::eval(&mut rng)).unwrap();
    check(&g, &store, &[("in.feat", &x)], &out);
}

#[test]
pub fn pooling() {
    for case in ["e_pooling_mean", "e_pooling_max", "e_pooling_stride4"] {
        let Some(g) = Golden::open(&format!("{case}.safetensors")) else { return };
        let cloud = cloud(&g);
        let store = store(case);
        let how = if g.config()["reduce"] == "max" { Reduce::Max } else { Reduce::Mean };
        let module = SerializedPooling::new(
            g.number("in_channels"),
            g.number("out_channels"),
            g.number("stride"),
            how,
            Compute::default(),
            store.builder(),
        )
        .unwrap();
        let x = Var::from_tensor(&g.tensor("in.feat")).unwrap();
        let mut rng = rng();
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
    let Some(g) = Golden::open("e_unpooling.safetensors") else { return };
    let store = store("e_unpooling");
    let module = SerializedUnpooling::new(
        g.number("in_channels"),
        g.number("skip_channels"),
        g.number("out_channels"),
        Compute::default(),
        store.builder(),
    )
    .unwrap();
    let inverse: Vec<u32> = g.ints("in.pooling_inverse").iter().map(|v| *v as u32).collect();
    let mut rows: Vec<u32> = (0..inverse.len() as u32).collect();
    rows.sort_by_key(|r| inverse[*r as usize]);
    let count = g.shape("in.low_feat")[0];
    let mut offsets = vec![0u32; count + 1];
    for i in &inverse {
        offsets[*i as usize + 1] += 1;
    }
    for i in 0..count {
        offsets[i + 1] += offsets[i];
    }
    let groups = Groups::new(rows, offsets).unwrap();
    assert_eq!(groups.inverse(), inverse);
    let groups = Arc::new(groups);
    let fine = Var::from_tensor(&g.tensor("in.feat")).unwrap();
    let coarse = Var::from_tensor(&g.tensor("in.low_feat")).unwrap();
    let mut rng = rng();
    let out = module
        .forward(coarse.as_tensor(), fine.as_tensor(), groups, &Forward::eval(&mut rng))
        .unwrap();
    g.compare_tensor("out.sparse_feat", &out.skip);
    check(&g, &store, &[("in.feat", &fine), ("in.low_feat", &coarse)], &out.sum);
}
