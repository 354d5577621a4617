//! Losses in a configuration file.

use crate::contrastive::{AggregatedContrastive, ClassSource, TermSchedule, TextColumns};
use crate::cosine::CosineLoss;
use crate::cross_entropy::CrossEntropy;
use crate::error::{LossError, check_positive, check_setting, check_smoothing};
use crate::l2::L2Loss;
use crate::loss::Loss;
use crate::lovasz::LovaszSoftmax;
use crate::objective::{OBJECTIVE, Objective, check_weight};
use crate::rows::Reduction;
use crate::smooth_l1::SmoothL1Loss;
use crate::text_classification::TextClassification;
use crate::text_distillation::TextDistillation;
use scenesplat_kernels::settings;
use serde::{Deserialize, Serialize};

/// A row for each loss: its name (in files in small letters), the type of its settings, which has a
/// `weight`, and how they become the loss.
macro_rules! loss_config {
    ($($name:ident($config:ty) => $build:expr;)*) => {
        /// One term of an objective in a configuration file.
        ///
        /// ```
        /// use scenesplat_losses::{LossConfig, build_objective};
        ///
        /// #[derive(serde::Deserialize)]
        /// struct File {
        ///     losses: Vec<LossConfig>,
        /// }
        /// let file: File = toml::from_str(
        ///     r#"
        ///     [[losses]]
        ///     type = "cosine"
        ///     [[losses]]
        ///     type = "aggregated_contrastive"
        ///     weight = 0.02
        ///     schedule = { last = 75.0 }
        ///     classes = "off"
        ///     "#,
        /// )?;
        /// let objective = build_objective(&file.losses, None)?;
        /// assert_eq!(objective.settings()[0], "1 · cosine");
        /// # Ok::<(), Box<dyn std::error::Error>>(())
        /// ```
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(tag = "type", rename_all = "snake_case")]
        pub enum LossConfig {
            $(#[doc = concat!("Settings of `", stringify!($name), "`.")] $name($config),)*
        }

        impl LossConfig {
            /// Whether the term compares rows with target rows.
            pub fn has_target(&self) -> bool {
                matches!(
                    self,
                    Self::Cosine(_) | Self::L2(_) | Self::SmoothL1(_) | Self::TextDistillation(_)
                )
            }

            /// Weight in the objective.
            pub fn weight(&self) -> f64 {
                match self {
                    $(Self::$name(config) => config.weight,)*
                }
            }

            /// The loss; `texts` are the data's, for pseudo-labels.
            ///
            /// # Errors
            /// If a setting is out of its range, or there are no texts where some are needed.
            pub fn build(&self, texts: Option<&TextColumns>) -> Result<Box<dyn Loss>, LossError> {
                check_weight(self.weight())?;
                match self {
                    $(Self::$name(config) => {
                        let build: fn(&$config, Option<&TextColumns>) -> Built = $build;
                        build(config, texts)
                    })*
                }
            }
        }
    };
}

/// A loss, or what is wrong with its settings.
type Built = Result<Box<dyn Loss>, LossError>;

loss_config! {
    Cosine(RowLossConfig) => |c, _| Ok(Box::new(CosineLoss { reduction: c.reduction }));
    L2(RowLossConfig) => |c, _| Ok(Box::new(L2Loss { reduction: c.reduction }));
    SmoothL1(SmoothL1Config) => |c, _| Ok(Box::new(c.build()?));
    AggregatedContrastive(ContrastiveConfig) => |c, texts| Ok(Box::new(c.build(texts)?));
    CrossEntropy(CrossEntropyConfig) => |c, _| Ok(Box::new(c.build()?));
    LovaszSoftmax(LovaszConfig) => |_, _| Ok(Box::new(LovaszSoftmax));
    TextClassification(TextClassificationConfig) => |c, texts| Ok(Box::new(c.build(texts)?));
    TextDistillation(TextDistillationConfig) => |c, texts| Ok(Box::new(c.build(texts)?));
}

settings! {
    /// Settings of [`CosineLoss`] and [`L2Loss`].
    pub struct RowLossConfig {
        /// Weight in the objective; default 1.
        pub weight: f64 = 1.0,
        /// Mean over the valid rows, or sum.
        pub reduction: Reduction = Reduction::Mean,
    }

    /// Settings of [`SmoothL1Loss`].
    pub struct SmoothL1Config {
        /// Weight in the objective; default 1.
        pub weight: f64 = 1.0,
        /// β; default 1.
        pub beta: f64 = SmoothL1Loss::default().beta,
        /// Mean over the valid rows, or sum.
        pub reduction: Reduction = Reduction::Mean,
    }
}

impl SmoothL1Config {
    fn build(&self) -> Result<SmoothL1Loss, LossError> {
        check_positive("smooth_l1", "beta", self.beta)?;
        Ok(SmoothL1Loss { beta: self.beta, reduction: self.reduction })
    }
}

settings! {
    /// Settings of [`AggregatedContrastive`], which documents them; defaults are the paper's.
    pub struct ContrastiveConfig {
        /// Weight in the objective; default 0.02.
        pub weight: f64 = 0.02,
        /// τ.
        pub temperature: f64 = AggregatedContrastive::default().temperature,
        /// `"always"`, `"skip"` or `{ last = PERCENT }`.
        pub schedule: TermSchedule = AggregatedContrastive::default().schedule,
        /// Classes with fewer rows are left out.
        pub min_points: usize = AggregatedContrastive::default().min_points,
        /// Where the classes come from.
        pub classes: ClassSourceConfig = ClassSourceConfig::Labels,
        /// Mean over the classes, or sum.
        pub reduction: Reduction = AggregatedContrastive::default().reduction,
    }
}

/// [`ClassSource`] without its table.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClassSourceConfig {
    /// No classes: the term is off.
    Off,
    /// The labels of the data: ground truth.
    #[default]
    Labels,
    /// The nearest of the data's texts.
    PseudoLabels,
    /// The largest channel of the target.
    Argmax,
}

settings! {
    /// Settings of [`CrossEntropy`].
    pub struct CrossEntropyConfig {
        /// Weight in the objective; default 1.
        pub weight: f64 = 1.0,
        /// In `0..1`; default 0.
        pub label_smoothing: f64 = 0.0,
        /// One for each class.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub class_weights: Option<Vec<f64>> = None,
    }

    /// Settings of [`LovaszSoftmax`].
    pub struct LovaszConfig {
        /// Weight in the objective; default 1.
        pub weight: f64 = 1.0,
    }

    /// Settings of [`TextClassification`].
    pub struct TextClassificationConfig {
        /// Weight in the objective; default 1.
        pub weight: f64 = 1.0,
        /// τ; default 0.1.
        pub temperature: f64 = 0.1,
        /// Weight of the Lovász term; default 1.
        pub lovasz: f64 = 1.0,
        /// Share of each target that is spread over all classes, 0..1.
        pub label_smoothing: f64 = 0.0,
    }
}

impl TextClassificationConfig {
    fn build(&self, texts: Option<&TextColumns>) -> Result<TextClassification, LossError> {
        const LOSS: &str = "text_classification";
        check_positive(LOSS, "temperature", self.temperature)?;
        let weight = self.lovasz >= 0.0 && self.lovasz.is_finite();
        check_setting(LOSS, "lovasz", self.lovasz, weight, "a finite number ≥ 0")?;
        check_smoothing(LOSS, self.label_smoothing, None)?;
        let texts = needed(LOSS, texts)?;
        let Self { temperature, lovasz, label_smoothing, .. } = *self;
        Ok(TextClassification { texts, temperature, lovasz, label_smoothing })
    }
}

/// The texts, which the loss cannot do without.
fn needed(loss: &'static str, texts: Option<&TextColumns>) -> Result<TextColumns, LossError> {
    let (value, expected) = ("none".to_owned(), "data that come with text embeddings");
    texts.cloned().ok_or(LossError::Setting { loss, setting: "texts", value, expected })
}

settings! {
    /// Settings of [`TextDistillation`].
    pub struct TextDistillationConfig {
        /// Weight in the objective; default 1.
        pub weight: f64 = 1.0,
        /// τ; default 0.05.
        pub temperature: f64 = 0.05,
        /// Mean over the valid rows, or sum.
        pub reduction: Reduction = Reduction::Mean,
    }
}

impl TextDistillationConfig {
    fn build(&self, texts: Option<&TextColumns>) -> Result<TextDistillation, LossError> {
        const LOSS: &str = "text_distillation";
        check_positive(LOSS, "temperature", self.temperature)?;
        let Self { temperature, reduction, .. } = *self;
        Ok(TextDistillation { texts: needed(LOSS, texts)?, temperature, reduction })
    }
}

impl ContrastiveConfig {
    fn build(&self, texts: Option<&TextColumns>) -> Result<AggregatedContrastive, LossError> {
        const LOSS: &str = "aggregated_contrastive";
        check_positive(LOSS, "temperature", self.temperature)?;
        if let TermSchedule::Last(percent) = self.schedule {
            let good = (0.0..=100.0).contains(&percent);
            check_setting(LOSS, "schedule.last", percent, good, "a percentage, 0..=100")?;
        }
        let min_points = self.min_points;
        check_setting(LOSS, "min_points", min_points as f64, min_points >= 2, "at least 2")?;
        let classes = match self.classes {
            ClassSourceConfig::Off => ClassSource::Off,
            ClassSourceConfig::Labels => ClassSource::Labels,
            ClassSourceConfig::Argmax => ClassSource::Argmax,
            ClassSourceConfig::PseudoLabels => {
                let missing = LossError::Setting {
                    loss: LOSS,
                    setting: "classes",
                    value: "pseudo_labels".to_owned(),
                    expected: "another source, or data that come with text embeddings",
                };
                ClassSource::PseudoLabels(texts.ok_or(missing)?.clone())
            }
        };
        let Self { temperature, schedule, min_points, reduction, .. } = *self;
        Ok(AggregatedContrastive { temperature, schedule, min_points, classes, reduction })
    }
}

impl CrossEntropyConfig {
    fn build(&self) -> Result<CrossEntropy, LossError> {
        check_smoothing("cross_entropy", self.label_smoothing, self.class_weights.as_deref())?;
        let Self { label_smoothing, class_weights, .. } = self.clone();
        Ok(CrossEntropy { label_smoothing, class_weights })
    }
}

/// The objective of a list of terms.
///
/// # Errors
/// As [`LossConfig::build`], or if there is no term.
pub fn build_objective(
    terms: &[LossConfig],
    texts: Option<&TextColumns>,
) -> Result<Objective, LossError> {
    let count = terms.len();
    check_setting(OBJECTIVE, "number of terms", count as f64, count > 0, "at least 1")?;
    terms.iter().try_fold(Objective::new(), |objective, term| {
        Ok(objective.with(term.weight(), term.build(texts)?))
    })
}
