//! Glass in a scene: a sheet that hardly hides anything, and behind it what it reflected.

use super::geometry::{mask_added, without_label};
use super::light::change;
use super::pane::{Pane, largest_wall};
use super::pictures::schlick;
use super::{Effect, Simulated, rng};
use crate::rng::{between, happens};
use crate::transforms::quaternion;
use scenesplat_scene::gaussian_scene::probability_to_logit;
use scenesplat_scene::{GaussianScene, SceneError, StatedUp, Up, guess_up};

/// Cosine of the angle at which reflections were seen: 60°, 7 % of the light.
const GHOST_COSINE: f64 = 0.5;
/// Opacity of what was reflected, of that of the thing itself: no two pictures agree on it.
const GHOST_OPACITY: f64 = 0.5;
/// How far before a pane things are whose reflections are reconstructed behind it, meters.
const GHOST_METRES: f64 = 1.5;
/// Opacities of a sheet's Gaussians around its own, as shares of it.
const SHEET_SPREAD: [f64; 2] = [0.6, 1.4];

/// Makes a pane of a part of the largest upright plane: few of its Gaussians stay, so faint that the pane
/// takes in what it should, and behind it come mirror images of what stands before it, dim as
/// reflections are. Neither has labels.
pub(super) fn glass(
    out: &mut Simulated,
    severity: f64,
    seed: u64,
    up: Option<Up>,
) -> Result<(usize, String), SceneError> {
    let up = up.unwrap_or_else(|| guess_up(&out.scene, StatedUp::UPRIGHT).direction);
    let Some(wall) = largest_wall(&out.scene.coord, up) else {
        return Ok((0, "no upright plane that could hold a pane".to_owned()));
    };
    on_pane(out, &Pane::on(&wall, severity, seed), seed)
}

/// As [`glass`], on a pane that is known.
pub(super) fn on_pane(
    out: &mut Simulated,
    pane: &Pane,
    seed: u64,
) -> Result<(usize, String), SceneError> {
    let at = |row: usize| out.scene.coord[row].map(f64::from);
    // The pane stands before the wall's Gaussians, by their thickness.
    let in_sheet = |row: usize| {
        (-2.0 * pane.thickness..=0.0).contains(&pane.before(at(row))) && pane.covers(at(row))
    };
    let rows = out.scene.len();
    let sheet: Vec<usize> = (0..rows).filter(|&row| in_sheet(row)).collect();
    let is_reflected = |row: usize| {
        let before = pane.before(at(row));
        before > 0.0 && before <= GHOST_METRES && pane.covers(at(row))
    };
    let ghosts: Vec<usize> = (0..rows).filter(|&row| is_reflected(row)).collect();
    let share = share_that_stays(&out.scene, &sheet, pane);
    let keys = out.keys();
    // Of the sheet's: their new opacity if they stay.
    let mut opacities = vec![None; rows];
    for &row in &sheet {
        let mut rng = rng(seed, Effect::Glass, 1 + keys[row]);
        let opacity = pane.alpha * between(&mut rng, SHEET_SPREAD);
        opacities[row] = Some(happens(&mut rng, share).then_some(opacity));
    }
    let kept: Vec<usize> = (0..rows).filter(|&row| opacities[row] != Some(None)).collect();
    let picked: Vec<usize> = kept.iter().chain(&ghosts).copied().collect();
    let mut scene = out.scene.select_rows(&picked)?;
    for (row, &from) in kept.iter().enumerate() {
        if let Some(Some(opacity)) = opacities[from] {
            scene.opacity_logit[row] = probability_to_logit(opacity as f32);
            tint(&mut scene, row, pane.tint);
            without_label(&mut scene, row);
        }
    }
    mask_added(&mut scene, kept.len());
    let rest = 3 * scene.sh_rest_len();
    for row in kept.len()..scene.len() {
        mirror(&mut scene, row, pane);
        scene.sh_rest[row * rest..(row + 1) * rest].fill(0.0);
        tint(&mut scene, row, [schlick(GHOST_COSINE); 3]);
        let opacity = GHOST_OPACITY * f64::from(scene.opacity(row));
        scene.opacity_logit[row] = probability_to_logit(opacity as f32);
        without_label(&mut scene, row);
    }
    let removed = rows - kept.len();
    let stayed = sheet.len() - removed;
    out.source = kept.iter().map(|&row| out.source[row]).collect();
    out.source.extend(std::iter::repeat_n(None, ghosts.len()));
    out.scene = scene;
    let ([w, h], alpha, added) = (pane.half.map(|half| 2.0 * half), pane.alpha, ghosts.len());
    let text = format!(
        "a pane of {w:.2} by {h:.2} m: {removed} Gaussians removed, {stayed} of opacity {alpha:.2}, \
         {added} reflections added behind it"
    );
    Ok((sheet.len() + added, text))
}

/// As [`glass`], on several panes, one after the other.
pub(super) fn on_panes(
    out: &mut Simulated,
    panes: &[Pane],
    seed: u64,
) -> Result<(usize, String), SceneError> {
    let (mut changed, mut texts) = (0, Vec::new());
    for pane in panes {
        let (more, text) = on_pane(out, pane, seed)?;
        changed += more;
        texts.push(text);
    }
    Ok((changed, texts.join("; ")))
}

/// The share of a sheet's Gaussians that lets through `1 − α` of the light on average, each with opacity
/// α: light passes `exp(−Σ α area / area of the pane)`, the area of a Gaussian being 2π σ₁ σ₂.
fn share_that_stays(scene: &GaussianScene, sheet: &[usize], pane: &Pane) -> f64 {
    let area = |&row: &usize| {
        let mut scale = scene.scale(row).map(f64::from);
        scale.sort_unstable_by(f64::total_cmp);
        let area = std::f64::consts::TAU * scale[1] * scale[2];
        if area.is_finite() { area } else { 0.0 }
    };
    let covered: f64 = sheet.iter().map(area).sum();
    let pane_area = 4.0 * pane.half[0] * pane.half[1];
    let wanted = -(1.0 - pane.alpha).ln() / pane.alpha;
    if covered > 0.0 { (wanted * pane_area / covered).min(1.0) } else { 1.0 }
}

/// Multiplies the linear light of a Gaussian's color.
fn tint(scene: &mut GaussianScene, row: usize, by: [f64; 3]) {
    let rest = 3 * scene.sh_rest_len();
    let harmonics = &mut scene.sh_rest[row * rest..(row + 1) * rest];
    change(&mut scene.sh_dc[row], harmonics, |i, light| light * by[i]);
}

/// Puts a Gaussian where its mirror image is.
fn mirror(scene: &mut GaussianScene, row: usize, pane: &Pane) {
    scene.coord[row] = pane.mirrored(scene.coord[row].map(f64::from)).map(|v| v as f32);
    let turn = quaternion::matrix(quaternion::unit(scene.quat[row].map(f64::from)));
    let axis = |k: usize| pane.mirrored_direction([turn[0][k], turn[1][k], turn[2][k]]);
    // A Gaussian is the same to both sides of each axis: one turned round makes a rotation of it.
    let axes = [axis(0).map(|v| -v), axis(1), axis(2)];
    let matrix = [0, 1, 2].map(|i| [axes[0][i], axes[1][i], axes[2][i]]);
    let quat = quaternion::with_positive_w(quaternion::of_matrix(matrix));
    scene.quat[row] = quat.map(|x| x as f32);
    if let Some(normal) = &mut scene.normal {
        normal[row] = pane.mirrored_direction(normal[row].map(f64::from)).map(|v| v as f32);
    }
}

#[cfg(test)]
mod tests {
    use super::super::{EffectSet, simulate, simulate_upright, strength::GLASS_ALPHA};
    use super::*;
    use scenesplat_scene::LanguageFeatures;
    use scenesplat_scene::gaussian_scene::SH_C0;

    /// A wall at y = 0 of 3 × 2 m with a board before it, 1 m high, and a red needle 1 m before the wall's middle.
    fn scene() -> GaussianScene {
        let mut coord: Vec<[f32; 3]> =
            (0..6000).map(|i| [0.03 * (i % 100) as f32, 0.0, 0.0333 * (i / 100) as f32]).collect();
        coord.extend((0..1500).map(|i| [0.06 * (i % 50) as f32, 0.06 * (i / 50) as f32, 1.0]));
        coord.push([1.5, 1.0, 1.0]);
        let n = coord.len();
        let mut scene = GaussianScene {
            coord,
            log_scale: vec![[0.02f32.ln(), 0.001f32.ln(), 0.02f32.ln()]; n],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logit: vec![6.0; n],
            sh_dc: vec![[1.0; 3]; n],
            segment: Some(vec![4; n]),
            instance: Some(vec![2; n]),
            lang_feat: Some(LanguageFeatures { values: vec![half::f16::ONE; n], dim: 1 }),
            ..GaussianScene::default()
        };
        scene.log_scale[n - 1] = [0.2f32.ln(), 0.001f32.ln(), 0.001f32.ln()];
        // Along x + y.
        scene.quat[n - 1] = [0.382_683_43_f32.cos(), 0.0, 0.0, 0.382_683_43_f32.sin()];
        scene
    }

    fn glassy(severity: f64, seed: u64) -> Simulated {
        let set = EffectSet::default().with(Effect::Glass, severity).unwrap();
        let out = simulate_upright(&scene(), &set, seed, Some(Up::PLUS_Z)).unwrap();
        out.scene.check_rows().unwrap();
        out
    }

    #[test]
    fn a_sheet_and_reflections_without_labels() {
        let before = scene();
        let out = glassy(5.0, 3);
        let scene = &out.scene;
        let labels = scene.segment.as_ref().unwrap();
        let valid = scene.valid_feat_mask.as_ref().unwrap();
        let (mut sheet, mut ghosts) = (0, 0);
        for (row, source) in out.source.iter().enumerate() {
            match source {
                Some(from) if scene.opacity_logit[row] != before.opacity_logit[*from] => {
                    sheet += 1;
                    assert!((0.17..0.43).contains(&scene.opacity(row)), "{}", scene.opacity(row));
                    assert!(scene.coord[row][1] == 0.0 && labels[row] == -1);
                }
                Some(from) => {
                    assert!(labels[row] == 4 && scene.coord[row] == before.coord[*from]);
                    assert!(valid[row]);
                }
                None => {
                    ghosts += 1;
                    // Behind the pane, as far as the thing is before it, and dark.
                    assert!(scene.coord[row][1] <= 0.1 && labels[row] == -1 && !valid[row]);
                    let color = 0.5 + SH_C0 * scene.sh_dc[row][0];
                    assert!((0.0..0.26).contains(&color), "{color}");
                    assert!((scene.opacity(row) - 0.5).abs() < 0.01);
                }
            }
        }
        assert!(sheet > 50 && ghosts > 100, "{sheet} {ghosts}: {:?}", out.done);
        // Light through the sheet, as the areas of its Gaussians say: 1 − α of it.
        let wall = largest_wall(&before.coord, Up::PLUS_Z).unwrap();
        let pane = Pane::on(&wall, 5.0, 3);
        let area = std::f64::consts::TAU * 0.02 * 0.02;
        let taken: f64 = (0..scene.len())
            .filter(|&row| out.source[row].is_some() && labels[row] == -1)
            .map(|row| f64::from(scene.opacity(row)) * area)
            .sum();
        let through = (-taken / (4.0 * pane.half[0] * pane.half[1])).exp();
        assert!((through - (1.0 - 5.0 * GLASS_ALPHA)).abs() < 0.05, "{through}");
    }

    #[test]
    fn mirror_images_have_mirrored_covariances() {
        let mut scene = scene();
        let row = scene.len() - 1;
        let wall = largest_wall(&scene.coord, Up::PLUS_Z).unwrap();
        let pane = Pane::on(&wall, 5.0, 3);
        let axis = |scene: &GaussianScene| {
            let m = quaternion::matrix(quaternion::unit(scene.quat[row].map(f64::from)));
            [m[0][0], m[1][0], m[2][0]]
        };
        let before = axis(&scene);
        mirror(&mut scene, row, &pane);
        let after = axis(&scene);
        let want = pane.mirrored_direction(before);
        let cosine: f64 = (0..3).map(|i| want[i] * after[i]).sum();
        assert!((cosine.abs() - 1.0).abs() < 1e-6, "{before:?} {after:?}");
        // The wall is y = 0, the pane its thickness before it.
        let want = [1.5, 2.0 * pane.thickness - 1.0, 1.0];
        (0..3).for_each(|i| assert!((f64::from(scene.coord[row][i]) - want[i]).abs() < 1e-4));
    }

    #[test]
    fn less_glass_changes_less_and_other_seeds_put_it_elsewhere() {
        let changed: Vec<usize> =
            [0.05, 0.5, 1.0, 2.0, 3.0, 5.0].map(|s| glassy(s, 1).done[0].changed).to_vec();
        assert!(changed.is_sorted() && changed[0] < 80 && changed[5] > 2500, "{changed:?}");
        assert_ne!(glassy(2.0, 1).source, glassy(2.0, 2).source);
        let floor = GaussianScene {
            coord: vec![[0.0; 3]; 40],
            log_scale: vec![[0.0; 3]; 40],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; 40],
            opacity_logit: vec![0.0; 40],
            sh_dc: vec![[0.0; 3]; 40],
            ..GaussianScene::default()
        };
        let out = simulate(&floor, &"glass=3".parse().unwrap(), 1).unwrap();
        assert!(out.scene == floor && out.done[0].text.contains("no upright plane"));
    }
}
