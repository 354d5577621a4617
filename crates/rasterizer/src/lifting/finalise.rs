//! From weights to features, block by block.

use super::LiftError;
use super::aggregate::{Aggregate, Workspace, normalise};
use super::spool::{BlockWeights, SegmentWeight};
use super::tables::SegmentTables;
use super::vector::Label;
use rayon::prelude::*;

/// How weights become features.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FinaliseSettings {
    /// The rule.
    pub aggregate: Aggregate,
    /// Where labels (unit vectors, by their weights) vary by no more than this, a Gaussian gets their weighted mean,
    /// whatever the rule; `None`: the rule is for all. At least 0.
    pub guard_above: Option<f32>,
    /// γ: a picture that saw a Gaussian with weight `W` counts `W^γ`. 1 counts pixels, so close
    /// pictures weigh most; 0 gives every picture one vote. In `0..=1`.
    pub view_exponent: f32,
    /// Least sum of labeled weights, pixels, ≥ 0; Gaussians with less get no feature.
    pub min_coverage: f32,
    /// Least part of the weight that lies in segments, in `0..=1`.
    pub min_labelled_share: f32,
    /// Whether features are divided by their length.
    pub normalise: bool,
}

impl Default for FinaliseSettings {
    /// The weighted mean of whatever was seen, as unit vectors.
    fn default() -> Self {
        Self {
            aggregate: Aggregate::WeightedMean,
            guard_above: None,
            view_exponent: 1.0,
            min_coverage: 0.0,
            min_labelled_share: 0.0,
            normalise: true,
        }
    }
}

impl FinaliseSettings {
    /// For labels that contradict each other: the geometric median. Pictures keep their weights: on a
    /// synthetic room with a fifth of the segments wrong, 1 − cosine to the truth was 0.030, of the
    /// weighted mean 0.038.
    pub fn robust() -> Self {
        Self { aggregate: Aggregate::MEDIAN, ..Self::default() }
    }

    /// Checks that every number is in its range.
    ///
    /// # Errors
    /// Names the first that is not.
    pub fn check(&self) -> Result<(), LiftError> {
        let check = |field, value: f32, good: bool, range: &str| {
            let problem = format!("is {value}; it has to be {range}");
            if good { Ok(()) } else { Err(LiftError::argument(field, problem)) }
        };
        let unit = |v: f32| (0.0..=1.0).contains(&v);
        let limit = self.guard_above.unwrap_or(0.0);
        check("variance to guard above", limit, limit >= 0.0, "at least 0")?;
        check("view exponent", self.view_exponent, unit(self.view_exponent), "from 0 to 1")?;
        let least = self.min_coverage;
        check("coverage", least, least >= 0.0 && least.is_finite(), "finite, at least 0")?;
        let share = self.min_labelled_share;
        check("labeled share", share, unit(share), "from 0 to 1")?;
        if let Aggregate::HeaviestGroup { cosine } = self.aggregate {
            check("group cosine", cosine, (-1.0..=1.0).contains(&cosine), "from -1 to 1")?;
        }
        Ok(())
    }
}

/// Features of consecutive Gaussians, with how much they are worth.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BlockFeatures {
    /// First Gaussian.
    pub first: usize,
    /// Rows of Gaussians without a feature are exactly 0. `[B, D]`
    pub features: Vec<f32>,
    /// Whether there is a feature. `[B]`
    pub valid: Vec<bool>,
    /// How far the labels agree: the length of their weighted mean (they are unit vectors), in
    /// `0..=1`; 1 where all are the same, 0 without labels. Before any robust rule. `[B]`
    pub confidence: Vec<f32>,
    /// Whether a robust rule made the feature. `[B]`
    pub guarded: Vec<bool>,
    /// Pictures that saw the Gaussian in a segment. `[B]`
    pub views: Vec<u32>,
    /// Sum of the labeled weights over all pictures, pixels. `[B]`
    pub coverage: Vec<f32>,
}

/// Gaussians handled with one workspace.
const ROWS_PER_TASK: usize = 64;

/// Makes features of a block of weights.
///
/// Labels keep the order of the pictures, sums are independent of the number of threads.
///
/// # Shapes
/// - `block`: B Gaussians; `segment` counts over all pictures of `tables`
/// - `totals`: `[B]`, all weight of each Gaussian, labeled or not, pixels
///
/// # Panics
/// If `totals` has another number of rows, or a segment is not in the tables.
pub fn finalise_block(
    block: &BlockWeights,
    tables: &SegmentTables,
    totals: &[f64],
    settings: &FinaliseSettings,
) -> BlockFeatures {
    assert_eq!(block.len(), totals.len(), "one total per Gaussian");
    let (rows, dim) = (block.len(), tables.dim());
    let mut out = BlockFeatures {
        first: block.first,
        features: vec![0.0; rows * dim],
        valid: vec![false; rows],
        confidence: vec![0.0; rows],
        guarded: vec![false; rows],
        views: vec![0; rows],
        coverage: vec![0.0; rows],
    };
    let tasks = out
        .features
        .par_chunks_mut(ROWS_PER_TASK * dim)
        .zip(out.valid.par_chunks_mut(ROWS_PER_TASK))
        .zip(out.confidence.par_chunks_mut(ROWS_PER_TASK))
        .zip(out.guarded.par_chunks_mut(ROWS_PER_TASK))
        .zip(out.views.par_chunks_mut(ROWS_PER_TASK))
        .zip(out.coverage.par_chunks_mut(ROWS_PER_TASK));
    tasks.enumerate().for_each(
        |(task, (((((features, valid), confidence), guarded), views), coverage))| {
            let mut space = Workspace::new(dim);
            let mut labels = Vec::new();
            for i in 0..valid.len() {
                let row = task * ROWS_PER_TASK + i;
                let seen =
                    Seen::collect(block.of(row), tables, settings.view_exponent, &mut labels);
                views[i] = seen.views;
                coverage[i] = seen.coverage as f32;
                if labels.is_empty() {
                    continue;
                }
                let feature = &mut features[i * dim..(i + 1) * dim];
                let rule = settings.aggregate;
                let found = space.aggregate(rule, settings.guard_above, tables, &labels, feature);
                confidence[i] = found.agreement as f32;
                guarded[i] = found.guarded;
                let enough = seen.coverage >= f64::from(settings.min_coverage)
                    && seen.coverage >= f64::from(settings.min_labelled_share) * totals[row];
                valid[i] = enough && if settings.normalise { normalise(feature) } else { true };
                if !valid[i] {
                    feature.fill(0.0);
                }
            }
        },
    );
    out
}

/// How a Gaussian was seen.
pub(super) struct Seen {
    pub(super) views: u32,
    pub(super) coverage: f64,
}

impl Seen {
    /// Labels of one Gaussian with each picture's weight raised to `exponent`.
    pub(super) fn collect(
        weights: &[SegmentWeight],
        tables: &SegmentTables,
        exponent: f32,
        labels: &mut Vec<Label>,
    ) -> Self {
        labels.clear();
        let mut seen = Self { views: 0, coverage: 0.0 };
        for view in of_each_view(weights, tables) {
            let total: f64 = view.iter().map(|w| f64::from(w.weight)).sum();
            seen.views += 1;
            seen.coverage += total;
            let scale = if exponent == 1.0 { 1.0 } else { total.powf(f64::from(exponent) - 1.0) };
            let scaled = |w: &SegmentWeight| (w.segment, (f64::from(w.weight) * scale) as f32);
            labels.extend(view.iter().map(scaled).filter(|(_, w)| *w > 0.0 && w.is_finite()));
        }
        seen
    }
}

/// Splits the weights of one Gaussian, which come in the order of the pictures, by picture.
pub(super) fn of_each_view<'a>(
    weights: &'a [SegmentWeight],
    tables: &'a SegmentTables,
) -> impl Iterator<Item = &'a [SegmentWeight]> {
    let mut left = weights;
    std::iter::from_fn(move || {
        let first = left.first()?;
        let segments = tables.segments_of(tables.view_of(first.segment));
        let end = left.iter().position(|w| !segments.contains(&w.segment));
        let (view, rest) = left.split_at(end.unwrap_or(left.len()));
        left = rest;
        Some(view)
    })
}
