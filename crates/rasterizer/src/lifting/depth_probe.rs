//! Whether to let only pixels of a Gaussian's own depth label it.

use super::disagreement::{Consensus, name_of, sampled};
use super::finalise::of_each_view;
use super::spool::{BlockWeights, SegmentWeight};
use super::tables::SegmentTables;
use super::vector::{Label, dot};
use super::{DepthTolerance, LabelledPicture, LiftError, LiftSettings, Lifter};
use crate::Gaussians;

/// How wrong labels have to be to be left out. In eight synthetic rooms it was 0.13 to 0.48, with no, a
/// fifth or two fifths of the segments wrong.
const MISLEADING: f64 = 0.1;
/// Least part of the labeled weight that has to agree: where most does not, the depth says little
/// (fog, fur, glass).
const LEAST_KEPT: f64 = 0.5;

/// Lifts some pictures twice, with all pixels and with those only whose depth agrees, and looks at the
/// labels that agreement would leave out.
///
/// What is behind a surface shines through it a little, and takes its name from every picture that
/// does not see it properly. Many pictures make the same mistake, so no rule that weighs labels
/// against each other finds it; the depth does.
#[derive(Debug)]
pub struct DepthProbe<'a> {
    /// All pixels as its first granularity, those that agree as its second.
    lifter: Lifter<'a>,
    tolerance: DepthTolerance,
    /// Labeled weight of either.
    labelled: [f64; 2],
}

/// What depth agreement would leave out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthEffect {
    /// How much farther labels of pictures whose depth disagrees are from the consensus of those whose
    /// depth agrees than one of these is from the rest; 0: no farther, 1: as far as labels drawn by
    /// lot. Wrong names, which fall on both alike, hardly change it. `None` if nothing would be left
    /// out, or there is too little to say.
    pub misleading: Option<f64>,
    /// Gaussians that this was seen on.
    pub gaussians: u64,
    /// Part of the labeled weight that agrees, in `0..=1`.
    pub kept: f64,
}

impl DepthEffect {
    /// Depth agreement is worth it from this much on.
    pub const MISLEADING: f64 = MISLEADING;

    /// Whether depth agreement is worth a second pass over the pixels: what it leaves out is
    /// misleading by 0.1 or more, and at least half of the weight is kept.
    pub fn helps(&self) -> bool {
        self.misleading.is_some_and(|m| m >= MISLEADING) && self.kept >= LEAST_KEPT
    }
}

impl<'a> DepthProbe<'a> {
    /// As many pictures tell enough, if they are spread over all.
    pub const PICTURES: usize = 16;

    /// For features of `dim` values; `settings` are those of the lifting it is for. A tolerance that
    /// they lack is [`DepthTolerance::RENDERED`].
    ///
    /// # Errors
    /// As [`Lifter::new`].
    pub fn new(
        gaussians: &'a Gaussians,
        dim: usize,
        settings: &LiftSettings,
    ) -> Result<Self, LiftError> {
        let tolerance = settings.depth.unwrap_or(DepthTolerance::RENDERED);
        tolerance.check()?;
        let lifter = Lifter::new(gaussians, 2, dim, settings.clone())?;
        Ok(Self { lifter, tolerance, labelled: [0.0; 2] })
    }

    /// Adds a picture; of its granularities the first counts, and the depth is that of the scene.
    ///
    /// # Errors
    /// As [`Lifter::add`].
    pub fn add(&mut self, picture: &LabelledPicture<'_>) -> Result<(), LiftError> {
        let levels = &picture.levels[..picture.levels.len().min(1)];
        let picture = LabelledPicture { levels, ..*picture };
        let report = self.lifter.add_twice(&picture, self.tolerance)?;
        self.labelled.iter_mut().zip(report.labelled).for_each(|(sum, l)| *sum += l);
        Ok(())
    }

    /// Looks at the labels of about 20,000 Gaussians spread over the scene.
    ///
    /// # Errors
    /// If a file of weights cannot be read.
    pub fn effect(&mut self) -> Result<DepthEffect, LiftError> {
        let step = self.lifter.sampling_step();
        let mut sums = Sums::new(self.lifter.tables().dim());
        for block in 0..self.lifter.num_blocks() {
            let (all, agreeing) = (self.lifter.block(0, block)?, self.lifter.block(1, block)?);
            sums.add_block(&all, &agreeing, self.lifter.tables(), step);
        }
        let [all, kept] = self.labelled;
        Ok(DepthEffect {
            misleading: sums.misleading(),
            gaussians: sums.gaussians,
            kept: if all > 0.0 { kept / all } else { 0.0 },
        })
    }
}

/// Squared distances of labels that would be left out from the consensus of the others.
struct Sums {
    /// As they are.
    found: f64,
    /// As they would be if they were as good as the others.
    as_good: f64,
    /// As they would be if they were drawn by lot, but for the part that depends on `overall`.
    by_lot: f64,
    /// Means of the consensus, as often as something would be left out. `[D]`
    weighted_mean: Vec<f64>,
    weight: f64,
    /// Mean of all consensus, times their number. `[D]`
    overall: Vec<f64>,
    consensus: u64,
    gaussians: u64,
}

impl Sums {
    fn new(dim: usize) -> Self {
        Self {
            found: 0.0,
            as_good: 0.0,
            by_lot: 0.0,
            weighted_mean: vec![0.0; dim],
            weight: 0.0,
            overall: vec![0.0; dim],
            consensus: 0,
            gaussians: 0,
        }
    }

    /// Looks at every `step`-th Gaussian of a block.
    fn add_block(
        &mut self,
        all: &BlockWeights,
        agreeing: &BlockWeights,
        tables: &SegmentTables,
        step: usize,
    ) {
        let (mut kept, mut others): (Vec<Label>, Vec<Label>) = Default::default();
        let mut consensus = Consensus::new(self.overall.len());
        let mut mean = vec![0.0f32; self.overall.len()];
        for i in sampled(all, step) {
            kept.clear();
            kept.extend(of_each_view(agreeing.of(i), tables).map(name_of));
            if !consensus.find(&kept, tables) {
                continue;
            }
            self.consensus += 1;
            self.overall.iter_mut().zip(&consensus.mean).for_each(|(o, v)| *o += v);
            let before = self.weight;
            for view in of_each_view(all.of(i), tables) {
                let Some((segment, weight)) = left_out(view, agreeing.of(i)) else { continue };
                // A picture is no witness of itself.
                let picture = tables.segments_of(tables.view_of(segment));
                others.clear();
                others.extend(kept.iter().filter(|(segment, _)| !picture.contains(segment)));
                if consensus.find(&others, tables) {
                    mean.iter_mut().zip(&consensus.mean).for_each(|(m, &v)| *m = v as f32);
                    let along = f64::from(dot(tables.row(segment), &mean));
                    self.add(f64::from(weight), along, &consensus);
                }
            }
            self.gaussians += u64::from(self.weight > before);
        }
    }

    /// A label that would be left out, with its length along the consensus.
    fn add(&mut self, weight: f64, along: f64, consensus: &Consensus) {
        self.found += weight * (1.0 - 2.0 * along + consensus.length);
        self.as_good += weight * consensus.variance * (1.0 + consensus.of_mean);
        self.by_lot += weight * (1.0 + consensus.length);
        self.weighted_mean.iter_mut().zip(&consensus.mean).for_each(|(m, v)| *m += weight * v);
        self.weight += weight;
    }

    fn misleading(&self) -> Option<f64> {
        let along: f64 = self.weighted_mean.iter().zip(&self.overall).map(|(a, b)| a * b).sum();
        let by_lot = self.by_lot - 2.0 * along / self.consensus.max(1) as f64;
        let range = by_lot - self.as_good;
        // Without a range, all labels are alike, or all are drawn by lot.
        (range > 0.02 * self.weight).then(|| (self.found - self.as_good) / range)
    }
}

/// The heaviest segment of what a picture says of a Gaussian at another depth. `agreeing`: the weights of
/// the same Gaussian that agree, of all pictures.
fn left_out(view: &[SegmentWeight], agreeing: &[SegmentWeight]) -> Option<Label> {
    let all: f32 = view.iter().map(|w| w.weight).sum();
    let rest = |w: &SegmentWeight| {
        let same = agreeing.iter().find(|a| a.segment == w.segment);
        SegmentWeight { weight: w.weight - same.map_or(0.0, |a| a.weight), ..*w }
    };
    let rest: Vec<SegmentWeight> = view.iter().map(rest).collect();
    // Less is rounding.
    Some(name_of(&rest)).filter(|(_, root)| root * root > 1e-4 * all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const DIM: usize = 16;
    const OBJECTS: u32 = 8;

    /// 4,000 Gaussians of eight objects; each is named by six pictures whose depth agrees and by two
    /// whose depth does not: `wrong` of all names are drawn by lot, and `misled` of the latter.
    fn misleading(wrong: f64, misled: f64) -> Option<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let rows: Vec<f32> =
            (0..OBJECTS as usize * DIM).map(|_| rng.random_range(-1.0f32..1.0) + 0.4).collect();
        let mut tables = SegmentTables::new(DIM);
        for _ in 0..8 {
            tables.push(&rows).unwrap();
        }
        let (mut all, mut agreeing) = (BlockWeights::default(), BlockWeights::default());
        for block in [&mut all, &mut agreeing] {
            block.offsets.push(0);
        }
        for gaussian in 0..4000u32 {
            for view in 0..8 {
                let lot = if view < 6 { wrong } else { 1.0 - (1.0 - wrong) * (1.0 - misled) };
                let by_lot = rng.random_bool(lot);
                let object = if by_lot { rng.random_range(0..OBJECTS) } else { gaussian % OBJECTS };
                let weight = rng.random_range(0.1f32..4.0);
                let label = SegmentWeight { gaussian, segment: view * OBJECTS + object, weight };
                all.weights.push(label);
                if view < 6 {
                    agreeing.weights.push(label);
                }
            }
            all.offsets.push(all.weights.len());
            agreeing.offsets.push(agreeing.weights.len());
        }
        let mut sums = Sums::new(DIM);
        sums.add_block(&all, &agreeing, &tables, 1);
        assert_eq!(sums.gaussians, 4000);
        sums.misleading()
    }

    #[test]
    fn misled_labels_are_told_from_wrong_ones() {
        for wrong in [0.0, 0.2, 0.5] {
            for misled in [0.0, 0.3, 1.0] {
                let found = misleading(wrong, misled).unwrap();
                assert!((found - misled).abs() < 0.04, "{wrong} {misled}: {found}");
            }
        }
    }

    #[test]
    fn labels_drawn_by_lot_tell_nothing() {
        assert_eq!(misleading(1.0, 0.0), None);
        assert_eq!(Sums::new(DIM).misleading(), None);
    }
}
