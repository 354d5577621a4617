//! The comparison, and the clouds that it is done on.

use crate::support::devices::here;
use crate::support::noise_like;
use candle_core::{DType, Tensor, Var};
use scenesplat_kernels::serialization::Curve;
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use scenesplat_models::weights::{WeightSource, unit};
use scenesplat_models::{Mode, ParamStore};
use std::collections::BTreeMap;

/// Values by name, in f64.
pub type Values = BTreeMap<String, Vec<f64>>;

/// Largest difference of an f32 output or gradient, relative to the largest value: some hundred
/// roundings of 6e-8, and norms that divide by what is left of a cancellation.
pub const F32_EPS: f64 = 1e-5;
/// The same with operands rounded to 8 bits.
pub const BF16_EPS: f64 = 2e-2;
/// Small enough for the cube of it to be nothing, large enough for f64 differences to keep ten
/// digits.
const STEP: f64 = 1e-5;

/// Noise with a name, as a variable.
pub fn var(name: &str, shape: &[usize]) -> Var {
    let values = unit(name, shape.iter().product(), 11);
    Var::from_tensor(&Tensor::from_vec(values, shape, &here()).unwrap()).unwrap()
}

pub fn flat(t: &Tensor) -> Vec<f64> {
    t.flatten_all().unwrap().to_dtype(DType::F64).unwrap().to_vec1().unwrap()
}

/// Trainable parameters with hashed values.
pub fn store() -> ParamStore {
    ParamStore::trainable_from(WeightSource::hashed(3, ""), 0).on(&here())
}

/// Checks an output and the gradients of ⟨output, noise⟩ to each variable, element by element.
pub fn check(
    case: &str,
    eps: f64,
    vars: &[(&str, &Var)],
    out: &Tensor,
    slow: impl Fn(&Values) -> Vec<f64>,
) {
    let values: Values = vars.iter().map(|(name, v)| ((*name).to_owned(), flat(v))).collect();
    let want = slow(&values);
    compare(&format!("{case}: output"), eps, &flat(out), &want);

    let noise = noise_like(out, "R", 5);
    let direction = flat(&noise);
    let grads = (out * noise).unwrap().sum_all().unwrap().backward().unwrap();
    let loss =
        |values: &Values| -> f64 { slow(values).iter().zip(&direction).map(|(o, r)| o * r).sum() };
    for (name, var) in vars {
        let got = grads.get(var).unwrap_or_else(|| panic!("{case}: {name} has no gradient"));
        let mut values = values.clone();
        let differences: Vec<f64> = (0..got.elem_count())
            .map(|i| {
                let at = values[*name][i];
                let mut moved = |to: f64| {
                    values.get_mut(*name).unwrap()[i] = to;
                    loss(&values)
                };
                let difference = moved(at + STEP) - moved(at - STEP);
                moved(at);
                difference / (2.0 * STEP)
            })
            .collect();
        compare(&format!("{case}: gradient of {name}"), eps, &flat(got), &differences);
    }
}

/// [`check`] of a part with a store: all its parameters, which must all be used, and the inputs.
pub fn check_part(
    case: &str,
    eps: f64,
    store: &ParamStore,
    inputs: &[(&str, &Var)],
    out: &Tensor,
    slow: impl Fn(&Values) -> Vec<f64>,
) {
    assert!(store.report().is_complete(), "{case}: {}", store.report());
    let parameters = store.parameters();
    let mut vars: Vec<(&str, &Var)> = inputs.to_vec();
    vars.extend(parameters.iter().map(|(name, v)| (name.as_str(), v)));
    check(case, eps, &vars, out, slow);
}

/// As [`check_part`] of a part with batch norms, which take the gradient of these biases in front of them away.
pub fn check_normed(
    case: &str,
    store: &ParamStore,
    biases: &[&str],
    inputs: &[(&str, &Var)],
    out: &Tensor,
    slow: impl Fn(&Values) -> Vec<f64>,
) {
    assert!(store.report().is_complete(), "{case}: {}", store.report());
    let parameters = store.parameters();
    let moved = |(name, _): &(&String, _)| !biases.contains(&name.as_str());
    let mut vars: Vec<_> =
        parameters.iter().filter(moved).map(|(name, v)| (name.as_str(), v)).collect();
    vars.extend(inputs);
    let fixed: Values = biases.iter().map(|n| ((*n).to_owned(), flat(&parameters[*n]))).collect();
    check(case, F32_EPS, &vars, out, |v| {
        let mut all = v.clone();
        all.extend(fixed.clone());
        slow(&all)
    });
    let grads = out.sqr().unwrap().sum_all().unwrap().backward().unwrap();
    let largest = |v: &Var| flat(grads.get(v).unwrap()).iter().fold(0f64, |a, g| a.max(g.abs()));
    for name in biases {
        let (of_bias, of_input) = (largest(&parameters[*name]), largest(inputs[0].1));
        assert!(of_bias < F32_EPS * of_input, "{case}: {name}: {of_bias}");
    }
}

/// Mean and variance that a batch norm applies: none of its own in training.
pub struct Statistics(Option<(Vec<f64>, Vec<f64>)>);

impl Statistics {
    /// Those that the norm with this prefix remembers.
    pub fn of(store: &ParamStore, prefix: &str, mode: Mode) -> Self {
        let buffers = store.buffers();
        let of = |what: &str| flat(&buffers[&format!("{prefix}running_{what}")]);
        Self((mode == Mode::Eval).then(|| (of("mean"), of("var"))))
    }

    pub fn get(&self) -> Option<(&[f64], &[f64])> {
        self.0.as_ref().map(|(mean, var)| (mean.as_slice(), var.as_slice()))
    }
}

fn compare(what: &str, eps: f64, got: &[f64], want: &[f64]) {
    assert_eq!(got.len(), want.len(), "{what}: length");
    let largest = want.iter().fold(0f64, |a, v| a.max(v.abs()));
    assert!(largest > 1e-3, "{what}: everything is zero");
    let mut worst = (0f64, 0);
    for (i, (g, w)) in got.iter().zip(want).enumerate() {
        assert!(g.is_finite(), "{what}[{i}] is {g}");
        let error = (g - w).abs() / largest;
        if error > worst.0 {
            worst = (error, i);
        }
    }
    println!("{what}: {:.1e} of the largest", worst.0);
    let (error, i) = worst;
    assert!(error < eps, "{what}[{i}]: {} instead of {} (largest {largest})", got[i], want[i]);
}

/// Two scenes with neighbors and with voxels apart, their rows in no order.
pub fn cloud() -> SerializedCloud {
    let mut cells: Vec<[i32; 3]> = (0..19).map(|i| [i * 7 % 3, i * 5 % 4, i / 6]).collect();
    cells.sort_unstable();
    cells.dedup();
    cells.push([9, 9, 9]);
    let first = cells.len();
    cells.extend([[1, 1, 1], [1, 1, 2], [2, 1, 1], [0, 0, 0], [3, 3, 2]]);
    let n = cells.len();
    let offsets = vec![0, first, n];
    SerializedCloud::new(cells, offsets, &Curve::ALL, CurveDepth::WholeBatch).unwrap()
}
