//! Gaussians as they are, by the renderer.

use super::discs::{Canvas, Disc, Lens};
use super::framing::Upright;
use super::{PreviewRows, SplatShapes};
use scenesplat_rasterizer::{
    DepthRequest, Gaussians, RasterError, RasterSettings, RenderRequest, View, render,
};

/// The constant harmonic: a color is `½ + Y₀ · dc`.
const Y0: f32 = 0.282_094_79;

/// Distance of a parallel view, in sizes of what is shown: its edges are then half a
/// percent of that nearer to each other than they should be, at most.
const FAR: f64 = 200.0;

/// Larger standard deviations, in sizes of what is shown, are left out: such Gaussians are haze before
/// the camera, and one can hide everything.
const LARGEST: f64 = 0.5;
/// Scenes of fewer Gaussians are drawn whole.
const FEW: usize = 100;

/// What is drawn: discs, and where rows have shapes Gaussians.
pub(super) struct Drawn {
    discs: Vec<Disc>,
    /// With whether they make up for the low-pass of the picture.
    gaussians: Option<(Gaussians, bool)>,
}

impl Drawn {
    /// The rows of `kept`; `size`: extent of what is shown.
    pub(super) fn of(rows: &PreviewRows<'_>, kept: &[usize], discs: Vec<Disc>, size: f64) -> Self {
        let gaussians =
            rows.shapes.map(|shapes| (gather(rows, &shapes, kept, size), shapes.antialiased));
        Self { discs, gaussians }
    }

    /// Draws a view. What the renderer refuses, such as far too many large Gaussians, is drawn as discs: a picture to look at
    /// is no reason to fail.
    pub(super) fn draw(&self, upright: Upright, lens: &Lens, canvas: &mut Canvas) {
        let rendered = (self.gaussians.as_ref())
            .map(|(gaussians, antialiased)| draw(gaussians, *antialiased, upright, lens, canvas));
        if !matches!(rendered, Some(Ok(()))) {
            canvas.draw(&self.discs, lens);
        }
    }
}

/// The rows of `kept` with colors of their own.
fn gather(
    rows: &PreviewRows<'_>,
    shapes: &SplatShapes<'_>,
    kept: &[usize],
    size: f64,
) -> Gaussians {
    // Of a few, none is haze.
    let largest = if kept.len() < FEW { f64::INFINITY } else { LARGEST * size };
    let fits = |&&i: &&usize| {
        let scale = shapes.scale[i];
        scale.iter().all(|&s| f64::from(s.abs()) <= largest)
    };
    let kept: Vec<usize> = kept.iter().filter(fits).copied().collect();
    let dc = |i: usize| rows.color[i].map(|c| (f32::from(c) / 255.0 - 0.5) / Y0);
    Gaussians {
        means: kept.iter().map(|&i| rows.coord[i]).collect(),
        quats: kept.iter().map(|&i| shapes.quat[i]).collect(),
        scales: kept.iter().map(|&i| shapes.scale[i]).collect(),
        opacities: kept.iter().map(|&i| rows.opacity[i]).collect(),
        sh: kept.iter().flat_map(|&i| dc(i)).collect(),
        sh_degree: 0,
    }
}

/// Draws Gaussians of the scene's own axes onto a canvas; the lens is of the upright ones.
fn draw(
    gaussians: &Gaussians,
    antialiased: bool,
    upright: Upright,
    lens: &Lens,
    canvas: &mut Canvas,
) -> Result<(), RasterError> {
    let side = canvas.side();
    let (mut eye, mut focal) = (lens.eye, lens.scale * side as f64 / 2.0);
    let mut step_back = 0.0;
    if !lens.is_perspective {
        step_back = FAR * lens.size;
        eye = [0, 1, 2].map(|a| eye[a] - step_back * lens.axes[2][a]);
        // What stands a size behind the eye's plane, as the scene does, has the scale asked for.
        focal *= step_back + 1.5 * lens.size;
    }
    let eye = upright.turn_back(eye);
    let rows = lens.axes.map(|axis| {
        let [x, y, z] = upright.turn_back(axis);
        let shift = -(x * eye[0] + y * eye[1] + z * eye[2]);
        [x as f32, y as f32, z as f32, shift as f32]
    });
    let middle = side as f32 / 2.0;
    let view = View {
        world_to_camera: rows,
        fx: focal as f32,
        fy: focal as f32,
        cx: middle,
        cy: middle,
        width: side as u32,
        height: side as u32,
    };
    let near = (step_back + lens.least_depth()).max(f64::from(f32::MIN_POSITIVE)) as f32;
    let settings =
        RasterSettings { near, far: f32::INFINITY, antialiased, ..RasterSettings::gsplat_1_6() };
    let depth = DepthRequest { median: true, ..DepthRequest::default() };
    let picture =
        render(gaussians, &view, &settings, &RenderRequest { depth, ..RenderRequest::rgb() })?;
    let alpha = picture.alpha();
    let depth = picture.depth_median.unwrap_or_default();
    canvas.take(&picture.rgb.unwrap_or_default(), alpha, &depth, lens.size);
    Ok(())
}
