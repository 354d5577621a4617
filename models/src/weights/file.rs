//! One weight file, opened but not yet read.

use super::pth::PthFile;
use candle_core::{DType, Device, Result, Tensor, bail};
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
    Safetensors(candle_core::safetensors::MmapedSafetensors),
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
    /// # Errors
    /// If the file cannot be read, is cut off or is of no known kind.
    pub fn open(path: &Path) -> Result<Self> {
        let mut start = [0u8; 16];
        let mut file = std::fs::File::open(path)
            .map_err(|e| candle_core::Error::Msg(format!("{}: {e}", path.display())))?;
        let mut got = 0;
        while got < start.len() {
            match file.read(&mut start[got..]) {
                Ok(0) => break,
                Ok(n) => got += n,
                Err(e) => bail!("{}: {e}", path.display()),
            }
        }
        if got == 0 {
            bail!("{}: the file is empty", path.display());
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
        if start.starts_with(b"version https://") {
            bail!(
                "{}: a git-lfs pointer, not the weights themselves; fetch them with git lfs pull",
                path.display()
            );
        }
        if start[0] == 0x80 {
            bail!(
                "{}: a PyTorch file of the old kind (before 1.6); open it in PyTorch and save it \
                 again with torch.save",
                path.display()
            );
        }
        bail!(
            "{}: neither safetensors nor a PyTorch checkpoint (zip); got bytes {:02x?}",
            path.display(),
            &start[..got]
        )
    }

    fn open_safetensors(path: &Path) -> Result<Self> {
        // SAFETY: the file is mapped read-only; changing it while it is read is the user's fault,
        // as for every memory-mapped reader.
        let mapped = unsafe { candle_core::safetensors::MmapedSafetensors::new(path) }
            .map_err(|e| candle_core::Error::Msg(format!("{}: {e}", path.display())))?;
        let mut entries = BTreeMap::new();
        for (name, view) in mapped.tensors() {
            let dtype = DType::try_from(view.dtype())
                .map_or_else(|_| format!("{:?}", view.dtype()), |d| d.as_str().to_owned());
            entries.insert(name, TensorEntry { shape: view.shape().to_vec(), dtype });
        }
        let kind = Kind::Safetensors(mapped);
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
            Kind::Safetensors(mapped) => mapped.load(name, &Device::Cpu),
            Kind::Pth(pth) => pth.read(name),
        };
        // Types too new to convert exist: what goes wrong there is about this file too.
        let converted =
            tensor.and_then(|t| if t.dtype().is_float() { t.to_dtype(DType::F32) } else { Ok(t) });
        converted
            .map_err(|e| candle_core::Error::Msg(format!("{}: {name}: {e}", self.path.display())))
    }

    /// SHA-256 of the whole file, in hexadecimal.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn sha256(&self) -> Result<String> {
        let mut file = std::fs::File::open(&self.path)?;
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
        [] => bail!("{}: holds no tensor", path.display()),
        many => bail!("{}: holds {} tensors, expected one: {many:?}", path.display(), many.len()),
    }
}
