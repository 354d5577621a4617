//! A loss as one candle operation: the value is computed before, the gradient when it is asked for.

use candle_core::{CpuStorage, CustomOp1, DType, Layout, Result, Shape, Tensor};

/// The gradient of a loss, from what its forward pass kept.
pub(crate) trait Backward: Send + Sync + 'static {
    /// Name of the operation in messages.
    fn name(&self) -> &'static str;
    /// `factor · ∂loss/∂pred`, in the type and shape of `pred`.
    fn gradient(&self, pred: &Tensor, factor: f64) -> Result<Tensor>;
}

struct Known<B> {
    value: f64,
    backward: B,
}

impl<B: Backward> CustomOp1 for Known<B> {
    fn name(&self) -> &'static str {
        self.backward.name()
    }
    fn cpu_fwd(&self, pred: &CpuStorage, _: &Layout) -> Result<(CpuStorage, Shape)> {
        let value = match pred {
            CpuStorage::F64(_) => CpuStorage::F64(vec![self.value]),
            _ => CpuStorage::F32(vec![self.value as f32]),
        };
        Ok((value, Shape::from(())))
    }
    fn bwd(&self, pred: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let factor = grad.to_dtype(DType::F64)?.to_scalar::<f64>()?;
        self.backward.gradient(pred, factor).map(Some)
    }
}

/// A scalar with this value and gradient: f64 if `pred` is, else f32.
pub(crate) fn scalar_loss(pred: &Tensor, value: f64, backward: impl Backward) -> Result<Tensor> {
    pred.apply_op1(Known { value, backward })
}

/// Zero, with zeros for a gradient.
pub(crate) struct Zero;

impl Backward for Zero {
    fn name(&self) -> &'static str {
        "zero_loss"
    }
    fn gradient(&self, pred: &Tensor, _: f64) -> Result<Tensor> {
        pred.zeros_like()
    }
}
