//! PyTorch checkpoints: a zip archive with a pickled description and raw storages.
//!
//! Only data are read: no class of the pickle is ever run.

use super::TensorEntry;
use super::message::about;
use super::pickle::{Pickle, Ref, Value};
use candle_core::{DType, Device, Result, Tensor, bail};
use scenesplat_scene::input_file::open_regular_file;
use scenesplat_scene::printable;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use zip::ZipArchive;
use zip::read::ZipReadOptions;

/// Keys under which trainers keep the weights, in the order they are looked for.
const STATE_KEYS: [&str; 4] = ["state_dict", "model_state_dict", "model", "network"];
/// A pickle larger than this is no description of tensors.
const MAX_PICKLE: u64 = 64 << 20;
/// Sizes in a file are only claims: more memory than this is taken as data arrive.
const FIRST_READ: usize = 1 << 20;

type Archive = ZipArchive<BufReader<File>>;

#[derive(Debug, Clone)]
struct Info {
    storage: String,
    /// Or the name of a storage type that has no counterpart.
    dtype: std::result::Result<DType, String>,
    shape: Vec<usize>,
    stride: Vec<usize>,
    offset: usize,
}

/// An opened checkpoint.
#[derive(Debug)]
pub(super) struct PthFile {
    archive: Mutex<Archive>,
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

fn message(path: &Path, e: &dyn std::fmt::Display) -> candle_core::Error {
    candle_core::Error::Msg(format!("{}: {e}", printable(path)))
}

/// Reads up to `limit` bytes of an entry after `skip`, and the rest for its checksum alone.
fn read_entry(zip: &mut Archive, name: &str, skip: u64, limit: u64) -> Result<Vec<u8>> {
    let missing = || candle_core::Error::Msg(format!("the archive has no {name}"));
    let index = zip.index_for_name(name).ok_or_else(missing)?;
    let zip_error = |e: zip::result::ZipError| candle_core::Error::Msg(format!("{name}: {e}"));
    let io_error = |e: std::io::Error| candle_core::Error::Msg(format!("{name}: {e}"));
    // PyTorch can be told to write no checksums; it then writes zero.
    let unchecked = zip.by_index(index).map_err(zip_error)?.crc32() == 0;
    // Names are in the archive twice; the contents of another entry would have a good checksum.
    let options = ZipReadOptions::new().ignore_crc32(unchecked).enforce_header_consistency(true);
    let mut entry = zip.by_index_with_options(index, options).map_err(zip_error)?;
    let claimed = entry.size().saturating_sub(skip).min(limit) as usize;
    std::io::copy(&mut entry.by_ref().take(skip), &mut std::io::sink()).map_err(io_error)?;
    let mut bytes = Vec::with_capacity(claimed.min(FIRST_READ));
    entry.by_ref().take(limit).read_to_end(&mut bytes).map_err(io_error)?;
    // The checksum is compared at the end of the entry.
    std::io::copy(&mut entry, &mut std::io::sink()).map_err(io_error)?;
    Ok(bytes)
}

/// A checkpoint's archive, the folder inside it, and its description.
fn unpickle(path: &Path) -> Result<(Archive, String, Pickle)> {
    let file = open_regular_file(path).map_err(|e| about(path, e))?;
    let mut zip = ZipArchive::new(BufReader::new(file)).map_err(|e| {
        message(path, &format!("{e}; the file is damaged or cut off, fetch it again"))
    })?;
    let mut description = None;
    for name in zip.file_names() {
        let name = name.map_err(|e| message(path, &e))?;
        if name == "data.pkl" || name.ends_with("/data.pkl") {
            description = Some(name.into_owned());
            break;
        }
    }
    let Some(name) = description else {
        bail!("{}: a zip archive without data.pkl is no PyTorch checkpoint", printable(path));
    };
    let folder = name.strip_suffix("data.pkl").unwrap_or_default().to_owned();
    let order = format!("{folder}byteorder");
    if zip.index_for_name(&order).is_some() {
        let text = read_entry(&mut zip, &order, 0, 16).map_err(|e| message(path, &e))?;
        if text.trim_ascii() != b"little" {
            let text = String::from_utf8_lossy(&text);
            bail!(
                "{}: byte order {text:?}; only little-endian checkpoints are read",
                printable(path)
            );
        }
    }
    let bytes = read_entry(&mut zip, &name, 0, MAX_PICKLE + 1).map_err(|e| message(path, &e))?;
    if bytes.len() as u64 > MAX_PICKLE {
        bail!("{}: data.pkl is larger than {} MiB", printable(path), MAX_PICKLE >> 20);
    }
    let pickle = Pickle::parse(&bytes).map_err(|e| message(path, &e))?;
    Ok((zip, folder, pickle))
}

/// The arguments of the call that makes a plain tensor, if this is one.
fn tensor_args(pickle: &Pickle, value: Ref) -> Option<&[Ref]> {
    let Value::Call { function, args } = pickle.get(value) else { return None };
    let (mut function, mut args) = (*function, *args);
    // A parameter of a tensor subclass is wrapped twice.
    for _ in 0..4 {
        let (Value::Global(name), Value::Tuple(given)) = (pickle.get(function), pickle.get(args))
        else {
            return None;
        };
        match name.as_str() {
            "torch._utils._rebuild_tensor_v2" => return Some(given),
            "torch._utils._rebuild_parameter" | "torch._utils._rebuild_parameter_with_state" => {
                let Value::Call { function: f, args: a } = pickle.get(*given.first()?) else {
                    return None;
                };
                (function, args) = (*f, *a);
            }
            "torch._tensor._rebuild_from_type_v2" => {
                (function, args) = (*given.first()?, *given.get(2)?);
            }
            _ => return None,
        }
    }
    None
}

fn index(pickle: &Pickle, value: Ref) -> Option<usize> {
    match pickle.get(value) {
        Value::Int(v) => usize::try_from(*v).ok(),
        _ => None,
    }
}

fn indices(pickle: &Pickle, value: Ref) -> Option<Vec<usize>> {
    match pickle.get(value) {
        Value::Tuple(items) => items.iter().map(|i| index(pickle, *i)).collect(),
        _ => None,
    }
}

/// `None` if the value is no tensor, an error if it is a malformed one.
fn tensor_info(pickle: &Pickle, value: Ref, folder: &str) -> Option<Result<Info>> {
    let args = tensor_args(pickle, value)?;
    let read = || {
        let Value::External(storage) = pickle.get(*args.first()?) else { return None };
        let Value::Tuple(storage) = pickle.get(*storage) else { return None };
        let Value::Global(class) = pickle.get(*storage.get(1)?) else { return None };
        let key = pickle.text(*storage.get(2)?)?;
        let class = class.rsplit('.').next().unwrap_or_default();
        let dtype = match class {
            "FloatStorage" => Ok(DType::F32),
            "DoubleStorage" => Ok(DType::F64),
            "HalfStorage" => Ok(DType::F16),
            "BFloat16Storage" => Ok(DType::BF16),
            "LongStorage" => Ok(DType::I64),
            "IntStorage" => Ok(DType::I32),
            "ShortStorage" => Ok(DType::I16),
            "ByteStorage" | "BoolStorage" => Ok(DType::U8),
            other => Err(other.to_owned()),
        };
        let offset = index(pickle, *args.get(1)?)?;
        let (shape, stride) = (indices(pickle, *args.get(2)?)?, indices(pickle, *args.get(3)?)?);
        if shape.len() != stride.len() {
            return None;
        }
        // Readers multiply dimensions without a check.
        shape.iter().try_fold(1usize, |n, d| n.checked_mul(*d))?.checked_mul(8)?;
        Some(Info { storage: format!("{folder}data/{key}"), dtype, shape, stride, offset })
    };
    Some(read().ok_or_else(|| candle_core::Error::Msg("malformed tensor description".to_owned())))
}

/// The entry of a dictionary that holds the weights, where that is one of several: its key and its content.
fn state_of<'a>(pickle: &'a Pickle, top: &'a [(Ref, Ref)]) -> Option<(Ref, &'a Vec<(Ref, Ref)>)> {
    STATE_KEYS.iter().find_map(|wanted| {
        top.iter().find_map(|(key, value)| match pickle.get(*value) {
            Value::Dict(state) if pickle.text(*key) == Some(wanted) => Some((*key, state)),
            _ => None,
        })
    })
}

impl PthFile {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let (archive, folder, pickle) = unpickle(path)?;
        let info = |name: &str, value| {
            let info = tensor_info(&pickle, value, &folder)?;
            Some(info.map_err(|e| message(path, &format!("{name}: {e}"))))
        };
        let (mut tensors, mut skipped) = (BTreeMap::new(), Vec::new());
        // Names of tensors are texts.
        let mut entries: Vec<(String, Option<Ref>)> = Vec::new();
        match pickle.root() {
            Value::Dict(top) => {
                let state = state_of(&pickle, top);
                let others =
                    top.iter().filter(|(key, _)| state.is_some_and(|(own, _)| own != *key));
                skipped.extend(others.map(|(key, _)| pickle.key(*key)));
                let named = |(key, value): &(Ref, Ref)| {
                    (pickle.key(*key), pickle.text(*key).map(|_| *value))
                };
                entries.extend(state.map_or(top, |(_, state)| state).iter().map(named));
            }
            // A table with something beside it, by their places.
            Value::Tuple(items) => {
                let placed = items.iter().enumerate();
                entries.extend(placed.map(|(place, item)| (place.to_string(), Some(*item))));
            }
            _ => {
                let tensor = info("the tensor", pickle.root_ref()).transpose()?;
                tensors.extend(tensor.map(|info| (String::new(), info)));
            }
        }
        for (name, value) in entries {
            match value.and_then(|value| info(&name, value)) {
                Some(info) => _ = tensors.insert(name, info?),
                None => skipped.push(name),
            }
        }
        if tensors.is_empty() && !matches!(pickle.root(), Value::Dict(_)) {
            bail!(
                "{}: holds neither a dictionary nor a tensor; a whole pickled module cannot be \
                 read: save its state_dict()",
                printable(path)
            );
        }
        Ok(Self { archive: Mutex::new(archive), tensors, skipped })
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
        let dtype = match &info.dtype {
            Ok(dtype) => *dtype,
            Err(class) => bail!("storage type {class} is not supported"),
        };
        let size = dtype.size_in_bytes();
        let too_large = || candle_core::Error::Msg("dimensions are too large".to_owned());
        let count: usize = info.shape.iter().product();
        // Elements from the first to the last that the strides reach.
        let mut reach = 1usize;
        for (d, s) in info.shape.iter().zip(&info.stride) {
            let step = d.saturating_sub(1).checked_mul(*s).ok_or_else(too_large)?;
            reach = reach.checked_add(step).ok_or_else(too_large)?;
        }
        if count == 0 {
            return Tensor::zeros(info.shape.as_slice(), dtype, &Device::Cpu);
        }
        if count > reach {
            bail!(
                "expanded: {count} values share {reach} stored ones; save a contiguous copy of it"
            );
        }
        let needed = reach.checked_mul(size).ok_or_else(too_large)?;
        let skip = info.offset.checked_mul(size).ok_or_else(too_large)?;
        let mut archive = self.archive.lock().unwrap_or_else(PoisonError::into_inner);
        let bytes = read_entry(&mut archive, &info.storage, skip as u64, needed as u64)?;
        drop(archive);
        if bytes.len() < needed {
            bail!(
                "{} has {} bytes from byte {skip}, {:?} {dtype:?} needs {needed}",
                info.storage,
                bytes.len(),
                info.shape
            );
        }
        if info.is_contiguous() {
            return Tensor::from_raw_buffer(&bytes, dtype, &info.shape, &Device::Cpu);
        }
        let mut dense = Vec::with_capacity(count * size);
        let mut at = vec![0usize; info.shape.len()];
        for _ in 0..count {
            let element = at.iter().zip(&info.stride).map(|(i, s)| i * s).sum::<usize>();
            dense.extend_from_slice(&bytes[element * size..(element + 1) * size]);
            for d in (0..at.len()).rev() {
                at[d] += 1;
                if at[d] < info.shape[d] {
                    break;
                }
                at[d] = 0;
            }
        }
        Tensor::from_raw_buffer(&dense, dtype, &info.shape, &Device::Cpu)
    }
}

impl Info {
    fn entry(&self) -> TensorEntry {
        let dtype = match &self.dtype {
            Ok(dtype) => dtype.as_str().to_owned(),
            Err(class) => class.clone(),
        };
        TensorEntry { shape: self.shape.clone(), dtype }
    }

    fn is_contiguous(&self) -> bool {
        let mut expected = 1;
        for (d, s) in self.shape.iter().zip(&self.stride).rev() {
            if *d != 1 && *s != expected {
                return false;
            }
            expected *= d;
        }
        true
    }
}

/// What the top level of a checkpoint holds, by key.
///
/// # Errors
/// If the file is no checkpoint.
pub fn summarize(path: &Path) -> Result<BTreeMap<String, PickleValue>> {
    let (_, folder, pickle) = unpickle(path)?;
    let value = |at: Ref| match pickle.get(at) {
        Value::Call { .. } => match tensor_info(&pickle, at, &folder) {
            Some(Ok(info)) => PickleValue::Tensor(info.entry()),
            Some(Err(_)) => PickleValue::Other("tensor".to_owned()),
            None => PickleValue::Other("object".to_owned()),
        },
        Value::Dict(d) => PickleValue::Dict {
            entries: d.len(),
            tensors: d.iter().filter(|(_, v)| tensor_args(&pickle, *v).is_some()).count(),
        },
        Value::Int(v) => PickleValue::Scalar(v.to_string()),
        Value::Float(v) => PickleValue::Scalar(v.to_string()),
        Value::Bool(v) => PickleValue::Scalar(v.to_string()),
        Value::Text(v) => PickleValue::Scalar(v.chars().take(80).collect()),
        Value::None => PickleValue::Scalar("none".to_owned()),
        Value::List(v) => PickleValue::Other(format!("list of {}", v.len())),
        Value::Tuple(v) => PickleValue::Other(format!("tuple of {}", v.len())),
        _ => PickleValue::Other("object".to_owned()),
    };
    Ok(match pickle.root() {
        Value::Dict(entries) => entries.iter().map(|(k, v)| (pickle.key(*k), value(*v))).collect(),
        _ => [(String::new(), value(pickle.root_ref()))].into(),
    })
}
