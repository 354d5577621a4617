//! What is measured: a reference, axes whose product is searched, and single settings beside it.

use super::ParetoError;
use scenesplat::setting::Setting;
use scenesplat::shipped::PARETO_GRID;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Most settings that a grid may have before its size alone is a mistake.
pub const MOST_POINTS: usize = 1_000_000;

/// One part of a setting with the values to try, ordered cheap to accurate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Axis {
    /// Name of the part, such as `voxel`.
    pub name: String,
    /// Its values as a setting writes them, the cheapest first.
    pub values: Vec<String>,
}

/// A network that a grid gives a name.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GridNetwork {
    /// Model folder or checkpoint; relative paths are from where the program runs.
    pub weights: PathBuf,
    /// Configuration, where it does not lie beside the weights.
    pub config: Option<String>,
    /// Text embeddings of the classes, or `vocabulary`. By default the words of the synthetic rooms
    /// in the width of the network.
    pub text: Option<PathBuf>,
    /// Names of the rows of `text`, or of a classifier's classes, one a line.
    pub text_names: Option<PathBuf>,
}

/// What must not change the result.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Neutral {
    /// Numbers of threads.
    pub threads: Vec<usize>,
    /// Memory limits; those that cut a scene into tiles are held to the rule of tiles.
    pub max_memory: Vec<String>,
    /// Instruction sets, as `SCENESPLAT_ISA` names them; `all` for those that the processor has.
    pub isa: Vec<String>,
}

/// What is written for each setting, and so counted in time and bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Written {
    /// `labels.npy` and `scores.npy`.
    Labels,
    /// `features.npy`, half precision.
    Features,
}

/// A grid of settings.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// What everything is compared with; its quality is 100 %.
    pub reference: Setting,
    /// Axes whose product is searched.
    pub axes: Vec<Axis>,
    /// Single settings beside the product, completed from the reference.
    pub points: Vec<Setting>,
    /// Whether settings are left out that a measured neighbor rules out.
    pub skip: bool,
    /// What must not change the result.
    pub neutral: Neutral,
    /// Networks by name.
    pub networks: BTreeMap<String, GridNetwork>,
    /// Folders of training runs whose quality is shown against their time.
    pub training: Vec<PathBuf>,
    /// What is written.
    pub writes: Vec<Written>,
}

/// As the file has it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    reference: String,
    #[serde(default)]
    axes: toml::Table,
    #[serde(default)]
    points: Vec<String>,
    #[serde(default = "yes")]
    skip: bool,
    #[serde(default)]
    neutral: Neutral,
    #[serde(default)]
    networks: BTreeMap<String, GridNetwork>,
    #[serde(default)]
    training: Vec<PathBuf>,
    #[serde(default = "labels")]
    writes: Vec<Written>,
}

fn yes() -> bool {
    true
}

fn labels() -> Vec<Written> {
    vec![Written::Labels]
}

impl Grid {
    /// A JSON schema of grid files, for editors.
    pub const SCHEMA: &str = include_str!("grid.schema.json");

    /// The grid that comes with the program.
    ///
    /// # Errors
    /// If the program was built with a broken file.
    pub fn default_grid() -> Result<Self, ParetoError> {
        let [text, place] = PARETO_GRID;
        Self::parse(text, place)
    }

    /// What a machine is calibrated with: settings of a network whose voxels are `voxel` meters, from
    /// twice as coarse as its own to two passes.
    ///
    /// # Errors
    /// If the size is not above 0.
    pub fn calibration(voxel: f64) -> Result<Self, ParetoError> {
        let of = |factor: f64, rest: &str| format!("\"voxel={},{rest}\"", tidy(factor * voxel));
        let points = [
            of(1.0, "k=8"),
            of(1.0, "precision=bf16,k=8"),
            of(1.0, "passes=2,k=8"),
            of(1.0, "precision=bf16,k=1"),
            of(1.25, "k=8"),
            of(1.5, "precision=bf16,k=8"),
            of(2.0, "precision=bf16,k=1"),
        ];
        let text = format!(
            "reference = {}\npoints = [{}]\n",
            of(1.0, "precision=f32,passes=1,k=25"),
            points.join(", ")
        );
        Self::parse(&text, "the grid of a calibration")
    }

    /// Reads a grid from a file.
    ///
    /// # Errors
    /// If it cannot be read, or is no grid; the message names the part.
    pub fn read(path: &Path) -> Result<Self, ParetoError> {
        let text =
            std::fs::read_to_string(path).map_err(ParetoError::io(path, "cannot read the grid"))?;
        Self::parse(&text, &path.display().to_string())
    }

    /// Reads a grid from text; `name`: what messages call it.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(text: &str, name: &str) -> Result<Self, ParetoError> {
        let wrong = |text: String| ParetoError::Grid { path: name.to_owned(), text };
        let file: File = toml::from_str(text).map_err(|e| wrong(e.to_string()))?;
        let reference: Setting =
            file.reference.parse().map_err(|e| wrong(format!("reference: {e}")))?;
        let mut axes = Vec::new();
        for (name, values) in file.axes {
            let list = values.as_array().filter(|list| !list.is_empty());
            let list = list.ok_or_else(|| {
                wrong(format!("axes.{name}: a list of values is expected, the cheapest first"))
            })?;
            let values = list.iter().map(text_of).collect::<Option<Vec<_>>>();
            let values =
                values.ok_or_else(|| wrong(format!("axes.{name}: values are numbers or texts")))?;
            let mut seen = BTreeSet::new();
            let mut canonical = Vec::new();
            for value in values {
                let one = format!("{name}={value}");
                let setting: Setting =
                    one.parse().map_err(|e| wrong(format!("axes.{name}: {e}")))?;
                let text = setting.to_string();
                let (_, value) = text.split_once('=').unwrap_or_default();
                if !seen.insert(value.to_owned()) {
                    return Err(wrong(format!("axes.{name}: {value} is there twice")));
                }
                canonical.push(value.to_owned());
            }
            axes.push(Axis { name, values: canonical });
        }
        let points = file.points.iter().map(|text| {
            let setting: Result<Setting, _> = text.parse();
            setting.map_err(|e| wrong(format!("points: {e}")))
        });
        let grid = Self {
            reference,
            points: points.collect::<Result<_, _>>()?,
            axes,
            skip: file.skip,
            neutral: file.neutral,
            networks: file.networks,
            training: file.training,
            writes: file.writes,
        };
        grid.check().map_err(wrong)?;
        Ok(grid)
    }

    fn check(&self) -> Result<(), String> {
        if self.writes.is_empty() {
            return Err("writes: at least one of labels and features is needed".to_owned());
        }
        if self.neutral.threads.contains(&0) {
            return Err("neutral.threads: 0; at least one thread is needed".to_owned());
        }
        if self.size() > MOST_POINTS {
            return Err(format!("{} settings; at most {MOST_POINTS} are possible", self.size()));
        }
        for (name, network) in &self.networks {
            let plain = name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
            if name.is_empty() || !plain {
                let text = "a name has letters, digits, dots, - and _ only";
                return Err(format!("networks.{name:?}: {text}"));
            }
            if !network.weights.exists() {
                let path = network.weights.display();
                let text = "there is no such file (net=embedded needs no entry)";
                return Err(format!("networks.{name}: weights {path}: {text}"));
            }
        }
        Ok(())
    }

    /// Number of settings before doubles are taken out, the reference included.
    pub fn size(&self) -> usize {
        let product = self.axes.iter().fold(1usize, |n, axis| n.saturating_mul(axis.values.len()));
        let product = if self.axes.is_empty() { 0 } else { product };
        product.saturating_add(self.points.len()).saturating_add(1)
    }

    /// All settings, each completed from the reference: the reference first, no setting twice.
    ///
    /// # Errors
    /// If parts do not go together.
    pub fn settings(&self) -> Result<Vec<Setting>, ParetoError> {
        let mut texts: Vec<String> = vec![String::new()];
        if self.axes.is_empty() {
            texts.clear();
        }
        for Axis { name, values } in &self.axes {
            let longer = |text: &String| {
                let comma = if text.is_empty() { "" } else { "," };
                let begin = format!("{text}{comma}{name}=");
                values.iter().map(move |value| format!("{begin}{value}")).collect::<Vec<_>>()
            };
            texts = texts.iter().flat_map(longer).collect();
        }
        let mut all = vec![self.reference.clone()];
        for text in texts {
            let setting: Setting =
                text.parse().map_err(|e: scenesplat::setting::SettingError| {
                    ParetoError::Setting { setting: text.clone(), text: e.to_string() }
                })?;
            all.push(setting.or(&self.reference));
        }
        all.extend(self.points.iter().map(|point| point.or(&self.reference)));
        let mut seen = BTreeSet::new();
        all.retain(|setting| seen.insert(setting.to_string()));
        Ok(all)
    }
}

/// Without the last bits of a product: 0.12 and not 0.12000000000000001.
fn tidy(length: f64) -> f64 {
    let text = format!("{length:.6}");
    text.parse().unwrap_or(length)
}

fn text_of(value: &toml::Value) -> Option<String> {
    match value {
        toml::Value::String(text) => Some(text.clone()),
        toml::Value::Integer(number) => Some(number.to_string()),
        toml::Value::Float(number) => Some(number.to_string()),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
