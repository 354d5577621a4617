//! Segments and features of pictures, kept from run to run.

use anyhow::{Context, Result};
use half::f16;
use scenesplat::rasterizer::lifting::{NO_SEGMENT, SegmentMap};
use scenesplat::scene::AtomicFile;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::input_file::read_file;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Largest record that is read.
const MAX_RECORD: u64 = 1 << 16;
/// Largest file of segments or features that is read.
const MAX_FILE: u64 = 1 << 31;

/// A folder of `<frame>_s.npy` (`[1, H, W]` i32, −1 = none), `<frame>_f.npy` (`[S, D]` f16) and `<frame>.json`.
///
/// The record is written last and says what both were made from, and what they hold: a frame without one, or with one
/// that does not fit, is made anew.
pub(super) struct FrameCache {
    folder: PathBuf,
}

/// What is known of a frame that is done.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameRecord {
    /// Hash of all that the result depends on.
    pub(super) key: String,
    /// Segments with pixels.
    pub(super) segments: usize,
    /// Segments without.
    pub(super) left_out: usize,
    /// Whether the frame has but one.
    pub(super) single_segment: bool,
    /// Width and height of the picture.
    pub(super) size: [u32; 2],
    /// Of `<frame>_s.npy`.
    segments_sha256: String,
    /// Of `<frame>_f.npy`.
    features_sha256: String,
}

/// What was made of a frame.
pub(super) struct Made<'a> {
    pub(super) map: &'a SegmentMap,
    /// `[S, dim]`
    pub(super) features: &'a [f32],
    pub(super) dim: usize,
    pub(super) left_out: usize,
    pub(super) single_segment: bool,
}

impl FrameCache {
    /// In a folder, which is made.
    pub(super) fn open(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("{}: cannot make the folder", folder.display()))?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// The record of a frame that is done and whose files are whole.
    pub(super) fn find(&self, frame: &str, key: &str) -> Option<FrameRecord> {
        let record = read_file(&self.path(frame, ".json"), MAX_RECORD).ok()?;
        let record: FrameRecord = serde_json::from_slice(&record).ok()?;
        let holds = |ending: &str, hash: &str| {
            read_file(&self.path(frame, ending), MAX_FILE).is_ok_and(|bytes| sha256(&bytes) == hash)
        };
        let is_whole = record.key == key
            && holds("_s.npy", &record.segments_sha256)
            && holds("_f.npy", &record.features_sha256);
        is_whole.then_some(record)
    }

    /// Whether there is something of a frame.
    pub(super) fn has(&self, frame: &str) -> bool {
        self.path(frame, ".json").exists()
    }

    /// Keeps a frame. Each file appears when it is complete, the record last.
    pub(super) fn keep(&self, frame: &str, key: &str, made: &Made<'_>) -> Result<FrameRecord> {
        let record = self.path(frame, ".json");
        if record.exists() {
            // What it says is over.
            std::fs::remove_file(&record).with_context(|| record.display().to_string())?;
        }
        let id = |&id: &u16| if id == NO_SEGMENT { -1 } else { i32::from(id) };
        let ids: Vec<i32> = made.map.ids().iter().map(id).collect();
        let (width, height) = (made.map.width(), made.map.height());
        write_npy(&self.path(frame, "_s.npy"), &[1, height as usize, width as usize], &ids)?;
        let features: Vec<f16> = made.features.iter().map(|&v| f16::from_f32(v)).collect();
        let rows = features.len() / made.dim.max(1);
        write_npy(&self.path(frame, "_f.npy"), &[rows, made.dim], &features)?;
        let hash = |ending: &str| -> Result<String> {
            Ok(sha256(&read_file(&self.path(frame, ending), MAX_FILE)?))
        };
        let done = FrameRecord {
            key: key.to_owned(),
            segments: rows,
            left_out: made.left_out,
            single_segment: made.single_segment,
            size: [width, height],
            segments_sha256: hash("_s.npy")?,
            features_sha256: hash("_f.npy")?,
        };
        AtomicFile::write(&record, (serde_json::to_string_pretty(&done)? + "\n").as_bytes())?;
        Ok(done)
    }

    fn path(&self, frame: &str, ending: &str) -> PathBuf {
        self.folder.join(format!("{frame}{ending}"))
    }
}

/// SHA-256 in hexadecimal.
pub(super) fn sha256(bytes: &[u8]) -> String {
    let mut out = String::with_capacity(64);
    for byte in Sha256::digest(bytes) {
        // Writing into a string cannot fail.
        let _ = write!(out, "{byte:02x}");
    }
    out
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;

    #[test]
    fn frames_that_are_not_whole_or_not_meant_are_not_found() {
        let dir = tempfile::tempdir().unwrap();
        let cache = FrameCache::open(&dir.path().join("frames")).unwrap();
        let map = SegmentMap::new(3, 1, vec![0, NO_SEGMENT, 1]).unwrap();
        let features = &[1.0, 0.0, 0.0, 1.0];
        let made = Made { map: &map, features, dim: 2, left_out: 0, single_segment: false };
        assert_eq!(cache.find("a", "key"), None);
        let kept = cache.keep("a", "key", &made).unwrap();
        assert_eq!(cache.find("a", "key"), Some(kept));
        assert_eq!(cache.find("a", "other"), None);
        for ending in ["_s.npy", "_f.npy", ".json"] {
            cache.keep("a", "key", &made).unwrap();
            let path = cache.path("a", ending);
            let bytes = std::fs::read(&path).unwrap();
            std::fs::write(&path, &bytes[..bytes.len() - 1 - usize::from(ending == ".json")])
                .unwrap();
            assert_eq!(cache.find("a", "key"), None, "{ending} cut short");
            std::fs::remove_file(&path).unwrap();
            assert_eq!(cache.find("a", "key"), None, "{ending} missing");
        }
        assert_eq!(sha256(b""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    }
}
