//! What `evaluate` prints and writes.

use crate::log;
use crate::session::Session;
use crate::terminal::print;
use anyhow::{Context, Result};
use scenesplat::evaluation::{EvaluationReport, OtherIds};
use scenesplat::metrics::{OracleReport, TesterReport};
use scenesplat::scene::input_file::read_text_file;
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;
use std::time::Instant;

/// Name of the file with the figures.
pub const EVALUATION: &str = "evaluation.json";

/// What is read of an evaluation that was written before.
#[derive(Deserialize)]
pub struct Written {
    /// The counts behind every figure.
    pub counts: EvaluationReport,
    /// Names of the classes.
    pub classes: Vec<String>,
    /// Classes that are left out of f-mIoU.
    pub excluded: Value,
    /// Neighbors that voted.
    pub vote_k: Value,
    /// Whether the labels come from seeded weights.
    pub meaningless: bool,
}

impl Written {
    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read, or is no evaluation.
    pub fn read(path: &Path) -> Result<Self> {
        let text = read_text_file(path)?;
        serde_json::from_str(&text)
            .with_context(|| format!("{}: no evaluation of this program", path.display()))
    }
}

/// Says what the oracle found in a scene.
pub fn tell_oracle(session: &Session<'_>, names: &[String], report: &OracleReport, path: &Path) {
    for (class, becomes) in &report.aliases {
        let other = usize::try_from(*becomes).ok().and_then(|c| names.get(c));
        session.warn(format!(
            "class {:?} rightly comes out as {:?} with these texts and options",
            names[*class],
            other.map_or("unknown", |n| n.as_str())
        ));
    }
    if !log::is_verbose() {
        return;
    }
    print(&format!(
        "{}: oracle matches its analytic value on {} labeled Gaussians, {} scored points: mIoU {}, \
         allAcc {}",
        path.display(),
        report.num_labelled,
        report.num_scored,
        percent(report.metrics.mean_iou),
        percent(report.metrics.all_accuracy)
    ));
}

/// Says that labels look as if they were one name off.
pub fn tell_other_ids(session: &Session<'_>, other: &OtherIds, path: &Path) {
    let OtherIds { by, agree, would_agree } = *other;
    let (which, base) = if by < 0 { ("before", 1) } else { ("after", 0) };
    session.warn_loudly(format!(
        "{}: {} of the labels agree with what was found, but {} would if every id stood for the name {which} its own: \
         are they ids that count from {base} (--label-base {base})?",
        path.display(),
        percent(Some(agree)),
        percent(Some(would_agree))
    ));
}

/// Prints the table, and gives its figures.
pub fn tell(report: &EvaluationReport, names: &[String], meaningless: bool) -> Value {
    print(&format!(
        "{:14} {:>8} {:>8} {:>8} {:>8} {:>8}",
        "", "mIoU", "mAcc", "allAcc", "f-mIoU", "f-mAcc"
    ));
    let yardsticks = [("oracle", &report.oracle), ("random labels", &report.random)];
    let of_features = report.model.as_ref().map(|m| ("features", m));
    let given = report.given.as_ref().map(|m| ("of those given", m));
    // What the truth itself gets on its way through, and chance: for who looks for a fault.
    let is_asked = log::is_verbose() || of_features.is_none();
    let yardsticks = yardsticks.into_iter().filter(|_| is_asked);
    for (name, row) in yardsticks.chain(of_features).chain(given) {
        print(&format!("{name:14} {}", columns(row)));
    }
    if report.withheld > 0 {
        print(&format!(
            "{} labels were withheld: wrong in the row of features, left out in the last one",
            report.withheld
        ));
    }
    if meaningless {
        print("the features come from seeded weights: their row means nothing");
    }
    let mut json = figures(report.model.as_ref().unwrap_or(&report.oracle), names);
    json["oracle"] = figures(&report.oracle, names);
    json["withheld"] = json!(report.withheld);
    if let Some(given) = &report.given {
        json["of_those_given"] = figures(given, names);
    }
    json["random_labels"] = figures(&report.random, names);
    json["features"] = json!(if report.model.is_some() { "features" } else { "oracle" });
    json["classes"] = json!(names);
    json["counts"] = json!(report);
    json["meaningless"] = json!(meaningless);
    json
}

/// Writes the figures into the output folder, the same bytes each time, and where --json says, there with the time since
/// `began`.
pub fn write(
    session: &Session<'_>,
    mut json: Value,
    began: Instant,
    elsewhere: Option<&Path>,
) -> Result<()> {
    let text = serde_json::to_string_pretty(&json)?;
    session.write_text(EVALUATION, &text)?;
    match elsewhere {
        Some(path) => {
            json["seconds"] = json!(began.elapsed().as_secs_f64());
            session.write_file(path, &serde_json::to_string_pretty(&json)?)
        }
        None => Ok(()),
    }
}

fn figures(report: &TesterReport, names: &[String]) -> Value {
    let per_class: Vec<_> = report
        .classes
        .iter()
        .zip(names)
        .filter(|(c, _)| c.union > 0)
        .map(|(c, name)| {
            json!({
                "name": name, "iou": c.iou, "accuracy": c.accuracy,
                "labelled": c.target, "excluded": c.excluded,
            })
        })
        .collect();
    json!({
        "f_miou": report.foreground_mean_iou, "f_macc": report.foreground_mean_accuracy,
        "miou": report.mean_iou, "macc": report.mean_accuracy, "all_acc": report.all_accuracy,
        "per_class": per_class,
    })
}

fn percent(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{:.2} %", v * 100.0))
}

fn columns(r: &TesterReport) -> String {
    [r.mean_iou, r.mean_accuracy, r.all_accuracy, r.foreground_mean_iou, r.foreground_mean_accuracy]
        .map(|v| format!("{:>8}", percent(v)))
        .join(" ")
}
