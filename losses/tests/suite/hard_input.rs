//! Input that nobody hopes for: every case has a policy, and none of them is NaN.

use crate::support::{evaluate, input, matrix, noise, number, reference, units, wide};
use candle_core::{DType, Device, Result, Tensor, Var};
use scenesplat_losses::{
    AggregatedContrastive, ClassHalves, ClassSource, CosineLoss, CrossEntropy, IGNORE, L2Loss,
    Loss, LossInput, LovaszSoftmax, Objective, Reduction, SmoothL1Loss, TermSchedule,
    TextClassification, TextColumns, TextDistillation, aggregated_contrastive, cosine,
    cross_entropy, l2, lovasz_softmax, smooth_l1, split_classes,
};

const F32: DType = DType::F32;

fn contrastive() -> AggregatedContrastive {
    AggregatedContrastive {
        schedule: TermSchedule::Always,
        min_points: 2,
        ..AggregatedContrastive::default()
    }
}

fn all() -> [Box<dyn Loss>; 6] {
    [
        Box::new(CosineLoss::default()),
        Box::new(L2Loss::default()),
        Box::new(SmoothL1Loss::default()),
        Box::new(contrastive()),
        Box::new(CrossEntropy::default()),
        Box::new(LovaszSoftmax),
    ]
}

/// Value and gradient of a loss; both must be finite.
fn sound(name: &str, pred: &Tensor, f: impl FnOnce(&Tensor) -> Result<Option<Tensor>>) -> f64 {
    let (value, gradient) = evaluate(pred, f).unwrap().unwrap_or_else(|| panic!("{name}: off"));
    assert!(value.is_finite(), "{name}: {value}");
    let bad = gradient.iter().position(|g| !g.is_finite());
    assert!(bad.is_none(), "{name}: gradient {bad:?}");
    value
}

#[test]
fn no_row_that_counts() {
    for dtype in [F32, DType::F64, DType::BF16, DType::F16] {
        for rows in [0, 1, 7] {
            let pred = Tensor::ones((rows, 4), dtype, &Device::Cpu).unwrap();
            // What does not count is not looked at.
            let pred = (pred * f64::NAN).unwrap();
            let (label, valid) = (vec![IGNORE; rows], vec![false; rows]);
            let input = input(&pred, Some(&pred), Some(&label), Some(&valid));
            for loss in all() {
                assert!(loss.forward(&input).unwrap().is_none(), "{}", loss.name());
                assert!(!loss.off_reason(&input).is_empty());
            }
            let objective = all()
                .into_iter()
                .fold(Objective::new(), |objective, loss| objective.with(0.5, loss));
            let var = Var::from_tensor(&pred).unwrap();
            let output = objective.forward(&LossInput { pred: &var, ..input }).unwrap();
            assert!(output.terms.is_empty());
            assert_eq!(output.off.len(), 6);
            assert_eq!(number(&output.total), 0.0);
            let grads = output.total.backward().unwrap();
            assert!(wide(grads.get(&var).unwrap()).iter().all(|g| *g == 0.0));
        }
    }
}

#[test]
fn one_and_two_rows() {
    let (p, t) = (noise(8, 1), noise(8, 2));
    for rows in [1, 2] {
        let n = rows * 4;
        let (pred, target) = (matrix(&p[..n], 4, F32), matrix(&t[..n], 4, F32));
        let valid = vec![true; rows];
        let label = &[2, 0][..rows];
        let (p, t, mean) = (&p[..n], &t[..n], Reduction::Mean);
        type LossFn<'a> = &'a dyn Fn(&Tensor) -> Result<Option<Tensor>>;
        let losses: [(LossFn<'_>, f64); 5] = [
            (&|p| cosine(p, &target, None, mean), reference::cosine(p, t, 4, &valid)),
            (&|p| l2(p, &target, None, mean), reference::l2(p, t, 4, &valid)),
            (
                &|p| smooth_l1(p, &target, None, 0.3, mean),
                reference::smooth_l1(p, t, 4, &valid, 0.3),
            ),
            (
                &|p| cross_entropy(p, label, 0.0, None),
                reference::cross_entropy(p, 4, label, 0.0, None),
            ),
            (&|p| lovasz_softmax(p, label), reference::lovasz(p, 4, label)),
        ];
        for (loss, want) in losses {
            let got = sound("few rows", &pred, loss);
            assert!((got - want).abs() < 1e-6, "{got} and {want}");
        }
        // Two rows are two halves; one is none.
        let same = vec![5; rows];
        let loss = contrastive().forward(&input(&pred, None, Some(&same), None)).unwrap();
        assert_eq!(loss.map(|l| number(&l)), (rows == 2).then_some(0.0));
    }
}

/// The message of the error that a loss gives.
fn refusal(loss: &dyn Loss, pred: &Tensor, target: &Tensor, label: &[i32]) -> String {
    let valid = [true, true, true, false, true, true];
    loss.forward(&input(pred, Some(target), Some(label), Some(&valid))).unwrap_err().to_string()
}

#[test]
fn values_that_are_not_finite_are_named() {
    let label = [0, 1, 0, IGNORE, 1, 1];
    let target = matrix(&noise(18, 2), 3, F32);
    for dtype in [F32, DType::F64, DType::BF16, DType::F16] {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let damaged = |row: usize| {
                let mut values = noise(18, 1);
                values[3 * row + 1] = value;
                matrix(&values, 3, dtype)
            };
            for loss in all() {
                let name = loss.name();
                for row in [0, 2, 5] {
                    let message = refusal(&*loss, &damaged(row), &target, &label);
                    let place = format!("{name}: pred[{row}, 1] is {value}");
                    assert!(message.contains(&place), "{message}");
                }
                // Row 3 counts nowhere: the same bits as without the damage, no gradient.
                let valid = [true, true, true, false, true, true];
                let run = |pred: &Tensor| {
                    let run = |p: &Tensor| {
                        loss.forward(&input(p, Some(&target), Some(&label), Some(&valid)))
                    };
                    evaluate(pred, run).unwrap().unwrap()
                };
                let (got, want) = (run(&damaged(3)), run(&matrix(&noise(18, 1), 3, dtype)));
                assert_eq!(got, want, "{name} {dtype:?}");
                assert!(got.1[9..12].iter().all(|g| *g == 0.0), "{name}");
            }
            for loss in
                [&CosineLoss::default() as &dyn Loss, &L2Loss::default(), &SmoothL1Loss::default()]
            {
                let pred = matrix(&noise(18, 1), 3, F32);
                let message = refusal(loss, &pred, &damaged(4), &label);
                assert!(message.contains(&format!("target[4, 1] is {value}")), "{message}");
            }
        }
    }
}

#[test]
fn rows_without_direction() {
    // Predicted rows 0, target rows 1, both 2.
    let mut p = noise(12, 1);
    let mut t = noise(12, 2);
    p[0..3].fill(0.0);
    t[3..6].fill(0.0);
    p[6..9].fill(0.0);
    t[6..9].fill(-0.0);
    for dtype in [F32, DType::F64, DType::BF16] {
        let (pred, target) = (matrix(&p, 3, dtype), matrix(&t, 3, dtype));
        let value = sound("cosine", &pred, |p| cosine(p, &target, None, Reduction::Sum));
        let own = reference::cosine(&wide(&pred), &wide(&target), 3, &[false, false, false, true]);
        assert!((value - 3.0 - own).abs() < 1e-6, "{value}: three zero rows cost 1 each");
        sound("l2", &pred, |p| l2(p, &target, None, Reduction::Mean));
        sound("smooth_l1", &pred, |p| smooth_l1(p, &target, None, 0.5, Reduction::Mean));
    }
    // A class of zero rows, and one whose rows cancel.
    let rows = [[0.0, 0.0], [0.0, 0.0], [1.0, 2.0], [-1.0, -2.0], [0.5, 1.0], [0.1, 0.0]];
    let pred = matrix(rows.as_flattened(), 2, F32);
    let class = |label, first: [u32; 1], second: [u32; 1]| ClassHalves {
        label,
        first: first.to_vec(),
        second: second.to_vec(),
    };
    let classes = [class(0, [0], [1]), class(1, [2], [3]), class(2, [4], [5])];
    let value =
        sound("contrastive", &pred, |p| aggregated_contrastive(p, &classes, 0.2, Reduction::Mean));
    let want = reference::contrastive(rows.as_flattened(), 2, &classes, 0.2);
    assert!((value - want).abs() < 1e-6, "{value} and {want}");
}

/// Rows count by their direction down to the smallest norm, 1e-8, and below it as rows of that norm.
#[test]
fn short_rows_have_a_direction() {
    for (p, t, want) in [
        // Norms 5e-8 and 5e-8; the cosine is 24/25.
        ([3e-8, 4e-8], [4e-8, 3e-8], 0.04),
        ([3e-8, 4e-8], [0.8, 0.6], 0.04),
        ([0.6, 0.8], [4e-8, 3e-8], 0.04),
        // 5e-9 counts as 1e-8, so half of the cosine is left; of both, a quarter.
        ([3e-9, 4e-9], [0.8, 0.6], 0.52),
        ([0.6, 0.8], [4e-9, 3e-9], 0.52),
        ([3e-9, 4e-9], [4e-9, 3e-9], 0.76),
    ] {
        for dtype in [F32, DType::F64] {
            let (pred, target) = (matrix(&p, 2, dtype), matrix(&t, 2, dtype));
            let value = sound("cosine", &pred, |p| cosine(p, &target, None, Reduction::Mean));
            assert!((value - want).abs() < 1e-6, "{dtype:?} {p:?} {t:?}: {value}, by hand {want}");
        }
    }
}

/// Sizes whose squares leave the type, up to its largest numbers.
#[test]
fn huge_and_tiny_features() {
    let (p, t) = (noise(120, 1), noise(120, 2));
    let label: Vec<i32> = (0..40).map(|i| i % 2).collect();
    for (dtype, factors) in [
        (F32, [1e-30, 1e-12, 1e15, 3e38]),
        (DType::F64, [1e-200, 1e-12, 1e160, 1e300]),
        (DType::BF16, [1e-30, 1e-12, 1e15, 3e38]),
        (DType::F16, [1e-6, 1e-3, 1e3, 6e4]),
    ] {
        for factor in factors {
            let scaled = |values: &[f64]| -> Tensor {
                let values: Vec<f64> = values.iter().map(|v| v * factor).collect();
                matrix(&values, 3, dtype)
            };
            let (pred, target) = (scaled(&p), scaled(&t));
            let case = format!("{dtype:?} {factor:e}");
            let value = sound(&case, &pred, |p| cosine(p, &target, None, Reduction::Mean));
            if factor > 1e-8 && dtype != DType::F16 {
                let want = reference::cosine(&p, &t, 3, &[true; 40]);
                assert!((value - want).abs() < 1e-2, "{case}: {value} and {want}");
            }
            let halves = split_classes(&label, None, 2, 0).unwrap();
            let value =
                sound(&case, &pred, |p| aggregated_contrastive(p, &halves, 0.2, Reduction::Mean));
            if factor > 1e-8 && dtype != DType::F16 {
                let want = reference::contrastive(&p, 3, &halves, 0.2);
                assert!((value - want).abs() < 2e-2, "{case}: {value} and {want}");
            }
            // A squared distance may be beyond its type; its gradient is not.
            let (value, gradient) =
                evaluate(&pred, |p| l2(p, &target, None, Reduction::Mean)).unwrap().unwrap();
            assert!(value >= 0.0, "{case}: {value}");
            assert!(gradient.iter().all(|g| g.is_finite()), "{case}: gradient of l2");
            let smooth = |p: &Tensor| smooth_l1(p, &target, None, 0.5, Reduction::Sum);
            let (value, gradient) = evaluate(&pred, smooth).unwrap().unwrap();
            assert!(value >= 0.0, "{case}: {value}");
            assert!(gradient.iter().all(|g| g.abs() <= 1.0), "{case}: gradient of smooth l1");
        }
    }
}

#[test]
fn equal_rows() {
    let row = noise(6, 5);
    let rows: Vec<f64> = row.iter().copied().cycle().take(240).collect();
    let label: Vec<i32> = (0..40).map(|i| i % 4).collect();
    let pred = matrix(&rows, 6, F32);
    let mean = Reduction::Mean;
    assert!(sound("cosine", &pred, |p| cosine(p, &pred, None, mean)).abs() < 1e-7);
    assert_eq!(sound("l2", &pred, |p| l2(p, &pred, None, mean)), 0.0);
    let halves = split_classes(&label, None, 2, 0).unwrap();
    let value = sound("contrastive", &pred, |p| aggregated_contrastive(p, &halves, 0.2, mean));
    assert!((value - 4f64.ln()).abs() < 1e-6, "four classes that cannot be told apart: {value}");
    let value = sound("lovasz", &pred, |p| lovasz_softmax(p, &label));
    assert!((value - reference::lovasz(&rows, 6, &label)).abs() < 1e-6);
}

#[test]
fn huge_logits() {
    for (dtype, size) in [(F32, 1e4), (F32, 3e38), (DType::F64, 1e308), (DType::BF16, 1e38)] {
        let mut z: Vec<f64> = noise(60, 3).iter().map(|v| v * size).collect();
        z[0] = size;
        z[1] = -size;
        let label: Vec<i32> = (0..20).map(|i| i % 3).collect();
        let pred = matrix(&z, 3, dtype);
        let case = format!("{dtype:?} {size:e}");
        let lovasz = sound(&case, &pred, |p| lovasz_softmax(p, &label));
        assert!((0.0..=1.0).contains(&lovasz), "{case}: {lovasz}");
        // The loss itself may be beyond its type (twice the largest number), never its gradient.
        let (value, gradient) =
            evaluate(&pred, |p| cross_entropy(p, &label, 0.1, None)).unwrap().unwrap();
        assert!(value > 0.0, "{case}: {value}");
        assert!(gradient.iter().all(|g| g.abs() <= 1.0), "{case}");
    }
}

#[test]
fn sure_rows_keep_what_is_left() {
    // e⁻⁴⁰ is far below the precision of 1 − p.
    let pred = matrix(&[0.0, -40.0, 0.0, -40.0], 2, DType::F64);
    let label = [0, 0];
    let (value, gradient) =
        evaluate(&pred, |p| cross_entropy(p, &label, 0.0, None)).unwrap().unwrap();
    assert!(value.abs() < 1e-15);
    assert!((gradient[1] - 0.5 * (-40f64).exp()).abs() < 1e-30, "{}", gradient[1]);
}

#[test]
fn classes_without_weight() {
    let pred = matrix(&noise(9, 1), 3, F32);
    let weights = [0.0, 1.0, 2.0];
    assert!(cross_entropy(&pred, &[0, 0, -1], 0.2, Some(&weights)).unwrap().is_none());
    sound("weights", &pred, |p| cross_entropy(p, &[0, 1, -1], 0.2, Some(&weights)));
    for bad in [&[1.0; 2][..], &[1.0, -1.0, 1.0], &[1.0, f64::NAN, 1.0]] {
        assert!(cross_entropy(&pred, &[0; 3], 0.0, Some(bad)).is_err());
    }
    for bad in [-0.1, 1.0, f64::NAN] {
        let message = cross_entropy(&pred, &[0; 3], bad, None).unwrap_err().to_string();
        assert!(message.contains("label_smoothing"), "{message}");
    }
}

#[test]
fn labels_and_shapes_that_do_not_fit() {
    let pred = matrix(&noise(12, 1), 3, F32);
    for (label, row) in [([0, 1, 3, 0], 2), ([0, -2, 0, 0], 1), ([i32::MAX, 0, 0, 0], 0)] {
        for message in [
            cross_entropy(&pred, &label, 0.0, None).unwrap_err().to_string(),
            lovasz_softmax(&pred, &label).unwrap_err().to_string(),
        ] {
            let place = format!("label[{row}] is {}, expected -1", label[row]);
            assert!(message.contains(&place) && message.contains("0..3"), "{message}");
        }
    }
    let narrow = matrix(&noise(12, 1), 2, F32);
    let flat = pred.flatten_all().unwrap();
    let whole = Tensor::zeros((4, 3), DType::I64, &Device::Cpu).unwrap();
    let (short, label) = ([true; 3], [0; 5]);
    for loss in all() {
        let good = [0, 0, 1, 1];
        let run = |pred, target, label, valid| loss.forward(&input(pred, target, label, valid));
        assert!(run(&flat, Some(&flat), Some(&good), None).is_err(), "{}: a vector", loss.name());
        let message = run(&whole, Some(&pred), Some(&good), None).unwrap_err().to_string();
        assert!(message.contains("f32, f64, bf16 or f16"), "{message}");
        match loss.name() {
            "cosine" | "l2" | "smooth_l1" => {
                let message = run(&pred, Some(&narrow), None, None).unwrap_err().to_string();
                assert!(message.contains("expected [4, 3], got [6, 2]"), "{message}");
                let message = run(&pred, None, None, None).unwrap_err().to_string();
                assert!(message.contains("needs `target`"), "{message}");
                assert!(run(&pred, Some(&pred), None, Some(&short)).is_err());
            }
            _ => {
                let message = run(&pred, None, Some(&label), None).unwrap_err().to_string();
                assert!(message.contains("label: expected [4], got [5]"), "{message}");
            }
        }
    }
    for beta in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = smooth_l1(&pred, &pred, None, beta, Reduction::Mean).unwrap_err().to_string();
        assert!(error.contains("beta"), "{error}");
    }
    for temperature in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(aggregated_contrastive(&pred, &[], temperature, Reduction::Mean).is_err());
    }
    let halves = |first: &[u32], second: &[u32]| {
        let (first, second) = (first.to_vec(), second.to_vec());
        let classes = [ClassHalves { label: 1, first, second }];
        aggregated_contrastive(&pred, &classes, 0.2, Reduction::Mean)
    };
    assert!(halves(&[0], &[4]).unwrap_err().to_string().contains("row 4 of 4"));
    assert!(halves(&[0, 1], &[1]).unwrap_err().to_string().contains("row 1 twice"));
    assert!(halves(&[0], &[]).unwrap_err().to_string().contains("empty half of class 1"));
}

#[test]
fn losses_of_texts() {
    let texts = TextColumns::new(&[1.0, 0.0, 0.0, 1.0, -0.8, 0.6], 2).unwrap();
    let distillation =
        |temperature| TextDistillation { temperature, ..TextDistillation::new(texts.clone()) };
    let (classification, plain) = (TextClassification::new(texts.clone()), distillation(0.1));
    let good = matrix(&[1.0, 0.0, 0.0, 1.0], 2, F32);
    let bad = matrix(&[1.0, 0.0, f64::NAN, 1.0], 2, F32);
    let wide = matrix(&[1.0; 6], 3, F32);
    let off = classification.forward(&input(&good, None, Some(&[-1, -1]), None)).unwrap();
    assert!(off.is_none());
    assert!(classification.forward(&input(&wide, None, Some(&[0, 0]), None)).is_err());
    let run = |pred, target, valid| plain.forward(&input(pred, target, None, valid));
    assert!(run(&good, Some(&good), Some(&[false, false])).unwrap().is_none());
    // Not read where it does not count.
    assert!(run(&good, Some(&bad), Some(&[true, false])).unwrap().is_some());
    for (pred, target, field) in [(&bad, &good, "pred"), (&good, &bad, "target")] {
        let error = run(pred, Some(target), None).unwrap_err().to_string();
        assert!(error.contains("text_distillation") && error.contains(field), "{error}");
    }
    assert!(run(&wide, Some(&wide), None).is_err());
    assert!(run(&good, None, None).is_err());
    // Answers beyond what exp can hold in f32: one row each, right and wrong.
    let sharp = distillation(1e-4);
    let (first, second) = (matrix(&[1.0, 0.0], 2, F32), matrix(&[0.0, 1.0], 2, F32));
    let at = |pred: &Tensor| {
        evaluate(pred, |p| sharp.forward(&input(p, Some(&first), None, None))).unwrap().unwrap()
    };
    assert_eq!(at(&first).0, 0.0);
    // The teacher is sure of the first text, the student of the second: 1/τ, away from the one to the other.
    let (value, gradient) = at(&second);
    for (got, want) in [(value, 1e4), (gradient[0], -1e4), (gradient[1], 1e4)] {
        assert!((got / want - 1.0).abs() < 1e-5, "{value} {gradient:?}");
    }
}

/// The numbers that the notes on the original give for a small case.
#[test]
fn worked_examples() {
    let of_each = |f: fn(f64, f64) -> f64| -> Vec<f64> {
        (0..48).map(|at| f(f64::from(at / 8), f64::from(at % 8))).collect()
    };
    let p = units(&of_each(|i, j| (0.7 * i + 0.3 * j + 0.1 * i * j).sin()), 8);
    let t = of_each(|i, j| 0.5 * (0.5 * i - 0.2 * j + 0.05 * i * j).cos());
    let (pred, target) = (matrix(&p, 8, F32), matrix(&t, 8, F32));
    let valid = [true, true, false, true, true, false];
    let close = |loss: Option<Tensor>, want: f64| {
        let got = number(&loss.unwrap());
        assert!((got - want).abs() < 1e-6, "{got} and {want}");
    };
    close(cosine(&pred, &target, Some(&valid), Reduction::Mean).unwrap(), 0.731_722_4);
    close(l2(&pred, &target, Some(&valid), Reduction::Mean).unwrap(), 1.008_646_1);

    let logits: Vec<f64> = (0..24).map(|k| 2.0 * (0.7 * f64::from(k)).sin()).collect();
    let (logits, label) = (matrix(&logits, 4, F32), [0, 1, 2, -1, 1, 0]);
    close(cross_entropy(&logits, &label, 0.0, None).unwrap(), 1.880_201_1);
    close(lovasz_softmax(&logits, &label).unwrap(), 0.780_145_6);

    // Four classes of 120 equal rows each, then one of them with too few.
    let class = |k: usize, count: usize| vec![p[8 * k..][..8].to_vec(); count].concat();
    for (counts, want) in [([120; 4], 0.002_990_98), ([99, 120, 120, 120], 0.002_562_19)] {
        let values: Vec<f64> = (0..4).flat_map(|k| class(k, counts[k])).collect();
        let label: Vec<i32> = (0..4).flat_map(|k| vec![k as i32; counts[k]]).collect();
        let pred = matrix(&values, 8, F32);
        let mut input = input(&pred, None, Some(&label), None);
        input.progress = 0.26;
        let loss = AggregatedContrastive::default();
        close(loss.forward(&input).unwrap().map(|l| (l * 0.02).unwrap()), want);
        input.progress = 0.25;
        assert!(loss.forward(&input).unwrap().is_none());
    }
    assert!(matches!(AggregatedContrastive::default().classes, ClassSource::Labels));
}
