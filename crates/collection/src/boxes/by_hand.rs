//! Pieces of a picture and what is chosen of them, by hand.

use super::*;

/// A map of rows of ids, one letter a pixel: `a` is 0.
fn map(rows: &[&str]) -> SegmentMap {
    let ids = rows.iter().flat_map(|row| row.bytes().map(|id| u16::from(id - b'a'))).collect();
    SegmentMap::new(rows[0].len() as u32, rows.len() as u32, ids).unwrap()
}

/// Pieces that are surfaces, too.
fn parts(rows: &[&str], depth: Option<&[f32]>) -> Parts {
    Parts::of(&map(rows), &map(rows), depth)
}

#[test]
fn the_depth_of_a_piece_is_the_median_of_what_is_known() {
    let depth = [5.0, 1.0, 3.0, 9.0, 0.0, 4.0, f32::NAN, 2.0, f32::INFINITY, -1.0];
    let found = parts(&["aaabbbbbcc"], Some(&depth));
    // 1, 3, 5; then 2, 4, 9 of five; then nothing.
    assert_eq!(found.depth, [3.0, 4.0, f32::INFINITY]);
    assert_eq!((found.len(), &found.pixels[..]), (3, &[3, 5, 2][..]));
    // Of an even number the upper one of the middle.
    assert_eq!(parts(&["aaaa"], Some(&[7.0, 2.0, 1.0, 4.0])).depth, [4.0]);
    assert_eq!(parts(&["ab"], None).depth, [f32::INFINITY; 2]);
}

#[test]
fn pieces_hang_together_up_to_a_step_of_the_nearer_depth() {
    let joined = |rows: &[&str], depth: Option<&[f32]>| parts(rows, depth).joined[0] == [1];
    // Two pixels away from a border the depth counts, not beside it: 1 and 1.079 of 1, or 1.081.
    let smeared = |far: f32| [1.0, 9.0, 5.0, 7.0, 3.0, far];
    assert!(joined(&["aaabbb"], Some(&smeared(1.079))));
    assert!(!joined(&["aaabbb"], Some(&smeared(1.081))));
    // The same down the picture.
    let down = |far: f32| smeared(far).into_iter().flat_map(|z| [z, z]).collect::<Vec<_>>();
    let rows = ["aa", "aa", "aa", "bb", "bb", "bb"];
    assert!(joined(&rows, Some(&down(1.079))) && !joined(&rows, Some(&down(1.081))));
    // Where a piece is one pixel wide, its own depth counts.
    assert!(joined(&["abbb"], Some(&[1.0, 1.0, 9.0, 9.0])));
    // Without a depth on both sides nothing is between them; with one side only, for most of the border, they are apart.
    let half = |left: [f32; 3]| [left[0], 1.0, left[1], 1.0, left[2], 1.0];
    let rows = ["ab", "ab", "ab"];
    assert!(joined(&rows, Some(&half([1.0, 1.0, 0.0]))));
    assert!(!joined(&rows, Some(&half([1.0, 0.0, 0.0]))));
    assert!(joined(&rows, Some(&[0.0; 6])) && joined(&rows, None));
}

#[test]
fn depth_is_not_read_beyond_the_ends_of_a_row() {
    // Of a border of 4 places two are steps of 0.12: a mean of 0.06. What is two places before the second row's border is
    // the end of the first row, and would be a third step.
    let depth = [1.0, 1.0, 1.12, 1.12, 1.0, 1.0, 1.0, 1.0];
    assert_eq!(parts(&["aaaa", "abbb"], Some(&depth)).joined, [vec![1], vec![0]]);
    // One step of 0.2: 0.05. What is two places behind the first row's border is in the second row, and would be another.
    let depth = [1.0, 1.0, 1.0, 1.0, 1.0, 1.2, 1.0, 1.0];
    assert_eq!(parts(&["aaab", "bbbb"], Some(&depth)).joined, [vec![1], vec![0]]);
}

#[test]
fn a_piece_is_of_the_surface_that_it_shares_most_with() {
    // Of a two pixels are of either surface: the first. Of b one is of the first and two are of the second.
    let found = Parts::of(&map(&["aaaabbb"]), &map(&["bbaaabb"]), None);
    assert_eq!((&found.surface[..], &found.surface_pixels[..]), (&[0, 1][..], &[3, 4][..]));
}

/// Four pieces of 4 × 4 beside each other.
const ROW: [&str; 4] = ["aaaabbbbccccdddd"; 4];

#[test]
fn what_a_box_cuts_counts_for_its_surface() {
    // Half of b and of d, and all of c: 32 of the 64 pixels of one surface, of which c alone is inside.
    let whole = map(&["aaaaaaaaaaaaaaaa"; 4]);
    let found = Parts::of(&map(&ROW), &whole, None);
    assert_eq!(chosen(&found, &map(&ROW), [6.0, 0.0, 14.0, 4.0]), [2]);
    // With half a pixel less on one side it is less than a half, as middles of pixels count.
    assert_eq!(chosen(&found, &map(&ROW), [6.6, 0.0, 14.0, 4.0]), [0; 0]);
}

#[test]
fn of_the_pieces_in_a_box_the_nearest_group_is_the_thing() {
    let depth = |of: [f32; 4]| (0..64).map(|at| of[at % 16 / 4]).collect::<Vec<f32>>();
    let of = |depths: [f32; 4], area| {
        let found = parts(&ROW, Some(&depth(depths)));
        chosen(&found, &map(&ROW), area)
    };
    // 0.6 of a piece are enough: 12 of 16 pixels of b, and 8 of 16 of d, which are not.
    assert_eq!(of([9.0, 2.0, 2.0, 2.0], [5.0, 0.0, 14.0, 4.0]), [1, 2]);
    // What is twice as near counts twice: b and c lie alike in the box.
    assert_eq!(of([9.0, 2.0, 4.0, 9.0], [4.0, 0.0, 12.0, 4.0]), [1]);
    assert_eq!(of([9.0, 4.0, 2.0, 9.0], [4.0, 0.0, 12.0, 4.0]), [2]);
    // A piece of known depth comes before one of none, however little of the middle it fills.
    assert_eq!(of([2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 16.0, 4.0]), [0]);
    // A tenth of the box is filled at least: 16 pixels of 160, not of 162. A box may end outside of the picture.
    assert_eq!(of([2.0; 4], [-8.0, -16.0, 12.0, 4.0]), [0, 1, 2]);
    let few = |bottom: f32| of([2.0, 9.0, 9.0, 9.0], [0.0, 0.0, 4.0, bottom]);
    assert_eq!((few(40.0), few(40.5)), (vec![0], vec![]));
}
