//! Whether features still differ and statistics still make sense, although every number is finite.

use crate::TrainError;
use crate::config::HealthConfig;
use candle_core::{DType, Tensor};
use scenesplat_metrics::Measurement;
use scenesplat_metrics::collapse::{centred_cosine, effective_rank};
use scenesplat_models::ParamStore;

/// Rows looked at.
const ROWS: usize = 512;

/// What a look found.
#[derive(Debug, Default)]
pub(crate) struct Health {
    pub(crate) measurements: Vec<Measurement>,
    pub(crate) alarms: Vec<String>,
    /// Whether the features collapse.
    pub(crate) collapsed: bool,
}

/// Looks at a sample of the feature rows and at the running variances.
pub(crate) fn look(
    config: &HealthConfig,
    features: Option<&Tensor>,
    params: &ParamStore,
    seed: u64,
) -> Result<Health, TrainError> {
    let mut health = Health::default();
    let tensor = |source| TrainError::Forward { source };
    if let Some(features) = features {
        let (rows, width) = features.dims2().map_err(tensor)?;
        let sample = sample(rows, seed);
        let chosen = Tensor::new(sample.as_slice(), features.device())
            .and_then(|rows| features.index_select(&rows, 0)?.to_dtype(DType::F32))
            .and_then(|t| t.flatten_all()?.to_vec1::<f32>())
            .map_err(tensor)?;
        if let Some(rank) = effective_rank(&chosen, width)? {
            health.note("effective_rank", rank);
            if rank < config.min_effective_rank {
                health.collapsed = true;
                health.alarms.push(format!(
                    "the features have an effective rank of {rank:.2} (of {width}): they collapse \
                     onto a line; lower the learning rate or give the loss a contrastive term"
                ));
            }
        }
        if let Some(cosine) = centred_cosine(&chosen, width)? {
            health.note("centred_cosine", cosine);
            if cosine > config.max_centred_cosine {
                health.collapsed = true;
                health.alarms.push(format!(
                    "rows of features are alike (mean cosine {cosine:.3} after taking off their \
                     mean)"
                ));
            }
        }
    }
    health.running_variances(config, params)?;
    Ok(health)
}

impl Health {
    fn note(&mut self, name: &str, value: f64) {
        self.measurements.push(Measurement::new(format!("health/{name}"), value));
    }

    fn running_variances(
        &mut self,
        config: &HealthConfig,
        params: &ParamStore,
    ) -> Result<(), TrainError> {
        let (mut least, mut most) = (f32::INFINITY, f32::NEG_INFINITY);
        for (name, var) in params.buffers() {
            if !name.ends_with("running_var") {
                continue;
            }
            let values: Vec<f32> =
                var.flatten_all().and_then(|v| v.to_vec1()).map_err(TrainError::tensor(&name))?;
            for value in values {
                (least, most) = (least.min(value), most.max(value));
                let value = f64::from(value);
                if value < config.min_running_var || value > config.max_running_var {
                    self.alarms.push(format!(
                        "{name}: a channel has the variance {value:e}; it is {}",
                        if value < 1.0 { "dead" } else { "exploding" }
                    ));
                    break;
                }
            }
        }
        if least <= most {
            self.note("min_running_var", f64::from(least));
            self.note("max_running_var", f64::from(most));
        }
        Ok(())
    }
}

/// At most [`ROWS`] rows, evenly spread from a seeded start, ascending.
fn sample(rows: usize, seed: u64) -> Vec<u32> {
    let stride = rows.div_ceil(ROWS).max(1);
    (seed as usize % stride..rows).step_by(stride).map(|r| r as u32).collect()
}
