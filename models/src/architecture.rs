//! The architectures: one row each.
//!
//! A new one is a file with its configuration, its network and its [`Architecture`], its names in
//! `lib.rs`, and a row here. Nothing else asks which architecture a network has.

use crate::weights::Shapes;
use crate::{Backbone, BackboneCost, Compute, LastStage, MultiplyAdds};
use candle_core::Result;
use candle_nn::VarBuilder;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// Why the last decoder stage cannot be shortened.
pub(crate) const NO_LAST_STAGE: &str =
    "only Point Transformer V3 with blocks in its last decoder stage can be shortened there";

/// What a backbone's configuration says about it, without building anything.
///
/// The fields of the configuration are what a file may say (`deny_unknown_fields`, `default`).
pub trait Architecture: std::fmt::Debug {
    /// Checks that the fields fit together.
    ///
    /// # Errors
    /// Names the first field that does not.
    fn check(&self) -> Result<()>;
    /// Builds the network; its parameters stand directly under `vb`.
    ///
    /// # Errors
    /// If the fields do not fit together, or parameters exist with another shape.
    fn build(&self, vb: VarBuilder<'_>) -> Result<Box<dyn Backbone>>;
    /// Width of the input features.
    fn in_channels(&self) -> usize;
    /// Width of the output.
    fn out_channels(&self) -> usize;
    /// Values of all parameters and buffers.
    fn num_values(&self) -> usize;
    /// What inference costs.
    fn cost(&self) -> BackboneCost;
    /// Multiply–adds of a forward pass on the voxels of one scene, for measurements. `frozen`: layers
    /// are joined as inference joins them ([`Compute::fold`]); the linear layer behind a convolution is a
    /// part of it then.
    ///
    /// # Errors
    /// If the voxels are out of range, or the architecture does not count them.
    fn multiply_adds(&self, voxels: &[[i32; 3]], frozen: bool) -> Result<MultiplyAdds> {
        _ = (voxels, frozen);
        candle_core::bail!("multiply–adds of this architecture are not counted")
    }
    /// How the network computes.
    fn compute(&self) -> Compute;
    /// Sets how the network computes; no part of what a file says.
    fn set_compute(&mut self, compute: Compute);
    /// Cuts all attention into patches of so many points.
    ///
    /// # Errors
    /// Says why not, where there are no such patches.
    fn set_patch_size(&mut self, points: usize) -> std::result::Result<(), String> {
        _ = points;
        Err("this architecture has no attention patches".to_owned())
    }
    /// Runs the blocks of the last decoder stage on other voxels.
    ///
    /// # Errors
    /// Says why not, where there are no such blocks.
    fn set_last_stage(&mut self, stage: LastStage) -> std::result::Result<(), String> {
        _ = stage;
        Err(NO_LAST_STAGE.to_owned())
    }
    /// Gives the convolutions of the last decoder stage a rank, once they saw an example
    /// ([`Backbone::calibrated`]).
    ///
    /// # Errors
    /// Says why not, where there are none, or none so wide.
    fn set_rank(&mut self, rank: usize) -> std::result::Result<(), String> {
        _ = rank;
        Err(NO_LAST_STAGE.to_owned())
    }
    /// Takes from a checkpoint what its first layer says of the number of inputs. Only for networks
    /// that are told by name; a file says its number itself.
    fn adapt_to(&mut self, shapes: &Shapes) {
        _ = shapes;
    }
    /// Whether a checkpoint's weights are those of this network, as far as their shapes show.
    fn fits(&self, shapes: &Shapes) -> bool {
        _ = shapes;
        false
    }
}

macro_rules! architectures {
    ($($variant:ident($config:ty) = $name:literal: $about:literal;)*) => {
        /// Which backbone, with its shape. In a file, `architecture` is its name and the other
        /// entries are the fields of its configuration.
        #[derive(Debug, Clone, PartialEq, Serialize)]
        #[serde(untagged)]
        pub enum BackboneConfig {
            $(#[doc = $about] $variant($config),)*
        }

        impl BackboneConfig {
            /// Names of all architectures; the first is meant where a file names none.
            pub const NAMES: &'static [&'static str] = &[$($name),*];

            /// Name of the architecture.
            pub fn name(&self) -> &'static str {
                match self {
                    $(Self::$variant(_) => $name,)*
                }
            }

            /// The configuration, whatever the architecture.
            pub fn get(&self) -> &dyn Architecture {
                match self {
                    $(Self::$variant(config) => config,)*
                }
            }

            /// As [`get`](Self::get), to be changed.
            pub fn get_mut(&mut self) -> &mut dyn Architecture {
                match self {
                    $(Self::$variant(config) => config,)*
                }
            }

            /// The fields of an architecture; those that are left out have their default.
            ///
            /// # Errors
            /// Names the field that is unknown or of a wrong type, or the unknown architecture.
            pub fn from_fields(
                name: &str,
                fields: Map<String, Value>,
            ) -> std::result::Result<Self, String> {
                match name {
                    $($name => read(fields).map(Self::$variant),)*
                    other => Err(format!(
                        "architecture: {other:?} is none; known are {}",
                        Self::NAMES.join(", ")
                    )),
                }
            }
        }

        $(impl From<$config> for BackboneConfig {
            fn from(config: $config) -> Self {
                Self::$variant(config)
            }
        })*
    };
}

architectures! {
    PointTransformerV3(crate::PointTransformerV3Config) = "point_transformer_v3":
        "Attention in patches of space-filling curves.";
    PointTransformerV1(crate::PointTransformerV1Config) = "point_transformer_v1":
        "Vector attention over nearest neighbors.";
    PointTransformerV2(crate::PointTransformerV2Config) = "point_transformer_v2":
        "Grouped vector attention over nearest neighbors.";
    LitePt(crate::LitePtConfig) = "litept":
        "Convolutions on fine voxels, attention on coarse ones.";
}

/// Fields of a configuration; an error begins with the field's name.
fn read<T: DeserializeOwned>(fields: Map<String, Value>) -> std::result::Result<T, String> {
    let whole = serde_json::from_value(Value::Object(fields.clone()));
    whole.map_err(|error| {
        // Each field has a default, so each can be read alone: that tells which one is wrong.
        for (name, value) in fields {
            let alone = Map::from_iter([(name.clone(), value)]);
            if let Err(error) = serde_json::from_value::<T>(Value::Object(alone)) {
                let text = error.to_string();
                return if text.contains(&name) { text } else { format!("{name}: {text}") };
            }
        }
        error.to_string()
    })
}
