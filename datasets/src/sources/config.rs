//! Sources by name.

use super::{Benchmark, SceneFolders, SceneFoldersOptions, Split, SyntheticRooms};
use crate::effects::EffectRanges;
use crate::error::{bad_setting, require};
use crate::{DataError, DataSource, SceneDataset, Transform};
use scenesplat_rooms::{CLASSES, SyntheticRoomSettings, Vocabulary};
use scenesplat_scene::{LabelBase, LabelIds, LabelSet, Policy, TextTable};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where scenes are on disk, and what of them is read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FolderConfig {
    /// The folder of the scenes, or of `folders`, or of the splits of a benchmark.
    pub root: PathBuf,
    /// What the scenes of a benchmark are used for, `train` if not given: says in which folders they
    /// are, see [`Benchmark::folders`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub split: Option<Split>,
    /// Folders of `root` to use; for a benchmark, instead of those of its split.
    #[serde(default)]
    pub folders: Vec<String>,
    /// The file (its stem) or PLY property with the labels. If not given, that of the benchmark;
    /// `segment` or `label` without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub segment: Option<String>,
    /// Shrinks and limits values as the original's scene loader does.
    #[serde(default)]
    pub exact: bool,
    /// Whether language features are read.
    #[serde(default = "yes")]
    pub lang_feat: bool,
    /// Whether labeled points are read, to be scored instead of the Gaussians. If not given, for
    /// evaluations only, see [`SourceConfig::for_evaluation`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub labelled_points: Option<bool>,
    /// Scenes to leave out: names, or the part of names before an `_`.
    #[serde(default)]
    pub excluded_scenes: Vec<String>,
    /// Most scenes, the first by name; all if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<usize>,
    /// Names of the classes, one a line; needed where the program has no list.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub class_names: Option<PathBuf>,
    /// The id of the first class in the labels, 0 or 1. If not given, 0, but ids that have names only
    /// if they count from 1 are refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label_base: Option<LabelBase>,
    /// Whether bad values are repaired or the scene is refused.
    #[serde(default)]
    pub policy: Policy,
}

fn yes() -> bool {
    true
}

impl FolderConfig {
    /// The scenes in the given folders, labels from the first of the given files that is there.
    fn scenes(
        &self,
        folders: Vec<String>,
        labels: &[&str],
        classes: Option<&LabelSet>,
    ) -> Result<SceneFolders, DataError> {
        if let (Some(base), None) = (self.label_base, classes) {
            let expected = "nothing without class_names, the names that ids stand for";
            return Err(bad_setting("label_base", base, expected));
        }
        let segment = match &self.segment {
            Some(own) => vec![own.clone()],
            None => labels.iter().map(|&stem| stem.to_owned()).collect(),
        };
        let options = SceneFoldersOptions {
            segment,
            label_ids: classes.map(|classes| LabelIds::new(classes.len(), self.label_base)),
            lang_feat: self.lang_feat,
            labelled_points: self.labelled_points.unwrap_or(false),
            excluded_scenes: self.excluded_scenes.clone(),
            policy: self.policy,
        };
        let folders = if self.folders.is_empty() { folders } else { self.folders.clone() };
        let scenes = SceneFolders::new(&self.root, &folders, options)?;
        Ok(scenes.truncated(self.limit.unwrap_or(usize::MAX)))
    }
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
    /// What the rooms are like; their seed is that of the source.
    #[serde(default)]
    pub room: SyntheticRoomSettings,
    /// Width of the built-in vocabulary that gives each Gaussian a language feature; none without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vocabulary: Option<usize>,
    /// A table of texts (`scenesplat text --names FILE --out TABLE.safetensors`) that gives each Gaussian the vector of
    /// what its object is called, in the place of `vocabulary`: its name, or where the table has none, its class.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texts: Option<PathBuf>,
    /// What a bad capture does to those rooms that call for it, as `holes=0..3,glass=2`; nothing without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effects: Option<EffectRanges>,
}

impl SyntheticRoomsConfig {
    fn build(&self) -> Result<SyntheticRooms, DataError> {
        let expected = "nothing: `seed` of the source is the seed of its rooms";
        require(self.room.seed == 0, "room.seed", self.room.seed, expected)?;
        let mut rooms = SyntheticRooms::new(self.count, self.room.clone(), self.seed)?;
        if let Some(effects) = self.effects {
            let expected = "effects with a severity above 0, such as holes=0..3, or none of it";
            require(!effects.is_empty(), "effects", effects, expected)?;
            rooms = rooms.with_effects(effects);
        }
        if let Some(path) = &self.texts {
            let expected = "nothing beside `vocabulary`: a Gaussian has one feature";
            require(self.vocabulary.is_none(), "texts", path.display(), expected)?;
            return rooms.with_texts(&TextTable::read(path, None)?).map_err(|error| match error {
                DataError::Setting { value, expected, .. } => {
                    bad_setting("texts", format!("{} ({value})", path.display()), expected)
                }
                other => other,
            });
        }
        let Some(dim) = self.vocabulary else { return Ok(rooms) };
        let vocabulary = Vocabulary::new(dim)
            .map_err(|error| bad_setting("vocabulary", error, "a width that fits"))?;
        Ok(rooms.with_vocabulary(Arc::new(vocabulary)))
    }
}

macro_rules! source_config {
    ($($name:ident: $text:literal;)*) => {
        /// A source as configuration files give it: `type` is its name, the other entries are the
        /// fields of [`FolderConfig`] or [`SyntheticRoomsConfig`].
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(tag = "type", rename_all = "snake_case")]
        #[non_exhaustive]
        pub enum SourceConfig {
            $(
                #[doc = concat!("The benchmark `", $text, "`.")]
                #[serde(rename = $text)]
                $name(FolderConfig),
            )*
            /// Anybody's folder.
            Generic(FolderConfig),
            /// Furnished rooms, made as they are needed, with exact labels.
            Synthetic(SyntheticRoomsConfig),
        }

        impl SourceConfig {
            /// The benchmark, and where it is.
            pub fn benchmark(&self) -> Option<(Benchmark, &FolderConfig)> {
                match self {
                    $(Self::$name(folder) => Some((Benchmark::$name, folder)),)*
                    Self::Generic(_) | Self::Synthetic(_) => None,
                }
            }

            fn folder_mut(&mut self) -> Option<&mut FolderConfig> {
                match self {
                    $(Self::$name(folder) => Some(folder),)*
                    Self::Generic(folder) => Some(folder),
                    Self::Synthetic(_) => None,
                }
            }
        }
    };
}

// Names as in `Benchmark::name`.
source_config! {
    Scannet20: "scannet20";
    Scannet200: "scannet200";
    Scannetpp: "scannetpp";
    ScannetppV2: "scannetpp_v2";
    Matterport21: "matterport21";
    Matterport160: "matterport160";
    Replica: "replica";
    Hypersim: "hypersim";
    ThreeRScan: "3rscan";
    Arkitscenes: "arkitscenes";
    Holicity: "holicity";
    Kitti360: "kitti360";
}

impl SourceConfig {
    /// The source; scenes are listed, none is read.
    ///
    /// # Errors
    /// If a folder is missing or holds no scene, a setting has no meaning for this source, or a file of
    /// names cannot be read.
    pub fn build(&self) -> Result<Arc<dyn DataSource>, DataError> {
        let classes = self.label_set()?;
        match self {
            Self::Synthetic(rooms) => Ok(Arc::new(rooms.build()?)),
            Self::Generic(FolderConfig { split: Some(split), .. }) => {
                let expected = "no split: a folder of one's own has none, name `folders`";
                Err(bad_setting("split", format!("{split:?}"), expected))
            }
            Self::Generic(folder) => {
                Ok(Arc::new(folder.scenes(Vec::new(), &[], classes.as_ref())?))
            }
            other => {
                let Some((benchmark, folder)) = other.benchmark() else {
                    return Err(bad_setting("type", "?", "a known source"));
                };
                let folders = benchmark.folders(folder.split.unwrap_or_default());
                let folders = folders.iter().map(|&name| name.to_owned()).collect();
                let files = benchmark.label_files();
                Ok(Arc::new(folder.scenes(folders, files, classes.as_ref())?))
            }
        }
    }

    /// The source as an evaluation reads it: with labeled points, unless it says otherwise.
    #[must_use]
    pub fn for_evaluation(mut self) -> Self {
        if let Some(folder) = self.folder_mut() {
            folder.labelled_points.get_or_insert(true);
        }
        self
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

    /// The classes of the labels, those marked that its f-mIoU leaves out; `None` if nothing is known
    /// of them.
    ///
    /// # Errors
    /// If a file of names is given and cannot be read.
    pub fn label_set(&self) -> Result<Option<LabelSet>, DataError> {
        match self {
            Self::Generic(folder) => {
                folder.class_names.as_deref().map(LabelSet::read).transpose().map_err(Into::into)
            }
            Self::Synthetic(_) => {
                let names = CLASSES.iter().map(|class| class.name.to_owned()).collect();
                Ok(Some(LabelSet::new(names)?.exclude(super::benchmark::STRUCTURE)?))
            }
            other => match other.needed_label_set() {
                Err(DataError::NoClassNames { .. }) => Ok(None),
                known => known,
            },
        }
    }

    /// As [`label_set`](Self::label_set), where labels are needed: a benchmark must have names.
    ///
    /// # Errors
    /// As [`label_set`](Self::label_set), and if the program has no list of a benchmark and none is
    /// given.
    pub fn needed_label_set(&self) -> Result<Option<LabelSet>, DataError> {
        match self.benchmark() {
            Some((benchmark, folder)) => {
                benchmark.label_set(folder.class_names.as_deref()).map(Some)
            }
            None => self.label_set(),
        }
    }

    /// Whether labeled points are asked for by name.
    pub fn asks_for_labelled_points(&self) -> bool {
        match self {
            Self::Synthetic(_) => false,
            Self::Generic(folder) => folder.labelled_points == Some(true),
            other => other.benchmark().is_some_and(|(_, f)| f.labelled_points == Some(true)),
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
        if let Self::Synthetic(rooms) = self {
            let paths = rooms.room.furniture.iter_mut().chain(&mut rooms.texts);
            paths.for_each(|path| *path = base.join(&*path));
        }
        let Some(folder) = self.folder_mut() else { return };
        // Joining keeps absolute paths.
        folder.class_names.iter_mut().for_each(|path| *path = base.join(&*path));
        folder.root = base.join(&folder.root);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_benchmark_can_be_named() {
        for benchmark in Benchmark::ALL {
            let value = serde_json::json!({"type": benchmark.name(), "root": "a"});
            let config: SourceConfig = serde_json::from_value(value).unwrap();
            assert_eq!(config.benchmark().map(|(found, _)| found), Some(benchmark));
        }
    }

    #[test]
    fn settings_without_meaning_are_refused() {
        let read = |value| serde_json::from_value::<SourceConfig>(value).unwrap();
        let split = read(serde_json::json!({"type": "generic", "root": ".", "split": "train"}));
        assert!(split.build().err().unwrap().to_string().contains("split"));
        for count in [usize::MAX, 1 << 40] {
            let rooms = read(serde_json::json!({"type": "synthetic", "count": count}));
            assert!(rooms.build().err().unwrap().to_string().contains("count"));
        }
        let missing = serde_json::json!({"type": "generic", "root": ".", "class_names": "none"});
        assert!(read(missing).label_set().is_err());
        let unknown = read(serde_json::json!({"type": "replica", "root": "."}));
        assert!(unknown.label_set().unwrap().is_none() && unknown.needed_label_set().is_err());
    }
}
