//! Reference numbers of the original implementation: finding, reading and comparing them.

use crate::support_device::device;
use candle_core::Tensor;
use safetensors::{Dtype, SafeTensors};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The folder of shared data, or `None` (printed) where there is none.
pub fn shared(what: &str) -> Option<PathBuf> {
    let root = std::env::var_os("SCENESPLAT_SHARED").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared"),
        PathBuf::from,
    );
    let path = root.join(what);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: no {what} under the shared data");
    None
}

/// One file of tensors with its tolerances.
pub struct Golden {
    pub file: String,
    tensors: BTreeMap<String, (Vec<usize>, Values)>,
    entry: serde_json::Value,
}

#[derive(Clone)]
enum Values {
    Float(Vec<f64>),
    Int(Vec<i64>),
}

impl Golden {
    pub fn open(file: &str) -> Option<Self> {
        let folder = shared("goldens/network")?;
        let bytes = std::fs::read(folder.join(file)).unwrap();
        let parsed = SafeTensors::deserialize(&bytes).unwrap();
        let mut tensors = BTreeMap::new();
        for (name, view) in parsed.tensors() {
            let data = view.data();
            let values = match view.dtype() {
                Dtype::F32 => Values::Float(
                    data.chunks_exact(4)
                        .map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap())))
                        .collect(),
                ),
                Dtype::I64 => Values::Int(
                    data.chunks_exact(8)
                        .map(|b| i64::from_le_bytes(b.try_into().unwrap()))
                        .collect(),
                ),
                Dtype::U8 => Values::Int(data.iter().map(|&b| i64::from(b)).collect()),
                other => panic!("{file}: {name} has type {other:?}"),
            };
            tensors.insert(name, (view.shape().to_vec(), values));
        }
        let manifest = std::fs::read_to_string(folder.join("manifest.json")).unwrap();
        let manifest: serde_json::Value = serde_json::from_str(&manifest).unwrap();
        let entry = manifest["entries"]
            .as_array()
            .unwrap()
            .iter()
            .find(|e| e["file"] == file)
            .unwrap_or_else(|| panic!("{file} is not in the manifest"))
            .clone();
        Some(Self { file: file.to_owned(), tensors, entry })
    }

    pub fn config(&self) -> &serde_json::Value {
        &self.entry["config"]
    }

    pub fn number(&self, key: &str) -> usize {
        self.config()[key].as_u64().unwrap_or_else(|| panic!("{}: {key}", self.file)) as usize
    }

    pub fn numbers(&self, key: &str) -> Vec<usize> {
        let list = self.config()[key].as_array().unwrap();
        list.iter().map(|v| v.as_u64().unwrap() as usize).collect()
    }

    pub fn names(&self, prefix: &str) -> Vec<String> {
        self.tensors.keys().filter(|n| n.starts_with(prefix)).cloned().collect()
    }

    pub fn has(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    fn get(&self, name: &str) -> &(Vec<usize>, Values) {
        self.tensors.get(name).unwrap_or_else(|| panic!("{}: no {name}", self.file))
    }

    pub fn shape(&self, name: &str) -> Vec<usize> {
        self.get(name).0.clone()
    }

    pub fn floats(&self, name: &str) -> Vec<f32> {
        match &self.get(name).1 {
            Values::Float(v) => v.iter().map(|v| *v as f32).collect(),
            Values::Int(_) => panic!("{}: {name} holds integers", self.file),
        }
    }

    pub fn ints(&self, name: &str) -> Vec<i64> {
        match &self.get(name).1 {
            Values::Int(v) => v.clone(),
            Values::Float(_) => panic!("{}: {name} holds floats", self.file),
        }
    }

    pub fn tensor(&self, name: &str) -> Tensor {
        Tensor::from_vec(self.floats(name), self.shape(name), &device()).unwrap()
    }

    pub fn cells(&self, name: &str) -> Vec<[i32; 3]> {
        self.ints(name).chunks_exact(3).map(|c| [c[0] as i32, c[1] as i32, c[2] as i32]).collect()
    }

    /// `[0, offset…]` from cumulative counts.
    pub fn offsets(&self, name: &str) -> Vec<usize> {
        [0].into_iter().chain(self.ints(name).into_iter().map(|v| v as usize)).collect()
    }

    /// All float tensors under a prefix, without it, as a weight source needs them.
    pub fn weights(&self, prefix: &str) -> BTreeMap<String, Tensor> {
        self.tensors
            .iter()
            .filter_map(|(n, (shape, values))| {
                let name = n.strip_prefix(prefix)?;
                let tensor = match values {
                    Values::Float(v) => {
                        let v: Vec<f32> = v.iter().map(|v| *v as f32).collect();
                        Tensor::from_vec(v, shape.as_slice(), &device())
                    }
                    Values::Int(v) => Tensor::from_vec(v.clone(), shape.as_slice(), &device()),
                };
                Some((name.to_owned(), tensor.unwrap()))
            })
            .collect()
    }

    /// Largest allowed difference of a tensor; `None` where the manifest says not to compare.
    fn tolerance(&self, name: &str, value: f64) -> Option<f64> {
        let entry = &self.entry["tensors"][name];
        if !entry["unstable"].is_null() || !entry["tol"]["unstable"].is_null() {
            return None;
        }
        let tol = &entry["tol"];
        if tol == "exact" {
            return Some(0.0);
        }
        let (atol, rtol) = (tol["atol"].as_f64(), tol["rtol"].as_f64());
        assert!(atol.or(rtol).is_some(), "{}: {name} has no tolerance", self.file);
        Some(atol.unwrap_or(0.0) + rtol.unwrap_or(0.0) * value.abs())
    }

    /// Compares with the stored floats; prints how much of the tolerance is used.
    pub fn compare(&self, name: &str, got: &[f32]) {
        let want = self.floats(name);
        assert_eq!(got.len(), want.len(), "{}: {name}: length", self.file);
        let mut worst = (0.0f64, 0);
        for (i, (g, w)) in got.iter().zip(&want).enumerate() {
            assert!(g.is_finite(), "{}: {name}[{i}] is {g}", self.file);
            let Some(tolerance) = self.tolerance(name, f64::from(*w)) else { continue };
            let used = (f64::from(*g) - f64::from(*w)).abs() / tolerance.max(1e-30);
            if used > worst.0 {
                worst = (used, i);
            }
        }
        let (used, i) = worst;
        println!("{} {name}: {:.1} % of the tolerance", self.file, used * 100.0);
        assert!(
            used <= 1.0,
            "{}: {name}[{i}]: {} differs from {} by {used:.2} tolerances",
            self.file,
            got[i],
            want[i]
        );
    }

    pub fn compare_tensor(&self, name: &str, got: &Tensor) {
        assert_eq!(got.dims(), self.shape(name), "{}: {name}: shape", self.file);
        self.compare(name, &got.flatten_all().unwrap().to_vec1::<f32>().unwrap());
    }

    pub fn compare_ints<T: Copy + Into<i64>>(&self, name: &str, got: &[T]) {
        let got: Vec<i64> = got.iter().map(|v| (*v).into()).collect();
        assert_eq!(got, self.ints(name), "{}: {name}", self.file);
    }
}
