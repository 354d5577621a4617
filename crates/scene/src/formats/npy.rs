//! Reading `.npy` arrays of numbers, versions 1 to 3.
//!
//! Not for arrays of objects, strings or records. Writing is in [`super::npy_writer`].

pub use crate::extra_columns::NumberType as NpyType;

use crate::SceneError;
use crate::input_file::{InputFile, filled, reserve};
use crate::place::less;
use half::f16;
use rayon::prelude::*;
use std::path::Path;

/// A header is one short line; one longer than this is a damaged or hostile file.
const MAX_HEADER_BYTES: usize = 1 << 16;
const VALUES_PER_TASK: usize = 1 << 15;

/// The type that a header names, and whether its bytes are most significant first.
fn parse_type(descr: &str) -> Option<(NpyType, bool)> {
    let (order, rest) = descr.split_at_checked(1)?;
    let (kind, size) = rest.split_at_checked(1)?;
    let size: u8 = size.parse().ok()?;
    let ty = match (kind, size) {
        ("b", 1) => NpyType::Bool,
        ("i", 1 | 2 | 4 | 8) => NpyType::Int(size),
        ("u", 1 | 2 | 4 | 8) => NpyType::UInt(size),
        ("f", 2 | 4 | 8) => NpyType::Float(size),
        _ => return None,
    };
    let big_endian = match order {
        ">" => true,
        "<" | "|" => false,
        "=" => cfg!(target_endian = "big"),
        _ => return None,
    };
    Some((ty, big_endian))
}

/// An open array.
///
/// Values stay in the file (it is mapped into memory) until they are read. The header has been
/// checked against the length of the file, so reading cannot be made to reserve more than that.
pub struct NpyFile {
    map: InputFile,
    ty: NpyType,
    big_endian: bool,
    shape: Vec<usize>,
    count: usize,
    /// `[rows, columns]` of a two-dimensional array in Fortran order.
    transposed: Option<[usize; 2]>,
    data_start: usize,
}

impl std::fmt::Debug for NpyFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("NpyFile")
            .field("path", &self.map.path())
            .field("ty", &self.ty)
            .field("shape", &self.shape)
            .finish_non_exhaustive()
    }
}

impl NpyFile {
    /// Opens an array and checks its header and its size.
    ///
    /// # Errors
    /// If the file cannot be read, is no `.npy` file, holds something other than numbers, has more
    /// than two dimensions in Fortran order, or is not exactly as long as its shape says.
    pub fn open(path: &Path) -> Result<Self, SceneError> {
        Self::new(InputFile::open(path)?)
    }

    /// As [`open`](Self::open), from the bytes of a file, of which a copy is kept; `path` is for
    /// messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, SceneError> {
        Self::new(InputFile::from_bytes(bytes, path))
    }

    fn new(map: InputFile) -> Result<Self, SceneError> {
        let path = map.path();
        let bad = |problem: String| SceneError::format(path, problem, "save the array again");
        let bytes = map.bytes();
        if !bytes.starts_with(b"\x93NUMPY") {
            return Err(bad("is no .npy file".to_owned()));
        }
        let cut = || bad("ends within the .npy header".to_owned());
        let (start, length) = match bytes.get(6).ok_or_else(cut)? {
            1 => {
                let length = bytes.get(8..10).ok_or_else(cut)?;
                (10, usize::from(u16::from_le_bytes([length[0], length[1]])))
            }
            2 | 3 => {
                let l = bytes.get(8..12).ok_or_else(cut)?;
                (12, u32::from_le_bytes([l[0], l[1], l[2], l[3]]) as usize)
            }
            version => return Err(bad(format!("has unknown .npy version {version}"))),
        };
        if length > MAX_HEADER_BYTES {
            return Err(bad(format!("has an .npy header of {length} bytes")));
        }
        let text = bytes.get(start..start + length).ok_or_else(cut)?;
        let text = std::str::from_utf8(text)
            .map_err(|_| bad("has an .npy header that is no text".to_owned()))?;
        let header = parse_header(text)
            .ok_or_else(|| bad(format!("has an .npy header that is not understood: {text:?}")))?;
        let (ty, big_endian) = parse_type(&header.descr).ok_or_else(|| {
            bad(format!("holds values of type {:?}, numbers are expected", header.descr))
        })?;
        let transposed = match (header.fortran_order, header.shape.as_slice()) {
            (false, _) | (true, [] | [_]) => None,
            (true, &[rows, columns]) => Some([rows, columns]),
            (true, _) => {
                return Err(SceneError::format(
                    path,
                    format!("has {} dimensions in Fortran order", header.shape.len()),
                    "save numpy.ascontiguousarray(array) instead",
                ));
            }
        };
        let data_start = start + length;
        let left = bytes.len() - data_start;
        let count = if header.shape.contains(&0) {
            Some(0)
        } else {
            header.shape.iter().try_fold(1usize, |n, &d| n.checked_mul(d))
        };
        let size = count.and_then(|n| n.checked_mul(ty.size()));
        let (Some(count), Some(true)) = (count, size.map(|size| size == left)) else {
            return Err(bad(format!(
                "should hold {:?} values of {} bytes, but has {left} bytes of data",
                header.shape,
                ty.size()
            )));
        };
        Ok(Self { ty, big_endian, shape: header.shape, count, transposed, data_start, map })
    }

    /// Where the file is.
    pub fn path(&self) -> &Path {
        self.map.path()
    }

    /// Length along each dimension.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The type of the values in the file.
    pub fn ty(&self) -> NpyType {
        self.ty
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is no value.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// All values as f32 in C order, rounded to nearest.
    ///
    /// # Errors
    /// If there is not enough memory.
    pub fn read_f32(&self) -> Result<Vec<f32>, SceneError> {
        self.read(|v| match v {
            Value::Int(v) => v as f32,
            Value::UInt(v) => v as f32,
            Value::F16(v) => v.to_f32(),
            Value::F32(v) => v,
            Value::F64(v) => v as f32,
        })
    }

    /// All values as f64 in C order.
    ///
    /// # Errors
    /// If there is not enough memory.
    pub fn read_f64(&self) -> Result<Vec<f64>, SceneError> {
        self.read(Value::widened)
    }

    /// Rows of three values less `origin`, subtracted in f64 and rounded once.
    ///
    /// # Errors
    /// If there is not enough memory.
    pub(crate) fn read_about(&self, origin: [f64; 3]) -> Result<Vec<[f32; 3]>, SceneError> {
        let mut out = filled(self.count / 3, [0f32; 3], self.path())?;
        out.par_chunks_mut(VALUES_PER_TASK).enumerate().for_each(|(task, rows)| {
            for (i, row) in rows.iter_mut().enumerate() {
                *row = less(self.position(task * VALUES_PER_TASK + i), origin);
            }
        });
        self.map.check_length()?;
        Ok(out)
    }

    /// A row of an array of rows of three values.
    pub(crate) fn position(&self, row: usize) -> [f64; 3] {
        let size = self.ty.size();
        [0, 1, 2].map(|column| {
            let at = match self.transposed {
                Some([rows, _]) => column * rows + row,
                None => row * 3 + column,
            };
            let bytes = &self.map.bytes()[self.data_start + at * size..][..size];
            value(self.ty, bytes, self.big_endian).widened()
        })
    }

    /// All values as f16 in C order, rounded to nearest; values beyond ±65504 become infinite.
    ///
    /// # Errors
    /// If there is not enough memory.
    pub fn read_f16(&self) -> Result<Vec<f16>, SceneError> {
        self.read(|v| match v {
            Value::Int(v) => f16::from_f64(v as f64),
            Value::UInt(v) => f16::from_f64(v as f64),
            Value::F16(v) => v,
            Value::F32(v) => f16::from_f32(v),
            Value::F64(v) => f16::from_f64(v),
        })
    }

    /// All values as i64 in C order.
    ///
    /// # Errors
    /// If a value is not a whole number of i64.
    pub fn read_i64(&self) -> Result<Vec<i64>, SceneError> {
        let whole = |v: f64| (v.fract() == 0.0 && v.abs() < 9.2e18).then_some(v as i64);
        let values = self.read(|v| match v {
            Value::Int(v) => Some(v),
            Value::UInt(v) => i64::try_from(v).ok(),
            Value::F16(v) => whole(v.to_f64()),
            Value::F32(v) => whole(f64::from(v)),
            Value::F64(v) => whole(v),
        })?;
        let bad = values.iter().position(Option::is_none);
        if let Some(element) = bad {
            return Err(SceneError::Value {
                path: self.path().to_owned(),
                element,
                field: "values".to_owned(),
                value: "a number that is not whole".to_owned(),
                help: "save the array as integers".to_owned(),
            });
        }
        Ok(values.into_iter().flatten().collect())
    }

    /// The bytes of all values in C order, least significant first.
    ///
    /// # Errors
    /// If there is not enough memory.
    pub(crate) fn read_bytes(&self) -> Result<Vec<u8>, SceneError> {
        let bits = self.read(|v| match v {
            Value::Int(v) => v as u64,
            Value::UInt(v) => v,
            Value::F16(v) => u64::from(v.to_bits()),
            Value::F32(v) => u64::from(v.to_bits()),
            Value::F64(v) => v.to_bits(),
        })?;
        let size = self.ty.size();
        let mut out = Vec::new();
        reserve(&mut out, self.count * size, self.path())?;
        bits.iter().for_each(|bits| out.extend_from_slice(&bits.to_le_bytes()[..size]));
        Ok(out)
    }

    /// All values as bytes in C order.
    ///
    /// # Errors
    /// If a value is not a whole number of 0 to 255.
    pub fn read_u8(&self) -> Result<Vec<u8>, SceneError> {
        let values = self.read_i64()?;
        values
            .iter()
            .enumerate()
            .map(|(element, &value)| {
                u8::try_from(value).map_err(|_| SceneError::Value {
                    path: self.path().to_owned(),
                    element,
                    field: "values".to_owned(),
                    value: value.to_string(),
                    help: "0 to 255 is expected".to_owned(),
                })
            })
            .collect()
    }

    /// Reads all values, in parallel.
    fn read<T: Copy + Default + Send + Sync>(
        &self,
        convert: impl Fn(Value) -> T + Sync,
    ) -> Result<Vec<T>, SceneError> {
        let mut out = filled(self.count, T::default(), self.path())?;
        let bytes = &self.map.bytes()[self.data_start..];
        let size = self.ty.size();
        out.par_chunks_mut(VALUES_PER_TASK).zip(bytes.par_chunks(VALUES_PER_TASK * size)).for_each(
            |(out, bytes)| {
                for (out, bytes) in out.iter_mut().zip(bytes.chunks_exact(size)) {
                    *out = convert(value(self.ty, bytes, self.big_endian));
                }
            },
        );
        self.map.check_length()?;
        let Some([rows, columns]) = self.transposed else { return Ok(out) };
        let mut turned = filled(self.count, T::default(), self.path())?;
        for (row, to) in turned.chunks_exact_mut(columns.max(1)).enumerate() {
            for (column, to) in to.iter_mut().enumerate() {
                *to = out[column * rows + row];
            }
        }
        Ok(turned)
    }
}

enum Value {
    Int(i64),
    UInt(u64),
    F16(f16),
    F32(f32),
    F64(f64),
}

impl Value {
    fn widened(self) -> f64 {
        match self {
            Self::Int(v) => v as f64,
            Self::UInt(v) => v as f64,
            Self::F16(v) => v.to_f64(),
            Self::F32(v) => f64::from(v),
            Self::F64(v) => v,
        }
    }
}

#[inline]
fn value(ty: NpyType, bytes: &[u8], big_endian: bool) -> Value {
    let mut le = [0u8; 8];
    let size = bytes.len().min(8);
    le[..size].copy_from_slice(&bytes[..size]);
    if big_endian {
        le[..size].reverse();
    }
    let bits = u64::from_le_bytes(le);
    match ty {
        NpyType::Bool => Value::UInt(u64::from(bits != 0)),
        NpyType::UInt(_) => Value::UInt(bits),
        NpyType::Int(size) => {
            // Moves the sign bit to the top and back, which extends it.
            let unused = 64 - 8 * u32::from(size);
            Value::Int((bits << unused) as i64 >> unused)
        }
        NpyType::Float(2) => Value::F16(f16::from_bits(bits as u16)),
        NpyType::Float(4) => Value::F32(f32::from_bits(bits as u32)),
        NpyType::Float(_) => Value::F64(f64::from_bits(bits)),
    }
}

struct Header {
    descr: String,
    fortran_order: bool,
    shape: Vec<usize>,
}

/// Parses the Python dictionary in a header; `None` if anything is unexpected.
fn parse_header(text: &str) -> Option<Header> {
    let mut rest = text.trim().strip_prefix('{')?;
    let (mut descr, mut fortran_order, mut shape) = (None, None, None);
    loop {
        rest = rest.trim_start();
        if let Some(after) = rest.strip_prefix('}') {
            if !after.trim().is_empty() {
                return None;
            }
            return Some(Header { descr: descr?, fortran_order: fortran_order?, shape: shape? });
        }
        let (key, after) = quoted(rest)?;
        rest = after.trim_start().strip_prefix(':')?.trim_start();
        match key {
            "descr" => {
                let (value, after) = quoted(rest)?;
                descr = Some(value.to_owned());
                rest = after;
            }
            "fortran_order" => {
                let value = [("True", true), ("False", false)];
                let found = value.iter().find_map(|&(word, v)| Some((v, rest.strip_prefix(word)?)));
                let (value, after) = found?;
                fortran_order = Some(value);
                rest = after;
            }
            "shape" => {
                let (inside, after) = rest.strip_prefix('(')?.split_once(')')?;
                let mut lengths = Vec::new();
                let mut parts = inside.split(',').peekable();
                while let Some(part) = parts.next() {
                    let part = part.trim();
                    if part.is_empty() && parts.peek().is_none() {
                        break;
                    }
                    // Python 2 wrote long integers as `10L`.
                    lengths.push(part.strip_suffix('L').unwrap_or(part).parse().ok()?);
                }
                shape = Some(lengths);
                rest = after;
            }
            _ => return None,
        }
        rest = rest.trim_start();
        rest = rest.strip_prefix(',').unwrap_or(rest);
    }
}

/// A quoted word and what follows it.
fn quoted(text: &str) -> Option<(&str, &str)> {
    let quote = text.chars().next().filter(|&c| c == '\'' || c == '"')?;
    text[1..].split_once(quote)
}
