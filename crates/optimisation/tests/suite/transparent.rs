//! Pictures that are transparent where nothing is.

use scenesplat_optimisation::initial::from_points;
use scenesplat_optimisation::{
    Background, Colors, Model, OptimiseSettings, Optimiser, Strategy, TrainingFrame,
    newest_checkpoint, score_frame,
};
use scenesplat_rasterizer::View;

const SIDE: u32 = 32;

/// An opaque square with a ramp of red in the middle; around it nothing, with whatever color.
fn frame(shift: f32) -> TrainingFrame {
    let view = View {
        world_to_camera: [[1., 0., 0., shift], [0., 1., 0., 0.], [0., 0., 1., 2.]],
        fx: 32.0,
        fy: 32.0,
        cx: 16.0 - 16.0 * shift,
        cy: 16.0,
        width: SIDE,
        height: SIDE,
    };
    let inside = |i: u32| (10..22).contains(&(i % SIDE)) && (10..22).contains(&(i / SIDE));
    let color = |i: u32| if inside(i) { [150 + 4 * (i % SIDE) as u8, 40, 20] } else { [0; 3] };
    let alpha = (0..SIDE * SIDE).map(|i| if inside(i) { 255 } else { 0 }).collect();
    TrainingFrame {
        name: format!("{shift}"),
        view,
        rgb: Colors::Bytes((0..SIDE * SIDE).flat_map(color).collect()),
        alpha: Some(alpha),
        depth: None,
        mask: None,
    }
}

/// A wall of gray Gaussians that fills the pictures.
fn wall(settings: &OptimiseSettings) -> Model {
    let points: Vec<[f32; 3]> = (0..400)
        .map(|i| [0.12 * (i % 20) as f32 - 1.14, 0.12 * (i / 20) as f32 - 1.14, 0.0])
        .collect();
    from_points(&points, &vec![[0.5; 3]; 400], &settings.initial, 1).unwrap()
}

fn settings(background: Background) -> OptimiseSettings {
    let base = OptimiseSettings::scenesplat();
    OptimiseSettings { background, strategy: Strategy::Fixed, ..base }.with_steps(300)
}

/// Where a picture is transparent nothing is made, and the score is of the whole picture.
#[test]
fn nothing_is_made_where_nothing_is() {
    let frames: Vec<_> = [-0.2, 0.0, 0.2].map(frame).to_vec();
    for background in [Background::Auto, Background::Fixed([1.0, 0.5, 0.0])] {
        let settings = settings(background);
        let mut optimiser = Optimiser::new(wall(&settings), &frames, settings).unwrap();
        let before = score_frame(optimiser.model(), &frames[1], &settings, 3).unwrap().0;
        assert!(before.psnr.unwrap() < 12.0 && before.psnr_masked.is_none(), "{before:?}");
        for _ in 0..300 {
            optimiser.step(&frames).unwrap();
        }
        let (score, drawn) = score_frame(optimiser.model(), &frames[1], &settings, 3).unwrap();
        let alpha = frames[1].alpha.as_ref().unwrap();
        let free = alpha.iter().zip(&drawn.transmittance).filter(|(a, _)| **a == 0);
        let free: Vec<f32> = free.map(|(_, t)| *t).collect();
        let mean = free.iter().sum::<f32>() / free.len() as f32;
        println!("{background:?}: {score:?}, free {mean}");
        assert!(mean > 0.97, "{background:?}: fog takes {:.3} of the light", 1.0 - mean);
        assert!(score.psnr.unwrap() > 22.0, "{score:?}");
    }
}

/// Masks say what does not count; figures with them are beside those of whole pictures.
#[test]
fn masks_leave_out_and_scores_are_of_whole_pictures() {
    let settings = settings(Background::Auto);
    let model = wall(&settings);
    let mut frame = TrainingFrame { alpha: None, ..frame(0.0) };
    let whole = score_frame(&model, &frame, &settings, 3).unwrap().0;
    frame.mask = Some((0..SIDE * SIDE).map(|i| u8::from(i % SIDE < 12)).collect());
    let masked = score_frame(&model, &frame, &settings, 3).unwrap().0;
    assert_eq!((whole.psnr, whole.ssim), (masked.psnr, masked.ssim));
    assert!(whole.psnr_masked.is_none() && masked.psnr_masked.is_some());
    assert_ne!(masked.psnr_masked, masked.psnr);
    assert!(masked.ssim_masked > masked.ssim, "{masked:?}");
}

/// The color behind a step depends on the seed and the step alone.
#[test]
fn a_resume_has_the_same_backgrounds() {
    let frames: Vec<_> = [-0.2, 0.0, 0.2].map(frame).to_vec();
    let settings = settings(Background::Auto);
    let steps = |optimiser: &mut Optimiser, count: usize| {
        for _ in 0..count {
            optimiser.step(&frames).unwrap();
        }
    };
    let begin = || Optimiser::new(wall(&settings), &frames, settings).unwrap();
    let mut whole = begin();
    steps(&mut whole, 20);
    let mut part = begin();
    steps(&mut part, 9);
    let folder = tempfile::tempdir().unwrap();
    part.save(folder.path(), &frames, 1).unwrap();
    let place = newest_checkpoint(folder.path()).unwrap().unwrap();
    let mut resumed = Optimiser::resume(&place, &frames, Some(settings)).unwrap();
    steps(&mut resumed, 11);
    assert_eq!(whole.model(), resumed.model());
    // Frames of another opacity are other frames.
    let mut other = frames.clone();
    other[0].alpha.as_mut().unwrap()[0] = 9;
    let error = Optimiser::resume(&place, &other, Some(settings)).unwrap_err().to_string();
    assert!(error.contains("is of other frames"), "{error}");
}
