//! Rows of a tensor as plain numbers, whatever type they are stored in.

use crate::error::LossError;
use candle_core::{CpuStorage, DType, Device, Result, Storage, Tensor, WithDType};
use half::slice::HalfFloatSliceExt;
use half::{bf16, f16};
use rayon::prelude::*;
use scenesplat_kernels::simd::compiled;
use std::ops::Range;

/// The type that rows are computed in: f64 for f64, f32 for all else. Sums are always f64.
pub(crate) trait Real: WithDType + Default {
    fn wide(self) -> f64;
    fn narrow(value: f64) -> Self;
    /// The values, if they are stored in this type.
    fn stored<'a>(values: &Values<'a>) -> Option<&'a [Self]>;
    /// Something that sorts the largest value first and equal values by row.
    type Key: Ord + Copy + Send + Default;
    /// The key of a value that is not negative.
    fn key(self, row: u32) -> Self::Key;
    /// What the key was made of.
    fn of_key(key: Self::Key) -> (Self, u32);
    /// Writes values of this type into a tensor's type, if that is another.
    fn store_half<H: Half>(values: &[Self], out: &mut [H]);
}

impl Real for f32 {
    #[inline(always)]
    fn wide(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn narrow(value: f64) -> Self {
        value as Self
    }
    fn stored<'a>(values: &Values<'a>) -> Option<&'a [Self]> {
        match values {
            Values::F32(v) => Some(v),
            _ => None,
        }
    }
    type Key = u64;
    #[inline(always)]
    fn key(self, row: u32) -> u64 {
        u64::from(!self.to_bits()) << 32 | u64::from(row)
    }
    #[inline(always)]
    fn of_key(key: u64) -> (Self, u32) {
        (Self::from_bits(!((key >> 32) as u32)), key as u32)
    }
    fn store_half<H: Half>(values: &[Self], out: &mut [H]) {
        H::from_f32(values, out);
    }
}

impl Real for f64 {
    #[inline(always)]
    fn wide(self) -> f64 {
        self
    }
    #[inline(always)]
    fn narrow(value: f64) -> Self {
        value
    }
    fn stored<'a>(values: &Values<'a>) -> Option<&'a [Self]> {
        match values {
            Values::F64(v) => Some(v),
            _ => None,
        }
    }
    type Key = u128;
    #[inline(always)]
    fn key(self, row: u32) -> u128 {
        u128::from(!self.to_bits()) << 64 | u128::from(row)
    }
    #[inline(always)]
    fn of_key(key: u128) -> (Self, u32) {
        (Self::from_bits(!((key >> 64) as u64)), key as u32)
    }
    fn store_half<H: Half>(values: &[Self], out: &mut [H]) {
        let narrow: Vec<f32> = values.iter().map(|v| *v as f32).collect();
        H::from_f32(&narrow, out);
    }
}

/// A type of 16 bits.
pub(crate) trait Half: WithDType + Default {
    fn from_f32(values: &[f32], out: &mut [Self]);
}

impl Half for bf16 {
    /// To the nearest, ties to even, in a loop that becomes vector instructions.
    fn from_f32(values: &[f32], out: &mut [Self]) {
        compiled(|| {
            for (out, value) in out.iter_mut().zip(values) {
                let bits = value.to_bits();
                let rounded = (bits.wrapping_add(0x7fff + ((bits >> 16) & 1)) >> 16) as u16;
                // Rounding could carry a NaN into infinity.
                let nan = (bits >> 16) as u16 | 0x40;
                *out = Self::from_bits(if value.is_nan() { nan } else { rounded });
            }
        });
    }
}

impl Half for f16 {
    /// Saturates: the largest f16 is 65,504, which the gradient at a row near zero exceeds.
    fn from_f32(values: &[f32], out: &mut [Self]) {
        out.convert_from_f32_slice(values);
        let largest = |o: &mut Self| *o = o.clamp(Self::MIN, Self::MAX);
        out.iter_mut().filter(|o| o.is_infinite()).for_each(largest);
    }
}

/// Values as they are stored.
pub(crate) enum Values<'a> {
    F32(&'a [f32]),
    F64(&'a [f64]),
    Bf16(&'a [bf16]),
    F16(&'a [f16]),
}

/// A matrix of a tensor's values.
pub(crate) struct Matrix<'a> {
    values: Values<'a>,
    pub rows: usize,
    pub columns: usize,
}

impl Matrix<'_> {
    /// Some rows, copied to `scratch` only if they are stored in another type.
    pub(crate) fn read<'s, T: Real>(
        &'s self,
        rows: Range<usize>,
        scratch: &'s mut Vec<T>,
    ) -> &'s [T] {
        let at = rows.start * self.columns..rows.end * self.columns;
        if let Some(values) = T::stored(&self.values) {
            return &values[at];
        }
        scratch.resize(at.len(), T::default());
        let set = scratch.iter_mut();
        match self.values {
            Values::F32(v) => set.zip(&v[at]).for_each(|(s, v)| *s = T::narrow(f64::from(*v))),
            Values::F64(v) => set.zip(&v[at]).for_each(|(s, v)| *s = T::narrow(*v)),
            Values::Bf16(v) => set.zip(&v[at]).for_each(|(s, v)| {
                *s = T::narrow(f64::from(f32::from_bits(u32::from(v.to_bits()) << 16)));
            }),
            Values::F16(v) => {
                let mut wide = vec![0f32; at.len()];
                v[at].convert_to_f32_slice(&mut wide);
                set.zip(wide).for_each(|(s, v)| *s = T::narrow(f64::from(v)));
            }
        }
        scratch
    }

    /// The value in a row that is not finite, as an error; `None` if all are finite.
    pub(crate) fn not_finite(
        &self,
        loss: &'static str,
        field: &'static str,
        row: usize,
    ) -> Option<LossError> {
        let mut scratch = Vec::<f64>::new();
        let values = self.read(row..row + 1, &mut scratch);
        let column = values.iter().position(|v| !v.is_finite())?;
        Some(LossError::NotFinite { loss, field, row, column, value: values[column] })
    }
}

/// Lends the values of a matrix, made contiguous if needed, and copied here if they are on another device.
pub(crate) fn read_matrix<R>(
    loss: &'static str,
    field: &'static str,
    tensor: &Tensor,
    f: impl FnOnce(&Matrix<'_>) -> Result<R>,
) -> Result<R> {
    let &[rows, columns] = tensor.dims() else {
        return Err(LossError::shape(loss, field, "[N, D]", tensor.dims()).into());
    };
    if rows > u32::MAX as usize {
        let (expected, got) = ("fewer than 2³² rows".to_owned(), rows.to_string());
        return Err(LossError::Shape { loss, field, expected, got }.into());
    }
    let tensor = tensor.to_device(&Device::Cpu)?.contiguous()?;
    let (storage, layout) = tensor.storage_and_layout();
    let wrong = || {
        let got = format!("{:?} on {:?}", tensor.dtype(), tensor.device().location());
        candle_core::Error::from(LossError::Type { loss, field, got })
    };
    let Storage::Cpu(storage) = &*storage else { return Err(wrong()) };
    let (start, end) = layout.contiguous_offsets().ok_or_else(wrong)?;
    let values = match storage {
        CpuStorage::F32(v) => Values::F32(&v[start..end]),
        CpuStorage::F64(v) => Values::F64(&v[start..end]),
        CpuStorage::BF16(v) => Values::Bf16(&v[start..end]),
        CpuStorage::F16(v) => Values::F16(&v[start..end]),
        _ => return Err(wrong()),
    };
    f(&Matrix { values, rows, columns })
}

/// Rows that one task works on; a function of the width alone, so that sums over tasks do not depend
/// on the number of threads.
pub(crate) fn rows_per_task(columns: usize) -> usize {
    ((1 << 16) / columns.max(1)).clamp(16, 2048)
}

/// A tensor like `like` (`[N, D]`), whose rows `fill` writes: it gets the number of the first row
/// and zeroed rows. The tensor is where `like` is.
pub(crate) fn make_rows<T: Real>(
    like: &Tensor,
    fill: impl Fn(usize, &mut [T]) + Sync,
) -> Result<Tensor> {
    let (rows, columns) = like.dims2()?;
    match like.dtype() {
        DType::BF16 => make_half::<T, bf16>((rows, columns), like.device(), fill),
        DType::F16 => make_half::<T, f16>((rows, columns), like.device(), fill),
        _ => {
            let mut out = vec![T::default(); rows * columns];
            let task = rows_per_task(columns);
            if columns > 0 {
                let tasks = out.par_chunks_mut(task * columns).enumerate();
                tasks.for_each(|(i, out)| fill(i * task, out));
            }
            Tensor::from_vec(out, (rows, columns), like.device())
        }
    }
}

fn make_half<T: Real, H: Half>(
    (rows, columns): (usize, usize),
    device: &Device,
    fill: impl Fn(usize, &mut [T]) + Sync,
) -> Result<Tensor> {
    let mut out = vec![H::default(); rows * columns];
    let task = rows_per_task(columns);
    if columns > 0 {
        out.par_chunks_mut(task * columns).enumerate().for_each_init(Vec::new, |wide, (i, out)| {
            wide.clear();
            wide.resize(out.len(), T::default());
            fill(i * task, wide);
            T::store_half(wide, out);
        });
    }
    Tensor::from_vec(out, (rows, columns), device)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bf16_as_the_crate_rounds_it() {
        let values: Vec<f32> = (0..=u16::MAX)
            .flat_map(|high| {
                let low = [0, 1, 0x7fff, 0x8000, 0x8001, 0xffff];
                low.map(|low| f32::from_bits(u32::from(high) << 16 | low))
            })
            .collect();
        let mut got = vec![bf16::ZERO; values.len()];
        <bf16 as Half>::from_f32(&values, &mut got);
        for (got, value) in got.iter().zip(&values) {
            assert_eq!(got.to_bits(), bf16::from_f32(*value).to_bits(), "{value}");
        }
    }

    #[test]
    fn f16_saturates() {
        let mut got = [f16::ZERO; 5];
        <f16 as Half>::from_f32(&[1e9, f32::NEG_INFINITY, 1.5, 65_519.0, f32::NAN], &mut got);
        assert_eq!(got[..4], [f16::MAX, f16::MIN, f16::from_f32_const(1.5), f16::MAX]);
        assert!(got[4].is_nan());
    }

    #[test]
    fn keys_sort_descending_and_then_by_row() {
        let values = [0f32, 1e-40, 1e-7, 0.5, 0.5, 1.0];
        let mut keys: Vec<_> = (0..6).map(|i| values[i].key(i as u32)).collect();
        keys.sort_unstable();
        let back: Vec<_> = keys.iter().map(|k| f32::of_key(*k)).collect();
        assert_eq!(back, [(1.0, 5), (0.5, 3), (0.5, 4), (1e-7, 2), (1e-40, 1), (0.0, 0)]);
        let mut keys: Vec<_> = (0..6).map(|i| f64::from(values[i]).key(i as u32)).collect();
        keys.sort_unstable();
        assert_eq!(keys.iter().map(|k| f64::of_key(*k).1).collect::<Vec<_>>(), [5, 3, 4, 2, 1, 0]);
    }
}
