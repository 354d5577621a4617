//! Named parameters and buffers, and where their first values come from.

use crate::weights::{Found, WeightSource};
use candle_core::{DType, Device, Result, Shape, Tensor, Var, bail};
use candle_nn::var_builder::SimpleBackend;
use candle_nn::{Init, VarBuilder};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The most values a store gives out: 4 GiB of f32, 11 times the language network.
///
/// A configuration is only a claim, so nothing is reserved for more.
pub const MAX_VALUES: usize = 1 << 30;

/// Checks that a configuration asks for no more.
pub(crate) fn check_values(values: usize) -> Result<()> {
    if values > MAX_VALUES {
        bail!("the sizes make a network of {values} values, at most {MAX_VALUES} are possible");
    }
    Ok(())
}

/// First values that a frozen store makes up for names which its files lack or have in another
/// shape, besides as many as the files hold: room for the largest released network, no more.
const MAX_INVENTED: usize = 1 << 27;

/// The parameters and buffers of one module, by name: the registry that candle lacks.
///
/// A module asks for its parameters while it is built. A trainable store answers with variables,
/// whose first values come from a weight file or from a seed and the parameter's name alone, so
/// they depend neither on the order of construction nor on a global generator. A frozen store hands
/// out each tensor once, for packing, and keeps nothing.
#[derive(Clone)]
pub struct ParamStore {
    inner: Arc<Mutex<Inner>>,
    device: Device,
}

struct Inner {
    trainable: bool,
    seed: u64,
    source: WeightSource,
    variables: BTreeMap<String, Var>,
    requested: BTreeMap<String, Vec<usize>>,
    missing: BTreeSet<String>,
    misshaped: BTreeMap<String, (Vec<usize>, Vec<usize>)>,
    matched: BTreeSet<String>,
    /// Values given out.
    values: usize,
    /// Those of them that the source had not.
    invented: usize,
}

/// How to treat names that are in only one of model and file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LoadPolicy {
    /// Every parameter must be in the file, with its shape, and nothing else.
    #[default]
    Strict,
    /// Every parameter must be in the file, with its shape; more is allowed.
    AllowUnexpected,
    /// Whatever fits is loaded, the rest keeps its seeded value; the report tells.
    Partial,
}

/// What a load did. Names are sorted.
#[derive(Debug, Default, Clone, PartialEq, Eq, serde::Serialize)]
pub struct LoadReport {
    /// Names found with the right shape.
    pub matched: Vec<String>,
    /// Names that the file lacks.
    pub missing: Vec<String>,
    /// Names in the file that nothing asked for.
    pub unexpected: Vec<String>,
    /// Name, shape of the model, shape in the file.
    pub misshaped: Vec<(String, Vec<usize>, Vec<usize>)>,
    /// Entries of the file that are no weights of this network, by the rule that knows them.
    pub ignored: Vec<(String, String)>,
    /// What another program put before the names, if it did.
    pub wrapper: Option<String>,
    /// Values of all parameters and buffers of the model.
    pub parameters: usize,
}

impl LoadReport {
    /// Whether model and file agree in everything.
    pub fn is_complete(&self) -> bool {
        self.missing.is_empty() && self.misshaped.is_empty() && self.unexpected.is_empty()
    }

    /// Checks the report against a policy.
    ///
    /// # Errors
    /// If the policy does not allow what was found; the message lists the names.
    pub fn check(&self, policy: LoadPolicy, origin: &str) -> Result<()> {
        let bad = match policy {
            LoadPolicy::Strict => !self.is_complete(),
            LoadPolicy::AllowUnexpected => !self.missing.is_empty() || !self.misshaped.is_empty(),
            LoadPolicy::Partial => self.matched.is_empty(),
        };
        if bad {
            bail!("{origin}: the weights do not fit the network: {self}{}", self.advice());
        }
        Ok(())
    }
}

impl LoadReport {
    /// What most likely helps.
    fn advice(&self) -> &'static str {
        let turned = |network: &[usize], file: &[usize]| match *file {
            [a, b, c, d, e] => network == [e, a, b, c, d] || network == [b, c, d, e, a],
            _ => false,
        };
        if self.misshaped.iter().any(|(_, network, file)| turned(network, file)) {
            "the file stores its convolutions in the other layout (spconv 1 or 2): choose that"
        } else if self.matched.is_empty() && self.ignored.iter().any(|(_, o)| o.contains("pair")) {
            "of the self-supervised pair only the other half is in the file: choose that branch"
        } else {
            "choose the configuration the weights were trained with, or allow a partial load"
        }
    }
}

impl fmt::Display for LoadReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let some =
            |f: &mut fmt::Formatter<'_>, what: &str, names: &mut dyn Iterator<Item = String>| {
                let names: Vec<String> = names.collect();
                if !names.is_empty() {
                    let more = names.len().saturating_sub(5);
                    let shown = names.iter().take(5).cloned().collect::<Vec<_>>().join(", ");
                    let tail = if more > 0 { format!(", … {more} more") } else { String::new() };
                    write!(f, "{} {what}: {shown}{tail}; ", names.len())?;
                }
                Ok(())
            };
        let total = self.matched.len() + self.missing.len() + self.misshaped.len();
        write!(f, "{} of {total} entries matched; ", self.matched.len())?;
        if let Some(wrapper) = &self.wrapper {
            write!(f, "names are read without {wrapper}; ")?;
        }
        some(f, "missing", &mut self.missing.iter().cloned())?;
        some(f, "unexpected", &mut self.unexpected.iter().cloned())?;
        let shapes = self.misshaped.iter();
        some(
            f,
            "of another shape",
            &mut shapes.map(|(n, want, got)| format!("{n} (network {want:?}, file {got:?})")),
        )?;
        if !self.ignored.is_empty() {
            write!(f, "{} entries that belong to no network ignored; ", self.ignored.len())?;
        }
        Ok(())
    }
}

impl ParamStore {
    /// A store of variables to train, first values from `seed` and the names.
    pub fn trainable(seed: u64) -> Self {
        Self::new(true, seed, WeightSource::empty())
    }

    /// A store of variables to train, first values from `source` where it has them.
    ///
    /// Building a network from it never fails for want of a value: call [`ParamStore::report`] and
    /// [`LoadReport::check`] afterwards, or training may start from scratch unnoticed.
    pub fn trainable_from(source: WeightSource, seed: u64) -> Self {
        Self::new(true, seed, source)
    }

    /// Weights for inference: packed by the layers, no gradients.
    pub fn frozen(source: WeightSource) -> Self {
        Self::new(false, 0, source)
    }

    fn new(trainable: bool, seed: u64, source: WeightSource) -> Self {
        let inner = Inner {
            trainable,
            seed,
            source,
            variables: BTreeMap::new(),
            requested: BTreeMap::new(),
            missing: BTreeSet::new(),
            misshaped: BTreeMap::new(),
            matched: BTreeSet::new(),
            values: 0,
            invented: 0,
        };
        Self { inner: Arc::new(Mutex::new(inner)), device: Device::Cpu }
    }

    /// The store with its values on a device; for modules that are yet to be built.
    ///
    /// On another device than the CPU frozen weights stay tensors: they are not packed, nothing is folded into
    /// another layer, and a precision without gradient is refused.
    pub fn on(self, device: &Device) -> Self {
        Self { inner: self.inner, device: device.clone() }
    }

    /// Where the values are.
    pub fn device(&self) -> &Device {
        &self.device
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What modules are built with (f32).
    pub fn builder(&self) -> VarBuilder<'static> {
        VarBuilder::from_backend(Box::new(self.clone()), DType::F32, self.device.clone())
    }

    /// Trainable variables (no batch statistics) by name.
    pub fn parameters(&self) -> BTreeMap<String, Var> {
        let inner = self.lock();
        let trained = inner.variables.iter().filter(|(n, _)| !is_buffer(n));
        trained.map(|(n, v)| (n.clone(), v.clone())).collect()
    }

    /// Batch statistics by name.
    pub fn buffers(&self) -> BTreeMap<String, Var> {
        let inner = self.lock();
        let kept = inner.variables.iter().filter(|(n, _)| is_buffer(n));
        kept.map(|(n, v)| (n.clone(), v.clone())).collect()
    }

    /// Shapes of everything that was asked for, by name.
    pub fn shapes(&self) -> BTreeMap<String, Vec<usize>> {
        self.lock().requested.clone()
    }

    /// How the modules built so far agreed with the source.
    pub fn report(&self) -> LoadReport {
        let inner = self.lock();
        let unexpected =
            inner.source.shapes().into_keys().filter(|n| !inner.requested.contains_key(n));
        LoadReport {
            matched: inner.matched.iter().cloned().collect(),
            missing: inner.missing.iter().cloned().collect(),
            unexpected: unexpected.collect(),
            misshaped: inner
                .misshaped
                .iter()
                .map(|(n, (want, got))| (n.clone(), want.clone(), got.clone()))
                .collect(),
            ignored: inner.source.ignored().to_vec(),
            wrapper: inner.source.wrapper().map(str::to_owned),
            parameters: inner.requested.values().map(|s| s.iter().product::<usize>()).sum(),
        }
    }

    /// Sets all variables, parameters and buffers, to the values of a file that
    /// [`save`](Self::save) wrote.
    ///
    /// # Errors
    /// If the store is frozen, the file cannot be read, or its names or shapes are not exactly those
    /// of the store; nothing has changed then.
    pub fn restore(&self, path: &Path) -> Result<()> {
        let origin = path.display().to_string();
        let stored = candle_core::safetensors::load(path, &Device::Cpu)
            .map_err(|e| candle_core::Error::Msg(format!("{origin}: {e}")))?;
        self.restore_from(stored.into_iter().collect(), &origin)
    }

    /// As [`restore`](Self::restore), from values that were read already; `origin` names them in
    /// messages.
    ///
    /// # Errors
    /// As [`restore`](Self::restore).
    pub fn restore_from(&self, mut stored: BTreeMap<String, Tensor>, origin: &str) -> Result<()> {
        let inner = self.lock();
        let place = |problem: String| candle_core::Error::Msg(format!("{origin}: {problem}"));
        if !inner.trainable {
            return Err(place("a frozen store keeps no values to restore".to_owned()));
        }
        let mut values = Vec::with_capacity(inner.variables.len());
        for (name, var) in &inner.variables {
            let Some(value) = stored.remove(name) else {
                return Err(place(format!("has no {name}, which the network has")));
            };
            if value.dims() != var.dims() || value.dtype() != var.dtype() {
                return Err(place(format!(
                    "{name} is {:?} {:?}, the network's is {:?} {:?}",
                    value.dtype(),
                    value.dims(),
                    var.dtype(),
                    var.dims()
                )));
            }
            values.push(value);
        }
        if let Some(name) = stored.keys().next() {
            return Err(place(format!("has {name}, which the network has not")));
        }
        let both = inner.variables.values().zip(&values);
        both.into_iter().try_for_each(|(var, value)| var.set(&value.to_device(var.device())?))
    }

    /// Writes all variables, parameters and buffers, to a safetensors file, under their names.
    ///
    /// Written beside and renamed, so a crash leaves no half file.
    ///
    /// # Errors
    /// If the store is frozen or the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let inner = self.lock();
        if !inner.trainable {
            bail!("a frozen store keeps no values to save");
        }
        let tensors: std::collections::HashMap<String, Tensor> =
            inner.variables.iter().map(|(n, v)| (n.clone(), v.as_tensor().clone())).collect();
        crate::weights::save_tensors(&tensors, path)
    }
}

impl Inner {
    /// Counts what a module asks for, before anything is reserved for it.
    fn claim(&mut self, name: &str, dims: &[usize]) -> Result<usize> {
        let count = dims.iter().try_fold(1usize, |n, d| n.checked_mul(*d));
        let sum = count.and_then(|n| n.checked_add(self.values)).filter(|sum| *sum <= MAX_VALUES);
        let (Some(count), Some(sum)) = (count, sum) else {
            bail!("{name}: with its shape {dims:?} the network has more than {MAX_VALUES} values");
        };
        self.values = sum;
        Ok(count)
    }

    /// Counts values that the files do not have.
    ///
    /// Frozen weights that do not fit are refused in the end, with a list of all names; but a network
    /// that is larger than its files by far is not even built for that.
    fn invent(&mut self, name: &str, dims: &[usize], count: usize, stored: &str) -> Result<()> {
        self.invented += count;
        let there = self.source.num_values().unwrap_or(MAX_VALUES);
        if !self.trainable && self.invented > there.saturating_add(MAX_INVENTED) {
            bail!(
                "{name}: the network has {dims:?}, {stored}; the configuration is not the one that \
                 these weights were trained with"
            );
        }
        Ok(())
    }
}

/// Batch statistics by their last name part.
fn is_buffer(name: &str) -> bool {
    let last = name.rsplit('.').next();
    matches!(last, Some("running_mean" | "running_var" | "num_batches_tracked"))
}

impl SimpleBackend for ParamStore {
    fn get(
        &self,
        shape: Shape,
        name: &str,
        init: Init,
        dtype: DType,
        device: &Device,
    ) -> Result<Tensor> {
        let mut inner = self.lock();
        let dims = shape.dims().to_vec();
        if let Some(var) = inner.variables.get(name) {
            if var.dims() != dims {
                bail!("{name}: exists as {:?}, asked for as {dims:?}", var.dims());
            }
            return Ok(var.as_tensor().clone());
        }
        let count = inner.claim(name, &dims)?;
        inner.requested.insert(name.to_owned(), dims.clone());
        let value = match inner.source.take(name, &dims)? {
            Found::Value(t) => {
                inner.matched.insert(name.to_owned());
                Some(t.to_dtype(dtype)?)
            }
            Found::OtherShape(stored) => {
                inner.invent(name, &dims, count, &format!("the file {stored:?}"))?;
                inner.misshaped.insert(name.to_owned(), (dims, stored));
                None
            }
            Found::Nothing => {
                if !inner.source.is_empty() {
                    inner.invent(name, &dims, count, "the file nothing of that name")?;
                    inner.missing.insert(name.to_owned());
                }
                None
            }
        };
        let value = match value {
            Some(value) => value,
            None => initial(&shape, name, init, dtype, inner.seed)?,
        };
        let value = value.to_device(device)?;
        if !inner.trainable {
            return Ok(value);
        }
        let var = Var::from_tensor(&value)?;
        let tensor = var.as_tensor().clone();
        inner.variables.insert(name.to_owned(), var);
        Ok(tensor)
    }

    fn get_unchecked(&self, name: &str, _: DType, _: &Device) -> Result<Tensor> {
        bail!("{name}: parameters are asked for with a shape")
    }

    fn contains_tensor(&self, name: &str) -> bool {
        let inner = self.lock();
        inner.variables.contains_key(name) || inner.source.shapes().contains_key(name)
    }
}

fn initial(shape: &Shape, name: &str, init: Init, dtype: DType, seed: u64) -> Result<Tensor> {
    let n = shape.elem_count();
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ crate::weights::name_hash(name));
    let values: Vec<f32> = match init {
        Init::Const(v) => vec![v as f32; n],
        Init::Uniform { lo, up } => {
            (0..n).map(|_| (lo + (up - lo) * rng.random::<f64>()) as f32).collect()
        }
        Init::Randn { mean, stdev } => (0..n)
            .map(|_| {
                // Box–Muller; cut at two deviations like the original's truncated normal.
                loop {
                    let u: f64 = rng.random::<f64>().max(f64::MIN_POSITIVE);
                    let angle = std::f64::consts::TAU * rng.random::<f64>();
                    let z = (-2.0 * u.ln()).sqrt() * angle.cos();
                    if z.abs() <= 2.0 {
                        break (mean + stdev * z) as f32;
                    }
                }
            })
            .collect(),
        Init::Kaiming { .. } => bail!("{name}: give explicit bounds instead of Kaiming hints"),
    };
    Tensor::from_vec(values, shape.clone(), &Device::Cpu)?.to_dtype(dtype)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_values_depend_on_seed_and_name_only() {
        let init = Init::Uniform { lo: -1.0, up: 1.0 };
        let get = |seed, names: &[&str]| -> Vec<Vec<f32>> {
            let store = ParamStore::trainable(seed);
            let vb = store.builder();
            let mut out: Vec<_> =
                names.iter().map(|n| (*n, vb.get_with_hints(4, n, init).unwrap())).collect();
            out.sort_by_key(|(n, _)| *n);
            out.into_iter().map(|(_, t)| t.to_vec1().unwrap()).collect()
        };
        assert_eq!(get(1, &["a", "b"]), get(1, &["b", "a"]));
        assert_ne!(get(1, &["a"]), get(2, &["a"]));
        assert_ne!(get(1, &["a"]), get(1, &["b"]));
    }

    #[test]
    fn one_name_with_two_shapes_is_an_error() {
        let store = ParamStore::trainable(0);
        let vb = store.builder();
        vb.get_with_hints(3, "w", Init::Const(0.0)).unwrap();
        assert!(vb.get_with_hints(3, "w", Init::Const(0.0)).is_ok());
        assert!(vb.get_with_hints(4, "w", Init::Const(0.0)).is_err());
    }

    #[test]
    fn buffers_are_not_parameters() {
        let store = ParamStore::trainable(0);
        let vb = store.builder();
        vb.get_with_hints(3, "norm.weight", Init::Const(1.0)).unwrap();
        vb.get_with_hints(3, "norm.running_mean", Init::Const(0.0)).unwrap();
        assert_eq!(store.parameters().keys().collect::<Vec<_>>(), ["norm.weight"]);
        assert_eq!(store.buffers().keys().collect::<Vec<_>>(), ["norm.running_mean"]);
    }
}
