//! Own data, loss, callback, evaluator, and a gradient through pictures: `cargo run --release --example own_training`
use scenesplat::prelude::*;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use std::sync::Arc;

/// Own data: rooms in which a Gaussian is low (class 0) or high (1). Files would be read here, with any error.
struct Heights(Vec<String>);
impl DataSource for Heights {
    fn scene_ids(&self) -> &[String] {
        &self.0
    }
    fn load(&self, id: &str) -> Result<SourceScene, DataError> {
        let number: u64 = id.parse().map_err(|error| DataError::unreadable(id, error))?;
        let mut scene = generate(&SyntheticRoomSettings::with_count(2000, number))?.scene;
        scene.segment = Some(scene.coord.iter().map(|at| i32::from(at[2] > 1.0)).collect());
        Ok(SourceScene { scene, report: RepairReport::default() })
    }
}
/// Own loss: large logits cost, so that the network stays unsure.
struct LogitSize;
impl Loss for LogitSize {
    fn name(&self) -> &str {
        "logit_size"
    }
    fn forward(&self, input: &LossInput<'_>) -> candle_core::Result<Option<Tensor>> {
        Ok(Some(input.pred.sqr()?.mean_all()?)) // `None` where a term is off: the log then says so.
    }
}
/// Own callback: stops when the loss is small.
struct StopBelow(f64);
impl Callback for StopBelow {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        let Event::Step { measurements } = event else { return Ok(Flow::Continue) };
        println!("step {}: loss {:.3}", at.step, measurements[0].value);
        Ok(if measurements[0].value < self.0 { Flow::Stop } else { Flow::Continue })
    }
}
/// Own evaluator: the largest parameter.
struct Largest;
impl<M: TrainingModule> Evaluator<M> for Largest {
    fn name(&self) -> &str {
        "params"
    }
    fn measurements(&self) -> Vec<String> {
        vec!["largest".to_owned()]
    }
    fn run(&mut self, module: &M, _: Progress) -> Result<Vec<Measurement>, TrainError> {
        let mut largest = 0.0_f32;
        for (_, var) in module.params().parameters() {
            largest = largest.max(var.abs()?.max_all()?.to_scalar()?);
        }
        Ok(vec![Measurement::new("largest", f64::from(largest))])
    }
}
/// The gradient of a picture's brightness with respect to where the Gaussians are.
fn picture_gradient(scene: &GaussianScene) -> anyhow::Result<Tensor> {
    let gaussians = GaussianTensors::of(&Gaussians::from_scene(scene)?)?;
    let means = Var::from_tensor(&gaussians.means)?;
    let gaussians = GaussianTensors { means: means.as_tensor().clone(), ..gaussians };
    let look = LookAt { eye: [3.0, 3.0, 1.6], target: [1.0, 1.0, 1.0], fov: 60.0 };
    let view = View::look_at(&look, Up::PLUS_Z, [160, 120])?;
    let picture = rasterize(&gaussians, &view, &RasterSettings::gsplat_1_6(), DepthChannel::None)?;
    let gradients = picture.mean_all()?.backward()?;
    gradients.get(&means).cloned().ok_or_else(|| anyhow::anyhow!("no gradient arrived"))
}
fn main() -> anyhow::Result<()> {
    let rooms = Arc::new(Heights((0..6).map(|i| i.to_string()).collect()));
    println!("gradient {:?}", picture_gradient(&rooms.load("0")?.scene)?.shape());
    let steps = build_transforms(&transforms::semantic_segmentation(0.05))?;
    let scenes = Arc::new(SceneDataset::new(rooms, steps, 0, 1)?);
    let loader = SceneLoader::new(scenes, Default::default(), Default::default())?;
    let params = ParamStore::trainable(0);
    let network = ModelConfig::tiny().with_classes(2).build(params.builder())?;
    let groups = group_by_keyword(&params.parameters(), 0.003, 0.02, &[]);
    let optimizer = Box::new(AdamW::new(groups, Default::default())?);
    let objective = Objective::new().with(1.0, CrossEntropy::default()).with(0.01, LogitSize);
    let module = tasks::TaskModule::new(params, network, objective, tasks::SemanticSegmentation);
    let config = TrainerConfig { epochs: 20, log_every: 1, ..Default::default() };
    let trainer = Trainer::new(config, optimizer, Box::new(OneCycle::default()))?;
    let mut trainer = trainer.with_callback(StopBelow(0.3));
    let mut data = DataModule::new(loader).with_evaluator(Largest);
    println!("{:?}", trainer.fit(&module, &mut data, Progress::default())?);
    Ok(())
}
