//! Every setting of an experiment's file does something. The list of settings is asked of the program
//! itself, so that a new one without a row here is a failure; each is changed once, and the run must come
//! out otherwise in the way its row says.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod bases;
mod cases;
mod known;
mod outcome;
mod steps;

use bases::{Data, read};
use cases::{Case, Effect};
use known::{names_of, settings_of};
use outcome::{Outcome, run};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicUsize, Ordering};

/// What of an experiment's file is a choice between tables: each must be in some base.
const CHOICES: [(&str, &str); 8] = [
    ("/train/0/source/type", "source"),
    ("/losses/0/type", "losses"),
    ("/self_supervised/terms/0/type", "terms"),
    ("/schedule/type", "schedule"),
    ("/text/type", "text"),
    ("/model/architecture", "model"),
    ("/task", "task"),
    ("/teacher/type", "teacher"),
];

#[test]
fn every_setting_has_a_row() {
    let data = Data::new();
    let mut known = BTreeSet::new();
    for (name, text) in bases::ALL {
        known.extend(settings_of(&read(&data, name, text)));
    }
    // A table that one base has and another leaves out is no setting itself.
    let inside = |name: &str| {
        let parts = [".", "(", "["].map(|next| format!("{name}{next}"));
        known.iter().any(|other| parts.iter().any(|part| other.starts_with(part)))
    };
    let known: BTreeSet<String> = known.iter().filter(|name| !inside(name)).cloned().collect();
    let rows: BTreeSet<String> = cases::all().map(|case| case.setting.to_owned()).collect();
    let missing: Vec<_> = known.difference(&rows).collect();
    assert!(missing.is_empty(), "settings without a row: {missing:#?}");
    let gone: Vec<_> = rows.difference(&known).collect();
    assert!(gone.is_empty(), "rows of settings that are not there: {gone:#?}");
}

#[test]
fn every_choice_is_in_a_base() {
    let data = Data::new();
    let bases: Vec<Value> = bases::ALL.iter().map(|(name, text)| read(&data, name, text)).collect();
    for (pointer, what) in CHOICES {
        let base = bases.iter().find(|base| base.pointer(pointer).is_some()).unwrap();
        let mut names = names_of(base, pointer);
        // Benchmarks share all of their settings: one stands for them.
        names.retain(|name| {
            what != "source" || ["generic", "synthetic", "replica"].contains(&name.as_str())
        });
        assert!(names.len() >= 2, "{what}: {names:?}");
        let last = pointer.rsplit('/').next().unwrap();
        for name in names {
            let there = bases.iter().any(|base| holds(base, last, &name));
            assert!(there, "{what}: no base has {name:?}");
        }
    }
}

/// Whether some table has this value.
fn holds(value: &Value, field: &str, name: &str) -> bool {
    match value {
        Value::Object(fields) => {
            fields.get(field).is_some_and(|v| v == name)
                || fields.values().any(|v| holds(v, field, name))
        }
        Value::Array(entries) => entries.iter().any(|v| holds(v, field, name)),
        _ => false,
    }
}

/// Sets a value; absent tables on the way are made.
fn set(config: &mut Value, pointer: &str, value: Value) {
    let (parent, field) = pointer.rsplit_once('/').unwrap();
    if config.pointer(parent).is_none_or(Value::is_null) {
        set(config, parent, Value::Object(<_>::default()));
    }
    match config.pointer_mut(parent) {
        Some(Value::Object(fields)) => _ = fields.insert(field.to_owned(), value),
        Some(Value::Array(entries)) => entries[field.parse::<usize>().unwrap()] = value,
        _ => panic!("{pointer}"),
    }
}

fn parsed(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()))
}

#[test]
fn every_setting_does_what_its_row_says() {
    let data = Data::new();
    // Something to start from.
    let first = read(&data, "language", bases::text("language"));
    assert_eq!(run(&data, &first, "first").error, None);
    std::fs::rename(data.path().join("first/model"), data.path().join("init")).unwrap();
    let mut groups: Vec<(&str, Vec<(usize, &Case)>)> = Vec::new();
    for (number, case) in cases::all().enumerate() {
        match groups.iter_mut().find(|(base, _)| *base == case.base) {
            Some((_, group)) => group.push((number, case)),
            None => groups.push((case.base, vec![(number, case)])),
        }
    }
    groups.sort_by_key(|(_, group)| std::cmp::Reverse(group.len()));
    // Runs this small keep one core busy. Those of one base may share files, those of different ones do not.
    let next = AtomicUsize::new(0);
    let work = || {
        let mut wrong = Vec::new();
        while let Some((_, group)) = groups.get(next.fetch_add(1, Ordering::Relaxed)) {
            wrong.extend(wrong_rows(&data, group));
        }
        wrong
    };
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    let wrong: Vec<String> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        workers.into_iter().flat_map(|worker| worker.join().unwrap()).collect()
    });
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// What is wrong with rows of one base.
fn wrong_rows(data: &Data, group: &[(usize, &Case)]) -> Vec<String> {
    let mut bases: BTreeMap<String, Outcome> = BTreeMap::new();
    let mut wrong = Vec::new();
    for &(number, case) in group {
        let mut config = read(data, case.base, bases::text(case.base));
        for (pointer, value) in case.with {
            set(&mut config, pointer, data.placed(parsed(value)));
        }
        let before = bases
            .entry(format!("{:?}", case.with))
            .or_insert_with(|| run(data, &config, &format!("base-{number}")));
        let mut changed = config.clone();
        set(&mut changed, case.pointer, data.placed(parsed(case.value)));
        if config == changed {
            wrong.push(format!("{}: the base has {} already", case.setting, case.value));
            continue;
        }
        let after = run(data, &changed, &format!("case-{number}"));
        if let Err(problem) = case.effect.check(before, &after) {
            wrong.push(format!("{} = {}: {problem}", case.setting, case.value));
        }
    }
    wrong
}

impl Effect {
    fn check(self, before: &Outcome, after: &Outcome) -> Result<(), String> {
        if let Some(error) = &before.error {
            return Err(format!("the base itself fails: {error}"));
        }
        match (self, &after.error) {
            (Self::Refused(word), Some(error)) if error.contains(word) => return Ok(()),
            (Self::Refused(word), Some(error)) => return Err(format!("{word:?} not in: {error}")),
            (Self::Refused(_), None) => return Err("not refused".to_owned()),
            (_, Some(error)) => return Err(format!("refused: {error}")),
            (_, None) => {}
        }
        let same = |what: &str, same: bool, due: bool| match same == due {
            true => Ok(()),
            false => Err(format!("{what}: {}", if same { "no difference" } else { "differs" })),
        };
        let weights = before.weights == after.weights;
        match self {
            Self::Weights => same("weights", weights, false),
            Self::Measured => {
                same("weights", weights, true)?;
                same("measurements", before.measured == after.measured, false)
            }
            Self::Logged => {
                same("weights", weights, true)?;
                same("log", before.logged == after.logged, false)
            }
            Self::Files => {
                same("weights", weights, true)?;
                same("checkpoints", before.files == after.files, false)
            }
            Self::Recorded => {
                same("weights", weights, true)?;
                same("record", before.record == after.record, false)
            }
            Self::Nothing(_) => {
                same("weights", weights, true)?;
                same("measurements", before.measured == after.measured, true)
            }
            Self::Refused(_) => Ok(()),
        }
    }
}
