//! Settings of self-supervised training.

use crate::CosineSchedule;
use crate::TrainError;
use crate::error::check_setting;
use scenesplat_datasets::{MaskShape, Masking};
use scenesplat_kernels::settings;
use scenesplat_losses::self_supervised::{Expansion, GaussianDistance, SimDino};
use serde::{Deserialize, Serialize};

settings! {
    /// Self-supervised training: a sum of terms over views of scenes, with a teacher where a term asks for
    /// one.
    pub struct SelfSupervisedConfig {
        /// Whether teacher and heads follow the original where we think that it errs.
        pub compat: Compat = Compat::None,
        /// Which network becomes the model folder.
        pub export: Export = Export::Student,
        /// Momentum of the teacher: after optimizer step `n` it keeps `momentum(n)` of itself.
        pub momentum: CosineSchedule = CosineSchedule::teacher_momentum(),
        /// What the student does not see of global views; `None` (`"none"` in files): all is seen.
        #[serde(with = "masking_or_none")]
        pub masking: Option<Masking> = Some(Masking::default()),
        /// Edge of masked patches over the run, meters, in the place of the one in `masking`.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub mask_size: Option<CosineSchedule> = None,
        /// Share of masked patches over the run, in the place of the one in `masking`.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub mask_ratio: Option<CosineSchedule> = None,
        /// The terms; each kind at most once.
        pub terms: Vec<TermConfig> = Vec::new(),
    }
}

/// `None` is a word in files: an entry that is left out means the default.
mod masking_or_none {
    use scenesplat_datasets::Masking;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

    pub(super) fn serialize<S: Serializer>(
        masking: &Option<Masking>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        match masking {
            Some(masking) => masking.serialize(serializer),
            None => serializer.serialize_str("none"),
        }
    }

    struct Visitor;

    impl<'de> de::Visitor<'de> for Visitor {
        type Value = Option<Masking>;

        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("a table of shape, ratio, scenes and weight, or \"none\"")
        }

        fn visit_str<E: de::Error>(self, word: &str) -> Result<Self::Value, E> {
            match word {
                "none" => Ok(None),
                word => Err(E::invalid_value(de::Unexpected::Str(word), &self)),
            }
        }

        fn visit_unit<E: de::Error>(self) -> Result<Self::Value, E> {
            Ok(None)
        }

        fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
            Masking::deserialize(de::value::MapAccessDeserializer::new(map)).map(Some)
        }
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<Masking>, D::Error> {
        deserializer.deserialize_any(Visitor)
    }
}

/// Whose rules hold for teacher and heads.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Compat {
    /// Ours: the teacher begins as a copy of the student, has heads of its own that follow the
    /// student's, and drops no path; heads are trained; both global views are reconstructed.
    #[default]
    None,
    /// Those of SceneSplat be9d5e1: the teacher begins with other values, drops paths, and is read
    /// through the student's heads, which no optimizer sees; of masked Gaussians only those of the first
    /// global view are reconstructed; weights of masked Gaussians are rounded to f16.
    Original,
}

/// Which network becomes the model folder.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Export {
    /// The one that gradients move.
    #[default]
    Student,
    /// The one that follows it.
    Teacher,
}

/// A row for each term: its name (in files and logs, and that of its head's parameters) and settings, which
/// have a `weight`.
macro_rules! term_config {
    ($($(#[$doc:meta])* $kind:ident($settings:ty) = $name:literal;)*) => {
        /// One term of the loss.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(tag = "type", rename_all = "snake_case")]
        pub enum TermConfig {
            $($(#[$doc])* $kind($settings),)*
        }

        impl TermConfig {
            /// Its name in files and logs, and that of its head's parameters.
            pub fn name(&self) -> &'static str {
                match self {
                    $(Self::$kind(_) => $name,)*
                }
            }

            /// Weight in the loss.
            pub fn weight(&self) -> f64 {
                match self {
                    $(Self::$kind(term) => term.weight,)*
                }
            }
        }
    };
}

term_config! {
    /// Attributes of masked Gaussians.
    MaskedGaussians(MaskedGaussiansTerm) = "masked_gaussians";
    /// Vectors of scenes: alike in all views of one, unlike between scenes.
    SimDino(SimDinoTerm) = "sim_dino";
    /// Vectors of scenes: the teacher's distribution over prototypes.
    Dino(DinoTerm) = "dino";
    /// Masked Gaussians: the direction of the teacher's row.
    Ibot(IbotTerm) = "ibot";
    /// Masked Gaussians: the teacher's distribution over prototypes.
    IbotCrossEntropy(IbotCrossEntropyTerm) = "ibot_cross_entropy";
    /// Rows of a coarse scale, matched between views by their places: the teacher's distribution over
    /// prototypes.
    SelfDistillation(SelfDistillationTerm) = "self_distillation";
    /// Rows of a coarse scale, matched between views by their places: the teacher's direction, and a coding
    /// rate over rows.
    SimDinoRows(SimDinoRowsTerm) = "sim_dino_rows";
    /// The scenes' language features (codes of an autoencoder, say).
    LanguageAlignment(LanguageAlignmentTerm) = "language_alignment";
}

/// What prevents that one prototype takes all rows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Balance {
    /// A running mean of the teacher's logits is subtracted; a step keeps this share of it.
    Centering(f64),
    /// So many iterations of Sinkhorn and Knopp.
    SinkhornKnopp(usize),
}

/// What predicts the attributes of a masked Gaussian.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GaussianHeads {
    /// One head for all, without activation, as the released code.
    #[default]
    Joint,
    /// Three layers for each with an activation, as the paper says: hyperbolic tangent for colors and normals, logistic
    /// function for opacities and colors in 0 to 1, unit length for rotations; sizes and places are any number.
    PerAttribute,
}

settings! {
    /// Masked Gaussian modeling.
    pub struct MaskedGaussiansTerm {
        /// Weight in the loss.
        pub weight: f64 = 1.0,
        /// How far a reconstruction is from the Gaussian. `fitted` compares logarithms of sizes.
        pub distance: GaussianDistance = GaussianDistance::MeanSquare,
        /// What predicts the attributes.
        pub heads: GaussianHeads = GaussianHeads::Joint,
    }

    /// SimDINO.
    pub struct SimDinoTerm {
        /// Weight in the loss.
        pub weight: f64 = 1.0,
        /// Width inside of the head.
        pub hidden: usize = 2048,
        /// Width of the vectors.
        pub out: usize = 256,
        /// Weight of the compression beside the coding rate.
        pub coefficient: f64 = 0.1,
        /// Distortion of the coding rate, above 0.
        pub epsilon: f64 = 0.05,
        /// Whose vectors are kept apart.
        pub expansion: Expansion = Expansion::StudentAndTeacher,
    }

    /// Distributions over prototypes.
    pub struct Prototypes {
        /// How many.
        pub count: usize = 1024,
        /// Width inside of the head.
        pub hidden: usize = 2048,
        /// Width of the rows that prototypes are compared with.
        pub out: usize = 256,
        /// Temperature of the student.
        pub student_temperature: f64 = 0.1,
        /// Temperature of the teacher over the run.
        pub teacher_temperature: CosineSchedule = CosineSchedule::teacher_temperature(),
        /// What prevents that one prototype takes all rows.
        pub balance: Balance = Balance::SinkhornKnopp(3),
    }

    /// DINO.
    pub struct DinoTerm {
        /// Weight in the loss.
        pub weight: f64 = 1.0,
        /// The distributions.
        pub prototypes: Prototypes = Prototypes::default(),
    }

    /// iBOT as the original computes it.
    pub struct IbotTerm {
        /// Weight in the loss.
        pub weight: f64 = 1.0,
        /// Width inside of the head.
        pub hidden: usize = 256,
        /// Width of the rows that are compared.
        pub out: usize = 32,
    }

    /// iBOT as it is named.
    pub struct IbotCrossEntropyTerm {
        /// Weight in the loss.
        pub weight: f64 = 1.0,
        /// The distributions.
        pub prototypes: Prototypes = Prototypes { hidden: 256, out: 32, ..Prototypes::default() },
    }

    /// Self-distillation of rows, after Sonata.
    pub struct SelfDistillationTerm {
        /// Weight in the loss.
        pub weight: f64 = 1.0,
        /// The distributions.
        pub prototypes: Prototypes = Prototypes {
            count: 4096,
            hidden: 4096,
            teacher_temperature: CosineSchedule { warmup: 0.05, ..CosineSchedule::teacher_temperature() },
            ..Prototypes::default()
        },
        /// How many scales above the coarsest one the rows are compared at, with all coarser scales beside
        /// them.
        pub up_cast: usize = MatchedRows::default().up_cast,
        /// Largest distance of matched rows, by their places before augmentation, meters.
        pub max_distance: f64 = MatchedRows::default().max_distance,
        /// Shares of masked views against the teacher's same view, against its other views, and of local
        /// views against its first view.
        pub shares: [f64; 3] = MatchedRows::default().shares,
    }

    /// SimDINO of rows of a coarse scale.
    pub struct SimDinoRowsTerm {
        /// Weight in the loss.
        pub weight: f64 = 1.0,
        /// Width inside of the head.
        pub hidden: usize = 512,
        /// Width of the vectors.
        pub out: usize = 128,
        /// Weight of the compression beside the coding rate.
        pub coefficient: f64 = 1.0,
        /// Distortion of the coding rate, above 0.
        pub epsilon: f64 = 0.05,
        /// Whose vectors are kept apart.
        pub expansion: Expansion = Expansion::StudentAndTeacher,
        /// Most rows of a pair of views that are compared, evenly along the curve through them.
        pub max_rows: usize = 1024,
        /// How many scales above the coarsest one the rows are compared at, with all coarser scales beside
        /// them.
        pub up_cast: usize = MatchedRows::default().up_cast,
        /// Largest distance of matched rows, by their places before augmentation, meters.
        pub max_distance: f64 = MatchedRows::default().max_distance,
        /// Shares of masked views against the teacher's same view, against its other views, and of local
        /// views against its first view.
        pub shares: [f64; 3] = MatchedRows::default().shares,
    }

    /// Language alignment: cosine and square distance to the scenes' features.
    pub struct LanguageAlignmentTerm {
        /// Weight in the loss.
        pub weight: f64 = 1.0,
        /// Width of the features: that of the scenes' `lang_feat`.
        pub out: usize = 16,
        /// Width inside of the head.
        pub hidden: usize = 32,
        /// Whether only masked Gaussians count, as beside masked Gaussian modeling in the paper.
        pub masked_only: bool = true,
    }
}

impl SimDinoTerm {
    pub(super) fn settings(&self) -> SimDino {
        let Self { coefficient, epsilon, expansion, .. } = *self;
        SimDino { coefficient, epsilon, expansion, normalized: true }
    }
}

impl SelfDistillationTerm {
    pub(super) fn matching(&self) -> MatchedRows {
        let Self { up_cast, max_distance, shares, .. } = *self;
        MatchedRows { up_cast, max_distance, shares }
    }
}

impl SimDinoRowsTerm {
    pub(super) fn settings(&self) -> SimDino {
        let Self { coefficient, epsilon, expansion, .. } = *self;
        SimDino { coefficient, epsilon, expansion, normalized: true }
    }

    pub(super) fn matching(&self) -> MatchedRows {
        let Self { up_cast, max_distance, shares, .. } = *self;
        MatchedRows { up_cast, max_distance, shares }
    }
}

/// Which rows of views are partners, and what pairs of views count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MatchedRows {
    pub up_cast: usize,
    pub max_distance: f64,
    pub shares: [f64; 3],
}

impl Default for MatchedRows {
    fn default() -> Self {
        Self { up_cast: 2, max_distance: 0.32, shares: [0.25, 0.25, 0.5] }
    }
}

impl MatchedRows {
    fn check(&self) -> Result<(), TrainError> {
        above("max_distance", self.max_distance)?;
        for share in self.shares {
            check_setting("shares", share, share.is_finite() && share >= 0.0, "0 or more")?;
        }
        above("shares", self.shares.iter().sum())
    }
}

impl TermConfig {
    /// Whether it compares with a teacher.
    pub fn has_teacher(&self) -> bool {
        !matches!(self, Self::MaskedGaussians(_) | Self::LanguageAlignment(_))
    }

    /// Whether it reads rows of the finest scale, for which the decoder runs.
    pub fn reads_rows(&self) -> bool {
        !matches!(
            self,
            Self::SimDino(_) | Self::Dino(_) | Self::SelfDistillation(_) | Self::SimDinoRows(_)
        )
    }

    /// Whether the teacher's rows of the finest scale are read.
    pub(super) fn reads_rows_of_teacher(&self) -> bool {
        matches!(self, Self::Ibot(_) | Self::IbotCrossEntropy(_))
    }

    /// Whether it looks at masked Gaussians alone.
    pub fn needs_mask(&self) -> bool {
        match self {
            Self::MaskedGaussians(_) | Self::Ibot(_) | Self::IbotCrossEntropy(_) => true,
            Self::LanguageAlignment(term) => term.masked_only,
            _ => false,
        }
    }

    /// Distributions over prototypes, if it has them.
    pub(super) fn prototypes(&self) -> Option<&Prototypes> {
        match self {
            Self::Dino(term) => Some(&term.prototypes),
            Self::IbotCrossEntropy(term) => Some(&term.prototypes),
            Self::SelfDistillation(term) => Some(&term.prototypes),
            _ => None,
        }
    }

    /// Names of the centers that it may have.
    pub(super) fn center_names(&self) -> Vec<String> {
        match self {
            Self::SelfDistillation(t) => {
                let [same, other, local] = t.shares;
                let kinds = [("masked", same > 0.0 || other > 0.0), ("local", local > 0.0)];
                let on = kinds.into_iter().filter(|(_, on)| *on);
                on.map(|(kind, _)| format!("self_distillation.{kind}")).collect()
            }
            term => vec![term.name().to_owned()],
        }
    }

    fn sizes(&self) -> Vec<(&'static str, usize)> {
        match self {
            Self::SimDino(t) => vec![("hidden", t.hidden), ("out", t.out)],
            Self::SimDinoRows(t) => {
                vec![("hidden", t.hidden), ("out", t.out), ("max_rows", t.max_rows)]
            }
            Self::Ibot(t) => vec![("hidden", t.hidden), ("out", t.out)],
            Self::LanguageAlignment(t) => vec![("hidden", t.hidden), ("out", t.out)],
            _ => self.prototypes().map_or(Vec::new(), |p| {
                vec![
                    ("prototypes.count", p.count),
                    ("prototypes.hidden", p.hidden),
                    ("prototypes.out", p.out),
                ]
            }),
        }
    }

    fn check(&self) -> Result<(), TrainError> {
        above("weight", self.weight())?;
        for (field, size) in self.sizes() {
            check_setting(field, size as f64, (1..=1 << 16).contains(&size), "in 1..=65536")?;
        }
        if let Some(prototypes) = self.prototypes() {
            above("prototypes.student_temperature", prototypes.student_temperature)?;
            let schedule = prototypes.teacher_temperature;
            schedule.check()?;
            above("prototypes.teacher_temperature.from", schedule.from)?;
            above("prototypes.teacher_temperature.to", schedule.to)?;
            if schedule.warmup > 0.0 {
                above("prototypes.teacher_temperature.warmup_from", schedule.warmup_from)?;
            }
            if let Balance::Centering(m) = prototypes.balance {
                let share = (0.0..=1.0).contains(&m);
                check_setting("prototypes.balance.centering", m, share, "in 0..=1")?;
            }
        }
        match self {
            Self::SimDino(SimDinoTerm { epsilon, coefficient, .. })
            | Self::SimDinoRows(SimDinoRowsTerm { epsilon, coefficient, .. }) => {
                above("epsilon", *epsilon)?;
                let finite = coefficient.is_finite();
                check_setting("coefficient", *coefficient, finite, "a finite number")?;
            }
            _ => {}
        }
        match self {
            Self::SelfDistillation(term) => term.matching().check(),
            Self::SimDinoRows(term) => term.matching().check(),
            _ => Ok(()),
        }
    }
}

fn above(field: &'static str, value: f64) -> Result<(), TrainError> {
    let good = value.is_finite() && value > 0.0;
    check_setting(field, value, good, "a finite number above 0")
}

impl SelfSupervisedConfig {
    /// Whether there is a teacher.
    pub fn has_teacher(&self) -> bool {
        self.terms.iter().any(TermConfig::has_teacher)
    }

    /// Checks that the settings fit together.
    ///
    /// # Errors
    /// Names the first that does not.
    pub fn check(&self) -> Result<(), TrainError> {
        let wrong = |setting: &'static str, problem: &str| {
            Err(TrainError::SelfSupervised { setting, problem: problem.to_owned() })
        };
        if self.terms.is_empty() {
            return wrong("terms", "at least one is needed");
        }
        for (i, term) in self.terms.iter().enumerate() {
            term.check()?;
            if self.terms[..i].iter().any(|other| other.name() == term.name()) {
                return wrong("terms", &format!("{} is there twice", term.name()));
            }
            if term.needs_mask() && self.masking.is_none() {
                let problem = format!("{} looks at masked Gaussians; give it", term.name());
                return wrong("masking", &problem);
            }
        }
        self.momentum.check()?;
        for value in [self.momentum.from, self.momentum.to] {
            check_setting("momentum", value, (0.0..=1.0).contains(&value), "in 0..=1")?;
        }
        if self.export == Export::Teacher && !self.has_teacher() {
            return wrong("export", "no term has a teacher; export the student");
        }
        if let Some(masking) = &self.masking {
            masking.check().or_else(|e| wrong("masking", &e.to_string()))?;
        } else if self.mask_size.is_some() || self.mask_ratio.is_some() {
            return wrong("masking", "mask_size and mask_ratio vary it; give it");
        }
        if let Some(size) = &self.mask_size {
            size.check()?;
            if matches!(self.masking, Some(Masking { shape: MaskShape::Gaussians, .. })) {
                return wrong("mask_size", "single Gaussians are masked, which have none");
            }
            for value in [size.from, size.to, size.warmup_from] {
                check_setting("mask_size", value, value > 0.0, "meters above 0")?;
            }
        }
        if let Some(ratio) = &self.mask_ratio {
            ratio.check()?;
            for value in [ratio.from, ratio.to, ratio.warmup_from] {
                check_setting("mask_ratio", value, (0.0..=1.0).contains(&value), "in 0..=1")?;
            }
        }
        Ok(())
    }

    /// How step `step` of `total` masks.
    pub fn masking_at(&self, step: u64, total: u64) -> Option<Masking> {
        let mut masking = self.masking?;
        if let Some(size) = &self.mask_size {
            masking.shape = MaskShape::Patches(size.value(step, total));
        }
        if let Some(ratio) = &self.mask_ratio {
            masking.ratio = [ratio.value(step, total); 2];
        }
        Some(masking)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_schedule_of_the_masked_share_sets_both_ends() {
        let masking = Masking { ratio: [0.1, 0.2], ..Masking::default() };
        let plain =
            SelfSupervisedConfig { masking: Some(masking), ..SelfSupervisedConfig::default() };
        assert_eq!(plain.masking_at(0, 10).unwrap().ratio, [0.1, 0.2]);
        let mask_ratio = Some(CosineSchedule::new(0.3, 0.7));
        let scheduled = SelfSupervisedConfig { mask_ratio, ..plain };
        assert_eq!(scheduled.masking_at(0, 10).unwrap().ratio, [0.3, 0.3]);
        let end = scheduled.masking_at(10, 10).unwrap().ratio;
        assert!(end.iter().all(|r| (r - 0.7).abs() < 1e-12), "{end:?}");
    }
}
