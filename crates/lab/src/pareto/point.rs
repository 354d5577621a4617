//! A setting over all sets of scenes: one mark of the picture.

use super::record::{Kind, Record};
use serde::{Deserialize, Serialize};

/// Figures of a setting, means over the sets of scenes. Field names are those of [`Record`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// The setting in canonical form: what `--setting` takes.
    pub setting: String,
    /// Median time of a scene, seconds.
    pub seconds_p50: f64,
    /// Time that 95 % keep, seconds.
    pub seconds_p95: f64,
    /// Least of the repeats' medians.
    pub seconds_low: f64,
    /// Largest of the repeats' medians.
    pub seconds_high: f64,
    /// Largest resident memory of any set, bytes.
    pub peak_bytes: f64,
    /// Bytes of the results of a scene.
    pub bytes_written: f64,
    /// Foreground mean `IoU`.
    pub f_miou: Option<f64>,
    /// Lower end of its interval over scenes; of several sets the mean of theirs, which is wider than
    /// that of the mean.
    pub f_miou_low: Option<f64>,
    /// Upper end.
    pub f_miou_high: Option<f64>,
    /// Mean `IoU`.
    pub miou: Option<f64>,
    /// Foreground mean accuracy.
    pub f_macc: Option<f64>,
    /// Share of Gaussians labeled as the reference labels them.
    pub agreement: Option<f64>,
    /// Share of queries whose best Gaussian is right.
    pub query_hit1: Option<f64>,
    /// Expected calibration error.
    pub ece: Option<f64>,
    /// Hash of the predictions of each set.
    pub prediction_hash: Vec<String>,
}

impl Point {
    /// Of the records of one setting, one for each set of scenes.
    pub fn of(records: &[&Record]) -> Self {
        let count = records.len().max(1) as f64;
        let mean =
            |get: &dyn Fn(&Record) -> f64| records.iter().map(|r| get(r)).sum::<f64>() / count;
        // A mean over some sets would not compare with one over all.
        let all = |get: &dyn Fn(&Record) -> Option<f64>| {
            records.iter().map(|r| get(r)).sum::<Option<f64>>().map(|sum| sum / count)
        };
        Self {
            setting: records.first().map(|r| r.setting.clone()).unwrap_or_default(),
            seconds_p50: mean(&|r| r.seconds_p50),
            seconds_p95: mean(&|r| r.seconds_p95),
            seconds_low: mean(&|r| r.seconds_low),
            seconds_high: mean(&|r| r.seconds_high),
            peak_bytes: records.iter().map(|r| r.peak_bytes).max().unwrap_or(0) as f64,
            bytes_written: mean(&|r| r.bytes_written as f64),
            f_miou: all(&|r| r.f_miou),
            f_miou_low: all(&|r| r.f_miou_low),
            f_miou_high: all(&|r| r.f_miou_high),
            miou: all(&|r| r.miou),
            f_macc: all(&|r| r.f_macc),
            agreement: all(&|r| r.agreement),
            query_hit1: all(&|r| r.query_hit1),
            ece: all(&|r| r.ece),
            prediction_hash: records.iter().map(|r| r.prediction_hash.clone()).collect(),
        }
    }
}

/// Sets of scenes in the order in which they were first measured.
pub fn sets(records: &[Record]) -> Vec<String> {
    let mut sets: Vec<String> = Vec::new();
    for record in records {
        if !sets.contains(&record.scenes) {
            sets.push(record.scenes.clone());
        }
    }
    sets
}

/// The points of a kind, over the given sets: of each setting that was measured on all of them, in the
/// order of the records.
pub fn points(records: &[Record], kind: Kind, sets: &[String]) -> Vec<Point> {
    let mut names: Vec<&str> = Vec::new();
    for record in records.iter().filter(|r| r.kind == kind) {
        if !names.contains(&record.setting.as_str()) {
            names.push(&record.setting);
        }
    }
    let of = |name: &&str| {
        let find = |set: &String| {
            records.iter().find(|r| r.kind == kind && r.setting == *name && r.scenes == *set)
        };
        let found: Option<Vec<&Record>> = sets.iter().map(find).collect();
        found.map(|found| Point::of(&found))
    };
    names.iter().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::record;
    use super::*;

    #[test]
    fn a_point_is_the_mean_of_its_sets_and_needs_them_all() {
        let house = Record { scenes: "house".to_owned(), ..record("k=1", 3.0, 0.3) };
        let records = [record("k=1", 1.0, 0.5), house, record("k=8", 2.0, 0.6)];
        let sets = sets(&records);
        assert_eq!(sets, ["rooms", "house"]);
        let found = points(&records, Kind::Setting, &sets);
        assert_eq!(found.len(), 1, "k=8 was not measured in the house");
        assert_eq!((found[0].seconds_p50, found[0].f_miou), (2.0, Some(0.4)));
        assert_eq!(points(&records, Kind::Setting, &sets[..1]).len(), 2);
        let blind = Record { f_miou: None, ..record("k=1", 1.0, 0.5) };
        assert_eq!(Point::of(&[&records[0], &blind]).f_miou, None);
    }

    #[test]
    fn the_peak_is_that_of_the_set_that_needs_most() {
        let of = |peak_bytes| Record { peak_bytes, ..record("k=1", 1.0, 0.5) };
        let found = Point::of(&[&of(100), &of(700), &of(400)]);
        assert_eq!(found.peak_bytes, 700.0);
        assert_eq!(found.bytes_written, 1000.0);
    }

    #[test]
    fn every_figure_of_a_point_is_the_mean_of_that_figure() {
        // Figure i of the first set is i, that of the second 3 i: the mean is 2 i.
        let of = |by: f64, hash: &str| Record {
            seconds_p50: by,
            seconds_p95: 2.0 * by,
            seconds_low: 3.0 * by,
            seconds_high: 4.0 * by,
            bytes_written: (5.0 * by) as u64,
            f_miou: Some(6.0 * by),
            f_miou_low: Some(7.0 * by),
            f_miou_high: Some(8.0 * by),
            miou: Some(9.0 * by),
            f_macc: Some(10.0 * by),
            agreement: Some(11.0 * by),
            query_hit1: Some(12.0 * by),
            ece: Some(13.0 * by),
            peak_bytes: (14.0 * by) as u64,
            prediction_hash: hash.to_owned(),
            ..record("k=1", 1.0, 0.5)
        };
        let found = Point::of(&[&of(1.0, "a"), &of(3.0, "b")]);
        let want = Point {
            setting: "k=1".to_owned(),
            seconds_p50: 2.0,
            seconds_p95: 4.0,
            seconds_low: 6.0,
            seconds_high: 8.0,
            peak_bytes: 42.0,
            bytes_written: 10.0,
            f_miou: Some(12.0),
            f_miou_low: Some(14.0),
            f_miou_high: Some(16.0),
            miou: Some(18.0),
            f_macc: Some(20.0),
            agreement: Some(22.0),
            query_hit1: Some(24.0),
            ece: Some(26.0),
            prediction_hash: vec!["a".to_owned(), "b".to_owned()],
        };
        assert_eq!(found, want);
        // Of each kind its own, in the order of the records, whatever stands between.
        let row = |kind, setting: &str| Record { kind, ..record(setting, 1.0, 0.5) };
        let all = [
            row(Kind::Oracle, "z"),
            row(Kind::Setting, "z"),
            row(Kind::Neutral, "b"),
            row(Kind::Setting, "a"),
        ];
        let names = |kind| -> Vec<String> {
            points(&all, kind, &["rooms".to_owned()]).into_iter().map(|p| p.setting).collect()
        };
        assert_eq!(
            (names(Kind::Setting), names(Kind::Oracle)),
            (vec!["z".into(), "a".into()], vec!["z".to_owned()])
        );
    }
}
