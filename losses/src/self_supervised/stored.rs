//! Losses of few values, whose gradient is computed along with them.

use crate::error::LossError;
use crate::scalar_op::{Backward, scalar_loss};
use crate::values::Real;
use candle_core::{DType, Result, Tensor};

/// Largest number of f16, at which gradients saturate.
const LARGEST_F16: f64 = 65_504.0;

struct Stored {
    name: &'static str,
    gradient: Vec<f64>,
}

impl Backward for Stored {
    fn name(&self) -> &'static str {
        self.name
    }
    fn gradient<T: Real>(&self, pred: &Tensor, factor: f64) -> Result<Tensor> {
        let largest = if pred.dtype() == DType::F16 { LARGEST_F16 } else { f64::INFINITY };
        let scaled = |g: &f64| (factor * g).clamp(-largest, largest);
        let values: Vec<f64> = self.gradient.iter().map(scaled).collect();
        Tensor::from_vec(values, pred.shape(), pred.device())?.to_dtype(pred.dtype())
    }
}

/// A scalar of this value whose gradient to `pred` is `gradient`, in the order of its values.
pub(super) fn stored_loss(
    name: &'static str,
    pred: &Tensor,
    value: f64,
    gradient: Vec<f64>,
) -> Result<Tensor> {
    scalar_loss(pred, value, Stored { name, gradient })
}

/// Vectors of views: `[views, scenes, width]`, as f64.
pub(super) struct Views {
    pub values: Vec<f64>,
    pub views: usize,
    pub scenes: usize,
    pub width: usize,
}

/// All values as f64, checked to be finite; `width` is that of a row in messages.
pub(super) fn finite_values(
    loss: &'static str,
    field: &'static str,
    tensor: &Tensor,
    width: usize,
) -> Result<Vec<f64>> {
    let values: Vec<f64> = tensor.to_dtype(DType::F64)?.flatten_all()?.to_vec1()?;
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(values),
        Some(at) => {
            let (row, column, value) = (at / width, at % width, values[at]);
            Err(LossError::NotFinite { loss, field, row, column, value }.into())
        }
    }
}

impl Views {
    /// Reads and checks vectors of rank 3 `[views, B, D]`, or of rank 2 `[N, D]`: one view.
    pub fn read(
        loss: &'static str,
        field: &'static str,
        tensor: &Tensor,
        rank: usize,
    ) -> Result<Self> {
        let (views, scenes, width) = match *tensor.dims() {
            [views, scenes, width] if rank == 3 => (views, scenes, width),
            [scenes, width] if rank == 2 => (1, scenes, width),
            _ => {
                let expected = if rank == 2 { "[N, D]" } else { "[views, B, D]" };
                return Err(LossError::shape(loss, field, expected, tensor.dims()).into());
            }
        };
        if !matches!(tensor.dtype(), DType::F32 | DType::F64 | DType::BF16 | DType::F16) {
            let got = format!("{:?}", tensor.dtype());
            return Err(LossError::Type { loss, field, got }.into());
        }
        let values = finite_values(loss, field, tensor, width)?;
        Ok(Self { values, views, scenes, width })
    }

    /// The vectors of a view. `[B · D]`
    pub fn view(&self, view: usize) -> &[f64] {
        let size = self.scenes * self.width;
        &self.values[view * size..][..size]
    }

    /// The vector of a scene in a view. `[D]`
    pub fn row(&self, view: usize, scene: usize) -> &[f64] {
        &self.values[(view * self.scenes + scene) * self.width..][..self.width]
    }
}

/// Checks that a teacher has views of the same scenes and width, at most as many as the student.
pub(super) fn check_teacher(loss: &'static str, student: &Views, teacher: &Views) -> Result<()> {
    let fits = teacher.scenes == student.scenes && teacher.width == student.width;
    if fits && (1..=student.views).contains(&teacher.views) {
        return Ok(());
    }
    let expected = format!("[1..={}, {}, {}]", student.views, student.scenes, student.width);
    let got = [teacher.views, teacher.scenes, teacher.width];
    Err(LossError::shape(loss, "teacher", expected, &got).into())
}
