//! Distances only: which of equally near points is kept differs, and is the reason for our tree.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use scenesplat_kernels::bench_room;
use scenesplat_kernels::neighbors::KdTree;
use std::num::NonZero;

const K: usize = 25;

#[test]
fn distances_agree_with_kiddo() {
    let points = bench_room::points(20_500);
    let random = bench_room::values(3 * 20_500, 1);
    let cube: Vec<[f32; 3]> = random.as_chunks().0.to_vec();
    for points in [points, cube] {
        let (coord, query) = points.split_at(20_000);
        let wide = |c: &[f32; 3]| c.map(f64::from);
        let entries: Vec<[f64; 3]> = coord.iter().map(wide).collect();
        let other: ImmutableKdTree<f64, 3> = ImmutableKdTree::new_from_slice(&entries).unwrap();
        let tree = KdTree::new(coord).unwrap();
        for q in query {
            let near = tree.nearest(*q, K);
            let found = other
                .query(&wide(q))
                .nearest_n::<SquaredEuclidean<f64>>(NonZero::new(K).unwrap())
                .execute();
            assert_eq!(found.len(), near.len());
            for (a, b) in near.iter().zip(found) {
                // Sums of the same squares, possibly fused or in another order.
                let (a, b) = (a.distance_squared, b.distance);
                assert!((a - b).abs() <= 4.0 * f64::EPSILON * a, "{a} {b}");
            }
        }
    }
}
