//! The operators on other instruction sets.

use super::{Args, run_cases};
use crate::bench::process::{end_with_parent, run_in_a_process};
use crate::progress::Progress;
use crate::terminal::write_text;
use anyhow::{Context, Result};
use scenesplat::kernels::simd::Isa;
use scenesplat_lab::doctor::{Case, Doctor, IsaReport, Level};
use std::path::Path;

/// The operators once more on each lower instruction set, each in a process of its own: it is chosen
/// once in a process.
pub(super) fn other_isas(
    args: &Args,
    scratch: &Path,
    progress: &Progress,
) -> Result<Vec<IsaReport>> {
    let lower = Isa::ALL.into_iter().filter(|isa| *isa < Isa::current());
    let asked = args.level.is_none_or(|level| level == Level::Operators);
    let mut reports = Vec::new();
    for isa in lower.filter(|_| asked) {
        progress.advance(&format!("operators on {}", isa.name()), 0.0);
        let file = scratch.join(format!("{}.json", isa.name()));
        let path = file.to_str().context("the scratch folder's name is no text")?;
        let threads = rayon::current_num_threads().to_string();
        let words = [
            "doctor",
            "--full",
            "--level",
            "operators",
            "--threads",
            &threads,
            "--operators-to",
            path,
        ];
        run_in_a_process(&words, &[("SCENESPLAT_ISA", isa.name())])
            .with_context(|| format!("operators on {}", isa.name()))?;
        reports.push(serde_json::from_slice(&std::fs::read(&file)?)?);
    }
    Ok(reports)
}

/// What such a process does.
pub(super) fn operators_to(path: &Path, cases: &[Case]) -> Result<()> {
    end_with_parent();
    // In the folder of whoever started this, who removes it.
    let doctor = Doctor::new(&path.with_extension("cases"))?;
    let verdicts = run_cases(&doctor, cases, &Progress::new(true))?;
    let report = IsaReport { isa: Isa::current().name().to_owned(), verdicts };
    write_text(path, &serde_json::to_string(&report)?)?;
    Ok(())
}
