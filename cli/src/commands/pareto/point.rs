//! One setting on one set of scenes, in this process.

use super::request::Request;
use crate::bench::process::end_with_parent;
use crate::commands::classes::Classes;
use crate::error::{WrongUse, refuse};
use crate::flags::{Inference, Shared};
use crate::session::Session;
use anyhow::{Context, Result};
use clap::Parser;
use scenesplat::evaluation::{
    EvaluationSettings, background, classes_of_labels, classes_of_rooms, own_directions,
};
use scenesplat::kernels::simd::Isa;
use scenesplat::machine::Machine;
use scenesplat::memory::Bytes;
use scenesplat::rooms::Vocabulary;
use scenesplat::scene::label_set::read_names;
use scenesplat::scene::{AtomicFile, ClassMap, LabelIds, LabelSet, TextTable};
use scenesplat::text::class_list;
use scenesplat::{Network, SceneEncoder};
use scenesplat_lab::pareto::{Job, SceneInput, Written, measure};
use std::path::PathBuf;
use std::time::Instant;

/// What `pareto` starts itself with.
#[derive(Debug, clap::Args)]
pub struct PointArgs {
    /// What to measure, as JSON.
    pub request: PathBuf,
}

/// The flags inside a request.
#[derive(Debug, Parser)]
#[command(no_binary_name = true)]
struct Line {
    #[command(flatten)]
    inference: Inference,
    #[command(flatten)]
    classes: Classes,
    #[command(flatten)]
    shared: Shared,
}

impl Line {
    fn of(request: &Request) -> Result<Self> {
        let mut words = request.flags.clone();
        let threads = request.threads.to_string();
        words.extend(["--quiet", "--threads", threads.as_str()].map(str::to_owned));
        if !request.given.is_empty() {
            words.extend(["--setting".to_owned(), request.given.clone()]);
        }
        Ok(Self::try_parse_from(&words).map_err(|e| WrongUse(e.to_string()))?)
    }
}

/// Measures what the request says, and writes the records where it says.
pub fn run_point(args: &PointArgs) -> Result<()> {
    let text = std::fs::read_to_string(&args.request)
        .with_context(|| format!("{}: cannot read the request", args.request.display()))?;
    let request: Request = serde_json::from_str(&text)
        .map_err(|e| WrongUse(format!("{e}: this is for the program itself")))?;
    end_with_parent();
    let line = Line::of(&request)?;
    let (inference, vote_k) = line.inference.settled(None)?;
    let session = Session::start_with(&line.shared, &inference.network, "pareto")?;
    let began = Instant::now();
    let network = session.network(&inference)?;
    let load_seconds = began.elapsed().as_secs_f64();
    let text = text_table(&line.classes, &network, inference.network.is_embedded())?;
    let set = LabelSet::new(text.names.clone())?;
    let excluded = match &request.exclude {
        Some(names) => class_list(&set, names)?,
        None => background(&set),
    };
    let evaluation = EvaluationSettings {
        excluded,
        options: line.classes.options(&set)?,
        vote_k,
        ..EvaluationSettings::default()
    };
    let mut encoder = inference.effective.apply_to_encoder(SceneEncoder::new(&network));
    encoder.halo = inference.halo;
    encoder.spill_folder.clone_from(&request.scratch);
    if let Some(limit) = &request.max_memory {
        let limit: Bytes = limit.parse().map_err(|e| WrongUse(format!("max_memory: {e}")))?;
        encoder.max_memory = Some(limit.0);
    }
    let mut writes = Vec::new();
    writes.extend(request.labels.then_some(Written::Labels));
    writes.extend(request.features.then_some(Written::Features));
    let measured = measure(&Job {
        setting: request.setting.clone(),
        set: request.set.clone(),
        encoder,
        text: &text,
        evaluation,
        scenes: &scenes(&request, &text.names)?,
        read: inference.source.options(),
        repeats: request.repeats,
        writes,
        scratch: request.scratch.clone(),
        reference: request.reference.clone(),
        keep_labels: request.keep_labels.clone(),
        bounds: request.bounds,
        conditions: request.conditions.clone(),
        weights_hash: request.weights_hash.clone(),
        input_hash: request.input_hash.clone(),
        load_seconds,
        machine: Machine { simd: Isa::current().name().to_owned(), ..Machine::detect() },
    })?;
    Ok(AtomicFile::write(&request.answer, serde_json::to_string(&measured)?.as_bytes())?)
}

/// The classes: those given, those of a classifier, or the words of the rooms in the network's width.
fn text_table(classes: &Classes, network: &Network, embedded: bool) -> Result<TextTable> {
    let width = network.model().out_channels();
    if !network.is_classifier() {
        return match classes.text.as_deref().and_then(std::path::Path::to_str) {
            None | Some("vocabulary") if !embedded => Ok(Vocabulary::new(width)?.class_table()),
            _ => classes.text_table(embedded),
        };
    }
    let Some(path) = &classes.text_names else {
        refuse!("--text-names is missing: the names of the network's classes, one a line");
    };
    let names = read_names(path)?;
    if names.len() != width {
        refuse!("--text-names: {} names for {width} classes", names.len());
    }
    Ok(own_directions(names)?)
}

fn scenes(request: &Request, classes: &[String]) -> Result<Vec<SceneInput>> {
    let (of_files, ids) = match &request.label_names {
        Some(path) => {
            let map = request.class_map.as_deref().map(ClassMap::read).transpose()?;
            let names = read_names(path)?;
            let of_files = classes_of_labels(&names, map.as_ref(), classes)?;
            (Some(of_files), Some(LabelIds::new(names.len(), request.label_base)))
        }
        None => (None, None),
    };
    let input = |scene: &super::request::Scene| SceneInput {
        name: scene.name.clone(),
        path: scene.path.clone(),
        label_ids: ids.filter(|_| !scene.is_room),
        class_of: if scene.is_room { Some(classes_of_rooms(classes)) } else { of_files.clone() },
    };
    Ok(request.scenes.iter().map(input).collect())
}
