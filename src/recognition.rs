//! Which parts of a scene are a place that the network knows, a room, and which are something else.
//!
//! A closed-set network answers whatever it is shown, so labels of a toy or a garden mean nothing. Three things tell
//! them from rooms: the direction in which features of a surface point (a linear classifier, fitted to rooms and to
//! things that are none: single things, heaps, balls, hills), the same over the whole scene (a chair in a room is
//! surer than a chair alone), and how square the scene is built ([`squareness`]). Each surface gets one probability,
//! so that what is strange in a room stays unknown and the room keeps its labels.
//!
//! [`squareness`]: scenesplat_scene::squareness

use crate::inference::{EncodeError, SceneFeatures};
use crate::network::NetworkError;
use rayon::prelude::*;
use scenesplat_kernels::normalize::normalize_rows;
use scenesplat_objects::surfaces::{NO_SURFACE, Surfaces};
use scenesplat_scene::quantile::quantile;
use serde::{Deserialize, Serialize};

mod logistic;

use logistic::Logistic;

const FILE: &str = "assets/embedded/recognition.json";
const EMBEDDED: &str = include_str!("../assets/embedded/recognition.json");

/// Rows that are read at a time.
const BLOCK: usize = 4096;

/// The share of a scene's rows that score less stands for the scene: things that a room has and no training room had
/// must not speak for all of it.
const QUANTILE: f64 = 0.75;

/// A surface that is less probable to be part of a room stays without a label.
pub const KNOWN: f32 = 0.25;

/// A surface that is less probable stays without a label where labels are to be trusted.
pub const SURE: f32 = 0.5;

/// With fewer Gaussians it is not judged whether a scene is known.
pub const FEWEST: usize = 10_000;

/// Where a smaller share of the Gaussians is known, what is known of a scene is chance.
pub const LEAST_SHARE: f64 = 0.2;

/// Less square than where normals point anywhere is no less a room.
const LEAST_SQUARE: f64 = 0.02;

/// What tells rooms from other scenes by the features of one network.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recognition {
    /// SHA-256 of the weights, hexadecimal.
    pub weights: String,
    /// Of a feature row of unit length: its log odds to be of a room.
    row: Logistic,
    /// Of the mean score of a surface, the score of the scene, and the logarithm of how square it is: the log odds that the surface is
    /// part of a room.
    surface: Logistic,
}

/// A scene that is known to be of rooms, or of none.
#[derive(Debug, Clone, PartialEq)]
pub struct Example {
    /// Feature rows of unit length. `[n, width]`
    pub rows: Vec<f32>,
    /// Surface of each row, [`NO_SURFACE`] for none. `[n]`
    pub surface: Vec<u32>,
    /// How square it is, 0..=1.
    pub squareness: f64,
    /// Whether each row is part of a room. `[n]`
    pub is_room: Vec<bool>,
}

/// What is known of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Recognized {
    /// The probability of each Gaussian to be part of a room, 0..=1. `[N]`
    pub probability: Vec<f32>,
    /// The score of the scene, log odds by its features alone.
    pub score: f64,
    /// How square it is, 0..=1.
    pub squareness: f64,
}

impl Recognized {
    /// The share of the Gaussians that are at least so probable.
    pub fn share(&self, least: f32) -> f64 {
        let known = self.probability.iter().filter(|p| **p >= least).count();
        known as f64 / self.probability.len().max(1) as f64
    }

    /// The Gaussians that are less probable; all of them, if hardly any is as probable. `[N]`
    pub fn strange(&self, least: f32) -> Vec<bool> {
        let is_all = self.share(least) < LEAST_SHARE;
        self.probability.iter().map(|p| is_all || *p < least).collect()
    }
}

impl Recognition {
    /// That of the network inside the program.
    ///
    /// # Errors
    /// If the program was built with a broken file.
    pub fn embedded() -> Result<Self, NetworkError> {
        serde_json::from_str(EMBEDDED).map_err(NetworkError::config(FILE))
    }

    /// Fits the classifier of rows to some scenes, and that of surfaces to others, which it has not seen. Each scene
    /// counts the same, and rooms as much as the rest. The same examples give the same bits.
    ///
    /// # Panics
    /// If either has no rooms, or nothing but rooms (a bug of the caller).
    pub fn fit(rows: &[Example], surfaces: &[Example], weights: String) -> Self {
        let width = rows[0].rows.len() / rows[0].surface.len().max(1);
        let of = |examples: &[Example], inputs: &dyn Fn(&Example) -> Vec<Vec<f64>>| {
            let mut all = Vec::new();
            for example in examples {
                let weight = 1.0 / example.is_room.len().max(1) as f64;
                let own = inputs(example).into_iter().zip(&example.is_room);
                all.extend(own.map(|(x, is_room)| (x, *is_room, weight)));
            }
            let of_rooms: f64 = all.iter().filter(|e| e.1).map(|e| e.2).sum();
            let share = of_rooms / examples.len() as f64;
            for (_, is_room, weight) in &mut all {
                *weight *= 0.5 / if *is_room { share } else { 1.0 - share };
            }
            Logistic::fit(&all)
        };
        let row = of(rows, &|e| {
            e.rows.chunks_exact(width).map(|r| r.iter().map(|v| f64::from(*v)).collect()).collect()
        });
        let mut found = Self { weights, surface: Logistic::zero(3), row };
        let surface = of(surfaces, &|e| {
            let scores: Vec<f32> = e.rows.chunks_exact(width).map(|r| found.row_score(r)).collect();
            // Larger surfaces count for more.
            let count = e.surface.iter().filter(|s| **s != NO_SURFACE).max().map_or(0, |s| s + 1);
            let of = Surfaces { of: e.surface.clone(), count: count as usize };
            let (scene, means) = means(&scores, &scores, &of);
            let of = |s: &u32| means.get(*s as usize).copied().flatten().unwrap_or(scene);
            e.surface.iter().map(|s| inputs(of(s), scene, e.squareness).to_vec()).collect()
        });
        found.surface = surface;
        found
    }

    /// Values of a row.
    pub fn width(&self) -> usize {
        self.row.width()
    }

    /// The log odds of a row of unit length to be of a room.
    pub fn row_score(&self, row: &[f32]) -> f32 {
        self.row.log_odds(row.iter().map(|v| f64::from(*v))) as f32
    }

    /// How probable it is that each Gaussian is part of a room. `surfaces`: of the same Gaussians; without them the scene
    /// is judged as one. `None` if the
    /// features are of another width: codes, or those of another network, or no row has a direction.
    ///
    /// # Errors
    /// If features went to a file and cannot be read.
    pub fn of(
        &self,
        features: &SceneFeatures,
        surfaces: Option<&Surfaces>,
        squareness: f64,
    ) -> Result<Option<Recognized>, EncodeError> {
        if features.width() != self.width() {
            return Ok(None);
        }
        let mut scores = Vec::with_capacity(features.num_slots());
        for start in (0..features.num_slots()).step_by(BLOCK) {
            let end = (start + BLOCK).min(features.num_slots());
            let mut rows = features.slot_rows(start..end)?;
            normalize_rows(&mut rows, self.width());
            let block = rows.par_chunks_exact(self.width()).map(|row| {
                let has_direction = row.iter().any(|v| *v != 0.0);
                if has_direction { self.row_score(row) } else { f32::NAN }
            });
            scores.extend(block.collect::<Vec<f32>>());
        }
        let each: Vec<f32> = features.inverse().iter().map(|slot| scores[*slot as usize]).collect();
        if !scores.iter().any(|s| s.is_finite()) {
            return Ok(None);
        }
        let none = Surfaces { of: Vec::new(), count: 0 };
        let surfaces = surfaces.unwrap_or(&none);
        let (scene, means) = means(&scores, &each, surfaces);
        let probable = |mean: f64| {
            let odds = self.surface.log_odds(inputs(mean, scene, squareness).into_iter());
            (1.0 / (1.0 + (-odds).exp())) as f32
        };
        let of_surface: Vec<f32> = means.iter().map(|m| probable(m.unwrap_or(scene))).collect();
        let rest = probable(scene);
        let of_row = |row| of_surface.get(*surfaces.of.get(row)? as usize).copied();
        let probability = (0..each.len()).map(|row| of_row(row).unwrap_or(rest)).collect();
        Ok(Some(Recognized { probability, score: scene, squareness }))
    }
}

/// What the odds of a surface are made of; a scene that is half as square loses the same, however square it is.
fn inputs(mean: f64, scene: f64, squareness: f64) -> [f64; 3] {
    [mean, scene, squareness.max(LEAST_SQUARE).ln()]
}

/// The score of a scene by those of its distinct rows, and the mean of those of the Gaussians of each surface; rows
/// without a score have no say.
fn means(distinct: &[f32], each: &[f32], surfaces: &Surfaces) -> (f64, Vec<Option<f64>>) {
    let mut finite: Vec<f32> = distinct.iter().copied().filter(|s| s.is_finite()).collect();
    let scene = quantile(&mut finite, QUANTILE).map_or(0.0, f64::from);
    let mut sums = vec![(0.0, 0.0); surfaces.count];
    for (surface, score) in surfaces.of.iter().zip(each).filter(|(_, s)| s.is_finite()) {
        if let Some(sum) = sums.get_mut(*surface as usize) {
            *sum = (sum.0 + f64::from(*score), sum.1 + 1.0);
        }
    }
    (scene, sums.into_iter().map(|(sum, n)| (n > 0.0).then(|| sum / n)).collect())
}

#[cfg(test)]
mod tests;
