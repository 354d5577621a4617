//! What was done with a scene, and of what: by this a scene is known to be done.

use super::words::Flags;
use crate::commands::evaluate::KINDS;
use crate::outputs::read_beside;
use crate::receipt::{ReceiptReport, StageTime, sha256_of};
use anyhow::{Context, Result};
use scenesplat::scene::AtomicFile;
use scenesplat::scene::input_file::read_text_file;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The folder of records in the output folder.
pub const RECORDS: &str = "records";
const RECORD: &str = "record.json";
const RECEIPT: &str = "receipt.json";

/// What is known of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Name of its folder.
    pub name: String,
    /// The file or folder that was read.
    pub scene: String,
    /// What became of it.
    pub status: Status,
    /// Why it failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// The job that was done.
    pub job: Job,
    /// The files that were written, sorted.
    pub outputs: Vec<Output>,
    /// Gaussians read.
    pub rows_in: u64,
    /// Gaussians written.
    pub rows_out: u64,
    /// What it cost: the only part that is another each time.
    pub cost: Cost,
}

/// What became of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// Its results are there.
    Done,
    /// There are none.
    Failed,
}

/// All that the result depends on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// The command.
    pub command: String,
    /// The program.
    pub version: String,
    /// Flags and their values; of files and folders, what is in them.
    pub settings: BTreeMap<String, Vec<String>>,
    /// The scene and what is read beside it.
    pub inputs: Vec<Input>,
}

/// A file or folder that was read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Input {
    /// Size, bytes.
    pub bytes: u64,
    /// Of its content.
    pub sha256: String,
}

/// A file that was written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Output {
    /// Its path in the scene's folder.
    pub file: String,
    /// Size, bytes.
    pub bytes: u64,
    /// Of its content.
    pub sha256: String,
}

/// Time and memory.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Wall time of the command, seconds.
    pub seconds: f64,
    /// Most memory of its process, bytes.
    pub peak_memory_bytes: Option<u64>,
    /// Its stages.
    pub stages: Vec<StageTime>,
}

/// What is in files that many scenes share: read once.
#[derive(Debug, Default)]
pub struct Fingerprints(RefCell<BTreeMap<PathBuf, String>>);

impl Fingerprints {
    /// A value of a flag, or what is in the file or folder that it names.
    fn value(&self, text: &str) -> Result<String> {
        let path = Path::new(text);
        if text.is_empty() || !path.exists() {
            return Ok(text.to_owned());
        }
        if let Some(known) = self.0.borrow().get(path) {
            return Ok(known.clone());
        }
        let value = format!("sha256:{}", sha256_of(path)?.0);
        self.0.borrow_mut().insert(path.to_owned(), value.clone());
        Ok(value)
    }
}

impl Job {
    /// The job of a scene.
    ///
    /// # Errors
    /// If something that it reads cannot be read.
    pub fn of(command: &str, scene: &str, flags: &Flags, known: &Fingerprints) -> Result<Self> {
        let mut settings = BTreeMap::new();
        for (flag, values) in flags.that_matter() {
            let values = values.iter().map(|value| known.value(&value.to_string_lossy()));
            settings.insert(flag.to_owned(), values.collect::<Result<_>>()?);
        }
        let version = env!("CARGO_PKG_VERSION").to_owned();
        Ok(Self { command: command.to_owned(), version, settings, inputs: inputs(scene)? })
    }

    /// In what it is another job than that, whatever the scene.
    pub fn differs(&self, other: &Self) -> Option<String> {
        if self.version != other.version {
            return Some(format!("version {} of the program, now {}", other.version, self.version));
        }
        let names: std::collections::BTreeSet<&String> =
            self.settings.keys().chain(other.settings.keys()).collect();
        let name = names.into_iter().find(|n| self.settings.get(*n) != other.settings.get(*n))?;
        let shown = |values: Option<&Vec<String>>| match values {
            None => "left out".to_owned(),
            Some(values) if values.is_empty() => "given".to_owned(),
            Some(values) => values.join(","),
        };
        let (before, now) = (shown(other.settings.get(name)), shown(self.settings.get(name)));
        Some(format!("--{name} {before}, now {now}"))
    }
}

fn inputs(scene: &str) -> Result<Vec<Input>> {
    let path = Path::new(scene);
    if !path.exists() && KINDS.into_iter().any(|kind| scene.starts_with(kind)) {
        // A room that is made: its name says all.
        let sha256 = hex(&Sha256::digest(scene.as_bytes()));
        return Ok(vec![Input { bytes: 0, sha256 }]);
    }
    let beside = read_beside(path).into_iter().filter(|path| path.exists());
    let all = std::iter::once(path.to_owned()).chain(beside);
    all.map(|path| {
        let (sha256, bytes) = sha256_of(&path)?;
        Ok(Input { bytes, sha256 })
    })
    .collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The record of a scene, if there is one.
///
/// # Errors
/// If it cannot be read.
pub fn read_record(out: &Path, name: &str) -> Result<Option<Record>> {
    let path = out.join(RECORDS).join(name).join(RECORD);
    if !path.exists() {
        return Ok(None);
    }
    let text = read_text_file(&path)?;
    let read = serde_json::from_str(&text);
    read.map(Some).with_context(|| {
        format!("{}: no record of this program; remove it to do the scene again", path.display())
    })
}

/// What is wrong with the files of a record: missing, of another size or, with `content`, changed.
pub fn inspect_outputs(out: &Path, record: &Record, content: bool) -> Option<String> {
    let folder = out.join(&record.name);
    record.outputs.iter().find_map(|output| {
        let path = folder.join(&output.file);
        match std::fs::metadata(&path) {
            Err(_) => Some(format!("{} is missing", path.display())),
            Ok(about) if about.len() != output.bytes => {
                Some(format!("{} has {} bytes, not {}", path.display(), about.len(), output.bytes))
            }
            Ok(_) if content => match sha256_of(&path) {
                Ok((sha256, _)) if sha256 == output.sha256 => None,
                Ok(_) => Some(format!("{} was changed", path.display())),
                Err(error) => Some(error.to_string()),
            },
            Ok(_) => None,
        }
    })
}

impl Record {
    /// Of a command that has ended well; its receipt says what it wrote.
    ///
    /// # Errors
    /// If the receipt or a file cannot be read.
    pub fn done(out: &Path, name: &str, scene: &str, job: Job) -> Result<Self> {
        let folder = out.join(name);
        let text = read_text_file(&folder.join(RECEIPT))?;
        let receipt: ReceiptReport = serde_json::from_str(&text)
            .with_context(|| format!("{}: no receipt", folder.join(RECEIPT).display()))?;
        let mut outputs = Vec::new();
        for file in &receipt.written {
            let path = folder.join(&file.path);
            let (sha256, bytes) = sha256_of(&path)?;
            outputs.push(Output { file: file.path.clone(), bytes, sha256 });
        }
        outputs.sort_by(|a, b| a.file.cmp(&b.file));
        outputs.dedup_by(|a, b| a.file == b.file);
        Ok(Self {
            name: name.to_owned(),
            scene: scene.to_owned(),
            status: Status::Done,
            reason: None,
            job,
            outputs,
            rows_in: receipt.rows_in,
            rows_out: receipt.rows_out,
            cost: Cost {
                seconds: receipt.wall_seconds,
                peak_memory_bytes: receipt.peak_memory_bytes,
                stages: receipt.stages,
            },
        })
    }

    /// Of a scene that could not be done.
    pub fn failed(name: &str, scene: &str, job: Job, reason: String, seconds: f64) -> Self {
        Self {
            name: name.to_owned(),
            scene: scene.to_owned(),
            status: Status::Failed,
            reason: Some(reason),
            job,
            outputs: Vec::new(),
            rows_in: 0,
            rows_out: 0,
            cost: Cost { seconds, ..Cost::default() },
        }
    }

    /// Writes it into the output folder.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, out: &Path) -> Result<()> {
        let path = out.join(RECORDS).join(&self.name).join(RECORD);
        let text = serde_json::to_string_pretty(self)? + "\n";
        Ok(AtomicFile::write(&path, text.as_bytes())?)
    }
}
