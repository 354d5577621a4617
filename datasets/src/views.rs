//! Several views of one scene: what networks without labels compare.
//!
//! A [`Views`](crate::transforms::Views) step, the last of its pipeline, makes them; a batch holds each
//! view as a batch of its own ([`TrainBatch::views`](crate::TrainBatch::views)), row `i` of scene `b` with
//! the place and the row that it had before the views were cut and changed. So two views of a scene are
//! compared place by place, whatever was done to them.

use crate::error::check_length;
use crate::{DataError, InputFeatures, Sample, TrainBatch, collate_samples};
use serde::{Deserialize, Serialize};

/// How much of a scene a view shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ViewKind {
    /// Much of it: student and teacher see it.
    Global,
    /// A small part: only the student sees it.
    Local,
}

/// One view of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewSample {
    /// How much it shows.
    pub kind: ViewKind,
    /// The Gaussians as the network sees them; `origin_row` says which rows of the scene they are.
    pub sample: Sample,
    /// Where each was before the view was cut and changed, meters. NaN for one that was added.
    /// `[N, 3]`
    pub origin: Vec<[f32; 3]>,
}

/// One view of all scenes of a batch.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// How much it shows.
    pub kind: ViewKind,
    /// The scenes, in the order of all views.
    pub batch: TrainBatch,
    /// Place of each row before the view was cut and changed, meters; NaN for one that was added.
    /// `[N, 3]`
    pub origin: Vec<[f32; 3]>,
    /// Row of the scene that each is, [`Sample::ADDED`] for one that was added. `[N]`
    pub origin_row: Vec<u32>,
}

/// Joins the views of samples, view by view. Scenes with a view that shows nothing are left out of all
/// views.
///
/// # Errors
/// If samples have other views than the first, or a view cannot be joined; the scene is named.
pub(crate) fn collate_views(
    samples: &mut [Sample],
    features: &InputFeatures,
) -> Result<Vec<View>, DataError> {
    let kinds = |sample: &Sample| sample.views.iter().map(|v| v.kind).collect::<Vec<_>>();
    let first = samples.first().map(kinds).unwrap_or_default();
    if let Some(other) = samples.iter().find(|sample| kinds(sample) != first) {
        return Err(other_views(&other.id));
    }
    let mut scenes: Vec<_> =
        samples.iter_mut().map(|sample| std::mem::take(&mut sample.views)).collect();
    scenes.retain(|views| views.iter().all(|view| !view.sample.is_empty()));
    let mut by_view: Vec<Vec<ViewSample>> = first.iter().map(|_| Vec::new()).collect();
    for views in scenes {
        by_view.iter_mut().zip(views).for_each(|(all, view)| all.push(view));
    }
    first.into_iter().zip(by_view).map(|(kind, views)| join(kind, views, features)).collect()
}

fn other_views(id: &str) -> DataError {
    let missing = "views, or others than the scenes beside it";
    let help = "let all datasets end with the same `views` step";
    DataError::Missing { step: "batch", missing, help }.in_scene(id)
}

fn join(
    kind: ViewKind,
    views: Vec<ViewSample>,
    features: &InputFeatures,
) -> Result<View, DataError> {
    let (mut origin, mut origin_row) = (Vec::new(), Vec::new());
    let mut samples = Vec::with_capacity(views.len());
    for mut view in views {
        let rows = view.sample.origin_row.take().unwrap_or_default();
        check_length("origin_row", view.sample.len(), rows.len())
            .and(check_length("origin", view.sample.len(), view.origin.len()))
            .map_err(|error| error.in_scene(&view.sample.id))?;
        origin.append(&mut view.origin);
        origin_row.extend(rows);
        samples.push(view.sample);
    }
    Ok(View { kind, batch: collate_samples(samples, features)?, origin, origin_row })
}
