//! Pictures of a scene as a capture would have taken them, and what pictures say about a capture.
//!
//! [`ScenePictures`] draws for the effects of
//! [`effects::pictures`](scenesplat::datasets::effects::pictures). [`CaptureProbe`] compares photos of a scene
//! with renders of the scene, and finds motion blur, drifting exposure and white balance, noise, clipped light
//! and parts that were hardly seen.

mod finding;
mod frame;
mod probe;

pub use finding::{CaptureFinding, CaptureReport, Figure, FrameEvidence, frame_weight};
pub use frame::{FrameFigures, frame_figures};
pub use probe::{CaptureError, CaptureProbe};

use scenesplat::preview::solid_depth;
use scenesplat_datasets::effects::pictures::{DrawnPicture, HalfSpace, PictureRenderer};
use scenesplat_rasterizer::{
    Gaussians, PlanError, Prepared, RenderRequest, Rendered, View, render,
};
use scenesplat_scene::Camera;
use std::cell::{Cell, RefCell};

/// Draws pictures of a scene that is ready for a plan.
#[derive(Debug)]
pub struct ScenePictures<'a> {
    prepared: &'a Prepared,
    request: RenderRequest,
    /// The Gaussians with those outside of a half space hidden: a mirror keeps its side.
    part: RefCell<Option<(HalfSpace, Gaussians)>>,
    visible: Cell<usize>,
}

impl<'a> ScenePictures<'a> {
    /// Pictures of what the plan was asked for: color, and depth if it has the expected one.
    pub fn new(prepared: &'a Prepared) -> Self {
        let request = RenderRequest { rgb: true, ..prepared.plan().request.render };
        Self { prepared, request, part: RefCell::default(), visible: Cell::new(0) }
    }

    /// Gaussians in the pictures of the whole scene since this was last asked.
    pub fn take_visible(&self) -> usize {
        self.visible.take()
    }

    fn draw_part(&self, view: &View, half: &HalfSpace) -> Result<Rendered, PlanError> {
        let mut part = self.part.borrow_mut();
        if part.as_ref().is_none_or(|(kept, _)| kept != half) {
            let mut gaussians = self.prepared.gaussians().clone();
            for (opacity, mean) in gaussians.opacities.iter_mut().zip(&gaussians.means) {
                if !half.contains(mean.map(f64::from)) {
                    *opacity = 0.0;
                }
            }
            *part = Some((*half, gaussians));
        }
        let plan = self.prepared.plan();
        let request = RenderRequest { sh_degree: Some(plan.sh_degree), ..self.request };
        let gaussians = part.as_ref().map_or(self.prepared.gaussians(), |(_, part)| part);
        Ok(render(gaussians, view, &plan.settings, &request)?)
    }
}

impl PictureRenderer for ScenePictures<'_> {
    type Error = PlanError;

    fn draw(&self, camera: &Camera, part: Option<&HalfSpace>) -> Result<DrawnPicture, PlanError> {
        let view = View::from_camera(camera)?;
        let rendered = match part {
            Some(half) => self.draw_part(&view, half)?,
            None => {
                let rendered = self.prepared.render(&view, &self.request)?;
                self.visible.set(self.visible.get() + rendered.work.visible);
                rendered
            }
        };
        let depth = solid_depth(&rendered);
        Ok(DrawnPicture { rgb: rendered.rgb.unwrap_or_default(), depth })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_datasets::effects::pictures::PictureSimulator;
    use scenesplat_datasets::effects::{EffectSet, Pane};
    use scenesplat_rasterizer::{
        DepthRequest, PlanRequest, RasterSettings, RenderPlan, SceneProfile,
    };
    use scenesplat_scene::Distortion;
    use scenesplat_scene::linear_light::{display, linear};

    /// A gray dot 2 m ahead, a white one 2 m behind the camera, and a red one 5 m ahead.
    fn prepared(depth: bool) -> Prepared {
        let gaussians = Gaussians {
            means: vec![[0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [0.0, 0.0, 5.0]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 3],
            scales: vec![[0.02; 3], [30.0, 30.0, 0.01], [0.8; 3]],
            opacities: vec![1.0; 3],
            sh: vec![0.0, 0.0, 0.0, 1.7, 1.7, 1.7, 1.7, -1.7, -1.7],
            sh_degree: 0,
        };
        let profile = SceneProfile::scan(&gaussians).unwrap();
        let depth = DepthRequest { expected: depth, ..DepthRequest::default() };
        let request = PlanRequest::new(RenderRequest { depth, ..RenderRequest::rgb() });
        let plan = RenderPlan::auto(&profile, RasterSettings::default(), request).unwrap();
        plan.prepare(gaussians).unwrap()
    }

    fn camera() -> Camera {
        Camera {
            name: String::new(),
            width: 33,
            height: 33,
            fx: 40.0,
            fy: 40.0,
            cx: 16.5,
            cy: 16.5,
            distortion: Distortion::None,
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
        }
    }

    #[test]
    fn without_effects_it_is_the_render_bit_for_bit() {
        for depth in [false, true] {
            let prepared = prepared(depth);
            let pictures = ScenePictures::new(&prepared);
            let mut simulator =
                PictureSimulator::new(&EffectSet::default(), 1, None, 0.01).unwrap();
            let (picture, report) = simulator.take(&pictures, 0, &camera()).unwrap();
            let view = View::from_camera(&camera()).unwrap();
            let plain = prepared.render(&view, &prepared.plan().request.render).unwrap();
            assert_eq!((report.renders, pictures.take_visible()), (1, plain.work.visible));
            assert_eq!(picture.depth, solid_depth(&plain));
            assert_eq!(Some(picture.rgb), plain.rgb);
        }
    }

    #[test]
    fn a_mirror_shows_what_is_behind_the_camera_and_not_what_is_behind_the_glass() {
        let prepared = prepared(true);
        let pictures = ScenePictures::new(&prepared);
        let pane = Pane {
            normal: [0.0, 0.0, -1.0],
            across: [1.0, 0.0, 0.0],
            up: [0.0, -1.0, 0.0],
            centre: [0.0, 0.0, 3.0],
            half: [0.4, 0.4],
            alpha: 0.06,
            tint: [1.0; 3],
            thickness: 0.05,
        };
        let plain = pictures.draw(&camera(), None).unwrap();
        let mut simulator =
            PictureSimulator::new(&"glass=1".parse().unwrap(), 1, Some(pane), 0.01).unwrap();
        let (picture, report) = simulator.take(&pictures, 0, &camera()).unwrap();
        assert_eq!(report.renders, 2);
        let at = |x: usize, y: usize| 3 * (33 * y + x);
        // The dot before the glass stays as it is, and hides it.
        assert_eq!(picture.rgb[at(16, 16)..][..3], plain.rgb[at(16, 16)..][..3]);
        assert!((picture.depth.as_ref().unwrap()[33 * 16 + 16] - 2.0).abs() < 0.1);
        // Beside it the red one is dimmed, and 4 % of white come to its green: 0.04 → 0.22.
        for c in 0..2 {
            let [got, behind] = [&picture, &plain].map(|p| f64::from(p.rgb[at(20, 16) + c]));
            let want = display(0.04 * linear(0.97) + 0.96 * 0.94 * linear(behind));
            assert!((got - want).abs() < 0.005, "{c}: {got} {want}");
        }
        assert!(plain.rgb[at(20, 16) + 1] < 0.05 && picture.rgb[at(20, 16) + 1] > 0.2);
        assert_eq!(picture.depth.unwrap()[33 * 16 + 20], 0.0);
    }
}
