//! Language features in few numbers, and what is left of them.

use super::input::bad_values;
use crate::TrainError;
use crate::error::check_setting;
use crate::event::{Evaluator, Progress};
use crate::module::{StepContext, StepOutput, TrainingModule};
use candle_core::{Device, Result, Tensor, bail};
use scenesplat_datasets::{Dataset, LeftOut, TrainBatch};
use scenesplat_kernels::settings;
use scenesplat_losses::{Reduction, cosine, l2};
use scenesplat_metrics::Measurement;
use scenesplat_models::autoencoder::Autoencoder;
use scenesplat_models::{Compute, Mode, ParamStore};
use scenesplat_scene::{LanguageFeatures, TextTable};
use std::sync::Arc;

settings! {
    /// How features are compressed.
    pub struct AutoencoderConfig {
        /// Widths of the features, of the layers between, and of the codes.
        pub widths: Vec<usize> = vec![768, 384, 192, 96, 48, 16],
        /// Weight of the square distance, summed over channels.
        pub l2: f64 = 1.0,
        /// Weight of 1 − cosine, of each row by itself.
        pub cosine: f64 = 1.0,
    }
}

impl AutoencoderConfig {
    /// Checks the settings.
    ///
    /// # Errors
    /// Names the first that is out of range.
    pub fn check(&self) -> std::result::Result<(), TrainError> {
        let above = |field, value: f64| {
            check_setting(field, value, value.is_finite() && value >= 0.0, "0 or more")
        };
        above("l2", self.l2)?;
        above("cosine", self.cosine)?;
        check_setting("l2", self.l2, self.l2 + self.cosine > 0.0, "above 0 if cosine is 0")?;
        let widths = self.widths.len() as f64;
        check_setting("widths", widths, self.widths.len() > 1, "two widths or more")
    }
}

/// An autoencoder of the language features of scenes (`lang_feat`), a row at a time.
pub struct AutoencoderTask {
    params: ParamStore,
    network: Autoencoder,
    config: AutoencoderConfig,
}

impl AutoencoderTask {
    /// Takes its parameters from `params`.
    ///
    /// # Errors
    /// If the settings do not fit together.
    pub fn new(config: &AutoencoderConfig, params: ParamStore) -> Result<Self> {
        config.check().map_err(candle_core::Error::wrap)?;
        let network = Autoencoder::new(&config.widths, Compute::default(), &params.builder())?;
        Ok(Self { params, network, config: config.clone() })
    }

    /// The network.
    pub fn network(&self) -> &Autoencoder {
        &self.network
    }

    /// The features of rows that have one, `[R, D]` at unit length.
    fn features(
        &self,
        features: Option<&LanguageFeatures>,
        valid: Option<&[bool]>,
        scenes: &str,
    ) -> Result<Tensor> {
        let Some(features) = features else {
            bail!("lang_feat: none of the scenes {scenes} has language features");
        };
        let width = self.config.widths[0];
        if features.dim != width {
            bail!(
                "autoencoder.widths: the scenes' features are {} wide, and the first width is {width}",
                features.dim
            );
        }
        let mut values = Vec::new();
        for (i, row) in features.values.chunks_exact(width).enumerate() {
            let norm = row.iter().map(|v| v.to_f64().powi(2)).sum::<f64>().sqrt();
            if norm > 0.0 && valid.is_none_or(|valid| valid[i]) {
                values.extend(row.iter().map(|v| (v.to_f64() / norm) as f32));
            } else if norm.is_nan() {
                // Left to the loss, which names it.
                values.extend(row.iter().map(|v| v.to_f32()));
            }
        }
        let rows = values.len() / width;
        Tensor::from_vec(values, (rows, width), &Device::Cpu)
    }
}

impl TrainingModule for AutoencoderTask {
    type Batch = TrainBatch;

    fn params(&self) -> &ParamStore {
        &self.params
    }

    fn training_step(&self, batch: &TrainBatch, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        let (features, valid) = (batch.lang_feat.as_ref(), batch.valid_feat.as_deref());
        let target = self.features(features, valid, &batch.ids.join(", "))?;
        let rows = target.dim(0)?;
        let device = self.params.device();
        let zero = Tensor::zeros((), candle_core::DType::F32, device)?;
        if rows == 0 {
            let terms = Vec::new();
            return Ok(StepOutput {
                loss: zero,
                rows: batch.len(),
                counted_rows: 0,
                terms,
                features: None,
            });
        }
        let codes = self.network.encode(&target.to_device(device)?, cx.forward.mode)?;
        let back = self.network.decode(&codes)?;
        let (mut loss, mut terms) = (zero, Vec::new());
        for (name, weight, value) in [
            ("l2", self.config.l2, l2(&back, &target, None, Reduction::Mean)?),
            ("cosine", self.config.cosine, cosine(&back, &target, None, Reduction::Mean)?),
        ] {
            if let Some(value) = value {
                terms.push((name.to_owned(), f64::from(value.to_scalar::<f32>()?)));
                loss = (loss + (value * weight)?)?;
            }
        }
        let features = Some(codes.detach());
        Ok(StepOutput { loss, rows: batch.len(), counted_rows: rows, terms, features })
    }

    fn is_empty(&self, batch: &TrainBatch) -> bool {
        batch.is_empty()
    }

    fn scenes(&self, batch: &TrainBatch) -> Vec<String> {
        batch.ids.clone()
    }

    fn suspects(&self, batch: &TrainBatch) -> Vec<String> {
        bad_values(batch)
    }
}

/// What an autoencoder keeps of the features of scenes.
///
/// | measurement | |
/// |---|---|
/// | `l2` | mean square distance of a feature and what comes back |
/// | `cosine` | mean of 1 − cosine |
/// | `agreement` | share of rows to which both give the same class by the texts |
/// | `agreement_centered` | the same after taking off the mean of all features |
pub struct AutoencoderEvaluator {
    name: String,
    data: Arc<dyn Dataset>,
    text: Option<TextTable>,
}

impl AutoencoderEvaluator {
    /// Without texts there is no agreement.
    pub fn new(name: impl Into<String>, data: Arc<dyn Dataset>, text: Option<TextTable>) -> Self {
        Self { name: name.into(), data, text }
    }
}

/// The class of each row by the texts, first of equal ones.
fn classes(rows: &Tensor, texts: &Tensor) -> Result<Vec<u32>> {
    rows.matmul(&texts.t()?)?.argmax(1)?.to_vec1()
}

impl Evaluator<AutoencoderTask> for AutoencoderEvaluator {
    fn name(&self) -> &str {
        &self.name
    }

    fn left_out(&self) -> LeftOut {
        self.data.left_out()
    }

    fn measurements(&self) -> Vec<String> {
        let all = ["l2", "cosine", "agreement", "agreement_centered"];
        let count = if self.text.is_some() { 4 } else { 2 };
        all[..count].iter().map(|name| (*name).to_owned()).collect()
    }

    fn run(
        &mut self,
        module: &AutoencoderTask,
        _: Progress,
    ) -> std::result::Result<Vec<Measurement>, TrainError> {
        let tensor = |source| TrainError::Forward { source };
        let (mut before, mut after) = (Vec::new(), Vec::new());
        for index in 0..self.data.len() {
            let sample = self.data.get(0, index)?;
            let (features, valid) = (sample.lang_feat.as_ref(), sample.valid_feat.as_deref());
            let rows = module.features(features, valid, &sample.id).map_err(tensor)?;
            let back = module
                .network
                .encode(&rows, Mode::Eval)
                .and_then(|codes| module.network.decode(&codes))
                .map_err(tensor)?;
            before.push(rows);
            after.push(back.detach());
        }
        self.compare(&before, &after).map_err(tensor)
    }
}

impl AutoencoderEvaluator {
    fn compare(&self, before: &[Tensor], after: &[Tensor]) -> Result<Vec<Measurement>> {
        let rows: usize = before.iter().map(|t| t.dims()[0]).sum();
        if rows == 0 {
            return Ok(Vec::new());
        }
        let (before, after) = (Tensor::cat(before, 0)?, Tensor::cat(after, 0)?);
        let count = rows as f64;
        // Both have unit length: the square distance is twice 1 − cosine, but for rows of zeros.
        let square: f64 = f64::from((&before - &after)?.sqr()?.sum_all()?.to_scalar::<f32>()?);
        let product = f64::from((&before * &after)?.sum_all()?.to_scalar::<f32>()?);
        let mut found = vec![
            Measurement::new("l2", square / count),
            Measurement::new("cosine", 1.0 - product / count),
        ];
        let Some(text) = &self.text else { return Ok(found) };
        let texts = Tensor::from_slice(&text.values, (text.len(), text.dim), &Device::Cpu)?;
        let agreement = |a: &Tensor, b: &Tensor| -> Result<f64> {
            let pairs = classes(a, &texts)?.into_iter().zip(classes(b, &texts)?);
            Ok(pairs.filter(|(a, b)| a == b).count() as f64 / count)
        };
        found.push(Measurement::new("agreement", agreement(&before, &after)?));
        let mean = before.mean_keepdim(0)?;
        let centered = |t: &Tensor| t.broadcast_sub(&mean);
        let value = agreement(&centered(&before)?, &centered(&after)?)?;
        found.push(Measurement::new("agreement_centered", value));
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use half::f16;
    use scenesplat_datasets::{DataError, Sample};

    struct Nothing;
    impl Dataset for Nothing {
        fn len(&self) -> usize {
            0
        }
        fn get(&self, _: u64, _: usize) -> std::result::Result<Sample, DataError> {
            Ok(Sample::default())
        }
        fn id(&self, _: usize) -> &str {
            ""
        }
    }

    fn task(config: &AutoencoderConfig) -> AutoencoderTask {
        AutoencoderTask::new(config, ParamStore::trainable(1)).unwrap()
    }

    fn features(rows: &[[f32; 2]]) -> LanguageFeatures {
        let values = rows.iter().flatten().map(|v| f16::from_f32(*v)).collect();
        LanguageFeatures { values, dim: 2 }
    }

    #[test]
    fn rows_that_count_are_brought_to_unit_length() {
        let task = task(&AutoencoderConfig { widths: vec![2, 1], ..<_>::default() });
        let rows = [[3.0, 4.0], [0.0, 0.0], [0.0, -2.0], [f32::NAN, 1.0], [5.0, 0.0]];
        let valid = [true, true, false, false, true];
        let found = |valid: Option<&[bool]>| {
            let rows = task.features(Some(&features(&rows)), valid, "a").unwrap();
            rows.to_vec2::<f32>().unwrap()
        };
        let some = found(Some(&valid));
        // A row of zeros and one that is marked are left out; one that is not a number stays, for the loss to name it.
        assert_eq!(
            (some.len(), some[0].as_slice(), some[2].as_slice()),
            (3, &[0.6, 0.8][..], &[1.0, 0.0][..])
        );
        assert!(some[1][0].is_nan() && some[1][1] == 1.0);
        let all = found(None);
        assert_eq!((all.len(), all[1].as_slice()), (4, &[0.0, -1.0][..]));
        let error = task.features(None, None, "a, b").unwrap_err().to_string();
        assert!(error.contains("scenes a, b has language features"), "{error}");
        let wide = LanguageFeatures { values: vec![f16::ONE; 3], dim: 3 };
        let error = task.features(Some(&wide), None, "a").unwrap_err().to_string();
        assert!(error.contains("are 3 wide, and the first width is 2"), "{error}");
    }

    #[test]
    fn the_loss_is_the_sum_of_its_terms_by_their_weights() {
        let of = |l2: f64, cosine: f64| {
            let task = task(&AutoencoderConfig { widths: vec![2, 3, 1], l2, cosine });
            let batch = TrainBatch {
                coord: vec![[0.0; 3]; 3],
                lang_feat: Some(features(&[[3.0, 4.0], [0.0, -2.0], [-1.0, 0.5]])),
                valid_feat: Some(vec![true, true, false]),
                ..TrainBatch::default()
            };
            let mut rng: rand_chacha::ChaCha8Rng =
                rand_chacha::rand_core::SeedableRng::seed_from_u64(1);
            let forward = scenesplat_models::Forward::train(&mut rng);
            let mut cx = StepContext { forward, progress: 0.0, step: 0, total_steps: 1, seed: 0 };
            let out = task.training_step(&batch, &mut cx).unwrap();
            assert_eq!((out.rows, out.counted_rows), (3, 2));
            assert_eq!(out.features.unwrap().dims(), [2, 1]);
            let names: Vec<&str> = out.terms.iter().map(|(name, _)| name.as_str()).collect();
            assert_eq!(names, ["l2", "cosine"]);
            (f64::from(out.loss.to_scalar::<f32>().unwrap()), [out.terms[0].1, out.terms[1].1])
        };
        for (l2, cosine) in [(1.0, 1.0), (0.25, 2.0), (3.0, 0.0)] {
            let (loss, terms) = of(l2, cosine);
            assert!((loss - l2 * terms[0] - cosine * terms[1]).abs() < 1e-5, "{loss} {terms:?}");
            assert!(terms[0] > 0.0 && terms[1] > 0.0);
        }
    }

    #[test]
    fn what_is_kept_is_measured_row_by_row() {
        let table = |rows: &[[f32; 2]]| {
            Tensor::from_slice(rows.as_flattened(), (rows.len(), 2), &Device::Cpu).unwrap()
        };
        let names = ["x", "y"].map(str::to_owned).to_vec();
        let text = TextTable::from_rows(names, vec![1.0, 0.0, 0.0, 1.0], 2).unwrap();
        let evaluator = |text| AutoencoderEvaluator::new("e", Arc::new(Nothing), text);
        let measured =
            |text: Option<TextTable>, before: &[Tensor], after: &[Tensor]| -> Vec<(String, f64)> {
                let found = evaluator(text).compare(before, after).unwrap();
                found.into_iter().map(|m| (m.name, m.value)).collect()
            };
        // In two parts, of one row and of three.
        let before = [table(&[[1.0, 0.0]]), table(&[[0.8, 0.6], [0.6, 0.8], [1.0, 0.0]])];
        let after = [table(&[[0.0, 1.0]]), table(&[[0.8, 0.6], [1.0, 0.0], [0.6, 0.8]])];
        let found = measured(Some(text), &before, &after);
        // Square distances 2, 0, 0.8, 0.8; products 0, 1, 0.6, 0.6; classes x x y x and y x x y. Less the mean of what
        // was there, (0.85, 0.35), classes are x y y x and y y x y.
        let want =
            [("l2", 0.9), ("cosine", 0.45), ("agreement", 0.25), ("agreement_centered", 0.25)];
        assert_eq!(found.len(), 4);
        for ((name, got), (due, value)) in found.iter().zip(want) {
            assert!(name == due && (got - value).abs() < 1e-6, "{found:?}");
        }
        // Less the mean, (0.9, 0.3), both rows of the first are nearer to another text than before.
        let names = ["x", "y"].map(str::to_owned).to_vec();
        let text = TextTable::from_rows(names, vec![1.0, 0.0, 0.0, 1.0], 2).unwrap();
        let (one, other) = (table(&[[0.8, 0.6], [1.0, 0.0]]), table(&[[0.96, 0.28], [1.0, 0.0]]));
        let found = measured(Some(text), &[one], &[other]);
        assert_eq!((found[2].1, found[3].1), (1.0, 0.5));
        assert_eq!(measured(None, &before, &after).len(), 2);
        assert!(measured(None, &[table(&[[1.0, 0.0]]).narrow(0, 0, 0).unwrap()], &[]).is_empty());
        let listed = Evaluator::<AutoencoderTask>::measurements(&evaluator(None));
        assert_eq!(listed, ["l2", "cosine"]);
    }
}
