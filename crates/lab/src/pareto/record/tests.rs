//! Lines that are written, read, found and refused.

use super::*;

/// A record of a setting with these figures.
pub(crate) fn record(setting: &str, seconds: f64, f_miou: f64) -> Record {
    Record {
        kind: Kind::Setting,
        setting: setting.to_owned(),
        changes_result: Some(true),
        neutral: None,
        rule: None,
        holds: None,
        scenes: "rooms".to_owned(),
        repeats: 5,
        seconds_p50: seconds,
        seconds_p95: seconds * 1.1,
        seconds_low: seconds * 0.98,
        seconds_high: seconds * 1.02,
        load_seconds: 0.01,
        peak_bytes: 100_000_000,
        bytes_written: 1000,
        f_miou: Some(f_miou),
        f_miou_low: Some(f_miou - 0.02),
        f_miou_high: Some(f_miou + 0.02),
        miou: Some(f_miou),
        f_macc: Some(f_miou),
        macc: Some(f_miou),
        all_acc: Some(f_miou),
        agreement: Some(1.0),
        query_hit1: Some(1.0),
        ece: Some(0.1),
        stages: vec![Stage { name: "network".to_owned(), seconds, share: 1.0 }],
        stage_coverage: 1.0,
        width: 96,
        classes: 20,
        prediction_hash: setting.to_owned(),
        conditions: "c".to_owned(),
        weights_hash: "w".to_owned(),
        input_hash: "i".to_owned(),
        truth_hash: "t".to_owned(),
        machine: Machine::default(),
        fingerprint: "m".to_owned(),
        per_scene: Vec::new(),
    }
}

#[test]
fn records_return_and_a_cut_line_is_taken_off() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("records.jsonl");
    let mut records = Records::open(&path).unwrap();
    records.append(record("k=1", 1.0, 0.5)).unwrap();
    records.append(record("k=8", 2.0, 0.6)).unwrap();
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() - 20]).unwrap();
    let mut records = Records::open(&path).unwrap();
    assert!(records.repaired && records.all == [record("k=1", 1.0, 0.5)]);
    records.append(record("k=8", 2.0, 0.6)).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), whole);
    assert!(records.find(Kind::Setting, "k=8", None, "rooms").is_some());
    assert!(records.find(Kind::Setting, "k=8", None, "house").is_none());
    assert!(records.find(Kind::Neutral, "k=8", None, "rooms").is_none());
    std::fs::write(&path, "{\"kind\":1}\n").unwrap();
    let error = Records::open(&path).unwrap_err().to_string();
    assert!(error.contains("line 1") && error.contains("records.jsonl"), "{error}");
}

#[test]
fn records_of_something_else_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut records = Records::open(&folder.path().join("records.jsonl")).unwrap();
    records.append(record("k=1", 1.0, 0.5)).unwrap();
    let input = |hash: &str| vec![("rooms".to_owned(), hash.to_owned())];
    let here = Machine::default();
    records.check_own("m", &here, "c", &input("i")).unwrap();
    let error = records.check_own("m", &here, "d", &input("i")).unwrap_err();
    assert!(error.to_string().contains("another choice"), "{error}");
    let newer = Machine { version: "9".to_owned(), ..here.clone() };
    for (fingerprint, machine, hash, what) in
        [("m", &newer, "i", "version"), ("n", &here, "i", "machine"), ("m", &here, "j", "input")]
    {
        let error = records.check_own(fingerprint, machine, "c", &input(hash)).unwrap_err();
        assert!(error.to_string().contains(what), "{error}");
    }
}

#[test]
fn each_neutral_change_is_measured_for_itself() {
    let folder = tempfile::tempdir().unwrap();
    let mut records = Records::open(&folder.path().join("records.jsonl")).unwrap();
    let neutral = Some("threads=1".to_owned());
    let done = Record { kind: Kind::Neutral, neutral, ..record("k=8", 1.0, 0.5) };
    records.append(done).unwrap();
    let find = |neutral| records.find(Kind::Neutral, "k=8", neutral, "rooms");
    assert!(find(Some("threads=1")).is_some());
    assert!(find(Some("threads=4")).is_none());
    assert!(find(None).is_none());
}

#[test]
fn a_line_has_stable_names_and_is_found_by_all_that_tells_it_apart() {
    let neutral = Record {
        kind: Kind::Neutral,
        neutral: Some("threads=2".to_owned()),
        per_scene: vec![SceneRecord { name: "a".to_owned(), ..SceneRecord::default() }],
        ..record("k=8", 1.0, 0.5)
    };
    assert_eq!(neutral.key(), ("Neutral k=8 threads=2".into(), "rooms".into(), "i".into()));
    assert_eq!(record("k=8", 1.0, 0.5).key().0, "Setting k=8 ");
    let line = serde_json::to_value(&neutral).unwrap();
    let names: Vec<&str> = line.as_object().unwrap().keys().map(String::as_str).collect();
    let mut want = "kind setting changes_result neutral rule holds scenes repeats seconds_p50 seconds_p95 seconds_low \
        seconds_high load_seconds peak_bytes bytes_written f_miou f_miou_low f_miou_high miou f_macc macc all_acc \
        agreement query_hit1 ece stages stage_coverage width classes prediction_hash conditions weights_hash \
        input_hash truth_hash machine fingerprint per_scene"
        .split_whitespace()
        .collect::<Vec<_>>();
    want.sort_unstable();
    let mut names = names;
    names.sort_unstable();
    assert_eq!(names, want);
    assert_eq!((&line["kind"], line["per_scene"][0].get("unnamed")), (&"neutral".into(), None));
    for (kind, name) in
        [(Kind::Setting, "setting"), (Kind::Oracle, "oracle"), (Kind::Random, "random")]
    {
        assert_eq!(serde_json::to_value(kind).unwrap(), name);
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("records.jsonl");
    let mut records = Records::open(&path).unwrap();
    assert!(!records.repaired && records.all.is_empty());
    records.append(record("k=1", 1.0, 0.5)).unwrap();
    records.append(neutral.clone()).unwrap();
    assert_eq!(records.all, [record("k=1", 1.0, 0.5), neutral.clone()]);
    assert!(records.find(Kind::Setting, "k=2", None, "rooms").is_none());
    assert_eq!(records.find(Kind::Neutral, "k=8", Some("threads=2"), "rooms"), Some(&neutral));
    // Empty lines are passed over and counted; what is read is not changed, not even a cut line.
    let text = format!("\n{}\n\n{{}}\n", serde_json::to_string(&neutral).unwrap());
    std::fs::write(&path, &text).unwrap();
    let error = Records::read(&path).unwrap_err().to_string();
    assert!(error.contains("line 4 is no record"), "{error}");
    let cut = text.replace("{}\n", "{");
    std::fs::write(&path, &cut).unwrap();
    assert_eq!(Records::read(&path).unwrap(), [neutral]);
    assert_eq!(std::fs::read_to_string(&path).unwrap(), cut);
    assert!(Records::open(&path).unwrap().repaired && !Records::open(&path).unwrap().repaired);
    assert!(Records::read(&folder.path().join("no")).is_err());
}

#[test]
fn all_records_are_checked_and_both_sides_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let mut records = Records::open(&folder.path().join("r.jsonl")).unwrap();
    let here = Machine { version: "1".to_owned(), cpu: "mine".to_owned(), ..Machine::default() };
    let mine = |setting| Record { machine: here.clone(), ..record(setting, 1.0, 0.5) };
    records.append(mine("k=1")).unwrap();
    // What is neutral has other threads, and so another machine and input.
    let other = Record {
        fingerprint: "n".to_owned(),
        machine: Machine::default(),
        input_hash: "x".to_owned(),
        ..mine("k=1")
    };
    records.append(Record { kind: Kind::Neutral, ..other.clone() }).unwrap();
    let inputs = |hash: &str| {
        vec![("other".to_owned(), "zz".to_owned()), ("rooms".to_owned(), hash.to_owned())]
    };
    records.check_own("m", &here, "c", &inputs("i")).unwrap();
    records.check_own("m", &here, "c", &[]).unwrap();
    let told = |records: &Records, hash: &str| {
        records.check_own("m", &here, "c", &inputs(hash)).unwrap_err().to_string()
    };
    let error = told(&records, "0123456789abcdef");
    assert!(
        error.contains("another input (rooms sha256 i…, here it is rooms sha256 0123456789ab…)"),
        "{error}"
    );
    // A later one is looked at, too.
    records
        .append(Record { machine: here.clone(), input_hash: "i".to_owned(), ..other.clone() })
        .unwrap();
    let error = told(&records, "i");
    assert!(
        error.contains("another machine (mine, 0 cores") && error.contains("r.jsonl"),
        "{error}"
    );
    records.all[2] = Record { conditions: "d".to_owned(), kind: Kind::Neutral, ..other };
    assert!(told(&records, "i").contains("another choice (d, here it is c)"));
    records.all[2] =
        Record { machine: Machine { version: "0".to_owned(), ..here.clone() }, ..mine("k=2") };
    assert!(told(&records, "i").contains("another version (0, here it is 1)"));
}
