//! What the commands read: a scene, or a labeled point cloud that becomes one.

use crate::inference::{EncodeError, SceneFeatures};
use crate::lifted::{IndexedRows, LiftedError, clusters_beside};
use crate::outputs::OpenedScene;
use scenesplat_datasets::{DataError, PointSettings, SurfacePoints, gaussians_from_points};
use scenesplat_scene::formats::labelled_ply::{LABEL_NAMES, cloud_of};
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::formats::ply::{PlyFile, is_ply};
use scenesplat_scene::formats::read_ply;
use scenesplat_scene::{
    GaussianScene, LanguageFeatures, LoadedScene, ReadOptions, SceneError, SceneFormat, open_scene,
    open_scene_bytes,
};
use std::ffi::OsStr;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Why there is no scene to work with.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InputError {
    /// A file that cannot be read.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Points that cannot be turned into Gaussians.
    #[error(transparent)]
    Points(#[from] DataError),
    /// A point cloud that is larger than what can be labeled here.
    #[error("{count} points, at most {most} become Gaussians here")]
    TooMany {
        /// Points of the file.
        count: usize,
        /// Most that are taken.
        most: usize,
    },
    /// An array that is no table of features.
    #[error("{}: expected [{rows}, D], got {shape:?}", path.display())]
    Shape {
        /// Which file.
        path: PathBuf,
        /// Rows that the scene's file has.
        rows: usize,
        /// What there is.
        shape: Vec<usize>,
    },
    /// Features of another scene.
    #[error(
        "{}: {count} rows, but the scene has {rows}: these features belong to another scene",
        path.display()
    )]
    OtherScene {
        /// Which file.
        path: PathBuf,
        /// Its rows.
        count: usize,
        /// Rows that the scene's file has.
        rows: usize,
    },
    /// Features in their index form that cannot be read.
    #[error(transparent)]
    Lifted(#[from] LiftedError),
    /// Features that cannot be used.
    #[error(transparent)]
    Features(#[from] EncodeError),
}

/// Reads a scene in any format. The points of a labeled point cloud become discs as wide as their
/// spacing, and the text says so.
///
/// # Errors
/// As [`open_scene`]; also if the points cannot be turned into Gaussians.
pub fn open_input(
    path: &Path,
    options: &ReadOptions,
) -> Result<(OpenedScene, Option<String>), InputError> {
    let label = options.segment.as_deref();
    if !labelled_cloud(path, label) {
        return Ok((OpenedScene { loaded: open_scene(path, options)?, converted: false }, None));
    }
    discs_of_points(PlyFile::open(path)?, options)
}

/// As [`open_input`], of the bytes of a file, which are given away; `path` is for messages. What a file refers to is not there. Of a
/// point cloud at most `most` points become discs.
///
/// # Errors
/// As [`open_input`]; also if a point cloud has more points.
pub fn open_input_owned(
    bytes: Vec<u8>,
    path: &Path,
    options: &ReadOptions,
    most: usize,
) -> Result<(OpenedScene, Option<String>), InputError> {
    let loaded = if is_ply(&bytes) {
        let ply = PlyFile::from_owned(bytes, path)?;
        if is_labelled_cloud(&ply, options.segment.as_deref()) {
            let count = ply.element("vertex").map_or(0, |vertex| vertex.count);
            if count > most {
                return Err(InputError::TooMany { count, most });
            }
            return discs_of_points(ply, options);
        }
        read_ply(&ply, options)?
    } else {
        open_scene_bytes(&bytes, path, options)?
    };
    Ok((OpenedScene { loaded, converted: false }, None))
}

/// The points of a labeled point cloud as discs, and what to say of it.
fn discs_of_points(
    ply: PlyFile,
    options: &ReadOptions,
) -> Result<(OpenedScene, Option<String>), InputError> {
    let path = ply.path().to_owned();
    let (cloud, report) = cloud_of(&ply, options.policy, options.segment.as_deref())?;
    // The file can be as large as what is made of it.
    drop(ply);
    let points = SurfacePoints {
        coord: cloud.coord,
        color: cloud.color,
        normal: cloud.normal,
        segment: Some(cloud.segment),
        instance: cloud.instance,
    };
    let converted = gaussians_from_points(&points, &PointSettings::default())?;
    let text = format!(
        "{}: a point cloud; its {} points became discs as wide as their spacing ({} normals \
         estimated, {} balls)",
        path.display(),
        points.coord.len(),
        converted.num_estimated_normals,
        converted.num_balls
    );
    let scene = GaussianScene { origin: cloud.origin, ..converted.scene };
    let loaded = LoadedScene {
        scene,
        report,
        kept_rows: cloud.kept_rows,
        path,
        kind: SceneFormat::Ply,
        stated_up: SceneFormat::Ply.stated_up(),
        unread: cloud.unread,
    };
    Ok((OpenedScene { loaded, converted: true }, Some(text)))
}

/// Reads the features of a scene from a file, `.npy`, `[N, D]`: a row for each row of the scene's
/// file, or for each that was kept; or from `segment_index.npy`, `[N]`, with the features of its clusters
/// beside it ([`IndexedRows`]).
///
/// # Errors
/// If the file cannot be read, or has another number of rows.
pub fn read_features(path: &Path, loaded: &LoadedScene) -> Result<SceneFeatures, InputError> {
    let rows = loaded.source_rows();
    if let Some(clusters) = clusters_beside(path) {
        return of_clusters(IndexedRows::read(path, &clusters)?, path, loaded);
    }
    let (file, count, width) = open_features(path, rows)?;
    let kept = loaded.kept_rows.as_deref();
    let values = match kept {
        _ if count == loaded.scene.len() => file.read_f32()?,
        Some(kept) if count == rows => pick(&file.read_f32()?, kept, width),
        _ => return Err(InputError::OtherScene { path: path.to_owned(), count, rows }),
    };
    Ok(SceneFeatures::from_rows(values, width)?)
}

fn of_clusters(
    found: IndexedRows,
    path: &Path,
    loaded: &LoadedScene,
) -> Result<SceneFeatures, InputError> {
    let IndexedRows { cluster_of, rows, dim } = found;
    let (count, expected) = (cluster_of.len(), loaded.source_rows());
    let cluster_of = match loaded.kept_rows.as_deref() {
        _ if count == loaded.scene.len() => cluster_of,
        Some(kept) if count == expected => {
            kept.iter().map(|&row| cluster_of[row as usize]).collect()
        }
        _ => return Err(InputError::OtherScene { path: path.to_owned(), count, rows: expected }),
    };
    let rows: Vec<f32> = rows.into_iter().map(f32::from).collect();
    Ok(SceneFeatures::from_clusters(&rows, dim, &cluster_of)?)
}

/// As [`read_features`], as a scene carries them: rounded to half precision. `rows`: those of the
/// scene's file, of which `kept` were kept (all if `None`).
///
/// # Errors
/// If the file cannot be read, or has another number of rows.
pub fn read_feature_rows(
    path: &Path,
    rows: usize,
    kept: Option<&[u32]>,
) -> Result<LanguageFeatures, InputError> {
    let (file, count, dim) = open_features(path, rows)?;
    if count != rows {
        return Err(InputError::OtherScene { path: path.to_owned(), count, rows });
    }
    let values = file.read_f16()?;
    let values = match kept {
        Some(kept) => pick(&values, kept, dim),
        None => values,
    };
    Ok(LanguageFeatures { values, dim })
}

/// A table of features with its number of rows and their width.
fn open_features(path: &Path, rows: usize) -> Result<(NpyFile, usize, usize), InputError> {
    let file = NpyFile::open(path)?;
    match *file.shape() {
        [count, width] => Ok((file, count, width)),
        _ => {
            let shape = file.shape().to_vec();
            Err(InputError::Shape { path: path.to_owned(), rows, shape })
        }
    }
}

fn pick<T: Copy>(values: &[T], rows: &[u32], width: usize) -> Vec<T> {
    rows.iter().flat_map(|&r| &values[r as usize * width..][..width]).copied().collect()
}

/// What to call a scene: its file or folder; one that is described by a `meta.json` or
/// `lod-meta.json` goes by the folder.
pub fn scene_name(path: &Path) -> Option<&OsStr> {
    let name = path.file_name()?;
    let described = name == "meta.json" || name == "lod-meta.json";
    if described { path.parent()?.file_name().or(Some(name)) } else { Some(name) }
}

/// Whether a file is a labeled point cloud rather than splats. What cannot be read is none: it is
/// refused later, with everything that can be read.
fn labelled_cloud(path: &Path, label: Option<&str>) -> bool {
    // Asked before opening: to open a pipe would wait for someone to write into it.
    if !path.metadata().is_ok_and(|about| about.is_file()) {
        return false;
    }
    let mut head = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(16).read_to_end(&mut head));
    if read.is_err() || !is_ply(&head) {
        return false;
    }
    PlyFile::open(path).is_ok_and(|ply| is_labelled_cloud(&ply, label))
}

/// Whether the file holds points with labels rather than splats. `label`: the column that is said to hold them.
fn is_labelled_cloud(ply: &PlyFile, label: Option<&str>) -> bool {
    let Some(vertex) = ply.element("vertex") else { return false };
    let has = |names: &[&str]| names.iter().any(|n| vertex.has(n));
    vertex.has("x")
        && (has(&LABEL_NAMES) || label.is_some_and(|l| vertex.has(l)))
        && !has(&["scale_0", "f_dc_0", "opacity", "packed_position"])
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_scene::formats::npy_writer::write_npy;

    #[test]
    fn of_bytes_only_as_many_points_become_discs_as_are_allowed() {
        let mut text =
            "ply\nformat ascii 1.0\nelement vertex 30\nproperty float x\nproperty float y\n\
                        property float z\nproperty int label\nend_header\n"
                .to_owned();
        (0..30).for_each(|i| text += &format!("{} {} 0 1\n", i % 6, i / 6));
        let open = |most| {
            let (bytes, options) = (text.clone().into_bytes(), ReadOptions::default());
            open_input_owned(bytes, Path::new("points.ply"), &options, most)
        };
        assert!(matches!(open(29), Err(InputError::TooMany { count: 30, most: 29 })));
        let (opened, said) = open(30).unwrap();
        assert!(opened.converted && said.unwrap().contains("30 points became discs"));
    }

    #[test]
    fn clusters_follow_the_rows_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("segment_index.npy");
        write_npy(&path, &[4], &[1, 65_535, 0, 1]).unwrap();
        write_npy(&folder.path().join("segment_features.npy"), &[2, 2], &[0.0f32, 1.0, 1.0, 0.0])
            .unwrap();
        let scene = |rows: usize, kept: Option<Vec<u32>>| LoadedScene {
            scene: GaussianScene { coord: vec![[0.0; 3]; rows], ..GaussianScene::default() },
            report: Default::default(),
            kept_rows: kept,
            path: PathBuf::from("room.ply"),
            kind: SceneFormat::Ply,
            stated_up: SceneFormat::Ply.stated_up(),
            unread: Vec::new(),
        };
        let values = |scene: &LoadedScene| {
            let found = read_features(&path, scene).unwrap();
            found.gaussian_rows(0..found.len()).unwrap()
        };
        assert_eq!(values(&scene(4, None)), [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0]);
        let error = read_features(&path, &scene(3, None)).unwrap_err();
        assert!(matches!(error, InputError::OtherScene { count: 4, .. }), "{error}");
    }

    #[test]
    fn features_follow_the_rows_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("features.npy");
        write_npy(&path, &[3, 2], &[0.0f32, 1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        let values = |kept: Option<&[u32]>| {
            let rows = read_feature_rows(&path, 3, kept).unwrap();
            assert_eq!(rows.dim, 2);
            rows.values.iter().map(|v| v.to_f32()).collect::<Vec<f32>>()
        };
        assert_eq!(values(None), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(values(Some(&[2, 0])), [4.0, 5.0, 0.0, 1.0]);
        let error = read_feature_rows(&path, 4, None).unwrap_err();
        assert!(matches!(error, InputError::OtherScene { count: 3, rows: 4, .. }), "{error}");
        write_npy(&path, &[6], &[0.0f32; 6]).unwrap();
        let error = read_feature_rows(&path, 6, None).unwrap_err();
        assert!(matches!(error, InputError::Shape { .. }), "{error}");
    }
}
