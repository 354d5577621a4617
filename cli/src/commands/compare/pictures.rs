//! Which pictures belong together, and their values.

use anyhow::{Context, Result, bail};
use image::DynamicImage;
use std::collections::BTreeSet;
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
    let (in_a, in_b) = (png_names(a)?, png_names(b)?);
    for (names, others, other) in [(&in_a, &in_b, b), (&in_b, &in_a, a)] {
        let missing: Vec<&str> = names.difference(others).map(String::as_str).collect();
        if let Some(first) = missing.first() {
            let more = match missing.len() {
                1 => String::new(),
                n => format!(" and {} more", n - 1),
            };
            bail!("{}: has no {first}{more}; both folders need the same names", other.display());
        }
    }
    if in_a.is_empty() {
        bail!("{}: has no .png files", a.display());
    }
    Ok(in_a.into_iter().map(|name| Pair { a: a.join(&name), b: b.join(&name), name }).collect())
}

fn png_names(folder: &Path) -> Result<BTreeSet<String>> {
    let context = || folder.display().to_string();
    let mut names = BTreeSet::new();
    for entry in std::fs::read_dir(folder).with_context(context)? {
        let path = entry.with_context(context)?.path();
        let is_png = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
        let name = path.file_name().and_then(|n| n.to_str());
        if let Some(name) = name.filter(|_| is_png && path.is_file()) {
            names.insert(name.to_owned());
        }
    }
    Ok(names)
}

/// Reads a picture.
pub(super) fn read(path: &Path, depth_scale: f64) -> Result<Picture> {
    let context = || path.display().to_string();
    let picture = image::ImageReader::open(path)
        .and_then(image::ImageReader::with_guessed_format)
        .with_context(context)?
        .decode()
        .with_context(context)?;
    let size = [picture.width() as usize, picture.height() as usize];
    if let DynamicImage::ImageLuma16(depth) = &picture {
        let unit = |v: &u16| (f64::from(*v) / depth_scale) as f32;
        return Ok(Picture::Depth { values: depth.as_raw().iter().map(unit).collect(), size });
    }
    if picture.color().has_alpha() && picture.to_rgba16().pixels().any(|p| p.0[3] != u16::MAX) {
        bail!("{}: is transparent in places; put it on the background of the other", context());
    }
    Ok(Picture::Color { values: picture.to_rgb32f().into_raw(), size })
}
