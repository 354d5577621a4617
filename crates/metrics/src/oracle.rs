use crate::error::{check_labels, check_rows};
use crate::similarity::score_error;
use crate::sweep::vote_by_sweep;
use crate::voting::check_vote;
use crate::{
    ConfusionMatrix, FeatureFn, IGNORE, Metric, MetricError, TesterReport, TextRows, UnknownRule,
    ZeroShotOptions, classify, keep_withheld, vote,
};
use std::collections::BTreeMap;
use std::fmt;

/// The voting step of an [`OracleCheck`].
#[derive(Debug, Clone, Copy)]
pub struct OracleVote<'a> {
    /// `[N, 3]` meters, where the classified rows are.
    pub coord: &'a [[f32; 3]],
    /// `[N]`, which rows vote; all if `None`.
    pub valid: Option<&'a [bool]>,
    /// `[M, 3]` meters and `[M]` true labels of the points that are scored; the rows themselves if
    /// `None`.
    pub query: Option<(&'a [[f32; 3]], &'a [i32])>,
    /// Neighbors per vote.
    pub k: usize,
    /// Whether rows without a class stay without one after the vote; without `query` only.
    pub keep_unknown: bool,
}

/// A deliberate mistake: one row gets the text row of another class as its feature.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fault {
    /// Row to spoil.
    pub row: usize,
    /// Class whose text row it gets.
    pub class: usize,
}

/// Runs the evaluation chain on features whose right answer is known.
///
/// Every labeled row gets the text row of its own class as its feature, every unlabeled one a
/// zero row. [`run`](Self::run) then calls the same functions as an evaluation,
/// [`classify`], [`vote`], [`ConfusionMatrix`], and compares their results, row by row and count by
/// count, with what must come out:
///
/// 1. the class of a row is `argmax_j T_c · T_j` in f64, which is `c` itself unless rows of the
///    table are equal ([`OracleReport::aliases`]) or the options rule `c` out;
/// 2. the vote over these labels comes from a second implementation without a tree;
/// 3. counts come from plain loops over the rows, and every metric must be the same number, not a
///    close one.
///
/// Labels shifted by one, a table in another order than the class names, a class map applied twice,
/// rows permuted between features and labels, a broken neighbor search: each of these turns real
/// results into plausible nonsense, and each fails here. A metric below 1 is not a failure by
/// itself, as a vote smooths true labels, too.
///
/// Features are made on the fly: memory stays at a few bytes per row.
///
/// ```
/// use scenesplat_metrics::{Fault, OracleCheck, TextRows};
///
/// let text = TextRows::new(&[1.0, 0.0, 0.6, 0.8], 2)?;
/// let check = OracleCheck::new(&[0, 1, -1, 1], text);
/// assert_eq!(check.run()?.metrics.all_accuracy, Some(1.0));
/// assert!(check.with_fault(Fault { row: 3, class: 0 }).run().is_err());
/// # Ok::<(), scenesplat_metrics::MetricError>(())
/// ```
#[derive(Debug, Clone)]
pub struct OracleCheck<'a> {
    labels: &'a [i32],
    text: TextRows<'a>,
    names: &'a [String],
    excluded: &'a [usize],
    options: ZeroShotOptions,
    vote: Option<OracleVote<'a>>,
    fault: Option<Fault>,
}

/// What a successful [`OracleCheck`] found.
#[derive(Debug, Clone, PartialEq)]
pub struct OracleReport {
    /// Rows that were classified.
    pub num_rows: usize,
    /// Of these, rows with a true class.
    pub num_labelled: usize,
    /// Points that were scored.
    pub num_scored: usize,
    /// Classes whose rows rightly come out as another class, or as -1, under this table and these
    /// options: (class, what it comes out as).
    pub aliases: Vec<(usize, i32)>,
    /// The metrics of the chain on truth: the ceiling of what any features can reach.
    pub metrics: TesterReport,
}

/// Where an [`OracleCheck`] found the chain wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum OracleStage {
    /// The zero-shot class of a row.
    Classify,
    /// The vote at a scored point.
    Vote,
    /// A count of the confusion matrix.
    Confusion,
    /// A number of the report.
    Metrics,
}

/// How an [`OracleCheck`] failed.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct OracleFailure {
    /// The first stage with a wrong result.
    pub stage: OracleStage,
    /// Results checked in that stage: rows, or counts.
    pub num_checked: usize,
    /// How many of them were wrong.
    pub num_wrong: usize,
    /// The first wrong one: a row, or the true class of a count.
    pub first: usize,
    /// What it should have been, as a person reads it.
    pub expected: String,
    /// What it was.
    pub got: String,
}

impl fmt::Display for OracleFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (wrong, all, first) = (self.num_wrong, self.num_checked, self.first);
        let (expected, got) = (&self.expected, &self.got);
        match self.stage {
            OracleStage::Classify => write!(f, "{wrong} of {all} rows classified wrongly")?,
            OracleStage::Vote => write!(f, "{wrong} of {all} votes wrong")?,
            OracleStage::Confusion => write!(f, "{wrong} of {all} confusion counts wrong")?,
            OracleStage::Metrics => {
                return write!(f, "metrics differ: expected {expected}, got {got}");
            }
        }
        write!(f, ", the first at {first}: expected {expected}, got {got}")
    }
}

impl std::error::Error for OracleFailure {}

impl<'a> OracleCheck<'a> {
    /// A check of the zero-shot classes of rows with these true `labels`, `[N]`, without a vote.
    pub fn new(labels: &'a [i32], text: TextRows<'a>) -> Self {
        let options = ZeroShotOptions::default();
        Self { labels, text, names: &[], excluded: &[], options, vote: None, fault: None }
    }

    /// Class names for the failure message, `[C]`.
    #[must_use]
    pub fn with_class_names(self, names: &'a [String]) -> Self {
        Self { names, ..self }
    }

    /// Classes left out of the foreground averages.
    #[must_use]
    pub fn with_excluded(self, excluded: &'a [usize]) -> Self {
        Self { excluded, ..self }
    }

    /// The options the evaluation classifies with.
    #[must_use]
    pub fn with_options(self, options: ZeroShotOptions) -> Self {
        Self { options, ..self }
    }

    /// The vote the evaluation does.
    #[must_use]
    pub fn with_vote(self, vote: OracleVote<'a>) -> Self {
        Self { vote: Some(vote), ..self }
    }

    /// Spoils one row, to see that the check notices.
    #[must_use]
    pub fn with_fault(self, fault: Fault) -> Self {
        Self { fault: Some(fault), ..self }
    }

    /// Runs the chain and compares.
    ///
    /// # Errors
    /// [`MetricError::Oracle`] if anything comes out other than it must.
    /// [`MetricError::AmbiguousText`] if two different text rows are so close that rounding decides
    /// between them: no evaluation with such a table means anything. Otherwise whatever the chain
    /// itself refuses.
    pub fn run(&self) -> Result<OracleReport, MetricError> {
        let num_classes = self.text.num_classes();
        check_labels("labels", self.labels, num_classes)?;
        if !self.names.is_empty() && self.names.len() != num_classes {
            let got = self.names.len();
            return Err(MetricError::ClassCount {
                what: "class names",
                expected: num_classes,
                got,
            });
        }
        let answers = self.class_answers()?;
        let answer = |&label: &i32| usize::try_from(label).map_or(IGNORE, |class| answers[class]);
        let mut expected: Vec<i32> = self.labels.iter().map(answer).collect();

        let mut got = self.classify_truth()?;
        self.compare_labels(OracleStage::Classify, &expected, &got)?;

        let mut truth = self.labels;
        if let Some(OracleVote { coord, valid, query, k, keep_unknown }) = self.vote {
            let keep = keep_unknown && query.is_none();
            check_rows("coord", coord.len(), self.labels.len())?;
            let (query, query_labels) = query.unwrap_or((coord, self.labels));
            check_rows("query labels", query_labels.len(), query.len())?;
            check_labels("query labels", query_labels, num_classes)?;
            check_vote(coord, &expected, valid, query, k, num_classes)?;
            let before = (got.clone(), expected.clone());
            got = vote(coord, &got, valid, query, k, num_classes)?;
            expected = vote_by_sweep(coord, &expected, valid, query, k)?;
            if keep {
                keep_withheld(&before.0, &mut got);
                keep_withheld(&before.1, &mut expected);
            }
            truth = query_labels;
            self.compare_labels(OracleStage::Vote, &expected, &got)?;
        }

        let mut confusion = ConfusionMatrix::new(num_classes)?.with_excluded(self.excluded)?;
        confusion.update((&got, truth))?;
        self.compare_counts(&expected, truth, &confusion)?;
        let metrics = confusion.tester_report();
        self.compare_metrics(&expected, truth, &metrics)?;
        Ok(OracleReport {
            num_rows: self.labels.len(),
            num_labelled: self.labels.iter().filter(|&&l| l != IGNORE).count(),
            num_scored: truth.len(),
            aliases: (0..num_classes)
                .filter(|&class| answers[class] != class as i32)
                .map(|class| (class, answers[class]))
                .collect(),
            metrics,
        })
    }

    fn classify_truth(&self) -> Result<Vec<i32>, MetricError> {
        let dim = self.text.dim();
        if let Some(Fault { row, class }) = self.fault {
            let num_classes = self.text.num_classes();
            if class >= num_classes {
                return Err(MetricError::ClassRange { what: "fault", class, num_classes });
            }
            if row >= self.labels.len() {
                let expected = self.labels.len();
                return Err(MetricError::RowCount { what: "fault", expected, got: row + 1 });
            }
        }
        let features = FeatureFn::new(self.labels.len(), dim, |rows, out: &mut [f32]| {
            for (row, out) in rows.zip(out.chunks_exact_mut(dim)) {
                let class = match self.fault {
                    Some(fault) if fault.row == row => Some(fault.class),
                    _ => usize::try_from(self.labels[row]).ok(),
                };
                if let Some(text) = class.and_then(|class| self.text.row(class)) {
                    out.copy_from_slice(text);
                }
            }
            Ok(())
        })?;
        Ok(classify(&features, self.text, &self.options)?.labels)
    }

    /// `[C]`, what a row whose feature is the text row of a class must be labeled. Classes without
    /// rows are not looked at and answer themselves.
    fn class_answers(&self) -> Result<Vec<i32>, MetricError> {
        let num_classes = self.text.num_classes();
        let candidates = self.options.candidate_classes(num_classes)?;
        let mut present = vec![false; num_classes];
        for class in self.labels.iter().filter_map(|&label| usize::try_from(label).ok()) {
            present[class] = true;
        }
        let answer = |class: usize| match present[class] {
            true => self.class_answer(class, &candidates),
            false => Ok(class as i32),
        };
        (0..num_classes).map(answer).collect()
    }

    fn class_answer(&self, class: usize, candidates: &[usize]) -> Result<i32, MetricError> {
        let rounding = 2.0 * score_error(self.text.dim());
        let row = |c: usize| self.text.row(c).unwrap_or_default();
        let score = |c: usize| -> f64 {
            row(class).iter().zip(row(c)).map(|(&x, &y)| f64::from(x) * f64::from(y)).sum()
        };
        let mut ranking: Vec<(f64, usize)> = candidates.iter().map(|&c| (score(c), c)).collect();
        // Stable: equal scores stay in rising class order.
        ranking.sort_by(|a, b| b.0.total_cmp(&a.0));
        let Some(&(best, answer)) = ranking.first() else { return Ok(IGNORE) };
        let ambiguous = |other: usize, gap: f64| MetricError::AmbiguousText { class, other, gap };
        for &(score, other) in &ranking[1..] {
            if best - score < rounding && row(other) != row(answer) {
                let other = if other == class { answer } else { other };
                return Err(ambiguous(other, best - score));
            }
        }
        let UnknownRule { min_cosine, min_margin } = self.options.unknown;
        let margin = ranking.get(1).map_or(f64::INFINITY, |second| best - second.0);
        // Equal rows have a margin of exactly 0 in any arithmetic; all else is known up to rounding.
        let limits = [(best, min_cosine, rounding), (margin, min_margin, rounding.min(margin))];
        for (value, limit, error) in limits {
            let Some(limit) = limit.map(f64::from) else { continue };
            if (value - limit).abs() < error {
                return Err(ambiguous(class, (value - limit).abs()));
            }
            if value < limit {
                return Ok(IGNORE);
            }
        }
        Ok(answer as i32)
    }

    fn compare_labels(
        &self,
        stage: OracleStage,
        expected: &[i32],
        got: &[i32],
    ) -> Result<(), MetricError> {
        check_rows("labels of the chain", got.len(), expected.len())?;
        let wrong = || (0..got.len()).filter(|&row| got[row] != expected[row]);
        let Some(first) = wrong().next() else { return Ok(()) };
        Err(failure(OracleFailure {
            stage,
            num_checked: got.len(),
            num_wrong: wrong().count(),
            first,
            expected: self.name(expected[first]),
            got: self.name(got[first]),
        }))
    }

    fn compare_counts(
        &self,
        prediction: &[i32],
        truth: &[i32],
        got: &ConfusionMatrix,
    ) -> Result<(), MetricError> {
        let c = got.num_classes();
        let mut counts: BTreeMap<(i32, i32), [u64; 2]> = BTreeMap::new();
        for (&label, &predicted) in truth.iter().zip(prediction) {
            if label != IGNORE {
                counts.entry((label, predicted)).or_default()[0] += 1;
            }
        }
        for (class, row) in got.counts().chunks_exact(c).enumerate() {
            let unassigned = (IGNORE, got.unassigned()[class]);
            for (predicted, count) in (0..).zip(row.iter().copied()).chain([unassigned]) {
                if count > 0 {
                    counts.entry((class as i32, predicted)).or_default()[1] = count;
                }
            }
        }
        let wrong = || counts.iter().filter(|(_, [expected, got])| expected != got);
        let Some((&(label, predicted), [expected, got])) = wrong().next() else { return Ok(()) };
        Err(failure(OracleFailure {
            stage: OracleStage::Confusion,
            num_checked: counts.len(),
            num_wrong: wrong().count(),
            first: label as usize,
            expected: format!("{expected} rows predicted as {}", self.name(predicted)),
            got: got.to_string(),
        }))
    }

    fn compare_metrics(
        &self,
        prediction: &[i32],
        truth: &[i32],
        got: &TesterReport,
    ) -> Result<(), MetricError> {
        let classes = (0..self.text.num_classes()).map(|class| {
            let id = class as i32;
            let count = |counts: &dyn Fn(i32, i32) -> bool| {
                let pairs = prediction.iter().zip(truth).filter(|&(_, &t)| t != IGNORE);
                pairs.filter(|&(&p, &t)| counts(p, t)).count() as u64
            };
            TesterReport::class(
                count(&|p, t| p == id && t == id),
                count(&|p, t| p == id || t == id),
                count(&|_, t| t == id),
                self.excluded.contains(&class),
            )
        });
        let expected = TesterReport::from_classes(classes.collect());
        if expected == *got {
            return Ok(());
        }
        Err(failure(OracleFailure {
            stage: OracleStage::Metrics,
            num_checked: 1,
            num_wrong: 1,
            first: 0,
            expected: format!("{:?}", expected.measurements()),
            got: format!("{:?}", got.measurements()),
        }))
    }

    fn name(&self, label: i32) -> String {
        match usize::try_from(label) {
            Err(_) => "no class".to_owned(),
            Ok(class) => match self.names.get(class) {
                Some(name) => format!("class {class} ({name})"),
                None => format!("class {class}"),
            },
        }
    }
}

fn failure(failure: OracleFailure) -> MetricError {
    MetricError::Oracle(Box::new(failure))
}
