//! The Gaussians as planes of bytes: values of one kind together deflate better.

use scenesplat_scene::GaussianScene;
use serde_json::{Value, json};

/// Steps of a position: 24 bits over the longest side.
const STEPS: f64 = 16_777_215.0;
/// Natural logarithms of the standard deviations that are told apart, units of the scene.
const LOG_SCALES: [f32; 2] = [-14.0, 6.0];

/// The blocks of the Gaussians.
pub(super) struct Packed {
    pub(super) parts: Vec<(&'static str, Vec<u8>)>,
    /// `origin`, `step` and `scaleRange`.
    pub(super) about: Value,
    /// Step of a position.
    pub(super) step: f64,
}

/// Rows that a page shows, rising: those with a place; of more than `most` those with the largest product of opacity
/// and surface.
pub(super) fn kept(scene: &GaussianScene, most: Option<usize>) -> Vec<usize> {
    let mut rows: Vec<usize> =
        (0..scene.len()).filter(|&r| scene.coord[r].iter().all(|v| v.is_finite())).collect();
    let Some(most) = most.filter(|&m| m < rows.len()) else { return rows };
    let weight = |&row: &usize| {
        let mut scale = scene.scale(row);
        scale.sort_by(f32::total_cmp);
        let weight = scene.opacity(row) * scale[1] * scale[2];
        if weight.is_finite() { weight } else { 0.0 }
    };
    rows.sort_by(|a, b| weight(b).total_cmp(&weight(a)).then(a.cmp(b)));
    rows.truncate(most);
    rows.sort_unstable();
    rows
}

/// Numbers as `bytes` planes, the lowest first.
pub(super) fn planes(values: impl Iterator<Item = u32> + Clone, bytes: u32) -> Vec<u8> {
    (0..bytes).flat_map(|b| values.clone().map(move |v| (v >> (8 * b)) as u8)).collect()
}

/// Positions, scales, rotations and colors of some rows.
pub(super) fn pack(scene: &GaussianScene, rows: &[usize]) -> Packed {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for &row in rows {
        for axis in 0..3 {
            let v = f64::from(scene.coord[row][axis]);
            low[axis] = low[axis].min(v);
            high[axis] = high[axis].max(v);
        }
    }
    let longest = (0..3).map(|a| high[a] - low[a]).fold(0.0, f64::max);
    let step = if longest > 0.0 { longest / STEPS } else { 1.0 };
    let mut position = Vec::with_capacity(rows.len() * 9);
    // Bytes of one weight of all axes together: the page reads one list of 3 N numbers.
    for byte in 0..3 {
        for axis in 0..3 {
            let place = |&r: &usize| ((f64::from(scene.coord[r][axis]) - low[axis]) / step).round();
            position.extend(rows.iter().map(|r| (place(r) as u32 >> (8 * byte)) as u8));
        }
    }
    // Only the range that occurs, so that 256 steps are fine.
    let logs = || rows.iter().flat_map(|&r| scene.log_scale[r]).filter(|v| v.is_finite());
    let clamp =
        |v: f32| if v.is_finite() { v.clamp(LOG_SCALES[0], LOG_SCALES[1]) } else { LOG_SCALES[0] };
    let least = logs().map(clamp).fold(LOG_SCALES[1], f32::min);
    let most = logs().map(clamp).fold(least, f32::max);
    let range = (most - least).max(1e-6);
    let scale_byte = |v: f32| ((clamp(v) - least).max(0.0) / range * 255.0).round() as u8;
    let scale = (0..3).flat_map(|a| rows.iter().map(move |&r| (r, a)));
    let scale = scale.map(|(r, a)| scale_byte(scene.log_scale[r][a])).collect();
    let rotation = (0..4).flat_map(|a| rows.iter().map(move |&r| (r, a)));
    let rotation = rotation.map(|(r, a)| (scene.quat[r][a] * 127.0).round() as i8 as u8).collect();
    let mut color: Vec<u8> = Vec::with_capacity(rows.len() * 4);
    for channel in 0..3 {
        color.extend(rows.iter().map(|&r| scene.color_u8(r)[channel]));
    }
    color.extend(rows.iter().map(|&r| (scene.opacity(r) * 255.0).round() as u8));
    Packed {
        parts: vec![
            ("position", position),
            ("scale", scale),
            ("rotation", rotation),
            ("color", color),
        ],
        about: json!({ "origin": low, "step": step, "scaleRange": [least, least + range] }),
        step,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene() -> GaussianScene {
        GaussianScene {
            coord: vec![[0.0, 1.0, 2.0], [10.0, 1.0, 2.5], [f32::NAN; 3]],
            log_scale: vec![[-3.0, -4.0, -5.0], [-1.0, f32::NEG_INFINITY, -2.0], [0.0; 3]],
            quat: vec![[1.0, 0.0, 0.0, 0.0], [0.5, -0.5, 0.5, -0.5], [1.0, 0.0, 0.0, 0.0]],
            opacity_logit: vec![f32::INFINITY, 0.0, 0.0],
            sh_dc: vec![[0.0; 3]; 3],
            ..Default::default()
        }
    }

    #[test]
    fn values_come_back_within_a_step() {
        let scene = scene();
        let rows = kept(&scene, None);
        assert_eq!(rows, [0, 1], "rows without a place are not shown");
        let packed = pack(&scene, &rows);
        let position = &packed.parts[0].1;
        let at = |axis: usize, row: usize| {
            let n = rows.len();
            let value: u32 =
                (0..3).map(|b| u32::from(position[b * 3 * n + axis * n + row]) << (8 * b)).sum();
            packed.about["origin"][axis].as_f64().unwrap() + f64::from(value) * packed.step
        };
        for (row, axis) in [(0, 0), (1, 0), (0, 1), (1, 2)] {
            let want = f64::from(scene.coord[row][axis]);
            assert!((at(axis, row) - want).abs() <= packed.step, "{row} {axis}");
        }
        assert_eq!(packed.parts[1].1[3], 0, "no extent is the least there is");
        assert_eq!(packed.parts[2].1, [127, 64, 0, 192, 0, 64, 0, 192]);
        assert_eq!(packed.parts[3].1[6..], [255, 128]);
    }

    #[test]
    fn of_too_many_those_seen_most_stay() {
        let mut scene = scene();
        scene.coord[2] = [0.0; 3];
        assert_eq!(kept(&scene, Some(1)), [2], "the largest");
        assert_eq!(kept(&scene, Some(3)).len(), 3);
    }

    #[test]
    fn planes_have_the_lowest_bytes_first() {
        assert_eq!(planes([0x0102, 0x0304].into_iter(), 2), [2, 4, 1, 3]);
    }
}
