//! Which rows of two views are the same place.

use candle_core::Result;
use scenesplat_datasets::View;
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_models::Levels;

/// Places of the rows of one scale of a view, before augmentation.
pub(super) struct Places {
    /// Mean place of the Gaussians of each row, meters; NaN where none is known. `[M, 3]`
    pub coord: Vec<[f32; 3]>,
    /// Rows of each scene. `[B + 1]`
    pub offsets: Vec<usize>,
}

impl Places {
    /// Of scale `level`, rows as [`Levels::up_cast`] numbers them.
    pub fn new(view: &View, levels: &Levels, level: usize) -> Result<Self> {
        let offsets = match levels.encoder().get(level) {
            Some(level) => level.offsets.clone(),
            None => candle_core::bail!("up_cast: the network has no scale {level}"),
        };
        let count = offsets.last().copied().unwrap_or(0);
        let mut sums = vec![([0f64; 3], 0usize); count];
        for (row, place) in levels.rows_at(level)?.into_iter().zip(&view.origin) {
            if place.iter().all(|v| v.is_finite()) {
                let (sum, n) = &mut sums[row as usize];
                (0..3).for_each(|a| sum[a] += f64::from(place[a]));
                *n += 1;
            }
        }
        let mean = |(sum, n): ([f64; 3], usize)| match n {
            0 => [f32::NAN; 3],
            n => sum.map(|v| (v / n as f64) as f32),
        };
        Ok(Self { coord: sums.into_iter().map(mean).collect(), offsets })
    }
}

/// For each row of `from` the nearest row of `to` in the same scene, if it is nearer than
/// `max_distance`: rows of `from`, and their partners. Of equally near ones the first.
///
/// # Errors
/// If the views show different numbers of scenes.
pub(super) fn matched(
    from: &Places,
    to: &Places,
    max_distance: f64,
) -> Result<(Vec<u32>, Vec<u32>)> {
    if from.offsets.len() != to.offsets.len() {
        candle_core::bail!(
            "views of {} and {} scenes cannot be matched",
            from.offsets.len() - 1,
            to.offsets.len() - 1
        );
    }
    let (mut rows, mut partners) = (Vec::new(), Vec::new());
    for (from_rows, to_rows) in from.offsets.windows(2).zip(to.offsets.windows(2)) {
        let known = (to_rows[0]..to_rows[1]).filter(|&row| to.coord[row][0].is_finite());
        let tree = KdTree::of_rows(&to.coord, known).map_err(candle_core::Error::wrap)?;
        let queries = &from.coord[from_rows[0]..from_rows[1]];
        let nearest = tree.map_nearest(
            queries,
            1,
            || (),
            |(), _, near| {
                near.first()
                    .filter(|n| n.distance_squared < max_distance * max_distance)
                    .map(|n| n.row)
            },
        );
        for (row, partner) in (from_rows[0]..).zip(nearest) {
            if let Some(partner) = partner {
                rows.push(row as u32);
                partners.push(partner);
            }
        }
    }
    Ok((rows, partners))
}

/// For each row of scale `level` in one pass the row of the same cell in another pass over the same view:
/// rows of the one, and their partners.
///
/// # Errors
/// If there is no such scale, or the passes are of different rows.
pub(super) fn same_cells(
    one: &Levels,
    other: &Levels,
    level: usize,
) -> Result<(Vec<u32>, Vec<u32>)> {
    let (rows, others) = (one.rows_at(level)?, other.rows_at(level)?);
    let count = one.encoder()[level].feat.dim(0)?;
    if rows.len() != others.len() || count != other.encoder()[level].feat.dim(0)? {
        candle_core::bail!(
            "passes over {} and {} rows are of different views",
            rows.len(),
            others.len()
        );
    }
    let mut partners = vec![0; count];
    rows.into_iter().zip(others).for_each(|(row, other)| partners[row as usize] = other);
    Ok(((0..count as u32).collect(), partners))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(coord: &[[f32; 3]], offsets: &[usize]) -> Places {
        Places { coord: coord.to_vec(), offsets: offsets.to_vec() }
    }

    #[test]
    fn the_nearest_of_the_same_scene_within_reach() {
        let nan = [f32::NAN; 3];
        let from = places(&[[0.0; 3], [1.0, 0.0, 0.0], nan, [5.0, 0.0, 0.0]], &[0, 3, 4]);
        let to = places(
            &[[1.1, 0.0, 0.0], [0.05, 0.0, 0.0], nan, [0.0; 3], [5.2, 0.0, 0.0]],
            &[0, 3, 5],
        );
        assert_eq!(matched(&from, &to, 0.32).unwrap(), (vec![0, 1, 3], vec![1, 0, 4]));
        // Closer than the distance, not as far as it.
        assert_eq!(matched(&from, &to, 0.06).unwrap(), (vec![0], vec![1]));
        let none = places(&[], &[0, 0, 0]);
        assert_eq!(matched(&none, &to, 1.0).unwrap(), (vec![], vec![]));
        assert_eq!(matched(&from, &none, 1.0).unwrap(), (vec![], vec![]));
        assert!(matched(&from, &places(&[], &[0, 0]), 1.0).is_err());
    }
}
