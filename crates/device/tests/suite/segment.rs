use crate::{Grid, GridError};
use crate::{ROWS, assert_same, bits_in_any_order, random, shuffled, values};
use rand::{Rng, SeedableRng};
use scenesplat_device::Launcher;
use scenesplat_device::ops::segment::{self, Reduce};
use scenesplat_kernels::segment as cpu;

crate::support::on_grid! {
    groups_are_reduced_as_on_the_cpu
    nan_ties_empty_groups_and_one_group_of_all
}

const HOW: [(Reduce, cpu::Reduce); 3] = [
    (Reduce::Sum, cpu::Reduce::Sum),
    (Reduce::Mean, cpu::Reduce::Mean),
    (Reduce::Max, cpu::Reduce::Max),
];

/// Groups of 0 to 8 rows, in any order.
fn groups(n: usize, seed: u64) -> cpu::Groups {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut offsets = vec![0u32];
    let mut at = 0;
    while at < n {
        at = (at + rng.random_range(0..9)).min(n);
        offsets.push(at as u32);
    }
    cpu::Groups::new(shuffled(n, seed), offsets).unwrap()
}

/// Calls `run` with the groups on the device.
fn with_groups<T>(
    l: &Grid,
    groups: &cpu::Groups,
    run: impl FnOnce(segment::Groups<'_, crate::Buffer>) -> Result<T, GridError>,
) -> Result<T, GridError> {
    let rows = l.upload_values(groups.rows())?;
    let offsets = l.upload_values(groups.offsets())?;
    let inverse = l.upload_values(groups.inverse())?;
    run(segment::Groups {
        rows: &rows,
        offsets: &offsets,
        inverse: &inverse,
        num_rows: groups.rows().len() as u32,
        num_groups: groups.len() as u32,
    })
}

fn check(x: &[f32], c: usize, groups: &cpu::Groups) {
    let (n, g) = (groups.rows().len(), groups.len());
    let grad = random(g * c, 9);
    for (how, cpu_how) in HOW {
        let mut want = vec![0.0; g * c];
        cpu::reduce(x, c, groups, cpu_how, &mut want);
        let got = bits_in_any_order(|l| {
            let x = l.upload_values(x)?;
            let mut out = l.alloc_values::<f32>(g * c)?;
            with_groups(l, groups, |groups| {
                segment::reduce(l, &x, c as u32, groups, how, &mut out)
            })?;
            values(l, &out, g * c)
        });
        assert_same(&got, &want, &format!("{how:?} of {n} rows of {c}"));
        let mut want = vec![0.0; n * c];
        cpu::reduce_backward(x, c, groups, cpu_how, &grad, &mut want);
        let got = bits_in_any_order(|l| {
            let (x, grad) = (l.upload_values(x)?, l.upload_values(&grad)?);
            let mut dx = l.alloc_values::<f32>(n * c)?;
            with_groups(l, groups, |groups| {
                segment::reduce_backward(l, &x, c as u32, groups, how, &grad, &mut dx)
            })?;
            values(l, &dx, n * c)
        });
        assert_same(&got, &want, &format!("gradient of {how:?} of {n} rows of {c}"));
    }
}

fn groups_are_reduced_as_on_the_cpu() {
    for n in ROWS {
        for c in [1, 6, 33] {
            check(&random(n * c, 3), c, &groups(n, 4));
        }
    }
}

fn nan_ties_empty_groups_and_one_group_of_all() {
    let (n, c) = (300, 4);
    // Few values, so that the largest one occurs often.
    let mut x: Vec<f32> = random(n * c, 5).iter().map(|v| (v * 3.0).round()).collect();
    for (at, value) in [(17, f32::NAN), (18, f32::INFINITY), (333, f32::NAN), (700, -0.0)] {
        x[at] = value;
    }
    check(&x, c, &groups(n, 6));
    let rows: Vec<u32> = shuffled(n, 7);
    check(&x, c, &cpu::Groups::new(rows.clone(), vec![0, n as u32]).unwrap());
    check(&x, c, &cpu::Groups::new(rows, vec![0, 0, 0, n as u32, n as u32]).unwrap());
}
