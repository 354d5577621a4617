//! PyTorch checkpoints: a zip archive with a pickled description and raw storages.
//!
//! Only data are read: no class of the pickle is ever run. The pickle machine is candle's; its
//! result is taken apart here without trusting any of it.

use super::TensorEntry;
use candle_core::pickle::{Object, Stack};
use candle_core::{DType, Device, Result, Tensor, bail};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Cursor, Read};
use std::path::{Path, PathBuf};
use zip::ZipArchive;

/// Keys under which trainers keep the weights, in the order they are looked for.
const STATE_KEYS: [&str; 4] = ["state_dict", "model_state_dict", "model", "network"];
/// A pickle larger than this is no description of tensors.
const MAX_PICKLE: u64 = 256 << 20;

#[derive(Debug, Clone)]
struct Info {
    storage: String,
    dtype: DType,
    shape: Vec<usize>,
    stride: Vec<usize>,
    offset: usize,
}

/// An opened checkpoint.
#[derive(Debug)]
pub(super) struct PthFile {
    path: PathBuf,
    tensors: BTreeMap<String, Info>,
    skipped: Vec<String>,
}

/// What the top level of a checkpoint holds, for `weights` to print.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PickleValue {
    /// A tensor.
    Tensor(TensorEntry),
    /// A dictionary with this many entries, of which so many tensors.
    Dict {
        /// Entries.
        entries: usize,
        /// Tensors among them.
        tensors: usize,
    },
    /// A number, text or flag.
    Scalar(String),
    /// Anything else, by kind.
    Other(String),
}

fn archive(path: &Path) -> Result<ZipArchive<BufReader<File>>> {
    let file = File::open(path).map_err(|e| message(path, &e))?;
    ZipArchive::new(BufReader::new(file)).map_err(|e| message(path, &e))
}

fn message(path: &Path, e: &dyn std::fmt::Display) -> candle_core::Error {
    candle_core::Error::Msg(format!("{}: {e}", path.display()))
}

/// Parses the pickle; returns the folder inside the archive too.
fn unpickle(path: &Path) -> Result<(String, Object)> {
    let mut zip = archive(path)?;
    let mut names = Vec::new();
    for i in 0..zip.len() {
        names.push(zip.by_index(i).map_err(|e| message(path, &e))?.name().map_err(|e| message(path, &e))?.into_owned());
    }
    let Some(name) = names.iter().find(|n| n.as_str() == "data.pkl" || n.ends_with("/data.pkl")) else {
        bail!("{}: a zip archive without data.pkl is no PyTorch checkpoint", path.display());
    };
    let folder = name.strip_suffix("data.pkl").unwrap_or_default().to_owned();
    let order = format!("{folder}byteorder");
    if names.contains(&order) {
        let mut text = String::new();
        let entry = zip.by_name(&order).map_err(|e| message(path, &e))?;
        entry.take(16).read_to_string(&mut text)?;
        if text.trim() != "little" {
            bail!("{}: byte order {text:?}; only little-endian checkpoints are read", path.display());
        }
    }
    let mut bytes = Vec::new();
    let entry = zip.by_name(name).map_err(|e| message(path, &e))?;
    entry.take(MAX_PICKLE + 1).read_to_end(&mut bytes).map_err(|e| message(path, &e))?;
    if bytes.len() as u64 > MAX_PICKLE {
        bail!("{}: data.pkl is larger than {} MiB", path.display(), MAX_PICKLE >> 20);
    }
    // The parser belongs to another crate; a panic in it on a hostile file must stay an error.
    let parsed = std::panic::catch_unwind(|| {
        let mut stack = Stack::empty();
        stack.read_loop(&mut Cursor::new(&bytes))?;
        stack.finalize()
    });
    match parsed {
        Ok(object) => Ok((folder, object.map_err(|e| message(path, &e))?)),
        Err(_) => bail!("{}: data.pkl is damaged", path.display()),
    }
}

/// Whether a class is one of the ways to write a tensor; gives its arguments.
fn tensor_args(object: &Object) -> Option<&[Object]> {
    let Object::Reduce { callable, args } = object else { return None };
    let (Object::Class { module_name, class_name }, Object::Tuple(args)) = (&**callable, &**args)
    else {
        return None;
    };
    match (module_name.as_str(), class_name.as_str()) {
        ("torch._utils", "_rebuild_tensor_v2") => Some(args),
        ("torch._utils", "_rebuild_parameter") => tensor_args(args.first()?),
        ("torch._tensor", "_rebuild_from_type_v2") => match args.get(2)? {
            Object::Tuple(inner) => Some(inner),
            _ => None,
        },
        _ => None,
    }
}

fn index(object: &Object) -> Option<usize> {
    match object {
        Object::Int(v) => usize::try_from(*v).ok(),
        Object::Long(v) => usize::try_from(*v).ok(),
        _ => None,
    }
}

fn indices(object: &Object) -> Option<Vec<usize>> {
    match object {
        Object::Tuple(items) => items.iter().map(index).collect(),
        _ => None,
    }
}

fn tensor_info(object: &Object, folder: &str) -> Option<std::result::Result<Info, String>> {
    let args = tensor_args(object)?;
    let read = || -> Option<std::result::Result<Info, String>> {
        let Object::PersistentLoad(storage) = args.first()? else { return None };
        let Object::Tuple(storage) = &**storage else { return None };
        let (Object::Class { class_name, .. }, Object::Unicode(key)) =
            (storage.get(1)?, storage.get(2)?)
        else {
            return None;
        };
        let dtype = match class_name.as_str() {
            "FloatStorage" => DType::F32,
            "DoubleStorage" => DType::F64,
            "HalfStorage" => DType::F16,
            "BFloat16Storage" => DType::BF16,
            "LongStorage" => DType::I64,
            "ByteStorage" => DType::U8,
            other => return Some(Err(format!("storage type {other} is not supported"))),
        };
        let (offset, shape, stride) =
            (index(args.get(1)?)?, indices(args.get(2)?)?, indices(args.get(3)?)?);
        if shape.len() != stride.len() {
            return None;
        }
        Some(Ok(Info { storage: format!("{folder}data/{key}"), dtype, shape, stride, offset }))
    };
    Some(read().unwrap_or_else(|| Err("malformed tensor description".to_owned())))
}

impl PthFile {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let (folder, root) = unpickle(path)?;
        let mut out = Self { path: path.to_owned(), tensors: BTreeMap::new(), skipped: Vec::new() };
        let Object::Dict(top) = root else {
            let Some(info) = tensor_info(&root, &folder) else {
                bail!("{}: holds neither a dictionary nor a tensor", path.display());
            };
            out.tensors.insert(String::new(), info.map_err(|e| message(path, &e))?);
            return Ok(out);
        };
        let state = STATE_KEYS.iter().find(|key| {
            top.iter().any(|(k, v)| matches!((k, v), (Object::Unicode(k), Object::Dict(_)) if k == *key))
        });
        let entries = match state {
            None => top,
            Some(key) => {
                let mut state = Vec::new();
                for (k, v) in top {
                    match (k, v) {
                        (Object::Unicode(k), Object::Dict(d)) if k == **key => state = d,
                        (Object::Unicode(k), _) => out.skipped.push(k),
                        (k, _) => out.skipped.push(format!("{k:?}")),
                    }
                }
                state
            }
        };
        for (key, value) in entries {
            let Object::Unicode(name) = key else {
                out.skipped.push(format!("{key:?}"));
                continue;
            };
            match tensor_info(&value, &folder) {
                Some(Ok(info)) => {
                    out.tensors.insert(name, info);
                }
                Some(Err(e)) => bail!("{}: {name}: {e}", path.display()),
                None => out.skipped.push(name),
            }
        }
        Ok(out)
    }

    pub(super) fn entries(&self) -> BTreeMap<String, TensorEntry> {
        self.tensors.iter().map(|(n, i)| (n.clone(), i.entry())).collect()
    }

    pub(super) fn skipped(&self) -> &[String] {
        &self.skipped
    }

    pub(super) fn read(&self, name: &str) -> Result<Tensor> {
        let Some(info) = self.tensors.get(name) else {
            bail!("no such tensor");
        };
        let size = info.dtype.size_in_bytes();
        let too_large = || candle_core::Error::Msg("dimensions are too large".to_owned());
        let count = info.shape.iter().try_fold(1usize, |n, d| n.checked_mul(*d)).ok_or_else(too_large)?;
        // The last element that the strides reach.
        let mut last = info.offset;
        for (d, s) in info.shape.iter().zip(&info.stride) {
            let step = d.saturating_sub(1).checked_mul(*s).ok_or_else(too_large)?;
            last = last.checked_add(step).ok_or_else(too_large)?;
        }
        let needed = if count == 0 { 0 } else { last.checked_add(1).ok_or_else(too_large)? };
        let bytes_needed = needed.checked_mul(size).ok_or_else(too_large)?;
        let mut zip = archive(&self.path)?;
        let entry = zip.by_name(&info.storage).map_err(|e| message(&self.path, &e))?;
        // An expanded tensor (stride 0) may have more elements than its storage; real weights do not.
        if entry.size() < bytes_needed as u64 || count > entry.size() as usize / size {
            bail!(
                "{} holds {} bytes, {:?} {:?} needs {bytes_needed}",
                info.storage,
                entry.size(),
                info.shape,
                info.dtype
            );
        }
        let mut bytes = Vec::with_capacity(bytes_needed);
        entry.take(bytes_needed as u64).read_to_end(&mut bytes)?;
        if bytes.len() < bytes_needed {
            bail!("{} is cut off: {} of {bytes_needed} bytes", info.storage, bytes.len());
        }
        let mut dense = Vec::with_capacity(count * size);
        let mut at = vec![0usize; info.shape.len()];
        for _ in 0..count {
            let element =
                info.offset + at.iter().zip(&info.stride).map(|(i, s)| i * s).sum::<usize>();
            dense.extend_from_slice(&bytes[element * size..(element + 1) * size]);
            for d in (0..at.len()).rev() {
                at[d] += 1;
                if at[d] < info.shape[d] {
                    break;
                }
                at[d] = 0;
            }
        }
        Tensor::from_raw_buffer(&dense, info.dtype, &info.shape, &Device::Cpu)
    }
}

impl Info {
    fn entry(&self) -> TensorEntry {
        TensorEntry { shape: self.shape.clone(), dtype: self.dtype.as_str().to_owned() }
    }
}

/// Reads a `.pt` file that holds one tensor (bare, or alone in a dictionary), as f32.
///
/// # Errors
/// If the file holds no tensor or several.
pub fn read_single_tensor(path: &Path) -> Result<Tensor> {
    let file = PthFile::open(path)?;
    let names: Vec<&String> = file.tensors.keys().collect();
    match names.as_slice() {
        [name] => file.read(name)?.to_dtype(DType::F32),
        [] => bail!("{}: holds no tensor", path.display()),
        many => bail!("{}: holds {} tensors, expected one: {many:?}", path.display(), many.len()),
    }
}

/// What the top level of a checkpoint holds, by key.
///
/// # Errors
/// If the file is no checkpoint.
pub fn summarize(path: &Path) -> Result<BTreeMap<String, PickleValue>> {
    let (folder, root) = unpickle(path)?;
    let value = |v: &Object| match v {
        v if tensor_args(v).is_some() => match tensor_info(v, &folder) {
            Some(Ok(info)) => PickleValue::Tensor(info.entry()),
            _ => PickleValue::Other("tensor".to_owned()),
        },
        Object::Dict(d) => PickleValue::Dict {
            entries: d.len(),
            tensors: d.iter().filter(|(_, v)| tensor_args(v).is_some()).count(),
        },
        Object::Int(v) => PickleValue::Scalar(v.to_string()),
        Object::Long(v) => PickleValue::Scalar(v.to_string()),
        Object::Float(v) => PickleValue::Scalar(v.to_string()),
        Object::Bool(v) => PickleValue::Scalar(v.to_string()),
        Object::Unicode(v) => PickleValue::Scalar(v.chars().take(80).collect()),
        Object::None => PickleValue::Scalar("none".to_owned()),
        Object::List(v) => PickleValue::Other(format!("list of {}", v.len())),
        Object::Tuple(v) => PickleValue::Other(format!("tuple of {}", v.len())),
        _ => PickleValue::Other("object".to_owned()),
    };
    Ok(match &root {
        Object::Dict(entries) => entries
            .iter()
            .map(|(k, v)| {
                let key = match k {
                    Object::Unicode(k) => k.clone(),
                    k => format!("{k:?}"),
                };
                (key, value(v))
            })
            .collect(),
        other => [(String::new(), value(other))].into(),
    })
}
