//! What several tests of this crate share.
#![allow(dead_code, reason = "each test program uses a part of it")]

use half::f16;
use scenesplat_scene::{GaussianScene, LanguageCode, LanguageCodebook};
use std::path::PathBuf;

/// A file among the shared real data; `None`, with a line saying so, where they are not installed.
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

/// Pseudo-random numbers; the same for the same seed everywhere.
pub struct SplitMix(pub u64);

impl SplitMix {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    /// −1..1.
    pub fn float(&mut self) -> f32 {
        (self.next() >> 40) as f32 / 8_388_608.0 - 1.0
    }
}

/// A scene that cleaning leaves as it is.
pub fn random_scene(rows: usize, sh_degree: u8, seed: u64) -> GaussianScene {
    let mut rng = SplitMix(seed);
    let mut scene = GaussianScene { sh_degree, ..GaussianScene::default() };
    for _ in 0..rows {
        scene.coord.push([(); 3].map(|()| rng.float() * 10.0));
        scene.log_scale.push([(); 3].map(|()| rng.float() - 4.0));
        let quat = [(); 4].map(|()| f64::from(rng.float()));
        let norm = quat.iter().map(|v| v * v).sum::<f64>().sqrt().copysign(quat[0]);
        scene.quat.push(quat.map(|v| (v / norm) as f32));
        scene.opacity_logit.push(rng.float() * 8.0);
        scene.sh_dc.push([(); 3].map(|()| rng.float() * 1.5));
        for _ in 0..scene.sh_rest_len() * 3 {
            scene.sh_rest.push(rng.float());
        }
    }
    scene
}

/// The columns of a scene in the order of the original trainer, without normals.
pub fn inria_columns(scene: &GaussianScene) -> Vec<(String, Vec<f32>)> {
    let mut columns: Vec<(String, Vec<f32>)> = Vec::new();
    for (i, name) in ["x", "y", "z"].into_iter().enumerate() {
        columns.push((name.into(), scene.coord.iter().map(|v| v[i]).collect()));
    }
    for i in 0..3 {
        columns.push((format!("f_dc_{i}"), scene.sh_dc.iter().map(|v| v[i]).collect()));
    }
    let k = scene.sh_rest_len();
    for channel in 0..3 {
        for c in 0..k {
            let values = scene.sh_rest.chunks_exact(3 * k).map(|row| row[c * 3 + channel]);
            columns.push((format!("f_rest_{}", channel * k + c), values.collect()));
        }
    }
    columns.push(("opacity".into(), scene.opacity_logit.clone()));
    for i in 0..3 {
        columns.push((format!("scale_{i}"), scene.log_scale.iter().map(|v| v[i]).collect()));
    }
    for i in 0..4 {
        columns.push((format!("rot_{i}"), scene.quat.iter().map(|v| v[i]).collect()));
    }
    columns
}

/// How a test file is encoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Encoding {
    Ascii,
    Little,
    Big,
}

/// A PLY file of float columns, written independently of the crate.
pub fn ply_bytes(columns: &[(String, Vec<f32>)], encoding: Encoding, line_end: &str) -> Vec<u8> {
    let rows = columns.first().map_or(0, |c| c.1.len());
    let name = match encoding {
        Encoding::Ascii => "ascii",
        Encoding::Little => "binary_little_endian",
        Encoding::Big => "binary_big_endian",
    };
    let mut head =
        vec!["ply".to_owned(), format!("format {name} 1.0"), "comment made by a test".into()];
    head.push(format!("element vertex {rows}"));
    head.extend(columns.iter().map(|(name, _)| format!("property float {name}")));
    head.push("end_header".into());
    let mut out = Vec::new();
    for line in head {
        out.extend_from_slice(line.as_bytes());
        out.extend_from_slice(line_end.as_bytes());
    }
    for row in 0..rows {
        match encoding {
            Encoding::Ascii => {
                let values: Vec<String> = columns.iter().map(|(_, v)| v[row].to_string()).collect();
                out.extend_from_slice(values.join(" ").as_bytes());
                out.extend_from_slice(line_end.as_bytes());
            }
            Encoding::Little => {
                columns.iter().for_each(|(_, v)| out.extend_from_slice(&v[row].to_le_bytes()));
            }
            Encoding::Big => {
                columns.iter().for_each(|(_, v)| out.extend_from_slice(&v[row].to_be_bytes()));
            }
        }
    }
    out
}

/// A small `.npy` file, written independently of the crate.
pub fn npy_bytes(version: u8, dict: &str, data: &[u8]) -> Vec<u8> {
    let mut out = b"\x93NUMPY".to_vec();
    out.extend_from_slice(&[version, 0]);
    let text = format!("{dict}\n");
    if version == 1 {
        out.extend_from_slice(&(text.len() as u16).to_le_bytes());
    } else {
        out.extend_from_slice(&(text.len() as u32).to_le_bytes());
    }
    out.extend_from_slice(text.as_bytes());
    out.extend_from_slice(data);
    out
}

/// Codes of `k` numbers for features of `width`, none of them special.
pub fn language_code(rows: usize, k: usize, width: usize) -> LanguageCode {
    let mut rng = SplitMix(rows as u64);
    let values = (0..rows * k).map(|_| f16::from_f32(rng.float())).collect();
    let mean = (0..width).map(|_| rng.float()).collect();
    let axes = (0..k * width).map(|_| rng.float()).collect();
    LanguageCode { values, codebook: LanguageCodebook { mean, axes } }
}
