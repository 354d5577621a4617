//! What the commands write: features, labels, colored scenes, previews.

use crate::inference::{EncodeError, SceneFeatures};
use crate::preview::{
    LegendEntry, PreviewError, PreviewSettings, SceneRows, UNLABELLED_COLOR, class_color,
    write_preview,
};
use half::f16;
use scenesplat_scene::formats::inria_ply::write_inria_ply_with;
use scenesplat_scene::formats::npy_writer::NpyRowWriter;
use scenesplat_scene::formats::ply::{
    ColumnValues, PlyColumn, PlyFile, free_column_name, write_ply_with_columns,
};
use scenesplat_scene::gaussian_scene::u8_to_dc;
use scenesplat_scene::{
    AtomicFile, GaussianScene, LoadedScene, SceneError, SceneFormat, WriteError, WriteOptions,
};
use std::path::{Path, PathBuf};

/// Why a result could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// The scene does not fit its file any more, or a scene file could not be written.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A file that could not be put in place.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// A picture that could not be drawn or written.
    #[error(transparent)]
    Preview(#[from] PreviewError),
    /// Features that went to a file could not be read.
    #[error(transparent)]
    Features(#[from] EncodeError),
    /// A file that could not be written or measured.
    #[error("{}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// A header would promise other than there is.
    #[error("{}: wrote {written} of {expected} values", path.display())]
    Incomplete {
        /// Which file.
        path: PathBuf,
        /// Values that there were.
        written: usize,
        /// Values that the scene calls for.
        expected: usize,
    },
}

type Result<T, E = OutputError> = std::result::Result<T, E>;

/// A scene as a command opened it.
#[derive(Debug)]
pub struct OpenedScene {
    /// The scene and how it was read.
    pub loaded: LoadedScene,
    /// Whether it was a point cloud that was turned into Gaussians.
    pub converted: bool,
}

/// Number type of written features.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeatureType {
    /// 4 bytes a value.
    F32,
    /// 2 bytes a value, rounded to nearest.
    F16,
}

/// Rows written at a time.
const BLOCK: usize = 4096;

/// Writes one feature row per row of the source file; rows that were left out are zero.
///
/// # Errors
/// If the file cannot be written; then nothing is left behind.
pub fn write_features_npy(
    opened: &OpenedScene,
    features: &SceneFeatures,
    ty: FeatureType,
    path: &Path,
) -> Result<u64> {
    let rows = opened.loaded.source_rows();
    let width = features.width();
    macro_rules! write {
        ($t:ty, $convert:expr) => {{
            let mut writer = NpyRowWriter::<$t>::create(path, rows, &[width])?;
            for_each_source_block(opened, features, |values| {
                let values: Vec<$t> = values.iter().map(|v| $convert(*v)).collect();
                Ok(writer.write_rows(&values)?)
            })?;
            writer.finish()?;
        }};
    }
    match ty {
        FeatureType::F32 => write!(f32, |v: f32| v),
        FeatureType::F16 => write!(f16, f16::from_f32),
    }
    file_size(path)
}

/// As [`write_features_npy`], as a safetensors file, streamed.
///
/// # Errors
/// If the file cannot be written; then nothing is left behind.
pub fn write_features_safetensors(
    opened: &OpenedScene,
    features: &SceneFeatures,
    ty: FeatureType,
    path: &Path,
) -> Result<u64> {
    use std::io::Write;
    let (rows, width) = (opened.loaded.source_rows(), features.width());
    let (name, size) = match ty {
        FeatureType::F32 => ("F32", 4),
        FeatureType::F16 => ("F16", 2),
    };
    let end = rows * width * size;
    let mut header = serde_json::json!({
        "features": { "dtype": name, "shape": [rows, width], "data_offsets": [0, end] }
    })
    .to_string();
    // The data start on a multiple of 8.
    header.push_str(&" ".repeat(header.len().next_multiple_of(8) - header.len()));
    let io = |source| OutputError::Io { path: path.to_owned(), source };
    {
        let part = AtomicFile::create(path)?;
        let mut file = std::io::BufWriter::new(part.file());
        file.write_all(&(header.len() as u64).to_le_bytes()).map_err(io)?;
        file.write_all(header.as_bytes()).map_err(io)?;
        let mut count = 0;
        for_each_source_block(opened, features, |values| {
            count += values.len();
            for v in values {
                let written = match ty {
                    FeatureType::F32 => file.write_all(&v.to_le_bytes()),
                    FeatureType::F16 => file.write_all(&f16::from_f32(*v).to_le_bytes()),
                };
                written.map_err(io)?;
            }
            Ok(())
        })?;
        file.flush().map_err(io)?;
        drop(file);
        // A header that promises more than there is would make every reader stumble.
        if count != rows * width {
            let (path, expected) = (path.to_owned(), rows * width);
            return Err(OutputError::Incomplete { path, written: count, expected });
        }
        part.commit()?;
    }
    file_size(path)
}

/// Walks over the rows of the source file, block by block.
fn for_each_source_block(
    opened: &OpenedScene,
    features: &SceneFeatures,
    mut f: impl FnMut(&[f32]) -> Result<()>,
) -> Result<()> {
    let width = features.width();
    let Some(kept) = &opened.loaded.kept_rows else {
        for start in (0..features.len()).step_by(BLOCK) {
            f(&features.gaussian_rows(start..(start + BLOCK).min(features.len()))?)?;
        }
        return Ok(());
    };
    let mut next = 0;
    let rows = opened.loaded.source_rows();
    for start in (0..rows).step_by(BLOCK) {
        let end = (start + BLOCK).min(rows);
        let mut block = vec![0f32; (end - start) * width];
        let until = next + kept[next..].partition_point(|&r| (r as usize) < end);
        let values = features.gaussian_rows(next..until)?;
        for (row, from) in kept[next..until].iter().zip(values.chunks_exact(width)) {
            let at = (*row as usize - start) * width;
            block[at..at + width].copy_from_slice(from);
        }
        next = until;
        f(&block)?;
    }
    Ok(())
}

fn file_size(path: &Path) -> Result<u64> {
    let io = |source| OutputError::Io { path: path.to_owned(), source };
    Ok(std::fs::metadata(path).map_err(io)?.len())
}

/// Columns to add to a colored scene, one value per Gaussian.
#[derive(Debug, Default)]
pub struct ResultColumns<'a> {
    /// Class, −1 = none.
    pub label: Option<&'a [i32]>,
    /// Score of the class or of the query.
    pub score: Option<&'a [f32]>,
    /// What a reader must know of them: comments of the file.
    pub warnings: &'a [String],
}

/// Writes the scene with new colors and result columns.
///
/// A PLY source keeps every element, property and value; only the colors `f_dc_*` are replaced and
/// the view-dependent `f_rest_*` set to 0, and their old values move to `source_f_dc_*` and
/// `source_f_rest_*`. Any other source becomes a standard splat PLY; where rows were left out, its
/// column `source_row` names the rows of the source.
///
/// # Errors
/// If the file cannot be written; then nothing is left behind.
pub fn write_colored_ply(
    opened: &OpenedScene,
    colors: &[[u8; 3]],
    columns: &ResultColumns<'_>,
    path: &Path,
) -> Result<u64> {
    if opened.converted || opened.loaded.kind != SceneFormat::Ply {
        write_as_splats(&opened.loaded, colors, columns, path)?;
    } else {
        write_recolored(&opened.loaded, colors, columns, path)?;
    }
    file_size(path)
}

fn f32_column<'a>(name: &'a str, values: &'a [f32]) -> PlyColumn<'a> {
    PlyColumn { name, values: ColumnValues::F32(values) }
}

fn i32_column<'a>(name: &'a str, values: &'a [i32]) -> PlyColumn<'a> {
    PlyColumn { name, values: ColumnValues::I32(values) }
}

/// A standard splat PLY of the rows that were read.
fn write_as_splats(
    loaded: &LoadedScene,
    colors: &[[u8; 3]],
    columns: &ResultColumns<'_>,
    path: &Path,
) -> Result<()> {
    let mut scene = GaussianScene {
        sh_dc: colors.iter().map(|c| c.map(u8_to_dc)).collect(),
        sh_rest: Vec::new(),
        sh_degree: 0,
        ..loaded.scene.clone()
    };
    scene.lang_feat = None;
    scene.valid_feat_mask = None;
    if columns.score.is_some() {
        scene.segment_score = None;
    }
    let source_row: Option<Vec<i32>> =
        loaded.kept_rows.as_ref().map(|kept| kept.iter().map(|r| *r as i32).collect());
    let mut extra = Vec::new();
    extra.extend(source_row.as_ref().map(|rows| i32_column("source_row", rows)));
    extra.extend(columns.label.map(|label| i32_column("label", label)));
    extra.extend(columns.score.map(|score| f32_column("score", score)));
    let options = WriteOptions { warnings: columns.warnings.to_vec(), ..WriteOptions::default() };
    Ok(write_inria_ply_with(&scene, &extra, &options, path)?)
}

/// The source's elements and properties with new colors.
fn write_recolored(
    loaded: &LoadedScene,
    colors: &[[u8; 3]],
    columns: &ResultColumns<'_>,
    path: &Path,
) -> Result<()> {
    let source = PlyFile::open(&loaded.path)?;
    let has = |name: &str| source.element("vertex").is_some_and(|e| e.has(name));
    let has_dc = has("f_dc_0");
    let dc_names = ["f_dc_0", "f_dc_1", "f_dc_2"];
    let mut new_dc: [Vec<f32>; 3] = Default::default();
    let mut old_dc: [Vec<f32>; 3] = Default::default();
    for axis in 0..3 {
        let ours: Vec<f32> = colors.iter().map(|c| u8_to_dc(c[axis])).collect();
        new_dc[axis] = loaded.to_source_rows(&ours, 0.0)?;
        if has_dc {
            old_dc[axis] = source.column_f32("vertex", dc_names[axis])?;
            if let Some(kept) = &loaded.kept_rows {
                // Rows left out keep their color.
                new_dc[axis].clone_from(&old_dc[axis]);
                for (&row, v) in kept.iter().zip(&ours) {
                    new_dc[axis][row as usize] = *v;
                }
            }
        }
    }
    let labels = columns.label.map(|l| loaded.to_source_rows(l, -1)).transpose()?;
    let scores = columns.score.map(|s| loaded.to_source_rows(s, 0.0)).transpose()?;
    let free = |name: &str| free_column_name(&source, name);
    let aside = |name: &str| free(&format!("source_{name}"));
    let (label_name, score_name) = (free("label"), free("score"));
    // Higher harmonics would tint the new colors; they become 0, their values move aside.
    let rest_names = (0..72).map(|i| format!("f_rest_{i}")).filter(|name| has_dc && has(name));
    let rest_names: Vec<String> = rest_names.collect();
    let rest: Vec<Vec<f32>> =
        rest_names.iter().map(|n| Ok(source.column_f32("vertex", n)?)).collect::<Result<_>>()?;
    let zeros = if rest.is_empty() { Vec::new() } else { vec![0f32; loaded.source_rows()] };
    let mut recolored: Vec<PlyColumn<'_>> =
        dc_names.iter().zip(&new_dc).map(|(name, values)| f32_column(name, values)).collect();
    recolored.extend(rest_names.iter().map(|name| f32_column(name, &zeros)));
    let old: Vec<(String, &[f32])> = (rest_names.iter().zip(&rest))
        .map(|(name, values)| (aside(name), values.as_slice()))
        .chain(dc_names.iter().zip(&old_dc).map(|(name, values)| (aside(name), values.as_slice())))
        .filter(|_| has_dc)
        .collect();
    let mut append: Vec<PlyColumn<'_>> =
        old.iter().map(|(name, values)| f32_column(name, values)).collect();
    append.extend(labels.as_ref().map(|labels| i32_column(&label_name, labels)));
    append.extend(scores.as_ref().map(|scores| f32_column(&score_name, scores)));
    if !has_dc {
        // A scene colored by bytes, or not at all: the new colors are columns of their own.
        append.splice(0..0, recolored.drain(..));
    }
    Ok(write_ply_with_columns(&source, &recolored, &append, columns.warnings, path)?)
}

/// Colors of labels; gray where there is none.
pub fn label_colors(labels: &[i32]) -> Vec<[u8; 3]> {
    labels.iter().map(|&l| usize::try_from(l).map_or(UNLABELLED_COLOR, class_color)).collect()
}

/// Classes that occur, for the legend of a preview.
pub fn legend(labels: &[i32], names: &[String]) -> Vec<LegendEntry> {
    let mut counts = vec![0u64; names.len()];
    let mut unknown = 0;
    for &l in labels {
        match usize::try_from(l).ok().and_then(|l| counts.get_mut(l)) {
            Some(count) => *count += 1,
            None => unknown += 1,
        }
    }
    let classes = names.iter().zip(&counts).enumerate().filter(|(_, (_, count))| **count > 0);
    let mut out: Vec<LegendEntry> = classes
        .map(|(i, (name, &count))| LegendEntry { name: name.clone(), color: class_color(i), count })
        .collect();
    if unknown > 0 {
        out.push(LegendEntry {
            name: "unknown".to_owned(),
            color: UNLABELLED_COLOR,
            count: unknown,
        });
    }
    out
}

/// Draws a scene in the given colors.
///
/// # Errors
/// If the picture cannot be drawn or written.
pub fn write_scene_preview(
    scene: &GaussianScene,
    colors: &[[u8; 3]],
    legend: &[LegendEntry],
    settings: &PreviewSettings,
    path: &Path,
) -> Result<u64> {
    let rows = SceneRows::of(scene);
    Ok(write_preview(path, &rows.rows(scene, colors), legend, settings)?)
}
