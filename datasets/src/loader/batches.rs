//! The iterator over an epoch, and the threads behind it.

use super::assembly::{Assembled, Assembly};
use super::{Skipped, SkippedScene};
use crate::error::bad_setting;
use crate::{DataError, TrainBatch};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// Batches of one epoch, in order; ends with the first error.
///
/// Dropped before its end, its workers stop after the scene they are at.
pub struct SceneBatches {
    assembly: Arc<Assembly>,
    skipped: Skipped,
    epoch: u64,
    /// Places in the epoch, and scenes.
    plan: Arc<Vec<(usize, Vec<usize>)>>,
    /// The next batch of these to hand over.
    next: usize,
    workers: Option<Workers>,
    prefetch: usize,
    num_workers: usize,
}

impl SceneBatches {
    pub(super) fn start(
        assembly: &Arc<Assembly>,
        skipped: &Skipped,
        epoch: u64,
        plan: Vec<(usize, Vec<usize>)>,
    ) -> Self {
        Self {
            assembly: Arc::clone(assembly),
            skipped: Arc::clone(skipped),
            epoch,
            plan: Arc::new(plan),
            next: 0,
            workers: None,
            prefetch: assembly.settings.prefetch,
            num_workers: assembly.settings.workers.min(assembly.settings.prefetch),
        }
    }

    fn make(&mut self, number: usize) -> Result<Assembled, DataError> {
        if self.num_workers == 0 {
            let (place, scenes) = &self.plan[number];
            let made = self.assembly.assemble(self.epoch, *place, scenes, || false);
            return made.unwrap_or_else(|| Err(ended()));
        }
        // Threads start with the first batch, so an iterator that nobody asks costs nothing.
        let workers = match &mut self.workers {
            Some(workers) => workers,
            none => {
                let count = self.num_workers.min(self.plan.len() - number);
                let workers = Workers::start(count, &self.assembly, self.epoch, &self.plan)?;
                let workers = none.insert(workers);
                for ahead in number..self.plan.len().min(number + self.prefetch) {
                    workers.order(ahead);
                }
                workers
            }
        };
        let made = workers.wait_for(number);
        // One more for the one that leaves: what waits never grows beyond `prefetch`.
        if number + self.prefetch < self.plan.len() {
            workers.order(number + self.prefetch);
        }
        made
    }
}

impl Iterator for SceneBatches {
    type Item = Result<TrainBatch, DataError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.next >= self.plan.len() {
            // Nothing is left to make; do not keep idle threads.
            self.workers = None;
            return None;
        }
        let made = self.make(self.next);
        match made {
            Ok(Assembled { batch, skipped }) => {
                self.next += 1;
                let mut all = self.skipped.lock().unwrap_or_else(PoisonError::into_inner);
                for (id, reason) in skipped {
                    all.entry(id).or_insert(SkippedScene { times: 0, reason }).times += 1;
                }
                Some(Ok(batch))
            }
            Err(error) => {
                self.next = self.plan.len();
                self.workers = None;
                Some(Err(error))
            }
        }
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        // At most: an error ends it.
        (usize::from(self.next < self.plan.len()), Some(self.plan.len() - self.next))
    }
}

/// The error for workers that are gone, which they never are while they have work.
fn ended() -> DataError {
    DataError::Panicked {
        id: "of no name".to_owned(),
        message: "a worker ended without a result".to_owned(),
    }
}

type Made = (usize, Result<Assembled, DataError>);

/// Threads that make the batches they are told to make.
struct Workers {
    orders: Option<Sender<usize>>,
    made: Receiver<Made>,
    /// Made before their turn.
    early: BTreeMap<usize, Result<Assembled, DataError>>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Workers {
    fn start(
        count: usize,
        assembly: &Arc<Assembly>,
        epoch: u64,
        plan: &Arc<Vec<(usize, Vec<usize>)>>,
    ) -> Result<Self, DataError> {
        let (orders, inbox) = channel();
        let (outbox, made) = channel();
        let inbox = Arc::new(Mutex::new(inbox));
        let stop = Arc::new(AtomicBool::new(false));
        let mut workers =
            Self { orders: Some(orders), made, early: BTreeMap::new(), stop, threads: Vec::new() };
        for number in 0..count {
            let (inbox, outbox) = (Arc::clone(&inbox), outbox.clone());
            let (assembly, plan) = (Arc::clone(assembly), Arc::clone(plan));
            let stop = Arc::clone(&workers.stop);
            let thread = std::thread::Builder::new()
                .name(format!("loader-{number}"))
                .spawn(move || work(&assembly, epoch, &plan, &inbox, &outbox, &stop));
            let thread = thread.map_err(|error| {
                let value = format!("{count} ({error})");
                bad_setting("workers", value, "as many as the system can start")
            })?;
            workers.threads.push(thread);
        }
        Ok(workers)
    }

    fn order(&self, number: usize) {
        if let Some(orders) = &self.orders {
            // Fails only if all workers are gone; then waiting for the batch says so.
            let _ = orders.send(number);
        }
    }

    fn wait_for(&mut self, number: usize) -> Result<Assembled, DataError> {
        loop {
            if let Some(made) = self.early.remove(&number) {
                return made;
            }
            let (which, made) = self.made.recv().map_err(|_| ended())?;
            self.early.insert(which, made);
        }
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        self.orders = None;
        for thread in self.threads.drain(..) {
            // A worker catches the panics of what it runs.
            let _ = thread.join();
        }
    }
}

fn work(
    assembly: &Assembly,
    epoch: u64,
    plan: &[(usize, Vec<usize>)],
    inbox: &Mutex<Receiver<usize>>,
    outbox: &Sender<Made>,
    stop: &AtomicBool,
) {
    let stopped = || stop.load(Ordering::SeqCst);
    let next = || inbox.lock().unwrap_or_else(PoisonError::into_inner).recv().ok();
    let run = || {
        while let Some(number) = next().filter(|_| !stopped()) {
            let (place, scenes) = &plan[number];
            let Some(made) = assembly.assemble(epoch, *place, scenes, stopped) else {
                return;
            };
            if outbox.send((number, made)).is_err() {
                return;
            }
        }
    };
    // Kernels split their work among the threads of a pool. A pool of this thread alone keeps the
    // cores free for the network, whose batch comes first. Without one, all share the global pool.
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build();
    match alone {
        Ok(pool) => pool.install(run),
        Err(_) => run(),
    }
}
