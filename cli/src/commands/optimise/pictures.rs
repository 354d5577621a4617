//! Pictures of truth, result and error, side by side.

use anyhow::Result;
use scenesplat::optimisation::{
    FrameScore, OptimiseSettings, Optimiser, TrainingFrame, score_frame,
};
use scenesplat::scene::picture::RgbPicture;

/// What an error is multiplied by to be seen.
const SHOWN: f32 = 4.0;

/// The scores of a frame and its three pictures in a row: truth, result, four times the error.
pub(super) fn compared(
    optimiser: &Optimiser,
    frame: &TrainingFrame,
) -> Result<(FrameScore, RgbPicture)> {
    let settings: &OptimiseSettings = optimiser.settings();
    let degree = settings.sh_degree_at(optimiser.steps_done().saturating_sub(1));
    let (score, drawn) = score_frame(optimiser.model(), frame, settings, degree)?;
    let rgb = drawn.rgb.unwrap_or_default();
    let mut truth = Vec::new();
    frame.put_over(settings.background.shown(), &mut truth);
    let (width, height) = (frame.view.width, frame.view.height);
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let picture = RgbPicture::from_fn(3 * width, height, |x, y| {
        let at = 3 * (y * width + x % width) as usize;
        [0, 1, 2].map(|c| {
            let (truth, result) = (truth[at + c], rgb[at + c]);
            match x / width {
                0 => byte(truth),
                1 => byte(result),
                _ => byte(SHOWN * (truth - result).abs()),
            }
        })
    });
    Ok((score, picture))
}
