use super::report::SAME;
use super::*;

/// A few steps of every form: all of the machinery, without the hours.
#[test]
fn short_trainings_pass() {
    let folder = tempfile::tempdir().unwrap();
    let settings = StabilitySettings { steps: 3, seeds: vec![1], ..StabilitySettings::default() };
    let mut shares = Vec::new();
    let report = stability(&settings, folder.path(), &mut |_, share| {
        shares.push(share);
        true
    })
    .unwrap();
    assert_eq!((report.runs.len(), report.gradients.len(), report.failed), (24, 8, 0), "{report}");
    assert!(shares.is_sorted() && !report.stopped);
    for run in &report.runs {
        assert_eq!((run.steps, run.finite_steps, run.skipped), (3, 3, 0.0), "{run:?}");
        assert!(run.effective_rank.is_some() && run.centred_cosine.is_some(), "{run:?}");
    }
    // Not the same training again and again.
    let mut losses: Vec<String> = report.runs.iter().map(|run| run.last_loss.to_string()).collect();
    losses.sort();
    losses.dedup();
    assert!(losses.len() >= 20, "{report}");
    // Nor the same number: what is compared is computed otherwise.
    assert!(report.gradients.iter().any(|check| check.relative > 0.0), "{report}");
    // Training without labels has its own networks and views.
    let widths: Vec<usize> = report.runs.iter().skip(11).step_by(4).map(|run| run.width).collect();
    assert_eq!(widths, [64, 16, 32, 32], "{report}");
    let poison = report.poison.as_ref().unwrap();
    assert!(poison.named && poison.recovered, "{poison:?}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "files are left behind");
    let json = serde_json::to_string(&report).unwrap();
    let back: StabilityReport = serde_json::from_str(&json).unwrap();
    assert_eq!((back.runs.len(), back.failed), (24, 0));
}

#[test]
fn recipes_without_labels_are_other_trainings() {
    let folder = tempfile::tempdir().unwrap();
    let recipes = vec![StabilityRecipe::SelfDistillation, StabilityRecipe::SimDinoRows];
    let settings = StabilitySettings { steps: 2, seeds: vec![1], recipes };
    let report = stability(&settings, folder.path(), &mut |_, _| true).unwrap();
    assert_eq!((report.runs.len(), report.gradients.len(), report.failed), (8, 0, 0), "{report}");
    assert!(report.poison.is_none());
    let text = report.to_string();
    for name in ["self-distillation", "sim-dino-rows"] {
        assert!(text.contains(name) && !text.contains("language"), "{text}");
    }
    // Another term is another training.
    assert_ne!(report.runs[0].effective_rank, report.runs[4].effective_rank);
    assert!(report.runs.iter().all(|run| run.width == 32 && run.effective_rank.unwrap() >= 1.0));
}

fn run_of(steps: u64, losses: &[f64], idle: u64, rank: f64, alarms: &[&str]) -> StabilityRun {
    let setup = Setup {
        recipe: StabilityRecipe::LanguagePretraining,
        precision: Precision::F32,
        batches: Batches::Even,
        form: Form::Plain,
        seed: 1,
    };
    let alarms = alarms.iter().map(|a| (*a).to_owned()).collect();
    StabilityRun::new(&setup, steps, losses, idle, [Some(rank), Some(0.1)], alarms, None, 1.0)
}

/// Each thing that a training may fail by.
#[test]
fn what_goes_wrong_is_told() {
    let fine = vec![0.5; 1000];
    assert_eq!(run_of(1000, &fine, 4, 6.5, &[]).problem, None);
    let problem = |run: StabilityRun| run.problem.unwrap();
    let mut bad = fine.clone();
    bad[700] = f64::NAN;
    assert!(problem(run_of(1000, &bad, 0, 9.0, &[])).contains("999 of 1000 losses"));
    assert!(problem(run_of(1000, &fine[1..], 0, 9.0, &[])).contains("999 of 1000 losses"));
    assert!(problem(run_of(1000, &fine, 5, 9.0, &[])).contains("0.5 % of the steps"));
    assert!(problem(run_of(1000, &fine, 0, 6.3, &[])).contains("effective rank"));
    assert!(problem(run_of(1000, &fine, 0, f64::NAN, &[])).contains("effective rank"));
    assert!(problem(run_of(1000, &fine, 0, 9.0, &["rows are alike"])).contains("alike"));
    // Too early to tell.
    assert_eq!(run_of(100, &fine[..100], 0, 1.2, &[]).problem, None);
    assert_eq!(run_of(1, &[], 0, 1.2, &[]).finite_steps, 0);
    let fine = StabilitySettings { steps: 1, seeds: vec![1], ..StabilitySettings::default() };
    for nothing in [
        StabilitySettings { steps: 0, ..fine.clone() },
        StabilitySettings { seeds: Vec::new(), ..fine.clone() },
        StabilitySettings { recipes: Vec::new(), ..fine },
    ] {
        assert!(stability(&nothing, "nowhere".as_ref(), &mut |_, _| true).is_err());
    }
    // A gradient that is not divided is three times too long.
    assert!(gradients::distance(&[4.0, 8.0], &[1.0, 2.0]) > 2.9);
    assert!(gradients::distance(&[1.0, 2.0 + 1e-5], &[1.0, 2.0]) > SAME);
    assert!(gradients::distance(&[f64::NAN], &[1.0]).is_nan());
}

#[test]
fn it_stops_when_asked_to() {
    let folder = tempfile::tempdir().unwrap();
    let settings = StabilitySettings { steps: 4, seeds: vec![2], ..StabilitySettings::default() };
    let mut calls = 0;
    let report = stability(&settings, folder.path(), &mut |_, _| {
        calls += 1;
        calls < 6
    })
    .unwrap();
    // The first training was done, the second was not.
    assert!(report.stopped && report.runs.len() == 1 && report.poison.is_none(), "{report}");
}
