//! Quality, calibration and unknown share of labels against the severity of each effect, on rooms that no training
//! saw.
//!
//! ```no_run
//! use scenesplat_lab::severity::{CurveSettings, severity_curves};
//!
//! let report = severity_curves(&CurveSettings::default(), &mut |_, _| true)?;
//! println!("{report}");
//! report.write("curves".as_ref())?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod chart;
mod measure;
mod report;

pub use report::{Check, ConfidenceRow, EffectCurve, SeverityPoint, SeverityReport};

use crate::pareto::ParetoError;
use measure::{Bench, Damaged, Labelled};
use scenesplat::Weights;
use scenesplat::inference::EncodeError;
use scenesplat::labels::LabelError;
use scenesplat::network::NetworkError;
use scenesplat_datasets::effects::{Effect, EffectError, EffectSet, simulate};
use scenesplat_kernels::random::sample_rng;
use scenesplat_metrics::MetricError;
use scenesplat_rooms::{RoomError, SyntheticRoomSettings, generate};
use scenesplat_scene::{GaussianScene, SceneError};
use std::time::Instant;

/// Which curves.
#[derive(Debug, Clone, PartialEq)]
pub struct CurveSettings {
    /// One curve each.
    pub effects: Vec<Effect>,
    /// Where the curves have their points, ascending, 0 first: the undamaged rooms.
    pub severities: Vec<f64>,
    /// Rooms, at least 1.
    pub rooms: usize,
    /// Gaussians of each.
    pub gaussians: usize,
    /// Seed of the rooms; those that the network inside the program was trained on have others.
    pub room_seed: u64,
    /// Seed of the damage.
    pub seed: u64,
    /// Weights of the network inside the program, or of one that is to take its place.
    pub weights: Weights,
}

impl Default for CurveSettings {
    fn default() -> Self {
        Self {
            effects: Effect::ALL.to_vec(),
            severities: (0..=5).map(f64::from).collect(),
            rooms: 4,
            gaussians: 20_000,
            room_seed: 4711,
            seed: 1,
            weights: Weights::Embedded,
        }
    }
}

/// Why there are no curves.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SeverityError {
    /// A setting is out of its range.
    #[error("{setting}: {expected} is expected")]
    Setting {
        /// Which.
        setting: &'static str,
        /// What it may be.
        expected: &'static str,
    },
    /// It was canceled.
    #[error("stopped")]
    Stopped,
    /// A severity that is none.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// No room.
    #[error(transparent)]
    Room(#[from] RoomError),
    /// Arrays of a scene that do not match.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// No network.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// No features.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// No labels.
    #[error(transparent)]
    Label(#[from] LabelError),
    /// No score.
    #[error(transparent)]
    Metric(#[from] MetricError),
    /// No calibration, or no picture.
    #[error(transparent)]
    Pareto(Box<ParetoError>),
    /// A picture that cannot be written.
    #[error(transparent)]
    Picture(#[from] scenesplat::preview::PreviewError),
    /// A report that cannot be written.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// A file of the report that cannot be written.
    #[error(transparent)]
    Write(#[from] scenesplat_scene::WriteError),
    /// A report that cannot be written as JSON.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
}

impl From<ParetoError> for SeverityError {
    fn from(error: ParetoError) -> Self {
        Self::Pareto(Box::new(error))
    }
}

/// Runs a network over rooms with each effect at each severity, and once more with
/// the damage in one corner only.
///
/// `go_on` gets the step under way and the share that is done; returning false cancels.
///
/// # Errors
/// If a setting is out of its range, it was canceled, or something cannot be computed.
pub fn severity_curves(
    settings: &CurveSettings,
    go_on: &mut dyn FnMut(&str, f64) -> bool,
) -> Result<SeverityReport, SeverityError> {
    check(settings)?;
    let began = Instant::now();
    let rooms: Vec<GaussianScene> =
        (0..settings.rooms).map(|room| self::room(settings, room)).collect::<Result<_, _>>()?;
    // Undamaged rooms once; the rest, and the corners, for each effect.
    let points = settings.severities.len();
    let total = (rooms.len() * (2 + settings.effects.len() * (points + 1))) as f64;
    let mut done = 0.0;
    let mut step = |text: &str| {
        let going = go_on(text, done / total);
        done += 1.0;
        if going { Ok(()) } else { Err(SeverityError::Stopped) }
    };
    let mut bench = Bench::new(&settings.weights)?;
    let (mut clean, mut anchored) = (Vec::new(), Vec::new());
    for room in &rooms {
        step("undamaged rooms")?;
        clean.push(bench.label(room)?);
        step("undamaged rooms")?;
        anchored.push(bench.label_anchored(room)?.labels);
    }
    bench.set_threshold(&clean);
    let undamaged = bench.point(0.0, rooms.iter().zip(&clean))?;
    let of = Undamaged { settings, bench: &bench, rooms: &rooms, clean: &clean, anchored };
    let mut curves = Vec::new();
    for &effect in &settings.effects {
        let mut points = vec![undamaged.clone()];
        for &severity in &settings.severities[1..] {
            points.push(of.damaged(effect, severity, &mut step)?);
        }
        let [far_changed, far_changed_anchored] = of.far_changed(effect, &mut step)?;
        let effect = effect.name().to_owned();
        curves.push(EffectCurve { effect, points, far_changed, far_changed_anchored });
    }
    Ok(SeverityReport::new(settings, bench.threshold, curves, began.elapsed().as_secs_f64()))
}

/// Says the next step; fails to cancel.
type Step<'a> = &'a mut dyn FnMut(&str) -> Result<(), SeverityError>;

/// Rooms with their labels before any damage.
struct Undamaged<'a> {
    settings: &'a CurveSettings,
    bench: &'a Bench,
    rooms: &'a [GaussianScene],
    clean: &'a [Labelled],
    anchored: Vec<Vec<i32>>,
}

impl Undamaged<'_> {
    /// The point of a curve at a severity.
    fn damaged(
        &self,
        effect: Effect,
        severity: f64,
        step: Step<'_>,
    ) -> Result<SeverityPoint, SeverityError> {
        let set = EffectSet::default().with(effect, severity)?;
        let mut found = Vec::new();
        for (i, room) in self.rooms.iter().enumerate() {
            step(effect.name())?;
            let scene = simulate(room, &set, seed(self.settings, i))?.scene;
            let labels = self.bench.label(&scene)?;
            found.push((scene, labels));
        }
        self.bench.point(severity, found.iter().map(|(s, l)| (s, l)))
    }

    /// Share of the labels far away that the worst damage in one corner changes; and with anchored voxels.
    fn far_changed(&self, effect: Effect, step: Step<'_>) -> Result<[f64; 2], SeverityError> {
        let worst = self.settings.severities.last().copied().unwrap_or_default();
        let set = EffectSet::default().with(effect, worst)?;
        let (mut far, mut changed, mut changed_anchored) = (0, 0, 0);
        for (i, (room, labels)) in self.rooms.iter().zip(self.clean).enumerate() {
            step(effect.name())?;
            let damage = simulate(room, &set, seed(self.settings, i))?;
            let damaged = Damaged::in_a_corner(room, &damage)?;
            let after = self.bench.label(&damaged.scene)?;
            let (all, other) = damaged.far_labels(room, &labels.labels, &after.labels);
            (far, changed) = (far + all, changed + other);
            step(effect.name())?;
            let after = self.bench.label_anchored(&damaged.scene)?;
            changed_anchored += damaged.far_labels(room, &self.anchored[i], &after.labels).1;
        }
        Ok([changed, changed_anchored].map(|n: u32| f64::from(n) / f64::from(far.max(1))))
    }
}

fn check(settings: &CurveSettings) -> Result<(), SeverityError> {
    let wrong = |setting, expected| Err(SeverityError::Setting { setting, expected });
    let CurveSettings { effects, severities, rooms, gaussians, .. } = settings;
    if effects.is_empty() {
        return wrong("effects", "one or more");
    }
    if *rooms == 0 {
        return wrong("rooms", "1 or more");
    }
    if *gaussians < 1000 {
        return wrong("gaussians", "1000 or more of each room");
    }
    let ascending = severities.first() == Some(&0.0) && severities.is_sorted_by(|a, b| a < b);
    if !ascending || severities.len() < 2 {
        return wrong("severities", "0 and then others, ascending, up to 5,");
    }
    Ok(())
}

fn room(settings: &CurveSettings, room: usize) -> Result<GaussianScene, SeverityError> {
    let settings = SyntheticRoomSettings {
        seed: settings.room_seed,
        room: room as u64,
        num_gaussians: Some(settings.gaussians),
        points_share: 0.0,
        ..SyntheticRoomSettings::default()
    };
    Ok(generate(&settings)?.scene)
}

/// Each room has damage of its own.
fn seed(settings: &CurveSettings, room: usize) -> u64 {
    use rand_chacha::rand_core::RngCore;
    sample_rng(settings.seed, 0, room as u64).next_u64()
}

#[cfg(test)]
mod tests;
