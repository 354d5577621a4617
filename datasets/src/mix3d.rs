//! Mixing scenes: two scenes in one frame, so that a network cannot rely on context alone.

use crate::error::{bad_setting, require};
use crate::rng::below;
use crate::train_batch::{feature_width, fill_optional_arrays, join};
use crate::{DataError, Sample, SampleRng};
use std::collections::HashMap;

/// Merges neighboring samples in pairs: the first with the second, the third with the fourth; the
/// last of an odd number stays alone.
///
/// Scenes are merged where they are (both are centered, as a rule): cells of the second are moved by
/// a whole number of cells so that both scenes' cells count from the same corner. A cell that both
/// scenes have keeps one of the two Gaussians, by the toss of a coin for each cell. Instances of
/// the second scene are numbered after those of the first.
///
/// With `exact`, cells and instances stay as they are in each scene and both Gaussians of a cell
/// are kept.
///
/// # Errors
/// If a sample has no cells, or two have cells of different sizes or language features of
/// different widths.
///
/// # Source
/// `point_collate_fn` in `pointcept/datasets/utils.py`, SceneSplat be9d5e1. Differs: there the
/// cells of both scenes count from the scene's own corner, so cells do not fit the coordinates, and
/// cells that are there twice have results that depend on the order of threads (its sparse
/// convolution keeps one of the two at random). `exact` keeps the same rows; the network's kernel
/// maps then take the first of a cell as its neighbors' neighbor, which is one of the results the
/// original may give. Instances of two scenes may there share a number.
pub fn mix_pairs(
    samples: Vec<Sample>,
    exact: bool,
    rng: &mut SampleRng,
) -> Result<Vec<Sample>, DataError> {
    let mut mixed = Vec::with_capacity(samples.len().div_ceil(2));
    let mut samples = samples.into_iter();
    while let Some(first) = samples.next() {
        mixed.push(match samples.next() {
            Some(second) => merge(first, second, exact, rng)?,
            None => first,
        });
    }
    Ok(mixed)
}

fn merge(
    first: Sample,
    second: Sample,
    exact: bool,
    rng: &mut SampleRng,
) -> Result<Sample, DataError> {
    let mut pair = [first, second];
    for sample in &pair {
        check(sample).map_err(|error| error.in_scene(&sample.id))?;
    }
    let dim = feature_width(&pair)?;
    let [segment, instance, valid] = [
        pair.iter().any(|s| s.segment.is_some()),
        pair.iter().any(|s| s.instance.is_some()),
        dim.is_some() || pair.iter().any(|s| s.valid_feat.is_some()),
    ];
    for sample in &mut pair {
        fill_optional_arrays(sample, segment, instance, dim, valid);
    }
    // Normals cannot be made up.
    let normal = pair.iter().all(|s| s.normal.is_some());
    let [mut first, mut second] = pair;
    if !exact {
        align(&mut first, &mut second)?;
        renumber(&first, &mut second);
        let drop = doubles(&first, &second, rng);
        first.select_rows(&kept(first.len(), &drop[0]));
        second.select_rows(&kept(second.len(), &drop[1]));
    }
    first.id = format!("{} + {}", first.id, second.id);
    first.coord.append(&mut second.coord);
    first.color.append(&mut second.color);
    first.opacity.append(&mut second.opacity);
    first.scale.append(&mut second.scale);
    first.quat.append(&mut second.quat);
    first.grid_coord.append(&mut second.grid_coord);
    join(&mut first.normal, second.normal);
    if !normal {
        first.normal = None;
    }
    join(&mut first.segment, second.segment);
    join(&mut first.instance, second.instance);
    join(&mut first.valid_feat, second.valid_feat);
    if let (Some(all), Some(mut part)) = (&mut first.lang_feat, second.lang_feat) {
        all.values.append(&mut part.values);
    }
    // Points to evaluate on are of no use in a scene that never was.
    first.labelled_points = None;
    first.full = None;
    if !exact {
        shift_to_zero(&mut first.grid_coord);
    }
    Ok(first)
}

fn check(sample: &Sample) -> Result<(), DataError> {
    sample.check()?;
    let (value, expected) = ("of scenes in several views", "0: two scenes share no view");
    require(sample.views.is_empty(), "mix_probability", value, expected)?;
    let sized = sample.grid_size.is_finite() && sample.grid_size > 0.0;
    if sample.is_empty() || (sized && sample.grid_coord.len() == sample.len()) {
        return Ok(());
    }
    Err(DataError::no_cells("mixing scenes"))
}

/// Moves the cells of the second sample into the frame of the first.
fn align(first: &mut Sample, second: &mut Sample) -> Result<(), DataError> {
    let (Some(a), Some(b)) = (corner(first), corner(second)) else { return Ok(()) };
    let expected = "the same cells in all scenes that are mixed";
    require(first.grid_size == second.grid_size, "grid_size", second.grid_size, expected)
        .map_err(|error| error.in_scene(&second.id))?;
    let shift: [f64; 3] =
        std::array::from_fn(|axis| ((b[axis] - a[axis]) / first.grid_size).round());
    // Cells have 21 bits; frames farther apart than that cannot be one grid.
    let fits = |s: f64| s.abs() < f64::from(1 << 22);
    if let Some(axis) = (0..3).find(|&axis| !fits(shift[axis])) {
        let expected = "scenes near each other: center them before they are mixed";
        let apart = format!("{} m apart", b[axis] - a[axis]);
        return Err(bad_setting("mix_probability", apart, expected).in_scene(&second.id));
    }
    for cell in &mut second.grid_coord {
        (0..3).for_each(|axis| cell[axis] += shift[axis] as i32);
    }
    Ok(())
}

/// Where the cell 0, 0, 0 has its lower corner, meters; `None` without Gaussians or cells.
///
/// Every Gaussian gives an upper bound of it, and with many the lowest of them is close.
fn corner(sample: &Sample) -> Option<[f64; 3]> {
    let rows = sample.coord.iter().zip(&sample.grid_coord);
    let bounds = rows.map(|(c, g)| -> [f64; 3] {
        std::array::from_fn(|axis| f64::from(c[axis]) - f64::from(g[axis]) * sample.grid_size)
    });
    bounds.reduce(|a, b| std::array::from_fn(|axis| a[axis].min(b[axis])))
}

/// Numbers the instances of the second sample after those of the first.
fn renumber(first: &Sample, second: &mut Sample) {
    let (Some(first), Some(second)) = (&first.instance, &mut second.instance) else { return };
    let Some(&last) = first.iter().max() else { return };
    let next = last.saturating_add(1).max(0);
    second.iter_mut().filter(|i| **i >= 0).for_each(|i| *i = i.saturating_add(next));
}

/// Rows to leave out so that no cell is there twice: of both samples, ascending.
fn doubles(first: &Sample, second: &Sample, rng: &mut SampleRng) -> [Vec<u32>; 2] {
    let mut owner: HashMap<[i32; 3], u32> = HashMap::with_capacity(first.len());
    let mut out = [Vec::new(), Vec::new()];
    for (row, cell) in (0_u32..).zip(&first.grid_coord) {
        owner.entry(*cell).or_insert(row);
    }
    for (row, cell) in (0_u32..).zip(&second.grid_coord) {
        if let Some(&other) = owner.get(cell) {
            let keeps_second = below(rng, 2) == 1;
            out[usize::from(!keeps_second)].push(if keeps_second { other } else { row });
        }
    }
    out[0].sort_unstable();
    out
}

/// The rows below `len` without those that are left out.
fn kept(len: usize, left_out: &[u32]) -> Vec<u32> {
    let mut left_out = left_out.iter().peekable();
    let out = |row: &u32| left_out.next_if_eq(&row).is_none();
    (0..len as u32).filter(out).collect()
}

fn shift_to_zero(cells: &mut [[i32; 3]]) {
    let Some(&first) = cells.first() else { return };
    let low =
        cells.iter().fold(first, |low, cell| std::array::from_fn(|axis| low[axis].min(cell[axis])));
    for cell in cells {
        (0..3).for_each(|axis| cell[axis] -= low[axis]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample_rng;
    use std::collections::BTreeSet;

    const G: f64 = 0.5;

    /// Gaussians in the middle of the given cells, whose count begins at `corner`.
    fn sample(id: &str, corner: [f32; 3], cells: &[[i32; 3]]) -> Sample {
        let n = cells.len();
        let middle = |cell: &[i32; 3]| {
            std::array::from_fn(|a| corner[a] + (cell[a] as f32 + 0.5) * G as f32)
        };
        Sample {
            id: id.to_owned(),
            coord: cells.iter().map(middle).collect(),
            color: vec![[1.0; 3]; n],
            opacity: vec![0.5; n],
            scale: vec![[0.1; 3]; n],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
            segment: Some((0..n as i32).collect()),
            instance: Some((0..n as i32).collect()),
            grid_coord: cells.to_vec(),
            grid_size: G,
            ..Sample::default()
        }
    }

    fn line(len: i32) -> Vec<[i32; 3]> {
        (0..len).map(|x| [x, 0, 0]).collect()
    }

    #[test]
    fn neighbours_become_pairs() {
        // Sizes of the merged scenes, as the original's offsets: 5 scenes give 3.
        for (counts, expected) in [
            (vec![2, 3, 4, 5], vec![5, 9]),
            (vec![2, 3], vec![5]),
            (vec![1, 2, 3], vec![3, 3]),
            (vec![1, 2, 3, 4, 5], vec![3, 7, 5]),
            (vec![4], vec![4]),
            (vec![], vec![]),
        ] {
            for exact in [false, true] {
                let far = |i: usize| [100.0 * i as f32, 0.0, 0.0];
                let samples: Vec<Sample> = counts
                    .iter()
                    .enumerate()
                    .map(|(i, &n)| sample("s", far(i), &line(n)))
                    .collect();
                let mixed = mix_pairs(samples, exact, &mut sample_rng(1, 0, 0)).unwrap();
                assert_eq!(mixed.len(), counts.len().div_ceil(2));
                let sizes: Vec<i32> = mixed.iter().map(|s| s.len() as i32).collect();
                assert_eq!(sizes, expected);
                mixed.iter().for_each(|s| s.check().unwrap());
            }
        }
    }

    #[test]
    fn a_cell_is_there_once_and_fits_its_coordinates() {
        // The second scene begins three cells before the first: cells 0 to 6 of it are shared.
        let a = sample("a", [0.0; 3], &line(10));
        let b = sample("b", [-1.5, 0.0, 0.0], &line(10));
        let mixed = mix_pairs(vec![a, b], false, &mut sample_rng(2, 0, 0)).unwrap().remove(0);
        mixed.check().unwrap();
        assert_eq!((mixed.id.as_str(), mixed.len()), ("a + b", 13));
        let cells: BTreeSet<[i32; 3]> = mixed.grid_coord.iter().copied().collect();
        assert_eq!(cells, line(13).into_iter().collect());
        for (coord, cell) in mixed.coord.iter().zip(&mixed.grid_coord) {
            assert_eq!(coord[0], -1.5 + (cell[0] as f32 + 0.5) * 0.5);
        }
        // Rows of the second scene are recognized by their instances.
        let of_b = mixed.instance.as_ref().unwrap().iter().filter(|&&i| i >= 10).count();
        assert!(
            (3..=10).contains(&of_b) && of_b != 3 && of_b != 10,
            "{of_b}: no coin is that fair"
        );
    }

    #[test]
    fn the_coin_is_seeded_and_fair() {
        let mixed = |seed| {
            let pair = vec![sample("a", [0.0; 3], &line(4000)), sample("b", [0.0; 3], &line(4000))];
            mix_pairs(pair, false, &mut sample_rng(seed, 0, 0)).unwrap().remove(0)
        };
        assert_eq!(mixed(1), mixed(1));
        assert_ne!(mixed(1).instance, mixed(2).instance);
        let of_b = mixed(1).instance.unwrap().iter().filter(|&&i| i >= 4000).count();
        // Five standard deviations of 4000 tosses are 158.
        assert!((1842..2158).contains(&of_b), "{of_b}");
    }

    #[test]
    fn exact_keeps_every_row_and_every_cell() {
        let a = sample("a", [0.0; 3], &line(3));
        let b = sample("b", [-7.0, 0.0, 0.0], &line(4));
        let mixed = mix_pairs(vec![a, b], true, &mut sample_rng(2, 0, 0)).unwrap().remove(0);
        assert_eq!(mixed.grid_coord, [line(3), line(4)].concat());
        assert_eq!(mixed.instance.unwrap(), [0, 1, 2, 0, 1, 2, 3]);
    }

    #[test]
    fn empty_and_incomplete_samples() {
        let mix = |pair| mix_pairs(pair, false, &mut sample_rng(1, 0, 0));
        let mixed = mix(vec![sample("a", [0.0; 3], &[]), sample("b", [0.0; 3], &line(2))]);
        assert_eq!(mixed.unwrap()[0].grid_coord, line(2));
        assert!(
            mix(vec![sample("a", [0.0; 3], &[]), sample("b", [0.0; 3], &[])]).unwrap()[0]
                .is_empty()
        );
        let mut no_cells = sample("b", [0.0; 3], &line(2));
        no_cells.grid_coord.clear();
        let error = mix(vec![sample("a", [0.0; 3], &line(2)), no_cells]).unwrap_err();
        assert!(matches!(&error, DataError::Sample { id, .. } if id == "b"), "{error}");
        let mut other = sample("b", [0.0; 3], &line(2));
        other.grid_size = 1.0;
        assert!(mix(vec![sample("a", [0.0; 3], &line(2)), other]).is_err());
        let far = sample("b", [1e9, 0.0, 0.0], &line(2));
        assert!(mix(vec![sample("a", [0.0; 3], &line(2)), far]).is_err());
        let mut bare = sample("b", [5.0, 0.0, 0.0], &line(2));
        (bare.segment, bare.instance) = (None, None);
        let mixed = mix(vec![sample("a", [0.0; 3], &line(1)), bare]).unwrap().remove(0);
        assert_eq!(mixed.segment.unwrap(), [0, -1, -1]);
        assert_eq!(mixed.instance.unwrap(), [0, -1, -1]);
    }
}
