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

/// Each type in the order of the enum, its word in headers, the other word for it, and its size.
const TYPES: [(PlyType, &str, &str, usize); 8] = [
    (PlyType::I8, "char", "int8", 1),
    (PlyType::U8, "uchar", "uint8", 1),
    (PlyType::I16, "short", "int16", 2),
    (PlyType::U16, "ushort", "uint16", 2),
    (PlyType::I32, "int", "int32", 4),
    (PlyType::U32, "uint", "uint32", 4),
    (PlyType::F32, "float", "float32", 4),
    (PlyType::F64, "double", "float64", 8),
];

impl PlyType {
    fn parse(word: &str) -> Option<Self> {
        TYPES.iter().find(|row| row.1 == word || row.2 == word).map(|row| row.0)
    }

    /// The word for it in a header.
    pub fn name(self) -> &'static str {
        TYPES[self as usize].1
    }

    /// Bytes of one value.
    pub fn size(self) -> usize {
        TYPES[self as usize].3
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

/// Refuses a line; it says the number and the beginning of the line.
type Refuse<'a> = &'a dyn Fn(&str) -> SceneError;

#[derive(Default)]
struct Parser {
    encoding: Option<PlyEncoding>,
    elements: Vec<PlyElement>,
    lines: Vec<HeaderLine>,
    /// Names of the properties of the last element.
    names: HashSet<String>,
    /// Properties of all elements.
    properties: usize,
}

impl Parser {
    /// Reads a line of words other than a remark and `end_header`.
    fn line(&mut self, keyword: &[u8], words: &[&str], bad: Refuse<'_>) -> Result<(), SceneError> {
        match (keyword, words) {
            (b"format", [name, version]) => self.format(name, version, bad),
            (b"element", [name, count]) => self.element(name, count, bad),
            (b"property", ["list", count, item, name]) => {
                let count = PlyType::parse(count).filter(|t| !t.is_float());
                let count = count.ok_or_else(|| bad("not a type of list lengths"))?;
                let item = PlyType::parse(item).ok_or_else(|| bad("unknown type"))?;
                self.property(PlyPropertyKind::List { count, item }, name, bad)
            }
            (b"property", [ty, name]) => {
                let ty = PlyType::parse(ty).ok_or_else(|| bad("unknown type"))?;
                self.property(PlyPropertyKind::Scalar(ty), name, bad)
            }
            (b"property", _) => Err(bad("not a property")),
            _ => Err(bad("not understood")),
        }
    }

    fn format(&mut self, name: &str, version: &str, bad: Refuse<'_>) -> Result<(), SceneError> {
        if version != "1.0" {
            return Err(bad("unknown version of PLY, 1.0 is expected"));
        }
        let encoding = match name {
            "ascii" => PlyEncoding::Ascii,
            "binary_little_endian" => PlyEncoding::BinaryLittleEndian,
            "binary_big_endian" => PlyEncoding::BinaryBigEndian,
            _ => return Err(bad("unknown encoding")),
        };
        if self.encoding.replace(encoding).is_some() {
            return Err(bad("a second format"));
        }
        self.lines.push(HeaderLine::Format);
        Ok(())
    }

    fn element(&mut self, name: &str, count: &str, bad: Refuse<'_>) -> Result<(), SceneError> {
        let count = count.parse::<u64>().ok().and_then(|c| usize::try_from(c).ok());
        let count = count.ok_or_else(|| bad("the number of rows is not a count"))?;
        if self.elements.len() == MAX_ELEMENTS {
            return Err(bad(&format!("more than {MAX_ELEMENTS} elements")));
        }
        if self.elements.iter().any(|e| e.name == name) {
            return Err(bad("a second element of this name"));
        }
        self.names.clear();
        self.lines.push(HeaderLine::Element(self.elements.len()));
        self.elements.push(PlyElement { name: name.into(), count, properties: Vec::new() });
        Ok(())
    }

    fn property(
        &mut self,
        kind: PlyPropertyKind,
        name: &str,
        bad: Refuse<'_>,
    ) -> Result<(), SceneError> {
        let index = self.elements.len().wrapping_sub(1);
        let Some(element) = self.elements.last_mut() else {
            return Err(bad("a property before any element"));
        };
        self.properties += 1;
        if self.properties > MAX_PROPERTIES {
            return Err(bad(&format!("more than {MAX_PROPERTIES} properties")));
        }
        if !self.names.insert(name.to_owned()) {
            return Err(bad("a second property of this name; rename one of them"));
        }
        self.lines.push(HeaderLine::Property(index, element.properties.len()));
        element.properties.push(PlyProperty { name: name.to_owned(), kind });
        Ok(())
    }
}

pub(super) fn parse_header(bytes: &[u8], path: &Path) -> Result<Header, SceneError> {
    let refuse = |problem: String, help: &str| SceneError::format(path, problem, help);
    if !has_magic(bytes) {
        return Err(refuse("is not a PLY file: it does not begin with `ply`".to_owned(), ""));
    }
    let mut parser = Parser::default();
    let (_, mut at) = next_line(bytes, 0).unwrap_or((0..0, bytes.len()));
    for number in 2usize.. {
        let Some((range, next)) = next_line(bytes, at) else {
            let limit = MAX_HEADER_BYTES;
            let problem = if bytes.len() >= limit {
                format!("the PLY header does not end within {limit} bytes")
            } else {
                "the PLY header has no `end_header` line".to_owned()
            };
            return Err(refuse(problem, "the file is damaged or cut short"));
        };
        let line = &bytes[range];
        at = next;
        let bad = |what: &str| {
            let text = String::from_utf8_lossy(&line[..line.len().min(80)]).into_owned();
            refuse(format!("PLY header line {number}: {what}: {text:?}"), "")
        };
        let words: Vec<&[u8]> =
            line.split(|b| b.is_ascii_whitespace()).filter(|w| !w.is_empty()).collect();
        let Some((&keyword, words)) = words.split_first() else { continue };
        if matches!(keyword, b"comment" | b"obj_info") {
            parser.lines.push(HeaderLine::Remark(line.to_vec()));
            continue;
        }
        let words = words.iter().map(|w| std::str::from_utf8(w).map_err(|_| bad("not UTF-8")));
        let words = words.collect::<Result<Vec<_>, _>>()?;
        if keyword == b"end_header" && words.is_empty() {
            break;
        }
        parser.line(keyword, &words, &bad)?;
    }
    let Parser { encoding, elements, lines, .. } = parser;
    let encoding =
        encoding.ok_or_else(|| refuse("the PLY header has no `format` line".to_owned(), ""))?;
    Ok(Header { encoding, elements, lines, data_start: at })
}
