//! The learning rate of an experiment: a search, and its curve as a picture and as a table.

use super::config::ExperimentConfig;
use super::error::ExperimentError;
use super::measured::with_measured_effects;
use super::module::{Opened, Work, optimizer};
use crate::page_kit::drawing::{Anchor, Color, Drawing};
use crate::page_kit::scale::{Scale, labels};
use crate::preview::write_png;
use candle_core::Device;
use scenesplat_datasets::TrainBatch;
use scenesplat_scene::AtomicFile;
use scenesplat_trainers::{DataModule, LrCurve, LrFinderConfig, LrPoint, TrainingModule, find_lr};
use std::fmt::Write;
use std::path::{Path, PathBuf};

const SIZE: [u32; 2] = [760, 420];
/// Space around the plot: left, top, right, bottom, pixels.
const MARGIN: [f64; 4] = [84.0, 50.0, 24.0, 40.0];
const FRAME: Color = [198, 200, 204];
const INK: Color = [52, 56, 64];
const RAW: Color = [176, 200, 232];
const SMOOTH: Color = [24, 92, 180];
const FOUND: Color = [200, 72, 40];

/// What came of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct LrReport {
    /// The losses by rate, and the rate that is suggested.
    pub curve: LrCurve,
    /// The curve as a picture.
    pub picture: PathBuf,
    /// The curve as comma-separated values.
    pub table: PathBuf,
    /// Things to know.
    pub remarks: Vec<String>,
}

/// Searches for a learning rate, see [`find_lr`]; groups keep their ratio to `optimizer.lr`. Writes `lr_find.png` and
/// `lr_find.csv` into a folder, which may be that of a run.
///
/// # Errors
/// As [`train`](super::train), and if a file cannot be written.
pub fn search_lr(
    config: &ExperimentConfig,
    settings: &LrFinderConfig,
    device: &Device,
    folder: &Path,
) -> Result<LrReport, ExperimentError> {
    let measured = with_measured_effects(config)?;
    let mut opened = Opened::of(&measured, device)?;
    let curve = opened.with_module(&measured, &Search { config: &measured, settings })?;
    std::fs::create_dir_all(folder).map_err(ExperimentError::io(folder))?;
    let [picture, table] = ["lr_find.png", "lr_find.csv"].map(|name| folder.join(name));
    write_png(&picture, &drawn(&curve).to_picture())?;
    AtomicFile::write(&table, csv(&curve).as_bytes())?;
    Ok(LrReport { curve, picture, table, remarks: opened.remarks })
}

struct Search<'a> {
    config: &'a ExperimentConfig,
    settings: &'a LrFinderConfig,
}

impl Work for Search<'_> {
    type Out = LrCurve;

    fn with<M: TrainingModule<Batch = TrainBatch>>(
        &self,
        module: &M,
        data: DataModule<'_, M>,
    ) -> Result<LrCurve, ExperimentError> {
        let optimizer = optimizer(&self.config.optimizer, module.params())?;
        let (rate, trainer) = (self.config.optimizer.lr, &self.config.trainer);
        Ok(find_lr(module, data.train, optimizer, rate, trainer, self.settings)?)
    }
}

fn csv(curve: &LrCurve) -> String {
    let mut text = String::from("lr,loss,smoothed\n");
    for point in &curve.points {
        let _ = writeln!(text, "{},{},{}", point.lr, point.loss, point.smoothed);
    }
    text
}

/// Losses over the logarithm of the rate, the mean above them, and the rate that is suggested.
fn drawn(curve: &LrCurve) -> Drawing {
    let [left, top, right, bottom] = MARGIN;
    let [width, height] = SIZE.map(f64::from);
    let (end, base) = (width - right, height - bottom);
    let rates: Vec<f64> = curve.points.iter().map(|point| point.lr).collect();
    // Beyond twice the first mean nothing is to be seen but how steep the end is.
    let most = curve.points.first().map_or(1.0, |point| 2.0 * point.smoothed);
    let clipped = |loss: f64| loss.min(most);
    let shown: Vec<f64> = curve.points.iter().map(|point| clipped(point.smoothed)).collect();
    let (x, y) = (Scale::over(&rates, true, [left, end]), Scale::over(&shown, false, [base, top]));
    let mut d = Drawing::new(SIZE[0], SIZE[1]);
    let title = match curve.suggestion {
        Some(rate) => format!("loss by learning rate; steepest at {rate:.2e}"),
        None => "loss by learning rate; it does not fall".to_owned(),
    };
    d.text([14.0, 12.0], 2, INK, Anchor::Start, &title);
    let ticks = y.ticks();
    for (&tick, label) in ticks.iter().zip(labels(&ticks)) {
        d.line([left, y.at(tick)], [end, y.at(tick)], 1.0, FRAME);
        d.text([left - 6.0, y.at(tick) - 4.0], 1, INK, Anchor::End, &label);
    }
    for tick in x.ticks() {
        d.line([x.at(tick), top], [x.at(tick), base], 1.0, FRAME);
        d.text([x.at(tick), base + 10.0], 1, INK, Anchor::Middle, &format!("{tick:.0e}"));
    }
    for (color, wide, loss) in [
        (RAW, 1.0, (|point| point.loss) as fn(&LrPoint) -> f64),
        (SMOOTH, 2.0, |point| point.smoothed),
    ] {
        for two in curve.points.windows(2).filter(|two| two.iter().all(|p| loss(p).is_finite())) {
            let at = |p: &LrPoint| [x.at(p.lr), y.at(clipped(loss(p))).clamp(top, base)];
            d.line(at(&two[0]), at(&two[1]), wide, color);
        }
    }
    if let Some(rate) = curve.suggestion {
        d.line([x.at(rate), top], [x.at(rate), base], 2.0, FOUND);
    }
    d
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_marks_the_rate_and_the_table_has_every_step() {
        let point = |lr, loss| LrPoint { lr, loss, smoothed: loss };
        let points = vec![point(1e-3, 2.0), point(1e-2, 1.0), point(1e-1, f64::NAN)];
        let mut curve = LrCurve { points, suggestion: Some(1e-2), diverged: true };
        let has = |curve: &LrCurve, color| drawn(curve).to_picture().pixels().contains(&color);
        assert!(has(&curve, FOUND) && has(&curve, SMOOTH));
        assert_eq!(csv(&curve), "lr,loss,smoothed\n0.001,2,2\n0.01,1,1\n0.1,NaN,NaN\n");
        curve.suggestion = None;
        assert!(!has(&curve, FOUND));
        assert_eq!(drawn(&curve).to_picture().width(), SIZE[0]);
    }
}
