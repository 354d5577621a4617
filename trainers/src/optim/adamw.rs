use super::slices::{self, InPlace};
use super::{Optimizer, ParamGroup, StepHyperparameters, clip};
use crate::TrainError;
use crate::error::check_setting;
use candle_core::{DType, Result as TensorResult, Tensor, Var, backprop::GradStore};
use scenesplat_kernels::settings;
use std::collections::{BTreeMap, HashMap};

/// Gradients above this norm are refused: their square, on its way into the second moment, would
/// leave the range of f32 (3.4e38), and an infinite moment never comes back.
const MAX_GRAD_NORM: f64 = 1e18;

/// The counter is saved as an i64.
const MAX_STEP: u64 = i64::MAX as u64;

settings! {
    /// Settings of [`AdamW`] that no group changes. The default is PyTorch's.
    #[derive(Copy)]
    pub struct AdamWConfig {
        /// Decay of the first moment, `0..1`, where no schedule sets it.
        pub beta1: f64 = 0.9,
        /// Decay of the second moment, `0..1`.
        pub beta2: f64 = 0.999,
        /// Added to the root of the second moment, above 0 also as an f32, or a parameter that has only
        /// seen zero gradients would become 0/0. The original's self-supervised runs use 1e-4.
        pub eps: f64 = 1e-8,
    }
}

/// Adam with decoupled weight decay.
///
/// For each parameter `p` with gradient `g`, at its own step `t` (from 1), with the rate
/// `η = lr · lr_scale` of its group:
///
/// ```text
/// p ← p · (1 − η · weight_decay)
/// m ← m + (1 − β₁)(g − m)
/// v ← β₂ v + (1 − β₂) g²
/// p ← p − η/(1 − β₁ᵗ) · m / (√v / √(1 − β₂ᵗ) + eps)
/// ```
///
/// A β₁ that a schedule cycles enters `β₁ᵗ` with its present value. A parameter without a gradient
/// is skipped, decay included, and its `t` stands still.
///
/// # State
/// Per parameter `name`: `name.exp_avg` and `name.exp_avg_sq` like the parameter, `name.step` a
/// scalar i64.
///
/// # Source
/// `torch.optim.AdamW`. Differs: a gradient that is not finite, or whose square is not, is an error
/// that names the parameter, and the step is not taken.
pub struct AdamW {
    config: AdamWConfig,
    groups: Vec<GroupRates>,
    slots: Vec<Slot>,
}

struct GroupRates {
    lr: f64,
    weight_decay: f64,
}

/// One parameter with its moments. `step` counts its updates.
struct Slot {
    name: String,
    group: usize,
    var: Var,
    first: Tensor,
    second: Tensor,
    step: u64,
}

impl AdamW {
    /// An optimizer at step 0 over all parameters of `groups`.
    ///
    /// # Errors
    /// If a setting is out of range, a parameter is neither f32 nor f64, or one is given twice (also
    /// under two names).
    pub fn new(groups: Vec<ParamGroup>, config: AdamWConfig) -> Result<Self, TrainError> {
        let AdamWConfig { beta1, beta2, eps } = config;
        check_setting("beta1", beta1, (0.0..1.0).contains(&beta1), "in 0..1")?;
        check_setting("beta2", beta2, (0.0..1.0).contains(&beta2), "in 0..1")?;
        let least = f64::from(f32::MIN_POSITIVE);
        check_setting("eps", eps, eps.is_finite() && eps >= least, "at least 1.2e-38")?;
        let (mut rates, mut slots) = (Vec::new(), BTreeMap::new());
        let mut names = HashMap::new();
        for (group, ParamGroup { params, lr, weight_decay }) in groups.into_iter().enumerate() {
            check_setting("lr", lr, lr.is_finite() && lr >= 0.0, "at least 0")?;
            check_decay(weight_decay)?;
            rates.push(GroupRates { lr, weight_decay });
            for (name, var) in params {
                if let Some(other) = names.insert(var.id(), name.clone()) {
                    return Err(TrainError::DuplicateParameter { name, other });
                }
                let slot = Slot::new(&name, group, var)?;
                if slots.insert(name.clone(), slot).is_some() {
                    return Err(TrainError::DuplicateParameter { other: name.clone(), name });
                }
            }
        }
        Ok(Self { config, groups: rates, slots: slots.into_values().collect() })
    }
}

impl Slot {
    fn new(name: &str, group: usize, var: Var) -> Result<Self, TrainError> {
        if !matches!(var.dtype(), DType::F32 | DType::F64) {
            return Err(TrainError::DType { name: name.to_owned(), dtype: var.dtype() });
        }
        let zeros = || {
            Tensor::zeros(var.shape(), var.dtype(), var.device()).map_err(TrainError::tensor(name))
        };
        let (first, second) = (zeros()?, zeros()?);
        Ok(Self { name: name.to_owned(), group, var, first, second, step: 0 })
    }

    fn keys(&self) -> [String; 3] {
        ["exp_avg", "exp_avg_sq", "step"].map(|part| format!("{}.{part}", self.name))
    }

    fn is_slice(&self) -> bool {
        slices::is_slice(&self.var)
            && slices::is_slice(&self.first)
            && slices::is_slice(&self.second)
    }

    fn update_moments(&mut self, grad: &Tensor, beta1: f64, beta2: f64) -> TensorResult<()> {
        if self.is_slice() && slices::is_slice(grad) {
            let weight = (1.0 - beta1) as f32;
            let first = InPlace("adamw-first-moment", |m, g| m + weight * (g - m));
            self.first.inplace_op2(grad, &first)?;
            let (beta, weight) = (beta2 as f32, (1.0 - beta2) as f32);
            let second = InPlace("adamw-second-moment", |v, g| beta * v + weight * g * g);
            return self.second.inplace_op2(grad, &second);
        }
        let towards = (grad - &self.first)?.affine(1.0 - beta1, 0.0)?;
        self.first = (&self.first + towards)?.detach();
        let fresh = grad.sqr()?.affine(1.0 - beta2, 0.0)?;
        self.second = (self.second.affine(beta2, 0.0)? + fresh)?.detach();
        Ok(())
    }

    fn update_parameter(&self, change: &Change) -> TensorResult<()> {
        if self.is_slice() {
            let [decay, rate, root_scale, eps] =
                [change.decay, change.rate, change.root_scale, change.eps].map(|v| v as f32);
            let update = InPlace("adamw-parameter", |p, m, v: f32| {
                p - (decay * p + rate * (m / (v.sqrt() / root_scale + eps)))
            });
            return self.var.inplace_op3(&self.first, &self.second, &update);
        }
        let root = (self.second.sqrt()? / change.root_scale)?;
        let direction = (&self.first / (root + change.eps)?)?;
        let value = self.var.as_detached_tensor();
        let change = (value.affine(change.decay, 0.0)? + direction.affine(change.rate, 0.0)?)?;
        self.var.set(&(value - change)?)
    }
}

impl Optimizer for AdamW {
    fn step(
        &mut self,
        grads: &GradStore,
        hyperparameters: &StepHyperparameters,
    ) -> Result<(), TrainError> {
        let AdamWConfig { beta1, beta2, eps } = self.config;
        let scale = hyperparameters.lr_scale;
        check_setting("lr_scale", scale, scale.is_finite() && scale >= 0.0, "at least 0")?;
        let beta1 = hyperparameters.beta1.unwrap_or(beta1);
        check_setting("beta1", beta1, (0.0..1.0).contains(&beta1), "in 0..1")?;
        hyperparameters.weight_decay.map_or(Ok(()), check_decay)?;
        // Everything is checked before anything changes.
        let grads = self.checked_grads(grads)?;
        // A gradient may share memory with some parameter, so all are read before any is written.
        for (slot, grad) in self.slots.iter_mut().zip(&grads) {
            let Some(grad) = grad else { continue };
            slot.update_moments(grad, beta1, beta2).map_err(TrainError::tensor(&slot.name))?;
            slot.step = (slot.step + 1).min(MAX_STEP);
        }
        for (slot, _) in self.slots.iter().zip(&grads).filter(|(_, grad)| grad.is_some()) {
            let rates = &self.groups[slot.group];
            let (lr, t) = (rates.lr * scale, slot.step as f64);
            let change = Change {
                decay: lr * hyperparameters.weight_decay.unwrap_or(rates.weight_decay),
                rate: lr / (1.0 - beta1.powf(t)),
                root_scale: (1.0 - beta2.powf(t)).sqrt(),
                eps,
            };
            slot.update_parameter(&change).map_err(TrainError::tensor(&slot.name))?;
        }
        Ok(())
    }

    fn settings(&self) -> serde_json::Value {
        let group = |(i, group): (usize, &GroupRates)| {
            let parameters = self.slots.iter().filter(|slot| slot.group == i).count();
            serde_json::json!({
                "lr": group.lr, "weight_decay": group.weight_decay, "parameters": parameters,
            })
        };
        let groups: Vec<_> = self.groups.iter().enumerate().map(group).collect();
        serde_json::json!({ "adamw": self.config, "parameter_groups": groups })
    }

    fn state(&self) -> Result<BTreeMap<String, Tensor>, TrainError> {
        let mut state = BTreeMap::new();
        for slot in &self.slots {
            let [first, second, step] = slot.keys();
            let error = TrainError::tensor(&slot.name);
            state.insert(first, slot.first.copy().map_err(&error)?);
            state.insert(second, slot.second.copy().map_err(&error)?);
            let count = Tensor::new(slot.step as i64, &candle_core::Device::Cpu).map_err(&error)?;
            state.insert(step, count);
        }
        Ok(state)
    }

    fn load_state(&mut self, state: &BTreeMap<String, Tensor>) -> Result<(), TrainError> {
        let mut known = std::collections::BTreeSet::new();
        let mut loaded = Vec::with_capacity(self.slots.len());
        for slot in &self.slots {
            let keys = slot.keys();
            let get = |key: &String| {
                let missing = || TrainError::State { key: key.clone(), problem: "missing" };
                state.get(key).ok_or_else(missing)
            };
            let error = TrainError::tensor(&slot.name);
            let moment = |key: &String| {
                let tensor = get(key)?;
                check_like("moment", key, tensor, &slot.var)?;
                // A copy, because steps work in place; contiguous, so that they can.
                let moved =
                    tensor.detach().to_device(slot.var.device()).and_then(|t| t.force_contiguous());
                moved.map_err(&error)
            };
            let count = get(&keys[2])?.to_dtype(DType::I64).and_then(|t| t.to_scalar::<i64>());
            let count = u64::try_from(count.map_err(&error)?)
                .map_err(|_| TrainError::State { key: keys[2].clone(), problem: "negative" })?;
            loaded.push((moment(&keys[0])?, moment(&keys[1])?, count));
            known.extend(keys);
        }
        if let Some(key) = state.keys().find(|key| !known.contains(*key)) {
            return Err(TrainError::State { key: key.clone(), problem: "unknown" });
        }
        for (slot, (first, second, step)) in self.slots.iter_mut().zip(loaded) {
            (slot.first, slot.second, slot.step) = (first, second, step);
        }
        Ok(())
    }
}

impl AdamW {
    /// The detached gradient of each slot, or none.
    fn checked_grads(&self, grads: &GradStore) -> Result<Vec<Option<Tensor>>, TrainError> {
        let checked = |slot: &Slot| {
            let Some(grad) = grads.get(&slot.var) else { return Ok(None) };
            check_like("gradient", &slot.name, grad, &slot.var)?;
            let norm = clip::sum_of_squares(&slot.name, grad)?.sqrt();
            if norm > MAX_GRAD_NORM {
                return Err(TrainError::GradientTooLarge { name: slot.name.clone(), norm });
            }
            let grad = grad.detach().contiguous().map_err(TrainError::tensor(&slot.name))?;
            Ok(Some(grad))
        };
        self.slots.iter().map(checked).collect()
    }
}

fn check_decay(decay: f64) -> Result<(), TrainError> {
    check_setting("weight_decay", decay, decay.is_finite() && decay >= 0.0, "at least 0")
}

/// Checks that a tensor has the shape and type of its parameter.
pub(super) fn check_like(
    what: &'static str,
    name: &str,
    tensor: &Tensor,
    param: &Tensor,
) -> Result<(), TrainError> {
    if tensor.shape() == param.shape() && tensor.dtype() == param.dtype() {
        return Ok(());
    }
    let describe = |t: &Tensor| format!("{:?} {:?}", t.dtype(), t.dims());
    let (expected, got) = (describe(param), describe(tensor));
    Err(TrainError::Mismatch { what, name: name.to_owned(), expected, got })
}

/// The last line of the update with the first one folded in.
struct Change {
    /// η · weight decay. Taken off instead of multiplying by 1 − it: that factor, rounded to f32, is off by up
    /// to 3e-8, always to the same side, which adds up over the steps.
    decay: f64,
    rate: f64,
    root_scale: f64,
    eps: f64,
}
