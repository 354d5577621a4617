//! SimDINO: views of a scene agree, scenes differ; the same of single rows.

use super::coding_rate::half_log_det;
use super::stored::{Views, check_teacher, stored_loss};
use crate::error::{LossError, check_positive, check_setting};
use candle_core::{Result, Tensor};
use scenesplat_kernels::settings;
use serde::{Deserialize, Serialize};

const NAME: &str = "sim_dino";
/// Norms below this count as this where rows are normalized here, as in the original.
const EPS: f64 = 1e-4;

/// Whose vectors are kept apart.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Expansion {
    /// The mean of student and teacher, the original's `expa_type = 1`.
    #[default]
    StudentAndTeacher,
    /// The student's, `expa_type = 0`.
    Student,
    /// Nobody's: no coding rate keeps scenes apart. For ablations.
    None,
}

settings! {
    /// Settings of [`sim_dino`]; defaults are the original's.
    #[derive(Copy)]
    pub struct SimDino {
        /// Weight of the compression; 0.1.
        pub coefficient: f64 = 0.1,
        /// Distortion ε of the coding rate, above 0; 0.05.
        pub epsilon: f64 = 0.05,
        /// Whose vectors are kept apart.
        pub expansion: Expansion = Expansion::StudentAndTeacher,
        /// Whether vectors come with unit length; false brings them to it here.
        pub normalized: bool = true,
    }
}

/// Result of [`sim_dino`] and [`sim_dino_rows`].
#[derive(Debug, Clone)]
pub struct SimDinoOutput {
    /// `−coefficient · compression − expansion`, a scalar with the gradient to the student.
    pub loss: Tensor,
    /// Mean cosine between a teacher's view and another view of the student, or between partners.
    pub compression: f64,
    /// Coding rate, ≥ 0. Near 0 all scenes (or rows) look alike: collapse.
    pub expansion: f64,
    /// The cosines of [`compression`](Self::compression) between views that the teacher has, added up
    /// and divided by the number of those; of rows the compression itself.
    pub global_compression: f64,
}

/// Compression between views and coding rate over scenes; `None` for no scenes.
///
/// With `T` views of the teacher, of which view `t` shows what the student's view `t` shows, and `B`
/// scenes: compression is the mean over `s ≠ t` and scenes of `⟨teacherₜ, studentₛ⟩`, divided by
/// `T·S − T`. Expansion is the mean over `t` of `γ · ½ log det(I + D/(B ε) Zₜᵀ Zₜ)`, where `Zₜ` is
/// chosen by [`Expansion`] and `γ = (D + B)/(D B)`. Sums, factorisation and logarithms are f64.
///
/// # Shapes
/// `student`: `[S, B, D]`, the teacher's views first · `teacher`: `[T, B, D]`, `1 ≤ T ≤ S`
///
/// # Errors
/// If shapes do not fit, a value is not finite, a setting is out of range, or rows are so far from unit
/// length that the determinant has no digits left (there the original gives NaN).
///
/// # Source
/// `MCRLoss` of SceneSplat be9d5e1, after SimDINO (arXiv:2502.10385), in one process. Differs: there the
/// factorisation's flag is ignored, and one of f32 fails for rows of 10⁴; with one view there the
/// division is by 0, here compression is 0.
pub fn sim_dino(
    student: &Tensor,
    teacher: &Tensor,
    settings: &SimDino,
) -> Result<Option<SimDinoOutput>> {
    attract_and_spread(NAME, (student, teacher, 3), settings, compress_views)
}

/// [`sim_dino`] of single rows: partners agree, rows differ; `None` for no rows.
///
/// Compression is the mean of `⟨teacherₙ, studentₙ⟩`, expansion `γ · ½ log det(I + D/(N ε) Zᵀ Z)` with
/// `Z` by [`Expansion`] and `γ = (D + N)/(D N)`. Where all rows of all scenes share one determinant,
/// what tells places of a scene apart counts as much as what tells scenes apart.
///
/// # Shapes
/// `student`, `teacher`: `[N, D]`, partners at the same row; the teacher gets no gradient
///
/// # Errors
/// As [`sim_dino`].
///
/// # Source
/// The total coding rate over patches as in EMP-SSL (arXiv:2304.03977), with SimDINO's factors.
pub fn sim_dino_rows(
    student: &Tensor,
    teacher: &Tensor,
    settings: &SimDino,
) -> Result<Option<SimDinoOutput>> {
    attract_and_spread("sim_dino_rows", (student, teacher, 2), settings, compress_rows)
}

fn attract_and_spread(
    loss: &'static str,
    (student, teacher, rank): (&Tensor, &Tensor, usize),
    settings: &SimDino,
    compress: fn(&Views, &Views, f64, &mut [f64]) -> (f64, f64),
) -> Result<Option<SimDinoOutput>> {
    check_positive(loss, "epsilon", settings.epsilon)?;
    let coefficient = settings.coefficient;
    check_setting(loss, "coefficient", coefficient, coefficient.is_finite(), "a finite number")?;
    let mut s = Views::read(loss, "student", student, rank)?;
    let mut t = Views::read(loss, "teacher", teacher, rank)?;
    check_teacher(loss, &s, &t)?;
    if s.scenes == 0 || s.width == 0 {
        return Ok(None);
    }
    let norms = if settings.normalized { None } else { Some(normalize(&mut s)) };
    if norms.is_some() {
        normalize(&mut t);
    }
    let mut gradient = vec![0.0; s.values.len()];
    let (compression, global_compression) = compress(&s, &t, -coefficient, &mut gradient);
    let expansion = expand(loss, &s, &t, settings, &mut gradient)?;
    if let Some(norms) = norms {
        back_through_norms(&s, &norms, &mut gradient);
    }
    let value = -coefficient * compression - expansion;
    let loss = stored_loss(loss, student, value, gradient)?;
    Ok(Some(SimDinoOutput { loss, compression, expansion, global_compression }))
}

/// Brings rows to unit length; gives what they were divided by.
fn normalize(views: &mut Views) -> Vec<f64> {
    let rows = views.values.chunks_exact_mut(views.width);
    rows.map(|row| {
        // Scaled first: squares of f32 fit f64, those of f64 may not.
        let largest = row.iter().fold(0.0, |m: f64, v| m.max(v.abs())).max(f64::MIN_POSITIVE);
        let norm = largest * row.iter().map(|v| (v / largest).powi(2)).sum::<f64>().sqrt();
        let norm = norm.max(EPS);
        row.iter_mut().for_each(|v| *v /= norm);
        norm
    })
    .collect()
}

/// The gradient to rows from that to the rows of unit length which they became.
fn back_through_norms(unit: &Views, norms: &[f64], gradient: &mut [f64]) {
    let rows = unit.values.chunks_exact(unit.width).zip(gradient.chunks_exact_mut(unit.width));
    for ((u, g), norm) in rows.zip(norms) {
        // Below EPS the divisor is a constant.
        let along: f64 =
            if *norm > EPS { u.iter().zip(&*g).map(|(u, g)| u * g).sum() } else { 0.0 };
        for (g, u) in g.iter_mut().zip(u) {
            *g = (*g - along * u) / norm;
        }
    }
}

/// The mean cosine of partners, twice; sets `weight` times its gradient.
fn compress_rows(s: &Views, t: &Views, weight: f64, gradient: &mut [f64]) -> (f64, f64) {
    let share = 1.0 / s.scenes as f64;
    let weight = weight * share;
    gradient.iter_mut().zip(&t.values).for_each(|(g, v)| *g = weight * v);
    let mean = share * s.values.iter().zip(&t.values).map(|(a, b)| a * b).sum::<f64>();
    (mean, mean)
}

/// Both means of cosines; adds `weight` times the gradient of the first.
fn compress_views(s: &Views, t: &Views, weight: f64, gradient: &mut [f64]) -> (f64, f64) {
    let pairs = (t.views * s.views - t.views) as f64;
    if pairs == 0.0 {
        return (0.0, 0.0);
    }
    let scenes = s.scenes as f64;
    let (mut total, mut global) = (0.0, 0.0);
    for teacher in 0..t.views {
        for student in (0..s.views).filter(|v| *v != teacher) {
            let mut sum = 0.0;
            for scene in 0..s.scenes {
                let (from, to) = (t.row(teacher, scene), s.row(student, scene));
                sum += from.iter().zip(to).map(|(a, b)| a * b).sum::<f64>();
                let at = (student * s.scenes + scene) * s.width;
                for (g, v) in gradient[at..at + s.width].iter_mut().zip(from) {
                    *g += weight / (scenes * pairs) * v;
                }
            }
            total += sum / scenes;
            global += if student < t.views { sum / scenes } else { 0.0 };
        }
    }
    // Divided by the number of views, as the original logs it; two views have two pairs.
    (total / pairs, global / t.views as f64)
}

/// The coding rate; adds the gradient of its negative.
fn expand(
    loss: &'static str,
    s: &Views,
    t: &Views,
    settings: &SimDino,
    gradient: &mut [f64],
) -> Result<f64> {
    let (b, d) = (s.scenes as f64, s.width as f64);
    let (gamma, scale) = ((d + b) / (d * b), d / (b * settings.epsilon));
    let (share, teacher) = match settings.expansion {
        Expansion::StudentAndTeacher => (0.5, true),
        Expansion::Student => (1.0, false),
        Expansion::None => return Ok(0.0),
    };
    let size = s.scenes * s.width;
    let mut total = 0.0;
    for view in 0..t.views {
        let mut rows = s.view(view).to_vec();
        if teacher {
            rows.iter_mut().zip(t.view(view)).for_each(|(r, t)| *r = 0.5 * (*r + t));
        }
        let Some((value, slope)) = half_log_det(&rows, s.scenes, s.width, scale) else {
            let setting = "normalized";
            let value = format!("{} for rows that are far too long", settings.normalized);
            let expected = "vectors of unit length, or `normalized = false`";
            return Err(LossError::Setting { loss, setting, value, expected }.into());
        };
        total += value;
        let factor = gamma / t.views as f64 * share;
        let to = &mut gradient[view * size..][..size];
        to.iter_mut().zip(&slope).for_each(|(g, slope)| *g -= factor * slope);
    }
    Ok(gamma * total / t.views as f64)
}
