//! Group a: codes, orders, inverses, pooled codes.

use crate::support::Tensors;
use scenesplat_kernels::serialization::{Curve, argsort, codes, invert};
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use scenesplat_test_support::Golden;

/// Rows of the original's code table: the scene number above the curve code.
fn packed(cloud: &SerializedCloud, order: usize) -> Vec<i64> {
    let scenes = cloud.scene_of_rows();
    let rows = cloud.codes(order).iter().zip(&scenes);
    rows.map(|(c, s)| i64::from(*s) << (3 * cloud.depth()[*s as usize]) | *c as i64).collect()
}

#[test]
fn codes_orders_and_inverses() {
    for case in [
        "random_d8",
        "random_d12",
        "random_d16",
        "structured_d8",
        "structured_d12",
        "structured_d16",
        "block_top_d16",
        "single_d4",
    ] {
        let Some(g) = Golden::network(&format!("a_{case}")) else { return };
        let cells = g.cells("grid_coord");
        let batch: Vec<u64> = g.ints("batch");
        let depth = g.ints("depth")[0];
        let (mut all, mut orders, mut inverses) = (Vec::new(), Vec::new(), Vec::new());
        for curve in Curve::ALL {
            let with_batch: Vec<u64> = codes(curve, &cells, depth)
                .iter()
                .zip(&batch)
                .map(|(c, b)| *b << (3 * depth) | c)
                .collect();
            let order = argsort(&with_batch);
            inverses.extend(invert(&order));
            orders.extend(order);
            all.extend(with_batch.into_iter().map(|c| c as i64));
        }
        g.compare_ints("code", &all);
        g.compare_ints("order", &orders);
        g.compare_ints("inverse", &inverses);
    }
}

#[test]
fn a_batch_and_its_pooled_codes() {
    let Some(g) = Golden::network("a_point_serialization") else { return };
    let cloud = SerializedCloud::new(
        g.cells("grid_coord"),
        g.offsets("offset"),
        &Curve::ALL,
        CurveDepth::WholeBatch,
    )
    .unwrap();
    check(&g, &cloud);
    g.compare_ints("depth", &cloud.depth()[..1]);
    g.compare_ints("batch", &cloud.scene_of_rows());

    let p = Golden::network("a_pool_codes").unwrap();
    let (coarse, groups) = cloud.pool(1);
    check(&p, &coarse);
    p.compare_ints("cluster", groups.inverse());
    let counts: Vec<u32> = groups.offsets().windows(2).map(|o| o[1] - o[0]).collect();
    p.compare_ints("counts", &counts);
    p.compare_ints("batch", &coarse.scene_of_rows());
    let cells: Vec<i32> = coarse.grid_coord().iter().flatten().copied().collect();
    p.compare_ints("grid_coord", &cells);
    // The original names the lowest row of a cluster; our groups list members in row order.
    let heads: Vec<u32> = groups
        .offsets()
        .windows(2)
        .map(|o| groups.rows()[o[0] as usize..o[1] as usize].iter().copied().min().unwrap())
        .collect();
    p.compare_ints("head_indices", &heads);
}

fn check(g: &Golden, cloud: &SerializedCloud) {
    let (mut codes, mut orders, mut inverses) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..4 {
        codes.extend(packed(cloud, i));
        orders.extend(cloud.order(i).order.iter().copied());
        inverses.extend(cloud.order(i).inverse.iter().copied());
    }
    g.compare_ints("code", &codes);
    g.compare_ints("order", &orders);
    g.compare_ints("inverse", &inverses);
}
