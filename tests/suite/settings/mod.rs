//! Every setting of an experiment's file does something, and a run is resumed with the same settings only. The
//! list of settings comes from the program itself, so that a new one without a row here is a failure; each is
//! changed once, the run must differ as its row says, and resuming the unchanged run with it must be refused by
//! its name, unless it is one of those that may change.

mod bases;
mod known;
mod outcome;
mod resuming;
mod rows;
mod schema;
mod steps;

use bases::read;
pub use bases::{Data, text};
use known::{name_of, names_of, settings_of};
use outcome::{Outcome, outcome};
use rows::{Effect, Row, TABLES, Table};
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

/// A base with the values that a table of rows sets besides.
fn base_of(data: &Data, table: &Table) -> Value {
    let mut config = read(data, table.base);
    for (pointer, value) in table.with {
        set(&mut config, pointer, data.placed(parsed(value)));
    }
    config
}

#[test]
fn every_setting_has_a_row() {
    let data = Data::new();
    let known: BTreeSet<String> =
        bases::ALL.iter().flat_map(|(name, _)| settings_of(&read(&data, name))).collect();
    // A table that one base has and another leaves out is no setting itself.
    let inside = |name: &str| {
        let parts = [".", "(", "["].map(|next| format!("{name}{next}"));
        known.iter().any(|other| parts.iter().any(|part| other.starts_with(part)))
    };
    let known: BTreeSet<String> = known.iter().filter(|name| !inside(name)).cloned().collect();
    let names = |table: &Table| -> Vec<String> {
        let config = base_of(&data, table);
        let name = |row: &Row| name_of(&config, &format!("{}/{}", table.at, row.0));
        table.rows.iter().map(name).collect()
    };
    let rows: BTreeSet<String> = TABLES.iter().flat_map(names).collect();
    let missing: Vec<_> = known.difference(&rows).collect();
    assert!(missing.is_empty(), "settings without a row: {missing:#?}");
    let gone: Vec<_> = rows.difference(&known).collect();
    assert!(gone.is_empty(), "rows of settings that are not there: {gone:#?}");
}

#[test]
fn every_choice_is_in_a_base() {
    let data = Data::new();
    let bases: Vec<Value> = bases::ALL.iter().map(|(name, _)| read(&data, name)).collect();
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
fn one_setting_in_eight_does_what_its_row_says() {
    check_rows(8);
}

#[test]
#[ignore = "trains 400 networks for a minute; .ci/optional runs it"]
fn every_setting_does_what_its_row_says() {
    check_rows(1);
}

/// Checks one row in `step`.
fn check_rows(step: usize) {
    let data = Data::new();
    // Something to start from.
    let first = read(&data, "language");
    assert_eq!(outcome(&data, &first, "first", false).error, None);
    std::fs::rename(data.path().join("first/model"), data.path().join("init")).unwrap();
    let mut groups: BTreeMap<&str, Vec<&Table>> = BTreeMap::new();
    TABLES.iter().for_each(|table| groups.entry(table.base).or_default().push(table));
    let mut groups: Vec<Vec<&Table>> = groups.into_values().collect();
    groups.sort_by_key(|tables| {
        std::cmp::Reverse(tables.iter().map(|t| t.rows.len()).sum::<usize>())
    });
    // Runs this small keep one core busy. Those of one base may share files, those of different ones do not.
    let next = AtomicUsize::new(0);
    let work = || {
        let mut wrong = Vec::new();
        while let Some(tables) = groups.get(next.fetch_add(1, Ordering::Relaxed)) {
            wrong.extend(wrong_rows(&data, tables, step));
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
fn wrong_rows(data: &Data, tables: &[&Table], step: usize) -> Vec<String> {
    let mut bases: BTreeMap<String, (String, Outcome)> = BTreeMap::new();
    let (mut wrong, mut number) = (Vec::new(), 0);
    for table in tables {
        let rows: Vec<(usize, &Row)> =
            (number..).zip(table.rows).filter(|(number, _)| number % step == 0).collect();
        number += table.rows.len();
        if rows.is_empty() {
            continue;
        }
        let config = base_of(data, table);
        let (base, before) = bases.entry(format!("{:?}", table.with)).or_insert_with(|| {
            let name = format!("{}-base-{number}", table.base);
            let before = outcome(data, &config, &name, false);
            (name, before)
        });
        for (number, (field, value, effect)) in rows {
            let pointer = format!("{}/{field}", table.at);
            let mut changed = config.clone();
            set(&mut changed, &pointer, data.placed(parsed(value)));
            let after = outcome(data, &changed, &format!("{}-{number}", table.base), false);
            let mut problem = effect.check(before, &after).err();
            if config == changed {
                problem = Some("the base has it already".to_owned());
            } else if problem.is_none() && after.error.is_none() {
                problem = resuming::check(data, base, &changed, &pointer).err();
            }
            if let Some(problem) = problem {
                wrong.push(format!("{pointer} = {value}: {problem}"));
            }
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
        let weights = before.weights == after.weights;
        if weights == matches!(self, Self::Weights) {
            return Err(format!("weights: {}", if weights { "no difference" } else { "differ" }));
        }
        let measured = before.measured == after.measured;
        let as_due = match self {
            Self::Measured => !measured,
            Self::Logged => before.logged != after.logged,
            Self::Files => before.files != after.files,
            Self::Recorded => before.record != after.record,
            Self::Nothing(_) => measured,
            Self::Weights | Self::Refused(_) => true,
        };
        if as_due { Ok(()) } else { Err("no other difference, or one too many".to_owned()) }
    }
}
