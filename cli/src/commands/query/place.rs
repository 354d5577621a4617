//! Things that are asked for by their place: the objects of the scene tell, as they do for `objects --find`.

use super::{Args, Found};
use crate::commands::labelled::{LabelArgs, Labelled, Labelling, MIN_COUNT};
use crate::commands::meant::Asking;
use crate::frame::frame;
use crate::label_ids::LabelIdArgs;
use crate::session::Session;
use crate::surfaces::SurfaceArgs;
use anyhow::Result;
use scenesplat::objects::Catalogue;
use scenesplat::query::Selection;

/// The Gaussians of the objects that a phrase such as "lamp on the desk" means; their scores are those of their labels.
pub fn find(args: &Args, session: &Session<'_>, vote_k: usize) -> Result<Found> {
    let labels = LabelArgs {
        scene: args.scene.clone(),
        label_names: None,
        label_ids: LabelIdArgs::default(),
        pieces: false,
        min_count: MIN_COUNT,
        gap: None,
        labelling: Labelling {
            classes: args.classes.clone(),
            vote_k: Some(vote_k),
            features: args.features.clone(),
            taught: None,
            surfaces: SurfaceArgs::default(),
            strange: None,
            effects: args.effects.clone(),
            inference: args.inference.clone(),
        },
    };
    let labelled = labels.label(session, false)?;
    let frame = frame(session, &labelled.opened, &args.inference);
    let found = labelled.objects(session, &labels.settings(), labels.pieces, frame)?;
    let places = Asking { session, found: &found, labels: &labelled.names }.meant(&args.query)?;
    let selection = of_objects(&labelled, &found, &places);
    Ok(Found { opened: labelled.opened, remark: labelled.remark, selection })
}

/// The Gaussians of some objects, with the scores of their labels.
pub fn of_objects(labelled: &Labelled, found: &Catalogue, places: &[usize]) -> Selection {
    let mut selected = vec![0; labelled.labels.len()];
    for row in places.iter().flat_map(|&place| &found.objects[place].rows) {
        selected[*row as usize] = 1;
    }
    let label_scores = labelled.scores.as_deref();
    let score = |row: usize| label_scores.map_or(1.0, |scores| scores[row]);
    let scores =
        selected.iter().enumerate().map(|(row, &is)| if is == 1 { score(row) } else { 0.0 });
    Selection { scores: scores.collect(), selected }
}
