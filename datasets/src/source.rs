//! Where scenes come from.

use crate::{DataError, RoomSettings, generate_room};
use scenesplat_scene::{GaussianScene, ReadOptions, RepairReport, SceneError, open_scene};
use std::path::{Path, PathBuf};

/// A scene as a source gives it.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceScene {
    /// The usable Gaussians.
    pub scene: GaussianScene,
    /// What was repaired or left out on reading.
    pub report: RepairReport,
}

/// A set of scenes: which there are, and how one is read.
///
/// What happens to a scene afterwards (voxels, augmentation, batches) never depends on the source.
pub trait DataSource: Send + Sync {
    /// Names of the scenes, in a fixed order.
    fn scene_ids(&self) -> &[String];

    /// Reads one scene.
    ///
    /// # Errors
    /// If the source has no such scene or it cannot be read; the error names it.
    fn load(&self, id: &str) -> Result<SourceScene, DataError>;
}

/// Generated rooms: data without files, for tests, benchmarks and trials of a pipeline.
#[derive(Debug, Clone)]
pub struct GeneratedRooms {
    ids: Vec<String>,
    num_gaussians: usize,
    seed: u64,
}

impl GeneratedRooms {
    /// Rooms `room-0`, `room-1`, … with seeds `seed`, `seed + 1`, …
    pub fn new(num_rooms: usize, num_gaussians: usize, seed: u64) -> Self {
        Self { ids: (0..num_rooms).map(|i| format!("room-{i}")).collect(), num_gaussians, seed }
    }
}

impl DataSource for GeneratedRooms {
    fn scene_ids(&self) -> &[String] {
        &self.ids
    }

    fn load(&self, id: &str) -> Result<SourceScene, DataError> {
        let seed = self.seed.wrapping_add(position(&self.ids, id)? as u64);
        let room = generate_room(&RoomSettings { num_gaussians: self.num_gaussians, seed })?;
        let report = RepairReport { source_rows: room.scene.len(), ..RepairReport::default() };
        Ok(SourceScene { scene: room.scene, report })
    }
}

/// The scenes in one folder: its PLY files, and its subfolders with a `coord.npy`.
///
/// An id is the name of the file or subfolder; ids are sorted, so the order is the same everywhere.
#[derive(Debug, Clone)]
pub struct SceneFolder {
    root: PathBuf,
    ids: Vec<String>,
    options: ReadOptions,
}

impl SceneFolder {
    /// Lists the scenes of a folder; none is read yet.
    ///
    /// # Errors
    /// If the folder cannot be listed, or a scene's name is not valid Unicode.
    pub fn new(root: &Path, options: ReadOptions) -> Result<Self, DataError> {
        let list_error = |source| SceneError::Io {
            path: root.to_owned(),
            action: "cannot list the folder of scenes",
            source,
        };
        let mut ids = Vec::new();
        for entry in std::fs::read_dir(root).map_err(list_error)? {
            let path = entry.map_err(list_error)?.path();
            let is_ply = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply"));
            if (is_ply && path.is_file()) || path.join("coord.npy").is_file() {
                let name = path.file_name().and_then(|n| n.to_str());
                let name = name.ok_or_else(|| SceneError::Format {
                    path: path.clone(),
                    problem: "has a name that is not Unicode".to_owned(),
                    help: "rename it".to_owned(),
                })?;
                ids.push(name.to_owned());
            }
        }
        ids.sort_unstable();
        Ok(Self { root: root.to_owned(), ids, options })
    }
}

impl DataSource for SceneFolder {
    fn scene_ids(&self) -> &[String] {
        &self.ids
    }

    fn load(&self, id: &str) -> Result<SourceScene, DataError> {
        // Only listed names, so an id cannot lead out of the folder.
        position(&self.ids, id)?;
        let loaded = open_scene(&self.root.join(id), &self.options)
            .map_err(|source| DataError::Scene { id: id.to_owned(), source: Box::new(source) })?;
        Ok(SourceScene { scene: loaded.scene, report: loaded.report })
    }
}

fn position(ids: &[String], id: &str) -> Result<usize, DataError> {
    ids.iter()
        .position(|known| known == id)
        .ok_or_else(|| DataError::UnknownScene { id: id.to_owned(), known: ids.len() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rooms_differ_and_unknown_ids_are_named() {
        let source: Box<dyn DataSource> = Box::new(GeneratedRooms::new(2, 500, 1));
        assert_eq!(source.scene_ids(), ["room-0", "room-1"]);
        let (a, b) = (source.load("room-0").unwrap().scene, source.load("room-1").unwrap().scene);
        assert_eq!((a.len(), b.len()), (500, 500));
        assert_ne!(a.coord, b.coord);
        let error = source.load("room-2").unwrap_err();
        assert!(error.to_string().contains("room-2"), "{error}");
    }
    #[test]
    fn folders_list_scenes_and_name_broken_ones() {
        let folder = tempfile::tempdir().unwrap();
        let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
                   property float z\nend_header\n1 2 3\n";
        std::fs::write(folder.path().join("b.ply"), ply).unwrap();
        std::fs::write(folder.path().join("a.PLY"), "not a scene").unwrap();
        std::fs::write(folder.path().join("notes.txt"), "").unwrap();
        std::fs::create_dir(folder.path().join("empty")).unwrap();
        std::fs::create_dir(folder.path().join("c")).unwrap();
        std::fs::write(folder.path().join("c/coord.npy"), "").unwrap();
        let source = SceneFolder::new(folder.path(), ReadOptions::default()).unwrap();
        assert_eq!(source.scene_ids(), ["a.PLY", "b.ply", "c"]);
        for id in ["a.PLY", "c"] {
            let error = source.load(id).unwrap_err();
            assert!(matches!(&error, DataError::Scene { id: named, .. } if named == id), "{error}");
        }
        let error = source.load("../b.ply").unwrap_err();
        assert!(matches!(error, DataError::UnknownScene { known: 3, .. }));
        assert!(SceneFolder::new(&folder.path().join("none"), ReadOptions::default()).is_err());
    }

    #[test]
    fn real_objects_load() {
        let root = std::env::var_os("SCENESPLAT_SHARED").map_or_else(
            || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared"),
            PathBuf::from,
        );
        let objects = root.join("real/objects");
        if !objects.is_dir() {
            println!("skipped: real/objects is not in the shared data (set SCENESPLAT_SHARED)");
            return;
        }
        let source = SceneFolder::new(&objects, ReadOptions::default()).unwrap();
        let loaded = source.load("hamburger.ply").unwrap();
        assert_eq!(loaded.scene.len(), 52_709);
        let plan = crate::FastPlan::default().build(&loaded.scene).unwrap();
        plan.input(0).unwrap().check().unwrap();
    }
}
