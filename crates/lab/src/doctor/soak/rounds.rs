//! The kinds of rounds.

use super::{Kind, Outcome};
use crate::doctor::inputs::files::{
    Columns, Encoding, columns, file_name, files_of_scenes, open, ply, scene,
};
use crate::doctor::noise::Noise;
use crate::doctor::scenes::{check_features, network};
use crate::doctor::trial::{Failure, ensure};
use scenesplat::labels::{Classes, label_with_vote};
use scenesplat::{Network, SceneEncoder, embedded};
use scenesplat_datasets::effects::{Effect, EffectSet, simulate};
use scenesplat_datasets::transforms::{
    build_transforms, language_pretraining, semantic_segmentation,
};
use scenesplat_datasets::{Sample, sample_rng};
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm};
use scenesplat_kernels::patch_attention::{Heads, forward_with};
use scenesplat_kernels::{Precision, layer_norm, normalize, patches};
use scenesplat_metrics::ZeroShotOptions;
use scenesplat_rasterizer::{Gaussians, RasterSettings, RenderRequest, View, render};
use scenesplat_rooms::{SyntheticRoomSettings, generate};
use scenesplat_scene::vector::rotation;
use scenesplat_scene::{GaussianScene, Policy, SceneFormat, TextTable, WriteOptions, write_scene};
use std::io;
use std::path::{Path, PathBuf};

pub(super) const KINDS: &[Kind] = &[
    Kind { name: "files", run: files },
    Kind { name: "values", run: values },
    Kind { name: "operators", run: operators },
    Kind { name: "network", run: through_the_network },
    Kind { name: "effects", run: effects },
    Kind { name: "transforms", run: transforms },
    Kind { name: "pictures", run: pictures },
];

/// Numbers that arithmetic does not like.
const HARD: [f32; 12] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    f32::MIN_POSITIVE,
    1e-42,
    0.0,
    -0.0,
    1e30,
    -1e-30,
    88.8,
];

/// What rounds share: a folder, and the network inside the program with its classes.
pub(super) struct Bath {
    folder: PathBuf,
    network: Network,
    texts: TextTable,
}

impl Bath {
    pub(super) fn new(folder: &Path) -> Result<Self, Failure> {
        let folder = folder.join("soak");
        std::fs::create_dir_all(&folder)?;
        let texts = embedded::vocabulary()?.class_table();
        Ok(Self { folder, network: network(Precision::F32)?, texts })
    }

    /// Removes what a round wrote.
    pub(super) fn clear(&self) -> io::Result<()> {
        for entry in std::fs::read_dir(&self.folder)? {
            let path = entry?.path();
            match path.is_dir() {
                true => std::fs::remove_dir_all(path)?,
                false => std::fs::remove_file(path)?,
            }
        }
        Ok(())
    }

    /// Features and labels of a scene.
    fn label(&self, scene: &GaussianScene) -> Result<Outcome, Failure> {
        let features = SceneEncoder::new(&self.network).encode(scene, &mut |_| Ok(()));
        let Ok(features) = features else { return Ok(Outcome::Refused) };
        check_features(&features, scene.len())?;
        let (classes, options) = (Classes::Texts(&self.texts), ZeroShotOptions::default());
        let found = label_with_vote(&features, classes, &options, &scene.coord, 25)?;
        let many = self.texts.len() as i32;
        ensure!(found.labels.iter().all(|l| (-1..many).contains(l)), "a label is no class");
        ensure!(found.scores.iter().all(|s| s.is_finite()), "a score is not finite");
        Ok(Outcome::Sound)
    }
}

impl Drop for Bath {
    fn drop(&mut self) {
        // Empty, unless a round is run by itself and its files are to stay.
        let _ = std::fs::remove_dir(&self.folder);
    }
}

fn pick<T: Copy>(rng: &mut Noise, from: &[T]) -> T {
    from[rng.below(from.len())]
}

/// Rows, often few, sometimes a few hundred.
fn some_rows(rng: &mut Noise) -> usize {
    match rng.below(4) {
        0 => 1 + rng.below(3),
        1 | 2 => 1 + rng.below(40),
        _ => 1 + rng.below(400),
    }
}

/// What has to hold of whatever a reader gives: rows match, and only values that are legal are not finite.
fn check_scene(scene: &GaussianScene) -> Result<(), Failure> {
    scene.check_rows()?;
    ensure!(scene.coord.as_flattened().iter().all(|v| v.is_finite()), "a position is not finite");
    ensure!(scene.quat.as_flattened().iter().all(|v| v.is_finite()), "a rotation is not finite");
    ensure!(scene.sh_dc.as_flattened().iter().all(|v| v.is_finite()), "a color is not finite");
    ensure!(scene.sh_rest.iter().all(|v| v.is_finite()), "a harmonic is not finite");
    let nan = |v: &f32| v.is_nan() || *v == f32::INFINITY;
    ensure!(!scene.log_scale.as_flattened().iter().any(nan), "a size is NaN or infinite");
    ensure!(!scene.opacity_logit.iter().any(|v| v.is_nan()), "an opacity is NaN");
    Ok(())
}

/// A file of any format with some bytes changed, cut or doubled: it is read or refused.
fn files(bath: &mut Bath, rng: &mut Noise) -> Result<Outcome, Failure> {
    let formats: Vec<SceneFormat> = files_of_scenes().collect();
    let format = pick(rng, &formats);
    let path = bath.folder.join(file_name(format));
    let degree = rng.below(4) as u8;
    let written = scene(some_rows(rng), degree, rng.next());
    write_scene(&written, &path, format, &WriteOptions::default(), &mut |_| true)?;
    let mut bytes = std::fs::read(&path)?;
    for _ in 0..rng.below(6) {
        if bytes.is_empty() {
            break;
        }
        // Headers are short, and where most can go wrong.
        let end = if rng.below(2) == 0 { bytes.len().min(256) } else { bytes.len() };
        let at = rng.below(end);
        match rng.below(6) {
            0 => bytes[at] ^= 1 << rng.below(8),
            1 => bytes[at] = pick(rng, &[0, 0xff, b'9', b'-', b'\n', 0x7f]),
            2 => bytes.truncate(at),
            3 => {
                let piece = bytes[at..bytes.len().min(at + 1 + rng.below(64))].to_vec();
                bytes.splice(at..at, piece);
            }
            4 => drop(bytes.drain(at..end.min(at + 1 + rng.below(16)))),
            _ => {
                let to = (at + 4).min(bytes.len());
                let value = pick(rng, &HARD).to_le_bytes();
                bytes[at..to].copy_from_slice(&value[..to - at]);
            }
        }
    }
    std::fs::write(&path, &bytes)?;
    let policy = pick(rng, &[Policy::Repair, Policy::Strict]);
    match open(&path, policy) {
        Ok(loaded) => check_scene(&loaded.scene).map(|()| Outcome::Sound),
        Err(error) => {
            ensure!(error.to_string().contains("scene"), "a refusal names no file: {error}");
            Ok(Outcome::Refused)
        }
    }
}

/// Columns of a PLY file with hard numbers anywhere.
fn hard_columns(rng: &mut Noise) -> Columns {
    let rows = some_rows(rng);
    let mut columns = columns(rows);
    for _ in 0..rng.below(2 * rows + 4) {
        let (column, row) = (rng.below(columns.len()), rng.below(rows));
        columns[column].1[row] = pick(rng, &HARD);
    }
    columns
}

fn values(bath: &mut Bath, rng: &mut Noise) -> Result<Outcome, Failure> {
    let encoding = pick(rng, &[Encoding::Ascii, Encoding::Little, Encoding::Big]);
    let path = bath.folder.join("scene.ply");
    std::fs::write(&path, ply(&hard_columns(rng), encoding, "\n"))?;
    let policy = pick(rng, &[Policy::Repair, Policy::Repair, Policy::Strict]);
    match open(&path, policy) {
        Ok(loaded) => check_scene(&loaded.scene).map(|()| Outcome::Sound),
        Err(error) => {
            ensure!(error.to_string().contains("scene.ply"), "a refusal names no file: {error}");
            Ok(Outcome::Refused)
        }
    }
}

/// Numbers of one size, some of them 0, or the same, or a thousand times as large.
fn numbers(rng: &mut Noise, count: usize) -> Vec<f32> {
    let size = pick(rng, &[1e-15, 1e-4, 1.0, 1.0, 50.0, 1e15]);
    let like = rng.below(5);
    (0..count)
        .map(|_| match (like, rng.below(20)) {
            (0, _) => size,
            (1, 0) => 1000.0 * size,
            (_, 1) => 0.0,
            _ => size * rng.float(),
        })
        .collect()
}

/// Products, norms and attention of any shape: finite, and one element of a product as in f64.
fn operators(_: &mut Bath, rng: &mut Noise) -> Result<Outcome, Failure> {
    let (m, k, n) = (1 + rng.below(70), 1 + rng.below(200), 1 + rng.below(70));
    let (a, w) = (numbers(rng, m * k), numbers(rng, n * k));
    let precision = pick(rng, &Precision::ALL);
    let mut out = vec![0.0; m * n];
    let packed = PackedMatrix::from_strided_with(precision, &w, k, n, 1, k);
    gemm(&a, &packed, Epilogue::default(), &mut out);
    ensure!(out.iter().all(|v| v.is_finite()), "{m}×{k}×{n} in {precision}: not finite");
    if precision == Precision::F32 {
        let (i, j) = (rng.below(m), rng.below(n));
        let terms = (0..k).map(|p| f64::from(a[i * k + p]) * f64::from(w[j * k + p]));
        let (sum, size) = terms.fold((0.0, 0.0), |(s, m), t| (s + t, m + t.abs()));
        let apart = (f64::from(out[i * n + j]) - sum).abs();
        let allowed = 1e-5 * size.max(f64::from(f32::MIN_POSITIVE));
        ensure!(apart <= allowed, "{m}×{k}×{n}: element {i}, {j} is off by {apart:e}");
    }
    let (weight, bias) = (numbers(rng, k), numbers(rng, k));
    let mut rows = vec![0.0; m * k];
    layer_norm::forward(&a, None, &weight, &bias, 1e-5, &mut rows);
    ensure!(rows.iter().all(|v| v.is_finite()), "layer norm of {m}×{k}: not finite");
    let mut unit = a;
    normalize::normalize_rows(&mut unit, k);
    ensure!(unit.iter().all(|v| v.abs() <= 1.0 + 1e-6), "unit rows of {m}×{k} are longer than 1");
    let heads = Heads { count: 1 + rng.below(3), dim: 16 };
    let c = heads.count * heads.dim;
    let rows = some_rows(rng);
    let qkv = numbers(rng, rows * 3 * c);
    let patch = pick(rng, &[16, 48, 128]);
    let cut = patches::cut(&[0, rows], patch);
    let order: Vec<u32> = (0..rows as u32).rev().collect();
    let mut out = vec![0.0; rows * c];
    forward_with(precision, &qkv, heads, &cut, &order, &mut out);
    let largest = qkv.iter().fold(0.0, |m: f32, v| m.max(v.abs()));
    // A mean of values is none larger than they; 8-bit steps may round it up.
    let beyond = out.iter().position(|v| v.is_nan() || v.abs() > 1.02 * largest);
    ensure!(
        beyond.is_none(),
        "attention of {rows} rows in {precision}, patches of {patch}: value {beyond:?} of {c} channels is {:e}, \
         none that goes in is beyond {largest:e}",
        out[beyond.unwrap_or_default()]
    );
    Ok(Outcome::Sound)
}

/// A scene with the shapes that networks do not like.
fn hard_scene(rng: &mut Noise) -> GaussianScene {
    let mut out = scene(some_rows(rng), 0, rng.next());
    let spread = pick(rng, &[0.0, 1e-4, 1.0, 3.0, 300.0]);
    let offset = pick(rng, &[0.0, 0.0, 1e6, -3e4]);
    for p in &mut out.coord {
        *p = p.map(|v| v * spread + offset);
    }
    match rng.below(5) {
        0 => out.coord.iter_mut().for_each(|p| p[2] = offset),
        1 => out.coord.iter_mut().for_each(|p| (p[1], p[2]) = (offset, offset)),
        2 => {
            let first = out.coord[0];
            out.coord.iter_mut().step_by(2).for_each(|p| *p = first);
        }
        _ => {}
    }
    for row in 0..out.len() {
        match rng.below(20) {
            0 => out.log_scale[row] = [f32::NEG_INFINITY; 3],
            1 => out.log_scale[row][rng.below(3)] = pick(rng, &[-60.0, 5.0, 16.0, 80.0]),
            2 => out.opacity_logit[row] = pick(rng, &[f32::INFINITY, f32::NEG_INFINITY, 60.0]),
            3 => out.sh_dc[row] = [pick(rng, &[1e30, -1e30, 5.0, 0.0]); 3],
            4 => out.quat[row] = [0.0, 1.0, 0.0, 0.0],
            _ => {}
        }
    }
    out
}

fn through_the_network(bath: &mut Bath, rng: &mut Noise) -> Result<Outcome, Failure> {
    let scene = hard_scene(rng);
    bath.label(&scene)
}

/// A damaged room: rows match, nothing new is not finite, and the network takes it.
fn effects(bath: &mut Bath, rng: &mut Noise) -> Result<Outcome, Failure> {
    let hard = rng.below(3) == 0;
    let room = match hard {
        true => hard_scene(rng),
        false => {
            generate(&SyntheticRoomSettings::with_count(300 + rng.below(700), rng.next()))?.scene
        }
    };
    let mut set = EffectSet::default();
    for effect in Effect::ALL {
        if rng.below(2) == 0 {
            set = set.with(effect, 5.0 * f64::from(rng.float().abs()))?;
        }
    }
    let found = simulate(&room, &set, rng.next())?;
    check_scene(&found.scene).map_err(|Failure(text)| Failure(format!("{set}: {text}")))?;
    ensure!(found.source.len() == found.scene.len(), "{set}: rows without a source");
    bath.label(&found.scene).map_err(|Failure(text)| Failure(format!("{set}: {text}")))
}

/// The pipelines of training on a scene with hard shapes: rows match, values are finite.
fn transforms(_: &mut Bath, rng: &mut Noise) -> Result<Outcome, Failure> {
    let mut sample = Sample::from_scene("soak", hard_scene(rng));
    let grid = f64::from(pick(rng, &[0.05f32, 0.3, 2.0]));
    let steps = match rng.below(2) {
        0 => language_pretraining(grid),
        _ => semantic_segmentation(grid),
    };
    let mut draws = sample_rng(rng.next(), 0, 0);
    for step in build_transforms(&steps)? {
        if step.apply(&mut sample, &mut draws).is_err() {
            return Ok(Outcome::Refused);
        }
        sample.check().map_err(|e| Failure(format!("{step:?}: {e}")))?;
    }
    ensure!(sample.coord.as_flattened().iter().all(|v| v.is_finite()), "a position is not finite");
    ensure!(sample.color.as_flattened().iter().all(|v| v.is_finite()), "a color is not finite");
    ensure!(sample.quat.as_flattened().iter().all(|v| v.is_finite()), "a rotation is not finite");
    ensure!(sample.scale.as_flattened().iter().all(|v| v.is_finite()), "a size is not finite");
    Ok(Outcome::Sound)
}

/// A picture of a scene with hard shapes, from anywhere.
fn pictures(_: &mut Bath, rng: &mut Noise) -> Result<Outcome, Failure> {
    let gaussians = Gaussians::from_scene(&hard_scene(rng))?;
    let quat = [(); 4].map(|()| f64::from(rng.float()));
    let norm = quat.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-6);
    let turn = rotation(quat.map(|v| (v / norm) as f32));
    let (width, height) = (1 + rng.below(50) as u32, 1 + rng.below(50) as u32);
    let view = View {
        world_to_camera: turn.map(|[a, b, c]| [a, b, c, 2.0 * rng.float()]),
        fx: 5.0 + 60.0 * rng.float().abs(),
        fy: 5.0 + 60.0 * rng.float().abs(),
        cx: 0.5 * width as f32,
        cy: 0.5 * height as f32,
        width,
        height,
    };
    let drawn = render(&gaussians, &view, &RasterSettings::default(), &RenderRequest::rgb());
    let Ok(drawn) = drawn else { return Ok(Outcome::Refused) };
    let rgb = drawn.rgb.unwrap_or_default();
    ensure!(rgb.iter().all(|v| v.is_finite()), "a pixel is not finite");
    let inside = drawn.transmittance.iter().all(|t| (0.0..=1.0).contains(t));
    ensure!(inside, "a transmittance is outside of 0 to 1");
    Ok(Outcome::Sound)
}
