//! How large a scene is by things of known size: tables, doors, chairs that a network finds in it.
//!
//! A room has no size by itself, but a table is three quarters of a meter high wherever it stands. Each class that is
//! about as high in all rooms is a yardstick: how high its Gaussians lie above the floor is compared with what was
//! measured in synthetic rooms. Yardsticks that agree decide; one that is far off, as a wrong label makes it, has
//! little say.

use crate::inference::{EncodeError, SceneFeatures};
use crate::network::NetworkError;
use rayon::prelude::*;
use scenesplat_scene::TextTable;
use scenesplat_scene::quantile::quantile;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

const FILE: &str = "assets/embedded/yardsticks.json";
const EMBEDDED: &str = include_str!("../assets/embedded/yardsticks.json");

/// Fewest Gaussians of a class that say how high it is.
const FEWEST: usize = 40;

/// What lies lower is floor, meters.
const LOWEST: f32 = 0.02;

/// Width of the window whose fullest place counts, in ln.
const WINDOW: f64 = 0.05;

/// No height is believed closer, in ln; and what so few Gaussians as [`FEWEST`] add to that.
const LEAST_SPREAD: f64 = 0.04;
const SPREAD_OF_FEW: f64 = 0.3;

/// A class whose height spreads more is no yardstick, nor is one that is in a smaller share of the scenes.
const MOST_SPREAD: f64 = 0.12;
const LEAST_SHARE: f64 = 0.28;

/// A height that is off by more, in ln, is no error of measurement; the share of them spreads a yardstick.
const FAR_OFF: f64 = 0.35;

/// Factors that are compared, in ln.
const REACH: f64 = 1.5;
const STEP: f64 = 0.005;

/// Which of its heights is the same in all rooms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// The one that 95 of 100 Gaussians lie below.
    Top,
    /// The one at which most Gaussians lie, as on the top of a table.
    Fullest,
    /// The median.
    Middle,
}

const QUANTITIES: [Quantity; 3] = [Quantity::Top, Quantity::Fullest, Quantity::Middle];

/// How high a class is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Yardstick {
    /// What is measured.
    pub of: Quantity,
    /// Meters above the floor.
    pub height: f64,
    /// Standard deviation of its logarithm over rooms.
    pub spread: f64,
}

/// The heights of classes as one network finds them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Yardsticks {
    /// SHA-256 of the weights, hexadecimal.
    pub weights: String,
    /// By the name of the class.
    pub classes: BTreeMap<String, Yardstick>,
}

/// Heights of a class in one scene, meters if the scene is in meters: logarithms, in the order of the quantities.
pub type Heights = [f64; 3];

/// Classes of a scene: their heights, and Gaussians.
pub type Measured = BTreeMap<String, (Heights, usize)>;

/// How large things are in a scene, compared with rooms.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// How many times too large, above 0.
    pub factor: f64,
    /// Standard deviation of its logarithm.
    pub spread: f64,
    /// Classes that agree within two standard deviations, the most telling first.
    pub agree: Vec<String>,
    /// Classes that were measured.
    pub count: usize,
}

/// Heights of the classes of a scene.
///
/// # Shapes
/// - `labels`: rows of `names`, others for none `[N]`
/// - `heights`: meters above the floor `[N]`
pub fn measured(names: &[String], labels: &[i32], heights: &[f32]) -> Measured {
    let mut of = vec![Vec::new(); names.len()];
    for (label, height) in labels.iter().zip(heights).filter(|(_, h)| **h > LOWEST) {
        if let Some(of) = usize::try_from(*label).ok().and_then(|label| of.get_mut(label)) {
            of.push(*height);
        }
    }
    let each = names.iter().zip(&mut of).filter(|(_, h)| h.len() >= FEWEST);
    each.filter_map(|(name, h)| Some((name.clone(), (heights_of(h)?, h.len())))).collect()
}

fn heights_of(heights: &mut [f32]) -> Option<Heights> {
    let [top, middle] = [0.95, 0.5].map(|share| quantile(heights, share));
    let mut logs: Vec<f64> = heights.iter().map(|h| f64::from(*h).ln()).collect();
    logs.sort_by(f64::total_cmp);
    let (mut end, mut best) = (0, (0, 0));
    for start in 0..logs.len() {
        while end < logs.len() && logs[end] <= logs[start] + WINDOW {
            end += 1;
        }
        if end - start > best.1 - best.0 {
            best = (start, end);
        }
    }
    let fullest = (logs[best.0] + logs[best.1 - 1]) / 2.0;
    Some([f64::from(top?).ln(), fullest, f64::from(middle?).ln()])
}

impl Yardsticks {
    /// Those of the network inside the program.
    ///
    /// # Errors
    /// If the program was built with a broken file.
    pub fn embedded() -> Result<Self, NetworkError> {
        serde_json::from_str(EMBEDDED).map_err(NetworkError::config(FILE))
    }

    /// Finds classes that are about as high in all scenes, and how high. Scenes are in meters.
    pub fn fit(scenes: &[Measured], weights: String) -> Self {
        let mut heights: BTreeMap<&String, Vec<Heights>> = BTreeMap::new();
        for (name, (found, _)) in scenes.iter().flatten() {
            heights.entry(name).or_default().push(*found);
        }
        let least = LEAST_SHARE * scenes.len() as f64;
        let of = |found: &[Heights]| {
            let one = |(k, of)| {
                let values: Vec<f64> = found.iter().map(|h| h[k]).collect();
                let (middle, spread) = middle_and_spread(&values);
                Yardstick { of, height: middle.exp(), spread }
            };
            let all = QUANTITIES.into_iter().enumerate().map(one);
            all.min_by(|a, b| a.spread.total_cmp(&b.spread))
        };
        let classes = heights
            .into_iter()
            .filter(|(_, found)| found.len() as f64 >= least)
            .filter_map(|(name, found)| Some((name.clone(), of(&found)?)))
            .filter(|(_, yardstick)| yardstick.spread < MOST_SPREAD)
            .collect();
        Self { weights, classes }
    }

    /// How many times too large the things of a scene are. `None` where fewer than two classes are known.
    pub fn compare(&self, scene: &Measured) -> Option<Measurement> {
        let each: Vec<(&String, f64, f64)> = scene
            .iter()
            .filter_map(|(name, (found, count))| {
                let known = self.classes.get(name)?;
                let off = found[known.of as usize] - known.height.ln();
                let few = SPREAD_OF_FEW * (FEWEST as f64 / *count as f64).sqrt();
                Some((name, off, known.spread.hypot(few)))
            })
            .collect();
        if each.len() < 2 {
            return None;
        }
        // Student's t of two degrees of freedom: what is far off costs little.
        let likelihood = |at: f64| {
            let cost = |(_, off, spread): &(&String, f64, f64)| {
                let z = (off - at) / spread;
                -1.5 * (z * z / 2.0).ln_1p()
            };
            each.iter().map(cost).sum::<f64>()
        };
        let steps = (REACH / STEP).round() as i32;
        let at: Vec<f64> = (-steps..=steps).map(|i| f64::from(i) * STEP).collect();
        let found: Vec<f64> = at.iter().map(|at| likelihood(*at)).collect();
        let best = (0..at.len()).fold(0, |best, i| if found[i] > found[best] { i } else { best });
        let weights: Vec<f64> = found.iter().map(|l| (l - found[best]).exp()).collect();
        let total: f64 = weights.iter().sum();
        let mean = at.iter().zip(&weights).map(|(at, w)| at * w).sum::<f64>() / total;
        let variance = at.iter().zip(&weights).map(|(at, w)| (at - mean).powi(2) * w).sum::<f64>();
        let mut agree: Vec<_> =
            each.iter().filter(|(_, off, s)| (off - at[best]).abs() <= 2.0 * s).collect();
        agree.sort_by(|a, b| a.2.total_cmp(&b.2));
        Some(Measurement {
            factor: peak(&at, &found, best).exp(),
            spread: (variance / total).sqrt(),
            agree: agree.into_iter().map(|(name, _, _)| (*name).clone()).collect(),
            count: each.len(),
        })
    }
}

/// The place of a maximum between the steps, by a parabola.
fn peak(at: &[f64], value: &[f64], best: usize) -> f64 {
    let (Some(before), Some(after)) = (best.checked_sub(1).map(|i| value[i]), value.get(best + 1))
    else {
        return at[best];
    };
    let bend = before - 2.0 * value[best] + after;
    if bend < 0.0 { at[best] + STEP * 0.5 * (before - after) / bend } else { at[best] }
}

/// The median, and the standard deviation as the median deviation tells it.
fn middle_and_spread(values: &[f64]) -> (f64, f64) {
    let median = |mut v: Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v.get(v.len() / 2).copied().unwrap_or(0.0)
    };
    let middle = median(values.to_vec());
    let deviation = median(values.iter().map(|v| (v - middle).abs()).collect());
    let far = values.iter().filter(|v| (*v - middle).abs() > FAR_OFF).count();
    let share = far as f64 / values.len().max(1) as f64;
    (middle, (1.4826 * deviation).max(LEAST_SPREAD).max(0.5 * share))
}

/// The class of each Gaussian whose text is nearest to its features, −1 for features without a direction, or of another
/// width than the texts. `[N]`
///
/// # Errors
/// If features went to a file and cannot be read.
pub fn nearest_text(features: &SceneFeatures, texts: &TextTable) -> Result<Vec<i32>, EncodeError> {
    let width = features.width();
    if width != texts.dim {
        return Ok(vec![-1; features.inverse().len()]);
    }
    let rows = features.slot_rows(0..features.num_slots())?;
    let of_slot: Vec<i32> = rows
        .par_chunks_exact(width)
        .map(|row| {
            if row.iter().all(|v| *v == 0.0) {
                return -1;
            }
            let mut best = (f32::NEG_INFINITY, -1);
            for (label, text) in texts.values.chunks_exact(width).enumerate() {
                let cosine = row.iter().zip(text).map(|(a, b)| a * b).sum::<f32>();
                if cosine > best.0 {
                    best = (cosine, label as i32);
                }
            }
            best.1
        })
        .collect();
    Ok(features.inverse().iter().map(|slot| of_slot[*slot as usize]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names() -> Vec<String> {
        ["table", "door", "chair", "plant"].map(str::to_owned).to_vec()
    }

    /// A scene with a table, a door and a chair, so many times too large.
    fn scene(factor: f32) -> (Vec<i32>, Vec<f32>) {
        let (mut labels, mut heights) = (Vec::new(), Vec::new());
        for i in 0..400u16 {
            let share = f32::from(i) / 400.0;
            // Two thirds of a table are its top; doors and chairs are as dense everywhere.
            let table = if i % 3 == 0 { 0.75 * share } else { 0.75 };
            for (label, height) in [(0, table), (1, 2.0 * share), (2, 0.9 * share)] {
                labels.push(label);
                heights.push(factor * height);
            }
        }
        (labels, heights)
    }

    fn known() -> Yardsticks {
        let scenes: Vec<Measured> = [0.97, 0.99, 1.0, 1.01, 1.03]
            .map(scene)
            .iter()
            .map(|(labels, heights)| measured(&names(), labels, heights))
            .collect();
        Yardsticks::fit(&scenes, "none".to_owned())
    }

    #[test]
    fn heights_are_of_tops_of_the_fullest_place_and_of_the_middle() {
        let (labels, heights) = scene(1.0);
        let found = measured(&names(), &labels, &heights);
        assert_eq!(found.keys().collect::<Vec<_>>(), ["chair", "door", "table"]);
        let ([top, fullest, middle], count) = found["table"];
        assert!((top.exp() - 0.75).abs() < 1e-6 && (middle.exp() - 0.75).abs() < 1e-6);
        assert!((fullest.exp() - 0.75).abs() < 0.02, "{}", fullest.exp());
        assert!((390..=400).contains(&count), "{count}");
        let [top, _, middle] = found["door"].0.map(f64::exp);
        assert!((top - 1.9).abs() < 0.01 && (middle - 1.01).abs() < 0.02, "{top} {middle}");
    }

    #[test]
    fn a_scene_is_compared_whatever_one_wrong_class_says() {
        let known = known();
        assert_eq!(known.classes.len(), 3);
        for factor in [0.4, 0.8, 1.0, 1.3, 3.0f32] {
            let (labels, heights) = scene(factor);
            let found = known.compare(&measured(&names(), &labels, &heights)).unwrap();
            let off = (found.factor / f64::from(factor)).ln();
            assert!(off.abs() < 0.02 && found.spread < 0.08, "{factor}: {found:?}");
            assert_eq!((found.agree.len(), found.count), (3, 3));
            // A plant is called a chair: one class says twice as much.
            let mut wrong = heights.clone();
            wrong.iter_mut().zip(&labels).filter(|(_, l)| **l == 2).for_each(|(h, _)| *h *= 2.0);
            let found = known.compare(&measured(&names(), &labels, &wrong)).unwrap();
            let off = (found.factor / f64::from(factor)).ln();
            assert!(off.abs() < 0.05, "{factor}: {found:?}");
            assert_eq!(found.agree.len(), 2);
        }
    }

    #[test]
    fn where_too_little_is_known_nothing_is_said() {
        let known = known();
        let (labels, heights) = scene(1.0);
        let none = Measured::new();
        assert_eq!(known.compare(&none), None);
        let only: Vec<i32> = labels.iter().map(|l| if *l == 0 { 0 } else { -1 }).collect();
        assert_eq!(known.compare(&measured(&names(), &only, &heights)), None);
        // NaN, what lies on the floor and labels out of range are nothing.
        let bad = measured(&names(), &[0, 0, 9, -7], &[f32::NAN, 0.0, 1.0, 1.0]);
        assert!(bad.is_empty());
        assert!(measured(&[], &labels, &heights).is_empty());
    }

    #[test]
    fn those_of_the_program_are_of_its_network_and_as_in_the_world() {
        let found = Yardsticks::embedded().unwrap();
        let weights = crate::calibration::Calibration::embedded().unwrap().weights;
        assert_eq!(found.weights, weights);
        let near = |name: &str, due: f64| {
            let height = found.classes[name].height;
            assert!((height - due).abs() < 0.1 * due, "{name}: {height}");
        };
        near("table", 0.74);
        near("desk", 0.74);
        near("door", 2.0);
    }
}
