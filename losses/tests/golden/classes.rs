//! Cross-entropy and Lovász softmax.

use crate::support::Golden;
use candle_core::Var;
use scenesplat_losses::{CrossEntropy, LossInput, LovaszSoftmax, Objective};

fn run(case: &str, objective: &Objective) {
    let Some(g) = Golden::open(&format!("h_{case}.safetensors")) else { return };
    let pred = Var::from_tensor(&g.tensor("in.pred")).unwrap();
    let label: Vec<i32> = g.ints("in.target").iter().map(|v| *v as i32).collect();
    let input = LossInput {
        pred: &pred,
        target: None,
        label: Some(&label),
        valid: None,
        progress: 0.0,
        seed: 0,
    };
    let output = objective.forward(&input).unwrap();
    let grads = output.total.backward().unwrap();
    let want = g.floats("out.loss")[0];
    if case.ends_with("all_ignored") {
        // NaN there; here the term is off, the total 0.
        assert!(want.is_nan() && output.terms.is_empty() && output.off.len() == 1);
        assert_eq!(output.total.to_scalar::<f32>().unwrap(), 0.0);
    } else {
        g.compare("out.loss", &[output.total.to_scalar().unwrap()]);
    }
    if g.has("grad.pred") {
        g.compare_tensor("grad.pred", grads.get(&pred).unwrap());
    }
}

#[test]
fn cross_entropy() {
    for case in
        ["basic", "single_class", "perfect", "huge", "equal_logits", "one_point", "all_ignored"]
    {
        run(&format!("ce_{case}"), &Objective::new().with(1.0, CrossEntropy::default()));
    }
}

#[test]
fn lovasz() {
    for case in ["basic", "single_class", "perfect", "huge", "equal_logits", "one_point"] {
        run(&format!("lovasz_{case}"), &Objective::new().with(1.0, LovaszSoftmax));
    }
}

#[test]
fn both() {
    let objective = Objective::new().with(1.0, CrossEntropy::default()).with(1.0, LovaszSoftmax);
    run("ce_lovasz_basic", &objective);
}
