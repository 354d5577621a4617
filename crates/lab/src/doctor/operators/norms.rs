//! Layer norm, batch norm and rows of unit length.

use super::compare::{F32, Wide, compare, gradients, wide};
use crate::doctor::case::{Case, Finding};
use crate::doctor::noise::noise;
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_kernels::unit_rows::check_unit_rows;
use scenesplat_kernels::{batch_norm, layer_norm, normalize};

/// As in the networks.
const EPS: f32 = 1e-5;

/// Rows for layer norm: name, values of a row of [`C`] channels.
const ROWS: &[(&str, fn(usize) -> Vec<f32>)] = &[
    ("noise", |row| noise(C, row as u64, 1.0)),
    ("variance-0", |row| vec![row as f32 * 3.7 - 11.0; C]),
    ("variance-1e-30", |row| noise(C, row as u64, 1e-15)),
    ("offset", |row| noise(C, row as u64, 1.0).into_iter().map(|v| v + 100.0).collect()),
    ("size-1e15", |row| noise(C, row as u64, 1e15)),
    ("one-spike", |row| {
        let mut values = noise(C, row as u64, 1e-3);
        values[row % C] = 1e4;
        values
    }),
];

/// Channels: no multiple of a register.
const C: usize = 37;

/// Columns for batch norm: name, value of a row and channel, number of rows.
const COLUMNS: &[(&str, fn(usize, usize) -> f32, usize)] = &[
    ("noise", |r, c| one_of(r, c, 1.0), 3000),
    ("one-row", |_, c| c as f32 - 5.5, 1),
    ("constant", |_, c| 0.1 * c as f32, 1500),
    ("offset-1e6", |r, c| 1e6 + one_of(r, c, 1.0), 2000),
    ("size-1e18", |r, c| one_of(r, c, 1e18), 500),
    ("no-row", |_, _| 0.0, 0),
];

fn one_of(row: usize, channel: usize, size: f32) -> f32 {
    noise(1, (row * C + channel) as u64, size)[0]
}

/// Rows for division by their norm: name, size.
const UNITS: &[(&str, f32)] = &[("zero", 0.0), ("1e-10", 1e-10), ("1e-30", 1e-30), ("1e38", 1e38)];

pub(super) fn cases() -> Vec<Case> {
    let layers =
        ROWS.iter().map(|&(name, row)| case(format!("layer-norm-{name}"), move |t| layer(t, row)));
    let gradients = [
        case("layer-norm-gradient", |t| layer_gradient(t, |row| noise(C, row as u64, 1.0))),
        case("layer-norm-gradient-variance-0", |t| layer_gradient(t, |row| vec![row as f32; C])),
    ];
    let batches = COLUMNS.iter().map(|&(name, value, rows)| {
        case(format!("batch-norm-{name}"), move |t| batch(t, value, rows))
    });
    let units =
        UNITS.iter().map(|&(name, size)| case(format!("unit-rows-{name}"), move |t| unit(t, size)));
    layers
        .chain(gradients)
        .chain(batches)
        .chain([case("batch-norm-gradient", batch_gradient)])
        .chain(units)
        .chain([case("unit-rows-checked", unit_rows_checked)])
        .collect()
}

fn unit_rows_checked(_: &Trial<'_>) -> Result<(), Failure> {
    ensure!(check_unit_rows(&[0.6, 0.8, 0.0, 1.0], 2).is_ok(), "unit rows are refused");
    for bad in [[3.0, 4.0], [0.0, 0.0], [f32::NAN, 1.0], [0.6, 0.81]] {
        let rows = [0.0, 1.0, bad[0], bad[1]];
        ensure!(check_unit_rows(&rows, 2).is_err(), "{bad:?} counts as a unit row");
    }
    Ok(())
}

/// Enough rows for several tasks.
const N: usize = 300;

fn rows(row: fn(usize) -> Vec<f32>) -> Vec<f32> {
    (0..N).flat_map(row).collect()
}

/// Mean and variance in f64.
fn moments(x: &[f64]) -> (f64, f64) {
    let n = f64::from(x.len() as u32);
    let mean = x.iter().sum::<f64>() / n;
    (mean, x.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n)
}

fn layer(trial: &Trial<'_>, row: fn(usize) -> Vec<f32>) -> Result<Finding, Failure> {
    let (x, weight, bias) = (rows(row), noise(C, 1001, 1.0), noise(C, 1002, 1.0));
    trial.keep("x", &x)?;
    let got = trial.one_and_many(|| {
        let mut out = vec![0.0; x.len()];
        layer_norm::forward(&x, None, &weight, &bias, EPS, &mut out);
        Ok(out)
    })?;
    let mut want = Vec::new();
    for row in x.chunks_exact(C) {
        let row = wide(row);
        let (mean, var) = moments(&row);
        let deviation = (var + f64::from(EPS)).sqrt();
        let largest = row.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        for (j, x) in row.iter().enumerate() {
            let (w, b) = (f64::from(weight[j]), f64::from(bias[j]));
            let term = (x - mean) / deviation * w;
            // The mean of f32 values, a sum in f32, is known to so much.
            let unit = 2.0 * f64::from(f32::EPSILON);
            let rounding = largest / deviation * w.abs() * unit / F32;
            want.push(Wide::of(term + b, term.abs() + b.abs() + rounding));
        }
    }
    compare(&got, &want, |i| format!("row {}, channel {}", i / C, i % C))
}

fn layer_gradient(trial: &Trial<'_>, row: fn(usize) -> Vec<f32>) -> Result<Finding, Failure> {
    let (x, weight, upstream) = (rows(row), noise(C, 1003, 1.0), noise(N * C, 1004, 1.0));
    let got = trial.one_and_many(|| {
        let mut dx = vec![0.0; x.len()];
        let (dw, db) = layer_norm::backward(&x, &upstream, &weight, EPS, &mut dx);
        dx.extend(dw);
        dx.extend(db);
        Ok(dx)
    })?;
    let (mut want, mut dw, mut db) = (Vec::new(), vec![0.0; C], vec![0.0; C]);
    for (x, up) in x.chunks_exact(C).zip(upstream.chunks_exact(C)) {
        let (x, up) = (wide(x), wide(up));
        let (mean, var) = moments(&x);
        let inverse = 1.0 / (var + f64::from(EPS)).sqrt();
        let unit: Vec<f64> = x.iter().map(|v| (v - mean) * inverse).collect();
        let g: Vec<f64> = up.iter().zip(&weight).map(|(u, w)| u * f64::from(*w)).collect();
        let n = f64::from(C as u32);
        let mean_g = g.iter().sum::<f64>() / n;
        let mean_gx = g.iter().zip(&unit).map(|(g, u)| g * u).sum::<f64>() / n;
        for j in 0..C {
            want.push(inverse * (g[j] - mean_g - unit[j] * mean_gx));
            dw[j] += up[j] * unit[j];
            db[j] += up[j];
        }
    }
    gradients(&got, &[want, dw, db])
}

fn batch(trial: &Trial<'_>, value: fn(usize, usize) -> f32, n: usize) -> Result<Finding, Failure> {
    let x: Vec<f32> = (0..n * C).map(|i| value(i / C, i % C)).collect();
    trial.keep("x", &x)?;
    let got = trial.same_on_threads(|| Ok(batch_norm::statistics(&x, C)))?;
    let mut found = Finding::right();
    let relative = |got: f64, want: f64, scale: f64| match got == want {
        true => 0.0,
        false => (got - want).abs() / scale,
    };
    for c in 0..C {
        let column: Vec<f64> = (0..n).map(|r| f64::from(x[r * C + c])).collect();
        let (mean, var) = if n == 0 { (0.0, 0.0) } else { moments(&column) };
        let size = column.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        found.add(relative(got.mean[c], mean, size), || {
            format!("mean of channel {c}: {:e}, f64 {mean:e}", got.mean[c])
        });
        // Below this a variance is the rounding of values of that size.
        let least = (size * 1e-10).powi(2);
        found.add(relative(got.var[c], var, var.max(least)), || {
            format!("variance of channel {c}: {:e}, f64 {var:e}", got.var[c])
        });
    }
    Ok(found)
}

fn batch_gradient(trial: &Trial<'_>) -> Result<Finding, Failure> {
    let n = 2500;
    let (x, up, weight) = (noise(n * C, 5, 1.0), noise(n * C, 6, 1.0), noise(C, 7, 1.0));
    let statistics = batch_norm::statistics(&x, C);
    let eps = f64::from(EPS);
    let inverse: Vec<f64> = statistics.var.iter().map(|v| 1.0 / (v + eps).sqrt()).collect();
    let got = trial.one_and_many(|| {
        let mut dx = vec![0.0; n * C];
        let (dw, db) =
            batch_norm::backward(&x, &up, &weight, &statistics.mean, &inverse, true, &mut dx);
        dx.extend(dw);
        dx.extend(db);
        Ok(dx)
    })?;
    let (mut want, mut dw, mut db) = (vec![0.0; n * C], vec![0.0; C], vec![0.0; C]);
    for c in 0..C {
        let column: Vec<f64> = (0..n).map(|r| f64::from(x[r * C + c])).collect();
        let g: Vec<f64> = (0..n).map(|r| f64::from(up[r * C + c])).collect();
        let (mean, var) = moments(&column);
        let inverse = 1.0 / (var + eps).sqrt();
        let unit: Vec<f64> = column.iter().map(|v| (v - mean) * inverse).collect();
        let rows = f64::from(n as u32);
        db[c] = g.iter().sum();
        dw[c] = g.iter().zip(&unit).map(|(g, u)| g * u).sum();
        for r in 0..n {
            let w = f64::from(weight[c]) * inverse;
            want[r * C + c] = w * (g[r] - db[c] / rows - unit[r] * dw[c] / rows);
        }
    }
    gradients(&got, &[want, dw, db])
}

fn unit(trial: &Trial<'_>, size: f32) -> Result<Finding, Failure> {
    let x = noise(500 * C, 8, size);
    let got = trial.one_and_many(|| {
        let mut rows = x.clone();
        normalize::normalize_rows(&mut rows, C);
        Ok(rows)
    })?;
    let mut want = Vec::new();
    for row in x.chunks_exact(C) {
        let norm = row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt().max(1e-12);
        want.extend(row.iter().map(|v| Wide::of(f64::from(*v) / norm, 1.0)));
    }
    compare(&got, &want, |i| format!("row {}, channel {}", i / C, i % C))
}
