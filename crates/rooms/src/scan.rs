//! How one scan differs from another, and its objects among each other, whatever they are.

use crate::dice::{between, chance, noise, whole};
use crate::splats::{Look, holes_in, rounded_ln};
use crate::vector::V3;
use scenesplat_kernels::random::SampleRng;

/// What a scan varies of a room.
#[derive(Debug)]
pub(crate) struct Scan {
    /// Factor of the number of Gaussians.
    pub(crate) density: f64,
    pub(crate) objects: Vec<ScannedObject>,
    /// Share of the Gaussians that lie below the floor, and how deep, meters.
    pub(crate) below: f64,
    pub(crate) deep: f64,
    shrink: f64,
    opacity: [f64; 2],
    rough: f64,
    strays: f64,
    tilt: f64,
    floaters: f64,
    holes: Vec<(V3, f64)>,
    /// Of a simulator: the light around, there is no other, and its gain.
    light: Option<[f64; 2]>,
}

/// What a scan varies of an object.
#[derive(Debug)]
pub(crate) struct ScannedObject {
    /// Gaussians per area, 1 on average.
    pub(crate) density: f64,
    /// Logarithm of what they are larger by.
    pub(crate) ln_size: f64,
    /// Whether it is of one color, whatever its texture.
    pub(crate) is_plain: bool,
}

/// A factor between two others, evenly in its logarithm; in steps, as libraries disagree about the last
/// bit.
fn factor(rng: &mut SampleRng, low: f64, high: f64) -> f64 {
    const STEPS: f64 = 16_777_216.0;
    let factor = between(rng, rounded_ln(low), rounded_ln(high)).exp();
    (factor * STEPS).round() / STEPS
}

/// A density of each object, whatever it is: Gaussians per area, about 1 on average.
pub(crate) fn densities(num_objects: usize, rng: &mut SampleRng) -> Vec<f64> {
    (0..num_objects).map(|_| factor(rng, 0.35, 2.8)).collect()
}

impl Scan {
    pub(crate) fn new(size: V3, num_objects: usize, rng: &mut SampleRng) -> Self {
        let is_rough = chance(rng, 0.35);
        let is_mirrored = chance(rng, 0.5);
        let holes = whole(rng, 0, 8);
        Self {
            density: factor(rng, 0.125, 2.0),
            below: if is_mirrored { between(rng, 0.002, 0.03) } else { 0.0 },
            deep: between(rng, 0.05, 0.6),
            shrink: factor(rng, 0.22, 2.2),
            opacity: [between(rng, -2.2, 4.0), between(rng, 0.8, 2.2)],
            rough: if is_rough { between(rng, 0.006, 0.02) } else { between(rng, 0.0, 0.006) },
            strays: between(rng, 0.0, 0.12),
            tilt: factor(rng, 0.02, 0.4),
            floaters: factor(rng, 0.0005, 0.02),
            holes: holes_in(size, holes, 1.0, rng),
            objects: (0..num_objects)
                .map(|_| ScannedObject {
                    density: factor(rng, 0.5, 1.8),
                    ln_size: 0.15 * noise(rng),
                    is_plain: false,
                })
                .collect(),
            light: None,
        }
    }

    /// As points of a depth camera differ before it looks: one density for all objects, any light.
    pub(crate) fn of_depth(num_objects: usize, rng: &mut SampleRng) -> Self {
        let light = [between(rng, 0.55, 1.0), between(rng, 0.9, 1.05)];
        let one = || ScannedObject { density: 1.0, ln_size: 0.0, is_plain: false };
        Self {
            density: factor(rng, 1.0, 2.5),
            objects: (0..num_objects).map(|_| one()).collect(),
            light: Some(light),
            ..Self::of_models(0, rng)
        }
    }

    /// As points of the models of a simulator differ: a density of each object, whatever it is, hardly any
    /// light, and most things of one color.
    pub(crate) fn of_models(num_objects: usize, rng: &mut SampleRng) -> Self {
        let plain = between(rng, 0.3, 1.0);
        Self {
            density: factor(rng, 0.4, 3.0),
            below: 0.0,
            deep: 0.0,
            shrink: factor(rng, 0.4, 1.1),
            opacity: [0.0; 2],
            rough: 0.0,
            strays: 0.0,
            tilt: 0.0,
            floaters: 0.0,
            holes: Vec::new(),
            light: Some([
                if chance(rng, 0.8) { 1.0 } else { between(rng, 0.6, 0.92) },
                between(rng, 0.85, 1.05),
            ]),
            objects: (0..num_objects)
                .map(|_| ScannedObject {
                    density: factor(rng, 0.35, 2.8),
                    ln_size: 0.0,
                    is_plain: chance(rng, plain),
                })
                .collect(),
        }
    }

    /// The look of the room, as this scan has it.
    pub(crate) fn change(&self, look: &mut Look) {
        look.shrink = self.shrink;
        if let Some([ambient, gain]) = self.light {
            look.ambient = ambient;
            look.gain = [gain; 3];
            return;
        }
        look.opacity = self.opacity;
        look.rough = self.rough;
        look.strays = self.strays;
        look.tilt = self.tilt;
        look.is_spelled_anyhow = true;
        if !look.is_points {
            look.floaters = self.floaters;
            look.holes.clone_from(&self.holes);
        }
    }
}
