//! Where the parts of a scene lie: files of a folder, or entries of a zip archive.

use super::meta::MAX_META_BYTES;
use crate::SceneError;
use crate::input_file::InputFile;
use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use zip::{CompressionMethod, ZipArchive};

const META: &str = "meta.json";
/// Most that one byte of deflate can stand for, and more than any of its heads.
const DEFLATE_MAX_RATIO: usize = 1032;

/// The bytes of a part.
pub(super) enum PartBytes<'a> {
    /// A file of its own.
    Mapped(InputFile),
    /// Stored in the archive as it is.
    Stored(&'a [u8]),
    /// Unpacked.
    Unpacked(Vec<u8>),
}

impl PartBytes<'_> {
    /// All of them.
    pub(super) fn bytes(&self) -> &[u8] {
        match self {
            Self::Mapped(file) => file.bytes(),
            Self::Stored(bytes) => bytes,
            Self::Unpacked(bytes) => bytes,
        }
    }
}

/// A folder or an archive with a `meta.json`.
pub(super) enum Source<'a> {
    /// The folder, and its `meta.json` (which may have another name).
    Folder {
        /// Where the textures are.
        folder: PathBuf,
        /// The description.
        meta: PathBuf,
    },
    /// The archive.
    Archive(Archive<'a>),
}

/// A zip archive in memory, by its central directory: local headers may have sizes of 0.
pub(super) struct Archive<'a> {
    path: PathBuf,
    bytes: &'a [u8],
    /// The folder inside the archive, with a slash at its end, or nothing.
    inside: String,
    entries: BTreeMap<String, Entry>,
}

struct Entry {
    start: u64,
    packed: u64,
    size: u64,
    crc32: u32,
    method: CompressionMethod,
    encrypted: bool,
}

/// Whether bytes are a zip archive with a `meta.json` in its root or in one folder of it.
pub fn is_sog_archive(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK")
        && ZipArchive::new(Cursor::new(bytes)).is_ok_and(|zip| {
            zip.file_names_raw().any(|name| std::str::from_utf8(name).is_ok_and(is_meta))
        })
}

/// Whether an entry is a `meta.json` in the root or in one folder.
fn is_meta(name: &str) -> bool {
    match name.strip_suffix(META) {
        Some("") => true,
        // The second copies of files that one system adds are no scene.
        Some(folder) => {
            folder.ends_with('/') && folder.matches('/').count() == 1 && folder != "__MACOSX/"
        }
        None => false,
    }
}

impl<'a> Source<'a> {
    /// A folder whose description is that file.
    pub(super) fn beside(meta: &Path) -> Self {
        let folder = meta.parent().unwrap_or(Path::new("")).to_owned();
        Self::Folder { folder, meta: meta.to_owned() }
    }

    /// An archive in memory; `path` is for messages.
    pub(super) fn archive(bytes: &'a [u8], path: &Path) -> Result<Self, SceneError> {
        Ok(Self::Archive(Archive::open(bytes, path)?))
    }

    /// The description, and its name for messages.
    pub(super) fn meta(&self) -> Result<(PathBuf, PartBytes<'a>), SceneError> {
        match self {
            Self::Folder { meta, .. } => {
                Ok((meta.clone(), PartBytes::Mapped(InputFile::open(meta)?)))
            }
            Self::Archive(_) => self.part(META, MAX_META_BYTES),
        }
    }

    /// A part that the description names, and its name for messages. Unpacked, it may not be longer
    /// than `limit`.
    pub(super) fn part(
        &self,
        name: &str,
        limit: usize,
    ) -> Result<(PathBuf, PartBytes<'a>), SceneError> {
        match self {
            Self::Folder { folder, meta } => {
                let path = folder.join(name);
                if !path.is_file() {
                    let problem = format!("names the file {name}, which is not there");
                    return Err(SceneError::format(meta, problem, "copy all files of the scene"));
                }
                let file = InputFile::open(&path)?;
                Ok((path, PartBytes::Mapped(file)))
            }
            Self::Archive(archive) => Ok((archive.path_of(name), archive.read(name, limit)?)),
        }
    }

    /// How many bytes a part takes where it lies, packed or not; 0 if it is not there.
    ///
    /// That is what a file may claim with: sizes that it only states prove nothing.
    pub(super) fn bytes_there(&self, name: &str) -> u64 {
        match self {
            Self::Folder { folder, .. } => {
                std::fs::metadata(folder.join(name)).map_or(0, |about| about.len())
            }
            Self::Archive(archive) => archive.entry(name).map_or(0, |entry| entry.packed),
        }
    }
}

impl<'a> Archive<'a> {
    fn open(bytes: &'a [u8], path: &Path) -> Result<Self, SceneError> {
        let bad = |problem: String| SceneError::format(path, problem, "copy or export it again");
        let damaged = |e: zip::result::ZipError| bad(format!("is no intact zip archive: {e}"));
        let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(damaged)?;
        let mut folders: Vec<String> = Vec::new();
        for name in zip.file_names_raw() {
            let name = std::str::from_utf8(name).ok().filter(|name| is_meta(name));
            folders.extend(name.and_then(|name| name.strip_suffix(META)).map(str::to_owned));
        }
        folders.sort_unstable();
        let inside = match folders.as_slice() {
            // The root sorts first and wins over folders.
            [root, ..] if root.is_empty() => String::new(),
            [one] => one.clone(),
            [] => return Err(bad(format!("is a zip archive without {META}"))),
            [first, second, ..] => {
                let problem = format!("holds several scenes, in {first} and {second}");
                return Err(SceneError::format(path, problem, "unpack it and open one of them"));
            }
        };
        let mut entries = BTreeMap::new();
        for i in 0..zip.len() {
            // Raw: nothing is unpacked, and entries of a kind that cannot be are no error yet.
            let entry = zip.by_index_raw(i).map_err(damaged)?;
            let Ok(name) = std::str::from_utf8(entry.name_raw()) else { continue };
            let Some(name) = name.strip_prefix(inside.as_str()) else { continue };
            let about = Entry {
                start: entry.data_start().unwrap_or(u64::MAX),
                packed: entry.compressed_size(),
                size: entry.size(),
                crc32: entry.crc32(),
                method: entry.compression(),
                encrypted: entry.encrypted(),
            };
            entries.insert(name.to_owned(), about);
        }
        Ok(Self { path: path.to_owned(), bytes, inside, entries })
    }

    fn path_of(&self, name: &str) -> PathBuf {
        self.path.join(format!("{}{name}", self.inside))
    }

    /// The entry of that name if its bytes lie within the archive.
    fn entry(&self, name: &str) -> Option<&Entry> {
        let inside = |entry: &&Entry| {
            entry.start.checked_add(entry.packed).is_some_and(|end| end <= self.bytes.len() as u64)
        };
        self.entries.get(name).filter(inside)
    }

    fn read(&self, name: &str, limit: usize) -> Result<PartBytes<'a>, SceneError> {
        let help = "copy or export the scene again";
        let bad = |problem: String| SceneError::format(&self.path_of(name), problem, help);
        let Some(entry) = self.entry(name) else {
            let problem = if self.entries.contains_key(name) {
                format!("has an entry {name} that ends beyond the file")
            } else {
                format!("has no entry {}{name}", self.inside)
            };
            return Err(SceneError::format(&self.path, problem, help));
        };
        if entry.encrypted {
            return Err(bad("is encrypted".into()));
        }
        if entry.size > limit as u64 {
            let size = entry.size;
            return Err(bad(format!("would be {size} bytes, more than {limit} cannot be right")));
        }
        // Both fit: the entry lies within the bytes, and the size is below the limit.
        let start = entry.start as usize;
        let (packed, size) =
            (&self.bytes[start..start + entry.packed as usize], entry.size as usize);
        let part = match entry.method {
            CompressionMethod::Stored => PartBytes::Stored(packed),
            CompressionMethod::Deflated => {
                if size / DEFLATE_MAX_RATIO > packed.len() {
                    return Err(bad(format!("cannot unpack to {size} bytes")));
                }
                let mut out = Vec::with_capacity(size);
                flate2::read::DeflateDecoder::new(packed)
                    .take(entry.size + 1)
                    .read_to_end(&mut out)
                    .map_err(|e| bad(format!("cannot be unpacked: {e}")))?;
                PartBytes::Unpacked(out)
            }
            other => return Err(bad(format!("is packed by a method that is not known: {other}"))),
        };
        let found = part.bytes().len();
        if found != size {
            return Err(bad(format!("is not of the {size} bytes that the archive says")));
        }
        if crc32fast::hash(part.bytes()) != entry.crc32 {
            return Err(bad("does not have the checksum in the archive".into()));
        }
        Ok(part)
    }
}
