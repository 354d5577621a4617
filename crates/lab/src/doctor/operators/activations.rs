//! Exponential, normal distribution and GELU over the whole range of f32.

use super::compare::{Wide, compare};
use super::products::normal_cdf;
use crate::doctor::case::{Case, Finding};
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial};
use scenesplat_kernels::activation::{
    exp_in_place, gelu_backward, gelu_forward, normal_cdf_in_place,
};

pub(super) fn cases() -> Vec<Case> {
    vec![
        case("exp", |t| {
            // Below −87.3 there are denormals, which the kernel takes for 0.
            sweep(t, exp_in_place, |x| match x {
                x if x < -87.3 => Wide::of(0.0, 1e-30),
                // From 88.7 on it may be infinite; it has to be from 88.73 on.
                x if (88.7..88.73).contains(&x) => Wide::of(x.exp(), f64::INFINITY),
                x if x >= 88.73 => Wide::own(f64::INFINITY),
                x => Wide::own(x.exp()),
            })
        }),
        case("normal-cdf", |t| {
            sweep(t, normal_cdf_in_place, |x| Wide::of(normal_cdf(x), normal_cdf(x).max(1e-30)))
        }),
        case("gelu", |t| {
            sweep(
                t,
                |x| in_place(x, gelu_forward),
                |x| {
                    // −∞ · 0 is no number, in PyTorch too.
                    let value = x * normal_cdf(x);
                    Wide::of(value, value.abs().max(1e-30))
                },
            )
        }),
        case("gelu-gradient", |t| {
            sweep(
                t,
                |x| in_place(x, |x, out| gelu_backward(x, &vec![1.0; x.len()], out)),
                gelu_slope,
            )
        }),
    ]
}

fn in_place(values: &mut [f32], run: impl FnOnce(&[f32], &mut [f32])) {
    let x = values.to_vec();
    run(&x, values);
}

fn gelu_slope(x: f64) -> Wide {
    if x.is_infinite() {
        return Wide::own(f64::from(u8::from(x > 0.0)));
    }
    let density = (-x * x / 2.0).exp() / (2.0 * std::f64::consts::PI).sqrt();
    let (a, b) = (normal_cdf(x), x * density);
    // Two terms that cancel at −0.75.
    Wide::of(a + b, (a + b.abs()).max(1e-30))
}

/// The range of f32 at steps that are fine where functions bend.
fn inputs() -> Vec<f32> {
    let mut all: Vec<f32> = (-48_000..=48_000).map(|i| i as f32 * 0.002).collect();
    for exponent in -44..=38 {
        let size = 10f32.powi(exponent);
        all.extend([size, -size, 3.3 * size, -3.3 * size]);
    }
    all.extend([f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 0.0, -0.0, f32::MAX, f32::MIN]);
    all
}

fn sweep(
    trial: &Trial<'_>,
    run: fn(&mut [f32]),
    reference: impl Fn(f64) -> Wide,
) -> Result<Finding, Failure> {
    let x = inputs();
    trial.keep("x", &x)?;
    let got = trial.one_and_many(|| {
        let mut values = x.clone();
        run(&mut values);
        Ok(values)
    })?;
    let want: Vec<Wide> = x
        .iter()
        .map(|&x| if x.is_nan() { Wide::own(f64::NAN) } else { reference(f64::from(x)) })
        .collect();
    compare(&got, &want, |i| format!("at {:e}", x[i]))
}
