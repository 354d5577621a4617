//! Metrics of someone else's, fed by our evaluators.

use scenesplat_metrics::{Measurement, Metric, MetricError};

/// A metric of predicted and true labels, whatever its type.
pub(super) trait LabelMetric: Send {
    /// As it was given: without any row.
    fn fresh(&self) -> Box<dyn LabelMetric>;
    fn update(&mut self, predicted: &[i32], truth: &[i32]) -> Result<(), MetricError>;
    fn names(&self) -> Vec<String>;
    fn measure(&self) -> Vec<Measurement>;
}

impl<M> LabelMetric for M
where
    M: for<'a> Metric<Update<'a> = (&'a [i32], &'a [i32])> + Clone + 'static,
{
    fn fresh(&self) -> Box<dyn LabelMetric> {
        Box::new(self.clone())
    }

    fn update(&mut self, predicted: &[i32], truth: &[i32]) -> Result<(), MetricError> {
        Metric::update(self, (predicted, truth))
    }

    fn names(&self) -> Vec<String> {
        Metric::names(self)
    }

    fn measure(&self) -> Vec<Measurement> {
        Metric::measure(self)
    }
}

/// Those of one evaluator.
#[derive(Default)]
pub(super) struct OwnMetrics(Vec<Box<dyn LabelMetric>>);

impl OwnMetrics {
    pub(super) fn add(&mut self, metric: impl LabelMetric + 'static) {
        self.0.push(Box::new(metric));
    }

    /// For one evaluation: each without any row.
    pub(super) fn fresh(&self) -> Self {
        Self(self.0.iter().map(|metric| metric.fresh()).collect())
    }

    pub(super) fn update(&mut self, predicted: &[i32], truth: &[i32]) -> Result<(), MetricError> {
        self.0.iter_mut().try_for_each(|metric| metric.update(predicted, truth))
    }

    pub(super) fn names(&self) -> Vec<String> {
        self.0.iter().flat_map(|metric| metric.names()).collect()
    }

    pub(super) fn measure(&self) -> Vec<Measurement> {
        self.0.iter().flat_map(|metric| metric.measure()).collect()
    }
}
