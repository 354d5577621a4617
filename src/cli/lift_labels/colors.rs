//! Features as colours while they stream by.

use crate::preview::UNLABELLED_COLOR;
use scenesplat_rasterizer::lifting::SegmentTables;

/// Segments that the directions are found from.
const SAMPLE: usize = 2000;
/// Rounds of the iteration; the picture needs no more.
const ROUNDS: usize = 30;

/// The three strongest directions of the segments' features, and what was projected on them.
pub(super) struct Colors {
    mean: Vec<f64>,
    directions: [Vec<f64>; 3],
    /// One row per Gaussian; none without a feature.
    projected: Vec<Option<[f32; 3]>>,
}

impl Colors {
    /// Finds the directions.
    pub(super) fn new(tables: &SegmentTables) -> Self {
        let step = tables.len().div_ceil(SAMPLE).max(1);
        let rows = || (0..tables.len()).step_by(step).map(|s| tables.row(s as u32));
        let (dim, count) = (tables.dim(), rows().count().max(1) as f64);
        let mut mean = vec![0.0; dim];
        rows().for_each(|r| mean.iter_mut().zip(r).for_each(|(m, v)| *m += f64::from(*v) / count));
        let mut directions: [Vec<f64>; 3] = std::array::from_fn(|k| {
            // A fixed start that is not orthogonal to anything likely.
            (0..dim).map(|i| ((i * (k + 2) + k) as f64 * 0.7).sin() + 0.01).collect()
        });
        for _ in 0..ROUNDS {
            for k in 0..3 {
                let mut next = vec![0.0; dim];
                for row in rows() {
                    let along = along(row, &mean, &directions[k]);
                    let centred = row.iter().zip(&mean).map(|(v, m)| f64::from(*v) - m);
                    next.iter_mut().zip(centred).for_each(|(n, v)| *n += along * v);
                }
                for done in &directions[..k] {
                    let dot: f64 = next.iter().zip(done).map(|(a, b)| a * b).sum();
                    next.iter_mut().zip(done).for_each(|(a, b)| *a -= dot * b);
                }
                let norm = next.iter().map(|v| v * v).sum::<f64>().sqrt();
                // Fewer directions than colours: the others stay grey.
                next.iter_mut().for_each(|v| *v = if norm > 1e-12 { *v / norm } else { 0.0 });
                directions[k] = next;
            }
        }
        Self { mean, directions, projected: Vec::new() }
    }

    /// Takes the feature of the next Gaussian.
    pub(super) fn push(&mut self, feature: Option<&[f32]>) {
        let project = |row: &[f32]| {
            [0, 1, 2].map(|k: usize| along(row, &self.mean, &self.directions[k]) as f32)
        };
        self.projected.push(feature.map(project));
    }

    /// Red, green and blue, each stretched over its 2–98 % range.
    pub(super) fn finish(self) -> Vec<[u8; 3]> {
        let ranges: [(f32, f32); 3] = std::array::from_fn(|axis| {
            let mut values: Vec<f32> = self.projected.iter().flatten().map(|p| p[axis]).collect();
            values.sort_by(f32::total_cmp);
            let at = |q: f64| values.get((values.len().saturating_sub(1) as f64 * q) as usize);
            (at(0.02).copied().unwrap_or(0.0), at(0.98).copied().unwrap_or(0.0))
        });
        let color = |p: &Option<[f32; 3]>| {
            p.map_or(UNLABELLED_COLOR, |p| {
                std::array::from_fn(|axis| {
                    let (low, high) = ranges[axis];
                    let t = if high > low { (p[axis] - low) / (high - low) } else { 0.5 };
                    (t.clamp(0.0, 1.0) * 255.0) as u8
                })
            })
        };
        self.projected.iter().map(color).collect()
    }
}

fn along(row: &[f32], mean: &[f64], direction: &[f64]) -> f64 {
    row.iter().zip(mean).zip(direction).map(|((v, m), d)| (f64::from(*v) - m) * d).sum()
}
