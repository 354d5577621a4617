//! How well effects are found in pictures: takes pictures of synthetic rooms with and without each effect at severities 1 to 5,
//! shows them to the detectors together with a reconstruction that is not perfect, and prints what they
//! say, their recall, false alarms and rank correlation with the truth.

use crate::Arguments;
use anyhow::{Context, Result};
use scenesplat::datasets::effects::pictures::PictureSimulator;
use scenesplat::datasets::effects::{EffectSet, simulate};
use scenesplat::metrics::rank_correlation;
use scenesplat::preview::{SceneRows, inside_views, picture_of};
use scenesplat::rasterizer::{
    DepthRequest, Gaussians, PlanRequest, Prepared, RasterSettings, RenderPlan, RenderRequest,
    SceneProfile,
};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::{Camera, GaussianScene, Up};
use scenesplat_lab::capture::{CaptureProbe, ScenePictures};

const EFFECTS: [&str; 3] = ["blur", "light", "noise"];
const SEVERITIES: [f64; 6] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
const PICTURES: usize = 20;
const SIZE: [u32; 2] = [480, 360];

/// Number of the effect that is there ([`EFFECTS`]' length: none), its severity, and measure and severity of each
/// detector.
type Row = (usize, f64, [(f64, f64); 3]);

pub fn run(mut args: Arguments) -> Result<()> {
    let (first, count): (u64, u64) = (args.or(200)?, args.or(8)?);
    let mut found: Vec<Row> = Vec::new();
    for room in first..first + count {
        let settings =
            SyntheticRoomSettings { room, ..SyntheticRoomSettings::with_count(40_000, 1) };
        let scene = generate(&settings)?.scene;
        let colors = vec![[0; 3]; scene.len()];
        let rows = SceneRows::of(&scene);
        let cameras = inside_views(&rows.rows(&scene, &colors), Up::PLUS_Z, PICTURES, 60.0, SIZE);
        let truth = prepared(&scene)?;
        // What the detectors know of the scene was not reconstructed perfectly.
        let known = simulate(&scene, &"surface=1,noise=1".parse()?, room)?.scene;
        let known = prepared(&known)?;
        for (k, effect) in EFFECTS.iter().enumerate() {
            for severity in SEVERITIES {
                if severity == 0.0 && k > 0 {
                    continue;
                }
                let set = format!("{effect}={severity}").parse()?;
                let measured = measure(&truth, &known, &cameras, &set, room)?;
                println!("room {room} {effect}={severity} {measured:.3?}");
                found.push((if severity == 0.0 { EFFECTS.len() } else { k }, severity, measured));
            }
        }
    }
    for (k, effect) in EFFECTS.iter().enumerate() {
        let there = |row: &&Row| row.0 == k && row.1 >= 2.0;
        let hits = found.iter().filter(there).filter(|row| row.2[k].1 > 0.0).count();
        let all = found.iter().filter(there).count();
        // Alarms where there is nothing, and where there is only something else.
        let alarms = |of: &dyn Fn(usize) -> bool| {
            let rows = || found.iter().filter(|row| of(row.0));
            (rows().filter(|row| row.2[k].1 > 0.0).count(), rows().count())
        };
        let (clean, cleans) = alarms(&|truth| truth == EFFECTS.len());
        let (other, others) = alarms(&|truth| truth != k && truth != EFFECTS.len());
        let (severities, measures): (Vec<f64>, Vec<f64>) = found
            .iter()
            .filter(|row| row.0 == k || row.0 == EFFECTS.len())
            .map(|row| (row.1, row.2[k].0))
            .unzip();
        println!(
            "{effect}: found {hits} of {all} from severity 2 on; false alarms {clean} of {cleans} clean, \
             {other} of {others} with another effect; rank correlation {:.3}",
            rank_correlation(&severities, &measures).unwrap_or(f64::NAN)
        );
    }
    Ok(())
}

fn prepared(scene: &GaussianScene) -> Result<Prepared> {
    let gaussians = Gaussians::from_scene(scene)?;
    let profile = SceneProfile::scan(&gaussians)?;
    let depth = DepthRequest { expected: true, ..DepthRequest::default() };
    let request = PlanRequest::new(RenderRequest { depth, ..RenderRequest::rgb() });
    Ok(RenderPlan::auto(&profile, RasterSettings::default(), request)?.prepare(gaussians)?)
}

/// Measure and severity of each detector for pictures with these effects.
fn measure(
    truth: &Prepared,
    known: &Prepared,
    cameras: &[Camera],
    set: &EffectSet,
    seed: u64,
) -> Result<[(f64, f64); 3]> {
    let pictures = ScenePictures::new(truth);
    let mut simulator = PictureSimulator::new(set, seed, None, 0.01)?;
    let mut probe = CaptureProbe::new(known);
    for (frame, camera) in cameras.iter().enumerate() {
        let (picture, _) = simulator.take(&pictures, frame as u64, camera)?;
        let photo = picture_of(&picture.rgb, camera.width, camera.height).context("a picture")?;
        probe.add(camera, &photo)?;
    }
    let report = probe.report();
    let mut out = [(0.0, 0.0); 3];
    for (out, effect) in out.iter_mut().zip(EFFECTS) {
        let finding = report.finding(effect).context("a detector")?;
        *out = (finding.measure.unwrap_or(f64::NAN), finding.severity);
    }
    Ok(out)
}
