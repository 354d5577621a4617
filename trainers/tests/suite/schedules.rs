//! Schedules where the formulas get thin: short runs, ends, beyond.

use scenesplat_trainers::{CosineSchedule, OneCycle, Schedule};

fn close(got: f64, expected: f64) {
    assert!((got - expected).abs() <= 1e-6 * expected.abs(), "got {got}, expected {expected}");
}

#[test]
fn one_cycle_over_a_hundred_steps() {
    let schedule = OneCycle::default();
    for (step, lr, beta1) in [
        (0, 6.0e-4, 0.95),
        (1, 1.390_812e-3, 0.935_355),
        (2, 3.3e-3, 0.90),
        (3, 5.209_188e-3, 0.864_645),
        (4, 6.0e-3, 0.85),
        (99, 6e-7, 0.95),
        (100, 6e-7, 0.95),
        (u64::MAX, 6e-7, 0.95),
    ] {
        close(0.006 * schedule.factor(step, 100), lr);
        close(schedule.beta1(step, 100).unwrap(), beta1);
    }
}

#[test]
fn one_cycle_of_short_runs_is_finite_and_ends_low() {
    let schedule = OneCycle::default();
    schedule.check().unwrap();
    for total in 0..60 {
        for step in 0..total + 2 {
            let factor = schedule.factor(step, total);
            assert!((1e-4 * 0.999..=1.0).contains(&factor), "{step} of {total}: {factor}");
            let beta1 = schedule.beta1(step, total).unwrap();
            assert!((0.85 - 1e-12..=0.95 + 1e-12).contains(&beta1));
        }
        close(schedule.factor(total.saturating_sub(1), total), 1e-4);
    }
    // A rise of exactly no steps is over at once.
    assert_eq!(schedule.factor(0, 20), 1.0);
    let all_rise = OneCycle { warmup: 1.0, ..schedule };
    close(all_rise.factor(9, 10), 1.0);
    let no_rise = OneCycle { warmup: 0.0, ..schedule };
    assert!(no_rise.factor(0, 10) < 1.0);
    assert!((0..100_000_000_u64).step_by(9_999_991).all(|n| {
        let factor = schedule.factor(n, 100_000_000);
        factor.is_finite() && factor > 0.0
    }));
}

#[test]
fn cosine_with_and_without_warmup() {
    let plain = CosineSchedule::new(1.0, 0.0);
    assert_eq!([0, 5, 10, 11].map(|n| plain.value(n, 10)), [1.0, 0.5, 0.0, 0.0]);
    let warm = CosineSchedule { warmup: 0.3, warmup_from: 0.0, from: 1.0, to: 0.0 };
    let first: Vec<f64> = (0..4).map(|n| warm.factor(n, 10)).collect();
    assert_eq!(first, [0.0, 0.5, 1.0, 1.0]);
    assert_eq!(warm.hyperparameters(1, 10).lr_scale, 0.5);
    assert_eq!(warm.hyperparameters(1, 10).beta1, None);
    let one_step = CosineSchedule { warmup: 0.1, ..warm };
    assert_eq!([0, 1].map(|n| one_step.value(n, 10)), [0.0, 1.0]);
    let only_warm = CosineSchedule { warmup: 1.0, ..warm };
    assert_eq!([0, 9, 10].map(|n| only_warm.value(n, 10)), [0.0, 1.0, 0.0]);
    assert_eq!(warm.value(0, 0), 0.0);
}

#[test]
fn settings_from_files_are_checked() {
    let plain = OneCycle::default();
    for bad in [
        OneCycle { warmup: -0.1, ..plain },
        OneCycle { warmup: f64::NAN, ..plain },
        OneCycle { div_factor: 0.0, ..plain },
        OneCycle { final_div_factor: f64::INFINITY, ..plain },
        OneCycle { max_beta1: 1.0, ..plain },
    ] {
        assert!(bad.check().is_err(), "{bad:?}");
    }
    CosineSchedule::teacher_temperature().check().unwrap();
    assert!(CosineSchedule { warmup: 2.0, ..CosineSchedule::weight_decay() }.check().is_err());
    assert!(CosineSchedule::new(f64::NAN, 0.0).check().is_err());
}
