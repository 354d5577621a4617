use crate::{ROWS, assert_same, bits_in_any_order, in_any_order, random, shuffled, values};
use scenesplat_device::Launcher;
use scenesplat_device::ops::rows::{self, Width};
use scenesplat_kernels::{permute, serialization};

crate::support::on_grid! {
    rows_are_gathered_and_a_permutation_undone
    fewer_rows_than_there_are_may_be_gathered_and_narrow_values_too
    inverse_and_counting
}

fn rows_are_gathered_and_a_permutation_undone() {
    for n in ROWS {
        for c in [1, 3, 32, 70] {
            let (x, order) = (random(n * c, 1), shuffled(n, 2));
            let mut want = vec![0.0; n * c];
            permute::gather_rows(&x, c, &order, &mut want);
            let got = bits_in_any_order(|l| {
                let (x, order) = (l.upload_values(&x)?, l.upload_values(&order)?);
                let mut out = l.alloc_values::<f32>(n * c)?;
                rows::gather_rows(l, &x, Width::Four, c as u32, &order, n as u32, &mut out)?;
                values(l, &out, n * c)
            });
            assert_same(&got, &want, &format!("{n} rows of {c}"));
            let back = bits_in_any_order(|l| {
                let (y, order) = (l.upload_values(&want)?, l.upload_values(&order)?);
                let mut inverse = l.alloc_values::<u32>(n)?;
                rows::invert(l, &order, n as u32, &mut inverse)?;
                let mut out = l.alloc_values::<f32>(n * c)?;
                rows::gather_rows(l, &y, Width::Four, c as u32, &inverse, n as u32, &mut out)?;
                values(l, &out, n * c)
            });
            assert_same(&back, &x, &format!("{n} rows of {c}, back"));
        }
    }
}

fn fewer_rows_than_there_are_may_be_gathered_and_narrow_values_too() {
    let (m, n, c) = (40, 1025, 5);
    let x: Vec<u16> = (0..m * c).map(|v| v as u16).collect();
    let rows: Vec<u32> = (0..n).map(|i| (i * 7 % m) as u32).collect();
    let mut want = vec![0; n * c];
    permute::gather_rows(&x, c, &rows, &mut want);
    let got = in_any_order(|l| {
        let (x, rows) = (l.upload_values(&x)?, l.upload_values(&rows)?);
        let mut out = l.alloc_values::<u16>(n * c)?;
        rows::gather_rows(l, &x, Width::Two, c as u32, &rows, n as u32, &mut out)?;
        l.download_values::<u16>(&out, n * c)
    });
    assert_eq!(got, want);
}

fn inverse_and_counting() {
    for n in ROWS {
        let order = shuffled(n, 5);
        let (inverse, count) = in_any_order(|l| {
            let order = l.upload_values(&order)?;
            let mut inverse = l.alloc_values::<u32>(n)?;
            rows::invert(l, &order, n as u32, &mut inverse)?;
            let count = rows::count_up(l, n as u32)?;
            Ok((l.download_values::<u32>(&inverse, n)?, l.download_values::<u32>(&count, n)?))
        });
        assert_eq!(inverse, serialization::invert(&order));
        assert!(count.iter().enumerate().all(|(i, &v)| i == v as usize));
    }
}
