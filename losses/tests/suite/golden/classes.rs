//! Cross-entropy and Lovász softmax.

use super::{compare, var};
use crate::support::input;
use scenesplat_losses::{CrossEntropy, LovaszSoftmax, Objective};
use scenesplat_test_support::Golden;

fn run(case: &str, objective: &Objective) {
    let Some(g) = Golden::network(&format!("h_{case}")) else { return };
    let pred = var(&g, "in.pred");
    let label: Vec<i32> = g.ints("in.target");
    let input = input(&pred, None, Some(&label), None);
    let output = objective.forward(&input).unwrap();
    let grads = output.total.backward().unwrap();
    let want = g.f64s("out.loss")[0];
    if case.ends_with("all_ignored") {
        // NaN there; here the term is off, the total 0.
        assert!(want.is_nan() && output.terms.is_empty() && output.off.len() == 1);
        assert_eq!(output.total.to_scalar::<f32>().unwrap(), 0.0);
    } else {
        compare(&g, "out.loss", &output.total);
    }
    if g.has("grad.pred") {
        compare(&g, "grad.pred", grads.get(&pred).unwrap());
    }
}

#[test]
fn cross_entropy_lovasz_and_both() {
    let entropy = || Objective::new().with(1.0, CrossEntropy::default());
    for case in ["basic", "single_class", "perfect", "huge", "equal_logits", "one_point"] {
        run(&format!("ce_{case}"), &entropy());
        run(&format!("lovasz_{case}"), &Objective::new().with(1.0, LovaszSoftmax));
    }
    run("ce_all_ignored", &entropy());
    run("ce_lovasz_basic", &entropy().with(1.0, LovaszSoftmax));
}
