//! What a network knows of a scene and of rooms: before and after it learned from the scene.

use super::error::AdaptError;
use crate::calibration::Calibration;
use crate::inference::{EncodeProgress, SceneFeatures};
use crate::labels::{Agreement, Classes, VOTE_K, label_agreeing_with_vote};
use crate::text::text_rows;
use crate::{AlignmentSettings, EncodeError, Network, SceneEncoder};
use scenesplat_metrics::{
    ConfusionMatrix, FeatureSlice, Metric, TesterReport, cosine_scores, fit_temperature,
    probability_error,
};
use scenesplat_objects::surfaces::{SurfaceSettings, scene_surfaces};
use scenesplat_rooms::{Capture, SyntheticRoomSettings, generate};
use scenesplat_scene::{GaussianScene, TextTable, Up};
use serde::Serialize;

/// Seeds of rooms that are scored, and of those that a temperature is fitted to and tried on: none is trained on.
const SCORED: u64 = 1000;
const FITTED: [u64; 2] = [5001, 5002];
/// Rooms of each capture that a temperature is fitted to, and rows of each, about.
const FITTED_ROOMS: u64 = 2;
const ROWS: usize = 4000;

/// Rows that have a class, and how many of them are labeled with it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Right {
    /// Rows with a class.
    pub rows: usize,
    /// Those that are right.
    pub right: usize,
}

impl Right {
    /// Part that is right, 0..=1; `None` without a row.
    pub fn share(self) -> Option<f64> {
        (self.rows > 0).then(|| self.right as f64 / self.rows as f64)
    }

    fn add(&mut self, is_right: bool) {
        self.rows += 1;
        self.right += usize::from(is_right);
    }
}

/// A scene whose truth is known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AgainstTruth {
    /// All rows with a true class.
    pub all: Right,
    /// Rows that have a label to learn from.
    pub labeled: Right,
    /// Rows that have none, those held out among them.
    pub unlabeled: Right,
    /// Rows whose true class is one of the labels'.
    pub known: Right,
    /// Rows whose true class is none of them.
    pub others: Right,
    /// Mean IoU of the classes, walls, floors and ceilings left out, 0..=1.
    pub f_miou: Option<f64>,
}

/// Rooms that were not trained on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OfRooms {
    /// How many.
    pub rooms: usize,
    /// All rows.
    pub all: Right,
    /// Mean IoU of the classes, walls, floors and ceilings left out, 0..=1.
    pub f_miou: Option<f64>,
    /// The same of the classes that the labels name.
    pub known: Option<f64>,
    /// The same of the classes that they do not.
    pub others: Option<f64>,
}

/// What a network knows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Labels that were learned from.
    pub learned: Right,
    /// Labels that were held out.
    pub held_out: Right,
    /// Held-out labels by class, those of a row or more.
    pub held_out_classes: Vec<(String, Right)>,
    /// The scene's truth, if there is one.
    pub truth: Option<AgainstTruth>,
    /// Rooms that are made on the spot; `None` if none was asked for.
    pub rooms: Option<OfRooms>,
}

/// What is asked of a network.
pub struct Exam<'a> {
    /// Texts of the classes.
    pub texts: &'a TextTable,
    /// The scene as networks read it: upright, in meters.
    pub scene: &'a GaussianScene,
    /// Its labels, −1 for none. `[N]`
    pub labels: &'a [i32],
    /// Which of them are held out. `[N]`
    pub held_out: &'a [bool],
    /// Its true classes, −1 for none. `[N]`
    pub truth: Option<&'a [i32]>,
    /// How many rooms are labeled.
    pub rooms: usize,
    /// How many Gaussians a room has; by its size if not given.
    pub room_gaussians: Option<usize>,
}

/// Called while networks run; an error stops them.
pub type Progress<'p> = dyn FnMut(&str, EncodeProgress) -> Result<(), EncodeError> + 'p;

impl Exam<'_> {
    /// The figures of a network whose cosines become probabilities by `calibration`.
    ///
    /// # Errors
    /// If the network refuses a scene, or `progress` stops it.
    pub fn figures(
        &self,
        network: &Network,
        calibration: Option<&Calibration>,
        progress: &mut Progress<'_>,
    ) -> Result<Figures, AdaptError> {
        let as_is = AlignmentSettings { as_is: true, ..AlignmentSettings::default() };
        let encoder = SceneEncoder { alignment: as_is, ..SceneEncoder::new(network) };
        let found = encoder.encode(self.scene, &mut |at| progress("the scene", at))?;
        let found = self.label(self.scene, &found, calibration)?;
        let (mut learned, mut held_out) = (Right::default(), Right::default());
        let mut by_class = vec![Right::default(); self.texts.len()];
        for ((found, label), out) in found.iter().zip(self.labels).zip(self.held_out) {
            let Ok(class) = usize::try_from(*label) else { continue };
            if *out {
                held_out.add(found == label);
                by_class[class].add(found == label);
            } else {
                learned.add(found == label);
            }
        }
        let named = self.texts.names.iter().cloned().zip(by_class);
        Ok(Figures {
            learned,
            held_out,
            held_out_classes: named.filter(|(_, right)| right.rows > 0).collect(),
            truth: self.truth.map(|truth| self.against(truth, &found)).transpose()?,
            rooms: self.of_rooms(network, calibration, progress)?,
        })
    }

    /// The classes that the labels name. `[classes]`
    pub fn known(&self) -> Vec<bool> {
        let mut known = vec![false; self.texts.len()];
        self.labels.iter().filter_map(|l| usize::try_from(*l).ok()).for_each(|l| known[l] = true);
        known
    }

    /// Labels as commands give them to a room: texts, surfaces, vote.
    fn label(
        &self,
        scene: &GaussianScene,
        features: &SceneFeatures,
        calibration: Option<&Calibration>,
    ) -> Result<Vec<i32>, AdaptError> {
        // How large things are does not depend on who looks at them.
        let sizes = calibration.cloned().map_or_else(Calibration::embedded, Ok)?;
        let upright = Up::PLUS_Z.upright();
        let surfaces = scene_surfaces(scene, &upright, 1.0, &SurfaceSettings::default())
            .map_err(crate::labels::LabelError::from)?;
        let agreement = Agreement {
            surfaces: Some(&surfaces),
            temperature: calibration.map(|own| own.temperature),
            min_probability: None,
            least_area: &sizes.least_area(&self.texts.names),
        };
        let classes = Classes::Texts(self.texts);
        let options = Default::default();
        let coord = &scene.coord;
        let found =
            label_agreeing_with_vote(features, classes, &options, &agreement, coord, VOTE_K)?;
        Ok(found.labels)
    }

    fn matrix(&self) -> Result<ConfusionMatrix, AdaptError> {
        let name = |class: &&str| self.texts.names.iter().position(|name| name == class);
        let excluded: Vec<usize> = ["wall", "floor", "ceiling"].iter().filter_map(name).collect();
        Ok(ConfusionMatrix::new(self.texts.len())?.with_excluded(&excluded)?)
    }

    fn against(&self, truth: &[i32], found: &[i32]) -> Result<AgainstTruth, AdaptError> {
        let known = self.known();
        let [mut all, mut labeled, mut unlabeled, mut of_known, mut others] = [Right::default(); 5];
        for (row, (truth, found)) in truth.iter().zip(found).enumerate() {
            let Ok(class) = usize::try_from(*truth) else { continue };
            let is_learned = self.labels[row] >= 0 && !self.held_out[row];
            let about = if is_learned { &mut labeled } else { &mut unlabeled };
            about.add(truth == found);
            let about = if known[class] { &mut of_known } else { &mut others };
            about.add(truth == found);
            all.add(truth == found);
        }
        let mut matrix = self.matrix()?;
        matrix.update((found, truth))?;
        let f_miou = matrix.tester_report().foreground_mean_iou;
        Ok(AgainstTruth { all, labeled, unlabeled, known: of_known, others, f_miou })
    }

    fn of_rooms(
        &self,
        network: &Network,
        calibration: Option<&Calibration>,
        progress: &mut Progress<'_>,
    ) -> Result<Option<OfRooms>, AdaptError> {
        if self.rooms == 0 {
            return Ok(None);
        }
        let mut matrix = self.matrix()?;
        let mut all = Right::default();
        for room in 0..self.rooms {
            let scene = self.room(SCORED, room as u64, Capture::Made)?;
            let name = format!("room {} of {}", room + 1, self.rooms);
            let encoder = SceneEncoder::new(network);
            let features = encoder.encode(&scene, &mut |at| progress(&name, at))?;
            let found = self.label(&scene, &features, calibration)?;
            let truth = scene.segment.unwrap_or_default();
            matrix.update((&found, &truth))?;
            truth.iter().zip(&found).filter(|(t, _)| **t >= 0).for_each(|(t, f)| all.add(t == f));
        }
        let (report, known) = (matrix.tester_report(), self.known());
        let mean = |wanted: bool| mean_iou(&report, |class| known[class] == wanted);
        let f_miou = report.foreground_mean_iou;
        Ok(Some(OfRooms { rooms: self.rooms, all, f_miou, known: mean(true), others: mean(false) }))
    }

    fn room(&self, seed: u64, room: u64, capture: Capture) -> Result<GaussianScene, AdaptError> {
        let num_gaussians = self.room_gaussians;
        let settings =
            SyntheticRoomSettings { seed, room, capture, num_gaussians, ..Default::default() };
        Ok(generate(&settings)?.scene)
    }

    /// What makes the cosines of a network probabilities: the temperature at which the classes of rooms are likeliest, and how
    /// far it is off on others. `weights`: the SHA-256 of its file.
    ///
    /// # Errors
    /// As [`figures`](Self::figures).
    pub fn calibrate(
        &self,
        network: &Network,
        weights: String,
        progress: &mut Progress<'_>,
    ) -> Result<Calibration, AdaptError> {
        let mut rows_of = |seed: u64| -> Result<(Vec<f32>, Vec<i32>), AdaptError> {
            let (mut scores, mut truth) = (Vec::new(), Vec::new());
            for (capture, room) in [Capture::Made, Capture::Scan]
                .into_iter()
                .flat_map(|capture| (0..FITTED_ROOMS).map(move |room| (capture, room)))
            {
                let scene = self.room(seed, room, capture)?;
                let features = SceneEncoder::new(network)
                    .encode(&scene, &mut |at| progress("calibration", at))?;
                let segment = scene.segment.as_deref().unwrap_or_default();
                for row in (0..scene.len()).step_by(scene.len().div_ceil(ROWS).max(1)) {
                    let own = features.gaussian_rows(row..row + 1)?;
                    let own = FeatureSlice::new(&own, self.texts.dim)?;
                    scores.extend(cosine_scores(&own, text_rows(self.texts)?)?);
                    truth.push(segment[row]);
                }
            }
            Ok((scores, truth))
        };
        let ([(scores, truth), (others, other_truth)], classes) =
            ([rows_of(FITTED[0])?, rows_of(FITTED[1])?], self.texts.len());
        // Rooms have labels, so there is one.
        let temperature = fit_temperature(&scores, &truth, classes)?.unwrap_or(1.0);
        let ece = probability_error(&others, &other_truth, classes, temperature)?.ece;
        let surface = Calibration::embedded()?.surface;
        Ok(Calibration { weights, temperature, ece, surface })
    }
}

/// Mean IoU of some of the classes that averages do not leave out and that are there, 0..=1.
fn mean_iou(report: &TesterReport, is_wanted: impl Fn(usize) -> bool) -> Option<f64> {
    let wanted = report.classes.iter().enumerate();
    let wanted = wanted.filter(|(class, about)| is_wanted(*class) && !about.excluded);
    let each: Vec<f64> = wanted.filter_map(|(_, about)| about.iou).collect();
    (!each.is_empty()).then(|| each.iter().sum::<f64>() / each.len() as f64)
}
