//! A decoder over a frozen encoder.

use super::rows::{ProbeScene, chosen_rows};
use super::{ProbeError, ProbeSettings};
use crate::network::NetworkConfig;
use candle_core::D;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_datasets::{BatchLoader, DataError, TrainBatch};
use scenesplat_losses::{CrossEntropy, Objective};
use scenesplat_models::weights::{SourceOptions, WeightSource, resolve};
use scenesplat_models::{
    BackboneConfig, Forward, LoadPolicy, ModelConfig, ParamStore, PointTransformerV3Config,
};
use scenesplat_trainers::tasks::{SemanticSegmentation, TaskModule, point_cloud};
use scenesplat_trainers::{
    AdamW, AdamWConfig, DataModule, HasBackbone, HealthConfig, OneCycle, Progress, Trainer,
    TrainerConfig, TrainingModule, group_by_keyword,
};
use std::path::Path;

/// Width of the decoder's finest scale, as of Sonata's.
const FINEST: usize = 64;

/// Where the encoder's values come from.
#[derive(Clone, Copy)]
pub(super) enum EncoderValues<'a> {
    /// A model folder.
    File(&'a Path),
    /// From a seed, as training would begin.
    Random,
}

/// A trained decoder on its encoder.
pub(super) struct DecoderProbe {
    module: TaskModule,
    /// Width of the rows that the last layer reads.
    pub width: usize,
    /// Loss of the last step.
    pub loss: f64,
}

/// Scenes as batches, one after the other.
struct Scenes {
    batches: Vec<TrainBatch>,
    order: Vec<usize>,
}

impl BatchLoader<TrainBatch> for Scenes {
    fn batches_per_epoch(&self) -> usize {
        self.order.len()
    }
    fn epoch(
        &mut self,
        _: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = Result<TrainBatch, DataError>> + '_> {
        Box::new(self.order[skip..].iter().map(|&i| Ok(self.batches[i].clone())))
    }
}

/// The network with a decoder of one block a scale and a classifier, and its encoder alone.
fn networks(
    config: &NetworkConfig,
    classes: usize,
) -> Result<(ModelConfig, ModelConfig), ProbeError> {
    let BackboneConfig::PointTransformerV3(own) = &config.model.backbone else {
        return Err(ProbeError::NoDecoder { architecture: config.model.backbone.name() });
    };
    let encoder = PointTransformerV3Config {
        mask_token: false,
        dec_depths: vec![],
        dec_channels: vec![],
        dec_num_head: vec![],
        dec_patch_size: vec![],
        ..own.clone()
    };
    let stages = own.num_stages() - 1;
    let channels: Vec<usize> =
        (0..stages).map(|i| if i == 0 { FINEST } else { own.enc_channels[i] }).collect();
    let heads = |width: &usize| (1..=8).rev().find(|h| width.is_multiple_of(*h)).unwrap_or(1);
    let decoder = PointTransformerV3Config {
        dec_depths: vec![1; stages],
        dec_num_head: channels.iter().map(heads).collect(),
        dec_channels: channels,
        dec_patch_size: own.enc_patch_size[..stages].to_vec(),
        drop_path: 0.0,
        ..encoder.clone()
    };
    let grid_size = config.model.grid_size;
    let model = |backbone: PointTransformerV3Config| ModelConfig {
        grid_size,
        ..ModelConfig::new(backbone)
    };
    Ok((model(decoder).with_classes(classes), model(encoder)))
}

/// The scenes with the labels that may be learned from; those without any are left out.
fn labelled_batches(
    scenes: &[ProbeScene],
    settings: &ProbeSettings,
) -> Result<Vec<TrainBatch>, ProbeError> {
    let mut batches = Vec::with_capacity(scenes.len());
    for (stream, scene) in (0..).zip(scenes) {
        let mut batch = scene.batch.clone();
        let mut labels = vec![-1; batch.len()];
        for row in chosen_rows(scene, settings.labels, settings.seed, stream) {
            labels[row as usize] = scene.labels[row as usize];
        }
        if labels.iter().any(|label| *label >= 0) {
            batch.segment = Some(labels);
            batches.push(batch);
        }
    }
    if batches.is_empty() {
        return Err(ProbeError::NoLabels);
    }
    Ok(batches)
}

/// Trains a decoder on scenes; the encoder and its batch statistics stay as they are.
///
/// # Errors
/// If the network has another architecture, its weights do not fit, or training fails.
pub(super) fn train(
    config: &NetworkConfig,
    values: EncoderValues<'_>,
    scenes: &[ProbeScene],
    classes: usize,
    settings: &ProbeSettings,
) -> Result<DecoderProbe, ProbeError> {
    let (model, encoder) = networks(config, classes)?;
    let source = match values {
        EncoderValues::Random => ParamStore::trainable(settings.seed),
        EncoderValues::File(path) => {
            let files = resolve(path)?.files;
            let source = WeightSource::files(files, SourceOptions::default())?;
            let source =
                source.unwrapped(|shapes| config.model.fits(shapes) || encoder.fits(shapes))?;
            ParamStore::trainable_from(source, settings.seed)
        }
    };
    encoder.build(source.builder())?;
    if let EncoderValues::File(path) = values {
        source.report().check(LoadPolicy::AllowUnexpected, &path.display().to_string())?;
    }
    let params = ParamStore::trainable(settings.seed);
    let network = model.build(params.builder())?;
    take_values(&params, &source)?;
    let batches = labelled_batches(scenes, settings)?;
    let order = (0..settings.steps as usize).map(|step| step % batches.len()).collect();
    let loader = Scenes { batches, order };
    let objective = Objective::new().with(1.0, CrossEntropy::default());
    let module = TaskModule::new(params, network, objective, SemanticSegmentation);
    let frozen = vec!["embedding.".to_owned(), "enc.enc".to_owned()];
    let trained: std::collections::BTreeMap<_, _> = module
        .params()
        .parameters()
        .into_iter()
        .filter(|(name, _)| !frozen.iter().any(|part| name.contains(part)))
        .collect();
    let groups = group_by_keyword(&trained, settings.lr, settings.weight_decay, &[]);
    let optimizer = AdamW::new(groups, AdamWConfig::default())?;
    let trainer_config = TrainerConfig {
        seed: settings.seed,
        clip_norm: Some(3.0),
        freeze: frozen,
        health: HealthConfig { every_steps: 0, ..HealthConfig::default() },
        ..TrainerConfig::default()
    };
    let last = LastLoss::default();
    let mut trainer =
        Trainer::new(trainer_config, Box::new(optimizer), Box::new(OneCycle::default()))?
            .with_callback(last.clone());
    trainer.fit(&module, &mut DataModule::new(loader), Progress::default())?;
    let width = FINEST;
    let loss = *last.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    Ok(DecoderProbe { module, width, loss })
}

/// Sets parameters and batch statistics to those of the same name in `source`, where it has them.
fn take_values(params: &ParamStore, source: &ParamStore) -> Result<(), ProbeError> {
    let (own, own_buffers) = (params.parameters(), params.buffers());
    for (name, value) in source.parameters().iter().chain(&source.buffers()) {
        if let Some(var) = own.get(name).or_else(|| own_buffers.get(name)) {
            var.set(&value.as_detached_tensor().copy()?)?;
        }
    }
    Ok(())
}

/// Keeps the loss of the last step that is logged.
#[derive(Clone, Default)]
struct LastLoss(std::sync::Arc<std::sync::Mutex<f64>>);

impl scenesplat_trainers::Callback for LastLoss {
    fn on_event(
        &mut self,
        event: &scenesplat_trainers::Event<'_>,
        _: Progress,
    ) -> Result<scenesplat_trainers::Flow, scenesplat_trainers::TrainError> {
        if let scenesplat_trainers::Event::Step { measurements } = event
            && let Some(loss) = measurements.iter().find(|m| m.name == "train/loss")
        {
            *self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = loss.value;
        }
        Ok(scenesplat_trainers::Flow::Continue)
    }
}

impl DecoderProbe {
    /// The class of each voxel of a scene. `[M]`
    ///
    /// # Errors
    /// If the scene does not fit the network.
    pub fn classes(&self, scene: &ProbeScene) -> Result<Vec<i32>, ProbeError> {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let points = point_cloud(&scene.batch)?;
        let logits = self.module.backbone().forward(&points, &mut Forward::eval(&mut rng))?;
        let best = logits.detach().argmax(D::Minus1)?.to_vec1::<u32>()?;
        Ok(best.into_iter().map(|class| class as i32).collect())
    }

    /// The parameters, the frozen ones among them.
    #[cfg(test)]
    fn params(&self) -> &ParamStore {
        self.module.params()
    }
}

#[cfg(test)]
mod tests {
    use super::super::rows::{RowSource, read};
    use super::super::{LabelRegime, ProbeKind, ProbeScenes};
    use super::*;
    use scenesplat_datasets::SyntheticRooms;
    use scenesplat_rooms::SyntheticRoomSettings;
    use std::sync::Arc;

    #[test]
    fn the_encoder_and_its_statistics_stay_as_they_are() {
        let backbone = PointTransformerV3Config::language().with_stages(
            &[[1, 8, 1], [1, 16, 2]],
            &[[1, 8, 1]],
            32,
        );
        let model = ModelConfig { grid_size: 0.25, ..ModelConfig::new(backbone) };
        let config = NetworkConfig { model, ..NetworkConfig::language() };
        let room = SyntheticRoomSettings { num_gaussians: Some(600), ..Default::default() };
        let rooms = Arc::new(SyntheticRooms::new(3, room, 1).unwrap());
        let (data, _) = ProbeScenes::new(rooms, 0.25, Some(1)).unwrap().split().unwrap();
        let store = ParamStore::trainable(0);
        let network = config.model.build(store.builder()).unwrap();
        let source = RowSource::Network(network.as_ref());
        let scenes = read(data.as_ref(), &config, source).unwrap();
        let settings = ProbeSettings {
            kind: ProbeKind::Decoder,
            labels: LabelRegime::All,
            steps: 4,
            ..ProbeSettings::default()
        };
        let before = ParamStore::trainable(settings.seed);
        networks(&config, 41).unwrap().1.build(before.builder()).unwrap();
        let probe = train(&config, EncoderValues::Random, &scenes, 41, &settings).unwrap();
        let after = probe.params();
        let bits = |t: &candle_core::Tensor| {
            let values = t.to_dtype(candle_core::DType::F32).unwrap().flatten_all().unwrap();
            values.to_vec1::<f32>().unwrap().iter().map(|v| v.to_bits()).collect::<Vec<_>>()
        };
        let (params, buffers) = (after.parameters(), after.buffers());
        let mut compared = 0;
        for (name, value) in before.parameters().iter().chain(&before.buffers()) {
            let now = params.get(name).or_else(|| buffers.get(name)).unwrap();
            assert_eq!(bits(value.as_tensor()), bits(now.as_tensor()), "{name}");
            compared += 1;
        }
        assert!(compared > 40);
        // What stands over it moved.
        let head = params["seg_head.weight"].flatten_all().unwrap();
        let first = ParamStore::trainable(settings.seed);
        networks(&config, 41).unwrap().0.build(first.builder()).unwrap();
        assert_ne!(
            bits(&head),
            bits(&first.parameters()["seg_head.weight"].flatten_all().unwrap())
        );
        assert_eq!(probe.classes(&scenes[0]).unwrap().len(), scenes[0].labels.len());
    }

    #[test]
    fn batch_statistics_are_taken_over_with_the_parameters() {
        use candle_core::{Device, Tensor, Var};
        use scenesplat_models::layers::BatchNorm;
        let [own, source] = [0, 1].map(ParamStore::trainable);
        for name in ["enc", "dec"] {
            BatchNorm::new(2, own.builder().pp(name)).unwrap();
        }
        BatchNorm::new(2, source.builder().pp("enc")).unwrap();
        let set = |var: &Var, values: [f32; 2]| {
            var.set(&Tensor::new(&values, &Device::Cpu).unwrap()).unwrap();
        };
        set(&source.parameters()["enc.weight"], [2.0, 3.0]);
        set(&source.buffers()["enc.running_mean"], [4.0, 5.0]);
        set(&source.buffers()["enc.running_var"], [6.0, 7.0]);
        take_values(&own, &source).unwrap();
        let read = |var: &Var| var.as_tensor().to_vec1::<f32>().unwrap();
        let (params, buffers) = (own.parameters(), own.buffers());
        assert_eq!(read(&params["enc.weight"]), [2.0, 3.0]);
        assert_eq!(read(&buffers["enc.running_mean"]), [4.0, 5.0]);
        assert_eq!(read(&buffers["enc.running_var"]), [6.0, 7.0]);
        // The source has nothing for it: mean 0 and variance 1, as at first.
        assert_eq!(read(&buffers["dec.running_mean"]), [0.0, 0.0]);
        assert_eq!(read(&buffers["dec.running_var"]), [1.0, 1.0]);
    }

    #[test]
    fn a_decoder_learns_from_the_labels_of_its_regime_only() {
        use candle_core::{DType, Device, Tensor};
        let scene = |labels: Vec<i32>| ProbeScene {
            id: "s".to_owned(),
            rows: Tensor::zeros((labels.len(), 1), DType::F32, &Device::Cpu).unwrap(),
            instances: None,
            voxel_of: (0..labels.len() as u32).collect(),
            truth: labels.clone(),
            batch: TrainBatch { coord: vec![[0.0; 3]; labels.len()], ..TrainBatch::default() },
            labels,
        };
        // Each voxel of the first has a class of its own, those of the second have none, and it is left out.
        let scenes = [scene((0..10).collect()), scene(vec![-1; 10])];
        let count = |labels: LabelRegime| {
            let settings = ProbeSettings { labels, ..ProbeSettings::default() };
            let batches = labelled_batches(&scenes, &settings).unwrap();
            assert_eq!(batches.len(), 1);
            let segment = batches[0].segment.clone().unwrap();
            assert!((0..).zip(&segment).all(|(row, label)| [-1, row].contains(label)));
            segment.iter().filter(|label| **label >= 0).count()
        };
        // 3 a scene; 0.4 of 10; all.
        let regimes = [LabelRegime::PerScene(3), LabelRegime::Share(0.4), LabelRegime::All];
        assert_eq!(regimes.map(count), [3, 4, 10]);
    }

    #[test]
    fn a_decoder_learns_from_the_rows_that_the_other_probes_learn_from() {
        use super::super::rows::choose;
        use candle_core::{Device, Tensor};
        // Each voxel has a class of its own, which tells it from all others; so has its row.
        let scene = |first: i32| {
            let labels: Vec<i32> = (first..first + 12).collect();
            let rows: Vec<f32> = labels.iter().map(|label| *label as f32).collect();
            ProbeScene {
                id: first.to_string(),
                rows: Tensor::from_vec(rows, (12, 1), &Device::Cpu).unwrap(),
                instances: None,
                voxel_of: (0..12).collect(),
                truth: labels.clone(),
                batch: TrainBatch { coord: vec![[0.0; 3]; 12], ..TrainBatch::default() },
                labels,
            }
        };
        let scenes = [scene(0), scene(12), scene(24)];
        let labels = LabelRegime::PerScene(4);
        let settings = ProbeSettings { labels, seed: 8, ..ProbeSettings::default() };
        let segments = labelled_batches(&scenes, &settings).unwrap().into_iter();
        let taught = segments.flat_map(|batch| batch.segment.unwrap());
        let taught: Vec<i32> = taught.filter(|label| *label >= 0).collect();
        assert_eq!(taught, choose(&scenes, labels, 8).unwrap().labels);
        // Not the same places in each scene.
        let places = |scene: usize| taught[4 * scene..][..4].iter().map(|label| label % 12);
        assert!(!places(0).eq(places(1)) || !places(0).eq(places(2)), "{taught:?}");
    }

    #[test]
    fn a_decoder_has_a_block_a_scale_over_the_encoder_as_it_is() {
        let mut own = PointTransformerV3Config {
            drop_path: 0.3,
            mask_token: true,
            ..PointTransformerV3Config::language()
        }
        .with_stages(&[[1, 24, 3], [2, 42, 7], [1, 48, 4]], &[[1, 24, 3], [1, 42, 7]], 16);
        own.enc_patch_size = vec![16, 32, 64];
        let model = ModelConfig { grid_size: 0.125, ..ModelConfig::new(own.clone()) };
        let config = NetworkConfig { model, ..NetworkConfig::language() };
        let (decoder, encoder) = networks(&config, 9).unwrap();
        let of = |model: &ModelConfig| match &model.backbone {
            BackboneConfig::PointTransformerV3(config) => config.clone(),
            other => panic!("{}", other.name()),
        };
        let none = PointTransformerV3Config {
            mask_token: false,
            dec_depths: vec![],
            dec_channels: vec![],
            dec_num_head: vec![],
            dec_patch_size: vec![],
            ..own
        };
        assert_eq!(of(&encoder), none);
        // 64 at the finest scale, above it as the encoder; heads of which the width is a multiple, 8 at most.
        let with = PointTransformerV3Config {
            dec_depths: vec![1, 1],
            dec_channels: vec![64, 42],
            dec_num_head: vec![8, 7],
            dec_patch_size: vec![16, 32],
            drop_path: 0.0,
            ..none
        };
        assert_eq!(of(&decoder), with);
        assert_eq!(
            (decoder.grid_size, encoder.grid_size, decoder.out_channels()),
            (0.125, 0.125, 9)
        );
    }
}
