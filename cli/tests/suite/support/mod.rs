//! Runs the program, and reads what it wrote.

mod demo_scene;
mod experiments;
mod in_process;

pub use demo_scene::{asset, asset_at, class_names};
pub use experiments::*;
pub use in_process::{scenesplat, with_defaults};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::cameras::write_cameras_json;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::{Camera, Distortion, GaussianScene, ReadOptions, open_scene};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Mutex, PoisonError};

/// Runs a command line in this process: words between spaces, or between single quotes.
pub fn line(line: &str) -> Output {
    scenesplat(&words(line))
}

/// The words of a command line.
pub fn words(line: &str) -> Vec<&str> {
    let parts = line.split('\'').enumerate();
    parts
        .flat_map(|(i, part)| match i % 2 {
            0 => part.split_whitespace().collect(),
            _ => vec![part],
        })
        .collect()
}

/// Runs a command line that is formatted as by `format!`.
macro_rules! run {
    ($($line:tt)*) => { $crate::support::line(&format!($($line)*)) };
}
pub(crate) use run;

/// The program as a process: where signals, pipes, variables, memory or processes of its own are the subject.
pub fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_scenesplat"));
    // Whatever defaults the user of this machine has.
    command.env("SCENESPLAT_CONFIG", "");
    command
}

/// Runs a command with `--json`, interrupts it when `begun` is in its first line, and asserts that it says so and
/// leaves nothing behind.
#[cfg(target_os = "linux")]
pub fn interrupted(line: &str, begun: &str) {
    use std::io::{BufRead, BufReader, Read};
    use std::process::Stdio;
    let folder = Folder::new();
    let mut command = program();
    let command =
        command.args(words(line)).args(["--verbose", "--json", &folder.at("report.json")]);
    let command = command.env("TMPDIR", folder.root()).stderr(Stdio::piped());
    let mut child = command.stdout(Stdio::null()).spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap());
    let mut first = String::new();
    said.read_line(&mut first).unwrap();
    has(&first, &[begun]);
    let interrupt = format!("kill -INT {}", child.id());
    assert!(Command::new("sh").args(["-c", &interrupt]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(1));
    let mut rest = String::new();
    said.read_to_string(&mut rest).unwrap();
    has(&rest, &["stopped"]);
    assert_eq!(folder.count(), 0);
}

/// Runs the program as a process.
pub fn process(args: &[&str]) -> Output {
    program().args(args).output().unwrap()
}

/// The tiny network with seeded weights.
pub const TINY: &str = "--config tiny --weights seeded:0";

/// Draws a small preview.png: the size of the default takes longer than a small network.
pub const SMALL_PICTURE: &str = "--preview-size=64";

/// Commands that draw a preview.png.
const WITH_PICTURE: [&str; 6] =
    ["collect-labels", "features", "lift-labels", "query", "segment", "simulate"];

/// Runs the program with the tiny seeded network, results in `out`.
pub fn tiny(command: &str, scene: &Path, out: &Path, more: &[&str]) -> Output {
    let mut args = vec![command, scene.to_str().unwrap()];
    if command == "query" {
        args.push(more[0]);
    }
    args.extend(["--config", "tiny", "--weights", "seeded:0", "--out", out.to_str().unwrap()]);
    args.extend(if command == "query" { &more[1..] } else { more });
    scenesplat(&args)
}

/// Standard error as text.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Standard output as text.
pub fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Asserts success.
#[track_caller]
pub fn done(output: &Output) {
    assert!(output.status.success(), "{}{}", stdout(output), stderr(output));
}

/// Asserts success, and gives standard output.
#[track_caller]
pub fn printed(output: &Output) -> String {
    done(output);
    stdout(output)
}

/// Asserts success, and gives standard error.
#[track_caller]
pub fn told(output: &Output) -> String {
    done(output);
    stderr(output)
}

/// Asserts that each of these is in a text.
#[track_caller]
pub fn has(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in: {text}");
    }
}

/// Asserts an exit code and parts of standard error, and gives all of it.
#[track_caller]
pub fn refused(output: &Output, code: i32, parts: &[&str]) -> String {
    let said = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{said}");
    has(&said, parts);
    assert!(!said.contains("panicked"), "{said}");
    said
}

/// Runs each command line by `run`, and asserts its exit code and a part of what is said.
#[track_caller]
pub fn all_refused<'c>(
    cases: impl IntoIterator<Item = (&'c str, i32, &'c str)>,
    run: impl Fn(&str) -> Output,
) {
    for (line, code, part) in cases {
        let output = run(line);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{line}: {said}");
        assert!(said.contains(part), "{line}: {part:?} is not in: {said}");
        assert!(!said.contains("panicked"), "{line}: {said}");
    }
}

/// A camera at `translation` that looks along +z, 40 pixels of focal length.
pub fn camera(name: &str, [width, height]: [u32; 2], translation: [f64; 3]) -> Camera {
    Camera {
        name: name.to_owned(),
        width,
        height,
        fx: 40.0,
        fy: 40.0,
        cx: f64::from(width) / 2.0,
        cy: f64::from(height) / 2.0,
        distortion: Distortion::None,
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation,
    }
}

/// Plain opaque Gaussians at these places.
pub fn balls(coord: Vec<[f32; 3]>, radius: f32, opacity_logit: f32) -> GaussianScene {
    let n = coord.len();
    GaussianScene {
        coord,
        log_scale: vec![[radius.ln(); 3]; n],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logit: vec![opacity_logit; n],
        sh_dc: vec![[0.5; 3]; n],
        ..GaussianScene::default()
    }
}

/// A folder that goes when this does.
pub struct Folder(tempfile::TempDir);

impl Folder {
    /// An empty one.
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// One that goes when the process ends: what is static is never dropped.
    pub fn lasting() -> Self {
        static ALL: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
        extern "C" fn remove() {
            let all = std::mem::take(&mut *ALL.lock().unwrap_or_else(PoisonError::into_inner));
            all.iter().for_each(|path| drop(std::fs::remove_dir_all(path)));
        }
        let folder = Self::new();
        ALL.lock().unwrap().push(folder.root().to_owned());
        // SAFETY: the function may run at the end of the process, for what it uses is static.
        assert_eq!(unsafe { libc::atexit(remove) }, 0);
        folder
    }

    /// Where a file of it is.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The same as a word of a command line.
    pub fn at(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    /// Writes a file, and gives where.
    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> String {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
        self.at(name)
    }

    /// Writes a scene as a PLY file, and gives where.
    pub fn scene(&self, name: &str, scene: &GaussianScene) -> String {
        write_inria_ply(scene, &[], &self.path(name)).unwrap();
        self.at(name)
    }

    /// Writes a synthetic room as a PLY file, and gives where.
    pub fn room(&self, name: &str, gaussians: usize, seed: u64) -> String {
        self.scene(name, &room(gaussians, seed))
    }

    /// Writes cameras, and gives where.
    pub fn cameras(&self, name: &str, cameras: &[Camera]) -> String {
        write_cameras_json(cameras, &self.path(name)).unwrap();
        self.at(name)
    }

    /// Writes the names of the classes of rooms, one a line, and gives where.
    pub fn names(&self) -> String {
        self.write("names.txt", class_names().join("\n"))
    }

    /// The folder itself.
    pub fn root(&self) -> &Path {
        self.0.path()
    }

    /// How many entries it has.
    pub fn count(&self) -> usize {
        std::fs::read_dir(self.0.path()).unwrap().count()
    }
}

/// A synthetic room.
pub fn room(gaussians: usize, seed: u64) -> GaussianScene {
    generate(&SyntheticRoomSettings::with_count(gaussians, seed)).unwrap().scene
}

/// Reads a scene.
pub fn read(path: impl AsRef<Path>) -> GaussianScene {
    open_scene(path.as_ref(), &ReadOptions::default()).unwrap().scene
}

/// The bytes of a file.
#[track_caller]
pub fn bytes(path: impl AsRef<Path>) -> Vec<u8> {
    let path = path.as_ref();
    std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The text of a file.
#[track_caller]
pub fn text(path: impl AsRef<Path>) -> String {
    String::from_utf8(bytes(path)).unwrap()
}

/// A JSON file.
#[track_caller]
pub fn json(path: impl AsRef<Path>) -> Value {
    serde_json::from_slice(&bytes(path)).unwrap()
}

/// The value of a setting in a receipt.
pub fn setting(receipt: &Value, name: &str) -> Option<String> {
    let all = receipt["settings"].as_array().unwrap();
    let found = all.iter().find(|s| s["name"] == name)?;
    Some(found["value"].as_str().unwrap().to_owned())
}

/// A .npy file.
#[track_caller]
pub fn npy(path: impl AsRef<Path>) -> NpyFile {
    NpyFile::open(path.as_ref()).unwrap()
}

/// A .npy file of numbers.
#[track_caller]
pub fn floats(path: impl AsRef<Path>) -> Vec<f32> {
    npy(path).read_f32().unwrap()
}

/// A .npy file of labels.
#[track_caller]
pub fn labels(path: impl AsRef<Path>) -> Vec<i64> {
    npy(path).read_i64().unwrap()
}

/// A file of the shared real data, or `None` after a line that says so.
pub use scenesplat_test_support::shared;
