//! From the arrays of a scene to textures, version 2.

use super::codebook::Codebook;
use super::codes::{LogAxis, alpha_byte, encode_quat};
use super::folder::FolderWriter;
use super::meta::OWN_KEY;
use super::order::spatial_order;
use super::palette::Palette;
use super::reader::{CENTROIDS_PER_LINE, ROWS_FOR_TABLE, line_width, plausible_rows};
use super::ticker::Ticker;
use super::{META_NAME, texture};
use crate::AtomicFile;
use crate::formats::limit_tally::LimitTally;
use crate::formats::{WriteOptions, WriteProgress, WriteReport, semantics};
use crate::{GaussianScene, SceneError};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::io::{BufWriter, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// Rows that one task turns into texels.
const ROWS_PER_TASK: usize = 16_384;
/// Smallest logarithm of a scale that stands for a scale of 0: a picometre.
const SMALLEST_LOG_SCALE: f32 = -27.631_02;
/// Name of the block of labels.
const LABELS_NAME: &str = "labels.safetensors";

/// Writes a scene as one archive, its entries stored as they are.
///
/// Values become the nearest that the format has: positions one of 65,536 steps along each axis in
/// `sign(p) · ln(1 + |p|)`, components of rotations one of 256, scales and DC coefficients one of
/// 256 fitted values each, opacity one of 256 steps of alpha, higher coefficients one of up to
/// 65,536 fitted rows of 256 fitted values. Rows are sorted in space unless they are so already;
/// then `order` of the report says which row came from where.
///
/// Bytes do not depend on the number of threads, and a scene that was read from such a file is
/// written as the same bytes.
///
/// # Errors
/// As [`super::super::write_scene`].
pub(in crate::formats) fn write_sog(
    scene: &GaussianScene,
    file: &AtomicFile,
    _options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let path = file.target();
    let mut ticker = Ticker::new(progress);
    let mut zip = ZipWriter::new(BufWriter::new(file.file()));
    let cannot = |e: zip::result::ZipError| -> SceneError {
        SceneError::io(path, "cannot write the archive")(e.into())
    };
    // No time of day and no rights of the writer: the same scene gives the same bytes.
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default())
        .unix_permissions(0o644);
    encode(scene, path, Order::Spatial, report, &mut ticker, &mut |name, bytes| {
        let options = options.large_file(bytes.len() as u64 >= u64::from(u32::MAX));
        zip.start_file(name, options).map_err(cannot)?;
        zip.write_all(bytes).map_err(SceneError::io(path, "cannot write the archive"))
    })?;
    let mut buffer = zip.finish().map_err(cannot)?;
    buffer.flush().map_err(SceneError::io(path, "cannot write the archive"))?;
    ticker.tick(0.99)
}

/// Writes a scene as files of a folder: `path`, which is its `meta.json`, and the textures beside it.
///
/// As [`write_sog`]; the files appear together when all are complete. Textures of the scene that was
/// described by the same `meta.json` before are removed.
///
/// # Errors
/// As [`super::super::write_scene`]; also if there are files of those names, which belong to no
/// scene, and `options.overwrite` is not set.
pub(in crate::formats) fn write_sog_folder(
    scene: &GaussianScene,
    path: &Path,
    options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let mut ticker = Ticker::new(progress);
    let mut folder = FolderWriter::create(path)?;
    let own_name = path.file_name().and_then(|name| name.to_str()).unwrap_or(META_NAME);
    encode(scene, path, Order::Spatial, report, &mut ticker, &mut |name, bytes| {
        folder.write(if name == META_NAME { own_name } else { name }, bytes)
    })?;
    ticker.tick(0.99)?;
    folder.commit(options.overwrite, report)
}

/// Takes a part under its name.
pub(super) type Sink<'a> = &'a mut dyn FnMut(&str, &[u8]) -> Result<(), SceneError>;

/// Whether rows may be sorted.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Order {
    /// In space, unless they are so already.
    Spatial,
    /// Somebody counts on the order.
    Kept,
}

/// Encodes a scene, part by part, `meta.json` last.
pub(super) fn encode(
    scene: &GaussianScene,
    path: &Path,
    rows: Order,
    report: &mut WriteReport,
    ticker: &mut Ticker<'_>,
    sink: Sink<'_>,
) -> Result<(), SceneError> {
    let Some(size) = texture::texture_size(scene.len()) else {
        let problem = format!("cannot hold {} Gaussians", scene.len());
        return Err(SceneError::format(path, problem, "split the scene or choose another format"));
    };
    let (axes, codes) = position_codes(&scene.coord);
    ticker.tick(0.05)?;
    let order = if rows == Order::Kept { None } else { spatial_order(&codes) };
    ticker.tick(0.1)?;
    let out = Textures { path, size, order: order.as_deref(), rows: scene.len() };
    encode_positions(&out, &codes, sink)?;
    drop(codes);
    ticker.tick(0.15)?;

    let scale = encode_shapes(&out, scene, report, ticker, sink)?;
    let color = encode_colors(&out, scene, report, ticker, sink)?;
    let mut meta = json!({
        "version": 2,
        "count": scene.len(),
        "means": {
            "mins": axes.map(|axis| axis.min),
            "maxs": axes.map(|axis| axis.max),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": { "codebook": numbers(&scale), "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": numbers(&color), "files": ["sh0.webp"] },
    });
    if scene.sh_degree > 0 {
        meta["shN"] = encode_rest(&out, scene, report, ticker, sink)?;
    }
    ticker.tick(0.95)?;
    if let Some(block) = semantics::encode(scene, order.as_deref()) {
        sink(LABELS_NAME, &block)?;
        meta[OWN_KEY] = json!({ "labels": LABELS_NAME });
    }
    if scene.antialiased {
        meta["antialias"] = true.into();
        meta["model"] = "antialiased".into();
    }
    report.order = order;
    sink(META_NAME, meta.to_string().as_bytes())
}

/// The two textures of positions.
fn encode_positions(
    out: &Textures<'_>,
    codes: &[[u16; 3]],
    sink: Sink<'_>,
) -> Result<(), SceneError> {
    let texels = |high: usize| out.of_rows(|row| codes[row].map(|c| c.to_le_bytes()[high]));
    let (low, high) = rayon::join(|| texels(0), || texels(1));
    let (low, high) = (low?, high?);
    if out.rows as u64 > plausible_rows((low.len() + high.len()) as u64) {
        let problem = format!("would hold {} Gaussians, nearly all in one place", out.rows);
        let help = "readers would take the file for damaged; choose another format";
        return Err(SceneError::format(out.path, problem, help));
    }
    sink("means_l.webp", &low)?;
    sink("means_u.webp", &high)
}

/// The textures of rotations and sizes; the codebook of the sizes.
fn encode_shapes(
    out: &Textures<'_>,
    scene: &GaussianScene,
    report: &mut WriteReport,
    ticker: &mut Ticker<'_>,
    sink: Sink<'_>,
) -> Result<Codebook, SceneError> {
    let scale = scale_codebook(scene, report);
    ticker.tick(0.2)?;
    let (quats, scales) = rayon::join(
        || out.of_rows(|row| encode_quat(scene.quat[row])),
        || out.of_rows(|row| scene.log_scale[row].map(|s| scale.code(s))),
    );
    sink("quats.webp", &quats?)?;
    sink("scales.webp", &scales?)?;
    ticker.tick(0.25)?;
    Ok(scale)
}

/// The texture of colors and opacities; the codebook of the colors.
fn encode_colors(
    out: &Textures<'_>,
    scene: &GaussianScene,
    report: &mut WriteReport,
    ticker: &mut Ticker<'_>,
    sink: Sink<'_>,
) -> Result<Codebook, SceneError> {
    let color = Codebook::fit(scene.sh_dc.as_flattened().to_vec());
    ticker.tick(0.28)?;
    let sh0 = out.of_rows(|row| {
        let [r, g, b] = scene.sh_dc[row].map(|dc| color.code(dc));
        [r, g, b, alpha_byte(scene.opacity_logit[row])]
    });
    sink("sh0.webp", &sh0?)?;
    report.limit("opacity_logit", "alpha of 8 bits becomes 0 or 1", saturated(scene));
    ticker.tick(0.3)?;
    Ok(color)
}

/// The textures of higher bands, and their description.
fn encode_rest(
    out: &Textures<'_>,
    scene: &GaussianScene,
    report: &mut WriteReport,
    ticker: &mut Ticker<'_>,
    sink: Sink<'_>,
) -> Result<Value, SceneError> {
    let degree = scene.sh_degree.min(3);
    report.limit("sh_rest", "bands beyond the third are cut", beyond_third_band(scene));
    let palette = Palette::build(scene, degree, &mut ticker.part(0.3, 0.9))?;
    let label = |row: usize| {
        let [low, high] = palette.labels[row].to_le_bytes();
        // Green is taken from blue before encoding, which leaves nothing of it here.
        [low, high, high]
    };
    let centroids = || {
        let height = palette.len().div_ceil(CENTROIDS_PER_LINE);
        let mut texels = palette.codes.clone();
        texels.resize(line_width(degree) * height * 3, 0);
        texture::encode(&texels, (line_width(degree), height), out.path)
    };
    let (labels, centroids) = rayon::join(|| out.of_rows(label), centroids);
    sink("shN_centroids.webp", &centroids?)?;
    sink("shN_labels.webp", &labels?)?;
    Ok(json!({
        "count": palette.len(),
        "bands": degree,
        "codebook": numbers(&palette.codebook),
        "files": ["shN_centroids.webp", "shN_labels.webp"],
    }))
}

/// The values of a codebook; f64 holds them exactly, whatever digits a reader parses.
fn numbers(book: &Codebook) -> Vec<Value> {
    book.padded().iter().map(|&v| Value::from(f64::from(v))).collect()
}

/// Textures with one texel for each row.
struct Textures<'a> {
    path: &'a Path,
    size: (usize, usize),
    order: Option<&'a [u32]>,
    rows: usize,
}

impl Textures<'_> {
    /// Encodes the texels of all rows, in the order of the file.
    fn of_rows<const C: usize>(
        &self,
        texel: impl Fn(usize) -> [u8; C] + Sync,
    ) -> Result<Vec<u8>, SceneError> {
        let mut texels = vec![0u8; self.size.0 * self.size.1 * C];
        let used = &mut texels.as_chunks_mut::<C>().0[..self.rows];
        used.par_chunks_mut(ROWS_PER_TASK).enumerate().for_each(|(task, out)| {
            for (i, out) in out.iter_mut().enumerate() {
                let place = task * ROWS_PER_TASK + i;
                *out = texel(self.order.map_or(place, |order| order[place] as usize));
            }
        });
        texture::encode(&texels, self.size, self.path)
    }
}

/// The bounds of positions and the code of each.
///
/// Bounds are those of the values as they are, which the codes at both ends give back exactly; so
/// they are the same for the scene that is read.
fn position_codes(coord: &[[f32; 3]]) -> ([LogAxis; 3], Vec<[u16; 3]>) {
    let around = |i: usize| LogAxis::around(coord.iter().map(|p| p[i]));
    let axes: Vec<LogAxis> = (0..3).into_par_iter().map(around).collect();
    let axes = [axes[0], axes[1], axes[2]];
    // Codes are made for the bounds that a reader parses, which may be a bit off.
    let read = axes.map(|axis| LogAxis { min: as_read(axis.min), max: as_read(axis.max) });
    let codes = if coord.len() < ROWS_FOR_TABLE {
        coord.par_iter().map(|p| [0, 1, 2].map(|i| read[i].code(p[i]))).collect()
    } else {
        let tables = read.map(|axis| axis.code_table());
        let code = |p: &[f32; 3]| [0, 1, 2].map(|i| read[i].code_by_table(p[i], &tables[i]));
        coord.par_iter().map(code).collect()
    };
    (axes, codes)
}

/// The number that comes of writing and parsing a number.
fn as_read(number: f64) -> f64 {
    serde_json::from_str(&Value::from(number).to_string()).unwrap_or(number)
}

/// The codebook of scales; a scale of 0 has no finite logarithm and becomes the smallest entry.
fn scale_codebook(scene: &GaussianScene, report: &mut WriteReport) -> Codebook {
    let mut values = scene.log_scale.as_flattened().to_vec();
    let zero = f32::NEG_INFINITY;
    let tally = tally_rows(scene.len(), |row| {
        scene.log_scale[row].contains(&zero).then_some(f64::INFINITY)
    });
    if tally.rows > 0 {
        let finite = values.iter().copied().filter(|&v| v != zero);
        let floor = finite.fold(SMALLEST_LOG_SCALE, f32::min);
        values.iter_mut().filter(|v| **v == zero).for_each(|v| *v = floor);
        report.limit("log_scale", format!("a scale of 0 becomes {:e}", floor.exp()), tally);
    }
    Codebook::fit(values)
}

fn saturated(scene: &GaussianScene) -> LimitTally {
    tally_rows(scene.len(), |row| {
        let logit = scene.opacity_logit[row];
        (logit.is_finite() && matches!(alpha_byte(logit), 0 | 255)).then_some(f64::INFINITY)
    })
}

fn beyond_third_band(scene: &GaussianScene) -> LimitTally {
    let (width, kept) = (scene.sh_rest_len() * 3, 15 * 3);
    tally_rows(scene.len(), |row| {
        let cut = scene.sh_rest[row * width..(row + 1) * width].get(kept..)?;
        let largest = cut.iter().fold(0f32, |a, v| a.max(v.abs()));
        (largest > 0.0).then_some(f64::from(largest))
    })
}

/// The rows for which `change` gives a number.
fn tally_rows(rows: usize, change: impl Fn(usize) -> Option<f64> + Sync) -> LimitTally {
    let add = |mut tally: LimitTally, row: usize| {
        if let Some(change) = change(row) {
            tally.add(row, change);
        }
        tally
    };
    (0..rows)
        .into_par_iter()
        .fold(LimitTally::default, add)
        .reduce(LimitTally::default, LimitTally::merge)
}
