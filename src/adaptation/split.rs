//! Which labels are held out: whole pieces of space, so that no neighbor gives the answer away.

use rand_chacha::rand_core::RngCore;
use scenesplat_datasets::sample_rng;
use std::collections::HashMap;

/// Edge of the cubes that are learned from or held out, meters.
const EDGE: f32 = 0.5;

/// Whether each label is held out: about `share` of the cubes of half a meter are, drawn by `seed`. What has no label is not. `[N]`
///
/// `coord`: positions, meters. `[N, 3]`
pub fn held_out(coord: &[[f32; 3]], labels: &[i32], share: f64, seed: u64) -> Vec<bool> {
    let mut drawn: HashMap<[i32; 3], bool> = HashMap::new();
    let mut is_out = |at: &[f32; 3]| {
        let cube = at.map(|v| (v / EDGE).floor() as i32);
        *drawn.entry(cube).or_insert_with(|| {
            let [x, y, z] = cube.map(|v| u64::from(v as u32));
            let draw = sample_rng(seed, x << 32 | y, z).next_u64();
            // 53 bits, as many as a float holds.
            ((draw >> 11) as f64) < share * 2f64.powi(53)
        })
    };
    coord.iter().zip(labels).map(|(at, label)| *label >= 0 && is_out(at)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_cubes_are_held_out() {
        let coord: Vec<[f32; 3]> = (0..40_000)
            .map(|i| [(i % 200) as f32 * 0.05, (i / 200) as f32 * 0.05 - 5.0, 0.1])
            .collect();
        let mut labels = vec![3; coord.len()];
        labels[7] = -1;
        let out = held_out(&coord, &labels, 0.2, 1);
        let share = out.iter().filter(|is| **is).count() as f64 / out.len() as f64;
        assert!((0.12..0.28).contains(&share), "{share}");
        let mut of_cube: HashMap<[i32; 2], bool> = HashMap::new();
        for (row, at) in coord.iter().enumerate().filter(|(row, _)| *row != 7) {
            let cube = [(at[0] / EDGE).floor() as i32, (at[1] / EDGE).floor() as i32];
            assert_eq!(*of_cube.entry(cube).or_insert(out[row]), out[row], "{row}");
        }
        assert!(of_cube.values().any(|is| *is) && of_cube.values().any(|is| !*is));
        assert_eq!(held_out(&coord, &labels, 0.2, 1), out);
        assert_ne!(held_out(&coord, &labels, 0.2, 2), out);
        assert!(!held_out(&coord, &labels, 0.0, 1).contains(&true));
        let all = held_out(&coord, &labels, 1.0, 1);
        assert_eq!(all.iter().filter(|is| !**is).count(), 1, "what has no label is not held out");
    }
}
