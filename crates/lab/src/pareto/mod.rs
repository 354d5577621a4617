//! What accuracy costs: a grid of settings, measured on labeled scenes, and the front among them.
//!
//! A [`Grid`] declares what to try. [`order`] and [`ruled_out`] say what to measure next and what is
//! not worth it, [`measure`] measures a setting in this process, [`Records`] keeps what was measured,
//! and a [`Summary`] with its [`page`] and pictures is made of the records alone. The program runs each
//! setting in a process of its own; nothing here starts one.

mod against;
mod bootstrap;
mod budget;
mod chart;
mod cost;
mod error;
mod findings;
mod front;
mod grid;
mod measure;
mod page;
mod point;
pub(crate) mod quality;
mod record;
mod search;
mod summary;
mod training;

pub use against::{Change, Compared, MOST_LOSS, MOST_TIME, Regression, compare};
pub use budget::{Ask, BudgetError, Calibrated, Calibration, Choice};
pub use chart::seconds_text;
pub use cost::{CostModel, Observation, Size};
pub use error::ParetoError;
pub use findings::{Finding, negative_findings};
pub use front::{CLASSES, ClassWinner, cheapest_of_class, front, knee};
pub use grid::{Axis, Grid, GridNetwork, Neutral, Written};
pub use measure::{Job, LEAST_COVERAGE, Measured, SceneInput, labels_path, measure};
pub use page::page;
pub use point::{Point, points, sets};
pub use quality::TEMPERATURE;
pub use record::{Kind, Record, Records, SceneRecord, Stage};
pub use search::{Candidate, RuledOut, Tried, order, ruled_out};
pub use summary::{Around, NeutralRow, Summary};
pub use training::TrainingCurve;

use scenesplat_scene::AtomicFile;
use std::path::{Path, PathBuf};

/// Writes `front.json`, `pareto.svg`, `pareto.png` and `pareto.html`. Gives their paths and sizes.
///
/// # Errors
/// If one cannot be written.
pub fn write_report(
    summary: &Summary,
    records: &[Record],
    folder: &Path,
) -> Result<Vec<(PathBuf, u64)>, ParetoError> {
    let json = serde_json::to_string_pretty(summary)? + "\n";
    let paths = ["front.json", "pareto.svg", "pareto.png", "pareto.html"].map(|n| folder.join(n));
    AtomicFile::write(&paths[0], json.as_bytes())?;
    let [svg, png] = chart::chart(summary).write(&paths[1], &paths[2])?;
    let page = page(summary, records)?;
    AtomicFile::write(&paths[3], page.as_bytes())?;
    let sizes = [json.len() as u64, svg, png, page.len() as u64];
    Ok(paths.into_iter().zip(sizes).collect())
}
