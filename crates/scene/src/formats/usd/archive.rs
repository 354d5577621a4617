//! Text layers in archives.

use super::reader::read_layer;
use super::writer::{note_limits, write_layer};
use super::{CONVERT, is_usda};
use crate::formats::{
    LoadedScene, ReadOptions, SceneFormat, WriteOptions, WriteProgress, WriteReport,
};
use crate::{AtomicFile, GaussianScene, SceneError};
use std::io::{BufWriter, Cursor, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter};

/// Where contents of entries begin: at multiples of so many bytes.
const ALIGNMENT: u16 = 64;
/// The entry that is written.
const NAME: &str = "scene.usda";

/// Whether bytes are a zip archive whose first entry is a layer.
pub fn is_usdz(bytes: &[u8]) -> bool {
    let name = || {
        let length = u16::from_le_bytes(*bytes.get(26..)?.first_chunk::<2>()?);
        bytes.get(30..30 + usize::from(length))
    };
    let is_layer = |name: &[u8]| {
        [&b".usda"[..], b".usdc", b".usd"]
            .iter()
            .any(|end| name.to_ascii_lowercase().ends_with(end))
    };
    bytes.starts_with(b"PK\x03\x04") && name().is_some_and(is_layer)
}

/// Reads the Gaussians of the first layer of an archive, as [`read_usda`](super::read_usda) does.
///
/// # Errors
/// As [`read_usda`](super::read_usda); also if the archive is damaged, or if that layer is compressed or binary.
pub fn read_usdz(
    bytes: &[u8],
    path: &Path,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    let damaged = |e: zip::result::ZipError| {
        SceneError::format(path, format!("is a damaged archive: {e}"), "get the file again")
    };
    let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(damaged)?;
    let entry = zip.by_index_raw(0).map_err(damaged)?;
    let name = String::from_utf8_lossy(entry.name_raw()).into_owned();
    if entry.compression() != CompressionMethod::Stored {
        let problem = format!("its first layer, {name}, is compressed");
        return Err(SceneError::format(
            path,
            problem,
            "archives of USD hold files as they are: pack it again",
        ));
    }
    let range = entry.data_start().zip(usize::try_from(entry.size()).ok());
    let layer = range.and_then(|(first, size)| {
        let first = usize::try_from(first).ok()?;
        bytes.get(first..first.checked_add(size)?)
    });
    let Some(layer) = layer else {
        return Err(SceneError::format(path, "its first layer is cut short", "get the file again"));
    };
    if !is_usda(layer) {
        let problem = format!("its first layer, {name}, is binary USD");
        return Err(SceneError::format(path, problem, CONVERT));
    }
    read_layer(layer, path, options, SceneFormat::Usdz)
}

/// Takes so many bytes.
struct Limited<W> {
    zip: W,
    left: u64,
}

impl<W: Write> Write for Limited<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.left = self.left.saturating_sub(bytes.len() as u64);
        match self.left {
            0 => Err(std::io::ErrorKind::FileTooLarge.into()),
            _ => self.zip.write_all(bytes).map(|()| bytes.len()),
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.zip.flush()
    }
}

/// Writes a scene as a `.usdz` file: an archive with the text of [`write_usda`](super::write_usda).
///
/// # Errors
/// As [`write_scene`](super::super::write_scene); also if the text exceeds 4 GiB, which such archives cannot hold.
pub(in crate::formats) fn write_usdz(
    scene: &GaussianScene,
    file: &AtomicFile,
    _options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let path = file.target();
    let cannot =
        |e: zip::result::ZipError| SceneError::io(path, "cannot write the archive")(e.into());
    let mut zip = ZipWriter::new(BufWriter::new(file.file()));
    // No time of day and no rights of the writer: the same scene gives the same bytes.
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default())
        .unix_permissions(0o644)
        .with_alignment(ALIGNMENT);
    zip.start_file(NAME, options).map_err(cannot)?;
    let mut limited = Limited { zip, left: u64::from(u32::MAX) };
    let written = write_layer(scene, &mut limited, path, progress);
    let Limited { zip, left } = limited;
    if left == 0 {
        let problem = "would be longer than the 4 GiB that archives of USD hold";
        return Err(SceneError::format(path, problem, "write a .usda file, or cut harmonics"));
    }
    written?;
    let mut buffer = zip.finish().map_err(cannot)?;
    buffer.flush().map_err(SceneError::io(path, "cannot write the archive"))?;
    note_limits(scene, report);
    Ok(())
}
