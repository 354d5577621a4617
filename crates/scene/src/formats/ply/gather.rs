//! Reading several groups of columns in one pass over the rows.

use super::layout::Cell;
use super::{PlyFile, PlyType};
use crate::SceneError;
use rayon::prelude::*;

/// Rows whose bytes stay in the innermost caches while every group takes its columns from them.
const ROWS_PER_BLOCK: usize = 256;
/// Rows of one task, a multiple of a block.
const ROWS_PER_TASK: usize = 8192;

/// Columns that belong together, and where their values go: all of them, or those of one task.
#[derive(Debug)]
struct Group<'a> {
    cells: Vec<Cell>,
    /// The words at which the cells begin, if all are little-endian floats at whole words.
    words: Option<Vec<usize>>,
    /// `[N, W]`, row by row.
    out: &'a mut [f32],
}

/// A pass over the rows of one element that fills any number of arrays.
pub(crate) struct Gather<'a> {
    file: &'a PlyFile,
    element: &'a str,
    groups: Vec<Group<'a>>,
}

impl<'a> Gather<'a> {
    /// A pass that fills nothing yet.
    pub(crate) fn new(file: &'a PlyFile, element: &'a str) -> Self {
        Self { file, element, groups: Vec::new() }
    }

    /// Fills `out`, row by row, with these columns as f32.
    ///
    /// # Errors
    /// If a property does not exist, the element has lists, or `out` has another size.
    pub(crate) fn add(
        &mut self,
        properties: &[&str],
        out: &'a mut [f32],
    ) -> Result<(), SceneError> {
        let (rows, cells) = self.file.rows(self.element, properties)?;
        if out.len() != rows.count * cells.len() {
            return Err(SceneError::RowCount {
                field: "column group",
                expected: rows.count * cells.len(),
                got: out.len(),
            });
        }
        if cells.is_empty() {
            return Ok(());
        }
        let whole = !self.file.big_endian
            && rows.stride.is_multiple_of(4)
            && cells.iter().all(|c| c.ty == PlyType::F32 && c.offset.is_multiple_of(4));
        let words = whole.then(|| cells.iter().map(|c| c.offset / 4).collect());
        self.groups.push(Group { cells, words, out });
        Ok(())
    }

    /// Does the pass, in parallel.
    ///
    /// # Errors
    /// If the element does not exist.
    pub(crate) fn run(self) -> Result<(), SceneError> {
        let (rows, _) = self.file.rows(self.element, &[])?;
        let big_endian = self.file.big_endian;
        let mut tasks: Vec<Vec<Group<'_>>> = Vec::new();
        tasks.resize_with(rows.count.div_ceil(ROWS_PER_TASK), Vec::new);
        for group in self.groups {
            let width = group.cells.len();
            let parts = group.out.chunks_mut(width * ROWS_PER_TASK);
            for (task, out) in tasks.iter_mut().zip(parts) {
                let (cells, words) = (group.cells.clone(), group.words.clone());
                task.push(Group { cells, words, out });
            }
        }
        // A row that has a cell to read is at least one byte wide.
        let stride = rows.stride.max(1);
        tasks.par_iter_mut().zip(rows.bytes.par_chunks(stride * ROWS_PER_TASK)).for_each(
            |(columns, bytes)| {
                for (block, bytes) in bytes.chunks(stride * ROWS_PER_BLOCK).enumerate() {
                    for group in columns.iter_mut() {
                        group.read(block * ROWS_PER_BLOCK, bytes, stride, big_endian);
                    }
                }
            },
        );
        Ok(())
    }
}

impl Group<'_> {
    fn read(&mut self, first: usize, bytes: &[u8], stride: usize, big_endian: bool) {
        let width = self.cells.len();
        let count = bytes.len() / stride;
        let out = &mut self.out[first * width..(first + count) * width];
        let Some(words) = &self.words else {
            for (out, row) in out.chunks_exact_mut(width).zip(bytes.chunks_exact(stride)) {
                for (value, cell) in out.iter_mut().zip(&self.cells) {
                    *value = cell.read_f32(row, big_endian);
                }
            }
            return;
        };
        let rows = bytes.as_chunks::<4>().0.chunks_exact(stride / 4);
        match *words.as_slice() {
            [a] => fixed(out, rows, [a]),
            [a, b, c] => fixed(out, rows, [a, b, c]),
            [a, b, c, d] => fixed(out, rows, [a, b, c, d]),
            _ => {
                for (out, row) in out.chunks_exact_mut(width).zip(rows) {
                    for (value, &word) in out.iter_mut().zip(words) {
                        *value = f32::from_le_bytes(row[word]);
                    }
                }
            }
        }
    }
}

/// As many columns as the compiler knows of.
fn fixed<'b, const W: usize>(
    out: &mut [f32],
    rows: impl Iterator<Item = &'b [[u8; 4]]>,
    words: [usize; W],
) {
    for (out, row) in out.as_chunks_mut::<W>().0.iter_mut().zip(rows) {
        *out = words.map(|word| f32::from_le_bytes(row[word]));
    }
}
