//! A moving average of the parameters, used in their place for evaluation.

use crate::{TrainError, ema_update};
use candle_core::{Tensor, Var};
use std::collections::BTreeMap;

/// Averages of parameters by name.
///
/// The decay of update `n` (from 0) is `min(decay, (1 + n) / (10 + n))`, so that the first values,
/// which mean nothing yet, are forgotten soon. Batch statistics are averages already and not part.
#[derive(Debug)]
pub struct Average {
    decay: f64,
    values: BTreeMap<String, Var>,
}

impl Average {
    /// Starts at the present values.
    ///
    /// # Errors
    /// If a parameter cannot be copied.
    pub fn new(params: &BTreeMap<String, Var>, decay: f64) -> Result<Self, TrainError> {
        let copy = |(name, var): (&String, &Var)| {
            let value = var.as_detached_tensor().copy().map_err(TrainError::tensor(name))?;
            Ok((name.clone(), Var::from_tensor(&value).map_err(TrainError::tensor(name))?))
        };
        Ok(Self { decay, values: params.iter().map(copy).collect::<Result<_, TrainError>>()? })
    }

    /// Moves toward the present values; `updates` counts the updates done before.
    ///
    /// # Errors
    /// If a parameter is gone or has another shape.
    pub fn update(&self, params: &BTreeMap<String, Var>, updates: u64) -> Result<(), TrainError> {
        let early = (1.0 + updates as f64) / (10.0 + updates as f64);
        ema_update(&self.values, params, self.decay.min(early))
    }

    /// Runs `f` while the parameters have the averaged values.
    ///
    /// # Errors
    /// That of `f`, or if values cannot be exchanged.
    pub fn during<R>(
        &self,
        params: &BTreeMap<String, Var>,
        f: impl FnOnce() -> Result<R, TrainError>,
    ) -> Result<R, TrainError> {
        self.swap(params)?;
        let result = f();
        self.swap(params)?;
        result
    }

    fn swap(&self, params: &BTreeMap<String, Var>) -> Result<(), TrainError> {
        for (name, average) in &self.values {
            let Some(var) = params.get(name) else {
                return Err(TrainError::MissingParameter { what: "average", name: name.clone() });
            };
            let exchange = || {
                let present = var.as_detached_tensor().copy()?;
                var.set(&average.as_detached_tensor().copy()?)?;
                average.set(&present)
            };
            exchange().map_err(TrainError::tensor(name))?;
        }
        Ok(())
    }

    /// The averages, by name.
    pub fn values(&self) -> BTreeMap<String, Tensor> {
        self.values.iter().map(|(n, v)| (n.clone(), v.as_detached_tensor())).collect()
    }

    /// Takes back what [`values`](Self::values) gave.
    ///
    /// # Errors
    /// If a name is missing or a shape differs.
    pub fn load(&self, values: &BTreeMap<String, Tensor>) -> Result<(), TrainError> {
        for (name, var) in &self.values {
            let Some(value) = values.get(name) else {
                return Err(TrainError::MissingParameter { what: "average", name: name.clone() });
            };
            var.set(value).map_err(TrainError::tensor(name))?;
        }
        Ok(())
    }
}
