//! Grid sampling against numbers from the original code and against a slow, obvious version.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat_kernels::grid_sample::{
    GridSampleError, KeyOrder, MAX_CELL, VoxelGroups, fnv_key, morton_key, ravel_key, voxel_groups,
};
use scenesplat_test_support::Golden;
use std::collections::BTreeMap;

const ORDERS: [KeyOrder; 3] = [KeyOrder::Fnv, KeyOrder::Ravel, KeyOrder::Morton];

fn open(case: &str) -> Option<Golden> {
    Golden::open(&format!("goldens/network/{case}.safetensors"))
}

/// The key of a cell among cells of such a shape.
fn key_of(order: KeyOrder, cell: [u32; 3], shape: [u64; 3]) -> u64 {
    match order {
        KeyOrder::Fnv => fnv_key(cell),
        KeyOrder::Ravel => ravel_key(cell, shape),
        KeyOrder::Morton => morton_key(cell),
    }
}

fn wide(values: &[u32]) -> Vec<i64> {
    values.iter().map(|&v| i64::from(v)).collect()
}

fn check_golden(case: &str, grid_size: f64, key_order: KeyOrder, differs_in_f32: usize) {
    let Some(golden) = open(case) else { return };
    let coord: Vec<[f32; 3]> = golden.rows("coord");
    assert_eq!(golden.f32s("grid_size"), [grid_size as f32]);
    let groups = voxel_groups(&coord, grid_size, key_order).unwrap();

    let flat: Vec<i64> = groups.grid_coord.iter().flatten().map(|&c| i64::from(c)).collect();
    assert_eq!(flat, golden.ints::<i64>("grid_coord_voxel"));
    let counts: Vec<i64> = groups.offsets.windows(2).map(|w| i64::from(w[1] - w[0])).collect();
    assert_eq!(counts, golden.ints::<i64>("count"));
    assert_eq!(wide(&groups.inverse), golden.ints::<i64>("inverse"));

    let cells: Vec<[i32; 3]> =
        groups.inverse.iter().map(|&v| groups.grid_coord[v as usize]).collect();
    let flat: Vec<i64> = cells.iter().flatten().map(|&c| i64::from(c)).collect();
    assert_eq!(flat, golden.ints::<i64>("grid_coord_point"));
    // The cells that f32 division would give are stored too: they must differ where the original
    // differs, or the test could not tell the two apart.
    let f32_cells = golden.ints::<i64>("grid_coord_point_f32div");
    let differing = flat.chunks(3).zip(f32_cells.chunks(3)).filter(|(a, b)| a != b).count();
    assert_eq!(differing, differs_in_f32);

    let shape = [0, 1, 2].map(|a| cells.iter().map(|c| c[a]).max().unwrap() as u64 + 1);
    let key = |c: &[i32; 3]| key_of(key_order, c.map(|c| c as u32), shape).cast_signed();
    let keys: Vec<i64> = cells.iter().map(key).collect();
    assert_eq!(keys, golden.ints::<i64>("hash_key"));

    let first = groups.first_rows();
    assert_eq!(wide(&first), golden.ints::<i64>("train.idx_first"));
    let drawn = groups.drawn_rows(&golden.ints("train.random_draws")).unwrap();
    assert_eq!(wide(&drawn), golden.ints::<i64>("train.idx_random"));
    let displacement: Vec<f32> = (0..groups.num_voxels())
        .flat_map(|v| groups.displacement(coord[first[v] as usize], v).map(|d| d as f32))
        .collect();
    assert_eq!(displacement, golden.f32s("displacement_first"));

    let fragments: Vec<i64> =
        (0..groups.largest_count()).flat_map(|f| wide(&groups.fragment_rows(f))).collect();
    assert_eq!(fragments, golden.ints::<i64>("test.fragment_index"));
    assert_eq!(
        golden.ints::<i64>("test.fragment_grid_coord0"),
        golden.ints::<i64>("grid_coord_voxel")
    );
}

#[test]
fn goldens() {
    for (case, grid_size, key_order, differs_in_f32) in [
        ("b_room_g0.02", 0.02, KeyOrder::Fnv, 0),
        ("b_room_g0.05", 0.05, KeyOrder::Fnv, 0),
        ("b_room_g0.1_ravel", 0.1, KeyOrder::Ravel, 0),
        ("b_boundary_g0.02", 0.02, KeyOrder::Fnv, 274),
        ("b_single", 0.02, KeyOrder::Fnv, 0),
        ("b_pc_g0.05", 0.05, KeyOrder::Fnv, 0),
    ] {
        check_golden(case, grid_size, key_order, differs_in_f32);
    }
}

#[test]
fn labelled_points() {
    let Some(golden) = open("b_pc_g0.05") else { return };
    let coord: Vec<[f32; 3]> = golden.rows("pc_coord");
    let segment: Vec<i32> = golden.ints("pc_segment");
    let groups = voxel_groups(&coord, 0.05, KeyOrder::Fnv).unwrap();
    let rows = groups.labelled_rows(&segment, -1).unwrap();
    let thinned: Vec<[f32; 3]> = rows.iter().map(|&r| coord[r as usize]).collect();
    assert_eq!(thinned, golden.rows::<3>("pc_coord_out"));
    let labels: Vec<i64> = rows.iter().map(|&r| i64::from(segment[r as usize])).collect();
    assert_eq!(labels, golden.ints::<i64>("pc_segment_out"));
}

/// Groups by a map from key and cell to rows.
fn slow_groups(
    coord: &[[f32; 3]],
    grid_size: f64,
    key_order: KeyOrder,
) -> BTreeMap<(u64, [u32; 3]), Vec<u32>> {
    let cells: Vec<[i64; 3]> =
        coord.iter().map(|c| c.map(|v| (f64::from(v) / grid_size).floor() as i64)).collect();
    let low = [0, 1, 2].map(|a| cells.iter().map(|c| c[a]).min().unwrap_or(0));
    let high = [0, 1, 2].map(|a| cells.iter().map(|c| c[a]).max().unwrap_or(0));
    let shape = [0, 1, 2].map(|a| (high[a] - low[a] + 1) as u64);
    let mut groups = BTreeMap::<_, Vec<u32>>::new();
    for (row, c) in cells.iter().enumerate() {
        let cell: [u32; 3] = std::array::from_fn(|a| (c[a] - low[a]) as u32);
        groups.entry((key_of(key_order, cell, shape), cell)).or_default().push(row as u32);
    }
    groups
}

fn assert_equals_slow(coord: &[[f32; 3]], grid_size: f64, key_order: KeyOrder) {
    let groups = voxel_groups(coord, grid_size, key_order).unwrap();
    let slow = slow_groups(coord, grid_size, key_order);
    assert_eq!(groups.num_voxels(), slow.len());
    for (voxel, ((_, cell), rows)) in slow.iter().enumerate() {
        assert_eq!(groups.rows_of(voxel), rows, "voxel {voxel} of {key_order:?}");
        assert_eq!(groups.grid_coord[voxel], cell.map(|c| c as i32));
        assert!(rows.iter().all(|&r| groups.inverse[r as usize] as usize == voxel));
    }
    assert_eq!(*groups.offsets.last().unwrap() as usize, coord.len());
    let nearest = groups.nearest_to_centre(coord).unwrap();
    for (voxel, rows) in slow.values().enumerate() {
        let distance = |row: u32| {
            let d = groups.displacement(coord[row as usize], voxel);
            d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        };
        let best = rows.iter().copied().min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        assert_eq!(Some(nearest[voxel]), best);
    }
}

fn cloud(seed: u64, rows: usize, extent: f32) -> Vec<[f32; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..rows).map(|_| std::array::from_fn(|_| (rng.random::<f32>() - 0.5) * extent)).collect()
}

#[test]
fn equals_the_slow_version() {
    for key_order in ORDERS {
        for (rows, extent) in [(0, 1.0), (1, 1.0), (2, 1.0), (2, 0.0), (500, 0.3), (4000, 3.0)] {
            assert_equals_slow(&cloud(rows as u64, rows, extent), 0.05, key_order);
        }
        // Rows beyond one parallel task.
        assert_equals_slow(&cloud(7, 50_000, 4.0), 0.1, key_order);
    }
}

#[test]
fn all_rows_in_one_voxel() {
    let coord = vec![[0.013, 0.013, 0.013]; 1000];
    for key_order in ORDERS {
        let groups = voxel_groups(&coord, 0.02, key_order).unwrap();
        assert_eq!(groups.num_voxels(), 1);
        assert_eq!(groups.largest_count(), 1000);
        assert_eq!(groups.nearest_to_centre(&coord).unwrap(), [0], "smallest row of equals");
        assert_eq!(groups.fragment_rows(999), [999]);
    }
}

#[test]
fn worked_example_of_the_specification() {
    let coord = [0.001_f32, 0.015, 0.021, -0.001, 0.0399].map(|x| [x, 0.0, 0.0]);
    let groups = voxel_groups(&coord, 0.02, KeyOrder::Fnv).unwrap();
    assert_eq!(groups.grid_coord.iter().map(|c| c[0]).collect::<Vec<_>>(), [2, 1, 0]);
    assert_eq!(groups.inverse, [1, 1, 0, 2, 0]);
    assert_eq!(groups.fragment_rows(0), [2, 0, 3]);
    assert_eq!(groups.fragment_rows(1), [4, 1, 3]);
}

#[test]
fn fragments_cover_every_row() {
    let coord = cloud(3, 3000, 0.6);
    let groups = voxel_groups(&coord, 0.05, KeyOrder::Morton).unwrap();
    let mut seen = vec![false; coord.len()];
    for fragment in 0..groups.largest_count() {
        for row in groups.fragment_rows(fragment) {
            seen[row as usize] = true;
        }
    }
    assert!(seen.iter().all(|&s| s));
}

#[test]
fn a_shift_by_whole_voxels_changes_nothing() {
    // A power of two keeps the shifted coordinates exact.
    let coord: Vec<[f32; 3]> =
        cloud(5, 2000, 2.0).into_iter().map(|c| c.map(|v| (v * 1024.0).round() / 1024.0)).collect();
    let moved: Vec<[f32; 3]> = coord.iter().map(|c| c.map(|v| v + 32.0)).collect();
    let at = |c: &[[f32; 3]]| voxel_groups(c, 0.0625, KeyOrder::Fnv).unwrap();
    let (a, b) = (at(&coord), at(&moved));
    assert_eq!((a.order, a.offsets, a.grid_coord), (b.order, b.offsets, b.grid_coord));
}

/// Two cells with one hash. They exist only when one axis is long: about 189 000 cells.
fn colliding_cells() -> [[u32; 3]; 2] {
    for y in 0..2000 {
        for other_y in 0..2000 {
            let difference = fnv_key([0, y, 0]) ^ fnv_key([1, other_y, 0]);
            if difference <= u64::from(MAX_CELL) {
                return [[0, y, 0], [1, other_y, difference as u32]];
            }
        }
    }
    panic!("no collision among these cells");
}

#[test]
fn colliding_hashes_do_not_merge_cells() {
    let [a, b] = colliding_cells();
    assert_eq!(fnv_key(a), fnv_key(b));
    let centre = |cell: [u32; 3]| cell.map(|c| c as f32 + 0.5);
    let coord = [[0.5; 3], centre(b), centre(a), centre(b), centre(a)];
    assert_equals_slow(&coord, 1.0, KeyOrder::Fnv);
    let groups = voxel_groups(&coord, 1.0, KeyOrder::Fnv).unwrap();
    assert_eq!(groups.num_voxels(), 3);
    assert_ne!(groups.inverse[1], groups.inverse[2]);
    assert_eq!(groups.inverse[1], groups.inverse[3]);
}

#[test]
fn non_finite_coordinates_are_named() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut coord = cloud(1, 40_000, 1.0);
        coord[30_000][1] = bad;
        coord[39_000][0] = bad;
        match voxel_groups(&coord, 0.02, KeyOrder::Morton) {
            Err(GridSampleError::NotFinite { row: 30_000, axis: 'y', value }) => {
                assert_eq!(value.to_bits(), bad.to_bits());
            }
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn the_outlier_is_blamed_on_either_side() {
    for far in [-1e6_f32, 1e6, f32::MAX, f32::MIN] {
        let mut coord = cloud(2, 1000, 1.0);
        coord[700][2] = far;
        let error = voxel_groups(&coord, 0.02, KeyOrder::Fnv).unwrap_err();
        assert!(
            matches!(error, GridSampleError::TooWide { row: 700, axis: 'z', value, .. } if value == far),
            "{error:?}"
        );
        assert!(error.to_string().contains("larger voxels"), "{error}");
    }
}

#[test]
fn the_largest_possible_extent_is_accepted() {
    let far = MAX_CELL as f32 + 0.5;
    let groups = voxel_groups(&[[0.0; 3], [far, 0.0, far]], 1.0, KeyOrder::Morton).unwrap();
    assert_eq!(groups.grid_coord[1], [MAX_CELL as i32, 0, MAX_CELL as i32]);
    let error = voxel_groups(&[[-1.0, 0.0, 0.0], [far, 0.0, 0.0]], 1.0, KeyOrder::Morton);
    assert!(matches!(error, Err(GridSampleError::TooWide { axis: 'x', .. })));
}

#[test]
fn bad_voxel_sizes_are_refused() {
    for size in [0.0, -0.02, f64::NAN, f64::INFINITY, 1e30, 2e6] {
        let error = voxel_groups(&[[0.0; 3]], size, KeyOrder::Morton);
        assert!(matches!(error, Err(GridSampleError::GridSize { .. })));
    }
    // So small that the quotient overflows.
    let error = voxel_groups(&[[0.0; 3], [1.0; 3]], 5e-324, KeyOrder::Morton);
    assert!(matches!(error, Err(GridSampleError::TooWide { .. })));
}

#[test]
fn wrong_lengths_are_named() {
    let groups = voxel_groups(&[[0.0; 3], [1.0; 3]], 0.5, KeyOrder::Morton).unwrap();
    for error in [
        groups.drawn_rows(&[0]).unwrap_err(),
        groups.labelled_rows(&[1, 2, 3], -1).unwrap_err(),
        groups.nearest_to_centre(&[]).unwrap_err(),
    ] {
        assert!(matches!(error, GridSampleError::Length { expected: 2, .. }), "{error}");
    }
}

#[test]
fn thread_count_does_not_matter() {
    let coord = cloud(11, 100_000, 5.0);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| -> Vec<(VoxelGroups, Vec<u32>)> {
            ORDERS
                .map(|order| {
                    let groups = voxel_groups(&coord, 0.05, order).unwrap();
                    let nearest = groups.nearest_to_centre(&coord).unwrap();
                    (groups, nearest)
                })
                .to_vec()
        })
    };
    let one = on(1);
    assert!(one == on(2) && one == on(5));
}
