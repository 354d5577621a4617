//! Changing a scene between reading and writing: cutting, thinning, turning, resizing.

use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use scenesplat_scene::{Frame, GaussianScene, LabelledPoints, SceneError, Similarity};
use std::str::FromStr;

/// A box along the axes; both ends belong to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CropBox {
    /// Lowest corner.
    pub min: [f32; 3],
    /// Highest corner.
    pub max: [f32; 3],
}

impl CropBox {
    fn contains(&self, p: &[f32; 3]) -> bool {
        (0..3).all(|i| (self.min[i]..=self.max[i]).contains(&p[i]))
    }
}

impl FromStr for CropBox {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad =
            || format!("{text:?} is no box; write X0,Y0,Z0,X1,Y1,Z1 with the lower end first");
        let numbers: Vec<f32> = text
            .split(',')
            .map(|part| part.trim().parse().map_err(|_| bad()))
            .collect::<Result<_, _>>()?;
        let [a, b, c, d, e, f] = numbers[..] else { return Err(bad()) };
        let (min, max) = ([a, b, c], [d, e, f]);
        // NaN is not below anything.
        if (0..3).all(|i| min[i] <= max[i]) { Ok(Self { min, max }) } else { Err(bad()) }
    }
}

/// How many Gaussians to keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sample {
    /// At most this many.
    Count(usize),
    /// This part of them, 0 to 1.
    Fraction(f64),
}

impl FromStr for Sample {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || format!("{text:?}: write a number of Gaussians (100000) or a part (10%)");
        if let Some(percent) = text.strip_suffix('%') {
            let percent: f64 = percent.trim().parse().map_err(|_| bad())?;
            return if percent > 0.0 && percent <= 100.0 {
                Ok(Self::Fraction(percent / 100.0))
            } else {
                Err(bad())
            };
        }
        match text.parse() {
            Ok(count) if count > 0 => Ok(Self::Count(count)),
            _ => Err(bad()),
        }
    }
}

/// From which frame to which.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameChange {
    /// The frame the scene is in.
    pub from: Frame,
    /// The frame it shall be in.
    pub to: Frame,
}

impl FromStr for FrameChange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Ok(match text.split_once(':') {
            Some((from, to)) => Self { from: from.parse()?, to: to.parse()? },
            None => Self { from: Frame::CANONICAL, to: text.parse()? },
        })
    }
}

/// What to change, in this order: crop, sample, harmonics, scale, frame. The crop is therefore in
/// the coordinates of the scene as it was read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SceneEdit {
    /// Keeps the Gaussians with their centre in the box.
    pub crop: Option<CropBox>,
    /// Keeps some, chosen by the seed, in their old order.
    pub sample: Option<Sample>,
    /// Cuts harmonics above this degree.
    pub sh_degree: Option<u8>,
    /// Multiplies positions and sizes.
    pub scale: Option<f64>,
    /// Turns or mirrors the axes.
    pub frame: Option<FrameChange>,
    /// Seed of the sample.
    pub seed: u64,
}

/// Why a scene cannot be changed as asked.
#[derive(Debug, thiserror::Error)]
pub enum EditError {
    /// Nothing is left.
    #[error("no Gaussian has its centre in the box; the scene lies in {min:?} to {max:?}")]
    EmptyCrop {
        /// Lowest centre.
        min: [f32; 3],
        /// Highest centre.
        max: [f32; 3],
    },
    /// A factor that makes no sense.
    #[error("a scale of {0}: must be above 0 and leave every position finite")]
    Scale(f64),
    /// The scene's arrays do not fit together.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

impl SceneEdit {
    /// Changes a scene; gives the rows of the old one that are left, if any were cut.
    ///
    /// # Errors
    /// If nothing would be left, or the scale is not above 0.
    pub fn apply(
        &self,
        scene: GaussianScene,
    ) -> Result<(GaussianScene, Option<Vec<usize>>), EditError> {
        if let Some(scale) = self.scale
            && !(scale.is_finite() && scale > 0.0)
        {
            return Err(EditError::Scale(scale));
        }
        let rows = self.rows(&scene)?;
        let mut scene = match &rows {
            Some(rows) => scene.select_rows(rows)?,
            None => scene,
        };
        if let (Some(crop), Some(points)) = (&self.crop, &mut scene.labelled_points) {
            crop_points(points, crop);
        }
        if let Some(degree) = self.sh_degree {
            cut_harmonics(&mut scene, degree);
        }
        if let Some(scale) = self.scale {
            let same = Similarity::between(Frame::CANONICAL, Frame::CANONICAL);
            scene.transform(&Similarity { scale, ..same });
            let lost = |p: &[f32; 3]| !p.iter().all(|v| v.is_finite());
            if scene.coord.par_iter().any(lost) {
                return Err(EditError::Scale(scale));
            }
        }
        if let Some(FrameChange { from, to }) = self.frame {
            scene.change_frame(from, to);
        }
        Ok((scene, rows))
    }

    fn rows(&self, scene: &GaussianScene) -> Result<Option<Vec<usize>>, EditError> {
        let mut rows = None;
        if let Some(crop) = self.crop {
            let inside = |row: &usize| crop.contains(&scene.coord[*row]);
            let kept: Vec<usize> = (0..scene.len()).into_par_iter().filter(inside).collect();
            if kept.is_empty() {
                let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
                for p in &scene.coord {
                    for i in 0..3 {
                        min[i] = min[i].min(p[i]);
                        max[i] = max[i].max(p[i]);
                    }
                }
                return Err(EditError::EmptyCrop { min, max });
            }
            rows = Some(kept);
        }
        if let Some(wanted) = self.sample {
            let all = rows.unwrap_or_else(|| (0..scene.len()).collect());
            let count = match wanted {
                Sample::Count(count) => count.min(all.len()),
                Sample::Fraction(part) => ((all.len() as f64 * part).round() as usize).max(1),
            };
            let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
            let mut chosen = sample(&mut rng, all.len(), count).into_vec();
            chosen.sort_unstable();
            rows = Some(chosen.into_iter().map(|i| all[i]).collect());
        }
        Ok(rows)
    }
}

/// Keeps the labelled points in the box: others would be judged by Gaussians that are not there.
fn crop_points(points: &mut LabelledPoints, crop: &CropBox) {
    let inside: Vec<bool> = points.coord.iter().map(|p| crop.contains(p)).collect();
    fn keep<T>(values: &mut Vec<T>, inside: &[bool]) {
        let mut flags = inside.iter();
        values.retain(|_| flags.next().copied().unwrap_or(false));
    }
    keep(&mut points.coord, &inside);
    for labels in [&mut points.segment, &mut points.instance].into_iter().flatten() {
        keep(labels, &inside);
    }
}

/// Drops the bands above `degree`.
fn cut_harmonics(scene: &mut GaussianScene, degree: u8) {
    if degree >= scene.sh_degree {
        return;
    }
    let old = scene.sh_rest_len() * 3;
    scene.sh_degree = degree;
    let new = scene.sh_rest_len() * 3;
    if new == 0 {
        scene.sh_rest = Vec::new();
        return;
    }
    let mut rest = Vec::with_capacity(scene.len() * new);
    for row in scene.sh_rest.chunks_exact(old) {
        rest.extend_from_slice(&row[..new]);
    }
    scene.sh_rest = rest;
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_rooms::{SyntheticRoomSettings, generate};

    fn room() -> GaussianScene {
        generate(&SyntheticRoomSettings::with_count(2000, 3)).unwrap().scene
    }

    #[test]
    fn crops_and_samples_keep_whole_rows_in_order() {
        let scene = room();
        let edit = SceneEdit {
            crop: Some("-1,-1,-1,1,1,1".parse().unwrap()),
            sample: Some(Sample::Count(50)),
            ..SceneEdit::default()
        };
        let (cut, rows) = edit.apply(scene.clone()).unwrap();
        let rows = rows.unwrap();
        assert_eq!((cut.len(), rows.len()), (50, 50));
        assert!(rows.is_sorted());
        assert!(cut.coord.iter().flatten().all(|v| v.abs() <= 1.0));
        assert_eq!(cut, scene.select_rows(&rows).unwrap());
        let again = edit.apply(scene.clone()).unwrap().1.unwrap();
        assert_eq!(again, rows);
        let other = SceneEdit { seed: 1, ..edit }.apply(scene).unwrap().1.unwrap();
        assert_ne!(other, rows);
    }

    #[test]
    fn labelled_points_are_cropped_too() {
        let mut scene = room();
        let coord = scene.coord.clone();
        let segment = Some((0..coord.len() as i32).collect());
        scene.labelled_points = Some(LabelledPoints { coord, segment, instance: None });
        let crop = Some("-1,-1,-1,1,1,1".parse().unwrap());
        let (cut, rows) = SceneEdit { crop, ..SceneEdit::default() }.apply(scene).unwrap();
        let points = cut.labelled_points.unwrap();
        assert_eq!(points.coord, cut.coord);
        let rows: Vec<i32> = rows.unwrap().into_iter().map(|r| r as i32).collect();
        assert_eq!(points.segment, Some(rows));
    }

    #[test]
    fn a_part_of_few_is_at_least_one() {
        let scene = room().select_rows(&[0, 1]).unwrap();
        let edit = SceneEdit { sample: Some("1%".parse().unwrap()), ..SceneEdit::default() };
        assert_eq!(edit.apply(scene).unwrap().0.len(), 1);
    }

    #[test]
    fn an_empty_box_says_where_the_scene_is() {
        let edit =
            SceneEdit { crop: Some("900,0,0,901,1,1".parse().unwrap()), ..SceneEdit::default() };
        assert!(edit.apply(room()).unwrap_err().to_string().contains("the scene lies in"));
    }

    #[test]
    fn millimetres_become_metres() {
        let scene = room();
        let edit = SceneEdit { scale: Some(0.001), ..SceneEdit::default() };
        let (small, rows) = edit.apply(scene.clone()).unwrap();
        assert_eq!(rows, None);
        assert!((small.coord[7][1] - scene.coord[7][1] / 1000.0).abs() < 1e-9);
        assert!((small.scale(7)[0] * 1000.0 / scene.scale(7)[0] - 1.0).abs() < 1e-5);
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e39] {
            assert!(SceneEdit { scale: Some(bad), ..SceneEdit::default() }.apply(room()).is_err());
        }
    }

    #[test]
    fn lower_degrees_keep_the_lower_bands() {
        let mut scene = room().select_rows(&[0, 1, 2]).unwrap();
        scene.sh_degree = 2;
        scene.sh_rest = (0..3 * 24).map(|i| i as f32).collect();
        let edit = SceneEdit { sh_degree: Some(1), ..SceneEdit::default() };
        let (cut, _) = edit.apply(scene.clone()).unwrap();
        assert_eq!(cut.sh_rest[9..18], scene.sh_rest[24..33]);
        cut.check_rows().unwrap();
        let none = SceneEdit { sh_degree: Some(0), ..SceneEdit::default() }.apply(scene).unwrap().0;
        assert!(none.sh_rest.is_empty() && none.sh_degree == 0);
    }

    #[test]
    fn nonsense_is_refused() {
        for text in ["", "1,2,3", "1,1,1,0,2,2", "nan,0,0,1,1,1", "a,b,c,d,e,f"] {
            assert!(text.parse::<CropBox>().is_err(), "{text}");
        }
        for text in ["0", "-1", "0%", "101%", "x", "1.5"] {
            assert!(text.parse::<Sample>().is_err(), "{text}");
        }
        assert!("RDF:XYZ".parse::<FrameChange>().is_err());
        let change: FrameChange = "rub".parse().unwrap();
        assert_eq!((change.from, change.to), (Frame::CANONICAL, Frame::RUB));
    }
}
