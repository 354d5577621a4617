use crate::{ConfusionMatrix, Measurement};

/// Added to each denominator by the original's tester. It only matters to someone who compares the
/// last digits, because a class with an empty denominator is left out anyway.
const TESTER_EPS: f64 = 1e-10;

/// Counts and scores of one class, tester's definition.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TesterClass {
    /// Rows of this class that were predicted as it.
    pub intersection: u64,
    /// Rows that are of this class, or were predicted as it, or both.
    pub union: u64,
    /// Rows of this class, unassigned ones included.
    pub target: u64,
    /// `intersection / (union + 1e-10)`; `None` when `union` is 0.
    pub iou: Option<f64>,
    /// `intersection / (target + 1e-10)`; `None` when `target` is 0.
    pub accuracy: Option<f64>,
    /// Whether it is left out of the foreground averages.
    pub excluded: bool,
}

/// What the original reports as its result.
///
/// With `I`, `U`, `T` the intersection, union and target of a class, summed over all scenes:
///
/// | number | formula | over classes |
/// |---|---|---|
/// | `mean_iou` | mean of `I / (U + 1e-10)` | `U ≠ 0` |
/// | `mean_accuracy` | mean of `I / (T + 1e-10)` | `T ≠ 0` |
/// | `all_accuracy` | `Σ I / Σ T` | all |
/// | `foreground_mean_iou`, `foreground_mean_accuracy` | as the means | the same, less excluded ones |
///
/// A row that got no class counts in `T` and `U` of its true class. A class that is predicted
/// somewhere but absent from the truth scores IoU 0 and lowers the mean.
///
/// A mean over no class is `None`.
///
/// # Source
/// `ZeroShotSemSegTester`, SceneSplat be9d5e1. Differs: an empty mean
/// is `None` where numpy gives NaN, and `all_accuracy` has no 1e-10.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TesterReport {
    /// One entry per class.
    pub classes: Vec<TesterClass>,
    /// mIoU, 0..=1.
    pub mean_iou: Option<f64>,
    /// mAcc, 0..=1.
    pub mean_accuracy: Option<f64>,
    /// allAcc, 0..=1.
    pub all_accuracy: Option<f64>,
    /// f-mIoU, 0..=1.
    pub foreground_mean_iou: Option<f64>,
    /// f-mAcc, 0..=1.
    pub foreground_mean_accuracy: Option<f64>,
}

impl TesterReport {
    pub(crate) fn new(confusion: &ConfusionMatrix) -> Self {
        let margins = Margins::new(confusion);
        let classes = (0..confusion.num_classes())
            .map(|c| {
                let intersection = margins.hit[c];
                let target = margins.assigned[c] + confusion.unassigned()[c];
                Self::class(
                    intersection,
                    target + margins.predicted[c] - intersection,
                    target,
                    confusion.excluded()[c],
                )
            })
            .collect();
        Self::from_classes(classes)
    }

    pub(crate) fn class(intersection: u64, union: u64, target: u64, excluded: bool) -> TesterClass {
        let ratio =
            |whole: u64| (whole > 0).then(|| intersection as f64 / (whole as f64 + TESTER_EPS));
        TesterClass {
            intersection,
            union,
            target,
            iou: ratio(union),
            accuracy: ratio(target),
            excluded,
        }
    }

    pub(crate) fn from_classes(classes: Vec<TesterClass>) -> Self {
        let foreground = || classes.iter().filter(|c| !c.excluded);
        let sum =
            |count: fn(&TesterClass) -> u64| classes.iter().map(count).fold(0, u64::saturating_add);
        let hit = sum(|c| c.intersection);
        let all = sum(|c| c.target);
        Self {
            mean_iou: mean(classes.iter().filter_map(|c| c.iou)),
            mean_accuracy: mean(classes.iter().filter_map(|c| c.accuracy)),
            all_accuracy: (all > 0).then(|| hit as f64 / all as f64),
            foreground_mean_iou: mean(foreground().filter_map(|c| c.iou)),
            foreground_mean_accuracy: mean(foreground().filter_map(|c| c.accuracy)),
            classes,
        }
    }

    /// The report on all rows that several reports are about: counts add up, and the scores are those of
    /// the sums, so it is what one run over everything would have said. `None` without a report, or if
    /// they are of other classes, leave out others, or count more than 2⁶⁴ rows.
    pub fn sum<'r>(reports: impl IntoIterator<Item = &'r Self>) -> Option<Self> {
        let mut reports = reports.into_iter();
        let mut classes = reports.next()?.classes.clone();
        for report in reports {
            if report.classes.len() != classes.len() {
                return None;
            }
            for (sum, class) in classes.iter_mut().zip(&report.classes) {
                if sum.excluded != class.excluded {
                    return None;
                }
                sum.intersection = sum.intersection.checked_add(class.intersection)?;
                sum.union = sum.union.checked_add(class.union)?;
                sum.target = sum.target.checked_add(class.target)?;
            }
        }
        let scored = |c: &TesterClass| Self::class(c.intersection, c.union, c.target, c.excluded);
        Some(Self::from_classes(classes.iter().map(scored).collect()))
    }

    /// The defined ones of `mIoU`, `mAcc`, `allAcc`, `f-mIoU`, `f-mAcc`, in this order.
    pub fn measurements(&self) -> Vec<Measurement> {
        let values = [
            self.mean_iou,
            self.mean_accuracy,
            self.all_accuracy,
            self.foreground_mean_iou,
            self.foreground_mean_accuracy,
        ];
        named(std::array::from_fn::<_, 5, _>(|i| (Self::NAMES[i], values[i])))
    }

    /// Names of the measurements.
    pub const NAMES: [&'static str; 5] = ["mIoU", "mAcc", "allAcc", "f-mIoU", "f-mAcc"];
}

/// Counts and scores of one class, evaluator's definition.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct EvaluatorClass {
    /// Rows of this class predicted as it.
    pub true_positive: u64,
    /// Rows of another class predicted as it.
    pub false_positive: u64,
    /// Rows of this class predicted as another or as none.
    pub false_negative: u64,
    /// `tp / (tp + fp + fn)`; `None` when the class has no row in the truth.
    pub iou: Option<f64>,
    /// `tp / (rows of this class with a prediction)`; `None` when there are none.
    pub accuracy: Option<f64>,
    /// Whether it is left out of the foreground averages.
    pub excluded: bool,
}

/// What the original computes while it trains, and picks the best checkpoint by.
///
/// Differs from [`TesterReport`] in the denominators: only classes **present in the truth** enter
/// the mean IoU, so a class that is merely predicted costs nothing there; and accuracies leave rows
/// without a prediction out of the denominator, so withholding an answer is free.
///
/// A mean over no class is `None`.
///
/// # Source
/// `LangPretrainZeroShotSemSegEval`, SceneSplat be9d5e1.
/// Differs: the multi-dataset variant there excludes nothing by mistake; here excluding works, and
/// its numbers are those of a matrix without excluded classes.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct EvaluatorReport {
    /// One entry per class.
    pub classes: Vec<EvaluatorClass>,
    /// mIoU over classes in the truth, 0..=1.
    pub mean_iou: Option<f64>,
    /// The same without excluded classes: the original's checkpoint criterion.
    pub foreground_mean_iou: Option<f64>,
    /// Mean accuracy over classes with a predicted row, 0..=1.
    pub mean_accuracy: Option<f64>,
    /// The same without excluded classes.
    pub foreground_mean_accuracy: Option<f64>,
    /// Right rows over rows with a prediction, 0..=1.
    pub global_accuracy: Option<f64>,
}

impl EvaluatorReport {
    pub(crate) fn new(confusion: &ConfusionMatrix) -> Self {
        let margins = Margins::new(confusion);
        let classes: Vec<_> = (0..confusion.num_classes())
            .map(|c| {
                let (hit, row) = (margins.hit[c], margins.assigned[c]);
                let unassigned = confusion.unassigned()[c];
                let joint = row + unassigned + margins.predicted[c] - hit;
                EvaluatorClass {
                    true_positive: hit,
                    false_positive: margins.predicted[c] - hit,
                    false_negative: row - hit + unassigned,
                    iou: (row + unassigned > 0).then(|| hit as f64 / joint as f64),
                    accuracy: (row > 0).then(|| hit as f64 / row as f64),
                    excluded: confusion.excluded()[c],
                }
            })
            .collect();
        let foreground = || classes.iter().filter(|c| !c.excluded);
        let hit: u64 = margins.hit.iter().sum();
        let all: u64 = margins.assigned.iter().sum();
        Self {
            mean_iou: mean(classes.iter().filter_map(|c| c.iou)),
            foreground_mean_iou: mean(foreground().filter_map(|c| c.iou)),
            mean_accuracy: mean(classes.iter().filter_map(|c| c.accuracy)),
            foreground_mean_accuracy: mean(foreground().filter_map(|c| c.accuracy)),
            global_accuracy: (all > 0).then(|| hit as f64 / all as f64),
            classes,
        }
    }

    /// The defined ones of `mIoU`, `fg_mIoU`, `mean_class_acc`, `fg_mAcc`, `global_acc`, in this
    /// order and with the original's names.
    pub fn measurements(&self) -> Vec<Measurement> {
        named([
            ("mIoU", self.mean_iou),
            ("fg_mIoU", self.foreground_mean_iou),
            ("mean_class_acc", self.mean_accuracy),
            ("fg_mAcc", self.foreground_mean_accuracy),
            ("global_acc", self.global_accuracy),
        ])
    }
}

/// Diagonal, row sums and column sums.
struct Margins {
    hit: Vec<u64>,
    assigned: Vec<u64>,
    predicted: Vec<u64>,
}

impl Margins {
    fn new(confusion: &ConfusionMatrix) -> Self {
        let n = confusion.num_classes();
        let mut margins = Self { hit: vec![0; n], assigned: vec![0; n], predicted: vec![0; n] };
        for (truth, row) in confusion.counts().chunks_exact(n).enumerate() {
            margins.hit[truth] = row[truth];
            for (predicted, &count) in margins.predicted.iter_mut().zip(row) {
                *predicted += count;
            }
            margins.assigned[truth] = row.iter().sum();
        }
        margins
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), v| (sum + v, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

fn named<const N: usize>(values: [(&str, Option<f64>); N]) -> Vec<Measurement> {
    values.into_iter().filter_map(|(name, v)| Some(Measurement::new(name, v?))).collect()
}
