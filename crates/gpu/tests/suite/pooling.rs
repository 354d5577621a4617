//! Rows of groups, and copies of rows.

use crate::support::{close, gpu, random, rows, stored};
use scenesplat_gpu::Gpu;
use scenesplat_gpu::ops::Stored;
use scenesplat_gpu::ops::pool::{Affine, DeviceGroups, pool};
use scenesplat_gpu::ops::rows::{add_gathered, gather};
use scenesplat_kernels::segment::{Groups, Reduce, reduce};
use scenesplat_test_support::reference;

fn on_device(gpu: &Gpu, groups: &Groups) -> DeviceGroups {
    let upload = |values: &[u32]| gpu.upload("groups", values).unwrap();
    DeviceGroups {
        rows: upload(groups.rows()),
        starts: upload(groups.offsets()),
        inverse: upload(groups.inverse()),
    }
}

#[test]
pub fn pooling_follows_the_formula() {
    let Some(gpu) = gpu() else { return };
    let n = 150u32;
    let order: Vec<u32> = (0..n).map(|i| i * 61 % n).collect();
    let groups = Groups::new(order, vec![0, 1, 9, 10, 100, n]).unwrap();
    for (stored, rounding) in stored(&gpu) {
        for c in [1, 18, 64] {
            let x = random(n as usize * c, 1);
            let input = rows(&gpu, &x, c, stored);
            let mut commands = gpu.commands();
            let device = on_device(&gpu, &groups);
            for (how, max) in [(Reduce::Mean, false), (Reduce::Max, true)] {
                let want = reference::pool(&x, c, groups.inverse(), 5, max);
                let out = pool(&mut commands, &input, &device, how, None, false).unwrap();
                close("pool", &out.read(&mut commands).unwrap(), &want, rounding * 2.0);
                let (factor, summand) = (random(c, 2), random(c, 3));
                let affine = Affine {
                    factor: gpu.upload("factor", &factor).unwrap(),
                    summand: gpu.upload("summand", &summand).unwrap(),
                };
                let out = pool(&mut commands, &input, &device, how, Some(&affine), true).unwrap();
                let value = |(i, v): (usize, &f64)| {
                    reference::gelu(v * f64::from(factor[i % c]) + f64::from(summand[i % c]))
                };
                let want: Vec<f64> = want.iter().enumerate().map(value).collect();
                close("pool, gelu", &out.read(&mut commands).unwrap(), &want, rounding * 2.0);
            }
        }
    }
}

#[test]
fn nan_ties_and_one_group_of_all_are_as_on_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let c = 3;
    let mut x = random(20 * c, 1);
    x[4] = f32::NAN;
    x[16] = 2.0;
    x[31] = f32::NEG_INFINITY;
    x[7] = 2.0;
    for starts in [vec![0, 20], vec![0, 0, 3, 20, 20], (0..=20).collect()] {
        let groups = Groups::new((0..20).rev().collect(), starts).unwrap();
        for how in [Reduce::Max, Reduce::Sum, Reduce::Mean] {
            let mut want = vec![0.0; groups.len() * c];
            reduce(&x, c, &groups, how, &mut want);
            let mut commands = gpu.commands();
            let input = rows(&gpu, &x, c, Stored::F32);
            let device = on_device(&gpu, &groups);
            let out = pool(&mut commands, &input, &device, how, None, false).unwrap();
            let got = out.read(&mut commands).unwrap();
            for (got, want) in got.iter().zip(&want) {
                let equal =
                    got.is_nan() && want.is_nan() || (got - want).abs() < 1e-6 || got == want;
                assert!(equal, "{how:?}: {got} {want}");
            }
        }
    }
}

#[test]
pub fn rows_are_copied_and_added_by_lists() {
    let Some(gpu) = gpu() else { return };
    for (stored, rounding) in stored(&gpu) {
        let c = 5;
        let (x, y) = (random(40 * c, 1), random(7 * c, 2));
        let list: Vec<u32> = (0..40).map(|i| i * 11 % 40).collect();
        let groups: Vec<u32> = (0..40).map(|i| i % 7).collect();
        let mut commands = gpu.commands();
        let (device_x, device_y) = (rows(&gpu, &x, c, stored), rows(&gpu, &y, c, stored));
        let copied = gather(&mut commands, &device_x, &gpu.upload("list", &list).unwrap()).unwrap();
        let want: Vec<f32> = list.iter().flat_map(|r| x[*r as usize * c..][..c].to_vec()).collect();
        assert_eq!(copied.read(&mut commands).unwrap(), want);
        let groups_list = gpu.upload("list", &groups).unwrap();
        let sum = add_gathered(&mut commands, &device_x, &device_y, &groups_list).unwrap();
        let want: Vec<f64> = (0..40 * c)
            .map(|i| f64::from(x[i]) + f64::from(y[groups[i / c] as usize * c + i % c]))
            .collect();
        close("sum", &sum.read(&mut commands).unwrap(), &want, rounding);
        assert!(add_gathered(&mut commands, &device_y, &device_x, &groups_list).is_err());
    }
}
