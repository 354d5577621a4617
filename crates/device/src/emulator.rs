//! The emulated grid: kernels compiled for this processor, for tests. Slow: it checks every access.

use crate::{Arg, KernelEntry, KernelModule, LaunchPlan, Launcher, Scalar, TooManyItems, modules};
use std::collections::HashMap;
use std::collections::hash_map::{DefaultHasher, Entry};
use std::ffi::c_void;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, OnceLock, PoisonError};

/// What stands in for the grid; `grid.h` includes it.
const GRID: &str = include_str!("../emulation/emulated_grid.h");
/// Bytes before and after an array that no kernel may change.
const MARGIN: usize = 32;
const MARGIN_BYTE: u8 = 0xa5;

/// A grid that runs blocks and threads one after another, in order or shuffled.
#[derive(Debug, Clone, Copy)]
pub struct Emulator {
    seed: u64,
    more: &'static [KernelModule],
}

/// An array with margins.
#[derive(Debug)]
pub struct Buffer {
    memory: Vec<u64>,
    bytes: usize,
}

/// Why a launch went wrong.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// What a kernel did, or what the compiler says of its text.
    #[error("{0}")]
    Kernel(String),
    /// More items than a grid has room for.
    #[error(transparent)]
    TooManyItems(#[from] TooManyItems),
}

/// As `grid::Launch`.
#[repr(C)]
struct Launch {
    blocks: u32,
    threads: u32,
    seed: u64,
    message: *mut u8,
    message_bytes: u64,
}

/// As `grid::Array`.
#[repr(C)]
struct Array {
    values: *mut c_void,
    bytes: u64,
}

type Function = unsafe extern "C" fn(*const Launch, *const *const c_void, u64) -> i32;

impl Emulator {
    /// A grid whose blocks and threads run in order (seed 0), or shuffled by the seed.
    pub fn new(seed: u64) -> Self {
        Self { seed, more: &[] }
    }

    /// As [`new`](Self::new), with kernels of further texts beside those of [`modules()`].
    pub fn with_modules(seed: u64, more: &'static [KernelModule]) -> Self {
        Self { seed, more }
    }
}

impl Buffer {
    fn new(bytes: usize, byte: u8) -> Self {
        let words = bytes.div_ceil(8) + 2 * MARGIN / 8;
        let mut memory = vec![u64::from_ne_bytes([MARGIN_BYTE; 8]); words];
        bytemuck::cast_slice_mut::<u64, u8>(&mut memory)[MARGIN..MARGIN + bytes].fill(byte);
        Self { memory, bytes }
    }

    fn values(&self) -> &[u8] {
        &bytemuck::cast_slice::<u64, u8>(&self.memory)[MARGIN..MARGIN + self.bytes]
    }

    fn values_mut(&mut self) -> &mut [u8] {
        &mut bytemuck::cast_slice_mut::<u64, u8>(&mut self.memory)[MARGIN..MARGIN + self.bytes]
    }

    fn margins_are_whole(&self) -> bool {
        let all = bytemuck::cast_slice::<u64, u8>(&self.memory);
        all[..MARGIN].iter().chain(&all[MARGIN + self.bytes..]).all(|&b| b == MARGIN_BYTE)
    }
}

impl Launcher for Emulator {
    type Buffer = Buffer;
    type Error = EmulatorError;

    /// Filled with NaN, and row numbers that are out of range.
    fn alloc(&self, bytes: usize) -> Result<Buffer, EmulatorError> {
        Ok(Buffer::new(bytes, 0xff))
    }

    fn bytes(&self, buffer: &Buffer) -> usize {
        buffer.bytes
    }

    fn fill(&self, buffer: &mut Buffer, byte: u8) -> Result<(), EmulatorError> {
        buffer.values_mut().fill(byte);
        Ok(())
    }

    fn upload(&self, bytes: &[u8]) -> Result<Buffer, EmulatorError> {
        let mut buffer = Buffer::new(bytes.len(), 0);
        buffer.values_mut().copy_from_slice(bytes);
        Ok(buffer)
    }

    fn download(&self, buffer: &Buffer, to: &mut [u8]) -> Result<(), EmulatorError> {
        to.copy_from_slice(&buffer.values()[..to.len()]);
        Ok(())
    }

    fn launch(
        &self,
        kernel: &'static KernelEntry,
        plan: LaunchPlan,
        args: &mut [Arg<'_, Buffer>],
    ) -> Result<(), EmulatorError> {
        let entry = self.entry(kernel)?;
        let mut arrays = Vec::with_capacity(args.len());
        let mut scalars = [0u64; 64];
        for (arg, scalar) in args.iter_mut().zip(&mut scalars) {
            let array = |values: *const u8, bytes: usize| Array {
                values: values.cast_mut().cast(),
                bytes: bytes as u64,
            };
            match arg {
                Arg::In(b) => arrays.push(array(b.values().as_ptr(), b.bytes)),
                Arg::Out(b) => {
                    let bytes = b.bytes;
                    arrays.push(array(b.values_mut().as_mut_ptr(), bytes));
                }
                Arg::Scalar(value) => *scalar = word(*value),
            }
        }
        let mut next = arrays.iter();
        let pointers: Vec<*const c_void> = args
            .iter()
            .zip(&scalars)
            .map(|(arg, scalar)| match arg {
                Arg::In(_) | Arg::Out(_) => {
                    next.next().map_or(std::ptr::null(), std::ptr::from_ref).cast()
                }
                Arg::Scalar(_) => std::ptr::from_ref(scalar).cast(),
            })
            .collect();
        let mut message = [0u8; 512];
        let launch = Launch {
            blocks: plan.blocks,
            threads: plan.threads,
            seed: self.seed,
            message: message.as_mut_ptr(),
            message_bytes: message.len() as u64,
        };
        // SAFETY: the symbol has this signature (`ENTRY` in the text); arrays and scalars outlive the call.
        let status = unsafe { entry(&launch, pointers.as_ptr(), pointers.len() as u64) };
        if status != 0 {
            let end = message.iter().position(|&b| b == 0).unwrap_or(0);
            return Err(EmulatorError::Kernel(String::from_utf8_lossy(&message[..end]).into()));
        }
        let whole = |arg: &Arg<'_, Buffer>| match arg {
            Arg::In(b) => b.margins_are_whole(),
            Arg::Out(b) => b.margins_are_whole(),
            Arg::Scalar(_) => true,
        };
        match args.iter().position(|arg| !whole(arg)) {
            Some(i) => {
                Err(EmulatorError::Kernel(format!("{}: wrote beside argument {i}", kernel.name)))
            }
            None => Ok(()),
        }
    }
}

/// The bytes of a scalar, which the kernel reads from the first on.
fn word(value: Scalar) -> u64 {
    match value {
        Scalar::U32(v) => u64::from(v),
        Scalar::I32(v) => u64::from(v.cast_unsigned()),
        Scalar::U64(v) => v,
        Scalar::F32(v) => u64::from(v.to_bits()),
        Scalar::F64(v) => v.to_bits(),
    }
}

/// The compiler: `CXX`, or what is usually there.
fn compiler() -> Option<&'static str> {
    static FOUND: OnceLock<Option<String>> = OnceLock::new();
    let works = |name: &String| {
        Command::new(name).arg("--version").output().is_ok_and(|o| o.status.success())
    };
    FOUND
        .get_or_init(|| {
            let named = std::env::var("CXX").ok();
            named.into_iter().chain(["c++", "g++", "clang++"].map(String::from)).find(works)
        })
        .as_deref()
}

/// Whether kernels can be run here, as a test asks before it starts; where they cannot, it says so.
pub fn is_there() -> bool {
    let there = compiler().is_some() && cfg!(unix);
    if !there {
        println!("skipped: no C++ compiler here (c++, g++, clang++ or CXX): no kernel was run");
    }
    there
}

impl Emulator {
    /// The compiled function of a kernel.
    fn entry(&self, kernel: &KernelEntry) -> Result<Function, EmulatorError> {
        // By the text, as two modules may have one name. Compilers one at a time: a few would need more memory than
        // they save time.
        static LIBRARIES: Mutex<Option<HashMap<usize, libloading::Library>>> = Mutex::new(None);
        let Some(module) = modules().iter().chain(self.more).find(|m| m.name == kernel.module)
        else {
            return Err(problem(format!("{}: no text {}", kernel.name, kernel.module)));
        };
        let mut libraries = LIBRARIES.lock().unwrap_or_else(PoisonError::into_inner);
        let libraries = libraries.get_or_insert_with(HashMap::new);
        let library = match libraries.entry(module.source.as_ptr() as usize) {
            Entry::Occupied(there) => there.into_mut(),
            Entry::Vacant(place) => {
                let path = compiled(module)?;
                // SAFETY: a library of plain functions, just compiled from the texts.
                let library = unsafe { libloading::Library::new(&path) };
                place.insert(library.map_err(|e| problem(format!("{}: {e}", path.display())))?)
            }
        };
        let name = format!("emulate_{}\0", kernel.name);
        // SAFETY: `ENTRY` gives it this signature; libraries stay loaded until the process ends.
        let entry = unsafe { library.get::<Function>(name.as_bytes()) };
        Ok(*entry.map_err(|e| problem(format!("{}: {e}", kernel.name)))?)
    }
}

fn problem(what: String) -> EmulatorError {
    EmulatorError::Kernel(what)
}

/// Beside the running program: tests of several crates share what they compile.
fn folder() -> Result<PathBuf, std::io::Error> {
    let program = std::env::current_exe()?;
    let folder = program.parent().unwrap_or(Path::new(".")).join("emulation");
    std::fs::create_dir_all(&folder)?;
    Ok(folder)
}

/// Compiles a text, unless that was done before with the same words.
fn compiled(module: &KernelModule) -> Result<PathBuf, EmulatorError> {
    let failed = |e: std::io::Error| problem(format!("{}: {e}", module.name));
    let compiler = compiler().ok_or_else(|| problem("no C++ compiler here".to_owned()))?;
    let mut hash = DefaultHasher::new();
    (module.source, GRID, compiler, 2).hash(&mut hash);
    let folder = folder().map_err(failed)?;
    let library = folder.join(format!("{}-{:016x}.so", module.name, hash.finish()));
    if library.exists() {
        return Ok(library);
    }
    let work = tempfile::tempdir_in(&folder).map_err(failed)?;
    std::fs::write(work.path().join("emulated_grid.h"), GRID).map_err(failed)?;
    let text = work.path().join(format!("{}.cpp", module.name));
    std::fs::write(&text, module.source).map_err(failed)?;
    let made = work.path().join("made.so");
    let run = |native: &[&str]| {
        Command::new(compiler)
            .args(["-std=c++17", "-O2", "-fPIC", "-shared", "-ffp-contract=off"])
            .args(["-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "-Wno-unknown-pragmas"])
            .args(native)
            .arg("-I")
            .arg(work.path())
            .arg("-o")
            .arg(&made)
            .arg(&text)
            .output()
            .map_err(failed)
    };
    // With the processor's own fused products; without them each is a call of the mathematical library.
    let mut output = run(&["-march=native"])?;
    if !output.status.success() {
        output = run(&[])?;
    }
    if !output.status.success() {
        let messages = String::from_utf8_lossy(&output.stderr);
        return Err(problem(format!("{}:\n{messages}", module.name)));
    }
    std::fs::rename(&made, &library).map_err(failed)?;
    Ok(library)
}
