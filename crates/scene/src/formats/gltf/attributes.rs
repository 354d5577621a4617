//! The attributes of one primitive, as a scene.

use super::accessor::{Column, Component, View, fill};
use super::buffers::Buffers;
use super::document::{Document, Primitive};
use super::file_error;
use crate::gaussian_scene::{SH_C0, probability_to_logit, u8_to_dc};
use crate::linear_light::{display, display_slope};
use crate::spherical_harmonics::MAX_DEGREE;
use crate::value_policy::{DEFAULT_GREY, DEFAULT_SCALE, Rule};
use crate::{GaussianScene, RepairReport, SceneError};
use rayon::prelude::*;
use std::path::Path;

/// The color space that is not that of scenes.
const LINEAR: &str = "lin_rec709_display";

/// The accessor of a Gaussian attribute under its present name or an older one.
pub(super) fn gaussian_attribute(primitive: &Primitive, name: &str) -> Option<usize> {
    let of = |prefix: &str| primitive.attributes.get(&format!("{prefix}{name}")).copied();
    of("KHR_gaussian_splatting:").or_else(|| of("_"))
}

/// The accessors of everything that is read, with their names.
pub(super) fn used_attributes(
    primitive: &Primitive,
    sh_rest: bool,
    path: &Path,
) -> Result<(u8, Vec<(String, usize)>), SceneError> {
    let mut used = Vec::new();
    for name in ["POSITION", "COLOR_0"] {
        used.extend(primitive.attributes.get(name).map(|&index| (name.to_owned(), index)));
    }
    let mut add = |name: String| {
        let index = gaussian_attribute(primitive, &name);
        used.extend(index.map(|index| (name, index)));
        index.is_some()
    };
    for name in ["ROTATION", "SCALE", "OPACITY"] {
        add(name.to_owned());
    }
    add(sh_name(0, 0));
    let has =
        |l: usize| (0..=2 * l).any(|n| gaussian_attribute(primitive, &sh_name(l, n)).is_some());
    let degree = (1..=MAX_DEGREE).rev().find(|&l| has(l)).unwrap_or(0);
    for (l, n) in (1..=degree).flat_map(|l| (0..=2 * l).map(move |n| (l, n))) {
        // Checked even if they are not wanted: half a degree is a broken file.
        let name = sh_name(l, n);
        if gaussian_attribute(primitive, &name).is_none() {
            let problem = format!("has harmonics of degree {degree}, but not the attribute {name}");
            return Err(file_error(path, problem));
        }
        if sh_rest {
            add(name);
        }
    }
    // At most 4.
    Ok((if sh_rest { degree as u8 } else { 0 }, used))
}

fn sh_name(l: usize, n: usize) -> String {
    format!("SH_DEGREE_{l}_COEF_{n}")
}

/// One primitive, checked but not decoded.
pub(super) struct Attributes<'a> {
    pub rows: usize,
    /// Of the harmonics.
    pub degree: u8,
    position: View<'a>,
    rotation: Option<View<'a>>,
    scale: Option<View<'a>>,
    opacity: Option<View<'a>>,
    color: Option<View<'a>>,
    dc: Option<View<'a>>,
    rest: Vec<View<'a>>,
    /// Whether colors are linear light instead of sRGB.
    linear: bool,
}

impl<'a> Attributes<'a> {
    /// Opens the accessors and checks that they go together.
    pub(super) fn open(
        document: &Document<'_>,
        buffers: &'a Buffers<'_>,
        primitive: &Primitive,
        sh_rest: bool,
        path: &Path,
    ) -> Result<Self, SceneError> {
        let (degree, used) = used_attributes(primitive, sh_rest, path)?;
        let position = used.iter().find(|(name, _)| name == "POSITION");
        let Some(&(_, position)) = position else {
            return Err(file_error(path, "has Gaussians without POSITION".to_owned()));
        };
        let rows = document.accessors.get(position).map_or(0, |accessor| accessor.count);
        let mut views = Vec::with_capacity(used.len());
        for (name, index) in used {
            let view = View::open(document, buffers, index, &name, path)?;
            let bad = |problem: String| file_error(path, format!("{name} {problem}"));
            if view.rows as u64 != rows {
                return Err(bad(format!("has {} elements, POSITION {rows}", view.rows)));
            }
            let widths: &[usize] = match name.as_str() {
                "ROTATION" => &[4],
                "OPACITY" => &[1],
                "COLOR_0" => &[3, 4],
                _ => &[3],
            };
            if !widths.contains(&view.width) {
                return Err(bad(format!("has {} components, not {}", view.width, widths[0])));
            }
            if matches!(name.as_str(), "ROTATION" | "OPACITY") && !view.is_fraction() {
                let problem =
                    format!("has integers ({:?}) that are not normalized", view.component);
                return Err(bad(problem));
            }
            views.push((name, view));
        }
        let rest = views.iter().position(|(name, _)| *name == sh_name(1, 0));
        let rest = views.split_off(rest.unwrap_or(views.len()));
        let mut take = |wanted: &str| {
            let at = views.iter().position(|(name, _)| name == wanted)?;
            Some(views.swap_remove(at).1)
        };
        let Some(position) = take("POSITION") else {
            return Err(file_error(path, "has Gaussians without POSITION".to_owned()));
        };
        let space = primitive.extensions.gaussians.as_ref().and_then(|g| g.color_space.as_deref());
        Ok(Self {
            rows: position.rows,
            degree,
            position,
            rotation: take("ROTATION"),
            scale: take("SCALE"),
            opacity: take("OPACITY"),
            color: take("COLOR_0"),
            dc: take(&sh_name(0, 0)),
            rest: rest.into_iter().map(|(_, view)| view).collect(),
            linear: space == Some(LINEAR),
        })
    }

    /// Whether the sizes can only be logarithms.
    pub(super) fn any_negative_scale(&self) -> bool {
        self.scale.as_ref().is_some_and(View::any_negative)
    }

    /// Some positions as the file has them, those of every `step`-th row.
    pub(super) fn sample_positions(&self, step: usize) -> impl Iterator<Item = [f64; 3]> + '_ {
        let rows = (0..self.rows).step_by(step);
        rows.map(|row| self.position.row::<3>(row).map(f64::from))
    }

    /// Whether there are sizes at all.
    pub(super) fn has_scale(&self) -> bool {
        self.scale.is_some()
    }

    /// Decodes the primitive; `first` is the number of its first row in the file.
    pub(super) fn read(
        &self,
        log_scale: bool,
        first: usize,
        report: &mut RepairReport,
    ) -> GaussianScene {
        let n = self.rows;
        let mut scene = GaussianScene { sh_degree: self.degree, ..GaussianScene::default() };
        scene.coord = rows_of(&self.position);
        scene.log_scale = match &self.scale {
            Some(view) => {
                let mut scale: Vec<[f32; 3]> = rows_of(view);
                if !log_scale {
                    // The logarithm of a negative number is NaN, and such a row is dropped.
                    let ln = |v: &mut f32| *v = f64::from(*v).ln() as f32;
                    scale.par_iter_mut().for_each(|s| s.iter_mut().for_each(ln));
                }
                scale
            }
            None => {
                report.add(Rule::ScaleMissing, n, first, "");
                vec![[DEFAULT_SCALE.ln(); 3]; n]
            }
        };
        scene.quat = match &self.rotation {
            Some(view) => {
                let mut quat: Vec<[f32; 4]> = rows_of(view);
                quat.par_iter_mut().for_each(|q| q.rotate_right(1));
                quat
            }
            None => {
                report.add(Rule::QuatMissing, n, first, "");
                vec![[1.0, 0.0, 0.0, 0.0]; n]
            }
        };
        scene.opacity_logit = self.opacity(first, report);
        scene.sh_dc = self.dc(first, report);
        let width = scene.sh_rest_len() * 3;
        if width > 0 {
            scene.sh_rest = vec![0.0; n * width];
            let column = |(k, view)| Column { view, components: 0..3, at: 3 * k };
            let columns: Vec<_> = self.rest.iter().enumerate().map(column).collect();
            fill(&columns, &mut scene.sh_rest, width);
        }
        if self.linear {
            linear_to_srgb(&mut scene);
        }
        scene
    }

    fn opacity(&self, first: usize, report: &mut RepairReport) -> Vec<f32> {
        let alpha = self.color.as_ref().filter(|view| view.width == 4);
        let (view, component) = match (&self.opacity, alpha) {
            (Some(view), _) => (view, 0),
            (None, Some(view)) => (view, 3),
            (None, None) => {
                report.add(Rule::OpacityMissing, self.rows, first, "");
                return vec![f32::INFINITY; self.rows];
            }
        };
        let mut values = vec![0.0; self.rows];
        let components = component..component + 1;
        fill(&[Column { view, components, at: 0 }], &mut values, 1);
        if component == 3 {
            unsigned(view, &mut values);
        }
        let outside = |v: &f32| *v < 0.0 || *v > 1.0;
        let count = values.par_iter().filter(|&v| outside(v)).count();
        if let Some(row) = values.iter().position(outside) {
            report.add(Rule::OpacityOutside, count, first + row, &values[row].to_string());
        }
        values.par_iter_mut().for_each(|v| *v = probability_to_logit(v.clamp(0.0, 1.0)));
        values
    }

    fn dc(&self, first: usize, report: &mut RepairReport) -> Vec<[f32; 3]> {
        if let Some(view) = &self.dc {
            return rows_of(view);
        }
        let Some(view) = &self.color else {
            report.add(Rule::ColorMissing, self.rows, first, "");
            return vec![[u8_to_dc(DEFAULT_GREY); 3]; self.rows];
        };
        let mut color: Vec<[f32; 3]> = rows_of(view);
        unsigned(view, color.as_flattened_mut());
        let dc = |v: f32| ((f64::from(v) - 0.5) / f64::from(SH_C0)) as f32;
        // A color of bytes is to come back as the same bytes.
        let byte = |v: f32| u8_to_dc((v * 255.0).round() as u8);
        let is_byte = view.component == Component::U8;
        color.par_iter_mut().for_each(|c| *c = c.map(|v| if is_byte { byte(v) } else { dc(v) }));
        color
    }
}

/// Elements of `W` components or their first `W`.
fn rows_of<const W: usize>(view: &View<'_>) -> Vec<[f32; W]> {
    let mut rows = vec![[0.0; W]; view.rows];
    fill(&[Column { view, components: 0..W, at: 0 }], rows.as_flattened_mut(), W);
    rows
}

/// Integer colors are fractions even where the exporter forgot to say so.
fn unsigned(view: &View<'_>, values: &mut [f32]) {
    if !view.is_fraction() && matches!(view.component, Component::U8 | Component::U16) {
        let largest = view.component.divisor() as f32;
        values.par_iter_mut().for_each(|v| *v /= largest);
    }
}

/// Turns linear light into sRGB: the DC term exactly, the harmonics to first order about it.
fn linear_to_srgb(scene: &mut GaussianScene) {
    let width = scene.sh_rest_len() * 3;
    let slopes: Vec<[f32; 3]> = scene
        .sh_dc
        .par_iter_mut()
        .map(|dc| {
            let light = dc.map(|dc| 0.5 + f64::from(SH_C0) * f64::from(dc));
            *dc = light.map(|light| ((display(light) - 0.5) / f64::from(SH_C0)) as f32);
            light.map(|light| display_slope(light) as f32)
        })
        .collect();
    if width > 0 {
        let rows = scene.sh_rest.par_chunks_exact_mut(width).zip(&slopes);
        rows.for_each(|(rest, slope)| {
            let values = rest.iter_mut().zip(slope.iter().cycle());
            values.for_each(|(value, slope)| *value *= slope);
        });
    }
}
