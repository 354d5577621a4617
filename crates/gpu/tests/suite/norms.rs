//! Layer norm.

use crate::support::{close, gpu, random, rows, stored};
use scenesplat_gpu::ops::Stored;
use scenesplat_gpu::ops::layer_norm::{Ending, LayerNorm, layer_norm};
use scenesplat_gpu::ops::unit_rows::unit_rows;
use scenesplat_kernels::normalize::normalize_rows;
use scenesplat_test_support::reference;

#[test]
pub fn norms_follow_the_formula_with_every_ending() {
    let Some(gpu) = gpu() else { return };
    for (stored, rounding) in stored(&gpu) {
        for (n, c) in [(1, 1), (5, 16), (70, 36), (9, 64), (3, 768), (66, 100)] {
            let (x, beside) = (random(n * c, 1), random(n * c, 2));
            let (weight, bias) = (random(c, 3), random(c, 4));
            let want = reference::layer_norm(&x, c, &weight, &bias, 1e-5);
            let norm = LayerNorm::upload(&gpu, &weight, &bias).unwrap();
            let (input, residual) = (rows(&gpu, &x, c, stored), rows(&gpu, &beside, c, stored));
            let mut commands = gpu.commands();
            let mut run = |ending| {
                layer_norm(&mut commands, &input, &norm, ending)
                    .unwrap()
                    .read(&mut commands)
                    .unwrap()
            };
            close("norm", &run(Ending::None), &want, rounding * 4.0);
            let gelu: Vec<f64> = want.iter().map(|v| reference::gelu(*v)).collect();
            close("norm, gelu", &run(Ending::Gelu), &gelu, rounding * 4.0);
            let sum: Vec<f64> = want.iter().zip(&beside).map(|(v, r)| v + f64::from(*r)).collect();
            close("norm, residual", &run(Ending::Residual(&residual)), &sum, rounding * 4.0);
        }
    }
}

#[test]
fn hard_rows_get_what_f64_gives_and_bad_ones_stay_alone() {
    let Some(gpu) = gpu() else { return };
    let c = 32;
    let plain = random(c, 1);
    let constant = vec![7.5f32; c];
    let huge: Vec<f32> = plain.iter().map(|v| v * 3e38).collect();
    let tiny: Vec<f32> = plain.iter().map(|v| v * 1e-30).collect();
    let mut nan = plain.clone();
    nan[3] = f32::NAN;
    let mut infinite = plain.clone();
    infinite[9] = f32::NEG_INFINITY;
    let (large, largest) = (vec![1e20; c], vec![3e38; c]);
    let x = [&plain, &nan, &constant, &infinite, &huge, &tiny, &vec![0.0; c], &large, &largest]
        .map(|r| r.clone())
        .concat();
    let norm = LayerNorm::upload(&gpu, &vec![1.0; c], &vec![0.25; c]).unwrap();
    let mut commands = gpu.commands();
    let input = rows(&gpu, &x, c, Stored::F32);
    let out = layer_norm(&mut commands, &input, &norm, Ending::None).unwrap();
    let got = out.read(&mut commands).unwrap();
    let want = reference::layer_norm(&x, c, &vec![1.0; c], &vec![0.25; c], 1e-5);
    for row in [0, 2, 4, 5, 6, 7, 8] {
        let part = row * c..(row + 1) * c;
        close(&format!("row {row}"), &got[part.clone()], &want[part], 4e-6);
    }
    for row in [1, 3] {
        assert!(got[row * c..(row + 1) * c].iter().all(|v| v.is_nan()), "row {row}");
    }
}

#[test]
fn rows_of_another_width_are_an_error() {
    let Some(gpu) = gpu() else { return };
    let norm = LayerNorm::upload(&gpu, &[1.0; 4], &[0.0; 4]).unwrap();
    let input = rows(&gpu, &random(9, 1), 3, Stored::F32);
    assert!(layer_norm(&mut gpu.commands(), &input, &norm, Ending::None).is_err());
    assert!(LayerNorm::upload(&gpu, &[1.0; 4], &[0.0; 3]).is_err());
}

#[test]
pub fn rows_have_unit_length_whatever_their_size() {
    let Some(gpu) = gpu() else { return };
    for c in [1, 3, 64, 770] {
        let row = random(c, 1);
        let mut x = vec![];
        for scale in [1.0, 1e-6, 1e-11, 1e-30, 1e30, 3e38, 0.0] {
            x.extend(row.iter().map(|v| v * scale));
        }
        let mut want = x.clone();
        normalize_rows(&mut want, c);
        let mut commands = gpu.commands();
        let got = unit_rows(&mut commands, &rows(&gpu, &x, c, Stored::F32)).unwrap();
        let want: Vec<f64> = want.iter().map(|v| f64::from(*v)).collect();
        close("unit rows", &got.read(&mut commands).unwrap(), &want, 1e-6);
    }
    let mut x = random(3 * 8, 2);
    x[9] = f32::NAN;
    let mut commands = gpu.commands();
    let got = unit_rows(&mut commands, &rows(&gpu, &x, 8, Stored::F32)).unwrap();
    let got = got.read(&mut commands).unwrap();
    for (i, v) in got.iter().enumerate() {
        assert_eq!(v.is_nan(), i / 8 == 1, "value {i}");
    }
}

/// More workgroups than one dimension has.
#[test]
fn rows_beyond_one_dimension_of_workgroups_are_like_the_others() {
    let Some(gpu) = gpu() else { return };
    for (n, c) in [(131_073, 1), (65_537, 65)] {
        let x = random(n * c, 1);
        let mut commands = gpu.commands();
        let input = rows(&gpu, &x, c, Stored::F32);
        let norm = LayerNorm::upload(&gpu, &vec![1.0; c], &vec![0.5; c]).unwrap();
        let unit = unit_rows(&mut commands, &input).unwrap().read(&mut commands).unwrap();
        let out = layer_norm(&mut commands, &input, &norm, Ending::None).unwrap();
        let normed = out.read(&mut commands).unwrap();
        let mut want = x.clone();
        normalize_rows(&mut want, c);
        let want: Vec<f64> = want.iter().map(|v| f64::from(*v)).collect();
        close("unit rows", &unit, &want, 1e-6);
        let want = reference::layer_norm(&x, c, &vec![1.0; c], &vec![0.5; c], 1e-5);
        close("norm", &normed, &want, 1e-5);
    }
}
