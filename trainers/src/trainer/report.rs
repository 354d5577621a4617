//! Telling callbacks, and asking evaluators.

use super::share::Bits;
use super::step::StepReport;
use super::{Run, Trainer};
use crate::TrainError;
use crate::collective::CollectiveError;
use crate::event::{Evaluator, Event, Flow, Progress};
use crate::module::TrainingModule;
use scenesplat_datasets::LeftOut;
use scenesplat_metrics::Measurement;
use std::collections::BTreeSet;

impl Trainer {
    /// Checks that every measurement that decides something is given by an evaluator.
    pub(super) fn check_names<M: ?Sized>(
        &self,
        evaluators: &[Box<dyn Evaluator<M> + '_>],
    ) -> Result<(), TrainError> {
        let (mut evaluations, mut known) = (BTreeSet::new(), Vec::new());
        for evaluator in evaluators {
            let name = evaluator.name();
            if !evaluations.insert(name) {
                let (what, name) = ("evaluations", name.to_owned());
                return Err(TrainError::DuplicateName { what, name });
            }
            known.extend(evaluator.measurements().iter().map(|m| format!("{name}/{m}")));
        }
        let best = self.config.checkpoint.best.iter().map(|best| ("checkpoint.best", best));
        let waiting = self.callbacks.iter().filter_map(|callback| callback.waits_for());
        best.chain(waiting).try_for_each(|(setting, chosen)| chosen.check(setting, &known))
    }

    pub(super) fn report<M: TrainingModule>(
        &mut self,
        module: &M,
        report: &StepReport,
        at: Progress,
        seconds: f64,
    ) -> Result<Flow, TrainError> {
        let mut flow = Flow::Continue;
        let mut measurements = Vec::new();
        let last = at.step == at.total_steps;
        if at.step.is_multiple_of(self.config.log_every) || last {
            let entry = |name: &str, value| Measurement::new(format!("train/{name}"), value);
            measurements.push(entry("loss", report.loss));
            measurements.extend(report.terms.iter().map(|(name, term)| entry(name, term.value())));
            measurements.push(entry("lr_factor", report.lr_factor));
            measurements.push(entry("grad_norm", report.grad_norm));
            measurements.push(entry("counted_rows", report.tally.counted_rows as f64));
            measurements.push(entry("seconds_per_step", seconds));
            if !self.is_alone() {
                let seconds = std::mem::take(&mut self.together_seconds);
                measurements.push(entry("together_seconds", seconds));
                let bytes = std::mem::take(&mut self.together_bytes);
                measurements.push(entry("together_bytes", bytes as f64));
            }
        }
        let mut alarms = Vec::new();
        if self.looks_at_features(at.step, at.total_steps) {
            let health = crate::health::look(
                &self.config.health,
                report.features.as_ref(),
                module.params(),
                self.config.seed ^ at.step,
            )?;
            measurements.extend(health.measurements);
            alarms = health.alarms;
            self.collapsed_looks = if health.collapsed { self.collapsed_looks + 1 } else { 0 };
        }
        if !measurements.is_empty() {
            flow = self.emit(&Event::Step { measurements: &measurements }, at)?;
        }
        for message in &alarms {
            flow = flow.and(self.emit(&Event::Alarm { message }, at)?);
        }
        let patience = self.config.health.stop_after;
        if patience > 0 && self.collapsed_looks >= patience {
            let looks = self.collapsed_looks;
            return Err(TrainError::Collapsed { step: at.step, looks, alarms: alarms.join("; ") });
        }
        Ok(flow)
    }

    /// Whether it is time, after so many steps.
    pub(super) fn looks_at_features(&self, step: u64, total_steps: u64) -> bool {
        let every = self.config.health.every_steps;
        every > 0 && (step.is_multiple_of(every) || step == total_steps)
    }

    /// What an evaluator found: by rank 0, who tells the others.
    fn found<M: TrainingModule>(
        &self,
        run: &Run<'_, M>,
        evaluator: &mut dyn Evaluator<M>,
        at: Progress,
    ) -> Result<Vec<Measurement>, TrainError> {
        let mut bytes = Vec::new();
        if self.collective.rank() == 0 {
            let found = match &self.average {
                Some(average) => average.during(&run.params, || evaluator.run(run.module, at))?,
                None => evaluator.run(run.module, at)?,
            };
            if self.is_alone() {
                return Ok(found);
            }
            let told: Vec<_> = found.iter().map(|m| (&m.name, Bits(m.value))).collect();
            bytes = serde_json::to_vec(&told).unwrap_or_default();
        }
        let bytes = self.collective.broadcast(0, &bytes)?;
        let told: Vec<(String, Bits)> = serde_json::from_slice(&bytes).map_err(|error| {
            let problem = format!("tells no measurements: {error}");
            CollectiveError::Disagreement { rank: 0, problem }
        })?;
        Ok(told.into_iter().map(|(name, Bits(value))| Measurement::new(name, value)).collect())
    }

    /// Runs the evaluators if it is their time: their measurements (`None` if it is not), and whether
    /// someone asks to stop.
    pub(super) fn evaluate<M: TrainingModule>(
        &mut self,
        run: &Run<'_, M>,
        evaluators: &mut [Box<dyn Evaluator<M> + '_>],
        at: Progress,
    ) -> Result<(Option<Vec<Measurement>>, Flow), TrainError> {
        let every = self.config.eval_every;
        let due = every > 0 && (at.epoch + 1).is_multiple_of(every);
        if evaluators.is_empty() || !due && at.step != at.total_steps {
            return Ok((None, Flow::Continue));
        }
        let (mut all, mut flow) = (Vec::new(), Flow::Continue);
        for evaluator in evaluators {
            let mut found = self.found(run, &mut **evaluator, at)?;
            let listed = evaluator.measurements();
            for measurement in &mut found {
                if !listed.contains(&measurement.name) {
                    let (evaluator, name) = (evaluator.name().to_owned(), measurement.name.clone());
                    return Err(TrainError::UnlistedMeasurement { evaluator, name });
                }
                measurement.name = format!("{}/{}", evaluator.name(), measurement.name);
            }
            let event = Event::Eval { name: evaluator.name(), measurements: &found };
            flow = flow.and(self.emit(&event, at)?);
            self.check_data(evaluator.name(), evaluator.left_out(), at, &mut flow)?;
            all.extend(found);
        }
        flow = flow.and(self.emit(&Event::Evaluated { measurements: &all }, at)?);
        Ok((Some(all), flow))
    }

    /// Says what of the data was left out, if it is more than before, and stops if it is too much.
    pub(super) fn check_data(
        &mut self,
        name: &str,
        left_out: LeftOut,
        at: Progress,
        flow: &mut Flow,
    ) -> Result<(), TrainError> {
        if self.said.get(name) == Some(&left_out) || left_out == LeftOut::default() {
            return Ok(());
        }
        *flow = flow.and(self.emit(&Event::Data { name, left_out: &left_out }, at)?);
        let limit = self.config.max_left_out;
        for (what, count, of) in [
            ("scenes", left_out.skipped.len(), left_out.scenes),
            ("rows", left_out.dropped_rows(), left_out.rows),
        ] {
            if count as f64 > limit * of as f64 {
                let (name, reasons) = (name.to_owned(), left_out.lines());
                return Err(TrainError::TooMuchLeftOut {
                    name,
                    what,
                    left_out: count,
                    of,
                    limit,
                    reasons,
                });
            }
        }
        self.said.insert(name.to_owned(), left_out);
        Ok(())
    }

    /// The deciding value, if it is the best so far.
    pub(super) fn better(
        &mut self,
        found: Option<&[Measurement]>,
        at: Progress,
        flow: &mut Flow,
    ) -> Result<Option<f64>, TrainError> {
        let (Some(best), Some(found)) = (&self.config.checkpoint.best, found) else {
            return Ok(None);
        };
        let Some(value) = best.value(found).filter(|value| value.is_finite()) else {
            let message = format!("{best} is undefined: this state cannot be the best one");
            *flow = flow.and(self.emit(&Event::Alarm { message: &message }, at)?);
            return Ok(None);
        };
        let smaller = self.config.checkpoint.smaller_is_better;
        let better = self.best.is_none_or(|b| if smaller { value < b } else { value > b });
        Ok(better.then(|| *self.best.insert(value)))
    }

    pub(super) fn emit(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        let mut flow = Flow::Continue;
        for callback in &mut self.callbacks {
            flow = flow.and(callback.on_event(event, at)?);
        }
        Ok(flow)
    }
}
