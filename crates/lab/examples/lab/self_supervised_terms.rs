//! What a step of self-supervised training takes with each term alone: seconds and peak memory.
//!
//! Network, scenes and views are those of the file (configs/self_supervised/synthetic_rooms.toml, its first
//! batch, again and again), terms have their defaults but for 512 prototypes; where a term does not read the
//! decoder, there is none. The median of STEPS (5) after a first one; gradients and AdamW are a part of a step.
//! Each line is a process of its own, whose peak is what the system counts (Linux). Nothing else should run.

use crate::Arguments;
use anyhow::{Context, Result, ensure};
use scenesplat::datasets::{BatchLoader, DataError, SourceConfig, TrainBatch};
use scenesplat::experiment::{ExperimentConfig, data};
use scenesplat::machine::peak_memory_bytes;
use scenesplat::models::{BackboneConfig, ParamStore};
use scenesplat::trainers::tasks::self_supervised::{SelfSupervised, TermConfig};
use scenesplat::trainers::{
    AdamW, AdamWConfig, Callback, DataModule, Event, Flow, OneCycle, Progress, TrainError, Trainer,
    TrainerConfig, TrainingModule, group_by_keyword,
};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Width of the features that language alignment learns.
const FEATURES: usize = 96;
const ALL: [&str; 9] = [
    "masked_gaussians",
    "sim_dino",
    "dino",
    "ibot",
    "ibot_cross_entropy",
    "self_distillation",
    "sim_dino_rows",
    "language_alignment",
    "masked_gaussians+sim_dino+ibot_cross_entropy",
];

struct Same(TrainBatch, usize);

impl BatchLoader<TrainBatch> for Same {
    fn batches_per_epoch(&self) -> usize {
        self.1
    }
    fn epoch(
        &mut self,
        _: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = Result<TrainBatch, DataError>> + '_> {
        Box::new((skip..self.1).map(|_| Ok(self.0.clone())))
    }
}

struct Clock(Arc<Mutex<Vec<Instant>>>);

impl Callback for Clock {
    fn on_event(&mut self, event: &Event<'_>, _: Progress) -> Result<Flow, TrainError> {
        if matches!(event, Event::Step { .. }) {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).push(Instant::now());
        }
        Ok(Flow::Continue)
    }
}

fn term(name: &str) -> Result<TermConfig> {
    let mut term = serde_json::json!({ "type": name });
    match name {
        "dino" | "ibot_cross_entropy" | "self_distillation" => {
            term["prototypes"] = serde_json::json!({ "count": 512, "hidden": 512, "out": 128 });
        }
        "language_alignment" => term["out"] = FEATURES.into(),
        _ => {}
    }
    serde_json::from_value(term).with_context(|| name.to_owned())
}

/// Trains with these terms, and prints a line.
fn measure(file: &str, steps: usize, names: &str) -> Result<()> {
    let mut config = ExperimentConfig::read(file.as_ref())?;
    for entry in &mut config.train {
        if let (SourceConfig::Synthetic(rooms), true) =
            (&mut entry.source, names.contains("language_alignment"))
        {
            rooms.vocabulary = Some(FEATURES);
        }
    }
    let terms = names.split('+').map(term).collect::<Result<Vec<_>, _>>()?;
    let reads_rows = terms.iter().any(TermConfig::reads_rows);
    if let (BackboneConfig::PointTransformerV3(network), false) =
        (&mut config.model.backbone, reads_rows)
    {
        (network.dec_depths, network.dec_channels) = (Vec::new(), Vec::new());
        (network.dec_num_head, network.dec_patch_size) = (Vec::new(), Vec::new());
    }
    let mut settings =
        config.self_supervised.clone().context("task = \"self_supervised\" is needed")?;
    settings.terms = terms;
    let network = config.network()?;
    let params = ParamStore::trainable(1);
    let module = SelfSupervised::new(&settings, &network.model, &network.input, params, 1)?;
    let batch = data::loader(&config, None)?.epoch(0, 0).next().context("no batch")??;
    let rows: usize = batch.views.iter().map(|view| view.batch.len()).sum();
    let (before, times) = (peak_memory_bytes(), Arc::new(Mutex::new(Vec::new())));
    let groups = group_by_keyword(&module.params().parameters(), 0.002, 0.02, &[]);
    let optimizer = AdamW::new(groups, AdamWConfig::default())?;
    // The clock hears of steps that are logged.
    let loop_settings = TrainerConfig { epochs: 1, log_every: 1, ..TrainerConfig::default() };
    Trainer::new(loop_settings, Box::new(optimizer), Box::new(OneCycle::default()))?
        .with_callback(Clock(Arc::clone(&times)))
        .fit(&module, &mut DataModule::new(Same(batch, steps + 1)), Progress::default())?;
    let times = times.lock().unwrap_or_else(PoisonError::into_inner);
    let mut seconds: Vec<f64> =
        times.windows(2).map(|pair| (pair[1] - pair[0]).as_secs_f64()).collect();
    seconds.sort_by(f64::total_cmp);
    let mib =
        |bytes: Option<u64>| bytes.map_or("-".into(), |b| format!("{:.0}", b as f64 / 1048576.0));
    println!(
        "{names:46} {:>9} {rows:>7} {:>9.3} {:>9} {:>9}",
        module.params().parameters().values().map(|p| p.elem_count()).sum::<usize>(),
        seconds.get(seconds.len() / 2).context("one step or more is needed")?,
        mib(before),
        mib(peak_memory_bytes())
    );
    Ok(())
}

/// Measures in a process of its own for each sum of terms, which is this program with `--one`.
pub fn run(args: Arguments) -> Result<()> {
    let mut args: Vec<String> = args.0.collect();
    if args.first().is_some_and(|arg| arg == "--one") {
        return measure(&args[1], args[2].parse()?, &args[3]);
    }
    let file = "configs/self_supervised/synthetic_rooms.toml".to_owned();
    args.extend([file, "5".to_owned()].into_iter().skip(args.len()));
    let terms = args.split_off(2);
    let all: Vec<&str> =
        if terms.is_empty() { ALL.to_vec() } else { terms.iter().map(String::as_str).collect() };
    println!(
        "{:46} {:>9} {:>7} {:>9} {:>9} {:>9}",
        "terms", "values", "rows", "s a step", "MiB first", "MiB peak"
    );
    for names in all {
        let child = std::process::Command::new(std::env::current_exe()?)
            .args(["self-supervised-terms", "--one", &args[0], &args[1], names])
            .status()?;
        ensure!(child.success(), "{names}: {child}");
    }
    Ok(())
}
