//! Reading text layers.

use super::layer::{Layer, Prim};
use super::{CHECK, CONVERT, HARMONICS, TYPE};
use crate::formats::gltf::{Affine, Placement, give_lengths};
use crate::formats::packed_values::log_of_scale;
use crate::formats::semantics::clean_code;
use crate::formats::{LoadedScene, ReadOptions, SceneFormat};
use crate::frame::Frame;
use crate::gaussian_scene::{probability_to_logit, sh_rest_len};
use crate::place::{NO_ORIGIN, origin_of, sample_rows};
use crate::value_policy::Rule;
use crate::{
    GaussianScene, LanguageCode, LanguageCodebook, RepairReport, SceneError, UnreadColumn,
};
use std::path::Path;

/// What a text layer begins with.
const MARK: &[u8] = b"#usda";
/// Meters a unit of layers that do not say it.
const UNSAID_UNIT: f64 = 0.01;
/// Harmonics beyond this degree are not known.
const MAX_DEGREE: u32 = 4;

/// Whether bytes are a text layer.
pub fn is_usda(bytes: &[u8]) -> bool {
    bytes.starts_with(MARK)
}

/// Reads the Gaussians of a text layer: the one prim of type `ParticleField3DGaussianSplat`, moved as its own and its parents'
/// `xformOp`s say, from the layer's up axis and unit.
///
/// Opacities 0 and 1 become the logits ±inf. What the layer does not say is what the schema prescribes for it. Other files that it
/// refers to are not read.
///
/// # Errors
/// As [`super::super::open_scene`]; also if the text is malformed, holds no such prim or several, or arrays of too few values.
pub fn read_usda(
    bytes: &[u8],
    path: &Path,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    read_layer(bytes, path, options, SceneFormat::Usda)
}

pub(super) fn read_layer(
    bytes: &[u8],
    path: &Path,
    options: &ReadOptions,
    kind: SceneFormat,
) -> Result<LoadedScene, SceneError> {
    let mut layer = Layer::read(bytes, path)?;
    let (Some(prim), 1) = (layer.first.take(), layer.count) else {
        return Err(none_or_several(&layer, path));
    };
    let mut report = RepairReport::default();
    if layer.refers {
        report.notes.push(
            "refers to other files or prims, or has variants; these were not read".to_owned(),
        );
    }
    let mut world = place(&layer, &prim, path, &mut report)?;
    let unread = unread(&prim);
    let mut scene = gaussians(prim, options, path, &mut report)?;
    let origin = subtract_origin(&mut world, &scene);
    if world.turns() {
        give_lengths(&mut scene.quat, 0, &mut report);
    }
    world.apply(&mut scene);
    scene.origin = origin;
    let loaded = LoadedScene::finish(scene, report, options.policy, path, kind)?;
    Ok(LoadedScene { unread, ..loaded })
}

fn none_or_several(layer: &Layer, path: &Path) -> SceneError {
    let count = layer.count;
    let refers = if layer.refers { " itself; it refers to other files or prims" } else { "" };
    let problem = match count {
        0 => format!("holds no {TYPE}{refers}"),
        _ => format!("holds {count} prims of type {TYPE}, of which one is read"),
    };
    let help = if count == 0 { CONVERT } else { "leave one of them in the file" };
    SceneError::format(path, problem, help)
}

/// From the coordinates of the prim to those of scenes in memory.
fn place(
    layer: &Layer,
    prim: &Prim,
    path: &Path,
    report: &mut RepairReport,
) -> Result<Placement, SceneError> {
    let frame = match layer.up_axis.as_deref() {
        None | Some("Y") => Frame::RUB,
        // Right, forward, up.
        Some("Z") => "RFU".parse().map_err(|e: String| SceneError::format(path, e, ""))?,
        Some(other) => {
            let problem = format!("says upAxis = {other:?}");
            return Err(SceneError::format(path, problem, "up is \"Y\" or \"Z\""));
        }
    };
    let unit = layer.meters_per_unit.unwrap_or(UNSAID_UNIT);
    if unit.is_nan() || unit <= 0.0 {
        let problem = format!("says metersPerUnit = {unit}");
        return Err(SceneError::format(path, problem, "a unit is a positive number of meters"));
    }
    if layer.meters_per_unit.is_none() {
        report.notes.push("does not say metersPerUnit; USD prescribes centimeters then".to_owned());
    } else if unit != 1.0 {
        report.notes.push(format!("says metersPerUnit = {unit}; converted to meters"));
    }
    let world = prim.world.as_ref().map_err(|why| {
        SceneError::format(
            path,
            why,
            "write the Gaussians where they are, without that transformation",
        )
    })?;
    let mut to_memory = Affine { linear: frame.matrix_to(Frame::CANONICAL), translation: [0.0; 3] };
    to_memory.linear.iter_mut().flatten().for_each(|v| *v *= unit);
    Placement::new(&to_memory.after(world)).ok_or_else(|| {
        let problem = format!("{} is placed by a matrix without inverse", prim.place);
        SceneError::format(path, problem, "check metersPerUnit and the xformOps above it")
    })
}

/// Has the Gaussians placed relative to an origin, where they would come to lie far from 0, and gives it.
fn subtract_origin(world: &mut Placement, scene: &GaussianScene) -> [f64; 3] {
    if *world.translation() == NO_ORIGIN {
        return NO_ORIGIN;
    }
    let sample =
        sample_rows(scene.len()).map(|row| world.position(scene.coord[row].map(f64::from)));
    let origin = origin_of(sample);
    world.translation().iter_mut().zip(origin).for_each(|(t, o)| *t -= o);
    origin
}

/// The Gaussians in the coordinates of the prim.
fn gaussians(
    prim: Prim,
    options: &ReadOptions,
    path: &Path,
    report: &mut RepairReport,
) -> Result<GaussianScene, SceneError> {
    let bad = |problem: String| SceneError::format(path, problem, "export the scene again");
    let Some(coord) = prim.positions else {
        let why = match prim.animated.iter().find(|name| name.starts_with("positions")) {
            Some(name) => format!("{name} changes with time, which is not read"),
            None => "has no positions".to_owned(),
        };
        return Err(bad(format!("{}: {why}", prim.place)));
    };
    let rows = coord.len();
    let mut rest = Given { place: &prim.place, rows, path, report };
    let scales = rest.rows("scales", prim.scales, [1.0; 3])?;
    let quat = rest.rows("orientations", prim.orientations, [1.0, 0.0, 0.0, 0.0])?;
    let mut opacity = rest.rows("opacities", prim.opacities, [1.0])?;
    let outside = |[alpha]: &[f32; 1]| *alpha < 0.0 || *alpha > 1.0;
    if let Some(row) = opacity.iter().position(outside) {
        let count = opacity.iter().filter(|alpha| outside(alpha)).count();
        rest.report.add(Rule::OpacityOutside, count, row, &opacity[row][0].to_string());
        opacity.iter_mut().flatten().for_each(|alpha| *alpha = alpha.clamp(0.0, 1.0));
    }
    let degree = prim.degree.unwrap_or(3);
    if degree > MAX_DEGREE {
        return Err(bad(format!(
            "{}: harmonics of degree {degree}, at most {MAX_DEGREE} are known",
            prim.place
        )));
    }
    let degree = if prim.harmonics.is_some() { degree as u8 } else { 0 };
    let width = 1 + sh_rest_len(degree);
    let harmonics = rest.rows_of(HARMONICS, prim.harmonics, [0.0; 3], width)?;
    let label = |values: Vec<[i32; 1]>| values.into_iter().map(|[v]| v.max(-1)).collect::<Vec<_>>();
    let mut own = |name, values: Option<Vec<[i32; 1]>>| {
        values.map(|values| rest.rows(name, Some(values), [-1]).map(label)).transpose()
    };
    let segment = own(super::SEGMENT, prim.segment)?;
    let instance = own(super::INSTANCE, prim.instance)?;
    let segment_score = prim
        .segment_score
        .map(|values| rest.rows(super::SEGMENT_SCORE, Some(values), [0.0]))
        .transpose()?
        .map(|values| values.into_iter().map(|[v]| v).collect());
    let lang_code = match (prim.lang_code, prim.codebook_mean, prim.codebook_axes) {
        (Some(code), Some(mean), Some(axes)) => {
            let k = axes.len() / mean.len().max(1);
            if k == 0 || k * mean.len() != axes.len() {
                return Err(bad(format!("{}: language codes with a broken codebook", prim.place)));
            }
            let code = rest.rows_of(super::LANG_CODE, Some(code), [half::f16::ZERO], k)?;
            let flat = |values: Vec<[f32; 1]>| values.into_iter().map(|[v]| v).collect();
            let codebook = LanguageCodebook { mean: flat(mean), axes: flat(axes) };
            codebook.check().map_err(|e| bad(format!("{}: {e}", prim.place)))?;
            let values = code.into_iter().map(|[v]| v).collect();
            Some(clean_code(LanguageCode { values, codebook }, rest.report))
        }
        (None, None, None) => None,
        _ => return Err(bad(format!("{}: language codes without the whole codebook", prim.place))),
    };
    let (sh_dc, sh_rest) = split(harmonics, width, options.sh_rest);
    Ok(GaussianScene {
        coord,
        log_scale: scales.into_iter().map(|scale| scale.map(log_of_scale)).collect(),
        quat,
        opacity_logit: opacity.into_iter().map(|[alpha]| probability_to_logit(alpha)).collect(),
        sh_dc,
        sh_rest,
        sh_degree: if options.sh_rest { degree } else { 0 },
        segment,
        instance,
        segment_score,
        lang_code,
        antialiased: prim.antialiased,
        ..GaussianScene::default()
    })
}

/// The first of every `width` rows, and the numbers of the others, if they are wanted.
fn split(rows: Vec<[f32; 3]>, width: usize, rest: bool) -> (Vec<[f32; 3]>, Vec<f32>) {
    if width == 1 {
        return (rows, Vec::new());
    }
    let first = rows.iter().step_by(width).copied().collect();
    let others = rows.chunks_exact(width).filter(|_| rest).flat_map(|row| row[1..].as_flattened());
    (first, others.copied().collect())
}

/// Arrays of a prim.
struct Given<'a> {
    place: &'a str,
    /// Gaussians.
    rows: usize,
    path: &'a Path,
    report: &'a mut RepairReport,
}

impl Given<'_> {
    /// One value a Gaussian; what the prim does not say is `default`.
    fn rows<T: Clone>(
        &mut self,
        name: &str,
        values: Option<Vec<T>>,
        default: T,
    ) -> Result<Vec<T>, SceneError> {
        self.rows_of(name, values, default, 1)
    }

    /// `width` values a Gaussian.
    fn rows_of<T: Clone>(
        &mut self,
        name: &str,
        values: Option<Vec<T>>,
        default: T,
        width: usize,
    ) -> Result<Vec<T>, SceneError> {
        let place = self.place;
        let Some(needed) = self.rows.checked_mul(width) else {
            let problem = format!(
                "{place}: {name} would have {width} values for each of {} Gaussians",
                self.rows
            );
            return Err(SceneError::format(self.path, problem, CHECK));
        };
        let Some(mut values) = values else {
            self.report
                .notes
                .push(format!("{place} has no {name}; all have those that the schema prescribes"));
            return Ok(vec![default; needed]);
        };
        if values.len() < needed {
            let problem = format!(
                "{place}: {name} has {} values, {needed} for {} Gaussians",
                values.len(),
                self.rows
            );
            return Err(SceneError::format(self.path, problem, "export the scene again"));
        }
        if values.len() > needed {
            let more = values.len() - needed;
            self.report.notes.push(format!("{place}: {more} values of {name} are of no Gaussian"));
            values.truncate(needed);
        }
        Ok(values)
    }
}

fn unread(prim: &Prim) -> Vec<UnreadColumn> {
    let column = |kind: &str, name: &String| UnreadColumn {
        name: name.clone(),
        kind: kind.to_owned(),
        may_be_labels: false,
    };
    let arrays = prim.unread.iter().map(|[name, ty]| column(ty, name));
    arrays.chain(prim.animated.iter().map(|name| column("changes with time", name))).collect()
}
