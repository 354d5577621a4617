//! Small regions of a mask's logits: holes filled, sprinkles removed.

/// Fills holes of at most `most` pixels and removes sprinkles of at most as many. What is changed becomes 10 above or
/// below the threshold 0. Pixels that touch at a corner belong together.
///
/// `logits`: `[side, side]`
pub(super) fn clean(logits: &mut [f32], side: usize, most: usize) {
    if most == 0 {
        return;
    }
    replace(logits, side, most, |v| v <= 0.0, 10.0);
    replace(logits, side, most, |v| v > 0.0, -10.0);
}

/// Sets all small regions of the pixels that `belongs` to a value.
fn replace(
    logits: &mut [f32],
    side: usize,
    most: usize,
    belongs: impl Fn(f32) -> bool,
    value: f32,
) {
    let mut open: Vec<bool> = logits.iter().map(|v| belongs(*v)).collect();
    let mut region = Vec::new();
    for start in 0..logits.len() {
        if !std::mem::take(&mut open[start]) {
            continue;
        }
        region.clear();
        region.push(start);
        let mut next = 0;
        while next < region.len() {
            let (y, x) = (region[next] / side, region[next] % side);
            next += 1;
            for v in y.saturating_sub(1)..=(y + 1).min(logits.len() / side - 1) {
                for u in x.saturating_sub(1)..=(x + 1).min(side - 1) {
                    if std::mem::take(&mut open[v * side + u]) {
                        region.push(v * side + u);
                    }
                }
            }
        }
        if region.len() <= most {
            region.iter().for_each(|pixel| logits[*pixel] = value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(rows: &[&str]) -> Vec<f32> {
        rows.iter().flat_map(|r| r.chars().map(|c| if c == '#' { 3.0 } else { -3.0 })).collect()
    }

    #[test]
    fn holes_and_sprinkles_by_hand() {
        let mut logits =
            picture(&["#####..", "#...#..", "#.#.#.#", "#...#..", "#####..", "......#", ".....#."]);
        clean(&mut logits, 7, 1);
        // The sprinkle inside and the lonely one go; the two that touch at a corner stay.
        let want =
            picture(&["#####..", "#...#..", "#...#..", "#...#..", "#####..", "......#", ".....#."]);
        let signs = |v: &[f32]| v.iter().map(|v| *v > 0.0).collect::<Vec<_>>();
        assert_eq!(signs(&logits), signs(&want));
        assert_eq!((logits[2 * 7 + 2], logits[2 * 7 + 6]), (-10.0, -10.0));
        // The hole of eight around it is one of nine now, and is filled by 9, not by 8.
        let mut eight = logits.clone();
        clean(&mut eight, 7, 8);
        assert!(eight[8] < 0.0 && eight[5 * 7 + 6] < 0.0);
        clean(&mut logits, 7, 9);
        assert_eq!(logits[8], 10.0);
        // A ring of eight around one: the hole is filled first, and nine are no sprinkle of eight.
        let mut ring = picture(&[".....", ".###.", ".#.#.", ".###.", "....."]);
        clean(&mut ring, 5, 8);
        assert_eq!(ring.iter().filter(|v| **v > 0.0).count(), 9);
        let mut same = picture(&["#.", ".."]);
        clean(&mut same, 2, 0);
        assert_eq!(same, picture(&["#.", ".."]));
    }

    #[test]
    fn a_logit_of_zero_is_outside_and_both_limits_are_the_same() {
        // One pixel of 0 in a square of 3: a hole, which becomes 10; what is not changed keeps its value.
        let mut hole = vec![2.0; 9];
        hole[4] = 0.0;
        clean(&mut hole, 3, 1);
        assert_eq!(hole, [2.0, 2.0, 2.0, 2.0, 10.0, 2.0, 2.0, 2.0, 2.0]);
        // A sprinkle of two in the corner of a square of 4 stays at 1 and goes at 2; the rest is larger.
        let mut two = vec![-0.5; 16];
        (two[11], two[15]) = (0.1, 4.0);
        let mut kept = two.clone();
        clean(&mut kept, 4, 1);
        assert_eq!(kept, two);
        clean(&mut two, 4, 2);
        let want: Vec<f32> =
            (0..16).map(|i| if i == 11 || i == 15 { -10.0 } else { -0.5 }).collect();
        assert_eq!(two, want);
    }
}
