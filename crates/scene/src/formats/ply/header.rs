//! The header of a PLY file.

use crate::SceneError;
use std::collections::HashSet;
use std::ops::Range;
use std::path::Path;

/// A header is text for people; one longer than this is a damaged or hostile file.
const MAX_HEADER_BYTES: usize = 1 << 20;
/// Files of splats and meshes have two to five.
const MAX_ELEMENTS: usize = 1024;
/// Of all elements together; wide language features are thousands of columns.
const MAX_PROPERTIES: usize = 1 << 14;

/// How the data of a PLY file are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlyEncoding {
    /// Numbers as text, one row a line.
    Ascii,
    /// Least significant byte first.
    BinaryLittleEndian,
    /// Most significant byte first.
    BinaryBigEndian,
}

/// The type of a scalar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlyType {
    /// `char`, `int8`
    I8,
    /// `uchar`, `uint8`
    U8,
    /// `short`, `int16`
    I16,
    /// `ushort`, `uint16`
    U16,
    /// `int`, `int32`
    I32,
    /// `uint`, `uint32`
    U32,
    /// `float`, `float32`
    F32,
    /// `double`, `float64`
    F64,
}

impl PlyType {
    fn parse(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// The word for it in a header.
    pub fn name(self) -> &'static str {
        match self {
            Self::I8 => "char",
            Self::U8 => "uchar",
            Self::I16 => "short",
            Self::U16 => "ushort",
            Self::I32 => "int",
            Self::U32 => "uint",
            Self::F32 => "float",
            Self::F64 => "double",
        }
    }

    /// Bytes of one value.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Whether it is `float` or `double`.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

/// One value or a list of values per row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlyPropertyKind {
    /// One value.
    Scalar(PlyType),
    /// A count, then that many values.
    List {
        /// Type of the count, an integer.
        count: PlyType,
        /// Type of the values.
        item: PlyType,
    },
}

/// A property of an element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlyProperty {
    /// Its name, unique within the element.
    pub name: String,
    /// What a row holds for it.
    pub kind: PlyPropertyKind,
}

impl PlyProperty {
    /// Whether it is a list.
    pub fn is_list(&self) -> bool {
        matches!(self.kind, PlyPropertyKind::List { .. })
    }
}

/// A table of a PLY file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlyElement {
    /// Its name, unique within the file.
    pub name: String,
    /// Number of rows.
    pub count: usize,
    /// Its columns, in the order of the file.
    pub properties: Vec<PlyProperty>,
}

impl PlyElement {
    /// The property of that name.
    pub fn property(&self, name: &str) -> Option<&PlyProperty> {
        self.properties.iter().find(|p| p.name == name)
    }

    /// Whether it has a scalar property of that name.
    pub fn has(&self, name: &str) -> bool {
        self.property(name).is_some_and(|p| !p.is_list())
    }
}

/// A line of the header, kept so that a copy of the file has every comment in its place.
#[derive(Debug, Clone)]
pub(super) enum HeaderLine {
    /// The line that names the encoding.
    Format,
    /// `comment …` or `obj_info …`, as it is.
    Remark(Vec<u8>),
    /// Index of the element.
    Element(usize),
    /// Indices of the element and of the property in it.
    Property(usize, usize),
}

#[derive(Debug, Clone)]
pub(super) struct Header {
    pub(super) encoding: PlyEncoding,
    pub(super) elements: Vec<PlyElement>,
    pub(super) lines: Vec<HeaderLine>,
    /// Offset of the first byte after `end_header`.
    pub(super) data_start: usize,
}

impl Header {
    pub(super) fn comments(&self) -> impl Iterator<Item = String> + '_ {
        self.lines.iter().filter_map(|line| match line {
            HeaderLine::Remark(text) => text.strip_prefix(b"comment").map(|rest| {
                String::from_utf8_lossy(rest.strip_prefix(b" ").unwrap_or(rest)).into_owned()
            }),
            _ => None,
        })
    }
}

/// Whether these bytes begin a PLY file.
pub(super) fn has_magic(bytes: &[u8]) -> bool {
    bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r\n")
}

/// The next line without its end, and where the one after it starts.
fn next_line(bytes: &[u8], start: usize) -> Option<(Range<usize>, usize)> {
    let limit = bytes.len().min(MAX_HEADER_BYTES);
    let end = start + bytes.get(start..limit)?.iter().position(|&b| b == b'\n')?;
    let text_end = if end > start && bytes[end - 1] == b'\r' { end - 1 } else { end };
    Some((start..text_end, end + 1))
}

pub(super) fn parse_header(bytes: &[u8], path: &Path) -> Result<Header, SceneError> {
    if !has_magic(bytes) {
        return Err(SceneError::format(
            path,
            "is not a PLY file: it does not begin with `ply`",
            "",
        ));
    }
    let mut encoding = None;
    let mut elements: Vec<PlyElement> = Vec::new();
    let mut lines = Vec::new();
    let mut names = HashSet::new();
    let (_, mut at) = next_line(bytes, 0).unwrap_or((0..0, bytes.len()));
    let mut number = 1usize;
    let mut properties = 0;
    loop {
        number += 1;
        let Some((range, next)) = next_line(bytes, at) else {
            let limit = MAX_HEADER_BYTES;
            let problem = if bytes.len() >= limit {
                format!("the PLY header does not end within {limit} bytes")
            } else {
                "the PLY header has no `end_header` line".to_owned()
            };
            return Err(SceneError::format(path, problem, "the file is damaged or cut short"));
        };
        let line = &bytes[range];
        at = next;
        let bad = |what: &str| {
            let text = String::from_utf8_lossy(&line[..line.len().min(80)]).into_owned();
            SceneError::format(path, format!("PLY header line {number}: {what}: {text:?}"), "")
        };
        let words: Vec<&[u8]> =
            line.split(|b| b.is_ascii_whitespace()).filter(|w| !w.is_empty()).collect();
        let Some((&keyword, words)) = words.split_first() else { continue };
        if matches!(keyword, b"comment" | b"obj_info") {
            lines.push(HeaderLine::Remark(line.to_vec()));
            continue;
        }
        let words = words
            .iter()
            .map(|w| std::str::from_utf8(w).map_err(|_| bad("not UTF-8")))
            .collect::<Result<Vec<_>, _>>()?;
        match (keyword, words.as_slice()) {
            (b"end_header", []) => break,
            (b"format", [name, version]) => {
                if encoding.is_some() {
                    return Err(bad("a second format"));
                }
                if *version != "1.0" {
                    return Err(bad("unknown version of PLY, 1.0 is expected"));
                }
                encoding = Some(match *name {
                    "ascii" => PlyEncoding::Ascii,
                    "binary_little_endian" => PlyEncoding::BinaryLittleEndian,
                    "binary_big_endian" => PlyEncoding::BinaryBigEndian,
                    _ => return Err(bad("unknown encoding")),
                });
                lines.push(HeaderLine::Format);
            }
            (b"element", [name, count]) => {
                let count = count
                    .parse::<u64>()
                    .ok()
                    .and_then(|c| usize::try_from(c).ok())
                    .ok_or_else(|| bad("the number of rows is not a count"))?;
                if elements.len() == MAX_ELEMENTS {
                    return Err(bad(&format!("more than {MAX_ELEMENTS} elements")));
                }
                if elements.iter().any(|e| e.name == *name) {
                    return Err(bad("a second element of this name"));
                }
                names.clear();
                lines.push(HeaderLine::Element(elements.len()));
                elements.push(PlyElement { name: (*name).into(), count, properties: Vec::new() });
            }
            (b"property", words) => {
                let (kind, name) = match words {
                    ["list", count, item, name] => {
                        let count = PlyType::parse(count).filter(|t| !t.is_float());
                        let count = count.ok_or_else(|| bad("not a type of list lengths"))?;
                        let item = PlyType::parse(item).ok_or_else(|| bad("unknown type"))?;
                        (PlyPropertyKind::List { count, item }, *name)
                    }
                    [ty, name] => {
                        let ty = PlyType::parse(ty).ok_or_else(|| bad("unknown type"))?;
                        (PlyPropertyKind::Scalar(ty), *name)
                    }
                    _ => return Err(bad("not a property")),
                };
                let index = elements.len().wrapping_sub(1);
                let Some(element) = elements.last_mut() else {
                    return Err(bad("a property before any element"));
                };
                properties += 1;
                if properties > MAX_PROPERTIES {
                    return Err(bad(&format!("more than {MAX_PROPERTIES} properties")));
                }
                if !names.insert(name.to_owned()) {
                    return Err(bad("a second property of this name; rename one of them"));
                }
                lines.push(HeaderLine::Property(index, element.properties.len()));
                element.properties.push(PlyProperty { name: name.to_owned(), kind });
            }
            _ => return Err(bad("not understood")),
        }
    }
    let encoding = encoding
        .ok_or_else(|| SceneError::format(path, "the PLY header has no `format` line", ""))?;
    Ok(Header { encoding, elements, lines, data_start: at })
}
