//! Reconstruction of masked Gaussians by a trained student.

use super::config::{SelfSupervisedConfig, TermConfig};
use super::heads::{Head, Widths};
use super::module::{checked_backbone, voxel_rows};
use super::step::indices;
use super::terms::LEAST_SIZE;
use crate::tasks::point_cloud;
use candle_core::{Result, Tensor, bail};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_datasets::{InputChannel, InputFeatures, TrainBatch};
use scenesplat_losses::self_supervised::GaussianDistance;
use scenesplat_models::{Backbone, Forward, LevelOptions, ModelConfig, ParamStore};

/// A trained student with its head of masked Gaussian modeling.
pub struct Reconstructor {
    network: Box<dyn Backbone>,
    head: Head,
    distance: GaussianDistance,
    input: InputFeatures,
}

impl std::fmt::Debug for Reconstructor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Reconstructor").field("input", &self.input).finish_non_exhaustive()
    }
}

impl Reconstructor {
    /// Takes the network's parameters from `params` and those of the head from `heads`: the same store,
    /// but for [`Compat::Original`](super::Compat::Original). Both may be frozen.
    ///
    /// # Errors
    /// If the run has no term `masked_gaussians`, or the network gives no rows of its scales.
    pub fn new(
        config: &SelfSupervisedConfig,
        model: &ModelConfig,
        input: &InputFeatures,
        params: &ParamStore,
        heads: &ParamStore,
    ) -> Result<Self> {
        let term = config.terms.iter().find(|t| matches!(t, TermConfig::MaskedGaussians(_)));
        let Some(term @ TermConfig::MaskedGaussians(settings)) = term else {
            let names: Vec<&str> = config.terms.iter().map(TermConfig::name).collect();
            bail!(
                "self_supervised.terms: masked_gaussians reconstructs Gaussians, and there are only {}",
                names.join(", ")
            );
        };
        let backbone = checked_backbone(config, model)?;
        let widths = Widths::new(model, backbone, input);
        Ok(Self {
            network: model.build(params.builder())?,
            head: Head::new(term, &widths, backbone.compute, heads)?,
            distance: settings.distance,
            input: input.clone(),
        })
    }

    /// What is reconstructed of the hidden rows of a batch, in its units (see [`InputFeatures`]): what the
    /// head gives, but sizes in meters, whatever the distance compares.
    ///
    /// # Shapes
    /// `hidden`: `[N]`, whether the network must not see a row · returns: `[H, input]`, row-major, the
    /// hidden rows in their order
    ///
    /// # Errors
    /// If the batch does not fit the network, or a value is not finite.
    pub fn rows(&self, batch: &TrainBatch, hidden: &[bool]) -> Result<Vec<f32>> {
        let chosen = indices(hidden);
        if chosen.is_empty() {
            return Ok(Vec::new());
        }
        // Nothing is drawn in evaluation.
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let options = LevelOptions { mask: Some(hidden), decoder: true };
        let mut forward = Forward::eval(&mut rng);
        let levels = self.network.forward_levels(&point_cloud(batch)?, options, &mut forward)?;
        let rows = voxel_rows(&levels)?;
        let rows = rows.index_select(&Tensor::new(chosen, rows.device())?, 0)?;
        let mut values: Vec<f32> = self.head.attributes(&rows)?.flatten_all()?.to_vec1()?;
        let width = self.input.width();
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            bail!("channel {} of reconstructed row {} is {}", at % width, at / width, values[at]);
        }
        if self.distance != GaussianDistance::MeanSquare {
            let mut start = 0;
            for channel in &self.input.channels {
                let columns = start..start + channel.width();
                start = columns.end;
                if *channel == InputChannel::Scale {
                    for row in values.chunks_exact_mut(width) {
                        row[columns.clone()].iter_mut().for_each(|v| *v = size_of_log(*v));
                    }
                }
            }
        }
        Ok(values)
    }
}

/// Meters of the logarithm of a size, which is not below what the logarithm is taken of.
fn size_of_log(log: f32) -> f32 {
    f64::from(log).exp().clamp(LEAST_SIZE, f64::from(f32::MAX)) as f32
}

#[cfg(test)]
mod tests {
    use super::super::{GaussianHeads, IbotTerm, MaskedGaussiansTerm};
    use super::*;
    use candle_core::Device;
    use scenesplat_models::PointTransformerV3Config;

    fn batch(places: i32) -> TrainBatch {
        let n = places as usize;
        TrainBatch {
            ids: vec!["scene".to_owned()],
            coord: (0..places).map(|x| [x as f32 * 0.1, 0.0, 0.0]).collect(),
            grid_coord: (0..places).map(|x| [x, 0, 0]).collect(),
            feat: (0..n * 11).map(|i| (i as f32 * 0.37).sin()).collect(),
            channels: 11,
            offsets: vec![0, n],
            ..TrainBatch::default()
        }
    }

    fn model() -> ModelConfig {
        let tiny = PointTransformerV3Config::tiny();
        ModelConfig::new(PointTransformerV3Config { in_channels: 11, mask_token: true, ..tiny })
    }

    fn config(terms: Vec<TermConfig>) -> SelfSupervisedConfig {
        SelfSupervisedConfig { terms, ..SelfSupervisedConfig::default() }
    }

    fn term(distance: GaussianDistance) -> TermConfig {
        TermConfig::MaskedGaussians(MaskedGaussiansTerm {
            distance,
            ..MaskedGaussiansTerm::default()
        })
    }

    #[test]
    fn hidden_rows_get_what_the_head_gives_sizes_in_metres() {
        let input = InputFeatures::default();
        for distance in
            [GaussianDistance::MeanSquare, GaussianDistance::Fitted, GaussianDistance::Ellipsoid]
        {
            let params = ParamStore::trainable(1);
            let config = config(vec![term(distance)]);
            let made = Reconstructor::new(&config, &model(), &input, &params, &params).unwrap();
            let (mut hidden, batch) = (vec![false; 40], batch(40));
            assert!(made.rows(&batch, &hidden).unwrap().is_empty(), "nothing is masked");
            (hidden[3], hidden[17]) = (true, true);
            let rows = made.rows(&batch, &hidden).unwrap();
            assert_eq!(rows.len(), 2 * 11);
            // What is hidden is not read.
            let mut other = batch.clone();
            other.feat[3 * 11..4 * 11].fill(7.0);
            let all = vec![true; 40];
            assert_eq!(made.rows(&batch, &all).unwrap(), made.rows(&other, &all).unwrap());
            // The last layer gives its bias: 0 for what is not a size.
            let layer = params.parameters();
            let bias: Vec<f32> = [vec![0.25; 8], vec![-2.0; 3]].concat();
            let weight = &layer["heads.masked_gaussians.3.weight"];
            weight.set(&weight.zeros_like().unwrap()).unwrap();
            layer["heads.masked_gaussians.3.bias"]
                .set(&Tensor::new(bias, &Device::Cpu).unwrap())
                .unwrap();
            let rows = made.rows(&batch, &hidden).unwrap();
            let size = match distance {
                GaussianDistance::MeanSquare => -2.0,
                _ => (-2.0f64).exp() as f32,
            };
            let want: Vec<f32> = [vec![0.25; 8], vec![size; 3]].concat();
            assert_eq!(rows, want.repeat(2), "{distance:?}");
        }
    }

    #[test]
    fn heads_of_each_attribute_stay_in_its_range() {
        let (params, input) = (ParamStore::trainable(1), InputFeatures::default());
        let own = MaskedGaussiansTerm {
            heads: GaussianHeads::PerAttribute,
            ..MaskedGaussiansTerm::default()
        };
        let config = config(vec![TermConfig::MaskedGaussians(own)]);
        let made = Reconstructor::new(&config, &model(), &input, &params, &params).unwrap();
        // The last layers give their bias: 3 everywhere.
        for (name, var) in params.parameters() {
            let Some(part) = name.strip_prefix("heads.masked_gaussians.") else { continue };
            if part.ends_with("4.weight") {
                var.set(&var.zeros_like().unwrap()).unwrap();
            } else if part.ends_with("4.bias") {
                var.set(&(var.ones_like().unwrap() * 3.0).unwrap()).unwrap();
            }
        }
        let rows = made.rows(&batch(40), &[vec![true], vec![false; 39]].concat()).unwrap();
        // Color by the hyperbolic tangent, opacity by the logistic function, a rotation of unit length, sizes as they are.
        let (tanh, logistic) = (3f32.tanh(), 1.0 / (1.0 + (-3f32).exp()));
        let want = [&[tanh; 3][..], &[logistic], &[0.5; 4], &[3.0; 3]].concat();
        assert_eq!(rows.len(), want.len());
        assert!(rows.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-6), "{rows:?} {want:?}");
    }

    #[test]
    fn a_run_without_the_term_is_refused_by_name() {
        let (params, input) = (ParamStore::trainable(1), InputFeatures::default());
        let config = config(vec![TermConfig::Ibot(IbotTerm::default())]);
        let error = Reconstructor::new(&config, &model(), &input, &params, &params).unwrap_err();
        let error = error.to_string();
        assert!(error.contains("masked_gaussians") && error.contains("only ibot"), "{error}");
    }
}
