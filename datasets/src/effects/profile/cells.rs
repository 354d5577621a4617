//! The cells that a plane is covered with.

use super::table::quantile_of;

/// Faint is what has less than this part of the median opacity of a scene.
pub const FAINT: f64 = 0.6;
/// Of eight directions, in so many the surface goes on around what is missing from it.
const AROUND: usize = 6;
/// A pane has so many cells with something faint in them, …
const FEWEST_FAINT: usize = 3;
/// … and this share of its cells: few of a pane's Gaussians are left.
const LEAST_FAINT: f64 = 0.3;
/// A cell is one of a wall from the mean opacity [`FAINT`] on, or from this on where the sum is less than …
const LESS_FAINT: f64 = 0.75;
/// … this part of …
const THIN: f64 = 0.2;
/// … what this share of the cells that hold something has at most.
const OF_WALL: f64 = 0.75;

/// Square cells of a rectangle.
pub(super) struct Cells {
    /// Corner of the first, in units of the scene.
    pub(super) low: [f64; 2],
    /// Side of a cell, in units of the scene.
    pub(super) edge: f64,
    /// How many there are along either axis.
    pub(super) count: [usize; 2],
}

impl Cells {
    pub(super) fn len(&self) -> usize {
        self.count[0] * self.count[1]
    }

    /// The cell that a point of the plane is in.
    pub(super) fn of(&self, p: [f64; 2]) -> Option<usize> {
        let at = [0, 1].map(|a| ((p[a] - self.low[a]) / self.edge).floor());
        let inside = (0..2).all(|a| at[a] >= 0.0 && at[a] < self.count[a] as f64);
        inside.then(|| at[0] as usize * self.count[1] + at[1] as usize)
    }

    /// The middle of a cell.
    pub(super) fn middle(&self, cell: usize) -> [f64; 2] {
        let at = [cell / self.count[1], cell % self.count[1]];
        [0, 1].map(|a| self.low[a] + (at[a] as f64 + 0.5) * self.edge)
    }

    /// Whether there are marked cells around a cell in nearly all directions.
    pub(super) fn is_amid(&self, is_marked: &[bool], cell: usize) -> bool {
        let steps = [[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]];
        let hits = |step: &[isize; 2]| {
            let mut at = [cell / self.count[1], cell % self.count[1]];
            loop {
                let next = [0, 1].map(|a| {
                    at[a].checked_add_signed(step[a]).filter(|next| *next < self.count[a])
                });
                let [Some(x), Some(y)] = next else { return false };
                at = [x, y];
                if is_marked[x * self.count[1] + y] {
                    return true;
                }
            }
        };
        steps.iter().filter(|step| hits(step)).count() >= AROUND
    }

    /// The cells of panes, by how many Gaussians there are in each and the sum of their opacities over the median one:
    /// those that are empty or faint amid solid ones, where enough of them, taken together with their neighbors,
    /// hold something. A hole has nothing in it.
    pub(super) fn panes(&self, here: &[(u32, f64)]) -> Vec<bool> {
        // The mean: the edge of a shelf before it makes no wall of a pane, and the clearest of a wall no pane. Where all of a
        // scene is clear a pane is not much clearer, but there is less of it.
        let sums = here.iter().map(|(_, sum)| *sum).filter(|sum| *sum > 0.0);
        let usual = quantile_of(sums, OF_WALL).unwrap_or(0.0);
        let is_solid = |&(n, sum): &(u32, f64)| {
            let mean = sum / f64::from(n);
            n > 0 && mean >= FAINT && !(mean < LESS_FAINT && sum < THIN * usual)
        };
        let is_solid: Vec<bool> = here.iter().map(is_solid).collect();
        let is_open: Vec<bool> =
            (0..self.len()).map(|c| !is_solid[c] && self.is_amid(&is_solid, c)).collect();
        let (mut is_pane, mut is_seen) = (vec![false; self.len()], vec![false; self.len()]);
        for start in 0..self.len() {
            if !is_open[start] || is_seen[start] {
                continue;
            }
            is_seen[start] = true;
            let mut together = vec![start];
            let mut next = 0;
            while next < together.len() {
                let (x, y) = (together[next] / self.count[1], together[next] % self.count[1]);
                next += 1;
                for i in x.saturating_sub(1)..(x + 2).min(self.count[0]) {
                    for j in y.saturating_sub(1)..(y + 2).min(self.count[1]) {
                        let cell = i * self.count[1] + j;
                        if is_open[cell] && !is_seen[cell] {
                            is_seen[cell] = true;
                            together.push(cell);
                        }
                    }
                }
            }
            let with_faint = together.iter().filter(|&&c| here[c].0 > 0).count();
            if with_faint >= FEWEST_FAINT
                && with_faint as f64 >= LEAST_FAINT * together.len() as f64
            {
                together.iter().for_each(|&c| is_pane[c] = true);
            }
        }
        is_pane
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall of 12 × 12 cells: a pane of 4 × 4 with six faint cells, a hole of 3 × 3 with one, and what is open at
    /// the wall's end.
    #[test]
    fn panes_are_not_holes_and_not_where_a_wall_ends() {
        let cells = Cells { low: [0.0, 0.0], edge: 0.5, count: [12, 12] };
        let within = |c: usize, x: std::ops::Range<usize>, y: std::ops::Range<usize>| {
            x.contains(&(c / 12)) && y.contains(&(c % 12))
        };
        let of_pane = |c: usize| within(c, 1..5, 1..5);
        let solid = |c: usize| !of_pane(c) && !within(c, 7..10, 6..9) && !within(c, 11..12, 0..12);
        let mut here: Vec<(u32, f64)> =
            (0..144).map(|c| if solid(c) { (2, 2.1) } else { (0, 0.0) }).collect();
        let faint = [13, 15, 26, 28, 40, 52, 7 * 12 + 7, 11 * 12 + 3, 11 * 12 + 4, 11 * 12 + 5];
        faint.iter().for_each(|&c| here[c] = (3, 0.9));
        // Something solid among what is faint, and something faint of a wall.
        here[26] = (4, 1.9);
        here[6 * 12 + 6] = (4, 3.3);
        let found = cells.panes(&here);
        assert_eq!(found, (0..144).map(of_pane).collect::<Vec<_>>());
        // With two of them gone it is a hole, too.
        here[13] = (0, 0.0);
        here[15] = (0, 0.0);
        assert!(cells.panes(&here).iter().all(|is| !is));
        assert_eq!(cells.middle(13), [0.75, 0.75]);
        assert_eq!(cells.of([0.75, 0.75]), Some(13));
        assert_eq!(
            [cells.of([-0.1, 1.0]), cells.of([1.0, 6.0]), cells.of([f64::NAN; 2])],
            [None; 3]
        );
    }
}
