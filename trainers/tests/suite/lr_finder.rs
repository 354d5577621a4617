//! The search for a learning rate on a model small enough to check by hand.

use crate::support::{Batches, Line, Numbers, adamw, config, everything, numbers};
use scenesplat_trainers::{LrCurve, LrFinderConfig, TrainError, find_lr};

fn search(module: &Line, data: Numbers, settings: &LrFinderConfig) -> Result<LrCurve, TrainError> {
    // A rate of the second group, whatever the first one has.
    find_lr(module, data, adamw(&module.params, 0.05, 0.0), 0.05, &config(None), settings)
}

#[test]
fn the_search_leaves_no_trace_and_is_the_same_each_time() {
    let settings = LrFinderConfig { steps: 60, ..LrFinderConfig::default() };
    let module = Line::new();
    let before = everything(&module);
    let curve = search(&module, numbers(), &settings).unwrap();
    assert_eq!(everything(&module), before);
    // The very bits, whatever ran before.
    assert_eq!(search(&module, numbers(), &settings).unwrap(), curve);
    let rates: Vec<f64> = curve.points.iter().map(|point| point.lr).collect();
    assert_eq!(rates[0], 1e-7);
    assert!(rates.windows(2).all(|two| two[0] < two[1]));
    let rate = curve.suggestion.unwrap();
    assert!((1e-3..1.0).contains(&rate), "{curve:?}");
    // The first loss is that of the untouched module.
    let first = search(&module, numbers(), &LrFinderConfig { steps: 3, ..settings }).unwrap();
    assert_eq!(first.points[0].loss, curve.points[0].loss);
}

#[test]
fn the_rate_of_the_optimizer_changes_nothing() {
    let settings = LrFinderConfig { steps: 20, ..LrFinderConfig::default() };
    let with = |lr: f64| {
        let module = Line::new();
        let optimizer = adamw(&module.params, lr, 0.0);
        find_lr(&module, numbers(), optimizer, lr, &config(None), &settings).unwrap()
    };
    let (a, b) = (with(0.5), with(0.25));
    assert!(a.points.iter().zip(&b.points).all(|(a, b)| (a.loss - b.loss).abs() < 1e-5));
}

#[test]
fn a_loss_that_grows_or_is_not_finite_ends_the_search() {
    let settings = LrFinderConfig { to: 1e3, diverged: 2.0, ..LrFinderConfig::default() };
    let module = Line::new();
    let before = everything(&module);
    let grown = search(&module, numbers(), &settings).unwrap();
    assert!(grown.diverged && grown.points.len() < 100, "{}", grown.points.len());
    let poisoned = Numbers { poison: Some((0, 4)), ..numbers() };
    let ended = search(&module, poisoned, &settings).unwrap();
    assert!(ended.diverged && ended.points[4].loss.is_nan(), "{ended:?}");
    assert_eq!((ended.points.len(), everything(&module)), (5, before));
    // What else goes wrong is an error.
    let few = Batches(0, |_, _| Vec::<[f32; 4]>::new());
    let optimizer = adamw(&module.params, 0.05, 0.0);
    assert!(find_lr(&module, few, optimizer, 0.05, &config(None), &settings).is_err());
}
