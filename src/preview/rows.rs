//! What a preview draws: rows of a scene, and which of them.

use super::discs::Disc;
use super::framing::Upright;
use scenesplat_scene::GaussianScene;

/// What to draw, one row per Gaussian.
#[derive(Debug, Clone, Copy)]
pub struct PreviewRows<'a> {
    /// Centers, meters. Rows that are not finite are left out. `[N, 3]`
    pub coord: &'a [[f32; 3]],
    /// Colors: of the scene, or [`class_color`](super::class_color) of its labels. `[N, 3]`
    pub color: &'a [[u8; 3]],
    /// Size, meters: the standard deviation, say the middle one of three. `[N]`
    pub radius: &'a [f32],
    /// Opacity in 0..=1; the faintest Gaussians are left out. `[N]`
    pub opacity: &'a [f32],
    /// Gaussians are rendered with their shapes; without, as discs.
    pub shapes: Option<SplatShapes<'a>>,
}

/// Shapes of Gaussians.
#[derive(Debug, Clone, Copy)]
pub struct SplatShapes<'a> {
    /// `w, x, y, z`, any norm. `[N, 4]`
    pub quat: &'a [[f32; 4]],
    /// Standard deviations, meters. `[N, 3]`
    pub scale: &'a [[f32; 3]],
    /// Whether opacities make up for the low-pass of the picture, as the scene was trained.
    pub antialiased: bool,
}

/// Sizes and opacities of a scene, to make [`PreviewRows`] of.
#[derive(Debug, Clone)]
pub struct SceneRows {
    scale: Vec<[f32; 3]>,
    /// The middle one of the three.
    radius: Vec<f32>,
    opacity: Vec<f32>,
}

impl SceneRows {
    /// Of all rows of a scene.
    pub fn of(scene: &GaussianScene) -> Self {
        let scale: Vec<[f32; 3]> = (0..scene.len()).map(|row| scene.scale(row)).collect();
        let middle = |s: &[f32; 3]| {
            let mut s = *s;
            s.sort_by(f32::total_cmp);
            s[1]
        };
        let radius = scale.iter().map(middle).collect();
        let opacity = (0..scene.len()).map(|row| scene.opacity(row)).collect();
        Self { scale, radius, opacity }
    }

    /// `color`: one per Gaussian of the same scene.
    pub fn rows<'a>(&'a self, scene: &'a GaussianScene, color: &'a [[u8; 3]]) -> PreviewRows<'a> {
        let Self { scale, radius, opacity } = self;
        let antialiased = scene.antialiased;
        let shapes = Some(SplatShapes { quat: &scene.quat, scale, antialiased });
        PreviewRows { coord: &scene.coord, color, radius, opacity, shapes }
    }
}

/// Rows to draw: not the faintest, which hide the rest in captures with much haze.
pub(super) fn visible_rows(rows: &PreviewRows<'_>) -> Vec<usize> {
    let mut opacities: Vec<f32> = rows.opacity.iter().copied().filter(|o| o.is_finite()).collect();
    if opacities.is_empty() {
        return Vec::new();
    }
    let middle = opacities.len() / 2;
    let median = *opacities.select_nth_unstable_by(middle, f32::total_cmp).1;
    // A badly converged capture may be faint throughout; half of it is drawn in any case.
    let least = median.min(0.25);
    (0..rows.coord.len())
        .filter(|&i| rows.opacity[i] >= least && rows.coord[i].iter().all(|v| v.is_finite()))
        .collect()
}

/// Rows as discs in the upright frame.
pub(super) fn discs_of(rows: &PreviewRows<'_>, kept: &[usize], upright: Upright) -> Vec<Disc> {
    let disc = |&i: &usize| Disc {
        centre: upright.turn(rows.coord[i]),
        radius: if rows.radius[i].is_finite() { rows.radius[i].max(0.0) } else { 0.0 },
        color: rows.color[i],
    };
    kept.iter().map(disc).collect()
}

/// Both.
pub(super) fn visible_discs(rows: &PreviewRows<'_>, upright: Upright) -> Vec<Disc> {
    discs_of(rows, &visible_rows(rows), upright)
}
