//! The formats: what each is called, how its files are recognized, what reads and writes them.
//!
//! Everything else that knows of formats (opening, writing, messages, the choices of a command line,
//! searches for scenes in folders) asks this table. A new format is a file of its own, its `mod` in
//! `formats`, a name in [`SceneFormat`] and a row in [`FORMATS`].

use super::write::{WriteOptions, WriteProgress, WriteReport};
use super::{
    LoadedScene, ReadOptions, compressed_ply, gltf, inria_ply, ksplat, npy_folder, sog, splat, spz,
    usd,
};
use crate::{AtomicFile, Frame, GaussianScene, SceneError, StatedUp, Up};
use serde::Serialize;
use std::path::Path;

/// The kinds of files and folders that hold a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneFormat {
    /// PLY with one float per property: loses nothing.
    Ply,
    /// PLY with packed integers in chunks of 256.
    CompressedPly,
    /// Niantic's compressed container.
    Spz,
    /// Binary glTF with Gaussian attributes.
    Glb,
    /// glTF with Gaussian attributes, as JSON or binary; what is read is called so.
    Gltf,
    /// Textures and codebooks, in one archive; what is read is called so, whatever the kind.
    Sog,
    /// Textures and codebooks, as files of a folder.
    SogFolder,
    /// Textures and codebooks in parts, with levels of detail.
    SogStreamed,
    /// Sections of buckets, for one viewer.
    Ksplat,
    /// USD as text.
    Usda,
    /// USD as text in an archive.
    Usdz,
    /// 32 bytes a Gaussian, no header.
    Splat,
    /// Folder of `.npy` files.
    NpyFolder,
}

impl SceneFormat {
    /// What the format prescribes about up, in the frame of scenes in memory: SPZ and glTF have +y up
    /// in their own, trainers leave scenes as image-based pipelines have them, with y down, and rooms of
    /// the `.npy` data sets stand on their floor.
    pub fn stated_up(self) -> StatedUp {
        let (direction, source) = match self {
            Self::Spz => (Up::MINUS_Y, "SPZ"),
            Self::Glb | Self::Gltf => (Up::MINUS_Y, "glTF"),
            Self::Usda | Self::Usdz => (Up::MINUS_Y, "USD"),
            Self::NpyFolder => (Up::PLUS_Z, "the habit of .npy data sets"),
            _ => (Up::MINUS_Y, "the convention of trainers"),
        };
        StatedUp { direction, source }
    }
}

/// Whether bytes are a file of this kind.
type Recognize = fn(&[u8]) -> bool;

/// Reads a scene from the bytes of a file.
type Read = fn(&[u8], &Path, &ReadOptions) -> Result<LoadedScene, SceneError>;

/// Writes a scene to `To`, and reports what the format cannot hold.
type Write<To> = fn(
    &GaussianScene,
    &To,
    &WriteOptions,
    &mut WriteReport,
    WriteProgress<'_>,
) -> Result<(), SceneError>;

/// How scenes are written.
#[derive(Clone, Copy)]
pub(crate) enum Writer {
    /// As one file that holds everything.
    File(Write<AtomicFile>),
    /// As one file, and a file of labels beside it.
    Beside(Write<AtomicFile>),
    /// As several files, which the writer puts in place.
    Files(Write<Path>),
}
use Writer::{Beside, File, Files};

/// One format.
pub struct FormatRow {
    /// Which one.
    pub format: SceneFormat,
    /// Its word in messages, reports and on the command line.
    pub name: &'static str,
    /// What it is, for people who choose one.
    pub about: &'static str,
    /// What names of its files end in, lower case, with the dot; without a dot it is the whole name.
    pub endings: &'static [&'static str],
    /// Where a whole file of this kind is recognized by its bytes, and read from them. Formats that
    /// come as several files, and PLY, are recognized in `open`.
    pub(super) reader: Option<(Recognize, Read)>,
    pub(super) writer: Option<Writer>,
    /// The frame that it prescribes; readers and writers convert from and to it. `None`: it says
    /// nothing, and the numbers of the file are those in memory.
    pub frame: Option<Frame>,
    /// Arrays that it keeps, of those that most do not: language features and labeled points,
    /// normals, harmonics, the place of scenes far from 0, and what else a file may say.
    pub(super) keeps: Keeps,
}

/// Arrays that a format may keep.
#[derive(Clone, Copy)]
pub(super) struct Keeps {
    pub(super) features: bool,
    pub(super) normals: bool,
    pub(super) harmonics: bool,
    /// Positions far from 0: doubles, or an offset.
    pub(super) origin: bool,
    /// Columns of unknown meaning.
    pub(super) extra: bool,
    /// Whether it was trained for antialiased rendering.
    pub(super) antialiased: bool,
    /// Which way the file says is up.
    pub(super) up: bool,
}

const PLAIN: Keeps = Keeps {
    features: false,
    normals: false,
    harmonics: true,
    origin: false,
    extra: false,
    antialiased: false,
    up: false,
};

/// All formats, in the order in which files are tried: those without a mark of their own last.
pub static FORMATS: [FormatRow; 13] = [
    FormatRow {
        format: SceneFormat::CompressedPly,
        name: "compressed-ply",
        about: "packed integers in chunks of 256",
        endings: &[".compressed.ply"],
        reader: None,
        writer: Some(Beside(compressed_ply::write_compressed_ply)),
        frame: None,
        keeps: Keeps { antialiased: true, up: true, ..PLAIN },
    },
    FormatRow {
        format: SceneFormat::Ply,
        name: "ply",
        about: "floats; loses nothing",
        endings: &[".ply"],
        reader: None,
        writer: Some(File(inria_ply::write_ply)),
        frame: None,
        keeps: Keeps {
            normals: true,
            origin: true,
            extra: true,
            antialiased: true,
            up: true,
            ..PLAIN
        },
    },
    FormatRow {
        format: SceneFormat::Spz,
        name: "spz",
        about: "Niantic's container",
        endings: &[".spz"],
        reader: Some((spz::is_spz, spz::read_spz)),
        writer: Some(File(spz::write_spz)),
        frame: Some(Frame::RUB),
        keeps: Keeps { antialiased: true, ..PLAIN },
    },
    FormatRow {
        format: SceneFormat::Gltf,
        name: "gltf",
        about: "glTF with KHR_gaussian_splatting",
        endings: &[".gltf"],
        reader: Some((gltf::is_gltf, gltf::read_gltf)),
        writer: None,
        frame: Some(Frame::LUF),
        keeps: PLAIN,
    },
    FormatRow {
        format: SceneFormat::Glb,
        name: "glb",
        about: "binary glTF with KHR_gaussian_splatting",
        endings: &[".glb"],
        // Read as glTF.
        reader: None,
        writer: Some(Beside(gltf::write_glb)),
        frame: Some(Frame::LUF),
        keeps: Keeps { origin: true, ..PLAIN },
    },
    FormatRow {
        format: SceneFormat::Usda,
        name: "usda",
        about: "USD text with ParticleField3DGaussianSplat",
        endings: &[".usda"],
        reader: Some((usd::is_usda, usd::read_usda)),
        writer: Some(File(usd::write_usda)),
        frame: Some(Frame::RUB),
        keeps: Keeps { origin: true, antialiased: true, ..PLAIN },
    },
    FormatRow {
        format: SceneFormat::Usdz,
        name: "usdz",
        about: "the same text in an archive",
        endings: &[".usdz"],
        reader: Some((usd::is_usdz, usd::read_usdz)),
        writer: Some(File(usd::write_usdz)),
        frame: Some(Frame::RUB),
        keeps: Keeps { origin: true, antialiased: true, ..PLAIN },
    },
    FormatRow {
        format: SceneFormat::Sog,
        name: "sog",
        about: "textures in one archive",
        endings: &[".sog"],
        reader: Some((sog::is_sog_archive, sog::read_sog_archive)),
        writer: Some(File(sog::write_sog)),
        frame: None,
        keeps: Keeps { antialiased: true, ..PLAIN },
    },
    FormatRow {
        format: SceneFormat::SogFolder,
        name: "sog-folder",
        about: "textures in a folder",
        endings: &["meta.json"],
        reader: None,
        writer: Some(Files(sog::write_sog_folder)),
        frame: None,
        keeps: Keeps { antialiased: true, ..PLAIN },
    },
    FormatRow {
        format: SceneFormat::SogStreamed,
        name: "sog-streamed",
        about: "textures in parts, with levels of detail",
        endings: &["lod-meta.json"],
        reader: None,
        writer: Some(Files(sog::write_sog_streamed)),
        frame: None,
        keeps: Keeps { antialiased: true, ..PLAIN },
    },
    FormatRow {
        format: SceneFormat::Ksplat,
        name: "ksplat",
        about: "buckets, for one viewer",
        endings: &[".ksplat"],
        reader: Some((ksplat::is_ksplat, ksplat::read_ksplat)),
        writer: None,
        frame: None,
        keeps: PLAIN,
    },
    FormatRow {
        format: SceneFormat::Splat,
        name: "splat",
        about: "32 bytes a Gaussian, no harmonics",
        endings: &[".splat"],
        reader: Some((splat::is_splat, splat::read_splat)),
        writer: Some(Beside(splat::write_splat)),
        frame: None,
        keeps: Keeps { harmonics: false, ..PLAIN },
    },
    FormatRow {
        format: SceneFormat::NpyFolder,
        name: "npy",
        about: "folder of .npy files with coord.npy, no harmonics",
        endings: &[],
        reader: None,
        writer: Some(Files(npy_folder::write_npy_scene)),
        frame: None,
        keeps: Keeps {
            features: true,
            normals: true,
            harmonics: false,
            origin: true,
            extra: true,
            ..PLAIN
        },
    },
];

impl FormatRow {
    /// Whether scenes can be written in it.
    pub fn is_writable(&self) -> bool {
        self.writer.is_some()
    }

    /// How to name a file so that it is of this format.
    fn naming(&self) -> &'static str {
        self.endings.first().copied().unwrap_or("no ending (folder)")
    }

    fn names(&self, name: &str) -> bool {
        self.endings.iter().any(|e| if e.starts_with('.') { name.ends_with(e) } else { name == *e })
    }
}

impl SceneFormat {
    /// The format that a name asks for by its ending: `.ply`, `.compressed.ply`, …, `meta.json` (a
    /// SOG folder), or no ending at all (a folder of `.npy` files). It need not be one that can be
    /// written.
    pub fn from_path(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_ascii_lowercase();
        // The first that fits; `.compressed.ply` is before `.ply`.
        let by_name = FORMATS.iter().find(|row| row.names(&name)).map(|row| row.format);
        let folder = path.extension().is_none().then_some(Self::NpyFolder);
        by_name.or(folder)
    }

    /// The format of that [`name`](Self::name).
    pub fn from_name(name: &str) -> Option<Self> {
        FORMATS.iter().find(|row| row.name == name).map(|row| row.format)
    }

    /// What the table says of it.
    pub fn row(self) -> &'static FormatRow {
        let at = FORMATS.iter().position(|row| row.format == self);
        &FORMATS[at.unwrap_or_default()]
    }

    /// The word for it in messages, reports and on the command line.
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// Whether scenes can be written in it.
    pub fn is_writable(self) -> bool {
        self.row().is_writable()
    }

    /// What a file may be called to be written: `.ply (ply), .spz (spz), …`.
    pub fn writable_endings() -> String {
        let rows = FORMATS.iter().filter(|row| row.is_writable());
        let names: Vec<String> = rows.map(|r| format!("{} ({})", r.naming(), r.name)).collect();
        names.join(", ")
    }

    /// Whether a name is one of a file that may hold a scene by itself; names of parts of folders,
    /// such as `meta.json`, are not.
    pub fn is_scene_file_name(name: &str) -> bool {
        let name = name.to_ascii_lowercase();
        let ends = |e: &&str| e.starts_with('.') && name.ends_with(*e);
        FORMATS.iter().any(|row| row.endings.iter().any(ends))
    }
}

/// What can be read, for messages.
pub(super) fn supported() -> String {
    let row = |row: &FormatRow| match row.endings.first() {
        Some(ending) => format!("{ending} ({})", row.about),
        None => row.about.to_owned(),
    };
    let rows: Vec<String> = FORMATS.iter().map(row).collect();
    format!("supported are {}", rows.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_is_found_by_name_and_ending() {
        for row in &FORMATS {
            assert_eq!(SceneFormat::from_name(row.name), Some(row.format));
            assert!(std::ptr::eq(row.format.row(), row));
            for ending in row.endings {
                let name =
                    if ending.starts_with('.') { format!("A{ending}") } else { (*ending).into() };
                assert_eq!(SceneFormat::from_path(Path::new(&name)), Some(row.format), "{name}");
                let upper = name.to_uppercase();
                assert_eq!(SceneFormat::from_path(Path::new(&upper)), Some(row.format), "{upper}");
                assert_eq!(SceneFormat::is_scene_file_name(&name), ending.starts_with('.'));
                assert!(supported().contains(ending));
            }
            assert_eq!(
                SceneFormat::writable_endings().contains(&format!("({})", row.name)),
                row.is_writable()
            );
        }
        assert_eq!(SceneFormat::from_path(Path::new("room")), Some(SceneFormat::NpyFolder));
        assert_eq!(SceneFormat::from_path(Path::new("room.obj")), None);
        assert_eq!(SceneFormat::from_name("obj"), None);
        assert!(!SceneFormat::is_scene_file_name("room.obj"));
    }
}
