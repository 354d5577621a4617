//! One picture at another size.

/// How far the shape of a map may be from its picture's, as a share: sensors of depth and their color cameras differ
/// by rounding alone (640 × 480 beside 1296 × 968 by 0.4 %).
const SHAPE: f64 = 0.01;

/// Whether two sizes are those of one picture at two scales: both sides by one factor, to within a pixel of
/// rounding. Sides are not 0.
pub fn is_scaled(from: [u32; 2], to: [u32; 2]) -> bool {
    // A side of the smaller picture, scaled as the other side, was rounded to whole pixels.
    let (small, large) = if to[0] <= from[0] { (to, from) } else { (from, to) };
    let [small, large] = [small, large].map(|side| side.map(f64::from));
    let off = |a: usize, b: usize| (large[a] * small[b] / large[b] - small[a]).abs();
    off(0, 1).min(off(1, 0)) < 1.0
}

/// Whether a map of depths, ids or a mask of size `from` is of the same shape as a picture of size `to`: the ratio of
/// the sides by at most 1 %, or to within a pixel of rounding. Sides are not 0.
pub fn is_one_shape(from: [u32; 2], to: [u32; 2]) -> bool {
    let [from_ratio, to_ratio] = [from, to].map(|s| f64::from(s[0]) / f64::from(s[1]));
    (from_ratio / to_ratio - 1.0).abs() <= SHAPE || is_scaled(from, to)
}

/// A map of one value a pixel at the size of its picture: each pixel takes the value of the pixel that its center
/// falls into. `None` unless they are of [one shape](is_one_shape) and `values` has `from[0] · from[1]` values.
pub fn nearest<T: Copy>(values: Vec<T>, from: [u32; 2], to: [u32; 2]) -> Option<Vec<T>> {
    let pixels = (from[0] as usize).checked_mul(from[1] as usize);
    if pixels != Some(values.len()) || from.contains(&0) || to.contains(&0) {
        return None;
    }
    if from == to {
        return Some(values);
    }
    if !is_one_shape(from, to) {
        return None;
    }
    let place = |i: u32, side: usize| {
        // (i + ½) · from / to, in whole numbers; below `from` because i < to.
        ((2 * u64::from(i) + 1) * u64::from(from[side]) / (2 * u64::from(to[side]))) as usize
    };
    let columns: Vec<usize> = (0..to[0]).map(|x| place(x, 0)).collect();
    let mut out = Vec::with_capacity(to[0] as usize * to[1] as usize);
    for y in 0..to[1] {
        let row = &values[place(y, 1) * from[0] as usize..];
        out.extend(columns.iter().map(|x| row[*x]));
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_that_are_one() {
        // Sensors of depth beside their cameras: ScanNet, ARKit, iPhones; and rounding.
        for (map, picture) in [
            ([640, 480], [1296, 968]),
            ([256, 192], [1920, 1440]),
            ([256, 192], [640, 480]),
            ([40, 30], [81, 61]),
            ([7, 5], [3, 2]),
        ] {
            assert!(
                is_one_shape(map, picture) && is_one_shape(picture, map),
                "{map:?} {picture:?}"
            );
        }
        for (map, picture) in
            [([3, 2], [9, 2]), ([480, 640], [640, 480]), ([640, 480], [1920, 1080])]
        {
            assert!(
                !is_one_shape(map, picture) && !is_one_shape(picture, map),
                "{map:?} {picture:?}"
            );
        }
        assert!(!is_scaled([640, 480], [1296, 968]), "a picture and its camera may not differ so");
    }

    #[test]
    fn pixels_take_what_their_centers_fall_into() {
        let map: Vec<u8> = (0..6).collect();
        let twice = nearest(map.clone(), [3, 2], [6, 4]).unwrap();
        assert_eq!(twice[..12], [0, 0, 1, 1, 2, 2, 0, 0, 1, 1, 2, 2]);
        assert_eq!(twice[12..15], [3, 3, 4]);
        // Of two pixels among three the middle one is nearer to the second: its center is on its border.
        let corners = [0, 1, 1, 2, 3, 3, 2, 3, 3].to_vec();
        assert_eq!(nearest(vec![0, 1, 2, 3], [2, 2], [3, 3]), Some(corners));
        // Of four pixels the last, whose corner is the center.
        assert_eq!(nearest(twice, [6, 4], [3, 2]), Some(map.clone()));
        assert_eq!(nearest(map.clone(), [3, 2], [3, 2]), Some(map.clone()));
        for (from, to) in [([3, 2], [9, 2]), ([3, 3], [3, 3]), ([3, 2], [0, 0])] {
            assert_eq!(nearest(map.clone(), from, to), None);
        }
        assert_eq!(nearest(Vec::<u8>::new(), [0, 0], [0, 0]), None);
    }
}
