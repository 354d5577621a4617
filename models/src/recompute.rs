//! Gradient checkpointing: the inside of a block is computed again when its gradient is wanted.
//!
//! Between forward and backward pass a block then holds its input alone, not the dozen tensors of
//! its inside. The second run sees the same input and the same random numbers, so the gradients
//! are those of the plain run; what it costs is one more forward pass of the blocks.
//!
//! candle gives a custom operation the gradients of its *inputs* to answer for. Those of the
//! parameters inside the block come out beside: [`Recompute`] collects them until the trainer asks.

use crate::ops::forward_passes;
use candle_core::backend::BackendStorage;
use candle_core::backprop::GradStore;
use candle_core::{
    CpuStorage, CudaStorage, CustomOp1, CustomOp2, Layout, Result, Shape, Storage, Tensor, Var,
    bail,
};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Switches recomputation on (as a field of [`Forward`](crate::Forward)) and collects the gradients
/// of the parameters that were used inside.
///
/// ```no_run
/// # fn step(loss: impl FnOnce(scenesplat_models::Recompute) -> candle_core::Result<candle_core::Tensor>,
/// #     store: &scenesplat_models::ParamStore) -> candle_core::Result<()> {
/// let recompute = scenesplat_models::Recompute::new(store.parameters());
/// let loss = loss(recompute.clone())?; // a forward pass with `recompute: Some(…)`
/// let mut grads = loss.backward()?;
/// recompute.drain_into(&mut grads)?; // without this the blocks' parameters have no gradient
/// # Ok(()) }
/// ```
#[derive(Debug, Clone)]
pub struct Recompute {
    parameters: Arc<BTreeMap<String, Var>>,
    found: Arc<Mutex<Vec<(Var, Tensor)>>>,
}

impl Recompute {
    /// For a network with these trainable parameters.
    pub fn new(parameters: BTreeMap<String, Var>) -> Self {
        Self { parameters: Arc::new(parameters), found: Arc::default() }
    }

    /// Adds the collected gradients to `grads` and forgets them.
    ///
    /// # Errors
    /// If candle cannot add two gradients.
    pub fn drain_into(&self, grads: &mut GradStore) -> Result<()> {
        let found = std::mem::take(&mut *self.found.lock().unwrap_or_else(PoisonError::into_inner));
        for (var, new) in found {
            let sum = match grads.remove(&var) {
                Some(old) => (old + new)?.detach(),
                None => new,
            };
            grads.insert(&var, sum);
        }
        Ok(())
    }

    /// `run(inputs)`, whose inside is not kept for the backward pass.
    ///
    /// `run` must give the same result each time it is called with the same inputs. It takes one or
    /// two f32 inputs.
    pub(crate) fn apply(
        &self,
        inputs: &[&Tensor],
        run: impl Fn(&[Tensor]) -> Result<Tensor> + Send + Sync + 'static,
    ) -> Result<Tensor> {
        let detached: Vec<Tensor> = inputs.iter().map(|t| t.detach()).collect();
        // Parameters are tracked even so; detaching the result lets go of what it was made from.
        let output = run(&detached)?.detach();
        let op = Recomputed {
            run: Box::new(run),
            output: Mutex::new(Some(output)),
            recompute: self.clone(),
        };
        match inputs {
            [x] => x.contiguous()?.apply_op1(op),
            [x, y] => x.contiguous()?.apply_op2(&y.contiguous()?, op),
            _ => bail!("recompute: expected one or two inputs, got {}", inputs.len()),
        }
    }
}

type Run = Box<dyn Fn(&[Tensor]) -> Result<Tensor> + Send + Sync>;

struct Recomputed {
    run: Run,
    /// Waits for the operation's own forward pass, which hands it out.
    output: Mutex<Option<Tensor>>,
    recompute: Recompute,
}

impl Recomputed {
    fn take_output(&self) -> Result<Tensor> {
        let output = self.output.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(output) = output else { bail!("recompute: the forward pass ran twice") };
        output.contiguous()
    }

    fn on_cpu(&self, _: &[(&CpuStorage, &Layout)]) -> Result<(CpuStorage, Shape)> {
        let output = self.take_output()?;
        let values = crate::ops::read("recompute", &output, |values| Ok(values.to_vec()))?;
        Ok((CpuStorage::F32(values), output.shape().clone()))
    }

    fn on_cuda(&self, _: &[(&CudaStorage, &Layout)]) -> Result<(CudaStorage, Shape)> {
        let output = self.take_output()?.force_contiguous()?;
        let (storage, layout) = output.storage_and_layout();
        let Storage::Cuda(storage) = &*storage else {
            bail!("recompute: the output is not on CUDA")
        };
        Ok((storage.try_clone(layout)?, output.shape().clone()))
    }

    /// Gradients of the inputs; those of parameters are put aside.
    fn gradients(&self, inputs: &[&Tensor], grad: &Tensor) -> Result<Vec<Option<Tensor>>> {
        let vars: Vec<Var> =
            inputs.iter().map(|t| Var::from_tensor(&t.detach())).collect::<Result<_>>()?;
        let tensors: Vec<Tensor> = vars.iter().map(|v| v.as_tensor().clone()).collect();
        let output = (self.run)(&tensors)?;
        let mut grads = (output * grad.detach())?.sum_all()?.backward()?;
        let mut found = Vec::new();
        for var in self.recompute.parameters.values() {
            if let Some(grad) = grads.remove(var) {
                found.push((var.clone(), grad.detach()));
            }
        }
        self.recompute.found.lock().unwrap_or_else(PoisonError::into_inner).extend(found);
        Ok(vars.iter().map(|v| grads.remove(v).map(|g| g.detach())).collect())
    }
}

impl CustomOp1 for Recomputed {
    forward_passes!("recompute", s l);
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        Ok(self.gradients(&[x], grad)?.pop().flatten())
    }
}

impl CustomOp2 for Recomputed {
    forward_passes!("recompute", s1 l1, s2 l2);
    fn bwd(
        &self,
        x: &Tensor,
        y: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let mut found = self.gradients(&[x, y], grad)?;
        let second = found.pop().flatten();
        Ok((found.pop().flatten(), second))
    }
}
