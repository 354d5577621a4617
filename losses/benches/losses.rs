//! Losses on a batch of 100,000 rows: value alone, and with the gradient.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

use candle_core::{DType, Device, Result, Tensor, Var};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_losses::{
    AggregatedContrastive, ClassSource, CosineLoss, CrossEntropy, L2Loss, Loss, LossInput,
    LovaszSoftmax, TermSchedule, TextColumns,
};
use std::time::Duration;

/// As the program: the system's allocator would add page faults to every gradient.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const ROWS: usize = 100_000;
const WIDTH: usize = 768;
const CLASSES: usize = 200;

fn criterion() -> Criterion {
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .configure_from_args()
}

/// Numbers in -1..1, the same in every run.
fn noise(columns: usize, seed: u32) -> Result<Tensor> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    };
    let values: Vec<f32> = (0..ROWS * columns).map(|_| next()).collect();
    Tensor::from_vec(values, (ROWS, columns), &Device::Cpu)
}

/// A class for each row, or none.
fn labels() -> Vec<i32> {
    (0..ROWS).map(|i| ((i * i % (CLASSES + 3)) as i32 - 3).max(-1)).collect()
}

/// The value alone, and the value with the whole of candle's `backward`.
fn bench(c: &mut Criterion, name: &str, loss: &dyn Loss, pred: &Tensor, target: Option<&Tensor>) {
    let label = labels();
    let var = Var::from_tensor(pred).expect("a variable");
    let run = |pred: &Tensor| {
        let input =
            LossInput { pred, target, label: Some(&label), valid: None, progress: 1.0, seed: 1 };
        loss.forward(&input).expect("a loss").expect("a loss that is on")
    };
    let mut group = c.benchmark_group(name);
    group.throughput(Throughput::Elements(ROWS as u64));
    let kind = format!("{:?}", pred.dtype()).to_lowercase();
    group.bench_function(format!("100k/{}/{kind}/value", pred.dims()[1]), |b| {
        b.iter(|| run(pred));
    });
    group.bench_function(format!("100k/{}/{kind}/backward", pred.dims()[1]), |b| {
        b.iter(|| run(&var).backward().expect("gradients"));
    });
    group.finish();
}

fn features(c: &mut Criterion) {
    let (pred, target) = (noise(WIDTH, 1).expect("rows"), noise(WIDTH, 2).expect("rows"));
    let contrastive = |classes| AggregatedContrastive {
        classes,
        schedule: TermSchedule::Always,
        ..AggregatedContrastive::default()
    };
    for dtype in [DType::F32, DType::BF16] {
        let (pred, target) =
            (pred.to_dtype(dtype).expect("a cast"), target.to_dtype(dtype).expect("a cast"));
        bench(c, "cosine", &CosineLoss::default(), &pred, Some(&target));
        bench(c, "l2", &L2Loss::default(), &pred, Some(&target));
        bench(c, "contrastive", &contrastive(ClassSource::Labels), &pred, Some(&target));
    }
    let texts: Vec<f32> = noise(WIDTH, 3)
        .and_then(|t| t.narrow(0, 0, CLASSES))
        .and_then(|t| t.broadcast_div(&t.sqr()?.sum_keepdim(1)?.sqrt()?))
        .and_then(|t| t.flatten_all()?.to_vec1())
        .expect("texts");
    let texts = TextColumns::new(&texts, WIDTH).expect("rows of unit length");
    let pseudo = contrastive(ClassSource::PseudoLabels(texts));
    bench(c, "contrastive_pseudo_labels", &pseudo, &pred, Some(&target));
}

fn classes(c: &mut Criterion) {
    let logits = (noise(CLASSES, 1).expect("rows") * 5.0).expect("logits");
    for dtype in [DType::F32, DType::BF16] {
        let logits = logits.to_dtype(dtype).expect("a cast");
        bench(c, "cross_entropy", &CrossEntropy::default(), &logits, None);
        bench(c, "lovasz_softmax", &LovaszSoftmax, &logits, None);
    }
    // A network that is mostly right: few rows can be left out of the sorting.
    let mut values = logits.flatten_all().and_then(|l| l.to_vec1::<f32>()).expect("logits");
    for (row, label) in values.chunks_exact_mut(CLASSES).zip(labels()) {
        if label >= 0 {
            row[label as usize] += 10.0;
        }
    }
    let trained = Tensor::from_vec(values, (ROWS, CLASSES), &Device::Cpu).expect("logits");
    bench(c, "lovasz_softmax_trained", &LovaszSoftmax, &trained, None);
}

criterion_group!(name = benches; config = criterion(); targets = features, classes);
criterion_main!(benches);
