//! Which objects of a page stand in a relation to which.

use rayon::prelude::*;
use scenesplat_objects::Object;
use scenesplat_objects::relations::{Relation, distance};

/// Most pairs of a page: a megabyte of text. A furnished house of 800 objects has a tenth of them.
const MOST: usize = 100_000;
/// What is nearer than this is near, meters.
const NEAR: f64 = 1.0;
/// The relations that a page can be asked for; of too many pairs the last kind is cut.
const KINDS: [(Relation, &str); 5] = [
    (Relation::On, "on"),
    (Relation::Above, "above"),
    (Relation::Under, "under"),
    (Relation::In, "in"),
    (Relation::Near, "near"),
];

/// Pairs of objects.
pub(super) struct Related {
    /// Place of an object, relation, place of the other.
    pub(super) pairs: Vec<(usize, &'static str, usize)>,
    /// Pairs that are left out.
    pub(super) left_out: usize,
}

impl Related {
    pub(super) fn of(objects: &[Object]) -> Self {
        Self::at_most(objects, MOST)
    }

    fn at_most(objects: &[Object], most: usize) -> Self {
        // What is farther in plan stands in no relation; along x alone this is a window of sorted places.
        let reach = |i: usize| {
            let [length, width, _] = objects[i].bounds.size;
            length.hypot(width) / 2.0
        };
        let x = |i: usize| objects[i].bounds.center[0];
        let widest = (0..objects.len()).map(reach).fold(0.0, f64::max);
        let mut order: Vec<usize> = (0..objects.len()).collect();
        order.sort_by(|&a, &b| x(a).total_cmp(&x(b)).then(a.cmp(&b)));
        let pairs_of = |at: usize| {
            let i = order[at];
            let far = reach(i) + widest + NEAR;
            let after = order[at + 1..].iter().take_while(move |&&j| x(j) - x(i) <= far);
            let mut found: Vec<(usize, f64, usize, usize)> = Vec::new();
            for &j in after {
                for (kind, (relation, _)) in KINDS.iter().enumerate() {
                    for (a, b) in [(i, j), (j, i)] {
                        let d = distance(&objects[a], &objects[b], *relation);
                        found.extend(d.map(|d| (kind, d, a, b)));
                    }
                }
            }
            found
        };
        let mut found: Vec<_> = (0..order.len()).into_par_iter().flat_map_iter(pairs_of).collect();
        // The nearest first, then by kind and number, so that any number of threads gives the same.
        found.sort_by(|a, b| {
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then((a.2, a.3).cmp(&(b.2, b.3)))
        });
        let left_out = found.len().saturating_sub(most);
        found.truncate(most);
        let mut pairs: Vec<_> = found.into_iter().map(|(k, _, a, b)| (k, a, b)).collect();
        pairs.sort_unstable();
        let pairs = pairs.into_iter().map(|(k, a, b)| (a, KINDS[k].1, b)).collect();
        Self { pairs, left_out }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_objects::UprightBox;

    fn object(center: [f64; 3], size: [f64; 3]) -> Object {
        let bounds = UprightBox { center, size, yaw: 0.0 };
        Object {
            id: 0,
            class: String::new(),
            label: 0,
            score: None,
            count: 30,
            bounds,
            position: center,
            corners: bounds.corners(),
            volume: bounds.volume(),
            above_floor: 0.0,
            wall_distance: None,
            rows: Vec::new(),
        }
    }

    #[test]
    fn all_objects_have_their_relations_however_many_there_are() {
        // 700 cubes in a row, each near the next one, and a lamp on the last.
        let mut objects: Vec<Object> =
            (0..700).map(|i| object([1.5 * f64::from(i), 0.0, 0.5], [1.0; 3])).collect();
        objects.push(object([1.5 * 699.0, 0.0, 1.2], [0.2, 0.2, 0.4]));
        // A lamp at the end of a long table: small things reach as far as what they are on.
        objects.push(object([300.0, 20.0, 0.5], [8.0, 1.0, 1.0]));
        objects.push(object([296.4, 20.0, 1.2], [0.2, 0.2, 0.4]));
        let related = Related::of(&objects);
        assert!(
            related.pairs.contains(&(702, "on", 701)),
            "the table's middle is far from its end"
        );
        assert!(related.pairs.contains(&(700, "on", 699)), "the last is known");
        assert!(related.pairs.contains(&(698, "near", 699)));
        assert_eq!(related.left_out, 0);
        // Every pair by hand, without a window.
        let mut want = Vec::new();
        for (relation, name) in KINDS {
            for a in 0..objects.len() {
                for b in (0..objects.len()).filter(|b| *b != a) {
                    if distance(&objects[a], &objects[b], relation).is_some() {
                        want.push((a, name, b));
                    }
                }
            }
        }
        assert_eq!(related.pairs, want);
        let few = Related::at_most(&objects, 100);
        assert_eq!((few.pairs.len(), few.left_out), (100, want.len() - 100));
        assert!(few.pairs.contains(&(700, "on", 699)), "what is only near is left out first");
    }
}
