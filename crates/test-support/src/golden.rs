//! Reference numbers of the original implementation.

use crate::shared;
use safetensors::{Dtype, SafeTensors};
use serde_json::Value;
use std::collections::BTreeMap;

/// The tensors of one file of reference numbers, with the settings and tolerances of its manifest.
pub struct Golden {
    file: String,
    tensors: BTreeMap<String, (Vec<usize>, Values)>,
    entry: Value,
}

enum Values {
    Float(Vec<f64>),
    Int(Vec<i64>),
}

impl Golden {
    /// `goldens/network/<case>.safetensors` with its entry in the manifest; `None` where it is not installed.
    pub fn network(case: &str) -> Option<Self> {
        let mut golden = Self::open(&format!("goldens/network/{case}.safetensors"))?;
        let manifest = manifest("network");
        let entries = manifest["entries"].as_array().unwrap();
        let entry = entries.iter().find(|e| e["file"] == golden.file.as_str());
        golden.entry = entry.unwrap_or_else(|| panic!("{case} is not in the manifest")).clone();
        Some(golden)
    }

    /// `goldens/raster/<name>.safetensors` with the manifest's entry of that name (`Null` if it has none);
    /// `None` where it is not installed.
    pub fn raster(name: &str) -> Option<Self> {
        let mut golden = Self::open(&format!("goldens/raster/{name}.safetensors"))?;
        golden.entry = manifest("raster")[name].clone();
        Some(golden)
    }

    /// A file of tensors under the shared data, without settings and tolerances.
    pub fn open(relative: &str) -> Option<Self> {
        let bytes = std::fs::read(shared(relative)?).unwrap();
        let parsed = SafeTensors::deserialize(&bytes).unwrap();
        let mut tensors = BTreeMap::new();
        for (name, view) in parsed.tensors() {
            let data = view.data();
            let values = match view.dtype() {
                Dtype::F64 => Values::Float(words(data, f64::from_le_bytes)),
                Dtype::F32 => Values::Float(words(data, |w| f32::from_le_bytes(w).into())),
                Dtype::I64 => Values::Int(words(data, i64::from_le_bytes)),
                Dtype::I32 => Values::Int(words(data, |w| i32::from_le_bytes(w).into())),
                Dtype::U32 => Values::Int(words(data, |w| u32::from_le_bytes(w).into())),
                Dtype::U8 | Dtype::BOOL => Values::Int(words(data, |[v]| i64::from(v))),
                other => panic!("{relative}: {name} has type {other:?}"),
            };
            tensors.insert(name, (view.shape().to_vec(), values));
        }
        let file = relative.rsplit('/').next().unwrap().to_owned();
        Some(Self { file, tensors, entry: Value::Null })
    }

    /// The file's name, for messages.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// The manifest's entry as a whole.
    pub fn entry(&self) -> &Value {
        &self.entry
    }

    /// Settings that the numbers were made with.
    pub fn config(&self) -> &Value {
        &self.entry["config"]
    }

    /// An integer among the settings.
    pub fn number(&self, key: &str) -> usize {
        self.config()[key].as_u64().unwrap_or_else(|| panic!("{}: {key}", self.file)) as usize
    }

    /// A list of integers among the settings.
    pub fn numbers(&self, key: &str) -> Vec<usize> {
        let list = self.config()[key].as_array().unwrap();
        list.iter().map(|v| v.as_u64().unwrap() as usize).collect()
    }

    /// Names of tensors that begin so.
    pub fn names(&self, prefix: &str) -> Vec<String> {
        self.tensors.keys().filter(|n| n.starts_with(prefix)).cloned().collect()
    }

    /// Whether there is a tensor of this name.
    pub fn has(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    fn get(&self, name: &str) -> &(Vec<usize>, Values) {
        self.tensors.get(name).unwrap_or_else(|| panic!("{}: no {name}", self.file))
    }

    /// Whether a tensor is stored as integers.
    pub fn is_integer(&self, name: &str) -> bool {
        matches!(self.get(name).1, Values::Int(_))
    }

    /// The shape of a tensor.
    pub fn shape(&self, name: &str) -> &[usize] {
        &self.get(name).0
    }

    /// Values as f64, whatever they are stored as.
    pub fn f64s(&self, name: &str) -> Vec<f64> {
        match &self.get(name).1 {
            Values::Float(v) => v.clone(),
            Values::Int(v) => v.iter().map(|v| *v as f64).collect(),
        }
    }

    /// Values as f32, whatever they are stored as.
    pub fn f32s(&self, name: &str) -> Vec<f32> {
        self.f64s(name).into_iter().map(|v| v as f32).collect()
    }

    /// Values in rows of `K`.
    pub fn rows<const K: usize>(&self, name: &str) -> Vec<[f32; K]> {
        self.f32s(name).as_chunks().0.to_vec()
    }

    /// Values as f64 of the part that belongs to the first index `i`.
    pub fn part(&self, name: &str, i: usize) -> Vec<f64> {
        let values = self.f64s(name);
        let len = values.len() / self.shape(name)[0];
        values[i * len..(i + 1) * len].to_vec()
    }

    /// The same as f32.
    pub fn part_f32(&self, name: &str, i: usize) -> Vec<f32> {
        self.part(name, i).into_iter().map(|v| v as f32).collect()
    }

    /// Integers, as another type of integers.
    pub fn ints<T: TryFrom<i64>>(&self, name: &str) -> Vec<T> {
        let Values::Int(values) = &self.get(name).1 else {
            panic!("{}: {name} holds floats", self.file)
        };
        let convert = |v: &i64| T::try_from(*v).unwrap_or_else(|_| panic!("{name}: {v}"));
        values.iter().map(convert).collect()
    }

    /// The largest allowed difference from `value` in a tensor; `None` where the manifest says not to compare.
    pub fn tolerance(&self, name: &str, value: f64) -> Option<f64> {
        let entry = &self.entry["tensors"][name];
        let tol = &entry["tol"];
        if !entry["unstable"].is_null() || !tol["unstable"].is_null() {
            return None;
        }
        if tol == "exact" {
            return Some(0.0);
        }
        let (atol, rtol) = (tol["atol"].as_f64(), tol["rtol"].as_f64());
        assert!(atol.or(rtol).is_some(), "{}: {name} has no tolerance", self.file);
        Some(atol.unwrap_or(0.0) + rtol.unwrap_or(0.0) * value.abs())
    }

    /// Compares with the stored values within the manifest's tolerance; returns and prints the largest share
    /// of it that was used.
    pub fn compare<T: Copy + Into<f64>>(&self, name: &str, got: &[T]) -> f64 {
        let want = self.f64s(name);
        assert_eq!(got.len(), want.len(), "{}: {name}: length", self.file);
        let mut worst = (0.0f64, 0);
        for (i, (&g, &w)) in got.iter().zip(&want).enumerate() {
            let g: f64 = g.into();
            assert!(g.is_finite(), "{}: {name}[{i}] is {g}", self.file);
            let Some(tolerance) = self.tolerance(name, w) else { continue };
            let used = (g - w).abs() / tolerance.max(1e-30);
            if used > worst.0 {
                worst = (used, i);
            }
        }
        let (used, i) = worst;
        println!("{} {name}: {:.1} % of the tolerance", self.file, used * 100.0);
        if used > 1.0 {
            let (got, want): (f64, f64) = (got[i].into(), want[i]);
            panic!("{}: {name}[{i}]: {got} is {used:.2} tolerances from {want}", self.file);
        }
        used
    }
}

/// Largest error, relative to the largest value; NaN if an error is.
pub fn relative_error(got: &[f32], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    let most = want.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let worst = got.iter().zip(want).map(|(g, w)| (f64::from(*g) - w).abs());
    worst.fold(0.0, |m: f64, e| if e.is_nan() { e } else { m.max(e) }) / most
}

/// Fails if an error, relative to the largest value, is above the limit.
pub fn compare_relative(name: &str, got: &[f32], want: &[f64], limit: f64) {
    let error = relative_error(got, want);
    println!("{name}: {error:.2e}");
    assert!(error <= limit, "{name}: {error:e} of the largest value, more than {limit:e}");
}

fn manifest(group: &str) -> Value {
    let path = shared(&format!("goldens/{group}/manifest.json")).unwrap();
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn words<const N: usize, T>(data: &[u8], parse: impl Fn([u8; N]) -> T) -> Vec<T> {
    data.as_chunks().0.iter().map(|&w| parse(w)).collect()
}
