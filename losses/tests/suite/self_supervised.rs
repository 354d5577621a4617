//! Losses of self-supervision: values by hand, and hard input.

use crate::support::{attribute, attributes, cube, matrix, noise, number, units, wide};
use candle_core::{DType, Device, Result, Tensor, Var};
use scenesplat_losses::self_supervised::{
    AttributeColumns, Centering, Expansion, GaussianDistance, SimDino, masked_cosine,
    masked_cross_entropy, masked_gaussians, sim_dino, sim_dino_rows, sinkhorn_knopp,
    view_cross_entropy,
};

/// The example of one number each, by the formulas in numpy.
#[test]
fn simdino_by_hand() {
    let wave = |v: f64| -> Vec<f64> {
        let at = |b: usize, k: usize| {
            let (b, k) = (b as f64, k as f64);
            (1.0 + 0.9 * v + 0.5 * b + 0.37 * k + 0.2 * v * k).sin()
        };
        let rows: Vec<f64> =
            (0..3).flat_map(|b| (0..5).map(move |k| (b, k))).map(|(b, k)| at(b, k)).collect();
        units(&rows, 5)
    };
    let student: Vec<f64> = (0..5).flat_map(|v| wave(f64::from(v))).collect();
    let teacher: Vec<f64> = [0.25, 1.25].into_iter().flat_map(wave).collect();
    let (student, teacher) = (cube(&student, 5, 3, DType::F64), cube(&teacher, 2, 3, DType::F64));
    let out = sim_dino(&student, &teacher, &SimDino::default()).unwrap().unwrap();
    let near = |got: f64, want: f64| assert!((got - want).abs() < 1e-6, "{got} {want}");
    near(out.compression, -0.248_772_0);
    near(out.expansion, 1.915_821_7);
    near(number(&out.loss), -1.890_944_6);
    near(out.global_compression, 0.090_542_7);
}

#[test]
fn simdino_rows_by_hand() {
    // Rows (1, 0), (0, 1), (0, 1); ZᵀZ = diag(1, 2), D/(N ε) = 2 / (3 · 0.5).
    let student = matrix(&[1.0, 0.0, 0.0, 1.0, 0.0, 1.0], 2, DType::F64);
    let teacher = matrix(&[0.0, 1.0, 0.0, 1.0, 0.6, 0.8], 2, DType::F64);
    let settings =
        SimDino { coefficient: 3.0, epsilon: 0.5, expansion: Expansion::Student, normalized: true };
    let out = sim_dino_rows(&student, &teacher, &settings).unwrap().unwrap();
    let scale: f64 = 4.0 / 3.0;
    let rate = 5.0 / 6.0 * 0.5 * ((1.0 + scale) * (1.0 + 2.0 * scale)).ln();
    let near = |got: f64, want: f64| assert!((got - want).abs() < 1e-14, "{got} {want}");
    near(out.compression, 0.6);
    near(out.expansion, rate);
    near(number(&out.loss), -1.8 - rate);
    // Means of student and teacher are kept apart: (½, ½), (0, 1), (0.3, 0.9).
    let both = SimDino { expansion: Expansion::StudentAndTeacher, ..settings };
    let out = sim_dino_rows(&student, &teacher, &both).unwrap().unwrap();
    let (a, b, c) = (0.25 + 0.09, 0.25 + 0.27, 0.25 + 1.0 + 0.81);
    let determinant: f64 = (1.0 + scale * a) * (1.0 + scale * c) - (scale * b).powi(2);
    near(out.expansion, 5.0 / 6.0 * 0.5 * determinant.ln());
    let none = SimDino { expansion: Expansion::None, ..settings };
    near(number(&sim_dino_rows(&student, &teacher, &none).unwrap().unwrap().loss), -1.8);
}

#[test]
fn simdino_rows_of_few_and_equal_rows() {
    let row = units(&noise(6, 1), 6);
    // One row: γ · ½ ln(1 + D/ε); a thousand equal ones have the rate of rank one, whatever their length.
    let gamma = |n: f64| (6.0 + n) / (6.0 * n);
    for (n, length, normalized) in [
        (1, 1.0, true),
        (2, 1.0, true),
        (1000, 1.0, true),
        (1000, 1e30, false),
        (1000, 1e-3, false),
    ] {
        let rows: Vec<f64> = row.repeat(n).iter().map(|v| length * v).collect();
        let same = matrix(&rows, 6, DType::F64);
        let settings = SimDino { normalized, ..SimDino::default() };
        let out = sim_dino_rows(&same, &same, &settings).unwrap().unwrap();
        let want = gamma(n as f64) * 0.5 * 121f64.ln();
        assert!((out.expansion - want).abs() < 1e-12, "{n} rows: {} {want}", out.expansion);
        assert!((out.compression - 1.0).abs() < 1e-12);
    }
    // A zero row has no direction: it agrees with nothing and takes no volume, and its slope is finite.
    let rows: Vec<f64> = row.iter().copied().chain([0.0; 6]).collect();
    let zero = Var::from_tensor(&matrix(&rows, 6, DType::F64)).unwrap();
    let settings = SimDino { normalized: false, ..SimDino::default() };
    let out = sim_dino_rows(&zero, &zero, &settings).unwrap().unwrap();
    assert!((out.compression - 0.5).abs() < 1e-12);
    assert!((out.expansion - gamma(2.0) * 0.5 * 61f64.ln()).abs() < 1e-12, "{}", out.expansion);
    let slope = wide(out.loss.backward().unwrap().get(&zero).unwrap());
    assert!(slope.iter().all(|v| v.is_finite()));
}

#[test]
fn ibot_by_hand() {
    let student: Vec<f64> = (0..12).map(|i| f64::from(i).sin()).collect();
    let teacher: Vec<f64> = (0..12).map(|i| (0.5 * f64::from(i)).cos()).collect();
    let (student, teacher) = (matrix(&student, 3, DType::F64), matrix(&teacher, 3, DType::F64));
    let loss = masked_cosine(&student, &teacher, &[0.5, 0.5, 0.25, 0.25]).unwrap().unwrap();
    assert!((number(&loss) + 0.455_192_6).abs() < 1e-6, "{}", number(&loss));
}

#[test]
fn masked_rotations_have_no_sign() {
    let quaternion = [0.5, -0.5, 0.5, 0.5];
    let attributes = [attribute("quat", 0..4)];
    let cost = |p: &[f64], t: &[f64]| {
        let (p, t) = (matrix(p, 4, DType::F64), matrix(t, 4, DType::F64));
        let out = masked_gaussians(&p, &t, None, &attributes, GaussianDistance::Fitted);
        number(&out.unwrap().unwrap().0)
    };
    assert!(cost(&quaternion.map(|v| -3.0 * v), &quaternion) < 1e-15);
    // A quarter turn about z from the identity: sin²(45°).
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    assert!((cost(&[quarter, 0.0, 0.0, quarter], &[1.0, 0.0, 0.0, 0.0]) - 0.5).abs() < 1e-15);
    // A half turn, whose real part is 0; no rotation at all; a prediction of zeros.
    assert!((cost(&[0.0, 0.0, 0.0, 1.0], &[1.0, 0.0, 0.0, 0.0]) - 1.0).abs() < 1e-15);
    assert_eq!(cost(&quaternion, &[0.0; 4]), 0.0);
    assert_eq!(cost(&[0.0; 4], &quaternion), 1.0);
    // In squares the negative is as far as can be.
    let (p, t) = (quaternion.map(|v| -v), quaternion);
    let (p, t) = (matrix(&p, 4, DType::F64), matrix(&t, 4, DType::F64));
    let out = masked_gaussians(&p, &t, None, &attributes, GaussianDistance::MeanSquare);
    let (loss, alone) = out.unwrap().unwrap();
    assert_eq!((number(&loss), alone), (1.0, vec![1.0]));
}

/// Product of quaternions (w, x, y, z).
fn times(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

/// A quaternion from an axis and an angle.
fn turn(axis: [f64; 3], angle: f64) -> [f64; 4] {
    let (sin, cos) = (angle / 2.0).sin_cos();
    [cos, axis[0] * sin, axis[1] * sin, axis[2] * sin]
}

/// Costs of rotation and sizes by the ellipsoid's distance, and the gradient; rows of quaternion and log-sizes.
fn ellipsoid(p: &[f64], t: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let attributes = [attribute("quat", 0..4), attribute("scale", 4..7)];
    let p = Var::from_tensor(&matrix(p, 7, DType::F64)).unwrap();
    let t = matrix(t, 7, DType::F64);
    let out = masked_gaussians(&p, &t, None, &attributes, GaussianDistance::Ellipsoid);
    let (loss, alone) = out.unwrap().unwrap();
    let gradient = loss.backward().unwrap().get(&p).unwrap().flatten_all().unwrap();
    (alone, gradient.to_vec1().unwrap())
}

#[test]
fn masked_ellipsoids_have_no_spelling() {
    let quarter = std::f64::consts::FRAC_PI_2;
    // First axis longest, third shortest: how predictions are read.
    let (q, sizes) = (turn([0.48, 0.6, 0.64], 0.9), [-2.0, -3.1, -5.0]);
    let row = |q: [f64; 4], sizes: [f64; 3]| [q.to_vec(), sizes.to_vec()].concat();
    let prediction = row(turn([0.0, 0.6, 0.8], 2.3).map(|v| 1.7 * v), [-2.2, -2.9, -4.0]);
    let want = ellipsoid(&prediction, &row(q, sizes));
    let mut spellings = 0;
    // Quarter turns about own axes exchange the sizes of the two others.
    let turns =
        [([1.0, 0.0, 0.0], [0, 2, 1]), ([0.0, 1.0, 0.0], [2, 1, 0]), ([0.0, 0.0, 1.0], [1, 0, 2])];
    let mut all = vec![(q, sizes)];
    for _ in 0..4 {
        for (q, s) in all.clone() {
            for (axis, order) in turns {
                let other = (times(q, turn(axis, quarter)), order.map(|i| s[i]));
                let same = |(a, s): &([f64; 4], [f64; 3])| {
                    let cosine: f64 = a.iter().zip(other.0).map(|(a, b)| a * b).sum();
                    cosine.abs() > 1.0 - 1e-9 && *s == other.1
                };
                if !all.iter().any(same) {
                    all.push(other);
                }
            }
        }
    }
    for (q, s) in all {
        for sign in [1.0, -1.0] {
            let (alone, gradient) = ellipsoid(&prediction, &row(q.map(|v| v * sign), s));
            let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
            assert!(near(&alone, &want.0) && near(&gradient, &want.1), "{q:?} {s:?}");
        }
        spellings += 1;
    }
    assert_eq!(spellings, 24);
    let (alone, gradient) = ellipsoid(&row(q.map(|v| -0.3 * v), sizes), &row(q, sizes));
    assert!(alone.iter().chain(&gradient).all(|v| v.abs() < 1e-12), "{alone:?} {gradient:?}");
}

#[test]
fn masked_ellipsoids_count_by_what_can_be_seen_of_them() {
    let identity = [1.0, 0.0, 0.0, 0.0];
    let row = |q: [f64; 4], sizes: [f64; 3]| [q.to_vec(), sizes.to_vec()].concat();
    let cost =
        |p: [f64; 4], t: [f64; 4], sizes: [f64; 3]| ellipsoid(&row(p, sizes), &row(t, sizes)).0[0];
    let third = std::f64::consts::FRAC_PI_6;
    let (about_x, about_z) = (turn([1.0, 0.0, 0.0], third), turn([0.0, 0.0, 1.0], third));
    let (ball, disc, needle) = ([-3.0; 3], [-3.0, -3.0, -9.0], [-3.0, -9.0, -9.0]);
    let thin = 1.0 - (-6.0f64).exp();
    // sin²(30°) = 1/4: a disc's normal, a needle's direction; a turn about either is not seen, nor any of a ball.
    for (sizes, p, want) in [
        (ball, about_x, 0.0),
        (disc, about_x, thin / 4.0),
        (disc, about_z, 0.0),
        (needle, about_x, 0.0),
        (needle, about_z, thin / 4.0),
    ] {
        assert!((cost(p, identity, sizes) - want).abs() < 1e-12, "{sizes:?}");
    }
    // A target without rotation has sizes only; a prediction of zeros is as far as the identity's opposite can be.
    assert_eq!(cost(about_x, [0.0; 4], disc), 0.0);
    let (alone, gradient) = ellipsoid(&[0.0; 7], &row(identity, disc));
    assert!(alone.iter().chain(&gradient).all(|v| v.is_finite()), "{alone:?} {gradient:?}");
    // Sizes beyond f32, and infinite anisotropy.
    let (alone, gradient) = ellipsoid(&row(about_x, ball), &row(identity, [80.0, 0.0, -700.0]));
    assert!(alone.iter().chain(&gradient).all(|v| v.is_finite()), "{alone:?} {gradient:?}");
    assert!((alone[0] - 0.25).abs() < 1e-12);
    // Sizes and rotations are both needed.
    let attributes = &attributes()[..1];
    let (p, t) = (matrix(&[0.1, 0.2], 2, DType::F64), matrix(&[0.1, 0.2], 2, DType::F64));
    let error =
        masked_gaussians(&p, &t, None, attributes, GaussianDistance::Ellipsoid).unwrap_err();
    assert!(error.to_string().contains("three sizes"), "{error}");
}

#[test]
fn attributes_have_a_value_each() {
    let (p, t) = (matrix(&noise(18, 1), 9, DType::F64), matrix(&noise(18, 2), 9, DType::F64));
    for distance in
        [GaussianDistance::MeanSquare, GaussianDistance::Fitted, GaussianDistance::Ellipsoid]
    {
        let (loss, alone) =
            masked_gaussians(&p, &t, None, &attributes(), distance).unwrap().unwrap();
        let want = match distance {
            GaussianDistance::MeanSquare => {
                (2.0 * alone[0] + 4.0 * alone[1] + 3.0 * alone[2]) / 9.0
            }
            _ => alone.iter().sum(),
        };
        assert!((number(&loss) - want).abs() < 1e-15, "{distance:?}");
    }
}

#[test]
fn nothing_masked_and_no_scene_are_off() {
    for dtype in [DType::F32, DType::BF16, DType::F16, DType::F64] {
        for rows in [0, 1, 3] {
            let bad = (Tensor::ones((rows, 9), dtype, &Device::Cpu).unwrap() * f64::NAN).unwrap();
            let none = vec![0.0; rows];
            assert!(masked_cosine(&bad, &bad, &none).unwrap().is_none());
            assert!(masked_cross_entropy(&bad, &bad, &none, 0.1).unwrap().is_none());
            let counts = vec![false; rows];
            let distance = GaussianDistance::Fitted;
            assert!(
                masked_gaussians(&bad, &bad, Some(&counts), &attributes(), distance)
                    .unwrap()
                    .is_none()
            );
        }
        let (s, t) = (
            Tensor::zeros((3, 0, 6), dtype, &Device::Cpu).unwrap(),
            Tensor::zeros((2, 0, 6), dtype, &Device::Cpu).unwrap(),
        );
        assert!(sim_dino(&s, &t, &SimDino::default()).unwrap().is_none());
        assert!(view_cross_entropy(&s, &t, 0.1, true).unwrap().is_none());
        let rows = Tensor::zeros((0, 6), dtype, &Device::Cpu).unwrap();
        assert!(sim_dino_rows(&rows, &rows, &SimDino::default()).unwrap().is_none());
    }
}

#[test]
fn simdino_of_one_scene_one_view_and_equal_rows() {
    let row = units(&noise(6, 1), 6);
    // One view has nothing to agree with; one scene still has a rate.
    let one = cube(&row, 1, 1, DType::F64);
    let out = sim_dino(&one, &one, &SimDino::default()).unwrap().unwrap();
    assert_eq!((out.compression, out.global_compression), (0.0, 0.0));
    // γ · ½ ln(1 + D/ε), D = 6, B = 1
    let want = 7.0 / 6.0 * 0.5 * 121f64.ln();
    assert!((out.expansion - want).abs() < 1e-12, "{}", out.expansion);
    // Eight equal scenes have the rate of rank one, and eight of any length the same.
    for (length, normalized) in [(1.0, true), (1e6, false), (1e-3, false), (1e30, false)] {
        let rows: Vec<f64> = row.repeat(2 * 8).iter().map(|v| length * v).collect();
        let same = cube(&rows, 2, 8, DType::F64);
        let out = sim_dino(&same, &same, &SimDino { normalized, ..SimDino::default() });
        let out = out.unwrap().unwrap();
        let want = 14.0 / 48.0 * 0.5 * 121f64.ln();
        assert!((out.expansion - want).abs() < 1e-12, "{length}: {}", out.expansion);
        assert!((out.compression - 1.0).abs() < 1e-12);
    }
    // More scenes than channels: the other side is factorised, to the same number.
    let rows = units(&noise(2 * 9 * 2, 3), 2);
    let wide_batch = cube(&rows, 2, 9, DType::F64);
    let out = sim_dino(&wide_batch, &wide_batch, &SimDino::default()).unwrap().unwrap();
    let mut want = 0.0;
    for view in rows.chunks_exact(18) {
        let [mut a, mut b, mut c] = [1.0, 0.0, 1.0];
        for row in view.chunks_exact(2) {
            let scale = 2.0 / (9.0 * 0.05);
            a += scale * row[0] * row[0];
            b += scale * row[0] * row[1];
            c += scale * row[1] * row[1];
        }
        want += 0.5 * (a * c - b * b).ln() * 11.0 / 18.0 / 2.0;
    }
    assert!((out.expansion - want).abs() < 1e-12, "{} {want}", out.expansion);
}

/// As τ falls, τ times the cross entropy is what the largest logit is above the target's; targets are one
/// prototype. Neither is lost on the way.
#[test]
fn temperatures_near_0() {
    let student = [0.5, -0.25, 0.75, 1.0, 0.0, -1.0];
    let teacher = [0.125, 0.5, 0.25, -0.5, 0.75, 0.0];
    for dtype in [DType::F64, DType::F32, DType::BF16, DType::F16] {
        let table = |values: &[f64]| {
            Tensor::from_vec(values.to_vec(), (2, 3), &Device::Cpu)
                .unwrap()
                .to_dtype(dtype)
                .unwrap()
        };
        let logits = Var::from_tensor(&table(&student)).unwrap();
        let rows = |t: &Tensor| t.to_dtype(DType::F64).unwrap().to_vec2::<f64>().unwrap();
        for tau in [1e-2, 1e-3, 1e-6, 1e-8] {
            let centering = Centering { center: vec![0.0; 3], momentum: 0.9 };
            let targets = centering.targets(&table(&teacher), tau).unwrap();
            let one = [[0.0, 1.0, 0.0]; 2];
            for (row, want) in rows(&targets).iter().zip(&one) {
                assert!(row.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-9), "{tau}: {row:?}");
            }
            let balanced = rows(&sinkhorn_knopp(&table(&teacher), tau, 3).unwrap());
            for row in &balanced {
                let sum: f64 = row.iter().sum();
                assert!(row.iter().all(|p| (0.0..=1.0 + 1e-6).contains(p)), "{tau}: {row:?}");
                assert!((sum - 1.0).abs() < 1e-6, "{tau}: {row:?}");
            }
            if dtype == DType::F16 && tau < 1e-3 {
                // Costs and slopes of 1/τ are beyond its 65504.
                continue;
            }
            let cost = masked_cross_entropy(&logits, &targets, &[0.5, 0.5], tau).unwrap().unwrap();
            // Row by row 0.75 + 0.25 and 1 − 0.
            let scaled = tau * number(&cost);
            assert!((scaled - 1.0).abs() < 1e-2, "{dtype:?} {tau}: {scaled}");
            let grads = cost.backward().unwrap();
            let slope = rows(grads.get(&logits).unwrap());
            assert!(slope.iter().flatten().all(|v| v.is_finite()), "{dtype:?} {tau}: {slope:?}");
        }
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let ones = |shape: &[usize]| Tensor::ones(shape, DType::F32, &Device::Cpu).unwrap();
    let views = |views, scenes, width| ones(&[views, scenes, width]);
    let message = |result: Result<bool>| result.unwrap_err().to_string();
    let infinite = |t: &Tensor| (t.clone() / 0.0).unwrap();
    // Four equal rows of 10³⁰: no digit of the identity is left.
    let huge = |t: &Tensor| (t.to_dtype(DType::F64).unwrap() * 1e30).unwrap();
    let (s, t, rows) = (views(3, 2, 4), views(2, 2, 4), ones(&[2, 4]));
    let plain = SimDino::default();
    for (s, t, settings, says) in [
        (&s, &views(2, 3, 4), plain, "teacher: expected [1..=3, 2, 4]"),
        (&s, &views(4, 2, 4), plain, "teacher"),
        (&s, &views(0, 2, 4), plain, "teacher"),
        (&s, &t, SimDino { epsilon: 0.0, ..plain }, "epsilon is 0"),
        (&s, &t, SimDino { coefficient: f64::NAN, ..plain }, "coefficient"),
        (&infinite(&s), &t, plain, "student[0, 0] is inf"),
        (&huge(&s), &huge(&t), plain, "normalized"),
    ] {
        let found = message(sim_dino(s, t, &settings).map(|out| out.is_some()));
        assert!(found.contains(says), "{found}");
    }
    for (s, t, settings, says) in [
        (&s, &rows, plain, "student: expected [N, D], got [3, 2, 4]"),
        (&rows, &rows.narrow(0, 0, 1).unwrap(), plain, "sim_dino_rows: teacher"),
        (&rows, &rows, SimDino { epsilon: -1.0, ..plain }, "epsilon is -1"),
        (&infinite(&rows), &rows, plain, "student[0, 0] is inf"),
    ] {
        let found = message(sim_dino_rows(s, t, &settings).map(|out| out.is_some()));
        assert!(found.contains(says), "{found}");
    }
    let entropy = message(view_cross_entropy(&s, &t, -1.0, true).map(|l| l.is_some()));
    assert!(entropy.contains("temperature is -1"), "{entropy}");

    let rows = ones(&[2, 9]);
    for (weights, says) in [(&[1.0][..], "weights"), (&[1.0, f64::NAN], "weights[1, 0] is NaN")] {
        let cosine = message(masked_cosine(&rows, &rows, weights).map(|l| l.is_some()));
        assert!(cosine.contains(says), "{cosine}");
    }
    let all = attributes();
    let refused = |rows: &Tensor, attributes: &[AttributeColumns], says: &str| {
        let out = masked_gaussians(rows, rows, None, attributes, GaussianDistance::Fitted);
        let found = message(out.map(|l| l.is_some()));
        assert!(found.contains(says), "{found}");
    };
    refused(&rows, &all[..2], "expected [N, 6], got [N, 9]");
    refused(&rows, &all[1..], "quat = 2..6");
    refused(&(&rows * f64::NAN).unwrap(), &all, "pred[0, 0] is NaN");
}
