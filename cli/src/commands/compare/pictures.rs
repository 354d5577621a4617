//! Which pictures belong together, and their values.

use anyhow::{Context, Result, bail};
use scenesplat::scene::picture::{Channels, Samples, read_picture};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Two files to compare.
pub(super) struct Pair {
    pub(super) name: String,
    pub(super) a: PathBuf,
    pub(super) b: PathBuf,
}

/// Values of a picture.
pub(super) enum Picture {
    /// `[H, W, 3]`, 0 to 1.
    Color { values: Vec<f32>, size: [usize; 2] },
    /// `[H, W]`, in the units of the scene, 0 where there is none.
    Depth { values: Vec<f32>, size: [usize; 2] },
}

/// Pairs files by name; two files are a pair whatever they are called.
pub(super) fn pairs(a: &Path, b: &Path) -> Result<Vec<Pair>> {
    match (kind(a)?, kind(b)?) {
        (Kind::File, Kind::File) => {
            let name = a.file_name().unwrap_or_default().to_string_lossy().into_owned();
            Ok(vec![Pair { name, a: a.to_owned(), b: b.to_owned() }])
        }
        (Kind::Folder, Kind::Folder) => folder_pairs(a, b),
        (Kind::File, Kind::Folder) => {
            bail!("{} is a file, {} a folder; give two of a kind", a.display(), b.display())
        }
        (Kind::Folder, Kind::File) => {
            bail!("{} is a folder, {} a file; give two of a kind", a.display(), b.display())
        }
    }
}

enum Kind {
    File,
    Folder,
}

fn kind(path: &Path) -> Result<Kind> {
    let about = std::fs::metadata(path).with_context(|| path.display().to_string())?;
    // A pipe would be waited for.
    match (about.is_dir(), about.is_file()) {
        (true, _) => Ok(Kind::Folder),
        (_, true) => Ok(Kind::File),
        _ => bail!("{}: is neither a file nor a folder", path.display()),
    }
}

fn folder_pairs(a: &Path, b: &Path) -> Result<Vec<Pair>> {
    let (in_a, in_b) = (picture_names(a)?, picture_names(b)?);
    for (names, others, other) in [(&in_a, &in_b, b), (&in_b, &in_a, a)] {
        let missing: Vec<&String> =
            names.iter().filter(|(stem, _)| !others.contains_key(*stem)).map(|n| n.1).collect();
        if let Some(first) = missing.first() {
            let more = match missing.len() {
                1 => String::new(),
                n => format!(" and {} more", n - 1),
            };
            bail!(
                "{}: has no {first}{more}; both folders need the same names (endings may differ)",
                other.display()
            );
        }
    }
    if in_a.is_empty() {
        bail!("{}: has no .png, .jpg or .jpeg files", a.display());
    }
    let pair = |(stem, name): (String, String)| {
        let other = in_b.get(&stem).unwrap_or(&name);
        Pair { a: a.join(&name), b: b.join(other), name }
    };
    Ok(in_a.into_iter().map(pair).collect())
}

/// Names of the pictures of a folder by their names without ending.
fn picture_names(folder: &Path) -> Result<BTreeMap<String, String>> {
    let context = || folder.display().to_string();
    let mut names = BTreeMap::new();
    for entry in std::fs::read_dir(folder).with_context(context)? {
        let path = entry.with_context(context)?.path();
        let is_picture = path
            .extension()
            .is_some_and(|e| ["png", "jpg", "jpeg"].iter().any(|p| e.eq_ignore_ascii_case(p)));
        if !(is_picture && path.is_file()) {
            continue;
        }
        let text =
            |part: Option<&std::ffi::OsStr>| part.and_then(|n| n.to_str()).map(str::to_owned);
        let (Some(stem), Some(name)) = (text(path.file_stem()), text(path.file_name())) else {
            bail!("{}: its name is not UTF-8; rename it", path.display());
        };
        if let Some(other) = names.insert(stem, name.clone()) {
            bail!("{}: {other} and {name} are one picture by their names; keep one", context());
        }
    }
    Ok(names)
}

/// Reads a picture.
pub(super) fn read(path: &Path, depth_scale: f64) -> Result<Picture> {
    let picture = read_picture(path)?;
    let size = [picture.width() as usize, picture.height() as usize];
    if let (Channels::Gray, Samples::Sixteen(depth)) = (picture.channels(), picture.samples()) {
        let unit = |v: &u16| (f64::from(*v) / depth_scale) as f32;
        return Ok(Picture::Depth { values: depth.iter().map(unit).collect(), size });
    }
    if picture.is_transparent() {
        let path = path.display();
        bail!("{path}: is transparent in places; put it on the background of the other");
    }
    Ok(Picture::Color { values: picture.to_rgb_f32(), size })
}
