//! Why a called command failed, for a caller with exceptions of its own.

use crate::error::WrongUse;
use scenesplat::inference::EncodeError;
use std::io;

/// What kind of failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FailureKind {
    /// What was asked for does not fit together.
    WrongUse,
    /// The caller stopped it.
    Stopped,
    /// A file is not there.
    NotFound,
    /// Anything else.
    Other,
}

/// Why a command failed, in the words of the program.
#[derive(Debug, thiserror::Error)]
#[error("{text}")]
pub struct Failure {
    /// What kind.
    pub kind: FailureKind,
    /// The error with its causes.
    pub text: String,
}

impl Failure {
    /// Of any error with its causes.
    pub fn of(error: impl Into<anyhow::Error>) -> Self {
        let error = error.into();
        let is_stop = |e: &EncodeError| matches!(e, EncodeError::Stopped);
        let kind = if error.downcast_ref::<WrongUse>().is_some() {
            FailureKind::WrongUse
        } else if error.chain().any(|e| e.downcast_ref().is_some_and(is_stop)) {
            FailureKind::Stopped
        } else if error.chain().any(is_missing) {
            FailureKind::NotFound
        } else {
            FailureKind::Other
        };
        Self { kind, text: format!("{error:#}") }
    }
}

fn is_missing(error: &(dyn std::error::Error + 'static)) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|e| e.kind() == io::ErrorKind::NotFound)
}

/// What clap says about flags, without how they are used.
pub fn from_usage(error: &clap::Error) -> anyhow::Error {
    let text = error.render().to_string();
    let text = text.split("\n\n").next().unwrap_or_default();
    let lines = text.lines().map(str::trim).collect::<Vec<_>>().join(" ");
    WrongUse(lines.strip_prefix("error: ").unwrap_or(&lines).to_owned()).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    #[test]
    fn kinds_are_told_by_the_error_and_its_causes() {
        let missing = io::Error::from(io::ErrorKind::NotFound);
        let stopped: anyhow::Result<()> = Err(EncodeError::Stopped).context("--max-memory");
        let cases = [
            (Failure::of(WrongUse("--k".to_owned())), FailureKind::WrongUse),
            (Failure::of(stopped.unwrap_err()), FailureKind::Stopped),
            (Failure::of(anyhow::Error::from(missing).context("a.ply")), FailureKind::NotFound),
            (Failure::of(anyhow::anyhow!("else")), FailureKind::Other),
        ];
        for (failure, kind) in cases {
            assert_eq!(failure.kind, kind, "{failure}");
        }
    }
}
