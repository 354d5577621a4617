//! What must not change the result: the reference again with other threads, memory limits and
//! instruction sets.

use super::campaign::{Beside, Campaign, Labels, reference_folder};
use crate::error::WrongUse;
use anyhow::Result;
use scenesplat::kernels::simd::Isa;
use scenesplat::memory::Bytes;
use scenesplat_lab::pareto::{Kind, Neutral, Record, Records};
use std::path::Path;

/// Repeats of a row: its time is shown, not compared.
pub(super) const REPEATS: usize = 1;
/// Least agreement of another instruction set: sums are rounded in another order, and a Gaussian
/// between two classes may take the other.
const OTHER_ISA: f64 = 0.999;
/// Least agreement of tiles: attention reaches further than any halo.
const TILES: f64 = 0.97;

/// The rows of a grid, each with its name.
pub fn rows(neutral: &Neutral) -> Result<Vec<(String, Beside)>> {
    let mut rows = Vec::new();
    for &threads in &neutral.threads {
        let beside = Beside { threads: Some(threads), ..Beside::default() };
        rows.push((format!("threads={threads}"), beside));
    }
    for limit in &neutral.max_memory {
        limit.parse::<Bytes>().map_err(|e| WrongUse(format!("neutral.max_memory: {e}")))?;
        let beside = Beside { max_memory: Some(limit.clone()), ..Beside::default() };
        rows.push((format!("max_memory={limit}"), beside));
    }
    for isa in isas(&neutral.isa)? {
        let beside = Beside { isa: Some(isa.name().to_owned()), ..Beside::default() };
        rows.push((format!("isa={}", isa.name()), beside));
    }
    Ok(rows)
}

/// The instruction sets that this processor has, of those named.
fn isas(names: &[String]) -> Result<Vec<Isa>> {
    let mut found = Vec::new();
    for name in names {
        let here = |isa: &Isa| *isa <= Isa::current();
        if name == "all" {
            found.extend(Isa::ALL.into_iter().filter(here));
            continue;
        }
        let isa = Isa::ALL.into_iter().find(|isa| isa.name() == name);
        let isa = isa.ok_or_else(|| {
            let known = Isa::ALL.map(Isa::name).join(", ");
            WrongUse(format!("neutral.isa: {name:?} is none of {known}, all"))
        })?;
        // What the processor lacks cannot be tried.
        found.extend(Some(isa).filter(here));
    }
    Ok(found)
}

/// Measures the rows that are not in the records.
pub fn complete(
    campaign: &Campaign<'_>,
    rows: &[(String, Beside)],
    records: &mut Records,
    out: &Path,
) -> Result<()> {
    let reference = &campaign.grid.reference;
    let name = reference.to_string();
    for (neutral, beside) in rows {
        for set in campaign.sets {
            if records.find(Kind::Neutral, &name, Some(neutral), &set.name).is_some() {
                continue;
            }
            let folder = reference_folder(out, set);
            let labels = Labels { folder: Some(&folder), keep: false };
            let mut record = campaign.measure(reference, set, REPEATS, beside, labels)?.setting;
            let known = records.find(Kind::Setting, &name, None, &set.name);
            let equal = known.is_some_and(|k| k.prediction_hash == record.prediction_hash);
            judge(&mut record, neutral, equal, beside);
            campaign.say(&record);
            records.append(record)?;
        }
    }
    Ok(())
}

/// Notes the rule that a row is held to, and whether it holds.
fn judge(record: &mut Record, neutral: &str, equal: bool, beside: &Beside) {
    let cut = record.per_scene.iter().any(|scene| scene.tiles > scene.passes);
    let least = match beside {
        Beside { isa: Some(isa), .. } if isa != Isa::current().name() => Some(OTHER_ISA),
        Beside { max_memory: Some(_), .. } if cut => Some(TILES),
        _ => None,
    };
    record.kind = Kind::Neutral;
    record.changes_result = Some(false);
    record.neutral = Some(neutral.to_owned());
    record.rule = Some(least.map_or("equal".to_owned(), |share| format!("agreement >= {share}")));
    let agrees = |share| record.agreement.is_some_and(|own| own >= share);
    record.holds = Some(equal || least.is_some_and(agrees));
}
