//! The report as one page that needs nothing else: no file, no network.

use super::ParetoError;
use super::point::{Point, points};
use super::record::{Kind, Record, Stage};
use super::summary::Summary;
use scenesplat::page_kit::{Block, Document, REPORT_STYLE, Rights};
use scenesplat::shipped::{PARETO_BODY, PARETO_SCRIPT};
use serde::Serialize;
use std::collections::BTreeMap;

/// What the page's script reads.
#[derive(Serialize)]
struct Data<'a> {
    summary: &'a Summary,
    machine: String,
    views: Vec<View>,
    findings: Vec<String>,
}

/// The points over some sets of scenes.
#[derive(Serialize)]
struct View {
    name: String,
    points: Vec<PointWithStages>,
    oracle: Option<Point>,
    random_labels: Option<Point>,
}

#[derive(Serialize)]
struct PointWithStages {
    #[serde(flatten)]
    point: Point,
    stages: Vec<Stage>,
}

/// The page.
///
/// # Errors
/// If the data cannot be written as JSON.
pub fn page(summary: &Summary, records: &[Record]) -> Result<String, ParetoError> {
    let view = |name: &str, sets: &[String]| {
        let row = |kind| points(records, kind, sets).into_iter().next();
        let all = points(records, Kind::Setting, sets).into_iter();
        View {
            name: name.to_owned(),
            points: all
                .map(|point| {
                    let stages = stages(records, &point.setting, sets);
                    PointWithStages { point, stages }
                })
                .collect(),
            oracle: row(Kind::Oracle),
            random_labels: row(Kind::Random),
        }
    };
    let mut views = vec![view("all", &summary.scenes)];
    if summary.scenes.len() > 1 {
        views.extend(summary.scenes.iter().map(|set| view(set, std::slice::from_ref(set))));
    }
    let findings = summary.findings.iter().map(ToString::to_string).collect();
    let machine = summary.machine.to_string();
    let data = Data { summary, machine, views, findings };
    let document = Document {
        title: "What accuracy costs",
        class: "",
        style: REPORT_STYLE,
        body: PARETO_BODY,
        blocks: &[Block::json("data", &data)?],
        script: PARETO_SCRIPT,
        rights: Rights::None,
    };
    Ok(document.html())
}

/// Mean seconds of each stage over the sets.
fn stages(records: &[Record], setting: &str, sets: &[String]) -> Vec<Stage> {
    let mut sums: BTreeMap<usize, Stage> = BTreeMap::new();
    let of =
        |r: &&Record| r.kind == Kind::Setting && r.setting == setting && sets.contains(&r.scenes);
    for record in records.iter().filter(of) {
        for (i, stage) in record.stages.iter().enumerate() {
            let sum =
                sums.entry(i).or_insert(Stage { name: stage.name.clone(), ..Stage::default() });
            sum.seconds += stage.seconds / sets.len() as f64;
            sum.share += stage.share / sets.len() as f64;
        }
    }
    sums.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::record;
    use super::super::summary::Around;
    use super::super::training::TrainingCurve;
    use super::super::write_report;
    use super::*;
    use scenesplat::machine::Machine;

    /// The report with names that would be markup. `.ci/page` opens it in a browser from the folder `SCENESPLAT_PAGES`.
    #[test]
    fn the_report_is_a_page_in_which_no_name_is_markup() {
        let temporary = tempfile::tempdir().unwrap();
        let named = std::env::var_os("SCENESPLAT_PAGES").map(std::path::PathBuf::from);
        let folder = named.unwrap_or_else(|| temporary.path().to_owned());
        std::fs::create_dir_all(&folder).unwrap();
        let attack = "<img src=x onerror=globalThis.attacked=1></script>";
        let machine = |cpu: &str| Machine { cpu: cpu.to_owned(), ..Machine::default() };
        let records = [
            Record {
                machine: machine("</script><script>globalThis.attacked=1</script>"),
                ..record("k=1", 0.5, 0.40)
            },
            record(&format!("k=8,net={attack}"), 1.0, 0.62),
            record("k=25", 4.0, 0.65),
            record("k=25,voxel=0.01", 5.0, 0.64),
        ];
        let training = vec![TrainingCurve {
            name: attack.to_owned(),
            metric: "zero_shot/f-mIoU".to_owned(),
            points: vec![[10.0, 0.1], [100.0, 0.5], [200.0, 0.55]],
            best: 0.55,
            seconds_to_99: 200.0,
        }];
        let networks = BTreeMap::from([(attack.to_owned(), "folder".to_owned())]);
        let around = Around { training, networks, ..Around::default() };
        let summary = Summary::of(&records, around).unwrap();
        let written = write_report(&summary, &records, &folder).unwrap();
        let page = std::fs::read_to_string(folder.join("pareto.html")).unwrap();
        assert_eq!(written.last().map(|(_, bytes)| *bytes), Some(page.len() as u64));
        let names =
            ["front.json", "pareto.svg", "pareto.png", "pareto.html"].map(|n| folder.join(n));
        assert_eq!(written.iter().map(|(path, _)| path.clone()).collect::<Vec<_>>(), names);
        for (path, bytes) in &written {
            assert_eq!(std::fs::metadata(path).unwrap().len(), *bytes, "{}", path.display());
        }
        let text = std::fs::read_to_string(&names[0]).unwrap();
        assert_eq!(serde_json::from_str::<Summary>(&text).unwrap(), summary);
        assert_eq!(page.matches("</script").count(), 2);
        assert!(page.contains("default-src 'none'") && !page.contains("unsafe-inline"));
        assert!(!page.contains("<img") && !page.contains("<script>globalThis"));
    }

    #[test]
    fn a_page_has_a_view_of_each_set_and_of_all() {
        let records = [
            record("k=1", 1.0, 0.5),
            Record { scenes: "</script>".to_owned(), ..record("k=1", 2.0, 0.4) },
        ];
        let summary = Summary::of(&records, Around::default()).unwrap();
        let page = page(&summary, &records).unwrap();
        let begin = page.find("id=\"data\">").unwrap() + 10;
        let end = begin + page[begin..].find("</script>").unwrap();
        let data: serde_json::Value = serde_json::from_str(&page[begin..end]).unwrap();
        let names: Vec<_> = data["views"].as_array().unwrap().iter().map(|v| &v["name"]).collect();
        assert_eq!(names, ["all", "rooms", "</script>"]);
        assert_eq!(data["views"][0]["points"][0]["stages"][0]["seconds"], 1.5);
    }

    #[test]
    fn a_view_has_the_points_stages_and_bounds_of_its_sets() {
        let stage =
            |name: &str, seconds: f64, share: f64| Stage { name: name.to_owned(), seconds, share };
        let of = |set: &str, stages: Vec<Stage>| Record {
            scenes: set.to_owned(),
            stages,
            ..record("k=1", 1.0, 0.5)
        };
        let records = [
            of("rooms", vec![stage("read", 1.0, 0.25), stage("network", 3.0, 0.75)]),
            of("house", vec![stage("read", 2.0, 0.5), stage("network", 2.0, 0.5)]),
            Record {
                kind: Kind::Oracle,
                setting: "oracle".to_owned(),
                ..of("rooms", vec![stage("read", 90.0, 1.0)])
            },
            Record {
                kind: Kind::Neutral,
                neutral: Some("threads=1".to_owned()),
                ..of("rooms", vec![stage("read", 90.0, 1.0)])
            },
            Record {
                setting: "k=8".to_owned(),
                seconds_p50: 2.0,
                seconds_low: 2.0,
                ..of("rooms", vec![])
            },
        ];
        let both = ["rooms", "house"].map(str::to_owned);
        let want = vec![stage("read", 1.5, 0.375), stage("network", 2.5, 0.625)];
        assert_eq!(
            (stages(&records, "k=1", &both), stages(&records, "k=2", &both)),
            (want, vec![])
        );
        assert_eq!(stages(&records, "k=1", &both[1..]), records[1].stages);
        let data = |records: &[Record]| -> serde_json::Value {
            let summary = Summary::of(records, Around::default()).unwrap();
            let page = page(&summary, records).unwrap();
            assert!(page.contains("<title>What accuracy costs</title>"));
            let begin = page.find("id=\"data\">").unwrap() + 10;
            serde_json::from_str(&page[begin..begin + page[begin..].find("</script>").unwrap()])
                .unwrap()
        };
        let found = data(&records);
        let views = found["views"].as_array().unwrap();
        let counts: Vec<usize> =
            views.iter().map(|v| v["points"].as_array().unwrap().len()).collect();
        assert_eq!(counts, [1, 2, 1]);
        assert_eq!(
            (&views[1]["name"], &views[1]["points"][0]["stages"][1]["seconds"]),
            (&"rooms".into(), &3.0.into())
        );
        // The truth was scored on the rooms alone.
        assert!(
            views[0]["oracle"].is_null()
                && views[2]["oracle"].is_null()
                && views[1]["random_labels"].is_null()
        );
        assert_eq!(views[1]["oracle"]["setting"], "oracle");
        assert_eq!(found["machine"], Machine::default().to_string());
        assert_eq!(found["summary"]["scenes"], serde_json::json!(["rooms", "house"]));
        // One set is a view of all. What costs and buys nothing is told in words.
        let one = data(&[records[0].clone(), records[4].clone()]);
        assert_eq!(
            (one["views"].as_array().unwrap().len(), &one["views"][0]["name"]),
            (1, &"all".into())
        );
        assert!(
            one["findings"][0].as_str().unwrap().starts_with("k=8 takes 2.00 times"),
            "{}",
            one["findings"]
        );
    }
}
