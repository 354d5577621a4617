//! Which file is whose.

use super::listing::{FrameFiles, Listed};
use super::names::{split, without_ending};
use crate::SceneError;
use crate::printable::printable;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path};

/// The files of cameras.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FoundFiles {
    /// Number of each camera's file, if it has one.
    pub files: Vec<Option<usize>>,
    /// Names of the cameras without a file.
    pub missing: Vec<String>,
}

impl FoundFiles {
    /// Cameras with a file.
    pub fn num_found(&self) -> usize {
        self.files.len() - self.missing.len()
    }

    /// How many cameras have a file and how many have none; `what` is what one is called: "photo".
    pub fn text(&self, what: &str) -> String {
        let (found, all) = (self.num_found(), self.files.len());
        let missing = self.missing.len();
        let names = match self.missing.first() {
            None => String::new(),
            Some(first) if missing == 1 => format!(" ({})", printable(first)),
            Some(first) => format!(" ({}, …)", printable(first)),
        };
        format!("{found} of {all} cameras have a {what}; missing: {missing}{names}")
    }
}

/// A camera's name in parts.
struct Named<'a> {
    whole: &'a str,
    folders: Vec<&'a str>,
    file: &'a str,
}

/// How names are read: the same for all cameras.
#[derive(Clone, Copy)]
struct Reading {
    /// Leading folders that are left out of a camera's name.
    left_out: usize,
    /// Folders before a file that no camera names.
    unnamed: usize,
}

/// What fits a camera: how well (0 is the name as it is), and which files.
type Claim = Option<(usize, Vec<usize>)>;

impl FrameFiles {
    /// The file of each camera, by the rule of [this module](super).
    ///
    /// # Errors
    /// If cameras of different names mean one file, or files in different folders fit one camera.
    pub fn find(&self, cameras: &[&str]) -> Result<FoundFiles, SceneError> {
        let named: Vec<Named<'_>> = cameras
            .iter()
            .map(|&whole| {
                let (folders, file) = split(whole);
                Named { whole, folders, file }
            })
            .collect();
        let claims = self.best_claims(&named);
        let taken = self.settled(&named, &claims)?;
        let mut out = FoundFiles { files: vec![None; cameras.len()], missing: Vec::new() };
        for (i, (camera, claim)) in named.iter().zip(&claims).enumerate() {
            let file = claim.as_ref().map(|(_, files)| files[0]);
            // A camera of the same name means the same file; one that fits less well has none.
            out.files[i] = file.filter(|file| named[taken[file]].whole == camera.whole);
            if out.files[i].is_none() {
                out.missing.push(camera.whole.to_owned());
            }
        }
        Ok(out)
    }

    /// What fits under the reading that finds most.
    fn best_claims(&self, cameras: &[Named<'_>]) -> Vec<Claim> {
        let deepest = self.files.iter().map(|file| file.folders.len()).max().unwrap_or(0);
        let longest = cameras.iter().map(|camera| camera.folders.len()).max().unwrap_or(0);
        for unnamed in 0..=deepest {
            let mut best: (usize, Vec<Claim>) = (0, Vec::new());
            for left_out in 0..=longest {
                let claims = self.claims(cameras, Reading { left_out, unnamed });
                let files: BTreeSet<usize> =
                    claims.iter().flatten().map(|(_, files)| files[0]).collect();
                if files.len() > best.0 {
                    best = (files.len(), claims);
                }
            }
            if best.0 > 0 {
                return best.1;
            }
        }
        vec![None; cameras.len()]
    }

    /// What fits each camera.
    fn claims(&self, cameras: &[Named<'_>], reading: Reading) -> Vec<Claim> {
        let above = folders_of(&self.folder);
        // How many of the folders that are left out lead to the searched one.
        let leading = |camera: &Named<'_>| {
            let out = &camera.folders[..reading.left_out.min(camera.folders.len())];
            let pairs = out.iter().rev().zip(above.iter().rev());
            (!out.is_empty()).then(|| pairs.take_while(|(a, b)| a == b).count())
        };
        let most = cameras.iter().filter_map(leading).max();
        let claim = |camera: &Named<'_>| {
            if leading(camera).is_some() && leading(camera) < most {
                return None;
            }
            let folders = &camera.folders[reading.left_out.min(camera.folders.len())..];
            let is_there = |file: &Listed| {
                file.folders.len() == reading.unnamed + folders.len()
                    && file.folders[reading.unnamed..] == *folders
            };
            self.fitting(camera.file, is_there)
        };
        cameras.iter().map(claim).collect()
    }

    /// Files that fit a name best, best first.
    fn fitting(&self, name: &str, is_there: impl Fn(&Listed) -> bool) -> Claim {
        let [names, stems, bare] = &self.by_name;
        let last = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
        let first = name.split('.').next().unwrap_or(name);
        let places = [
            names.get(name),
            stems.get(name),
            bare.get(without_ending(name)),
            stems.get(last),
            stems.get(first),
        ];
        places.into_iter().enumerate().find_map(|(rank, files)| {
            let fits = files?.iter().copied().filter(|&i| is_there(&self.files[i]));
            let mut fits: Vec<usize> = fits.collect();
            // Sorted by name before, and so within an ending.
            fits.sort_by_key(|&i| self.files[i].ending);
            (!fits.is_empty()).then_some((rank, fits))
        })
    }

    /// The camera of each file that one means.
    fn settled(
        &self,
        cameras: &[Named<'_>],
        claims: &[Claim],
    ) -> Result<BTreeMap<usize, usize>, SceneError> {
        let mut taken: BTreeMap<usize, (usize, usize)> = BTreeMap::new();
        for (i, (camera, claim)) in cameras.iter().zip(claims).enumerate() {
            let Some((rank, files)) = claim else { continue };
            let elsewhere =
                |file: &&usize| self.files[**file].folders != self.files[files[0]].folders;
            if let Some(other) = files.iter().find(elsewhere) {
                let problem = format!(
                    "camera {:?} may mean {} and {}",
                    camera.whole,
                    self.stem(files[0]),
                    self.stem(*other)
                );
                let help =
                    "name one of the folders, or have the folders in the names of the cameras";
                return Err(SceneError::format(&self.folder, problem, help));
            }
            match taken.get(&files[0]) {
                Some((better, _)) if better < rank => {}
                Some((same, other)) if same == rank && cameras[*other].whole != camera.whole => {
                    let problem = format!(
                        "{} belongs to two cameras, {:?} and {:?}",
                        self.stem(files[0]),
                        cameras[*other].whole,
                        camera.whole
                    );
                    let help = "put files into folders as the names of the cameras have them, or give files names of \
                                their own";
                    return Err(SceneError::format(&self.folder, problem, help));
                }
                _ => {
                    taken.insert(files[0], (*rank, i));
                }
            }
        }
        Ok(taken.into_iter().map(|(file, (_, camera))| (file, camera)).collect())
    }
}

/// The folders of a path from the root.
fn folders_of(path: &Path) -> Vec<String> {
    let whole = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let parts = whole.components().filter_map(|part| match part {
        Component::Normal(name) => Some(name.to_string_lossy().into_owned()),
        _ => None,
    });
    parts.collect()
}
