//! Pieces of a class that hang together: rows in cells, cells joined to near cells.

use glam::{DVec3, Vec3};
use std::collections::HashMap;

/// Sets that grow together; the smallest member stands for a set.
#[derive(Debug)]
pub(crate) struct Joined(Vec<u32>);

impl Joined {
    pub(crate) fn new(len: usize) -> Self {
        Self((0..len as u32).collect())
    }

    pub(crate) fn root(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            let up = self.0[self.0[i as usize] as usize];
            self.0[i as usize] = up;
            i = up;
        }
        i
    }

    pub(crate) fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

/// Rows of one cell of a class.
struct Cell {
    at: [i32; 3],
    rows: std::ops::Range<usize>,
    center: DVec3,
}

/// Pieces of rows in which each cell is within `gap` meters of another. Cells whose mean features have a
/// cosine below `min_similarity` are not joined. Pieces come by their first row, rows rise.
///
/// `rows`: rising, of finite `coord` `[N, 3]`.
pub(crate) fn pieces(
    rows: &[u32],
    coord: &[[f32; 3]],
    gap: f64,
    similar: &dyn Fn(&[u32]) -> Option<Vec<f32>>,
    min_similarity: f32,
) -> Vec<Vec<u32>> {
    let (order, cells) = in_cells(rows, coord, gap / 2.0);
    let features: Vec<Option<Vec<f32>>> =
        cells.iter().map(|c| similar(&order[c.rows.clone()])).collect();
    let index: HashMap<[i32; 3], u32> = (0..).zip(&cells).map(|(i, c)| (c.at, i)).collect();
    let mut joined = Joined::new(cells.len());
    for (i, cell) in (0u32..).zip(&cells) {
        for step in forward_steps() {
            let at = [0, 1, 2].map(|a| cell.at[a].saturating_add(step[a]));
            let Some(&j) = index.get(&at) else { continue };
            if (cell.center - cells[j as usize].center).length_squared() > gap * gap {
                continue;
            }
            let agree = match (&features[i as usize], &features[j as usize]) {
                (Some(a), Some(b)) => {
                    a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>() >= min_similarity
                }
                _ => true,
            };
            if agree {
                joined.join(i, j);
            }
        }
    }
    let mut found: Vec<Vec<u32>> = Vec::new();
    let mut place: HashMap<u32, usize> = HashMap::new();
    for (i, cell) in (0u32..).zip(&cells) {
        let at = *place.entry(joined.root(i)).or_insert_with(|| {
            found.push(Vec::new());
            found.len() - 1
        });
        found[at].extend(&order[cell.rows.clone()]);
    }
    found.iter_mut().for_each(|rows| rows.sort_unstable());
    found.sort_unstable_by_key(|rows| rows.first().copied());
    found
}

/// The rows by the cells of this side that they are in, and these cells.
fn in_cells(rows: &[u32], coord: &[[f32; 3]], side: f64) -> (Vec<u32>, Vec<Cell>) {
    // Far strays would leave the range of i32; they only meet others as far out.
    let cell_of = |row: u32| {
        coord[row as usize].map(|v| (f64::from(v) / side).floor().clamp(-1e9, 1e9) as i32)
    };
    let mut sorted: Vec<([i32; 3], u32)> = rows.iter().map(|&row| (cell_of(row), row)).collect();
    sorted.sort_unstable();
    let mut start = 0;
    let cells = sorted.chunk_by(|a, b| a.0 == b.0).map(|together| {
        let rows = start..start + together.len();
        start = rows.end;
        let places = together.iter().map(|(_, row)| Vec3::from(coord[*row as usize]).as_dvec3());
        let center = places.fold(DVec3::ZERO, |sum, p| sum + p) / together.len() as f64;
        Cell { at: together[0].0, rows, center }
    });
    let cells = cells.collect();
    (sorted.iter().map(|(_, row)| *row).collect(), cells)
}

/// Each of some values once, sorted.
pub(crate) fn distinct<T: Ord>(values: impl Iterator<Item = T>) -> Vec<T> {
    let mut values: Vec<T> = values.collect();
    values.sort_unstable();
    values.dedup();
    values
}

/// Half of the steps to cells at most two away; the others are seen from the other side.
fn forward_steps() -> impl Iterator<Item = [i32; 3]> {
    (-2..=2)
        .flat_map(|x| (-2..=2).flat_map(move |y| (-2..=2).map(move |z| [x, y, z])))
        .filter(|step| *step > [0, 0, 0])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(xs: &[f32]) -> Vec<[f32; 3]> {
        xs.iter().map(|&x| [x, 0.0, 0.0]).collect()
    }

    #[test]
    fn what_is_near_is_one_piece() {
        let coord = line(&[0.0, 0.05, 0.1, 0.5, 0.55, -7.0]);
        let found = pieces(&[0, 1, 2, 3, 4, 5], &coord, 0.1, &|_| None, 0.0);
        assert_eq!(found, [vec![0, 1, 2], vec![3, 4], vec![5]]);
        assert_eq!(pieces(&[0, 1, 2, 3, 4, 5], &coord, 1.0, &|_| None, 0.0).len(), 2);
        assert!(pieces(&[], &coord, 0.1, &|_| None, 0.0).is_empty());
    }

    #[test]
    fn other_features_are_another_piece() {
        let coord = line(&[0.0, 0.06, 0.12, 0.18]);
        let feature =
            |rows: &[u32]| Some(if rows[0] < 2 { vec![1.0, 0.0] } else { vec![0.0, 1.0] });
        let rows = [0, 1, 2, 3];
        assert_eq!(pieces(&rows, &coord, 0.1, &feature, 0.5), [vec![0, 1], vec![2, 3]]);
        assert_eq!(pieces(&rows, &coord, 0.1, &feature, -1.0).len(), 1);
    }

    #[test]
    fn places_out_of_any_grid_do_no_harm() {
        let coord = line(&[3e38, 3e38, -3e38, 0.0]);
        assert_eq!(pieces(&[0, 1, 2, 3], &coord, 0.1, &|_| None, 0.0).len(), 3);
    }

    #[test]
    fn cells_are_joined_up_to_the_gap_and_not_beyond() {
        let found = |xs: &[f32], gap: f64| pieces(&[0, 1], &line(xs), gap, &|_| None, 0.0);
        // Two cells on in each case: 0.07, 0.13, 1.5 and 2.8 m apart.
        assert_eq!(found(&[0.04, 0.11], 0.1), [vec![0, 1]]);
        assert_eq!(found(&[0.01, 0.14], 0.1), [vec![0], vec![1]]);
        assert_eq!(found(&[0.5, 2.0], 2.0), [vec![0, 1]]);
        assert_eq!(found(&[0.1, 2.9], 2.0), [vec![0], vec![1]]);
    }

    #[test]
    fn cells_are_joined_in_space_whatever_the_order_of_rows() {
        // Two steps along each axis and along diagonals; 62 of 124 cells around are looked at, no two opposite.
        let steps: Vec<[i32; 3]> = forward_steps().collect();
        assert_eq!(steps.len(), 62);
        assert!(
            steps.iter().all(|s| !steps.contains(&s.map(|v| -v)) && s.iter().all(|v| v.abs() <= 2))
        );
        for offset in [[0.09, 0.0, 0.0], [0.0, -0.09, 0.0], [0.0, 0.0, 0.09], [-0.05, 0.05, 0.05]] {
            let coord = [[0.5, 0.5, 0.5], offset.map(|v: f32| 0.5 + v), [9.0, 9.0, 9.0]];
            assert_eq!(
                pieces(&[0, 1, 2], &coord, 0.1, &|_| None, 0.0),
                [vec![0, 1], vec![2]],
                "{offset:?}"
            );
        }
        // A cosine at the limit joins; without a feature anything does.
        let coord = line(&[0.0, 0.06]);
        let feature =
            |rows: &[u32]| Some(if rows[0] == 0 { vec![1.0, 0.0] } else { vec![0.5, 0.8] });
        let count = |least: f32| pieces(&[0, 1], &coord, 0.1, &feature, least).len();
        assert_eq!([count(0.5), count(0.51)], [1, 2]);
        let half = |rows: &[u32]| (rows[0] == 0).then(|| vec![1.0]);
        assert_eq!(pieces(&[0, 1], &coord, 0.1, &half, 1.0).len(), 1);
        // Pieces come by their first row; a center is the mean of its rows.
        let coord = line(&[5.0, 0.02, 5.01, 0.01]);
        assert_eq!(pieces(&[0, 1, 2, 3], &coord, 0.1, &|_| None, 0.0), [vec![0, 2], vec![1, 3]]);
        let (order, cells) = in_cells(&[0, 1, 2, 3], &coord, 0.5);
        assert_eq!(
            (order, cells[0].at, cells[1].at, cells[1].rows.clone()),
            (vec![1, 3, 0, 2], [0; 3], [10, 0, 0], 2..4)
        );
        assert!((cells[1].center - DVec3::new(5.005, 0.0, 0.0)).length() < 1e-6);
        let mut joined = Joined::new(6);
        [(4, 5), (3, 4), (5, 1)].into_iter().for_each(|(a, b)| joined.join(a, b));
        assert_eq!([0, 1, 2, 3, 4, 5].map(|i| joined.root(i)), [0, 1, 2, 1, 1, 1]);
    }
}
