//! The PLY container: elements, typed columns, and a copy with columns added.
//!
//! Knows nothing of Gaussians: [`super::inria_ply`], [`super::compressed_ply`] and
//! [`super::labelled_ply`] give the columns their meaning. Reads `ascii`, `binary_little_endian`
//! and `binary_big_endian` files with elements and properties in any order. Lists, the
//! faces of meshes, are read by [`PlyFile::lists`]; columns come from elements without them.

mod ascii;
mod extra;
mod gather;
mod header;
mod layout;
mod lists;
mod positions;
mod raw_rows;
mod writer;

pub(crate) use extra::{ANTIALIASED, PlyNumbers, Remarks};
pub(crate) use gather::Gather;
pub use header::{PlyElement, PlyEncoding, PlyProperty, PlyPropertyKind, PlyType};
pub use lists::PlyLists;
pub(crate) use raw_rows::ByteRows;
pub(crate) use writer::{ColumnSource, NewElement, write_new_ply};
pub use writer::{
    ColumnValues, PlyColumn, free_column_name, warning_comment, write_ply_with_columns,
};

use super::memory;
use crate::input_file::{InputFile, filled};
use crate::value_policy::Rule;
use crate::{RepairReport, SceneError};
use header::{Header, parse_header};
use layout::{Cell, Layout, lay_out};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Rows that one task of a parallel read handles.
const ROWS_PER_TASK: usize = 4096;

/// An open PLY file.
///
/// Binary data stay in the file (it is mapped into memory) until a column is read; ascii data are
/// converted to binary once, when the file is opened. All sizes in the header have been checked
/// against the length of the file, so no later call can be made to reserve more than that.
pub struct PlyFile {
    path: PathBuf,
    header: Header,
    layouts: Vec<Layout>,
    data: Data,
    big_endian: bool,
    trailing_bytes: usize,
}

enum Data {
    Mapped(InputFile),
    /// What an ascii file says, as little-endian binary.
    Converted(Vec<u8>),
}

impl Data {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map.bytes(),
            Self::Converted(bytes) => bytes,
        }
    }
}

impl std::fmt::Debug for PlyFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PlyFile")
            .field("path", &self.path)
            .field("encoding", &self.header.encoding)
            .field("elements", &self.header.elements)
            .finish_non_exhaustive()
    }
}

/// Whether a file that begins with these bytes is PLY.
pub fn is_ply(head: &[u8]) -> bool {
    header::has_magic(head)
}

impl PlyFile {
    /// Opens a file and checks its header and its size.
    ///
    /// # Errors
    /// If the file cannot be read, is not PLY, is malformed, or is shorter than its header says.
    pub fn open(path: &Path) -> Result<Self, SceneError> {
        Self::open_mapped(InputFile::open(path)?)
    }

    /// As [`open`](Self::open), from a file that is mapped already.
    pub(crate) fn open_mapped(file: InputFile) -> Result<Self, SceneError> {
        let path = file.path().to_owned();
        Self::new(Data::Mapped(file), &path)
    }

    /// As [`open`](Self::open), from the bytes of a file, of which a copy is kept; `path` is for
    /// messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, SceneError> {
        Self::new(Data::Mapped(InputFile::from_bytes(bytes, path)), path)
    }

    /// As [`from_bytes`](Self::from_bytes), of bytes that are given away: they are not there twice.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_owned(bytes: Vec<u8>, path: &Path) -> Result<Self, SceneError> {
        Self::open_mapped(InputFile::owned(bytes, path))
    }

    fn new(mut data: Data, path: &Path) -> Result<Self, SceneError> {
        let header = parse_header(data.bytes(), path)?;
        let mut data_start = header.data_start;
        let mut leftover = None;
        if header.encoding == PlyEncoding::Ascii {
            let (binary, bytes) = ascii::to_binary(&data.bytes()[data_start..], &header, path)?;
            (data, data_start, leftover) = (Data::Converted(binary), 0, Some(bytes));
        }
        let mut file = Self {
            path: path.to_owned(),
            big_endian: header.encoding == PlyEncoding::BinaryBigEndian,
            header,
            layouts: Vec::new(),
            data,
            trailing_bytes: 0,
        };
        let (layouts, end) =
            lay_out(file.bytes(), data_start, &file.header.elements, file.big_endian, &file.path)?;
        file.layouts = layouts;
        file.trailing_bytes = match leftover {
            Some(bytes) => bytes,
            None => {
                let rest = &file.bytes()[end..];
                // One line end after the data is a habit of some writers, not lost data.
                if rest == b"\n" || rest == b"\r\n" { 0 } else { rest.len() }
            }
        };
        Ok(file)
    }

    /// Checks, after reading, that the file is as long as it was.
    ///
    /// # Errors
    /// If another process has changed its length.
    pub(crate) fn check_length(&self) -> Result<(), SceneError> {
        match &self.data {
            Data::Mapped(file) => file.check_length(),
            Data::Converted(_) => Ok(()),
        }
    }

    /// Where the file is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How the data are stored in the file.
    pub fn encoding(&self) -> PlyEncoding {
        self.header.encoding
    }

    /// The elements in the order of the file.
    pub fn elements(&self) -> &[PlyElement] {
        &self.header.elements
    }

    /// The element of that name.
    pub fn element(&self, name: &str) -> Option<&PlyElement> {
        self.header.elements.iter().find(|e| e.name == name)
    }

    /// The comments, without the word `comment`; bytes that are not UTF-8 are replaced.
    pub fn comments(&self) -> impl Iterator<Item = String> + '_ {
        self.header.comments()
    }

    /// Bytes after the last element: 0 unless the header counts too few rows.
    pub fn trailing_bytes(&self) -> usize {
        self.trailing_bytes
    }

    /// Reports bytes after the last of `rows` rows.
    pub(crate) fn report_trailing(&self, rows: usize, report: &mut RepairReport) {
        if self.trailing_bytes > 0 {
            let example = format!("{} bytes", self.trailing_bytes);
            report.add(Rule::FileTrailing, 1, rows, &example);
        }
    }

    /// One column as f32; integers and doubles are rounded to the nearest f32. `[N]`
    ///
    /// # Errors
    /// If the element or property does not exist, or the element has list properties.
    pub fn column_f32(&self, element: &str, property: &str) -> Result<Vec<f32>, SceneError> {
        self.table_f32(element, &[property])
    }

    /// One column as f64, exact for every PLY type. `[N]`
    ///
    /// # Errors
    /// As [`column_f32`](Self::column_f32).
    pub fn column_f64(&self, element: &str, property: &str) -> Result<Vec<f64>, SceneError> {
        let (rows, cells) = self.rows(element, &[property])?;
        self.read_column(&rows, cells[0], Cell::read_f64)
    }

    /// One column as i64. `[N]`
    ///
    /// # Errors
    /// As [`column_f32`](Self::column_f32), and if a float column holds a value that is not a
    /// whole number of i64.
    pub fn column_i64(&self, element: &str, property: &str) -> Result<Vec<i64>, SceneError> {
        let (rows, cells) = self.rows(element, &[property])?;
        if !cells[0].ty.is_float() {
            return self.read_column(&rows, cells[0], Cell::read_i64);
        }
        let values = self.read_column(&rows, cells[0], Cell::read_f64)?;
        let whole = |v: f64| v.fract() == 0.0 && v.abs() < 9.2e18;
        if let Some(row) = values.iter().position(|&v| !whole(v)) {
            return Err(SceneError::Value {
                path: self.path.clone(),
                element: row,
                field: property.to_owned(),
                value: values[row].to_string(),
                help: "the column must hold whole numbers".to_owned(),
            });
        }
        Ok(values.into_iter().map(|v| v as i64).collect())
    }

    /// One column of bytes, which must be stored as `uchar`. `[N]`
    ///
    /// # Errors
    /// As [`column_f32`](Self::column_f32), and if the column has another type.
    pub fn column_u8(&self, element: &str, property: &str) -> Result<Vec<u8>, SceneError> {
        let (rows, cells) = self.rows(element, &[property])?;
        if cells[0].ty != PlyType::U8 {
            return Err(SceneError::format(
                &self.path,
                format!("property {property} is {}, not uchar", cells[0].ty.name()),
                "",
            ));
        }
        self.read_column(&rows, cells[0], |cell, row, _| row[cell.offset])
    }

    /// Several columns as f32, row by row in one pass over the data. `[N, W]`
    ///
    /// # Errors
    /// As [`column_f32`](Self::column_f32).
    pub fn rows_f32<const W: usize>(
        &self,
        element: &str,
        properties: [&str; W],
    ) -> Result<Vec<[f32; W]>, SceneError> {
        let (rows, _) = self.rows(element, &properties)?;
        let mut out = memory::zeroed::<[f32; W]>(rows.count, &self.path)?;
        let mut pass = Gather::new(self, element);
        pass.add(&properties, out.as_flattened_mut())?;
        pass.run()?;
        Ok(out)
    }

    /// Several columns as f32, flattened row by row, in one pass over the data. `[N · W]`
    ///
    /// # Errors
    /// As [`column_f32`](Self::column_f32).
    pub fn table_f32(&self, element: &str, properties: &[&str]) -> Result<Vec<f32>, SceneError> {
        let (rows, cells) = self.rows(element, properties)?;
        if cells.is_empty() {
            return Ok(Vec::new());
        }
        let total = rows.count.saturating_mul(cells.len());
        let mut out = memory::zeroed::<f32>(total, &self.path)?;
        let mut pass = Gather::new(self, element);
        pass.add(properties, &mut out)?;
        pass.run()?;
        Ok(out)
    }

    /// The bytes of the data, which need not start at the first row.
    fn bytes(&self) -> &[u8] {
        self.data.bytes()
    }

    /// Finds the rows of an element and the cells of some of its properties.
    fn rows(
        &self,
        element: &str,
        properties: &[&str],
    ) -> Result<(Rows<'_>, Vec<Cell>), SceneError> {
        let Some(index) = self.header.elements.iter().position(|e| e.name == element) else {
            let known: Vec<_> = self.header.elements.iter().map(|e| e.name.as_str()).collect();
            return Err(SceneError::format(
                &self.path,
                format!("has no element {element}; it has: {}", known.join(", ")),
                "",
            ));
        };
        let about = &self.header.elements[index];
        let layout = &self.layouts[index];
        if let Some(list) = about.properties.iter().find(|p| p.is_list()) {
            return Err(SceneError::format(
                &self.path,
                format!("element {element} has the list property {}", list.name),
                "columns can only be read from elements without lists; export it without",
            ));
        }
        let cells = properties
            .iter()
            .map(|&name| {
                let at = about.properties.iter().position(|p| p.name == name);
                at.and_then(|i| layout.cells.get(i).copied()).ok_or_else(|| {
                    SceneError::format(
                        &self.path,
                        format!("element {element} has no property {name}"),
                        "",
                    )
                })
            })
            .collect::<Result<Vec<_>, _>>()?;
        let bytes = &self.bytes()[layout.start..layout.end];
        Ok((Rows { bytes, stride: layout.stride, count: about.count }, cells))
    }

    fn read_column<T: Copy + Default + Send + Sync>(
        &self,
        rows: &Rows<'_>,
        cell: Cell,
        read: impl Fn(Cell, &[u8], bool) -> T + Sync,
    ) -> Result<Vec<T>, SceneError> {
        let mut out = filled(rows.count, T::default(), &self.path)?;
        // A row that has a cell to read is at least one byte wide.
        let stride = rows.stride.max(1);
        let parts = rows.bytes.par_chunks(stride * ROWS_PER_TASK);
        out.par_chunks_mut(ROWS_PER_TASK).zip(parts).for_each(|(out, bytes)| {
            for (out, row) in out.iter_mut().zip(bytes.chunks_exact(stride)) {
                *out = read(cell, row, self.big_endian);
            }
        });
        Ok(out)
    }
}

/// The rows of an element without lists.
struct Rows<'a> {
    bytes: &'a [u8],
    stride: usize,
    count: usize,
}
