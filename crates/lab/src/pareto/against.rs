//! Records beside those of an earlier run: what became slower or worse, and whether labels stayed.

use super::record::{Kind, Record};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Time that a setting may take of what it took before, without being called slower.
pub const MOST_TIME: f64 = 1.15;
/// f-mIoU that a setting may lose, as a share, without being called worse.
pub const MOST_LOSS: f64 = 0.003;

/// What is said of a setting.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Change {
    /// f-mIoU fell by more than [`MOST_LOSS`].
    Worse {
        /// f-mIoU before.
        before: f64,
        /// f-mIoU now; none if there is none any more.
        now: Option<f64>,
    },
    /// The median time of a scene grew by more than [`MOST_TIME`].
    Slower {
        /// Seconds before.
        before: f64,
        /// Seconds now.
        now: f64,
    },
}

/// A change of a setting on a set of scenes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Regression {
    /// The setting in canonical form.
    pub setting: String,
    /// The set of scenes.
    pub scenes: String,
    /// What changed.
    pub change: Change,
}

impl fmt::Display for Regression {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} on {}: ", self.setting, self.scenes)?;
        match self.change {
            Change::Worse { before, now: Some(now) } => {
                write!(f, "f-mIoU {:.2} %, {:.2} % before", 100.0 * now, 100.0 * before)
            }
            Change::Worse { before, now: None } => {
                write!(f, "no f-mIoU, {:.2} % before", 100.0 * before)
            }
            Change::Slower { before, now } => {
                write!(f, "{now:.3} s a scene, {before:.3} s before ({:.2} times)", now / before)
            }
        }
    }
}

/// Two runs beside each other.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Compared {
    /// Settings and sets of scenes that both have, of the same input and weights.
    pub common: usize,
    /// How many of them have the same labels, to the last one.
    pub same_labels: usize,
    /// Least and largest time as a multiple of that before; none if nothing is common.
    pub times: Option<[f64; 2]>,
    /// Whether times compare: the same machine, threads, instruction set and version of the program.
    pub same_machine: bool,
    /// What became worse, or slower.
    pub regressions: Vec<Regression>,
    /// Settings of before that are of other input or weights, or were not measured now.
    pub missing: Vec<String>,
    /// Settings of before that were measured under other conditions (reference, classes, files, what was written), and
    /// under which.
    pub other_conditions: Vec<String>,
}

impl Compared {
    /// What is to be failed for: quality on any machine, time on the same one only.
    pub fn failures(&self) -> impl Iterator<Item = &Regression> {
        let counts =
            |r: &&Regression| self.same_machine || matches!(r.change, Change::Worse { .. });
        self.regressions.iter().filter(counts)
    }
}

/// Compares the settings of two runs.
pub fn compare(now: &[Record], before: &[Record]) -> Compared {
    let mut out = Compared { same_machine: true, ..Compared::default() };
    for old in before.iter().filter(|record| record.kind == Kind::Setting) {
        let same = |new: &&Record| new.key() == old.key() && new.weights_hash == old.weights_hash;
        let Some(new) = now.iter().find(same) else {
            out.missing.push(format!("{} on {}", old.setting, old.scenes));
            continue;
        };
        if new.conditions != old.conditions {
            let Record { setting, scenes, conditions, .. } = old;
            out.other_conditions.push(format!("{setting} on {scenes}: {conditions}"));
            continue;
        }
        out.common += 1;
        out.same_labels += usize::from(new.prediction_hash == old.prediction_hash);
        out.same_machine &= new.fingerprint == old.fingerprint;
        let times = new.seconds_p50 / old.seconds_p50;
        let [least, most] = out.times.unwrap_or([times; 2]);
        out.times = Some([least.min(times), most.max(times)]);
        let mut add = |change| {
            let (setting, scenes) = (old.setting.clone(), old.scenes.clone());
            out.regressions.push(Regression { setting, scenes, change });
        };
        // Written so that a value that is no number counts as worse, and as slower.
        if let Some(miou) = old.f_miou
            && !new.f_miou.is_some_and(|now| now >= miou - MOST_LOSS)
        {
            add(Change::Worse { before: miou, now: new.f_miou });
        }
        if times.is_nan() || times > MOST_TIME {
            add(Change::Slower { before: old.seconds_p50, now: new.seconds_p50 });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::record;
    use super::*;

    fn changes(now: Record, before: Record) -> (Vec<Change>, usize) {
        let found = compare(&[now], &[before]);
        assert_eq!((found.common, found.missing.len()), (1, 0));
        let failures = found.failures().count();
        (found.regressions.into_iter().map(|r| r.change).collect(), failures)
    }

    #[test]
    fn other_conditions_are_not_compared() {
        let before = record("k=8", 1.0, 0.6);
        let now = Record { conditions: "writes [Labels]".to_owned(), ..record("k=8", 9.0, 0.1) };
        let found = compare(&[now], std::slice::from_ref(&before));
        assert_eq!((found.common, found.times, found.failures().count()), (0, None, 0));
        assert!(found.other_conditions[0].contains("k=8"), "{found:?}");
        assert!(found.missing.is_empty());
        let same = std::slice::from_ref(&before);
        assert_eq!(compare(same, same).common, 1);
    }

    #[test]
    fn what_became_worse_or_slower_is_found_at_its_bound() {
        let before = || record("k=8", 1.0, 0.6);
        assert_eq!(changes(before(), before()), (vec![], 0));
        assert_eq!(changes(record("k=8", 1.149, 0.5971), before()), (vec![], 0));
        assert_eq!(changes(record("k=8", 0.5, 0.9), before()), (vec![], 0));
        let slower = Change::Slower { before: 1.0, now: 1.16 };
        assert_eq!(changes(record("k=8", 1.16, 0.6), before()), (vec![slower.clone()], 1));
        let worse = Change::Worse { before: 0.6, now: Some(0.596) };
        assert_eq!(changes(record("k=8", 1.0, 0.596), before()), (vec![worse.clone()], 1));
        let lost = Record { f_miou: None, ..before() };
        assert_eq!(changes(lost, before()), (vec![Change::Worse { before: 0.6, now: None }], 1));
        let nan = Record { f_miou: Some(f64::NAN), seconds_p50: f64::NAN, ..before() };
        assert_eq!(changes(nan, before()).0.len(), 2);
        // Another machine has other times, but no other quality.
        let elsewhere = Record { fingerprint: "n".to_owned(), ..record("k=8", 1.16, 0.596) };
        assert_eq!(changes(elsewhere, before()), (vec![worse, slower], 1));
    }

    #[test]
    fn what_does_not_compare_is_missing_and_labels_are_counted() {
        let settings = ["k=1", "k=8", "k=25", "k=50"];
        let before: Vec<Record> = settings.map(|s| record(s, 1.0, 0.6)).to_vec();
        let mut now: Vec<Record> = settings[..3].iter().map(|s| record(s, 0.9, 0.6)).collect();
        now[0].prediction_hash = "other".to_owned();
        now[1].seconds_p50 = 1.1;
        now[2].input_hash = "other".to_owned();
        now.push(record("k=99", 9.0, 0.1));
        let found = compare(&now, &before);
        assert_eq!((found.common, found.same_labels), (2, 1));
        assert_eq!(found.times, Some([0.9, 1.1]));
        assert_eq!(found.missing, ["k=25 on rooms", "k=50 on rooms"]);
        assert!(found.regressions.is_empty() && found.same_machine);
        assert_eq!(compare(&[], &[]).times, None);
    }

    #[test]
    fn one_record_of_another_machine_is_enough_for_times_not_to_compare() {
        let before = ["k=1", "k=8"].map(|s| record(s, 1.0, 0.6));
        for elsewhere in [0, 1] {
            let mut now = ["k=1", "k=8"].map(|s| record(s, 2.0, 0.6));
            now[elsewhere].fingerprint = "n".to_owned();
            let found = compare(&now, &before);
            assert_eq!((found.common, found.regressions.len()), (2, 2));
            assert!(!found.same_machine, "{elsewhere}");
            // Both became slower, for which nobody is to blame.
            assert_eq!(found.failures().count(), 0, "{elsewhere}");
        }
    }

    #[test]
    fn other_weights_are_missing_and_rows_that_are_no_settings_do_not_count() {
        let before = [
            Record { kind: Kind::Neutral, ..record("k=1", 1.0, 0.5) },
            Record { kind: Kind::Oracle, ..record("k=1", 1.0, 0.5) },
            record("k=8", 2.0, 0.5),
            record("k=25", 4.0, 0.5),
        ];
        let mut now = before.to_vec();
        now[2].weights_hash = "other".to_owned();
        now[3] = Record { seconds_p50: 4.6, f_miou: Some(0.497), ..now[3].clone() };
        let found = compare(&now, &before);
        assert_eq!((found.common, found.missing), (1, vec!["k=8 on rooms".to_owned()]));
        // 1.15 times and 0.003 less are not more than that.
        assert_eq!((found.regressions.len(), found.times.map(|t| t[0])), (0, Some(4.6 / 4.0)));
        assert_eq!((MOST_TIME, MOST_LOSS), (1.15, 0.003));
        now[3] = Record { seconds_p50: 6.0, f_miou: Some(0.4), ..now[3].clone() };
        let texts = |f_miou| {
            let mut now = now.clone();
            now[3].f_miou = f_miou;
            compare(&now, &before).regressions.iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        let slower = "k=25 on rooms: 6.000 s a scene, 4.000 s before (1.50 times)";
        assert_eq!(texts(Some(0.4)), ["k=25 on rooms: f-mIoU 40.00 %, 50.00 % before", slower]);
        assert_eq!(texts(None), ["k=25 on rooms: no f-mIoU, 50.00 % before", slower]);
        now[3].conditions = "d".to_owned();
        assert_eq!(compare(&now, &before).other_conditions, ["k=25 on rooms: c"]);
        // Without a quality before nothing can become worse.
        let blind = [Record { f_miou: None, ..record("k=8", 2.0, 0.5) }];
        assert_eq!(compare(&[record("k=8", 2.0, 0.1)], &blind).regressions, []);
    }
}
