//! The scenes of several folders.

use crate::files::{bad_file, entries, name_of};
use crate::{DataError, DataSource, SourceScene};
use scenesplat_scene::{
    LabelIds, LabelledPoints, Policy, ReadOptions, SceneError, SceneFormat, open_scene,
};
use std::path::{Path, PathBuf};

/// What of a scene is read.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneFoldersOptions {
    /// Stems of the files (or PLY properties) with labels; the first that a scene has counts. Empty:
    /// what [`ReadOptions::segment`] finds by itself.
    pub segment: Vec<String>,
    /// What the ids of labels stand for; if `None`, they are classes as they are.
    pub label_ids: Option<LabelIds>,
    /// Whether language features are read; they are by far the largest part of a scene.
    pub lang_feat: bool,
    /// Whether labeled points are kept.
    pub labelled_points: bool,
    /// Scenes to leave out: names, or the part of names before an `_`.
    pub excluded_scenes: Vec<String>,
    /// Whether bad values are repaired or the scene is refused.
    pub policy: Policy,
}

impl Default for SceneFoldersOptions {
    fn default() -> Self {
        Self {
            segment: Vec::new(),
            label_ids: None,
            lang_feat: true,
            labelled_points: false,
            excluded_scenes: Vec::new(),
            policy: Policy::Repair,
        }
    }
}

/// Scenes, each a folder of `.npy` files or a file of any format, in one or several folders.
///
/// Scenes of a folder are sorted by name, folders keep their order. An id is the name of the scene;
/// with several folders it is `folder/name`.
#[derive(Debug, Clone)]
pub struct SceneFolders {
    ids: Vec<String>,
    paths: Vec<PathBuf>,
    options: SceneFoldersOptions,
}

impl SceneFolders {
    /// Lists the scenes in folders of `root`, or in `root` itself if none is named; none is read
    /// yet.
    ///
    /// # Errors
    /// If a folder is missing (those that are there are named), cannot be listed, or if there is no
    /// scene at all.
    pub fn new(
        root: &Path,
        folders: &[String],
        options: SceneFoldersOptions,
    ) -> Result<Self, DataError> {
        let mut this = Self { ids: Vec::new(), paths: Vec::new(), options };
        if folders.is_empty() {
            this.add(root, "")?;
        }
        for folder in folders {
            let path = root.join(folder);
            if !path.is_dir() {
                return Err(DataError::NoSplit {
                    root: root.to_owned(),
                    folder: folder.clone(),
                    there: subfolders(root).join(", "),
                });
            }
            let prefix = if folders.len() > 1 { format!("{folder}/") } else { String::new() };
            this.add(&path, &prefix)?;
        }
        if this.ids.is_empty() {
            let of = if folders.is_empty() { "" } else { "in " };
            let problem = format!("holds no scene {of}{}", folders.join(", "));
            let help = "a scene is a folder with a coord.npy, or a file such as .ply or .spz";
            return Err(bad_file(root, problem, help));
        }
        Ok(this)
    }

    fn add(&mut self, folder: &Path, prefix: &str) -> Result<(), DataError> {
        for path in entries(folder)?.into_iter().filter(|path| is_scene(path)) {
            let Some(name) = path.file_name().and_then(|n| n.to_str()) else {
                let problem = "has a name that is not Unicode".to_owned();
                return Err(SceneError::Format { path, problem, help: "rename it".into() }.into());
            };
            if !name.starts_with('.') && !self.excludes(name) {
                self.ids.push(format!("{prefix}{name}"));
                self.paths.push(path);
            }
        }
        Ok(())
    }

    /// Keeps the first scenes only.
    #[must_use]
    pub fn truncated(mut self, count: usize) -> Self {
        self.ids.truncate(count);
        self.paths.truncate(count);
        self
    }

    fn excludes(&self, name: &str) -> bool {
        self.options.excluded_scenes.iter().any(|excluded| {
            let rest = name.strip_prefix(excluded.as_str());
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('_'))
        })
    }

    /// The file or folder of a scene.
    ///
    /// # Errors
    /// If no scene is called that.
    pub fn path(&self, id: &str) -> Result<&Path, DataError> {
        let at = self.ids.iter().position(|known| known == id);
        let unknown = || DataError::UnknownScene { id: id.to_owned(), known: self.ids.len() };
        Ok(&self.paths[at.ok_or_else(unknown)?])
    }

    /// Which labels to read of a scene; `None` if it has none of those that are wanted.
    fn label_file(&self, path: &Path) -> Option<&String> {
        let files = self.options.segment.iter();
        if path.is_dir() {
            let there = |stem: &&String, prefix| path.join(format!("{prefix}{stem}.npy")).is_file();
            let of_gaussians = files.clone().find(|stem| there(stem, ""));
            // A scene may have labeled points only.
            return of_gaussians.or_else(|| files.into_iter().find(|stem| there(stem, "pc_")));
        }
        // Other formats have one name for labels, or a property that is looked up on reading.
        files.into_iter().next()
    }
}

impl DataSource for SceneFolders {
    fn scene_ids(&self) -> &[String] {
        &self.ids
    }

    fn load(&self, id: &str) -> Result<SourceScene, DataError> {
        let path = self.path(id)?;
        let segment = self.label_file(path).cloned();
        let unlabelled = segment.is_none() && !self.options.segment.is_empty();
        let options = ReadOptions {
            policy: self.options.policy,
            segment,
            lang_feat: self.options.lang_feat,
            // No transform knows them.
            sh_rest: false,
            ..ReadOptions::default()
        };
        let scene_error = |source| DataError::Scene { id: id.to_owned(), source };
        let loaded = open_scene(path, &options).map_err(|e| scene_error(Box::new(e)))?;
        let (mut scene, mut report) = (loaded.scene, loaded.report);
        if unlabelled {
            // Labels of other classes may be there, and must not be taken for those.
            scene.segment = None;
            if let Some(points) = &mut scene.labelled_points {
                points.segment = None;
            }
            report.notes.push(format!("no {}: without labels", self.options.segment.join(" or ")));
        }
        if !self.options.labelled_points {
            scene.labelled_points = None::<LabelledPoints>;
        }
        if let Some(ids) = self.options.label_ids {
            ids.number(&mut scene)
                .map_err(|source| scene_error(Box::new(source)))?
                .report(&mut report);
        }
        Ok(SourceScene { scene, report })
    }
}

fn is_scene(path: &Path) -> bool {
    if path.is_dir() {
        return path.join("coord.npy").is_file() || path.join("meta.json").is_file();
    }
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    SceneFormat::is_scene_file_name(name)
}

/// Names of the folders in a folder, sorted; none if it cannot be listed.
fn subfolders(root: &Path) -> Vec<String> {
    let entries = entries(root).unwrap_or_default();
    entries.iter().filter(|path| path.is_dir()).map(|path| name_of(path)).collect()
}
