//! The catalogue of hard cases: what it says of itself holds, every case passes, and a wrong operator
//! is seen.

use scenesplat_lab::doctor::{
    Case, Doctor, DoctorReport, Failure, Finding, IsaReport, Level, Policy, Surroundings, Verdict,
    catalogue, nearest_names,
};
use std::collections::BTreeSet;

/// What the documentation claims, see `docs/hard_cases.md`.
const LEAST: usize = 417;

#[test]
fn the_table_is_whole() {
    let cases = catalogue();
    assert!(cases.len() >= LEAST, "{} cases", cases.len());
    let names: BTreeSet<&str> = cases.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names.len(), cases.len(), "two cases have the same name");
    for case in &cases {
        let Case { name, area, origin, policy, tolerance, reason, .. } = case;
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        assert!(name.chars().all(plain), "{name}");
        assert!(!area.is_empty() && origin.len() > 10 && reason.len() > 10, "{name}");
        assert!(tolerance.is_finite() && (0.0..=0.15).contains(tolerance), "{name}: {tolerance}");
        assert!(*policy != Policy::Refused || *tolerance == 0.0, "{name}: a refusal is no number");
    }
    for level in Level::ALL {
        let quick = cases.iter().filter(|c| c.level == level && c.quick).count();
        assert!(quick > 0, "no quick case of level {level}");
    }
}

/// An attack without a case or a test is none that is kept off.
#[test]
fn every_attack_is_a_case_or_a_test() {
    let names: BTreeSet<String> = catalogue().into_iter().map(|case| case.name).collect();
    let root = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let text = std::fs::read_to_string(root.join("docs/hard_cases.md")).unwrap();
    let (_, table) = text
        .split_once(
            "| attempt | what it did | cases | tests |
|---|---|---|---|
",
        )
        .unwrap();
    assert!(table.lines().count() >= 13, "attacks are missing");
    for line in table.lines() {
        let cells: Vec<&str> = line.trim_matches('|').split(" | ").collect();
        let [attempt, harm, cases, tests] = cells[..] else { panic!("{line}") };
        assert!(!harm.trim().is_empty(), "{attempt}: what it did");
        let quoted = |cell: &'_ str| -> Vec<String> {
            cell.split('`').skip(1).step_by(2).map(str::to_owned).collect()
        };
        let (cases, tests) = (quoted(cases), quoted(tests));
        assert!(!cases.is_empty() || !tests.is_empty(), "{attempt}: nothing tries it");
        for case in cases {
            assert!(names.contains(&case), "{attempt}: no case {case}");
        }
        for test in tests {
            let (file, function) = test.split_once("::").unwrap();
            let text = std::fs::read_to_string(root.join(file)).unwrap();
            assert!(
                text.contains(&format!(
                    "]
fn {function}("
                )),
                "{attempt}: no test {test}"
            );
        }
    }
}

/// Runs cases, and tells which failed and why.
fn run(cases: impl Iterator<Item = Case>) -> Vec<Verdict> {
    let folder = tempfile::tempdir().unwrap();
    let doctor = Doctor::new(folder.path()).unwrap();
    let verdicts: Vec<Verdict> = cases.map(|case| doctor.run(&case)).collect();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "files are left behind");
    verdicts
}

fn all_pass(level: Level) {
    let verdicts = run(catalogue().into_iter().filter(|case| case.level == level));
    let failed: Vec<String> = verdicts
        .iter()
        .filter(|v| !v.passed)
        .map(|v| format!("{}: {}", v.name, v.failure.as_deref().unwrap_or_default()))
        .collect();
    assert!(failed.is_empty(), "{} failed:\n{}", failed.len(), failed.join("\n"));
}

#[test]
fn inputs_pass() {
    all_pass(Level::Inputs);
}

#[test]
fn operators_pass() {
    all_pass(Level::Operators);
}

#[test]
fn trainings_pass() {
    all_pass(Level::Training);
}

#[test]
fn scenes_pass() {
    all_pass(Level::Scenes);
}

/// An operator that is wrong, in each of the ways that there are to be wrong.
#[test]
fn a_wrong_operator_is_seen() {
    let product = |wrong: fn(usize, &mut f32)| {
        let mut case = {
            Case::new("planted", Level::Operators, move |trial| {
                let a: Vec<f32> = (0..64).map(|i| (i as f32 * 0.7).sin()).collect();
                let got = trial.one_and_many(|| {
                    let mut out: Vec<f32> = a.iter().map(|v| v * v).collect();
                    out.iter_mut().enumerate().for_each(|(i, v)| wrong(i, v));
                    Ok(out)
                })?;
                let mut found = Finding::right();
                for (i, (got, a)) in got.iter().zip(&a).enumerate() {
                    let want = f64::from(*a) * f64::from(*a);
                    let error = (f64::from(*got) - want).abs() / want.max(1e-30);
                    found.add(error, || format!("square {i}"));
                }
                Ok(found)
            })
        };
        case.tolerance = 1e-5;
        case
    };
    let verdict = |wrong: fn(usize, &mut f32)| run(std::iter::once(product(wrong))).remove(0);
    assert!(verdict(|_, _| {}).passed, "the right operator passes");
    let slightly = verdict(|i, v| {
        if i == 17 {
            *v *= 1.0 + 1e-4;
        }
    });
    assert!(!slightly.passed && slightly.worst.contains("square 17"), "{slightly:?}");
    assert!(slightly.failure.unwrap().contains("is allowed"));
    let nan = verdict(|i, v| {
        if i == 63 {
            *v = f32::NAN;
        }
    });
    assert!(!nan.passed && nan.error.is_none(), "{nan:?}");
    let infinite = verdict(|i, v| {
        if i == 3 {
            *v = f32::INFINITY;
        }
    });
    assert!(!infinite.passed, "{infinite:?}");
    let threads = verdict(|_, v| *v += rayon::current_num_threads() as f32 * 1e-9);
    assert!(!threads.passed && threads.failure.unwrap().contains("depend on threads"));
    let panicked = verdict(|i, _| assert!(i < 9, "row {i} is too much"));
    assert!(panicked.failure.unwrap().contains("row 9 is too much"), "the panic's text is told");
}

#[test]
fn reports_count_and_name() {
    let good = || Case::new("good", Level::Inputs, |_| Ok(Finding::right()));
    let bad = || {
        Case::new("bad", Level::Scenes, |_| {
            Err::<(), _>(Failure("a roof without a house".to_owned()))
        })
    };
    let report = |cases: Vec<Case>| {
        DoctorReport::new(Surroundings::detect(2), run(cases.into_iter()), Vec::new(), 1.5)
    };
    let whole = report(vec![good(), good()]);
    assert_eq!((whole.cases, whole.passed, whole.failed), (2, 2, 0));
    let half = report(vec![good(), bad()]);
    assert_eq!((half.cases, half.passed, half.failed), (2, 1, 1));
    let text = half.to_string();
    assert!(text.contains("FAILED bad") && text.contains("a roof without a house"), "{text}");
    assert!(text.ends_with("2 cases, 1 passed, 1 failed, 1.5 s"), "{text}");
    // Failing elsewhere is failing.
    let mut renamed = bad();
    renamed.name = "good".to_owned();
    let elsewhere =
        IsaReport { isa: "portable".to_owned(), verdicts: run(std::iter::once(renamed)) };
    let own = run(std::iter::once(good()));
    let report = DoctorReport::new(Surroundings::detect(2), own, vec![elsewhere], 1.0);
    assert_eq!((report.cases, report.passed, report.failed), (1, 0, 1));
    let json = serde_json::to_value(&report).unwrap();
    let back: DoctorReport = serde_json::from_value(json).unwrap();
    assert_eq!(back, report);
}

#[test]
fn names_that_are_nearly_right_are_found() {
    assert_eq!(nearest_names("ply-quat-w-zer")[0], "ply-quat-w-zero");
    assert!(nearest_names("product f32 huge").contains(&"product-f32-huge".to_owned()));
}
