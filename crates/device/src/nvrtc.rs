//! The run-time compiler of CUDA, and what it made before.
//!
//! A text is compiled when a kernel of it is first wanted, for the architecture at hand, and kept in the user's
//! cache folder under the hash of text and options. The compiler is looked for when it is needed: in the folder
//! that `SCENESPLAT_NVRTC` names, then where the system looks for libraries.

use crate::launch::KernelModule;
use cudarc::nvrtc::{CompileError, CompileOptions, compile_ptx_with_opts, result, sys};
use sha2::{Digest, Sha256};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Names a folder that holds `libnvrtc`, or the library itself.
pub const NVRTC_VARIABLE: &str = "SCENESPLAT_NVRTC";
/// Names the folder where compiled kernels are kept.
pub const CACHE_VARIABLE: &str = "SCENESPLAT_KERNEL_CACHE";

/// Contraction would round otherwise than the CPU; the texts say where they mean it.
const OPTIONS: [&str; 5] =
    ["--std=c++17", "--fmad=false", "--prec-div=true", "--prec-sqrt=true", "--ftz=false"];

/// Why a text could not be compiled.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NvrtcError {
    /// `SCENESPLAT_NVRTC` names something else.
    #[error(
        "{NVRTC_VARIABLE} names {path}, where {problem}; it must be the folder of libnvrtc.so.13 or that file"
    )]
    Named {
        /// What it names.
        path: String,
        /// What is wrong there.
        problem: String,
    },
    /// The compiler is not there.
    #[error(
        "the CUDA run-time compiler (libnvrtc.so.13) was not found: install it (`pip install \
         nvidia-cuda-nvrtc==13.0.*`, or the CUDA toolkit) and name its folder in {NVRTC_VARIABLE}"
    )]
    Missing,
    /// The compiler refuses the text.
    #[error("{module} does not compile for {architecture}:\n{log}")]
    Compile {
        /// Name of the text.
        module: String,
        /// For what it was compiled.
        architecture: String,
        /// What the compiler says.
        log: String,
    },
}

/// A processor's generation: 9.0 is Hopper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Architecture {
    /// Major number of the compute capability.
    pub major: u32,
    /// Minor number.
    pub minor: u32,
}

impl std::fmt::Display for Architecture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "compute_{}{}", self.major, self.minor)
    }
}

/// A compiled text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Compiled {
    /// The code, which the driver fits to the processor.
    pub ptx: String,
    /// Whether it was found in the cache.
    pub from_cache: bool,
    /// Why it could not be kept for the next time, if so.
    pub not_kept: Option<String>,
}

/// Where compiled texts are kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cache {
    folder: Option<PathBuf>,
}

impl Cache {
    /// The user's: [`CACHE_VARIABLE`], or `scenesplat/kernels` in the system's folder for caches.
    pub fn of_user() -> Self {
        let variable = |name| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
        let system = || {
            let base = variable("XDG_CACHE_HOME")
                .or_else(|| variable("LOCALAPPDATA"))
                .or_else(|| variable("HOME").map(|home| home.join(".cache")))?;
            Some(base.join("scenesplat").join("kernels"))
        };
        Self { folder: variable(CACHE_VARIABLE).or_else(system) }
    }

    /// A folder, which is made when it is needed.
    pub fn at(folder: impl Into<PathBuf>) -> Self {
        Self { folder: Some(folder.into()) }
    }

    /// The file of a text.
    fn file(&self, module: &KernelModule, architecture: Architecture) -> Option<PathBuf> {
        let mut hash = Sha256::new();
        // Lengths before parts, so that no two lists of parts are one text.
        for part in OPTIONS.iter().copied().chain([module.source, env!("CARGO_PKG_VERSION")]) {
            hash.update((part.len() as u64).to_le_bytes());
            hash.update(part);
        }
        let name = format!("{}-{architecture}-{}.ptx", module.name, hex(&hash.finalize()[..16]));
        Some(self.folder.as_ref()?.join(name))
    }
}

/// The first line of a kept file: the hash of all that follows.
fn headed(ptx: &str) -> String {
    format!("// sha256 {}\n{ptx}", hex(&Sha256::digest(ptx)))
}

/// What was kept, if it is whole.
fn kept(path: &Path) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    let (_, ptx) = text.split_once('\n')?;
    (headed(ptx) == text).then(|| ptx.to_owned())
}

/// Written beside and renamed, so that no other process reads half of it.
fn keep(path: &Path, ptx: &str) -> std::io::Result<()> {
    let folder = path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder)?;
    let unique = std::process::id();
    let beside = path.with_extension(format!("{unique}.part"));
    let mut file = std::fs::File::create(&beside)?;
    let written = file.write_all(headed(ptx).as_bytes()).and_then(|()| file.sync_all());
    drop(file);
    let done = written.and_then(|()| std::fs::rename(&beside, path));
    if done.is_err() {
        // The message of the first failure is the one that counts.
        let _ = std::fs::remove_file(&beside);
    }
    done
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Compiles a text, or finds it in the cache. A damaged file there counts as none and is written anew.
///
/// # Errors
/// If the compiler is missing, or refuses the text.
pub fn compile(
    module: &KernelModule,
    architecture: Architecture,
    cache: &Cache,
) -> Result<Compiled, NvrtcError> {
    let file = cache.file(module, architecture);
    if let Some(ptx) = file.as_deref().and_then(kept) {
        return Ok(Compiled { ptx, from_cache: true, not_kept: None });
    }
    let ptx = compile_anew(module, &architecture.to_string())?;
    let not_kept = match file {
        None => Some(format!("no folder for caches is known; name one in {CACHE_VARIABLE}")),
        Some(path) => {
            keep(&path, &ptx).err().map(|e| format!("{} cannot be written: {e}", path.display()))
        }
    };
    Ok(Compiled { ptx, from_cache: false, not_kept })
}

/// Compiles a text for `compute_90`, `sm_90` and the like. With `sm_…` the compiler goes on to machine code, which
/// shows what a processor has no room for.
///
/// # Errors
/// As [`compile`].
pub fn compile_anew(module: &KernelModule, architecture: &str) -> Result<String, NvrtcError> {
    find_library()?;
    let options = OPTIONS.iter().map(|&o| o.to_owned());
    let options = CompileOptions {
        options: options.chain([format!("--gpu-architecture={architecture}")]).collect(),
        name: Some(format!("{}.cu", module.name)),
        ..CompileOptions::default()
    };
    match compile_ptx_with_opts(module.source, options) {
        Ok(ptx) => Ok(ptx.to_src()),
        Err(error) => {
            let log = match error {
                CompileError::CompileError { log, .. } => log.to_string_lossy().into_owned(),
                other => other.to_string(),
            };
            let (module, architecture) = (module.name.to_owned(), architecture.to_owned());
            Err(NvrtcError::Compile { module, architecture, log })
        }
    }
}

/// Version of the compiler that is there.
///
/// # Errors
/// If there is none.
pub fn version() -> Result<(i32, i32), NvrtcError> {
    find_library()?;
    let (mut major, mut minor) = (0, 0);
    // SAFETY: both are numbers to be written.
    let status = unsafe { sys::nvrtcVersion(&mut major, &mut minor) };
    match status.result() {
        Ok(()) => Ok((major, minor)),
        Err(result::NvrtcError(_)) => Err(NvrtcError::Missing),
    }
}

/// Loads the compiler, or says why it cannot. The bindings would end the program.
fn find_library() -> Result<(), NvrtcError> {
    static NAMED: OnceLock<Result<(), (String, String)>> = OnceLock::new();
    if let Some(path) = std::env::var_os(NVRTC_VARIABLE).filter(|v| !v.is_empty()) {
        let named = NAMED.get_or_init(|| {
            load_named(Path::new(&path)).map_err(|e| (path.to_string_lossy().into_owned(), e))
        });
        if let Err((path, problem)) = named.clone() {
            return Err(NvrtcError::Named { path, problem });
        }
    }
    // SAFETY: loading a library of the system runs what it does when it is loaded, and nothing else.
    if unsafe { sys::is_culib_present() } { Ok(()) } else { Err(NvrtcError::Missing) }
}

/// Loads the compiler of a folder. Once a library is loaded the system finds it by its name.
fn load_named(path: &Path) -> Result<(), String> {
    let folder = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new(".")) };
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(|e| format!("no folder can be read ({e})"))?
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .collect();
    files.sort();
    let of = |prefix: &str| {
        files.iter().find(|f| {
            let name = f.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with(prefix) && name.contains(".so") && !name.contains(".alt.")
        })
    };
    // The compiler asks for the built-in functions by name, so they come first.
    let (Some(builtins), Some(compiler)) = (of("libnvrtc-builtins.so"), of("libnvrtc.so")) else {
        return Err("there is no libnvrtc.so and libnvrtc-builtins.so".into());
    };
    for file in [builtins, compiler] {
        // SAFETY: as in `find_library`.
        let library = unsafe { libloading::Library::new(file) }
            .map_err(|e| format!("{} does not load ({e})", file.display()))?;
        // It stays loaded as long as the program runs.
        std::mem::forget(library);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODULE: KernelModule =
        KernelModule { name: "m", source: "extern \"C\" __global__ void k() {}", entries: &[] };
    const HOPPER: Architecture = Architecture { major: 9, minor: 0 };

    #[test]
    fn what_is_kept_is_found_and_what_is_damaged_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::at(folder.path().join("a").join("b"));
        let file = cache.file(&MODULE, HOPPER).unwrap();
        assert_eq!(kept(&file), None);
        keep(&file, ".version 9.0\n").unwrap();
        assert_eq!(kept(&file).as_deref(), Some(".version 9.0\n"));
        // Found without a compiler.
        let found = compile(&MODULE, HOPPER, &cache).unwrap();
        assert!(found.from_cache && found.ptx == ".version 9.0\n" && found.not_kept.is_none());
        for damage in ["", "// sha256 00\n.version 9.0\n", "no line"] {
            std::fs::write(&file, damage).unwrap();
            assert_eq!(kept(&file), None, "{damage:?}");
        }
        let left: Vec<_> = std::fs::read_dir(file.parent().unwrap()).unwrap().collect();
        assert_eq!(left.len(), 1, "a file beside was left");
    }

    #[test]
    fn the_file_depends_on_text_and_architecture() {
        let cache = Cache::at("c");
        let name = |module: &KernelModule, major| {
            cache.file(module, Architecture { major, minor: 0 }).unwrap()
        };
        let other = KernelModule { source: "extern \"C\" __global__ void k() { }", ..MODULE };
        assert_ne!(name(&MODULE, 8), name(&MODULE, 9));
        assert_ne!(name(&MODULE, 9), name(&other, 9));
        assert_eq!(name(&MODULE, 9), name(&MODULE, 9));
    }
}
