//! A furnished room made of Gaussians, from a seed: data without files.
//!
//! The room is as large as its number of Gaussians calls for, so that 2 cm voxels are about as
//! full as in captured scenes. Same settings, same bits, on any machine: all values come from
//! operations that IEEE 754 rounds exactly, except the logarithm of scales, which is rounded.

mod furniture;
mod surface;

use crate::DataError;
use crate::rng::{SampleRng, cos_sin, direction, normal, sample_rng, unit};
use furniture::furnish;
use scenesplat_scene::GaussianScene;
use scenesplat_scene::gaussian_scene::u8_to_dc;
use surface::Surface;

/// Names of the classes of generated rooms; `segment` is the index.
pub const CLASS_NAMES: [&str; 13] = [
    "wall",
    "floor",
    "ceiling",
    "table",
    "chair",
    "sofa",
    "bookshelf",
    "lamp",
    "plant",
    "ball",
    "rug",
    "door",
    "picture",
];

/// Most Gaussians of a room: beyond, a room would have no realistic size.
pub const MAX_GAUSSIANS: usize = 20_000_000;

/// Room height, metres.
const HEIGHT: f64 = 2.6;

/// Width of the smallest room that its furniture fits into, metres.
const MIN_WIDTH: f64 = 2.4;

/// Gaussians per square metre of surface that a captured scene has: about 2 per 2 cm voxel, with
/// 1.3 voxels per 2 cm × 2 cm because surfaces are noisy.
const DENSITY: f64 = 5500.0;

/// Share of Gaussians that float in the air, as in captured scenes.
const FLOATERS: f64 = 0.002;

/// Which room.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RoomSettings {
    /// Number of Gaussians; also decides the size of the room.
    pub num_gaussians: usize,
    /// Changes layout, colours and noise.
    pub seed: u64,
}

impl Default for RoomSettings {
    fn default() -> Self {
        Self { num_gaussians: 100_000, seed: 0 }
    }
}

/// A room and what is in it.
#[derive(Debug, Clone, PartialEq)]
pub struct GeneratedRoom {
    /// The Gaussians, with normals, `segment` and `instance`; +z is up, the floor at z = 0.
    /// Floaters have the labels −1.
    pub scene: GaussianScene,
    /// Extent of the room, metres.
    pub size: [f32; 3],
    /// Number of objects; instance ids are below it.
    pub num_instances: usize,
}

/// Generates a room.
///
/// # Errors
/// If more than [`MAX_GAUSSIANS`] are asked for.
pub fn generate_room(settings: &RoomSettings) -> Result<GeneratedRoom, DataError> {
    let n = settings.num_gaussians;
    if n > MAX_GAUSSIANS {
        return Err(DataError::Setting {
            setting: "num_gaussians",
            value: n.to_string(),
            expected: "at most 20000000",
        });
    }
    let size = room_size(n);
    let layout = furnish(size, &mut sample_rng(settings.seed, 0, 0));
    let mut rng = sample_rng(settings.seed, 0, 1);
    let num_floaters = (n as f64 * FLOATERS) as usize;
    let counts = shares(&layout.surfaces, n - num_floaters);

    let mut rows = Rows::with_capacity(n);
    for (surface, &count) in layout.surfaces.iter().zip(&counts) {
        let spacing = (surface.area() / count.max(1) as f64).sqrt();
        for _ in 0..count {
            rows.push_on(surface, spacing, &mut rng);
        }
    }
    for _ in 0..num_floaters {
        rows.push_floater(size, &mut rng);
    }
    rows.scene.normal = Some(rows.normal);
    rows.scene.segment = Some(rows.segment);
    rows.scene.instance = Some(rows.instance);
    Ok(GeneratedRoom {
        scene: rows.scene,
        size: size.map(|v| v as f32),
        num_instances: layout.num_instances,
    })
}

/// Extent of the room whose surfaces, furniture included, take `n` Gaussians at the usual density.
fn room_size(n: usize) -> [f64; 3] {
    // With width b and length 1.2 b: floor, ceiling and about as much furniture again, 3.8 b², and
    // the walls, 4.4 b · height.
    let area = n as f64 / DENSITY;
    let (square, linear) = (3.8, 4.4 * HEIGHT);
    let width = ((linear * linear + 4.0 * square * area).sqrt() - linear) / (2.0 * square);
    let width = width.max(MIN_WIDTH);
    [1.2 * width, width, HEIGHT]
}

/// Splits `n` over surfaces by area times density; the largest remainders get the rest.
fn shares(surfaces: &[Surface], n: usize) -> Vec<usize> {
    let weights: Vec<f64> = surfaces.iter().map(|s| s.area() * s.density).collect();
    let total: f64 = weights.iter().sum();
    let exact: Vec<f64> = weights.iter().map(|w| w / total * n as f64).collect();
    let mut counts: Vec<usize> = exact.iter().map(|&e| e as usize).collect();
    let mut by_remainder: Vec<usize> = (0..surfaces.len()).collect();
    by_remainder.sort_by(|&a, &b| exact[b].fract().total_cmp(&exact[a].fract()).then(a.cmp(&b)));
    let rest = n - counts.iter().sum::<usize>().min(n);
    for &surface in by_remainder.iter().cycle().take(rest) {
        counts[surface] += 1;
    }
    counts
}

struct Rows {
    scene: GaussianScene,
    normal: Vec<[f32; 3]>,
    segment: Vec<i32>,
    instance: Vec<i32>,
}

struct Splat {
    coord: [f64; 3],
    /// Standard deviations: two in the surface, one along the normal.
    scale: [f64; 3],
    normal: [f64; 3],
    opacity_logit: f64,
    color: [f64; 3],
    segment: i32,
    instance: i32,
}

impl Rows {
    fn with_capacity(n: usize) -> Self {
        let scene = GaussianScene {
            coord: Vec::with_capacity(n),
            log_scale: Vec::with_capacity(n),
            quat: Vec::with_capacity(n),
            opacity_logit: Vec::with_capacity(n),
            sh_dc: Vec::with_capacity(n),
            ..GaussianScene::default()
        };
        Self {
            scene,
            normal: Vec::with_capacity(n),
            segment: Vec::with_capacity(n),
            instance: Vec::with_capacity(n),
        }
    }

    fn push_on(&mut self, surface: &Surface, spacing: f64, rng: &mut SampleRng) {
        let point = surface.sample(rng);
        // A captured surface is a few millimetres thick, with some rows well off it.
        let off = normal(rng) * if unit(rng) < 0.03 { 0.02 } else { 0.003 };
        let wide = spacing * (0.45 + 0.6 * unit(rng));
        let long = wide * (0.7 + 0.9 * unit(rng) * unit(rng));
        let thin = wide.min(long) * (0.05 + 0.3 * unit(rng) * unit(rng));
        let faint = unit(rng) < 0.12;
        let shade = 7.0 * normal(rng);
        self.push(
            &Splat {
                coord: std::array::from_fn(|a| point.coord[a] + off * point.normal[a]),
                scale: [wide, long, thin],
                normal: tilt(point.normal, 0.06, rng),
                opacity_logit: if faint { normal(rng) - 1.5 } else { 2.5 + 1.2 * normal(rng) },
                color: point.color.map(|c| c + shade + 3.0 * normal(rng)),
                segment: surface.class as i32,
                instance: surface.instance,
            },
            rng,
        );
    }

    fn push_floater(&mut self, size: [f64; 3], rng: &mut SampleRng) {
        let scale = 0.01 + 0.06 * unit(rng) * unit(rng);
        let splat = Splat {
            coord: size.map(|s| s * unit(rng)),
            scale: std::array::from_fn(|_| scale * (0.3 + unit(rng))),
            normal: direction(rng),
            opacity_logit: normal(rng) - 3.0,
            color: std::array::from_fn(|_| 120.0 + 100.0 * (unit(rng) - 0.5)),
            segment: -1,
            instance: -1,
        };
        self.push(&splat, rng);
    }

    fn push(&mut self, splat: &Splat, rng: &mut SampleRng) {
        let scene = &mut self.scene;
        scene.coord.push(splat.coord.map(|v| v as f32));
        scene.log_scale.push(splat.scale.map(rounded_ln));
        scene.quat.push(quat_with_spin(splat.normal, cos_sin(rng)));
        scene.opacity_logit.push(splat.opacity_logit as f32);
        scene.sh_dc.push(splat.color.map(|c| u8_to_dc(c.clamp(0.0, 255.0) as u8)));
        self.normal.push(splat.normal.map(|v| v as f32));
        self.segment.push(splat.segment);
        self.instance.push(splat.instance);
    }
}

/// The logarithm of a scale, between 0.2 mm and 20 cm, in steps of 1/1024: libraries disagree
/// about its last bit.
fn rounded_ln(scale: f64) -> f32 {
    ((scale.clamp(2e-4, 0.2).ln() * 1024.0).round() / 1024.0) as f32
}

/// A unit vector moved by noise of the given size.
fn tilt(vector: [f64; 3], size: f64, rng: &mut SampleRng) -> [f64; 3] {
    let moved = vector.map(|v| v + size * normal(rng));
    let norm = moved.iter().map(|v| v * v).sum::<f64>().sqrt();
    if norm > 0.1 { moved.map(|v| v / norm) } else { vector }
}

/// The quaternion that spins about z by twice the angle of `cos`, `sin`, then turns z to `normal`.
fn quat_with_spin(normal: [f64; 3], [cos, sin]: [f64; 2]) -> [f32; 4] {
    let [w, x, y, _] = crate::from_points::quat_from_z_to(normal);
    // Hamilton product (w, x, y, 0) · (cos, 0, 0, sin).
    let q = [w * cos, x * cos + y * sin, y * cos - x * sin, w * sin];
    let sign = if q[0] < 0.0 { -1.0 } else { 1.0 };
    q.map(|v| (sign * v) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::grid_sample::{KeyOrder, voxel_groups};

    fn room(num_gaussians: usize, seed: u64) -> GeneratedRoom {
        generate_room(&RoomSettings { num_gaussians, seed }).unwrap()
    }

    #[test]
    fn any_number_of_gaussians() {
        for n in [0, 1, 2, 13, 5000] {
            let room = room(n, 3);
            assert_eq!(room.scene.len(), n);
            room.scene.check_rows().unwrap();
        }
        let error = generate_room(&RoomSettings { num_gaussians: usize::MAX, seed: 0 });
        assert!(matches!(error, Err(DataError::Setting { .. })));
    }

    #[test]
    fn the_same_bits_on_any_machine() {
        let scene = room(3000, 42).scene;
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        let floats = (scene.coord.iter().flatten())
            .chain(scene.log_scale.iter().flatten())
            .chain(scene.quat.iter().flatten())
            .chain(&scene.opacity_logit)
            .chain(scene.sh_dc.iter().flatten());
        for value in floats {
            hash = (hash ^ u64::from(value.to_bits())).wrapping_mul(0x100_0000_01b3);
        }
        assert_eq!(hash, SAME_BITS, "{hash:#x}");
    }

    const SAME_BITS: u64 = 0x168b_4cc9_fc07_a6b1;

    #[test]
    fn seeds_and_values_are_sensible() {
        let (a, b) = (room(20_000, 1), room(20_000, 2));
        assert_eq!(a, room(20_000, 1));
        assert_ne!(a.scene.coord, b.scene.coord);
        let scene = &a.scene;
        for row in 0..scene.len() {
            let q: f32 = scene.quat[row].iter().map(|v| v * v).sum();
            assert!((q - 1.0).abs() < 1e-5 && scene.quat[row][0] >= 0.0);
            assert!(scene.scale(row).iter().all(|s| (1e-4..0.25).contains(s)));
            assert!(scene.opacity_logit[row].is_finite());
            for axis in 0..3 {
                assert!((-0.2..a.size[axis] + 0.2).contains(&scene.coord[row][axis]));
            }
        }
        let segment = scene.segment.as_ref().unwrap();
        let instance = scene.instance.as_ref().unwrap();
        for class in 0..CLASS_NAMES.len() as i32 {
            assert!(segment.contains(&class), "{} is missing", CLASS_NAMES[class as usize]);
        }
        assert!(instance.iter().all(|&i| (-1..a.num_instances as i32).contains(&i)));
        assert!(segment.iter().zip(instance).all(|(&s, &i)| (s < 0) == (i < 0)));
    }

    #[test]
    fn an_instance_has_one_class() {
        let room = room(30_000, 7);
        let mut class = vec![None; room.num_instances];
        let segment = room.scene.segment.as_ref().unwrap();
        for (&s, &i) in segment.iter().zip(room.scene.instance.as_ref().unwrap()) {
            if i >= 0 {
                assert_eq!(*class[i as usize].get_or_insert(s), s);
            }
        }
    }

    #[test]
    fn normals_are_the_thin_axis() {
        let scene = room(2000, 9).scene;
        let normal = scene.normal.as_ref().unwrap();
        for (&[w, x, y, z], normal) in scene.quat.iter().zip(normal) {
            let third = [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)];
            let dot: f32 = third.iter().zip(normal).map(|(a, b)| a * b).sum();
            assert!((dot - 1.0).abs() < 1e-4, "{dot}");
        }
    }

    #[test]
    fn voxels_are_as_full_as_in_captures() {
        let rows_per_voxel = |n: usize| {
            let scene = room(n, 4).scene;
            let groups = voxel_groups(&scene.coord, 0.02, KeyOrder::Morton).unwrap();
            n as f64 / groups.num_voxels() as f64
        };
        // Small rooms are thinly covered; large ones keep the density of a capture.
        assert!((1.0..1.4).contains(&rows_per_voxel(10_000)));
        for n in [300_000, 600_000] {
            let rows = rows_per_voxel(n);
            assert!((1.4..2.6).contains(&rows), "{n}: {rows}");
        }
    }
}
