//! Gradients between `backward` and the optimizer.

use crate::TrainError;
use candle_core::{Var, backprop::GradStore};
use std::collections::BTreeMap;

/// Adds the gradients of `params` in `new` to `sum`.
///
/// They are detached: what `backward` returns still points into the graph and would keep every
/// activation of the step alive.
///
/// # Errors
/// If two gradients of one parameter differ in shape.
pub fn add_gradients(
    sum: &mut GradStore,
    new: &mut GradStore,
    params: &BTreeMap<String, Var>,
) -> Result<(), TrainError> {
    for (name, var) in params {
        let Some(grad) = new.remove(var) else { continue };
        let grad = match sum.remove(var) {
            Some(old) => (old + grad).map_err(TrainError::tensor(name))?,
            None => grad,
        };
        sum.insert(var, grad.detach());
    }
    Ok(())
}

/// Checks that every parameter has a gradient, except those whose name contains one of `idle`.
///
/// candle's fused norms and its fused softmax have no gradient and do not say so; everything before
/// them would silently stay as it is.
///
/// # Errors
/// [`TrainError::DeadParameters`] with the names.
pub fn check_gradients(
    params: &BTreeMap<String, Var>,
    grads: &GradStore,
    idle: &[String],
) -> Result<(), TrainError> {
    let dead = params.iter().filter(|(name, var)| {
        grads.get(var).is_none() && !idle.iter().any(|part| name.contains(part.as_str()))
    });
    let names: Vec<String> = dead.map(|(name, _)| name.clone()).collect();
    if names.is_empty() { Ok(()) } else { Err(TrainError::DeadParameters { names }) }
}
