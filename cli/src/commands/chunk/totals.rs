//! What became of the scenes that were cut.

use crate::progress::Progress;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::datasets::DataError;
use scenesplat::datasets::chunking::ChunkReport;
use std::path::Path;

/// What became of all scenes.
#[derive(Default)]
pub struct Totals {
    scenes: usize,
    chunks: usize,
    rows: usize,
    found: usize,
    without: Vec<String>,
    broken: Vec<String>,
}

impl Totals {
    /// Scenes that were cut.
    pub fn scenes(&self) -> usize {
        self.scenes
    }

    /// Counts a scene that could not be cut, and says why.
    pub fn add_broken(&mut self, id: &str, error: DataError, progress: &Progress) {
        let text = format!("{:#}", anyhow::Error::from(error));
        progress.say(format!("{id}: {text}"));
        self.broken.push(format!("{id}: {text}"));
    }

    /// Counts a scene that was cut, and says into what.
    pub fn add(&mut self, report: &ChunkReport, progress: &Progress) {
        self.scenes += 1;
        self.chunks += report.chunks.len();
        self.rows += report.chunks.iter().map(|(_, rows)| rows).sum::<usize>();
        self.found += report.found;
        if report.chunks.is_empty() {
            self.without.push(report.scene.clone());
        }
        let mut text = format!(
            "{}: {} Gaussians, {} after sampling, {:.1} m x {:.1} m, {}",
            report.scene,
            report.source_rows,
            report.sampled,
            report.extent[0],
            report.extent[1],
            count(report.chunks.len(), "chunk")
        );
        for (number, what) in [
            (report.found, "there already"),
            (report.below_minimum, "left out as too small"),
            (report.beyond_limit, "left out as too many"),
        ] {
            if number > 0 {
                text += &format!(", {number} {what}");
            }
        }
        for note in &report.notes {
            text += &format!("\n  {note}");
        }
        progress.say(text);
    }

    /// Prints the sums.
    pub fn say(&self, folder: &Path) {
        let found = match self.found {
            0 => String::new(),
            n => format!(" ({n} of them there already)"),
        };
        print(&format!(
            "{}: {}{found} of {}, {}",
            folder.display(),
            count(self.chunks, "chunk"),
            count(self.scenes, "scene"),
            count(self.rows, "Gaussian")
        ));
        if !self.without.is_empty() {
            print(&format!("without a chunk: {}", self.without.join(", ")));
        }
    }

    /// An error if any scene could not be cut.
    pub fn result(&self) -> Result<()> {
        let Some(first) = self.broken.first() else { return Ok(()) };
        anyhow::bail!("{} could not be cut, the first: {first}", count(self.broken.len(), "scene"));
    }
}

/// A number with its noun.
fn count(number: usize, noun: &str) -> String {
    if number == 1 { format!("1 {noun}") } else { format!("{number} {noun}s") }
}
