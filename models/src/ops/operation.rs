//! Differentiable operations: what each says about itself, and how candle runs it on any device.
//!
//! On CUDA an operation launches its kernels. Where it has none, the CPU computes it on copies of the values; each such pass
//! is counted in [`scenesplat_kernels::fallbacks`].

use super::{Array, cpu_slice, read_all};
use crate::device::launches::{Input, Launched, Launches};
use candle_core::backend::{BackendDevice, BackendStorage};
use candle_core::{
    CpuStorage, CudaStorage, CustomOp1, CustomOp2, CustomOp3, Device, Layout, Result, Shape,
    Tensor, bail,
};
use scenesplat_device::Launcher;
use scenesplat_kernels::fallbacks::{self, Pass};

/// An operation on up to three tensors of f32, with its gradient.
pub(crate) trait Operation: Sized + Send + Sync + 'static {
    /// Name in messages and counts.
    const NAME: &'static str;

    /// Checks the shapes of the inputs and gives that of the result.
    fn shape(&self, inputs: &[&Shape]) -> Result<Shape>;

    /// The result, on the CPU. Shapes were checked.
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>>;

    /// The gradient of each input, from that of the result, on the CPU.
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>>;

    /// The result, by kernels of a device.
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        _ = (l, inputs);
        Ok(None)
    }

    /// The gradient of each input, by kernels of a device. `inputs`: those of the operation, then the gradient of the result.
    fn launch_backward<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        _ = (l, inputs);
        Ok(None)
    }

    /// The gradient of each input, as tensors.
    fn gradients(&self, inputs: &[&Tensor], grad: &Tensor) -> Result<Vec<Tensor>> {
        gradients(self, inputs, grad)
    }
}

/// Applies an operation.
///
/// # Errors
/// If shapes do not fit or a tensor is not f32.
pub(crate) fn apply<O: Operation>(operation: O, inputs: &[&Tensor]) -> Result<Tensor> {
    let x = inputs[0].contiguous()?;
    match *inputs {
        [_] => x.apply_op1(Custom(operation)),
        [_, second] => x.apply_op2(second, Custom(operation)),
        [_, second, third] => x.apply_op3(second, third, Custom(operation)),
        _ => bail!("{}: {} inputs", O::NAME, inputs.len()),
    }
}

/// The gradients by a device's kernels if it has some, else by the CPU; of these inputs alone.
pub(crate) fn gradients<O: Operation>(
    operation: &O,
    inputs: &[&Tensor],
    grad: &Tensor,
) -> Result<Vec<Tensor>> {
    let all: Vec<&Tensor> = inputs.iter().copied().chain([grad]).collect();
    if let Some(made) = launched(&all, &Backward(operation))? {
        return Ok(made);
    }
    let device = here(O::NAME, Pass::Backward, grad);
    let made = read_all(O::NAME, &all, |arrays| {
        let (inputs, grad) = arrays.split_at(inputs.len());
        operation.backward(inputs, grad[0].0)
    })?;
    let tensor = |(values, input): (_, &&Tensor)| Tensor::from_vec(values, input.shape(), device);
    made.into_iter().zip(inputs).map(tensor).collect()
}

/// Counts a pass that the CPU is about to run, if `t` is elsewhere. The device of `t`, where the result belongs.
pub(crate) fn here<'a>(op: &'static str, pass: Pass, t: &'a Tensor) -> &'a Device {
    if !t.device().is_cpu() {
        fallbacks::count(op, pass);
    }
    t.device()
}

/// Runs a pass by a device's own kernels, if all inputs are on one that has them; `None` elsewhere.
fn launched(inputs: &[&Tensor], pass: &impl Launches) -> Result<Option<Vec<Tensor>>> {
    #[cfg(feature = "cuda")]
    if inputs.iter().all(|t| t.device().is_cuda()) {
        return crate::device::launcher::on_tensors(inputs, pass);
    }
    #[cfg(feature = "emulation")]
    if crate::device::emulated::is_emulated() {
        let run = |arrays: &[Array<'_>]| crate::device::emulated::run(arrays, pass);
        let tensor = |(values, shape)| Tensor::from_vec(values, shape, &Device::Cpu);
        let made = read_all(pass.name().0, inputs, run)?;
        return made.map(|made| made.into_iter().map(tensor).collect()).transpose();
    }
    _ = (inputs, pass);
    Ok(None)
}

#[cfg(any(feature = "cuda", feature = "emulation"))]
struct Forward<'a, O>(&'a O);

#[cfg(any(feature = "cuda", feature = "emulation"))]
impl<O: Operation> Launches for Forward<'_, O> {
    fn name(&self) -> (&'static str, Pass) {
        (O::NAME, Pass::Forward)
    }
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        self.0.launch(l, inputs)
    }
}

struct Backward<'a, O>(&'a O);

impl<O: Operation> Launches for Backward<'_, O> {
    fn name(&self) -> (&'static str, Pass) {
        (O::NAME, Pass::Backward)
    }
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        self.0.launch_backward(l, inputs)
    }
}

/// An operation as candle runs it.
struct Custom<O>(O);

impl<O: Operation> Custom<O> {
    fn shape<S>(&self, inputs: &[(&S, &Layout)]) -> Result<Shape> {
        let shapes: Vec<&Shape> = inputs.iter().map(|(_, layout)| layout.shape()).collect();
        self.0.shape(&shapes)
    }

    fn on_cpu(&self, inputs: &[(&CpuStorage, &Layout)]) -> Result<(CpuStorage, Shape)> {
        let shape = self.shape(inputs)?;
        let mut arrays = Vec::with_capacity(inputs.len());
        for (storage, layout) in inputs {
            arrays.push((cpu_slice(O::NAME, storage, layout)?, layout.dims()));
        }
        #[cfg(feature = "emulation")]
        if let Some(mut made) = crate::device::emulated::run(&arrays, &Forward(&self.0))?
            && let Some((values, shape)) = made.pop()
        {
            return Ok((CpuStorage::F32(values), shape));
        }
        Ok((CpuStorage::F32(self.0.forward(&arrays)?), shape))
    }

    fn on_cuda(&self, inputs: &[(&CudaStorage, &Layout)]) -> Result<(CudaStorage, Shape)> {
        #[cfg(feature = "cuda")]
        {
            self.shape(inputs)?;
            if let Some(made) = crate::device::launcher::on_storages(inputs, &Forward(&self.0))? {
                return Ok(made);
            }
        }
        self.on_copies(inputs)
    }

    /// The pass of the CPU on copies of a device's values; the result goes back there.
    fn on_copies<S: BackendStorage>(&self, inputs: &[(&S, &Layout)]) -> Result<(S, Shape)>
    where
        S::Device: BackendDevice<Storage = S>,
    {
        fallbacks::count(O::NAME, Pass::Forward);
        let mut copies = Vec::with_capacity(inputs.len());
        for (storage, layout) in inputs {
            copies.push((storage.to_cpu_storage()?, *layout));
        }
        let copies: Vec<_> = copies.iter().map(|(storage, layout)| (storage, *layout)).collect();
        let (out, shape) = self.on_cpu(&copies)?;
        Ok((inputs[0].0.device().storage_from_cpu_storage_owned(out)?, shape))
    }
}

/// The forward passes of candle's traits: a storage and its layout for each input.
macro_rules! forward_passes {
    ($name:expr, $($storage:ident $layout:ident),*) => {
        fn name(&self) -> &'static str {
            $name
        }
        fn cpu_fwd(&self, $($storage: &CpuStorage, $layout: &Layout),*) -> Result<(CpuStorage, Shape)> {
            self.on_cpu(&[$(($storage, $layout)),*])
        }
        fn cuda_fwd(&self, $($storage: &CudaStorage, $layout: &Layout),*) -> Result<(CudaStorage, Shape)> {
            self.on_cuda(&[$(($storage, $layout)),*])
        }
    };
}
pub(crate) use forward_passes;

impl<O: Operation> CustomOp1 for Custom<O> {
    forward_passes!(O::NAME, s l);
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        Ok(self.0.gradients(&[x], grad)?.pop())
    }
}

impl<O: Operation> CustomOp2 for Custom<O> {
    forward_passes!(O::NAME, s1 l1, s2 l2);
    fn bwd(
        &self,
        a: &Tensor,
        b: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let mut found = self.0.gradients(&[a, b], grad)?.into_iter();
        Ok((found.next(), found.next()))
    }
}

impl<O: Operation> CustomOp3 for Custom<O> {
    forward_passes!(O::NAME, s1 l1, s2 l2, s3 l3);
    fn bwd(
        &self,
        a: &Tensor,
        b: &Tensor,
        c: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let mut found = self.0.gradients(&[a, b, c], grad)?.into_iter();
        Ok((found.next(), found.next(), found.next()))
    }
}
