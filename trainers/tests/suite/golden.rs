//! Schedules, AdamW, clipping and moving averages of the original code.

use crate::support::{tensor, values};
use candle_core::{Tensor, Var, backprop::GradStore};
use scenesplat_test_support::Golden;
use scenesplat_trainers::{
    AdamW, AdamWConfig, CosineSchedule, OneCycle, Optimizer, ParamGroup, Schedule,
    StepHyperparameters, clip_grad_norm, ema_update,
};
use std::collections::BTreeMap;

fn float(golden: &Golden, key: &str) -> f64 {
    golden.config()[key].as_f64().unwrap()
}

fn compare(golden: &Golden, name: &str, got: &Tensor) {
    golden.compare(name, &values(got));
}

fn one_cycle(case: &str) {
    let Some(golden) = Golden::network(case) else { return };
    let schedule = OneCycle {
        warmup: float(&golden, "pct_start"),
        div_factor: float(&golden, "div_factor"),
        final_div_factor: float(&golden, "final_div_factor"),
        ..OneCycle::default()
    };
    assert_eq!(schedule, OneCycle::default());
    let total = golden.number("total_steps") as u64;
    let max_lr: Vec<f64> =
        golden.config()["max_lr"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let (mut lr, mut beta1) = (vec![], vec![]);
    for step in 0..total {
        let controls = schedule.hyperparameters(step, total);
        lr.extend(max_lr.iter().map(|max| max * controls.lr_scale));
        beta1.extend([controls.beta1.unwrap(); 2]);
    }
    golden.compare("lr", &lr);
    golden.compare("beta1", &beta1);
}

#[test]
fn one_cycle_of_all_lengths() {
    for case in ["lang_1000", "lang_37", "holicity_200", "ssl_500"] {
        one_cycle(&format!("i_onecycle_{case}"));
    }
}

fn adamw(case: &str) {
    let Some(golden) = Golden::network(case) else { return };
    let vars: Vec<Var> = ["param0.init", "param1.init"]
        .map(|name| Var::from_tensor(&tensor(&golden, name)).unwrap())
        .into();
    let names = ["weight", "block.bias"];
    let config = AdamWConfig {
        beta2: float(&golden, "beta2"),
        eps: float(&golden, "eps"),
        ..AdamWConfig::default()
    };
    let (lr, weight_decay) = (float(&golden, "lr"), float(&golden, "weight_decay"));
    let group = |i: usize, lr: f64| ParamGroup {
        params: BTreeMap::from([(names[i].to_owned(), vars[i].clone())]),
        lr,
        weight_decay,
    };
    let mut optimizer = AdamW::new(vec![group(0, lr), group(1, lr / 10.0)], config).unwrap();
    let params: BTreeMap<String, Var> =
        names.map(str::to_owned).into_iter().zip(vars.clone()).collect();
    let (cycles, max_norm) =
        (golden.config()["onecycle"] == true, golden.config()["clip_grad_norm"].as_f64());
    let mut norms = vec![];
    for step in 0..10 {
        let controls = match cycles {
            // Not in the manifest, but what the recorded rates follow.
            true => OneCycle { warmup: 0.25, ..OneCycle::default() }.hyperparameters(step, 12),
            false => StepHyperparameters::default(),
        };
        let rates = [lr * controls.lr_scale, lr / 10.0 * controls.lr_scale];
        golden.compare(&format!("lr.{step}"), &rates);
        golden.compare(&format!("beta1.{step}"), &[controls.beta1.unwrap_or(config.beta1); 2]);
        let mut grads = GradStore::default();
        for (i, var) in vars.iter().enumerate() {
            grads.insert(var, tensor(&golden, &format!("grad{i}.{step}")));
        }
        if let Some(max_norm) = max_norm {
            norms.push(clip_grad_norm(&params, &mut grads, max_norm).unwrap());
            for (i, var) in vars.iter().enumerate() {
                compare(&golden, &format!("clipped{i}.{step}"), grads.get(var).unwrap());
            }
        }
        optimizer.step(&grads, &controls).unwrap();
        for (i, var) in vars.iter().enumerate() {
            compare(&golden, &format!("param{i}.{step}"), var);
        }
    }
    let state = optimizer.state().unwrap();
    compare(&golden, "exp_avg0", &state["weight.exp_avg"]);
    compare(&golden, "exp_avg_sq0", &state["weight.exp_avg_sq"]);
    assert_eq!(state["block.bias.step"].to_scalar::<i64>().unwrap(), 10);
    if max_norm.is_some() {
        golden.compare("total_norm", &norms);
    }
}

#[test]
fn adamw_constant_cycled_clipped_and_self_supervised() {
    for case in ["const", "onecycle", "clip1", "ssl_eps1e-4"] {
        adamw(&format!("i_adamw_{case}"));
    }
}

#[test]
fn self_supervised_schedules() {
    let Some(golden) = Golden::network("i_ssl_schedules") else { return };
    let total = golden.number("total_steps") as u64;
    for (name, schedule) in [
        ("momentum", CosineSchedule::teacher_momentum()),
        ("weight_decay", CosineSchedule::weight_decay()),
        ("teacher_temp", CosineSchedule::teacher_temperature()),
    ] {
        let values: Vec<f64> = (0..total + 5).map(|step| schedule.value(step, total)).collect();
        golden.compare(name, &values);
    }
}

#[test]
fn teacher_average() {
    let Some(golden) = Golden::network("i_ema") else { return };
    let named = |var: &Var| BTreeMap::from([("weight".to_owned(), var.clone())]);
    let teacher = Var::from_tensor(&tensor(&golden, "teacher.init")).unwrap();
    let total = golden.number("total_iters") as u64;
    let momentum: Vec<f64> =
        (0..total).map(|step| CosineSchedule::teacher_momentum().value(step, total)).collect();
    golden.compare("momentum", &momentum);
    for (step, momentum) in momentum.into_iter().enumerate() {
        let student = (tensor(&golden, "student") * (1.0 + 0.1 * step as f64)).unwrap();
        let student = Var::from_tensor(&student).unwrap();
        ema_update(&named(&teacher), &named(&student), momentum).unwrap();
        compare(&golden, &format!("teacher.{step}"), &teacher);
    }
}
