//! Rows of a PLY element read where they lie, without columns in between.

use super::layout::Cell;
use super::{PlyFile, PlyType};
use crate::SceneError;

/// Integer cells of every row, as 32-bit words.
pub(crate) struct WordRows<'a, const W: usize> {
    bytes: &'a [u8],
    stride: usize,
    cells: [Cell; W],
    big_endian: bool,
}

impl<const W: usize> WordRows<'_, W> {
    /// The words of a row of the element.
    #[inline]
    pub(crate) fn get(&self, row: usize) -> [u32; W] {
        let row = &self.bytes[row * self.stride..][..self.stride];
        self.cells.map(|cell| match cell.ty {
            PlyType::U32 => cell.read_u32(row, self.big_endian),
            // A word is 32 bits whether the file calls it signed or not.
            _ => cell.read_i64(row, self.big_endian) as u32,
        })
    }
}

/// `uchar` cells of every row.
pub(crate) struct ByteRows<'a> {
    bytes: &'a [u8],
    stride: usize,
    offsets: Vec<usize>,
}

impl ByteRows<'_> {
    /// The bytes of a row of the element, in the order they were asked for.
    #[inline]
    pub(crate) fn get(&self, row: usize) -> impl Iterator<Item = u8> {
        let row = &self.bytes[row * self.stride..][..self.stride];
        self.offsets.iter().map(|&at| row[at])
    }
}

impl PlyFile {
    /// The rows of integer properties, to be read one by one.
    ///
    /// # Errors
    /// As [`column_f32`](Self::column_f32), and if a property holds floats.
    pub(crate) fn word_rows<const W: usize>(
        &self,
        element: &str,
        properties: [&str; W],
    ) -> Result<WordRows<'_, W>, SceneError> {
        let (rows, found) = self.rows(element, &properties)?;
        if let Some(i) = found.iter().position(|cell| cell.ty.is_float()) {
            let (name, ty) = (properties[i], found[i].ty.name());
            let problem = format!("property {name} of element {element} is {ty}, not uint");
            return Err(SceneError::format(&self.path, problem, "export the scene again"));
        }
        let cells = std::array::from_fn(|i| found[i]);
        let big_endian = self.big_endian;
        Ok(WordRows { bytes: rows.bytes, stride: rows.stride, cells, big_endian })
    }

    /// The rows of `uchar` properties, to be read one by one; `None` if one has another type.
    ///
    /// # Errors
    /// As [`column_f32`](Self::column_f32).
    pub(crate) fn byte_rows(
        &self,
        element: &str,
        properties: &[&str],
    ) -> Result<Option<ByteRows<'_>>, SceneError> {
        let (rows, cells) = self.rows(element, properties)?;
        if cells.iter().any(|cell| cell.ty != PlyType::U8) {
            return Ok(None);
        }
        let offsets = cells.iter().map(|cell| cell.offset).collect();
        Ok(Some(ByteRows { bytes: rows.bytes, stride: rows.stride, offsets }))
    }

    /// All bytes of the file, header included; `None` for ascii files, which are not kept as such.
    pub(crate) fn file_bytes(&self) -> Option<&[u8]> {
        match &self.data {
            super::Data::Mapped(map) => Some(map.bytes()),
            super::Data::Converted(_) => None,
        }
    }
}
