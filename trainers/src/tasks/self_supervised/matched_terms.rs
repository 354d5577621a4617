//! Terms of rows of a coarse scale that are matched between views by their places.

use super::centers::Centers;
use super::config::{MatchedRows, SelfDistillationTerm, SimDinoRowsTerm};
use super::heads::{Head, level_of};
use super::matching::{Places, matched, same_cells};
use super::step::{Seen, Step, TermOutput};
use candle_core::{Result, Tensor};
use scenesplat_datasets::ViewKind;
use scenesplat_losses::self_supervised::{masked_cross_entropy, sim_dino_rows};

/// Rows of a student's view and their partners in a view of the teacher.
struct Pair {
    /// What the pair counts.
    share: f64,
    view: usize,
    with: usize,
    is_local: bool,
    rows: Vec<u32>,
    partners: Vec<u32>,
}

/// All pairs with a share that match somewhere, view by view of the student.
fn pairs(matching: &MatchedRows, step: &Step<'_>, level: usize) -> Result<Vec<Pair>> {
    let globals = step.teacher.len();
    let [same, cross, local] = matching.shares;
    let locals = step.views.len() - globals;
    // A pass numbers the rows of its scales by the curve it drew first, so each has places of its own.
    let all = |seen: &[Seen]| -> Result<Vec<Places>> {
        let each = seen.iter().zip(step.views);
        each.map(|(seen, view)| Places::new(view, &seen.levels, level)).collect()
    };
    let (own, teachers) = (all(step.student)?, all(step.teacher)?);
    let mut pairs = Vec::new();
    for (view, shown) in step.views.iter().enumerate() {
        let is_local = shown.kind == ViewKind::Local;
        let with: Vec<(f64, usize)> = if is_local {
            vec![(local / locals as f64, 0)]
        } else {
            let others = (0..globals).filter(|other| *other != view);
            let cross = cross / (globals * (globals - 1)) as f64;
            let same = (same / globals as f64, view);
            std::iter::once(same).chain(others.map(|other| (cross, other))).collect()
        };
        for (share, with) in with.into_iter().filter(|(share, _)| *share > 0.0) {
            let (rows, partners) = if view == with {
                same_cells(&step.student[view].levels, &step.teacher[with].levels, level)?
            } else {
                matched(&own[view], &teachers[with], matching.max_distance)?
            };
            if !rows.is_empty() {
                pairs.push(Pair { share, view, with, is_local, rows, partners });
            }
        }
    }
    Ok(pairs)
}

/// A function of the rows of views, computed at the first use of each.
struct Outputs<'a, F> {
    seen: &'a [Seen],
    of: F,
    views: Vec<[Option<Tensor>; 2]>,
}

impl<'a, F: Fn(&Seen, bool) -> Result<Tensor>> Outputs<'a, F> {
    fn new(seen: &'a [Seen], of: F) -> Self {
        Self { seen, of, views: vec![[None, None]; seen.len()] }
    }

    fn rows(&mut self, view: usize, is_local: bool, rows: Vec<u32>) -> Result<Tensor> {
        let slot = &mut self.views[view][usize::from(is_local)];
        let all = match slot {
            Some(known) => known,
            None => slot.insert((self.of)(&self.seen[view], is_local)?),
        };
        all.index_select(&Tensor::new(rows, all.device())?, 0)
    }
}

/// The teacher's distribution over prototypes.
pub(super) fn self_distillation(
    term: &SelfDistillationTerm,
    [own, other]: [&Head; 2],
    step: &Step<'_>,
    centers: &Centers,
) -> Result<TermOutput> {
    let scales = step.student.first().map_or(0, |seen| seen.levels.encoder().len());
    let matching = term.matching();
    let level = level_of("self_distillation", scales, matching.up_cast)?;
    let logits =
        |head: &Head, seen: &Seen, local| head.of_view(&seen.levels.up_cast(level)?, local);
    let mut students = Outputs::new(step.student, |seen, local| logits(own, seen, local));
    let mut teachers = Outputs::new(step.teacher, |seen, local| logits(other, seen, local));
    let (mut sum, mut even, mut counted) = (None, Vec::new(), 0);
    for pair in pairs(&matching, step, level)? {
        let Pair { share, view, with, is_local, rows, partners } = pair;
        counted += rows.len();
        let weights = vec![1.0 / rows.len() as f64; rows.len()];
        let student = students.rows(view, is_local, rows)?;
        let teacher = teachers.rows(with, is_local, partners)?.detach();
        let prototypes = &term.prototypes;
        let name = format!("self_distillation.{}", if is_local { "local" } else { "masked" });
        let (targets, evenness) = centers.targets(&name, &teacher, prototypes, step)?;
        even.push(evenness);
        let cost =
            masked_cross_entropy(&student, &targets, &weights, prototypes.student_temperature)?;
        add(&mut sum, cost, share)?;
    }
    let mean = even.iter().sum::<f64>() / even.len().max(1) as f64;
    let notes = [
        ("prototypes_used", mean),
        ("matched_rows", counted as f64),
        ("matched_pairs", even.len() as f64),
    ];
    Ok(TermOutput::new(sum, &notes, counted))
}

/// The teacher's direction, and a coding rate that keeps rows apart.
pub(super) fn sim_dino_rows_term(
    term: &SimDinoRowsTerm,
    [own, other]: [&Head; 2],
    step: &Step<'_>,
) -> Result<TermOutput> {
    let scales = step.student.first().map_or(0, |seen| seen.levels.encoder().len());
    let matching = term.matching();
    let level = level_of("sim_dino_rows", scales, matching.up_cast)?;
    let up_cast = |seen: &Seen, _| seen.levels.up_cast(level);
    let mut students = Outputs::new(step.student, up_cast);
    let mut teachers = Outputs::new(step.teacher, up_cast);
    let (mut sum, mut counted, mut seen) = (None, 0, Vec::new());
    for pair in pairs(&matching, step, level)? {
        let Pair { share, view, with, rows, partners, .. } = pair;
        let (rows, partners) = (spread(&rows, term.max_rows), spread(&partners, term.max_rows));
        counted += rows.len();
        let student = own.forward(&students.rows(view, false, rows)?)?;
        let teacher = other.forward(&teachers.rows(with, false, partners)?)?.detach();
        if let Some(out) = sim_dino_rows(&student, &teacher, &term.settings())? {
            seen.push((out.compression, out.expansion));
            add(&mut sum, Some(out.loss), share)?;
        }
    }
    let mean = |of: fn(&(f64, f64)) -> f64| seen.iter().map(of).sum::<f64>() / seen.len() as f64;
    let mut notes = vec![("matched_rows", counted as f64), ("matched_pairs", seen.len() as f64)];
    if !seen.is_empty() {
        notes.push(("compression", mean(|pair| pair.0)));
        notes.push(("coding_rate", mean(|pair| pair.1)));
    }
    Ok(TermOutput::new(sum, &notes, counted))
}

/// At most `most` of `rows`, evenly along their order; rows of a scale stand along a curve through space.
fn spread(rows: &[u32], most: usize) -> Vec<u32> {
    if rows.len() <= most {
        return rows.to_vec();
    }
    (0..most).map(|i| rows[i * rows.len() / most]).collect()
}

fn add(sum: &mut Option<Tensor>, value: Option<Tensor>, share: f64) -> Result<()> {
    if let Some(value) = value {
        let value = (value * share)?;
        *sum = Some(match sum.take() {
            Some(sum) => (sum + value)?,
            None => value,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_left_out_evenly() {
        let rows: Vec<u32> = (10..20).collect();
        assert_eq!(spread(&rows, 10), rows);
        assert_eq!(spread(&rows, 4), [10, 12, 15, 17]);
        assert_eq!(spread(&[], 3), [0u32; 0]);
    }
}
