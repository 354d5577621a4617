//! Effects on where Gaussians are and how large: holes, floaters, rough surfaces, motion blur.

use super::strength::{BLUR_METRES, FLOATERS_SHARE, HOLES_SHARE, SURFACE_DEGREES, SURFACE_METRES};
use super::{Effect, Simulated, rng};
use crate::rng::{below, between, normals};
use crate::transforms::quaternion;
use rayon::prelude::*;
use scenesplat_kernels::random::direction;
use scenesplat_kernels::symmetric_eigen::symmetric_eigen;
use scenesplat_scene::gaussian_scene::{SH_C0, probability_to_logit};
use scenesplat_scene::vector::dot;
use scenesplat_scene::{GaussianScene, SceneError};
use std::collections::HashMap;

/// Sizes of floaters, in median sizes of the scene; their opacities; where they are between the middle
/// of the scene and a Gaussian.
const FLOATER_SIZE: [f64; 2] = [2.0, 10.0];
const FLOATER_OPACITY: [f64; 2] = [0.05, 0.4];
const FLOATER_DEPTH: [f64; 2] = [0.1, 0.6];
/// Edge of the cells in which the camera moves in one direction, meters.
const BLUR_CELL: f64 = 1.0;

fn is_finite(v: [f32; 3]) -> bool {
    v.iter().all(|x| x.is_finite())
}

fn count_of(rows: usize, share: f64) -> usize {
    (rows as f64 * share).round() as usize
}

/// A row number, any of `0..rows`; scenes have fewer than 2³² rows.
fn any_row(rng: &mut crate::SampleRng, rows: usize) -> usize {
    below(rng, u32::try_from(rows).unwrap_or(u32::MAX)) as usize
}

/// Removes balls of Gaussians.
pub(super) fn holes(
    out: &mut Simulated,
    severity: f64,
    seed: u64,
) -> Result<(usize, String), SceneError> {
    let coord = &out.scene.coord;
    let all: usize = count_of(coord.len(), HOLES_SHARE * severity);
    let balls = severity.ceil() as usize;
    let mut alive: Vec<usize> = (0..coord.len()).filter(|&row| is_finite(coord[row])).collect();
    let missing_before = coord.len() - alive.len();
    let mut widest = 0f64;
    for ball in 0..balls {
        // The balls share out what does not divide evenly; one Gaussian always stays.
        let take =
            (all * (ball + 1) / balls - all * ball / balls).min(alive.len().saturating_sub(1));
        if take == 0 {
            continue;
        }
        let mut rng = rng(seed, Effect::Holes, ball as u64);
        let centre = coord[alive[any_row(&mut rng, alive.len())]].map(f64::from);
        let square = |row: usize| -> f64 {
            let d: [f64; 3] = std::array::from_fn(|i| f64::from(coord[row][i]) - centre[i]);
            dot(d, d)
        };
        let mut near: Vec<(f64, usize)> = alive.par_iter().map(|&row| (square(row), row)).collect();
        near.select_nth_unstable_by(take - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        widest = widest.max(near[take - 1].0.sqrt());
        alive = near[take..].iter().map(|&(_, row)| row).collect();
        alive.sort_unstable();
    }
    let removed = coord.len() - missing_before - alive.len();
    // What is nowhere is in no hole.
    let mut kept = alive;
    kept.extend((0..coord.len()).filter(|&row| !is_finite(coord[row])));
    kept.sort_unstable();
    out.scene = out.scene.select_rows(&kept)?;
    out.source = kept.iter().map(|&row| out.source[row]).collect();
    let text = format!("{removed} Gaussians removed in {balls} balls of up to {widest:.2} m");
    Ok((removed, text))
}

fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Takes a Gaussian's labels away.
pub(super) fn without_label(scene: &mut GaussianScene, row: usize) {
    if let Some(segment) = &mut scene.segment {
        segment[row] = -1;
    }
    if let Some(score) = &mut scene.segment_score {
        score[row] = 0.0;
    }
    if let Some(instance) = &mut scene.instance {
        instance[row] = -1;
    }
    if let Some(valid) = &mut scene.valid_feat_mask {
        valid[row] = false;
    }
}

/// Says which features are none, where rows from `first` on were added: without a mask, what was never
/// seen would count as having one.
pub(super) fn mask_added(scene: &mut GaussianScene, first: usize) {
    if let (Some(_), None) = (&scene.lang_feat, &scene.valid_feat_mask) {
        scene.valid_feat_mask = Some((0..scene.len()).map(|row| row < first).collect());
    }
}

/// Adds Gaussians between the middle of the scene and its surfaces.
pub(super) fn floaters(
    out: &mut Simulated,
    severity: f64,
    seed: u64,
) -> Result<(usize, String), SceneError> {
    let rows = out.scene.len();
    let there: Vec<usize> = (0..rows).filter(|&row| is_finite(out.scene.coord[row])).collect();
    let count = if there.is_empty() { 0 } else { count_of(rows, FLOATERS_SHARE * severity).max(1) };
    let middle: [f64; 3] = std::array::from_fn(|i| {
        median(there.iter().map(|&row| f64::from(out.scene.coord[row][i])).collect())
    });
    let sizes = there
        .iter()
        .map(|&row| out.scene.log_scale[row].iter().map(|&s| f64::from(s)).sum::<f64>() / 3.0);
    let size = median(sizes.filter(|size| size.is_finite()).collect());
    let mut rngs: Vec<_> = (0..count).map(|i| rng(seed, Effect::Floaters, i as u64)).collect();
    let behind: Vec<usize> = rngs.iter_mut().map(|r| there[any_row(r, there.len())]).collect();
    let picked: Vec<usize> = (0..rows).chain(behind.iter().copied()).collect();
    let mut scene = out.scene.select_rows(&picked)?;
    let rest = scene.sh_rest_len() * 3;
    for (i, rng) in rngs.iter_mut().enumerate() {
        let row = rows + i;
        let depth = between(rng, FLOATER_DEPTH);
        let end = scene.coord[row].map(f64::from);
        scene.coord[row] =
            std::array::from_fn(|k| (middle[k] + depth * (end[k] - middle[k])) as f32);
        let log_size = (size + between(rng, FLOATER_SIZE).ln()) as f32;
        scene.log_scale[row] = [log_size; 3];
        scene.quat[row] = [1.0, 0.0, 0.0, 0.0];
        scene.opacity_logit[row] = probability_to_logit(between(rng, FLOATER_OPACITY) as f32);
        let dc = &mut scene.sh_dc[row];
        normals(rng, 3, |k, x| dc[k] += (0.1 * x) as f32 / SH_C0);
        scene.sh_rest[row * rest..(row + 1) * rest].fill(0.0);
        let any = direction(rng).map(|x| x as f32);
        if let Some(normal) = &mut scene.normal {
            normal[row] = any;
        }
        without_label(&mut scene, row);
    }
    mask_added(&mut scene, rows);
    out.scene = scene;
    out.source.extend(std::iter::repeat_n(None, count));
    Ok((count, format!("{count} Gaussians added in the air")))
}

/// The axis along which a Gaussian is thinnest, of length 1.
fn thin_axis(scene: &GaussianScene, row: usize) -> [f64; 3] {
    let scale = scene.log_scale[row];
    let thin = (1..3).fold(0, |best, i| if scale[i] < scale[best] { i } else { best });
    let matrix = quaternion::matrix(quaternion::unit(scene.quat[row].map(f64::from)));
    std::array::from_fn(|i| matrix[i][thin])
}

/// Moves Gaussians along their normals and tilts them.
pub(super) fn surface(out: &mut Simulated, severity: f64, seed: u64) -> (usize, String) {
    let (metres, degrees) = (SURFACE_METRES * severity, SURFACE_DEGREES * severity);
    let (scene, keys) = (&out.scene, out.keys());
    type Moved = ([f32; 3], [f32; 4], Option<[f32; 3]>);
    let moved: Vec<Moved> = (0..scene.len())
        .into_par_iter()
        .map(|row| {
            let mut rng = rng(seed, Effect::Surface, keys[row]);
            let mut draws = [0.0; 2];
            normals(&mut rng, 2, |i, x| draws[i] = x);
            let axis = direction(&mut rng);
            let normal = thin_axis(scene, row);
            let coord = std::array::from_fn(|i| {
                (f64::from(scene.coord[row][i]) + metres * draws[0] * normal[i]) as f32
            });
            let half = 0.5 * (degrees * draws[1]).to_radians();
            let turn =
                [half.cos(), half.sin() * axis[0], half.sin() * axis[1], half.sin() * axis[2]];
            let quat = quaternion::unit(scene.quat[row].map(f64::from));
            let quat = quaternion::with_positive_w(quaternion::product(turn, quat));
            let turned = scene.normal.as_ref().map(|normal| {
                let matrix = quaternion::matrix(turn);
                quaternion::times(matrix, normal[row].map(f64::from)).map(|x| x as f32)
            });
            (coord, quat.map(|x| x as f32), turned)
        })
        .collect();
    let scene = &mut out.scene;
    for (row, (coord, quat, normal)) in moved.into_iter().enumerate() {
        scene.coord[row] = coord;
        scene.quat[row] = quat;
        if let (Some(all), Some(normal)) = (&mut scene.normal, normal) {
            all[row] = normal;
        }
    }
    let text = format!(
        "all Gaussians moved along their normals by {:.1} cm and tilted by {degrees:.1}° (standard \
         deviations)",
        100.0 * metres
    );
    (scene.len(), text)
}

/// Draws Gaussians out along a motion and mixes their colors.
pub(super) fn blur(out: &mut Simulated, severity: f64, seed: u64) -> (usize, String) {
    let length = BLUR_METRES * severity;
    let scene = &mut out.scene;
    let cell = |coord: [f32; 3], edge: f64| coord.map(|x| (f64::from(x) / edge).floor() as i64);
    // An even motion spreads a point with this variance.
    let variance = length * length / 12.0;
    let drawn: Vec<([f32; 3], [f32; 4])> = (0..scene.len())
        .into_par_iter()
        .map(|row| {
            let [x, y, z] = cell(scene.coord[row], BLUR_CELL);
            let key = |v: i64| v as u64 & 0x1f_ffff;
            let index = key(x) | key(y) << 21 | key(z) << 42;
            let along = direction(&mut rng(seed, Effect::Blur, index));
            drawn_out(scene.log_scale[row], scene.quat[row], along, variance)
        })
        .collect();
    for (row, (log_scale, quat)) in drawn.into_iter().enumerate() {
        scene.log_scale[row] = log_scale;
        scene.quat[row] = quat;
    }
    // Colors mix with what lies within the motion, as far as a display shows them: one bad value must
    // not reach its neighbors.
    let most = 0.5 / f64::from(SH_C0);
    let mut sums: HashMap<[i64; 3], ([f64; 3], f64)> = HashMap::new();
    for (coord, dc) in scene.coord.iter().zip(&scene.sh_dc).filter(|(_, dc)| is_finite(**dc)) {
        let (sum, count) = sums.entry(cell(*coord, length)).or_default();
        sum.iter_mut().zip(dc).for_each(|(s, v)| *s += f64::from(*v).clamp(-most, most));
        *count += 1.0;
    }
    for (coord, dc) in scene.coord.iter().zip(&mut scene.sh_dc).filter(|(_, dc)| is_finite(**dc)) {
        let (sum, count) = sums[&cell(*coord, length)];
        *dc = std::array::from_fn(|i| (0.5 * (f64::from(dc[i]) + sum[i] / count)) as f32);
    }
    let text = format!("all Gaussians drawn out by a motion of {:.1} cm", 100.0 * length);
    (scene.len(), text)
}

/// A Gaussian with `variance` more along a direction; one whose sizes are not finite stays.
fn drawn_out(
    log_scale: [f32; 3],
    quat: [f32; 4],
    along: [f64; 3],
    variance: f64,
) -> ([f32; 3], [f32; 4]) {
    let squares = log_scale.map(|s| (2.0 * f64::from(s)).exp());
    let turn = quaternion::matrix(quaternion::unit(quat.map(f64::from)));
    let mut matrix = [0.0; 9];
    for i in 0..3 {
        for j in 0..3 {
            let own: f64 = (0..3).map(|k| turn[i][k] * squares[k] * turn[j][k]).sum();
            matrix[3 * i + j] = own + variance * along[i] * along[j];
        }
    }
    if !matrix.iter().all(|v| v.is_finite()) {
        return (log_scale, quat);
    }
    let found = symmetric_eigen(&matrix, 3, 3);
    // A product of rounding may be below 0 where a Gaussian has no thickness; it gets none.
    let log_scale = std::array::from_fn(|i| (0.5 * found.values[i].max(0.0).ln()) as f32);
    let v = &found.vectors;
    let mut axes: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|k| v[3 * k + i]));
    let cross = scenesplat_scene::vector::cross(
        [axes[0][0], axes[1][0], axes[2][0]],
        [axes[0][1], axes[1][1], axes[2][1]],
    );
    if dot(cross, [axes[0][2], axes[1][2], axes[2][2]]) < 0.0 {
        axes.iter_mut().for_each(|row| row[2] = -row[2]);
    }
    let quat = quaternion::with_positive_w(quaternion::of_matrix(axes));
    (log_scale, quat.map(|x| x as f32))
}
