//! A loss as one candle operation: the value is computed before it, the gradient in the backward pass.
//!
//! Both run on the CPU. Rows on another device are copied from it, value and gradient are copied to it; each
//! pass is counted in [`scenesplat_kernels::fallbacks`] by the loss's name.

use crate::values::Real;
use candle_core::backend::{BackendDevice, BackendStorage};
use candle_core::{CpuStorage, CudaStorage, CustomOp1, DType, Layout, Result, Shape, Tensor};
use scenesplat_kernels::fallbacks::{Pass, count};

/// The gradient of a loss, from what its forward pass kept.
pub(crate) trait Backward: Send + Sync + 'static {
    /// Name of the operation in messages.
    fn name(&self) -> &'static str;
    /// `factor · ∂loss/∂pred`, in the type and shape of `pred`.
    /// Computed in `T`: f64 for f64, else f32.
    fn gradient<T: Real>(&self, pred: &Tensor, factor: f64) -> Result<Tensor>;
}

struct Known<B> {
    value: f64,
    backward: B,
}

impl<B: Backward> Known<B> {
    fn storage(&self, dtype: DType) -> CpuStorage {
        match dtype {
            DType::F64 => CpuStorage::F64(vec![self.value]),
            _ => CpuStorage::F32(vec![self.value as f32]),
        }
    }

    /// The value, on the device of `pred`; it was computed here.
    fn elsewhere<S: BackendStorage>(&self, pred: &S) -> Result<(S, Shape)>
    where
        S::Device: BackendDevice<Storage = S>,
    {
        count(self.backward.name(), Pass::Forward);
        let value = self.storage(pred.dtype());
        Ok((pred.device().storage_from_cpu_storage_owned(value)?, Shape::from(())))
    }
}

impl<B: Backward> CustomOp1 for Known<B> {
    fn name(&self) -> &'static str {
        self.backward.name()
    }
    fn cpu_fwd(&self, pred: &CpuStorage, _: &Layout) -> Result<(CpuStorage, Shape)> {
        Ok((self.storage(pred.dtype()), Shape::from(())))
    }
    fn cuda_fwd(&self, pred: &CudaStorage, _: &Layout) -> Result<(CudaStorage, Shape)> {
        self.elsewhere(pred)
    }
    fn bwd(&self, pred: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        if !pred.device().is_cpu() {
            count(self.backward.name(), Pass::Backward);
        }
        let factor = grad.to_dtype(DType::F64)?.to_scalar::<f64>()?;
        match pred.dtype() {
            DType::F64 => self.backward.gradient::<f64>(pred, factor),
            _ => self.backward.gradient::<f32>(pred, factor),
        }
        .map(Some)
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
    fn gradient<T: Real>(&self, pred: &Tensor, _: f64) -> Result<Tensor> {
        pred.zeros_like()
    }
}
