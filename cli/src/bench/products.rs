//! Rows made of matrix products: a product, a convolution, an attention module.

use super::stopwatch::time;
use super::{Measured, Request, checks};
use anyhow::Result;
use candle_core::{Device, Tensor};
use scenesplat::kernels::Precision;
use scenesplat::kernels::bench_room as room;
use scenesplat::kernels::gemm::{Epilogue, PackedMatrix, gemm as product};
use scenesplat::kernels::kernel_map::KernelMap;
use scenesplat::kernels::patches::Patches;
use scenesplat::kernels::serialization::Curve;
use scenesplat::kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use scenesplat::kernels::sparse_conv::{PackedConv, forward};
use scenesplat::models::point_transformer_v3::{BatchRule, SerializedAttention};
use scenesplat::models::weights::WeightSource;
use scenesplat::models::{Compute, ParamStore};
use std::collections::BTreeMap;

/// Points of an attention patch, as in all released networks.
const PATCH_SIZE: usize = 1024;

/// Bytes of a weight.
pub(super) fn weight_size(precision: Precision) -> usize {
    match precision {
        Precision::F32 | Precision::F32Split => 4,
        Precision::Bf16 | Precision::F16 => 2,
        Precision::Int8 => 1,
    }
}

/// `[n, c] · [c, c]`
pub(super) fn gemm(c: usize, n: usize, request: &Request) -> Result<Measured> {
    let (x, weight) = (room::values(n * c, 1), room::values(c * c, 2));
    let matrix = PackedMatrix::from_strided_with(request.precision, &weight, c, c, 1, c);
    let mut out = vec![0.0; n * c];
    let measured = time(request, || {
        product(&x, &matrix, Epilogue::default(), &mut out);
        Ok(())
    })?;
    let rows = checks::some_rows(n, 64);
    let better = checks::linear(&checks::widened(&x, c, rows.iter().copied()), c, &weight, &[]);
    Ok(Measured {
        size: n,
        flop: (2 * n * c * c) as u64,
        bytes: (8 * n * c + weight_size(request.precision) * c * c) as u64,
        accuracy: Some(checks::against_f64(&out, c, &rows, &better)),
        ..measured
    })
}

/// Submanifold convolution over 3³ voxels with bias, table prebuilt.
pub(super) fn convolution(c: usize, n: usize, request: &Request) -> Result<Measured> {
    let map = KernelMap::build(&room::voxels(n), &[0, n], 3)?;
    let (x, bias) = (room::values(n * c, 1), room::values(c, 3));
    let weight = room::values(27 * c * c, 2);
    let conv = PackedConv::with_precision(request.precision, &weight, c, c, 27);
    let mut out = vec![0.0; n * c];
    let measured = time(request, || {
        forward(&map, &x, &conv, Some(&bias), &mut out);
        Ok(())
    })?;
    let rows = checks::some_rows(n, 16);
    let better = checks::convolution(&map, &x, &weight, &bias, &rows);
    let weight_bytes = weight_size(request.precision) * 27 * c * c;
    Ok(Measured {
        size: n,
        flop: (2 * map.num_pairs() * c * c) as u64,
        bytes: (8 * n * c + weight_bytes + 8 * map.num_pairs()) as u64,
        accuracy: Some(checks::against_f64(&out, c, &rows, &better)),
        ..measured
    })
}

/// The whole attention module: query, key and value, gather, attention, projection.
pub(super) fn attention(c: usize, heads: usize, n: usize, request: &Request) -> Result<Measured> {
    let cloud =
        SerializedCloud::new(room::voxels(n), vec![0, n], &[Curve::Hilbert], CurveDepth::PerScene)?;
    let patches = cloud.patches(PATCH_SIZE);
    // The spread that trained networks start from: scores neither flat nor all on one key.
    let scaled = |len: usize, seed| -> Vec<f32> {
        let bound = (3.0 / c as f32).sqrt();
        room::values(len, seed).into_iter().map(|v| v * bound).collect()
    };
    let weights = Weights {
        qkv: scaled(3 * c * c, 4),
        qkv_bias: room::values(3 * c, 5),
        proj: scaled(c * c, 6),
        proj_bias: room::values(c, 7),
    };
    let module = weights.module(c, heads, request.precision)?;
    let x = Tensor::from_vec(room::values(n * c, 1), (n, c), &Device::Cpu)?;
    let mut out = None;
    let measured = time(request, || {
        // The result of the pass before is given up first, as in a network.
        out = None;
        out = Some(module.forward(x.clone(), &cloud, None)?);
        Ok(())
    })?;
    let out = out.map(|t| t.flatten_all()?.to_vec1::<f32>()).transpose()?.unwrap_or_default();
    let x = x.flatten_all()?.to_vec1::<f32>()?;
    let (rows, better) = weights.some_rows(&x, c, heads, &patches, &cloud.order(0).order);
    let products: usize = patches.patches().iter().map(|p| p.own * p.len).sum();
    Ok(Measured {
        size: n,
        flop: (8 * n * c * c + 4 * products * c) as u64,
        bytes: (8 * n * c + 4 * weight_size(request.precision) * c * c + 4 * n) as u64,
        accuracy: Some(checks::against_f64(&out, c, &rows, &better)),
        ..measured
    })
}

/// Weights of an attention module, `[out, in]`.
struct Weights {
    qkv: Vec<f32>,
    qkv_bias: Vec<f32>,
    proj: Vec<f32>,
    proj_bias: Vec<f32>,
}

impl Weights {
    fn module(&self, c: usize, heads: usize, precision: Precision) -> Result<SerializedAttention> {
        let tensor = |name: &str, values: &[f32]| -> Result<(String, Tensor)> {
            let tensor = Tensor::from_slice(values, (values.len() / c, c), &Device::Cpu)?;
            let tensor = if name.ends_with("bias") { tensor.flatten_all()? } else { tensor };
            Ok((name.to_owned(), tensor))
        };
        let tensors = BTreeMap::from([
            tensor("qkv.weight", &self.qkv)?,
            tensor("qkv.bias", &self.qkv_bias)?,
            tensor("proj.weight", &self.proj)?,
            tensor("proj.bias", &self.proj_bias)?,
        ]);
        let store = ParamStore::frozen(WeightSource::tensors(tensors));
        let (rule, vb) = (BatchRule::Isolated, store.builder());
        let compute = Compute { precision, ..Compute::default() };
        Ok(SerializedAttention::new(c, heads, PATCH_SIZE, 0, rule, compute, vb)?)
    }

    /// Some rows of the patch in the middle, in f64: their numbers and values.
    fn some_rows(
        &self,
        x: &[f32],
        c: usize,
        heads: usize,
        patches: &Patches,
        order: &[u32],
    ) -> (Vec<usize>, Vec<f64>) {
        let patch = patches.patches()[patches.patches().len() / 2];
        let row = |slot: usize| order[patches.pad()[slot] as usize] as usize;
        let keys = checks::widened(x, c, (patch.start..patch.start + patch.len).map(row));
        let part = |p: usize, x: &[f64]| {
            let bias = &self.qkv_bias[p * c..(p + 1) * c];
            checks::linear(x, c, &self.qkv[p * c * c..(p + 1) * c * c], bias)
        };
        let rows: Vec<usize> =
            checks::some_rows(patch.own, 16).into_iter().map(|i| row(patch.start + i)).collect();
        let queries = part(0, &checks::widened(x, c, rows.iter().copied()));
        let attended = checks::attention(&queries, &part(1, &keys), &part(2, &keys), c, heads);
        (rows, checks::linear(&attended, c, &self.proj, &self.proj_bias))
    }
}
