//! Scenes, cameras and maps for the tests.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use safetensors::{Dtype, SafeTensors};
use scenesplat_rasterizer::lifting::{NO_SEGMENT, SegmentMap};
use scenesplat_rasterizer::{Gaussians, View};
use std::path::PathBuf;

/// A file of numbers of the original code, or `None` after saying why a test is skipped.
pub struct Golden(Vec<u8>);

impl Golden {
    pub fn open(name: &str) -> Option<Self> {
        let root = std::env::var_os("SCENESPLAT_SHARED").map_or_else(
            || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
            PathBuf::from,
        );
        let path = root.join("goldens/raster").join(name);
        if !path.is_file() {
            println!("skipped: {name} is not in the shared data (set SCENESPLAT_SHARED)");
            return None;
        }
        Some(Self(std::fs::read(path).unwrap()))
    }

    fn words(&self, tensor: &str, dtype: Dtype) -> Vec<[u8; 4]> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let tensor = file.tensor(tensor).unwrap();
        assert_eq!(tensor.dtype(), dtype);
        tensor.data().as_chunks::<4>().0.to_vec()
    }

    pub fn f32(&self, tensor: &str) -> Vec<f32> {
        self.words(tensor, Dtype::F32).into_iter().map(f32::from_le_bytes).collect()
    }

    pub fn i32(&self, tensor: &str) -> Vec<i32> {
        self.words(tensor, Dtype::I32).into_iter().map(i32::from_le_bytes).collect()
    }

    pub fn bool(&self, tensor: &str) -> Vec<bool> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        file.tensor(tensor).unwrap().data().iter().map(|&b| b != 0).collect()
    }
}

/// The golden scene with its cameras and maps of segments.
pub fn golden_scene(scene: &Golden) -> (Gaussians, Vec<View>, Vec<SegmentMap>) {
    let rows = |values: Vec<f32>| values.as_chunks::<3>().0.to_vec();
    let gaussians = Gaussians {
        means: rows(scene.f32("means")),
        quats: scene.f32("quats").as_chunks::<4>().0.to_vec(),
        scales: rows(scene.f32("scales")),
        opacities: scene.f32("opacities"),
        sh: scene.f32("sh"),
        sh_degree: 3,
    };
    let (width, height) = (96, 64);
    let (matrices, k) = (scene.f32("viewmats"), scene.f32("Ks"));
    let view = |v: usize| {
        let row = |r: usize| std::array::from_fn(|c| matrices[v * 16 + r * 4 + c]);
        let k = &k[v * 9..v * 9 + 9];
        let world_to_camera = [row(0), row(1), row(2)];
        View { world_to_camera, fx: k[0], fy: k[4], cx: k[2], cy: k[5], width, height }
    };
    let ids = scene.i32("seg");
    let map = |ids: &[i32]| {
        let ids = ids.iter().map(|&id| if id < 0 { NO_SEGMENT } else { id as u16 });
        SegmentMap::new(width, height, ids.collect()).unwrap()
    };
    let pixels = (width * height) as usize;
    (gaussians, (0..3).map(view).collect(), ids.chunks_exact(pixels).map(map).collect())
}

/// A cloud of Gaussians in front of cameras that look along +z, slightly turned.
pub fn cloud(count: usize, views: usize, size: [u32; 2], seed: u64) -> (Gaussians, Vec<View>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut gaussians = Gaussians { sh_degree: 0, ..Gaussians::default() };
    for _ in 0..count {
        let mut any = |low: f32, high: f32| rng.random_range(low..high);
        gaussians.means.push([any(-1.5, 1.5), any(-1.0, 1.0), any(1.5, 4.0)]);
        gaussians.quats.push([any(-1.0, 1.0), any(-1.0, 1.0), any(-1.0, 1.0), any(0.1, 1.0)]);
        gaussians.scales.push([any(0.01, 0.2), any(0.01, 0.2), any(0.01, 0.2)]);
        gaussians.opacities.push(any(0.02, 1.0));
        gaussians.sh.extend([0.0; 3]);
    }
    let view = |i: usize| {
        let (sin, cos) = (0.1 * i as f32 - 0.1).sin_cos();
        let shift = 0.1 * i as f32;
        let [width, height] = size;
        View {
            world_to_camera: [
                [cos, 0.0, sin, shift],
                [0.0, 1.0, 0.0, -shift],
                [-sin, 0.0, cos, 0.0],
            ],
            fx: width as f32,
            fy: width as f32,
            cx: width as f32 / 2.0,
            cy: height as f32 / 2.0 + 0.3,
            width,
            height,
        }
    };
    (gaussians, (0..views).map(view).collect())
}

/// Cells around random points, some of them no segment.
pub fn voronoi(width: u32, height: u32, segments: u16, seed: u64) -> SegmentMap {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let point = |_| [rng.random_range(0..width), rng.random_range(0..height)].map(f64::from);
    let points: Vec<[f64; 2]> = (0..segments + segments / 5).map(point).collect();
    let nearest = |i: u32| {
        let (x, y) = (f64::from(i % width), f64::from(i / width));
        let distance = |p: &[f64; 2]| (p[0] - x).powi(2) + (p[1] - y).powi(2);
        let order = |a: &usize, b: &usize| distance(&points[*a]).total_cmp(&distance(&points[*b]));
        (0..points.len()).min_by(order).unwrap() as u16
    };
    let ids =
        (0..width * height).map(nearest).map(|id| if id < segments { id } else { NO_SEGMENT });
    SegmentMap::new(width, height, ids.collect()).unwrap()
}

/// Random rows.
pub fn rows(count: usize, dim: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count * dim).map(|_| rng.random_range(-1.0..1.0)).collect()
}
