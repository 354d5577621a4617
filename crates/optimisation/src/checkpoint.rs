//! Checkpoints: everything that a step depends on, in a folder that appears whole.

use crate::frame::{Colors, TrainingFrame};
use crate::model::Stored;
use crate::settings::OptimiseSettings;
use crate::{Model, Moments, OptimiseError, Optimiser};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use scenesplat_scene::WholeFolder;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Everything but the arrays.
#[derive(Debug, Serialize, Deserialize)]
struct State {
    /// Version of this file.
    version: u32,
    step: u64,
    adam_steps: u64,
    scene_scale: f64,
    settings: OptimiseSettings,
    frames: Vec<FrameMark>,
    exposure_steps: Vec<u64>,
}

/// Identifies a frame.
#[derive(Debug, Serialize, Deserialize, PartialEq)]
struct FrameMark {
    name: String,
    width: u32,
    height: u32,
    /// FNV-1a of pose, lens, picture, alpha, depth and mask: 64 bits as text.
    hash: String,
}

/// The version of a state, whatever else is in it.
#[derive(Deserialize)]
struct Versioned {
    version: u32,
}

const VERSION: u32 = 2;
const STATE: &str = "state.json";
const ARRAYS: &str = "arrays.safetensors";
/// Parameters that Adam has moments of.
const GROUPS: [&str; 5] = ["means", "quats", "scales", "opacities", "sh"];

/// FNV-1a, eight bytes at a time.
struct Hash(u64);

impl Hash {
    fn add(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.0 = (self.0 ^ u64::from_le_bytes(word)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    fn floats(&mut self, values: &[f32]) {
        values.iter().for_each(|v| self.add(&v.to_le_bytes()));
    }
}

impl FrameMark {
    fn of(frame: &TrainingFrame) -> Self {
        let v = &frame.view;
        let mut hash = Hash(0xcbf2_9ce4_8422_2325);
        hash.floats(v.world_to_camera.as_flattened());
        hash.floats(&[v.fx, v.fy, v.cx, v.cy]);
        match &frame.rgb {
            Colors::Bytes(values) => hash.add(values),
            Colors::Floats(values) => hash.floats(values),
        }
        hash.floats(frame.depth.as_deref().unwrap_or_default());
        hash.add(frame.mask.as_deref().unwrap_or_default());
        hash.add(frame.alpha.as_deref().unwrap_or_default());
        let (name, hash) = (frame.name.clone(), format!("{:016x}", hash.0));
        Self { name, width: v.width, height: v.height, hash }
    }
}

fn bad(path: &Path, problem: impl Into<String>, help: &'static str) -> OptimiseError {
    OptimiseError::Checkpoint { path: path.to_owned(), problem: problem.into(), help }
}

fn damaged(path: &Path, problem: &(impl ToString + ?Sized)) -> OptimiseError {
    bad(path, problem.to_string(), "take an older checkpoint, or begin anew")
}

/// The folder of a step in `root`.
fn folder_of(root: &Path, step: u64) -> PathBuf {
    root.join(format!("step-{step:09}"))
}

/// The newest checkpoint in `root`, `None` without any.
///
/// # Errors
/// If the folder cannot be read.
pub fn newest_checkpoint(root: &Path) -> Result<Option<PathBuf>, OptimiseError> {
    if !root.exists() {
        return Ok(None);
    }
    let failed = |error: std::io::Error| bad(root, error.to_string(), "is it a folder?");
    let mut newest = None;
    for entry in std::fs::read_dir(root).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let step = path.file_name().and_then(|n| n.to_str()?.strip_prefix("step-")?.parse().ok());
        let step: Option<u64> = step.filter(|_| path.join(STATE).is_file());
        newest = newest.max(step.map(|step| (step, path)));
    }
    Ok(newest.map(|(_, path)| path))
}

impl Optimiser {
    /// Writes a checkpoint into `root`, and removes those before it but for the `keep` newest.
    ///
    /// # Errors
    /// If it cannot be written; what was there is then as it was.
    pub fn save(
        &self,
        root: &Path,
        frames: &[TrainingFrame],
        keep: usize,
    ) -> Result<PathBuf, OptimiseError> {
        let place = folder_of(root, self.step);
        let folder = WholeFolder::create(&place)?;
        let state = State {
            version: VERSION,
            step: self.step,
            adam_steps: self.adam.steps,
            scene_scale: self.scene_scale,
            settings: self.settings,
            frames: frames.iter().map(FrameMark::of).collect(),
            exposure_steps: self.exposure.steps.clone(),
        };
        let text = serde_json::to_vec_pretty(&state).map_err(|e| bad(&place, e.to_string(), ""))?;
        folder.write(ARRAYS, &self.arrays(&place)?)?;
        folder.write(STATE, &text)?;
        folder.commit()?;
        let mut steps: Vec<u64> = Vec::new();
        for entry in std::fs::read_dir(root).into_iter().flatten().flatten() {
            let name = entry.file_name();
            steps.extend(name.to_str().and_then(|n| n.strip_prefix("step-")?.parse::<u64>().ok()));
        }
        steps.retain(|step| *step < self.step);
        steps.sort_unstable_by(|a, b| b.cmp(a));
        for old in steps.into_iter().skip(keep.saturating_sub(1)) {
            let path = folder_of(root, old);
            let failed = |e: std::io::Error| {
                bad(
                    &path,
                    format!("cannot be removed: {e}"),
                    "remove it, or change its permissions",
                )
            };
            std::fs::remove_dir_all(&path).map_err(failed)?;
        }
        Ok(place)
    }

    fn arrays(&self, path: &Path) -> Result<Vec<u8>, OptimiseError> {
        let n = self.model.len();
        let g = self.model.gaussians();
        let width = self.model.sh_stride();
        let mut list: Vec<(String, Vec<usize>, &[f32])> = vec![
            ("means".into(), vec![n, 3], g.means.as_flattened()),
            ("quats".into(), vec![n, 4], g.quats.as_flattened()),
            ("log_scales".into(), vec![n, 3], self.model.log_scales.as_flattened()),
            ("logits".into(), vec![n], &self.model.logits),
            ("sh".into(), vec![n, width / 3, 3], &g.sh),
            ("doubling.sum".into(), vec![self.doubling.sum.len()], &self.doubling.sum),
            ("doubling.count".into(), vec![self.doubling.count.len()], &self.doubling.count),
            ("exposure".into(), vec![self.exposure.steps.len(), 6], &self.exposure.values),
        ];
        let a = &self.adam;
        let groups = [&a.means, &a.quats, &a.scales, &a.opacities, &a.sh];
        for (name, moments) in GROUPS.iter().zip(groups) {
            list.push((format!("adam.{name}.first"), vec![moments.first.len()], &moments.first));
            list.push((format!("adam.{name}.second"), vec![moments.second.len()], &moments.second));
        }
        for (i, moments) in self.exposure.moments.iter().enumerate() {
            list.push((format!("exposure.{i}.first"), vec![6], &moments.first));
            list.push((format!("exposure.{i}.second"), vec![6], &moments.second));
        }
        let bytes: Vec<Vec<u8>> = list
            .iter()
            .map(|(_, _, values)| values.iter().flat_map(|v| v.to_le_bytes()).collect())
            .collect();
        let failed = |e: safetensors::SafeTensorError| bad(path, e.to_string(), "");
        let mut views = Vec::with_capacity(list.len());
        for ((name, shape, _), bytes) in list.iter().zip(&bytes) {
            views.push((name, TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(failed)?));
        }
        safetensors::serialize(views, None).map_err(failed)
    }

    /// Resumes from a checkpoint, with the same frames and the settings it was made with.
    ///
    /// # Errors
    /// If it is damaged, of other frames, or if `settings` are others than those it was made with (only
    /// the step at which to end is the caller's).
    pub fn resume(
        checkpoint: &Path,
        frames: &[TrainingFrame],
        settings: Option<OptimiseSettings>,
    ) -> Result<Self, OptimiseError> {
        let state = State::read(&checkpoint.join(STATE), frames, settings)?;
        let path = checkpoint.join(ARRAYS);
        let bytes = std::fs::read(&path).map_err(|e| damaged(&path, &e))?;
        let file = SafeTensors::deserialize(&bytes).map_err(|e| damaged(&path, &e))?;
        let arrays = Arrays { path: &path, file };
        let mut this = Self::new(arrays.model(&state.settings)?, frames, state.settings)?;
        this.scene_scale = state.scene_scale;
        this.step = state.step;
        let a = &mut this.adam;
        a.steps = state.adam_steps;
        let groups = [&mut a.means, &mut a.quats, &mut a.scales, &mut a.opacities, &mut a.sh];
        for (name, moments) in GROUPS.iter().zip(groups) {
            *moments = arrays.moments(&format!("adam.{name}"), moments.first.len())?;
        }
        this.doubling.sum = arrays.read("doubling.sum", None)?;
        this.doubling.count = arrays.read("doubling.count", Some(this.doubling.sum.len()))?;
        let exposures = this.exposure.steps.len();
        if state.exposure_steps.len() != exposures {
            return Err(damaged(&path, "has exposures of other frames"));
        }
        this.exposure.steps = state.exposure_steps;
        this.exposure.values = arrays.read("exposure", Some(6 * exposures))?;
        for i in 0..exposures {
            this.exposure.moments[i] = arrays.moments(&format!("exposure.{i}"), 6)?;
        }
        Ok(this)
    }
}

impl State {
    /// Reads the state of a run of these frames.
    fn read(
        path: &Path,
        frames: &[TrainingFrame],
        settings: Option<OptimiseSettings>,
    ) -> Result<Self, OptimiseError> {
        let text = std::fs::read(path).map_err(|e| damaged(path, &e))?;
        // Before all else: another version has other fields.
        let written: Versioned = serde_json::from_slice(&text).map_err(|e| damaged(path, &e))?;
        if written.version != VERSION {
            let version = written.version;
            let problem = format!("is of version {version}, this program reads {VERSION}");
            return Err(bad(path, problem, "resume with the program that wrote it"));
        }
        let state: Self = serde_json::from_slice(&text).map_err(|e| damaged(path, &e))?;
        if settings.is_some_and(|settings| settings != state.settings) {
            let problem = "was made with other settings";
            return Err(bad(path, problem, "give the flags of the first run, or another --out"));
        }
        let other = |problem| {
            Err(bad(path, problem, "give the cameras, pictures and depths of the first run"))
        };
        let marks: Vec<FrameMark> = frames.iter().map(FrameMark::of).collect();
        if let Some((a, b)) = marks.iter().zip(&state.frames).find(|(a, b)| a != b) {
            return other(format!("is of other frames: {:?} is not {:?}", a.name, b.name));
        }
        if marks.len() != state.frames.len() {
            return other(format!("is of {} frames, not of {}", state.frames.len(), marks.len()));
        }
        Ok(state)
    }
}

/// The arrays of a checkpoint.
struct Arrays<'a> {
    path: &'a Path,
    file: SafeTensors<'a>,
}

impl Arrays<'_> {
    fn read(&self, name: &str, len: Option<usize>) -> Result<Vec<f32>, OptimiseError> {
        let view = self.file.tensor(name).map_err(|e| damaged(self.path, &e))?;
        if view.dtype() != Dtype::F32 {
            return Err(damaged(self.path, &format!("{name} is {:?}, not F32", view.dtype())));
        }
        let words = view.data().as_chunks::<4>().0;
        let values: Vec<f32> = words.iter().map(|w| f32::from_le_bytes(*w)).collect();
        if let Some(len) = len.filter(|len| *len != values.len()) {
            let problem = format!("{name} has {} values, not {len}", values.len());
            return Err(damaged(self.path, &problem));
        }
        Ok(values)
    }

    fn moments(&self, name: &str, len: usize) -> Result<Moments, OptimiseError> {
        let read = |which: &str| self.read(&format!("{name}.{which}"), Some(len));
        Ok(Moments { first: read("first")?, second: read("second")? })
    }

    fn model(&self, settings: &OptimiseSettings) -> Result<Model, OptimiseError> {
        let logits = self.read("logits", None)?;
        let n = logits.len();
        let means = self.read("means", Some(3 * n))?;
        let quats = self.read("quats", Some(4 * n))?;
        let log_scales = self.read("log_scales", Some(3 * n))?;
        let (means, quats) = (means.as_chunks::<3>().0, quats.as_chunks::<4>().0);
        let log_scales = log_scales.as_chunks::<3>().0;
        let row = |i: usize| Stored {
            mean: means[i],
            log_scale: log_scales[i],
            quat: quats[i],
            logit: logits[i],
        };
        let rows: Vec<Stored> = (0..n).map(row).collect();
        Model::from_arrays(&rows, self.read("sh", None)?, settings.initial.sh_degree)
    }
}

#[cfg(test)]
mod tests;
