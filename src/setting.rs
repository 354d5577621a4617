//! What a result costs and is worth, as one string: `voxel=0.04,precision=bf16,patch=256,k=8`.
//!
//! `docs/settings.md` says what each part changes.

mod apply;
mod error;
mod parse;

pub use error::SettingError;

use scenesplat_datasets::Anchor;
use scenesplat_kernels::Precision;
use scenesplat_models::LastStage;
use std::fmt;

/// Choices that trade accuracy for time, each by its key. A part that is not named stays as the
/// command has it.
///
/// ```
/// use scenesplat::setting::Setting;
///
/// let setting: Setting = "patch=256,voxel=0.04".parse()?;
/// assert_eq!(setting.to_string(), "voxel=0.04,patch=256");
/// assert_eq!(setting.or(&"k=8,patch=64".parse()?).to_string(), "voxel=0.04,patch=256,k=8");
/// let error = "voxels=0.04".parse::<Setting>().unwrap_err().to_string();
/// assert!(error.contains("known are voxel, net,"));
/// # Ok::<(), scenesplat::setting::SettingError>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Setting {
    /// `voxel`: size of the network's voxels, meters, above 0, at most 1,000,000.
    pub voxel: Option<f64>,
    /// `net`: `embedded`, the name of a configuration (whose weights are given otherwise), a
    /// configuration file, or a model folder or checkpoint.
    pub net: Option<String>,
    /// `precision`: form of the numbers that products multiply.
    pub precision: Option<Precision>,
    /// `patch`: points of an attention patch, in all stages, 1 to 65536.
    pub patch: Option<usize>,
    /// `stage`: voxels of the last decoder stage.
    pub stage: Option<LastStage>,
    /// `rank`: rank of the convolutions of the last decoder stage, 1 to their width.
    pub rank: Option<usize>,
    /// `passes`: how often the network runs.
    pub passes: Option<Passes>,
    /// `tta`: copies of the scene, turned and scaled, whose mean is the result, 1 to 12.
    pub tta: Option<usize>,
    /// `anchor`: where voxels are counted from, `box` or `world`.
    pub anchor: Option<Anchor>,
    /// `codes`: numbers of a feature, 1 to 256 and fewer than the network gives.
    pub codes: Option<usize>,
    /// `k`: neighbors that vote on a label, at most 4096; 0 and 1 are no vote.
    pub k: Option<usize>,
}

/// How often the network runs over a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Passes {
    /// 1: one Gaussian a voxel. More: the first so many passes of [`All`](Self::All).
    Count(usize),
    /// Until each Gaussian of a sampling at half the voxel size was read, layer by layer: the
    /// original's steps.
    All,
}

impl fmt::Display for Passes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count(count) => count.fmt(f),
            Self::All => f.write_str("all"),
        }
    }
}

impl Setting {
    /// All keys, in the order in which a setting is written.
    pub const KEYS: [&'static str; 11] = [
        "voxel",
        "net",
        "precision",
        "patch",
        "stage",
        "rank",
        "passes",
        "tta",
        "anchor",
        "codes",
        "k",
    ];

    /// The parts that are named, in the order of [`KEYS`](Self::KEYS), with their values.
    pub fn parts(&self) -> Vec<(&'static str, String)> {
        fn text<T: fmt::Display>(value: &Option<T>) -> Option<String> {
            value.as_ref().map(T::to_string)
        }
        let values = [
            text(&self.voxel),
            text(&self.net),
            text(&self.precision),
            text(&self.patch),
            text(&self.stage),
            text(&self.rank),
            text(&self.passes),
            text(&self.tta),
            self.anchor.map(|anchor| anchor.name().to_owned()),
            text(&self.codes),
            text(&self.k),
        ];
        let named = Self::KEYS.into_iter().zip(values);
        named.filter_map(|(key, value)| Some((key, value?))).collect()
    }

    /// Whether no part is named.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// The parts of this setting, and of the other where this one names none.
    #[must_use]
    pub fn or(&self, other: &Self) -> Self {
        Self {
            voxel: self.voxel.or(other.voxel),
            net: self.net.clone().or_else(|| other.net.clone()),
            precision: self.precision.or(other.precision),
            patch: self.patch.or(other.patch),
            stage: self.stage.or(other.stage),
            rank: self.rank.or(other.rank),
            passes: self.passes.or(other.passes),
            tta: self.tta.or(other.tta),
            anchor: self.anchor.or(other.anchor),
            codes: self.codes.or(other.codes),
            k: self.k.or(other.k),
        }
    }
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, (key, value)) in self.parts().iter().enumerate() {
            write!(f, "{}{key}={value}", if i > 0 { "," } else { "" })?;
        }
        Ok(())
    }
}
