//! Pieces that are too small for what they are taken for: a bed of a tenth of a square meter is none.

use super::{AgreeSettings, SceneSurfaces};
use crate::cells::{Joined, distinct};

/// How often small pieces are looked for: what took the label of a neighbor may have become one with another.
const ROUNDS: usize = 3;

/// Labels of cells (−1: none) in which no piece is smaller than its class may be, where a neighbor that is none such
/// has a share in it. `share`: of each cell. `[cells, classes]`
pub(super) fn relabel_small(
    labels: &mut [i32],
    share: &[f32],
    surfaces: &SceneSurfaces,
    settings: &AgreeSettings<'_>,
) {
    let classes = share.len() / labels.len().max(1);
    let least = |label: i32| {
        usize::try_from(label).ok().and_then(|c| settings.least_area.get(c)).copied().unwrap_or(0.0)
    };
    for _ in 0..ROUNDS {
        let (piece_of, beside) = beside_small(labels, surfaces, least);
        // Sums over pieces with a large neighbor, in the order of their first cell.
        let mut place = vec![None; labels.len()];
        let pieces: Vec<&[(u32, i32)]> = beside.chunk_by(|a, b| a.0 == b.0).collect();
        for (at, of_piece) in pieces.iter().enumerate() {
            place[of_piece[0].0 as usize] = Some(at);
        }
        let place_of = |cell: usize| place[piece_of[cell] as usize];
        let mut sums = vec![0.0; pieces.len() * classes];
        for cell in 0..labels.len() {
            if let Some(at) = place_of(cell) {
                let sum = &mut sums[at * classes..][..classes];
                let own = &share[cell * classes..][..classes];
                sum.iter_mut().zip(own).for_each(|(sum, p)| *sum += f64::from(*p));
            }
        }
        let becomes = |(at, of_piece): (usize, &&[(u32, i32)])| {
            let has = |label: i32| sums[at * classes..][..classes][label as usize];
            // Labels rise: of equal ones the smallest.
            let best = (of_piece.iter().map(|(_, label)| *label))
                .reduce(|best, label| if has(label) > has(best) { label } else { best });
            let own = has(labels[of_piece[0].0 as usize]);
            best.filter(|best| has(*best) >= settings.keep * own)
        };
        let becomes: Vec<Option<i32>> = pieces.iter().enumerate().map(becomes).collect();
        let mut is_done = true;
        for (cell, own) in labels.iter_mut().enumerate() {
            if let Some(label) = place_of(cell).and_then(|at| becomes[at]) {
                *own = label;
                is_done = false;
            }
        }
        if is_done {
            break;
        }
    }
}

/// The piece of each cell, and labels of large neighbors of each piece below the `least` area of its label, sorted.
fn beside_small(
    labels: &[i32],
    surfaces: &SceneSurfaces,
    least: impl Fn(i32) -> f64,
) -> (Vec<u32>, Vec<(u32, i32)>) {
    let mut joined = Joined::new(labels.len());
    for &[a, b] in &surfaces.touching {
        if labels[a as usize] >= 0 && labels[a as usize] == labels[b as usize] {
            joined.join(a, b);
        }
    }
    let piece_of: Vec<u32> = (0..labels.len() as u32).map(|cell| joined.root(cell)).collect();
    let mut area = vec![0.0; labels.len()];
    for (cell, &piece) in piece_of.iter().enumerate() {
        area[piece as usize] += f64::from(surfaces.area[cell]);
    }
    let is_small = |cell: u32| {
        let piece = piece_of[cell as usize] as usize;
        labels[piece] >= 0 && area[piece] < least(labels[piece])
    };
    let both_ways = surfaces.touching.iter().flat_map(|&[a, b]| [(a, b), (b, a)]);
    let beside = both_ways.filter(|&(small, large)| {
        let [a, b] = [small, large].map(|cell| labels[cell as usize]);
        a != b && a >= 0 && b >= 0 && is_small(small) && !is_small(large)
    });
    let beside =
        distinct(beside.map(|(small, large)| (piece_of[small as usize], labels[large as usize])));
    (piece_of, beside)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_of_a_piece_is_that_of_all_its_cells() {
        // A row of five cells; the third and the fourth are one piece.
        let labels = [0, 0, 1, 1, 0];
        let beside = |areas: [f32; 2], least: f64| {
            let surfaces = SceneSurfaces {
                scales: Vec::new(),
                cell_of: Vec::new(),
                area: vec![5.0, 5.0, areas[0], areas[1], 5.0],
                touching: vec![[0, 1], [1, 2], [2, 3], [3, 4]],
            };
            let least = |label: i32| if label == 1 { least } else { 0.0 };
            let (piece_of, beside) = beside_small(&labels, &surfaces, least);
            assert_eq!(piece_of, [0, 0, 2, 2, 4]);
            beside
        };
        // 0.1 and 2 are 2.1 square meters together, whichever comes first.
        assert!(beside([0.1, 2.0], 1.0).is_empty());
        assert_eq!(beside([2.0, 0.1], 3.0), [(2, 0)]);
        assert_eq!(beside([0.1, 2.0], 3.0), [(2, 0)]);
    }
}
