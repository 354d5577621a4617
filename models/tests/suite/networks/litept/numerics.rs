//! Outputs and gradients beside those of the formulas.

use super::reference::{Formulas, Reference, Values};
use super::scenes::{decoded, frozen, plain, room, trainable};
use crate::support::devices::elsewhere;
use crate::support::{Scene, batch, flat, gradients, rng};
use scenesplat_kernels::Precision;
use scenesplat_models::weights::unit;
use scenesplat_models::{Compute, Forward, LitePtConfig, Mode, Orders};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Largest difference of an output in f32, relative to the largest value.
const F32_EPS: f64 = 1e-5;
/// Root of the summed squared differences with operands of 8 bits, relative to that of the values:
/// single values of a row may be off by more.
const BF16_EPS: f64 = 2e-2;

fn configs() -> [(&'static str, LitePtConfig); 2] {
    [("plain", plain()), ("decoded", decoded())]
}

fn reference<'a>(config: &'a LitePtConfig, orders: &Orders) -> Reference<'a> {
    let orders = match orders {
        Orders::Given(p) => Some(p.clone()),
        _ => None,
    };
    let layers = Formulas {
        values: Values::default(),
        order: config.order.clone(),
        mlp_ratio: config.mlp_ratio,
        rope_base: Some(config.rope_base),
    };
    Reference { config, layers, train: false, orders }
}

/// Largest difference, relative to the largest value.
pub fn error(got: &[f32], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    let largest = want.iter().fold(0f64, |a, v| a.max(v.abs()));
    assert!(largest > 0.1, "everything is small");
    let pairs = got.iter().zip(want);
    pairs.fold(0f64, |a, (g, w)| {
        assert!(g.is_finite());
        a.max((f64::from(*g) - w).abs() / largest)
    })
}

/// Root of the summed squared differences, relative to that of the values.
fn mean_error(got: &[f32], want: &[f64]) -> f64 {
    let square = |sum: f64, v: f64| sum + v * v;
    let off = got.iter().zip(want).map(|(g, w)| f64::from(*g) - w).fold(0.0, square);
    (off / want.iter().copied().fold(0.0, square)).sqrt()
}

#[test]
pub fn outputs_are_those_of_the_formulas() {
    let scenes = [&room(12, "a"), &room(7, "b")];
    for (name, config) in configs() {
        let attending = if name == "plain" { 2 } else { 3 };
        let given = (0..attending).map(|i| (0..4).map(|j| (i + 3 * j + 1) % 4).collect());
        for orders in [Orders::Listed, Orders::Given(given.collect())] {
            let want = reference(&config, &orders).forward(&scenes);
            for (what, compute, eps) in [
                ("exact", Compute::EXACT, F32_EPS),
                ("joined", Compute::default(), F32_EPS),
                ("bf16", Compute { precision: Precision::Bf16, fold: true }, BF16_EPS),
            ] {
                let mut rng = rng(0);
                let mut cx = Forward { orders: orders.clone(), ..Forward::eval(&mut rng) };
                let network = frozen(&config, compute);
                let out = network.forward(&batch(&scenes), &mut cx).unwrap();
                let measure = if compute.precision == Precision::F32 { error } else { mean_error };
                let found = measure(&flat(&out), &want);
                println!("{name}, {what}, {orders:?}: {found:.1e}");
                assert!(found < eps, "{name}, {what}, {orders:?}: {found:.1e}");
                // Eight bits of mantissa are seen.
                assert!(eps < BF16_EPS || found > 1e-4, "nothing was rounded: {found:.1e}");
            }
            // Trainable layers compute the same, layer by layer.
            let mut rng = rng(0);
            let mut cx = Forward { orders: orders.clone(), ..Forward::eval(&mut rng) };
            let out = trainable(&config).1.forward(&batch(&scenes), &mut cx).unwrap();
            assert!(error(&flat(&out), &want) < F32_EPS, "{name}, trainable");
        }
    }
}

#[test]
fn curves_positions_and_patches_matter() {
    // What the test above would not see if the network ignored it.
    let scenes = [&room(12, "a")];
    let moved = |config: &LitePtConfig, orders: &Orders| reference(config, orders).forward(&scenes);
    let config = plain();
    let usual = moved(&config, &Orders::Listed);
    let far = |other: Vec<f64>| -> bool {
        let largest = usual.iter().fold(0f64, |a, v| a.max(v.abs()));
        other.iter().zip(&usual).any(|(a, b)| (a - b).abs() > 100.0 * F32_EPS * largest)
    };
    assert!(far(moved(&config, &Orders::Given(vec![vec![2, 3, 0, 1]; 2]))));
    assert!(far(moved(&LitePtConfig { rope_base: 50.0, ..config.clone() }, &Orders::Listed)));
    let patches = LitePtConfig { enc_patch_size: vec![1024; 4], ..config };
    assert!(far(moved(&patches, &Orders::Listed)));
}

/// Size of the steps of differences.
const STEP: f64 = 1e-6;

/// A direction of a parameter: all its values count.
fn direction(parameter: &str, len: usize) -> Vec<f64> {
    unit(&format!("{parameter}.direction"), len, 9).into_iter().map(f64::from).collect()
}

/// Differences of the f64 formulas along a direction of each parameter. They take longer than a network on any device, and
/// are the same for all of them: computed once.
fn differences(
    name: &'static str,
    slow: &Reference<'_>,
    scenes: &[&Scene],
    parameters: &BTreeMap<String, Vec<f32>>,
    out: &[f64],
) -> Arc<BTreeMap<String, f64>> {
    type Known = Mutex<BTreeMap<(&'static str, bool), Arc<BTreeMap<String, f64>>>>;
    static KNOWN: Known = Mutex::new(BTreeMap::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let entry = known.entry((name, slow.train)).or_insert_with(|| {
        let loss = || -> f64 { slow.forward(scenes).iter().zip(out).map(|(o, r)| o * r).sum() };
        let of = |(parameter, values): (&String, &Vec<f32>)| {
            let along = direction(parameter, values.len());
            slow.layers.values.shift(parameter, STEP, &along);
            let above = loss();
            slow.layers.values.shift(parameter, -2.0 * STEP, &along);
            let below = loss();
            slow.layers.values.shift(parameter, STEP, &along);
            (parameter.clone(), (above - below) / (2.0 * STEP))
        };
        Arc::new(parameters.iter().map(of).collect())
    });
    entry.clone()
}

#[test]
pub fn gradients_are_differences_of_the_formulas() {
    let scenes = [&room(5, "a"), &room(3, "b")];
    for (name, config) in configs() {
        // Batch norms of a few coarse rows divide by what little these differ, which magnifies
        // rounding errors.
        for (mode, eps) in [(Mode::Eval, 3e-5), (Mode::Train, 3e-4)] {
            let config = LitePtConfig { drop_path: 0.0, ..config.clone() };
            let (store, network) = trainable(&config);
            let mut rng = rng(0);
            let mut cx = Forward { mode, ..Forward::eval(&mut rng) };
            let out = network.forward(&batch(&scenes), &mut cx).unwrap();
            let (got, out) = (gradients(&store, &out, 5), flat(&out));
            let slow =
                Reference { train: mode == Mode::Train, ..reference(&config, &Orders::Listed) };
            let found = error(&out, &slow.forward(&scenes));
            // So do outputs, where sums are not in f64 or products are another library's.
            let most = if mode == Mode::Train && elsewhere() { 5e-5 } else { F32_EPS };
            assert!(found < most, "{name}, {mode:?}: output {found:.1e}");
            let of_out: Vec<f64> = unit("R", out.len(), 5).into_iter().map(f64::from).collect();
            let wanted = differences(name, &slow, &scenes, &got, &of_out);
            let norm =
                |values: &[f32]| values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
            let largest = got.values().map(|g| norm(g)).fold(0f64, f64::max);
            let mut worst = (0f64, String::new());
            for (parameter, gradient) in &got {
                let along = direction(parameter, gradient.len());
                let want = wanted[parameter];
                let found: f64 = gradient.iter().zip(&along).map(|(g, d)| f64::from(*g) * d).sum();
                let length = along.iter().map(|d| d * d).sum::<f64>().sqrt();
                // Parameters without effect (the bias of a key, of what is normalized next) have
                // rounding errors of the others.
                let scale = norm(gradient) * length / (gradient.len() as f64).sqrt();
                let scale = scale.max(1e-3 * largest * length);
                let off = (found - want).abs() / scale;
                if off > worst.0 {
                    worst = (off, parameter.clone());
                }
            }
            println!("{name}, {mode:?}: gradients off by {:.1e} ({})", worst.0, worst.1);
            let most = if mode == Mode::Train && elsewhere() { 1e-3 } else { eps };
            assert!(worst.0 < most, "{name}, {mode:?}: {:.1e} of {}", worst.0, worst.1);
        }
    }
}

/// Names and shapes that the formulas asked for are those that the network has.
#[test]
fn names_are_those_of_the_published_weights() {
    let scenes = [&room(4, "a")];
    for (name, config) in configs() {
        let slow = reference(&config, &Orders::Listed);
        slow.forward(&scenes);
        let mut want = slow.layers.values.shapes();
        // Counters, which nothing computes with.
        let counters: Vec<String> = want
            .keys()
            .filter_map(|n| n.strip_suffix("running_mean"))
            .map(|n| format!("{n}num_batches_tracked"))
            .collect();
        want.extend(counters.into_iter().map(|n| (n, vec![])));
        assert_eq!(trainable(&config).0.shapes(), want, "{name}");
    }
}
