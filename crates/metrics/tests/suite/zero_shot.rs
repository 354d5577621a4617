//! Zero-shot classes against f64, on hard features, and for any number of threads.

use crate::reference;
use crate::support::{in_all_pools, random_rows, rng, unit_rows};
use rand::Rng;
use scenesplat_metrics::{
    FeatureFn, FeatureRows, FeatureSlice, MetricError, TextRows, UnknownRule, ZeroShotLabels,
    ZeroShotOptions, class_probabilities, classify, cosine_scores,
};

/// Twice the rounding of 16 running sums over at most 50 blocks; measured errors are a tenth.
const SCORE_ATOL: f64 = 8e-6;

fn run(features: &[f32], text: TextRows<'_>, options: &ZeroShotOptions) -> ZeroShotLabels {
    classify(&FeatureSlice::new(features, text.dim()).unwrap(), text, options).unwrap()
}

#[test]
fn scores_are_cosines() {
    for (seed, n, c, dim) in [(0, 0, 3, 8), (1, 1, 1, 1), (2, 70, 21, 768), (3, 131, 7, 45)] {
        let rng = &mut rng(seed);
        let mut features = random_rows(rng, n, dim);
        for row in features.chunks_exact_mut(dim) {
            let scale = 10_f32.powi(rng.random_range(-30..30));
            row.iter_mut().for_each(|v| *v *= scale);
        }
        let table = random_rows(rng, c, dim);
        let units = unit_rows(&table, dim);
        let text = TextRows::new(&units, dim).unwrap();
        let features = FeatureSlice::new(&features, dim).unwrap();
        let scores = cosine_scores(&features, text).unwrap();
        assert_eq!(scores.len(), n * c);
        let mut scratch = vec![];
        let rows = features.read(0..n, &mut scratch).unwrap();
        for (i, &score) in scores.iter().enumerate() {
            let (row, class) = (i / c, i % c);
            let exact = reference::cosine(
                &rows[row * dim..(row + 1) * dim],
                &table[class * dim..(class + 1) * dim],
            );
            let error = (f64::from(score) - exact).abs();
            assert!(error < SCORE_ATOL, "row {row}, class {class}: {error}");
        }
    }
}

#[test]
fn threads_pieces_and_scale_do_not_change_a_bit() {
    let rng = &mut rng(8);
    let (n, c, dim) = (1003, 20, 100);
    let features = random_rows(rng, n, dim);
    let units = unit_rows(&random_rows(rng, c, dim), dim);
    let text = TextRows::new(&units, dim).unwrap();
    let options = ZeroShotOptions::default();
    let all = in_all_pools(|| run(&features, text, &options));
    for (i, row) in features.chunks_exact(dim).enumerate() {
        let alone = run(row, text, &options);
        assert_eq!(alone.labels[0], all.labels[i]);
        assert_eq!(alone.scores[0].to_bits(), all.scores[i].to_bits());
    }
    // Powers of two are exact, also where rows must be rescaled first.
    for exponent in [-90, -3, 70] {
        let scaled: Vec<f32> = features.iter().map(|v| v * 2_f32.powi(exponent)).collect();
        assert_eq!(run(&scaled, text, &options), all, "2^{exponent}");
    }
    let streamed = FeatureFn::new(n, dim, |rows, out: &mut [f32]| {
        out.copy_from_slice(&features[rows.start * dim..rows.end * dim]);
        Ok(())
    });
    assert_eq!(classify(&streamed.unwrap(), text, &options).unwrap(), all);
}

#[test]
fn rows_without_a_direction_are_unknown() {
    let text = TextRows::new(&[1.0, 0.0, 0.0, 1.0], 2).unwrap();
    let features = [
        [0.0, 0.0],
        [f32::NAN, 1.0],
        [f32::INFINITY, 0.0],
        [-0.0, 0.0],
        [1e-45, 0.0],
        [0.0, 1e-30],
        [0.0, f32::MAX],
        [f32::MAX, f32::MAX],
        [-1.0, -1.0],
    ];
    let found = run(features.as_flattened(), text, &ZeroShotOptions::default());
    assert_eq!(found.labels, [-1, -1, -1, -1, 0, 1, 1, 0, 0]);
    assert_eq!(found.num_unusable, 4);
    assert_eq!(found.scores[..5], [0.0, 0.0, 0.0, 0.0, 1.0]);
    assert!((found.scores[7] - 0.5_f32.sqrt()).abs() < 1e-6);
    assert!((found.scores[8] + 0.5_f32.sqrt()).abs() < 1e-6);
    assert_eq!(found.margins[7], 0.0);
}

#[test]
fn equal_text_rows_tie_to_the_smallest_class() {
    let rng = &mut rng(2);
    let mut table = random_rows(rng, 9, 40);
    let copy = table[40..80].to_vec();
    for class in [3, 4, 8] {
        table[class * 40..][..40].copy_from_slice(&copy);
    }
    let units = unit_rows(&table, 40);
    let text = TextRows::new(&units, 40).unwrap();
    let found = run(&copy.repeat(5), text, &ZeroShotOptions::default());
    assert_eq!(found.labels, [1; 5]);
    assert_eq!(found.margins, [0.0; 5]);
}

#[test]
fn the_unknown_rule_withholds_by_score_and_by_margin() {
    let text = TextRows::new(&[1.0, 0.0, 0.0, 1.0, -1.0, 0.0], 2).unwrap();
    let features = [1.0, 0.0, 0.8, 0.6, -0.1, -1.0];
    let label = |min_cosine, min_margin| {
        let unknown = UnknownRule { min_cosine, min_margin };
        let options = ZeroShotOptions { unknown, candidates: None };
        let found = run(&features, text, &options);
        assert_eq!(found.num_withheld, found.labels.iter().filter(|&&l| l == -1).count());
        found.labels
    };
    assert_eq!(label(None, None), [0, 0, 2]);
    assert_eq!(label(Some(0.5), None), [0, 0, -1]);
    assert_eq!(label(None, Some(0.5)), [0, -1, -1]);
    assert_eq!(label(Some(0.9), Some(0.1)), [0, -1, -1]);
    assert_eq!(label(Some(f32::INFINITY), None), [-1, -1, -1]);
    assert_eq!(label(Some(f32::NEG_INFINITY), Some(f32::NEG_INFINITY)), [0, 0, 2]);
}

#[test]
fn probabilities_are_the_softmax_of_cosines_over_a_temperature() {
    let mut rng = rng(12);
    let (dim, classes, n) = (24, 7, 700);
    let units = unit_rows(&random_rows(&mut rng, classes, dim), dim);
    let text = TextRows::new(&units, dim).unwrap();
    let mut features = random_rows(&mut rng, n, dim);
    // Any norm; and three rows without a direction.
    features[..dim].iter_mut().for_each(|v| *v *= 1e30);
    features[dim..2 * dim].iter_mut().for_each(|v| *v *= 1e-30);
    features[2 * dim..3 * dim].fill(0.0);
    features[3 * dim] = f32::NAN;
    features[4 * dim] = f32::INFINITY;
    let rows = FeatureSlice::new(&features, dim).unwrap();
    for (temperature, mask) in
        [(0.07, None), (1.5, Some([true, true, false, true, true, true, false]))]
    {
        let options =
            ZeroShotOptions { candidates: mask.map(|m| m.to_vec()), ..Default::default() };
        let found = class_probabilities(&rows, text, &options, temperature).unwrap();
        let allowed = |c: usize| mask.is_none_or(|m| m[c]);
        let mut worst: f64 = 0.0;
        for (row, (p, f)) in found.chunks(classes).zip(features.chunks(dim)).enumerate() {
            if (2..5).contains(&row) {
                assert_eq!(p, [0.0; 7], "{row}");
                continue;
            }
            let norm = f.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
            let cosine = |c: usize| {
                let t = &units[c * dim..][..dim];
                f.iter().zip(t).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>() / norm
            };
            let weight = |c: usize| match allowed(c) {
                true => (cosine(c) / f64::from(temperature)).exp(),
                false => 0.0,
            };
            let sum: f64 = (0..classes).map(weight).sum();
            for (c, p) in p.iter().enumerate() {
                worst = worst.max((f64::from(*p) - weight(c) / sum).abs());
            }
        }
        println!("probabilities at {temperature}: off by {worst:.1e} at most");
        assert!(worst < 2e-6, "{worst}");
    }
    for bad in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let options = ZeroShotOptions::default();
        let error = class_probabilities(&rows, text, &options, bad).unwrap_err().to_string();
        assert!(error.starts_with("temperature is"), "{error}");
    }
    let none = FeatureSlice::new(&[], dim).unwrap();
    assert!(class_probabilities(&none, text, &ZeroShotOptions::default(), 1.0).unwrap().is_empty());
}

#[test]
fn only_candidates_are_predicted() {
    let text = TextRows::new(&[1.0, 0.0, 0.0, 1.0, -1.0, 0.0], 2).unwrap();
    let options = |mask: &[bool]| ZeroShotOptions {
        candidates: Some(mask.to_vec()),
        unknown: UnknownRule { min_margin: Some(1e9), min_cosine: None },
    };
    let found = run(&[1.0, 0.1], text, &options(&[false, true, false]));
    assert_eq!((found.labels[0], found.margins[0]), (1, f32::INFINITY));
    let features = FeatureSlice::new(&[1.0, 0.1], 2).unwrap();
    let error = |mask| classify(&features, text, &options(mask)).unwrap_err().to_string();
    assert_eq!(error(&[false; 3]), "number of candidates is 0, expected at least 1");
    assert_eq!(error(&[true; 2]), "candidates: expected 3 rows, got 2");
}

#[test]
fn malformed_inputs_are_named() {
    let text = |rows: &[f32], dim| TextRows::new(rows, dim).map(|_| ()).unwrap_err().to_string();
    assert_eq!(text(&[1.0; 3], 2), "text embeddings: 3 values cannot be rows of 2 channels");
    assert_eq!(text(&[1.0; 3], 0), "text embeddings: 3 values cannot be rows of 0 channels");
    assert!(text(&[], 2).starts_with("0 classes"));
    assert!(text(&[1.0, 0.0, 0.0, 0.0], 2).contains("of class 1 has norm 0"));
    assert!(text(&[1.0, f32::NAN], 2).contains("of class 0 has norm NaN"));
    assert!(text(&[0.6, 0.8, 3.0, 4.0], 2).contains("of class 1 has norm 5, expected 1"));

    let table = TextRows::new(&[1.0, 0.0], 2).unwrap();
    let features = FeatureSlice::new(&[1.0; 6], 3).unwrap();
    let options = ZeroShotOptions::default();
    assert_eq!(
        classify(&features, table, &options).unwrap_err().to_string(),
        "features have 3 channels, the text table has 2"
    );
    assert!(FeatureSlice::new(&[1.0; 7], 3).is_err() && FeatureSlice::new(&[], 0).is_err());
    let nothing = |_, _: &mut [f32]| Ok(());
    assert!(FeatureFn::new(usize::MAX, 2, nothing).is_err());
    let wide = FeatureFn::new(3, usize::MAX, nothing).unwrap();
    assert!(wide.read(0..3, &mut vec![]).is_err());
    let nan = UnknownRule { min_cosine: Some(f32::NAN), min_margin: None };
    let features = FeatureSlice::new(&[1.0; 6], 2).unwrap();
    let error = classify(&features, table, &ZeroShotOptions { unknown: nan, candidates: None });
    assert_eq!(error.unwrap_err().to_string(), "min_cosine is NaN, expected a number");
}

#[test]
fn the_first_unreadable_piece_is_named() {
    let text = TextRows::new(&[1.0, 0.0], 2).unwrap();
    let features = FeatureFn::new(1000, 2, |rows, out: &mut [f32]| {
        out.fill(1.0);
        if rows.end > 300 { Err("disk on fire".into()) } else { Ok(()) }
    });
    let error = in_all_pools(|| {
        match classify(features.as_ref().unwrap(), text, &ZeroShotOptions::default()) {
            Err(MetricError::Rows { start, end, source }) => (start, end, source.to_string()),
            other => panic!("{other:?}"),
        }
    });
    assert_eq!(error, (256, 320, "disk on fire".to_owned()));
}
