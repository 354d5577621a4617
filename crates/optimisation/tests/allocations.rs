//! Steps reserve no memory that grows with the scene or its pictures. A program of its own, because it counts what
//! the global allocator is asked for.
#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

use scenesplat_optimisation::initial::{InitialSettings, from_points};
use scenesplat_optimisation::{
    BaseRates, Colors, Model, OptimiseSettings, Optimiser, Strategy, TrainingFrame,
};
use scenesplat_rasterizer::View;
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Bytes asked for so far.
static ASKED: AtomicUsize = AtomicUsize::new(0);

struct Counting;

// SAFETY: everything is handed on to the system's allocator as it is.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ASKED.fetch_add(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        ASKED.fetch_add(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller's promise.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, old: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ASKED.fetch_add(size, Ordering::Relaxed);
        // SAFETY: the caller's promise.
        unsafe { System.realloc(old, layout, size) }
    }

    unsafe fn dealloc(&self, old: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(old, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A wavy wall.
fn wall(side: usize) -> Model {
    let at = |i: usize| {
        let (x, y) = ((i % side) as f32 / side as f32, (i / side) as f32 / side as f32);
        [2.0 * x - 1.0, 2.0 * y - 1.0, 2.0 + 0.2 * (9.0 * x).sin() * (7.0 * y).cos()]
    };
    let points: Vec<[f32; 3]> = (0..side * side).map(at).collect();
    let colors = vec![[0.3, 0.5, 0.7]; points.len()];
    let settings = InitialSettings { opacity: 0.5, scale: 1.0, sh_degree: 1, random_quats: true };
    from_points(&points, &colors, &settings, 1).unwrap()
}

fn frame(i: usize, size: u32) -> TrainingFrame {
    let shift = 0.1 * i as f32;
    let view = View {
        world_to_camera: [[1., 0., 0., shift], [0., 1., 0., 0.], [0., 0., 1., 0.]],
        fx: size as f32,
        fy: size as f32,
        cx: size as f32 / 2.0,
        cy: size as f32 / 2.0,
        width: size,
        height: size,
    };
    let pixels = view.pixels();
    let rgb = Colors::Bytes((0..3 * pixels).map(|k| (k * 37 % 251) as u8).collect());
    TrainingFrame {
        name: format!("{i}"),
        view,
        rgb,
        alpha: None,
        depth: Some(vec![2.0; pixels]),
        mask: None,
    }
}

/// The most bytes of one step, once every frame has been seen.
fn most_of_a_step(side: usize, size: u32, half_steps: u64) -> usize {
    let frames: Vec<_> = (0..3).map(|i| frame(i, size)).collect();
    let still = BaseRates {
        means: 0.0,
        scales: 0.0,
        quats: 0.0,
        opacities: 0.0,
        sh0: 0.0,
        sh_rest: 0.0,
        ..BaseRates::default()
    };
    let base = OptimiseSettings::scenesplat();
    let initial = InitialSettings { sh_degree: 1, ..base.initial };
    let settings = OptimiseSettings {
        strategy: Strategy::Fixed,
        rates: still,
        sh_every: 0,
        initial,
        half_steps,
        ..base
    };
    let mut optimiser = Optimiser::new(wall(side), &frames, settings).unwrap();
    let mut most = 0;
    for step in 0..12 {
        let before = ASKED.load(Ordering::Relaxed);
        optimiser.step(&frames).unwrap();
        if step >= 6 {
            most = most.max(ASKED.load(Ordering::Relaxed) - before);
        }
    }
    most
}

/// The scene stays as it is, so that no list grows. What is left are the places of tasks: a few dozen bytes
/// per 2,048 Gaussians and per four tiles. One picture here has 786,432 bytes of color.
#[test]
fn steps_use_their_memory_again() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for half_steps in [0, 100] {
        let small = pool.install(|| most_of_a_step(40, 64, half_steps));
        let large = pool.install(|| most_of_a_step(160, 256, half_steps));
        println!("bytes of a step: {small} of 1,600 Gaussians, {large} of 25,600");
        assert!(small < 16 << 10, "{small} bytes with {half_steps} half steps");
        assert!(large < 64 << 10, "{large} bytes with {half_steps} half steps");
    }
}
