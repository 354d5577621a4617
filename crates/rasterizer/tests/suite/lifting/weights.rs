//! What a picture weighs among others.

use scenesplat_rasterizer::lifting::{
    BlockFeatures, FinaliseSettings, LabelledPicture, LiftSettings, Lifter, NO_SEGMENT, SegmentMap,
};
use scenesplat_rasterizer::{Gaussians, View};

fn view() -> View {
    View {
        world_to_camera: [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.]],
        fx: 40.0,
        fy: 40.0,
        cx: 16.0,
        cy: 16.0,
        width: 32,
        height: 32,
    }
}

fn dot() -> Gaussians {
    Gaussians {
        means: vec![[0.0, 0.0, 2.0]],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        scales: vec![[0.1; 3]],
        opacities: vec![0.9],
        sh: vec![0.0; 3],
        sh_degree: 0,
    }
}

/// Two pictures of a dot that name it differently, with these weights.
fn lifted(weights: [Option<f32>; 2]) -> BlockFeatures {
    let (gaussians, view) = (dot(), view());
    let levels = [SegmentMap::new(32, 32, vec![0; 32 * 32]).unwrap()];
    let mut lifter = Lifter::new(&gaussians, 1, 2, LiftSettings::default()).unwrap();
    for (features, weight) in [[1.0, 0.0], [0.0, 1.0]].into_iter().zip(weights) {
        let features = &features;
        let picture = LabelledPicture { view: &view, levels: &levels, features, depth: None };
        match weight {
            None => lifter.add(&picture).unwrap(),
            Some(weight) => lifter.add_weighted(&picture, weight).unwrap(),
        };
    }
    let settings = FinaliseSettings { normalise: false, ..FinaliseSettings::default() };
    lifter.collect(0, &settings).unwrap()
}

#[test]
fn pictures_count_as_much_as_they_weigh_and_one_is_no_weight_at_all() {
    let plain = lifted([None, None]);
    assert_eq!(lifted([Some(1.0), Some(1.0)]), plain);
    // By hand: three quarters to one quarter.
    let uneven = lifted([None, Some(1.0 / 3.0)]);
    let near = |got: f32, want: f32| (got - want).abs() < 1e-6;
    assert!(near(uneven.features[0], 0.75) && near(uneven.features[1], 0.25), "{uneven:?}");
    // What all weigh alike changes no feature, and coverage by as much.
    let half = lifted([Some(0.5), Some(0.5)]);
    assert_eq!(half.features, plain.features);
    assert!(near(half.coverage[0], 0.5 * plain.coverage[0]) && half.views == plain.views);
}

#[test]
fn weights_that_are_none_are_refused() {
    let (gaussians, view) = (dot(), view());
    let levels = [SegmentMap::new(32, 32, vec![NO_SEGMENT; 32 * 32]).unwrap()];
    let mut lifter = Lifter::new(&gaussians, 1, 2, LiftSettings::default()).unwrap();
    let picture =
        LabelledPicture { view: &view, levels: &levels, features: &[1.0, 0.0], depth: None };
    for weight in [0.0, -1.0, 1.01, f32::NAN, f32::INFINITY] {
        let error = lifter.add_weighted(&picture, weight).unwrap_err().to_string();
        assert!(error.contains("above 0 and at most 1"), "{error}");
    }
}
