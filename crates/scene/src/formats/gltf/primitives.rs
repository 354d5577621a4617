//! Which primitives of a document are Gaussians, and what is said about them.

use super::attributes::gaussian_attribute;
use super::document::{CompressedView, Document, Primitive};
use super::file_error;
use super::nodes::{Affine, Placed, placed_meshes};
use super::placement::Placement;
use crate::{Frame, RepairReport, SceneError};
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

/// Most primitives that a document may show; one mesh under many nodes counts for each.
const MAX_PRIMITIVES: usize = 1 << 16;

/// A primitive with Gaussians and where it is.
pub(super) struct Job<'a> {
    pub primitive: &'a Primitive,
    /// The extension that keeps them as a whole SPZ file, and the buffer view it is in.
    pub spz: Option<(&'a str, usize)>,
    /// From the coordinates as they are read to the canonical frame.
    pub place: Placement,
}

/// Refuses files that say they cannot be understood without something that is not read.
pub(super) fn check_required(
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
pub(super) fn gaussian_primitives<'a>(
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
        // The reader of SPZ has already gone to the canonical frame; the node is about glTF's.
        let world_of_spz = world.after(&to_canonical);
        for primitive in &mesh.primitives {
            if jobs.len() + others > MAX_PRIMITIVES {
                let problem = format!("shows more than {MAX_PRIMITIVES} primitives");
                let help = "export the Gaussians by themselves";
                return Err(SceneError::format(path, problem, help));
            }
            if !is_gaussian(primitive) {
                others += 1;
                continue;
            }
            note_properties(primitive, &mut notes);
            let job = job(primitive, &placed, [&world, &world_of_spz], path)?;
            stretched += usize::from(matches!(job.place, Placement::Stretched { .. }));
            jobs.push(job);
        }
    }
    if jobs.is_empty() {
        let problem = format!("shows no Gaussians; it has {others} primitives of other kinds");
        let help = "Gaussians are points with KHR_gaussian_splatting, or with _ROTATION and _SCALE";
        return Err(SceneError::format(path, problem, help));
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

/// What a primitive is and where it goes; `worlds`: of attributes, and of SPZ.
fn job<'a>(
    primitive: &'a Primitive,
    placed: &Placed,
    worlds: [&Affine; 2],
    path: &Path,
) -> Result<Job<'a>, SceneError> {
    if primitive.extensions.draco.is_some() {
        let problem = format!("mesh {} is compressed by Draco, which is not read", placed.mesh);
        return Err(SceneError::format(path, problem, "export it without compression"));
    }
    let spz = spz_of(primitive).map(|(name, about)| {
        let none = || file_error(path, format!("{name} names no buffer view"));
        Ok::<_, SceneError>((name, about.buffer_view.ok_or_else(none)?))
    });
    let spz = spz.transpose()?;
    let place = Placement::new(worlds[usize::from(spz.is_some())]).ok_or_else(|| {
        let problem = format!(
            "node {} shows Gaussians through a matrix without inverse: {:?}",
            placed.node, placed.world.linear
        );
        SceneError::format(path, problem, "give the node and its parents a size")
    })?;
    Ok(Job { primitive, spz, place })
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
    let of = |property: &Option<String>, usual: &str, note: &dyn Fn(&str) -> String| {
        property.as_deref().filter(|&value| value != usual).map(note)
    };
    notes.extend(of(&about.kernel, "ellipse", &|other| {
        format!("the kernel {other:?} is unknown; read as \"ellipse\"")
    }));
    notes.extend(of(&about.color_space, "srgb_rec709_display", &|other| match other {
        "lin_rec709_display" => {
            "linear colors became sRGB, their harmonics to first order".to_owned()
        }
        _ => format!("the color space {other:?} is unknown; read as sRGB"),
    }));
    notes.extend(of(&about.projection, "perspective", &|other| {
        format!("the projection {other:?} is not kept")
    }));
    let ignored = about.extensions.keys().filter(|name| !name.contains("compression_spz"));
    notes.extend(ignored.map(|name| format!("the extension {name} of the Gaussians was ignored")));
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
    let mut inner = inner.map(|(name, view)| (name.as_str(), *view));
    old.or_else(|| {
        inner.find(|(name, _)| name.starts_with("KHR_gaussian_splatting_compression_spz"))
    })
}
