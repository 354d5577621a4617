//! What was computed here for a device that has no kernel for it.
//!
//! A network on a graphics processor may meet an operation that only the processor knows. It runs here then,
//! on values that were copied to and fro, which is right but slow; so it is counted, by the name of the
//! operation and of its pass, and a program can say it. The count is one for the whole process.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The passes of an operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Pass {
    /// From inputs to outputs.
    Forward,
    /// From gradients of outputs to those of inputs.
    Backward,
}

/// How often one pass of one operation was computed here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Fallback {
    /// Name of the operation.
    pub operation: &'static str,
    /// Which of its passes.
    pub pass: Pass,
    /// How often.
    pub times: u64,
}

static COUNTS: Mutex<BTreeMap<(&'static str, Pass), u64>> = Mutex::new(BTreeMap::new());

fn counts() -> MutexGuard<'static, BTreeMap<(&'static str, Pass), u64>> {
    COUNTS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Counts one pass.
pub fn count(operation: &'static str, pass: Pass) {
    *counts().entry((operation, pass)).or_default() += 1;
}

/// All that was counted so far, sorted by name.
pub fn counted() -> Vec<Fallback> {
    let counts = counts();
    let row = |(&(operation, pass), &times): (&(&'static str, Pass), &u64)| Fallback {
        operation,
        pass,
        times,
    };
    counts.iter().map(row).collect()
}

/// As [`counted`]; the count begins anew.
pub fn take() -> Vec<Fallback> {
    let found = std::mem::take(&mut *counts());
    let row = |((operation, pass), times)| Fallback { operation, pass, times };
    found.into_iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_are_counted_by_name() {
        for _ in 0..3 {
            count("fallback test b", Pass::Forward);
        }
        count("fallback test a", Pass::Backward);
        let own = |list: Vec<Fallback>| -> Vec<(&'static str, Pass, u64)> {
            let own = list.into_iter().filter(|f| f.operation.starts_with("fallback test"));
            own.map(|f| (f.operation, f.pass, f.times)).collect()
        };
        let all =
            vec![("fallback test a", Pass::Backward, 1), ("fallback test b", Pass::Forward, 3)];
        assert_eq!(own(counted()), all);
        assert_eq!(own(take()), all);
        assert_eq!(own(counted()), []);
    }
}
