//! What became of a case.

use super::case::{Case, Finding, Level, Policy};
use super::measures::{Bounds, Measures};
use serde::{Deserialize, Serialize};

/// What became of a case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Name of the case.
    pub name: String,
    /// Its level.
    pub level: Level,
    /// Its area.
    pub area: String,
    /// What was expected.
    pub policy: Policy,
    /// Whether that is what happened.
    pub passed: bool,
    /// Largest error; `None` if the case did not come so far, or the error is not a number.
    pub error: Option<f64>,
    /// What it may be.
    pub tolerance: f64,
    /// Why it may be that.
    pub reason: String,
    /// Where the case comes from.
    pub origin: String,
    /// What else was measured of an operator.
    pub measures: Measures,
    /// What those may come to.
    pub bounds: Bounds,
    /// The input with the largest error.
    pub worst: String,
    /// Why it did not pass.
    pub failure: Option<String>,
    /// How long it took.
    pub seconds: f64,
}

impl Verdict {
    /// Of what the check found, or why it failed.
    pub(super) fn new(
        case: &Case,
        finding: Option<Finding>,
        failure: Option<String>,
        seconds: f64,
    ) -> Self {
        // A NaN is at most nothing.
        let passes = |finding: &Finding| {
            finding.error <= case.tolerance && case.bounds().broken(&finding.measures).is_none()
        };
        let passed = finding.as_ref().is_some_and(passes);
        let too_far = || {
            let found = finding.as_ref().filter(|_| !passed)?;
            let (error, worst) = (found.error, &found.worst);
            if error <= case.tolerance {
                return case.bounds().broken(&found.measures);
            }
            Some(format!("an error of {error:.3e}, {:.1e} is allowed ({worst})", case.tolerance))
        };
        Self {
            name: case.name.clone(),
            level: case.level,
            area: case.area.clone(),
            policy: case.policy,
            passed,
            error: finding.as_ref().map(|f| f.error).filter(|e| e.is_finite()),
            tolerance: case.tolerance,
            reason: case.reason.clone(),
            origin: case.origin.clone(),
            measures: finding.as_ref().map(|f| f.measures).unwrap_or_default(),
            bounds: case.bounds(),
            failure: failure.or_else(too_far),
            worst: finding.map(|f| f.worst).unwrap_or_default(),
            seconds,
        }
    }
}
