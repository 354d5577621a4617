//! Arithmetic on f32 tensors in main memory without temporary tensors.

use candle_core::{CpuStorage, Layout, Result, Storage, Tensor, bail};
use rayon::prelude::*;

/// Elements per task. Also the unit in which sums are taken, so it must not depend on the machine.
const CHUNK: usize = 1 << 14;

/// The elements of a contiguous f32 tensor in main memory.
pub(super) fn elements<'a>(storage: &'a CpuStorage, layout: &Layout) -> Option<&'a [f32]> {
    match (storage, layout.contiguous_offsets()) {
        (CpuStorage::F32(data), Some((start, end))) => data.get(start..end),
        _ => None,
    }
}

/// As [`elements`], to be written, and an error where that is not possible.
pub(super) fn elements_mut<'a>(
    storage: &'a mut CpuStorage,
    layout: &Layout,
) -> Result<&'a mut [f32]> {
    match (storage, layout.contiguous_offsets()) {
        (CpuStorage::F32(data), Some((start, end))) if end <= data.len() => {
            Ok(&mut data[start..end])
        }
        _ => bail!("expected contiguous f32 data in main memory"),
    }
}

/// Whether `tensor` can be handled as a slice.
pub(super) fn is_slice(tensor: &Tensor) -> bool {
    let (storage, layout) = tensor.storage_and_layout();
    matches!(&*storage, Storage::Cpu(storage) if elements(storage, layout).is_some())
}

/// `d = f(d, s)` for all elements.
pub(super) fn zip2(d: &mut [f32], s: &[f32], f: impl Fn(f32, f32) -> f32 + Sync) {
    d.par_chunks_mut(CHUNK).zip(s.par_chunks(CHUNK)).for_each(|(d, s)| {
        for (d, &s) in d.iter_mut().zip(s) {
            *d = f(*d, s);
        }
    });
}

/// `d = f(d, s, t)` for all elements.
pub(super) fn zip3(d: &mut [f32], s: &[f32], t: &[f32], f: impl Fn(f32, f32, f32) -> f32 + Sync) {
    let sources = s.par_chunks(CHUNK).zip(t.par_chunks(CHUNK));
    d.par_chunks_mut(CHUNK).zip(sources).for_each(|(d, (s, t))| {
        for ((d, &s), &t) in d.iter_mut().zip(s).zip(t) {
            *d = f(*d, s, t);
        }
    });
}

/// Sum of squares in f64, in an order that no thread count changes.
pub(super) fn sum_of_squares(values: &[f32]) -> f64 {
    let chunk = |values: &[f32]| -> f64 {
        let mut lanes = [0.0_f64; 8];
        for block in values.chunks(8) {
            for (lane, &v) in lanes.iter_mut().zip(block) {
                *lane += f64::from(v) * f64::from(v);
            }
        }
        lanes.iter().sum()
    };
    let partial: Vec<f64> = values.par_chunks(CHUNK).map(chunk).collect();
    partial.iter().sum()
}
