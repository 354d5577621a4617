//! One feature per segment from three crops: the whole frame, the segment with its surroundings,
//! and the segment alone.

use super::LiftError;

/// How the weight of the whole frame follows from how much a segment resembles it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FrameWeight {
    /// Softmax over the segments of the frame: the weights of a frame sum to 1, so with `n`
    /// segments each is about `1/n`. A single segment would get weight 1, and nothing of itself would
    /// be left; it gets the [`Logistic`](Self::Logistic) weight instead, and the result says so.
    #[default]
    Softmax,
    /// `1 / (1 + e^−φ)` of each segment by itself.
    Logistic,
}

/// Fused features and what they were made of.
#[derive(Debug, Clone, PartialEq)]
pub struct FusedFeatures {
    /// Unit features. `[S, D]`; a row is 0 where the crops cancel out exactly.
    pub features: Vec<f32>,
    /// `r`: cosine of the crops with and without surroundings, −1..=1. `[S]`
    pub crop_agreement: Vec<f32>,
    /// `φ`: cosine of the segment with the frame, −1..=1. `[S]`
    pub frame_similarity: Vec<f32>,
    /// `w`: share of the whole frame, 0..=1. `[S]`
    pub frame_weight: Vec<f32>,
    /// Whether a single segment was given the logistic weight in place of the softmax.
    pub single_segment: bool,
}

/// Fuses the features of three crops of each segment with weights that follow from them.
///
/// With `r = cos(crop, masked)` and the local feature `l = norm(r · masked + (1 − r) · crop)`, the
/// frame's weight `w` is a [`FrameWeight`] of `φ = cos(l, frame)`, and the result is
/// `norm(w · frame + (1 − w)(1 − r) · crop + (1 − w) r · masked)`. Rows need no unit norm: they are
/// divided by it. A negative `r` is used as it is; sums are f64.
///
/// # Shapes
/// - `frame`: `[D]`, the picture as a whole · `crops`: `[S, D]`, bounding boxes · `masked`: `[S, D]`,
///   bounding boxes with everything else painted over
///
/// # Errors
/// If shapes do not fit, or a value is not finite, or a row is 0.
///
/// # Source
/// Algorithm 1 and "Dynamic Weighting" of the SceneSplat paper. It writes a softmax without
/// saying over what; as in HOV-SG, which it adapts, it is over the frame's segments here.
pub fn fuse_crops(
    frame: &[f32],
    crops: &[f32],
    masked: &[f32],
    weight: FrameWeight,
) -> Result<FusedFeatures, LiftError> {
    let dim = frame.len();
    if dim == 0 || !crops.len().is_multiple_of(dim) || crops.len() != masked.len() {
        let (c, m) = (crops.len(), masked.len());
        let problem = format!("expected [S, {dim}] twice, got {c} and {m} values");
        return Err(LiftError::argument("crops and masked", problem));
    }
    let count = crops.len() / dim;
    let frame = unit(frame).ok_or_else(|| bad_row("frame", 0))?;
    let mut local = Vec::with_capacity(count);
    let mut out = FusedFeatures {
        features: Vec::with_capacity(crops.len()),
        crop_agreement: Vec::with_capacity(count),
        frame_similarity: Vec::with_capacity(count),
        frame_weight: Vec::new(),
        single_segment: count == 1 && weight == FrameWeight::Softmax,
    };
    for (row, (crop, masked)) in crops.chunks_exact(dim).zip(masked.chunks_exact(dim)).enumerate() {
        let crop = unit(crop).ok_or_else(|| bad_row("crops", row))?;
        let masked = unit(masked).ok_or_else(|| bad_row("masked", row))?;
        let r = dot(&crop, &masked);
        let mixed: Vec<f64> = sum(&[(r, &masked), (1.0 - r, &crop)]);
        // Opposite crops can cancel out; then the segment resembles nothing.
        let phi = unit64(&mixed).map_or(0.0, |l| dot(&l, &frame));
        out.crop_agreement.push(r as f32);
        out.frame_similarity.push(phi as f32);
        local.push((r, phi, crop, masked));
    }
    let phi: Vec<f64> = local.iter().map(|(_, phi, ..)| *phi).collect();
    let weights = match weight {
        FrameWeight::Softmax if count > 1 => softmax(&phi),
        _ => phi.iter().map(|phi| 1.0 / (1.0 + (-phi).exp())).collect(),
    };
    for ((r, _, crop, masked), w) in local.iter().zip(&weights) {
        let mixed = sum(&[(*w, &frame), ((1.0 - w) * (1.0 - r), crop), ((1.0 - w) * r, masked)]);
        match unit64(&mixed) {
            Some(fused) => out.features.extend(fused.iter().map(|&v| v as f32)),
            None => out.features.resize(out.features.len() + dim, 0.0),
        }
    }
    out.frame_weight = weights.iter().map(|&w| w as f32).collect();
    Ok(out)
}

fn bad_row(field: &'static str, row: usize) -> LiftError {
    LiftError::argument(field, format!("row {row} is 0 or holds a value that is not finite"))
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The vector at length 1; `None` if it has no direction.
fn unit64(v: &[f64]) -> Option<Vec<f64>> {
    let norm = dot(v, v).sqrt();
    (norm > 0.0 && norm.is_finite()).then(|| v.iter().map(|x| x / norm).collect())
}

fn unit(v: &[f32]) -> Option<Vec<f64>> {
    unit64(&v.iter().map(|&x| f64::from(x)).collect::<Vec<_>>())
}

fn sum(parts: &[(f64, &[f64])]) -> Vec<f64> {
    let dim = parts.first().map_or(0, |(_, v)| v.len());
    (0..dim).map(|i| parts.iter().map(|(w, v)| w * v[i]).sum()).collect()
}

fn softmax(x: &[f64]) -> Vec<f64> {
    let largest = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let e: Vec<f64> = x.iter().map(|x| (x - largest).exp()).collect();
    let total: f64 = e.iter().sum();
    e.iter().map(|e| e / total).collect()
}
