//! What each term makes of what student and teacher see.

use super::centers::Centers;
use super::config::{
    Compat, LanguageAlignmentTerm, MaskedGaussiansTerm, Prototypes, SimDinoTerm, TermConfig,
};
use super::heads::Head;
use super::matched_terms;
use crate::module::StepContext;
use candle_core::{Device, Result, Tensor, bail};
use scenesplat_datasets::{Masked, View, ViewKind};
use scenesplat_losses::self_supervised::{
    AttributeColumns, GaussianDistance, SimDino, masked_cosine, masked_cross_entropy,
    masked_gaussians, sim_dino, view_cross_entropy,
};
use scenesplat_losses::{Reduction, cosine, l2};
use scenesplat_models::{Levels, scene_means};

/// Sizes below this count as this before their logarithm, metres.
pub(super) const LEAST_SIZE: f64 = 1e-4;

/// What a network makes of a view.
pub(super) struct Seen {
    pub levels: Levels,
    /// Rows of the finest scale, in the caller's order, if they are read. `[N, C]`
    pub rows: Option<Tensor>,
}

impl Seen {
    /// Without the way back to parameters.
    pub fn detached(self) -> Self {
        Self { levels: self.levels.detached(), rows: self.rows.map(|rows| rows.detach()) }
    }

    /// A vector for each scene: the mean over its coarsest rows. `[B, C]`
    fn scenes(&self) -> Result<Tensor> {
        let level = self.levels.coarsest()?;
        scene_means(&level.feat, &level.offsets)
    }

    fn rows(&self) -> Result<&Tensor> {
        match &self.rows {
            Some(rows) => Ok(rows),
            None => bail!("the rows of this view were not asked for"),
        }
    }

    /// What collapse shows in: rows as they are handed on, detached.
    pub fn features(&self) -> Result<Tensor> {
        match &self.rows {
            Some(rows) => Ok(rows.detach()),
            None => Ok(self.levels.coarsest()?.feat.detach()),
        }
    }
}

/// What a term gives.
pub(super) struct TermOutput {
    pub name: &'static str,
    pub weight: f64,
    /// Scalar; `None` if nothing counts.
    pub value: Option<Tensor>,
    /// For the log.
    pub notes: Vec<(String, f64)>,
    /// Rows (or scenes) that count.
    pub rows: usize,
}

/// The terms with their heads.
pub(super) struct Terms {
    pub compat: Compat,
    pub terms: Vec<TermConfig>,
    pub student: Vec<Head>,
    pub teacher: Vec<Head>,
    pub attributes: Vec<AttributeColumns>,
    pub centers: Centers,
}

/// Names of the centers that a term may have.
pub(super) fn center_names(term: &TermConfig) -> Vec<String> {
    match term {
        TermConfig::SelfDistillation(t) => {
            let [same, other, local] = t.shares;
            let mut names = Vec::new();
            if same > 0.0 || other > 0.0 {
                names.push("self_distillation.masked".to_owned());
            }
            if local > 0.0 {
                names.push("self_distillation.local".to_owned());
            }
            names
        }
        term => vec![term.name().to_owned()],
    }
}

/// Value, notes and the number of rows that count.
pub(super) type Value = (Option<Tensor>, Vec<(String, f64)>, usize);

/// What all terms look at.
pub(super) struct Step<'a> {
    pub views: &'a [View],
    pub masks: &'a [Option<Masked>],
    pub student: &'a [Seen],
    pub teacher: &'a [Seen],
    step: u64,
    total: u64,
}

impl Step<'_> {
    pub fn temperature(&self, prototypes: &Prototypes) -> f64 {
        prototypes.teacher_temperature.value(self.step, self.total)
    }

    /// Views of the teacher, whose masked rows count: number, rows, weights.
    fn masked(&self) -> Result<Vec<(usize, Tensor, Vec<f64>)>> {
        let mut all = Vec::new();
        for (view, masked) in self.masks.iter().enumerate() {
            let Some(masked) = masked else { continue };
            let rows: Vec<u32> = hidden_rows(masked);
            let weights = rows.iter().map(|&row| masked.weights[row as usize]).collect();
            all.push((view, Tensor::new(rows, &Device::Cpu)?, weights));
        }
        Ok(all)
    }
}

fn hidden_rows(masked: &Masked) -> Vec<u32> {
    (0_u32..).zip(&masked.hidden).filter(|(_, hidden)| **hidden).map(|(row, _)| row).collect()
}

impl Terms {
    pub fn outputs(
        &self,
        views: &[View],
        masks: &[Option<Masked>],
        student: &[Seen],
        teacher: &[Seen],
        cx: &StepContext<'_>,
    ) -> Result<Vec<TermOutput>> {
        let (step, total) = (cx.step, cx.total_steps);
        let step = Step { views, masks, student, teacher, step, total };
        let terms = self.terms.iter().zip(self.student.iter().zip(&self.teacher));
        terms
            .map(|(term, (own, other))| {
                let (value, notes, rows) = self.value(term, own, other, &step)?;
                Ok(TermOutput { name: term.name(), weight: term.weight(), value, notes, rows })
            })
            .collect()
    }

    fn value(&self, term: &TermConfig, own: &Head, other: &Head, step: &Step<'_>) -> Result<Value> {
        match term {
            TermConfig::MaskedGaussians(t) => self.masked_gaussians(t, own, step),
            TermConfig::SimDino(t) => sim_dino_term(t, own, other, step),
            TermConfig::Dino(t) => self.dino(&t.prototypes, own, other, step),
            TermConfig::Ibot(_) => ibot(own, other, step),
            TermConfig::IbotCrossEntropy(t) => {
                self.ibot_cross_entropy(&t.prototypes, own, other, step)
            }
            TermConfig::SelfDistillation(t) => {
                matched_terms::self_distillation(t, own, other, step, &self.centers)
            }
            TermConfig::SimDinoRows(t) => matched_terms::sim_dino_rows_term(t, own, other, step),
            TermConfig::LanguageAlignment(t) => alignment(t, own, step),
        }
    }

    fn masked_gaussians(
        &self,
        term: &MaskedGaussiansTerm,
        head: &Head,
        step: &Step<'_>,
    ) -> Result<Value> {
        let mut views = step.masked()?;
        if self.compat == Compat::Original {
            views.truncate(1);
        }
        let (mut pred, mut target) = (Vec::new(), Vec::new());
        for (view, rows, _) in &views {
            if rows.dim(0)? == 0 {
                continue;
            }
            let seen = step.student[*view].rows()?;
            pred.push(seen.index_select(&rows.to_device(seen.device())?, 0)?);
            let batch = &step.views[*view].batch;
            let feat =
                Tensor::from_slice(&batch.feat, (batch.len(), batch.channels), &Device::Cpu)?;
            target.push(feat.index_select(rows, 0)?);
        }
        if pred.is_empty() {
            return Ok((None, Vec::new(), 0));
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
            return Ok((None, Vec::new(), 0));
        };
        let names = self.attributes.iter().map(|a| a.name.clone());
        Ok((Some(value), names.zip(alone).collect(), rows))
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
        own: &Head,
        other: &Head,
        step: &Step<'_>,
    ) -> Result<Value> {
        let student = stacked(own, step.student)?;
        let teacher = stacked(other, step.teacher)?.detach();
        let (t, b, k) = teacher.dims3()?;
        let temperature = step.temperature(prototypes);
        let (targets, even) = self.centers.targets(
            "dino",
            &teacher.reshape((t * b, k))?,
            temperature,
            prototypes.balance,
        )?;
        let targets = targets.reshape((t, b, k))?;
        let value = view_cross_entropy(&student, &targets, prototypes.student_temperature, false)?;
        let pairs = (t * step.student.len() - t).max(1) as f64;
        let value = value.map(|value| value / pairs).transpose()?;
        Ok((value, vec![("prototypes_used".to_owned(), even)], b))
    }

    fn ibot_cross_entropy(
        &self,
        prototypes: &Prototypes,
        own: &Head,
        other: &Head,
        step: &Step<'_>,
    ) -> Result<Value> {
        let Some((student, teacher, weights)) = masked_pairs(own, other, step)? else {
            return Ok((None, Vec::new(), 0));
        };
        let temperature = step.temperature(prototypes);
        let (targets, even) = self.centers.targets(
            "ibot_cross_entropy",
            &teacher,
            temperature,
            prototypes.balance,
        )?;
        // Of views and scenes, which each weigh about 1 where Gaussians share a patch's weight.
        let sum: f64 = weights.iter().sum();
        let weights: Vec<f64> = weights.iter().map(|w| w / sum).collect();
        let value =
            masked_cross_entropy(&student, &targets, &weights, prototypes.student_temperature)?;
        Ok((value, vec![("prototypes_used".to_owned(), even)], weights.len()))
    }
}

/// Vectors or logits of all scenes in all views. `[views, B, D]`
fn stacked(head: &Head, seen: &[Seen]) -> Result<Tensor> {
    let each = seen.iter().map(|seen| head.forward(&seen.scenes()?));
    Tensor::stack(&each.collect::<Result<Vec<_>>>()?, 0)
}

fn sim_dino_term(term: &SimDinoTerm, own: &Head, other: &Head, step: &Step<'_>) -> Result<Value> {
    let student = stacked(own, step.student)?;
    let teacher = stacked(other, step.teacher)?.detach();
    let settings = SimDino {
        coefficient: term.coefficient,
        epsilon: term.epsilon,
        expansion: term.expansion,
        normalized: true,
    };
    let scenes = student.dim(1)?;
    let Some(out) = sim_dino(&student, &teacher, &settings)? else {
        return Ok((None, Vec::new(), 0));
    };
    let notes = vec![
        ("compression".to_owned(), out.compression),
        ("global_compression".to_owned(), out.global_compression),
        ("coding_rate".to_owned(), out.expansion),
    ];
    Ok((Some(out.loss), notes, scenes))
}

/// What both heads make of the masked rows of all views, with their weights.
fn masked_pairs(
    own: &Head,
    other: &Head,
    step: &Step<'_>,
) -> Result<Option<(Tensor, Tensor, Vec<f64>)>> {
    let (mut student, mut teacher, mut all) = (Vec::new(), Vec::new(), Vec::new());
    for (view, rows, weights) in step.masked()? {
        if weights.is_empty() {
            continue;
        }
        for (seen, picked) in [(step.student, &mut student), (step.teacher, &mut teacher)] {
            let of_view = seen[view].rows()?;
            picked.push(of_view.index_select(&rows.to_device(of_view.device())?, 0)?);
        }
        all.extend(weights);
    }
    if all.is_empty() {
        return Ok(None);
    }
    let student = own.forward(&Tensor::cat(&student, 0)?)?;
    let teacher = other.forward(&Tensor::cat(&teacher, 0)?)?.detach();
    Ok(Some((student, teacher, all)))
}

fn ibot(own: &Head, other: &Head, step: &Step<'_>) -> Result<Value> {
    let Some((student, teacher, weights)) = masked_pairs(own, other, step)? else {
        return Ok((None, Vec::new(), 0));
    };
    let value = masked_cosine(&student, &teacher, &weights)?;
    Ok((value, Vec::new(), weights.len()))
}

/// `1 − cosine` and the square distance to the scenes' features, over rows that have one.
fn alignment(term: &LanguageAlignmentTerm, head: &Head, step: &Step<'_>) -> Result<Value> {
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
        pred.push(seen.rows()?.clone());
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
    let rows: Vec<u32> =
        (0_u32..).zip(&counts).filter(|(_, counts)| **counts).map(|(row, _)| row).collect();
    if rows.is_empty() {
        return Ok((None, Vec::new(), 0));
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
    let (Some(cos), Some(square)) = (cos, square) else { return Ok((None, Vec::new(), 0)) };
    let note = |t: &Tensor| t.to_scalar::<f32>().map(f64::from);
    let notes = vec![("cosine".to_owned(), note(&cos)?), ("l2".to_owned(), note(&square)?)];
    Ok((Some((cos + square)?), notes, count))
}
