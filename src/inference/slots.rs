//! Where the outputs of the network are collected: in memory or in a scratch file.

use super::{EncodeError, ScratchFile};
use scenesplat_scene::LanguageCode;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Rows moved between file and memory at a time.
const BLOCK: usize = 2048;

/// Sums of output rows, one per slot, with their counts.
#[derive(Debug)]
pub(super) struct SlotStore {
    width: usize,
    count: Vec<u32>,
    values: Values,
}

#[derive(Debug)]
enum Values {
    Memory(Vec<f32>),
    File(ScratchFile),
    /// Decoded whenever a row is read; never added to.
    Codes(LanguageCode),
}

impl SlotStore {
    pub(super) fn memory(slots: usize, width: usize) -> Self {
        Self { width, count: vec![0; slots], values: Values::Memory(vec![0.0; slots * width]) }
    }

    pub(super) fn file(folder: &Path, slots: usize, width: usize) -> Result<Self, EncodeError> {
        // Several encoders may run in one process, and several processes in one folder.
        static SERIAL: AtomicU64 = AtomicU64::new(0);
        let serial = SERIAL.fetch_add(1, Ordering::Relaxed);
        let name = format!(".scenesplat-features-{}-{serial}.partial", std::process::id());
        let path = folder.join(name);
        let spill = |source| EncodeError::Spill { path: path.clone(), source };
        let mut options = File::options();
        options.read(true).write(true).create_new(true);
        let file = options.open(&path).map_err(spill)?;
        file.set_len((slots * width * 4) as u64).map_err(spill)?;
        let file = ScratchFile { file: std::sync::Mutex::new(file), path };
        Ok(Self { width, count: vec![0; slots], values: Values::File(file) })
    }

    /// Finished rows. `[slots, width]`
    pub(super) fn rows(values: Vec<f32>, width: usize) -> Self {
        Self { width, count: vec![1; values.len() / width], values: Values::Memory(values) }
    }

    /// Rows that are stored as codes; their features are brought to unit length.
    pub(super) fn codes(slots: usize, code: LanguageCode) -> Self {
        let width = code.codebook.feature_width();
        Self { width, count: vec![1; slots], values: Values::Codes(code) }
    }

    /// Memory of the rows.
    pub(super) fn bytes(&self) -> u64 {
        match &self.values {
            Values::Memory(values) => size_of_val(values.as_slice()) as u64,
            Values::File(_) | Values::Codes(_) => 0,
        }
    }

    pub(super) fn width(&self) -> usize {
        self.width
    }

    /// Adds output rows to their slots; with `counts`, only rows whose entry is true.
    pub(super) fn add(
        &mut self,
        slots: &[u32],
        rows: &[f32],
        counts: Option<&[bool]>,
    ) -> Result<(), EncodeError> {
        let width = self.width;
        let wanted = |i: usize| counts.is_none_or(|c| c[i]);
        for (i, (&slot, row)) in slots.iter().zip(rows.chunks_exact(width)).enumerate() {
            if !wanted(i) {
                continue;
            }
            let slot = slot as usize;
            let first = self.count[slot] == 0;
            self.count[slot] += 1;
            match &mut self.values {
                Values::Memory(values) => {
                    let sum = &mut values[slot * width..(slot + 1) * width];
                    sum.iter_mut().zip(row).for_each(|(s, v)| *s += v);
                }
                Values::File(file) => {
                    let at = slot * width;
                    if first {
                        write_at(file, at, row)?;
                    } else {
                        let mut sum = read_at(file, at, width)?;
                        sum.iter_mut().zip(row).for_each(|(s, v)| *s += v);
                        write_at(file, at, &sum)?;
                    }
                }
                Values::Codes(_) => return Err(EncodeError::ReadOnly),
            }
        }
        Ok(())
    }

    /// Turns each sum into the final row.
    pub(super) fn finish(&mut self, mut f: impl FnMut(&mut [f32], u32)) -> Result<(), EncodeError> {
        let width = self.width;
        for start in (0..self.count.len()).step_by(BLOCK) {
            let end = (start + BLOCK).min(self.count.len());
            let mut apply = |rows: &mut [f32]| {
                for (row, &count) in rows.chunks_exact_mut(width).zip(&self.count[start..end]) {
                    f(row, count.max(1));
                }
            };
            match &mut self.values {
                Values::Memory(values) => apply(&mut values[start * width..end * width]),
                Values::File(file) => {
                    let mut rows = read_at(file, start * width, (end - start) * width)?;
                    apply(&mut rows);
                    write_at(file, start * width, &rows)?;
                }
                Values::Codes(_) => return Err(EncodeError::ReadOnly),
            }
        }
        Ok(())
    }

    pub(super) fn read(&self, rows: Range<usize>) -> Result<Vec<f32>, EncodeError> {
        let (start, len) = (rows.start * self.width, rows.len() * self.width);
        match &self.values {
            Values::Memory(values) => Ok(values[start..start + len].to_vec()),
            Values::File(file) => read_at(file, start, len),
            Values::Codes(code) => {
                let mut out = vec![0.0; len];
                for (row, out) in rows.zip(out.chunks_exact_mut(self.width)) {
                    decode_unit(code, row, out);
                }
                Ok(out)
            }
        }
    }

    pub(super) fn gather(&self, slots: &[u32]) -> Result<Vec<f32>, EncodeError> {
        let mut out = Vec::with_capacity(slots.len() * self.width);
        for &slot in slots {
            let start = slot as usize * self.width;
            match &self.values {
                Values::Memory(values) => out.extend_from_slice(&values[start..start + self.width]),
                Values::File(file) => out.extend(read_at(file, start, self.width)?),
                Values::Codes(code) => {
                    out.resize(out.len() + self.width, 0.0);
                    let at = out.len() - self.width;
                    decode_unit(code, slot as usize, &mut out[at..]);
                }
            }
        }
        Ok(out)
    }
}

/// The feature of a row at unit length, or zeros if it has none.
fn decode_unit(code: &LanguageCode, row: usize, out: &mut [f32]) {
    code.decode(row, out);
    let norm = out.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>().sqrt();
    if norm > 0.0 {
        out.iter_mut().for_each(|v| *v = (f64::from(*v) / norm) as f32);
    }
}

fn spill_error(path: &Path) -> impl Fn(io::Error) -> EncodeError + '_ {
    move |source| EncodeError::Spill { path: PathBuf::from(path), source }
}

fn write_at(file: &ScratchFile, first: usize, values: &[f32]) -> Result<(), EncodeError> {
    let mut bytes = Vec::with_capacity(values.len() * 4);
    values.iter().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
    let mut handle = file.lock();
    handle
        .seek(SeekFrom::Start(first as u64 * 4))
        .and_then(|_| handle.write_all(&bytes))
        .map_err(spill_error(&file.path))
}

fn read_at(file: &ScratchFile, first: usize, len: usize) -> Result<Vec<f32>, EncodeError> {
    let mut bytes = vec![0u8; len * 4];
    let mut handle = file.lock();
    handle
        .seek(SeekFrom::Start(first as u64 * 4))
        .and_then(|_| handle.read_exact(&mut bytes))
        .map_err(spill_error(&file.path))?;
    Ok(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_decoded_to_unit_length() {
        use half::f16;
        use scenesplat_scene::LanguageCodebook;
        let values = [3.0, 0.0, -1.0].map(f16::from_f32).to_vec();
        let codebook = LanguageCodebook { mean: vec![0.0, 4.0], axes: vec![1.0, 0.0] };
        let mut store = SlotStore::codes(3, LanguageCode { values, codebook });
        assert_eq!(store.read(0..2).unwrap(), [0.6, 0.8, 0.0, 0.0]);
        assert_eq!(store.gather(&[1, 0]).unwrap(), [0.0, 0.0, 0.6, 0.8]);
        assert!(store.add(&[0], &[1.0, 1.0], None).is_err());
        assert!(store.finish(|_, _| ()).is_err());
    }

    #[test]
    fn file_and_memory_agree() {
        let folder = tempfile::tempdir().unwrap();
        let mut stores = [SlotStore::memory(3, 2), SlotStore::file(folder.path(), 3, 2).unwrap()];
        for store in &mut stores {
            store.add(&[2, 0], &[1.0, 2.0, 3.0, 4.0], None).unwrap();
            store.add(&[2, 1], &[5.0, 6.0, 7.0, 8.0], Some(&[true, false])).unwrap();
            store.finish(|row, n| row.iter_mut().for_each(|v| *v /= n as f32)).unwrap();
            assert_eq!(store.read(0..3).unwrap(), [3.0, 4.0, 0.0, 0.0, 3.0, 4.0]);
            assert_eq!(store.gather(&[2, 0, 2]).unwrap(), [3.0, 4.0, 3.0, 4.0, 3.0, 4.0]);
        }
        drop(stores);
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            0,
            "the scratch file is gone"
        );
    }
}
