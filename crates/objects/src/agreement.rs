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
