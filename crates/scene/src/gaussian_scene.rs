//! The scene in memory.

use crate::SceneError;
use crate::extra_columns::ExtraColumn;
use crate::language_code::LanguageCode;
use half::f16;

/// Zeroth spherical-harmonic basis constant: `rgb = 0.5 + SH_C0 · dc`.
pub const SH_C0: f32 = 0.282_094_8;

/// Per-row features of a fixed width, stored as f16 (that is how language features are on disk).
#[derive(Debug, Clone, PartialEq)]
pub struct LanguageFeatures {
    /// Row-major values, `[N, dim]`.
    pub values: Vec<f16>,
    /// Width of a row.
    pub dim: usize,
}

/// Labeled points of the original capture, which benchmarks evaluate on instead of Gaussians.
///
/// Same frame and [`origin`](GaussianScene::origin) as the Gaussians; the number of points is independent of the number of Gaussians.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LabelledPoints {
    /// Positions relative to the scene's origin, meters. `[M, 3]`
    pub coord: Vec<[f32; 3]>,
    /// Class index, `-1` = no label. `[M]`
    pub segment: Option<Vec<i32>>,
    /// Instance id, `-1` = none. `[M]`
    pub instance: Option<Vec<i32>>,
}

impl LabelledPoints {
    /// Keeps the points whose flag is set.
    pub(crate) fn retain(&mut self, keep: &[bool]) {
        retain_flagged(&mut self.coord, keep);
        for labels in [&mut self.segment, &mut self.instance].into_iter().flatten() {
            retain_flagged(labels, keep);
        }
    }
}

/// A scene of 3D Gaussians: structure of arrays, every array with one row per Gaussian.
///
/// # Conventions (stated here once)
/// - positions and scales are in meters, in the frame of the trainer's PLY files, nominally x right,
///   y down, z forward ([`Frame::CANONICAL`](crate::frame::Frame)); readers of formats that
///   prescribe another frame (SPZ, glTF) convert, others leave the axes alone; which way is up is
///   in none of these files, the trainer's choice decides;
/// - a scene far from 0, of a file that holds its positions as doubles, keeps them relative to an
///   `origin`; all that looks at one scene alone may leave that out of account;
/// - scale is the natural logarithm of the standard deviation along each principal axis;
/// - `quat` is `w, x, y, z`, unit norm, `w ≥ 0`; the columns of its matrix are the principal axes;
/// - opacity is a logit: `alpha = 1 / (1 + e^-logit)`; `±inf` are legal (alpha 0 or 1);
/// - color is the spherical-harmonic DC term: `rgb = 0.5 + SH_C0 · dc`, display-referred sRGB;
/// - `sh_rest` is coefficient-major with the channel inside: `[N, K, 3]`, `K = (degree + 1)² − 1`.
///
/// Values are kept *before* activation because that is what splat files hold: a scene that is read
/// and written again is unchanged.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GaussianScene {
    /// What was subtracted from all positions on reading, in units of the scene; zero for scenes near
    /// 0. A center is at `coord + origin` in the coordinates of the file.
    pub origin: [f64; 3],
    /// Centers relative to `origin`, meters. `[N, 3]`
    pub coord: Vec<[f32; 3]>,
    /// Natural logarithm of the standard deviations in meters. `[N, 3]`
    pub log_scale: Vec<[f32; 3]>,
    /// Orientation `w, x, y, z`. `[N, 4]`
    pub quat: Vec<[f32; 4]>,
    /// Opacity before the sigmoid. `[N]`
    pub opacity_logit: Vec<f32>,
    /// Color as SH DC coefficients. `[N, 3]`
    pub sh_dc: Vec<[f32; 3]>,
    /// Higher SH coefficients, `[N, K, 3]` flattened; empty for degree 0.
    pub sh_rest: Vec<f32>,
    /// Spherical-harmonic degree of `sh_rest`, 0..=4.
    pub sh_degree: u8,
    /// Unit surface normals. `[N, 3]`
    pub normal: Option<Vec<[f32; 3]>>,
    /// Class index, `-1` = no label. `[N]`
    pub segment: Option<Vec<i32>>,
    /// How sure the class in `segment` is, any range, higher is surer. `[N]`
    pub segment_score: Option<Vec<f32>>,
    /// Instance id, `-1` = none. `[N]`
    pub instance: Option<Vec<i32>>,
    /// Short language codes with what decodes them. `[N, k]`
    pub lang_code: Option<LanguageCode>,
    /// Language features. `[N, D]`
    pub lang_feat: Option<LanguageFeatures>,
    /// Whether the row of `lang_feat` holds a feature. `[N]`
    pub valid_feat_mask: Option<Vec<bool>>,
    /// Labeled points to evaluate on; independent row count.
    pub labelled_points: Option<LabelledPoints>,
    /// Columns whose meaning is not known, if they were asked for. `[N, …]` each
    pub extra: Vec<ExtraColumn>,
    /// Whether it was trained with opacities that make up for the low-pass of the picture, and looks as it
    /// was trained only if it is drawn so.
    pub antialiased: bool,
}

impl GaussianScene {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.coord.len()
    }

    /// Whether there is no Gaussian.
    pub fn is_empty(&self) -> bool {
        self.coord.is_empty()
    }

    /// Number of higher SH coefficients per channel: `(degree + 1)² − 1`.
    pub fn sh_rest_len(&self) -> usize {
        sh_rest_len(self.sh_degree)
    }

    /// Opacity in `0..=1`.
    pub fn opacity(&self, row: usize) -> f32 {
        sigmoid(self.opacity_logit[row])
    }

    /// Standard deviations in meters.
    pub fn scale(&self, row: usize) -> [f32; 3] {
        self.log_scale[row].map(f32::exp)
    }

    /// Color as the preprocessing of the original system stores it: clipped to 0..=1, times 255,
    /// *truncated* (not rounded) to a byte.
    pub fn color_u8(&self, row: usize) -> [u8; 3] {
        self.sh_dc[row].map(dc_to_u8)
    }

    /// Checks that every array has one row per Gaussian.
    ///
    /// # Errors
    /// Names the first array whose row count differs.
    pub fn check_rows(&self) -> Result<(), SceneError> {
        let rows = self.len();
        let check = |field: &'static str, got: usize, width: usize| {
            let expected = rows * width;
            if got == expected {
                Ok(())
            } else {
                Err(SceneError::RowCount { field, expected, got })
            }
        };
        let optional = |field: &'static str, got: Option<usize>, width: usize| {
            got.map_or(Ok(()), |got| check(field, got, width))
        };
        check("log_scale", self.log_scale.len(), 1)?;
        check("quat", self.quat.len(), 1)?;
        check("opacity_logit", self.opacity_logit.len(), 1)?;
        check("sh_dc", self.sh_dc.len(), 1)?;
        check("sh_rest", self.sh_rest.len(), self.sh_rest_len() * 3)?;
        optional("normal", self.normal.as_ref().map(Vec::len), 1)?;
        optional("segment", self.segment.as_ref().map(Vec::len), 1)?;
        optional("segment_score", self.segment_score.as_ref().map(Vec::len), 1)?;
        optional("instance", self.instance.as_ref().map(Vec::len), 1)?;
        if let Some(code) = &self.lang_code {
            code.codebook.check()?;
            check("lang_code", code.values.len(), code.width())?;
        }
        if let Some(feat) = &self.lang_feat {
            // A ragged last row counts as a row too many, never as none.
            let width = feat.dim.max(1);
            check("lang_feat", feat.values.len().div_ceil(width), 1)?;
            check("lang_feat", feat.values.len() / width, 1)?;
        }
        self.extra.iter().try_for_each(|column| column.check_rows(rows))?;
        optional("valid_feat_mask", self.valid_feat_mask.as_ref().map(Vec::len), 1)
    }

    /// Leaves out the rows whose flag is false, in place: nothing is there twice at any time.
    ///
    /// # Panics
    /// If there is not one flag per Gaussian.
    pub(crate) fn retain_rows(&mut self, keep: &[bool]) {
        assert_eq!(keep.len(), self.len(), "one flag per Gaussian");
        fn compact<T: Copy>(values: &mut Vec<T>, width: usize, keep: &[bool]) {
            let mut end = 0;
            for row in (0..keep.len()).filter(|&row| keep[row]) {
                values.copy_within(row * width..(row + 1) * width, end);
                end += width;
            }
            values.truncate(end);
        }
        let rest = self.sh_rest_len() * 3;
        compact(&mut self.coord, 1, keep);
        compact(&mut self.log_scale, 1, keep);
        compact(&mut self.quat, 1, keep);
        compact(&mut self.opacity_logit, 1, keep);
        compact(&mut self.sh_dc, 1, keep);
        compact(&mut self.sh_rest, rest, keep);
        fn compact_some<T: Copy>(values: &mut Option<Vec<T>>, keep: &[bool]) {
            values.iter_mut().for_each(|values| compact(values, 1, keep));
        }
        compact_some(&mut self.normal, keep);
        compact_some(&mut self.segment, keep);
        compact_some(&mut self.instance, keep);
        compact_some(&mut self.segment_score, keep);
        compact_some(&mut self.valid_feat_mask, keep);
        if let Some(a) = &mut self.lang_code {
            let width = a.width();
            compact(&mut a.values, width, keep);
        }
        if let Some(a) = &mut self.lang_feat {
            compact(&mut a.values, a.dim, keep);
        }
        for column in &mut self.extra {
            let width = column.row_bytes();
            compact(&mut column.bytes, width, keep);
        }
    }

    /// The scene made of the given rows, in the given order; rows may repeat.
    ///
    /// The one place where the number of rows changes, so no array can get out of step.
    ///
    /// # Errors
    /// If a row is out of range.
    pub fn select_rows(&self, rows: &[usize]) -> Result<Self, SceneError> {
        if let Some(&row) = rows.iter().find(|&&r| r >= self.len()) {
            return Err(SceneError::RowOutOfRange { row, rows: self.len() });
        }
        fn pick<T: Copy>(from: &[T], rows: &[usize]) -> Vec<T> {
            rows.iter().map(|&r| from[r]).collect()
        }
        fn pick_some<T: Copy>(from: &Option<Vec<T>>, rows: &[usize]) -> Option<Vec<T>> {
            from.as_ref().map(|from| pick(from, rows))
        }
        fn pick_wide<T: Copy>(from: &[T], width: usize, rows: &[usize]) -> Vec<T> {
            let mut out = Vec::with_capacity(rows.len() * width);
            rows.iter().for_each(|r| out.extend_from_slice(&from[r * width..(r + 1) * width]));
            out
        }
        Ok(Self {
            origin: self.origin,
            coord: pick(&self.coord, rows),
            log_scale: pick(&self.log_scale, rows),
            quat: pick(&self.quat, rows),
            opacity_logit: pick(&self.opacity_logit, rows),
            sh_dc: pick(&self.sh_dc, rows),
            sh_rest: pick_wide(&self.sh_rest, self.sh_rest_len() * 3, rows),
            sh_degree: self.sh_degree,
            normal: pick_some(&self.normal, rows),
            segment: pick_some(&self.segment, rows),
            segment_score: pick_some(&self.segment_score, rows),
            instance: pick_some(&self.instance, rows),
            lang_code: self.lang_code.as_ref().map(|a| LanguageCode {
                values: pick_wide(&a.values, a.width(), rows),
                codebook: a.codebook.clone(),
            }),
            lang_feat: self.lang_feat.as_ref().map(|a| LanguageFeatures {
                values: pick_wide(&a.values, a.dim, rows),
                dim: a.dim,
            }),
            valid_feat_mask: pick_some(&self.valid_feat_mask, rows),
            labelled_points: self.labelled_points.clone(),
            extra: self.extra.iter().map(|column| column.select(rows)).collect(),
            antialiased: self.antialiased,
        })
    }
}

/// Number of higher SH coefficients per channel of a degree.
pub(crate) fn sh_rest_len(degree: u8) -> usize {
    (usize::from(degree) + 1).pow(2) - 1
}

/// Keeps the values whose flag is set.
pub(crate) fn retain_flagged<T>(values: &mut Vec<T>, keep: &[bool]) {
    let mut flags = keep.iter();
    values.retain(|_| flags.next().copied().unwrap_or(false));
}

/// The logistic function; exact at both infinities.
pub fn sigmoid(logit: f32) -> f32 {
    1.0 / (1.0 + (-logit).exp())
}

/// The logit of a probability, computed in f64: `ln(p / (1 − p))`.
///
/// `-inf` for 0 and `+inf` for 1, which [`sigmoid`] maps back exactly; NaN outside `0..=1`.
pub fn probability_to_logit(probability: f32) -> f32 {
    let p = f64::from(probability);
    (p / (1.0 - p)).ln() as f32
}

/// The byte that a DC coefficient is stored as: `trunc(255 · clip(0.5 + SH_C0 · dc, 0, 1))`.
pub fn dc_to_u8(dc: f32) -> u8 {
    // The product is rounded once before the sum, as in the original; `mul_add` would not be.
    ((dc * SH_C0 + 0.5).clamp(0.0, 1.0) * 255.0) as u8
}

/// A DC coefficient that [`dc_to_u8`] maps back to exactly `byte`.
pub fn u8_to_dc(byte: u8) -> f32 {
    let mut dc = (f32::from(byte) / 255.0 - 0.5) / SH_C0;
    // Rounding may land just below the byte, which truncation would then miss by one.
    while dc_to_u8(dc) < byte {
        dc = dc.next_up();
    }
    dc
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extra_columns::NumberType;
    use crate::language_code::LanguageCodebook;

    #[test]
    fn every_byte_survives_the_color_round_trip() {
        for byte in 0..=255 {
            assert_eq!(dc_to_u8(u8_to_dc(byte)), byte);
        }
    }

    #[test]
    fn opacity_is_exact_at_infinity() {
        assert_eq!(sigmoid(f32::INFINITY), 1.0);
        assert_eq!(sigmoid(f32::NEG_INFINITY), 0.0);
        assert_eq!(sigmoid(0.0), 0.5);
    }

    #[test]
    fn probability_survives_the_logit() {
        assert_eq!(probability_to_logit(0.0), f32::NEG_INFINITY);
        assert_eq!(probability_to_logit(1.0), f32::INFINITY);
        assert!(probability_to_logit(1.5).is_nan() && probability_to_logit(-0.5).is_nan());
        for p in [1e-30f32, 1e-6, 0.1, 0.5, 0.75, 0.999] {
            let back = sigmoid(probability_to_logit(p));
            // The logit is rounded to f32, so its relative error, times the logit, is what shows.
            assert!((back - p).abs() <= p * 1e-5, "{p} came back as {back}");
        }
    }

    #[test]
    fn leaving_rows_out_in_place_is_selecting_the_others() {
        let n = 5;
        let codebook = LanguageCodebook { mean: vec![1.0], axes: vec![1.0, 2.0] };
        let half = |count: usize| (0..count).map(|i| f16::from_f32(i as f32)).collect::<Vec<_>>();
        let scene = GaussianScene {
            origin: [1e6, 0.0, -7.0],
            coord: (0..n).map(|i| [i as f32; 3]).collect(),
            log_scale: (0..n).map(|i| [i as f32 + 10.0; 3]).collect(),
            quat: (0..n).map(|i| [i as f32, 1.0, 2.0, 3.0]).collect(),
            opacity_logit: (0..n).map(|i| i as f32).collect(),
            sh_dc: (0..n).map(|i| [i as f32, 0.5, 0.25]).collect(),
            sh_rest: (0..n * 9).map(|i| i as f32).collect(),
            sh_degree: 1,
            normal: Some((0..n).map(|i| [i as f32; 3]).collect()),
            segment: Some((0..n as i32).collect()),
            segment_score: Some((0..n).map(|i| i as f32).collect()),
            instance: Some((5..5 + n as i32).collect()),
            lang_code: Some(LanguageCode { values: half(n * 2), codebook }),
            lang_feat: Some(LanguageFeatures { values: half(n * 3), dim: 3 }),
            valid_feat_mask: Some((0..n).map(|i| i % 2 == 0).collect()),
            labelled_points: None,
            extra: vec![ExtraColumn {
                name: "age".to_owned(),
                ty: NumberType::UInt(2),
                row_shape: vec![2],
                bytes: (0..n as u8 * 4).collect(),
            }],
            antialiased: true,
        };
        scene.check_rows().unwrap();
        for flags in 1u32..1 << n {
            let keep: Vec<bool> = (0..n).map(|i| flags >> i & 1 == 1).collect();
            let rows: Vec<usize> = (0..n).filter(|&i| keep[i]).collect();
            let mut left = scene.clone();
            left.retain_rows(&keep);
            assert_eq!(left, scene.select_rows(&rows).unwrap());
        }
    }

    #[test]
    fn ragged_features_are_refused() {
        let scene = GaussianScene {
            coord: vec![[0.0; 3]; 2],
            log_scale: vec![[0.0; 3]; 2],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            opacity_logit: vec![0.0; 2],
            sh_dc: vec![[0.0; 3]; 2],
            lang_feat: Some(LanguageFeatures { values: vec![f16::ZERO; 5], dim: 2 }),
            ..GaussianScene::default()
        };
        assert!(matches!(scene.check_rows(), Err(SceneError::RowCount { field: "lang_feat", .. })));
    }
}
