//! What a command will take: a model of its stages in Gaussians, voxels, classes and width, fitted to
//! runs.

use super::bootstrap::quantile_of;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What the time of a command grows with.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Size {
    /// Gaussians of the scene.
    pub gaussians: usize,
    /// Voxels of the setting's size.
    pub voxels: usize,
    /// Classes that compete.
    pub classes: usize,
    /// Numbers of a feature.
    pub width: usize,
    /// Neighbors that vote.
    pub k: usize,
}

/// A run of a command, as its receipt tells.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// `segment`, `features` or `query`.
    pub command: String,
    /// The setting.
    pub setting: String,
    /// How large it was.
    pub size: Size,
    /// Seconds of each stage that is no part of another.
    pub stages: BTreeMap<String, f64>,
    /// Seconds of the whole command.
    pub wall: f64,
    /// Largest resident memory, bytes.
    pub peak_bytes: u64,
}

/// A fitted model. Coefficients are seconds, none below 0.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CostModel {
    /// Starting and loading the weights.
    pub start: f64,
    /// Reading: once, and a Gaussian.
    pub read: Vec<f64>,
    /// The network, by setting: once, a voxel, and a Gaussian, which has to be put into one.
    pub network: BTreeMap<String, Vec<f64>>,
    /// Labeling: once, a Gaussian, a Gaussian's neighbor, and a voxel's product with a class.
    pub labels: Vec<f64>,
    /// Writing and drawing, by command: once, a Gaussian, and a number of its feature.
    pub results: BTreeMap<String, Vec<f64>>,
    /// Memory, by setting, bytes: once, a Gaussian, and a voxel.
    pub peak: BTreeMap<String, Vec<f64>>,
    /// Nine of ten runs that the model was fitted to are within this share of it.
    pub error: f64,
    /// How many times as long as the fitted runs, which are the fastest, a run takes in the middle.
    #[serde(default = "once")]
    pub typical: f64,
    /// Nineteen of twenty runs take at most so much more of that, a share.
    #[serde(default)]
    pub reserve: f64,
}

fn once() -> f64 {
    1.0
}

const LABEL_STAGES: [&str; 2] = ["labels", "query"];
const RESULT_STAGES: [&str; 2] = ["write", "picture"];

impl CostModel {
    /// Least squares of the relative errors, stage by stage.
    pub fn fit(runs: &[Observation]) -> Self {
        let of = |run: &Observation, names: &[&str]| -> f64 {
            names.iter().filter_map(|name| run.stages.get(*name)).sum()
        };
        let start = |run: &Observation| {
            run.wall - of(run, &["read", "network", "labels", "query", "write", "picture"])
        };
        let starts: Vec<f64> = runs.iter().map(start).collect();
        let fit = |chosen: &[&Observation], names: &[&str], terms: fn(&Size) -> Vec<f64>| {
            let rows: Vec<Vec<f64>> = chosen.iter().map(|run| terms(&run.size)).collect();
            nonnegative_fit(&rows, &chosen.iter().map(|run| of(run, names)).collect::<Vec<_>>())
        };
        let all: Vec<&Observation> = runs.iter().collect();
        let groups = |key: fn(&Observation) -> &String| {
            let mut groups: BTreeMap<String, Vec<&Observation>> = BTreeMap::new();
            for run in runs {
                groups.entry(key(run).clone()).or_default().push(run);
            }
            groups
        };
        let labelled: Vec<&Observation> =
            all.iter().copied().filter(|run| of(run, &LABEL_STAGES) > 0.0).collect();
        let by_setting = groups(|run| &run.setting);
        let peaks = by_setting.iter().map(|(setting, runs)| {
            let rows: Vec<Vec<f64>> = runs.iter().map(|run| memory_terms(&run.size)).collect();
            let bytes: Vec<f64> = runs.iter().map(|run| run.peak_bytes as f64).collect();
            (setting.clone(), nonnegative_fit(&rows, &bytes))
        });
        let mut model = Self {
            start: quantile_of(&starts, 0.5).max(0.0),
            read: fit(&all, &["read"], row_terms),
            labels: fit(&labelled, &LABEL_STAGES, label_terms),
            peak: peaks.collect(),
            network: by_setting
                .iter()
                .map(|(setting, runs)| (setting.clone(), fit(runs, &["network"], network_terms)))
                .collect(),
            results: groups(|run| &run.command)
                .iter()
                .map(|(command, runs)| (command.clone(), fit(runs, &RESULT_STAGES, result_terms)))
                .collect(),
            error: 0.0,
            typical: 1.0,
            reserve: 0.0,
        };
        let off = runs.iter().filter_map(|run| {
            Some((model.seconds(&run.command, &run.setting, &run.size)? / run.wall - 1.0).abs())
        });
        model.error = quantile_of(&off.collect::<Vec<_>>(), 0.9);
        model
    }

    /// The model with what runs take that were not the fastest of theirs: `runs` are all, the slow ones
    /// too. The fastest ones show how time grows with a scene, and are not what people get.
    #[must_use]
    pub fn with_spread(mut self, runs: &[Observation]) -> Self {
        let times: Vec<f64> = runs
            .iter()
            .filter_map(|run| Some(run.wall / self.seconds(&run.command, &run.setting, &run.size)?))
            .filter(|times| times.is_finite())
            .collect();
        if !times.is_empty() {
            let typical = quantile_of(&times, 0.5).max(1.0);
            self.typical *= typical;
            self.reserve = (quantile_of(&times, 0.95) / typical - 1.0).max(0.0);
        }
        self
    }

    /// Seconds of a command from its start, reading included, as it takes in the middle; `None` for a
    /// setting or command that was not fitted.
    pub fn seconds(&self, command: &str, setting: &str, size: &Size) -> Option<f64> {
        let network = sum(self.network.get(setting)?, &network_terms(size));
        let results = sum(self.results.get(command)?, &result_terms(size));
        let labels = match command {
            "features" => 0.0,
            _ => sum(&self.labels, &label_terms(size)),
        };
        let fastest = self.start + sum(&self.read, &row_terms(size)) + network + labels + results;
        Some(self.typical * fastest)
    }

    /// Largest resident memory, bytes; `None` for a setting that was not fitted.
    pub fn peak_bytes(&self, setting: &str, size: &Size) -> Option<f64> {
        Some(sum(self.peak.get(setting)?, &memory_terms(size)))
    }
}

fn row_terms(size: &Size) -> Vec<f64> {
    vec![1.0, size.gaussians as f64]
}

fn network_terms(size: &Size) -> Vec<f64> {
    vec![1.0, size.voxels as f64, size.gaussians as f64]
}

fn label_terms(size: &Size) -> Vec<f64> {
    let rows = size.gaussians as f64;
    let neighbours = if size.k > 1 { size.k as f64 } else { 0.0 };
    vec![1.0, rows, rows * neighbours, size.voxels as f64 * (size.classes * size.width) as f64]
}

fn result_terms(size: &Size) -> Vec<f64> {
    let rows = size.gaussians as f64;
    vec![1.0, rows, rows * size.width as f64]
}

fn memory_terms(size: &Size) -> Vec<f64> {
    vec![1.0, size.gaussians as f64, size.voxels as f64]
}

fn sum(coefficients: &[f64], terms: &[f64]) -> f64 {
    coefficients.iter().zip(terms).map(|(c, t)| c * t).sum()
}

/// Coefficients, none below 0, with the least sum of squared relative errors. Rows whose target is not
/// above 0 do not count.
///
/// Coordinate descent: the problem is convex and has four unknowns at most.
fn nonnegative_fit(rows: &[Vec<f64>], targets: &[f64]) -> Vec<f64> {
    let width = rows.first().map_or(0, Vec::len);
    let used: Vec<Vec<f64>> = rows
        .iter()
        .zip(targets)
        .filter(|(_, target)| **target > 0.0)
        .map(|(row, target)| row.iter().map(|term| term / target).collect())
        .collect();
    let mut x = vec![0.0; width];
    let mut rest: Vec<f64> = vec![1.0; used.len()];
    const ROUNDS: usize = 20_000;
    for _ in 0..ROUNDS {
        let mut moved = 0.0f64;
        for j in 0..width {
            let square: f64 = used.iter().map(|row| row[j] * row[j]).sum();
            if square <= 0.0 {
                continue;
            }
            let slope: f64 = used.iter().zip(&rest).map(|(row, r)| row[j] * r).sum();
            let next = (x[j] + slope / square).max(0.0);
            let step = next - x[j];
            for (row, r) in used.iter().zip(&mut rest) {
                *r -= step * row[j];
            }
            moved = moved.max(step.abs() * square.sqrt());
            x[j] = next;
        }
        if moved < 1e-12 {
            break;
        }
    }
    x
}

#[cfg(test)]
pub(crate) mod tests;
