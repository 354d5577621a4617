//! What a training learns.

use crate::doctor::trial::Failure;
use scenesplat_datasets::transforms::{
    CenterShift, ColorJitter, CropOrigin, GridSample, RandomFlip, RandomRotate, ViewCrop,
    ViewGroup, Views, language_pretraining,
};
use scenesplat_datasets::{
    InputFeatures, MaskShape, MaskWeight, Masking, TransformConfig, ViewKind,
};
use scenesplat_kernels::Precision;
use scenesplat_losses::self_supervised::GaussianDistance;
use scenesplat_models::{Compute, ModelConfig, ParamStore, PointTransformerV3Config};
use scenesplat_trainers::tasks::self_supervised::{
    IbotCrossEntropyTerm, MaskedGaussiansTerm, Prototypes, SelfDistillationTerm, SelfSupervised,
    SelfSupervisedConfig, SimDinoRowsTerm, SimDinoTerm, TermConfig,
};
use scenesplat_trainers::{CosineSchedule, KeywordGroup};
use serde::{Deserialize, Serialize};
use std::fmt;

/// What a training learns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StabilityRecipe {
    /// Features against the texts of the classes, in every form of the loop.
    LanguagePretraining,
    /// Without labels: masked Gaussians, SimDINO and iBOT over prototypes, with a decoder.
    GaussianSsl,
    /// Without labels: self-distillation over prototypes, the encoder alone.
    SelfDistillation,
    /// Without labels: SimDINO of matched rows, the encoder alone.
    SimDinoRows,
}

impl StabilityRecipe {
    /// All of them.
    pub const ALL: [Self; 4] =
        [Self::LanguagePretraining, Self::GaussianSsl, Self::SelfDistillation, Self::SimDinoRows];

    /// Its name in tables and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::LanguagePretraining => "language",
            Self::GaussianSsl => "gaussian-ssl",
            Self::SelfDistillation => "self-distillation",
            Self::SimDinoRows => "sim-dino-rows",
        }
    }

    /// Width of the rows that collapse is looked for in.
    pub(super) fn width(self) -> usize {
        match self {
            Self::LanguagePretraining => WIDTH,
            Self::GaussianSsl => DECODER,
            Self::SelfDistillation | Self::SimDinoRows => COARSEST,
        }
    }

    /// Learning rate, and that of parameters with a name of their own.
    pub(super) fn rates(self) -> (f64, Vec<KeywordGroup>) {
        match self {
            Self::LanguagePretraining => (0.003, Vec::new()),
            Self::GaussianSsl | Self::SelfDistillation | Self::SimDinoRows => {
                (0.004, vec![KeywordGroup { keyword: "block".to_owned(), lr: 0.001 }])
            }
        }
    }

    /// What becomes of a room before a batch is made of it.
    pub(super) fn transforms(self) -> Vec<TransformConfig> {
        match self {
            Self::LanguagePretraining => language_pretraining(GRID),
            Self::GaussianSsl | Self::SelfDistillation | Self::SimDinoRows => views(),
        }
    }
}

impl fmt::Display for StabilityRecipe {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Size of a voxel, meters.
const GRID: f64 = 0.2;
/// Channels of the features of language pretraining.
pub(super) const WIDTH: usize = 64;
/// Channels of the decoder.
const DECODER: usize = 16;
/// Channels of the coarsest scale.
const COARSEST: usize = 32;

/// Two global and two local views.
fn views() -> Vec<TransformConfig> {
    let each = || -> Vec<TransformConfig> {
        vec![
            RandomRotate { probability: 1.0, ..RandomRotate::default() }.into(),
            RandomFlip::default().into(),
            ColorJitter::default().into(),
            GridSample { grid_size: GRID, ..GridSample::default() }.into(),
            CenterShift { apply_z: false }.into(),
        ]
    };
    let group = |kind, ratio, center| ViewGroup {
        kind,
        shared: Vec::new(),
        crop: Some(ViewCrop { ratio, point_max: 1000, center }),
        views: vec![each(), each()],
    };
    let groups = vec![
        group(ViewKind::Global, [0.4, 1.0], CropOrigin::Major),
        group(ViewKind::Local, [0.1, 0.4], CropOrigin::Uncovered),
    ];
    vec![CenterShift::default().into(), Views { groups }.into()]
}

/// What a network without labels learns.
fn terms(recipe: StabilityRecipe) -> Vec<TermConfig> {
    let prototypes = |given: Prototypes| Prototypes { count: 64, hidden: 32, out: 16, ..given };
    match recipe {
        StabilityRecipe::SimDinoRows => vec![TermConfig::SimDinoRows(SimDinoRowsTerm {
            hidden: 32,
            out: 16,
            coefficient: 3.0,
            up_cast: 1,
            max_distance: 2.0 * GRID,
            ..SimDinoRowsTerm::default()
        })],
        StabilityRecipe::SelfDistillation => {
            let term = SelfDistillationTerm::default();
            vec![TermConfig::SelfDistillation(SelfDistillationTerm {
                prototypes: prototypes(term.prototypes.clone()),
                up_cast: 1,
                max_distance: 2.0 * GRID,
                ..term
            })]
        }
        StabilityRecipe::GaussianSsl | StabilityRecipe::LanguagePretraining => {
            let ibot = IbotCrossEntropyTerm::default();
            let ibot = IbotCrossEntropyTerm { prototypes: prototypes(ibot.prototypes), ..ibot };
            vec![
                TermConfig::MaskedGaussians(MaskedGaussiansTerm {
                    distance: GaussianDistance::Fitted,
                    ..MaskedGaussiansTerm::default()
                }),
                TermConfig::SimDino(SimDinoTerm { hidden: 32, out: 16, ..SimDinoTerm::default() }),
                TermConfig::IbotCrossEntropy(ibot),
            ]
        }
    }
}

/// A small network that learns without labels; terms, momentum and rates are those of
/// `configs/self_supervised/synthetic_rooms*.toml`.
pub(super) fn self_supervised(
    recipe: StabilityRecipe,
    precision: Precision,
    seed: u64,
) -> Result<SelfSupervised, Failure> {
    let has_decoder = recipe == StabilityRecipe::GaussianSsl;
    let masking = Masking {
        shape: MaskShape::Patches(3.0 * GRID),
        ratio: [0.2, 0.5],
        scenes: 1.0,
        weight: MaskWeight::PerGaussian,
    };
    let from = if recipe == StabilityRecipe::SimDinoRows { 0.9 } else { 0.99 };
    let momentum = CosineSchedule { from, ..SelfSupervisedConfig::default().momentum };
    let config = SelfSupervisedConfig {
        momentum,
        masking: Some(masking),
        terms: terms(recipe),
        ..SelfSupervisedConfig::default()
    };
    let only = |kept: bool, values: Vec<usize>| if kept { values } else { Vec::new() };
    let input = InputFeatures::default();
    let network = PointTransformerV3Config {
        in_channels: input.width(),
        enc_channels: vec![8, 16, COARSEST],
        enc_num_head: vec![1, 2, 4],
        enc_patch_size: vec![64; 3],
        dec_depths: only(has_decoder, vec![1, 1]),
        dec_channels: only(has_decoder, vec![DECODER, 16]),
        dec_num_head: only(has_decoder, vec![2, 2]),
        dec_patch_size: only(has_decoder, vec![64; 2]),
        drop_path: 0.1,
        mask_token: true,
        compute: Compute { precision, ..Compute::default() },
        ..PointTransformerV3Config::tiny()
    };
    let model = ModelConfig { grid_size: GRID, ..ModelConfig::new(network) };
    Ok(SelfSupervised::new(&config, &model, &input, ParamStore::trainable(seed), seed)?)
}
