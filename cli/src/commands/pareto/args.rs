//! The flags of `pareto`.

use crate::commands::classes::Classes;
use crate::duration::{Seconds, parse_duration};
use crate::error::WrongUse;
use crate::flags::{NetworkArgs, Running, SourceArgs};
use crate::label_ids::LabelIdArgs;
use scenesplat::Setting;
use scenesplat::network::Weights;
use scenesplat_lab::pareto::{Grid, ParetoError};
use std::path::{Path, PathBuf};

/// Measures a grid of settings on labeled scenes and shows what accuracy costs: records.jsonl,
/// front.json, pareto.html, pareto.png and pareto.svg.
///
/// Each setting runs in a process of its own. Ctrl-C keeps what was measured; the same command goes on
/// from there. Run nothing else meanwhile.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What to try, as TOML; a grid comes with the program (configs/pareto/default.toml).
    #[arg(long, value_name = "FILE.toml")]
    pub grid: Option<PathBuf>,
    /// Scenes with labels: files or folders, or synthetic:COUNT:SEED for rooms that are made on the
    /// spot. Each is a set of its own.
    #[arg(required_unless_present_any = ["scenes", "training", "calibrate"], value_name = "SCENE|synthetic:COUNT:SEED")]
    first: Vec<String>,
    /// The same, after other flags.
    #[arg(long, num_args = 1.., value_name = "SCENE|synthetic:COUNT:SEED")]
    scenes: Vec<String>,
    /// Measures this machine instead, for --budget of the other commands: a few settings of the
    /// network on made rooms, in some three minutes. Stored in the user's data folder
    /// (~/.local/share/scenesplat, or where SCENESPLAT_FRONTS says).
    #[arg(long, conflicts_with_all = ["training"])]
    pub calibrate: bool,
    /// Gaussians of the rooms that a calibration times.
    #[arg(long, value_name = "N", num_args = 1.., requires = "calibrate", default_values_t = [10_000, 60_000, 240_000, 600_000])]
    pub sizes: Vec<usize>,
    /// Repeats after a warm-up.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub repeats: u16,
    /// Most time for all of it: 90s, 10m, 2h. What takes longer by an estimate is refused.
    #[arg(long, value_name = "TIME", default_value = "10m", value_parser = parse_duration)]
    pub limit: Seconds,
    /// Folder for the results; records in it are kept and not measured again.
    #[arg(long, value_name = "DIR", default_value = "pareto-out")]
    pub out: PathBuf,
    /// records.jsonl of an earlier run: fails if a setting lost more than 0.3 points of f-mIoU, or takes
    /// more than 1.15 times as long on the same machine.
    #[arg(long, value_name = "FILE.jsonl", conflicts_with = "calibrate")]
    pub against: Option<PathBuf>,
    /// Folders of training runs, whose quality is shown against their time.
    #[arg(long, num_args = 1.., value_name = "RUN_DIR")]
    pub training: Vec<PathBuf>,
    /// Names of the labels in the scenes that are files, one a line or as JSON.
    #[arg(long, value_name = "FILE")]
    pub label_names: Option<PathBuf>,
    /// From where the ids of those labels count. What may count from 1 is refused without --label-base.
    #[command(flatten)]
    pub label_ids: LabelIdArgs,
    /// Which class each label name means (TOML or JSON); labels without one are ignored.
    #[arg(long, value_name = "FILE", requires = "label_names")]
    pub class_map: Option<PathBuf>,
    /// Classes left out of f-mIoU and f-mAcc, comma-separated.
    /// [default: those of wall, floor, ceiling that exist]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub exclude: Option<Vec<String>>,
    /// Choice of classes.
    #[command(flatten)]
    pub classes: Classes,
    /// Which network, where a setting names none.
    #[command(flatten)]
    pub network: NetworkArgs,
    /// How to read the scenes.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
}

impl Args {
    /// The scenes that are measured.
    pub fn scenes(&self) -> Vec<String> {
        [&self.first[..], &self.scenes].concat()
    }

    /// The grid of --grid, or this one, with its settings.
    pub fn grid_or(
        &self,
        default: impl FnOnce() -> Result<Grid, WrongUse>,
    ) -> Result<(Grid, Vec<Setting>), WrongUse> {
        let wrong = |error: ParetoError| WrongUse(error.to_string());
        let grid = match &self.grid {
            Some(path) => Grid::read(path).map_err(wrong)?,
            None => default()?,
        };
        let settings = grid.settings().map_err(wrong)?;
        Ok((grid, settings))
    }

    /// The flags that each process takes over, with another network where a grid names one.
    pub fn flags(&self, network: Option<&scenesplat_lab::pareto::GridNetwork>) -> Vec<String> {
        let mut words = Vec::new();
        let mut path = |flag: &str, value: Option<&Path>| {
            words.extend(value.map(|v| format!("{flag}={}", v.display())));
        };
        match network {
            Some(named) => {
                path("--weights", Some(&named.weights));
                path("--config", named.config.as_deref().map(Path::new));
                path("--text", named.text.as_deref());
                path("--text-names", named.text_names.as_deref());
            }
            None => {
                let weights = self.network.weights.as_ref().map(weights_text);
                path("--weights", weights.as_deref().map(Path::new));
                let config = self.network.config.as_ref().map(ToString::to_string);
                path("--config", config.as_deref().map(Path::new));
                path("--text", self.classes.text.as_deref());
                path("--text-names", self.classes.text_names.as_deref());
                path("--text-model", self.classes.text_model.as_deref());
                words.extend(self.classes.template.iter().map(|text| format!("--template={text}")));
            }
        }
        let Classes { without, min_score, min_margin, .. } = &self.classes;
        if !without.is_empty() {
            words.push(format!("--without={}", without.join(",")));
        }
        words.extend(min_score.map(|v| format!("--min-score={v}")));
        words.extend(min_margin.map(|v| format!("--min-margin={v}")));
        let SourceArgs { segment_name, strict, spz_frame, lod } = &self.source;
        words.extend(segment_name.as_ref().map(|name| format!("--segment-name={name}")));
        words.extend(strict.then(|| "--strict".to_owned()));
        words.push(format!("--lod={lod}"));
        let frame = clap::ValueEnum::to_possible_value(spz_frame);
        words.extend(frame.map(|frame| format!("--spz-frame={}", frame.get_name())));
        words
    }
}

/// Weights as the flag takes them.
pub fn weights_text(weights: &Weights) -> String {
    match weights {
        Weights::Embedded => scenesplat::embedded::NAME.to_owned(),
        Weights::Seeded(seed) => format!("seeded:{seed}"),
        Weights::File(path) => path.display().to_string(),
    }
}
