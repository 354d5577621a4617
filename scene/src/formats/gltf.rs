//! glTF scenes with Gaussians: `KHR_gaussian_splatting` and the files of before it.
//!
//! A Gaussian is a point of a primitive with more attributes. All such primitives that the scene of
//! the document shows are read and joined, in the order of the nodes, each moved as its node says
//! and from glTF's frame ([`Frame::LUF`]) to the canonical one.
//!
//! | attribute | read as |
//! |---|---|
//! | `POSITION` | position |
//! | `ROTATION` | quaternion `x, y, z, w` |
//! | `SCALE` | standard deviation, or its logarithm where any value of the file is negative |
//! | `OPACITY`, else the alpha of `COLOR_0` | probability |
//! | `SH_DEGREE_l_COEF_n` | coefficients as they are |
//! | `COLOR_0`, if there is no `SH_DEGREE_0_COEF_0` | colour 0 to 1 |
//!
//! The names carry the prefix `KHR_gaussian_splatting:`, in older files `_`. The logarithms come
//! from a draft of the extension; the text that followed says standard deviations. Colours of the
//! space `lin_rec709_display` become sRGB, harmonics to first order. Nothing is fetched from a
//! network, and only files below the folder of the document are opened.

mod accessor;
mod attributes;
mod buffers;
mod container;
mod document;
mod nodes;
mod placement;
mod singular;

pub use container::is_glb;

use super::{LoadedScene, ReadOptions, SceneKind};
use crate::value_policy::Rule;
use crate::{Frame, GaussianScene, RepairReport, SceneError};
use attributes::{Attributes, gaussian_attribute, used_attributes};
use buffers::Buffers;
use document::{CompressedView, Document, Primitive};
use nodes::{Affine, placed_meshes};
use placement::Placement;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::path::Path;

/// The mode of primitives that are points.
const POINTS: u32 = 0;

/// Extensions that may be required without changing what a Gaussian is; of others a note is made.
const HARMLESS: [&str; 4] = [
    "KHR_gaussian_splatting",
    "KHR_mesh_quantization",
    "KHR_materials_unlit",
    "KHR_texture_transform",
];

/// How much larger than its buffers a scene may be in memory.
///
/// Quantised attributes grow by three; more comes from one mesh under several nodes. A file that
/// shows one mesh thousands of times would not fit, and no exporter of Gaussians writes one.
const MAX_GROWTH: usize = 16;
/// Most primitives that a document may show; one mesh under many nodes counts for each.
const MAX_PRIMITIVES: usize = 1 << 16;
/// Small scenes may be shown any number of times; bytes.
const ALWAYS_FITS: usize = 1 << 24;

fn file_error(path: &Path, problem: impl Into<String>) -> SceneError {
    SceneError::format(path, problem, "export the scene again")
}

/// Whether the bytes are a JSON object with `asset`, as every `.gltf`.
pub fn is_gltf_json(bytes: &[u8]) -> bool {
    document::has_asset(without_mark(bytes))
}

/// JSON without the mark of UTF-8 that some editors put before it.
fn without_mark(json: &[u8]) -> &[u8] {
    json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json)
}

/// A primitive with Gaussians and where it is.
struct Job<'a> {
    primitive: &'a Primitive,
    place: Placement,
}

/// Reads the Gaussians of a `.gltf` or `.glb`.
///
/// Rows are numbered through all primitives, in the order of the scene's nodes. `report.notes`
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
    let jobs = gaussian_primitives(&document, path, &mut report)?;
    if let Some((name, view)) = jobs.iter().find_map(|job| spz_of(job.primitive)) {
        return read_spz_primitive(name, view, path);
    }
    let needed = needed_buffers(&document, &jobs, options.sh_rest, path)?;
    let buffers = Buffers::open(&document, bin, path, &needed)?;
    let rows = check_size(&document, &jobs, options.sh_rest, buffers.total(), path)?;
    let open =
        |job: &Job<'_>| Attributes::open(&document, &buffers, job.primitive, options.sh_rest, path);
    let parts = jobs.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    let degree = parts.iter().map(|part| part.degree).max().unwrap_or(0);
    if parts.iter().any(|part| part.degree != degree) {
        report.notes.push(format!(
            "primitives have harmonics of several degrees; all get degree {degree}, with zeros"
        ));
    }
    let log_scale = parts.iter().any(Attributes::any_negative_scale);
    if parts.iter().any(Attributes::has_scale) {
        report.notes.push(if log_scale {
            "SCALE has negative values and was read as logarithms".to_owned()
        } else {
            "SCALE has no negative value and was read as standard deviations".to_owned()
        });
    }
    let mut scene = GaussianScene { sh_degree: degree, ..GaussianScene::default() };
    for (part, job) in parts.iter().zip(&jobs) {
        let first = scene.len();
        let mut read = part.read(degree, log_scale, first, &mut report);
        if job.place.turns() {
            give_lengths(&mut read.quat, first, &mut report);
        }
        job.place.apply(&mut read);
        append(&mut scene, read, rows);
    }
    LoadedScene::finish(scene, report, options.policy, path, SceneKind::Gltf)
}

/// Refuses files that say they cannot be understood without something that is not read.
fn check_required(
    document: &Document<'_>,
    path: &Path,
    report: &mut RepairReport,
) -> Result<(), SceneError> {
    for name in &document.extensions_required {
        let unreadable = name.contains("meshopt") || name.contains("draco");
        if unreadable {
            let problem = format!("requires the extension {name}, which is not read");
            return Err(SceneError::format(path, problem, "export it without compression"));
        }
        if !HARMLESS.contains(&name.as_str()) && !name.contains("spz") {
            report
                .notes
                .push(format!("the extension {name}, which the file requires, was ignored"));
        }
    }
    Ok(())
}

/// The primitives that are Gaussians, with what their nodes do to them.
fn gaussian_primitives<'a>(
    document: &'a Document<'_>,
    path: &Path,
    report: &mut RepairReport,
) -> Result<Vec<Job<'a>>, SceneError> {
    let to_canonical =
        Affine { linear: Frame::LUF.matrix_to(Frame::CANONICAL), translation: [0.0; 3] };
    let (mut jobs, mut others, mut stretched) = (Vec::new(), 0usize, 0usize);
    let mut notes = BTreeSet::new();
    for placed in placed_meshes(document, path)? {
        let Some(mesh) = document.meshes.get(placed.mesh) else {
            let (node, mesh) = (placed.node, placed.mesh);
            let there = document.meshes.len();
            let problem = format!("node {node} shows mesh {mesh}, of which there are {there}");
            return Err(file_error(path, problem));
        };
        let world = to_canonical.after(&placed.world);
        for primitive in &mesh.primitives {
            if jobs.len() + others > MAX_PRIMITIVES {
                let problem = format!("shows more than {MAX_PRIMITIVES} primitives");
                return Err(SceneError::format(
                    path,
                    problem,
                    "export the Gaussians by themselves",
                ));
            }
            if !is_gaussian(primitive) {
                others += 1;
                continue;
            }
            note_properties(primitive, &mut notes);
            if primitive.extensions.draco.is_some() {
                let problem =
                    format!("mesh {} is compressed by Draco, which is not read", placed.mesh);
                return Err(SceneError::format(path, problem, "export it without compression"));
            }
            let place = Placement::new(&world).ok_or_else(|| {
                let problem = format!(
                    "node {} shows Gaussians through a matrix without inverse: {:?}",
                    placed.node, placed.world.linear
                );
                SceneError::format(path, problem, "give the node and its parents a size")
            })?;
            stretched += usize::from(matches!(place, Placement::Stretched { .. }));
            jobs.push(Job { primitive, place });
        }
    }
    if jobs.is_empty() {
        let problem = format!("shows no Gaussians; it has {others} primitives of other kinds");
        let mend = "Gaussians are points with KHR_gaussian_splatting, or with _ROTATION and _SCALE";
        return Err(SceneError::format(path, problem, mend));
    }
    report.notes.extend(notes);
    if others > 0 {
        report.notes.push(format!("{others} primitives that are no Gaussians were left out"));
    }
    if stretched > 0 {
        report.notes.push(format!(
            "{stretched} of {} primitives are stretched by their nodes: sizes and orientations were \
             computed anew, harmonics follow the rotation only",
            jobs.len()
        ));
    }
    Ok(jobs)
}

fn is_gaussian(primitive: &Primitive) -> bool {
    let has = |name| gaussian_attribute(primitive, name).is_some();
    primitive.extensions.gaussians.is_some()
        || spz_of(primitive).is_some()
        || primitive.mode == Some(POINTS) && has("ROTATION") && has("SCALE")
}

/// Notes of what the extension says and this reader does not do.
fn note_properties(primitive: &Primitive, notes: &mut BTreeSet<String>) {
    if primitive.mode != Some(POINTS) {
        notes.insert(
            "a primitive of Gaussians is not of mode 0, points; it was read all the same"
                .to_owned(),
        );
    }
    let Some(about) = &primitive.extensions.gaussians else { return };
    match about.kernel.as_deref() {
        None | Some("ellipse") => {}
        Some(other) => {
            notes.insert(format!("the kernel {other:?} is unknown; read as \"ellipse\""));
        }
    }
    match about.color_space.as_deref() {
        None | Some("srgb_rec709_display") => {}
        Some("lin_rec709_display") => {
            notes.insert("linear colours became sRGB, their harmonics to first order".to_owned());
        }
        Some(other) => {
            notes.insert(format!("the colour space {other:?} is unknown; read as sRGB"));
        }
    }
    match about.projection.as_deref() {
        None | Some("perspective") => {}
        Some(other) => {
            notes.insert(format!("the projection {other:?} is not kept"));
        }
    }
    for name in about.extensions.keys().filter(|name| !name.contains("compression_spz")) {
        notes.insert(format!("the extension {name} of the Gaussians was ignored"));
    }
}

/// The extension that keeps the Gaussians of a primitive as a whole SPZ file, and where.
fn spz_of(primitive: &Primitive) -> Option<(&str, CompressedView)> {
    let outer = &primitive.extensions;
    let old = [
        ("KHR_spz_gaussian_splats_compression", outer.spz),
        ("KHR_spz_compression", outer.spz_first),
    ];
    let old = old.into_iter().find_map(|(name, view)| Some((name, view?)));
    let inner = outer.gaussians.iter().flat_map(|about| &about.extensions);
    let inner = inner.map(|(name, view)| (name.as_str(), *view));
    old.or_else(|| {
        inner
            .into_iter()
            .find(|(name, _)| name.starts_with("KHR_gaussian_splatting_compression_spz"))
    })
}

/// The one place where SPZ inside glTF is read.
///
/// To read it: take the bytes of the buffer view (mark its buffer as needed first), give them to
/// `super::spz::read_spz` with [`super::SpzFrame::Rub`], and move the result by `F·M·F`, with `M`
/// the node's matrix and `F` the map from LUF to the canonical frame: that reader has already
/// applied `F`, and the extension prescribes that SPZ data are packed from LUF.
fn read_spz_primitive(
    name: &str,
    view: CompressedView,
    path: &Path,
) -> Result<LoadedScene, SceneError> {
    let place = view.buffer_view.map_or_else(String::new, |view| format!(" in buffer view {view}"));
    let problem = format!("keeps its Gaussians{place} as SPZ ({name}), which is not read yet");
    Err(SceneError::format(path, problem, "export it without compression, or as .spz"))
}

/// Which buffers hold anything of the Gaussians.
fn needed_buffers(
    document: &Document<'_>,
    jobs: &[Job<'_>],
    sh_rest: bool,
    path: &Path,
) -> Result<Vec<bool>, SceneError> {
    let mut needed = vec![false; document.buffers.len()];
    for job in jobs {
        for (_, index) in used_attributes(job.primitive, sh_rest, path)?.1 {
            let views = document.accessors.get(index).into_iter().flat_map(accessor::views_of);
            for view in views.filter_map(|view| document.buffer_views.get(view)) {
                if let Some(flag) = needed.get_mut(view.buffer) {
                    *flag = true;
                }
            }
        }
    }
    Ok(needed)
}

/// The number of rows, if a scene of that many is no absurd size for the bytes that hold it.
fn check_size(
    document: &Document<'_>,
    jobs: &[Job<'_>],
    sh_rest: bool,
    bytes: usize,
    path: &Path,
) -> Result<usize, SceneError> {
    let (mut rows, mut degree) = (0u64, 0u8);
    for job in jobs {
        let position = job.primitive.attributes.get("POSITION");
        let accessor = position.and_then(|&index| document.accessors.get(index));
        rows = rows.saturating_add(accessor.map_or(0, |accessor| accessor.count));
        degree = degree.max(used_attributes(job.primitive, sh_rest, path)?.0);
    }
    let rest = (u64::from(degree) + 1).pow(2) - 1;
    // Position, size, orientation, opacity, colour and coefficients.
    let size = rows.saturating_mul(4 * (3 + 3 + 4 + 1 + 3 + 3 * rest));
    let limit = bytes.saturating_mul(MAX_GROWTH).max(ALWAYS_FITS) as u64;
    usize::try_from(rows).ok().filter(|_| size <= limit).ok_or_else(|| {
        let count = jobs.len();
        let problem = format!(
            "shows {rows} Gaussians in {count} primitives, more than its {bytes} bytes can hold"
        );
        SceneError::format(path, problem, "show fewer copies of a mesh, or export it again")
    })
}

/// Reports quaternions without direction, and repairs them before they are multiplied.
fn give_lengths(quat: &mut [[f32; 4]], first: usize, report: &mut RepairReport) {
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
fn append(scene: &mut GaussianScene, mut more: GaussianScene, rows: usize) {
    if scene.is_empty() && more.len() == rows {
        *scene = more;
        return;
    }
    fn join<T>(all: &mut Vec<T>, more: &mut Vec<T>, due: usize) {
        all.reserve_exact(due - all.len());
        all.append(more);
    }
    join(&mut scene.coord, &mut more.coord, rows);
    join(&mut scene.log_scale, &mut more.log_scale, rows);
    join(&mut scene.quat, &mut more.quat, rows);
    join(&mut scene.opacity_logit, &mut more.opacity_logit, rows);
    join(&mut scene.sh_dc, &mut more.sh_dc, rows);
    let width = scene.sh_rest_len() * 3;
    join(&mut scene.sh_rest, &mut more.sh_rest, rows * width);
}
