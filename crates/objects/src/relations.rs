//! How objects stand to each other, and questions in these words.

use crate::catalogue::{Catalogue, Object};
use scenesplat_scene::label_set::find_name;

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

/// The words of a relation, longer ones before those that they begin with.
const WORDS: [(&str, Relation); 13] = [
    ("on top of", Relation::On),
    ("standing on", Relation::On),
    ("lying on", Relation::On),
    ("next to", Relation::Near),
    ("close to", Relation::Near),
    ("beside", Relation::Near),
    ("near", Relation::Near),
    ("above", Relation::Above),
    ("over", Relation::Above),
    ("below", Relation::Under),
    ("under", Relation::Under),
    ("inside", Relation::In),
    ("on", Relation::On),
];

/// Rests on: the lower face is so near to a face of the other, meters.
const REST: f64 = 0.12;
/// Near: at most so far apart, meters.
const NEAR: f64 = 1.0;

/// A question such as "the lamp on the desk", in its parts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Question {
    /// What is looked for: "lamp".
    pub what: String,
    /// How it stands to the other.
    pub relation: Relation,
    /// The other: "desk".
    pub to: String,
}

impl Question {
    /// The parts of a phrase, without articles; `None` if it has no words of a relation in its
    /// middle. "picture over the sofa in the corner" asks for what the first such words say.
    pub fn parse(phrase: &str) -> Option<Self> {
        let words: Vec<String> =
            phrase.split_whitespace().map(str::to_lowercase).filter(|w| !is_article(w)).collect();
        for at in 1..words.len() {
            for (text, relation) in WORDS.into_iter().chain([("in", Relation::In)]) {
                let parts: Vec<&str> = text.split(' ').collect();
                let end = at + parts.len();
                if end < words.len() && words[at..end] == parts {
                    let (what, to) = (words[..at].join(" "), words[end..].join(" "));
                    return Some(Self { what, relation, to });
                }
            }
        }
        None
    }

    /// Places in the catalogue of the objects that answer, best first; `None` if it has no class of one
    /// of the names.
    pub fn answer(&self, catalogue: &Catalogue) -> Option<Vec<usize>> {
        let mut names: Vec<String> = catalogue.objects.iter().map(|o| o.class.clone()).collect();
        names.dedup();
        let class = |name: &str| {
            let single = name.strip_suffix('s').unwrap_or(name);
            let at = find_name(&names, name).or_else(|_| find_name(&names, single)).ok()?;
            Some(names[at].as_str())
        };
        let (what, to) = (class(&self.what)?, class(&self.to)?);
        let all = &catalogue.objects;
        let of = |name: &str| -> Vec<usize> {
            (0..all.len()).filter(|&i| all[i].class == name).collect()
        };
        let others = of(to);
        let mut found: Vec<(f64, usize)> = of(what)
            .into_iter()
            .filter_map(|i| {
                let best = others.iter().filter(|&&j| j != i);
                let best = best.filter_map(|&j| distance(&all[i], &all[j], self.relation));
                best.reduce(f64::min).map(|d| (d, i))
            })
            .collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        Some(found.into_iter().map(|(_, i)| i).collect())
    }
}

fn is_article(word: &str) -> bool {
    ["the", "a", "an"].contains(&word)
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
        }
    }

    #[test]
    fn questions_have_three_parts() {
        let q = Question::parse("the reading lamp On top of a desk").unwrap();
        assert_eq!(
            (q.what.as_str(), q.relation, q.to.as_str()),
            ("reading lamp", Relation::On, "desk")
        );
        assert_eq!(Question::parse("lamp next to the sofa").unwrap().relation, Relation::Near);
        for none in ["lamp", "on the desk", "lamp on", "lamp on the", "", "something to sit"] {
            assert_eq!(Question::parse(none), None, "{none}");
        }
    }

    #[test]
    fn the_lamp_on_the_desk_is_that_lamp() {
        let room = room();
        let ask = |text: &str| Question::parse(text).unwrap().answer(&room);
        assert_eq!(ask("the lamp on the desk"), Some(vec![1]));
        assert_eq!(ask("lamps above the desk"), Some(vec![1, 3]));
        assert_eq!(ask("trash can under the desk"), Some(vec![4]));
        assert_eq!(ask("the lamp near the sofa"), Some(vec![2]));
        assert_eq!(ask("sofa on the desk"), Some(vec![]));
        assert_eq!(ask("piano on the desk"), None);
    }
}
