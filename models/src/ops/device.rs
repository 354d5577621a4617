//! Operations on tensors of another device than the CPU.
//!
//! A pass that the device has kernels for is a sequence of launches ([`super::launches`]). Where there is none, the pass
//! of the CPU runs on copies of the values; each such pass is counted in [`scenesplat_kernels::fallbacks`].

use super::launches::Launches;
use candle_core::backend::{BackendDevice, BackendStorage};
use candle_core::{CpuStorage, Device, Layout, Result, Shape, Tensor};
use scenesplat_kernels::fallbacks::{self, Pass};

/// Counts a pass that is about to run here, if `t` is elsewhere; where it is, and its result belongs.
pub(crate) fn here<'a>(op: &'static str, pass: Pass, t: &'a Tensor) -> &'a Device {
    if !t.device().is_cpu() {
        fallbacks::count(op, pass);
    }
    t.device()
}

/// Runs the forward pass of the CPU on copies of a device's values, and puts the result there.
///
/// # Errors
/// Those of the pass, or if the device cannot copy.
pub(crate) fn through_host<S: BackendStorage, const N: usize>(
    op: &'static str,
    inputs: [(&S, &Layout); N],
    run: impl FnOnce([(&CpuStorage, &Layout); N]) -> Result<(CpuStorage, Shape)>,
) -> Result<(S, Shape)>
where
    S::Device: BackendDevice<Storage = S>,
{
    fallbacks::count(op, Pass::Forward);
    let mut copies = Vec::with_capacity(N);
    for (storage, _) in inputs {
        copies.push(storage.to_cpu_storage()?);
    }
    let (out, shape) = run(std::array::from_fn(|i| (&copies[i], inputs[i].1)))?;
    Ok((inputs[0].0.device().storage_from_cpu_storage_owned(out)?, shape))
}

/// Runs a pass by a device's own kernels, if all inputs are on one that has them; `None` elsewhere.
///
/// # Errors
/// What the device reports, or if an input is not f32.
pub(crate) fn launched<const N: usize>(
    inputs: [&Tensor; N],
    pass: &impl Launches<N>,
) -> Result<Option<Vec<Tensor>>> {
    #[cfg(feature = "cuda")]
    if inputs.iter().all(|t| t.device().is_cuda()) {
        return crate::device::launcher::on_tensors(inputs, pass).map(Some);
    }
    #[cfg(feature = "emulation")]
    if crate::device::emulated::is_emulated() {
        let mut values = Vec::with_capacity(N);
        for tensor in inputs {
            values.push(tensor.flatten_all()?.to_vec1::<f32>()?);
        }
        let of = |i: usize| (values[i].as_slice(), inputs[i].dims());
        let made = crate::device::emulated::run(std::array::from_fn(of), pass)?;
        let tensor = |(values, shape)| Tensor::from_vec(values, shape, &Device::Cpu);
        return made.map(|made| made.into_iter().map(tensor).collect()).transpose();
    }
    let _ = (inputs, pass);
    Ok(None)
}

/// Runs a forward pass on the emulated grid, if tests ask for that on this thread and there is such a pass.
///
/// # Errors
/// Those of `pass`, which checks shapes, or what a kernel did.
pub(crate) fn emulated<const N: usize, P: Launches<N>>(
    inputs: [(&CpuStorage, &Layout); N],
    pass: impl FnOnce() -> Result<Option<P>>,
) -> Result<Option<(CpuStorage, Shape)>> {
    #[cfg(feature = "emulation")]
    if crate::device::emulated::is_emulated() {
        let Some(pass) = pass()? else { return Ok(None) };
        let mut arrays = [(&[][..], &[][..]); N];
        for (array, (storage, layout)) in arrays.iter_mut().zip(inputs) {
            *array = (super::cpu_slice("emulated", storage, layout)?, layout.shape().dims());
        }
        let made = crate::device::emulated::run(arrays, &pass)?;
        return Ok(made.and_then(|mut made| made.pop()).map(|(v, s)| (CpuStorage::F32(v), s)));
    }
    let _ = (inputs, pass);
    Ok(None)
}

/// The forward passes of a custom operation on CUDA and Metal. Given a method that makes an `Option` of [`Launches`] from
/// the layouts (having checked them), CUDA runs that; else, and on Metal, the pass of the CPU runs on copies, and is counted.
macro_rules! forward_on_device {
    ($custom:ident $(, $pass:ident)?) => {
        $crate::ops::forward_on_device!(@$custom cuda_fwd CudaStorage $(, $pass)?);
        $crate::ops::forward_on_device!(@$custom metal_fwd MetalStorage);
    };
    (@CustomOp1 $name:ident $storage:ident $(, $pass:ident)?) => {
        fn $name(
            &self,
            s: &candle_core::$storage,
            l: &Layout,
        ) -> Result<(candle_core::$storage, Shape)> {
            $(#[cfg(feature = "cuda")]
            if let Some(pass) = self.$pass([l])? {
                return $crate::device::launcher::on_storages([(s, l)], &pass);
            })?
            let name = CustomOp1::name(self);
            $crate::ops::device::through_host(name, [(s, l)], |[(s, l)]| self.cpu_fwd(s, l))
        }
    };
    (@CustomOp2 $name:ident $storage:ident $(, $pass:ident)?) => {
        fn $name(
            &self,
            s1: &candle_core::$storage,
            l1: &Layout,
            s2: &candle_core::$storage,
            l2: &Layout,
        ) -> Result<(candle_core::$storage, Shape)> {
            $(#[cfg(feature = "cuda")]
            if let Some(pass) = self.$pass([l1, l2])? {
                return $crate::device::launcher::on_storages([(s1, l1), (s2, l2)], &pass);
            })?
            let name = CustomOp2::name(self);
            $crate::ops::device::through_host(name, [(s1, l1), (s2, l2)], |[a, b]| {
                CustomOp2::cpu_fwd(self, a.0, a.1, b.0, b.1)
            })
        }
    };
    (@CustomOp3 $name:ident $storage:ident $(, $pass:ident)?) => {
        fn $name(
            &self,
            s1: &candle_core::$storage,
            l1: &Layout,
            s2: &candle_core::$storage,
            l2: &Layout,
            s3: &candle_core::$storage,
            l3: &Layout,
        ) -> Result<(candle_core::$storage, Shape)> {
            let inputs = [(s1, l1), (s2, l2), (s3, l3)];
            $(#[cfg(feature = "cuda")]
            if let Some(pass) = self.$pass([l1, l2, l3])? {
                return $crate::device::launcher::on_storages(inputs, &pass);
            })?
            let name = CustomOp3::name(self);
            $crate::ops::device::through_host(name, inputs, |[a, b, c]| {
                CustomOp3::cpu_fwd(self, a.0, a.1, b.0, b.1, c.0, c.1)
            })
        }
    };
}
pub(crate) use forward_on_device;
