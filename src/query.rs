//! A text in, the Gaussians that it means out.

use crate::inference::SceneFeatures;
use crate::labels::{ComparableTexts, LabelError, distinct_rows};
use scenesplat_metrics::{ZeroShotOptions, classify, vote};
use scenesplat_scene::label_set::find_name;

pub use scenesplat_text::Query;

/// When a Gaussian is selected.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct QuerySettings {
    /// Rivals that do not count, by name.
    pub without: Vec<String>,
    /// Least cosine.
    pub min_score: Option<f32>,
    /// Least lead over the best rival.
    pub min_margin: Option<f32>,
    /// Neighbors that vote on the selection; below 2 none do.
    pub vote_k: usize,
}

/// Color of the selected Gaussians in pictures.
pub const SELECTED_COLOR: [u8; 3] = [255, 140, 40];
/// Color that stands for all others in legends.
pub const OTHERS_COLOR: [u8; 3] = [110, 110, 118];

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Selection {
    /// Cosine with the best of what is meant. `[N]`
    pub scores: Vec<f32>,
    /// 1 where selected, else 0. `[N]`
    pub selected: Vec<i32>,
}

/// Where the selected Gaussians are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// How many they are.
    pub count: usize,
    /// Mean of their positions, meters.
    pub center: [f64; 3],
    /// Lowest corner of their box, meters.
    pub low: [f32; 3],
    /// Highest corner of their box, meters.
    pub high: [f32; 3],
}

/// Selects the Gaussians that a query means: those whose best meant text beats every rival and
/// reaches the thresholds, after a vote of neighbors.
///
/// `coord`: positions of the same Gaussians, meters. `[N, 3]`
///
/// # Errors
/// If texts and features differ in width, nothing speaks against any Gaussian (no rival and no least
/// score), or features cannot be read.
pub fn select(
    features: &SceneFeatures,
    query: &Query,
    settings: &QuerySettings,
    coord: &[[f32; 3]],
) -> Result<Selection, LabelError> {
    let rows = distinct_rows(features)?;
    let meant = ComparableTexts::new(features, &query.meant)?;
    let own = classify(&rows, meant.rows()?, &ZeroShotOptions::default())?;
    let counts = |name: &String| find_name(&settings.without, name).is_err();
    let candidates: Vec<bool> = query.rivals.names.iter().map(counts).collect();
    let rivals = if candidates.contains(&true) {
        let options =
            ZeroShotOptions { candidates: Some(candidates), ..ZeroShotOptions::default() };
        let rivals = ComparableTexts::new(features, &query.rivals)?;
        Some(classify(&rows, rivals.rows()?, &options)?.scores)
    } else {
        None
    };
    let wins = |slot: usize| {
        let score = own.scores[slot];
        // A row without a direction has no class, not even the only one.
        own.labels[slot] >= 0
            && rivals.as_ref().is_none_or(|r| {
                score > r[slot] && score - r[slot] >= settings.min_margin.unwrap_or(0.0)
            })
            && settings.min_score.is_none_or(|m| score >= m)
    };
    let distinct: Vec<i32> = (0..features.num_slots()).map(|slot| i32::from(wins(slot))).collect();
    let scores = features.inverse().iter().map(|s| own.scores[*s as usize]).collect();
    let mut selected: Vec<i32> = features.inverse().iter().map(|s| distinct[*s as usize]).collect();
    if settings.vote_k > 1 {
        selected = vote(coord, &selected, features.voters(), coord, settings.vote_k, 2)?;
    }
    Ok(Selection { scores, selected })
}

impl Selection {
    /// Whether nothing is selected.
    pub fn is_empty(&self) -> bool {
        self.selected.iter().all(|selected| *selected == 0)
    }

    /// Takes some Gaussians out of the selection, whose scores stay; gives the number that were in it. `rows`: which;
    /// those beyond its end stay.
    pub fn withhold(&mut self, rows: &[bool]) -> usize {
        let mut taken = 0;
        for (selected, _) in self.selected.iter_mut().zip(rows).filter(|(_, is)| **is) {
            taken += usize::from(*selected == 1);
            *selected = 0;
        }
        taken
    }

    /// Colors of a picture of it: selected Gaussians orange, the others gray, brighter with their
    /// score. `[N]`
    pub fn colors(&self) -> Vec<[u8; 3]> {
        let mut sorted: Vec<f32> = self.scores.iter().copied().filter(|s| s.is_finite()).collect();
        sorted.sort_by(f32::total_cmp);
        let at = |q: f32| sorted.get(((sorted.len().max(1) - 1) as f32 * q) as usize).copied();
        let (low, high) = (at(0.02).unwrap_or(0.0), at(0.98).unwrap_or(0.0));
        let color = |(&score, &selected): (&f32, &i32)| {
            let t = if high > low { ((score - low) / (high - low)).clamp(0.0, 1.0) } else { 0.0 };
            match selected {
                1 => SELECTED_COLOR,
                _ => {
                    let v = (60.0 + 100.0 * t) as u8;
                    [v, v, v.saturating_add(8)]
                }
            }
        };
        self.scores.iter().zip(&self.selected).map(color).collect()
    }

    /// The best finite score; `None` if no Gaussian has one.
    pub fn best_score(&self) -> Option<f32> {
        self.scores.iter().copied().filter(|s| s.is_finite()).max_by(f32::total_cmp)
    }

    /// Where the selected Gaussians are; `None` if none is. `coord`: meters. `[N, 3]`
    pub fn place(&self, coord: &[[f32; 3]]) -> Option<Place> {
        let rows = || self.selected.iter().zip(coord).filter(|(s, _)| **s == 1).map(|(_, c)| c);
        let count = rows().count();
        let mut place = Place {
            count,
            center: [0.0; 3],
            low: [f32::INFINITY; 3],
            high: [f32::NEG_INFINITY; 3],
        };
        for c in rows() {
            for axis in 0..3 {
                place.low[axis] = place.low[axis].min(c[axis]);
                place.high[axis] = place.high[axis].max(c[axis]);
                place.center[axis] += f64::from(c[axis]) / count as f64;
            }
        }
        (count > 0).then_some(place)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_rooms::{ClassId, ColorName, Vocabulary};

    /// One Gaussian of each given object, as a perfect network would see it.
    fn scene(objects: &[(ClassId, ColorName)]) -> (SceneFeatures, Vec<[f32; 3]>, Vocabulary) {
        let words = Vocabulary::new(96).unwrap();
        let rows = objects.iter().flat_map(|&(c, color)| words.object_target(c, color)).collect();
        let coord = (0..objects.len()).map(|i| [i as f32, 0.0, 0.0]).collect();
        (SceneFeatures::from_rows(rows, 96).unwrap(), coord, words)
    }

    #[test]
    fn a_group_is_meant_by_its_members() {
        let seats = [ClassId::Chair, ClassId::Sofa];
        let objects: Vec<_> = ClassId::ALL.iter().map(|&c| (c, ColorName::Brown)).collect();
        let (features, coord, words) = scene(&objects);
        let query = Query::of_vocabulary(&words, "seat").unwrap();
        let found = select(&features, &query, &QuerySettings::default(), &coord).unwrap();
        for (&class, &selected) in ClassId::ALL.iter().zip(&found.selected) {
            let is_seat = query.meant.names.iter().any(|n| n == class.about().name);
            assert_eq!(selected == 1, is_seat, "{}", class.about().name);
        }
        assert!(seats.iter().all(|s| query.meant.names.iter().any(|n| n == s.about().name)));
    }

    #[test]
    fn a_class_in_a_color_is_not_one_in_another() {
        let objects = [
            (ClassId::Chair, ColorName::Red),
            (ClassId::Chair, ColorName::Blue),
            (ClassId::Table, ColorName::Red),
        ];
        let (features, coord, words) = scene(&objects);
        let query = Query::of_vocabulary(&words, "red chair").unwrap();
        let found = select(&features, &query, &QuerySettings::default(), &coord).unwrap();
        assert_eq!(found.selected, [1, 0, 0]);
        let place = found.place(&coord).unwrap();
        assert_eq!((place.count, place.center, place.high), (1, [0.0; 3], [0.0; 3]));
    }

    #[test]
    fn what_is_selected_stands_out() {
        let found = Selection { scores: vec![0.0, 1.0, 0.5], selected: vec![0, 0, 1] };
        assert_eq!(found.colors(), [[60, 60, 68], [160, 160, 168], SELECTED_COLOR]);
        let flat = Selection { scores: vec![f32::NAN; 2], selected: vec![0, 1] };
        assert_eq!(flat.colors(), [[60, 60, 68], SELECTED_COLOR]);
    }

    #[test]
    fn rows_without_direction_and_texts_of_another_width_are_not_found() {
        let words = Vocabulary::new(96).unwrap();
        let query = Query::of_vocabulary(&words, "chair").unwrap();
        let none = SceneFeatures::from_rows(vec![0.0; 96], 96).unwrap();
        let settings = QuerySettings::default();
        let found = select(&none, &query, &settings, &[[0.0; 3]]).unwrap();
        assert_eq!(found.place(&[[0.0; 3]]), None);
        assert_eq!(found.selected, [0]);
        let narrow = SceneFeatures::from_rows(vec![1.0; 8], 8).unwrap();
        let error = select(&narrow, &query, &settings, &[[0.0; 3]]).unwrap_err();
        assert!(matches!(error, LabelError::Width { texts: 96, features: 8 }), "{error}");
        assert!(SceneFeatures::from_rows(vec![1.0; 8], 3).is_err());
    }
}
