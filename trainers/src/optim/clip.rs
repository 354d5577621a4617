use super::slices;
use crate::TrainError;
use crate::error::check_setting;
use candle_core::{DType, Storage, Tensor, Var, backprop::GradStore};
use std::collections::BTreeMap;

/// Added to the norm by PyTorch, so that a zero norm divides nothing.
const NORM_EPS: f64 = 1e-6;

/// Below this factor its f32 value loses bits, and scaling is done in two rounds.
const SMALL_FACTOR: f64 = 1e-30;

/// Euclidean norm over the gradients of all `params` together.
///
/// Squares are added in f64, parameters in name order. Parameters without a gradient count as 0.
///
/// # Errors
/// [`TrainError::NonFiniteGradient`] with the first parameter whose gradient has a NaN or infinity.
pub fn grad_norm(params: &BTreeMap<String, Var>, grads: &GradStore) -> Result<f64, TrainError> {
    let mut sum = 0.0;
    for (name, var) in params {
        if let Some(grad) = grads.get(var) {
            sum += sum_of_squares(name, grad)?;
        }
    }
    Ok(sum.sqrt())
}

/// Scales all gradients down so that their joint norm is at most `max_norm`; returns the norm before.
///
/// `g ← g · min(1, max_norm / (norm + 1e-6))`. The gradients that stay in `grads` are detached, so
/// that none of them keeps the graph alive.
///
/// # Errors
/// If `max_norm` is negative or NaN, or a gradient is not finite (named; nothing has changed then).
///
/// # Source
/// `torch.nn.utils.clip_grad_norm_`. Differs: the norm is summed in f64; a norm that is not finite
/// is an error, where PyTorch by default spreads the NaN to every parameter.
pub fn clip_grad_norm(
    params: &BTreeMap<String, Var>,
    grads: &mut GradStore,
    max_norm: f64,
) -> Result<f64, TrainError> {
    check_setting("max_norm", max_norm, max_norm >= 0.0, "at least 0")?;
    let norm = grad_norm(params, grads)?;
    let factor = max_norm / (norm + NORM_EPS);
    for (name, var) in params {
        let Some(grad) = grads.get(var) else { continue };
        let clipped = scaled(grad, factor).map_err(TrainError::tensor(name))?;
        grads.insert(var, clipped);
    }
    Ok(norm)
}

fn scaled(grad: &Tensor, factor: f64) -> candle_core::Result<Tensor> {
    let grad = grad.detach();
    if factor >= 1.0 {
        Ok(grad)
    } else if factor < SMALL_FACTOR && factor > 0.0 {
        let root = factor.sqrt();
        grad.affine(root, 0.0)?.affine(root, 0.0)
    } else {
        grad.affine(factor, 0.0)
    }
}

/// Sum of squares of a gradient in f64; an error if it is not finite. The squares of f32 values fit
/// in an f64 with room for 10²³⁰ of them, so only a NaN or infinity in the gradient gets there.
pub(super) fn sum_of_squares(name: &str, grad: &Tensor) -> Result<f64, TrainError> {
    let on_host = {
        let (storage, layout) = grad.storage_and_layout();
        match &*storage {
            Storage::Cpu(storage) => slices::elements(storage, layout).map(slices::sum_of_squares),
            _ => None,
        }
    };
    let sum = match on_host {
        Some(sum) => Ok(sum),
        None => {
            grad.detach().to_dtype(DType::F64).and_then(|g| g.sqr()?.sum_all()?.to_scalar::<f64>())
        }
    };
    let sum = sum.map_err(TrainError::tensor(name))?;
    if sum.is_finite() {
        Ok(sum)
    } else {
        Err(TrainError::NonFiniteGradient { name: name.to_owned() })
    }
}
