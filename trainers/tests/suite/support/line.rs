//! A model small enough to check by hand, and data for it.

use candle_core::{Device, Result, Tensor};
use rand_chacha::rand_core::RngCore;
use scenesplat_datasets::{BatchLoader, DataError};
use scenesplat_models::ParamStore;
use scenesplat_trainers::{StepContext, StepOutput, TrainingModule};

/// `y = x·w + noise`, whose noise comes from the step's generator.
pub struct Line {
    pub params: ParamStore,
    pub weight: Tensor,
    pub bias: Tensor,
    pub use_bias: bool,
    pub noise: f64,
}

impl Line {
    pub fn new() -> Self {
        let params = ParamStore::trainable(1);
        let init = candle_nn::Init::Uniform { lo: -1.0, up: 1.0 };
        let vb = params.builder();
        let weight = vb.get_with_hints((4, 1), "weight", init).unwrap();
        let bias = vb.get_with_hints(1, "bias", init).unwrap();
        Self { params, weight, bias, use_bias: true, noise: 0.01 }
    }

    /// The bias, then the weights.
    pub fn values(&self) -> Vec<f32> {
        self.params.parameters().values().flat_map(|v| super::flat(v)).collect()
    }
}

pub type Rows = Vec<[f32; 4]>;

impl TrainingModule for Line {
    type Batch = Rows;
    fn params(&self) -> &ParamStore {
        &self.params
    }
    fn training_step(&self, batch: &Rows, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        let noise = f64::from(cx.forward.rng.next_u32()) / f64::from(u32::MAX) * self.noise;
        let x = Tensor::from_vec(batch.concat(), (batch.len(), 4), &Device::Cpu)?;
        let target = (x.sum_keepdim(1)? * 0.5)?.affine(1.0, noise)?;
        let mut y = x.matmul(&self.weight)?;
        if self.use_bias {
            y = y.broadcast_add(&self.bias)?;
        }
        let loss = (y - target)?.sqr()?.mean_all()?;
        let terms = vec![("square".to_owned(), f64::from(loss.to_scalar::<f32>()?))];
        let rows = batch.len();
        Ok(StepOutput { loss, rows, counted_rows: rows, terms, features: None })
    }
    fn scenes(&self, batch: &Rows) -> Vec<String> {
        vec![format!("rows-{}", batch[0][0])]
    }
    fn suspects(&self, batch: &Rows) -> Vec<String> {
        let bad = batch.iter().flatten().any(|v| !v.is_finite());
        if bad { vec!["x is not finite".to_owned()] } else { Vec::new() }
    }
}

/// Batches that depend on epoch and place alone.
#[derive(Clone, Copy)]
pub struct Numbers {
    pub batches: usize,
    pub rows: usize,
    pub poison: Option<(u64, usize)>,
}

impl Numbers {
    pub fn batch(&self, epoch: u64, place: usize) -> Rows {
        let row = |r: usize| {
            std::array::from_fn(|c| {
                let phase = epoch as f32 * 31.0 + (place * 17 + r * 5 + c * 3) as f32;
                2.0 * ((phase * 12.9898).sin() * 43758.547).fract()
            })
        };
        let mut rows: Rows = (0..self.rows).map(row).collect();
        if self.poison == Some((epoch, place)) {
            rows[0][2] = f32::NAN;
        }
        rows
    }
}

impl BatchLoader<Rows> for Numbers {
    fn batches_per_epoch(&self) -> usize {
        self.batches
    }
    fn epoch(
        &mut self,
        epoch: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = std::result::Result<Rows, DataError>> + '_> {
        Box::new((skip..self.batches).map(move |place| Ok(self.batch(epoch, place))))
    }
}

/// Seven batches of five rows.
pub fn numbers() -> Numbers {
    Numbers { batches: 7, rows: 5, poison: None }
}
