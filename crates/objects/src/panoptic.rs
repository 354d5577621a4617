//! How good objects are, in one number for each class.

use crate::agreement::Agreement;
use crate::catalogue::Catalogue;
use std::collections::BTreeMap;

/// Panoptic quality over scenes: of each class Σ IoU of the matches ÷ (matches + ½ wrong + ½ missed) objects (Kirillov et
/// al., *Panoptic Segmentation*, CVPR 2019). A match has the class and an IoU over Gaussians above 0.5.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PanopticQuality {
    classes: BTreeMap<usize, OfClass>,
}

/// What a class has over all scenes so far.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct OfClass {
    iou: f64,
    matches: usize,
    /// Found objects that match none.
    wrong: usize,
    /// True objects that match none.
    missed: usize,
}

impl PanopticQuality {
    /// Adds a scene: its objects and how they agree with its truth, both as [`Agreement::of`] had them.
    ///
    /// Wrong objects most of whose Gaussians have no true instance count nowhere: what they are is not known. A true
    /// instance whose label is negative is of no class, and is not missed.
    pub fn add(
        &mut self,
        agreed: &Agreement,
        found: &Catalogue,
        instances: &[i32],
        labels: &[i32],
    ) {
        let mut class_of = BTreeMap::new();
        for (&id, &label) in instances.iter().zip(labels).filter(|(id, _)| **id >= 0) {
            class_of.entry(id).or_insert(label);
        }
        let has_truth = |row: &&u32| instances.get(**row as usize).is_some_and(|id| *id >= 0);
        for m in &agreed.matches {
            let class = self.classes.entry(found.objects[m.found].label).or_default();
            class.matches += 1;
            class.iou += m.iou;
        }
        for &place in &agreed.wrong {
            let object = &found.objects[place];
            if 2 * object.rows.iter().filter(has_truth).count() >= object.rows.len() {
                self.classes.entry(object.label).or_default().wrong += 1;
            }
        }
        for id in &agreed.missed {
            if let Some(class) = class_of.get(id).and_then(|label| usize::try_from(*label).ok()) {
                self.classes.entry(class).or_default().missed += 1;
            }
        }
    }

    /// That of a class, 0..=1; `None` if it was neither found nor true anywhere.
    pub fn of_class(&self, class: usize) -> Option<f64> {
        self.classes.get(&class).map(OfClass::quality)
    }

    /// Mean over the classes that were found or true, 0..=1; `None` without any.
    pub fn mean(&self) -> Option<f64> {
        let sum: f64 = self.classes.values().map(OfClass::quality).sum();
        (!self.classes.is_empty()).then(|| sum / self.classes.len() as f64)
    }
}

impl OfClass {
    fn quality(&self) -> f64 {
        let others = (self.wrong + self.missed) as f64;
        // A class is met by one of the three, so this is above 0.
        self.iou / (self.matches as f64 + others / 2.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agreement::Match;
    use crate::made::{catalogue, object};

    fn found(objects: &[(usize, std::ops::Range<u32>)]) -> Catalogue {
        let objects = objects.iter().map(|(label, rows)| object(*label, rows.clone()));
        catalogue(objects.collect(), 40)
    }

    #[test]
    fn matches_count_by_their_iou_and_others_by_half() {
        // Instances 0 to 2 of ten Gaussians each: two chairs (1), a table (2); ten without an instance.
        let instances: Vec<i32> = (0..40).map(|row| if row < 30 { row / 10 } else { -1 }).collect();
        let labels: Vec<i32> = (0..40).map(|row| if row < 20 { 1 } else { 2 }).collect();
        // Eight of ten of the first chair; the table as a chair (5); a half in the open (4), one mostly there (6).
        let found = found(&[(1, 0..8), (5, 20..30), (4, 28..32), (6, 29..36)]);
        let agreed = Agreement::of(&found, &instances, &labels, 1);
        assert_eq!(agreed.matches, [Match { found: 0, truth: 0, iou: 0.8 }]);
        let mut quality = PanopticQuality::default();
        assert_eq!((quality.mean(), quality.of_class(1)), (None, None));
        quality.add(&agreed, &found, &instances, &labels);
        // One match, the second chair missed: 0.8 / 1.5.
        let chair = quality.of_class(1).unwrap();
        assert!((chair - 0.8 / 1.5).abs() < 1e-12, "{chair}");
        assert_eq!([2, 4, 5].map(|class| quality.of_class(class)), [Some(0.0); 3]);
        assert_eq!(quality.of_class(6), None, "mostly where nothing is known");
        assert!((quality.mean().unwrap() - 0.2 / 1.5).abs() < 1e-12);
        // The same scene once more, all found: 1.8 + 1 of 3 + ½ chairs.
        let all = self::found(&[(1, 0..10), (1, 10..20), (2, 20..30)]);
        quality.add(&Agreement::of(&all, &instances, &labels, 1), &all, &instances, &labels);
        let chair = quality.of_class(1).unwrap();
        assert!((chair - 2.8 / 3.5).abs() < 1e-12, "{chair}");
        // Missed in one scene and found in the other: 1 of 1 + ½.
        assert!((quality.of_class(2).unwrap() - 1.0 / 1.5).abs() < 1e-12);
    }

    #[test]
    fn what_is_of_no_class_is_not_missed() {
        let (instances, labels, nothing) = (vec![3; 20], vec![-1; 20], found(&[]));
        let agreed = Agreement::of(&nothing, &instances, &labels, 1);
        assert_eq!(agreed.missed, [3]);
        let mut quality = PanopticQuality::default();
        quality.add(&agreed, &nothing, &instances, &labels);
        assert_eq!(quality.mean(), None);
    }
}
