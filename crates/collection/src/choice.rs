//! Which of many pictures are worth their time: those that show most that others do not, the sharp ones first.

/// Pictures before and behind that a picture's sharpness is compared with: those that show about the same.
const NEIGHBOURS: usize = 5;
/// Least a blurred picture counts: it may be the only one that shows something.
const LEAST: f64 = 0.05;

/// What a picture shows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Shown {
    /// Things that it shows, without repetition.
    pub things: Vec<u32>,
    /// How well, above 0 and at most 1.
    pub quality: f64,
}

/// Picks up to `count` pictures, each time the one that adds most: a thing counts 1 where no picked picture shows it,
/// ½ where one does, ¼ where two do, times the picture's quality. Pictures that show nothing are not picked.
///
/// Gives numbers in the order in which they were picked; of equals the first.
///
/// # Panics
/// If a thing is not below `things` (a bug of the caller).
pub fn choose_pictures(shown: &[Shown], things: usize, count: usize) -> Vec<usize> {
    let mut worth = vec![1.0f64; things];
    let mut left: Vec<usize> = (0..shown.len()).collect();
    let mut picked = Vec::new();
    while picked.len() < count {
        let gain = |i: usize| {
            let sum: f64 = shown[i].things.iter().map(|&t| worth[t as usize]).sum();
            sum * shown[i].quality
        };
        let mut best: Option<(usize, f64)> = None;
        for (place, &i) in left.iter().enumerate() {
            let gain = gain(i);
            if gain > best.map_or(0.0, |(_, g)| g) {
                best = Some((place, gain));
            }
        }
        let Some((place, _)) = best else { break };
        let i = left.remove(place);
        shown[i].things.iter().for_each(|&t| worth[t as usize] *= 0.5);
        picked.push(i);
    }
    picked
}

/// Sharpness of pictures of a walk, in its order, as a part of that of the sharpest of the five before and behind:
/// 0.05 to 1. `sharpness`: at least 0, any unit; what is not finite counts as 0.
pub fn relative_sharpness(sharpness: &[f64]) -> Vec<f64> {
    let clean = |i: usize| if sharpness[i].is_finite() { sharpness[i].max(0.0) } else { 0.0 };
    (0..sharpness.len())
        .map(|i| {
            let around = i.saturating_sub(NEIGHBOURS)..(i + NEIGHBOURS + 1).min(sharpness.len());
            let best = around.map(clean).fold(0.0, f64::max);
            if best > 0.0 { (clean(i) / best).max(LEAST) } else { 1.0 }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(things: &[u32], quality: f64) -> Shown {
        Shown { things: things.to_vec(), quality }
    }

    #[test]
    fn coverage_comes_first_and_sharpness_settles_what_shows_the_same() {
        let pictures = [
            shown(&[0, 1, 2, 3], 0.4),
            shown(&[0, 1, 2, 3], 1.0),
            shown(&[4], 1.0),
            shown(&[], 1.0),
            shown(&[0, 1, 2], 1.0),
        ];
        // 4 things at once; then 3 seen once count 1.5, a new one 1.
        assert_eq!(choose_pictures(&pictures, 5, 3), [1, 4, 2]);
        // Nothing is never picked.
        assert_eq!(choose_pictures(&pictures, 5, 9), [1, 4, 2, 0]);
        assert!(choose_pictures(&[], 5, 9).is_empty());
    }

    #[test]
    fn sharpness_is_that_among_neighbours() {
        let found = relative_sharpness(&[2.0, 1.0, f64::NAN, 4.0]);
        assert_eq!(found, [0.5, 0.25, 0.05, 1.0]);
        let mut walk = vec![1.0; 20];
        walk[0] = 10.0;
        let found = relative_sharpness(&walk);
        assert_eq!((found[5], found[6]), (0.1, 1.0));
        assert_eq!(relative_sharpness(&[0.0, 0.0]), [1.0, 1.0]);
    }

    #[test]
    fn sharpness_is_seen_from_five_pictures_away_and_no_further() {
        for sharpest in [0, 8, 16] {
            let mut sharpness = [1.0; 17];
            sharpness[sharpest] = 10.0;
            for (i, part) in relative_sharpness(&sharpness).into_iter().enumerate() {
                let near = i.abs_diff(sharpest) <= NEIGHBOURS && i != sharpest;
                assert_eq!(part, if near { 0.1 } else { 1.0 }, "{i} of {sharpest}");
            }
        }
    }

    #[test]
    fn a_blurred_picture_halves_the_worth_of_its_things_as_any_other() {
        let pictures = [shown(&[0, 1, 2, 3], 0.5), shown(&[0, 1], 0.9), shown(&[4], 1.0)];
        // First 4 · 0.5 = 2 against 2 · 0.9 and 1. Then things 0 and 1 count ½ each: (½ + ½) · 0.9 = 0.9 against 1.
        assert_eq!(choose_pictures(&pictures, 5, 3), [0, 2, 1]);
    }

    #[test]
    fn of_equal_pictures_the_first_is_picked_and_worth_halves_each_time() {
        let pictures = [shown(&[0], 0.5), shown(&[1], 0.5), shown(&[1, 2], 0.25), shown(&[0], 0.3)];
        // All but the last add 0.5. Then 1 adds 0.5 and 2 as much; after it 2 adds (½ + 1) / 4 and the last ½ · 0.3.
        assert_eq!(choose_pictures(&pictures, 3, 4), [0, 1, 2, 3]);
        assert_eq!(choose_pictures(&pictures, 3, 0), [0; 0]);
        // Of a thing that two have shown a quarter is left: 0.25 against 0.26 of a new one, 0.25 against 0.24.
        for (quality, third) in [(0.26, 3), (0.24, 2)] {
            let again =
                [shown(&[0], 1.0), shown(&[0], 1.0), shown(&[0], 1.0), shown(&[1], quality)];
            assert_eq!(choose_pictures(&again, 2, 3), [0, 1, third]);
        }
        assert_eq!(relative_sharpness(&[f64::INFINITY, -1.0, 4.0]), [0.05, 0.05, 1.0]);
    }
}
