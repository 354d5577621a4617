//! Sources by name.

use super::{Benchmark, SceneFolders, SceneFoldersOptions, Split, SyntheticRooms};
use crate::{DataError, DataSource, SceneDataset, Transform};
use scenesplat_rooms::{SyntheticRoomSettings, Vocabulary};
use scenesplat_scene::{LabelSet, Policy};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where the scenes of a benchmark are, and what of them is read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchmarkFolder {
    /// The folder of the splits.
    pub root: PathBuf,
    /// What the scenes are used for; says in which folders they are.
    #[serde(default)]
    pub split: Split,
    /// Folders of `root` to use instead.
    #[serde(default)]
    pub folders: Vec<String>,
    /// Shrinks and limits values as the original's scene loader does.
    #[serde(default)]
    pub exact: bool,
    /// Whether language features are read.
    #[serde(default = "yes")]
    pub lang_feat: bool,
    /// Whether labelled points are kept, for evaluation on them.
    #[serde(default)]
    pub labelled_points: bool,
    /// Scenes to leave out: names, or the part of names before an `_`.
    #[serde(default)]
    pub excluded_scenes: Vec<String>,
    /// Most scenes, the first by name; all if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<usize>,
    /// Names of the classes, one a line; needed where the program has no list.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub class_names: Option<PathBuf>,
    /// Whether bad values are repaired or the scene is refused.
    #[serde(default)]
    pub policy: Policy,
}

/// Scenes of one's own: files of any format, or folders of `.npy` files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GenericFolder {
    /// The folder of the scenes, or of `folders`.
    pub root: PathBuf,
    /// Folders of `root` to use.
    #[serde(default)]
    pub folders: Vec<String>,
    /// The file (its stem) or PLY property with the labels; `segment` or `label` if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub segment: Option<String>,
    /// Limits values as the original's scene loader for one's own data does.
    #[serde(default)]
    pub exact: bool,
    /// Whether language features are read.
    #[serde(default = "yes")]
    pub lang_feat: bool,
    /// Whether labelled points are kept, for evaluation on them.
    #[serde(default)]
    pub labelled_points: bool,
    /// Scenes to leave out: names, or the part of names before an `_`.
    #[serde(default)]
    pub excluded_scenes: Vec<String>,
    /// Most scenes, the first by name; all if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<usize>,
    /// Names of the classes, one a line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub class_names: Option<PathBuf>,
    /// Whether bad values are repaired or the scene is refused.
    #[serde(default)]
    pub policy: Policy,
}

/// Furnished synthetic rooms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SyntheticRoomsConfig {
    /// Number of rooms.
    pub count: usize,
    /// Other seeds give other rooms.
    #[serde(default)]
    pub seed: u64,
    /// What the rooms are like.
    #[serde(default)]
    pub room: SyntheticRoomSettings,
    /// Width of the built-in vocabulary that gives each Gaussian a language feature; none without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vocabulary: Option<usize>,
}

fn yes() -> bool {
    true
}

/// A source as configuration files give it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
#[non_exhaustive]
pub enum SourceConfig {
    /// ScanNet, 20 classes.
    Scannet20(BenchmarkFolder),
    /// ScanNet, 200 classes.
    Scannet200(BenchmarkFolder),
    /// ScanNet++ version 1.
    Scannetpp(BenchmarkFolder),
    /// ScanNet++ version 2.
    ScannetppV2(BenchmarkFolder),
    /// Matterport3D, 21 classes.
    Matterport21(BenchmarkFolder),
    /// Matterport3D, 160 classes.
    Matterport160(BenchmarkFolder),
    /// Replica.
    Replica(BenchmarkFolder),
    /// Hypersim.
    Hypersim(BenchmarkFolder),
    /// 3RScan.
    #[serde(rename = "3rscan")]
    ThreeRScan(BenchmarkFolder),
    /// ARKitScenes.
    Arkitscenes(BenchmarkFolder),
    /// HoliCity.
    Holicity(BenchmarkFolder),
    /// KITTI-360.
    Kitti360(BenchmarkFolder),
    /// Anybody's folder.
    Generic(GenericFolder),
    /// Furnished rooms, made as they are needed, with exact labels.
    Synthetic(SyntheticRoomsConfig),
}

impl SourceConfig {
    /// The source; scenes are listed, none is read.
    ///
    /// # Errors
    /// If a folder is missing or holds no scene.
    pub fn build(&self) -> Result<Arc<dyn DataSource>, DataError> {
        let folders = match self {
            Self::Synthetic(SyntheticRoomsConfig { count, seed, room, vocabulary }) => {
                let mut rooms = SyntheticRooms::new(*count, room.clone(), *seed);
                if let Some(dim) = *vocabulary {
                    let built = Vocabulary::new(dim).map_err(|error| {
                        crate::error::bad_setting("vocabulary", error, "a larger width")
                    })?;
                    rooms = rooms.with_vocabulary(Arc::new(built));
                }
                return Ok(Arc::new(rooms));
            }
            Self::Generic(folder) => generic(folder)?,
            other => match other.benchmark() {
                Some((benchmark, folder)) => of_benchmark(benchmark, folder)?,
                None => return Err(crate::error::bad_setting("type", "?", "a known source")),
            },
        };
        Ok(Arc::new(folders))
    }

    /// A dataset of this source; with `exact`, values are limited before the first transform.
    ///
    /// # Errors
    /// As [`build`](Self::build) and [`SceneDataset::new`].
    pub fn dataset(
        &self,
        transforms: Vec<Arc<dyn Transform>>,
        seed: u64,
        repeat: usize,
    ) -> Result<SceneDataset, DataError> {
        let limits = self.exact_limits().map(|limits| -> Arc<dyn Transform> { Arc::new(limits) });
        let transforms = limits.into_iter().chain(transforms).collect();
        SceneDataset::new(self.build()?, transforms, seed, repeat)
    }

    /// The classes of the labels; `None` if nothing is known of them.
    ///
    /// # Errors
    /// If the file of names cannot be read, or one is needed and not given.
    pub fn label_set(&self) -> Result<Option<LabelSet>, DataError> {
        match self {
            Self::Generic(folder) => {
                folder.class_names.as_deref().map(LabelSet::read).transpose().map_err(Into::into)
            }
            Self::Synthetic(_) => {
                let names = scenesplat_rooms::CLASSES.iter().map(|c| c.name.to_owned());
                Ok(Some(LabelSet::new(names.collect())?))
            }
            other => other
                .benchmark()
                .map(|(benchmark, folder)| benchmark.label_set(folder.class_names.as_deref()))
                .transpose(),
        }
    }

    /// The limits that `exact` asks for.
    fn exact_limits(&self) -> Option<crate::transforms::LimitValues> {
        match self {
            // The limits of `GenericGSDataset`, which is the one for scenes without a script.
            Self::Generic(folder) => folder.exact.then(|| Benchmark::Replica.exact_limits()),
            other => {
                let (benchmark, folder) = other.benchmark()?;
                folder.exact.then(|| benchmark.exact_limits())
            }
        }
    }

    /// Makes relative paths start at `base`, the folder of the configuration file, say.
    pub fn place(&mut self, base: &Path) {
        let folder = match self {
            Self::Synthetic(_) => return,
            Self::Generic(folder) => {
                folder.class_names.iter_mut().for_each(|path| *path = base.join(&*path));
                folder.root = base.join(&folder.root);
                return;
            }
            Self::Scannet20(folder)
            | Self::Scannet200(folder)
            | Self::Scannetpp(folder)
            | Self::ScannetppV2(folder)
            | Self::Matterport21(folder)
            | Self::Matterport160(folder)
            | Self::Replica(folder)
            | Self::Hypersim(folder)
            | Self::ThreeRScan(folder)
            | Self::Arkitscenes(folder)
            | Self::Holicity(folder)
            | Self::Kitti360(folder) => folder,
        };
        // Joining keeps absolute paths.
        folder.class_names.iter_mut().for_each(|path| *path = base.join(&*path));
        folder.root = base.join(&folder.root);
    }

    /// The benchmark, and where it is.
    pub fn benchmark(&self) -> Option<(Benchmark, &BenchmarkFolder)> {
        Some(match self {
            Self::Scannet20(folder) => (Benchmark::Scannet20, folder),
            Self::Scannet200(folder) => (Benchmark::Scannet200, folder),
            Self::Scannetpp(folder) => (Benchmark::Scannetpp, folder),
            Self::ScannetppV2(folder) => (Benchmark::ScannetppV2, folder),
            Self::Matterport21(folder) => (Benchmark::Matterport21, folder),
            Self::Matterport160(folder) => (Benchmark::Matterport160, folder),
            Self::Replica(folder) => (Benchmark::Replica, folder),
            Self::Hypersim(folder) => (Benchmark::Hypersim, folder),
            Self::ThreeRScan(folder) => (Benchmark::ThreeRScan, folder),
            Self::Arkitscenes(folder) => (Benchmark::Arkitscenes, folder),
            Self::Holicity(folder) => (Benchmark::Holicity, folder),
            Self::Kitti360(folder) => (Benchmark::Kitti360, folder),
            Self::Generic(_) | Self::Synthetic(_) => return None,
        })
    }
}

fn of_benchmark(benchmark: Benchmark, folder: &BenchmarkFolder) -> Result<SceneFolders, DataError> {
    let options = SceneFoldersOptions {
        segment: benchmark.label_files().iter().map(|&stem| stem.to_owned()).collect(),
        lang_feat: folder.lang_feat,
        labelled_points: folder.labelled_points,
        excluded_scenes: folder.excluded_scenes.clone(),
        policy: folder.policy,
    };
    let folders: Vec<String> = if folder.folders.is_empty() {
        benchmark.folders(folder.split).iter().map(|&name| name.to_owned()).collect()
    } else {
        folder.folders.clone()
    };
    let scenes = SceneFolders::new(&folder.root, &folders, options)?;
    Ok(scenes.truncated(folder.limit.unwrap_or(usize::MAX)))
}

fn generic(folder: &GenericFolder) -> Result<SceneFolders, DataError> {
    let options = SceneFoldersOptions {
        segment: folder.segment.iter().cloned().collect(),
        lang_feat: folder.lang_feat,
        labelled_points: folder.labelled_points,
        excluded_scenes: folder.excluded_scenes.clone(),
        policy: folder.policy,
    };
    let scenes = SceneFolders::new(&folder.root, &folder.folders, options)?;
    Ok(scenes.truncated(folder.limit.unwrap_or(usize::MAX)))
}
