//! Where the values of a binary PLY file are.

use super::header::{PlyElement, PlyPropertyKind, PlyType};
use crate::SceneError;
use std::path::Path;

/// Where a scalar is within a row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    pub(super) offset: usize,
    pub(super) ty: PlyType,
}

/// Where the rows of an element are.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    pub(super) start: usize,
    pub(super) end: usize,
    /// Bytes of a row; 0 where rows hold lists and so differ in length.
    pub(super) stride: usize,
    /// One per property; empty where rows hold lists.
    pub(super) cells: Vec<Cell>,
}

/// The bytes at `offset`, least significant first.
fn take<const W: usize>(row: &[u8], offset: usize, big_endian: bool) -> [u8; W] {
    let mut out = [0; W];
    // Layouts are checked against the file, so the range is always there.
    if let Some(bytes) = row.get(offset..offset + W) {
        out.copy_from_slice(bytes);
    }
    if big_endian {
        out.reverse();
    }
    out
}

impl Cell {
    #[inline]
    pub(super) fn read_f32(self, row: &[u8], big_endian: bool) -> f32 {
        match self.ty {
            PlyType::F32 => f32::from_le_bytes(take(row, self.offset, big_endian)),
            PlyType::F64 => f64::from_le_bytes(take(row, self.offset, big_endian)) as f32,
            _ => self.read_i64(row, big_endian) as f32,
        }
    }

    pub(super) fn read_f64(self, row: &[u8], big_endian: bool) -> f64 {
        match self.ty {
            PlyType::F32 => f64::from(f32::from_le_bytes(take(row, self.offset, big_endian))),
            PlyType::F64 => f64::from_le_bytes(take(row, self.offset, big_endian)),
            // Every PLY integer has at most 32 bits, so this is exact.
            _ => self.read_i64(row, big_endian) as f64,
        }
    }

    /// The value of a cell of 32 bits.
    #[inline]
    pub(super) fn read_u32(self, row: &[u8], big_endian: bool) -> u32 {
        u32::from_le_bytes(take(row, self.offset, big_endian))
    }

    /// The value of an integer cell; a float is cut to its whole part.
    pub(super) fn read_i64(self, row: &[u8], big_endian: bool) -> i64 {
        let (at, big) = (self.offset, big_endian);
        match self.ty {
            PlyType::I8 => i64::from(i8::from_le_bytes(take(row, at, big))),
            PlyType::U8 => i64::from(u8::from_le_bytes(take(row, at, big))),
            PlyType::I16 => i64::from(i16::from_le_bytes(take(row, at, big))),
            PlyType::U16 => i64::from(u16::from_le_bytes(take(row, at, big))),
            PlyType::I32 => i64::from(i32::from_le_bytes(take(row, at, big))),
            PlyType::U32 => i64::from(u32::from_le_bytes(take(row, at, big))),
            PlyType::F32 => f32::from_le_bytes(take(row, at, big)) as i64,
            PlyType::F64 => f64::from_le_bytes(take(row, at, big)) as i64,
        }
    }
}

/// Lays the elements out one after the other from `start`; also gives the end of the last one.
pub(super) fn lay_out(
    bytes: &[u8],
    start: usize,
    elements: &[PlyElement],
    big_endian: bool,
    path: &Path,
) -> Result<(Vec<Layout>, usize), SceneError> {
    let mut layouts = Vec::with_capacity(elements.len());
    let mut at = start;
    for element in elements {
        let mut cells = Vec::with_capacity(element.properties.len());
        let mut width = 0usize;
        let mut has_lists = false;
        for property in &element.properties {
            match property.kind {
                PlyPropertyKind::Scalar(ty) => {
                    cells.push(Cell { offset: width, ty });
                    width += ty.size();
                }
                PlyPropertyKind::List { count, .. } => {
                    has_lists = true;
                    width += count.size();
                }
            }
        }
        let left = bytes.len().saturating_sub(at);
        // `width` is the size of a row, or the least it can be where lists are empty.
        let needed = element.count.checked_mul(width).filter(|&n| n <= left);
        let Some(needed) = needed else {
            return Err(too_short(path, element, width, left, has_lists));
        };
        let (stride, end) = if has_lists {
            cells.clear();
            let end = walk_lists(bytes, at, element, big_endian)
                .ok_or_else(|| too_short(path, element, width, left, true))?;
            (0, end)
        } else {
            (width, at + needed)
        };
        layouts.push(Layout { start: at, end, stride, cells });
        at = end;
    }
    Ok((layouts, at))
}

fn too_short(
    path: &Path,
    element: &PlyElement,
    width: usize,
    left: usize,
    has_lists: bool,
) -> SceneError {
    let at_least = if has_lists { "at least " } else { "" };
    SceneError::format(
        path,
        format!(
            "element {} should have {} rows of {at_least}{width} bytes, but only {left} bytes of \
             data are left in the file",
            element.name, element.count
        ),
        "the file is cut short, or its header counts too many rows",
    )
}

/// The end of an element with list properties; `None` if it runs past the end of the file.
fn walk_lists(bytes: &[u8], start: usize, element: &PlyElement, big_endian: bool) -> Option<usize> {
    let mut at = start;
    // Every row is at least one byte (the count of a list), so the walk is bounded by the file.
    for _ in 0..element.count {
        for property in &element.properties {
            match property.kind {
                PlyPropertyKind::Scalar(ty) => at = at.checked_add(ty.size())?,
                PlyPropertyKind::List { count, item } => {
                    let end = at.checked_add(count.size())?;
                    let cell = Cell { offset: 0, ty: count };
                    let length = cell.read_i64(bytes.get(at..end)?, big_endian);
                    let length = usize::try_from(length).ok()?;
                    at = end.checked_add(length.checked_mul(item.size())?)?;
                }
            }
        }
        if at > bytes.len() {
            return None;
        }
    }
    Some(at)
}
