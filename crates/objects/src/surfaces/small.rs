//! Pieces that are too small for what they are taken for: a bed of a tenth of a square metre is none.

use super::{AgreeSettings, SceneSurfaces};
use crate::cells::Joined;

/// How often small pieces are looked for: what took the label of a neighbour may have become one with another.
const ROUNDS: usize = 3;

/// Labels of cells (−1: none) in which no piece is smaller than its class may be, where a neighbour that is none such
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
        // Labels of large neighbours, of each small piece.
        let mut beside: Vec<(u32, i32)> = Vec::new();
        for &[a, b] in &surfaces.touching {
            let of = |cell: u32| labels[cell as usize];
            if of(a) == of(b) || of(a) < 0 || of(b) < 0 {
                continue;
            }
            for (small, large) in [(a, b), (b, a)] {
                if is_small(small) && !is_small(large) {
                    beside.push((piece_of[small as usize], of(large)));
                }
            }
        }
        beside.sort_unstable();
        beside.dedup();
        // Sums over pieces with a large neighbour, in the order of their first cell.
        let mut place = vec![u32::MAX; labels.len()];
        let mut count = 0;
        for of_piece in beside.chunk_by(|a, b| a.0 == b.0) {
            place[of_piece[0].0 as usize] = count;
            count += 1;
        }
        let mut sums = vec![0.0; count as usize * classes];
        for (cell, &piece) in piece_of.iter().enumerate() {
            let at = place[piece as usize];
            if at != u32::MAX {
                let sum = &mut sums[at as usize * classes..][..classes];
                let own = &share[cell * classes..][..classes];
                sum.iter_mut().zip(own).for_each(|(sum, p)| *sum += f64::from(*p));
            }
        }
        let mut becomes = vec![-1; count as usize];
        for (at, of_piece) in beside.chunk_by(|a, b| a.0 == b.0).enumerate() {
            let sum = &sums[at * classes..][..classes];
            let has = |label: i32| sum[label as usize];
            // Labels rise: of equal ones the smallest.
            let best = (of_piece.iter().map(|(_, label)| *label))
                .reduce(|best, label| if has(label) > has(best) { label } else { best });
            let own = has(labels[of_piece[0].0 as usize]);
            becomes[at] = best.filter(|best| has(*best) >= settings.keep * own).unwrap_or(-1);
        }
        let mut is_done = true;
        for (cell, &piece) in piece_of.iter().enumerate() {
            let at = place[piece as usize];
            if at != u32::MAX && becomes[at as usize] >= 0 {
                labels[cell] = becomes[at as usize];
                is_done = false;
            }
        }
        if is_done {
            break;
        }
    }
}
