//! Measures the photos of a scene.

use super::ScenePictures;
use super::finding::{CaptureFinding, CaptureReport, Figure, FrameEvidence};
use super::frame::{FrameFigures, frame_figures, motion};
use scenesplat::preview::picture_of;
use scenesplat_datasets::effects::pictures::PictureRenderer;
use scenesplat_datasets::effects::strength::{LIGHT_BALANCE, LIGHT_LOG_GAIN};
use scenesplat_metrics::image::ImageError;
use scenesplat_rasterizer::{PlanError, Prepared};
use scenesplat_scene::Camera;
use scenesplat_scene::linear_light::linear;
use scenesplat_scene::picture::RgbPicture;

/// Gaussians that are looked for in each photo.
const POINTS: usize = 4000;
/// Distance of the pixels whose colors are compared, and how many of them are needed.
const PIXEL_STEP: usize = 4;
const FEWEST_PIXELS: usize = 100;
/// Opacity from which on a Gaussian shows its own color.
const SOLID: f32 = 0.5;
/// How far a Gaussian may be from the depth of its pixel, as a share.
const DEPTH_SHARE: f64 = 0.03;
/// Linear light in which a sensor neither drowns nor clips.
const LIGHT: [f64; 2] = [0.004, 0.9];
/// Byte from which on a channel may be clipped.
const CLIPPED: u8 = 250;
/// Fewer pictures do not say how much one differs from the others.
const FEWEST_FRAMES: usize = 6;
/// The sharpest fifth of the pictures is the measure of the others.
const SHARP_QUANTILE: f64 = 0.8;
/// Pictures below which a Gaussian was hardly seen.
const FEWEST_VIEWS: u32 = 3;

/// Detail that the median picture lacks along its motion at severities 0 to 5, nat: fitted on rooms 100 to 102.
const BLUR_BY_SEVERITY: [f64; 6] = [0.0, 0.31, 0.9, 1.2, 1.4, 1.55];
/// Share of hardly seen Gaussians at severity 1: what the simulator's holes take.
const UNSEEN_PER_SEVERITY: f64 = 0.03;
/// Share of clipped pixels at severity 1.
const SATURATED_PER_SEVERITY: f64 = 0.02;

/// Measures, as severities, from which on an effect is there.
const BLUR_FROM: f64 = 0.75;
const LIGHT_FROM: f64 = 0.75;
const NOISE_FROM: f64 = 0.5;
const SATURATED_FROM: f64 = 0.5;
const UNSEEN_FROM: f64 = 0.33;

/// Why photos cannot be measured.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// The renderer refuses.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A picture cannot be measured.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A photo of another size than its camera says.
    #[error(
        "{camera}: the photo has {photo:?} pixels, its camera {size:?}; bring them to one size first"
    )]
    Size {
        /// Name of the camera.
        camera: String,
        /// Width and height.
        photo: [u32; 2],
        /// Width and height.
        size: [u32; 2],
    },
    /// The plan has no depth.
    #[error("the plan has no expected depth: ask for it together with color")]
    NoDepth,
}

/// Measures the photos of a scene, one by one.
#[derive(Debug)]
pub struct CaptureProbe<'a> {
    pictures: ScenePictures<'a>,
    points: Vec<[f64; 3]>,
    views: Vec<u32>,
    /// Logarithms of red, green, blue over those of the scene's own pictures.
    log_gains: Vec<Option<[f64; 3]>>,
    frames: Vec<(FrameEvidence, f64)>,
}

impl<'a> CaptureProbe<'a> {
    /// For a scene whose plan has color and expected depth.
    pub fn new(prepared: &'a Prepared) -> Self {
        let gaussians = prepared.gaussians();
        let there = |i: &usize| {
            gaussians.opacities[*i] >= SOLID && gaussians.means[*i].iter().all(|v| v.is_finite())
        };
        let rows: Vec<usize> = (0..gaussians.len()).filter(there).collect();
        let step = rows.len().div_ceil(POINTS).max(1);
        let place = |row: &usize| gaussians.means[*row].map(f64::from);
        let points: Vec<[f64; 3]> = rows.iter().step_by(step).map(place).collect();
        Self {
            pictures: ScenePictures::new(prepared),
            views: vec![0; points.len()],
            points,
            log_gains: Vec::new(),
            frames: Vec::new(),
        }
    }

    /// Measures a photo: one render, and a few passes over the pixels.
    ///
    /// # Errors
    /// A photo of another size than its camera's, and what the renderer refuses.
    pub fn add(&mut self, camera: &Camera, photo: &RgbPicture) -> Result<(), CaptureError> {
        let size = [camera.width, camera.height];
        let shown = [photo.width(), photo.height()];
        if shown != size {
            return Err(CaptureError::Size { camera: camera.name.clone(), photo: shown, size });
        }
        let drawn = self.pictures.draw(camera, None)?;
        let depth = drawn.depth.as_ref().ok_or(CaptureError::NoDepth)?;
        let figures = frame_figures(photo)?;
        let own = picture_of(&drawn.rgb, size[0], size[1]);
        let width = size[0] as usize;
        self.log_gains.push(own.as_ref().and_then(|own| log_gain(photo, own, depth)));
        let own = own.map(|own| frame_figures(&own)).transpose()?.unwrap_or_default();
        for (views, point) in self.views.iter_mut().zip(&self.points) {
            let Some([x, y]) = camera.project(*point).filter(|at| camera.contains(*at)) else {
                continue;
            };
            let z = camera.to_camera(*point)[2];
            let surface = f64::from(depth[y as usize * width + x as usize]);
            *views += u32::from((z - surface).abs() <= DEPTH_SHARE * z);
        }
        let name = camera.name.clone();
        let motion = motion(&figures, &own);
        let evidence = FrameEvidence { name, figures, sharpness_share: None, motion, gain: None };
        self.frames.push((evidence, own.sharpness));
        Ok(())
    }

    /// What the photos say so far.
    pub fn report(&self) -> CaptureReport {
        let gains = against_the_median(&self.log_gains);
        let ratio = |(frame, own): &(FrameEvidence, f64)| {
            (*own > 1e-6).then(|| frame.figures.sharpness / own)
        };
        let mut ratios: Vec<f64> = self.frames.iter().filter_map(ratio).collect();
        let sharp = quantile(&mut ratios, SHARP_QUANTILE);
        let frame = |(frame, gain): (&(FrameEvidence, f64), &Option<[f64; 3]>)| FrameEvidence {
            sharpness_share: ratio(frame).zip(sharp).map(|(r, sharp)| (r / sharp).min(1.0)),
            gain: gain.map(|g| g.map(f64::exp)),
            ..frame.0.clone()
        };
        let frames: Vec<FrameEvidence> = self.frames.iter().zip(&gains).map(frame).collect();
        let findings = vec![
            blur(&frames),
            light(&frames),
            noise(&frames),
            saturation(&frames),
            coverage(&self.views, frames.len()),
        ];
        CaptureReport { frames, findings }
    }
}

/// How much more linear light a photo has than the scene's own picture, natural logarithm: the median over
/// pixels that show something solid and are clipped in neither. What several photos agree on is in the
/// scene's picture; what stands where the scene has nothing does not decide.
fn log_gain(photo: &RgbPicture, own: &RgbPicture, depth: &[f32]) -> Option<[f64; 3]> {
    let (width, height) = (photo.width() as usize, photo.height() as usize);
    let mut ratios: [Vec<f64>; 3] = Default::default();
    for y in (1..height.saturating_sub(1)).step_by(PIXEL_STEP) {
        for x in (1..width.saturating_sub(1)).step_by(PIXEL_STEP) {
            if depth[y * width + x] > 0.0
                && let Some((a, b)) = color_around(photo, x, y).zip(color_around(own, x, y))
            {
                (0..3).for_each(|c| ratios[c].push(a[c] - b[c]));
            }
        }
    }
    let enough = ratios[0].len() >= FEWEST_PIXELS;
    enough.then(|| ratios.map(|mut ratios| quantile(&mut ratios, 0.5).unwrap_or(0.0)))
}

/// Gains less those of the median photo: what all have in common is the scene's.
fn against_the_median(gains: &[Option<[f64; 3]>]) -> Vec<Option<[f64; 3]>> {
    let middle: [f64; 3] = std::array::from_fn(|c| {
        let mut all: Vec<f64> = gains.iter().flatten().map(|gain| gain[c]).collect();
        quantile(&mut all, 0.5).unwrap_or(0.0)
    });
    let less = |gain: [f64; 3]| std::array::from_fn(|c| gain[c] - middle[c]);
    gains.iter().map(|gain| gain.map(less)).collect()
}

/// Logarithms of the mean linear color of 3 × 3 pixels; `None` where one is clipped or too dark.
fn color_around(photo: &RgbPicture, x: usize, y: usize) -> Option<[f64; 3]> {
    let mut sum = [0.0; 3];
    for row in y - 1..=y + 1 {
        let start = row * photo.width() as usize + x - 1;
        for pixel in &photo.pixels()[start..start + 3] {
            if pixel.iter().any(|v| *v >= CLIPPED) {
                return None;
            }
            (0..3).for_each(|c| sum[c] += linear(f64::from(pixel[c]) / 255.0) / 9.0);
        }
    }
    sum.iter().all(|v| (LIGHT[0]..LIGHT[1]).contains(v)).then(|| sum.map(f64::ln))
}

fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let at = (last as f64 * share).round() as usize;
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// The standard deviation of normally distributed values, by the median of their distances from their median: a
/// photo that shows something else than the scene does not decide.
fn deviation(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    let Some(middle) = quantile(&mut sorted, 0.5) else { return 0.0 };
    let mut off: Vec<f64> = values.iter().map(|v| (v - middle).abs()).collect();
    1.4826 * quantile(&mut off, 0.5).unwrap_or(0.0)
}

/// Where a value is in a rising table, in steps; beyond its end as far as its last step says.
fn place_in(table: &[f64], value: f64) -> f64 {
    let last = table.len() - 2;
    let k = (0..last).find(|&k| value < table[k + 1]).unwrap_or(last);
    k as f64 + (value - table[k]) / (table[k + 1] - table[k])
}

fn figure(name: &'static str, value: f64, unit: &'static str) -> Figure {
    Figure { name, value, unit }
}

fn blur(frames: &[FrameEvidence]) -> CaptureFinding {
    let mut motions: Vec<f64> = frames.iter().filter_map(|f| f.motion).collect();
    let (enough, pictures) = (motions.len() >= FEWEST_FRAMES, motions.len() as f64);
    let middle = quantile(&mut motions, 0.5).filter(|_| enough);
    let worst = quantile(&mut motions, 0.95).unwrap_or(0.0);
    let mut sharp: Vec<f64> = frames.iter().filter_map(|f| f.sharpness_share).collect();
    let sharp = quantile(&mut sharp, 0.5).unwrap_or(1.0);
    let figures = vec![
        figure("detail lacking along motion in the median picture", middle.unwrap_or(0.0), "nat"),
        figure("in the worst twentieth", worst, "nat"),
        figure("sharpness of the median picture", sharp, "of the sharpest fifth"),
        figure("pictures", pictures, ""),
    ];
    let measure = middle.map(|lacks| place_in(&BLUR_BY_SEVERITY, lacks));
    CaptureFinding::new("blur", measure, BLUR_FROM, figures)
}

fn light(frames: &[FrameEvidence]) -> CaptureFinding {
    let gains: Vec<[f64; 3]> =
        frames.iter().filter_map(|f| f.gain).map(|g| g.map(f64::ln)).collect();
    let exposures: Vec<f64> = gains.iter().map(|g| (g[0] + g[1] + g[2]) / 3.0).collect();
    let balances: Vec<f64> = gains.iter().map(|g| 0.5 * (g[0] - g[2])).collect();
    let enough = gains.len() >= FEWEST_FRAMES;
    let [exposure, balance] =
        [exposures, balances].map(|v| if enough { deviation(&v) } else { 0.0 });
    let figures = vec![
        figure("exposure ±", exposure / std::f64::consts::LN_2, "stops"),
        figure("red against blue ±", 100.0 * balance, "%"),
        figure("pictures", gains.len() as f64, ""),
    ];
    let measure = enough.then(|| (exposure / LIGHT_LOG_GAIN).max(balance / LIGHT_BALANCE));
    CaptureFinding::new("light", measure, LIGHT_FROM, figures)
}

fn noise(frames: &[FrameEvidence]) -> CaptureFinding {
    let of = |of: fn(&FrameFigures) -> Option<f64>| {
        let mut all: Vec<f64> = frames.iter().filter_map(|f| of(&f.figures)).collect();
        quantile(&mut all, 0.5)
    };
    let steps = of(|f| f.noise_steps).unwrap_or(0.0);
    let figures = vec![figure("noise of the median picture", steps, "steps of 255")];
    CaptureFinding::new("noise", of(|f| f.noise_severity), NOISE_FROM, figures)
}

fn saturation(frames: &[FrameEvidence]) -> CaptureFinding {
    let mean = |of: fn(&FrameFigures) -> f64| {
        frames.iter().map(|f| of(&f.figures)).sum::<f64>() / frames.len().max(1) as f64
    };
    let (saturated, black) = (mean(|f| f.saturated), mean(|f| f.black));
    let figures = vec![
        figure("clipped", 100.0 * saturated, "% of the pixels"),
        figure("black", 100.0 * black, "% of the pixels"),
    ];
    let measure = (!frames.is_empty()).then_some(saturated / SATURATED_PER_SEVERITY);
    CaptureFinding::new("saturation", measure, SATURATED_FROM, figures)
}

fn coverage(views: &[u32], frames: usize) -> CaptureFinding {
    let unseen = views.iter().filter(|n| **n < FEWEST_VIEWS).count() as f64;
    let share = unseen / views.len().max(1) as f64;
    let mut all: Vec<f64> = views.iter().map(|n| f64::from(*n)).collect();
    let figures = vec![
        figure("seen in fewer than 3 pictures", 100.0 * share, "% of the Gaussians"),
        figure("pictures of the median Gaussian", quantile(&mut all, 0.5).unwrap_or(0.0), ""),
        figure("pictures", frames as f64, ""),
    ];
    let measure = (!views.is_empty() && frames > 0).then_some(share / UNSEEN_PER_SEVERITY);
    CaptureFinding::new("coverage", measure, UNSEEN_FROM, figures)
}

#[cfg(test)]
mod tests {
    use super::*;

    use scenesplat::preview::{SceneRows, inside_views};
    use scenesplat_datasets::effects::pictures::PictureSimulator;
    use scenesplat_datasets::effects::simulate;
    use scenesplat_rasterizer::{
        DepthRequest, Gaussians, PlanRequest, RasterSettings, RenderPlan, RenderRequest,
        SceneProfile,
    };
    use scenesplat_rooms::{SyntheticRoomSettings, generate};
    use scenesplat_scene::{GaussianScene, Up};

    fn prepared(scene: &GaussianScene, expected: bool) -> Prepared {
        let gaussians = Gaussians::from_scene(scene).unwrap();
        let profile = SceneProfile::scan(&gaussians).unwrap();
        let depth = DepthRequest { expected, ..DepthRequest::default() };
        let request = PlanRequest::new(RenderRequest { depth, ..RenderRequest::rgb() });
        let plan = RenderPlan::auto(&profile, RasterSettings::default(), request).unwrap();
        plan.prepare(gaussians).unwrap()
    }

    #[test]
    fn effects_on_photos_are_found_as_strong_as_they_are_and_absent_ones_are_not() {
        // Not a room that thresholds were fitted on, and the scene at hand is no perfect reconstruction.
        let settings =
            SyntheticRoomSettings { room: 205, ..SyntheticRoomSettings::with_count(15_000, 1) };
        let scene = generate(&settings).unwrap().scene;
        let known = simulate(&scene, &"surface=1,noise=1".parse().unwrap(), 4).unwrap().scene;
        let (truth, known) = (prepared(&scene, false), prepared(&known, true));
        let rows = SceneRows::of(&scene);
        let colors = vec![[0; 3]; scene.len()];
        let cameras = inside_views(&rows.rows(&scene, &colors), Up::PLUS_Z, 12, 60.0, [320, 240]);
        let report = |effect: &str| {
            let pictures = ScenePictures::new(&truth);
            let mut simulator =
                PictureSimulator::new(&effect.parse().unwrap(), 8, None, 0.01).unwrap();
            let mut probe = CaptureProbe::new(&known);
            for (k, camera) in cameras.iter().enumerate() {
                let (picture, _) = simulator.take(&pictures, k as u64, camera).unwrap();
                probe.add(camera, &picture_of(&picture.rgb, 320, 240).unwrap()).unwrap();
            }
            probe.report()
        };
        let severities = |effect: &str| {
            let report = report(effect);
            ["blur", "light", "noise"].map(|name| report.finding(name).unwrap().severity)
        };
        assert_eq!(severities("none"), [0.0; 3]);
        for (k, name) in ["blur", "light", "noise"].into_iter().enumerate() {
            let found = [2.0, 5.0].map(|s| severities(&format!("{name}={s}"))[k]);
            assert!(found[0] > 0.0 && found[1] > found[0] + 0.5, "{name}: {found:?}");
        }
        // Gains are those that the simulator drew, but for one common factor.
        let set = "light=4".parse().unwrap();
        let mut simulator = PictureSimulator::new(&set, 8, None, 0.01).unwrap();
        let pictures = ScenePictures::new(&truth);
        let found = report("light=4");
        let mut ratios = Vec::new();
        for (k, camera) in cameras.iter().enumerate() {
            let (_, drawn) = simulator.take(&pictures, k as u64, camera).unwrap();
            if let Some(gain) = found.frames[k].gain {
                ratios.push((gain[1] / drawn.gain[1]).ln());
            }
        }
        assert!(ratios.len() >= 10 && deviation(&ratios) < 0.05, "{ratios:?}");
        // All of them are text, with figures and units.
        let text = found.findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
        for part in ["light: severity", "stops", "blur: absent", "% of the Gaussians"] {
            assert!(text.contains(part), "{part}: {text}");
        }
    }

    #[test]
    fn photos_that_do_not_fit_are_refused() {
        let scene = generate(&SyntheticRoomSettings::with_count(500, 1)).unwrap().scene;
        let rows = SceneRows::of(&scene);
        let colors = vec![[0; 3]; scene.len()];
        let camera =
            inside_views(&rows.rows(&scene, &colors), Up::PLUS_Z, 1, 60.0, [32, 24]).remove(0);
        let photo = RgbPicture::filled(64, 48, [9; 3]);
        let (with, without) = (prepared(&scene, true), prepared(&scene, false));
        let error = CaptureProbe::new(&with).add(&camera, &photo).unwrap_err().to_string();
        assert!(error.contains("[64, 48]") && error.contains("[32, 24]"), "{error}");
        let photo = RgbPicture::filled(32, 24, [9; 3]);
        let error = CaptureProbe::new(&without).add(&camera, &photo).unwrap_err().to_string();
        assert!(error.contains("no expected depth"), "{error}");
        // One photo says little, none nothing.
        let mut probe = CaptureProbe::new(&with);
        assert!(probe.report().findings.iter().all(|f| f.measure.is_none() && !f.is_present()));
        probe.add(&camera, &photo).unwrap();
        assert_eq!(probe.report().finding("light").unwrap().measure, None);
    }

    #[test]
    fn places_in_a_table() {
        let table = [0.0, 0.5, 2.0, 3.0];
        for (value, want) in
            [(0.0, 0.0), (0.25, 0.5), (0.5, 1.0), (1.25, 1.5), (2.5, 2.5), (4.0, 4.0)]
        {
            assert!((place_in(&table, value) - want).abs() < 1e-12, "{value}");
        }
    }
}
