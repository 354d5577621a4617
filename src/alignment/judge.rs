//! Which way is up and how large a scene is, by a network, where the shape of the scene leaves it open.
//!
//! A network has learned how rooms lie. A scene that lies otherwise is stranger to it, so of a few directions
//! the one is taken in which the scene's features are nearest to those of rooms, what speaks for it by its shape
//! considered. How large it is, things of known size say that the network finds in it ([`yardsticks`]): the scene is
//! scaled until they are as large as in rooms.

use super::{Alignment, AlignmentSettings, Remark, USUAL_HEIGHT, UnitBySize};
use crate::embedded;
use crate::familiarity::Familiarity;
use crate::inference::{EncodeError, Fidelity, ProgressFn, SceneEncoder, SceneFeatures};
use crate::network::NetworkError;
use crate::yardsticks::{self, Measured, Yardsticks, nearest_text};
use scenesplat_scene::{GaussianScene, TextTable, UpEvidence, UpGuess, robust_bounds};

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

/// The least [`Look::sense`] that decides, and how often that of the next direction it must be. Measured on a kitchen of bare
/// points in seven poses (upright 0.90 to 0.93, half of it if it is read half as large again; else 0.30 at most) and on eight
/// single things (0.33 at most).
const LEAST_SENSE: f64 = 0.35;
const SENSE_LEAD: f64 = 2.0;
/// The lowest part of a scene, as a share of its height.
const LOWEST: f64 = 0.05;

/// Times that a scene is scaled by what is found in it; below so small a factor, in ln, it is settled.
const ROUNDS: usize = 4;
const SETTLED: f64 = 0.03;

/// Fewest classes that must agree, and how much their heights may spread, in ln.
const FEWEST_THAT_AGREE: usize = 3;
const MOST_SPREAD: f64 = 0.12;

/// How far all yardsticks are off together from one scene to another, in ln: measured on rooms that they were not fitted to.
const OWN_SPREAD: f64 = 0.04;

/// A unit this near to a meter, in ln, is taken for it.
const METRE: f64 = 0.15;

/// By how much a unit may be off for the confidence, in ln.
const TENTH: f64 = 0.1;

/// Heights of scenes that are looked at as they are, meters; others are first made as high as rooms usually are.
const HEIGHTS: [f64; 2] = [1.2, 6.0];

/// The class of floors.
const FLOOR: &str = "floor";

/// Classes that are named as evidence.
const SHOWN: usize = 4;

/// How a scene is read in one direction.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Look {
    /// The direction.
    direction: scenesplat_scene::Up,
    /// The out-of-distribution score of the scene so.
    strangeness: f32,
    /// What speaks for it by the shape of the scene.
    score: f64,
    /// How much sense the labels make.
    sense: f64,
}

impl Look {
    /// Lower is better.
    fn cost(&self) -> f64 {
        f64::from(self.strangeness) - SCORE_WEIGHT * self.score
    }
}

/// What the network inside the program decides by.
pub struct Judge {
    familiar: Familiarity,
    yardsticks: Yardsticks,
    texts: TextTable,
}

impl Judge {
    /// That of the network inside the program.
    ///
    /// # Errors
    /// If the program was built with broken files.
    pub fn embedded() -> Result<Self, NetworkError> {
        Ok(Self {
            familiar: Familiarity::embedded()?,
            yardsticks: Yardsticks::embedded()?,
            texts: embedded::vocabulary()?.class_table(),
        })
    }

    /// The alignment of a scene that was found by its shape; where that leaves up or the unit open, the encoder's
    /// network decides.
    ///
    /// # Errors
    /// If the network refuses the scene, or is stopped.
    pub fn decide(
        &self,
        encoder: &SceneEncoder<'_>,
        scene: &GaussianScene,
        settings: &AlignmentSettings,
        alignment: Alignment,
        progress: &mut ProgressFn<'_>,
    ) -> Result<Alignment, EncodeError> {
        let alignment = self.judged_up(encoder, scene, settings, alignment, progress)?;
        if !alignment.is_size_open() {
            return Ok(alignment);
        }
        let looker = Looker::new(encoder, scene)?;
        let mut found = self.sized(&looker, scene, settings, alignment, progress)?;
        found.warn_of_open_size(&looker.sample);
        Ok(found)
    }

    /// With up by what the network makes of the scene in each direction that may be up.
    fn judged_up(
        &self,
        encoder: &SceneEncoder<'_>,
        scene: &GaussianScene,
        settings: &AlignmentSettings,
        alignment: Alignment,
        progress: &mut ProgressFn<'_>,
    ) -> Result<Alignment, EncodeError> {
        if !alignment.is_open() {
            return Ok(alignment);
        }
        let mut looks = self.looks(encoder, scene, settings, &alignment.up, progress)?;
        let Some((best, why)) = by_sense(&mut looks).or_else(|| self.by_shape(&mut looks)) else {
            return Ok(alignment);
        };
        let evidence = format!("{}; the network decides by {why}", alignment.up.evidence);
        let up = UpGuess { direction: best.direction, evidence, ..alignment.up };
        Ok(Alignment::with_up(scene, settings, up, true))
    }

    /// The direction in which the scene is least strange to the network, its shape counted in, if one leads.
    fn by_shape(&self, looks: &mut [Look]) -> Option<(Look, String)> {
        looks.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
        let best = *looks.first()?;
        let leads = looks.get(1).is_none_or(|next| next.cost() - best.cost() >= MARGIN);
        let each: Vec<String> = looks
            .iter()
            .map(|look| format!("{}: {:.1} ({:.2})", look.direction, look.strangeness, look.score))
            .collect();
        let why = format!("how strange the scene is to it, and by its shape: {}", each.join(", "));
        (best.strangeness <= self.familiar.limit() && leads).then_some((best, why))
    }

    /// How the scene looks to the network in each direction that may be up.
    fn looks(
        &self,
        encoder: &SceneEncoder<'_>,
        scene: &GaussianScene,
        settings: &AlignmentSettings,
        up: &UpGuess,
        progress: &mut ProgressFn<'_>,
    ) -> Result<Vec<Look>, EncodeError> {
        let looker = Looker::new(encoder, scene)?;
        let best = up.candidates.first().map_or(0.0, |c| c.score);
        let tried = up.candidates.iter().filter(|c| c.score >= best - REACH).take(MOST);
        let mut looks = Vec::new();
        for &UpEvidence { direction, score, .. } in tried {
            let guess = UpGuess { direction, ..up.clone() };
            let mut alignment = Alignment::with_up(&looker.sample, settings, guess, true);
            if alignment.is_size_open() {
                alignment.make_as_high_as_rooms(&looker.sample, settings);
            }
            let features = looker.look(&alignment, progress)?;
            let Some(strangeness) = self.familiar.strangeness(&features)? else { continue };
            let labels = nearest_text(&features, &self.texts)?;
            let copy = alignment.apply(&looker.sample);
            let heights: Vec<f32> = copy.coord.iter().map(|p| p[2]).collect();
            let floor = self.texts.names.iter().position(|name| name == FLOOR);
            let sense = sense(&labels, &heights, floor);
            looks.push(Look { direction, strangeness, score, sense });
        }
        Ok(looks)
    }

    /// With the unit by what the network finds in the scene.
    fn sized(
        &self,
        looker: &Looker<'_>,
        scene: &GaussianScene,
        settings: &AlignmentSettings,
        shape: Alignment,
        progress: &mut ProgressFn<'_>,
    ) -> Result<Alignment, EncodeError> {
        let mut found = shape.clone();
        found.make_as_high_as_rooms(&looker.sample, settings);
        // Heights are measured from a floor.
        if !found.floors.has_plane() {
            return Ok(shape);
        }
        let mut measured = None;
        for round in 1..=ROUNDS {
            let features = looker.look(&found, progress)?;
            let things = things(&self.texts, &features, &found, &looker.sample)?;
            let Some(by) = self.yardsticks.compare(&things) else { return Ok(shape) };
            let is_settled = by.factor.ln().abs() <= SETTLED;
            if !is_settled && round < ROUNDS {
                found.scale_by(scene, settings, 1.0 / by.factor);
            }
            measured = Some(by);
            if is_settled {
                break;
            }
        }
        let Some(by) = measured else { return Ok(shape) };
        if by.agree.len() < FEWEST_THAT_AGREE || by.spread > MOST_SPREAD {
            return Ok(shape);
        }
        let metres = found.scale / by.factor;
        let spread = by.spread.hypot(OWN_SPREAD);
        let evidence = |what: &str| {
            let shown: Vec<&str> = by.agree.iter().take(SHOWN).map(String::as_str).collect();
            format!(
                "{what}; {} of {} kinds of things agree, of them {}",
                by.agree.len(),
                by.count,
                shown.join(", ")
            )
        };
        // Meters are likelier than any other unit.
        let is_metre = metres.ln().abs() <= METRE.max(2.0 * spread);
        if is_metre {
            let mut alignment = found;
            let back = 1.0 / alignment.scale;
            alignment.scale_by(scene, settings, back);
            alignment.scale = 1.0;
            alignment.unit = None;
            alignment.remarks.retain(|remark| !remark.is_of_unit());
            alignment.sized = Some(UnitBySize {
                confidence: within(metres.ln(), spread, TENTH),
                evidence: evidence("things are as large as in rooms in meters"),
            });
            return Ok(alignment);
        }
        let confidence = within(0.0, spread, TENTH);
        found.unit = None;
        found.remarks.retain(|remark| !remark.is_of_unit());
        found.remarks.insert(0, Remark::ScaledBySize { by: found.scale, confidence });
        let what = format!("with {:.4} m per unit things are as large as in rooms", found.scale);
        found.sized = Some(UnitBySize { confidence, evidence: evidence(&what) });
        Ok(found)
    }
}

impl Alignment {
    /// Reads a copy as high as rooms usually are, if the scene is by far not.
    fn make_as_high_as_rooms(&mut self, sample: &GaussianScene, settings: &AlignmentSettings) {
        if let Some(height) = self.height_of_no_room(sample) {
            self.scale_by(sample, settings, USUAL_HEIGHT / height);
        }
    }

    /// Says so where nothing was found that says how large the scene is.
    fn warn_of_open_size(&mut self, sample: &GaussianScene) {
        let is_open = self.sized.is_none() && !self.remarks.iter().any(Remark::is_of_unit);
        if let Some(height) = self.height_of_no_room(sample).filter(|_| is_open) {
            self.remarks.insert(0, Remark::SizeUnclear { height: height / self.scale });
        }
    }

    /// Height of the scene as it is read, meters, if no room is so high.
    fn height_of_no_room(&self, sample: &GaussianScene) -> Option<f64> {
        let height = robust_bounds(&self.apply(sample).coord).extent()[2];
        (height > 0.0 && !(HEIGHTS[0]..=HEIGHTS[1]).contains(&height)).then_some(height)
    }
}

/// The direction in which the labels make by far the most sense, if one does.
fn by_sense(looks: &mut [Look]) -> Option<(Look, String)> {
    looks.sort_by(|a, b| b.sense.total_cmp(&a.sense));
    let best = *looks.first()?;
    let leads = looks.get(1).is_none_or(|next| best.sense >= SENSE_LEAD * next.sense);
    let each: Vec<String> =
        looks.iter().map(|look| format!("{}: {:.2}", look.direction, look.sense)).collect();
    let why = format!(
        "where it sees a floor lying lowest, and many kinds of things: {}",
        each.join(", ")
    );
    (best.sense >= LEAST_SENSE && leads).then_some((best, why))
}

/// How much sense labels (−1 = none) at heights make; `floor`: its class. The share of the scene that is floor and lies lowest,
/// times the square of the F1 of the two, times the number of classes that would be as evenly spread: lying on a wall, a room
/// has no floor and few classes.
fn sense(labels: &[i32], heights: &[f32], floor: Option<usize>) -> f64 {
    let mut finite: Vec<f32> = heights.iter().copied().filter(|h| h.is_finite()).collect();
    if finite.is_empty() {
        return 0.0;
    }
    finite.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| f64::from(finite[((finite.len() - 1) as f64 * share) as usize]);
    let (low, high) = (at(0.01), at(0.99));
    let limit = low + LOWEST * (high - low);
    let mut counts = std::collections::BTreeMap::<i32, usize>::new();
    let (mut both, mut lowest) = (0, 0);
    for (&label, &height) in labels.iter().zip(heights) {
        let is_lowest = f64::from(height) <= limit;
        lowest += usize::from(is_lowest);
        if let Ok(class) = usize::try_from(label) {
            *counts.entry(label).or_default() += 1;
            both += usize::from(is_lowest && floor == Some(class));
        }
    }
    let called = floor.and_then(|class| counts.get(&(class as i32))).copied().unwrap_or(0);
    let f1 = 2.0 * both as f64 / (called + lowest).max(1) as f64;
    let labelled: usize = counts.values().sum();
    let entropy: f64 = counts
        .values()
        .map(|&count| {
            let share = count as f64 / labelled as f64;
            -share * share.ln()
        })
        .sum();
    f1 * f1 * both as f64 / labels.len() as f64 * entropy.exp()
}

/// The probability that a normal deviate of this mean and spread is less than `limit` from 0.
fn within(mean: f64, spread: f64, limit: f64) -> f64 {
    // A logistic curve is within 0.01 of the normal one.
    let below =
        |at: f64| 1.0 / (1.0 + (-1.702 * (at - mean) / spread.max(f64::MIN_POSITIVE)).exp());
    (below(limit) - below(-limit)).clamp(0.0, 1.0)
}

/// The rows of a scene that are looked at.
///
/// # Errors
/// If the scene has fields of different lengths.
pub fn sample(scene: &GaussianScene) -> Result<GaussianScene, EncodeError> {
    let step = scene.len().div_ceil(ROWS).max(1);
    let rows: Vec<usize> = (0..scene.len()).step_by(step).collect();
    Ok(scene.select_rows(&rows).map_err(scenesplat_datasets::DataError::from)?)
}

/// How high the things are that the features of a scene say are in it, as the network reads it.
///
/// # Errors
/// If features went to a file and cannot be read.
pub fn things(
    texts: &TextTable,
    features: &SceneFeatures,
    alignment: &Alignment,
    scene: &GaussianScene,
) -> Result<Measured, EncodeError> {
    let copy = alignment.apply(scene);
    let heights: Vec<f32> = copy.coord.iter().map(|p| alignment.floors.height(p[2])).collect();
    Ok(yardsticks::measured(&texts.names, &nearest_text(features, texts)?, &heights))
}

/// Looks at some rows of a scene.
struct Looker<'a> {
    encoder: SceneEncoder<'a>,
    sample: GaussianScene,
}

impl<'a> Looker<'a> {
    fn new(encoder: &SceneEncoder<'a>, scene: &GaussianScene) -> Result<Self, EncodeError> {
        let sample = sample(scene)?;
        let encoder =
            SceneEncoder { fidelity: Fidelity::Fast, tta: 1, codes: None, ..encoder.clone() };
        Ok(Self { encoder, sample })
    }

    fn look(
        &self,
        alignment: &Alignment,
        progress: &mut ProgressFn<'_>,
    ) -> Result<SceneFeatures, EncodeError> {
        self.encoder.encode_aligned(&self.sample, alignment.clone(), progress)
    }
}

#[cfg(test)]
mod tests {
    use super::{AlignmentSettings, Look, Remark, by_sense, sense, within};
    use crate::alignment::Alignment;
    use scenesplat_scene::GaussianScene;

    #[test]
    fn a_scene_of_no_known_size_is_not_taken_for_meters_in_silence() {
        // Points of a box; nothing in it says how large it is.
        for (height, is_said) in [(0.3_f32, true), (2.5, false), (40.0, true)] {
            let at = |i: u32, prime: u32| (i * prime % 1009) as f32 / 1008.0 * height;
            let coord = (0..2000).map(|i| [at(i, 7), at(i, 31), at(i, 113)]).collect();
            let scene = GaussianScene {
                log_scale: vec![[-5.0; 3]; 2000],
                quat: vec![[1.0, 0.0, 0.0, 0.0]; 2000],
                opacity_logit: vec![1.0; 2000],
                sh_dc: vec![[0.0; 3]; 2000],
                coord,
                ..GaussianScene::default()
            };
            let mut alignment = Alignment::of(&scene, &AlignmentSettings::default());
            alignment.remarks.retain(|remark| !remark.is_of_unit());
            alignment.warn_of_open_size(&scene);
            let said = alignment.remarks.iter().find_map(|remark| match remark {
                Remark::SizeUnclear { height } => Some(*height),
                _ => None,
            });
            assert_eq!(said.is_some(), is_said, "{height}: {said:?}");
            let off = said.map_or(0.0, |said| (said / f64::from(height) - 1.0).abs());
            assert!(off < 0.1, "{height}: {said:?}");
        }
    }

    #[test]
    fn sense_is_a_floor_that_lies_lowest_among_many_classes() {
        // Classes 0 to 4, a tenth of the rows each: the lowest tenth is called floor (0); the rest is class 4.
        let heights: Vec<f32> = (0..1000).map(|row| row as f32 / 1000.0).collect();
        let labels: Vec<i32> = (0..1000).map(|row| (row / 100).min(4)).collect();
        // 60 rows lie lowest (0.01 + 0.05 · 0.98 of 1), all of them among the 100 that are called floor.
        let entropy = -(4.0 * 0.1 * 0.1f64.ln() + 0.6 * 0.6f64.ln());
        let due = 0.75 * 0.75 * 0.06 * entropy.exp();
        let found = sense(&labels, &heights, Some(0));
        assert!((found / due - 1.0).abs() < 0.06, "{found}, due {due}");
        // On its head the floor lies highest; without the class there is none.
        let upside_down: Vec<f32> = heights.iter().map(|h| -h).collect();
        assert_eq!(sense(&labels, &upside_down, Some(0)), 0.0);
        assert_eq!(sense(&labels, &heights, None), 0.0);
        for (labels, heights) in
            [(vec![], vec![]), (vec![-1], vec![1.0]), (vec![0, 0], vec![f32::NAN; 2])]
        {
            assert_eq!(sense(&labels, &heights, Some(0)), 0.0, "{labels:?}");
        }
    }

    #[test]
    fn the_direction_of_most_sense_must_lead() {
        let look = |sense| Look {
            direction: scenesplat_scene::Up::PLUS_Z,
            strangeness: 20.0,
            score: 0.0,
            sense,
        };
        for (best, next, is_decided) in [(0.9, 0.3, true), (0.9, 0.5, false), (0.34, 0.0, false)] {
            let found = by_sense(&mut [look(next), look(best)]);
            assert_eq!(found.is_some(), is_decided, "{best} {next}");
            assert!(found.is_none_or(|(look, _)| look.sense == best));
        }
        assert!(by_sense(&mut [look(0.5)]).is_some() && by_sense(&mut []).is_none());
    }

    #[test]
    fn confidence_is_the_share_of_a_normal_curve() {
        for (mean, spread, limit, due) in [
            (0.0, 0.1, 0.1, 0.683),
            (0.0, 0.05, 0.1, 0.954),
            (0.1, 0.05, 0.1, 0.5),
            (0.3, 0.05, 0.1, 0.0),
        ] {
            let found = within(mean, spread, limit);
            assert!((found - due).abs() < 0.025, "{mean} {spread}: {found}");
        }
        assert_eq!(within(0.0, 0.0, 0.1), 1.0);
    }
}
