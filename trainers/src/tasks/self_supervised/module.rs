//! Student, heads and teacher, and a step of their training.

use super::centers::Centers;
use super::config::{Compat, SelfSupervisedConfig, TermConfig};
use super::heads::{HEADS, Head, Widths};
use super::step::{Seen, Step, TermOutput};
use super::teacher::{Teacher, point_transformer};
use super::terms::Terms;
use crate::TrainError;
use crate::module::{AfterStep, HasBackbone, StepContext, StepOutput, TrainingModule};
use crate::tasks::{bad_values, point_cloud};
use candle_core::{Device, Result, Tensor, bail};
use half::f16;
use scenesplat_datasets::InputChannel;
use scenesplat_datasets::{InputFeatures, Masked, TrainBatch, View, ViewKind};
use scenesplat_losses::self_supervised::AttributeColumns;
use scenesplat_models::{
    Backbone, Forward, LevelOptions, Levels, ModelConfig, ParamStore, PointTransformerV3Config,
};

/// Keeps masks of views apart.
const VIEW_SEED: u64 = 0xD1B5_4A32_D192_ED03;

/// A network that learns from views of scenes, with heads and, where a term asks for one, a teacher.
///
/// In a step the student sees every view, of the global ones only what is not masked; the teacher sees the
/// global ones whole. Terms compare what they make of them. After the optimizer's step the teacher moves
/// toward the student.
///
/// Parameters are those of the network under their own names, so that its file is a model like any other,
/// and of the heads under `heads.`.
pub struct SelfSupervised {
    config: SelfSupervisedConfig,
    student: Box<dyn Backbone>,
    params: ParamStore,
    /// Heads that no optimizer sees.
    untrained_heads: Option<ParamStore>,
    teacher: Option<Teacher>,
    terms: Terms,
}

/// Whether a parameter belongs to a head, which the exported model does not have.
pub fn is_head(name: &str) -> bool {
    name.strip_prefix(HEADS).is_some_and(|rest| rest.starts_with('.'))
}

impl SelfSupervised {
    /// Builds student, heads and teacher. `params` gives the student's first values and takes the heads;
    /// `seed` is that of what `params` does not have.
    ///
    /// # Errors
    /// If settings do not fit together or to the network.
    pub fn new(
        config: &SelfSupervisedConfig,
        model: &ModelConfig,
        input: &InputFeatures,
        params: ParamStore,
        seed: u64,
    ) -> Result<Self> {
        config.check().map_err(candle_core::Error::wrap)?;
        let backbone = checked_backbone(config, model)?;
        let widths = Widths::new(model, backbone, input);
        let student = model.build(params.builder())?;
        let compute = backbone.compute;
        let untrained_heads = (config.compat == Compat::Original)
            .then(|| ParamStore::trainable(seed).on(params.device()));
        let heads_in = untrained_heads.as_ref().unwrap_or(&params);
        let build = |store: &ParamStore| -> Result<Vec<Head>> {
            config.terms.iter().map(|term| Head::new(term, &widths, compute, store)).collect()
        };
        let student_heads = build(heads_in)?;
        let teacher =
            config.has_teacher().then(|| Teacher::new(model, config.compat, seed, params.device()));
        let teacher = teacher.transpose()?;
        let teacher_heads = match (&teacher, config.compat) {
            (None, _) | (_, Compat::Original) => student_heads.clone(),
            (Some(teacher), Compat::None) => {
                let terms = config.terms.iter().zip(&student_heads);
                let heads = terms.map(|(term, own)| match term.has_teacher() {
                    true => Head::new(term, &widths, compute, &teacher.store),
                    // Not used.
                    false => Ok(own.clone()),
                });
                let heads = heads.collect::<Result<_>>()?;
                teacher.copy_from(&params)?;
                heads
            }
        };
        let mut centers = Centers::new();
        for term in &config.terms {
            for name in term.center_names() {
                if let Some(p) = term.prototypes() {
                    centers.add(&name, p.count, p.balance)?;
                }
            }
        }
        let terms = Terms {
            compat: config.compat,
            terms: config.terms.clone(),
            student: student_heads,
            teacher: teacher_heads,
            attributes: attribute_columns(input),
            centers,
        };
        let config = config.clone();
        Ok(Self { config, student, params, untrained_heads, teacher, terms })
    }

    /// The teacher's parameters and batch statistics, its heads included.
    pub fn teacher(&self) -> Option<&ParamStore> {
        self.teacher.as_ref().map(|teacher| &teacher.store)
    }

    /// The heads that no optimizer sees, of [`Compat::Original`].
    pub fn untrained_heads(&self) -> Option<&ParamStore> {
        self.untrained_heads.as_ref()
    }

    /// What is masked of each view in a step: of global ones what the settings say, by (seed, step, view).
    ///
    /// # Errors
    /// If a batch is out of step.
    pub fn masks(&self, views: &[View], cx: &StepContext<'_>) -> Result<Vec<Option<Masked>>> {
        let masking = self.config.masking_at(cx.step, cx.total_steps);
        let reads_masks = |view: &View| view.kind == ViewKind::Global && !view.batch.is_empty();
        let of_view = |(i, view): (u64, &View)| {
            let Some(masking) = masking.filter(|_| reads_masks(view)) else { return Ok(None) };
            let seed = cx.seed ^ (i + 1).wrapping_mul(VIEW_SEED);
            let batch = &view.batch;
            let mut masked = masking
                .choose(&batch.coord, &batch.offsets, seed, cx.step)
                .map_err(candle_core::Error::wrap)?;
            if self.config.compat == Compat::Original {
                masked.weights.iter_mut().for_each(|w| *w = f16::from_f64(*w).to_f64());
            }
            Ok(Some(masked))
        };
        (0..).zip(views).map(of_view).collect()
    }

    /// A step with given masks, as [`training_step`](TrainingModule::training_step) takes it with those
    /// of [`masks`](Self::masks).
    ///
    /// # Errors
    /// If views or masks do not fit the network, or a term fails.
    pub fn step_with_masks(
        &self,
        views: &[View],
        masks: &[Option<Masked>],
        cx: &mut StepContext<'_>,
    ) -> Result<StepOutput> {
        check_views(views)?;
        let globals = views.iter().filter(|view| view.kind == ViewKind::Global).count();
        let rows = self.config.terms.iter().any(|term| term.reads_rows());
        let rows_of_teacher = self.config.terms.iter().any(|term| term.reads_rows_of_teacher());
        let mut student = Vec::with_capacity(views.len());
        for (view, masked) in views.iter().zip(masks) {
            let mask = masked.as_ref().map(|masked| masked.hidden.as_slice());
            let decoder = rows && view.kind == ViewKind::Global;
            let options = LevelOptions { mask, decoder };
            let recompute = cx.forward.recompute.clone();
            let mut forward = Forward { recompute, ..same(&mut cx.forward) };
            student.push(look(self.student.as_ref(), view, options, &mut forward)?);
        }
        let mut teacher = Vec::new();
        if let Some(network) = self.teacher.as_ref().map(|teacher| &teacher.network) {
            for view in &views[..globals] {
                let options = LevelOptions { mask: None, decoder: rows_of_teacher };
                let mut forward = same(&mut cx.forward);
                let seen = look(network.as_ref(), view, options, &mut forward)?;
                teacher.push(seen.detached());
            }
        }
        let (step, total) = (cx.step, cx.total_steps);
        let step = Step { views, masks, student: &student, teacher: &teacher, step, total };
        let outputs = self.terms.outputs(&step)?;
        let features = student.first().map(Seen::features).transpose()?;
        sum(outputs, views, features, self.params.device())
    }
}

/// The sum of the terms, and what is logged of them.
fn sum(
    outputs: Vec<(&TermConfig, TermOutput)>,
    views: &[View],
    features: Option<Tensor>,
    device: &Device,
) -> Result<StepOutput> {
    let (mut loss, mut terms) = (Tensor::zeros((), candle_core::DType::F32, device)?, Vec::new());
    let mut counted_rows = 0;
    for (term, TermOutput { value, notes, rows }) in outputs {
        let name = term.name();
        terms.extend(notes.into_iter().map(|(note, value)| (format!("{name}/{note}"), value)));
        if let Some(value) = value {
            terms.push((name.to_owned(), f64::from(value.to_scalar::<f32>()?)));
            loss = (loss + (value * term.weight())?)?;
            counted_rows = counted_rows.max(rows);
        }
    }
    let rows = views.iter().map(|view| view.batch.len()).sum();
    Ok(StepOutput { loss, rows, counted_rows, terms, features })
}

/// A pass of the same mode, without observer and recomputation.
fn same<'a>(forward: &'a mut Forward<'_>) -> Forward<'a> {
    Forward {
        mode: forward.mode,
        orders: forward.orders.clone(),
        frozen: forward.frozen.clone(),
        ..Forward::eval(forward.rng)
    }
}

fn look(
    network: &dyn Backbone,
    view: &View,
    options: LevelOptions<'_>,
    forward: &mut Forward<'_>,
) -> Result<Seen> {
    let levels = network.forward_levels(&point_cloud(&view.batch)?, options, forward)?;
    let rows = options.decoder.then(|| voxel_rows(&levels)).transpose()?;
    Ok(Seen { levels, rows })
}

/// Rows of the finest scale, in the caller's order: the decoder's, or of an encoder alone all of its scales
/// at the voxels.
pub(super) fn voxel_rows(levels: &Levels) -> Result<Tensor> {
    levels.decoder().map_or_else(|| levels.up_cast(0), |rows| Ok(rows.clone()))
}

/// Views of the same scenes, global ones first.
fn check_views(views: &[View]) -> Result<()> {
    let Some(first) = views.first().filter(|view| view.kind == ViewKind::Global) else {
        bail!("views: the batch has none; end the transforms with a `views` step");
    };
    let is_late =
        |pair: &[View]| pair[0].kind == ViewKind::Local && pair[1].kind == ViewKind::Global;
    if views.windows(2).any(is_late) {
        bail!("views: global ones come first");
    }
    let other = |view: &&View| view.batch.ids != first.batch.ids;
    match views.iter().find(other) {
        Some(view) => bail!("views: of {:?} and {:?}", first.batch.ids, view.batch.ids),
        None => Ok(()),
    }
}

pub(super) fn checked_backbone<'a>(
    config: &SelfSupervisedConfig,
    model: &'a ModelConfig,
) -> Result<&'a PointTransformerV3Config> {
    let backbone = point_transformer(model)?;
    if model.head != (scenesplat_models::Head::Features { projection: None }) {
        bail!(
            "model: self-supervised training has heads of its own; leave out num_classes and projection"
        );
    }
    match (backbone.mask_token, config.masking.is_some()) {
        (false, true) => bail!("model.mask_token: masks need it; set it to true"),
        (true, false) => bail!(
            "model.mask_token: nothing is masked, so nothing would teach it; set it to false, \
                                or give self_supervised.masking"
        ),
        _ => {}
    }
    let reads_rows = config.terms.iter().any(|term| term.reads_rows());
    if !reads_rows && !backbone.dec_depths.is_empty() {
        bail!(
            "model.dec_depths: no term reads the decoder's rows, so nothing would teach it; leave it empty"
        );
    }
    Ok(backbone)
}

/// Where the attributes stand in the input rows.
fn attribute_columns(input: &InputFeatures) -> Vec<AttributeColumns> {
    let mut start = 0;
    let column = |channel: &InputChannel| {
        let columns = start..start + channel.width();
        start = columns.end;
        let name = serde_json::to_value(channel).ok();
        let name = name.as_ref().and_then(|n| n.as_str()).unwrap_or("channel").to_owned();
        let (is_rotation, is_size) =
            (*channel == InputChannel::Quat, *channel == InputChannel::Scale);
        AttributeColumns { name, columns, is_rotation, is_size }
    };
    input.channels.iter().map(column).collect()
}

impl HasBackbone for SelfSupervised {
    fn backbone(&self) -> &dyn Backbone {
        self.student.as_ref()
    }
}

impl TrainingModule for SelfSupervised {
    type Batch = TrainBatch;

    fn params(&self) -> &ParamStore {
        &self.params
    }

    fn training_step(&self, batch: &TrainBatch, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        let masks = self.masks(&batch.views, cx)?;
        self.step_with_masks(&batch.views, &masks, cx)
    }

    fn after_step(&self, cx: &AfterStep<'_>) -> std::result::Result<(), TrainError> {
        if let Some(teacher) = &self.teacher {
            let momentum = self.config.momentum.value(cx.step, cx.total_steps);
            teacher.follow(&self.params, momentum)?;
        }
        self.terms.centers.update()
    }

    fn stores(&self) -> Vec<(&'static str, &ParamStore)> {
        let teacher = self.teacher().map(|store| ("teacher", store));
        let heads = self.untrained_heads().map(|store| ("heads", store));
        let centers = self.terms.centers.store().map(|store| ("centers", store));
        [teacher, heads, centers].into_iter().flatten().collect()
    }

    fn is_empty(&self, batch: &TrainBatch) -> bool {
        batch.is_empty()
    }

    fn scenes(&self, batch: &TrainBatch) -> Vec<String> {
        batch.ids.clone()
    }

    fn suspects(&self, batch: &TrainBatch) -> Vec<String> {
        batch.views.iter().flat_map(|view| bad_values(&view.batch)).collect()
    }
}
