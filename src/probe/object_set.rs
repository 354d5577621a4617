//! Single objects with one label a file, in folders by class, as ModelNet10 and OmniObject3D are laid out.

use super::ProbeError;
use crate::input::open_input;
use scenesplat_datasets::{DataError, DataSource, SourceScene};
use scenesplat_scene::ReadOptions;
use std::path::{Path, PathBuf};

/// Names of the folders of objects that are learned from, and that are scored.
const PARTS: [&str; 2] = ["train", "test"];

/// Objects of a folder: `CLASS/train/FILE` and `CLASS/test/FILE`, or `train/CLASS/FILE` and `test/CLASS/FILE`. Every
/// Gaussian of a file has the class of its folder, and the file is one instance.
///
/// Classes are numbered in the order of their names; those that are learned from come first.
#[derive(Debug)]
pub struct ObjectSet {
    ids: Vec<String>,
    files: Vec<(PathBuf, i32)>,
    classes: Vec<String>,
    test: usize,
    options: ReadOptions,
}

impl ObjectSet {
    /// Looks for the objects; reads none.
    ///
    /// # Errors
    /// If a folder cannot be read, or there are no objects to learn from or to score.
    pub fn open(root: &Path, options: ReadOptions) -> Result<Self, ProbeError> {
        let top = entries(root, true)?;
        let by_part = PARTS.iter().all(|part| top.iter().any(|folder| folder.ends_with(part)));
        let class_folder = |class: &str, part: &str| match by_part {
            true => root.join(part).join(class),
            false => root.join(class).join(part),
        };
        let mut classes = Vec::new();
        let holders = if by_part {
            PARTS.map(|part| root.join(part)).to_vec()
        } else {
            vec![root.to_owned()]
        };
        for holder in &holders {
            classes.extend(entries(holder, true)?.iter().map(|folder| name_of(folder)));
        }
        classes.sort();
        classes.dedup();
        let (mut ids, mut files, mut counts) = (Vec::new(), Vec::new(), [0; 2]);
        for (part, count) in PARTS.iter().zip(&mut counts) {
            for (label, class) in (0..).zip(&classes) {
                let folder = class_folder(class, part);
                let found = if folder.is_dir() { entries(&folder, false)? } else { Vec::new() };
                *count += found.len();
                for file in found {
                    ids.push(format!("{part}/{class}/{}", name_of(&file)));
                    files.push((file, label));
                }
            }
        }
        if let Some(at) = counts.iter().position(|count| *count == 0) {
            return Err(ProbeError::NoObjects { root: root.to_owned(), part: PARTS[at] });
        }
        Ok(Self { ids, files, classes, test: counts[1], options })
    }

    /// Names of the classes, in the order of their numbers.
    pub fn classes(&self) -> &[String] {
        &self.classes
    }

    /// How many of the last objects are scored.
    pub fn test(&self) -> usize {
        self.test
    }
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Folders, or what else is in a folder and not hidden, by name.
fn entries(folder: &Path, folders: bool) -> Result<Vec<PathBuf>, ProbeError> {
    let failed = |source| ProbeError::Folder { path: folder.to_owned(), source };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if !name_of(&path).starts_with('.') && (!folders || path.is_dir()) {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

impl DataSource for ObjectSet {
    fn scene_ids(&self) -> &[String] {
        &self.ids
    }

    fn load(&self, id: &str) -> Result<SourceScene, DataError> {
        let unknown = || DataError::UnknownScene { id: id.to_owned(), known: self.ids.len() };
        let index = self.ids.iter().position(|known| known == id).ok_or_else(unknown)?;
        let (path, label) = &self.files[index];
        let mut read = read_file(id, path, &self.options)?;
        read.scene.segment = Some(vec![*label; read.scene.len()]);
        read.scene.instance = Some(vec![0; read.scene.len()]);
        Ok(read)
    }
}

/// A file of any format as a scene of a source.
///
/// # Errors
/// If it cannot be read; names the scene.
pub fn read_file(id: &str, path: &Path, options: &ReadOptions) -> Result<SourceScene, DataError> {
    let failed = |error: crate::input::InputError| DataError::Unreadable {
        id: id.to_owned(),
        source: error.into(),
    };
    let loaded = open_input(path, options).map_err(failed)?.0.loaded;
    Ok(SourceScene { scene: loaded.scene, report: loaded.report })
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_scene::GaussianScene;
    use scenesplat_scene::formats::inria_ply::write_inria_ply;

    fn object(path: &Path, at: f32) {
        let scene = GaussianScene {
            coord: vec![[at, 0.0, 0.0], [at, 1.0, 0.0]],
            log_scale: vec![[-4.0; 3]; 2],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            opacity_logit: vec![2.0; 2],
            sh_dc: vec![[0.5; 3]; 2],
            ..GaussianScene::default()
        };
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        write_inria_ply(&scene, &[], path).unwrap();
    }

    #[test]
    fn every_gaussian_of_a_file_has_the_class_of_its_folder() {
        for by_part in [false, true] {
            let root = tempfile::tempdir().unwrap();
            let at = |part: &str, class: &str, name: &str| {
                let folder = if by_part { [part, class] } else { [class, part] };
                root.path().join(folder[0]).join(folder[1]).join(name)
            };
            object(&at("train", "table", "b.ply"), 1.0);
            object(&at("train", "table", "a.ply"), 2.0);
            object(&at("train", "chair", "c.ply"), 3.0);
            object(&at("test", "table", "d.ply"), 4.0);
            // A class that is scored only has a number, too.
            object(&at("test", "bed", "e.ply"), 5.0);
            std::fs::write(at("test", "bed", ".hidden"), "").unwrap();
            let set = ObjectSet::open(root.path(), ReadOptions::default()).unwrap();
            assert_eq!(set.classes(), ["bed", "chair", "table"]);
            let ids = ["train/chair/c.ply", "train/table/a.ply", "train/table/b.ply"];
            assert_eq!(set.scene_ids()[..3], ids);
            assert_eq!(set.scene_ids()[3..], ["test/bed/e.ply", "test/table/d.ply"]);
            assert_eq!(set.test(), 2);
            for (id, label, x) in [("train/table/a.ply", 2, 2.0), ("test/bed/e.ply", 0, 5.0)] {
                let scene = set.load(id).unwrap().scene;
                assert_eq!(scene.segment, Some(vec![label; 2]));
                assert_eq!(scene.instance, Some(vec![0; 2]));
                assert_eq!(scene.coord[0][0], x);
            }
            assert!(set.load("train/lamp/x.ply").is_err());
        }
        let root = tempfile::tempdir().unwrap();
        object(&root.path().join("chair/train/a.ply"), 1.0);
        let error = ObjectSet::open(root.path(), ReadOptions::default()).unwrap_err().to_string();
        assert!(error.contains("CLASS/test/FILE"), "{error}");
        let error = ObjectSet::open(&root.path().join("none"), ReadOptions::default());
        assert!(error.unwrap_err().to_string().contains("none"));
    }
}
