//! How objects stand to each other.

use crate::catalogue::{Catalogue, Object};
use std::fmt;

/// How one object stands to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Relation {
    /// Rests on it: over it in plan, its lowest part near the height of some of it.
    On,
    /// Wholly higher, over it in plan.
    Above,
    /// Wholly lower, under it in plan.
    Under,
    /// Within its box.
    In,
    /// Within a meter, of those of its class the nearest first.
    Near,
}

impl Relation {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::On, Self::Above, Self::Under, Self::In, Self::Near];
}

/// Its word: "on".
impl fmt::Display for Relation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::On => "on",
            Self::Above => "above",
            Self::Under => "under",
            Self::In => "in",
            Self::Near => "near",
        })
    }
}

/// Rests on: the lower face is so near to a face of the other, meters.
const REST: f64 = 0.12;
/// Near: at most so far apart, meters.
const NEAR: f64 = 1.0;

/// Places in the catalogue of the objects that stand in a relation to an object, best first: "the lamps on a desk".
///
/// `what`, `to`: which objects are looked for, and which they stand to. No object stands to itself.
pub fn related(
    catalogue: &Catalogue,
    what: impl Fn(&Object) -> bool,
    relation: Relation,
    to: impl Fn(&Object) -> bool,
) -> Vec<usize> {
    let all = &catalogue.objects;
    let others: Vec<usize> = (0..all.len()).filter(|&j| to(&all[j])).collect();
    let nearest = |i: usize| {
        let others = others.iter().filter(|&&j| j != i);
        others.filter_map(|&j| distance(&all[i], &all[j], relation)).reduce(f64::min)
    };
    let mut found: Vec<(f64, usize)> = (0..all.len())
        .filter(|&i| what(&all[i]))
        .filter_map(|i| nearest(i).map(|d| (d, i)))
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    found.into_iter().map(|(_, i)| i).collect()
}

/// How far from the ideal of a relation two objects are, meters; `None` where it does not hold.
pub fn distance(a: &Object, b: &Object, relation: Relation) -> Option<f64> {
    let (x, y) = (&a.bounds, &b.bounds);
    let ([a_low, a_high], [b_low, b_high]) = (x.heights(), y.heights());
    let over = y.plan_distance([x.center[0], x.center[1]]) == 0.0;
    match relation {
        Relation::On => {
            // A desk's top is not the top of its box where something stands behind; within it will do.
            let rests =
                a_low >= b_low + 0.3 * (b_high - b_low).max(0.0) - REST && a_low <= b_high + REST;
            (over && rests && a_high > b_high).then(|| (a_low - b_high).abs())
        }
        Relation::Above => {
            (x.plan_gap(y) == 0.0 && a_low >= b_high - REST).then(|| (a_low - b_high).max(0.0))
        }
        Relation::Under => {
            (x.plan_gap(y) == 0.0 && a_high <= b_high - REST && a_low < b_low + REST)
                .then(|| (b_high - a_high).max(0.0))
        }
        Relation::In => {
            let inside = over && a_low >= b_low - REST && a_high <= b_high + REST;
            inside.then(|| x.plan_gap(y))
        }
        Relation::Near => {
            let d = x.plan_gap(y).hypot(x.height_gap(y));
            (d <= NEAR).then_some(d)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Floor, UprightBox};

    fn object(class: &str, center: [f64; 3], size: [f64; 3]) -> Object {
        let bounds = UprightBox { center, size, yaw: 0.0 };
        Object {
            id: 0,
            class: class.to_owned(),
            label: 0,
            score: None,
            count: 30,
            bounds,
            position: center,
            corners: bounds.corners(),
            volume: bounds.volume(),
            above_floor: bounds.heights()[0],
            wall_distance: None,
            rows: Vec::new(),
        }
    }

    fn room() -> Catalogue {
        Catalogue {
            objects: vec![
                object("desk", [0.0, 0.0, 0.37], [1.4, 0.7, 0.74]),
                object("lamp", [0.5, 0.2, 0.95], [0.2, 0.2, 0.4]),
                object("lamp", [3.0, 3.0, 0.8], [0.3, 0.3, 1.6]),
                object("lamp", [0.0, 0.0, 2.2], [0.4, 0.4, 0.3]),
                object("trash can", [0.3, 0.0, 0.2], [0.3, 0.3, 0.4]),
                object("sofa", [3.0, 2.0, 0.4], [2.0, 0.9, 0.8]),
            ],
            floor: Floor { height: 0.0, is_labelled: true, is_given: false },
            left_over: 0,
            small_instances: 0,
            nameless_instances: 0,
            gaussians: 0,
            is_carried: false,
        }
    }

    #[test]
    fn the_lamp_on_the_desk_is_that_lamp() {
        let room = room();
        let ask = |what: &str, relation, to: &str| {
            related(&room, |o| o.class == what, relation, |o| o.class == to)
        };
        assert_eq!(ask("lamp", Relation::On, "desk"), [1]);
        assert_eq!(ask("lamp", Relation::Above, "desk"), [1, 3]);
        assert_eq!(ask("trash can", Relation::Under, "desk"), [4]);
        assert_eq!(ask("lamp", Relation::Near, "sofa"), [2]);
        assert!(ask("sofa", Relation::On, "desk").is_empty());
        assert!(ask("piano", Relation::On, "desk").is_empty());
        // No desk is near itself.
        let near_furniture = related(&room, |_| true, Relation::Near, |o| o.class == "desk");
        assert!(!near_furniture.contains(&0) && near_furniture.contains(&1), "{near_furniture:?}");
        // The lamp at the ceiling is 1.3 m above it.
        assert!(!near_furniture.contains(&3), "{near_furniture:?}");
    }

    #[test]
    fn inside_is_within_in_plan_and_in_height() {
        let mut room = room();
        room.objects = vec![
            object("box", [0.0, 0.0, 0.5], [1.0, 1.0, 1.0]),
            object("ball", [0.2, 0.2, 0.5], [0.2, 0.2, 0.2]),
            // Over it, through its top, below it, and beside it.
            object("ball", [0.2, 0.2, 2.5], [0.2, 0.2, 0.2]),
            object("ball", [0.2, 0.2, 1.0], [0.2, 0.2, 0.8]),
            object("ball", [0.2, 0.2, -1.0], [0.2, 0.2, 0.2]),
            object("ball", [3.0, 0.2, 0.5], [0.2, 0.2, 0.2]),
        ];
        let found = related(&room, |o| o.class == "ball", Relation::In, |o| o.class == "box");
        assert_eq!(found, [1]);
    }

    #[test]
    fn each_relation_holds_up_to_its_limits() {
        let desk = object("desk", [0.0, 0.0, 0.5], [2.0, 1.0, 1.0]);
        // x of its middle, lower end, height; what is 0.2 wide is over the desk up to 1, beside it from 1.1 on.
        let at =
            |x: f64, low: f64, high: f64| object("a", [x, 0.1, low + high / 2.0], [0.2, 0.2, high]);
        use Relation::{Above, In, Near, On, Under};
        let cases: [(Relation, f64, f64, f64, Option<f64>); 28] = [
            (On, 0.0, 1.1, 0.5, Some(0.1)),
            (On, 0.0, 1.13, 0.5, None),
            (On, 0.0, 0.19, 1.0, Some(0.81)),
            (On, 0.0, 0.17, 1.0, None),
            (On, 0.0, 0.5, 0.49, None),
            (On, 0.99, 1.0, 0.5, Some(0.0)),
            (On, 1.05, 1.0, 0.5, None),
            (Above, 0.0, 0.89, 0.5, Some(0.0)),
            (Above, 0.0, 0.87, 0.5, None),
            (Above, 1.05, 2.5, 0.5, Some(1.5)),
            (Above, 1.15, 2.5, 0.5, None),
            (Under, 0.0, 0.1, 0.5, Some(0.4)),
            (Under, 0.0, 0.13, 0.5, None),
            (Under, 0.0, 0.0, 0.87, Some(0.13)),
            (Under, 0.0, 0.0, 0.89, None),
            (Under, 1.05, -2.0, 0.5, Some(2.5)),
            (Under, 1.15, -2.0, 0.5, None),
            (In, 0.0, -0.11, 0.5, Some(0.0)),
            (In, 0.0, -0.13, 0.5, None),
            (In, 0.99, 0.6, 0.51, Some(0.0)),
            (In, 0.0, 0.6, 0.53, None),
            (In, 1.05, 0.2, 0.2, None),
            (Near, 0.0, 0.2, 0.2, Some(0.0)),
            (Near, 1.7, 1.79, 0.2, Some(0.6f64.hypot(0.79))),
            (Near, 1.7, 1.81, 0.2, None),
            (Near, -1.7, -0.9, 0.2, Some(0.6f64.hypot(0.7))),
            (Near, 2.09, 0.2, 0.2, Some(0.99)),
            (Near, 2.11, 0.2, 0.2, None),
        ];
        for (relation, x, low, high, want) in cases {
            let found = distance(&at(x, low, high), &desk, relation);
            let is_near = found.zip(want).is_none_or(|(a, b)| (a - b).abs() < 1e-9);
            assert!(
                found.is_some() == want.is_some() && is_near,
                "{relation} {x} {low} {high}: {found:?}"
            );
        }
        let words = Relation::ALL.map(|r| r.to_string());
        assert_eq!(words, ["on", "above", "under", "in", "near"]);
        assert_eq!(serde_json::to_value(Relation::ALL).unwrap(), serde_json::json!(words));
    }

    #[test]
    fn the_best_comes_first_by_its_nearest() {
        let mut room = room();
        let at = |class: &str, x: f64| object(class, [x, 0.0, 0.5], [0.2, 0.2, 1.0]);
        room.objects = vec![
            at("a", 0.9),
            at("b", 0.0),
            at("a", 0.5),
            at("a", -0.5),
            at("b", 1.7),
            at("a", 9.0),
        ];
        // 0.6 from the second b, 0.3 twice, and none.
        assert_eq!(
            related(&room, |o| o.class == "a", Relation::Near, |o| o.class == "b"),
            [2, 3, 0]
        );
        assert!(related(&room, |o| o.class == "a", Relation::Near, |_| false).is_empty());
    }
}
