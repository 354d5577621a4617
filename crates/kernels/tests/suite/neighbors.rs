//! Nearest neighbors against sorting all distances; `benches/kiddo` compares with another tree.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat_kernels::neighbors::{KdTree, Neighbor, NeighborError, distance_squared};

type Coord = [f32; 3];

fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

fn cube(rng: &mut ChaCha8Rng, n: usize) -> Vec<Coord> {
    (0..n).map(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))).collect()
}

/// Points on a coarse grid: distances tie and points repeat.
fn gridded(rng: &mut ChaCha8Rng, n: usize) -> Vec<Coord> {
    let mut cell = || f32::from(rng.random_range(0..9_u8)) * 0.25;
    (0..n).map(|_| [cell(), cell(), cell()]).collect()
}

/// Dense balls of very different sizes far apart, with a few lone points.
fn clustered(rng: &mut ChaCha8Rng, n: usize) -> Vec<Coord> {
    let centres = cube(rng, 12);
    (0..n)
        .map(|i| {
            let size = [1e-4, 1e-2, 0.1, 30.0][i % 97 % 4];
            let [x, y, z] = centres[rng.random_range(0..12)];
            let mut near = |v: f32| v * 20.0 + size * rng.random_range(-1.0..1.0_f32);
            [near(x), near(y), near(z)]
        })
        .collect()
}

/// All distances, sorted by (distance, row).
fn slow(coord: &[Coord], rows: &[usize], query: Coord, k: usize) -> Vec<Neighbor> {
    let mut all: Vec<Neighbor> = rows
        .iter()
        .map(|&row| Neighbor {
            distance_squared: distance_squared(coord[row], query),
            row: row as u32,
        })
        .collect();
    all.sort();
    all.truncate(k);
    all
}

fn all_nearest(tree: &KdTree, query: &[Coord], k: usize) -> Vec<Vec<Neighbor>> {
    tree.map_nearest(query, k, || (), |(), _, near| near.to_vec())
}

#[test]
fn equals_sorting_all_distances() {
    let kinds = [cube, gridded, clustered];
    for (seed, n) in [0, 1, 2, 15, 16, 17, 32, 33, 500, 3000].into_iter().enumerate() {
        for (kind, make) in kinds.iter().enumerate() {
            let rng = &mut rng(seed as u64);
            let coord = make(rng, n);
            let rows: Vec<usize> = (0..n).filter(|_| rng.random_bool(0.9)).collect();
            let tree = KdTree::of_rows(&coord, rows.iter().copied()).unwrap();
            assert_eq!((tree.len(), tree.is_empty()), (rows.len(), rows.is_empty()));
            // Strangers, and the points themselves, a dense and a sparse set.
            let mut query = make(rng, 40);
            query.extend(coord.iter().take(100));
            query.push([1e6, -1e6, 0.1]);
            for k in [0, 1, 3, 25, 5000] {
                let batch = all_nearest(&tree, &query, k);
                for (&q, got) in query.iter().zip(&batch) {
                    let expected = slow(&coord, &rows, q, k);
                    assert_eq!(*got, expected, "kind {kind}, n {n}, k {k}");
                    assert_eq!(tree.nearest(q, k), expected, "kind {kind}, n {n}, k {k}");
                }
            }
        }
    }
}

#[test]
fn many_queries_equal_one_at_a_time() {
    for make in [cube, gridded, clustered] {
        let rng = &mut rng(5);
        let (coord, query) = (make(rng, 40_000), make(rng, 40_000));
        let tree = KdTree::new(&coord).unwrap();
        for k in [1, 17] {
            let batch = all_nearest(&tree, &query, k);
            for i in (0..query.len()).step_by(7) {
                assert_eq!(batch[i], tree.nearest(query[i], k));
            }
        }
    }
}

#[test]
fn planes_lines_and_outliers() {
    let rng = &mut rng(2);
    for fixed in [1, 2] {
        let mut coord = cube(rng, 20_000);
        coord.iter_mut().for_each(|c| c[..fixed].fill(7.0));
        coord[5] = [1e30, -1e30, 0.0];
        let tree = KdTree::new(&coord).unwrap();
        let rows: Vec<usize> = (0..coord.len()).collect();
        let batch = all_nearest(&tree, &coord, 25);
        for i in (0..coord.len()).step_by(499).chain([5]) {
            assert_eq!(batch[i], slow(&coord, &rows, coord[i], 25));
        }
    }
}

#[test]
fn extreme_coordinates() {
    let huge = f32::MAX;
    let coord = [[huge; 3], [-huge; 3], [0.0; 3], [1e-40, 0.0, -0.0], [-1e-40, 0.0, 0.0]];
    let tree = KdTree::new(&coord).unwrap();
    for k in 1..=6 {
        for (&q, got) in coord.iter().zip(all_nearest(&tree, &coord, k)) {
            assert_eq!(got, slow(&coord, &[0, 1, 2, 3, 4], q, k));
        }
    }
}

#[test]
fn coincident_points_come_by_row_and_cost_little() {
    let mut coord = vec![[0.5, -1.0, 2.0]; 100_000];
    coord[0] = [0.5, -1.0, 2.5];
    let tree = KdTree::new(&coord).unwrap();
    let mut query = coord.clone();
    query[7] = [9.0, 9.0, -9.0];
    for near in all_nearest(&tree, &query[1..], 25) {
        assert!(near.iter().map(|n| n.row).eq(1..26));
    }
    assert_eq!(tree.nearest(coord[0], 2).iter().map(|n| n.row).collect::<Vec<_>>(), [0, 1]);
}

#[test]
fn queries_that_are_not_finite_have_no_neighbours() {
    let tree = KdTree::new(&[[0.0; 3]; 2]).unwrap();
    let query = [[0.0; 3], [f32::NAN, 0.0, 0.0], [0.0, f32::INFINITY, 0.0], [1.0; 3]];
    let counts = tree.map_nearest(&query, 9, || (), |(), i, near| (i, near.len()));
    assert_eq!(counts, [(0, 2), (1, 0), (2, 0), (3, 2)]);
    assert!(query[1..3].iter().all(|&q| tree.nearest(q, 1).is_empty()));
    let empty = KdTree::new(&[]).unwrap();
    assert_eq!(empty.map_nearest(&query, 3, || (), |(), i, near| (i, near.len()))[3], (3, 0));
}

#[test]
fn refuses_coordinates_that_are_not_finite() {
    let coord = [[0.0; 3], [0.0, f32::INFINITY, 0.0]];
    let error = KdTree::new(&coord).unwrap_err();
    assert_eq!(error, NeighborError::NotFinite { row: 1, value: coord[1] });
    assert_eq!(KdTree::of_rows(&coord, [0]).unwrap().len(), 1);
}

#[test]
fn thread_count_does_not_matter() {
    let rng = &mut rng(9);
    let coord = gridded(rng, 30_000);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| all_nearest(&KdTree::new(&coord).unwrap(), &coord, 12))
    };
    let one = on(1);
    assert!([2, 3, 8].into_iter().all(|threads| on(threads) == one));
}
