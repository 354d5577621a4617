//! Objectives, schedules, sources of classes, configuration files, and equal bits.

use crate::support::{evaluate, input, matrix, noise, number, units, wide};
use candle_core::{DType, Result, Tensor, Var};
use scenesplat_losses::{
    AggregatedContrastive, ClassSource, CosineLoss, CrossEntropy, IGNORE, L2Loss, Loss, LossConfig,
    LossInput, LovaszSoftmax, Objective, TermSchedule, TextColumns, argmax_labels, build_objective,
    pseudo_labels,
};

#[test]
fn the_total_is_the_weighted_sum_of_the_terms() {
    let pred = Var::from_tensor(&matrix(&noise(60, 1), 5, DType::F32)).unwrap();
    let target = matrix(&noise(60, 2), 5, DType::F32);
    let label: Vec<i32> = (0..12).map(|i| i % 5).collect();
    let objective = Objective::new()
        .with(1.0, CosineLoss::default())
        .with(-0.5, L2Loss::default())
        .with(0.0, CrossEntropy::default())
        .with(2.0, LovaszSoftmax);
    let input = input(&pred, Some(&target), Some(&label), None);
    let output = objective.forward(&input).unwrap();
    let names: Vec<&str> = output.terms.iter().map(|t| t.name.as_str()).collect();
    assert_eq!(names, ["cosine", "l2", "lovasz_softmax"]);
    assert_eq!(output.off[0].name, "cross_entropy");
    assert!(output.off[0].reason.contains("weight is 0"));
    let sum: f64 = output.terms.iter().map(|t| t.weight * number(&t.value)).sum();
    assert!((number(&output.total) - sum).abs() < 1e-6);
    assert!(output.terms.iter().all(|t| !t.value.track_op()), "terms are detached");
    // The value of a term is not weighted.
    let alone = L2Loss::default().forward(&input).unwrap().unwrap();
    assert_eq!(number(&output.terms[1].value), number(&alone));

    let gradient = |loss: &Tensor| wide(loss.backward().unwrap().get(&pred).unwrap());
    let total = gradient(&output.total);
    let parts = [
        (1.0, CosineLoss::default().forward(&input).unwrap().unwrap()),
        (-0.5, alone),
        (2.0, LovaszSoftmax.forward(&input).unwrap().unwrap()),
    ];
    for i in 0..60 {
        let want: f64 = parts.iter().map(|(w, l)| w * gradient(l)[i]).sum();
        assert!((total[i] - want).abs() < 1e-6, "{i}");
    }
}

type Term = fn(&Tensor) -> Result<Option<Tensor>>;

struct Broken(Term);

impl Loss for Broken {
    fn name(&self) -> &str {
        "mine"
    }
    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        (self.0)(input.pred)
    }
}

#[test]
fn a_failing_term_is_named() {
    let pred = matrix(&noise(6, 1), 3, DType::F32);
    let terms: [Term; 2] = [|p| p.sqr().map(Some), |_| candle_core::bail!("nothing works")];
    for term in terms {
        let objective = Objective::new().with(1.0, Broken(term));
        let message = objective.forward(&input(&pred, None, None, None)).unwrap_err().to_string();
        assert!(message.contains("mine"), "{message}");
    }
    for progress in [-0.1, 1.1, f64::NAN] {
        let input = LossInput { progress, ..input(&pred, None, None, None) };
        let message = Objective::new().forward(&input).unwrap_err().to_string();
        assert!(message.contains("progress"), "{message}");
    }
    let infinite = Objective::new().with(f64::INFINITY, LovaszSoftmax);
    assert!(infinite.forward(&input(&pred, None, None, None)).is_err());
    // A loss of the caller is used as those of the crate are, in f64 too.
    let own = Objective::new().with(3.0, Broken(|p| p.sum_all().map(Some)));
    let wide = pred.to_dtype(DType::F64).unwrap();
    let output = own.forward(&input(&wide, None, None, None)).unwrap();
    assert_eq!(output.total.dtype(), DType::F64);
    assert_eq!(output.off.len(), 0);
}

#[test]
fn schedules() {
    let last = TermSchedule::Last(75.0);
    assert!(!last.is_on(0.0) && !last.is_on(0.25) && last.is_on(0.2501) && last.is_on(1.0));
    assert!(TermSchedule::Last(100.0).is_on(1e-9) && !TermSchedule::Last(0.0).is_on(1.0));
    assert!(TermSchedule::Always.is_on(0.0) && !TermSchedule::Skip.is_on(1.0));
}

/// Three texts, the axes.
fn axes() -> TextColumns {
    TextColumns::new(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], 3).unwrap()
}

#[test]
fn where_classes_come_from() {
    // Targets near three texts, one zero row, one row without a target.
    let texts = axes();
    assert_eq!((texts.len(), texts.is_empty()), (3, false));
    let rows = [[0.0, 0.1, 0.2], [0.9, 0.1, 0.0], [0.0; 3], [0.0, 9.0, 1.0], [2.0, 2.0, 0.0]];
    let target = matrix(rows.as_flattened(), 3, DType::BF16);
    let valid = [true, true, true, false, true];
    let want = [2, 0, IGNORE, IGNORE, 0];
    assert_eq!(pseudo_labels(&target, &texts, Some(&valid)).unwrap(), want, "ties to the smallest");
    assert_eq!(argmax_labels(&target, Some(&valid)).unwrap(), want);
    assert!(pseudo_labels(&target, &texts, Some(&valid[..4])).is_err());
    assert!(argmax_labels(&target, Some(&valid[..4])).is_err());
    let narrow = matrix(&noise(4, 1), 2, DType::F32);
    assert!(pseudo_labels(&narrow, &texts, None).unwrap_err().to_string().contains("[N, 3]"));
    for (values, dim) in
        [(&[][..], 3), (&[1.0; 4], 3), (&[1.0; 3], 0), (&[0.0; 3], 3), (&[2.0, 0.0], 2)]
    {
        assert!(TextColumns::new(values, dim).is_err());
    }
    assert!(TextColumns::new(&[f32::NAN, 1.0], 2).unwrap_err().to_string().contains("class 0"));

    // Blocks of rows: far more than one, with damage in the last.
    let mut many = noise(3 * 9000, 4);
    let wanted = |values: &[f64]| -> Vec<i32> {
        let best = |r: &[f64]| (0..3).fold(0, |b, c| if r[c] > r[b] { c } else { b }) as i32;
        values.chunks_exact(3).map(best).collect()
    };
    let all = pseudo_labels(&matrix(&many, 3, DType::F32), &texts, None).unwrap();
    assert_eq!(all, wanted(&many));
    many[3 * 8999 + 2] = f64::NAN;
    let message = pseudo_labels(&matrix(&many, 3, DType::F32), &texts, None).unwrap_err();
    assert!(message.to_string().contains("target[8999, 2] is NaN"), "{message}");
}

#[test]
fn the_loss_takes_its_classes_and_says_which() {
    let texts = axes();
    let loss = |classes| AggregatedContrastive {
        classes,
        min_points: 2,
        schedule: TermSchedule::Always,
        ..AggregatedContrastive::default()
    };
    let pred = matrix(&noise(90, 5), 3, DType::F32);
    let target = matrix(&noise(90, 6), 3, DType::F32);
    let labels = pseudo_labels(&target, &texts, None).unwrap();
    let value = |loss: &AggregatedContrastive, label: Option<&[i32]>| {
        let value = loss.forward(&input(&pred, Some(&target), label, None)).unwrap();
        value.map(|v| number(&v))
    };
    let given = loss(ClassSource::Labels);
    let pseudo = loss(ClassSource::PseudoLabels(texts));
    let argmax = loss(ClassSource::Argmax);
    assert_eq!(value(&pseudo, None), value(&given, Some(&labels)));
    assert_eq!(value(&argmax, None), value(&given, Some(&labels)));
    assert_eq!(value(&given, None), None);
    assert_eq!(value(&loss(ClassSource::Off), Some(&labels)), None);
    assert!(given.off_reason(&input(&pred, None, None, None)).contains("no labels"));
    let objective = Objective::new().with(0.02, pseudo);
    let line = &objective.settings()[0];
    assert!(
        line.starts_with("0.02 · aggregated_contrastive") && line.contains("3 texts"),
        "{line}"
    );
    assert!(given.settings().contains("given labels"));
    assert!(loss(ClassSource::Off).settings().contains("classes: off"));
}

fn with_threads<R: Send>(n: usize, f: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(f)
}

/// Values and gradients of all losses on more rows than a task takes, bit for bit.
#[test]
fn any_number_of_threads() {
    const ROWS: usize = 5003;
    const WIDTH: usize = 67;
    let label: Vec<i32> = (0..ROWS).map(|i| (i * i % 71) as i32 - 4).map(|l| l.max(-1)).collect();
    let valid: Vec<bool> = (0..ROWS).map(|i| i % 5 != 3).collect();
    let texts: Vec<f32> = units(&noise(20 * WIDTH, 8), WIDTH).iter().map(|v| *v as f32).collect();
    let texts = TextColumns::new(&texts, WIDTH).unwrap();
    let contrastive = |classes| AggregatedContrastive {
        classes,
        min_points: 20,
        ..AggregatedContrastive::default()
    };
    let losses: [Box<dyn Loss>; 6] = [
        Box::new(CosineLoss::default()),
        Box::new(L2Loss::default()),
        Box::new(contrastive(ClassSource::Labels)),
        Box::new(contrastive(ClassSource::PseudoLabels(texts))),
        Box::new(CrossEntropy { label_smoothing: 0.1, class_weights: None }),
        Box::new(LovaszSoftmax),
    ];
    for dtype in [DType::F32, DType::BF16, DType::F64] {
        let pred = matrix(&noise(ROWS * WIDTH, 1), WIDTH, dtype);
        let target = matrix(&noise(ROWS * WIDTH, 2), WIDTH, dtype);
        for loss in &losses {
            let run = |seed: u64| {
                let run = |p: &Tensor| {
                    let input = input(p, Some(&target), Some(&label), Some(&valid));
                    loss.forward(&LossInput { seed, ..input })
                };
                let (value, gradient) = evaluate(&pred, run).unwrap().unwrap();
                let bits = |v: f64| v.to_bits();
                (bits(value), gradient.into_iter().map(bits).collect::<Vec<_>>())
            };
            let expected = with_threads(1, || run(7));
            for threads in [1, 2, 3, 5] {
                assert!(with_threads(threads, || run(7)) == expected, "{threads} {}", loss.name());
            }
            let random = loss.name() == "aggregated_contrastive";
            assert_eq!(run(8) != expected, random, "{}: another seed", loss.name());
        }
    }
}

fn parse(text: &str) -> std::result::Result<Vec<LossConfig>, String> {
    #[derive(serde::Deserialize)]
    struct File {
        losses: Vec<LossConfig>,
    }
    toml::from_str::<File>(text).map(|f| f.losses).map_err(|e| e.to_string())
}

#[test]
fn configuration_files() {
    let text = r#"
        [[losses]]
        type = "cosine"
        [[losses]]
        type = "l2"
        weight = 0.5
        reduction = "sum"
        [[losses]]
        type = "aggregated_contrastive"
        temperature = 0.1
        schedule = "skip"
        min_points = 10
        classes = "pseudo_labels"
        [[losses]]
        type = "aggregated_contrastive"
        schedule = { last = 50.0 }
        [[losses]]
        type = "cross_entropy"
        label_smoothing = 0.1
        class_weights = [1.0, 2.0]
        [[losses]]
        type = "lovasz_softmax"
    "#;
    let terms = parse(text).unwrap();
    let texts = TextColumns::new(&[1.0, 0.0], 2).unwrap();
    let objective = build_objective(&terms, Some(&texts)).unwrap();
    let lines = objective.settings();
    assert_eq!(lines[0], "1 · cosine");
    assert!(lines[2].contains("temperature 0.1, never, from 10 rows"), "{}", lines[2]);
    assert!(lines[3].starts_with("0.02 · ") && lines[3].contains("last 50 %, from 100 rows"));
    assert_eq!(lines[4], "1 · cross_entropy (label smoothing 0.1, weighted classes)");
    for term in &terms {
        let written = toml::to_string(term).unwrap();
        assert_eq!(&toml::from_str::<LossConfig>(&written).unwrap(), term, "{written}");
    }
    let message = build_objective(&terms, None).err().unwrap().to_string();
    assert!(message.contains("text embeddings"), "{message}");
    assert!(build_objective(&[], None).is_err());
}

#[test]
fn configuration_files_that_are_wrong() {
    for (line, part) in [
        ("type = \"cosine\"\nwieght = 1.0", "wieght"),
        ("type = \"cosin\"", "cosin"),
        ("type = \"lovasz_softmax\"\ntemperature = 1.0", "temperature"),
        ("type = \"aggregated_contrastive\"\nclasses = \"truth\"", "truth"),
        ("type = \"aggregated_contrastive\"\nschedule = { first = 10.0 }", "first"),
    ] {
        let message = parse(&format!("[[losses]]\n{line}")).unwrap_err();
        assert!(message.contains(part), "{message}");
    }
    for (line, part) in [
        ("type = \"cosine\"\nweight = nan", "weight is NaN"),
        ("type = \"aggregated_contrastive\"\ntemperature = 0.0", "temperature is 0"),
        ("type = \"aggregated_contrastive\"\nschedule = { last = 101.0 }", "schedule.last is 101"),
        ("type = \"aggregated_contrastive\"\nmin_points = 1", "min_points is 1"),
        ("type = \"cross_entropy\"\nlabel_smoothing = 1.0", "label_smoothing is 1"),
        ("type = \"cross_entropy\"\nclass_weights = [-1.0]", "class_weights is -1"),
    ] {
        let terms = parse(&format!("[[losses]]\n{line}")).unwrap();
        let message = build_objective(&terms, None).err().unwrap().to_string();
        assert!(message.contains(part), "{message}");
    }
}
