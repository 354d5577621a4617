//! Columns of unknown meaning, copied as they are.

use super::{ColumnSource, PlyElement, PlyFile, PlyType};
use crate::extra_columns::{ExtraColumn, NumberType, UnreadColumn};
use crate::input_file::reserve;
use crate::{RepairReport, SceneError};
use std::borrow::Cow;

impl PlyFile {
    /// These columns of an element, in one pass over the data.
    ///
    /// # Errors
    /// As [`column_f32`](Self::column_f32).
    pub(crate) fn extra_columns(
        &self,
        element: &str,
        names: &[&str],
    ) -> Result<Vec<ExtraColumn>, SceneError> {
        let (rows, cells) = self.rows(element, names)?;
        let mut columns = Vec::with_capacity(names.len());
        for (name, cell) in names.iter().zip(&cells) {
            let mut bytes = Vec::new();
            reserve(&mut bytes, rows.count * cell.ty.size(), &self.path)?;
            let (name, ty) = ((*name).to_owned(), number_type(cell.ty));
            columns.push(ExtraColumn { name, ty, row_shape: Vec::new(), bytes });
        }
        if cells.is_empty() {
            return Ok(columns);
        }
        for row in rows.bytes.chunks_exact(rows.stride) {
            for (cell, column) in cells.iter().zip(&mut columns) {
                let value = &row[cell.offset..][..cell.ty.size()];
                match self.big_endian {
                    true => column.bytes.extend(value.iter().rev()),
                    false => column.bytes.extend_from_slice(value),
                }
            }
        }
        Ok(columns)
    }

    /// The columns of an element, and the other elements, that a reader passes over: `is_read` says which
    /// columns it knows, `elements` which elements. Columns are kept if `keep` says so; the others are
    /// named.
    ///
    /// # Errors
    /// As [`column_f32`](Self::column_f32).
    pub(crate) fn unknown(
        &self,
        element: &PlyElement,
        is_read: impl Fn(&str) -> bool,
        elements: &[&str],
        keep: bool,
    ) -> Result<(Vec<ExtraColumn>, Vec<UnreadColumn>), SceneError> {
        let unknown = element.properties.iter().filter(|p| !is_read(&p.name));
        let names: Vec<&str> = unknown.map(|p| p.name.as_str()).collect();
        let (mut kept, mut unread) = (Vec::new(), Vec::new());
        if keep {
            kept = self.extra_columns(&element.name, &names)?;
        } else {
            let kind = |name: &str| self.type_of(element, name).map_or("list", PlyType::name);
            let named = |name: &&str| UnreadColumn::of_numbers(name, kind(name).to_owned(), true);
            unread.extend(names.iter().map(named));
        }
        for other in self.elements().iter().filter(|e| e.name != element.name) {
            if !elements.contains(&other.name.as_str()) {
                let kind = format!("an element of {} rows beside the vertices", other.count);
                unread.push(UnreadColumn::other(&other.name, kind));
            }
        }
        Ok((kept, unread))
    }

    fn type_of(&self, element: &PlyElement, name: &str) -> Option<PlyType> {
        let (_, cells) = self.rows(&element.name, &[name]).ok()?;
        cells.first().map(|cell| cell.ty)
    }
}

fn number_type(ty: PlyType) -> NumberType {
    match ty {
        PlyType::I8 | PlyType::I16 | PlyType::I32 => NumberType::Int(ty.size() as u8),
        PlyType::U8 | PlyType::U16 | PlyType::U32 => NumberType::UInt(ty.size() as u8),
        PlyType::F32 | PlyType::F64 => NumberType::Float(ty.size() as u8),
    }
}

/// Numbers of a column as PLY has them.
pub(crate) struct PlyNumbers<'a> {
    ty: PlyType,
    bytes: Cow<'a, [u8]>,
    width: usize,
    /// Rows whose numbers do not fit any type of PLY exactly, and the first of them.
    pub(crate) rounded: (usize, usize),
}

impl<'a> PlyNumbers<'a> {
    /// Types that PLY lacks become the next larger: halves `float`, integers of 64 bits `int` where all
    /// fit, else `double`.
    pub(crate) fn of(column: &'a ExtraColumn) -> Self {
        let (width, rounded) = (column.width(), (0, 0));
        let as_is = |ty| Self { ty, bytes: Cow::Borrowed(&column.bytes), width, rounded };
        match column.ty {
            NumberType::Bool | NumberType::UInt(1) => as_is(PlyType::U8),
            NumberType::UInt(2) => as_is(PlyType::U16),
            NumberType::UInt(4) => as_is(PlyType::U32),
            NumberType::Int(1) => as_is(PlyType::I8),
            NumberType::Int(2) => as_is(PlyType::I16),
            NumberType::Int(4) => as_is(PlyType::I32),
            NumberType::Float(4) => as_is(PlyType::F32),
            NumberType::Float(8) => as_is(PlyType::F64),
            NumberType::Float(_) => {
                let halves = column.bytes.as_chunks::<2>().0.iter();
                let wide =
                    halves.flat_map(|half| half::f16::from_le_bytes(*half).to_f32().to_le_bytes());
                Self { ty: PlyType::F32, bytes: wide.collect(), width, rounded }
            }
            NumberType::Int(_) | NumberType::UInt(_) => Self::of_long(column, width),
        }
    }

    fn of_long(column: &ExtraColumn, width: usize) -> Self {
        let signed = matches!(column.ty, NumberType::Int(_));
        let whole = |bytes: &[u8; 8]| match signed {
            true => i128::from(i64::from_le_bytes(*bytes)),
            false => i128::from(u64::from_le_bytes(*bytes)),
        };
        let values = || column.bytes.as_chunks::<8>().0.iter().map(whole);
        if values().all(|v| i32::try_from(v).is_ok()) {
            let bytes = values().flat_map(|v| (v as i32).to_le_bytes()).collect();
            return Self { ty: PlyType::I32, bytes, width, rounded: (0, 0) };
        }
        let inexact = |row: &[[u8; 8]]| row.iter().map(whole).any(|v| v as f64 as i128 != v);
        let mut rows = column.bytes.as_chunks::<8>().0.chunks_exact(width.max(1));
        let count = rows.clone().filter(|row| inexact(row)).count();
        let rounded = (count, rows.position(inexact).unwrap_or(0));
        let bytes = values().flat_map(|v| (v as f64).to_le_bytes()).collect();
        Self { ty: PlyType::F64, bytes, width, rounded }
    }

    /// The columns of the file, of these names: one for each number of a row.
    pub(crate) fn columns<'b>(
        &'b self,
        names: &'b [String],
    ) -> impl Iterator<Item = (String, ColumnSource<'b>)> {
        let source =
            |at| ColumnSource::Bytes { ty: self.ty, bytes: &self.bytes, width: self.width, at };
        names.iter().enumerate().map(move |(at, name)| (name.clone(), source(at)))
    }
}

/// What the comments of a file say that has a meaning.
#[derive(Debug, Default)]
pub(crate) struct Remarks {
    /// Whether the scene was trained for antialiased rendering.
    pub(crate) antialiased: Option<bool>,
    /// The way up, as it is written.
    pub(crate) vertical_axis: Option<String>,
}

/// The comment that marks a scene as antialiased, in Brush's words, which others have taken over.
pub(crate) const ANTIALIASED: &str = "SplatRenderMode: mip";

impl PlyFile {
    /// Reads the comments: Brush's `SplatRenderMode: mip`, Postshot's `antialiased 1`,
    /// `train_flags antialiasing`, of which the last counts, and `Vertical axis: z`.
    pub(crate) fn remarks(&self, report: &mut RepairReport) -> Remarks {
        let mut remarks = Remarks::default();
        for comment in self.comments() {
            let text = comment.trim().to_ascii_lowercase();
            let (key, value) = text.split_once([':', ' ', '=']).unwrap_or((&text, ""));
            let value = value.trim_start_matches([':', '=', ' ']).trim();
            match (key.trim(), value) {
                ("splatrendermode", "mip") | ("antialiased", "1" | "true") => {
                    remarks.antialiased = Some(true);
                }
                ("splatrendermode", "default") | ("antialiased", "0" | "false") => {
                    remarks.antialiased = Some(false);
                }
                ("train_flags", flags) => {
                    remarks.antialiased = Some(flags.split(' ').any(|f| f == "antialiasing"));
                }
                ("splatrendermode", mode) => {
                    let text =
                        format!("trained for the rendering mode {mode}, which is not known here");
                    report.notes.push(text);
                }
                _ => {
                    let axis =
                        text.split_once(':').filter(|(name, _)| name.trim() == "vertical axis");
                    if let Some((_, axis)) = axis {
                        remarks.vertical_axis.get_or_insert(axis.trim().to_owned());
                    }
                }
            }
        }
        remarks
    }
}
