//! One feature from the labels of one Gaussian.

use super::tables::SegmentTables;
use super::vector::{Label, dot, scaled, squared_distance, squared_length, weighted_sum};

/// How the labels of a Gaussian become one feature.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Aggregate {
    /// `Σ w f / Σ w`: the most likely feature if labels err by a normal distribution.
    #[default]
    WeightedMean,
    /// The point with the least weighted sum of distances to the labels, by Weiszfeld's iteration
    /// from the mean: wrong labels with less than half of the weight cannot move it far, however
    /// wrong they are.
    GeometricMedian {
        /// Rounds, at most; it ends early when nothing moves.
        rounds: u32,
    },
    /// The mean of the heaviest group of labels that resemble each other; for thin objects, whose
    /// masks often hold what is behind them.
    HeaviestGroup {
        /// Least cosine to the heaviest label of a group.
        cosine: f32,
    },
}

impl Aggregate {
    /// The median with 8 rounds: labels with 20 % errors end up as with 50 rounds, to 1e-3.
    pub const MEDIAN: Self = Self::GeometricMedian { rounds: 8 };
    /// Groups of cosine 0.9.
    pub const HEAVIEST_GROUP: Self = Self::HeaviestGroup { cosine: 0.9 };
}

/// Distances below this count as this: a label at the median itself would otherwise weigh infinitely.
const NEAREST: f32 = 1e-3;
/// A move of the median below which it has converged, squared.
const STILL: f32 = 1e-8;

/// How a feature came about.
#[derive(Debug, Clone, Copy)]
pub(super) struct Aggregated {
    /// Length of the weighted mean.
    pub(super) agreement: f64,
    /// Whether a robust rule made it.
    pub(super) guarded: bool,
}

/// Space for the work on one Gaussian after the other.
#[derive(Debug)]
pub(super) struct Workspace {
    sum: Vec<f64>,
    reweighted: Vec<Label>,
    next: Vec<f32>,
    groups: Vec<(u32, f64)>,
    group_of: Vec<usize>,
    order: Vec<usize>,
}

impl Workspace {
    pub(super) fn new(dim: usize) -> Self {
        Self {
            sum: vec![0.0; dim],
            reweighted: Vec::new(),
            next: vec![0.0; dim],
            groups: Vec::new(),
            group_of: Vec::new(),
            order: Vec::new(),
        }
    }

    /// `Σ w f / Σ w` into `out`; gives its length, in `0..=1`, which is 1 if all labels agree.
    pub(super) fn mean(
        &mut self,
        tables: &SegmentTables,
        labels: &[Label],
        out: &mut [f32],
    ) -> f64 {
        weighted_sum(tables, labels, &mut self.sum);
        let total: f64 = labels.iter().map(|&(_, w)| f64::from(w)).sum();
        (scaled(&self.sum, 1.0 / total, out)).sqrt().min(1.0)
    }

    /// The feature by a rule into `out`, not normalized; of labels that vary by no more than `guard_above`, the mean.
    ///
    /// `labels`: weights above 0, at least one.
    pub(super) fn aggregate(
        &mut self,
        rule: Aggregate,
        guard_above: Option<f32>,
        tables: &SegmentTables,
        labels: &[Label],
        out: &mut [f32],
    ) -> Aggregated {
        let agreement = self.mean(tables, labels, out);
        let variance = 1.0 - agreement * agreement;
        let agree = guard_above.is_some_and(|limit| variance <= f64::from(limit));
        // One label is its own median.
        let same = labels.iter().all(|l| l.0 == labels[0].0);
        let guarded = rule != Aggregate::WeightedMean && !agree && !same;
        match rule {
            _ if !guarded => {}
            Aggregate::WeightedMean => {}
            Aggregate::GeometricMedian { rounds } => self.median(rounds, tables, labels, out),
            Aggregate::HeaviestGroup { cosine } => self.heaviest(cosine, tables, labels, out),
        }
        Aggregated { agreement, guarded }
    }

    /// From the mean in `out`.
    fn median(&mut self, rounds: u32, tables: &SegmentTables, labels: &[Label], out: &mut [f32]) {
        for _ in 0..rounds {
            self.reweighted.clear();
            let mut total = 0.0;
            for &(segment, weight) in labels {
                let distance = squared_distance(tables.row(segment), out).sqrt().max(NEAREST);
                let weight = weight / distance;
                total += f64::from(weight);
                self.reweighted.push((segment, weight));
            }
            weighted_sum(tables, &self.reweighted, &mut self.sum);
            scaled(&self.sum, 1.0 / total, &mut self.next);
            let moved = squared_distance(out, &self.next);
            out.copy_from_slice(&self.next);
            if moved < STILL {
                return;
            }
        }
    }

    /// Groups greedily, the heaviest label first.
    fn heaviest(&mut self, cosine: f32, tables: &SegmentTables, labels: &[Label], out: &mut [f32]) {
        self.order.clear();
        self.order.extend(0..labels.len());
        // Stable: of equal weights, the earlier picture comes first.
        self.order.sort_by(|&a, &b| labels[b].1.total_cmp(&labels[a].1));
        self.groups.clear();
        self.group_of.clear();
        self.group_of.resize(labels.len(), 0);
        for &i in &self.order {
            let (segment, weight) = labels[i];
            let row = tables.row(segment);
            let like = |&(leader, _): &(u32, f64)| {
                leader == segment || dot(tables.row(leader), row) > cosine
            };
            let group = self.groups.iter().position(like).unwrap_or_else(|| {
                self.groups.push((segment, 0.0));
                self.groups.len() - 1
            });
            self.groups[group].1 += f64::from(weight);
            self.group_of[i] = group;
        }
        let mut best = 0;
        for (group, (_, weight)) in self.groups.iter().enumerate() {
            if *weight > self.groups[best].1 {
                best = group;
            }
        }
        let mut kept = std::mem::take(&mut self.reweighted);
        kept.clear();
        let in_best = labels.iter().zip(&self.group_of).filter(|&(_, &group)| group == best);
        kept.extend(in_best.map(|(label, _)| *label));
        self.mean(tables, &kept, out);
        self.reweighted = kept;
    }
}

/// Divides by the length; `false` if there is none, and the vector is 0 then.
pub(super) fn normalise(v: &mut [f32]) -> bool {
    let norm = squared_length(v).sqrt();
    // Labels that cancel out leave rounding errors, which are no feature.
    if norm < 1e-6 {
        v.fill(0.0);
        return false;
    }
    let inverse = 1.0 / norm;
    v.iter_mut().for_each(|x| *x = (f64::from(*x) * inverse) as f32);
    true
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;

    fn tables(rows: &[f32], dim: usize) -> SegmentTables {
        let mut tables = SegmentTables::new(dim);
        tables.push(rows).unwrap();
        tables
    }

    fn run(rule: Aggregate, tables: &SegmentTables, labels: &[Label]) -> (Vec<f32>, f64) {
        let mut out = vec![0.0; tables.dim()];
        let found = Workspace::new(tables.dim()).aggregate(rule, None, tables, labels, &mut out);
        (out, found.agreement)
    }

    #[test]
    fn a_rule_waits_for_labels_that_vary() {
        // Two directions, three to one: the mean is (0.75, 0.25), the variance 1 - 0.625.
        let tables = tables(&[1.0, 0.0, 0.0, 1.0], 2);
        let labels = [(0, 3.0), (1, 1.0)];
        let run = |rule, limit| {
            let mut out = [0.0; 2];
            let found = Workspace::new(2).aggregate(rule, limit, &tables, &labels, &mut out);
            (out, found.guarded)
        };
        assert_eq!(run(Aggregate::MEDIAN, Some(0.38)), ([0.75, 0.25], false));
        let (guarded, is) = run(Aggregate::MEDIAN, Some(0.37));
        assert!(is && guarded[0] > 0.9 && run(Aggregate::MEDIAN, None) == (guarded, true));
        assert_eq!(run(Aggregate::WeightedMean, None), ([0.75, 0.25], false));
    }

    #[test]
    fn the_mean_by_hand() {
        let tables = tables(&[1.0, 0.0, 0.0, 2.0], 2);
        let (mean, agreement) = run(Aggregate::WeightedMean, &tables, &[(0, 3.0), (1, 1.0)]);
        assert_eq!(mean, [0.75, 0.25]);
        assert!((agreement - (0.625f64).sqrt()).abs() < 1e-12);
        assert_eq!(run(Aggregate::WeightedMean, &tables, &[(1, 1e-30)]).1, 1.0);
    }

    #[test]
    fn the_median_stays_with_the_majority_and_is_where_the_derivative_is_0() {
        // Three directions; of the weight 55 %, 25 %, 20 %.
        let rows = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let tables = tables(&rows, 3);
        let labels = [(0, 5.5), (1, 2.5), (2, 2.0)];
        let (mean, _) = run(Aggregate::WeightedMean, &tables, &labels);
        let (median, _) = run(Aggregate::GeometricMedian { rounds: 500 }, &tables, &labels);
        assert!(median[0] > 0.99 && mean[0] < 0.6, "{median:?} {mean:?}");
        // No majority: inside the triangle, Σ w (m − f)/|m − f| = 0.
        let labels = [(0, 3.5), (1, 3.3), (2, 3.2)];
        let (median, _) = run(Aggregate::GeometricMedian { rounds: 500 }, &tables, &labels);
        let mut slope = [0.0f32; 3];
        for (s, w) in labels {
            let d: Vec<f32> = median.iter().zip(tables.row(s)).map(|(m, f)| m - f).collect();
            let norm = d.iter().map(|d| d * d).sum::<f32>().sqrt();
            slope.iter_mut().zip(&d).for_each(|(s, d)| *s += w * d / norm);
        }
        assert!(slope.iter().all(|s| s.abs() < 2e-3), "{slope:?}");
    }

    #[test]
    fn eight_rounds_of_the_median_are_close_to_many() {
        use rand::{Rng, SeedableRng};
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(8);
        let rows: Vec<f32> = (0..30 * 64).map(|_| rng.random_range(-1.0f32..1.0)).collect();
        let tables = tables(&rows, 64);
        for _ in 0..50 {
            let label = |_| {
                let wrong = rng.random_range(0.0..1.0) < 0.2;
                (if wrong { rng.random_range(1..30) } else { 0 }, rng.random_range(0.1..1.0))
            };
            let labels: Vec<Label> = (0..30).map(label).collect();
            let (few, _) = run(Aggregate::MEDIAN, &tables, &labels);
            let (many, _) = run(Aggregate::GeometricMedian { rounds: 50 }, &tables, &labels);
            let (mut few, mut many) = (few, many);
            assert!(normalise(&mut few) && normalise(&mut many));
            assert!(1.0 - dot(&few, &many) < 1e-3, "{}", dot(&few, &many));
        }
    }

    #[test]
    fn the_heaviest_group_by_hand() {
        // 0 and 1 are alike, 2 is alone and the heaviest by itself.
        let rows = [1.0, 0.0, 0.95, 0.312_249_9, 0.0, 1.0];
        let tables = tables(&rows, 2);
        let labels = [(0, 2.0), (2, 3.0), (1, 2.0)];
        let (group, agreement) = run(Aggregate::HEAVIEST_GROUP, &tables, &labels);
        assert!((group[0] - 0.975).abs() < 1e-6 && (group[1] - 0.156_124_95).abs() < 1e-6);
        assert!(agreement < 0.9, "of all labels: {agreement}");
        // Of equal groups, that of the first label.
        let (group, _) = run(Aggregate::HEAVIEST_GROUP, &tables, &[(2, 1.0), (0, 1.0)]);
        assert_eq!(group, [0.0, 1.0]);
    }

    #[test]
    fn labels_that_cancel_out_are_no_feature() {
        let tables = tables(&[1.0, 0.5, -1.0, -0.5], 2);
        let (mut mean, agreement) = run(Aggregate::WeightedMean, &tables, &[(0, 1.0), (1, 1.0)]);
        assert!(!normalise(&mut mean) && mean == [0.0, 0.0] && agreement < 1e-6);
    }
}
