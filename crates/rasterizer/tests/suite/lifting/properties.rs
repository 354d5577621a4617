//! What must hold for any scene.

use super::support::{cloud, dense, lifter, picture, rows, uniform, voronoi, weights};
use crate::support::{join, on_threads, one, permute, pinhole};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat_rasterizer::lifting::{
    Aggregate, BlockFeatures, DepthProbe, DepthTolerance, FinaliseSettings, FrameWeight,
    LabelledPicture, LabelledView, LiftError, LiftRule, LiftSettings, Lifter, NO_SEGMENT, Robust,
    SegmentMap, fuse_crops, view_weights,
};
use scenesplat_rasterizer::{
    DepthRequest, Gaussians, RasterSettings, RenderRequest, View, render, render_features,
};
use std::slice::from_ref;

const SIZE: [u32; 2] = [83, 70];

/// Makes the second Gaussian one that cannot be drawn.
type Spoil = fn(&mut Gaussians);
/// Frame, crops, masked crops, and a word of the error.
type BadCrops<'a> = (&'a [f32], &'a [f32], &'a [f32], &'a str);

fn lift(
    gaussians: &Gaussians,
    views: &[View],
    settings: &LiftSettings,
    finalise: &FinaliseSettings,
) -> BlockFeatures {
    let mut lifter = Lifter::new(gaussians, 2, 5, settings.clone()).unwrap();
    for (i, view) in views.iter().enumerate() {
        let seed = i as u64;
        let levels = [voronoi(SIZE, 12, seed), voronoi(SIZE, 30, 100 + seed)];
        lifter.add(&picture(view, &levels, &rows(30, 5, 200 + seed))).unwrap();
    }
    lifter.collect(1, finalise).unwrap()
}

#[test]
fn segments_give_what_features_of_every_pixel_give() {
    // Every channel of every pixel: the weights of one Gaussian are the derivative of a rendered
    // channel with respect to its feature, so W · f is Σ over pixels of that derivative times f.
    let (gaussians, views) = cloud(60, 1, SIZE, 1);
    let view = &views[0];
    let map = voronoi(SIZE, 9, 5);
    let features = rows(9, 4, 6);
    let weights = weights(&gaussians, view, from_ref(&map), LiftRule::AlphaWeighted);
    // One channel per Gaussian: the picture of its weights.
    let n = gaussians.len();
    let mut identity = vec![0.0; n * n];
    (0..n).for_each(|i| identity[i * n + i] = 1.0);
    let pixels =
        render_features(&gaussians, view, &RasterSettings::default(), &identity, n).unwrap();
    let mut expected = vec![0.0f64; n * 4];
    let mut total = vec![0.0f64; n];
    for (pixel, weights) in pixels.chunks_exact(n).enumerate() {
        let id = map.ids()[pixel];
        for (i, &w) in weights.iter().enumerate() {
            total[i] += f64::from(w);
            if id != NO_SEGMENT {
                for c in 0..4 {
                    let f = f64::from(features[usize::from(id) * 4 + c]);
                    expected[i * 4 + c] += f64::from(w) * f;
                }
            }
        }
    }
    let mut got = vec![0.0f64; n * 4];
    for w in &weights.levels[0] {
        for c in 0..4 {
            let f = f64::from(features[w.segment as usize * 4 + c]);
            got[w.gaussian as usize * 4 + c] += f64::from(w.weight) * f;
        }
    }
    for (i, (got, expected)) in got.iter().zip(&expected).enumerate() {
        assert!((got - expected).abs() <= 1e-5 * (1.0 + total[i / 4]), "{i}: {got}, {expected}");
    }
    for &(i, w) in &weights.totals {
        let expected = total[i as usize];
        assert!((f64::from(w) - expected).abs() <= 1e-5 * (1.0 + expected), "{i}: {w}");
    }
    assert!(weights.totals.len() > n / 2);
}

#[test]
fn several_granularities_at_once_are_each_by_itself() {
    let (gaussians, views) = cloud(400, 1, SIZE, 2);
    // A tile with more tuples than a word has bits, and one with a single one.
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let noise = (0..SIZE[0] * SIZE[1]).map(|_| rng.random_range(0..200)).collect();
    let levels = [
        voronoi(SIZE, 5, 1),
        SegmentMap::new(SIZE[0], SIZE[1], noise).unwrap(),
        uniform(SIZE, 3),
        uniform(SIZE, NO_SEGMENT),
    ];
    for rule in [LiftRule::AlphaWeighted, LiftRule::CentrePixel] {
        let run = |levels: &[SegmentMap]| weights(&gaussians, &views[0], levels, rule);
        let all = run(&levels);
        for (level, map) in levels.iter().enumerate() {
            let one = run(from_ref(map));
            assert_eq!(one.levels[0].len(), all.levels[level].len(), "{rule:?} {level}");
            for (a, b) in one.levels[0].iter().zip(&all.levels[level]) {
                assert_eq!((a.gaussian, a.segment), (b.gaussian, b.segment));
                assert!((a.weight - b.weight).abs() <= 1e-5 * a.weight, "{a:?} {b:?}");
            }
        }
        assert!(all.levels[3].is_empty() && !all.levels[1].is_empty());
        // Of one segment everywhere, the labeled weight is all of it.
        assert_eq!(all.levels[2].len(), all.totals.len());
        let pairs = all.levels[2].iter().zip(&all.totals);
        assert!(pairs.clone().all(|(w, t)| w.gaussian == t.0 && w.segment == 3));
        assert!(pairs.clone().all(|(w, t)| (w.weight - t.1).abs() <= 1e-5 * t.1));
    }
}

#[test]
fn the_order_of_gaussians_and_the_numbers_of_segments_do_not_matter() {
    let (gaussians, views) = cloud(300, 1, SIZE, 3);
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut order: Vec<usize> = (0..gaussians.len()).collect();
    order.shuffle(&mut rng);
    let shuffled = permute(&gaussians, &order);
    let map = voronoi(SIZE, 20, 4);
    let mut names: Vec<u16> = (0..20).collect();
    names.shuffle(&mut rng);
    let rename = |&id: &u16| if id == NO_SEGMENT { id } else { names[usize::from(id)] };
    let renamed =
        SegmentMap::new(SIZE[0], SIZE[1], map.ids().iter().map(rename).collect()).unwrap();
    for rule in [LiftRule::AlphaWeighted, LiftRule::CentrePixel] {
        let run = |gaussians: &Gaussians, map: &SegmentMap| {
            dense(&weights(gaussians, &views[0], from_ref(map), rule), 300, 20)
        };
        let (plain, other) = (run(&gaussians, &map), run(&shuffled, &renamed));
        for (new, &old) in order.iter().enumerate() {
            for s in 0..20 {
                let (a, b) = (plain[old * 20 + s], other[new * 20 + usize::from(names[s])]);
                assert!((a - b).abs() <= 1e-5 * (a + b), "{rule:?}: {a} {b}");
            }
        }
        assert!(plain.iter().filter(|&&w| w > 0.0).count() > 100);
    }
}

#[test]
fn two_halves_of_a_picture_are_the_whole() {
    let (mut gaussians, views) = cloud(300, 1, [96, 64], 3);
    // The limit on tangents is nearer in a smaller picture; small Gaussians that it bends are not
    // seen.
    gaussians.scales.iter_mut().flatten().for_each(|s| *s *= 0.2);
    let map = voronoi([96, 64], 20, 4);
    let view = &views[0];
    let run = |view: &View, map: &SegmentMap| {
        dense(&weights(&gaussians, view, from_ref(map), LiftRule::AlphaWeighted), 300, 20)
    };
    let whole = run(view, &map);
    let crop = |from: u32, to: u32| {
        let ids = map.ids().chunks_exact(96).flat_map(|r| &r[from as usize..to as usize]);
        let map = SegmentMap::new(to - from, 64, ids.copied().collect()).unwrap();
        run(&View { cx: view.cx - from as f32, width: to - from, ..*view }, &map)
    };
    let (left, right) = (crop(0, 40), crop(40, 96));
    for ((whole, left), right) in whole.iter().zip(&left).zip(&right) {
        assert!((whole - left - right).abs() <= 1e-4 * (1.0 + whole), "{whole} {left} {right}");
    }
    assert!(whole.iter().filter(|&&w| w > 0.0).count() > 200);
}

#[test]
fn neither_memory_nor_threads_change_a_bit() {
    let (gaussians, views) = cloud(2500, 4, SIZE, 7);
    let run = |memory: u64, threads: usize, (rule, depth), finalise: &FinaliseSettings| {
        let settings = LiftSettings { memory, rule, depth, ..LiftSettings::default() };
        on_threads(threads, || lift(&gaussians, &views, &settings, finalise))
    };
    let (all, own) = (None, Some(DepthTolerance { sigmas: 8.0, ..DepthTolerance::RENDERED }));
    let centre = (LiftRule::CentrePixel, all);
    for rule in [(LiftRule::AlphaWeighted, all), (LiftRule::AlphaWeighted, own), centre] {
        for finalise in [FinaliseSettings::default(), FinaliseSettings::robust()] {
            let plain = run(u64::MAX, 1, rule, &finalise);
            // Each thread has 512 Gaussians of a picture at least.
            assert!(plain.valid.iter().filter(|&&v| v).count() > 500);
            let least = LiftSettings::least_memory(2);
            for (memory, threads) in [(u64::MAX, 3), (least, 1), (least, 4)] {
                assert_eq!(plain, run(memory, threads, rule, &finalise), "{memory} {threads}");
            }
        }
    }
}

#[test]
fn the_spool_goes_to_disk_when_it_must() {
    let (gaussians, views) = cloud(2500, 1, SIZE, 7);
    let least = LiftSettings::least_memory(1);
    let with = |memory| LiftSettings { memory, ..LiftSettings::default() };
    // Less is refused rather than exceeded.
    let error = Lifter::new(&gaussians, 1, 2, with(least - 1)).unwrap_err().to_string();
    assert!(error.contains("memory: 24575 bytes") && error.contains("24576"), "{error}");
    assert!(Lifter::new(&gaussians, 2, 2, with(least)).is_err(), "each granularity has its own");
    let settings = with(least);
    let mut lifter = Lifter::new(&gaussians, 1, 2, settings).unwrap();
    let levels = [voronoi(SIZE, 12, 0)];
    lifter.add(&picture(&views[0], &levels, &rows(12, 2, 1))).unwrap();
    assert!(lifter.num_weights() > 1024 && lifter.bytes_on_disk() > 0);
}

#[test]
fn each_picture_has_a_vote_of_its_size_to_a_power() {
    // Two pictures of one Gaussian, one from nearby: it covers more pixels there.
    let gaussians = one([0.0, 0.0, 2.0], 0.1, 0.8);
    let views = [0.0, 2.0].map(|back| pinhole([64, 64], 64.0, back));
    let mut lifter = lifter(&gaussians, 1, 2);
    let levels = [uniform([64, 64], 0)];
    let mut weight = Vec::new();
    for (view, features) in views.iter().zip([[1.0, 0.0], [0.0, 1.0]]) {
        let report = lifter.add(&picture(view, &levels, &features)).unwrap();
        assert_eq!((report.visible, report.segments), (1, 1));
        assert!((report.weight - report.labelled[0]).abs() < 1e-9);
        weight.push(report.weight);
    }
    assert!(weight[0] > 3.0 * weight[1], "{weight:?}");
    for exponent in [1.0, 0.5, 0.0] {
        let settings = FinaliseSettings { view_exponent: exponent, ..FinaliseSettings::default() };
        let lifted = lifter.collect(0, &settings).unwrap();
        let votes = [0, 1].map(|i: usize| weight[i].powf(f64::from(exponent)));
        let ratio = f64::from(lifted.features[0] / lifted.features[1]);
        assert!((ratio / (votes[0] / votes[1]) - 1.0).abs() < 1e-5, "γ = {exponent}: {ratio}");
        let length = votes[0].hypot(votes[1]) / (votes[0] + votes[1]);
        assert!((f64::from(lifted.confidence[0]) - length).abs() < 1e-6);
        assert_eq!(lifted.views, [2]);
        assert!((f64::from(lifted.coverage[0]) - weight[0] - weight[1]).abs() < 1e-3);
    }
    let coverage = (weight[0] + weight[1]) as f32;
    for (least, valid) in [(coverage * 0.99, true), (coverage * 1.01, false)] {
        let settings = FinaliseSettings { min_coverage: least, ..FinaliseSettings::default() };
        let lifted = lifter.collect(0, &settings).unwrap();
        assert_eq!(lifted.valid, [valid]);
        assert_eq!(lifted.features == [0.0, 0.0], !valid, "rows without a feature are 0");
    }
    assert!(lifter.collect(1, &FinaliseSettings::default()).is_err());
}

fn median_depth(gaussians: &Gaussians, view: &View) -> Vec<f32> {
    let depth = DepthRequest { median: true, ..DepthRequest::default() };
    let request = RenderRequest { depth, ..RenderRequest::default() };
    render(gaussians, view, &RasterSettings::default(), &request).unwrap().depth_median.unwrap()
}

#[test]
fn only_pixels_whose_depth_agrees_label_a_gaussian() {
    // A floater in front of a wall; the picture's depth is that of the wall.
    let mut gaussians = join(one([0.0, 0.0, 1.0], 0.05, 0.3), &one([0.0, 0.0, 3.0], 0.5, 0.9));
    gaussians.scales[1][2] = 0.01;
    let view = pinhole([40, 40], 40.0, 0.0);
    let levels = [uniform([40, 40], 0)];
    let near = 3.0 * 1.03 + 0.05;
    for rule in [LiftRule::AlphaWeighted, LiftRule::CentrePixel] {
        let weights = |depth: &[f32]| {
            let depth = Some((depth, DepthTolerance::default()));
            let picture = LabelledView { view: &view, levels: &levels, depth };
            view_weights(&gaussians, &picture, rule, &RasterSettings::default()).unwrap()
        };
        let labelled = |depth: f32| {
            let weights = weights(&vec![depth; 1600]);
            assert_eq!(weights.totals.len(), 2, "what is seen does not change");
            weights.levels[0].iter().map(|w| w.gaussian).collect::<Vec<_>>()
        };
        assert_eq!(labelled(3.0), [1]);
        assert_eq!(labelled(1.0), [0]);
        assert_eq!(labelled(near - 1e-3), [1]);
        assert_eq!(labelled(near + 0.1), [] as [u32; 0]);
        for none in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(labelled(none).is_empty(), "{none} is no depth");
        }
    }
    // Without a depth of its own, the picture takes the median one of the render: the wall's, since
    // the floater hides less than half of it.
    let settings =
        LiftSettings { depth: Some(DepthTolerance::default()), ..LiftSettings::default() };
    let mut lifter = Lifter::new(&gaussians, 1, 1, settings).unwrap();
    lifter.add(&picture(&view, &levels, &[1.0])).unwrap();
    assert_eq!(lifter.collect(0, &FinaliseSettings::default()).unwrap().valid, [false, true]);
    assert!((median_depth(&gaussians, &view)[20 * 40 + 20] - 3.0).abs() < 1e-5);
}

#[test]
fn the_depth_of_the_scene_is_the_rendered_one_and_the_probe_compares_it_with_none() {
    let (gaussians, views) = cloud(700, 5, SIZE, 31);
    let tolerance = DepthTolerance { relative: 0.02, absolute: 0.01, sigmas: 0.5 };
    let with = |depth| LiftSettings { depth, ..LiftSettings::default() };
    let new = |depth| Lifter::new(&gaussians, 1, 5, with(depth)).unwrap();
    let (mut own, mut given, mut all) = (new(Some(tolerance)), new(Some(tolerance)), new(None));
    let mut probe = DepthProbe::new(&gaussians, 5, &with(Some(tolerance))).unwrap();
    let (mut kept, mut total) = (0.0, 0.0);
    for (i, view) in views.iter().enumerate() {
        let map = [voronoi(SIZE, 12, i as u64)];
        let features = rows(12, 5, 40 + i as u64);
        let picture = picture(view, &map, &features);
        let depth = median_depth(&gaussians, view);
        kept += own.add(&picture).unwrap().labelled[0];
        given.add(&LabelledPicture { depth: Some(&depth), ..picture }).unwrap();
        total += all.add(&picture).unwrap().labelled[0];
        probe.add(&picture).unwrap();
    }
    let collect = |lifter: &mut Lifter<'_>| lifter.collect(0, &FinaliseSettings::default());
    let (own, given) = (collect(&mut own).unwrap(), collect(&mut given).unwrap());
    assert!(own == given, "a depth taken on the way differs from the rendered one");
    assert!(own != collect(&mut all).unwrap());
    let effect = probe.effect().unwrap();
    assert_eq!(effect.kept, kept / total);
    assert!(effect.kept > 0.1 && effect.kept < 0.9 && effect.gaussians > 100, "{effect:?}");
    // Segments drawn by lot: nobody knows what is right, and depth agreement stays off.
    assert!(effect.misleading.is_none() && !effect.helps(), "{effect:?}");
}

#[test]
fn disagreement_is_0_for_equal_labels_and_1_for_random_ones() {
    let (gaussians, views) = cloud(800, 8, SIZE, 11);
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut measure = |wrong: f64| {
        let mut lifter = lifter(&gaussians, 1, 16);
        let table = rows(8, 16, 5);
        let map = voronoi(SIZE, 8, 3);
        // The same picture again and again, its segments named anew.
        for _ in 0..8 {
            let mut features = table.clone();
            for own in 0..8 {
                if rng.random_bool(wrong) {
                    let other = rng.random_range(0..8);
                    features[own * 16..(own + 1) * 16]
                        .copy_from_slice(&table[other * 16..(other + 1) * 16]);
                }
            }
            lifter.add(&picture(&views[0], from_ref(&map), &features)).unwrap();
        }
        let measured = lifter.disagreement(0).unwrap();
        assert!(measured.gaussians() > 300);
        measured.value().unwrap()
    };
    let (none, some, all) = (measure(0.0), measure(0.2), measure(1.0));
    println!("disagreement: {none:.3} {some:.3} {all:.3}");
    // With a fifth drawn by lot from 8, two names differ with probability 1 − (0.825² + 7 · 0.025²).
    assert!(none < 1e-6 && (0.15..0.5).contains(&some) && (0.7..1.3).contains(&all));
    let same = vec![1.0; 4];
    let mut lifter = lifter(&gaussians, 1, 4);
    assert_eq!(lifter.disagreement(0).unwrap().value(), None, "nothing was seen");
    for view in &views {
        lifter.add(&picture(view, &[uniform(SIZE, 0)], &same)).unwrap();
    }
    assert_eq!(lifter.disagreement(0).unwrap().value(), None, "all have one feature");
    assert!(!Robust::default().decide(None) && Robust::default().decide(Some(0.3)));
    assert!(Robust::On.decide(None) && !Robust::Off.decide(Some(1.0)));
}

#[test]
fn scenes_without_rows_and_gaussians_that_cannot_be_drawn() {
    let empty = Gaussians { sh_degree: 0, ..Gaussians::default() };
    let (gaussians, views) = cloud(1, 1, SIZE, 1);
    let levels = [voronoi(SIZE, 3, 1)];
    let table = rows(3, 2, 1);
    let picture = picture(&views[0], &levels, &table);
    let mut none = lifter(&empty, 1, 2);
    let report = none.add(&picture).unwrap();
    assert_eq!((report.visible, report.segments), (0, 0));
    assert_eq!(none.collect(0, &FinaliseSettings::default()).unwrap().valid.len(), 0);

    // Clean ones with hostile ones among them: the same features for the clean.
    let hostile: [(Spoil, &str); 7] = [
        (|g| g.means[1][0] = f32::NAN, "mean"),
        (|g| g.means[1][2] = f32::INFINITY, "mean"),
        (|g| g.quats[1] = [0.0; 4], "quat"),
        (|g| g.scales[1][1] = f32::NAN, "scale"),
        (|g| g.scales[1] = [f32::INFINITY; 3], "scale"),
        (|g| g.opacities[1] = f32::NAN, "opacity"),
        (|g| g.opacities[1] = 0.0, "opacity"),
    ];
    for (spoil, name) in hostile {
        let mut bad = permute(&gaussians, &[0; 3]);
        bad.opacities[2] = -1.0;
        spoil(&mut bad);
        let features = |gaussians: &Gaussians| {
            let mut lifter = lifter(gaussians, 1, 2);
            lifter.add(&picture).unwrap();
            lifter.collect(0, &FinaliseSettings::default()).unwrap()
        };
        let (clean, bad) = (features(&gaussians), features(&bad));
        assert_eq!(bad.features[..2], clean.features[..], "{name}");
        assert_eq!(bad.features[2..], [0.0; 4], "{name}");
        assert_eq!(bad.valid, [true, false, false], "{name}");
        assert_eq!(bad.views[1..], [0, 0]);
    }
}

#[test]
fn what_does_not_fit_together_is_refused_by_name() {
    let (gaussians, views) = cloud(3, 1, SIZE, 1);
    let levels = [voronoi(SIZE, 3, 1)];
    let small = [voronoi([20, 20], 3, 1)];
    let table = rows(3, 2, 1);
    let good = picture(&views[0], &levels, &table);
    let refused = |picture: &LabelledPicture<'_>, settings: &LiftSettings, about: &str| {
        let mut lifter = Lifter::new(&gaussians, 1, 2, settings.clone()).unwrap();
        let error = lifter.add(picture).unwrap_err();
        assert!(error.to_string().contains(about), "{error}");
        assert_eq!(lifter.num_weights(), 0, "nothing is added by halves");
    };
    let plain = LiftSettings::default();
    refused(&LabelledPicture { levels: &small, ..good }, &plain, "is 20×20, the camera 83×70");
    refused(&LabelledPicture { levels: &[], ..good }, &plain, "0 maps, 1 are expected");
    refused(&LabelledPicture { features: &table[..5], ..good }, &plain, "5 values");
    refused(&LabelledPicture { features: &table[..4], ..good }, &plain, "id 2, there are 2");
    let nan = [f32::NAN; 6];
    refused(&LabelledPicture { features: &nan, ..good }, &plain, "not finite");
    let depth = LiftSettings { depth: Some(DepthTolerance::default()), ..plain.clone() };
    let short = [1.0; 7];
    refused(&LabelledPicture { depth: Some(&short), ..good }, &depth, "has 7 values");
    let mirrored = View { world_to_camera: [[-1., 0., 0., 0.]; 3], ..views[0] };
    refused(&LabelledPicture { view: &mirrored, ..good }, &plain, "rotation");

    let new = |levels, dim, settings: LiftSettings| Lifter::new(&gaussians, levels, dim, settings);
    for (levels, dim) in [(0, 2), (5, 2), (1, 0), (1, usize::MAX)] {
        assert!(matches!(new(levels, dim, plain.clone()), Err(LiftError::Argument { .. })));
    }
    let tolerance = Some(DepthTolerance { relative: 1.0, absolute: 0.0, sigmas: 0.0 });
    assert!(new(1, 2, LiftSettings { depth: tolerance, ..plain.clone() }).is_err());
    let bad: [FinaliseSettings; 4] = [
        FinaliseSettings { view_exponent: -0.1, ..FinaliseSettings::default() },
        FinaliseSettings { min_coverage: f32::NAN, ..FinaliseSettings::default() },
        FinaliseSettings { min_labelled_share: 1.5, ..FinaliseSettings::default() },
        FinaliseSettings {
            aggregate: Aggregate::HeaviestGroup { cosine: f32::NAN },
            ..FinaliseSettings::default()
        },
    ];
    for settings in bad {
        assert!(new(1, 2, plain.clone()).unwrap().collect(0, &settings).is_err());
    }
}

#[test]
fn a_segment_without_a_feature_labels_nothing() {
    let (gaussians, views) = cloud(50, 1, SIZE, 1);
    let levels = [voronoi(SIZE, 3, 1)];
    let mut lifter = lifter(&gaussians, 1, 2);
    let report = lifter.add(&picture(&views[0], &levels, &[0.0; 6])).unwrap();
    assert_eq!((report.segments, report.without_feature), (0, 3));
    assert!(report.weight > 0.0 && report.labelled == [0.0]);
    let table = [1.0, 0.0, 0.0, 0.0, 1e30, 1e30];
    let report = lifter.add(&picture(&views[0], &levels, &table)).unwrap();
    assert_eq!((report.segments, report.without_feature), (2, 1));
    let lifted = lifter.collect(0, &FinaliseSettings::default()).unwrap();
    let share = FinaliseSettings { min_labelled_share: 0.9, ..FinaliseSettings::default() };
    let strict = lifter.collect(0, &share).unwrap();
    let count = |lifted: &BlockFeatures| lifted.valid.iter().filter(|&&v| v).count();
    assert!(count(&lifted) > 0 && count(&strict) == 0, "half of the pictures label nothing");
}

#[test]
fn fusion_of_hard_crops() {
    let fuse = |frame: &[f32], crops: &[f32], masked: &[f32]| {
        fuse_crops(frame, crops, masked, FrameWeight::Softmax)
    };
    // No segment, one segment: the softmax of one would leave nothing of it.
    assert_eq!(fuse(&[1.0, 0.0], &[], &[]).unwrap().features, [] as [f32; 0]);
    let one = fuse(&[0.0, 5.0], &[3.0, 0.0], &[1e-20, 0.0]).unwrap();
    assert!(one.single_segment && one.frame_weight == [0.5], "φ = 0: {one:?}");
    let side = std::f32::consts::FRAC_1_SQRT_2;
    assert!((one.features[0] - side).abs() < 1e-6 && (one.features[1] - side).abs() < 1e-6);
    // Equal segments share the frame.
    let two = fuse(&[0.0, 1.0], &[1.0, 0.0, 2.0, 0.0], &[1.0, 0.0, 1e30, 0.0]).unwrap();
    assert!(!two.single_segment && two.frame_weight == [0.5, 0.5]);
    assert_eq!(two.features[..2], two.features[2..]);
    // A crop that is the opposite of itself without surroundings: r = −1.
    let opposite = fuse(&[0.0, 1.0], &[1.0, 0.0, 1.0, 0.0], &[-1.0, 0.0, 1.0, 0.0]).unwrap();
    assert_eq!(opposite.crop_agreement, [-1.0, 1.0]);
    assert!(opposite.features.iter().all(|v| v.is_finite()));
    let bad: [BadCrops<'_>; 5] = [
        (&[], &[], &[], "expected"),
        (&[1.0, 0.0], &[1.0], &[1.0], "expected"),
        (&[1.0, 0.0], &[1.0, 0.0], &[], "expected"),
        (&[0.0, 0.0], &[1.0, 0.0], &[1.0, 0.0], "frame: row 0"),
        (&[1.0, 0.0], &[1.0, 0.0, f32::NAN, 0.0], &[1.0, 0.0, 1.0, 0.0], "crops: row 1"),
    ];
    for (frame, crops, masked, about) in bad {
        let error = fuse(frame, crops, masked).unwrap_err().to_string();
        assert!(error.contains(about), "{error}");
    }
}
