//! A learning rate to begin with: the loss of a short run whose rate rises from step to step.

use crate::error::check_setting;
use crate::event::{Callback, Event, Flow, Progress};
use crate::optim::{Optimizer, Schedule};
use crate::{DataModule, TrainError, Trainer, TrainerConfig, TrainingModule};
use scenesplat_datasets::BatchLoader;
use scenesplat_kernels::settings;
use scenesplat_models::ParamStore;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

settings! {
    /// How a learning rate is looked for.
    #[derive(Copy)]
    pub struct LrFinderConfig {
        /// Rate of the first step.
        pub from: f64 = 1e-7,
        /// Rate of the last step.
        pub to: f64 = 1.0,
        /// Steps, at least 3; the rate grows by the same factor in each.
        pub steps: u64 = 100,
        /// Share of the smoothed loss that each step keeps, `0..1`.
        pub smoothing: f64 = 0.9,
        /// The run ends when the smoothed loss is so many times the smallest one, above 1.
        pub diverged: f64 = 4.0,
    }
}

impl LrFinderConfig {
    /// Checks the settings.
    ///
    /// # Errors
    /// Names the first that is out of its range.
    pub fn check(&self) -> Result<(), TrainError> {
        let Self { from, to, steps, smoothing, diverged } = *self;
        check_setting("from", from, from.is_finite() && from > 0.0, "above 0")?;
        check_setting("to", to, to.is_finite() && to > from, "above `from`")?;
        check_setting("steps", steps as f64, steps >= 3, "at least 3")?;
        check_setting("smoothing", smoothing, (0.0..1.0).contains(&smoothing), "in 0..1")?;
        check_setting("diverged", diverged, diverged.is_finite() && diverged > 1.0, "above 1")
    }

    /// Rate of a step, from 0: `from · (to / from)^(step / (steps − 1))`.
    pub fn rate(&self, step: u64) -> f64 {
        let part = step as f64 / (self.steps - 1) as f64;
        self.from * (self.to / self.from).powf(part)
    }
}

/// One step of the run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LrPoint {
    /// Learning rate of the step.
    pub lr: f64,
    /// Loss before the step's update.
    pub loss: f64,
    /// Mean of the losses so far, later ones more.
    pub smoothed: f64,
}

/// What became of the run.
#[derive(Debug, Clone, PartialEq)]
pub struct LrCurve {
    /// Its steps, with rising rates.
    pub points: Vec<LrPoint>,
    /// The rate at which the smoothed loss falls the most; none if it never falls.
    pub suggestion: Option<f64>,
    /// Whether the run ended early, because the loss grew or was no longer finite.
    pub diverged: bool,
}

impl LrCurve {
    /// Of the losses of a run.
    pub fn new(settings: &LrFinderConfig, losses: &[f64]) -> Self {
        let mut points: Vec<LrPoint> = Vec::with_capacity(losses.len());
        let (mut mean, mut best, mut diverged) = (0.0, f64::INFINITY, false);
        for (step, &loss) in (0..).zip(losses) {
            mean = settings.smoothing * mean + (1.0 - settings.smoothing) * loss;
            // The mean starts at 0, whose share falls from step to step.
            let smoothed = mean / (1.0 - settings.smoothing.powi(step as i32 + 1));
            points.push(LrPoint { lr: settings.rate(step), loss, smoothed });
            best = f64::min(best, smoothed);
            if !loss.is_finite() || smoothed > settings.diverged * best {
                diverged = true;
                break;
            }
        }
        let suggestion = steepest(&points, settings.smoothing);
        Self { points, suggestion, diverged }
    }
}

/// The rate around which the smoothed loss falls the most: between the points `reach` before and after it, equally far
/// apart on the logarithm of the rate, so that differences are slopes. The mean is over about `1 / (1 − smoothing)`
/// losses; half of that is the reach, and points before the mean has so many do not count. Neither do those after its
/// smallest value.
fn steepest(points: &[LrPoint], smoothing: f64) -> Option<f64> {
    let averaged = 1.0 / (1.0 - smoothing);
    let (first, reach) =
        (averaged.round() as usize - 1, (averaged / 2.0).round().max(1.0) as usize);
    let by_loss = |a: &&LrPoint, b: &&LrPoint| a.smoothed.total_cmp(&b.smoothed);
    let lowest = points.iter().filter(|p| p.smoothed.is_finite()).min_by(by_loss)?;
    let counted = points.get(first..).unwrap_or_default();
    let falling = counted.windows(2 * reach + 1).filter(|part| part[2 * reach].lr <= lowest.lr);
    let slope = |part: &[LrPoint]| part[2 * reach].smoothed - part[0].smoothed;
    let found = falling.min_by(|a, b| slope(a).total_cmp(&slope(b)))?;
    (slope(found) < 0.0).then_some(found[reach].lr)
}

/// Trains for some steps with a learning rate that rises from step to step, and gives the losses by rate. All stores of
/// the module have their values again afterwards; the optimizer's state is gone.
///
/// `base_rate`: the rate of the optimizer's first group, to which rates of other groups keep their ratio. Of `config`,
/// what concerns steps is used; there are no evaluations and no checkpoints.
///
/// # Errors
/// If a setting is out of its range, or as [`Trainer::fit`], but for a loss or gradient that is not finite, which ends
/// the curve.
pub fn find_lr<M: TrainingModule>(
    module: &M,
    train: impl BatchLoader<M::Batch>,
    optimizer: Box<dyn Optimizer>,
    base_rate: f64,
    config: &TrainerConfig,
    settings: &LrFinderConfig,
) -> Result<LrCurve, TrainError> {
    settings.check()?;
    let before = Snapshot::of(module)?;
    let mut config =
        TrainerConfig { max_steps: Some(settings.steps), log_every: 1, ..config.clone() };
    config.checkpoint.dir = None;
    config.checkpoint.best = None;
    let losses = Losses::default();
    let watch = Watch { losses: losses.clone(), settings: *settings };
    let ramp = Ramp { settings: *settings, base_rate };
    let mut trainer = Trainer::new(config, optimizer, Box::new(ramp))?.with_callback(watch);
    let done = trainer.fit(module, &mut DataModule::new(train), Progress::default());
    before.put_back()?;
    match done {
        Err(TrainError::Step { source, .. }) if is_not_finite(&source) => {
            losses.held().push(f64::NAN);
        }
        done => _ = done?,
    }
    let curve = LrCurve::new(settings, &losses.held());
    Ok(curve)
}

fn is_not_finite(error: &TrainError) -> bool {
    use TrainError::{GradientTooLarge, NonFiniteGradient, NonFiniteLoss};
    matches!(error, NonFiniteLoss { .. } | NonFiniteGradient { .. } | GradientTooLarge { .. })
}

/// The rate of each step, as a factor on the optimizer's.
struct Ramp {
    settings: LrFinderConfig,
    base_rate: f64,
}

impl Schedule for Ramp {
    fn factor(&self, step: u64, _: u64) -> f64 {
        self.settings.rate(step) / self.base_rate
    }
}

/// The losses so far.
#[derive(Debug, Clone, Default)]
struct Losses(Arc<Mutex<Vec<f64>>>);

impl Losses {
    fn held(&self) -> MutexGuard<'_, Vec<f64>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Notes losses, and ends a run that diverges.
struct Watch {
    losses: Losses,
    settings: LrFinderConfig,
}

impl Callback for Watch {
    fn on_event(&mut self, event: &Event<'_>, _: Progress) -> Result<Flow, TrainError> {
        let Event::Step { measurements } = event else { return Ok(Flow::Continue) };
        let mut losses = self.losses.held();
        losses.extend(measurements.iter().filter(|m| m.name == "train/loss").map(|m| m.value));
        let diverged = LrCurve::new(&self.settings, &losses).diverged;
        Ok(if diverged { Flow::Stop } else { Flow::Continue })
    }
}

/// The values of all stores of a module.
struct Snapshot<'a>(Vec<(&'a ParamStore, BTreeMap<String, candle_core::Tensor>)>);

impl<'a> Snapshot<'a> {
    fn of<M: TrainingModule>(module: &'a M) -> Result<Self, TrainError> {
        let further = module.stores().into_iter().map(|(_, store)| store);
        let copied = |store: &'a ParamStore| {
            let all = store.parameters().into_iter().chain(store.buffers());
            let copies = all.map(|(name, var)| Ok((name, var.as_tensor().copy()?)));
            Ok((store, copies.collect::<candle_core::Result<_>>()?))
        };
        let stores = std::iter::once(module.params()).chain(further).map(copied);
        let stores: candle_core::Result<_> = stores.collect();
        Ok(Self(stores.map_err(|source| TrainError::Forward { source })?))
    }

    fn put_back(self) -> Result<(), TrainError> {
        let mut all = self.0.into_iter();
        let done =
            all.try_for_each(|(store, values)| store.restore_from(values, "before the search"));
        done.map_err(|source| TrainError::Forward { source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(smoothing: f64) -> LrFinderConfig {
        LrFinderConfig { from: 1e-4, to: 1.0, steps: 5, smoothing, diverged: 4.0 }
    }

    #[test]
    fn rates_grow_by_one_factor() {
        for (step, rate) in [1e-4, 1e-3, 1e-2, 1e-1, 1.0].into_iter().enumerate() {
            let found = settings(0.0).rate(step as u64);
            assert!((found / rate - 1.0).abs() < 1e-12, "{step}: {found}");
        }
    }

    #[test]
    fn the_steepest_fall_before_the_loss_grows_is_suggested() {
        // Falls over two steps: 0.5, 3.5, 3; then it grows.
        let curve = LrCurve::new(&settings(0.0), &[5.0, 4.5, 1.5, 1.4, 6.0]);
        assert!(curve.diverged && curve.points.len() == 5);
        assert_eq!(curve.suggestion, Some(settings(0.0).rate(1)));
        // The last steps fall more, but from a height that came before.
        let curve = LrCurve::new(&settings(0.0), &[2.0, 1.5, 1.0, 3.9, 1.2]);
        assert_eq!((curve.diverged, curve.suggestion), (false, Some(settings(0.0).rate(1))));
        let rising = LrCurve::new(&settings(0.0), &[1.0, 2.0, 3.0]);
        assert_eq!((rising.suggestion, rising.diverged), (None, false));
        let ended = LrCurve::new(&settings(0.0), &[2.0, 1.0, f64::NAN, 0.0]);
        assert!(ended.diverged && ended.points.len() == 3 && ended.suggestion.is_none());
    }

    #[test]
    fn the_mean_is_of_the_losses_so_far() {
        let curve = LrCurve::new(&settings(0.5), &[4.0, 2.0, 1.0]);
        let smoothed: Vec<f64> = curve.points.iter().map(|point| point.smoothed).collect();
        // 4; (4/4 + 2/2) / (3/4); (4/8 + 2/4 + 1/2) / (7/8).
        assert_eq!(smoothed, [4.0, 2.0 / 0.75, 1.5 / 0.875]);
        // The mean is of two: the first point does not count, and the fall is from the second to the fourth.
        let curve = LrCurve::new(&settings(0.5), &[9.0, 4.0, 2.0, 1.0, 1.0]);
        assert_eq!(curve.suggestion, Some(settings(0.5).rate(2)));
        assert!(settings(1.0).check().is_err() && settings(0.5).check().is_ok());
    }
}
