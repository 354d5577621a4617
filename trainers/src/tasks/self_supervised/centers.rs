//! Running means of the teacher's logits, which change after a step and are kept in checkpoints.

use super::config::{Balance, Prototypes};
use super::step::Step;
use crate::TrainError;
use candle_core::{Result, Tensor};
use scenesplat_losses::self_supervised::{Centering, sinkhorn_knopp};
use scenesplat_models::ParamStore;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// A center for each name, of terms that are balanced by centering.
pub(super) struct Centers {
    store: ParamStore,
    momentum: BTreeMap<String, f64>,
    /// Sums and counts of the logits of the step under way; a step may have several batches.
    seen: Mutex<BTreeMap<String, (Vec<f64>, usize)>>,
}

impl Centers {
    pub fn new() -> Self {
        Self { store: ParamStore::trainable(0), momentum: BTreeMap::new(), seen: Mutex::default() }
    }

    /// Adds a center of zeros, if the balance has one.
    pub fn add(&mut self, name: &str, prototypes: usize, balance: Balance) -> Result<()> {
        if let Balance::Centering(momentum) = balance {
            self.store.builder().get(prototypes, name)?;
            self.momentum.insert(name.to_owned(), momentum);
        }
        Ok(())
    }

    /// The store of the centers, if there are any.
    pub fn store(&self) -> Option<&ParamStore> {
        (!self.momentum.is_empty()).then_some(&self.store)
    }

    /// The teacher's distributions, and how evenly they use prototypes: 1 for all alike, 0 for a single
    /// one. `[N, K]`
    pub fn targets(
        &self,
        name: &str,
        logits: &Tensor,
        prototypes: &Prototypes,
        step: &Step<'_>,
    ) -> Result<(Tensor, f64)> {
        let temperature = prototypes.teacher_temperature.value(step.step, step.total);
        let targets = match prototypes.balance {
            Balance::SinkhornKnopp(iterations) => sinkhorn_knopp(logits, temperature, iterations)?,
            Balance::Centering(_) => {
                let center = match self.store.parameters().get(name) {
                    Some(center) => center.to_vec1::<f32>()?,
                    None => candle_core::bail!("{name}: there is no such center"),
                };
                let center: Vec<f64> = center.into_iter().map(f64::from).collect();
                self.look(name, logits)?;
                Centering { center, momentum: 0.0 }.targets(logits, temperature)?
            }
        };
        let evenness = evenness(&targets)?;
        Ok((targets, evenness))
    }

    /// Notes logits for the update after the step.
    fn look(&self, name: &str, logits: &Tensor) -> Result<()> {
        let rows = logits.to_vec2::<f32>()?;
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let (sum, count) =
            seen.entry(name.to_owned()).or_insert_with(|| (vec![0.0; logits.dims()[1]], 0));
        for row in rows {
            sum.iter_mut().zip(row).for_each(|(sum, v)| *sum += f64::from(v));
            *count += 1;
        }
        Ok(())
    }

    /// Moves the centers to the means of the step that is done.
    pub fn update(&self) -> std::result::Result<(), TrainError> {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let centers = self.store.parameters();
        for (name, (sum, count)) in std::mem::take(&mut *seen) {
            let (Some(center), Some(m)) = (centers.get(&name), self.momentum.get(&name)) else {
                continue;
            };
            if count == 0 {
                continue;
            }
            let moved = |center: &Tensor| -> Result<Tensor> {
                let old = center.to_vec1::<f32>()?;
                let new = old.iter().zip(&sum).map(|(old, sum)| {
                    (m * f64::from(*old) + (1.0 - m) * sum / count as f64) as f32
                });
                Tensor::from_vec(new.collect::<Vec<f32>>(), sum.len(), center.device())
            };
            moved(center.as_tensor())
                .and_then(|value| center.set(&value))
                .map_err(TrainError::tensor(&name))?;
        }
        Ok(())
    }
}

/// Entropy of the mean distribution over that of an even one; 1 for no rows.
fn evenness(targets: &Tensor) -> Result<f64> {
    let (rows, width) = targets.dims2()?;
    if rows == 0 || width < 2 {
        return Ok(1.0);
    }
    let mean: Vec<f32> = targets.mean(0)?.to_vec1()?;
    let entropy: f64 =
        mean.iter().map(|&p| if p > 0.0 { -f64::from(p) * f64::from(p).ln() } else { 0.0 }).sum();
    Ok(entropy / (width as f64).ln())
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn centers_move_after_the_step_by_its_mean() {
        let mut centers = Centers::new();
        let balance = Balance::Centering(0.75);
        centers.add("a", 2, balance).unwrap();
        let prototypes = Prototypes { balance, ..Default::default() };
        let (views, masks, seen) = (&[], &[], &[]);
        let step = Step { views, masks, student: seen, teacher: seen, step: 0, total: 1 };
        let logits = |values: &[f32]| {
            Tensor::from_vec(values.to_vec(), (values.len() / 2, 2), &Device::Cpu).unwrap()
        };
        let value = || centers.store().unwrap().parameters()["a"].to_vec1::<f32>().unwrap();
        let (first, _) = centers.targets("a", &logits(&[4.0, 0.0]), &prototypes, &step).unwrap();
        // Two batches of a step: the second still sees the old center.
        let (second, _) = centers.targets("a", &logits(&[4.0, 0.0]), &prototypes, &step).unwrap();
        assert_eq!(first.to_vec2::<f32>().unwrap(), second.to_vec2::<f32>().unwrap());
        centers.targets("a", &logits(&[1.0, 3.0]), &prototypes, &step).unwrap();
        assert_eq!(value(), [0.0, 0.0]);
        centers.update().unwrap();
        assert_eq!(value(), [0.75, 0.25]);
        // Nothing seen, nothing moved.
        centers.update().unwrap();
        assert_eq!(value(), [0.75, 0.25]);
        assert!(Centers::new().store().is_none());
    }

    #[test]
    fn evenness_of_one_and_of_all() {
        let table =
            |values: &[f32]| Tensor::new(values, &Device::Cpu).unwrap().reshape((2, 2)).unwrap();
        assert!((evenness(&table(&[1.0, 0.0, 0.0, 1.0])).unwrap() - 1.0).abs() < 1e-6);
        assert!(evenness(&table(&[1.0, 0.0, 1.0, 0.0])).unwrap().abs() < 1e-6);
    }

    #[test]
    fn the_teacher_is_as_sharp_as_the_schedule_says_at_its_step() {
        let mut centers = Centers::new();
        let balance = Balance::Centering(0.9);
        centers.add("a", 2, balance).unwrap();
        let teacher_temperature = crate::CosineSchedule::new(1.0, 0.25);
        let prototypes = Prototypes { balance, teacher_temperature, ..Default::default() };
        let logits = Tensor::new(&[[1.0f32, 0.0]], &Device::Cpu).unwrap();
        // 1 ÷ (1 + e^(−1 / T)), with T of the first and of the last step.
        for (at, temperature) in [(0, 1.0f64), (10, 0.25)] {
            let step =
                Step { views: &[], masks: &[], student: &[], teacher: &[], step: at, total: 10 };
            let (targets, _) = centers.targets("a", &logits, &prototypes, &step).unwrap();
            let found = f64::from(targets.to_vec2::<f32>().unwrap()[0][0]);
            let want = 1.0 / (1.0 + (-1.0 / temperature).exp());
            assert!((found - want).abs() < 1e-5, "{at}: {found} {want}");
        }
    }
}
