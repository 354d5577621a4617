//! Every loss with settings that use all of its formula, as a function of its predictions.

use crate::support::{attributes, cube, matrix, noise, number, reference, units, wide};
use candle_core::{DType, Device, Result, Tensor, Var};
use scenesplat_losses::self_supervised::{
    Expansion, GaussianDistance, SimDino, masked_cosine, masked_cross_entropy, masked_gaussians,
    sim_dino, sim_dino_rows, view_cross_entropy,
};
use scenesplat_losses::{
    Loss, LossInput, Reduction, TextClassification, TextColumns, TextDistillation,
    aggregated_contrastive, cosine, cross_entropy, l2, lovasz_softmax, smooth_l1, split_classes,
};

pub type LossFn = Box<dyn Fn(&Tensor) -> Result<Option<Tensor>>>;

pub struct Case {
    pub name: &'static str,
    pub shape: Vec<usize>,
    pub pred: Vec<f64>,
    pub loss: LossFn,
    /// The value by the formula; the targets of those without one take the type of the predictions.
    pub want: Option<f64>,
}

impl Case {
    pub fn tensor(&self, values: &[f64], dtype: DType) -> Tensor {
        let wide = Tensor::from_vec(values.to_vec(), self.shape.as_slice(), &Device::Cpu).unwrap();
        wide.to_dtype(dtype).unwrap()
    }

    /// Value and gradient at these predictions.
    pub fn at(&self, pred: &Tensor) -> (f64, Vec<f64>) {
        let var = Var::from_tensor(pred).unwrap();
        let loss = (self.loss)(&var).unwrap().unwrap();
        let gradient = loss.backward().unwrap().get(&var).unwrap().clone();
        assert_eq!((gradient.dtype(), gradient.dims()), (pred.dtype(), pred.dims()));
        (number(&loss), wide(&gradient))
    }

    pub fn run(&self, dtype: DType) -> (f64, Vec<f64>) {
        self.at(&self.tensor(&self.pred, dtype))
    }
}

pub const ROWS: usize = 24;
pub const WIDTH: usize = 5;

pub fn all() -> Vec<Case> {
    let mut all = supervised();
    all.extend(self_supervised());
    all
}

/// Losses of rows with target rows or labels.
pub fn supervised() -> Vec<Case> {
    let pred: Vec<f64> = noise(ROWS * WIDTH, 1).iter().map(|v| 1.5 * v).collect();
    let rows = noise(ROWS * WIDTH, 2);
    let target = matrix(&rows, WIDTH, DType::F64);
    let valid: Vec<bool> = (0..ROWS).map(|i| i % 4 != 2).collect();
    let label: Vec<i32> = (0..ROWS).map(|i| [0, 3, -1, 1, 3, 0][i % 6]).collect();
    let weights = vec![0.5, 2.0, 1.0, 0.0, 0.25];
    let halves = split_classes(&label, Some(&valid), 3, 9).unwrap();
    assert_eq!(halves.len(), 3);
    let mut cases = Vec::new();
    let mut add = |name, want: f64, loss: LossFn| {
        let (shape, pred) = (vec![ROWS, WIDTH], pred.clone());
        cases.push(Case { name, shape, pred, loss, want: Some(want) });
    };
    type RowLoss = fn(&Tensor, &Tensor, Option<&[bool]>) -> Result<Option<Tensor>>;
    let losses: [(_, _, RowLoss); 4] = [
        ("cosine", reference::cosine(&pred, &rows, WIDTH, &valid), |p, t, v| {
            cosine(p, t, v, Reduction::Mean)
        }),
        ("l2", reference::l2(&pred, &rows, WIDTH, &valid), |p, t, v| l2(p, t, v, Reduction::Mean)),
        ("smooth l1", reference::smooth_l1(&pred, &rows, WIDTH, &valid, 0.4), |p, t, v| {
            smooth_l1(p, t, v, 0.4, Reduction::Mean)
        }),
        ("smooth l1, wide", reference::smooth_l1(&pred, &rows, WIDTH, &valid, 1.0), |p, t, v| {
            smooth_l1(p, t, v, 1.0, Reduction::Mean)
        }),
    ];
    for (name, want, loss) in losses {
        let (target, valid) = (target.clone(), valid.clone());
        add(name, want, Box::new(move |p| loss(p, &target, Some(&valid))));
    }
    let want = reference::contrastive(&pred, WIDTH, &halves, 0.3);
    let contrast = move |p: &Tensor| aggregated_contrastive(p, &halves, 0.3, Reduction::Mean);
    add("contrastive", want, Box::new(contrast));
    for (name, smoothing, weights) in
        [("cross entropy", 0.0, None), ("cross entropy, smoothed and weighted", 0.1, Some(weights))]
    {
        let want = reference::cross_entropy(&pred, WIDTH, &label, smoothing, weights.as_deref());
        let label = label.clone();
        let loss = move |p: &Tensor| cross_entropy(p, &label, smoothing, weights.as_deref());
        add(name, want, Box::new(loss));
    }
    let want = reference::lovasz(&pred, WIDTH, &label);
    let labels = label.clone();
    add("lovasz", want, Box::new(move |p| lovasz_softmax(p, &labels)));
    cases.extend(of_texts(&pred, &rows, &valid, &label));
    cases
}

/// Losses that compare rows with texts.
fn of_texts(pred: &[f64], rows: &[f64], valid: &[bool], label: &[i32]) -> Vec<Case> {
    let target = matrix(rows, WIDTH, DType::F64);
    let texts: Vec<f32> = units(&noise(4 * WIDTH, 6), WIDTH).iter().map(|v| *v as f32).collect();
    let columns = TextColumns::new(&texts, WIDTH).unwrap();
    let texts: Vec<f64> = texts.into_iter().map(f64::from).collect();
    let logits = |rows: &[f64], temperature| reference::logits(rows, &texts, WIDTH, temperature);
    let mut cases = Vec::new();
    let mut add = |name, want: f64, loss: LossFn| {
        let (shape, pred) = (vec![ROWS, WIDTH], pred.to_vec());
        cases.push(Case { name, shape, pred, loss, want: Some(want) });
    };
    for (name, lovasz) in [("text classification", 0.0), ("text classification, lovasz", 0.7)] {
        let z = logits(pred, 0.5);
        let want = reference::cross_entropy(&z, 4, label, 0.0, None)
            + lovasz * reference::lovasz(&z, 4, label);
        let new = TextClassification::new(columns.clone());
        let (label, loss) =
            (label.to_vec(), TextClassification { temperature: 0.5, lovasz, ..new });
        let input = move |p: &Tensor| loss.forward(&labelled(p, &label));
        add(name, want, Box::new(input));
    }
    for (name, temperature) in [("text distillation", 1.0), ("text distillation, sharp", 0.3)] {
        let (p, q) = (logits(pred, temperature), logits(rows, temperature));
        let want = reference::divergence(&p, &q, 4, valid);
        let loss = TextDistillation { temperature, ..TextDistillation::new(columns.clone()) };
        let (target, valid) = (target.clone(), valid.to_vec());
        let input = move |p: &Tensor| {
            let (target, valid) = (Some(&target), Some(valid.as_slice()));
            loss.forward(&LossInput { target, valid, ..labelled(p, &[]) })
        };
        add(name, want, Box::new(input));
    }
    cases
}

fn labelled<'a>(pred: &'a Tensor, label: &'a [i32]) -> LossInput<'a> {
    crate::support::input(pred, None, Some(label), None)
}

/// Losses of self-supervision: `[3, 4, 6]` for views, else rows.
pub fn self_supervised() -> Vec<Case> {
    let teacher = cube(&units(&noise(2 * 4 * 6, 2), 6), 2, 4, DType::F64);
    let target = matrix(&noise(8 * 9, 3), 9, DType::F64);
    let soft: Vec<f64> = noise(8 * 9, 5).iter().map(|v| v.abs() / 4.0).collect();
    let soft = matrix(&soft, 9, DType::F64);
    let soft_views: Vec<f64> = noise(2 * 4 * 6, 6).iter().map(|v| v.abs()).collect();
    let soft_views = cube(&soft_views, 2, 4, DType::F64);
    let weights = vec![0.5, 0.5, 0.25, 0.0, 0.25, 0.125, 0.3, 0.1];
    let mut cases = Vec::new();
    let mut add = |name, shape: &[usize], target: &Tensor, loss: RowsFn| {
        let pred = noise(shape.iter().product(), 1);
        let target = target.clone();
        let loss: LossFn = Box::new(move |p| loss(p, &target.to_dtype(p.dtype())?));
        cases.push(Case { name, shape: shape.to_vec(), pred, loss, want: None });
    };
    let plain = SimDino::default();
    for (name, settings) in [
        ("simdino", plain),
        ("simdino, student", SimDino { expansion: Expansion::Student, coefficient: 1.0, ..plain }),
        ("simdino, any length", SimDino { normalized: false, ..plain }),
    ] {
        let loss = move |s: &Tensor, t: &Tensor| Ok(sim_dino(s, t, &settings)?.map(|out| out.loss));
        add(name, &[3, 4, 6], &teacher, Box::new(loss));
    }
    for (name, shape, settings) in [
        ("simdino rows", [8, 9], plain),
        (
            "simdino rows, more rows than channels",
            [24, 3],
            SimDino { coefficient: 2.0, normalized: false, ..plain },
        ),
    ] {
        let rows = matrix(&units(&noise(72, 4), shape[1]), shape[1], DType::F64);
        let loss =
            move |s: &Tensor, t: &Tensor| Ok(sim_dino_rows(s, t, &settings)?.map(|out| out.loss));
        add(name, &shape, &rows, Box::new(loss));
    }
    let views = |s: &Tensor, t: &Tensor| view_cross_entropy(s, t, 0.3, false);
    add("dino", &[3, 4, 6], &soft_views, Box::new(views));
    let masked = weights.clone();
    add("ibot cosine", &[8, 9], &target, Box::new(move |p, t| masked_cosine(p, t, &masked)));
    let entropy = move |p: &Tensor, t: &Tensor| masked_cross_entropy(p, t, &weights, 0.2);
    add("ibot cross entropy", &[8, 9], &soft, Box::new(entropy));
    for (name, distance) in [
        ("masked, mean square", GaussianDistance::MeanSquare),
        ("masked, fitted", GaussianDistance::Fitted),
        ("masked, ellipsoid", GaussianDistance::Ellipsoid),
    ] {
        let counts = [true, true, false, true, true, true, true, false];
        let loss = move |p: &Tensor, t: &Tensor| {
            let out = masked_gaussians(p, t, Some(&counts), &attributes(), distance)?;
            Ok(out.map(|(loss, _)| loss))
        };
        add(name, &[8, 9], &target, Box::new(loss));
    }
    cases
}

type RowsFn = Box<dyn Fn(&Tensor, &Tensor) -> Result<Option<Tensor>>>;
