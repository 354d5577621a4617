//! The block of labels as a file beside a scene, for formats that cannot hold it.

use super::{ABOUT, SceneFingerprint, decode, encode_with, has_any, read_about};
use crate::AtomicFile;
use crate::input_file::InputFile;
use crate::{GaussianScene, Policy, RepairReport, SceneError};
use std::io::Write;
use std::path::{Path, PathBuf};

/// What is beside `room.splat`: `room.splat.labels.safetensors`.
fn sidecar_path(scene: &Path) -> PathBuf {
    let mut name = scene.as_os_str().to_owned();
    name.push(".labels.safetensors");
    name.into()
}

/// What is to become of the file beside a scene that is written.
pub(crate) struct Sidecar {
    path: PathBuf,
    /// There are labels of an earlier scene, and none of this one.
    remove: bool,
}

impl Sidecar {
    /// Looks at what is beside the scene that will be written to `scene_path`.
    ///
    /// # Errors
    /// If there are labels already, though not of this scene, and `overwrite` is not set; also if
    /// what is there is no file.
    pub(crate) fn prepare(
        scene: &GaussianScene,
        scene_path: &Path,
        overwrite: bool,
    ) -> Result<Self, SceneError> {
        let path = sidecar_path(scene_path);
        let carries = has_any(scene);
        // A name that is too long, say, must not be found out when the scene is in place already.
        if carries
            && let Err(source) = std::fs::symlink_metadata(&path)
            && source.kind() != std::io::ErrorKind::NotFound
        {
            return Err(SceneError::io(&path, "cannot write the labels beside the scene")(source));
        }
        if carries && path.exists() && !path.is_file() {
            let problem = "is in the way of the labels of the scene: it is not a file";
            return Err(SceneError::format(&path, problem, "remove it or choose another name"));
        }
        // Without labels of its own the scene would come back with those of the earlier one, if
        // their files are the same but for them.
        let there = if carries { path.exists() } else { is_ours(&path) };
        if there && !overwrite {
            let help = "overwrite it or choose another name";
            return Err(SceneError::format(&path, "is there already", help));
        }
        Ok(Self { path, remove: there && !carries })
    }

    /// Puts a finished scene in place, with its labels beside it; `order` is the row of the scene
    /// for each row of the file. Gives the path of the labels, if there are any.
    ///
    /// Until both files are complete nothing changes.
    pub(crate) fn commit(
        self,
        scene: &GaussianScene,
        order: Option<&[u32]>,
        file: AtomicFile,
    ) -> Result<Option<PathBuf>, SceneError> {
        let mut labels = None;
        if has_any(scene) {
            let fingerprint = SceneFingerprint::of(InputFile::of_written(&file)?.bytes());
            labels = stage(scene, order, &self.path, fingerprint)?;
        }
        file.sync()?;
        file.commit()?;
        match labels {
            Some(labels) => {
                labels.commit()?;
                Ok(Some(self.path))
            }
            None if self.remove => {
                let failed = "the scene is written, but these labels of an earlier one could not \
                              be removed";
                std::fs::remove_file(&self.path).map_err(SceneError::io(&self.path, failed))?;
                Ok(None)
            }
            None => Ok(None),
        }
    }
}

/// Writes the block to a file that waits for its name.
fn stage(
    scene: &GaussianScene,
    order: Option<&[u32]>,
    path: &Path,
    belongs_to: SceneFingerprint,
) -> Result<Option<AtomicFile>, SceneError> {
    let Some(block) = encode_with(scene, order, Some(belongs_to)) else { return Ok(None) };
    let file = AtomicFile::create(path)?;
    file.file().write_all(&block).map_err(SceneError::io(path, "cannot write the labels"))?;
    file.sync()?;
    Ok(Some(file))
}

/// Whether this program wrote that file, whole or not.
fn is_ours(path: &Path) -> bool {
    /// Where a block says what it is.
    const HEAD: usize = 4096;
    if !path.is_file() {
        return false;
    }
    let Ok(file) = InputFile::open(path) else { return false };
    let head = &file.bytes()[..file.bytes().len().min(HEAD)];
    read_about(file.bytes()).is_ok() || head.windows(ABOUT.len()).any(|w| w == ABOUT.as_bytes())
}

/// Reads the block beside a scene, if there is one and it belongs to this very file.
///
/// One that was made for another version of the scene is not read: its labels would be those of
/// other Gaussians. Nor is a damaged one, unless the policy is strict: then it is an error. The
/// report says so.
pub(crate) fn read_sidecar(
    path: &Path,
    scene_bytes: &[u8],
    rows: usize,
    policy: Policy,
    scene: &mut GaussianScene,
    report: &mut RepairReport,
) -> Result<(), SceneError> {
    let beside = sidecar_path(path);
    if !beside.is_file() {
        return Ok(());
    }
    match read_block(&beside, scene_bytes, rows, scene, report) {
        Err(error) if policy == Policy::Repair => {
            let why = match error {
                SceneError::Format { problem, .. } => problem,
                SceneError::Io { action, source, .. } => format!("{action}: {source}"),
                other => other.to_string(),
            };
            let beside = beside.display();
            report.notes.push(format!("{beside} is damaged and was not read: {why}"));
            Ok(())
        }
        result => result,
    }
}

fn read_block(
    beside: &Path,
    scene_bytes: &[u8],
    rows: usize,
    scene: &mut GaussianScene,
    report: &mut RepairReport,
) -> Result<(), SceneError> {
    let block = InputFile::open(beside)?;
    let about = read_about(block.bytes()).map_err(|e| {
        let help = "remove it, or write the scene with its labels again";
        SceneError::format(beside, format!("cannot be read as labels of a scene: {e}"), help)
    })?;
    if about.scene != Some(SceneFingerprint::of(scene_bytes)) {
        report.notes.push(format!(
            "{} was made for another version of the scene and was not read",
            beside.display()
        ));
        return Ok(());
    }
    decode(block.bytes(), rows, scene, report, beside)
}
