//! Unit-length rows.

use super::{Pass, composed, cpu_slice, forward_on_device, here, make, read};
use crate::device::off_host;
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};
use scenesplat_kernels::normalize::{norm, normalize_rows};

struct L2Normalize {
    /// Smaller norms count as this; below it the divisor is a constant.
    floor: f64,
}

/// The floor of the kernel.
const EPS: f64 = 1e-12;

impl CustomOp1 for L2Normalize {
    fn name(&self) -> &'static str {
        "l2_normalize"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        let (_, c) = l.shape().dims2()?;
        let x = cpu_slice("l2_normalize", s, l)?;
        let mut out = x.to_vec();
        if self.floor <= EPS {
            normalize_rows(&mut out, c);
        } else if c > 0 {
            for row in out.chunks_exact_mut(c) {
                let inverse = 1.0 / norm(row).max(self.floor);
                row.iter_mut().for_each(|v| *v = (f64::from(*v) * inverse) as f32);
            }
        }
        Ok((CpuStorage::F32(out), l.shape().clone()))
    }
    forward_on_device!(CustomOp1);
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let (_, c) = x.dims2()?;
        let (shape, device) = (x.shape().clone(), here("l2_normalize", Pass::Backward, x));
        read("l2_normalize", x, |x| {
            read("l2_normalize", grad, |g| {
                make(device, shape, |out| {
                    for ((x, g), out) in
                        x.chunks_exact(c).zip(g.chunks_exact(c)).zip(out.chunks_exact_mut(c))
                    {
                        let norm = norm(x).max(self.floor);
                        // Below the floor the divisor is a constant.
                        let along = if norm > self.floor {
                            let dot: f64 =
                                x.iter().zip(g).map(|(x, g)| f64::from(*x) * f64::from(*g)).sum();
                            dot / norm / norm
                        } else {
                            0.0
                        };
                        for j in 0..c {
                            out[j] = ((f64::from(g[j]) - f64::from(x[j]) * along) / norm) as f32;
                        }
                    }
                })
            })
        })
        .map(Some)
    }
}

/// `x / max(‖x‖, 1e-12)` for each row; a zero row stays zero.
///
/// # Shapes
/// `x`: `[N, C]` f32 · returns `[N, C]`
///
/// # Errors
/// If the tensor is not a matrix of f32.
pub fn l2_normalize(x: &Tensor) -> Result<Tensor> {
    l2_normalize_above(x, EPS)
}

/// `x / max(‖x‖, floor)` for each row; `floor` is 1e-12 at least. On the calling thread: for few rows.
///
/// # Shapes
/// `x`: `[N, C]` f32 · returns `[N, C]`
///
/// # Errors
/// If the tensor is not a matrix of f32.
pub fn l2_normalize_above(x: &Tensor, floor: f64) -> Result<Tensor> {
    let floor = floor.max(EPS);
    if off_host(x.device()) {
        x.dims2()?;
        return composed::unit_rows(x, floor);
    }
    x.contiguous()?.apply_op1(L2Normalize { floor })
}
