//! What the photos themselves say, and how much each of them counts.

use super::args::{Args, FrameWeightsArg};
use super::plan::LIFTING;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::rasterizer::{
    DepthRequest, Gaussians, PlanRequest, Prepared, RasterSettings, RenderPlan, RenderRequest,
    SceneProfile,
};
use scenesplat::scene::Camera;
use scenesplat::scene::frame_files::PICTURES;
use scenesplat::scene::picture::read_picture;
use scenesplat_lab::capture::CaptureProbe;
use scenesplat_lab::compensation::render_section;

/// The Gaussians for renderings with depth.
fn prepare(
    session: &Session<'_>,
    (gaussians, antialiased): (&Gaussians, bool),
) -> Result<Prepared> {
    let profile = SceneProfile::scan(gaussians)?;
    let depth = DepthRequest { expected: true, ..DepthRequest::default() };
    let request = PlanRequest::new(RenderRequest { depth, ..RenderRequest::rgb() });
    let raster = RasterSettings { antialiased, ..RasterSettings::default() };
    let plan = RenderPlan::auto(&profile, raster, request)?;
    session.receipt.plan(gaussians.means.len(), render_section(&plan));
    Ok(plan.prepare(gaussians.clone())?)
}

impl Args {
    /// The weight of each picture, all 1 without photos; `cameras` are those of the pictures, `names` what their
    /// photos are called.
    pub(super) fn weigh(
        &self,
        session: &Session<'_>,
        (gaussians, antialiased): (&Gaussians, bool),
        names: &[&str],
        cameras: &[&Camera],
    ) -> Result<Vec<f32>> {
        let mut weights = vec![1.0; cameras.len()];
        let count = gaussians.means.len();
        let Some(folder) = &self.photos else {
            session.receipt.decided(count, LIFTING, self.about_frames(None, 0));
            return Ok(weights);
        };
        let _stage = session.receipt.stage("photos");
        let photos = session.files_of_cameras(("--photos", folder), ("photo", PICTURES), names)?;
        let prepared = prepare(session, (gaussians, antialiased))?;
        let mut probe = CaptureProbe::new(&prepared);
        let mut seen = Vec::new();
        for (number, (camera, file)) in cameras.iter().zip(&photos).enumerate() {
            session.check_stop()?;
            session.progress.advance("photos", number as f64 / cameras.len() as f64);
            let Some(path) = file else { continue };
            let photo = read_picture(path)?.over_black();
            probe.add(camera, &photo).with_context(|| path.display().to_string())?;
            seen.push(number);
        }
        session.progress.finish();
        let report = probe.report();
        for finding in &report.findings {
            session.progress.say(finding.to_string());
            let value = format!("{:.2}", finding.severity);
            session.receipt.setting(
                &format!("photos/{}", finding.effect),
                value,
                &finding.to_string(),
            );
        }
        if self.frame_weights == FrameWeightsArg::Auto {
            for (number, weight) in seen.iter().zip(report.frame_weights()) {
                weights[*number] = weight;
            }
            let less = weights.iter().filter(|w| **w < 1.0).count();
            let text = format!("{less} of {} pictures count less for their motion", weights.len());
            session.progress.say(&text);
            session.receipt.setting("frame_weights", less, &text);
        }
        let less = weights.iter().filter(|w| **w < 1.0).count();
        session.receipt.decided(count, LIFTING, self.about_frames(Some(&report), less));
        Ok(weights)
    }
}
