//! The terms: each compares features of student and teacher.

use super::centers::Centers;
use super::config::{
    Compat, LanguageAlignmentTerm, MaskedGaussiansTerm, Prototypes, SimDinoTerm, TermConfig,
};
use super::heads::Head;
use super::matched_terms;
use super::step::{Seen, Step, TermOutput, indices};
use candle_core::{Device, Result, Tensor, bail};
use scenesplat_datasets::ViewKind;
use scenesplat_losses::self_supervised::{
    AttributeColumns, GaussianDistance, masked_cosine, masked_cross_entropy, masked_gaussians,
    sim_dino, view_cross_entropy,
};
use scenesplat_losses::{Reduction, cosine, l2};

/// Sizes below this count as this before their logarithm, meters.
pub(super) const LEAST_SIZE: f64 = 1e-4;

/// The terms with their heads.
pub(super) struct Terms {
    pub compat: Compat,
    pub terms: Vec<TermConfig>,
    pub student: Vec<Head>,
    pub teacher: Vec<Head>,
    pub attributes: Vec<AttributeColumns>,
    pub centers: Centers,
}

impl Terms {
    /// The terms with what each gives for a step.
    pub fn outputs(&self, step: &Step<'_>) -> Result<Vec<(&TermConfig, TermOutput)>> {
        let terms = self.terms.iter().zip(self.student.iter().zip(&self.teacher));
        terms
            .map(|(term, (own, other))| Ok((term, self.output(term, [own, other], step)?)))
            .collect()
    }

    fn output(&self, term: &TermConfig, heads: [&Head; 2], step: &Step<'_>) -> Result<TermOutput> {
        match term {
            TermConfig::MaskedGaussians(t) => self.masked_gaussians(t, heads[0], step),
            TermConfig::SimDino(t) => sim_dino_term(t, heads, step),
            TermConfig::Dino(t) => self.dino(&t.prototypes, heads, step),
            TermConfig::Ibot(_) => ibot(heads, step),
            TermConfig::IbotCrossEntropy(t) => self.ibot_cross_entropy(&t.prototypes, heads, step),
            TermConfig::SelfDistillation(t) => {
                matched_terms::self_distillation(t, heads, step, &self.centers)
            }
            TermConfig::SimDinoRows(t) => matched_terms::sim_dino_rows_term(t, heads, step),
            TermConfig::LanguageAlignment(t) => alignment(t, heads[0], step),
        }
    }

    fn masked_gaussians(
        &self,
        term: &MaskedGaussiansTerm,
        head: &Head,
        step: &Step<'_>,
    ) -> Result<TermOutput> {
        let mut views = step.masked()?;
        if self.compat == Compat::Original {
            let first = step.masks.iter().position(Option::is_some);
            views.retain(|(view, ..)| Some(*view) == first);
        }
        let (mut pred, mut target) = (Vec::new(), Vec::new());
        for (view, rows, _) in &views {
            pred.push(step.student[*view].rows_at(rows)?);
            let batch = &step.views[*view].batch;
            let shape = (batch.len(), batch.channels);
            let feat = Tensor::from_slice(&batch.feat, shape, &Device::Cpu)?;
            target.push(feat.index_select(rows, 0)?);
        }
        if pred.is_empty() {
            return Ok(TermOutput::default());
        }
        let pred = head.attributes(&Tensor::cat(&pred, 0)?)?;
        let mut target = Tensor::cat(&target, 0)?;
        if term.distance != GaussianDistance::MeanSquare {
            target = self.with_log_sizes(&target)?;
        }
        let rows = pred.dim(0)?;
        let Some((value, alone)) =
            masked_gaussians(&pred, &target, None, &self.attributes, term.distance)?
        else {
            return Ok(TermOutput::default());
        };
        let names = self.attributes.iter().map(|a| a.name.clone());
        Ok(TermOutput { value: Some(value), notes: names.zip(alone).collect(), rows })
    }

    /// Sizes as logarithms: what distances that fit compare.
    fn with_log_sizes(&self, target: &Tensor) -> Result<Tensor> {
        let (n, width) = target.dims2()?;
        let mut values: Vec<f32> = target.flatten_all()?.to_vec1()?;
        for attribute in self.attributes.iter().filter(|a| a.is_size) {
            for row in values.chunks_exact_mut(width) {
                for v in &mut row[attribute.columns.clone()] {
                    *v = f64::from(*v).max(LEAST_SIZE).ln() as f32;
                }
            }
        }
        Tensor::from_vec(values, (n, width), &Device::Cpu)
    }

    fn dino(
        &self,
        prototypes: &Prototypes,
        [own, other]: [&Head; 2],
        step: &Step<'_>,
    ) -> Result<TermOutput> {
        let student = stacked(own, step.student)?;
        let teacher = stacked(other, step.teacher)?.detach();
        let (t, b, k) = teacher.dims3()?;
        let rows = teacher.reshape((t * b, k))?;
        let (targets, even) = self.centers.targets("dino", &rows, prototypes, step)?;
        let targets = targets.reshape((t, b, k))?;
        let value = view_cross_entropy(&student, &targets, prototypes.student_temperature, false)?;
        let pairs = pairs_of_views(t, step.student.len());
        let value = value.map(|value| value / pairs).transpose()?;
        Ok(TermOutput::new(value, &[("prototypes_used", even)], b))
    }

    fn ibot_cross_entropy(
        &self,
        prototypes: &Prototypes,
        heads: [&Head; 2],
        step: &Step<'_>,
    ) -> Result<TermOutput> {
        let Some((student, teacher, weights)) = masked_pairs(heads, step)? else {
            return Ok(TermOutput::default());
        };
        let name = "ibot_cross_entropy";
        let (targets, even) = self.centers.targets(name, &teacher, prototypes, step)?;
        // Of views and scenes, which each weigh about 1 where Gaussians share a patch's weight.
        let sum: f64 = weights.iter().sum();
        let weights: Vec<f64> = weights.iter().map(|w| w / sum).collect();
        let value =
            masked_cross_entropy(&student, &targets, &weights, prototypes.student_temperature)?;
        Ok(TermOutput::new(value, &[("prototypes_used", even)], weights.len()))
    }
}

/// Vectors or logits of all scenes in all views. `[views, B, D]`
fn stacked(head: &Head, seen: &[Seen]) -> Result<Tensor> {
    let each = seen.iter().map(|seen| head.forward(&seen.scenes()?));
    Tensor::stack(&each.collect::<Result<Vec<_>>>()?, 0)
}

fn sim_dino_term(
    term: &SimDinoTerm,
    [own, other]: [&Head; 2],
    step: &Step<'_>,
) -> Result<TermOutput> {
    let student = stacked(own, step.student)?;
    let teacher = stacked(other, step.teacher)?.detach();
    let scenes = student.dim(1)?;
    let Some(out) = sim_dino(&student, &teacher, &term.settings())? else {
        return Ok(TermOutput::default());
    };
    let notes = [
        ("compression", out.compression),
        ("global_compression", out.global_compression),
        ("coding_rate", out.expansion),
    ];
    Ok(TermOutput::new(Some(out.loss), &notes, scenes))
}

/// Both heads' rows of the masked rows of all views, with their weights.
fn masked_pairs(
    [own, other]: [&Head; 2],
    step: &Step<'_>,
) -> Result<Option<(Tensor, Tensor, Vec<f64>)>> {
    let (mut student, mut teacher, mut all) = (Vec::new(), Vec::new(), Vec::new());
    for (view, rows, weights) in step.masked()? {
        student.push(step.student[view].rows_at(&rows)?);
        teacher.push(step.teacher[view].rows_at(&rows)?);
        all.extend(weights);
    }
    if all.is_empty() {
        return Ok(None);
    }
    let student = own.forward(&Tensor::cat(&student, 0)?)?;
    let teacher = other.forward(&Tensor::cat(&teacher, 0)?)?.detach();
    Ok(Some((student, teacher, all)))
}

fn ibot(heads: [&Head; 2], step: &Step<'_>) -> Result<TermOutput> {
    let Some((student, teacher, weights)) = masked_pairs(heads, step)? else {
        return Ok(TermOutput::default());
    };
    let value = masked_cosine(&student, &teacher, &weights)?;
    Ok(TermOutput::new(value, &[], weights.len()))
}

/// `1 − cosine` and the square distance to the scenes' features, over rows that have one.
fn alignment(term: &LanguageAlignmentTerm, head: &Head, step: &Step<'_>) -> Result<TermOutput> {
    let (mut pred, mut target) = (Vec::new(), Vec::new());
    for (view, seen) in step.views.iter().zip(step.student) {
        if view.kind != ViewKind::Global {
            continue;
        }
        let Some(features) = &view.batch.lang_feat else {
            bail!(
                "lang_feat: none of the scenes {} has language features, which language_alignment learns",
                view.batch.ids.join(", ")
            );
        };
        if features.dim != term.out {
            bail!(
                "language_alignment.out: {}, but the scenes' features are {} wide",
                term.out,
                features.dim
            );
        }
        pred.push(seen.all_rows()?.clone());
        let values: Vec<f32> = features.values.iter().map(|v| v.to_f32()).collect();
        target.push(Tensor::from_vec(values, (view.batch.len(), features.dim), &Device::Cpu)?);
    }
    let counts: Vec<bool> = step
        .views
        .iter()
        .zip(step.masks)
        .filter(|(view, _)| view.kind == ViewKind::Global)
        .flat_map(|(view, masked)| {
            (0..view.batch.len()).map(move |row| {
                let valid = view.batch.valid_feat.as_ref().is_none_or(|v| v[row]);
                let hidden = masked.as_ref().is_some_and(|m| m.hidden[row]);
                valid && (hidden || !term.masked_only)
            })
        })
        .collect();
    let rows = indices(&counts);
    if rows.is_empty() {
        return Ok(TermOutput::default());
    }
    let count = rows.len();
    let rows = Tensor::new(rows, &Device::Cpu)?;
    let pred = Tensor::cat(&pred, 0)?;
    let pred = head.attributes(&pred.index_select(&rows.to_device(pred.device())?, 0)?)?;
    let target = Tensor::cat(&target, 0)?.index_select(&rows, 0)?;
    let (cos, square) = (
        cosine(&pred, &target, None, Reduction::Mean)?,
        l2(&pred, &target, None, Reduction::Mean)?,
    );
    let (Some(cos), Some(square)) = (cos, square) else { return Ok(TermOutput::default()) };
    let note = |t: &Tensor| t.to_scalar::<f32>().map(f64::from);
    let notes = [("cosine", note(&cos)?), ("l2", note(&square)?)];
    Ok(TermOutput::new(Some((cos + square)?), &notes, count))
}

/// How many pairs of a teacher's view with another view of the student there are; at least 1.
fn pairs_of_views(teachers: usize, students: usize) -> f64 {
    (teachers * students - teachers).max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_is_no_pair_with_itself() {
        // Two views of the teacher and five of the student, of which each has one in common.
        assert_eq!(pairs_of_views(2, 5), 8.0);
        assert_eq!(pairs_of_views(1, 1), 1.0);
    }
}
