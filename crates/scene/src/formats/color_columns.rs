//! Red, green and blue where a file holds them instead of a DC term: bytes, 16 bits, fractions.
//!
//! No file says what full intensity is. One decision over all colors of a file does, here, for every
//! reader; a row by itself could be dark in one range and bright in another.

use super::ply::{PlyElement, PlyFile, PlyPropertyKind, PlyType};
use crate::gaussian_scene::{SH_C0, u8_to_dc};
use crate::value_policy::Rule;
use crate::{RepairReport, SceneError};
use rayon::prelude::*;

/// What columns of colors are called, in any case.
const NAMES: [[&str; 3]; 3] =
    [["red", "green", "blue"], ["r", "g", "b"], ["diffuse_red", "diffuse_green", "diffuse_blue"]];
/// Fractions may come out of a conversion this much too high.
const FRACTION_SLACK: f32 = 1.0 / 255.0;

/// The numbers that colors are stored as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ColorType {
    /// Bytes: always 0 to 255.
    Byte,
    /// 16 bits without a sign.
    Short,
    /// Other whole numbers.
    Whole,
    /// Floats.
    Float,
}

/// Colors of a file in the range that was decided on.
#[derive(Debug)]
pub(super) struct FileColors {
    /// `[N, 3]`, 0 to `full`, NaN where the file says so.
    values: Vec<f32>,
    full: f32,
}

impl FileColors {
    /// Decides what full intensity is, clips what is outside, and says both.
    ///
    /// Floats up to 1 are fractions. Any value above 1 means 0 to 255, and 0 to 65535 where most values
    /// are above 255, or, of 16-bit numbers, one is. `what` is the name of the field for the note.
    pub(super) fn decide(
        mut values: Vec<f32>,
        ty: ColorType,
        what: &str,
        report: &mut RepairReport,
    ) -> Self {
        let full = full_intensity(&values, ty);
        if ty != ColorType::Byte {
            report.notes.push(format!("{what}: read as 0 to {full}"));
        }
        for (row, color) in values.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let outside = color.iter().find(|v| **v < 0.0 || **v > full);
            if let Some(value) = outside.copied() {
                report.add_row(Rule::ColorClipped, row, || value.to_string());
                *color = color.map(|v| v.clamp(0.0, full));
            }
        }
        Self { values, full }
    }

    /// The DC terms; a byte gives the one that is written as the same byte. `[N, 3]`
    pub(super) fn dc(&self) -> Vec<[f32; 3]> {
        let table: Vec<f32> = (0..=255).map(u8_to_dc).collect();
        let term = |v: f32| match self.full {
            255.0 if v.fract() == 0.0 => table[usize::from(v as u8)],
            full => (v / full - 0.5) / SH_C0,
        };
        self.values.as_chunks::<3>().0.par_iter().map(|color| color.map(term)).collect()
    }

    /// The nearest bytes, gray where there is no number. `[N, 3]`
    pub(super) fn bytes(&self) -> Vec<[u8; 3]> {
        let byte = |v: f32| match v.is_nan() {
            true => crate::value_policy::DEFAULT_GREY,
            false => (v / self.full * 255.0).round() as u8,
        };
        self.values.as_chunks::<3>().0.iter().map(|color| color.map(byte)).collect()
    }
}

fn full_intensity(values: &[f32], ty: ColorType) -> f32 {
    let finite = || values.par_iter().copied().filter(|v| v.is_finite());
    let largest = finite().reduce(|| 0.0, f32::max);
    let mostly_above_255 = || 2 * finite().filter(|&v| v > 255.0).count() > values.len();
    match ty {
        ColorType::Byte => 255.0,
        ColorType::Float if largest <= 1.0 + FRACTION_SLACK => 1.0,
        ColorType::Short if largest > 255.0 => 65535.0,
        _ if mostly_above_255() => 65535.0,
        _ => 255.0,
    }
}

/// The names of three columns of colors, as the file spells them.
pub(super) fn color_names(vertex: &PlyElement) -> Option<[&str; 3]> {
    let spelled = |wanted: &str| {
        let mut names = vertex.properties.iter().filter(|p| !p.is_list()).map(|p| p.name.as_str());
        names.find(|name| name.eq_ignore_ascii_case(wanted))
    };
    NAMES.iter().find_map(|[r, g, b]| Some([spelled(r)?, spelled(g)?, spelled(b)?]))
}

/// The colors of an element; `None` if it has no columns of that kind.
///
/// # Errors
/// If there are some columns of a group, but not all, or if they cannot be read.
pub(super) fn read_colors(
    file: &PlyFile,
    vertex: &PlyElement,
    report: &mut RepairReport,
) -> Result<Option<FileColors>, SceneError> {
    let Some(names) = color_names(vertex) else {
        let [all, ..] = NAMES;
        let lacking: Vec<&str> = all.into_iter().filter(|name| !vertex.has(name)).collect();
        if lacking.len() == all.len() {
            return Ok(None);
        }
        let problem = format!("of {} its vertices lack {}", all.join(", "), lacking.join(", "));
        return Err(SceneError::format(file.path(), problem, "export the scene again"));
    };
    let types = names.map(|name| match vertex.property(name).map(|p| p.kind) {
        Some(PlyPropertyKind::Scalar(PlyType::U8)) => ColorType::Byte,
        Some(PlyPropertyKind::Scalar(PlyType::U16)) => ColorType::Short,
        Some(PlyPropertyKind::Scalar(ty)) if ty.is_float() => ColorType::Float,
        _ => ColorType::Whole,
    });
    let ty = match types {
        [r, g, b] if r == g && g == b => r,
        types if types.contains(&ColorType::Float) => ColorType::Float,
        _ => ColorType::Whole,
    };
    let values = file.table_f32(&vertex.name, &names)?;
    Ok(Some(FileColors::decide(values, ty, &names.join(", "), report)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decided(values: &[f32], ty: ColorType) -> (f32, usize) {
        let mut report = RepairReport::default();
        let colors = FileColors::decide(values.to_vec(), ty, "color", &mut report);
        assert!(colors.values.iter().all(|v| v.is_nan() || (0.0..=colors.full).contains(v)));
        assert_eq!(report.notes.is_empty(), ty == ColorType::Byte);
        (colors.full, report.count(Rule::ColorClipped))
    }

    #[test]
    fn one_value_decides_for_the_whole_file() {
        use ColorType::{Byte, Float, Short, Whole};
        assert_eq!(decided(&[0.0, 0.5, 1.0], Float), (1.0, 0));
        assert_eq!(decided(&[0.0, 0.5, 1.003], Float), (1.0, 1));
        assert_eq!(decided(&[0.0, 0.5, 1.0, 0.1, 0.2, 2.0], Float), (255.0, 0));
        assert_eq!(decided(&[0.0, 300.0, 12.0, -1.0, f32::NAN, 2.0], Float), (255.0, 2));
        assert_eq!(decided(&[f32::INFINITY, 0.5, 0.2], Float), (1.0, 1));
        assert_eq!(decided(&[900.0, 40_000.0, 3.0], Float), (65535.0, 0));
        assert_eq!(decided(&[0.0, 1.0, 1.0], Byte), (255.0, 0));
        assert_eq!(decided(&[0.0, 1.0, 255.0], Short), (255.0, 0));
        assert_eq!(decided(&[0.0, 1.0, 256.0], Short), (65535.0, 0));
        assert_eq!(decided(&[0.0, 1.0, 256.0], Whole), (255.0, 1));
        assert_eq!(decided(&[], Float), (1.0, 0));
    }

    #[test]
    fn the_same_color_comes_out_of_every_range() {
        let mut report = RepairReport::default();
        let mut of = |values: [f32; 3], ty| {
            let colors = FileColors::decide(values.to_vec(), ty, "color", &mut report);
            (colors.dc()[0], colors.bytes()[0])
        };
        let byte = of([0.0, 51.0, 255.0], ColorType::Byte);
        assert_eq!(byte.1, [0, 51, 255]);
        assert_eq!(byte, of([0.0, 51.0, 255.0], ColorType::Float));
        for (values, ty) in
            [([0.0, 0.2, 1.0], ColorType::Float), ([0.0, 13107.0, 65535.0], ColorType::Short)]
        {
            let other = of(values, ty);
            assert_eq!(other.1, byte.1);
            assert!((0..3).all(|i| (other.0[i] - byte.0[i]).abs() < 1e-5), "{other:?}");
        }
    }
}
