use crate::{ROWS, in_any_order};
use rand::{Rng, SeedableRng};
use scenesplat_device::Launcher;
use scenesplat_device::ops::{curves, radix_sort, scan};
use scenesplat_kernels::serialization as cpu;

crate::support::on_grid! {
    codes_and_orders_of_all_curves_at_every_depth
    sorting_is_stable_at_all_sizes_and_widths
    sums_run_over_blocks_of_blocks
}

const CURVES: [(curves::Curve, cpu::Curve); 4] = [
    (curves::Curve::Z, cpu::Curve::Z),
    (curves::Curve::ZTrans, cpu::Curve::ZTrans),
    (curves::Curve::Hilbert, cpu::Curve::Hilbert),
    (curves::Curve::HilbertTrans, cpu::Curve::HilbertTrans),
];

fn cells(n: usize, depth: u32, seed: u64) -> Vec<[i32; 3]> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| std::array::from_fn(|_| rng.random_range(0..1i32 << depth))).collect()
}

fn codes_and_orders_of_all_curves_at_every_depth() {
    let check = |cells: &[[i32; 3]], depth: u32| {
        let n = cells.len();
        for (curve, cpu_curve) in CURVES {
            let want = cpu::codes(cpu_curve, cells, depth);
            let order = cpu::argsort(&want);
            let got = in_any_order(|l| {
                let cells = l.upload_values(cells)?;
                let mut codes = l.alloc_values::<u64>(n)?;
                curves::codes(l, curve, &cells, n as u32, depth, &mut codes)?;
                let made = curves::order(l, curve, &cells, n as u32, depth)?;
                Ok((
                    l.download_values::<u64>(&codes, n)?,
                    l.download_values::<u32>(&made.order, n)?,
                    l.download_values::<u32>(&made.inverse, n)?,
                ))
            });
            assert_eq!(got.0, want, "{curve:?}, {n} cells, depth {depth}");
            assert_eq!(got.1, order, "{curve:?}, {n} cells, depth {depth}");
            assert_eq!(got.2, cpu::invert(&order));
        }
    };
    for depth in 0..=21 {
        check(&cells(200, depth, 1), depth);
    }
    for n in ROWS {
        // Few cells, so that ties show.
        check(&cells(n, 3, 2), 3);
        check(&cells(n, 11, 3), 11);
    }
    check(&vec![[0; 3]; 300], 0);
    check(&vec![[(1 << 21) - 1; 3]; 300], 21);
}

fn sorting_is_stable_at_all_sizes_and_widths() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    for n in [0, 1, 2, 255, 256, 257, 4095, 4096, 4097, 20_000] {
        for bits in [0, 1, 8, 9, 33, 64] {
            let codes: Vec<u64> = (0..n)
                .map(|_| if bits == 0 { 7 } else { rng.random::<u64>() >> (64 - bits) })
                .collect();
            let want = cpu::argsort(&codes);
            let (rows, sorted) = in_any_order(|l| {
                let sorted = radix_sort::sort(l, l.upload_values(&codes)?, n as u32, bits)?;
                Ok((
                    l.download_values::<u32>(&sorted.rows, n)?,
                    l.download_values::<u64>(&sorted.codes, n)?,
                ))
            });
            assert_eq!(rows, want, "{n} codes of {bits} bits");
            assert!(rows.iter().zip(&sorted).all(|(&r, &code)| codes[r as usize] == code));
        }
    }
}

fn sums_run_over_blocks_of_blocks() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    // 2048 values a block; more than 2048 blocks have sums of sums.
    for n in [0, 1, 2047, 2048, 2049, 10_000, 2048 * 2048 + 1] {
        let values: Vec<u32> = (0..n).map(|_| rng.random_range(0..4)).collect();
        let run = |l: &crate::Grid| {
            let sums = scan::running_sums(l, &l.upload_values(&values)?, n as u64)?;
            Ok((
                l.download_values::<u32>(&sums.before, n)?,
                l.download_values::<u32>(&sums.total, 1)?[0],
            ))
        };
        let (before, total) =
            if n < 100_000 { in_any_order(run) } else { run(crate::grid(1)).unwrap() };
        let mut sum = 0;
        for (value, before) in values.iter().zip(before) {
            assert_eq!(before, sum);
            sum += value;
        }
        assert_eq!(total, sum);
    }
}
