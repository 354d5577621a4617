//! How well objects agree with true instances.

use crate::catalogue::Catalogue;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// A true object that was found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Match {
    /// Place of the object in the catalogue.
    pub found: usize,
    /// Its true instance.
    pub truth: i32,
    /// Gaussians of both, over those of any.
    pub iou: f64,
}

/// Matches and what has none.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Agreement {
    /// Pairs of one class with an IoU above 0.5; one each, by that.
    pub matches: Vec<Match>,
    /// Objects of the catalogue.
    pub found: usize,
    /// True objects of enough Gaussians.
    pub truth: usize,
    /// Instances that nothing was matched with.
    pub missed: Vec<i32>,
    /// Places in the catalogue of objects that match nothing.
    pub wrong: Vec<usize>,
}

impl Agreement {
    /// Compares objects with true instances; those of fewer than `min_count` Gaussians count
    /// nowhere.
    ///
    /// `instances`, `labels`: truth of each Gaussian, −1 = none. `[N]`; shorter ones end early.
    pub fn of(found: &Catalogue, instances: &[i32], labels: &[i32], min_count: usize) -> Self {
        let instances = &instances[..instances.len().min(labels.len())];
        let mut sizes: BTreeMap<i32, (usize, i32)> = BTreeMap::new();
        for (&id, &label) in instances.iter().zip(labels).filter(|(id, _)| **id >= 0) {
            sizes.entry(id).or_insert((0, label)).0 += 1;
        }
        let mut out = Self { found: found.objects.len(), ..Self::default() };
        let mut matched = BTreeSet::new();
        for (place, object) in found.objects.iter().enumerate() {
            let mut common: BTreeMap<i32, usize> = BTreeMap::new();
            for &row in &object.rows {
                if let Some(&id) = instances.get(row as usize).filter(|id| **id >= 0) {
                    *common.entry(id).or_default() += 1;
                }
            }
            // At least half of both: nothing else can be as near.
            let best = common.iter().max_by_key(|(id, n)| (**n, -**id));
            let iou =
                best.map_or(0.0, |(id, &n)| n as f64 / (object.count + sizes[id].0 - n) as f64);
            match best {
                Some((&truth, _)) if iou > 0.5 && sizes[&truth].1 == object.label as i32 => {
                    out.matches.push(Match { found: place, truth, iou });
                    matched.insert(truth);
                }
                _ => out.wrong.push(place),
            }
        }
        // What is too small to ask for may be found all the same.
        let is_missed =
            |(id, (n, _)): &(&i32, &(usize, i32))| *n >= min_count && !matched.contains(id);
        out.missed = sizes.iter().filter(is_missed).map(|(id, _)| *id).collect();
        out.truth = matched.len() + out.missed.len();
        out
    }

    /// Part of the objects that are true ones, 0..=1; 1 without any.
    pub fn precision(&self) -> f64 {
        share(self.matches.len(), self.found)
    }

    /// Part of the true objects that were found, 0..=1; 1 without any.
    pub fn recall(&self) -> f64 {
        share(self.matches.len(), self.truth)
    }
}

fn share(part: usize, of: usize) -> f64 {
    if of == 0 { 1.0 } else { part as f64 / of as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made::{catalogue, object};

    #[test]
    fn a_match_needs_the_class_and_more_than_half_of_both() {
        // Three true things of ten Gaussians: two chairs (1) and a table (2).
        let instances: Vec<i32> = (0..30).map(|row| row / 10).collect();
        let labels: Vec<i32> = (0..30).map(|row| if row < 20 { 1 } else { 2 }).collect();
        let found = catalogue(
            // Eight of the first; one that covers the second and what lies around it; the third as a chair.
            vec![object(1, 0..8), object(1, 5..25), object(1, 20..30)],
            30,
        );
        let agreement = Agreement::of(&found, &instances, &labels, 1);
        assert_eq!(agreement.matches, [Match { found: 0, truth: 0, iou: 0.8 }]);
        assert_eq!((&agreement.wrong[..], &agreement.missed[..]), (&[1, 2][..], &[1, 2][..]));
        assert_eq!((agreement.precision(), agreement.recall()), (1.0 / 3.0, 1.0 / 3.0));
        // What is too small to ask for is not missed.
        assert_eq!(Agreement::of(&found, &instances, &labels, 11).recall(), 1.0);
    }

    #[test]
    fn an_instance_of_just_enough_gaussians_is_missed() {
        let nothing = catalogue(Vec::new(), 30);
        // Instances 0, 1 and 2 of 9, 10 and 11 Gaussians; those of 10 or more are asked for.
        let instances: Vec<i32> =
            (0..30).map(|row| i32::from(row >= 9) + i32::from(row >= 19)).collect();
        let agreement = Agreement::of(&nothing, &instances, &[0; 30], 10);
        assert_eq!((&agreement.missed[..], agreement.truth), (&[1, 2][..], 2));
    }

    #[test]
    fn counts_are_of_what_has_an_instance_and_small_ones_may_be_found() {
        // Instance 4 of six rows, class 2, whose rows 6 and 7 have none; 7 of three rows, class 0; 9 of four, class 1.
        let instances = [4, 4, 4, 4, 4, 4, -1, -1, 7, 7, 7, 9, 9, 9, 9, 5];
        let labels = [2, 2, 2, 2, 0, 0, 2, 2, 0, 0, 0, 1, 1, 1, 1];
        let found = catalogue(
            // Five of six and two of nothing: 5 / 8. All of a small one. Two of four: 2 / 4 is not above a half.
            vec![object(2, 1..8), object(0, 8..11), object(1, 13..15), object(1, 15..18)],
            18,
        );
        let agreed = Agreement::of(&found, &instances, &labels, 4);
        let matches =
            [Match { found: 0, truth: 4, iou: 0.625 }, Match { found: 1, truth: 7, iou: 1.0 }];
        assert_eq!(agreed.matches, matches);
        assert_eq!(
            (agreed.found, agreed.truth, &agreed.missed[..], &agreed.wrong[..]),
            (4, 3, &[9][..], &[2, 3][..])
        );
        assert_eq!((agreed.precision(), agreed.recall()), (0.5, 2.0 / 3.0));
        assert_eq!((Agreement::default().precision(), Agreement::default().recall()), (1.0, 1.0));
    }
}
