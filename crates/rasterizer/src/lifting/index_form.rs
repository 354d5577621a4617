//! Lifted labels in two bytes a Gaussian: the number of a cluster of segments, and one feature for each cluster.
//!
//! The idea is that of LightSplat: what is written and compared later grows with the things that pictures show, not with
//! Gaussians times the width of features. Segments of different pictures are of one cluster if they lie on the same
//! Gaussians and have like features; they are joined once, over all pictures.

use super::LiftError;
use super::disagreement::{name_of, sampled};
use super::finalise::{Seen, of_each_view};
use super::lifter::Lifter;
use super::spool::{BlockWeights, SegmentWeight};
use super::tables::SegmentTables;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};

/// What stands for no cluster.
pub const NO_CLUSTER: u16 = u16::MAX;
/// Most clusters: what two bytes tell apart beside [`NO_CLUSTER`].
pub const MAX_CLUSTERS: usize = NO_CLUSTER as usize;

/// Pictures, of those that show a Gaussian, that each of its pictures is compared with. All pairs would grow with the
/// square of the pictures; an object is seen by neighbors of neighbors.
const NEXT: usize = 4;

/// How segments are clustered, and which Gaussians get a cluster.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndexSettings {
    /// Segments of two pictures are joined if so much of what both pictures show of either lies in both (IoU over
    /// Gaussians). Above 0, at most 1. From above a half on, a segment has one partner in a picture at most; where any
    /// overlap counts, pictures that are cut differently chain everything into one cluster.
    pub overlap: f32,
    /// Least cosine of their features, and of the mean features of the clusters that they are in. In `-1..=1`.
    pub cosine: f32,
    /// Least sum of labeled weights, pixels, ≥ 0; Gaussians with less get no cluster.
    pub min_coverage: f32,
    /// Least part of the weight that lies in segments, in `0..=1`.
    pub min_labelled_share: f32,
}

impl Default for IndexSettings {
    /// An IoU of a half, features with a cosine of 0.8, whatever was seen.
    fn default() -> Self {
        Self { overlap: 0.5, cosine: 0.8, min_coverage: 0.0, min_labelled_share: 0.0 }
    }
}

impl IndexSettings {
    /// Checks that every number is in its range.
    ///
    /// # Errors
    /// Names the first that is not.
    pub fn check(&self) -> Result<(), LiftError> {
        let check = |field, value: f32, good: bool, range: &str| {
            let problem = format!("is {value}; it has to be {range}");
            if good { Ok(()) } else { Err(LiftError::argument(field, problem)) }
        };
        let (overlap, cosine) = (self.overlap, self.cosine);
        check("overlap", overlap, overlap > 0.0 && overlap <= 1.0, "above 0 and at most 1")?;
        check("cosine", cosine, (-1.0..=1.0).contains(&cosine), "from -1 to 1")?;
        let (least, share) = (self.min_coverage, self.min_labelled_share);
        check("coverage", least, least >= 0.0 && least.is_finite(), "finite, at least 0")?;
        check("labeled share", share, (0.0..=1.0).contains(&share), "from 0 to 1")
    }
}

/// Labels of all Gaussians in their index form.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct IndexedLabels {
    /// The cluster of each Gaussian, or [`NO_CLUSTER`]. `[N]`
    pub index: Vec<u16>,
    /// Unit features of the clusters, in the order of their first segment; each is that of a Gaussian. `[K, D]`
    pub features: Vec<f32>,
    /// Part of the labeled weight of each Gaussian that lies in segments of its cluster, `0..=1`; 0 without labels. `[N]`
    pub confidence: Vec<f32>,
    /// Pictures that saw the Gaussian in a segment. `[N]`
    pub views: Vec<u32>,
    /// Sum of the labeled weights over all pictures, pixels. `[N]`
    pub coverage: Vec<f32>,
}

impl Lifter<'_> {
    /// Makes the index form of a granularity: clusters its segments, and gives each Gaussian the cluster with the most
    /// weight on it, the one with the first segment of equal ones. A cluster's feature is the mean of those of its
    /// segments, by their weight on the Gaussians that have it.
    ///
    /// Overlaps are counted on about 20,000 Gaussians spread over the scene. The same bits for any memory limit and number of
    /// threads.
    ///
    /// # Errors
    /// If a setting is out of range, there is no such level, the file cannot be read, or there are more clusters than
    /// [`MAX_CLUSTERS`].
    pub fn indexed(
        &mut self,
        level: usize,
        settings: &IndexSettings,
    ) -> Result<IndexedLabels, LiftError> {
        settings.check()?;
        let step = self.sampling_step();
        let mut overlaps = Overlaps::default();
        for block in 0..self.num_blocks() {
            let weights = self.block(level, block)?;
            overlaps.add(&weights, self.tables(), step);
        }
        let cluster_of = overlaps.clusters(self.tables(), settings);
        let mut out = IndexedLabels::default();
        let mut chosen: Vec<Option<u32>> = Vec::with_capacity(self.num_gaussians());
        let mut weight_of = vec![0.0; cluster_of.len()];
        for block in 0..self.num_blocks() {
            let weights = self.block(level, block)?;
            let (tables, totals) = (self.tables(), self.totals(weights.first, weights.len()));
            let found: Vec<Choice> = (0..weights.len())
                .into_par_iter()
                .map(|i| Choice::of(weights.of(i), tables, totals[i], &cluster_of, settings))
                .collect();
            for (i, found) in found.into_iter().enumerate() {
                for w in weights.of(i) {
                    if found.cluster == Some(cluster_of[w.segment as usize]) {
                        weight_of[w.segment as usize] += f64::from(w.weight);
                    }
                }
                chosen.push(found.cluster);
                let confidence = self.confidence(weights.first + i, found.confidence);
                out.confidence.push(confidence);
                out.views.push(found.views);
                out.coverage.push(found.coverage);
            }
        }
        let mut is_used = vec![false; cluster_of.len()];
        chosen.iter().flatten().for_each(|&cluster| is_used[cluster as usize] = true);
        let number = numbered(&is_used)?;
        let number_of =
            |cluster: &Option<u32>| cluster.map_or(NO_CLUSTER, |cluster| number[cluster as usize]);
        out.index = chosen.iter().map(number_of).collect();
        out.features = features(&cluster_of, &number, &weight_of, self.tables());
        Ok(out)
    }
}

/// The numbers of clusters that are used, from 0; [`NO_CLUSTER`] for others.
fn numbered(is_used: &[bool]) -> Result<Vec<u16>, LiftError> {
    let count = is_used.iter().filter(|is| **is).count();
    if count > MAX_CLUSTERS {
        let problem = format!(
            "{count}, and an index of two bytes tells {MAX_CLUSTERS} apart; take the full form, fewer pictures or larger \
             segments"
        );
        return Err(LiftError::argument("clusters of segments", problem));
    }
    let mut next = 0;
    let number = is_used.iter().map(|is| {
        let own = if *is { next } else { NO_CLUSTER };
        next += u16::from(*is);
        own
    });
    Ok(number.collect())
}

/// Unit features of the numbered clusters. `[K, D]`
fn features(
    cluster_of: &[u32],
    number: &[u16],
    weight_of: &[f64],
    tables: &SegmentTables,
) -> Vec<f32> {
    let (dim, count) = (tables.dim(), number.iter().filter(|n| **n != NO_CLUSTER).count());
    let mut sums = vec![0.0_f64; count * dim];
    for (segment, (&cluster, &weight)) in cluster_of.iter().zip(weight_of).enumerate() {
        let number = number[cluster as usize];
        if number != NO_CLUSTER {
            let sum = &mut sums[usize::from(number) * dim..][..dim];
            let row = tables.row(segment as u32);
            sum.iter_mut().zip(row).for_each(|(sum, v)| *sum += weight * f64::from(*v));
        }
    }
    for sum in sums.chunks_exact_mut(dim) {
        let norm = sum.iter().map(|v| v * v).sum::<f64>().sqrt();
        let scale = if norm > 0.0 { 1.0 / norm } else { 0.0 };
        sum.iter_mut().for_each(|v| *v *= scale);
    }
    sums.into_iter().map(|v| v as f32).collect()
}

/// What a Gaussian gets.
struct Choice {
    cluster: Option<u32>,
    confidence: f32,
    views: u32,
    coverage: f32,
}

impl Choice {
    fn of(
        weights: &[SegmentWeight],
        tables: &SegmentTables,
        total: f64,
        cluster_of: &[u32],
        settings: &IndexSettings,
    ) -> Self {
        let mut labels = Vec::new();
        let seen = Seen::collect(weights, tables, 1.0, &mut labels);
        let mut sums: Vec<(u32, f64)> = Vec::new();
        for &(segment, weight) in &labels {
            let cluster = cluster_of[segment as usize];
            match sums.iter_mut().find(|(own, _)| *own == cluster) {
                Some((_, sum)) => *sum += f64::from(weight),
                None => sums.push((cluster, f64::from(weight))),
            }
        }
        let most = sums.into_iter().reduce(|most, next| {
            if next.1.total_cmp(&most.1).then(most.0.cmp(&next.0)).is_gt() { next } else { most }
        });
        let enough = seen.coverage >= f64::from(settings.min_coverage)
            && seen.coverage >= f64::from(settings.min_labelled_share) * total;
        Self {
            cluster: most.filter(|_| enough).map(|(cluster, _)| cluster),
            confidence: most.map_or(0.0, |(_, weight)| (weight / seen.coverage) as f32),
            views: seen.views,
            coverage: seen.coverage as f32,
        }
    }
}

/// On how many of the sampled Gaussians segments of two pictures lie both, the earlier one first.
#[derive(Default)]
struct Overlaps(HashMap<(u32, u32), u32>);

impl Overlaps {
    fn add(&mut self, block: &BlockWeights, tables: &SegmentTables, step: usize) {
        for i in sampled(block, step) {
            let names: Vec<u32> =
                of_each_view(block.of(i), tables).map(|view| name_of(view).0).collect();
            for (at, &a) in names.iter().enumerate() {
                for &b in names[at + 1..].iter().take(NEXT) {
                    *self.0.entry((a, b)).or_default() += 1;
                }
            }
        }
    }

    /// Segments that lie on each other, with their IoU: the largest first, then by segment.
    fn edges(&self, tables: &SegmentTables, least: f32) -> Vec<(f64, u32, u32)> {
        // How many of a segment's Gaussians another picture shows in a segment.
        let mut shown: HashMap<(u32, usize), u32> = HashMap::new();
        // Sums: in whatever order a hash map gives its pairs.
        self.0.iter().for_each(|(&(a, b), &count)| {
            *shown.entry((a, tables.view_of(b))).or_default() += count;
            *shown.entry((b, tables.view_of(a))).or_default() += count;
        });
        let overlap = |(&(a, b), &count): (&(u32, u32), &u32)| {
            let [of_a, of_b] = [shown[&(a, tables.view_of(b))], shown[&(b, tables.view_of(a))]];
            (f64::from(count) / f64::from(of_a + of_b - count), a, b)
        };
        let mut edges: Vec<_> =
            self.0.iter().map(overlap).filter(|edge| edge.0 >= f64::from(least)).collect();
        edges.sort_unstable_by(|x, y| y.0.total_cmp(&x.0).then((x.1, x.2).cmp(&(y.1, y.2))));
        edges
    }

    /// The cluster of each segment, named by its first one.
    fn clusters(&self, tables: &SegmentTables, settings: &IndexSettings) -> Vec<u32> {
        let mut clusters = Clusters {
            up: (0..tables.len() as u32).collect(),
            sums: BTreeMap::new(),
            tables,
            least: f64::from(settings.cosine),
        };
        for (_, a, b) in self.edges(tables, settings.overlap) {
            clusters.join(a, b);
        }
        (0..tables.len() as u32).map(|segment| clusters.root(segment)).collect()
    }
}

/// Clusters that grow.
struct Clusters<'a> {
    up: Vec<u32>,
    /// Sums of the features of clusters of several segments, by their first one.
    sums: BTreeMap<u32, Vec<f64>>,
    tables: &'a SegmentTables,
    /// Least cosine of what is joined.
    least: f64,
}

impl Clusters<'_> {
    fn root(&mut self, mut i: u32) -> u32 {
        while self.up[i as usize] != i {
            let up = self.up[self.up[i as usize] as usize];
            self.up[i as usize] = up;
            i = up;
        }
        i
    }

    /// Joins the clusters of two segments that lie on each other, if they are alike.
    fn join(&mut self, a: u32, b: u32) {
        let [x, y] = [a, b].map(|segment| self.segment(segment));
        if cosine(&x, &y) < self.least {
            return;
        }
        let (a, b) = (self.root(a), self.root(b));
        if a == b {
            return;
        }
        let [mut x, y] = [a.min(b), a.max(b)].map(|cluster| match self.sums.get(&cluster) {
            Some(sum) => sum.clone(),
            None => self.segment(cluster),
        });
        if cosine(&x, &y) < self.least {
            return;
        }
        x.iter_mut().zip(&y).for_each(|(x, y)| *x += y);
        self.sums.remove(&a.max(b));
        self.sums.insert(a.min(b), x);
        self.up[a.max(b) as usize] = a.min(b);
    }

    fn segment(&self, segment: u32) -> Vec<f64> {
        self.tables.row(segment).iter().map(|v| f64::from(*v)).collect()
    }
}

/// Of a row without a direction: 0.
fn cosine(x: &[f64], y: &[f64]) -> f64 {
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let lengths = (dot(x, x) * dot(y, y)).sqrt();
    if lengths > 0.0 { dot(x, y) / lengths } else { 0.0 }
}

#[cfg(test)]
mod by_hand;
