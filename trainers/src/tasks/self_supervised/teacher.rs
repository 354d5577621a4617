//! The network that the student is compared with.

use super::config::Compat;
use crate::{TrainError, ema_update};
use candle_core::{Device, Result};
use scenesplat_models::{
    Backbone, BackboneConfig, ModelConfig, ParamStore, PointTransformerV3Config,
};

/// Sets the teacher's seed apart from its student's, where it does not begin as a copy.
const OTHER_SEED: u64 = 0x7EAC_4E12;

/// A network that gets no gradient and follows its student after each step.
///
/// Its batch norms take the statistics of its own views, and remember them on their own: what is averaged
/// are parameters. It drops no path, but with [`Compat::Original`].
pub(super) struct Teacher {
    pub store: ParamStore,
    pub network: Box<dyn Backbone>,
}

impl Teacher {
    /// A network like the student's, without mask token: it sees everything.
    ///
    /// # Errors
    /// If the architecture does not give its scales.
    pub fn new(model: &ModelConfig, compat: Compat, seed: u64, device: &Device) -> Result<Self> {
        let mut backbone = point_transformer(model)?.clone();
        backbone.mask_token = false;
        if compat == Compat::None {
            backbone.drop_path = 0.0;
        }
        let backbone = BackboneConfig::PointTransformerV3(backbone);
        let model = ModelConfig { backbone, ..model.clone() };
        let store = ParamStore::trainable(seed ^ OTHER_SEED).on(device);
        let network = model.build(store.builder())?;
        Ok(Self { store, network })
    }

    /// Takes all values of a student that has the same names.
    ///
    /// # Errors
    /// If the student lacks one.
    pub fn copy_from(&self, student: &ParamStore) -> Result<()> {
        let (parameters, buffers) = (student.parameters(), student.buffers());
        for (name, var) in self.store.parameters().iter().chain(&self.store.buffers()) {
            let Some(value) = parameters.get(name).or_else(|| buffers.get(name)) else {
                candle_core::bail!("{name}: the student has no such parameter");
            };
            var.set(&value.as_detached_tensor().copy()?)?;
        }
        Ok(())
    }

    /// Moves parameters toward the student's; batch statistics stay its own.
    ///
    /// # Errors
    /// If the student lacks one.
    pub fn follow(
        &self,
        student: &ParamStore,
        momentum: f64,
    ) -> std::result::Result<(), TrainError> {
        ema_update(&self.store.parameters(), &student.parameters(), momentum)
    }
}

/// The settings of the backbone, which has to give its scales.
pub(super) fn point_transformer(model: &ModelConfig) -> Result<&PointTransformerV3Config> {
    match &model.backbone {
        BackboneConfig::PointTransformerV3(backbone) => Ok(backbone),
        other => candle_core::bail!(
            "model.architecture: {} does not give the rows of its scales; point_transformer_v3 does",
            other.name()
        ),
    }
}
