use crate::{Buffer, Grid, GridError};
use crate::{assert_near, bits_in_any_order, in_any_order, random, values};
use rand::{Rng, SeedableRng};
use scenesplat_device::Launcher;
use scenesplat_device::ops::kernel_map::{self, KernelMap};
use scenesplat_device::ops::{columns, sparse_conv};
use scenesplat_kernels::{Precision, kernel_map as cpu_map, sparse_conv as cpu};
use sparse_conv::Method;

crate::support::on_grid! {
    maps_are_those_of_the_cpu
    convolutions_are_those_of_the_cpu
    rows_that_share_voxels
}

/// Cells of a cube, each at most once if `unique`.
fn grid(n: usize, side: i32, unique: bool, seed: u64) -> Vec<[i32; 3]> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut seen = std::collections::BTreeSet::new();
    let mut out = Vec::new();
    while out.len() < n {
        let c = std::array::from_fn(|_| rng.random_range(0..side));
        if seen.insert(c) || !unique {
            out.push(c);
        }
    }
    out
}

fn map_of(
    l: &Grid,
    grid: &[[i32; 3]],
    offsets: &[usize],
    k: usize,
) -> Result<KernelMap<Buffer>, GridError> {
    let offsets: Vec<u32> = offsets.iter().map(|&o| o as u32).collect();
    kernel_map::build(l, &l.upload_values(grid)?, &offsets, k as u32)
}

fn check_map(grid: &[[i32; 3]], offsets: &[usize], k: usize) {
    let want = cpu_map::KernelMap::build(grid, offsets, k).unwrap();
    let (starts, input, output, duplicates) = in_any_order(|l| {
        let map = map_of(l, grid, offsets, k)?;
        let pairs = map.pairs as usize;
        Ok((
            l.download_values::<u32>(&map.starts, map.taps() as usize + 1)?,
            l.download_values::<u32>(&map.input, pairs)?,
            l.download_values::<u32>(&map.output, pairs)?,
            map.duplicates,
        ))
    });
    assert_eq!(duplicates, want.has_duplicates());
    assert_eq!(input.len(), want.num_pairs());
    for tap in 0..want.taps() {
        let span = starts[tap] as usize..starts[tap + 1] as usize;
        let (from, to) = want.tap_pairs(tap);
        assert_eq!(input[span.clone()], from, "tap {tap} of {k}³, {} rows", grid.len());
        assert_eq!(output[span], to, "tap {tap} of {k}³, {} rows", grid.len());
    }
}

fn maps_are_those_of_the_cpu() {
    for n in [0, 1, 2, 1023, 1024, 1025] {
        let grid = grid(n, 13, true, 1);
        for k in [1, 3, 5] {
            check_map(&grid, &[0, n / 3, n / 3, n], k);
        }
    }
    let top = (1 << 21) - 1;
    let mut corners: Vec<[i32; 3]> = vec![[top; 3], [top, top - 1, top], [0, 0, top], [0; 3]];
    corners.extend([[0, 1, 0], [top - 2, top, top], [0, top, 0], [1, 0, 0]]);
    check_map(&corners, &[0, corners.len()], 7);
    // Shared cells: the first row stands for them.
    let crowded = grid(1200, 6, false, 2);
    for k in [1, 3, 5] {
        check_map(&crowded, &[0, 500, 1200], k);
    }
    check_map(&[[4, 4, 4]; 300], &[0, 300], 3);
}

/// Forward in all ways, and the three gradients.
fn check(grid: &[[i32; 3]], offsets: &[usize], k: usize, cin: usize, cout: usize) {
    let n = grid.len();
    let map = cpu_map::KernelMap::build(grid, offsets, k).unwrap();
    let taps = map.taps();
    let (x, w, b) = (random(n * cin, 1), random(cout * taps * cin, 2), random(cout, 3));
    let grad = random(n * cout, 4);
    // Thousands of products, added up in another order.
    let bound = if k > 3 || cin * cout > 1000 { 1e-4 } else { 2e-5 };
    let what = format!("{n} rows, {k}³ taps, {cin} to {cout} channels");

    let mut want = vec![0.0; n * cout];
    cpu::forward(&map, &x, &cpu::PackedConv::new(&w, cin, cout, taps), Some(&b), &mut want);
    let mut want_dx = vec![0.0; n * cin];
    cpu::backward_input(Precision::F32, &map, &grad, &w, cin, cout, &mut want_dx);
    let mut want_dw = vec![0.0; w.len()];
    cpu::backward_weight(Precision::F32, &map, &x, &grad, cin, cout, &mut want_dw);
    for method in [Method::Fused, Method::TapByTap] {
        let got = bits_in_any_order(|l| {
            let map = map_of(l, grid, offsets, k)?;
            let (x, w, b) = (l.upload_values(&x)?, l.upload_values(&w)?, l.upload_values(&b)?);
            let mut out = l.alloc_values::<f32>(n * cout)?;
            let (cin, cout) = (cin as u32, cout as u32);
            sparse_conv::forward(l, method, &map, &x, &w, Some(&b), cin, cout, &mut out)?;
            values(l, &out, n * cout as usize)
        });
        assert_near(&got, &want, bound, &format!("{method:?}: {what}"));
        let got = bits_in_any_order(|l| {
            let map = map_of(l, grid, offsets, k)?;
            let (grad, w) = (l.upload_values(&grad)?, l.upload_values(&w)?);
            let mut dx = l.alloc_values::<f32>(n * cin)?;
            let (cin, cout) = (cin as u32, cout as u32);
            sparse_conv::backward_input(l, method, &map, &grad, &w, cin, cout, &mut dx)?;
            values(l, &dx, n * cin as usize)
        });
        assert_near(&got, &want_dx, bound, &format!("{method:?}, gradient of the input: {what}"));
    }
    let got = bits_in_any_order(|l| {
        let map = map_of(l, grid, offsets, k)?;
        let (x, grad) = (l.upload_values(&x)?, l.upload_values(&grad)?);
        let mut dw = l.alloc_values::<f32>(w.len())?;
        sparse_conv::backward_weight(l, &map, &x, &grad, cin as u32, cout as u32, &mut dw)?;
        values(l, &dw, w.len())
    });
    assert_near(&got, &want_dw, 5e-5, &format!("gradient of the weight: {what}"));
    let got = bits_in_any_order(|l| {
        let grad = l.upload_values(&grad)?;
        let mut db = l.alloc_values::<f32>(cout)?;
        columns::column_sums(l, &grad, n as u32, cout as u32, &mut db)?;
        values(l, &db, cout)
    });
    assert_near(
        &got,
        &cpu::backward_bias(&grad, cout),
        1e-6,
        &format!("gradient of the bias: {what}"),
    );
}

fn convolutions_are_those_of_the_cpu() {
    for (n, k, cin, cout) in [
        (0, 3, 4, 4),
        (1, 3, 11, 5),
        (2, 3, 3, 2),
        (1023, 3, 7, 20),
        (1024, 3, 16, 16),
        (1025, 3, 17, 33),
    ] {
        check(&grid(n, 12, true, 5), &[0, n / 3, n], k, cin, cout);
    }
    check(&grid(700, 10, true, 6), &[0, 700], 5, 6, 32);
    check(&grid(200, 7, true, 7), &[0, 200], 3, 70, 130);
}

fn rows_that_share_voxels() {
    check(&grid(600, 6, false, 8), &[0, 250, 600], 3, 5, 9);
    check(&[[3, 3, 3]; 130], &[0, 130], 3, 4, 4);
}
