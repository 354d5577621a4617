//! Losses and errors of rendered depth: against a depth image, against sparse points.

use super::ImageError;
use super::view::{check_finite, check_size};

/// Which pixels of a measured depth image count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthRange {
    /// Measured depths up to this are no measurement, meters; sensors write 0 for "nothing".
    pub min: f32,
    /// Measured depths above this are not trusted, meters.
    pub max: f32,
}

impl Default for DepthRange {
    /// 0.1 m to 10 m: what indoor depth sensors resolve.
    fn default() -> Self {
        Self { min: 0.1, max: 10.0 }
    }
}

impl DepthRange {
    /// Whether a measured depth counts; NaN and infinities do not.
    pub fn contains(&self, depth: f32) -> bool {
        depth > self.min && depth <= self.max && depth.is_finite()
    }
}

/// Mean error of a depth image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthError {
    /// Mean of `|pred − truth|` over the pixels that count, meters.
    pub mean: f64,
    /// Number of pixels that count.
    pub count: usize,
}

/// Mean of `|pred − truth|` over the pixels whose truth is in `range` and whose `mask` is true;
/// `None` if there is no such pixel.
///
/// Both `[H·W]`, meters along the viewing axis (not along the ray: convert data sets that store
/// ray lengths). A prediction of 0, where nothing was hit, counts as any other.
///
/// # Errors
/// If lengths differ, or a prediction that counts is not finite.
pub fn depth_l1(
    pred: &[f32],
    truth: &[f32],
    mask: Option<&[bool]>,
    range: DepthRange,
) -> Result<Option<DepthError>, ImageError> {
    let (mut sum, mut count) = (0.0, 0);
    for_each_valid(pred, truth, mask, range, |_, p, t| {
        sum += (f64::from(p) - f64::from(t)).abs();
        count += 1;
    })?;
    Ok((count > 0).then(|| DepthError { mean: sum / count as f64, count }))
}

/// [`depth_l1`] and its derivative with respect to every predicted depth, `[H·W]`: `±1 / count`
/// where a pixel counts and the depths differ, else 0.
///
/// # Errors
/// As [`depth_l1`].
pub fn depth_l1_with_gradient(
    pred: &[f32],
    truth: &[f32],
    mask: Option<&[bool]>,
    range: DepthRange,
) -> Result<Option<(DepthError, Vec<f32>)>, ImageError> {
    let Some(error) = depth_l1(pred, truth, mask, range)? else { return Ok(None) };
    let step = (1.0 / error.count as f64) as f32;
    let mut gradient = vec![0.0; pred.len()];
    for_each_valid(pred, truth, mask, range, |i, p, t| {
        if p != t {
            gradient[i] = if p > t { step } else { -step };
        }
    })?;
    Ok(Some((error, gradient)))
}

fn for_each_valid(
    pred: &[f32],
    truth: &[f32],
    mask: Option<&[bool]>,
    range: DepthRange,
    mut each: impl FnMut(usize, f32, f32),
) -> Result<(), ImageError> {
    let expected = pred.len();
    let lengths = [("measured depth", truth.len()), ("mask", mask.map_or(expected, <[bool]>::len))];
    for (what, got) in lengths {
        if got != expected {
            return Err(ImageError::RowCount { what, expected, got });
        }
    }
    for (i, (&p, &t)) in pred.iter().zip(truth).enumerate() {
        if range.contains(t) && mask.is_none_or(|m| m[i]) {
            if !p.is_finite() {
                let (what, expected) = ("rendered depth", "a finite depth where one is measured");
                return Err(ImageError::Row { what, row: i, value: p.into(), expected });
            }
            each(i, p, t);
        }
    }
    Ok(())
}

/// Where the samples of a depth image lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SamplePosition {
    /// The center of the first pixel is at (0.5, 0.5), as cameras have it.
    #[default]
    PixelCentres,
    /// The center of the first pixel is taken to be at (0, 0): half a pixel off, as gsplat's
    /// trainer samples. For numbers that are to be compared with it.
    Gsplat,
}

/// Loss of a rendered depth image against sparse points, in disparity.
///
/// `scene_scale · mean |1/D(p) − 1/z|` over the points, `1/0` taken as 0; `D(p)` is bilinear, with
/// zeros outside the picture.
///
/// - `depth`: `[H·W]`, `width` pixels per row, 0 where nothing was hit
/// - `points`: pixel coordinates, `[M, 2]` · `truth`: their depths, `[M]`, ≥ 0, 0 = unknown
/// - returns: the loss (0 without points) and its derivative with respect to `depth`, `[H·W]`
///
/// # Errors
/// If lengths do not fit, or a number is negative, NaN or infinite.
///
/// # Source
/// `simple_trainer.py` of gsplat 1.6. Differs: [`SamplePosition::PixelCentres`] by default.
pub fn sparse_disparity_l1(
    depth: &[f32],
    width: usize,
    points: &[[f32; 2]],
    truth: &[f32],
    scene_scale: f64,
    position: SamplePosition,
) -> Result<(f64, Vec<f32>), ImageError> {
    let height = depth.len().checked_div(width).unwrap_or(0);
    check_size("depth", [width, height, 1], depth.len())?;
    if truth.len() != points.len() {
        let (what, expected) = ("depths of points", points.len());
        return Err(ImageError::RowCount { what, expected, got: truth.len() });
    }
    check_finite("depth", depth, width, 1)?;
    check_points(points, truth)?;
    if !(scene_scale.is_finite() && scene_scale >= 0.0) {
        let (field, expected) = ("scene_scale", "a finite number, 0 or more");
        return Err(ImageError::Setting { field, value: scene_scale, expected });
    }
    let shift = if position == SamplePosition::Gsplat { 0.0 } else { 0.5 };
    let weight = scene_scale / points.len().max(1) as f64;
    let mut gradient = vec![0f64; depth.len()];
    let mut loss = 0.0;
    for (point, &z) in points.iter().zip(truth) {
        let corners = bilinear(point.map(|v| f64::from(v) - shift), width, height);
        let sampled: f64 =
            corners.iter().flatten().map(|&(at, share)| share * f64::from(depth[at])).sum();
        let inverse = |d: f64| if d > 0.0 { 1.0 / d } else { 0.0 };
        let difference = inverse(sampled) - inverse(f64::from(z));
        loss += weight * difference.abs();
        if sampled > 0.0 && difference != 0.0 {
            let slope = -weight * difference.signum() / (sampled * sampled);
            for &(at, share) in corners.iter().flatten() {
                gradient[at] += share * slope;
            }
        }
    }
    Ok((loss, gradient.into_iter().map(|v| v as f32).collect()))
}

fn check_points(points: &[[f32; 2]], truth: &[f32]) -> Result<(), ImageError> {
    if let Some(row) = points.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
        let value = if points[row][0].is_finite() { points[row][1] } else { points[row][0] };
        let (what, expected) = ("points", "finite pixel coordinates");
        return Err(ImageError::Row { what, row, value: value.into(), expected });
    }
    if let Some(row) = truth.iter().position(|z| !(z.is_finite() && *z >= 0.0)) {
        let (what, expected) = ("depths of points", "a finite depth, 0 or more");
        return Err(ImageError::Row { what, row, value: truth[row].into(), expected });
    }
    Ok(())
}

/// The up to four pixels around a position and their shares; those outside are left out.
fn bilinear([x, y]: [f64; 2], width: usize, height: usize) -> [Option<(usize, f64)>; 4] {
    let (left, top) = (x.floor(), y.floor());
    let (fx, fy) = (x - left, y - top);
    let corner = |dx: f64, dy: f64, share: f64| {
        let (cx, cy) = (left + dx, top + dy);
        let inside = cx >= 0.0 && cy >= 0.0 && cx < width as f64 && cy < height as f64;
        (inside && share > 0.0).then(|| (cy as usize * width + cx as usize, share))
    };
    [
        corner(0.0, 0.0, (1.0 - fx) * (1.0 - fy)),
        corner(1.0, 0.0, fx * (1.0 - fy)),
        corner(0.0, 1.0, (1.0 - fx) * fy),
        corner(1.0, 1.0, fx * fy),
    ]
}
