//! Labels of panes and of what is behind them.

use super::support::picture;
use crate::support::pinhole;
use scenesplat_rasterizer::lifting::{
    DepthTolerance, FinaliseSettings, LiftSettings, Lifter, Panes, SegmentMap,
};
use scenesplat_rasterizer::{Gaussians, View};
use std::ops::Range;
use std::slice::from_ref;

const W: u32 = 64;
const H: u32 = 48;
/// One axis per segment.
const FEATURES: [f32; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
/// Where the pane shows in the pictures.
const PANE: [Range<u32>; 2] = [22..42, 14..34];

/// A wall 4 before the camera, a faint pane of one meter 2 before it, and maybe a board 1 before it.
fn world(board: bool) -> (Gaussians, Panes, Range<usize>) {
    let mut means = Vec::new();
    for i in 0..900 {
        means.push([0.15 * (i % 30) as f32 - 2.2, 0.15 * (i / 30) as f32 - 2.2, 4.0]);
    }
    let sheet = means.len()..means.len() + 100;
    for i in 0..100 {
        means.push([0.1 * (i % 10) as f32 - 0.45, 0.1 * (i / 10) as f32 - 0.45, 2.0]);
    }
    if board {
        for i in 0..400 {
            means.push([0.04 * (i % 20) as f32 - 0.38, 0.04 * (i / 20) as f32 - 0.38, 1.0]);
        }
    }
    let n = means.len();
    let is_sheet: Vec<bool> = (0..n).map(|i| sheet.contains(&i)).collect();
    let gaussians = Gaussians {
        quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
        scales: means.iter().map(|p| [0.02 * p[2], 0.02 * p[2], 0.001]).collect(),
        opacities: is_sheet.iter().map(|is| if *is { 0.12 } else { 0.97 }).collect(),
        sh: vec![0.0; 3 * n],
        sh_degree: 0,
        means,
    };
    let balls = gaussians.means[sheet.clone()].iter().map(|[x, y, z]| [*x, *y, *z, 0.08]);
    let mut is_doubtful = vec![false; n];
    is_doubtful[435] = true;
    let panes = Panes { is_sheet, is_doubtful, balls: vec![balls.collect()] };
    (gaussians, panes, sheet)
}

fn view() -> View {
    pinhole([W, H], 40.0, 0.0)
}

/// 0 everywhere, `id` in a part of it.
fn map(id: u16, part: &[Range<u32>; 2]) -> SegmentMap {
    let inside = |i: u32| part[0].contains(&(i % W)) && part[1].contains(&(i / W));
    SegmentMap::new(W, H, (0..W * H).map(|i| if inside(i) { id } else { 0 }).collect()).unwrap()
}

/// Features of all Gaussians, confidences, and pictures in two layers.
fn lift(
    gaussians: &Gaussians,
    panes: Option<&Panes>,
    maps: &[SegmentMap],
    depth: Option<DepthTolerance>,
) -> (Vec<[f32; 3]>, Vec<f32>, usize) {
    let settings = LiftSettings { depth, ..LiftSettings::default() };
    let mut lifter = Lifter::new(gaussians, 1, 3, settings).unwrap();
    if let Some(panes) = panes {
        lifter = lifter.with_panes(panes.clone()).unwrap();
    }
    for map in maps {
        lifter.add(&picture(&view(), from_ref(map), &FEATURES)).unwrap();
    }
    let lifted = lifter.collect(0, &FinaliseSettings::default()).unwrap();
    let rows = lifted.features.as_chunks::<3>().0.to_vec();
    (rows, lifted.confidence, lifter.num_through_panes())
}

/// Rows of the wall right behind the pane's middle.
const BEHIND: [usize; 4] = [434, 435, 464, 465];

#[test]
fn a_pane_has_its_own_labels_and_what_is_behind_it_too() {
    let (gaussians, panes, sheet) = world(false);
    // One picture names the pane, the other what is seen through it.
    let maps = [map(1, &PANE), map(0, &PANE)];
    for depth in [None, Some(DepthTolerance::RENDERED)] {
        let (one, _, count) = lift(&gaussians, None, &maps, depth);
        assert_eq!(count, 0);
        // In one layer the wall is half a pane, and the pane half a wall, or without a label.
        BEHIND.iter().for_each(|&i| assert!(one[i][1] > 0.5, "{:?}", one[i]));
        assert!(sheet.clone().all(|i| one[i][1] < 0.8), "{:?}", one[sheet.start + 44]);
        let (two, confidence, count) = lift(&gaussians, Some(&panes), &maps, depth);
        assert_eq!(count, 2);
        BEHIND.iter().for_each(|&i| assert_eq!(two[i], [1.0, 0.0, 0.0]));
        let own = sheet.clone().filter(|&i| two[i] == [0.0, 1.0, 0.0]).count();
        assert!(own == sheet.len(), "{own}");
        // What may be a mirror image is as right, and less sure.
        assert!((confidence[435] - 0.25).abs() < 1e-6 && confidence[434] > 0.999);
    }
}

#[test]
fn what_is_smaller_or_larger_than_the_pane_is_behind_it() {
    let (gaussians, panes, sheet) = world(false);
    // A thing seen through the pane; and a thing that the pane is a small part of.
    let maps = [map(2, &[28..36, 20..28]), map(2, &[12..54, 4..44])];
    for map in maps {
        for depth in [None, Some(DepthTolerance::RENDERED)] {
            let (two, _, count) = lift(&gaussians, Some(&panes), from_ref(&map), depth);
            assert_eq!(count, 1);
            BEHIND.iter().for_each(|&i| assert_eq!(two[i], [0.0, 0.0, 1.0]));
            assert!(sheet.clone().all(|i| two[i] == [0.0; 3]));
        }
    }
}

#[test]
fn a_level_is_lifted_the_same_beside_another() {
    let (gaussians, panes, _) = world(false);
    // A large thing that the pane is a small part of; and the same picture with the pane named.
    let (large, named) = (map(2, &[12..54, 4..44]), map(1, &PANE));
    for depth in [None, Some(DepthTolerance::RENDERED)] {
        let lifted = |levels: &[SegmentMap], level: usize| {
            let settings = LiftSettings { depth, ..LiftSettings::default() };
            let mut lifter = Lifter::new(&gaussians, levels.len(), 3, settings).unwrap();
            lifter = lifter.with_panes(panes.clone()).unwrap();
            lifter.add(&picture(&view(), levels, &FEATURES)).unwrap();
            let lifted = lifter.collect(level, &FinaliseSettings::default()).unwrap();
            (lifted.features, lifted.confidence)
        };
        let alone = lifted(from_ref(&large), 0);
        assert_eq!(lifted(&[named.clone(), large.clone()], 1), alone, "{depth:?}");
    }
}

#[test]
fn pictures_without_a_pane_are_what_they_were() {
    let (gaussians, panes, _) = world(true);
    let maps = [map(1, &PANE)];
    for depth in [None, Some(DepthTolerance::RENDERED)] {
        let plain = lift(&gaussians, None, &maps, depth);
        let sure = |confidence: &[f32]| [confidence[0], confidence[434], confidence[1100]];
        // The board hides all of it.
        let hidden = lift(&gaussians, Some(&panes), &maps, depth);
        assert_eq!((&hidden.0, sure(&hidden.1), hidden.2), (&plain.0, sure(&plain.1), 0));
        let mut elsewhere = panes.clone();
        elsewhere.balls[0].iter_mut().for_each(|ball| ball[2] = -2.0);
        let away = lift(&gaussians, Some(&elsewhere), &maps, depth);
        assert_eq!((&away.0, away.2), (&plain.0, 0));
    }
    let lifter = Lifter::new(&gaussians, 1, 3, LiftSettings::default()).unwrap();
    let short = Panes { is_sheet: vec![false; 3], ..panes };
    let error = lifter.with_panes(short).unwrap_err().to_string();
    assert!(error.contains("3 rows, there are 1400 Gaussians"), "{error}");
}
