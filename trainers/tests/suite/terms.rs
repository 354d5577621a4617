//! What is logged of a loss's terms, which need not be on in every batch.

use crate::support::{Line, Rows, config, fit, logged, numbers, trainer};
use candle_core::Result;
use scenesplat_models::ParamStore;
use scenesplat_trainers::callbacks::JsonLines;
use scenesplat_trainers::{StepContext, StepOutput, TrainerConfig, TrainingModule};
use std::sync::atomic::{AtomicU32, Ordering};

/// A [`Line`] with a term that is on in every third batch, from the first.
struct Sometimes {
    line: Line,
    batches: AtomicU32,
}

impl TrainingModule for Sometimes {
    type Batch = Rows;
    fn params(&self) -> &ParamStore {
        &self.line.params
    }
    fn training_step(&self, batch: &Rows, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        let mut out = self.line.training_step(batch, cx)?;
        let number = self.batches.fetch_add(1, Ordering::Relaxed);
        out.terms = vec![("always".to_owned(), f64::from(number))];
        if number.is_multiple_of(3) {
            out.terms.push(("third".to_owned(), f64::from(100 + number)));
        }
        Ok(out)
    }
}

#[test]
fn a_term_is_the_mean_of_the_batches_where_it_was_on() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("metrics.jsonl");
    let module = Sometimes { line: Line::new(), batches: AtomicU32::new(0) };
    let settings = TrainerConfig { accumulate: 2, epochs: 2, ..config(None) };
    let trainer = trainer(&module, settings).with_callback(JsonLines::new(&log));
    fit(trainer, &module, numbers()).unwrap();
    // Batches 0 and 1 are the first step, and so on.
    let always: Vec<_> = (1..=6).map(|step| (step, 2.0 * step as f64 - 1.5)).collect();
    assert_eq!(logged(&log, "train/always"), always);
    assert_eq!(logged(&log, "train/third"), [(1, 100.0), (2, 103.0), (4, 106.0), (5, 109.0)]);
}
