//! Shared data of tests and benchmarks.
#![allow(dead_code, reason = "each program uses a part")]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set itself up should stop"
)]

mod around_points;

use safetensors::{Dtype, SafeTensors};
use scenesplat_rasterizer::{Gaussians, View};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::PathBuf;

/// A file among the shared data; `None`, with a line saying so, where they are not installed.
pub fn shared(relative: &str) -> Option<PathBuf> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let root = std::env::var_os("SCENESPLAT_SHARED").map_or(beside, PathBuf::from);
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is not there", path.display());
    None
}

/// Arrays of one golden file, as f64 whatever they are stored as.
pub struct Golden {
    arrays: BTreeMap<String, (Vec<usize>, Vec<f64>)>,
}

impl Golden {
    /// `goldens/raster/<name>.safetensors`.
    pub fn open(name: &str) -> Option<Self> {
        let bytes = std::fs::read(shared(&format!("goldens/raster/{name}.safetensors"))?).unwrap();
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let mut arrays = BTreeMap::new();
        for (name, view) in file.tensors() {
            let data = view.data();
            let values: Vec<f64> = match view.dtype() {
                Dtype::F32 => words(data, |w| f64::from(f32::from_le_bytes(w))),
                Dtype::I32 => words(data, |w| f64::from(i32::from_le_bytes(w))),
                Dtype::U8 | Dtype::BOOL => data.iter().map(|&v| f64::from(v)).collect(),
                other => panic!("{name} is {other:?}"),
            };
            arrays.insert(name, (view.shape().to_vec(), values));
        }
        Some(Self { arrays })
    }

    pub fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    pub fn shape(&self, name: &str) -> &[usize] {
        &self.arrays[name].0
    }

    pub fn array(&self, name: &str) -> &[f64] {
        &self.arrays[name].1
    }

    /// The part of the array that belongs to the first index `i`.
    pub fn part(&self, name: &str, i: usize) -> &[f64] {
        let (shape, values) = &self.arrays[name];
        let len = values.len() / shape[0];
        &values[i * len..(i + 1) * len]
    }

    pub fn f32(&self, name: &str) -> Vec<f32> {
        self.array(name).iter().map(|&v| v as f32).collect()
    }

    /// The Gaussians of a scene file.
    pub fn gaussians(&self) -> Gaussians {
        Gaussians {
            means: self.f32("means").as_chunks().0.to_vec(),
            quats: self.f32("quats").as_chunks().0.to_vec(),
            scales: self.f32("scales").as_chunks().0.to_vec(),
            opacities: self.f32("opacities"),
            sh: self.f32("sh"),
            sh_degree: 3,
        }
    }

    /// The cameras of a scene file, for pictures of `[height, width]`.
    pub fn views(&self, [height, width]: [usize; 2]) -> Vec<View> {
        let (poses, lenses) = (self.f32("viewmats"), self.f32("Ks"));
        poses
            .chunks_exact(16)
            .zip(lenses.chunks_exact(9))
            .map(|(pose, lens)| view(pose, lens, [height, width]))
            .collect()
    }
}

fn words<T>(data: &[u8], parse: fn([u8; 4]) -> T) -> Vec<T> {
    data.as_chunks().0.iter().map(|&w| parse(w)).collect()
}

/// A view from a row-major 4×4 world-to-camera matrix and a 3×3 matrix of the lens.
pub fn view(pose: &[f32], lens: &[f32], [height, width]: [usize; 2]) -> View {
    let row = |i: usize| [pose[4 * i], pose[4 * i + 1], pose[4 * i + 2], pose[4 * i + 3]];
    View {
        world_to_camera: [row(0), row(1), row(2)],
        fx: lens[0],
        fy: lens[4],
        cx: lens[2],
        cy: lens[5],
        width: width as u32,
        height: height as u32,
    }
}

/// 138,766 Gaussians around the points of the garden, and its three views of 648×420 pixels.
///
/// `None` where the points are not installed; they are real, and not ours to ship.
pub fn garden() -> Option<(Gaussians, Vec<View>)> {
    let file = std::fs::File::open(shared("real/posed/test_garden.npz")?).unwrap();
    let mut archive = zip::ZipArchive::new(file).unwrap();
    let mut entry = |name: &str| {
        let mut bytes = Vec::new();
        archive.by_name(name).unwrap().read_to_end(&mut bytes).unwrap();
        let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        bytes.split_off(10 + header)
    };
    let points = words(&entry("means3d.npy"), f32::from_le_bytes).as_chunks().0.to_vec();
    let colors: Vec<[f32; 3]> =
        entry("colors.npy").as_chunks().0.iter().map(|c| c.map(|v| f32::from(v) / 255.0)).collect();
    let poses = words(&entry("viewmats.npy"), f32::from_le_bytes);
    let lenses = words(&entry("Ks.npy"), f32::from_le_bytes);
    let views = poses
        .chunks_exact(16)
        .zip(lenses.chunks_exact(9))
        .map(|(pose, lens)| view(pose, lens, [420, 648]))
        .collect();
    Some((around_points::around_points(&points, &colors, 7), views))
}
