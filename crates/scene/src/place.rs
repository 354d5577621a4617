//! Where a scene is: positions that lie far from 0 are kept relative to an origin.
//!
//! Surveys and tiles of maps have coordinates of millions of meters. f32 keeps those to half a meter,
//! while the same number of bits keeps every millimeter of a room about its own center. So readers
//! of files with doubles subtract an origin in f64 before anything becomes f32
//! ([`GaussianScene::origin`]), and writers add it again.

use crate::GaussianScene;
use crate::quantile::rank;
use rayon::prelude::*;

/// A scene is far when its center is more than this many of its sizes from 0. Nearer, f32 is exact to
/// about a millionth of the size, and positions are kept as they are.
const NEAR: f64 = 16.0;

/// Rows that decide; more would say the same.
const SAMPLE: usize = 1 << 16;

/// Share of the rows, at each end of an axis, that do not count for the size: so many may be stray.
const STRAY: f64 = 0.1;

/// The origin of scenes near 0.
pub(crate) const NO_ORIGIN: [f64; 3] = [0.0; 3];

/// Every so many rows of `rows` are enough to decide.
pub(crate) fn sample_step(rows: usize) -> usize {
    rows.div_ceil(SAMPLE).max(1)
}

/// Rows, spread evenly over `rows`, that are enough to decide.
pub(crate) fn sample_rows(rows: usize) -> impl Iterator<Item = usize> {
    (0..rows).step_by(sample_step(rows))
}

/// What to subtract from positions of which these are a sample: whole units near their center (in
/// scenes smaller than a unit, a short decimal fraction), 0 where they are not far. Positions that
/// are not finite or beyond the range of f32 do not count.
pub(crate) fn origin_of(sample: impl Iterator<Item = [f64; 3]>) -> [f64; 3] {
    let most = f64::from(f32::MAX);
    let mut axes: [Vec<f64>; 3] = Default::default();
    // NaN is not below anything.
    for p in sample.filter(|p| p.iter().all(|v| v.abs() <= most)) {
        axes.iter_mut().zip(p).for_each(|(axis, v)| axis.push(v));
    }
    if axes[0].is_empty() {
        return NO_ORIGIN;
    }
    axes.iter_mut().for_each(|axis| axis.sort_unstable_by(f64::total_cmp));
    let at = |axis: &[f64], share: f64| axis[rank(axis.len(), share)];
    let widest = |stray: f64| {
        axes.iter().map(|axis| at(axis, 1.0 - stray) - at(axis, stray)).fold(0.0, f64::max)
    };
    // Where most rows are in one place, the others say how large the scene is.
    let size = [STRAY, 0.0].into_iter().map(widest).find(|&size| size > 0.0);
    // A single place has no size; a unit is taken for it.
    let size = size.unwrap_or(1.0);
    let center = axes.each_ref().map(|axis| at(axis, 0.5));
    let distance = center.iter().map(|v| v * v).sum::<f64>().sqrt();
    if distance <= NEAR * size {
        return NO_ORIGIN;
    }
    // 1 for 2 m, 10 for 0.2 m: the number of steps in a unit.
    let steps = 10f64.powf((-size.log10()).ceil().clamp(0.0, 300.0));
    let short = center.map(|v| (v * steps).round() / steps + 0.0);
    if short.iter().all(|v| v.is_finite()) { short } else { center }
}

/// A position relative to `origin`, rounded once; beyond the range of f32 it is infinite.
pub(crate) fn less(position: [f64; 3], origin: [f64; 3]) -> [f32; 3] {
    [0, 1, 2].map(|i| (position[i] - origin[i]) as f32)
}

/// A position in the coordinates of the file.
pub(crate) fn plus(coord: [f32; 3], origin: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| f64::from(coord[i]) + origin[i])
}

/// The origin as messages say it: `(431000, 5411000, 230)`.
pub(crate) fn origin_text(origin: [f64; 3]) -> String {
    let [x, y, z] = origin;
    format!("({x}, {y}, {z})")
}

/// What reports say about positions that are kept relative to an origin.
pub(crate) fn origin_note(origin: [f64; 3]) -> Option<String> {
    (origin != NO_ORIGIN).then(|| {
        let about = origin_text(origin);
        format!("positions are about {about}: they are kept relative to that origin")
    })
}

impl GaussianScene {
    /// Whether positions are kept relative to an origin other than 0.
    pub fn has_origin(&self) -> bool {
        self.origin != NO_ORIGIN
    }

    /// The center of a Gaussian in the coordinates of the file: `coord + origin`.
    ///
    /// # Panics
    /// If there is no such row.
    pub fn position(&self, row: usize) -> [f64; 3] {
        plus(self.coord[row], self.origin)
    }

    /// Keeps positions, of Gaussians and labeled points, relative to another origin. They stay where
    /// they are but for the rounding of `coord`; with the same origin, bit for bit.
    pub fn move_origin(&mut self, origin: [f64; 3]) {
        if self.origin != origin {
            let from = self.origin;
            self.map_positions(origin, |p| plus(p, from));
        }
    }

    /// Gives every position another value, of which `origin` is subtracted before it is rounded.
    pub(crate) fn map_positions(
        &mut self,
        origin: [f64; 3],
        position: impl Fn([f32; 3]) -> [f64; 3] + Sync,
    ) {
        let moved = |p: &mut [f32; 3]| *p = less(position(*p), origin);
        self.coord.par_iter_mut().for_each(moved);
        if let Some(points) = &mut self.labelled_points {
            points.coord.par_iter_mut().for_each(moved);
        }
        self.origin = origin;
    }

    /// Some of the positions, in the coordinates of the file.
    pub(crate) fn sample_positions(&self) -> impl Iterator<Item = [f64; 3]> {
        sample_rows(self.len()).map(|row| self.position(row))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box of `size` with its center at `center`, `n` rows.
    fn rows(center: [f64; 3], size: f64, n: usize) -> Vec<[f64; 3]> {
        let part = |row: usize, k: usize| (row * k % n) as f64 / n as f64 - 0.5;
        (0..n).map(|i| [1, 3, 7].map(|k| size * part(i, k))).map(|p| add(p, center)).collect()
    }

    fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|i| a[i] + b[i])
    }

    fn origin(rows: Vec<[f64; 3]>) -> [f64; 3] {
        origin_of(rows.into_iter())
    }

    #[test]
    fn only_far_scenes_have_an_origin() {
        assert_eq!(origin(rows([0.0; 3], 10.0, 1000)), NO_ORIGIN);
        assert_eq!(origin(rows([100.0, 0.0, 0.0], 10.0, 1000)), NO_ORIGIN);
        let far = origin(rows([431_000.3, -5_411_000.2, 230.1], 10.0, 1000));
        assert_eq!(far, [431_000.0, -5_411_000.0, 230.0]);
        assert_eq!(origin(rows([1e9, 0.0, 0.0], 10.0, 1000)), [1e9, 0.0, 0.0]);
        // Half a centimeter, a meter away: whole units would be too coarse an origin.
        assert_eq!(origin(rows([1.2342, 0.0, 0.0], 0.005, 1000)), [1.234, 0.0, 0.0]);
    }

    #[test]
    fn stray_and_bad_rows_do_not_decide() {
        let mut near = rows([0.0; 3], 10.0, 1000);
        near.extend([[1e30, 0.0, 0.0]; 90]);
        assert_eq!(origin(near), NO_ORIGIN);
        let mut far = rows([500_000.0, 0.0, 0.0], 10.0, 1000);
        far.extend([[f64::NAN, 0.0, 0.0], [f64::INFINITY; 3], [1e300; 3], [0.0; 3]]);
        assert_eq!(origin(far), [500_000.0, 0.0, 0.0]);
        assert_eq!(origin(vec![[1e300, 0.0, 0.0]; 9]), NO_ORIGIN);
        assert_eq!(origin(vec![[f64::NAN; 3]; 9]), NO_ORIGIN);
    }

    #[test]
    fn few_rows_and_one_place() {
        assert_eq!(origin(Vec::new()), NO_ORIGIN);
        assert_eq!(origin(vec![[5.3, 0.0, 0.0]]), NO_ORIGIN);
        assert_eq!(origin(vec![[500_000.37, 0.0, 0.0]; 3]), [500_000.0, 0.0, 0.0]);
        // Most rows in one place: the size is that of the others.
        let mut clump = vec![[50.0, 0.0, 0.0]; 97];
        clump.extend([[0.0; 3], [40.0, 3.0, 0.0], [60.0, 0.0, 0.0]]);
        assert_eq!(origin(clump), NO_ORIGIN);
    }

    #[test]
    fn the_origin_is_the_same_after_rounding_about_it() {
        for center in [[431_000.3, 5_411_000.5, 230.1], [1e9, -7.5, 0.25]] {
            for size in [0.003, 0.7, 12.0, 3000.0] {
                let exact = rows(center, size, 999);
                let first = origin(exact.clone());
                let rounded = exact.into_iter().map(|p| plus(less(p, first), first)).collect();
                assert_eq!(origin(rounded), first, "{center:?} {size}");
            }
        }
    }

    #[test]
    fn moving_the_origin_there_and_back() {
        let mut scene =
            GaussianScene { coord: vec![[0.25, -1.5, 3.0]; 2], ..GaussianScene::default() };
        let before = scene.clone();
        scene.move_origin([100.0, 0.0, -7.0]);
        assert_eq!((scene.coord[0], scene.position(0)), ([-99.75, -1.5, 10.0], [0.25, -1.5, 3.0]));
        assert_ne!(scene, before);
        scene.move_origin(NO_ORIGIN);
        assert_eq!(scene, before);
    }
}
