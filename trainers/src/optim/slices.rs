//! Arithmetic on f32 tensors in main memory without temporary tensors.

use candle_core::{CpuStorage, InplaceOp2, InplaceOp3, Layout, Result, Storage, Tensor, bail};
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

fn expected<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    match elements(storage, layout) {
        Some(elements) => Ok(elements),
        None => bail!("expected contiguous f32 data in main memory"),
    }
}

fn elements_mut<'a>(storage: &'a mut CpuStorage, layout: &Layout) -> Result<&'a mut [f32]> {
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

/// `d ← f(d, s)` or `f(d, s, t)` for all elements, as an operation of this name.
pub(super) struct InPlace<F>(pub &'static str, pub F);

impl<F: Fn(f32, f32) -> f32 + Sync> InplaceOp2 for InPlace<F> {
    fn name(&self) -> &'static str {
        self.0
    }

    fn cpu_fwd(
        &self,
        d: &mut CpuStorage,
        d_layout: &Layout,
        s: &CpuStorage,
        s_layout: &Layout,
    ) -> Result<()> {
        let (d, s) = (elements_mut(d, d_layout)?, expected(s, s_layout)?);
        d.par_chunks_mut(CHUNK).zip(s.par_chunks(CHUNK)).for_each(|(d, s)| {
            d.iter_mut().zip(s).for_each(|(d, &s)| *d = (self.1)(*d, s));
        });
        Ok(())
    }
}

impl<F: Fn(f32, f32, f32) -> f32 + Sync> InplaceOp3 for InPlace<F> {
    fn name(&self) -> &'static str {
        self.0
    }

    fn cpu_fwd(
        &self,
        d: &mut CpuStorage,
        d_layout: &Layout,
        s: &CpuStorage,
        s_layout: &Layout,
        t: &CpuStorage,
        t_layout: &Layout,
    ) -> Result<()> {
        let (s, t) = (expected(s, s_layout)?, expected(t, t_layout)?);
        let sources = s.par_chunks(CHUNK).zip(t.par_chunks(CHUNK));
        elements_mut(d, d_layout)?.par_chunks_mut(CHUNK).zip(sources).for_each(|(d, (s, t))| {
            d.iter_mut().zip(s).zip(t).for_each(|((d, &s), &t)| *d = (self.1)(*d, s, t));
        });
        Ok(())
    }
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
