use crate::error::{check_labels, check_num_classes, check_rows};
use crate::{EvaluatorReport, IGNORE, Measurement, Metric, MetricError, TesterReport};

/// Counts of (true class, predicted class), fed scene by scene.
///
/// - Rows whose **truth** is -1 are not counted at all.
/// - Rows whose **prediction** is -1 are counted per true class as
///   [`unassigned`](Self::unassigned): the point was there and got no class.
///
/// Two sets of numbers come out, [`tester_report`](Self::tester_report) and
/// [`evaluator_report`](Self::evaluator_report). As a [`Metric`] it yields the first, as `mIoU`,
/// `mAcc`, `allAcc`, `f-mIoU`, `f-mAcc`; numbers that are undefined so far are left out.
///
/// # Source
/// The counting in `ZeroShotSemSegTester` and `LangPretrainZeroShotSemSegEval`, SceneSplat be9d5e1.
/// Differs: a label that is no class is an error; excluding classes works for several data sets,
/// too (there the multi-dataset evaluator compares an id with a list and excludes nothing).
///
/// ```
/// use scenesplat_metrics::{ConfusionMatrix, Metric};
///
/// let mut confusion = ConfusionMatrix::new(3)?;
/// confusion.update((&[0, 1, 2, -1, 1, 2], &[0, 2, 2, 1, -1, 1]))?;
/// let report = confusion.tester_report();
/// let unions: Vec<u64> = report.classes.iter().map(|c| c.union).collect();
/// assert_eq!(unions, [1, 3, 3]);
/// # Ok::<(), scenesplat_metrics::MetricError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConfusionMatrix {
    num_classes: usize,
    /// `[num_classes, num_classes]`, true class × predicted class.
    counts: Vec<u64>,
    /// `[num_classes]`, rows of a true class that got no prediction.
    unassigned: Vec<u64>,
    /// `[num_classes]`, true = left out of the foreground averages.
    excluded: Vec<bool>,
}

impl ConfusionMatrix {
    /// An empty matrix; no class is excluded.
    ///
    /// # Errors
    /// If `num_classes` is 0 or above 4096.
    pub fn new(num_classes: usize) -> Result<Self, MetricError> {
        check_num_classes(num_classes)?;
        Ok(Self {
            num_classes,
            counts: vec![0; num_classes * num_classes],
            unassigned: vec![0; num_classes],
            excluded: vec![false; num_classes],
        })
    }

    /// Leaves `classes` (wall, floor, ceiling, say) out of the foreground averages.
    ///
    /// Excluding a class here does not keep it from being predicted; for that see
    /// [`ZeroShotOptions::candidates`](crate::ZeroShotOptions::candidates).
    ///
    /// # Errors
    /// If a class does not exist.
    pub fn with_excluded(mut self, classes: &[usize]) -> Result<Self, MetricError> {
        for &class in classes {
            let num_classes = self.num_classes;
            *self.excluded.get_mut(class).ok_or(MetricError::ClassRange {
                what: "excluded",
                class,
                num_classes,
            })? = true;
        }
        Ok(self)
    }

    /// Number of classes.
    pub fn num_classes(&self) -> usize {
        self.num_classes
    }

    /// `[num_classes, num_classes]`, row-major, true class × predicted class.
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }

    /// `[num_classes]`, labeled rows without a prediction, by true class.
    pub fn unassigned(&self) -> &[u64] {
        &self.unassigned
    }

    /// `[num_classes]`, true = left out of the foreground averages.
    pub fn excluded(&self) -> &[bool] {
        &self.excluded
    }

    /// Rows counted so far: those with a true class.
    pub fn num_labelled(&self) -> u64 {
        self.counts.iter().chain(&self.unassigned).sum()
    }

    /// The numbers as the original's tester defines them.
    pub fn tester_report(&self) -> TesterReport {
        TesterReport::new(self)
    }

    /// The numbers as the original's evaluator defines them during training.
    pub fn evaluator_report(&self) -> EvaluatorReport {
        EvaluatorReport::new(self)
    }
}

impl Metric for ConfusionMatrix {
    /// Predictions and true labels, one each per row.
    type Update<'a> = (&'a [i32], &'a [i32]);

    fn update(&mut self, (prediction, label): Self::Update<'_>) -> Result<(), MetricError> {
        check_rows("prediction", prediction.len(), label.len())?;
        check_labels("prediction", prediction, self.num_classes)?;
        check_labels("label", label, self.num_classes)?;
        for (&p, &l) in prediction.iter().zip(label).filter(|&(_, &l)| l != IGNORE) {
            // Both were checked: not below -1, and below the number of classes.
            let l = l as usize;
            match p {
                IGNORE => self.unassigned[l] += 1,
                p => self.counts[l * self.num_classes + p as usize] += 1,
            }
        }
        Ok(())
    }

    fn merge(&mut self, other: &Self) -> Result<(), MetricError> {
        if other.num_classes != self.num_classes {
            return Err(MetricError::ClassCount {
                what: "merged confusion matrix",
                expected: self.num_classes,
                got: other.num_classes,
            });
        }
        if let Some(class) = (0..self.num_classes).find(|&c| self.excluded[c] != other.excluded[c])
        {
            let num_classes = self.num_classes;
            return Err(MetricError::ClassRange {
                what: "excluded in one of the merged matrices only",
                class,
                num_classes,
            });
        }
        let mine = self.counts.iter_mut().chain(&mut self.unassigned);
        for (a, b) in mine.zip(other.counts.iter().chain(&other.unassigned)) {
            *a = a.saturating_add(*b);
        }
        Ok(())
    }

    fn names(&self) -> Vec<String> {
        TesterReport::NAMES.map(str::to_owned).to_vec()
    }

    fn measure(&self) -> Vec<Measurement> {
        self.tester_report().measurements()
    }
}
