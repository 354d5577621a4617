//! Rows of a teacher on disk.
//!
//! A file's name is the SHA-256 of everything that its rows depend on: the Gaussians that the teacher was
//! shown, the teacher and its settings, the version of the program and the instruction set. The file holds
//! that too, its sizes, the rows, and a checksum of all of it; what does not agree is not used.

use super::config::CacheConfig;
use super::record::TeacherRecord;
use half::f16;
use scenesplat_datasets::{DataError, Sample, TeacherRows};
use scenesplat_kernels::simd::Isa;
use scenesplat_scene::{AtomicFile, LanguageFeatures};
use sha2::{Digest, Sha256};
use std::io::ErrorKind;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

const MAGIC: &[u8; 8] = b"SPLTEACH";
const EXTENSION: &str = "teacher";
/// Magic, key, and three sizes.
const HEAD: usize = 8 + 32 + 3 * 8;
const CHECKSUM: usize = 32;

/// A folder of rows.
pub(super) struct Cache {
    folder: PathBuf,
    max_bytes: u64,
    record: Arc<TeacherRecord>,
    /// Only one writes, so that the limit holds.
    writing: Mutex<()>,
}

/// What rows depend on.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Key([u8; 32]);

impl Key {
    /// Of the Gaussians shown to a teacher; `teacher` says everything about it.
    pub(super) fn new(teacher: &str, shown: &Sample) -> Self {
        let mut hash = Sha256::new();
        for text in ["rows 1", env!("CARGO_PKG_VERSION"), Isa::current().name(), teacher] {
            hash.update((text.len() as u64).to_le_bytes());
            hash.update(text);
        }
        hash.update((shown.len() as u64).to_le_bytes());
        let mut floats = |name: &str, values: &[f32]| {
            hash.update(name);
            // In pieces: a scene is hundreds of megabytes.
            let mut bytes = Vec::with_capacity(4 << 14);
            for part in values.chunks(1 << 14) {
                bytes.clear();
                part.iter().for_each(|v| bytes.extend_from_slice(&v.to_bits().to_le_bytes()));
                hash.update(&bytes);
            }
        };
        floats("coord", shown.coord.as_flattened());
        floats("color", shown.color.as_flattened());
        floats("opacity", &shown.opacity);
        floats("scale", shown.scale.as_flattened());
        floats("quat", shown.quat.as_flattened());
        if let Some(normal) = &shown.normal {
            floats("normal", normal.as_flattened());
        }
        Self(hash.finalize().into())
    }

    fn file_name(self) -> String {
        let digits: String = self.0.iter().map(|b| format!("{b:02x}")).collect();
        format!("{digits}.{EXTENSION}")
    }
}

impl Cache {
    pub(super) fn new(config: &CacheConfig, record: Arc<TeacherRecord>) -> std::io::Result<Self> {
        std::fs::create_dir_all(&config.folder)?;
        Ok(Self {
            folder: config.folder.clone(),
            max_bytes: (config.max_gb * 1e9) as u64,
            record,
            writing: Mutex::new(()),
        })
    }

    /// The rows of a scene of so many Gaussians, if they are there. A file that is cut off, damaged or of
    /// something else is not used, and noted.
    ///
    /// # Errors
    /// If there is a file that cannot be read.
    pub(super) fn read(
        &self,
        key: Key,
        (scene, gaussians): (&str, usize),
        width: usize,
    ) -> Result<Option<TeacherRows>, DataError> {
        let path = self.folder.join(key.file_name());
        let unreadable = |e: std::io::Error| DataError::teacher(format!("{}: {e}", path.display()));
        let most = HEAD + CHECKSUM + gaussians.saturating_mul(4 + 2 * width);
        let decoded = match std::fs::metadata(&path) {
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(unreadable(e)),
            // Not what was written, and nothing to load into memory.
            Ok(about) if !about.is_file() || about.len() > most as u64 => {
                Err("no file of its rows")
            }
            Ok(_) => decode(&std::fs::read(&path).map_err(unreadable)?, key, gaussians, width),
        };
        match decoded {
            Ok(rows) => {
                self.record.with(|counts| counts.read += 1);
                Ok(Some(rows))
            }
            Err(why) => {
                self.record.remade(scene, why.to_owned());
                Ok(None)
            }
        }
    }

    /// Keeps rows, if there is room for them; what became of it is noted.
    pub(super) fn write(&self, key: Key, rows: &TeacherRows) {
        let bytes = encode(key, rows);
        let path = self.folder.join(key.file_name());
        let _alone = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let old = std::fs::metadata(&path).map_or(0, |m| m.len());
        let held = match self.held() {
            Ok(held) => held,
            Err(e) => return self.record.not_kept(|| format!("{}: {e}", self.folder.display())),
        };
        if held.saturating_sub(old) + bytes.len() as u64 > self.max_bytes {
            let limit = self.max_bytes as f64 / 1e9;
            return self.record.not_kept(|| {
                format!("{} would hold more than {limit} GB (max_gb)", self.folder.display())
            });
        }
        match AtomicFile::write(&path, &bytes) {
            Ok(()) => self.record.with(|counts| counts.kept += 1),
            Err(e) => self.record.not_kept(|| e.to_string()),
        }
    }

    /// Bytes of all rows in the folder.
    fn held(&self) -> std::io::Result<u64> {
        let mut held = 0;
        for entry in std::fs::read_dir(&self.folder)? {
            let entry = entry?;
            if entry.path().extension().is_some_and(|e| e == EXTENSION) {
                // Another run may have replaced it meanwhile.
                held += entry.metadata().map_or(0, |m| m.len());
            }
        }
        Ok(held)
    }
}

fn encode(key: Key, taught: &TeacherRows) -> Vec<u8> {
    let TeacherRows { rows, row_of } = taught;
    let mut bytes = Vec::with_capacity(HEAD + 4 * row_of.len() + 2 * rows.values.len() + CHECKSUM);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&key.0);
    for size in [row_of.len(), taught.num_rows(), rows.dim] {
        bytes.extend_from_slice(&(size as u64).to_le_bytes());
    }
    row_of.iter().for_each(|row| bytes.extend_from_slice(&row.to_le_bytes()));
    rows.values.iter().for_each(|v| bytes.extend_from_slice(&v.to_bits().to_le_bytes()));
    let checksum = Sha256::digest(&bytes);
    bytes.extend_from_slice(&checksum);
    bytes
}

fn decode(
    bytes: &[u8],
    key: Key,
    gaussians: usize,
    width: usize,
) -> Result<TeacherRows, &'static str> {
    if bytes.len() < HEAD + CHECKSUM || !bytes.starts_with(MAGIC) {
        return Err("no file of rows, or cut off");
    }
    if bytes[8..40] != key.0 {
        return Err("rows of another scene, teacher or setting");
    }
    let (content, checksum) = bytes.split_at(bytes.len() - CHECKSUM);
    if Sha256::digest(content)[..] != *checksum {
        return Err("cut off or damaged");
    }
    let size = |i: usize| {
        let mut size = [0; 8];
        size.copy_from_slice(&bytes[40 + 8 * i..48 + 8 * i]);
        usize::try_from(u64::from_le_bytes(size)).unwrap_or(usize::MAX)
    };
    let (n, rows, dim) = (size(0), size(1), size(2));
    let values = rows.checked_mul(dim);
    let expected =
        values.and_then(|v| v.checked_mul(2)?.checked_add(n.checked_mul(4)?)?.checked_add(HEAD));
    if (n, dim) != (gaussians, width) || expected != Some(content.len()) {
        return Err("rows of another size");
    }
    let (of, values) = content[HEAD..].split_at(4 * n);
    let row_of = of.as_chunks::<4>().0.iter().map(|b| u32::from_le_bytes(*b)).collect();
    let values =
        values.as_chunks::<2>().0.iter().map(|b| f16::from_bits(u16::from_le_bytes(*b))).collect();
    let taught = TeacherRows { rows: LanguageFeatures { values, dim }, row_of };
    taught.check(gaussians).map_err(|_| "rows that are not there")?;
    Ok(taught)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_rooms::{SyntheticRoomSettings, generate};

    fn shown(seed: u64) -> Sample {
        let room = generate(&SyntheticRoomSettings::with_count(50, seed)).unwrap();
        Sample::from_scene("room", room.scene)
    }

    fn rows(gaussians: usize) -> TeacherRows {
        let values = (0..40).map(|i| f16::from_f32(i as f32)).collect();
        let row_of = (0..gaussians as u32).map(|i| if i == 3 { u32::MAX } else { i % 10 });
        TeacherRows { rows: LanguageFeatures { values, dim: 4 }, row_of: row_of.collect() }
    }

    fn cache(folder: &std::path::Path, max_gb: f64) -> Cache {
        Cache::new(&CacheConfig { folder: folder.join("rows"), max_gb }, Arc::default()).unwrap()
    }

    #[test]
    fn rows_come_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache(folder.path(), 1.0);
        let key = Key::new("teacher", &shown(1));
        assert!(cache.read(key, ("a", 50), 4).unwrap().is_none());
        cache.write(key, &rows(50));
        assert_eq!(cache.read(key, ("a", 50), 4).unwrap().unwrap(), rows(50));
        let did = cache.record.to_json();
        assert_eq!(did["cache"]["kept"], 1);
        assert_eq!(did["cache"]["read"], 1);
        assert_eq!(cache.record.remark(), None);
    }

    #[test]
    fn everything_that_rows_depend_on_is_in_the_key() {
        let key = Key::new("teacher", &shown(1));
        assert!(key == Key::new("teacher", &shown(1)));
        assert!(key != Key::new("teacher 2", &shown(1)));
        assert!(key != Key::new("teacher", &shown(2)));
        type Change = fn(&mut Sample);
        let changes: [Change; 6] = [
            |s| s.coord[7][2] += 1e-6,
            |s| s.color[7][0] += 1.0,
            |s| s.opacity[0] *= 0.5,
            |s| s.scale[49][1] *= 2.0,
            |s| s.quat[3][0] = -s.quat[3][0],
            |s| s.normal = Some(vec![[0.0, 0.0, 1.0]; 50]),
        ];
        for (i, change) in changes.iter().enumerate() {
            let mut other = shown(1);
            other.normal = None;
            let plain = Key::new("teacher", &other);
            change(&mut other);
            assert!(plain != Key::new("teacher", &other), "change {i}");
        }
    }

    #[test]
    fn what_is_not_the_rows_is_never_used() {
        let folder = tempfile::tempdir().unwrap();
        let cache = cache(folder.path(), 1.0);
        let key = Key::new("teacher", &shown(1));
        let other = Key::new("teacher", &shown(2));
        let path = folder.path().join("rows").join(key.file_name());
        let good = encode(key, &rows(50));
        let mut remade = 0;
        let mut refused = |bytes: &[u8], why: &str| {
            std::fs::write(&path, bytes).unwrap();
            assert!(cache.read(key, ("scene-7", 50), 4).unwrap().is_none(), "{why}");
            remade += 1;
            let did = cache.record.to_json();
            assert_eq!(did["cache"]["remade"], remade);
            let told = did["cache"]["why_remade"]["scene-7"].to_string();
            assert!(told.contains(why), "{told}: {why}");
        };
        for length in [0, 7, 40, HEAD, good.len() - 1] {
            refused(&good[..length], "cut off");
        }
        for at in [HEAD + 3, HEAD + 210, good.len() - 1] {
            let mut damaged = good.clone();
            damaged[at] ^= 1;
            refused(&damaged, "damaged");
        }
        refused(&encode(other, &rows(50)), "another scene");
        refused(&encode(key, &rows(51)), "another size");
        let beyond = TeacherRows { row_of: vec![10; 50], ..rows(50) };
        refused(&encode(key, &beyond), "not there");
        refused(&[good.clone(), vec![0]].concat(), "damaged");
        refused(&[good.clone(), vec![0; 4000]].concat(), "no file of its rows");
        assert!(cache.record.remark().unwrap().contains("scene-7"));
        // Written anew, it is used again.
        cache.write(key, &rows(50));
        assert!(cache.read(key, ("scene-7", 50), 4).unwrap().is_some());
    }

    #[test]
    fn the_folder_never_holds_more_than_its_limit() {
        let folder = tempfile::tempdir().unwrap();
        let size = encode(Key([0; 32]), &rows(50)).len();
        let cache = cache(folder.path(), 2.5e-9 * size as f64);
        let keys: Vec<Key> = (0..4).map(|seed| Key::new("teacher", &shown(seed))).collect();
        keys.iter().for_each(|key| cache.write(*key, &rows(50)));
        assert_eq!(cache.held().unwrap(), 2 * size as u64);
        // What is there may be replaced.
        cache.write(keys[0], &rows(50));
        let did = cache.record.to_json();
        assert_eq!((&did["cache"]["kept"], &did["cache"]["not_kept"]), (&3.into(), &2.into()));
        assert!(cache.record.remark().unwrap().contains("max_gb"));
        // Nothing half-written is left behind.
        assert_eq!(std::fs::read_dir(folder.path().join("rows")).unwrap().count(), 2);
    }
}
