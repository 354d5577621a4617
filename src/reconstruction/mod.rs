//! What self-supervised training makes of Gaussians that it does not see: a scene, the scene with parts of it
//! masked, and with what is reconstructed in their place.

mod pictures;

pub use pictures::{ReconstructionPicture, ReconstructionPictures};

use crate::experiment::{ExperimentConfig, ExperimentError, exported_checkpoint};
use scenesplat_datasets::transforms::{build_transforms, validation};
use scenesplat_datasets::{
    DataError, InputChannel, InputFeatures, Masking, Sample, collate_samples, sample_rng,
};
use scenesplat_models::weights::WeightSource;
use scenesplat_models::{LoadPolicy, ModelConfig, ParamStore};
use scenesplat_scene::gaussian_scene::{SH_C0, probability_to_logit};
use scenesplat_scene::{GaussianScene, SceneError};
use scenesplat_trainers::TrainError;
use scenesplat_trainers::checkpoint::{read_network, read_state, read_store};
use scenesplat_trainers::tasks::self_supervised::{Compat, Reconstructor};
use std::path::{Path, PathBuf};

/// Sizes below this are drawn as this, meters.
const LEAST_SIZE: f32 = 1e-4;

/// Why nothing is reconstructed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReconstructionError {
    /// A run of another task.
    #[error("{}: a run of another task; masked Gaussians are reconstructed by task = \"self_supervised\"", path.display())]
    OtherTask {
        /// Which run.
        path: PathBuf,
    },
    /// A run without masks.
    #[error("{}: self_supervised.masking is not given, so nothing was ever masked", path.display())]
    NoMasking {
        /// Which run.
        path: PathBuf,
    },
    /// A scene without Gaussians.
    #[error("the scene has no Gaussian to mask")]
    Empty,
    /// A run that cannot be read.
    #[error(transparent)]
    Experiment(Box<ExperimentError>),
    /// A checkpoint that cannot be read.
    #[error(transparent)]
    Checkpoint(#[from] TrainError),
    /// A scene that is no input.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A scene whose arrays do not match.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A network that does not fit its parameters, or cannot be run.
    #[error(transparent)]
    Model(#[from] candle_core::Error),
}

impl From<ExperimentError> for ReconstructionError {
    fn from(error: ExperimentError) -> Self {
        Self::Experiment(Box::new(error))
    }
}

/// A self-supervised run with the term `masked_gaussians`: its student with the head.
#[derive(Debug)]
pub struct ReconstructionRun {
    reconstructor: Reconstructor,
    model: ModelConfig,
    input: InputFeatures,
    masking: Masking,
    /// Which checkpoint it is.
    pub checkpoint: String,
    /// Step of the checkpoint.
    pub step: u64,
}

/// A scene with parts of it masked, and what is reconstructed.
#[derive(Debug, Clone)]
pub struct Reconstruction {
    /// Gaussians whose voxel is masked. `[N]`
    pub hidden: Vec<bool>,
    /// Those that are not.
    pub masked: GaussianScene,
    /// All of them, those of masked voxels with what is reconstructed for their voxel: color, opacity,
    /// rotation and sizes as far as the network reads them; where they are is known.
    pub reconstructed: GaussianScene,
    /// Voxels, and those that are masked.
    pub voxels: [usize; 2],
    /// Mean absolute difference, over masked voxels, of each kind of input channel from what the network
    /// would have read, in the units of [`InputFeatures`]; rotations at unit length, one and its negative the
    /// same.
    pub errors: Vec<(InputChannel, f64)>,
}

impl ReconstructionRun {
    /// Opens the folder of a run: its `config.toml`, and the checkpoint that became its model.
    ///
    /// # Errors
    /// If it is no run of this task, or a file cannot be read or does not fit.
    pub fn open(run: &Path) -> Result<Self, ReconstructionError> {
        let config = ExperimentConfig::read(&run.join("config.toml"))?;
        let Some(settings) = &config.self_supervised else {
            return Err(ReconstructionError::OtherTask { path: run.to_owned() });
        };
        let (dir, checkpoint) = exported_checkpoint(&run.join("checkpoints"))?;
        let at = read_state(&dir)?.progress;
        let Some(masking) = settings.masking_at(at.step, at.total_steps) else {
            return Err(ReconstructionError::NoMasking { path: run.to_owned() });
        };
        let store = |tensors| ParamStore::frozen(WeightSource::tensors(tensors));
        let params = store(read_network(&dir)?.into_iter().collect());
        let heads = match settings.compat {
            Compat::None => params.clone(),
            Compat::Original => store(read_store(&dir, "heads")?.into_iter().collect()),
        };
        let network = config.network()?;
        let reconstructor =
            Reconstructor::new(settings, &network.model, &network.input, &params, &heads)?;
        for store in [&params, &heads] {
            // Other heads and, of the original's, the network are in the files, too.
            store.report().check(LoadPolicy::AllowUnexpected, &dir.display().to_string())?;
        }
        Ok(Self {
            reconstructor,
            masking,
            checkpoint,
            step: at.step,
            model: network.model,
            input: network.input,
        })
    }

    /// How it masks: as at the step of the checkpoint.
    pub fn masking(&self) -> &Masking {
        &self.masking
    }

    /// Masks a scene by `seed` as training did, only that every scene is masked, and reconstructs it. The
    /// scene is read as networks read it, a Gaussian a voxel, and not augmented; z is up, lengths are
    /// meters.
    ///
    /// # Errors
    /// If the scene has no Gaussian or is no input of the network.
    pub fn reconstruct(
        &self,
        scene: &GaussianScene,
        seed: u64,
    ) -> Result<Reconstruction, ReconstructionError> {
        scene.check_rows()?;
        if scene.is_empty() {
            return Err(ReconstructionError::Empty);
        }
        let mut sample = Sample::from_scene("scene", scene.clone());
        for step in build_transforms(&validation(self.model.grid_size))? {
            step.apply(&mut sample, &mut sample_rng(0, 0, 0))?;
        }
        let voxel_of = match sample.full.take() {
            Some(full) => full.voxel,
            None => (0..scene.len() as u32).collect(),
        };
        let batch = collate_samples(vec![sample], &self.input)?;
        let masking = Masking { scenes: 1.0, ..self.masking };
        let masked = masking.choose(&batch.coord, &batch.offsets, seed, self.step)?;
        let rows = self.reconstructor.rows(&batch, &masked.hidden)?;
        let width = self.input.width();
        // Where the row of each hidden voxel stands.
        let mut place = vec![None; batch.len()];
        let hidden_voxels = (0..batch.len()).filter(|&v| masked.hidden[v]);
        let hidden_voxels: Vec<usize> = hidden_voxels.collect();
        hidden_voxels.iter().enumerate().for_each(|(i, &voxel)| place[voxel] = Some(i));
        let hidden: Vec<bool> = voxel_of.iter().map(|&v| masked.hidden[v as usize]).collect();
        let visible: Vec<usize> = (0..scene.len()).filter(|&row| !hidden[row]).collect();
        let mut reconstructed = scene.clone();
        for (row, voxel) in voxel_of.iter().enumerate() {
            if let Some(i) = place[*voxel as usize] {
                self.put(&rows[i * width..(i + 1) * width], row, &mut reconstructed);
            }
        }
        let truth: Vec<&[f32]> =
            hidden_voxels.iter().map(|&v| &batch.feat[v * width..(v + 1) * width]).collect();
        Ok(Reconstruction {
            errors: self.errors(&rows, &truth),
            masked: scene.select_rows(&visible)?,
            reconstructed,
            hidden,
            voxels: [batch.len(), hidden_voxels.len()],
        })
    }

    /// Gives a Gaussian the attributes of a row.
    fn put(&self, row: &[f32], at: usize, scene: &mut GaussianScene) {
        let mut start = 0;
        for channel in &self.input.channels {
            let values = &row[start..start + channel.width()];
            start += channel.width();
            match channel {
                InputChannel::Color | InputChannel::UnitColor => {
                    let unit = *channel == InputChannel::UnitColor;
                    scene.sh_dc[at] = std::array::from_fn(|c| {
                        let color = if unit { values[c] } else { (values[c] + 1.0) / 2.0 };
                        let color = color.clamp(0.0, 1.0);
                        (color - 0.5) / SH_C0
                    });
                    let rest = 3 * scene.sh_rest_len();
                    scene.sh_rest[at * rest..(at + 1) * rest].fill(0.0);
                }
                InputChannel::Opacity => {
                    scene.opacity_logit[at] = probability_to_logit(values[0].clamp(0.0, 1.0));
                }
                InputChannel::Quat => {
                    let norm = values.iter().map(|v| v * v).sum::<f32>().sqrt();
                    let identity = [1.0, 0.0, 0.0, 0.0];
                    scene.quat[at] = std::array::from_fn(|c| {
                        if norm > 1e-6 { values[c] / norm } else { identity[c] }
                    });
                }
                InputChannel::Scale => {
                    let largest = self.input.scale_clip.map_or(f32::MAX, |[_, high]| high);
                    scene.log_scale[at] = std::array::from_fn(|c| {
                        values[c].clamp(LEAST_SIZE, largest.max(LEAST_SIZE)).ln()
                    });
                }
                InputChannel::Normal => {
                    if let Some(normal) = &mut scene.normal {
                        normal[at] = std::array::from_fn(|c| values[c]);
                    }
                }
                // Where it is, is known.
                InputChannel::Height | InputChannel::Position => {}
            }
        }
    }

    /// Mean absolute differences of each kind of channel.
    fn errors(&self, rows: &[f32], truth: &[&[f32]]) -> Vec<(InputChannel, f64)> {
        let width = self.input.width();
        let mut start = 0;
        let mut all = Vec::new();
        for channel in &self.input.channels {
            let columns = start..start + channel.width();
            start = columns.end;
            let mut sum = 0.0;
            for (row, truth) in rows.chunks_exact(width).zip(truth) {
                let (a, b) = (&row[columns.clone()], &truth[columns.clone()]);
                // A rotation is drawn at unit length, whatever the length that the head gives it.
                let is_rotation = *channel == InputChannel::Quat;
                let norm = a.iter().map(|v| v * v).sum::<f32>().sqrt();
                let length = if is_rotation && norm > 0.0 { norm } else { 1.0 };
                let far = |sign: f32| -> f64 {
                    a.iter().zip(b).map(|(a, b)| f64::from((a / length - sign * b).abs())).sum()
                };
                sum += if is_rotation { far(1.0).min(far(-1.0)) } else { far(1.0) };
            }
            let count = (truth.len() * channel.width()).max(1);
            all.push((*channel, sum / count as f64));
        }
        all
    }
}
