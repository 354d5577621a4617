//! Which way is up, by a network, where the scene itself leaves it open.
//!
//! A network has learned how rooms lie. A scene that lies otherwise is stranger to it, so of a few directions
//! the one is taken in which the scene's features are nearest to those of rooms, what speaks for it by its shape
//! considered.

use super::{Alignment, AlignmentSettings};
use crate::familiarity::Familiarity;
use crate::inference::{EncodeError, Fidelity, ProgressFn, SceneEncoder};
use scenesplat_scene::{GaussianScene, UpEvidence, UpGuess};

/// Directions that are tried at most.
const MOST: usize = 6;

/// A direction whose score is so much below the best is not tried.
const REACH: f64 = 0.6;

/// Rows that the network reads for each.
const ROWS: usize = 50_000;

/// What a point of a direction's score is worth in out-of-distribution score.
const SCORE_WEIGHT: f64 = 4.0;

/// By so much the best must lead; below it, and where the scene is strange in every direction, up stays open.
const MARGIN: f64 = 0.3;

/// How a scene is read in one direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// The direction.
    pub direction: scenesplat_scene::Up,
    /// The out-of-distribution score of the scene so.
    pub strangeness: f32,
    /// What speaks for it by the shape of the scene.
    pub score: f64,
}

impl Look {
    /// Lower is better.
    fn cost(&self) -> f64 {
        f64::from(self.strangeness) - SCORE_WEIGHT * self.score
    }
}

/// The alignment of a scene that was found by its shape; where up is open, the encoder's network decides, whose
/// features `familiar` knows.
///
/// # Errors
/// If the network refuses the scene, or is stopped.
pub fn judged(
    encoder: &SceneEncoder<'_>,
    familiar: &Familiarity,
    scene: &GaussianScene,
    settings: &AlignmentSettings,
    alignment: Alignment,
    progress: &mut ProgressFn<'_>,
) -> Result<Alignment, EncodeError> {
    if !alignment.is_open() {
        return Ok(alignment);
    }
    let mut looks = looks(encoder, familiar, scene, settings, &alignment.up, progress)?;
    looks.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    let margin = |best: &Look| looks.get(1).is_none_or(|next| next.cost() - best.cost() >= MARGIN);
    let is_known = |best: &&Look| best.strangeness <= familiar.limit() && margin(best);
    let Some(best) = looks.first().filter(is_known) else { return Ok(alignment) };
    let each: Vec<String> = looks
        .iter()
        .map(|look| format!("{}: {:.1} ({:.2})", look.direction, look.strangeness, look.score))
        .collect();
    let evidence = format!(
        "{}; the network decides by how strange the scene is to it, and by its shape: {}",
        alignment.up.evidence,
        each.join(", ")
    );
    let up = UpGuess { direction: best.direction, evidence, ..alignment.up };
    Ok(Alignment::with_up(scene, settings, up, true))
}

/// How the scene looks to the network in each direction that may be up.
///
/// # Errors
/// As [`judged`].
pub fn looks(
    encoder: &SceneEncoder<'_>,
    familiar: &Familiarity,
    scene: &GaussianScene,
    settings: &AlignmentSettings,
    up: &UpGuess,
    progress: &mut ProgressFn<'_>,
) -> Result<Vec<Look>, EncodeError> {
    let step = scene.len().div_ceil(ROWS).max(1);
    let rows: Vec<usize> = (0..scene.len()).step_by(step).collect();
    let sample = scene.select_rows(&rows).map_err(scenesplat_datasets::DataError::from)?;
    let encoder = SceneEncoder { fidelity: Fidelity::Fast, codes: None, ..encoder.clone() };
    let best = up.candidates.first().map_or(0.0, |c| c.score);
    let tried = up.candidates.iter().filter(|c| c.score >= best - REACH).take(MOST);
    let mut looks = Vec::new();
    for &UpEvidence { direction, score, .. } in tried {
        let guess = UpGuess { direction, ..up.clone() };
        let alignment = Alignment::with_up(&sample, settings, guess, true);
        let features = encoder.encode_aligned(&sample, alignment, progress)?;
        if let Some(strangeness) = familiar.strangeness(&features)? {
            looks.push(Look { direction, strangeness, score });
        }
    }
    Ok(looks)
}
