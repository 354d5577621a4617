//! Which settings need not be measured, because neighbors that were rule them out.
//!
//! The values of an axis are ordered cheap to accurate. A setting that is nowhere more accurate than a
//! measured one cannot be worth more than that, and one that is nowhere cheaper cannot cost less. Where
//! some measured setting costs no more than that least and is worth no less than that most, nothing is
//! left to find out.
//!
//! # Source
//! `ParameterSpace::update_bounds` and `explore` of `faiss/AutoTune.cpp`, faiss 02dbb4e. Differs: parts
//! without an order (single points of a grid) compare only if they are equal.

use super::grid::Axis;
use scenesplat::setting::Setting;
use std::collections::BTreeMap;

/// A setting by its parts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// The setting as it is written.
    pub text: String,
    parts: BTreeMap<String, String>,
}

/// What was found of a candidate.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// Which.
    pub candidate: Candidate,
    /// What it costs, seconds.
    pub cost: f64,
    /// What it is worth, higher is better.
    pub worth: f64,
}

/// Why a setting is left out.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RuledOut {
    /// The setting that was not measured.
    pub setting: String,
    /// A measured setting that is no dearer and no worse than this one can be.
    pub by: String,
    /// The measured setting that is nowhere cheaper, whose worth this one cannot exceed.
    pub no_better_than: String,
    /// The measured setting that is nowhere more accurate, whose cost this one cannot undercut.
    pub no_cheaper_than: String,
}

impl Candidate {
    /// Of a setting.
    pub fn new(setting: &Setting) -> Self {
        let text = setting.to_string();
        let parts = text.split(',').filter_map(|part| part.split_once('='));
        let parts = parts.map(|(key, value)| (key.to_owned(), value.to_owned())).collect();
        Self { text, parts }
    }

    /// Its parts by name.
    pub fn parts(&self) -> &BTreeMap<String, String> {
        &self.parts
    }

    /// Whether it is at least as accurate, and as dear, as another in every part.
    fn covers(&self, other: &Self, axes: &[Axis]) -> bool {
        let keys = self.parts.keys().chain(other.parts.keys());
        keys.into_iter().all(|key| {
            let (own, their) = (self.parts.get(key), other.parts.get(key));
            if own == their {
                return true;
            }
            let place = |value: Option<&String>| {
                let axis = axes.iter().find(|axis| axis.name == *key)?;
                axis.values.iter().position(|v| Some(v) == value)
            };
            place(own).zip(place(their)).is_some_and(|(own, their)| own >= their)
        })
    }
}

/// Why a candidate need not be measured; `None` if it has to be.
pub fn ruled_out(candidate: &Candidate, tried: &[Tried], axes: &[Axis]) -> Option<RuledOut> {
    let above = tried.iter().filter(|t| t.candidate.covers(candidate, axes));
    let most = above.min_by(|a, b| a.worth.total_cmp(&b.worth))?;
    let below = tried.iter().filter(|t| candidate.covers(&t.candidate, axes));
    let least = below.max_by(|a, b| a.cost.total_cmp(&b.cost))?;
    let by = tried.iter().find(|t| t.cost <= least.cost && t.worth >= most.worth)?;
    Some(RuledOut {
        setting: candidate.text.clone(),
        by: by.candidate.text.clone(),
        no_better_than: most.candidate.text.clone(),
        no_cheaper_than: least.candidate.text.clone(),
    })
}

/// The order in which a grid is measured: the reference, the two corners of the axes, then the rest in
/// an order that depends on nothing but their names, so that bounds come from all over the grid.
pub fn order(settings: &[Setting], axes: &[Axis]) -> Vec<Candidate> {
    use sha2::Digest;
    let mut all: Vec<Candidate> = settings.iter().map(Candidate::new).collect();
    let rank = |candidate: &Candidate| {
        let corner = |pick: fn(&[String]) -> Option<&String>| {
            axes.iter().all(|axis| candidate.parts.get(&axis.name) == pick(&axis.values))
        };
        match () {
            () if axes.is_empty() => 2,
            () if corner(<[String]>::first) => 0,
            () if corner(<[String]>::last) => 1,
            () => 2,
        }
    };
    if let Some(rest) = all.get_mut(1..) {
        rest.sort_by_cached_key(|c| (rank(c), sha2::Sha256::digest(c.text.as_bytes()).to_vec()));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axes() -> Vec<Axis> {
        let axis = |name: &str, values: &[&str]| Axis {
            name: name.to_owned(),
            values: values.iter().map(|&v| v.to_owned()).collect(),
        };
        vec![axis("voxel", &["0.1", "0.05", "0.02"]), axis("k", &["1", "8", "25"])]
    }

    fn candidate(text: &str) -> Candidate {
        Candidate::new(&text.parse().unwrap())
    }

    fn tried(text: &str, cost: f64, worth: f64) -> Tried {
        Tried { candidate: candidate(text), cost, worth }
    }

    #[test]
    fn a_setting_between_two_that_are_worth_the_same_is_ruled_out() {
        let all = [tried("voxel=0.1,k=1", 1.0, 0.5), tried("voxel=0.1,k=25", 3.0, 0.5)];
        let found = ruled_out(&candidate("voxel=0.1,k=8"), &all, &axes()).unwrap();
        assert_eq!(found.by, "voxel=0.1,k=1");
        assert_eq!((found.no_better_than, found.no_cheaper_than).0, "voxel=0.1,k=25");
        // If the dearer one is worth more, the one between may be, too.
        let all = [tried("voxel=0.1,k=1", 1.0, 0.5), tried("voxel=0.1,k=25", 3.0, 0.6)];
        assert_eq!(ruled_out(&candidate("voxel=0.1,k=8"), &all, &axes()), None);
    }

    #[test]
    fn nothing_is_ruled_out_without_a_bound_on_both_sides() {
        let cheap = [tried("voxel=0.1,k=1", 1.0, 0.9)];
        assert_eq!(ruled_out(&candidate("voxel=0.05,k=1"), &cheap, &axes()), None);
        let dear = [tried("voxel=0.02,k=25", 9.0, 0.1)];
        assert_eq!(ruled_out(&candidate("voxel=0.05,k=1"), &dear, &axes()), None);
        // Neither is more accurate than the other.
        let all = [tried("voxel=0.02,k=1", 1.0, 0.5), tried("voxel=0.1,k=25", 3.0, 0.5)];
        assert_eq!(ruled_out(&candidate("voxel=0.05,k=8"), &all, &axes()), None);
    }

    #[test]
    fn parts_without_an_order_compare_only_if_equal() {
        let all = [tried("voxel=0.1,k=1", 1.0, 0.5), tried("voxel=0.1,k=25", 3.0, 0.5)];
        let other = candidate("voxel=0.1,precision=bf16,k=8");
        assert_eq!(ruled_out(&other, &all, &axes()), None);
        assert_eq!(ruled_out(&candidate("voxel=0.1,k=9"), &all, &axes()), None);
    }

    #[test]
    fn the_reference_comes_first_and_corners_before_the_rest() {
        let texts = ["voxel=0.05,k=8", "voxel=0.1,k=8", "voxel=0.02,k=25", "voxel=0.1,k=1"];
        let settings: Vec<Setting> = texts.iter().map(|t| t.parse().unwrap()).collect();
        let names: Vec<String> = order(&settings, &axes()).into_iter().map(|c| c.text).collect();
        assert_eq!(names, [texts[0], texts[3], texts[2], texts[1]]);
    }

    #[test]
    fn a_part_that_only_one_setting_has_keeps_it_from_covering() {
        let (plain, half) =
            (candidate("voxel=0.1,k=25"), candidate("voxel=0.1,precision=bf16,k=8"));
        assert!(!plain.covers(&half, &axes()) && !half.covers(&plain, &axes()));
        assert!(plain.covers(&candidate("voxel=0.1,k=8"), &axes()));
        // Only the cheap one is of the same precision: what more neighbors are worth there is unknown.
        let all =
            [tried("voxel=0.1,k=25", 3.0, 0.5), tried("voxel=0.1,precision=bf16,k=1", 1.0, 0.5)];
        assert_eq!(ruled_out(&half, &all, &axes()), None);
    }

    #[test]
    fn equal_costs_and_worths_are_enough_and_the_tightest_bounds_are_named() {
        // Below: 1 and 2 s, of which 2 s is the least that k=8 can cost. Above: 0.7 and 0.6, which it cannot exceed.
        let mut all = vec![
            tried("voxel=0.1,k=1", 1.0, 0.3),
            tried("voxel=0.05,k=1", 2.0, 0.4),
            tried("voxel=0.02,k=25", 9.0, 0.7),
            tried("voxel=0.05,k=25", 8.0, 0.6),
            tried("voxel=0.02,k=1", 2.0, 0.6),
        ];
        let wanted = candidate("voxel=0.05,k=8");
        let want = RuledOut {
            setting: "voxel=0.05,k=8".to_owned(),
            by: "voxel=0.02,k=1".to_owned(),
            no_better_than: "voxel=0.05,k=25".to_owned(),
            no_cheaper_than: "voxel=0.05,k=1".to_owned(),
        };
        assert_eq!(ruled_out(&wanted, &all, &axes()), Some(want));
        // A little dearer, or a little worse, rules nothing out.
        all[4].cost = 2.01;
        assert_eq!(ruled_out(&wanted, &all, &axes()), None);
        (all[4].cost, all[4].worth) = (2.0, 0.59);
        assert_eq!(ruled_out(&wanted, &all, &axes()), None);
        assert_eq!(
            wanted.parts().iter().map(|(k, v)| format!("{k}:{v}")).collect::<Vec<_>>(),
            ["k:8", "voxel:0.05"]
        );
    }

    #[test]
    fn the_rest_is_in_the_order_of_the_hashes_of_its_names() {
        use sha2::Digest;
        let texts: Vec<String> = (2..9).map(|k| format!("voxel=0.05,k={k}")).collect();
        let settings: Vec<Setting> = texts.iter().map(|t| t.parse().unwrap()).collect();
        let mut want = texts[1..].to_vec();
        want.sort_by_key(|t| sha2::Sha256::digest(t.as_bytes()).to_vec());
        want.insert(0, texts[0].clone());
        for axes in [axes(), Vec::new()] {
            let names: Vec<String> = order(&settings, &axes).into_iter().map(|c| c.text).collect();
            assert_eq!(names, want);
        }
        assert_eq!(order(&[], &axes()), []);
    }
}
