//! Figures that the confusion matrix does not hold: how well confidence and truth agree, and whether
//! a query's best Gaussian is what was asked for.

use super::ParetoError;
use scenesplat::inference::SceneFeatures;
use scenesplat::labels::ComparableTexts;
use scenesplat_metrics::ConfidenceBins;
use scenesplat_scene::TextTable;

/// Cosines are divided by this before a softmax makes probabilities of them. It is the same for all
/// settings, so that their calibration errors compare; docs/accuracy_time.md says where it comes from.
pub const TEMPERATURE: f32 = 0.05;
/// Feature rows read together.
const BLOCK: usize = 2048;

/// How many queries hit, of how many.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Hits {
    /// Queries whose best Gaussian is of the class.
    pub hits: usize,
    /// Classes that were asked for: those that the scene has.
    pub asked: usize,
}

/// Adds a scene: the confidence in each Gaussian's label against its truth, and for each class of the
/// truth whether the Gaussian that scores best for it is one.
///
/// `text`: the classes; `None` for a network whose rows are probabilities. `labels`, `truth`: class of
/// each Gaussian, -1 for none. `[N]`
///
/// # Errors
/// If features cannot be read.
pub fn add_scene(
    calibration: &mut ConfidenceBins,
    features: &SceneFeatures,
    text: Option<&TextTable>,
    labels: &[i32],
    truth: &[i32],
) -> Result<Hits, ParetoError> {
    let width = features.width();
    let classes = text.map_or(width, TextTable::len);
    // Codes are compared with the texts along their axes.
    let text = text.map(|text| ComparableTexts::new(features, text)).transpose()?;
    let by_slot = members(features);
    let mut best: Vec<(f32, Option<usize>)> = vec![(f32::NEG_INFINITY, None); classes];
    for start in (0..features.num_slots()).step_by(BLOCK) {
        let end = (start + BLOCK).min(features.num_slots());
        let rows = features.slot_rows(start..end)?;
        for (slot, row) in (start..end).zip(rows.chunks_exact(width)) {
            let gaussians = &by_slot.rows[by_slot.starts[slot]..by_slot.starts[slot + 1]];
            let Some(&first) = gaussians.first() else { continue };
            let scores: Vec<f32> = match &text {
                Some(text) => text
                    .values()
                    .chunks_exact(width)
                    .map(|t| t.iter().zip(row).map(|(a, b)| a * b).sum())
                    .collect(),
                None => row.to_vec(),
            };
            for (best, &score) in best.iter_mut().zip(&scores) {
                if score > best.0 {
                    *best = (score, Some(first as usize));
                }
            }
            let probabilities = if text.is_some() { softmax(&scores) } else { scores };
            for &gaussian in gaussians {
                let (label, known) = (labels[gaussian as usize], truth[gaussian as usize]);
                let confidence = usize::try_from(label).ok().and_then(|l| probabilities.get(l));
                if let (Some(&confidence), true) = (confidence, known >= 0)
                    && confidence.is_finite()
                {
                    calibration.add(f64::from(confidence.clamp(0.0, 1.0)), label == known);
                }
            }
        }
    }
    let mut hits = Hits::default();
    for (class, (_, gaussian)) in best.iter().enumerate() {
        if truth.contains(&(class as i32)) {
            hits.asked += 1;
            hits.hits += usize::from(gaussian.is_some_and(|g| truth[g] == class as i32));
        }
    }
    Ok(hits)
}

/// How sure labels are, by several measures. `[N]` each
#[derive(Debug, Clone, Default)]
pub(crate) struct Sureness {
    /// Probability of the label, 0 where there is none.
    pub(crate) of_label: Vec<f32>,
    /// Probability of the class that is most probable by the Gaussian's own feature, which a vote may have overruled.
    pub(crate) highest: Vec<f32>,
    /// That less the probability of the second.
    pub(crate) margin: Vec<f32>,
    /// One less the entropy of all classes, of the largest that there could be.
    pub(crate) order: Vec<f32>,
    /// The label's probability at twice the temperature.
    pub(crate) tempered: Vec<f32>,
    /// 1 where the vote took the Gaussian's own class.
    pub(crate) agrees: Vec<f32>,
}

/// How sure the labels of a scene are.
///
/// # Errors
/// If features cannot be read.
pub(crate) fn sureness(
    features: &SceneFeatures,
    text: &TextTable,
    labels: &[i32],
) -> Result<Sureness, ParetoError> {
    let width = features.width();
    // Codes are compared with the texts along their axes.
    let texts = ComparableTexts::new(features, text)?;
    let by_slot = members(features);
    let zeros = vec![0.0; labels.len()];
    let mut out = Sureness {
        of_label: zeros.clone(),
        highest: zeros.clone(),
        margin: zeros.clone(),
        order: zeros.clone(),
        tempered: zeros.clone(),
        agrees: zeros,
    };
    for start in (0..features.num_slots()).step_by(BLOCK) {
        let end = (start + BLOCK).min(features.num_slots());
        let rows = features.slot_rows(start..end)?;
        for (slot, row) in (start..end).zip(rows.chunks_exact(width)) {
            let dot = |t: &[f32]| t.iter().zip(row).map(|(a, b)| a * b).sum();
            let scores: Vec<f32> = texts.values().chunks_exact(width).map(dot).collect();
            let all = softmax(&scores);
            let soft = softmax_at(&scores, 2.0 * TEMPERATURE);
            let (mut own, mut top, mut second) = (0, 0.0f32, 0.0f32);
            for (class, &p) in all.iter().enumerate() {
                if p > top {
                    (own, top, second) = (class, p, top);
                } else {
                    second = second.max(p);
                }
            }
            let entropy: f32 = all.iter().filter(|p| **p > 0.0).map(|p| -p * p.ln()).sum();
            let order = 1.0 - entropy / (all.len().max(2) as f32).ln();
            for &gaussian in &by_slot.rows[by_slot.starts[slot]..by_slot.starts[slot + 1]] {
                let at = gaussian as usize;
                let label = usize::try_from(labels[at]).ok();
                let of = |p: &[f32]| label.and_then(|l| p.get(l).copied()).unwrap_or(0.0);
                out.of_label[at] = of(&all);
                out.tempered[at] = of(&soft);
                out.agrees[at] = f32::from(u8::from(label == Some(own)));
                (out.highest[at], out.margin[at], out.order[at]) = (top, top - second, order);
            }
        }
    }
    Ok(out)
}

/// Which Gaussians have each row.
struct Members {
    starts: Vec<usize>,
    rows: Vec<u32>,
}

fn members(features: &SceneFeatures) -> Members {
    let mut starts = vec![0; features.num_slots() + 1];
    for &slot in features.inverse() {
        starts[slot as usize + 1] += 1;
    }
    for i in 1..starts.len() {
        starts[i] += starts[i - 1];
    }
    let mut next = starts.clone();
    let mut rows = vec![0; features.len()];
    for (gaussian, &slot) in (0..).zip(features.inverse()) {
        rows[next[slot as usize]] = gaussian;
        next[slot as usize] += 1;
    }
    Members { starts, rows }
}

fn softmax(scores: &[f32]) -> Vec<f32> {
    softmax_at(scores, TEMPERATURE)
}

fn softmax_at(scores: &[f32], temperature: f32) -> Vec<f32> {
    let top = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let exp: Vec<f32> = scores.iter().map(|s| ((s - top) / temperature).exp()).collect();
    let sum: f32 = exp.iter().sum();
    exp.into_iter().map(|e| e / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat::evaluation::own_directions;

    #[test]
    fn a_query_hits_if_its_best_gaussian_is_of_the_class() {
        let names = ["wall", "chair", "lamp"].map(str::to_owned).to_vec();
        let text = own_directions(names).unwrap();
        let rows = vec![1.0, 0.0, 0.0, 0.6, 0.8, 0.0, 0.0, 1.0, 0.0];
        let features = SceneFeatures::from_rows(rows, 3).unwrap();
        let mut calibration = ConfidenceBins::default();
        let mut hits = |truth: &[i32]| {
            add_scene(&mut calibration, &features, Some(&text), &[0, 1, 1], truth).unwrap()
        };
        assert_eq!(hits(&[0, 1, 1]), Hits { hits: 2, asked: 2 });
        // The best chair is a wall; no lamp is there to be asked for.
        assert_eq!(hits(&[0, 1, 0]), Hits { hits: 1, asked: 2 });
        assert_eq!(hits(&[-1, -1, -1]), Hits { hits: 0, asked: 0 });
        // Two numbers hold all of these rows: as codes they answer the same, as surely.
        let error = calibration.error().unwrap();
        let codes = features.into_codes(2).unwrap();
        let mut calibration = ConfidenceBins::default();
        let mut hits = |truth: &[i32]| {
            add_scene(&mut calibration, &codes, Some(&text), &[0, 1, 1], truth).unwrap()
        };
        assert_eq!(hits(&[0, 1, 1]), Hits { hits: 2, asked: 2 });
        assert_eq!(hits(&[0, 1, 0]), Hits { hits: 1, asked: 2 });
        assert!((calibration.error().unwrap() - error).abs() < 1e-6);
        let sure = sureness(&codes, &text, &[0, 1, 1]).unwrap();
        assert_eq!(sure.agrees, [1.0, 1.0, 1.0]);
    }

    #[test]
    fn a_margin_is_the_distance_to_the_second_wherever_it_stands() {
        let names = ["wall", "chair", "lamp"].map(str::to_owned).to_vec();
        let text = own_directions(names).unwrap();
        // The second stands before the highest, then behind it.
        let rows = vec![0.6, 0.8, 0.0, 0.8, 0.6, 0.0];
        let features = SceneFeatures::from_rows(rows, 3).unwrap();
        let sure = sureness(&features, &text, &[1, 0]).unwrap();
        // The scores 0.8, 0.6 and 0, divided by 0.05, are 16, 12 and 0: weights 1, e^-4 and e^-16.
        let (second, third) = ((-4.0f32).exp(), (-16.0f32).exp());
        let margin = (1.0 - second) / (1.0 + second + third);
        for found in sure.margin {
            assert!((found - margin).abs() < 2e-3, "{found} {margin}");
        }
        assert_eq!(sure.agrees, [1.0, 1.0]);
    }

    #[test]
    fn confidence_is_compared_with_truth_gaussian_by_gaussian() {
        let names = ["wall", "chair"].map(str::to_owned).to_vec();
        let text = own_directions(names).unwrap();
        // Cosines 1 and 0: e^-20 of the second. 0.6 and 0.8: 1 / (1 + e^4) = 0.018 and 0.982.
        let rows = [1.0, 0.0, 0.6, 0.8, 0.8, 0.6].to_vec();
        let features = SceneFeatures::from_rows(rows, 2).unwrap();
        let error = |labels: &[i32], truth: &[i32]| {
            let mut calibration = ConfidenceBins::default();
            add_scene(&mut calibration, &features, Some(&text), labels, truth).unwrap();
            calibration.error()
        };
        let low = 1.0 / (1.0 + 4f64.exp());
        // Sure and right; sure and wrong; unsure of what is right. Each in a bin of its own, but for the first.
        for (labels, truth, want) in [
            ([0, 1, 0], [0, 1, 0], 2.0 * low / 3.0),
            ([0, 1, 0], [1, -1, -1], 1.0),
            ([-1, 0, -1], [0, 1, 0], low),
            ([-1, 1, 2], [0, 0, 0], 1.0 - low),
            ([1, 0, -1], [1, 0, -1], (1.0 + 1.0 - low) / 2.0),
        ] {
            let found = error(&labels, &truth).unwrap();
            assert!((found - want).abs() < 1e-5, "{labels:?} {truth:?}: {found} {want}");
        }
        assert_eq!(error(&[-1, 0, 0], &[0, -1, -1]), None);
        // A classifier's rows are probabilities already.
        let classes = SceneFeatures::from_rows(vec![0.75, 0.25, 0.5, 0.5], 2).unwrap();
        let first = classes.slot_rows(0..1).unwrap();
        let mut calibration = ConfidenceBins::default();
        let hits = add_scene(&mut calibration, &classes, None, &[0, -1], &[0, 1]).unwrap();
        assert_eq!(hits, Hits { hits: 2, asked: 2 });
        assert!((calibration.error().unwrap() - f64::from(1.0 - first[0])).abs() < 1e-6);
    }

    #[test]
    fn sureness_by_hand_in_more_rows_than_are_read_together() {
        let text = own_directions(["wall", "chair", "lamp"].map(str::to_owned).to_vec()).unwrap();
        // 2,050 rows, of which the last two are others: cosines 0.8, 0.6 and 0.
        let mut rows = [1.0, 0.0, 0.0].repeat(2048);
        rows.extend([0.8, 0.6, 0.0, 0.0, 0.6, 0.8]);
        let features = SceneFeatures::from_rows(rows, 3).unwrap();
        let mut labels = vec![0; 2050];
        (labels[2047], labels[2048], labels[2049]) = (-1, 1, 2);
        let sure = sureness(&features, &text, &labels).unwrap();
        let near = |found: f32, want: f64| {
            assert!((f64::from(found) - want).abs() < 1e-5, "{found} {want}");
        };
        // Divided by 0.05: 16, 12, 0. At twice the temperature 8, 6, 0.
        let of = |scores: [f64; 3]| {
            let sum: f64 = scores.iter().map(|s| s.exp()).sum();
            scores.map(|s| s.exp() / sum)
        };
        let (p, soft) = (of([16.0, 12.0, 0.0]), of([8.0, 6.0, 0.0]));
        let entropy: f64 = p.iter().map(|p| -p * p.ln()).sum();
        for (at, label) in [(2048, 1), (2049, 0)] {
            near(sure.of_label[at], p[label]);
            near(sure.tempered[at], soft[label]);
            near(sure.highest[at], p[0]);
            near(sure.margin[at], p[0] - p[1]);
            near(sure.order[at], 1.0 - entropy / 3f64.ln());
        }
        assert_eq!(
            (sure.agrees[0], sure.agrees[2047], sure.agrees[2048], sure.agrees[2049]),
            (1.0, 0.0, 0.0, 1.0)
        );
        assert_eq!((sure.of_label[2047], sure.tempered[2047]), (0.0, 0.0));
        near(sure.of_label[2046], 1.0);
        assert_eq!(TEMPERATURE, 0.05);
        // The best of a query is looked for in all rows: the best lamp is a chair, of equal chairs the first counts.
        let mut truth = vec![0; 2050];
        (truth[5], truth[2048], truth[2049]) = (2, 1, 1);
        let hits =
            add_scene(&mut ConfidenceBins::default(), &features, Some(&text), &labels, &truth)
                .unwrap();
        assert_eq!(hits, Hits { hits: 2, asked: 3 });
    }
}
