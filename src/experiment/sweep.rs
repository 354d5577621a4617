//! Trainings that differ in some settings, and what came of each.

use super::ExperimentError;
use super::curves::{LOSS, values_of};
use scenesplat_trainers::CheckpointConfig;
use scenesplat_trainers::callbacks::LoggedValue;

type Result<T, E = ExperimentError> = std::result::Result<T, E>;

/// Most trainings of a sweep.
const MOST_RUNS: usize = 1000;
/// Longest name of a run's folder.
const LONGEST_NAME: usize = 80;

/// The values that a setting takes in a sweep.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SweepAxis {
    /// The setting, such as `optimizer.lr`.
    pub key: String,
    /// Its values as TOML, in order; at least one.
    pub values: Vec<String>,
}

impl SweepAxis {
    /// Reads `optimizer.lr=[1e-3, 3e-4]`.
    ///
    /// # Errors
    /// Without `=`, a list, or a value in it; or if a value stands there twice.
    pub fn parse(text: &str) -> Result<Self> {
        let wrong = |problem: &str| ExperimentError::setting(text, problem.to_owned());
        let form = "expected KEY=[VALUE, VALUE], as in optimizer.lr=[1e-3, 3e-4]";
        let (key, list) = text.split_once('=').ok_or_else(|| wrong(form))?;
        let table = format!("value = {list}").parse::<toml::Table>();
        let values = match table.ok().and_then(|mut table| table.remove("value")) {
            Some(toml::Value::Array(values)) if !values.is_empty() => values,
            _ => return Err(wrong(form)),
        };
        let values: Vec<String> = values.iter().map(toml::Value::to_string).collect();
        let again = (1..values.len()).find(|&i| values[..i].contains(&values[i]));
        match again {
            Some(i) => Err(wrong(&format!("{} stands there twice", values[i]))),
            None => Ok(Self { key: key.trim().to_owned(), values }),
        }
    }
}

/// The changes of each training: every combination of the values, those of the last setting change first.
///
/// # Errors
/// If a setting is swept twice, or there are more than a thousand combinations.
pub fn combinations(axes: &[SweepAxis]) -> Result<Vec<Vec<String>>> {
    let again = (1..axes.len()).find(|&i| axes[..i].iter().any(|axis| axis.key == axes[i].key));
    if let Some(i) = again {
        let problem = "is swept twice; give its values in one list".to_owned();
        return Err(ExperimentError::setting(&axes[i].key, problem));
    }
    let runs = axes.iter().try_fold(1, |n: usize, axis| n.checked_mul(axis.values.len()));
    if runs.is_none_or(|runs| runs > MOST_RUNS) {
        let keys: Vec<&str> = axes.iter().map(|axis| axis.key.as_str()).collect();
        let problem = format!("more than {MOST_RUNS} trainings; give fewer values");
        return Err(ExperimentError::setting(keys.join(", "), problem));
    }
    let mut all = vec![Vec::new()];
    for SweepAxis { key, values } in axes {
        let longer = |changes: &Vec<String>| {
            let with = |value| [&changes[..], &[format!("{key}={value}")]].concat();
            values.iter().map(with).collect::<Vec<_>>()
        };
        all = all.iter().flat_map(longer).collect();
    }
    Ok(all)
}

/// The folder of a training inside that of the sweep: its number from 1, and what it changes.
pub fn folder_name(number: usize, changes: &[String]) -> String {
    let short = |change: &String| {
        let (key, value) = change.split_once('=').unwrap_or((change, ""));
        format!("-{}={value}", key.rsplit('.').next().unwrap_or(key))
    };
    let safe = |c: char| c.is_ascii_alphanumeric() || "._=-".contains(c);
    let name: String = changes.iter().map(short).collect();
    let name = format!("{number:03}{}", name.replace('"', ""));
    name.chars().map(|c| if safe(c) { c } else { '_' }).take(LONGEST_NAME).collect()
}

/// What came of a training, from its log.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RunOutcome {
    /// The last loss.
    pub loss: Option<f64>,
    /// The best value of the measurement that selects the best checkpoint, and the step that it was measured at.
    pub best: Option<(f64, u64)>,
}

impl RunOutcome {
    /// From what was logged.
    pub(super) fn of(log: &[LoggedValue], selection: &CheckpointConfig) -> Self {
        let values = selection.best.as_ref().map(|best| values_of(log, best)).unwrap_or_default();
        let sign = if selection.smaller_is_better { -1.0 } else { 1.0 };
        // Of equals the first, as the trainer keeps it.
        let better = |a: (f64, u64), b: (f64, u64)| if sign * b.0 > sign * a.0 { b } else { a };
        let last = log.iter().rev().find(|value| value.name == LOSS);
        Self {
            loss: last.map(|value| value.value),
            best: values
                .into_iter()
                .map(|(step, value)| (value, step))
                .filter(|(value, _)| value.is_finite())
                .reduce(better),
        }
    }
}

/// Place of the best of some outcomes: by the measurement that selects, else by the last loss. `None` without either.
pub fn best_of(selection: &CheckpointConfig, outcomes: &[Option<&RunOutcome>]) -> Option<usize> {
    let score = |outcome: &RunOutcome| match (&selection.best, outcome.best, outcome.loss) {
        (Some(_), best, _) if selection.smaller_is_better => best.map(|(value, _)| -value),
        (Some(_), best, _) => best.map(|(value, _)| value),
        (None, _, loss) => loss.filter(|loss| loss.is_finite()).map(|loss| -loss),
    };
    let scored = (outcomes.iter().enumerate())
        .filter_map(|(i, outcome)| Some((i, outcome.and_then(score)?)));
    // Of equals the first.
    scored.reduce(|a, b| if b.1 > a.1 { b } else { a }).map(|(i, _)| i)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_combination_once_the_last_setting_first() {
        let axes = ["a.b=[1, 2]", "c = [\"x\", true]"].map(|text| SweepAxis::parse(text).unwrap());
        let all = combinations(&axes).unwrap();
        let expected =
            [["a.b=1", "c=\"x\""], ["a.b=1", "c=true"], ["a.b=2", "c=\"x\""], ["a.b=2", "c=true"]];
        assert_eq!(all, expected);
        assert_eq!(folder_name(3, &all[2]), "003-b=2-c=x");
        assert_eq!(folder_name(12, &["p/../q=\"a b\"".to_owned()]), "012-_q=a_b");
        assert!(folder_name(1, &["k=".to_owned() + &"v".repeat(300)]).len() <= LONGEST_NAME);
    }

    #[test]
    fn lists_that_are_none_are_refused() {
        for (text, part) in [
            ("lr", "KEY=[VALUE"),
            ("lr=1e-3", "KEY=[VALUE"),
            ("lr=[]", "KEY=[VALUE"),
            ("lr=[1,", "KEY=[VALUE"),
            ("lr=[1, 2, 1]", "1 stands there twice"),
        ] {
            let error = SweepAxis::parse(text).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
        let axis = |key: &str, n: usize| SweepAxis {
            key: key.to_owned(),
            values: (0..n).map(|i| i.to_string()).collect(),
        };
        assert!(combinations(&[axis("a", 2), axis("a", 2)]).is_err());
        assert!(combinations(&[axis("a", 40), axis("b", 40)]).is_err());
        assert_eq!(combinations(&[axis("a", 40), axis("b", 25)]).unwrap().len(), 1000);
    }

    #[test]
    fn the_best_is_what_the_trainer_selects_by() {
        let outcome = |best: Option<f64>, loss: f64| {
            Some(RunOutcome { loss: Some(loss), best: best.map(|v| (v, 5)) })
        };
        let best_of = |selection: &CheckpointConfig, found: &[Option<RunOutcome>]| {
            super::best_of(selection, &found.iter().map(Option::as_ref).collect::<Vec<_>>())
        };
        let mut selection = CheckpointConfig::default();
        let found =
            [outcome(Some(0.2), 3.0), None, outcome(Some(0.5), 4.0), outcome(Some(0.5), 1.0)];
        selection.best = Some("zero_shot/f-mIoU".into());
        assert_eq!(best_of(&selection, &found), Some(2));
        selection.smaller_is_better = true;
        assert_eq!(best_of(&selection, &found), Some(0));
        selection.best = None;
        assert_eq!(best_of(&selection, &found), Some(3));
        assert_eq!(best_of(&selection, &[None, outcome(None, f64::NAN)]), None);
    }

    #[test]
    fn of_a_log_the_first_best_value_and_the_last_loss_count() {
        let value =
            |step, name: &str, value| LoggedValue { step, epoch: 0, name: name.to_owned(), value };
        let log = [
            value(1, LOSS, 3.0),
            value(1, "a/x", 0.5),
            value(2, "a/x", f64::NAN),
            value(3, "a/x", 0.9),
            value(3, "b/x", 0.1),
            value(4, "a/x", 0.9),
            value(4, LOSS, 2.0),
        ];
        let of = |best: Option<&str>, smaller_is_better| {
            let best = best.map(Into::into);
            RunOutcome::of(
                &log,
                &CheckpointConfig { best, smaller_is_better, ..CheckpointConfig::default() },
            )
        };
        assert_eq!(of(Some("a/x"), false), RunOutcome { loss: Some(2.0), best: Some((0.9, 3)) });
        assert_eq!(of(Some("a/x"), true).best, Some((0.5, 1)));
        assert_eq!((of(None, false).best, of(Some("c/x"), false).best), (None, None));
        assert_eq!(RunOutcome::of(&[], &CheckpointConfig::default()), RunOutcome::default());
    }
}
