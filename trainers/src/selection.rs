//! Which measurement decides.

use crate::TrainError;
use scenesplat_metrics::Measurement;
use serde::{Deserialize, Serialize};
use std::fmt;

/// The measurement that says which of two states of a network is better: one by its full name, such
/// as `"unseen/f-mIoU"`, or the mean of several (a list of names).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Criterion {
    /// One measurement.
    One(String),
    /// The mean of several.
    Mean(Vec<String>),
}

impl Criterion {
    /// The measurements it is made of.
    pub fn names(&self) -> &[String] {
        match self {
            Self::One(name) => std::slice::from_ref(name),
            Self::Mean(names) => names,
        }
    }

    /// Its value; `None` if one of its measurements is not among those found.
    pub fn value(&self, found: &[Measurement]) -> Option<f64> {
        let of = |name: &String| found.iter().find(|m| &m.name == name).map(|m| m.value);
        let sum: f64 = self.names().iter().map(of).sum::<Option<f64>>()?;
        Some(sum / self.names().len() as f64)
    }

    /// Checks that there are such measurements. `setting`: where the names stand.
    ///
    /// # Errors
    /// Names the first that nobody gives, and those that exist; or that the list is empty.
    pub fn check(&self, setting: &'static str, known: &[String]) -> Result<(), TrainError> {
        let unknown = |name: &str| TrainError::UnknownMeasurement {
            setting,
            name: name.to_owned(),
            known: known.to_vec(),
        };
        if self.names().is_empty() {
            return Err(unknown(""));
        }
        match self.names().iter().find(|name| !known.contains(name)) {
            Some(name) => Err(unknown(name)),
            None => Ok(()),
        }
    }
}

impl From<&str> for Criterion {
    fn from(name: &str) -> Self {
        Self::One(name.to_owned())
    }
}

impl From<String> for Criterion {
    fn from(name: String) -> Self {
        Self::One(name)
    }
}

impl fmt::Display for Criterion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::One(name) => f.write_str(name),
            Self::Mean(names) => write!(f, "mean of {}", names.join(", ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_needs_all_its_parts() {
        let found = [Measurement::new("a/x", 1.0), Measurement::new("b/x", 4.0)];
        let mean = |names: &[&str]| Criterion::Mean(names.iter().map(|n| (*n).into()).collect());
        assert_eq!(mean(&["a/x", "b/x"]).value(&found), Some(2.5));
        assert_eq!(mean(&["a/x", "c/x"]).value(&found), None);
        assert_eq!(Criterion::from("b/x").value(&found), Some(4.0));
        let known = ["a/x".to_owned(), "b/x".to_owned()];
        mean(&["a/x", "b/x"]).check("best", &known).unwrap();
        let error = mean(&["a/x", "a/y"]).check("best", &known).unwrap_err().to_string();
        assert!(error.contains("\"a/y\"") && error.contains("a/x, b/x"), "{error}");
        assert!(mean(&[]).check("best", &known).is_err());
    }
}
