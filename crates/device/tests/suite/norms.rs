use crate::{ROWS, assert_near, assert_same, bits_in_any_order, random, values};
use rand::{Rng, SeedableRng};
use scenesplat_device::Launcher;
use scenesplat_device::ops::{activation, batch_norm, layer_norm, point_rope};
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::point_rope::{Rotations, Turn};
use scenesplat_kernels::{
    activation as cpu_gelu, batch_norm as cpu_bn, layer_norm as cpu_ln, normalize,
};

crate::support::on_grid! {
    layer_norm_and_its_gradients
    batch_norm_and_its_gradients
    gelu_is_the_cpu_s_to_the_last_bits
    rows_of_unit_length_whatever_their_size
    queries_and_keys_turn_with_their_voxel
}

const EPS: f32 = 1e-5;

fn check_layer_norm(x: &[f32], c: usize, bound: f64) {
    let n = x.len() / c;
    let what = format!("layer norm of {n} rows of {c}");
    let (weight, bias, residual, grad) =
        (random(c, 1), random(c, 2), random(x.len(), 3), random(x.len(), 4));
    for residual in [None, Some(&residual)] {
        let mut want = vec![0.0; x.len()];
        cpu_ln::forward(x, residual.map(Vec::as_slice), &weight, &bias, EPS, &mut want);
        let got = bits_in_any_order(|l| {
            let residual = residual.map(|r| l.upload_values(r)).transpose()?;
            let (x_in, w, b) =
                (l.upload_values(x)?, l.upload_values(&weight)?, l.upload_values(&bias)?);
            let mut out = l.alloc_values::<f32>(x.len())?;
            let (n, c) = (n as u32, c as u32);
            layer_norm::forward(l, &x_in, residual.as_ref(), &w, &b, n, c, EPS, &mut out)?;
            values(l, &out, x.len())
        });
        assert_near(&got, &want, bound, &what);
    }
    let mut want = vec![0.0; x.len()];
    let (dw, db) = cpu_ln::backward(x, &grad, &weight, EPS, &mut want);
    let got = bits_in_any_order(|l| {
        let (x_in, g, w) =
            (l.upload_values(x)?, l.upload_values(&grad)?, l.upload_values(&weight)?);
        let mut dx = l.alloc_values::<f32>(x.len())?;
        let both = layer_norm::backward(l, &x_in, &g, &w, n as u32, c as u32, EPS, &mut dx)?;
        Ok([values(l, &dx, x.len())?, values(l, &both, 2 * c)?].concat())
    });
    let (dx, both) = got.split_at(x.len());
    assert_near(dx, &want, bound, &format!("gradient, {what}"));
    assert_near(both, &[dw, db].concat(), bound, &format!("gradient of the parameters, {what}"));
}

fn layer_norm_and_its_gradients() {
    for n in ROWS {
        for c in [1, 31, 96] {
            check_layer_norm(&random(n * c, 5), c, 2e-5);
        }
    }
    check_layer_norm(&random(3 * 768, 6), 768, 2e-5);
    // Variances that overflow, tiny ones, equal values, and rows that are not finite.
    for scale in [1e-12, 1e12, 1e25, 1e37] {
        let x: Vec<f32> = random(5 * 48, 7).iter().map(|v| v * scale).collect();
        check_layer_norm(&x, 48, 2e-5);
    }
    check_layer_norm(&vec![3.25; 70 * 16], 16, 2e-5);
    let mut x = random(40 * 20, 8);
    x[7] = f32::NAN;
    x[45] = f32::INFINITY;
    check_layer_norm(&x, 20, 2e-5);
}

fn check_batch_norm(x: &[f32], c: usize) {
    let n = x.len() / c;
    let what = format!("batch norm of {n} rows of {c}");
    let want = cpu_bn::statistics(x, c);
    let statistics = bits_in_any_order(|l| {
        let s = batch_norm::statistics(l, &l.upload_values(x)?, n as u32, c as u32)?;
        Ok(l.download_values::<f64>(&s, 2 * c)?.iter().map(|&v| v as f32).collect())
    });
    let as_f32 = |v: &[f64]| v.iter().map(|&v| v as f32).collect::<Vec<_>>();
    assert_near(&statistics[..c], &as_f32(&want.mean), 1e-6, &format!("mean, {what}"));
    assert_near(&statistics[c..], &as_f32(&want.var), 1e-6, &format!("variance, {what}"));

    let (weight, bias, grad) = (random(c, 1), random(c, 2), random(x.len(), 3));
    for gelu in [false, true] {
        let mut y = vec![0.0; x.len()];
        cpu_bn::apply(x, &weight, &bias, gelu, &mut y);
        let got = bits_in_any_order(|l| {
            let (x_in, w, b) =
                (l.upload_values(x)?, l.upload_values(&weight)?, l.upload_values(&bias)?);
            let mut out = l.alloc_values::<f32>(x.len())?;
            batch_norm::apply(l, &x_in, &w, &b, n as u32, c as u32, gelu, &mut out)?;
            values(l, &out, x.len())
        });
        assert_near(&got, &y, 5e-7, &what);
    }
    let inverse: Vec<f64> = want.var.iter().map(|v| 1.0 / (v + 1e-5).sqrt()).collect();
    for batch in [false, true] {
        let mut dx = vec![0.0; x.len()];
        let (dw, db) = cpu_bn::backward(x, &grad, &weight, &want.mean, &inverse, batch, &mut dx);
        let got = bits_in_any_order(|l| {
            let (x_in, g, w) =
                (l.upload_values(x)?, l.upload_values(&grad)?, l.upload_values(&weight)?);
            let (mean, inverse) = (l.upload_values(&want.mean)?, l.upload_values(&inverse)?);
            let mut dx = l.alloc_values::<f32>(x.len())?;
            let of = batch_norm::backward(
                l, &x_in, &g, &w, &mean, &inverse, n as u32, c as u32, batch, &mut dx,
            )?;
            let parameters = [values(l, &of.weight, c)?, values(l, &of.bias, c)?].concat();
            Ok([values(l, &dx, x.len())?, parameters].concat())
        });
        assert_near(&got, &[dx, dw, db].concat(), 2e-6, &format!("gradients, {what}"));
    }
}

fn batch_norm_and_its_gradients() {
    for n in ROWS {
        for c in [1, 7, 64] {
            check_batch_norm(&random(n * c, 5), c);
        }
    }
    // Far from zero, where squares would cancel.
    let far: Vec<f32> = random(3000 * 3, 6).iter().map(|v| 1000.0 + v).collect();
    check_batch_norm(&far, 3);
    let mut x = random(2500 * 3, 7);
    x[3 * 2000] = f32::INFINITY;
    x[3 * 10 + 1] = f32::NAN;
    check_batch_norm(&x, 3);
}

fn gelu_is_the_cpu_s_to_the_last_bits() {
    let mut x: Vec<f32> = (0..20_001).map(|i| (i - 10_000) as f32 * 0.002).collect();
    x.extend([0.0, -0.0, 1e30, -1e30, 1e-40, f32::INFINITY, f32::NEG_INFINITY, f32::NAN]);
    for n in ROWS.into_iter().chain([x.len()]) {
        let x = &x[x.len() - n..];
        let grad = random(n, 1);
        let (mut want, mut want_dx) = (vec![0.0; n], vec![0.0; n]);
        cpu_gelu::gelu_forward(x, &mut want);
        cpu_gelu::gelu_backward(x, &grad, &mut want_dx);
        let got = bits_in_any_order(|l| {
            let x = l.upload_values(x)?;
            let (mut out, mut dx) = (l.alloc_values::<f32>(n)?, l.alloc_values::<f32>(n)?);
            activation::gelu(l, &x, n as u64, &mut out)?;
            activation::gelu_backward(l, &x, &l.upload_values(&grad)?, n as u64, &mut dx)?;
            Ok([values(l, &out, n)?, values(l, &dx, n)?].concat())
        });
        assert_near(&got[..n], &want, 1.2e-7, "gelu");
        assert_near(&got[n..], &want_dx, 1.2e-7, "gradient of gelu");
    }
}

fn rows_of_unit_length_whatever_their_size() {
    for (n, c) in [(0, 3), (1, 1), (2, 770), (1025, 48)] {
        for scale in [1.0, 1e-30, 1e30, 3e38, 1e-44] {
            let mut x: Vec<f32> = random(n * c, 2).iter().map(|v| v * scale).collect();
            if n > 1 {
                x[..c].fill(0.0);
            }
            let mut want = x.clone();
            normalize::normalize_rows(&mut want, c);
            let got = bits_in_any_order(|l| {
                let mut out = l.alloc_values::<f32>(n * c)?;
                activation::normalize_rows(l, &l.upload_values(&x)?, n as u32, c as u32, &mut out)?;
                values(l, &out, n * c)
            });
            assert_near(&got, &want, 1.2e-7, &format!("{n} rows of {c}, about {scale}"));
        }
    }
}

fn queries_and_keys_turn_with_their_voxel() {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    for (n, count, dim) in [(0, 2, 18), (1, 1, 6), (1025, 2, 18), (300, 3, 36)] {
        let mut cells: Vec<[i32; 3]> =
            (0..n).map(|_| std::array::from_fn(|_| rng.random_range(0..5000))).collect();
        if n > 0 {
            cells[0] = [0, -7, (1 << 21) - 1];
        }
        let qkv = random(n * 3 * count * dim, 4);
        let rotations = Rotations::new(&cells, dim, 100.0);
        for (turn, back) in [(Turn::Forward, false), (Turn::Back, true)] {
            let mut want = qkv.clone();
            rotations.apply(&mut want, Heads { count, dim }, turn);
            let got = bits_in_any_order(|l| {
                let cells = l.upload_values(&cells)?;
                let pairs = point_rope::rotations(l, &cells, n as u32, dim as u32, 100.0)?;
                let mut turned = l.upload_values(&qkv)?;
                let (heads, dim) = (count as u32, dim as u32);
                point_rope::turn(l, &mut turned, &pairs, n as u32, heads, dim, back)?;
                values(l, &turned, qkv.len())
            });
            assert_near(&got, &want, 2e-7, &format!("{n} rows, {count} heads of {dim}"));
            let values_of = |x: &[f32]| -> Vec<f32> {
                let c = count * dim;
                x.chunks_exact(3 * c).flat_map(|row| row[2 * c..].to_vec()).collect()
            };
            assert_same(&values_of(&got), &values_of(&qkv), "values");
        }
    }
}
