//! Changing a scene between reading and writing: cutting, thinning, turning, moving, resizing,
//! joining.

mod crop;
mod level;
mod merge;
mod sample;
mod turn;

pub use crop::CropBox;
pub use level::{Leveling, level};
pub use merge::{MergeReport, merge};
pub use sample::SampleSize;
pub use turn::{EulerAngles, FrameChange, Offset};

use crate::up::{StatedUp, Up, UpGuess, guess_up};
use crate::{GaussianScene, SceneError, Similarity};
use rayon::prelude::*;
use serde::Serialize;

/// What to change, in this order: crop, sample, harmonics, scale, frame, up and level, rotation,
/// translation. The crop is therefore in the coordinates of the scene as it was read, the
/// translation in those of the scene that comes out.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SceneEdit {
    /// Keeps the Gaussians with their center in the box.
    pub crop: Option<CropBox>,
    /// Keeps some, chosen by the seed, in their old order.
    pub sample: Option<SampleSize>,
    /// Cuts harmonics above this degree.
    pub sh_degree: Option<u8>,
    /// Multiplies positions and sizes.
    pub scale: Option<f64>,
    /// Turns or mirrors the axes.
    pub frame: Option<FrameChange>,
    /// Turns the scene so that this direction becomes +z.
    pub up: Option<UpSource>,
    /// What the file states about up, for what is guessed.
    pub stated_up: StatedUp,
    /// Turns the scene so that its floor lies level at z = 0; up is `up`, or else guessed.
    pub level: bool,
    /// Turns about the axes, after all other turns.
    pub rotate: Option<EulerAngles>,
    /// Moves, after all turns.
    pub translate: Option<Offset>,
    /// Seed of the sample.
    pub seed: u64,
}

/// Which direction of a scene is up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum UpSource {
    /// The one that the scene speaks for, by [`guess_up`].
    Auto,
    /// This one.
    Given(Up),
}

/// What an edit did to a scene.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct EditReport {
    /// Rows of the old scene that are left, if any were cut.
    #[serde(skip)]
    pub rows: Option<Vec<usize>>,
    /// The direction that became +z, where one was asked for.
    pub up: Option<UpGuess>,
    /// How the floor was made level, where that was asked for.
    pub level: Option<Leveling>,
}

/// Why a scene cannot be changed as asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EditError {
    /// Nothing is left.
    #[error("no Gaussian has its center in the box; the scene lies in {min:?} to {max:?}")]
    EmptyCrop {
        /// Lowest center.
        min: [f64; 3],
        /// Highest center.
        max: [f64; 3],
    },
    /// A factor that makes no sense.
    #[error("a scale of {0}: must be above 0 and leave every position finite")]
    Scale(f64),
    /// A position that a move takes beyond what a number holds.
    #[error("a move by {0:?}: must leave every position finite")]
    Translation([f64; 3]),
    /// There is nothing to join.
    #[error("no scene to merge")]
    NoScene,
    /// The scene's arrays do not fit together.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

impl SceneEdit {
    /// Changes a scene, and says what was done.
    ///
    /// # Errors
    /// If nothing would be left, the scale is not above 0, or a position would not be finite.
    pub fn apply(&self, scene: GaussianScene) -> Result<(GaussianScene, EditReport), EditError> {
        if let Some(scale) = self.scale
            && !(scale.is_finite() && scale > 0.0)
        {
            return Err(EditError::Scale(scale));
        }
        let mut report = EditReport { rows: self.rows(&scene)?, ..EditReport::default() };
        let mut scene = match &report.rows {
            Some(rows) => scene.select_rows(rows)?,
            None => scene,
        };
        if let (Some(crop), Some(points)) = (&self.crop, &mut scene.labelled_points) {
            crop.cut_points(points, scene.origin);
        }
        if let Some(degree) = self.sh_degree {
            cut_harmonics(&mut scene, degree);
        }
        if let Some(scale) = self.scale {
            scene.transform(&Similarity { scale, ..Similarity::IDENTITY });
            check_finite(&scene, EditError::Scale(scale))?;
        }
        if let Some(FrameChange { from, to }) = self.frame {
            scene.change_frame(from, to);
        }
        self.stand_up(&mut scene, &mut report);
        if let Some(angles) = self.rotate {
            scene.transform(&Similarity { rotation: angles.matrix(), ..Similarity::IDENTITY });
        }
        if let Some(Offset(translation)) = self.translate {
            scene.transform(&Similarity { translation, ..Similarity::IDENTITY });
            check_finite(&scene, EditError::Translation(translation))?;
        }
        Ok((scene, report))
    }

    /// Turns up to +z, and makes the floor level.
    fn stand_up(&self, scene: &mut GaussianScene, report: &mut EditReport) {
        let up = match (self.up, self.level) {
            (None, false) => return,
            (Some(UpSource::Given(axis)), _) => UpGuess::given(axis),
            (Some(UpSource::Auto), _) | (None, true) => guess_up(scene, self.stated_up),
        };
        // Harmonics turn with rounding, so not for nothing.
        if up.direction != Up::PLUS_Z {
            scene.transform(&Similarity {
                rotation: up.direction.upright(),
                ..Similarity::IDENTITY
            });
        }
        report.up = Some(up);
        if self.level {
            let leveling = level(scene);
            scene.transform(&leveling.similarity());
            report.level = Some(leveling);
        }
    }

    fn rows(&self, scene: &GaussianScene) -> Result<Option<Vec<usize>>, EditError> {
        let rows = self.crop.map(|crop| crop.rows(scene)).transpose()?;
        let Some(size) = self.sample else { return Ok(rows) };
        let all = rows.unwrap_or_else(|| (0..scene.len()).collect());
        Ok(Some(size.choose(&all, self.seed)))
    }
}

fn check_finite(scene: &GaussianScene, error: EditError) -> Result<(), EditError> {
    let lost = |p: &[f32; 3]| !p.iter().all(|v| v.is_finite());
    let origin_lost = !scene.origin.iter().all(|v| v.is_finite());
    if origin_lost || scene.coord.par_iter().any(lost) { Err(error) } else { Ok(()) }
}

/// Drops the bands above `degree`.
fn cut_harmonics(scene: &mut GaussianScene, degree: u8) {
    let old = scene.sh_rest_len() * 3;
    if degree < scene.sh_degree {
        scene.sh_degree = degree;
        let new = scene.sh_rest_len() * 3;
        scene.sh_rest =
            scene.sh_rest.chunks_exact(old).flat_map(|row| &row[..new]).copied().collect();
    }
}
