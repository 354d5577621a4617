//! The comparison, and the clouds that it is done on.

use crate::support_device::device;
use candle_core::{DType, Tensor, Var};
use scenesplat_kernels::serialization::Curve;
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use scenesplat_models::ParamStore;
use scenesplat_models::weights::{WeightSource, unit};
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
    Var::from_tensor(&Tensor::from_vec(values, shape, &device()).unwrap()).unwrap()
}

pub fn flat(t: &Tensor) -> Vec<f64> {
    t.flatten_all().unwrap().to_dtype(DType::F64).unwrap().to_vec1().unwrap()
}

/// Trainable parameters with hashed values.
pub fn store() -> ParamStore {
    ParamStore::trainable_from(WeightSource::hashed(3, ""), 0).on(&device())
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

    let noise = Tensor::from_vec(unit("R", want.len(), 5), out.dims(), &device()).unwrap();
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

/// Two scenes with neighbours and with voxels apart, their rows in no order.
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
