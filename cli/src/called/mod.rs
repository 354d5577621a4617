//! Commands as functions of another program, such as the Python package: flags, scenes and networks in, arrays out; no file
//! is written, nothing is printed.
//!
//! Results have the bits of the files that the program writes by the same flags. Threads are those of the pool that the
//! calling thread runs in.

mod failure;
mod flags;

pub use crate::caller::Caller;
pub use crate::commands::Labelled;
pub use crate::terminal::started_by;
pub use failure::{Failure, FailureKind};

use crate::caller::called_by;
use crate::commands::{
    evaluate as evaluation, features as encoding, inspect as inspection, objects as listing,
    query as asking,
};
use crate::effects::EffectArgs;
use crate::flags::{Inference, Shared};
use crate::frame::frame;
use crate::session::Session;
use crate::terminal::{captured, forget_warnings};
use anyhow::Result;
pub(crate) use flags::parse;
use flags::{
    AlignFlags, EvaluateFlags, FeatureFlags, InspectFlags, NetworkFlags, ObjectFlags, QueryFlags,
    SegmentFlags,
};
use scenesplat::objects::Catalogue;
use scenesplat::outputs::OpenedScene;
use scenesplat::query::Selection;
use scenesplat::scene::{GaussianScene, LoadedScene};
use scenesplat::{Alignment, Network, SceneFeatures};
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Arc;

/// What a command is called with.
pub struct Call<'a> {
    /// Flags as on the command line, without the scene.
    pub flags: &'a [OsString],
    /// The network that the flags name, if it was loaded before.
    pub network: Option<Arc<Network>>,
    /// Who calls.
    pub caller: Arc<dyn Caller>,
}

/// The rows of a scene that a network needs, as the program reads them of a file.
pub fn for_network(opened: &OpenedScene) -> OpenedScene {
    let loaded = &opened.loaded;
    let from = &loaded.scene;
    let scene = GaussianScene {
        origin: from.origin,
        coord: from.coord.clone(),
        log_scale: from.log_scale.clone(),
        quat: from.quat.clone(),
        opacity_logit: from.opacity_logit.clone(),
        sh_dc: from.sh_dc.clone(),
        sh_rest: Vec::new(),
        sh_degree: 0,
        normal: from.normal.clone(),
        segment: from.segment.clone(),
        segment_score: from.segment_score.clone(),
        instance: from.instance.clone(),
        lang_code: from.lang_code.clone(),
        lang_feat: None,
        valid_feat_mask: from.valid_feat_mask.clone(),
        labelled_points: from.labelled_points.clone(),
        extra: Vec::new(),
        antialiased: from.antialiased,
    };
    let loaded = LoadedScene {
        scene,
        report: loaded.report.clone(),
        kept_rows: loaded.kept_rows.clone(),
        path: loaded.path.clone(),
        kind: loaded.kind,
        stated_up: loaded.stated_up,
        unread: loaded.unread.clone(),
    };
    OpenedScene { loaded, converted: opened.converted }
}

/// Loads the network that flags name.
///
/// # Errors
/// As `scenesplat features` has them.
pub fn load_network(call: Call<'_>) -> Result<Arc<Network>, Failure> {
    let caller = call.caller;
    alone(caller, || {
        let NetworkFlags { inference } = parse(call.flags)?;
        let (inference, _) = inference.settled(None)?;
        let shared = nowhere();
        let session = Session::start_network(&shared, &inference, None, "")?;
        session.network(&inference)
    })
}

/// How a network reads a scene: which way is up, what a unit is.
///
/// # Errors
/// As `scenesplat segment` has them.
pub fn align(call: Call<'_>, scene: &OpenedScene) -> Result<Alignment, Failure> {
    let caller = Arc::clone(&call.caller);
    alone(caller, || {
        let AlignFlags { inference } = parse(call.flags)?;
        let (inference, _) = inference.settled(None)?;
        let shared = nowhere();
        let session = start(&shared, &inference, Vec::new(), call.network)?;
        let network = session.network(&inference)?;
        session.alignment_of(scene, &inference, &network)
    })
}

/// Features of a scene, as `scenesplat features` writes them.
///
/// # Errors
/// As that command has them.
pub fn features(call: Call<'_>, scene: OpenedScene) -> Result<SceneFeatures, Failure> {
    let caller = Arc::clone(&call.caller);
    alone(caller, || {
        let FeatureFlags { effects, inference } = parse(call.flags)?;
        encoding::check(&inference)?;
        let (inference, _) = inference.settled(None)?;
        let path = scene.loaded.path.clone();
        let shared = nowhere();
        let session = start(&shared, &inference, vec![scene], call.network)?;
        let wish = EffectArgs::wish(&effects, &session, true, false)?;
        Ok(encoding::encode(&session, &path, &inference, &wish)?.1)
    })
}

/// Labels of a scene, as `scenesplat segment` writes them.
///
/// # Errors
/// As that command has them.
pub fn segment(call: Call<'_>, scene: OpenedScene) -> Result<Labelled, Failure> {
    let caller = Arc::clone(&call.caller);
    alone(caller, || {
        let SegmentFlags { labelling } = parse(call.flags)?;
        let labelling = labelling.settled()?;
        let path = scene.loaded.path.clone();
        let shared = nowhere();
        let session = start(&shared, &labelling.inference, vec![scene], call.network)?;
        let wish = labelling.wish(&session)?;
        labelling.classes.check_model()?;
        labelling.run(&session, &path, &wish)
    })
}

/// What of a scene a phrase means, as `scenesplat query` writes it.
///
/// # Errors
/// As that command has them.
pub fn query(call: Call<'_>, phrase: &str, scene: OpenedScene) -> Result<Selection, Failure> {
    let caller = Arc::clone(&call.caller);
    alone(caller, || {
        let words = [scene.loaded.path.clone().into_os_string(), phrase.into()];
        let words = after_flags(call.flags, words);
        let QueryFlags { args } = parse(&words)?;
        let (inference, vote_k) = args.inference.settled(args.vote_k)?;
        let args = asking::Args { inference, ..args };
        let shared = nowhere();
        let session = start(&shared, &args.inference, vec![scene], call.network)?;
        let wish = args.effects.wish(&session, args.features.is_none(), true)?;
        let asked = asking::meant(&args, &session)?;
        args.classes.record(&session)?;
        let found = asking::find(&args, &session, &asked, &wish, vote_k)?;
        session.check_stop()?;
        Ok(found.selection)
    })
}

/// The objects of a scene with the labels that make them, and what `scenesplat objects` writes of them as JSON.
///
/// # Errors
/// As that command has them.
pub fn objects(
    call: Call<'_>,
    scene: OpenedScene,
) -> Result<(Labelled, Catalogue, serde_json::Value), Failure> {
    let caller = Arc::clone(&call.caller);
    alone(caller, || {
        let words = after_flags(call.flags, [scene.loaded.path.clone().into_os_string()]);
        let ObjectFlags { labels } = parse(&words)?;
        let labels = labels.settled()?;
        let inference = &labels.labelling.inference;
        let shared = nowhere();
        let session = start(&shared, inference, vec![scene], call.network)?;
        labels.labelling.classes.check_model()?;
        let labelled = labels.label(&session, false)?;
        let frame = frame(&session, &labelled.opened, inference);
        let found = labelled.objects(&session, &labels.settings(), labels.pieces, frame)?;
        session.check_stop()?;
        let table = listing::json(&session, &labelled, &found);
        Ok((labelled, found, table))
    })
}

/// The figures of `scenesplat evaluate`, as its evaluation.json has them. `scenes`: those that are held; `named`: all, in
/// order, by their paths or as the command line has them.
///
/// # Errors
/// As that command has them.
pub fn evaluate(
    call: Call<'_>,
    scenes: Vec<OpenedScene>,
    named: &[PathBuf],
) -> Result<serde_json::Value, Failure> {
    let caller = Arc::clone(&call.caller);
    alone(caller, || {
        let names = named.iter().map(|path| path.clone().into_os_string());
        let EvaluateFlags { args } = parse(&after_flags(call.flags, names))?;
        let (args, vote_k) = args.settled()?;
        let shared = nowhere();
        let session = start(&shared, &args.inference, scenes, call.network)?;
        evaluation::figures(&args, &session, vote_k, || Ok(()))
    })
}

/// What is in a scene and what is wrong with it: as text, and as the file of `scenesplat inspect --json` has it.
///
/// # Errors
/// As that command has them.
pub fn inspect(
    call: Call<'_>,
    scene: &OpenedScene,
) -> Result<(String, serde_json::Value), Failure> {
    let caller = Arc::clone(&call.caller);
    alone(caller, || {
        let words = after_flags(call.flags, [scene.loaded.path.clone().into_os_string()]);
        let InspectFlags { args } = parse(&words)?;
        let (chosen, name, config) = inspection::asked(&args)?;
        let shared = nowhere();
        let mut session = Session::start_with(&shared, &chosen, "")?;
        session.hold(Vec::new(), call.network);
        let seen = inspection::look(&args, &session, (&chosen, name, config), scene)?;
        Ok((seen.inspection.to_string(), seen.json()?))
    })
}

/// Flags, and what is no flag whatever it begins with.
fn after_flags(flags: &[OsString], words: impl IntoIterator<Item = OsString>) -> Vec<OsString> {
    flags.iter().cloned().chain([OsString::from("--")]).chain(words).collect()
}

/// An output folder that nothing is written into but features that do not fit into memory.
fn nowhere() -> Shared {
    Shared::into_folder(&std::env::temp_dir(), true)
}

fn start<'s>(
    shared: &'s Shared,
    inference: &Inference,
    scenes: Vec<OpenedScene>,
    network: Option<Arc<Network>>,
) -> Result<Session<'s>> {
    let mut session = Session::start_network(shared, inference, None, "")?;
    session.hold(scenes, network);
    Ok(session)
}

/// Runs a command for a caller: what it prints goes nowhere.
fn alone<T>(caller: Arc<dyn Caller>, work: impl FnOnce() -> Result<T>) -> Result<T, Failure> {
    let (done, _) = captured(|| {
        called_by(caller, || {
            forget_warnings(false);
            work()
        })
    });
    done.map_err(Failure::of)
}
