//! Writing PLY files, always as `binary_little_endian`.

use super::PlyFile;
use super::header::{HeaderLine, PlyElement, PlyProperty, PlyPropertyKind, PlyType};
use super::layout::{Cell, Layout};
use crate::AtomicFile;
use crate::SceneError;
use crate::disk::write_all_at;
use crate::formats::WriteProgress;
use half::f16;
use rayon::prelude::*;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Rows gathered before they are handed to the file.
const ROWS_PER_WRITE: usize = 8192;
/// Such blocks between two reports of progress, in parallel: some 10 ms of work.
const WRITES_PER_TICK: usize = 64;

/// The element whose columns are changed.
const VERTEX: &str = "vertex";

/// The values of a column, borrowed. `[N]`
#[derive(Debug, Clone, Copy)]
pub enum ColumnValues<'a> {
    /// Written as `uchar`.
    U8(&'a [u8]),
    /// Written as `int`.
    I32(&'a [i32]),
    /// Written as `float`.
    F32(&'a [f32]),
}

impl ColumnValues<'_> {
    fn len(&self) -> usize {
        match self {
            Self::U8(v) => v.len(),
            Self::I32(v) => v.len(),
            Self::F32(v) => v.len(),
        }
    }

    fn ty(&self) -> PlyType {
        match self {
            Self::U8(_) => PlyType::U8,
            Self::I32(_) => PlyType::I32,
            Self::F32(_) => PlyType::F32,
        }
    }

    /// Replaces a value of the same type, or a `double` by a float.
    fn overwrite(&self, row: usize, old: &mut [u8]) {
        match self {
            Self::U8(v) => old.copy_from_slice(&[v[row]]),
            Self::I32(v) => old.copy_from_slice(&v[row].to_le_bytes()),
            Self::F32(v) if old.len() == 8 => {
                old.copy_from_slice(&f64::from(v[row]).to_le_bytes());
            }
            Self::F32(v) => old.copy_from_slice(&v[row].to_le_bytes()),
        }
    }

    fn push(&self, row: usize, out: &mut Vec<u8>) {
        match self {
            Self::U8(v) => out.push(v[row]),
            Self::I32(v) => out.extend_from_slice(&v[row].to_le_bytes()),
            Self::F32(v) => out.extend_from_slice(&v[row].to_le_bytes()),
        }
    }
}

/// A column to write: one value per vertex.
#[derive(Debug, Clone, Copy)]
pub struct PlyColumn<'a> {
    /// Name of the property.
    pub name: &'a str,
    /// One value per vertex.
    pub values: ColumnValues<'a>,
}

/// `wanted`, or `wanted_2`, `wanted_3` … if the vertices of `file` already have such a property.
pub fn free_column_name(file: &PlyFile, wanted: &str) -> String {
    let Some(vertex) = file.element(VERTEX) else { return wanted.to_owned() };
    let mut name = wanted.to_owned();
    let mut number = 2u64;
    while vertex.property(&name).is_some() {
        name = format!("{wanted}_{number}");
        number += 1;
    }
    name
}

/// Copies a PLY file with columns of its vertices replaced or added.
///
/// Every element, property, comment and value of the source is kept, vertex for vertex and bit for
/// bit, but for the columns in `replace` and the warnings of an earlier copy ([`warning_comment`]).
/// The columns in `append` follow the properties of the vertices, and `warnings` are comments. The copy is `binary_little_endian` whatever the source is, and streamed: memory does
/// not grow with the file. `out` may be the source itself: it is replaced when the copy is complete.
///
/// # Errors
/// If a column has the wrong number of rows, a name in `append` is taken (see
/// [`free_column_name`]) or not a word, a column in `replace` does not exist or is of another type
/// (f32 values may replace a `double`), or the file cannot be written; then nothing is left behind.
pub fn write_ply_with_columns(
    source: &PlyFile,
    replace: &[PlyColumn<'_>],
    append: &[PlyColumn<'_>],
    warnings: &[String],
    out: &Path,
) -> Result<(), SceneError> {
    let bad = |problem: String, help: &str| SceneError::format(&source.path, problem, help);
    let index = source.header.elements.iter().position(|e| e.name == VERTEX);
    let index = index.ok_or_else(|| bad("has no element vertex".to_owned(), ""))?;
    let element = &source.header.elements[index];
    let layout = &source.layouts[index];
    if element.properties.iter().any(PlyProperty::is_list) {
        return Err(bad("its vertices have list properties".to_owned(), "export it without lists"));
    }
    check_new_columns(element, append, &source.path)?;
    let replaced = replacements(source, element, layout, replace)?;

    // Little-endian rows are copied as they are but for these cells.
    let cells = layout.cells.iter().zip(&replaced);
    let changed: Vec<_> = cells.filter(|(_, new)| new.is_some() || source.big_endian).collect();

    let file = AtomicFile::create(out)?;
    let mut to = BufWriter::with_capacity(1 << 20, file.file());
    let write_failed = || SceneError::io(file.target(), "cannot write the file");
    to.write_all(&copied_header(source, index, append, warnings)).map_err(write_failed())?;
    for (i, layout) in source.layouts.iter().enumerate() {
        let bytes = &source.bytes()[layout.start..layout.end];
        if i == index {
            let row_of = |row: usize, buffer: &mut Vec<u8>| {
                let start = buffer.len();
                buffer.extend_from_slice(&bytes[row * layout.stride..][..layout.stride]);
                for (cell, new) in &changed {
                    let value = &mut buffer[start + cell.offset..][..cell.ty.size()];
                    match new {
                        Some(new) => new.overwrite(row, value),
                        None => value.reverse(),
                    }
                }
                append.iter().for_each(|column| column.values.push(row, buffer));
            };
            let mut buffer = Vec::new();
            for first in (0..element.count).step_by(ROWS_PER_WRITE) {
                buffer.clear();
                let rows = first..(first + ROWS_PER_WRITE).min(element.count);
                rows.for_each(|row| row_of(row, &mut buffer));
                to.write_all(&buffer).map_err(write_failed())?;
            }
        } else if source.big_endian {
            write_swapped(bytes, &source.header.elements[i], &mut to).map_err(write_failed())?;
        } else {
            to.write_all(bytes).map_err(write_failed())?;
        }
    }
    to.flush().map_err(write_failed())?;
    drop(to);
    Ok(file.commit()?)
}

/// The new values of each property of the vertices.
fn replacements<'a>(
    source: &PlyFile,
    element: &PlyElement,
    layout: &Layout,
    replace: &[PlyColumn<'a>],
) -> Result<Vec<Option<ColumnValues<'a>>>, SceneError> {
    let bad = |problem: String, help: &str| Err(SceneError::format(&source.path, problem, help));
    let mut replaced = vec![None; element.properties.len()];
    for column in replace {
        check_rows(column, element.count, &source.path)?;
        let (name, new) = (column.name, column.values.ty());
        let Some(at) = element.properties.iter().position(|p| p.name == name) else {
            return bad(format!("has no property {name} to replace"), "append it instead");
        };
        let old = layout.cells[at].ty;
        if old != new && (old, new) != (PlyType::F64, PlyType::F32) {
            let (old, new) = (old.name(), new.name());
            let problem = format!("property {name} is {old}, {new} values do not fit");
            return bad(problem, "append a column of another name instead");
        }
        if replaced[at].replace(column.values).is_some() {
            return bad(format!("property {name} is to be replaced twice"), "");
        }
    }
    Ok(replaced)
}

/// What the comments that hold warnings begin with.
const WARNING: &str = "scenesplat warning: ";

/// What a reader of the file must know of the values in it, as a comment of a PLY file: one line, without the word
/// `comment`.
pub fn warning_comment(text: &str) -> String {
    let line = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    WARNING.chars().chain(line).collect()
}

/// The header of the source with another encoding, further properties and these warnings alone.
fn copied_header(
    source: &PlyFile,
    index: usize,
    append: &[PlyColumn<'_>],
    warnings: &[String],
) -> Vec<u8> {
    let header = &source.header;
    let mut out = b"ply\n".to_vec();
    let mut line = |text: &[u8]| {
        out.extend_from_slice(text);
        out.push(b'\n');
    };
    // The new properties come where the element's last one is, before any later remark.
    let last = header.elements[index].properties.len().checked_sub(1);
    let new: Vec<String> =
        append.iter().map(|c| format!("property {} {}", c.values.ty().name(), c.name)).collect();
    for about in &header.lines {
        match about {
            HeaderLine::Format => {
                line(b"format binary_little_endian 1.0");
                let comments = warnings.iter().map(|text| warning_comment(text));
                comments.for_each(|text| line(format!("comment {text}").as_bytes()));
            }
            HeaderLine::Remark(text) if is_warning(text) => {}
            HeaderLine::Remark(text) => line(text),
            HeaderLine::Element(i) => {
                let element = &header.elements[*i];
                line(format!("element {} {}", element.name, element.count).as_bytes());
                if *i == index && last.is_none() {
                    new.iter().for_each(|text| line(text.as_bytes()));
                }
            }
            HeaderLine::Property(i, j) => {
                let property = &header.elements[*i].properties[*j];
                let text = match property.kind {
                    PlyPropertyKind::Scalar(ty) => {
                        format!("property {} {}", ty.name(), property.name)
                    }
                    PlyPropertyKind::List { count, item } => {
                        format!("property list {} {} {}", count.name(), item.name(), property.name)
                    }
                };
                line(text.as_bytes());
                if *i == index && Some(*j) == last {
                    new.iter().for_each(|text| line(text.as_bytes()));
                }
            }
        }
    }
    line(b"end_header");
    out
}

/// Whether a line of a header is a warning of an earlier copy.
fn is_warning(line: &[u8]) -> bool {
    line.strip_prefix(b"comment ").is_some_and(|text| text.starts_with(WARNING.as_bytes()))
}

fn check_new_columns(
    element: &PlyElement,
    append: &[PlyColumn<'_>],
    path: &Path,
) -> Result<(), SceneError> {
    for (i, column) in append.iter().enumerate() {
        check_rows(column, element.count, path)?;
        check_name(column.name, path)?;
        let taken = element.property(column.name).is_some()
            || append[..i].iter().any(|other| other.name == column.name);
        if taken {
            let problem = format!("already has a property {}", column.name);
            return Err(SceneError::format(path, problem, "choose another name for the new one"));
        }
    }
    Ok(())
}

fn check_name(name: &str, path: &Path) -> Result<(), SceneError> {
    if name.is_empty() || name.chars().any(|c| c.is_whitespace() || c.is_control()) {
        let problem = format!("{name:?} cannot be the name of a PLY property");
        return Err(SceneError::format(path, problem, "use one word"));
    }
    Ok(())
}

fn check_rows(column: &PlyColumn<'_>, count: usize, path: &Path) -> Result<(), SceneError> {
    if column.values.len() == count {
        return Ok(());
    }
    let problem =
        format!("column {} has {} rows for {count} vertices", column.name, column.values.len());
    Err(SceneError::format(path, problem, ""))
}

/// Writes a big-endian element as little-endian.
fn write_swapped(bytes: &[u8], element: &PlyElement, to: &mut impl Write) -> std::io::Result<()> {
    let mut at = 0;
    let mut turn = |size: usize, at: &mut usize| -> std::io::Result<()> {
        let mut value = [0; 8];
        value[..size].copy_from_slice(&bytes[*at..*at + size]);
        value[..size].reverse();
        *at += size;
        to.write_all(&value[..size])
    };
    // A row of an element without properties has no bytes, however many rows there are.
    let rows = if element.properties.is_empty() { 0 } else { element.count };
    for _ in 0..rows {
        for property in &element.properties {
            match property.kind {
                PlyPropertyKind::Scalar(ty) => turn(ty.size(), &mut at)?,
                PlyPropertyKind::List { count, item } => {
                    let cell = Cell { offset: 0, ty: count };
                    let length = cell.read_i64(&bytes[at..], true);
                    turn(count.size(), &mut at)?;
                    for _ in 0..length {
                        turn(item.size(), &mut at)?;
                    }
                }
            }
        }
    }
    Ok(())
}

/// Where the values of a new column come from.
pub(crate) enum ColumnSource<'a> {
    /// One value per row.
    Values(ColumnValues<'a>),
    /// Every `width`-th value from `at` on.
    Strided { values: &'a [f32], width: usize, at: usize },
    /// As `Strided`, each value plus `add`, written as `double`.
    Placed { values: &'a [f32], width: usize, at: usize, add: f64 },
    /// As `Strided`, written as `float`.
    StridedHalf { values: &'a [f16], width: usize, at: usize },
    /// Of rows of `width` values of this type, least significant byte first, the one at `at`.
    Bytes { ty: PlyType, bytes: &'a [u8], width: usize, at: usize },
    /// `0.0` in every row.
    Zero,
}

impl ColumnSource<'_> {
    fn ty(&self) -> PlyType {
        match self {
            Self::Values(values) => values.ty(),
            Self::Placed { .. } => PlyType::F64,
            Self::Bytes { ty, .. } => *ty,
            _ => PlyType::F32,
        }
    }

    fn push(&self, row: usize, out: &mut Vec<u8>) {
        match self {
            Self::Values(values) => values.push(row, out),
            Self::Strided { values, width, at } => {
                out.extend_from_slice(&values[row * width + at].to_le_bytes());
            }
            Self::Placed { values, width, at, add } => {
                let value = f64::from(values[row * width + at]) + add;
                out.extend_from_slice(&value.to_le_bytes());
            }
            Self::StridedHalf { values, width, at } => {
                out.extend_from_slice(&values[row * width + at].to_f32().to_le_bytes());
            }
            Self::Bytes { ty, bytes, width, at } => {
                out.extend_from_slice(&bytes[(row * width + at) * ty.size()..][..ty.size()]);
            }
            Self::Zero => out.extend_from_slice(&[0; 4]),
        }
    }
}

/// An element to write after the vertices.
pub(crate) struct NewElement<'a> {
    pub(crate) name: &'static str,
    pub(crate) count: usize,
    pub(crate) columns: Vec<(String, ColumnSource<'a>)>,
}

/// Writes a PLY file of comments, vertices and further elements; nothing is left if `progress` says
/// stop.
pub(crate) fn write_new_ply(
    file: &AtomicFile,
    comments: &[String],
    count: usize,
    columns: &[(String, ColumnSource<'_>)],
    after: &[NewElement<'_>],
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let path = file.target();
    let mut header = "ply\nformat binary_little_endian 1.0\n".to_owned();
    comments.iter().for_each(|text| header.push_str(&format!("comment {text}\n")));
    describe(VERTEX, count, columns, path, &mut header)?;
    for element in after {
        describe(element.name, element.count, &element.columns, path, &mut header)?;
    }
    header.push_str("end_header\n");
    let all = after.iter().map(|element| element.count * stride(&element.columns));
    let size = header.len() + count * stride(columns) + all.sum::<usize>();

    let write_failed = || SceneError::io(path, "cannot write the file");
    write_all_at(file.file(), header.as_bytes(), 0).map_err(write_failed())?;
    let mut tick = |end: u64| {
        if progress(end as f64 / size as f64) { Ok(()) } else { Err(SceneError::Stopped) }
    };
    let mut at = header.len() as u64;
    at += write_rows(file, at, count, columns, &mut tick)?;
    for element in after {
        at += write_rows(file, at, element.count, &element.columns, &mut tick)?;
    }
    Ok(())
}

/// Bytes of a row.
fn stride(columns: &[(String, ColumnSource<'_>)]) -> usize {
    columns.iter().map(|(_, source)| source.ty().size()).sum()
}

/// Adds an element to a header.
fn describe(
    name: &str,
    count: usize,
    columns: &[(String, ColumnSource<'_>)],
    path: &Path,
    header: &mut String,
) -> Result<(), SceneError> {
    header.push_str(&format!("element {name} {count}\n"));
    for (i, (name, source)) in columns.iter().enumerate() {
        check_name(name, path)?;
        if columns[..i].iter().any(|(other, _)| other == name) {
            let problem = format!("two columns are called {name}");
            return Err(SceneError::format(path, problem, "choose another name for the new one"));
        }
        if let ColumnSource::Values(values) = source {
            check_rows(&PlyColumn { name, values: *values }, count, path)?;
        }
        header.push_str(&format!("property {} {name}\n", source.ty().name()));
    }
    Ok(())
}

/// Writes the rows of an element in parallel from byte `start` on; gives their size. `tick` gets the
/// byte up to which the file is written.
fn write_rows(
    file: &AtomicFile,
    start: u64,
    count: usize,
    columns: &[(String, ColumnSource<'_>)],
    tick: &mut dyn FnMut(u64) -> Result<(), SceneError>,
) -> Result<u64, SceneError> {
    let stride = stride(columns);
    let to = file.file();
    let blocks = count.div_ceil(ROWS_PER_WRITE);
    for first_block in (0..blocks).step_by(WRITES_PER_TICK) {
        let end = blocks.min(first_block + WRITES_PER_TICK);
        (first_block..end).into_par_iter().try_for_each_init(
            Vec::new,
            |buffer: &mut Vec<u8>, block| {
                let first = block * ROWS_PER_WRITE;
                buffer.clear();
                for row in first..(first + ROWS_PER_WRITE).min(count) {
                    columns.iter().for_each(|(_, source)| source.push(row, buffer));
                }
                write_all_at(to, buffer, start + (first * stride) as u64)
                    .map_err(SceneError::io(file.target(), "cannot write the file"))
            },
        )?;
        tick(start + ((end * ROWS_PER_WRITE).min(count) * stride) as u64)?;
    }
    Ok((count * stride) as u64)
}
