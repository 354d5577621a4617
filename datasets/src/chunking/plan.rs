//! Which Gaussians are in which chunk.

use super::ChunkSettings;
use crate::error::{check_finite, check_length};
use crate::rng::{Purpose, below, purpose_rng};
use crate::sample::bounds;
use crate::{DataError, SampleRng};
use scenesplat_kernels::grid_sample::{KeyOrder, voxel_groups};
use std::collections::BTreeMap;

/// One chunk.
#[derive(Debug, Clone, PartialEq)]
pub struct Chunk {
    /// Its Gaussians, in the order they are written in.
    pub rows: Vec<u32>,
    /// Its lowest corner in x and y, meters from the lowest corner of the scene.
    pub origin: [f64; 2],
}

/// The chunks of a scene, and what was left out.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ChunkPlan {
    /// Chunks to write, in the order of their numbers.
    pub chunks: Vec<Chunk>,
    /// The lowest corner of the scene, meters.
    pub corner: [f32; 3],
    /// Length of the scene along x and y, meters.
    pub extent: [f64; 2],
    /// Gaussians left after the sampling of cells.
    pub sampled: usize,
    /// Chunks left out because they hold too few Gaussians; those that hold none do not count.
    pub below_minimum: usize,
    /// Chunks left out because there are too many.
    pub beyond_limit: usize,
}

/// Cuts a scene.
///
/// Chunks begin at 0, stride, 2 · stride, … from the lowest corner, in x and in y, as long as they
/// are needed to reach the highest one; x goes slowest. A Gaussian belongs to a chunk if
/// `origin ≤ x < origin + range`, and the same in y. `scene` selects the random numbers, so that
/// scenes may be cut in any order.
///
/// # Shapes
/// - `coord`: `[N, 3]` meters, finite · `has_feature`: `[N]`
///
/// # Errors
/// If a setting is out of range, a coordinate is not finite, or the scene too wide for the cells.
///
/// # Source
/// `scripts/sampling_chunking_data_gs.py`, SceneSplat be9d5e1. Differs: a scene that is not longer
/// than `range - stride` is one chunk along that axis (there, it has none and is lost), and a Gaussian
/// that lies exactly where the last chunk would end gets one more (there, it is lost); `exact` loses
/// them.
pub fn plan_chunks(
    coord: &[[f32; 3]],
    has_feature: Option<&[bool]>,
    settings: &ChunkSettings,
    scene: u64,
) -> Result<ChunkPlan, DataError> {
    settings.check()?;
    check_finite("coord", coord)?;
    check_length("valid_feat_mask", coord.len(), has_feature.map_or(coord.len(), <[bool]>::len))?;
    let Some([corner, _]) = bounds(coord) else { return Ok(ChunkPlan::default()) };
    let local: Vec<[f32; 3]> =
        coord.iter().map(|c| std::array::from_fn(|a| c[a] - corner[a])).collect();
    let mut rng = purpose_rng(Purpose::Chunking, settings.seed, 0, scene);
    let rows = match settings.grid_size {
        Some(size) => sample_cells(&local, has_feature, size, &mut rng)?,
        None => (0..coord.len() as u32).collect(),
    };
    let mut extent = [0.0; 2];
    for &row in &rows {
        (0..2).for_each(|a| extent[a] = f64::max(extent[a], f64::from(local[row as usize][a])));
    }
    let counts: [usize; 2] = std::array::from_fn(|a| num_chunks(extent[a], a, settings));
    let mut found: BTreeMap<[usize; 2], Vec<u32>> = BTreeMap::new();
    for &row in &rows {
        let along = |a: usize| chunks_at(f64::from(local[row as usize][a]), a, counts[a], settings);
        for x in along(0) {
            for y in along(1) {
                found.entry([x, y]).or_default().push(row);
            }
        }
    }
    let mut chunks: Vec<Chunk> = found
        .into_iter()
        .map(|(at, rows)| Chunk {
            rows,
            origin: std::array::from_fn(|a| origin(at[a], a, settings)),
        })
        .collect();
    let mut beyond_limit = 0;
    if let Some(limit) = settings.max_chunks
        && chunks.len() > limit
    {
        beyond_limit = chunks.len() - limit;
        // Stable: of equally full ones the first stay.
        chunks.sort_by_key(|chunk| std::cmp::Reverse(chunk.rows.len()));
        chunks.truncate(limit);
    }
    let all = chunks.len();
    chunks.retain(|chunk| chunk.rows.len() >= settings.minimum_size);
    let below_minimum = all - chunks.len();
    Ok(ChunkPlan { chunks, corner, extent, sampled: rows.len(), below_minimum, beyond_limit })
}

/// One row of every cell: a random one of those with a feature, else the first; cells by their first
/// row.
fn sample_cells(
    local: &[[f32; 3]],
    has_feature: Option<&[bool]>,
    size: f64,
    rng: &mut SampleRng,
) -> Result<Vec<u32>, DataError> {
    let groups = voxel_groups(local, size, KeyOrder::Morton)?;
    let mut cells: Vec<usize> = (0..groups.num_voxels()).collect();
    cells.sort_unstable_by_key(|&cell| groups.rows_of(cell)[0]);
    let pick = |cell: usize| {
        let rows = groups.rows_of(cell);
        let Some(has) = has_feature else { return rows[0] };
        let with = || rows.iter().filter(|&&row| has[row as usize]);
        let count = with().count() as u32;
        let drawn = below(rng, count) as usize;
        with().nth(drawn).copied().unwrap_or(rows[0])
    };
    Ok(cells.into_iter().map(pick).collect())
}

/// How many chunks an axis has.
fn num_chunks(extent: f64, axis: usize, settings: &ChunkSettings) -> usize {
    let (range, stride) = (settings.range[axis], settings.stride[axis]);
    let beyond = (extent - range) / stride;
    if settings.exact {
        // The length of arange(0, extent + stride - range, stride).
        return ((extent + stride - range) / stride).ceil().max(0.0) as usize;
    }
    // Until one ends above the extent.
    if beyond >= 0.0 { (beyond as usize).saturating_add(2) } else { 1 }
}

fn origin(number: usize, axis: usize, settings: &ChunkSettings) -> f64 {
    number as f64 * settings.stride[axis]
}

/// The numbers of the chunks that hold a place along an axis.
fn chunks_at(
    place: f64,
    axis: usize,
    count: usize,
    settings: &ChunkSettings,
) -> impl Iterator<Item = usize> + use<> {
    let (range, stride) = (settings.range[axis], settings.stride[axis]);
    // Two more than rounding could miss; the condition itself decides.
    let first = ((place - range) / stride - 1.0).max(0.0) as usize;
    let last = ((place / stride).max(0.0) as usize).saturating_add(2).min(count);
    (first..last).filter(move |&number| {
        let origin = number as f64 * stride;
        origin <= place && place < origin + range
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::between;
    use crate::sample_rng;

    fn cloud(n: usize, size: [f64; 3], seed: u64) -> Vec<[f32; 3]> {
        let mut rng = sample_rng(seed, 0, 0);
        let from = [-4.0, 7.0, 1.0];
        let mut place = |a: usize| (from[a] + between(&mut rng, [0.0, size[a]])) as f32;
        (0..n).map(|_| std::array::from_fn(&mut place)).collect()
    }

    fn settings(grid_size: Option<f64>, minimum_size: usize) -> ChunkSettings {
        ChunkSettings { grid_size, minimum_size, ..ChunkSettings::default() }
    }

    #[test]
    fn chunks_are_where_and_what_a_search_of_all_rows_finds() {
        let coord = cloud(3000, [14.0, 7.5, 3.0], 1);
        let plan = plan_chunks(&coord, None, &settings(None, 100), 0).unwrap();
        // arange(0, 14 + 3 - 6, 3) and arange(0, 7.5 + 3 - 6, 3), less a little.
        let xs = [0.0, 3.0, 6.0, 9.0];
        let ys = [0.0, 3.0];
        let mut expected = Vec::new();
        for x in xs {
            for y in ys {
                let inside = |c: &[f32; 3]| {
                    let [u, v]: [f64; 2] =
                        std::array::from_fn(|a| f64::from(c[a] - plan.corner[a]));
                    x <= u && u < x + 6.0 && y <= v && v < y + 6.0
                };
                let rows = (0..3000_u32).filter(|&r| inside(&coord[r as usize])).collect();
                expected.push(Chunk { rows, origin: [x, y] });
            }
        }
        assert_eq!(plan.chunks, expected);
        assert_eq!((plan.sampled, plan.below_minimum, plan.beyond_limit), (3000, 0, 0));
    }

    #[test]
    fn small_scenes_are_one_chunk_and_in_the_original_none() {
        for size in [[2.0, 2.0, 1.0], [3.0, 9.0, 1.0], [0.0, 0.0, 0.0]] {
            let coord = cloud(500, size, 2);
            let plan = plan_chunks(&coord, None, &settings(None, 1), 0).unwrap();
            assert!(!plan.chunks.is_empty());
            let covered: std::collections::BTreeSet<u32> =
                plan.chunks.iter().flat_map(|c| c.rows.iter().copied()).collect();
            assert_eq!(covered.len(), 500, "no Gaussian is lost");
            let exact = ChunkSettings { exact: true, ..settings(None, 1) };
            assert!(plan_chunks(&coord, None, &exact, 0).unwrap().chunks.is_empty());
        }
        assert_eq!(plan_chunks(&[], None, &settings(None, 1), 0).unwrap(), ChunkPlan::default());
        let one = plan_chunks(&[[5.0; 3]], None, &settings(Some(0.01), 1), 0).unwrap();
        assert_eq!(one.chunks[0].rows, [0]);
    }

    #[test]
    fn limits_keep_the_fullest() {
        let coord = cloud(4000, [14.0, 14.0, 3.0], 3);
        let all = plan_chunks(&coord, None, &settings(None, 1), 0).unwrap();
        let mut sizes: Vec<usize> = all.chunks.iter().map(|c| c.rows.len()).collect();
        sizes.sort_unstable_by(|a, b| b.cmp(a));
        let limited = ChunkSettings { max_chunks: Some(3), ..settings(None, sizes[1]) };
        let plan = plan_chunks(&coord, None, &limited, 0).unwrap();
        let kept: Vec<usize> = plan.chunks.iter().map(|c| c.rows.len()).collect();
        assert_eq!(kept, sizes[..2]);
        assert_eq!((plan.beyond_limit, plan.below_minimum), (all.chunks.len() - 3, 1));
    }

    #[test]
    fn cells_prefer_what_has_a_feature() {
        // Three in one cell, two in the next; features of the second and third, and of none.
        let coord =
            [[0.001, 0.0, 0.0], [0.505; 3], [0.002, 0.0, 0.0], [0.004, 0.0, 0.0], [0.507; 3]];
        let has = [false, false, true, true, false];
        let rows = |seed| {
            let settings = ChunkSettings { seed, ..settings(Some(0.01), 1) };
            plan_chunks(&coord, Some(&has), &settings, 0).unwrap().chunks.remove(0).rows
        };
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..40 {
            let rows = rows(seed);
            assert_eq!((rows.len(), rows[1]), (2, 1), "cells by their first row");
            seen.insert(rows[0]);
        }
        assert_eq!(seen.into_iter().collect::<Vec<_>>(), [2, 3]);
        let plain = plan_chunks(&coord, None, &settings(Some(0.01), 1), 0).unwrap();
        assert_eq!(plain.chunks[0].rows, [0, 1]);
        assert!(plan_chunks(&coord, Some(&has[1..]), &settings(None, 1), 0).is_err());
    }

    #[test]
    fn a_far_outlier_costs_nothing() {
        let mut coord = cloud(1000, [5.0, 5.0, 1.0], 4);
        coord.push([1e6, 1e6, 0.0]);
        let plan = plan_chunks(&coord, None, &settings(None, 1), 0).unwrap();
        // Two along each axis hold the cloud, and the outlier is in two along each axis at most.
        let at: Vec<[f64; 2]> = plan.chunks.iter().map(|c| c.origin).collect();
        assert!((5..=8).contains(&at.len()), "{at:?} {:?}", plan.extent);
    }

    #[test]
    fn bad_input_is_named() {
        let refused = |settings: ChunkSettings| {
            plan_chunks(&[[0.0; 3]], None, &settings, 0).unwrap_err().to_string()
        };
        let base = ChunkSettings::default;
        assert!(refused(ChunkSettings { grid_size: Some(0.0), ..base() }).contains("grid_size"));
        assert!(refused(ChunkSettings { range: [6.0, -1.0], ..base() }).contains("range"));
        assert!(refused(ChunkSettings { stride: [7.0; 2], ..base() }).contains("stride"));
        assert!(refused(ChunkSettings { stride: [1e-3; 2], ..base() }).contains("stride"));
        assert!(refused(ChunkSettings { max_chunks: Some(0), ..base() }).contains("max_chunks"));
        let nan = plan_chunks(&[[0.0; 3], [f32::NAN; 3]], None, &base(), 0).unwrap_err();
        assert!(matches!(nan, DataError::NotFinite { row: 1, .. }));
    }

    #[test]
    fn names_of_folders() {
        assert_eq!(base_name(Some(0.01)), "train_grid1.0cm_chunk6x6_stride3x3");
        assert_eq!(base_name(Some(0.005)), "train_grid0.5cm_chunk6x6_stride3x3");
        assert_eq!(base_name(None), "train_chunk6x6_stride3x3");
        let half = ChunkSettings { range: [5.5, 6.0], ..settings(None, 1) };
        assert_eq!(half.folder_name("val"), "val_chunk5.5x6_stride3x3");
    }

    fn base_name(grid_size: Option<f64>) -> String {
        settings(grid_size, 1).folder_name("train")
    }
}
