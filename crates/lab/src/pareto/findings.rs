//! What costs time and buys nothing.

use super::point::Point;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Smallest time difference that is reported, as a ratio: less is lost in the noise of a machine.
const LEAST_COST: f64 = 1.10;
/// Quality that counts as nothing: a tenth of a point.
const NOTHING: f64 = 0.001;

/// A dearer choice that buys nothing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// The part of the setting.
    pub part: String,
    /// Its cheaper value.
    pub cheap: String,
    /// Its dearer value.
    pub dear: String,
    /// Time of the dearer over that of the cheaper.
    pub times: f64,
    /// f-mIoU of the dearer less that of the cheaper.
    pub gained: f64,
    /// The other parts, which both share.
    pub otherwise: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { part, cheap, dear, times, gained, otherwise } = self;
        let points = 100.0 * gained;
        write!(
            f,
            "{part}={dear} takes {times:.2} times as long as {part}={cheap} and gains {points:+.2} \
             points of f-mIoU ({otherwise})"
        )
    }
}

/// Pairs of settings that differ in one part only, of which one takes at least a tenth longer and is
/// worth at most a tenth of a point more. Of each pair of values the case of the highest quality: what
/// is bought where nothing works anyway says little. The costliest first.
pub fn negative_findings(points: &[Point]) -> Vec<Finding> {
    let mut best: BTreeMap<(String, String, String), (f64, Finding)> = BTreeMap::new();
    for cheap in points {
        for dear in points {
            let Some(finding) = compare(cheap, dear) else { continue };
            let key = (finding.part.clone(), finding.cheap.clone(), finding.dear.clone());
            let worth = cheap.f_miou.unwrap_or(0.0);
            match best.get(&key) {
                Some((known, _)) if *known >= worth => {}
                _ => drop(best.insert(key, (worth, finding))),
            }
        }
    }
    let mut found: Vec<Finding> = best.into_values().map(|(_, finding)| finding).collect();
    found.sort_by(|a, b| b.times.total_cmp(&a.times));
    found
}

fn compare(cheap: &Point, dear: &Point) -> Option<Finding> {
    let times = dear.seconds_p50 / cheap.seconds_p50;
    // The repeats' spreads must not overlap either.
    if times < LEAST_COST || dear.seconds_low <= cheap.seconds_high {
        return None;
    }
    let gained = dear.f_miou? - cheap.f_miou?;
    if gained > NOTHING {
        return None;
    }
    let parts = |p: &Point| -> BTreeMap<String, String> {
        let pairs = p.setting.split(',').filter_map(|part| part.split_once('='));
        pairs.map(|(k, v)| (k.to_owned(), v.to_owned())).collect()
    };
    let (own, their) = (parts(cheap), parts(dear));
    let keys: std::collections::BTreeSet<&String> = own.keys().chain(their.keys()).collect();
    let mut differing = keys.into_iter().filter(|key| own.get(*key) != their.get(*key));
    let (part, None) = (differing.next()?, differing.next()) else { return None };
    let value = |of: &BTreeMap<String, String>| of.get(part).cloned().unwrap_or("-".to_owned());
    let same = dear.setting.split(',').filter(|p| !p.starts_with(&format!("{part}=")));
    Some(Finding {
        part: part.clone(),
        cheap: value(&own),
        dear: value(&their),
        times,
        gained,
        otherwise: same.collect::<Vec<_>>().join(","),
    })
}

#[cfg(test)]
mod tests {
    use super::super::point::Point;
    use super::super::record::tests::record;
    use super::*;

    fn point(setting: &str, seconds: f64, f_miou: f64) -> Point {
        Point::of(&[&record(setting, seconds, f_miou)])
    }

    #[test]
    fn what_costs_and_buys_nothing_is_found() {
        let points = [
            point("voxel=0.02,k=8", 1.0, 0.70),
            point("voxel=0.02,k=25", 1.5, 0.70),
            point("voxel=0.04,k=8", 0.5, 0.60),
            point("voxel=0.04,k=25", 0.9, 0.599),
        ];
        let found = negative_findings(&points);
        // Both cases of k are the same finding: the one of the better setting is reported. The voxels pay.
        assert_eq!(found.len(), 1, "{found:?}");
        let text = found[0].to_string();
        assert!(text.contains("k=25 takes 1.50 times as long as k=8"), "{text}");
        assert!(text.contains("+0.00 points") && text.contains("(voxel=0.02)"), "{text}");
    }

    #[test]
    fn noise_and_gains_are_no_findings() {
        let base = point("k=8", 1.0, 0.70);
        for other in [
            point("k=25", 1.05, 0.70),
            point("k=25", 2.0, 0.71),
            point("voxel=0.02,k=25", 2.0, 0.7),
            Point { seconds_low: 0.9, ..point("k=25", 1.5, 0.7) },
            Point { f_miou: None, ..point("k=25", 1.5, 0.7) },
        ] {
            assert_eq!(negative_findings(&[base.clone(), other.clone()]), [], "{other:?}");
        }
    }

    #[test]
    fn a_finding_needs_spreads_that_do_not_overlap() {
        let cheap = Point { seconds_low: 0.9, seconds_high: 1.2, ..point("k=8", 1.0, 0.7) };
        let dear = |low| Point { seconds_low: low, ..point("k=25", 1.5, 0.7) };
        // From 1.1 s on the dearer one still meets the cheaper one's 0.9 to 1.2 s; from 1.3 s on no more.
        assert_eq!(negative_findings(&[cheap.clone(), dear(1.1)]), []);
        assert_eq!(negative_findings(&[cheap.clone(), dear(1.2)]), []);
        assert_eq!(negative_findings(&[cheap, dear(1.3)]).len(), 1);
    }

    #[test]
    fn findings_are_at_least_a_tenth_dearer_and_the_costliest_come_first() {
        let exact = |setting: &str, seconds: f64, f_miou: f64| Point {
            seconds_low: seconds,
            seconds_high: seconds,
            ..point(setting, seconds, f_miou)
        };
        let of = |dear: Point| negative_findings(&[exact("k=8", 10.0, 0.5), dear]).len();
        assert_eq!((of(exact("k=25", 11.0, 0.5)), of(exact("k=25", 10.99, 0.5))), (1, 0));
        assert_eq!((of(exact("k=25", 12.0, 0.5009)), of(exact("k=25", 12.0, 0.5011))), (1, 0));
        // Parts that only the dearer one has are - in the cheaper one.
        let all = [
            exact("voxel=0.1,k=8", 1.0, 0.7),
            exact("voxel=0.1,k=8,tta=4", 4.0, 0.69),
            exact("voxel=0.1,k=25", 1.5, 0.7005),
            // Both are dearer than the last by the voxel, and worth more.
            exact("voxel=0.4,k=8", 0.2, 0.2),
            exact("voxel=0.4,k=25", 0.9, 0.2),
        ];
        let found = negative_findings(&all);
        let want = [
            Finding {
                part: "tta".into(),
                cheap: "-".into(),
                dear: "4".into(),
                times: 4.0,
                gained: 0.69 - 0.7,
                otherwise: "voxel=0.1,k=8".into(),
            },
            Finding {
                part: "k".into(),
                cheap: "8".into(),
                dear: "25".into(),
                times: 1.5,
                gained: 0.7005 - 0.7,
                otherwise: "voxel=0.1".into(),
            },
        ];
        assert_eq!(found, want);
        let text = "tta=4 takes 4.00 times as long as tta=- and gains -1.00 points of f-mIoU (voxel=0.1,k=8)";
        assert_eq!(found[0].to_string(), text);
    }
}
