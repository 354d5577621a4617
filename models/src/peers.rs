//! Processes that train together, as batch norms see them: their statistics are those of the rows of all.

use crate::ops::Pass;
use crate::scoped::with_value;
use candle_core::{Result, bail};
use std::cell::{Cell, RefCell};
use std::rc::Rc;

/// Processes that are in the same step of one training, each with rows of its own.
pub trait Peers {
    /// Gives every process what each of them has said, this one too, in the same order on all. Nothing of those that
    /// are through with the step, such as one without a batch.
    ///
    /// # Errors
    /// If another process is gone.
    fn gather(&self, mine: &[f64]) -> Result<Vec<Option<Vec<f64>>>>;
}

/// The peers of a thread in a step.
pub(crate) struct Together {
    peers: Rc<dyn Peers>,
    /// How many batch norms they have gone through.
    norms: Cell<u64>,
    /// Who has said something in a forward pass.
    spoke: RefCell<Vec<bool>>,
}

thread_local! {
    static TOGETHER: RefCell<Option<Rc<Together>>> = const { RefCell::new(None) };
}

/// Runs `work`, forward and backward passes of this thread: batch norms that train take the statistics of the rows of
/// all peers, and send their gradients through them. All peers with rows run the same layers in the same order; one that
/// does not is told.
pub fn with_peers<R>(peers: Rc<dyn Peers>, work: impl FnOnce() -> R) -> R {
    let together = Together { peers, norms: Cell::new(0), spoke: RefCell::default() };
    with_value(&TOGETHER, Rc::new(together), work).0
}

impl Together {
    /// The peers of this thread, if it has any.
    pub(crate) fn here() -> Option<Rc<Self>> {
        TOGETHER.with_borrow(Clone::clone)
    }

    /// The place of the batch norm that the forward pass has come to, from 1.
    pub(crate) fn next_norm(&self) -> u64 {
        self.norms.set(self.norms.get() + 1);
        self.norms.get()
    }

    /// What all peers with rows say of one batch norm, in one order.
    ///
    /// # Errors
    /// If a peer is gone, or goes through other layers than this one.
    pub(crate) fn gather(&self, pass: Pass, norm: u64, mine: Vec<f64>) -> Result<Vec<Vec<f64>>> {
        let head = [f64::from(u8::from(pass == Pass::Backward)), norm as f64, mine.len() as f64];
        let all = self.peers.gather(&[&head[..], &mine].concat())?;
        let mut spoke = self.spoke.borrow_mut();
        spoke.resize(all.len(), false);
        let mut bodies = Vec::with_capacity(all.len());
        for (peer, said) in all.into_iter().enumerate() {
            match said {
                Some(mut said) if said.starts_with(&head) => {
                    spoke[peer] = true;
                    bodies.push(said.split_off(head.len()));
                }
                // Without a loss there is no backward pass; within a forward pass nobody may stop.
                None if pass == Pass::Backward || !spoke[peer] => {}
                _ => bail!(
                    "batch_norm: rank {peer} is elsewhere than layer {norm}, {pass:?}: with the statistics of all, all \
                     have to go through the same layers"
                ),
            }
        }
        Ok(bodies)
    }
}
