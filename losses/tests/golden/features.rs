//! Cosine, L2, contrastive, and the sum of them that language pretraining uses.

use crate::support::Golden;
use candle_core::{Tensor, Var};
use scenesplat_losses::{
    AggregatedContrastive, ClassHalves, ClassSource, CosineLoss, L2Loss, Loss, LossInput,
    Reduction, TermSchedule, aggregated_contrastive, cosine, l2, split_classes,
};

fn mask(g: &Golden) -> Vec<bool> {
    g.ints("in.mask").iter().map(|v| *v != 0).collect()
}

fn labels(g: &Golden) -> Vec<i32> {
    g.ints("in.segment").iter().map(|v| *v as i32).collect()
}

/// Compares a loss times its weight, and the gradient; a term that is off is the original's 0.
fn check(g: &Golden, pred: &Var, loss: Option<Tensor>, weight: f64) {
    let Some(loss) = loss else {
        assert_eq!(g.floats("out.loss"), [0.0], "{}: off", g.file);
        if g.has("grad.pred") {
            assert!(g.floats("grad.pred").iter().all(|v| *v == 0.0), "{}: off", g.file);
        }
        return;
    };
    let loss = (loss * weight).unwrap();
    let grads = loss.backward().unwrap();
    if g.floats("out.loss")[0].is_finite() {
        g.compare("out.loss", &[loss.to_scalar().unwrap()]);
    } else {
        // What overflows there overflows here: beyond f32 there is only infinity.
        assert_eq!(loss.to_scalar::<f32>().unwrap(), f32::INFINITY, "{}", g.file);
    }
    if g.has("grad.pred") {
        g.compare_tensor("grad.pred", grads.get(pred).unwrap());
    }
}

#[test]
fn cosine_and_l2() {
    let cases = [
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
    ];
    for case in cases {
        for name in ["cos", "l2"] {
            let file = format!("h_{name}_{case}.safetensors");
            let Some(g) = Golden::open(&file) else { return };
            let pred = Var::from_tensor(&g.tensor("in.pred")).unwrap();
            let (target, valid) = (g.tensor("in.target"), mask(&g));
            let f = if name == "cos" { cosine } else { l2 };
            let loss = f(&pred, &target, Some(&valid), Reduction::Mean).unwrap();
            assert_eq!(loss.is_none(), case == "novalid", "{file}");
            check(&g, &pred, loss, 1.0);
        }
    }
}

#[test]
fn cosine_sum() {
    let Some(g) = Golden::open("h_cos_sum.safetensors") else { return };
    let pred = Var::from_tensor(&g.tensor("in.pred")).unwrap();
    let loss = cosine(&pred, &g.tensor("in.target"), Some(&mask(&g)), Reduction::Sum).unwrap();
    check(&g, &pred, loss, 0.5);
}

/// The halves that the original drew: the permutation of a class's rows, cut in two.
fn drawn(g: &Golden) -> Vec<ClassHalves> {
    let (labels, mask) = (labels(g), mask(g));
    let mut classes: Vec<ClassHalves> = g
        .names("in.perm.")
        .iter()
        .map(|name| {
            let label: i32 = name.strip_prefix("in.perm.").unwrap().parse().unwrap();
            let rows: Vec<u32> = (0..labels.len())
                .filter(|&i| mask[i] && labels[i] == label)
                .map(|i| i as u32)
                .collect();
            let drawn: Vec<u32> = g.ints(name).iter().map(|i| rows[*i as usize]).collect();
            let (first, second) = drawn.split_at(drawn.len() / 2);
            ClassHalves { label, first: first.to_vec(), second: second.to_vec() }
        })
        .collect();
    classes.sort_by_key(|c| c.label);
    classes
}

#[test]
fn contrastive() {
    let cases = [
        "basic",
        "masked",
        "too_early",
        "sum_red",
        "single_class",
        "identical",
        "zero_class",
        "huge",
        "none_used",
    ];
    for case in cases {
        let Some(g) = Golden::open(&format!("h_aggcon_{case}.safetensors")) else { return };
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
        let (labels, mask) = (labels(&g), mask(&g));
        let pred = Var::from_tensor(&g.tensor("in.pred")).unwrap();

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
        let input = LossInput {
            pred: &pred,
            target: None,
            label: Some(&labels),
            valid: Some(&mask),
            progress: number("epoch_progress"),
            seed: 1,
        };
        let whole = settings.forward(&input).unwrap();
        let on = !drawn.is_empty();
        assert_eq!(whole.is_some(), on, "{case}: {}", settings.off_reason(&input));

        let loss = aggregated_contrastive(&pred, &drawn, settings.temperature, settings.reduction)
            .unwrap();
        check(&g, &pred, loss, number("weight"));
    }
}

/// The criterion of language pretraining on raw features, with the networks' normalisation.
#[test]
fn language_total() {
    let Some(g) = Golden::open("h_lang_total.safetensors") else { return };
    let pred = Var::from_tensor(&g.tensor("in.pred")).unwrap();
    let unit = scenesplat_models::ops::l2_normalize(&pred).unwrap();
    g.compare_tensor("out.normalized", &unit);
    let (target, valid) = (g.tensor("in.target"), mask(&g));
    let input = LossInput {
        pred: &unit,
        target: Some(&target),
        label: None,
        valid: Some(&valid),
        progress: 0.9,
        seed: 0,
    };
    assert!(TermSchedule::Last(75.0).is_on(input.progress));
    let term = |loss: &dyn Loss| loss.forward(&input).unwrap().unwrap();
    let contrast = aggregated_contrastive(&unit, &drawn(&g), 0.2, Reduction::Mean).unwrap();
    let total = (term(&CosineLoss::default()) + term(&L2Loss::default())).unwrap();
    let total = (total + (contrast.unwrap() * 0.02).unwrap()).unwrap();
    check(&g, &pred, Some(total), 1.0);
}
