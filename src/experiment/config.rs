//! An experiment as a file.

mod file;

use super::error::{ExperimentError, Place};
use crate::NetworkConfig;
use scenesplat_datasets::transforms::{self, LimitLabels, TransformConfig};
use scenesplat_datasets::{InputFeatures, LoaderSettings, MixRule, SourceConfig};
use scenesplat_kernels::settings;
use scenesplat_losses::LossConfig;
use scenesplat_models::{Compute, ModelConfig};
use scenesplat_trainers::callbacks::EarlyStopping;
use scenesplat_trainers::tasks::autoencoder::AutoencoderConfig;
use scenesplat_trainers::tasks::self_supervised::SelfSupervisedConfig;
use scenesplat_trainers::{
    AdamWConfig, CosineSchedule, Criterion, KeywordGroup, OneCycle, TrainerConfig,
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

use super::limits::LimitsConfig;
use super::teacher::TeacherConfig;
use file::{read_table, set};

type Result<T, E = ExperimentError> = std::result::Result<T, E>;

/// What is trained, on what, and how. The file is TOML; relative paths start at its folder, also
/// those that it takes from a file that it extends.
///
/// `extends = "other.toml"` takes everything from another file first; tables are joined, everything
/// else (lists too) is replaced. So configurations of one family differ in what differs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExperimentConfig {
    /// What the network is trained for.
    pub task: Task,
    /// The network: its architecture, head and voxel size.
    #[serde(default)]
    pub model: ModelConfig,
    /// Form of the numbers that are multiplied: `f32`, `split` or `bf16`. Parameters, sums, norms,
    /// softmax and losses are f32 in any case.
    #[serde(default = "f32_name")]
    pub precision: String,
    /// Seed of the parameters' first values.
    #[serde(default)]
    pub model_seed: u64,
    /// Weights to start from; what fits is taken, and what does not is listed.
    #[serde(default)]
    pub init_from: Option<PathBuf>,
    /// What the network reads of a Gaussian.
    #[serde(default)]
    pub input: InputFeatures,
    /// Data to train on; several are taken in turns by their weights.
    pub train: Vec<TrainDataConfig>,
    /// How the weights of several datasets count.
    #[serde(default)]
    pub mix: MixRule,
    /// How scenes become batches.
    #[serde(default)]
    pub loader: LoaderSettings,
    /// Where the targets of language pretraining come from.
    #[serde(default)]
    pub targets: TargetChoice,
    /// Whose rows the network shall learn, in distillation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub teacher: Option<TeacherConfig>,
    /// Texts of the classes, for targets and zero-shot evaluation.
    #[serde(default)]
    pub text: Option<TextConfig>,
    /// The terms of the loss; those of self-supervised training are in its own table.
    #[serde(default)]
    pub losses: Vec<LossConfig>,
    /// Terms, masks and teacher of self-supervised training.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub self_supervised: Option<SelfSupervisedConfig>,
    /// Widths and weights of an autoencoder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub autoencoder: Option<AutoencoderConfig>,
    /// AdamW and its groups.
    #[serde(default)]
    pub optimizer: OptimizerConfig,
    /// How the learning rate varies.
    #[serde(default)]
    pub schedule: ScheduleConfig,
    /// The loop.
    #[serde(default)]
    pub trainer: TrainerConfig,
    /// Scenes to evaluate on.
    #[serde(default)]
    pub evaluate: Vec<EvaluationConfig>,
    /// Ends the run when it no longer gets better.
    #[serde(default)]
    pub early_stopping: Option<EarlyStoppingConfig>,
    /// Less data than there is.
    // Not written where there is none: runs from before it was there go on.
    #[serde(default, skip_serializing_if = "LimitsConfig::is_off")]
    pub limits: LimitsConfig,
}

fn f32_name() -> String {
    "f32".to_owned()
}

/// Scenes to train on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainDataConfig {
    /// Where they come from.
    pub source: SourceConfig,
    /// What is done to each.
    pub transforms: TransformList,
    /// How many labels of each are learned from, before all transforms; all if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub labels: Option<LimitLabels>,
    /// How often each comes in an epoch, with other random numbers each time.
    #[serde(default = "one")]
    pub repeat: usize,
    /// Weight among several datasets, see `mix`.
    #[serde(default = "one")]
    pub weight: usize,
    /// Seed of the transforms.
    #[serde(default)]
    pub seed: u64,
}

/// Scenes to evaluate on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Prefix of the measurements.
    pub name: String,
    /// Where the scenes come from.
    pub source: SourceConfig,
    /// What is done to each.
    #[serde(default = "validation")]
    pub transforms: TransformList,
    /// Neighbors that vote on each label. If not given, as the paper evaluates: 25, but for logits
    /// where the Gaussians themselves are labeled, which are not voted on (1).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vote_k: Option<usize>,
    /// Texts of these scenes' classes, where they are others than those of the experiment.
    #[serde(default)]
    pub text: Option<TextConfig>,
}

fn one() -> usize {
    1
}

fn validation() -> TransformList {
    TransformList::Preset("validation".to_owned())
}

/// What a network is trained for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Task {
    /// Features shall be language features.
    LanguagePretraining,
    /// Logits shall name the class.
    SemanticSegmentation,
    /// Features shall be those of a teacher.
    Distillation,
    /// What is hidden of scenes, and what their views have in common; no labels.
    SelfSupervised,
    /// Language features shall come back from few numbers.
    Autoencoder,
}

/// Where targets of language pretraining come from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TargetChoice {
    /// The scenes' own language features.
    #[default]
    Features,
    /// The text of each row's class.
    ClassText,
}

/// Texts of the classes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, tag = "type", rename_all = "snake_case")]
pub enum TextConfig {
    /// A table of embeddings.
    Table {
        /// `.safetensors`, or `.pt` with `names`.
        path: PathBuf,
        /// Names of the rows, one a line, if the table has none.
        #[serde(default)]
        names: Option<PathBuf>,
        /// Rows to use, in the order of the labels; all if empty. How classes of synthetic rooms
        /// meet a table of other names.
        #[serde(default)]
        rows: Vec<String>,
        /// Classes left out of the averages that begin with f; if not given, those that the benchmark
        /// of the labels leaves out.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        exclude: Option<Vec<String>>,
    },
    /// The built-in vocabulary of the synthetic rooms.
    Vocabulary {
        /// Width of its vectors.
        dim: usize,
        /// Classes left out of the averages that begin with f.
        #[serde(default = "background")]
        exclude: Vec<String>,
    },
    /// Rows of a table for the classes of the synthetic rooms, by their names in `ScanNet200`.
    SyntheticClasses {
        /// As for `table`.
        path: PathBuf,
        /// As for `table`.
        #[serde(default)]
        names: Option<PathBuf>,
        /// Classes left out of the averages that begin with f.
        #[serde(default = "background")]
        exclude: Vec<String>,
    },
}

fn background() -> Vec<String> {
    ["wall", "floor", "ceiling"].map(str::to_owned).to_vec()
}

settings! {
    /// AdamW over groups of parameters.
    pub struct OptimizerConfig {
        /// Largest learning rate of parameters that no group claims.
        pub lr: f64 = 0.006,
        /// Decay per unit of learning rate, of all parameters.
        pub weight_decay: f64 = 0.05,
        /// Parameters with a rate of their own, by part of their name.
        pub groups: Vec<KeywordGroup> = vec![KeywordGroup { keyword: "block".to_owned(), lr: 0.0006 }],
        /// Decay that varies over the run, in the place of `weight_decay`: `{ warmup = 0.0, warmup_from =
        /// 0.04, from = 0.04, to = 0.4 }`.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub weight_decay_schedule: Option<CosineSchedule> = None,
        /// Moments.
        pub adamw: AdamWConfig = AdamWConfig::default(),
    }
}

/// How the learning rate varies over the run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ScheduleConfig {
    /// One rise and one longer fall, momentum the other way.
    OneCycle(OneCycle),
    /// A warm-up, then half a cosine.
    Cosine(CosineSchedule),
}

impl Default for ScheduleConfig {
    fn default() -> Self {
        Self::OneCycle(OneCycle::default())
    }
}

/// When a run has had its time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EarlyStoppingConfig {
    /// Full name of the measurement, such as `zero_shot/f-mIoU`; a list for the mean of several.
    pub measurement: Criterion,
    /// Evaluations without a better value.
    pub patience: u64,
    /// Whether a smaller value is better.
    #[serde(default)]
    pub smaller_is_better: bool,
    /// Only what is better by more than this counts as better.
    // Not written where it is off, as above.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub min_delta: f64,
}

impl EarlyStoppingConfig {
    /// What stops the run.
    pub(super) fn callback(&self) -> EarlyStopping {
        EarlyStopping::new(self.measurement.clone(), self.patience, self.smaller_is_better)
            .with_min_delta(self.min_delta)
    }
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// The steps that a scene goes through.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum TransformList {
    /// `language_pretraining`, `semantic_segmentation` or `validation`; with views
    /// `self_supervised`, `self_supervised_joint`, `self_supervised_joint_scannetpp`,
    /// `self_supervised_supplement` or `self_distillation`.
    Preset(String),
    /// One after the other.
    Steps(Vec<TransformConfig>),
}

impl TransformList {
    /// The steps; presets sample at `grid_size`, meters.
    ///
    /// # Errors
    /// If there is no preset of this name.
    pub fn steps(&self, grid_size: f64) -> Result<Vec<TransformConfig>> {
        type Preset = fn(f64) -> Vec<TransformConfig>;
        const PRESETS: [(&str, Preset); 8] = [
            ("language_pretraining", transforms::language_pretraining),
            ("semantic_segmentation", transforms::semantic_segmentation),
            ("validation", transforms::validation),
            ("self_supervised", transforms::self_supervised),
            ("self_supervised_joint", transforms::self_supervised_joint),
            ("self_supervised_joint_scannetpp", transforms::self_supervised_joint_scannetpp),
            ("self_supervised_supplement", transforms::self_supervised_supplement),
            ("self_distillation", transforms::self_distillation),
        ];
        let name = match self {
            Self::Steps(steps) => return Ok(steps.clone()),
            Self::Preset(name) => name,
        };
        match PRESETS.iter().find(|(preset, _)| preset == name) {
            Some((_, steps)) => Ok(steps(grid_size)),
            None => {
                let names = PRESETS.map(|(preset, _)| preset).join(", ");
                let problem = format!("{name:?} is no preset; use {names}, or a list of steps");
                Err(ExperimentError::setting("transforms", problem))
            }
        }
    }
}

impl ExperimentConfig {
    /// Reads a file and those that it extends.
    ///
    /// # Errors
    /// If a file cannot be read, extends itself, or has unknown or wrong fields.
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_with(path, &|name| std::env::var(name).ok())
    }

    /// As [`read`](Self::read), with the values of `${NAME}` from elsewhere than the environment.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn read_with(path: &Path, variable: &dyn Fn(&str) -> Option<String>) -> Result<Self> {
        Self::of_table(path, &read_table(path, variable, &mut Vec::new())?)
    }

    /// As [`read`](Self::read), with changes such as `optimizer.lr=1e-3` or `train.0.repeat=4`: the path of a setting, and
    /// its value as TOML; what is no TOML is a text.
    ///
    /// # Errors
    /// As [`read`](Self::read); also if a change names nothing that can be set.
    pub fn read_changed(path: &Path, changes: &[String]) -> Result<Self> {
        let mut table = read_table(path, &|name| std::env::var(name).ok(), &mut Vec::new())?;
        for change in changes {
            set(&mut table, change)?;
        }
        Self::of_table(path, &table)
    }

    /// An experiment whose settings are at hand; relative paths start at the folder of `path`, which messages name.
    ///
    /// # Errors
    /// If there are unknown or wrong fields.
    pub fn of_table(path: &Path, table: &toml::Table) -> Result<Self> {
        let place = || path.display().to_string();
        let text = toml::to_string(table).at(place)?;
        let mut config: Self = toml::from_str(&text).at(place)?;
        config.check().at(place)?;
        config.place(path.parent().unwrap_or(Path::new("")));
        Ok(config)
    }

    /// Sets the seed of everything that is random: first values, order, augmentation, steps. The
    /// scenes stay the same.
    pub fn set_seed(&mut self, seed: u64) {
        self.model_seed = seed;
        self.loader.seed = seed;
        self.trainer.seed = seed;
        self.train.iter_mut().for_each(|data| data.seed = seed);
    }

    /// The network with what it reads.
    ///
    /// # Errors
    /// If there is no such precision.
    pub fn network(&self) -> Result<NetworkConfig> {
        let compute =
            Compute { precision: self.precision()?, ..self.model.backbone.get().compute() };
        let config = NetworkConfig { model: self.model.clone(), input: self.input.clone() };
        Ok(config.with_compute(compute))
    }

    /// The precision of products.
    ///
    /// # Errors
    /// If there is none of this name, or nothing can be trained in it.
    pub fn precision(&self) -> Result<scenesplat_kernels::Precision> {
        let wrong = |e: String| ExperimentError::setting("precision", e);
        let precision: scenesplat_kernels::Precision = self.precision.parse().map_err(wrong)?;
        if !precision.has_gradient() {
            let problem = format!(
                "{precision} is for inference and has no gradient; train in f32, split or bf16 and use \
                 {precision} with the trained weights"
            );
            return Err(ExperimentError::setting("precision", problem));
        }
        Ok(precision)
    }

    /// Makes relative paths start at `folder`, and so the same for whoever reads them in the folder of the run.
    fn place(&mut self, folder: &Path) {
        let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
        let folder = folder.as_path();
        let place = |path: &mut PathBuf| {
            if path.is_relative() {
                *path = folder.join(&*path);
            }
        };
        self.init_from.iter_mut().for_each(place);
        self.teacher.iter_mut().for_each(|teacher| teacher.place(folder));
        let texts = self.evaluate.iter_mut().filter_map(|e| e.text.as_mut());
        for text in texts.chain(&mut self.text) {
            if let TextConfig::Table { path, names, .. }
            | TextConfig::SyntheticClasses { path, names, .. } = text
            {
                place(path);
                names.iter_mut().for_each(place);
            }
        }
        let train = self.train.iter_mut().map(|d| &mut d.source);
        let evaluate = self.evaluate.iter_mut().map(|d| &mut d.source);
        train.chain(evaluate).for_each(|source| source.place(folder));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_circle_of_files_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        for (name, other) in [("a", "b"), ("b", "a")] {
            let text = format!("extends = '{other}.toml'\n");
            std::fs::write(dir.path().join(format!("{name}.toml")), text).unwrap();
        }
        let error = ExperimentConfig::read(&dir.path().join("a.toml")).unwrap_err();
        assert!(error.to_string().contains("extends itself"), "{error}");
    }

    #[test]
    fn every_configuration_of_the_project_is_right() {
        let root = scenesplat_test_support::repository().join("configs");
        let folders = [
            root.clone(),
            root.join("language_pretraining"),
            root.join("semantic_segmentation"),
            root.join("distillation"),
            root.join("self_supervised"),
            root.join("room_ablations"),
        ];
        let mut read = 0;
        for folder in folders {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                // The common part is no experiment by itself.
                if path.extension().is_none_or(|e| e != "toml") || path.ends_with("common.toml") {
                    continue;
                }
                let value = |_: &str| Some("/data".to_owned());
                let config = ExperimentConfig::read_with(&path, &value).unwrap();
                // What a run records can be read again.
                let text = toml::to_string_pretty(&config).unwrap();
                assert_eq!(toml::from_str::<ExperimentConfig>(&text).unwrap(), config);
                read += 1;
            }
        }
        assert_eq!(read, 81);
    }
}
