//! What every target holds its reader to.

use scenesplat_scene::{LoadedScene, ReadOptions, SceneError};
use std::path::{Path, PathBuf};

/// A name for messages; no file of that name is there, so nothing beside it is found either.
pub fn path() -> &'static Path {
    Path::new("fuzz-input")
}

/// Reads with everything on.
pub fn options() -> ReadOptions {
    ReadOptions::default()
}

/// A scene that was read is whole, and no row is lost without a word.
pub fn check(read: Result<LoadedScene, SceneError>) {
    if let Ok(loaded) = read {
        loaded.scene.check_rows().expect("every array has one row per Gaussian");
        assert_eq!(loaded.scene.len() + loaded.report.dropped_rows, loaded.source_rows());
        assert!(loaded.scene.coord.iter().flatten().all(|v| v.is_finite()));
    }
}

/// Cuts an input in three by two lengths at its beginning.
pub fn three_parts(bytes: &[u8]) -> [&[u8]; 3] {
    let Some((lengths, rest)) = bytes.split_first_chunk::<8>() else { return [&[]; 3] };
    let length = |at: usize| {
        u32::from_le_bytes([lengths[at], lengths[at + 1], lengths[at + 2], lengths[at + 3]]) as usize
    };
    let (first, rest) = rest.split_at(length(0).min(rest.len()));
    let (second, third) = rest.split_at(length(4).min(rest.len()));
    [first, second, third]
}

/// A file of this process with the given content, for readers that take a path.
pub fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("scenesplat-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a temporary folder");
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a temporary file");
    path
}

/// A `.pth` archive around a pickle, with the values of one storage: mutations of a whole archive would
/// end at its checksums.
pub fn torch_archive(pickle: &[u8], storage: &[u8]) -> Vec<u8> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    let entries = [("archive/data.pkl", pickle), ("archive/data/0", storage)];
    for (name, content) in entries {
        let offset = out.len() as u32;
        let mut about = Vec::new();
        for half in [20u16, 0, 0, 0, 0] {
            about.extend(half.to_le_bytes());
        }
        for word in [crc32(content), content.len() as u32, content.len() as u32] {
            about.extend(word.to_le_bytes());
        }
        about.extend((name.len() as u16).to_le_bytes());
        about.extend(0u16.to_le_bytes());
        out.extend(b"PK\x03\x04");
        out.extend(&about);
        out.extend(name.as_bytes());
        out.extend(content);
        directory.extend(b"PK\x01\x02\x14\0");
        directory.extend(&about);
        directory.extend([0; 10]);
        directory.extend(offset.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let (start, length) = (out.len() as u32, directory.len() as u32);
    out.extend(directory);
    out.extend(b"PK\x05\x06\0\0\0\0");
    for half in [entries.len() as u16; 2] {
        out.extend(half.to_le_bytes());
    }
    for word in [length, start] {
        out.extend(word.to_le_bytes());
    }
    out.extend([0; 2]);
    out
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |mut crc, &byte| {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = crc >> 1 ^ (0xedb8_8320 & (crc & 1).wrapping_neg());
        }
        crc
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The archive is one, and what is in it is read.
    #[test]
    fn archives_are_opened() {
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
        // {}: an empty dictionary.
        let path = file("archive.pth", &torch_archive(b"\x80\x02}.", b""));
        let weights = scenesplat_models::weights::WeightFile::open(&path).unwrap();
        assert!(weights.entries().is_empty());
    }
}
