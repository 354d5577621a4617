//! Cosine, L2, contrastive, and the sum of them that language pretraining uses.

use super::{compare, mask, tensor, var};
use crate::support::input;
use candle_core::{Tensor, Var};
use scenesplat_losses::{
    AggregatedContrastive, ClassHalves, ClassSource, CosineLoss, L2Loss, Loss, LossInput,
    Reduction, TermSchedule, aggregated_contrastive, cosine, l2, split_classes,
};
use scenesplat_test_support::Golden;

type RowFunction =
    fn(&Tensor, &Tensor, Option<&[bool]>, Reduction) -> candle_core::Result<Option<Tensor>>;

/// Compares a loss times its weight, and the gradient; a term that is off is the original's 0.
fn check(g: &Golden, pred: &Var, loss: Option<Tensor>, weight: f64) {
    let Some(loss) = loss else {
        assert_eq!(g.f64s("out.loss"), [0.0], "{}: off", g.file());
        if g.has("grad.pred") {
            assert!(g.f64s("grad.pred").iter().all(|v| *v == 0.0), "{}: off", g.file());
        }
        return;
    };
    let loss = (loss * weight).unwrap();
    let grads = loss.backward().unwrap();
    if g.f64s("out.loss")[0].is_finite() {
        compare(g, "out.loss", &loss);
    } else {
        // What overflows there overflows here: beyond f32 there is only infinity.
        assert_eq!(loss.to_scalar::<f32>().unwrap(), f32::INFINITY, "{}", g.file());
    }
    if g.has("grad.pred") {
        compare(g, "grad.pred", grads.get(pred).unwrap());
    }
}

#[test]
fn cosine_and_l2() {
    for case in [
        "basic",
        "unnormalised",
        "identical",
        "opposite",
        "zeros",
        "huge",
        "overflow",
        "tiny",
        "novalid",
        "onevalid",
    ] {
        for (name, f) in [("cos", cosine as RowFunction), ("l2", l2)] {
            let Some(g) = Golden::network(&format!("h_{name}_{case}")) else { return };
            let pred = var(&g, "in.pred");
            let loss =
                f(&pred, &tensor(&g, "in.target"), Some(&mask(&g)), Reduction::Mean).unwrap();
            assert_eq!(loss.is_none(), case == "novalid", "{name} {case}");
            check(&g, &pred, loss, 1.0);
        }
    }
    let Some(g) = Golden::network("h_cos_sum") else { return };
    let pred = var(&g, "in.pred");
    let loss = cosine(&pred, &tensor(&g, "in.target"), Some(&mask(&g)), Reduction::Sum).unwrap();
    check(&g, &pred, loss, 0.5);
}

/// The halves that the original drew: the permutation of a class's rows, cut in two.
fn drawn(g: &Golden) -> Vec<ClassHalves> {
    let (labels, mask) = (g.ints::<i32>("in.segment"), mask(g));
    let mut classes: Vec<ClassHalves> = g
        .names("in.perm.")
        .iter()
        .map(|name| {
            let label: i32 = name.strip_prefix("in.perm.").unwrap().parse().unwrap();
            let rows: Vec<u32> = (0..labels.len())
                .filter(|&i| mask[i] && labels[i] == label)
                .map(|i| i as u32)
                .collect();
            let drawn: Vec<u32> = g.ints(name).iter().map(|i: &usize| rows[*i]).collect();
            let (first, second) = drawn.split_at(drawn.len() / 2);
            ClassHalves { label, first: first.to_vec(), second: second.to_vec() }
        })
        .collect();
    classes.sort_by_key(|c| c.label);
    classes
}

#[test]
fn contrastive() {
    for case in [
        "basic",
        "masked",
        "too_early",
        "sum_red",
        "single_class",
        "identical",
        "zero_class",
        "huge",
        "none_used",
    ] {
        let Some(g) = Golden::network(&format!("h_aggcon_{case}")) else { return };
        let number = |key: &str| g.config()[key].as_f64().unwrap();
        let schedule = match g.config()["schedule"].as_str().unwrap() {
            "all" => TermSchedule::Always,
            "last_75" => TermSchedule::Last(75.0),
            other => panic!("schedule {other}"),
        };
        let sum = g.config()["reduction"] == "sum";
        let settings = AggregatedContrastive {
            temperature: number("temperature"),
            schedule,
            min_points: 100,
            classes: ClassSource::Labels,
            reduction: if sum { Reduction::Sum } else { Reduction::Mean },
        };
        let (labels, mask) = (g.ints::<i32>("in.segment"), mask(&g));
        let pred = var(&g, "in.pred");

        // Which classes, and how many rows in each half, is what the loss itself decides.
        let ours = split_classes(&labels, Some(&mask), 100, 1).unwrap();
        let drawn = drawn(&g);
        let used: Vec<usize> = ours.iter().map(|c| c.label as usize).collect();
        if schedule.is_on(number("epoch_progress")) {
            assert_eq!(used, g.numbers("classes_used"), "{case}");
            let sizes = |c: &[ClassHalves]| -> Vec<_> {
                c.iter().map(|c| (c.label, c.first.len(), c.second.len())).collect()
            };
            assert_eq!(sizes(&ours), sizes(&drawn), "{case}");
        }
        let progress = number("epoch_progress");
        let input = LossInput { progress, ..input(&pred, None, Some(&labels), Some(&mask)) };
        let whole = settings.forward(&input).unwrap();
        let on = !drawn.is_empty();
        assert_eq!(whole.is_some(), on, "{case}: {}", settings.off_reason(&input));

        let loss = aggregated_contrastive(&pred, &drawn, settings.temperature, settings.reduction)
            .unwrap();
        check(&g, &pred, loss, number("weight"));
    }
}

/// The criterion of language pretraining on raw features, with the networks' normalization.
#[test]
fn language_total() {
    let Some(g) = Golden::network("h_lang_total") else { return };
    let pred = var(&g, "in.pred");
    let unit = scenesplat_models::ops::l2_normalize(&pred).unwrap();
    compare(&g, "out.normalized", &unit);
    let (target, valid) = (tensor(&g, "in.target"), mask(&g));
    let input = LossInput { progress: 0.9, ..input(&unit, Some(&target), None, Some(&valid)) };
    assert!(TermSchedule::Last(75.0).is_on(input.progress));
    let term = |loss: &dyn Loss| loss.forward(&input).unwrap().unwrap();
    let contrast = aggregated_contrastive(&unit, &drawn(&g), 0.2, Reduction::Mean).unwrap();
    let total = (term(&CosineLoss::default()) + term(&L2Loss::default())).unwrap();
    let total = (total + (contrast.unwrap() * 0.02).unwrap()).unwrap();
    check(&g, &pred, Some(total), 1.0);
}
