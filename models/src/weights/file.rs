//! One weight file, opened but not yet read.

use super::message::{about, at};
use super::pth::PthFile;
use candle_core::safetensors::{BufferedSafetensors, MmapedSafetensors};
use candle_core::{DType, Device, Result, Tensor, bail};
use scenesplat_scene::input_file::{COPIED_BELOW, is_lfs_pointer, open_regular_file, read_file};
use scenesplat_scene::printable;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Shape and type of an entry.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct TensorEntry {
    /// Dimensions.
    pub shape: Vec<usize>,
    /// Type name as candle spells it.
    pub dtype: String,
}

/// A `.safetensors` or PyTorch `.pth`/`.pt`/`.bin` file, told apart by content.
pub struct WeightFile {
    path: PathBuf,
    entries: BTreeMap<String, TensorEntry>,
    skipped: Vec<String>,
    kind: Kind,
}

enum Kind {
    Copied(BufferedSafetensors),
    Mapped(MmapedSafetensors),
    Pth(PthFile),
}

impl std::fmt::Debug for WeightFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WeightFile")
            .field("path", &self.path)
            .field("entries", &self.entries.len())
            .finish_non_exhaustive()
    }
}

impl WeightFile {
    /// Reads the directory of a file.
    ///
    /// A safetensors file below [`COPIED_BELOW`] is copied into memory; a larger one is mapped, and
    /// must not be cut short by another process while it is open.
    ///
    /// # Errors
    /// If the file cannot be read, is no regular file, is cut off or is of no known kind.
    pub fn open(path: &Path) -> Result<Self> {
        let mut start = [0u8; 48];
        let mut file = open_regular_file(path).map_err(|e| about(path, e))?;
        let mut got = 0;
        while got < start.len() {
            match file.read(&mut start[got..]) {
                Ok(0) => break,
                Ok(n) => got += n,
                Err(e) => bail!("{}: {e}", printable(path)),
            }
        }
        if got == 0 {
            bail!("{}: the file is empty", printable(path));
        }
        if start.starts_with(b"PK\x03\x04") {
            let pth = PthFile::open(path)?;
            let entries = pth.entries();
            let skipped = pth.skipped().to_vec();
            return Ok(Self { path: path.to_owned(), entries, skipped, kind: Kind::Pth(pth) });
        }
        if got >= 9 && start[8] == b'{' {
            return Self::open_safetensors(path);
        }
        if is_lfs_pointer(&start) {
            bail!(
                "{}: a git-lfs pointer, not the weights themselves; fetch them with git lfs pull",
                printable(path)
            );
        }
        if start[0] == 0x80 {
            bail!(
                "{}: a PyTorch file of the old kind (before 1.6); open it in PyTorch and save it \
                 again with torch.save",
                printable(path)
            );
        }
        bail!(
            "{}: neither safetensors nor a PyTorch checkpoint (zip); got bytes {:02x?}",
            printable(path),
            &start[..got.min(16)]
        )
    }

    fn open_safetensors(path: &Path) -> Result<Self> {
        let length = open_regular_file(path)
            .map_err(|e| about(path, e))?
            .metadata()
            .map_err(|e| about(path, e))?
            .len();
        let kind = if length < COPIED_BELOW {
            let bytes = read_file(path, COPIED_BELOW).map_err(|e| about(path, e))?;
            Kind::Copied(BufferedSafetensors::new(bytes).map_err(|e| at(path, e))?)
        } else {
            // SAFETY: the file is mapped read-only; that no other process cuts it short meanwhile is
            // the contract of this function.
            Kind::Mapped(unsafe { MmapedSafetensors::new(path) }.map_err(|e| at(path, e))?)
        };
        let tensors = match &kind {
            Kind::Copied(file) => file.tensors(),
            Kind::Mapped(file) => file.tensors(),
            Kind::Pth(_) => Vec::new(),
        };
        let mut entries = BTreeMap::new();
        for (name, view) in tensors {
            let dtype = DType::try_from(view.dtype())
                .map_or_else(|_| format!("{:?}", view.dtype()), |d| d.as_str().to_owned());
            entries.insert(name, TensorEntry { shape: view.shape().to_vec(), dtype });
        }
        Ok(Self { path: path.to_owned(), entries, skipped: Vec::new(), kind })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All tensors by name.
    pub fn entries(&self) -> &BTreeMap<String, TensorEntry> {
        &self.entries
    }

    /// Names of entries that are no tensors (epoch, optimizer settings, …).
    pub fn skipped(&self) -> &[String] {
        &self.skipped
    }

    /// Reads one tensor; floating-point types become f32.
    ///
    /// # Errors
    /// If there is no such entry, its type is not known, or its data are cut off or do not match
    /// their checksum (safetensors has none: compare [`WeightFile::sha256`]).
    pub fn read(&self, name: &str) -> Result<Tensor> {
        let tensor = match &self.kind {
            Kind::Copied(file) => file.load(name, &Device::Cpu),
            Kind::Mapped(file) => file.load(name, &Device::Cpu),
            Kind::Pth(pth) => pth.read(name),
        };
        // Types too new to convert exist: what goes wrong there is about this file too.
        let converted =
            tensor.and_then(|t| if t.dtype().is_float() { t.to_dtype(DType::F32) } else { Ok(t) });
        converted.map_err(|e| at(&self.path, format!("{}: {e}", printable(name))))
    }

    /// SHA-256 of the whole file, in hexadecimal.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn sha256(&self) -> Result<String> {
        let mut file = open_regular_file(&self.path).map_err(|e| about(&self.path, e))?;
        let mut hash = Sha256::new();
        let mut buffer = vec![0u8; 1 << 20];
        loop {
            let n = file.read(&mut buffer)?;
            if n == 0 {
                break;
            }
            hash.update(&buffer[..n]);
        }
        Ok(hash.finalize().iter().map(|b| format!("{b:02x}")).collect())
    }
}

/// Reads a file that holds one tensor (bare, or alone in a dictionary), as f32.
///
/// # Errors
/// If the file holds no tensor or several.
pub fn read_single_tensor(path: &Path) -> Result<Tensor> {
    let file = WeightFile::open(path)?;
    let names: Vec<&String> = file.entries.keys().collect();
    match names.as_slice() {
        [name] => file.read(name)?.to_dtype(DType::F32),
        [] => bail!("{}: holds no tensor", printable(path)),
        many => bail!("{}: holds {} tensors, expected one: {many:?}", printable(path), many.len()),
    }
}
