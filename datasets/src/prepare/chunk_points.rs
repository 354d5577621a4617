//! Labeled points of scenes to the chunks that were cut of them.

use crate::DataError;
use crate::files::{arrays, bad_file, picked, positions};
use crate::from_points::tree;
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::formats::npy_writer::write_npy;
use std::path::Path;

/// Which points belong to a chunk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChunkTransfer {
    /// Points around each Gaussian that may belong, at least 1.
    pub neighbours: usize,
    /// How far they may be, meters, above 0.
    pub max_distance: f64,
}

impl Default for ChunkTransfer {
    /// The original's: 16 within 0.25 m.
    fn default() -> Self {
        Self { neighbours: 16, max_distance: 0.25 }
    }
}

/// What a chunk got.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ChunkTransferReport {
    /// Points of the scene.
    pub points: usize,
    /// Points of the chunk.
    pub kept: usize,
    /// Files written.
    pub files: Vec<String>,
}

/// Writes `pc_*.npy` into a chunk's folder: of the scene's labeled points those that are among the nearest of any of
/// the chunk's Gaussians, in the scene's order. Files of the chunk that are there are replaced, each as a whole.
///
/// # Errors
/// If the scene has no `pc_coord.npy`, a file of it has another number of rows, or nothing can be written.
pub fn transfer_to_chunks(
    scene: &Path,
    chunk: &Path,
    settings: &ChunkTransfer,
) -> Result<ChunkTransferReport, DataError> {
    let coord = positions(&scene.join("pc_coord.npy"), [0.0; 3])?;
    let gaussians = positions(&chunk.join("coord.npy"), [0.0; 3])?;
    let tree = tree(&coord)?;
    let limit = settings.max_distance * settings.max_distance;
    let near: Vec<Vec<u32>> = tree.map_nearest(
        &gaussians,
        settings.neighbours,
        || (),
        |(), _, near| near.iter().filter(|n| n.distance_squared <= limit).map(|n| n.row).collect(),
    );
    let mut is_kept = vec![false; coord.len()];
    near.iter().flatten().for_each(|&row| is_kept[row as usize] = true);
    let kept: Vec<u32> = (0..coord.len() as u32).filter(|&row| is_kept[row as usize]).collect();
    let mut report =
        ChunkTransferReport { points: coord.len(), kept: kept.len(), files: Vec::new() };
    for stem in arrays(scene)?.into_iter().filter(|stem| stem.starts_with("pc_")) {
        let name = format!("{stem}.npy");
        let file = NpyFile::open(&scene.join(&name))?;
        let shape = file.shape().to_vec();
        if shape.first() != Some(&coord.len()) {
            let problem = format!("is {shape:?}, pc_coord.npy has {} rows", coord.len());
            return Err(bad_file(file.path(), problem, "both have to be of one scene"));
        }
        let width: usize = shape[1..].iter().product();
        let mut to = shape.clone();
        to[0] = kept.len();
        let path = chunk.join(&name);
        if file.ty().is_float() {
            write_npy(&path, &to, &picked(&file.read_f32()?, width, &kept))?;
        } else {
            let values: Vec<i32> =
                file.read_i64()?.into_iter().map(|v| i32::try_from(v).unwrap_or(-1)).collect();
            write_npy(&path, &to, &picked(&values, width, &kept))?;
        }
        report.files.push(name);
    }
    Ok(report)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;

    #[test]
    fn a_chunk_gets_the_points_around_its_gaussians() {
        let dir = tempfile::tempdir().unwrap();
        let (scene, chunk) = (dir.path().join("a"), dir.path().join("a_0"));
        std::fs::create_dir(&scene).unwrap();
        std::fs::create_dir(&chunk).unwrap();
        let coord: Vec<[f32; 3]> = (0..10).map(|i| [0.1 * i as f32, 0.0, 0.0]).collect();
        write_npy(&scene.join("pc_coord.npy"), &[10, 3], coord.as_flattened()).unwrap();
        let labels: Vec<i32> = (0..10).collect();
        write_npy(&scene.join("pc_segment20.npy"), &[10], &labels).unwrap();
        let pairs: Vec<i64> = (0..20).collect();
        write_npy(&scene.join("pc_instance.npy"), &[10, 2], &pairs).unwrap();
        write_npy(&chunk.join("coord.npy"), &[2, 3], &[0.31f32, 0.0, 0.0, 5.0, 0.0, 0.0]).unwrap();
        let settings = ChunkTransfer::default();
        let report = transfer_to_chunks(&scene, &chunk, &settings).unwrap();
        // Within 0.25 of 0.31: 0.1 to 0.5; nothing is near 5.
        assert_eq!((report.points, report.kept, report.files.len()), (10, 5, 3));
        let read = |name: &str| NpyFile::open(&chunk.join(name)).unwrap();
        assert_eq!(read("pc_segment20.npy").read_i64().unwrap(), [1, 2, 3, 4, 5]);
        assert_eq!(read("pc_instance.npy").read_i64().unwrap(), [2, 3, 4, 5, 6, 7, 8, 9, 10, 11]);
        assert_eq!(read("pc_coord.npy").shape(), [5, 3]);
        let few = ChunkTransfer { neighbours: 2, ..settings };
        assert_eq!(transfer_to_chunks(&scene, &chunk, &few).unwrap().kept, 2);
        write_npy(&scene.join("pc_segment20.npy"), &[9], &labels[..9]).unwrap();
        let error = transfer_to_chunks(&scene, &chunk, &settings).unwrap_err().to_string();
        assert!(error.contains("pc_segment20.npy") && error.contains("10 rows"), "{error}");
    }

    #[test]
    fn a_chunk_keeps_the_values_of_its_points_in_the_scenes_order() {
        assert_eq!(ChunkTransfer::default(), ChunkTransfer { neighbours: 16, max_distance: 0.25 });
        let dir = tempfile::tempdir().unwrap();
        let (scene, chunk) = (dir.path().join("a"), dir.path().join("a_0"));
        std::fs::create_dir(&scene).unwrap();
        std::fs::create_dir(&chunk).unwrap();
        let error = transfer_to_chunks(&scene, &chunk, &ChunkTransfer::default()).unwrap_err();
        assert!(
            std::error::Error::source(&error).is_some() || error.to_string().contains("pc_coord")
        );
        // Exactly 0.5 from the first Gaussian: the third point; the second is farther, the first is the second's.
        let coord = [[4.0f32, 1.0, 2.0], [1.0, 0.0, 0.5625], [1.0, 0.5, 0.0], [1.0, 0.0, 0.25]];
        write_npy(&scene.join("pc_coord.npy"), &[4, 3], coord.as_flattened()).unwrap();
        write_npy(&scene.join("pc_normal.npy"), &[4, 2], &[1.5f32, 2., 3., 4., 5., 6., 7., 8.])
            .unwrap();
        write_npy(&scene.join("pc_segment.npy"), &[4], &[1i64 << 40, 1, -1, 3]).unwrap();
        write_npy(&scene.join("segment.npy"), &[4], &[0i32, 1, 2, 3]).unwrap();
        write_npy(&chunk.join("coord.npy"), &[2, 3], &[1.0f32, 0., 0., 4., 1., 2.]).unwrap();
        let settings = ChunkTransfer { neighbours: 3, max_distance: 0.5 };
        let report = transfer_to_chunks(&scene, &chunk, &settings).unwrap();
        assert_eq!((report.points, report.kept), (4, 3));
        assert_eq!(report.files, ["pc_coord.npy", "pc_normal.npy", "pc_segment.npy"]);
        let read = |name: &str| NpyFile::open(&chunk.join(name)).unwrap();
        let kept = [[4.0f32, 1.0, 2.0], [1.0, 0.5, 0.0], [1.0, 0.0, 0.25]];
        assert_eq!(read("pc_coord.npy").read_f32().unwrap(), kept.as_flattened());
        assert_eq!(read("pc_normal.npy").read_f32().unwrap(), [1.5, 2., 5., 6., 7., 8.]);
        assert_eq!(read("pc_normal.npy").shape(), [3, 2]);
        // A number that no i32 holds is no label.
        assert_eq!(read("pc_segment.npy").read_i64().unwrap(), [-1, -1, 3]);
        assert!(!chunk.join("segment.npy").exists());
    }
}
