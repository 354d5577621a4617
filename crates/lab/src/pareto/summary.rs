//! What is made of the records: the front, its knee, the classes, and what else the report shows.

use super::ParetoError;
use super::findings::{Finding, negative_findings};
use super::front::{CLASSES, ClassWinner, cheapest_of_class, front, knee};
use super::point::{Point, points, sets};
use super::record::{Kind, Record};
use super::search::RuledOut;
use super::training::TrainingCurve;
use scenesplat::machine::Machine;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A line of the table of what must not change the result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NeutralRow {
    /// What was tried, such as `threads=1`.
    pub neutral: String,
    /// The setting.
    pub setting: String,
    /// The set of scenes.
    pub scenes: String,
    /// What it is held to: `equal`, or a least agreement.
    pub rule: String,
    /// Whether it holds.
    pub holds: bool,
    /// Whether the labels are the same to the last one.
    pub equal: bool,
    /// Share of Gaussians with the same label.
    pub agreement: Option<f64>,
    /// Median time of a scene.
    pub seconds_p50: f64,
    /// Largest resident memory, bytes.
    pub peak_bytes: u64,
}

/// What `front.json` holds. Field names are stable.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Version of the program.
    pub version: String,
    /// Where it was measured.
    pub machine: Machine,
    /// [`Machine::fingerprint`].
    pub fingerprint: String,
    /// Sets of scenes.
    pub scenes: Vec<String>,
    /// Number of scenes in all sets.
    pub num_scenes: usize,
    /// What the front is drawn from.
    pub quality: String,
    /// What everything is compared with.
    pub reference: String,
    /// The front over all sets, cheapest first: no point beats another.
    pub points: Vec<Point>,
    /// Settings that one of the front beats.
    pub dominated: Vec<Point>,
    /// Setting at which more time stops to pay.
    pub knee: Option<String>,
    /// The cheapest of each class of quality.
    pub classes: Vec<ClassWinner>,
    /// The ceiling.
    pub oracle: Option<Point>,
    /// What has to be beaten.
    pub random_labels: Option<Point>,
    /// What must not change the result.
    pub neutral: Vec<NeutralRow>,
    /// Settings that were not measured because neighbors rule them out.
    pub skipped: Vec<RuledOut>,
    /// Settings that were not measured because time was over.
    pub unmeasured: Vec<String>,
    /// What costs time and buys nothing.
    pub findings: Vec<Finding>,
    /// Folders of the networks that settings name.
    pub networks: BTreeMap<String, String>,
    /// Quality against training time.
    pub training: Vec<TrainingCurve>,
}

/// What the records do not know.
#[derive(Debug, Clone, Default)]
pub struct Around {
    /// The reference setting.
    pub reference: String,
    /// Settings that neighbors rule out.
    pub skipped: Vec<RuledOut>,
    /// Settings for which there was no time.
    pub unmeasured: Vec<String>,
    /// Folders of the networks that settings name.
    pub networks: BTreeMap<String, String>,
    /// Quality against training time.
    pub training: Vec<TrainingCurve>,
}

impl Summary {
    /// Of all records; of training curves alone, where there are no records.
    ///
    /// # Errors
    /// If no setting was measured on all sets with an f-mIoU, or there is nothing at all.
    pub fn of(records: &[Record], around: Around) -> Result<Self, ParetoError> {
        if records.is_empty() && !around.training.is_empty() {
            let machine = Machine::detect();
            return Ok(Self {
                version: machine.version.clone(),
                fingerprint: machine.fingerprint(),
                machine,
                training: around.training,
                ..Self::default()
            });
        }
        let empty = || ParetoError::Empty { quality: "f-mIoU".to_owned() };
        let sets = sets(records);
        let all = points(records, Kind::Setting, &sets);
        let first = records.first().ok_or_else(empty)?;
        let (kept, mut beaten) = split(&all);
        if kept.is_empty() {
            return Err(empty());
        }
        beaten.sort_by(|a, b| a.seconds_p50.total_cmp(&b.seconds_p50));
        let on: Vec<[f64; 2]> = kept.iter().map(place).collect();
        let places: Vec<[f64; 2]> = all.iter().map(place).collect();
        let reference = all.iter().find(|p| p.setting == around.reference).and_then(|p| p.f_miou);
        let winner = |share: f64| {
            let found =
                reference.and_then(|r| cheapest_of_class(&places, r, share)).map(|i| &all[i]);
            ClassWinner {
                share,
                setting: found.map(|p| p.setting.clone()),
                seconds_p50: found.map(|p| p.seconds_p50),
                quality: found.and_then(|p| p.f_miou),
            }
        };
        let row = |kind| points(records, kind, &sets).into_iter().next();
        let count = |set: &String| {
            let of = records.iter().find(|r| r.kind == Kind::Setting && r.scenes == *set);
            of.map_or(0, |r| r.per_scene.len())
        };
        Ok(Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            machine: first.machine.clone(),
            fingerprint: first.fingerprint.clone(),
            num_scenes: sets.iter().map(count).sum(),
            quality: "f_miou".to_owned(),
            knee: knee(&on).map(|i| kept[i].setting.clone()),
            points: kept,
            dominated: beaten,
            classes: CLASSES.into_iter().map(winner).collect(),
            oracle: row(Kind::Oracle),
            random_labels: row(Kind::Random),
            neutral: records.iter().filter_map(neutral).collect(),
            findings: negative_findings(&all),
            scenes: sets,
            reference: around.reference,
            skipped: around.skipped,
            unmeasured: around.unmeasured,
            networks: around.networks,
            training: around.training,
        })
    }

    /// All measured settings, the front first.
    pub fn all(&self) -> impl Iterator<Item = &Point> {
        self.points.iter().chain(&self.dominated)
    }
}

/// Time and quality, as a front takes them.
pub(crate) fn place(point: &Point) -> [f64; 2] {
    [point.seconds_p50, point.f_miou.unwrap_or(f64::NAN)]
}

/// The front, cheapest first, and the rest.
pub(crate) fn split(all: &[Point]) -> (Vec<Point>, Vec<Point>) {
    let places: Vec<[f64; 2]> = all.iter().map(place).collect();
    let kept = front(&places);
    let pick =
        |on: bool| all.iter().zip(&kept).filter(move |(_, k)| **k == on).map(|(p, _)| p.clone());
    let mut on: Vec<Point> = pick(true).collect();
    on.sort_by(|a, b| a.seconds_p50.total_cmp(&b.seconds_p50));
    (on, pick(false).collect())
}

fn neutral(record: &Record) -> Option<NeutralRow> {
    let neutral = record.neutral.clone()?;
    Some(NeutralRow {
        neutral,
        setting: record.setting.clone(),
        scenes: record.scenes.clone(),
        rule: record.rule.clone().unwrap_or_default(),
        holds: record.holds.unwrap_or(false),
        equal: record.agreement == Some(1.0),
        agreement: record.agreement,
        seconds_p50: record.seconds_p50,
        peak_bytes: record.peak_bytes,
    })
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::record;
    use super::*;

    fn records() -> Vec<Record> {
        let row = |kind, name: &str, f_miou| Record { kind, ..record(name, 0.01, f_miou) };
        let once_more = Record {
            kind: Kind::Neutral,
            neutral: Some("threads=1".to_owned()),
            rule: Some("equal".to_owned()),
            holds: Some(true),
            ..record("voxel=0.02,k=8", 2.0, 0.7)
        };
        vec![
            record("voxel=0.02,k=8", 1.0, 0.70),
            row(Kind::Oracle, "oracle", 0.99),
            row(Kind::Random, "random labels", 0.03),
            record("voxel=0.02,k=25", 1.5, 0.70),
            record("voxel=0.05,k=8", 0.4, 0.695),
            record("voxel=0.1,k=8", 0.1, 0.40),
            once_more,
        ]
    }

    #[test]
    fn the_front_holds_settings_only() {
        let around = Around { reference: "voxel=0.02,k=25".to_owned(), ..Around::default() };
        let summary = Summary::of(&records(), around).unwrap();
        let names: Vec<&str> = summary.points.iter().map(|p| p.setting.as_str()).collect();
        assert_eq!(names, ["voxel=0.1,k=8", "voxel=0.05,k=8", "voxel=0.02,k=8"]);
        assert_eq!(summary.dominated[0].setting, "voxel=0.02,k=25");
        assert_eq!(summary.knee.as_deref(), Some("voxel=0.05,k=8"));
        let winners: Vec<_> = summary.classes.iter().map(|c| c.setting.as_deref()).collect();
        let (fine, coarse) = (Some("voxel=0.02,k=8"), Some("voxel=0.05,k=8"));
        assert_eq!(winners, [fine, coarse, coarse]);
        assert!((summary.oracle.unwrap().f_miou, summary.neutral.len()) == (Some(0.99), 1));
        assert_eq!(summary.findings[0].dear, "25");
    }

    #[test]
    fn nothing_measured_is_no_front() {
        assert!(Summary::of(&[], Around::default()).is_err());
        let blind = Record { f_miou: None, ..record("k=1", 1.0, 0.5) };
        assert!(Summary::of(&[blind], Around::default()).is_err());
    }

    #[test]
    fn a_rule_that_allows_differences_may_hold_without_equal_labels() {
        let row = |holds, agreement| {
            let around = Around { reference: "voxel=0.02,k=8".to_owned(), ..Around::default() };
            let again = Record {
                kind: Kind::Neutral,
                neutral: Some("max_memory=1GB".to_owned()),
                rule: Some("agreement >= 0.99".to_owned()),
                holds: Some(holds),
                agreement: Some(agreement),
                ..record("voxel=0.02,k=8", 2.0, 0.7)
            };
            let all = [record("voxel=0.02,k=8", 1.0, 0.7), again];
            let summary = Summary::of(&all, around).unwrap();
            (summary.neutral[0].holds, summary.neutral[0].equal)
        };
        assert_eq!(row(true, 0.995), (true, false));
        assert_eq!(row(true, 1.0), (true, true));
        assert_eq!(row(false, 0.9), (false, false));
    }

    #[test]
    fn a_summary_is_of_all_sets_and_says_where_it_was_measured() {
        let scenes = |count| vec![super::super::record::SceneRecord::default(); count];
        let here = Machine { cpu: "cpu".to_owned(), ..Machine::default() };
        let house = |r: Record| Record { scenes: "house".to_owned(), per_scene: scenes(3), ..r };
        let rooms = |r: Record| Record { machine: here.clone(), per_scene: scenes(2), ..r };
        let again = Record {
            kind: Kind::Neutral,
            neutral: Some("threads=1".to_owned()),
            rule: Some("equal".to_owned()),
            holds: None,
            agreement: Some(0.75),
            ..record("b", 2.0, 0.7)
        };
        // Means of both sets: a 4 s for 0.5, b 1 s for 0.4, c 6 s for 0.5, d 5 s for 0.3.
        let mut all = Vec::new();
        for (name, seconds, f_miou) in
            [("a", 4.0, 0.5), ("b", 1.0, 0.4), ("c", 6.0, 0.5), ("d", 5.0, 0.3)]
        {
            all.push(rooms(record(name, seconds - 0.5, f_miou + 0.1)));
            all.push(house(record(name, seconds + 0.5, f_miou - 0.1)));
        }
        all.push(record("only rooms", 0.1, 0.9));
        all.push(again);
        let networks = BTreeMap::from([("net".to_owned(), "folder".to_owned())]);
        let around = Around {
            reference: "c".to_owned(),
            skipped: vec![RuledOut {
                setting: "e".into(),
                by: "a".into(),
                no_better_than: "c".into(),
                no_cheaper_than: "b".into(),
            }],
            unmeasured: vec!["f".to_owned()],
            networks: networks.clone(),
            training: Vec::new(),
        };
        let found = Summary::of(&all, around.clone()).unwrap();
        let names = |points: &[Point]| {
            points.iter().map(|p| p.setting.clone()).collect::<Vec<_>>().join(" ")
        };
        assert_eq!(
            (names(&found.points), names(&found.dominated)),
            ("b a".to_owned(), "d c".to_owned())
        );
        assert_eq!(found.all().map(|p| p.setting.as_str()).collect::<String>(), "badc");
        assert_eq!((found.scenes.join(" "), found.num_scenes), ("rooms house".to_owned(), 5));
        assert_eq!((found.machine, found.fingerprint.as_str()), (here, "m"));
        assert_eq!(
            (found.version.as_str(), found.quality.as_str()),
            (env!("CARGO_PKG_VERSION"), "f_miou")
        );
        assert_eq!((found.reference.as_str(), &found.networks), ("c", &networks));
        assert_eq!(
            (found.skipped, found.unmeasured),
            (around.skipped.clone(), vec!["f".to_owned()])
        );
        assert_eq!((found.oracle, found.random_labels, found.knee), (None, None, None));
        let winner = &found.classes[2];
        assert_eq!(
            (winner.share, winner.setting.as_deref(), winner.seconds_p50),
            (0.95, Some("a"), Some(4.0))
        );
        assert!((winner.quality.unwrap() - 0.5).abs() < 1e-12 && found.classes[0].share == 0.999);
        let row = NeutralRow {
            neutral: "threads=1".into(),
            setting: "b".into(),
            scenes: "rooms".into(),
            rule: "equal".into(),
            holds: false,
            equal: false,
            agreement: Some(0.75),
            seconds_p50: 2.0,
            peak_bytes: 100_000_000,
        };
        assert_eq!(found.neutral, [row]);
        // Without the reference nobody wins a class. With curves alone there is a summary of this machine.
        let nobody = Summary::of(&all, Around { reference: "z".to_owned(), ..around }).unwrap();
        assert!(
            nobody
                .classes
                .iter()
                .all(|c| c.setting.is_none() && c.seconds_p50.is_none() && c.quality.is_none())
        );
        let curve = TrainingCurve {
            name: "run".into(),
            metric: "m".into(),
            points: vec![],
            best: 0.5,
            seconds_to_99: 1.0,
        };
        let alone = Summary::of(&[], Around { training: vec![curve.clone()], ..Around::default() })
            .unwrap();
        assert_eq!(
            (alone.training, alone.fingerprint),
            (vec![curve], Machine::detect().fingerprint())
        );
        assert!(alone.points.is_empty() && alone.version == alone.machine.version);
    }
}
