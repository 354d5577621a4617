//! Primitives that are whole SPZ files.

use super::buffers::Buffers;
use super::document::Document;
use super::primitives::Job;
use super::{file_error, join};
use crate::formats::spz::{peek_spz, read_spz_as_stored};
use crate::formats::{ReadOptions, SpzFrame};
use crate::{GaussianScene, RepairReport, SceneError};
use std::collections::BTreeMap;
use std::path::Path;

/// One SPZ file, however many primitives it is shown as.
struct SpzPart<'a> {
    /// The extension that it was found by first.
    name: &'a str,
    bytes: &'a [u8],
    rows: usize,
    degree: u8,
    /// Primitives that are still to come.
    uses: usize,
    /// Kept from its first use to its last.
    decoded: Option<GaussianScene>,
}

/// The SPZ files of a document, by their buffer view.
pub(super) struct SpzParts<'a> {
    parts: BTreeMap<usize, SpzPart<'a>>,
    options: ReadOptions,
    path: &'a Path,
}

impl<'a> SpzParts<'a> {
    /// Looks at the headers of all that are shown. Decodes none.
    pub(super) fn open(
        document: &Document<'_>,
        buffers: &'a Buffers<'_>,
        jobs: &[Job<'a>],
        options: &ReadOptions,
        path: &'a Path,
    ) -> Result<Self, SceneError> {
        // The extension says that SPZ is packed from glTF's frame, so a file is taken to be in the
        // frame that SPZ prescribes whatever the options say.
        let options = ReadOptions { spz_frame: SpzFrame::Rub, ..options.clone() };
        let mut parts: BTreeMap<usize, SpzPart<'a>> = BTreeMap::new();
        for (name, view) in jobs.iter().filter_map(|job| job.spz) {
            if let Some(part) = parts.get_mut(&view) {
                part.uses += 1;
                continue;
            }
            let bytes = buffers.view(document, view, path)?;
            let (rows, degree) = peek_spz(bytes, path)?;
            let degree = if options.sh_rest { degree } else { 0 };
            let part = SpzPart { name, bytes, rows, degree, uses: 1, decoded: None };
            parts.insert(view, part);
        }
        Ok(Self { parts, options, path })
    }

    /// The number of Gaussians in a view, and the degree of the harmonics that are read of them.
    pub(super) fn about(&self, view: usize) -> (usize, u8) {
        self.parts.get(&view).map_or((0, 0), |part| (part.rows, part.degree))
    }

    /// Bytes of all SPZ files together.
    pub(super) fn bytes(&self) -> usize {
        self.parts.values().fold(0, |sum, part| sum.saturating_add(part.bytes.len()))
    }

    /// Some positions of a view, those of every `step`-th row. A document's only SPZ file is kept for
    /// [`read`](Self::read); several are decoded once more there, so that they do not lie in memory
    /// together.
    pub(super) fn sample_positions(
        &mut self,
        view: usize,
        step: usize,
        report: &mut RepairReport,
    ) -> Result<Vec<[f64; 3]>, SceneError> {
        let of = |scene: &GaussianScene| {
            scene.coord.iter().step_by(step).map(|p| p.map(f64::from)).collect()
        };
        let is_only = self.parts.len() == 1;
        let (path, options) = (self.path, &self.options);
        let Some(part) = self.parts.get_mut(&view) else { return Ok(Vec::new()) };
        if !is_only {
            return Ok(of(&decode(part, path, options, &mut RepairReport::default())?));
        }
        let scene = match part.decoded.take() {
            Some(scene) => scene,
            None => decode(part, path, options, report)?,
        };
        let sample = of(&scene);
        part.decoded = Some(scene);
        Ok(sample)
    }

    /// The Gaussians of a view, decoded the first time and copied from then on; what there is to
    /// report of them is reported once.
    pub(super) fn read(
        &mut self,
        view: usize,
        report: &mut RepairReport,
    ) -> Result<GaussianScene, SceneError> {
        let path = self.path;
        let none = || file_error(path, format!("buffer view {view} holds no SPZ file"));
        let part = self.parts.get_mut(&view).ok_or_else(none)?;
        let scene = match part.decoded.take() {
            Some(scene) => scene,
            None => decode(part, path, &self.options, report)?,
        };
        part.uses = part.uses.saturating_sub(1);
        if part.uses == 0 {
            return Ok(scene);
        }
        let (sh_degree, antialiased) = (scene.sh_degree, scene.antialiased);
        let mut copy = GaussianScene { sh_degree, antialiased, ..GaussianScene::default() };
        let width = scene.sh_rest_len() * 3;
        join(&mut copy, &scene, scene.len(), width).ok_or_else(|| {
            let rows = scene.len();
            file_error(path, format!("shows {rows} Gaussians again; too many for the memory"))
        })?;
        part.decoded = Some(scene);
        Ok(copy)
    }
}

fn decode(
    part: &SpzPart<'_>,
    path: &Path,
    options: &ReadOptions,
    report: &mut RepairReport,
) -> Result<GaussianScene, SceneError> {
    let (mut scene, about) = read_spz_as_stored(part.bytes, path, options)?;
    report.notes.extend(about.notes.iter().map(|note| format!("SPZ in {}: {note}", part.name)));
    *report = std::mem::take(report).merge(&about);
    // Other primitives have none.
    (scene.segment, scene.segment_score, scene.instance) = (None, None, None);
    scene.lang_code = None;
    Ok(scene)
}
