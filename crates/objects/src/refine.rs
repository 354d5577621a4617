//! Labels and objects that refine each other: an object is what most speaks for in its Gaussians, and Gaussians are
//! what their object is.
//!
//! The idea is that of EPS3D (panoptic segmentation whose semantic and instance labels correct each other). Nothing is
//! learned here, and the labels need no instances: objects are those that [`find_objects`] makes of the labels
//! themselves, and labels found wrong make other objects in the next round.

use crate::catalogue::{Object, find_objects};
use crate::error::{Result, check_setting};
use crate::input::ObjectInput;
use crate::settings::ObjectSettings;
use crate::surfaces::ClassShares;
use rayon::prelude::*;
use scenesplat_kernels::neighbors::{KdTree, Neighbor};
use std::collections::BTreeSet;

/// How often objects are made of the labels.
const ROUNDS: usize = 2;
/// Gaussians around one that say which objects it touches.
const BESIDE: usize = 8;
/// Farther ones do not touch it, meters.
const REACH: f64 = 0.25;
/// No object.
const NONE: i32 = -1;

/// When an object is what it touches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefineSettings {
    /// Least share of a class that an object, or a Gaussian in none, could be, as part of its largest share. Above 0, at most
    /// 1.
    pub keep: f64,
    /// Most Gaussians of an object that becomes what it touches, as part of those of the larger one. Above 0, at most 1.
    pub part: f64,
}

impl Default for RefineSettings {
    fn default() -> Self {
        Self { keep: 0.7, part: 0.5 }
    }
}

impl RefineSettings {
    fn check(&self) -> Result<()> {
        for (name, value) in [("keep", self.keep), ("part", self.part)] {
            let fits = value > 0.0 && value <= 1.0;
            check_setting(fits, name, value, "a number above 0, at most 1")?;
        }
        Ok(())
    }
}

/// Labels that agree with objects.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Refined {
    /// Class of each Gaussian, −1 = none, as before. `[N]`
    pub labels: Vec<i32>,
    /// Objects of another class, over all rounds.
    pub renamed: usize,
    /// Gaussians with another label than at first.
    pub changed: usize,
}

/// Refines labels by the objects that they make, and these by what speaks for the classes in their Gaussians.
///
/// In each of two rounds:
/// 1. Objects are looked for in the labels ([`find_objects`]).
/// 2. A class that an object could be has a mean share over its Gaussians of at least [`RefineSettings::keep`] of its
///    largest. It gets the class of a much larger object that it touches, if it could be of that: of several the one with
///    the largest share, then the largest, then the first. Else it keeps its own if it could be of that, or gets the class with
///    the largest share, the first of equal ones.
/// 3. Gaussians take the class of their object; a labeled one in none, that of the object that most of its eight nearest
///    are in, if it could be of that.
///
/// Gaussians without a label (negative) get none. Instances in `input` are not read: what a scene knows of its objects
/// must not change its labels. The same for any number of threads.
///
/// # Errors
/// As [`find_objects`]; also if shares and labels are of different Gaussians or classes, or a setting is out of range.
pub fn refine(
    input: &ObjectInput<'_>,
    shares: &ClassShares<'_>,
    objects: &ObjectSettings,
    settings: &RefineSettings,
) -> Result<Refined> {
    settings.check()?;
    input.check()?;
    shares.check(input.labels)?;
    let has_names = shares.num_classes == input.names.len();
    check_setting(has_names, "num_classes", shares.num_classes, "as many classes as names")?;
    let coord = input.upright();
    let mut out = Refined { labels: input.labels.to_vec(), ..Refined::default() };
    for _ in 0..ROUNDS {
        let with = ObjectInput { labels: &out.labels, scores: None, instances: None, ..*input };
        let found = find_objects(&with, objects)?;
        let object_of = found.instances();
        let beside = Beside::new(&coord, &out.labels, &object_of)?;
        let touching = beside.touching(&object_of, found.objects.len());
        let classes: Vec<usize> = (found.objects.par_iter().zip(&touching))
            .map(|(object, touching)| {
                let touching = touching.iter().map(|&other| &found.objects[other]);
                class_of(object, &means(object, shares), touching, settings)
            })
            .collect();
        let renamed = found.objects.iter().zip(&classes).filter(|(o, class)| o.label != **class);
        let renamed = renamed.count();
        out.renamed += renamed;
        for (object, &class) in found.objects.iter().zip(&classes) {
            object.rows.iter().for_each(|&row| out.labels[row as usize] = class as i32);
        }
        let taken = beside.take_in(&mut out.labels, &object_of, &classes, shares, settings.keep);
        if renamed + taken == 0 {
            break;
        }
    }
    out.changed = out.labels.iter().zip(input.labels).filter(|(a, b)| a != b).count();
    Ok(out)
}

/// Mean share of each class over the Gaussians of an object. `[classes]`
fn means(object: &Object, shares: &ClassShares<'_>) -> Vec<f64> {
    let mut sum = vec![0.0; shares.num_classes];
    for &row in &object.rows {
        sum.iter_mut().zip(shares.of(row)).for_each(|(sum, p)| *sum += f64::from(*p));
    }
    sum.iter_mut().for_each(|sum| *sum /= object.rows.len().max(1) as f64);
    sum
}

/// The class of an object by its mean shares and by what it touches.
fn class_of<'a>(
    object: &Object,
    mean: &[f64],
    touching: impl Iterator<Item = &'a Object>,
    settings: &RefineSettings,
) -> usize {
    let could_be = |class: usize| could_be(mean.iter().copied(), class, settings.keep);
    let is_much_larger = |other: &Object| object.count as f64 <= settings.part * other.count as f64;
    let larger = touching.filter(|other| is_much_larger(other) && could_be(other.label));
    // Objects come by class and place: of equal ones the first.
    let best = larger.reduce(|best, next| {
        let (a, b) = (mean[best.label], mean[next.label]);
        if b.total_cmp(&a).then(next.count.cmp(&best.count)).is_gt() { next } else { best }
    });
    let most = || (0..mean.len()).fold(0, |most, c| if mean[c] > mean[most] { c } else { most });
    match best {
        Some(other) => other.label,
        // What nothing speaks for stays what it is.
        None if could_be(object.label) || mean.iter().all(|share| *share <= 0.0) => object.label,
        None => most(),
    }
}

/// Whether enough speaks for a class.
fn could_be(shares: impl Iterator<Item = f64> + Clone, class: usize, keep: f64) -> bool {
    let own = shares.clone().nth(class).unwrap_or(0.0);
    own > 0.0 && own >= keep * shares.fold(0.0, f64::max)
}

/// The objects around labeled Gaussians.
struct Beside {
    /// Labeled Gaussians with a place, rising.
    rows: Vec<u32>,
    /// The objects that its nearest Gaussians are in, nearest first; the rest is [`NONE`].
    near: Vec<[i32; BESIDE]>,
}

impl Beside {
    fn new(coord: &[[f32; 3]], labels: &[i32], object_of: &[i32]) -> Result<Self> {
        let in_objects = (0..object_of.len()).filter(|&row| object_of[row] != NONE);
        let tree = KdTree::of_rows(coord, in_objects)?;
        let has_place = |row: &u32| coord[*row as usize].iter().all(|v| v.is_finite());
        let rows: Vec<u32> = (0..labels.len() as u32)
            .filter(|row| labels[*row as usize] >= 0)
            .filter(has_place)
            .collect();
        let places: Vec<[f32; 3]> = rows.iter().map(|&row| coord[row as usize]).collect();
        let reach = REACH * REACH;
        // One more than are wanted: the nearest is the Gaussian itself, if it is in an object.
        let near = tree.map_nearest(
            &places,
            BESIDE + 1,
            || (),
            |(), at, found| {
                let others = |n: &&Neighbor| n.row != rows[at] && n.distance_squared <= reach;
                let mut near = [NONE; BESIDE];
                for (near, other) in near.iter_mut().zip(found.iter().filter(others)) {
                    *near = object_of[other.row as usize];
                }
                Some(near)
            },
        );
        Ok(Self { rows, near: near.into_iter().flatten().collect() })
    }

    /// The objects that each object touches, rising.
    fn touching(&self, object_of: &[i32], objects: usize) -> Vec<BTreeSet<usize>> {
        let mut out = vec![BTreeSet::new(); objects];
        for (&row, near) in self.rows.iter().zip(&self.near) {
            let Ok(own) = usize::try_from(object_of[row as usize]) else { continue };
            let others = near.iter().filter_map(|&other| usize::try_from(other).ok());
            out[own].extend(others.filter(|&other| other != own));
        }
        out
    }

    /// Gives Gaussians in no object the class of the one around them, where that speaks for them; how many took it.
    fn take_in(
        &self,
        labels: &mut [i32],
        object_of: &[i32],
        classes: &[usize],
        shares: &ClassShares<'_>,
        keep: f64,
    ) -> usize {
        let mut taken = 0;
        for (&row, near) in self.rows.iter().zip(&self.near) {
            let at = row as usize;
            let (NONE, Some(object)) = (object_of[at], most(near)) else { continue };
            let (own, class) = (labels[at] as usize, classes[object]);
            let share = shares.of(row).iter().map(|share| f64::from(*share));
            if own != class && could_be(share, class, keep) {
                labels[at] = class as i32;
                taken += 1;
            }
        }
        taken
    }
}

/// The object that most are in, the first of equal ones; `None` if none is in any.
fn most(near: &[i32; BESIDE]) -> Option<usize> {
    let mut sorted = *near;
    sorted.sort_unstable();
    let runs = sorted.chunk_by(|a, b| a == b).filter(|run| run[0] != NONE);
    let longest = runs.reduce(|most, run| if run.len() > most.len() { run } else { most });
    longest.and_then(|run| usize::try_from(run[0]).ok())
}

#[cfg(test)]
mod tests;
