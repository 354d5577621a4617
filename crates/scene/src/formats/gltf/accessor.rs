//! Numbers out of buffer views.

use super::buffers::Buffers;
use super::document::{Accessor, Document, Sparse};
use super::file_error;
use crate::SceneError;
use rayon::prelude::*;
use std::ops::Range;
use std::path::Path;

/// Rows that one task decodes.
const ROWS_PER_TASK: usize = 4096;

/// The numbers that components are stored as; the codes are those of OpenGL.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

/// Each component in the order of the enum: its code, its size, and the number for the largest code where
/// integers stand for −1 to 1 or 0 to 1.
const COMPONENTS: [(Component, u32, usize, f64); 6] = [
    (Component::I8, 5120, 1, 127.0),
    (Component::U8, 5121, 1, 255.0),
    (Component::I16, 5122, 2, 32767.0),
    (Component::U16, 5123, 2, 65535.0),
    (Component::U32, 5125, 4, u32::MAX as f64),
    (Component::F32, 5126, 4, 1.0),
];

impl Component {
    fn from_code(code: u32) -> Option<Self> {
        COMPONENTS.iter().find(|row| row.1 == code).map(|row| row.0)
    }

    fn size(self) -> usize {
        COMPONENTS[self as usize].2
    }

    /// The number for the largest code.
    pub(super) fn divisor(self) -> f64 {
        COMPONENTS[self as usize].3
    }
}

/// Elements that replace those of the buffer view.
struct Replaced<'a> {
    /// Ascending, below the number of rows.
    rows: Vec<u32>,
    values: &'a [u8],
}

/// An accessor whose bytes are all there.
pub(super) struct View<'a> {
    /// From the first element on; `None`: all 0.
    data: Option<&'a [u8]>,
    stride: usize,
    pub component: Component,
    pub normalized: bool,
    /// Components of an element.
    pub width: usize,
    /// Elements.
    pub rows: usize,
    replaced: Option<Replaced<'a>>,
}

/// The buffer views that an accessor reads.
pub(super) fn views_of(accessor: &Accessor) -> impl Iterator<Item = usize> {
    let sparse = accessor.sparse.as_deref();
    let sparse = sparse.map(|s| [s.indices.buffer_view, s.values.buffer_view]);
    accessor.buffer_view.into_iter().chain(sparse.into_iter().flatten())
}

impl<'a> View<'a> {
    /// Checks an accessor against the bytes of its buffer views. `name` is for messages.
    pub(super) fn open(
        document: &Document<'_>,
        buffers: &'a Buffers<'_>,
        index: usize,
        name: &str,
        path: &Path,
    ) -> Result<Self, SceneError> {
        let bad = |problem: String| {
            file_error(path, format!("accessor {index}, which is {name}, {problem}"))
        };
        let Some(accessor) = document.accessors.get(index) else {
            return Err(bad(format!("is missing: there are {}", document.accessors.len())));
        };
        let code = accessor.component_type;
        let component = Component::from_code(code)
            .ok_or_else(|| bad(format!("has the unknown component type {code}")))?;
        let width = match accessor.shape.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            other => return Err(bad(format!("is of type {other:?}"))),
        };
        let count = accessor.count;
        let rows = u32::try_from(count).map_err(|_| bad(format!("counts {count} elements")))?;
        let size = component.size() * width;
        let mut stride = size;
        let mut data = None;
        if let Some(view) = accessor.buffer_view {
            let bytes = buffers.view(document, view, path)?;
            // Exporters write 0 for a tightly packed view, too.
            if let Some(given @ 1..) = document.buffer_views.get(view).and_then(|v| v.byte_stride) {
                stride = usize::try_from(given).ok().filter(|&given| given >= size).ok_or_else(
                    || bad(format!("needs {size} bytes an element, the stride is {given}")),
                )?;
            }
            let start = usize::try_from(accessor.byte_offset).ok();
            let rest = start.and_then(|start| bytes.get(start..));
            let due = (rows as usize)
                .checked_sub(1)
                .map_or(Some(0), |before| before.checked_mul(stride)?.checked_add(size));
            data = rest.filter(|rest| due.is_some_and(|due| due <= rest.len()));
            if data.is_none() {
                return Err(bad(format!(
                    "has {count} elements every {stride} bytes from byte {} of buffer view {view}, \
                     which has {} bytes",
                    accessor.byte_offset,
                    bytes.len()
                )));
            }
        } else if accessor.sparse.is_none() {
            return Err(bad("has no bytes: an extension that is not read holds them".to_owned()));
        }
        let sparse = accessor.sparse.as_deref();
        let replaced = sparse
            .map(|sparse| Replaced::open(document, buffers, sparse, rows, size, path, &bad))
            .transpose()?;
        let normalized = accessor.normalized && component != Component::F32;
        Ok(Self { data, stride, component, normalized, width, rows: rows as usize, replaced })
    }

    /// Whether the values are floats, or integers that stand for fractions.
    pub(super) fn is_fraction(&self) -> bool {
        self.component == Component::F32 || self.normalized
    }

    /// Writes `components` of the elements `rows` to `out`, whose rows have `width` values, from
    /// value `at` on.
    fn decode(
        &self,
        rows: Range<usize>,
        components: Range<usize>,
        out: &mut [f32],
        width: usize,
        at: usize,
    ) {
        let first = rows.start;
        let places = || out_rows(width, at, components.len());
        if let Some(data) = self.data {
            let elements = rows.clone().map(|row| &data[row * self.stride..]);
            self.convert(elements.zip(out.chunks_exact_mut(width)), &components, places());
        } else {
            out.chunks_exact_mut(width).for_each(|row| row[places()].fill(0.0));
        }
        let Some(replaced) = &self.replaced else { return };
        let from = replaced.rows.partition_point(|&row| (row as usize) < rows.start);
        let to = replaced.rows.partition_point(|&row| (row as usize) < rows.end);
        let size = self.component.size() * self.width;
        for i in from..to {
            let row = replaced.rows[i] as usize - first;
            let place = &mut out[row * width..(row + 1) * width];
            let element = &replaced.values[i * size..];
            self.convert(std::iter::once((element, place)), &components, places());
        }
    }

    /// The first `W` values of an element.
    pub(super) fn row<const W: usize>(&self, row: usize) -> [f32; W] {
        let mut out = [0.0; W];
        self.decode(row..row + 1, 0..W, &mut out, W, 0);
        out
    }

    /// Converts elements one after the other.
    fn convert<'b>(
        &self,
        elements: impl Iterator<Item = (&'b [u8], &'b mut [f32])>,
        components: &Range<usize>,
        places: Range<usize>,
    ) {
        // One loop for each kind of number, so that the kind is not asked for each value.
        macro_rules! each {
            ($size:literal, $number:ty) => {
                for (element, out) in elements {
                    let numbers = element.as_chunks::<$size>().0[components.clone()].iter();
                    for (out, bytes) in out[places.clone()].iter_mut().zip(numbers) {
                        *out = self.scaled(f64::from(<$number>::from_le_bytes(*bytes)));
                    }
                }
            };
        }
        match self.component {
            Component::I8 => each!(1, i8),
            Component::U8 => each!(1, u8),
            Component::I16 => each!(2, i16),
            Component::U16 => each!(2, u16),
            Component::U32 => each!(4, u32),
            Component::F32 => each!(4, f32),
        }
    }

    fn scaled(&self, value: f64) -> f32 {
        // The most negative code would be below −1.
        if self.normalized {
            (value / self.component.divisor()).max(-1.0) as f32
        } else {
            value as f32
        }
    }

    /// Whether any value is below 0.
    pub(super) fn any_negative(&self) -> bool {
        let tasks = self.rows.div_ceil(ROWS_PER_TASK);
        (0..tasks).into_par_iter().any(|task| {
            let rows = task * ROWS_PER_TASK..((task + 1) * ROWS_PER_TASK).min(self.rows);
            let mut values = vec![0.0; rows.len() * self.width];
            self.decode(rows, 0..self.width, &mut values, self.width, 0);
            values.iter().any(|&v| v < 0.0)
        })
    }
}

fn out_rows(width: usize, at: usize, components: usize) -> Range<usize> {
    at..(at + components).min(width)
}

impl<'a> Replaced<'a> {
    fn open(
        document: &Document<'_>,
        buffers: &'a Buffers<'_>,
        sparse: &Sparse,
        rows: u32,
        size: usize,
        path: &Path,
        bad: &dyn Fn(String) -> SceneError,
    ) -> Result<Self, SceneError> {
        let count = usize::try_from(sparse.count).unwrap_or(usize::MAX);
        if count > rows as usize {
            return Err(bad(format!("replaces {count} elements of {rows}")));
        }
        let part = |view: usize, offset: u64, size: usize| {
            let bytes = buffers.view(document, view, path)?;
            let part = usize::try_from(offset).ok().and_then(|offset| bytes.get(offset..));
            let due = count.checked_mul(size);
            part.and_then(|part| part.get(..due?)).ok_or_else(|| {
                let has = bytes.len();
                bad(format!(
                    "replaces {count} elements by {size} bytes each from byte {offset} of buffer \
                     view {view}, which has {has} bytes"
                ))
            })
        };
        let indices = &sparse.indices;
        let code = indices.component_type;
        let unsigned = |c: &Component| matches!(c, Component::U8 | Component::U16 | Component::U32);
        let index_size = Component::from_code(code).filter(unsigned).map(Component::size);
        let index_size = index_size
            .ok_or_else(|| bad(format!("has replaced elements counted by type {code}")))?;
        let numbers = part(indices.buffer_view, indices.byte_offset, index_size)?;
        let values = part(sparse.values.buffer_view, sparse.values.byte_offset, size)?;
        let index = |bytes: &[u8]| bytes.iter().rev().fold(0u32, |n, &b| n << 8 | u32::from(b));
        let replaced: Vec<u32> = numbers.chunks_exact(index_size).map(index).collect();
        if let Some(pair) = replaced.windows(2).find(|pair| pair[0] >= pair[1]) {
            return Err(bad(format!("replaces element {} after {}", pair[1], pair[0])));
        }
        if let Some(last) = replaced.last().filter(|&&last| last >= rows) {
            return Err(bad(format!("replaces element {last} of {rows}")));
        }
        Ok(Self { rows: replaced, values })
    }
}

/// Components of an accessor and where they go.
pub(super) struct Column<'a, 'b> {
    pub view: &'b View<'a>,
    pub components: Range<usize>,
    /// First place in a row.
    pub at: usize,
}

/// Fills rows of `width` values; places that no column is for keep what they hold.
pub(super) fn fill(columns: &[Column<'_, '_>], out: &mut [f32], width: usize) {
    out.par_chunks_mut(ROWS_PER_TASK * width).enumerate().for_each(|(task, out)| {
        let first = task * ROWS_PER_TASK;
        let rows = first..first + out.len() / width;
        for column in columns {
            column.view.decode(rows.clone(), column.components.clone(), out, width, column.at);
        }
    });
}
