//! Rows that repeat other rows.

use super::statistics::Counted;
use rayon::prelude::*;
use scenesplat_scene::GaussianScene;

/// Rows that stand a second time in the scene.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Duplicates {
    /// Rows equal to an earlier one in position, size, rotation, opacity and color.
    pub(super) whole: Counted,
    /// Rows at the very position of an earlier one, those of `whole` included.
    pub(super) position: Counted,
}

/// Finds repeated rows by their bits; −0 and 0 are different.
pub(super) fn find_duplicates(scene: &GaussianScene) -> Duplicates {
    // Rows of one position stand together after the sort.
    let mut keys: Vec<(u64, u32)> = (0..scene.len())
        .into_par_iter()
        .with_min_len(1 << 14)
        .map(|row| (position_key(scene, row), row as u32))
        .collect();
    keys.par_sort_unstable();
    let mut found = Duplicates::default();
    // Equal keys nearly always mean equal rows; a collision of 64 bits is checked, not trusted.
    let same_position = |a: &(u64, u32), b: &(u64, u32)| {
        a.0 == b.0 && bits(scene.coord[a.1 as usize]) == bits(scene.coord[b.1 as usize])
    };
    for place in keys.chunk_by(same_position).filter(|p| p.len() > 1) {
        found.position.add_repeats(place);
        let mut rows: Vec<(u64, u32)> =
            place.par_iter().map(|&(_, row)| (row_key(scene, row as usize), row)).collect();
        rows.par_sort_unstable();
        let same_row = |a: &(u64, u32), b: &(u64, u32)| {
            a.0 == b.0 && row_bits(scene, a.1 as usize) == row_bits(scene, b.1 as usize)
        };
        for equal in rows.chunk_by(same_row).filter(|e| e.len() > 1) {
            found.whole.add_repeats(equal);
        }
    }
    found
}

impl Counted {
    /// Counts all rows of a group but its smallest; the second smallest is the first repeat.
    fn add_repeats(&mut self, group: &[(u64, u32)]) {
        let (mut smallest, mut second) = (u32::MAX, u32::MAX);
        for &(_, row) in group {
            if row < smallest {
                (smallest, second) = (row, smallest);
            } else {
                second = second.min(row);
            }
        }
        self.count += group.len() - 1;
        let second = second as usize;
        self.first = Some(self.first.map_or(second, |first| first.min(second)));
    }
}

fn bits<const W: usize>(values: [f32; W]) -> [u32; W] {
    values.map(f32::to_bits)
}

fn row_bits(scene: &GaussianScene, row: usize) -> [u32; 14] {
    let mut out = [0; 14];
    out[..3].copy_from_slice(&bits(scene.coord[row]));
    out[3..6].copy_from_slice(&bits(scene.log_scale[row]));
    out[6..10].copy_from_slice(&bits(scene.quat[row]));
    out[10] = scene.opacity_logit[row].to_bits();
    out[11..].copy_from_slice(&bits(scene.sh_dc[row]));
    out
}

/// The position in one number: a mix in which no bit is lost to a neighbor's.
fn position_key(scene: &GaussianScene, row: usize) -> u64 {
    bits(scene.coord[row]).into_iter().fold(0, mix)
}

fn row_key(scene: &GaussianScene, row: usize) -> u64 {
    row_bits(scene, row)[3..].iter().copied().fold(0, mix)
}

/// A step of multiplication and folding, as in the finaliser of splitmix64.
fn mix(state: u64, value: u32) -> u64 {
    let mut z = (state ^ u64::from(value)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z ^= z >> 29;
    z = z.wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(n: usize) -> GaussianScene {
        GaussianScene {
            coord: (0..n).map(|i| [i as f32, 0.5, -1.0]).collect(),
            log_scale: vec![[-3.0; 3]; n],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logit: vec![1.0; n],
            sh_dc: vec![[0.1, 0.2, 0.3]; n],
            ..GaussianScene::default()
        }
    }

    #[test]
    fn repeats_are_counted_and_the_first_later_row_is_named() {
        assert_eq!(find_duplicates(&scene(1000)), Duplicates::default());
        let mut s = scene(1000);
        for (row, of) in [(990, 3), (500, 800), (700, 3)] {
            s.coord[row] = s.coord[of];
        }
        s.sh_dc[500][1] = 0.25;
        let found = find_duplicates(&s);
        // 500 and 800 stand in one place, in different colors.
        assert_eq!(found.position, Counted { count: 3, first: Some(700) });
        assert_eq!(found.whole, Counted { count: 2, first: Some(700) });
        let same = find_duplicates(&scene(5).select_rows(&[2; 64]).unwrap());
        assert_eq!(same.whole, Counted { count: 63, first: Some(1) });
    }

    #[test]
    fn nothing_and_one() {
        assert_eq!(find_duplicates(&scene(0)), Duplicates::default());
        assert_eq!(find_duplicates(&scene(1)), Duplicates::default());
    }
}
