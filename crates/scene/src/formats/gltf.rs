//! glTF scenes with Gaussians: `KHR_gaussian_splatting` and the files of before it.
//!
//! A Gaussian is a point of a primitive with more attributes. All such primitives that the scene of
//! the document shows are read and joined, in the order of the nodes, each moved as its node says
//! and from glTF's frame ([`Frame::LUF`](crate::Frame::LUF)) to the canonical one.
//!
//! | attribute | read as |
//! |---|---|
//! | `POSITION` | position |
//! | `ROTATION` | quaternion `x, y, z, w` |
//! | `SCALE` | standard deviation, or its logarithm where any value of the file is negative |
//! | `OPACITY`, else the alpha of `COLOR_0` | probability |
//! | `SH_DEGREE_l_COEF_n` | coefficients as they are |
//! | `COLOR_0`, if there is no `SH_DEGREE_0_COEF_0` | color 0 to 1 |
//!
//! The names carry the prefix `KHR_gaussian_splatting:`, in older files `_`. The logarithms come
//! from a draft of the extension; the text that followed says standard deviations. Colors of the
//! space `lin_rec709_display` become sRGB, harmonics to first order. Labels come from a file beside
//! it that [`write_scene`](crate::write_scene) wrote. Nothing is fetched from a
//! network, and only files below the folder of the document are opened.

mod accessor;
mod attributes;
mod buffers;
mod container;
mod document;
mod nodes;
mod placement;
mod primitives;
mod spz_parts;
mod writer;

pub use container::{glb_head, is_glb};
pub(super) use nodes::Affine;
pub(super) use placement::Placement;
pub(super) use writer::write_glb;

use super::json_text::{is_json, without_mark};
use super::memory::zeroed;
use super::{LoadedScene, ReadOptions, SceneFormat, semantics};
use crate::gaussian_scene::sh_rest_len;
use crate::place::{NO_ORIGIN, origin_of, sample_step};
use crate::value_policy::Rule;
use crate::{GaussianScene, RepairReport, SceneError, UnreadColumn};
use attributes::{Attributes, used_attributes};
use buffers::Buffers;
use document::Document;
use primitives::{Job, check_required, gaussian_primitives};
use rayon::prelude::*;
use spz_parts::SpzParts;
use std::collections::BTreeSet;
use std::path::Path;

/// How much larger than its buffers a scene may be in memory.
///
/// Quantized attributes grow by three; more comes from one mesh under several nodes. A file that
/// shows one mesh thousands of times would not fit, and no exporter of Gaussians writes one.
const MAX_GROWTH: usize = 16;
/// How much more the bytes of SPZ files may grow than others: they are compressed, four to one where
/// there is detail in the harmonics and more where there is none.
const SPZ_GROWTH: usize = 4;
/// Small scenes may be shown any number of times; bytes.
const ALWAYS_FITS: usize = 1 << 24;

/// Whether a file is glTF, as JSON or binary.
pub fn is_gltf(bytes: &[u8]) -> bool {
    is_glb(bytes) || (is_json(bytes) && is_gltf_json(bytes))
}

fn file_error(path: &Path, problem: impl Into<String>) -> SceneError {
    SceneError::format(path, problem, "export the scene again")
}

/// Whether the bytes are a JSON object with `asset`, as every `.gltf`.
pub fn is_gltf_json(bytes: &[u8]) -> bool {
    document::has_asset(without_mark(bytes))
}

/// The Gaussians of a primitive, not decoded yet.
enum Part<'a> {
    Attributes(Box<Attributes<'a>>),
    /// The buffer view of an SPZ file, and its rows and degree.
    Spz(usize, (usize, u8)),
}

impl Part<'_> {
    fn rows(&self) -> usize {
        match self {
            Self::Attributes(part) => part.rows,
            Self::Spz(_, (rows, _)) => *rows,
        }
    }

    fn degree(&self) -> u8 {
        match self {
            Self::Attributes(part) => part.degree,
            Self::Spz(_, (_, degree)) => *degree,
        }
    }

    fn attributes(&self) -> Option<&Attributes<'_>> {
        match self {
            Self::Attributes(part) => Some(part),
            Self::Spz(..) => None,
        }
    }
}

/// Reads the Gaussians of a `.gltf` or `.glb`.
///
/// Rows are numbered through all primitives, in the order of the scene's nodes. Where nodes take the
/// scene far from 0, an origin is subtracted before positions become f32. `report.notes`
/// says how sizes were understood, and what was left out or changed.
///
/// # Errors
/// If the document, an index, a range of bytes or a file beside it is not as glTF says, if a node's
/// matrix has no inverse, if no Gaussian is shown, or if an extension that is not read holds them;
/// and as [`super::open_scene`].
pub fn read_gltf(
    bytes: &[u8],
    path: &Path,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    let (json, bin) =
        if is_glb(bytes) { container::chunks(bytes, path)? } else { (without_mark(bytes), None) };
    let document = document::parse(json, path)?;
    let mut report = RepairReport::default();
    check_required(&document, path, &mut report)?;
    let mut jobs = gaussian_primitives(&document, path, &mut report)?;
    let needed = needed_buffers(&document, &jobs, options.sh_rest, path)?;
    let buffers = Buffers::open(&document, bin, path, &needed)?;
    let mut spz = SpzParts::open(&document, &buffers, &jobs, options, path)?;
    check_size(&document, &jobs, options.sh_rest, &buffers, &spz, path)?;
    let open = |job: &Job<'_>| match job.spz {
        Some((_, view)) => Ok(Part::Spz(view, spz.about(view))),
        None => Attributes::open(&document, &buffers, job.primitive, options.sh_rest, path)
            .map(|part| Part::Attributes(Box::new(part))),
    };
    let parts = jobs.iter().map(open).collect::<Result<Vec<_>, SceneError>>()?;
    let degree = parts.iter().map(Part::degree).max().unwrap_or(0);
    if parts.iter().any(|part| part.degree() != degree) {
        report.notes.push(format!(
            "primitives have harmonics of several degrees; all get degree {degree}, with zeros"
        ));
    }
    let attributes = || parts.iter().filter_map(Part::attributes);
    let log_scale = attributes().any(Attributes::any_negative_scale);
    if attributes().any(Attributes::has_scale) {
        report.notes.push(if log_scale {
            "SCALE has negative values and was read as logarithms".to_owned()
        } else {
            "SCALE has no negative value and was read as standard deviations".to_owned()
        });
    }
    let rows: usize = parts.iter().map(Part::rows).sum();
    let origin = subtract_origin(&parts, &mut jobs, &mut spz, &mut report)?;
    let mut scene = GaussianScene { sh_degree: degree, ..GaussianScene::default() };
    let mut antialiased = true;
    for (part, job) in parts.into_iter().zip(&jobs) {
        let first = scene.len();
        let mut read = match part {
            Part::Attributes(part) => part.read(log_scale, first, &mut report),
            Part::Spz(view, _) => spz.read(view, &mut report)?,
        };
        antialiased &= read.antialiased;
        widen(&mut read, degree, path)?;
        if job.place.turns() {
            give_lengths(&mut read.quat, first, &mut report);
        }
        job.place.apply(&mut read);
        append(&mut scene, read, rows, path)?;
    }
    (scene.origin, scene.antialiased) = (origin, antialiased && rows > 0);
    semantics::read_sidecar(path, bytes, rows, options.policy, &mut scene, &mut report)?;
    let loaded = LoadedScene::finish(scene, report, options.policy, path, SceneFormat::Gltf)?;
    Ok(LoadedScene { unread: unread_attributes(&jobs, path)?, ..loaded })
}

/// Attributes of the primitives that nothing here reads, by name.
fn unread_attributes(jobs: &[Job<'_>], path: &Path) -> Result<Vec<UnreadColumn>, SceneError> {
    let mut names = BTreeSet::new();
    for job in jobs.iter().filter(|job| job.spz.is_none()) {
        let (_, used) = used_attributes(job.primitive, true, path)?;
        let unused = job.primitive.attributes.iter();
        let unused = unused.filter(|(_, index)| used.iter().all(|(_, of)| of != *index));
        names.extend(unused.map(|(name, _)| name.clone()));
    }
    Ok(names
        .iter()
        .map(|name| UnreadColumn::other(name, "an attribute of the glTF file"))
        .collect())
}

/// Which buffers hold anything of the Gaussians.
fn needed_buffers(
    document: &Document<'_>,
    jobs: &[Job<'_>],
    sh_rest: bool,
    path: &Path,
) -> Result<Vec<bool>, SceneError> {
    let mut needed = vec![false; document.buffers.len()];
    let mut need = |view: usize| {
        let buffer = document.buffer_views.get(view).map(|view| view.buffer);
        if let Some(flag) = buffer.and_then(|buffer| needed.get_mut(buffer)) {
            *flag = true;
        }
    };
    for job in jobs {
        if let Some((_, view)) = job.spz {
            need(view);
            continue;
        }
        for (_, index) in used_attributes(job.primitive, sh_rest, path)?.1 {
            let views = document.accessors.get(index).into_iter().flat_map(accessor::views_of);
            views.for_each(&mut need);
        }
    }
    Ok(needed)
}

/// Refuses a scene that is absurdly large for the bytes that hold it, before anything is reserved.
fn check_size(
    document: &Document<'_>,
    jobs: &[Job<'_>],
    sh_rest: bool,
    buffers: &Buffers<'_>,
    spz: &SpzParts<'_>,
    path: &Path,
) -> Result<(), SceneError> {
    let (mut rows, mut degree) = (0u64, 0u8);
    for job in jobs {
        if let Some((_, view)) = job.spz {
            let about = spz.about(view);
            rows = rows.saturating_add(about.0 as u64);
            degree = degree.max(about.1);
            continue;
        }
        let position = job.primitive.attributes.get("POSITION");
        let accessor = position.and_then(|&index| document.accessors.get(index));
        rows = rows.saturating_add(accessor.map_or(0, |accessor| accessor.count));
        degree = degree.max(used_attributes(job.primitive, sh_rest, path)?.0);
    }
    let rest = sh_rest_len(degree) as u64;
    // Position, size, orientation, opacity, color and coefficients.
    let size = rows.saturating_mul(4 * (3 + 3 + 4 + 1 + 3 + 3 * rest));
    let bytes = buffers.total();
    // Views may lie over each other, but no byte counts twice.
    let compressed = spz.bytes().min(bytes);
    let held = bytes.saturating_add(compressed.saturating_mul(SPZ_GROWTH - 1));
    let limit = held.saturating_mul(MAX_GROWTH).max(ALWAYS_FITS) as u64;
    if size <= limit {
        return Ok(());
    }
    let count = jobs.len();
    let problem = format!(
        "shows {rows} Gaussians in {count} primitives, more than its {bytes} bytes can hold"
    );
    Err(SceneError::format(path, problem, "show fewer copies of a mesh, or export it again"))
}

/// Gives the harmonics a higher degree, with zeros.
fn widen(scene: &mut GaussianScene, degree: u8, path: &Path) -> Result<(), SceneError> {
    if scene.sh_degree >= degree {
        return Ok(());
    }
    let old = std::mem::take(&mut scene.sh_rest);
    let had = scene.sh_rest_len() * 3;
    scene.sh_degree = degree;
    let width = scene.sh_rest_len() * 3;
    scene.sh_rest = zeroed(scene.len() * width, path)?;
    if had > 0 {
        let rows = scene.sh_rest.par_chunks_exact_mut(width).zip(old.par_chunks_exact(had));
        rows.for_each(|(new, old)| new[..had].copy_from_slice(old));
    }
    Ok(())
}

/// Has the nodes place their Gaussians relative to the origin of the whole scene, and gives it.
///
/// Only nodes that move something are a reason for one: the positions themselves are f32.
fn subtract_origin(
    parts: &[Part<'_>],
    jobs: &mut [Job<'_>],
    spz: &mut SpzParts<'_>,
    report: &mut RepairReport,
) -> Result<[f64; 3], SceneError> {
    if jobs.iter_mut().all(|job| *job.place.translation() == NO_ORIGIN) {
        return Ok(NO_ORIGIN);
    }
    let step = sample_step(parts.iter().map(Part::rows).sum());
    let mut sample = Vec::new();
    for (part, job) in parts.iter().zip(&*jobs) {
        let place = |p| job.place.position(p);
        match part {
            Part::Attributes(part) => sample.extend(part.sample_positions(step).map(place)),
            Part::Spz(view, _) => {
                sample.extend(spz.sample_positions(*view, step, report)?.into_iter().map(place));
            }
        }
    }
    let origin = origin_of(sample.into_iter());
    for job in jobs {
        job.place.translation().iter_mut().zip(origin).for_each(|(t, o)| *t -= o);
    }
    Ok(origin)
}

/// Reports quaternions without direction, and repairs them before they are multiplied.
pub(super) fn give_lengths(quat: &mut [[f32; 4]], first: usize, report: &mut RepairReport) {
    let squared = |q: &[f32; 4]| q.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>();
    let not_finite = |q: &[f32; 4]| !squared(q).is_finite();
    let zero = |q: &[f32; 4]| squared(q) == 0.0;
    let not_unit =
        |q: &[f32; 4]| !not_finite(q) && !zero(q) && (squared(q).sqrt() - 1.0).abs() > 1e-3;
    let mut count = |rule, bad: &dyn Fn(&[f32; 4]) -> bool| {
        let Some(row) = quat.iter().position(bad) else { return };
        let rows = quat.iter().filter(|q| bad(q)).count();
        report.add(rule, rows, first + row, &format!("{:?}", quat[row]));
    };
    count(Rule::QuatNotFinite, &not_finite);
    count(Rule::QuatZero, &zero);
    count(Rule::QuatNotUnit, &not_unit);
    quat.par_iter_mut()
        .filter(|q| not_finite(q) || zero(q))
        .for_each(|q| *q = [1.0, 0.0, 0.0, 0.0]);
}

/// Puts the rows of `more` behind those of `scene`, which will have `rows` in the end.
fn append(
    scene: &mut GaussianScene,
    more: GaussianScene,
    rows: usize,
    path: &Path,
) -> Result<(), SceneError> {
    if scene.is_empty() && more.len() == rows {
        *scene = more;
        return Ok(());
    }
    let (now, width) = (scene.len(), more.sh_rest_len() * 3);
    join(scene, &more, rows - now, width)
        .ok_or_else(|| file_error(path, format!("shows {rows} Gaussians; too many for the memory")))
}

/// Puts rows behind others; makes room for `due` more, so that it happens once for all that come.
/// `None` if there is not enough memory.
fn join(scene: &mut GaussianScene, more: &GaussianScene, due: usize, width: usize) -> Option<()> {
    fn extend<T: Copy>(all: &mut Vec<T>, more: &[T], due: usize) -> Option<()> {
        all.try_reserve_exact(due).ok()?;
        all.extend_from_slice(more);
        Some(())
    }
    extend(&mut scene.coord, &more.coord, due)?;
    extend(&mut scene.log_scale, &more.log_scale, due)?;
    extend(&mut scene.quat, &more.quat, due)?;
    extend(&mut scene.opacity_logit, &more.opacity_logit, due)?;
    extend(&mut scene.sh_dc, &more.sh_dc, due)?;
    extend(&mut scene.sh_rest, &more.sh_rest, due.checked_mul(width)?)
}
