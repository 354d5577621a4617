//! Writing `.npy` arrays, at once or row by row.

use crate::disk::write_all_at;
use crate::extra_columns::NumberType;
use crate::{AtomicFile, SceneError};
use half::f16;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Bytes converted before they are handed to the file.
const BYTES_PER_WRITE: usize = 1 << 20;

/// A number that can be stored in `.npy` files; always written little-endian.
pub trait NpyElement: Copy + Send + Sync {
    /// The type as the header names it.
    const DESCR: &'static str;
    /// Bytes of one value.
    const SIZE: usize;
    /// Appends the bytes of the value.
    fn push_le(self, out: &mut Vec<u8>);
}

macro_rules! npy_element {
    ($($ty:ty: $descr:literal;)*) => {
        $(impl NpyElement for $ty {
            const DESCR: &'static str = $descr;
            const SIZE: usize = size_of::<$ty>();
            fn push_le(self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }
        })*
    };
}
npy_element! { f16: "<f2"; f32: "<f4"; f64: "<f8"; u8: "|u1"; i16: "<i2"; i32: "<i4"; i64: "<i8"; }

/// Writes an array in one go; the file appears when it is complete.
///
/// # Errors
/// If `values` does not fill `shape`, or the file cannot be written; then nothing is left behind.
pub fn write_npy<T: NpyElement>(
    path: &Path,
    shape: &[usize],
    values: &[T],
) -> Result<(), SceneError> {
    let (&rows, row_shape) = shape.split_first().unwrap_or((&1, &[]));
    let mut writer = NpyRowWriter::<T>::with_header(path, shape, rows, row_shape)?;
    writer.write_rows(values)?;
    writer.finish()
}

/// Writes an array of any type from its bytes, least significant first and in C order; the file appears
/// when it is complete.
pub(super) fn write_npy_bytes(
    path: &Path,
    ty: NumberType,
    shape: &[usize],
    bytes: &[u8],
) -> Result<(), SceneError> {
    let (order, kind) = match ty {
        NumberType::Bool => ('|', 'b'),
        NumberType::Int(size) => (if size == 1 { '|' } else { '<' }, 'i'),
        NumberType::UInt(size) => (if size == 1 { '|' } else { '<' }, 'u'),
        NumberType::Float(_) => ('<', 'f'),
    };
    let header = header(&format!("{order}{kind}{}", ty.size()), shape);
    let file = AtomicFile::create(path)?;
    let failed = || SceneError::io(path, "cannot write the array");
    write_all_at(file.file(), &header, 0).map_err(failed())?;
    write_all_at(file.file(), bytes, header.len() as u64).map_err(failed())?;
    Ok(file.commit()?)
}

/// Writes an array of known shape row by row, in order or at given rows, from one thread or many.
///
/// The file appears under its name when [`finish`](Self::finish) is called; dropped before that,
/// nothing is left behind. Memory does not grow with the array.
pub struct NpyRowWriter<T> {
    file: AtomicFile,
    data_start: u64,
    rows: usize,
    width: usize,
    next_row: usize,
    /// Rows written so far, as start → end, apart from each other.
    written: Mutex<BTreeMap<usize, usize>>,
    element: std::marker::PhantomData<fn(T)>,
}

impl<T: NpyElement> NpyRowWriter<T> {
    /// Starts an array of shape `[rows, row_shape…]`; an empty `row_shape` makes it a vector.
    ///
    /// # Errors
    /// If the size overflows or the file cannot be created.
    pub fn create(path: &Path, rows: usize, row_shape: &[usize]) -> Result<Self, SceneError> {
        let shape: Vec<usize> = std::iter::once(rows).chain(row_shape.iter().copied()).collect();
        Self::with_header(path, &shape, rows, row_shape)
    }

    fn with_header(
        path: &Path,
        shape: &[usize],
        rows: usize,
        row_shape: &[usize],
    ) -> Result<Self, SceneError> {
        let header = header(T::DESCR, shape);
        let width = row_shape.iter().try_fold(1usize, |n, &d| n.checked_mul(d));
        let size = width
            .and_then(|w| w.checked_mul(rows)?.checked_mul(T::SIZE)?.checked_add(header.len()))
            .and_then(|size| u64::try_from(size).ok());
        let (Some(width), Some(size)) = (width, size) else {
            let problem = format!("cannot hold an array of shape {shape:?}");
            return Err(SceneError::format(path, problem, ""));
        };
        let file = AtomicFile::create(path)?;
        let failed = || SceneError::io(path, "cannot write the array");
        write_all_at(file.file(), &header, 0).map_err(failed())?;
        // Rows that are never written read as 0.
        file.file().set_len(size).map_err(failed())?;
        Ok(Self {
            file,
            data_start: header.len() as u64,
            rows,
            width,
            next_row: 0,
            written: Mutex::new(BTreeMap::new()),
            element: std::marker::PhantomData,
        })
    }

    /// Writes whole rows after those of the last call.
    ///
    /// # Errors
    /// If `values` is no whole number of rows or goes beyond the last row, or writing fails.
    pub fn write_rows(&mut self, values: &[T]) -> Result<(), SceneError> {
        let rows = self.write_rows_at(self.next_row, values)?;
        self.next_row += rows;
        Ok(())
    }

    /// Writes whole rows from row `first` on, and gives their number; threads may share the writer.
    ///
    /// # Errors
    /// If `values` is no whole number of rows or goes beyond the last row, or writing fails.
    pub fn write_rows_at(&self, first: usize, values: &[T]) -> Result<usize, SceneError> {
        let width = self.width.max(1);
        let count = if self.width == 0 { 0 } else { values.len() / width };
        let fits = first.checked_add(count).is_some_and(|end| end <= self.rows);
        if count * self.width != values.len() || !fits {
            let problem = format!(
                "{} values from row {first} on do not fit into {} rows of {}",
                values.len(),
                self.rows,
                self.width
            );
            return Err(SceneError::format(self.file.target(), problem, ""));
        }
        let mut bytes = Vec::with_capacity(BYTES_PER_WRITE.min(values.len() * T::SIZE));
        let mut at = self.data_start + (first * width * T::SIZE) as u64;
        for part in values.chunks((BYTES_PER_WRITE / T::SIZE).max(1)) {
            bytes.clear();
            part.iter().for_each(|value| value.push_le(&mut bytes));
            write_all_at(self.file.file(), &bytes, at)
                .map_err(SceneError::io(self.file.target(), "cannot write the array"))?;
            at += bytes.len() as u64;
        }
        if count > 0 {
            // A panic of another thread cannot leave the map half-changed.
            let mut written = self.written.lock().unwrap_or_else(PoisonError::into_inner);
            mark(&mut written, first, first + count);
        }
        Ok(count)
    }

    /// Completes the file.
    ///
    /// # Errors
    /// If some row was never written (see [`finish_with_zeros`](Self::finish_with_zeros)), or the
    /// file cannot be completed.
    pub fn finish(self) -> Result<(), SceneError> {
        let missing = {
            let written = self.written.lock().unwrap_or_else(PoisonError::into_inner);
            let end_of_first =
                written.first_key_value().map_or(0, |(&s, &e)| if s == 0 { e } else { 0 });
            (end_of_first < self.rows && self.width > 0).then_some(end_of_first)
        };
        if let Some(row) = missing {
            let problem = format!("row {row} of {} was never written", self.rows);
            return Err(SceneError::format(self.file.target(), problem, ""));
        }
        Ok(self.file.commit()?)
    }

    /// Completes the file; rows that were never written hold 0.
    ///
    /// # Errors
    /// If the file cannot be completed.
    pub fn finish_with_zeros(self) -> Result<(), SceneError> {
        Ok(self.file.commit()?)
    }
}

/// Adds `start..end` to a set of ranges that stay apart from each other.
fn mark(ranges: &mut BTreeMap<usize, usize>, mut start: usize, mut end: usize) {
    if let Some((&s, &e)) = ranges.range(..=start).next_back()
        && e >= start
    {
        start = s;
        end = end.max(e);
    }
    while let Some((&s, &e)) = ranges.range(start..=end).next() {
        end = end.max(e);
        ranges.remove(&s);
    }
    ranges.insert(start, end);
}

/// A header, padded so that the values start at a multiple of 64 bytes.
fn header(descr: &str, shape: &[usize]) -> Vec<u8> {
    let lengths: Vec<String> = shape.iter().map(usize::to_string).collect();
    let comma = if shape.len() == 1 { "," } else { "" };
    let lengths = lengths.join(", ");
    let dict =
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({lengths}{comma}), }}");
    let padded = (10 + dict.len() + 1).next_multiple_of(64) - 10;
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    // Shapes have a handful of dimensions, so the header is far below 65536 bytes.
    out.extend_from_slice(&(padded as u16).to_le_bytes());
    out.extend_from_slice(format!("{dict:<width$}\n", width = padded - 1).as_bytes());
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_merge() {
        let mut ranges = BTreeMap::new();
        for (start, end) in [(4, 6), (0, 2), (8, 9), (6, 8), (1, 3)] {
            mark(&mut ranges, start, end);
        }
        assert_eq!(ranges.iter().collect::<Vec<_>>(), [(&0, &3), (&4, &9)]);
        mark(&mut ranges, 2, 20);
        assert_eq!(ranges.iter().collect::<Vec<_>>(), [(&0, &20)]);
    }

    #[test]
    fn headers_are_aligned_and_end_a_line() {
        for shape in [&[][..], &[1], &[123_456, 768], &[1, 2, 3, 4]] {
            let header = header("<f4", shape);
            assert_eq!(header.len() % 64, 0);
            assert_eq!(header.last(), Some(&b'\n'));
            let length = u16::from_le_bytes([header[8], header[9]]);
            assert_eq!(usize::from(length) + 10, header.len());
        }
    }
}
