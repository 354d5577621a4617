//! What a page holds, before it is a file or served.

use super::codes::{PageCodes, pack_codes};
use super::relations::Related;
use super::words::Words;
use super::{MOST_NAMES, PageError, PageInput, PageReport, PageSettings, blocks};
use crate::outputs::label_colors;
use scenesplat_objects::{Catalogue, Object};
use scenesplat_text::{denial_words, place_words};
use serde_json::{Value, json};

/// Blocks of numbers, what they mean, and what is said about them.
pub(super) struct Pack {
    /// What the page reads first.
    pub(super) about: Value,
    /// The blocks by name.
    pub(super) parts: Vec<(&'static str, Vec<u8>)>,
    /// What is in it; its sizes are not known yet.
    pub(super) report: PageReport,
}

impl Pack {
    pub(super) fn of(input: &PageInput<'_>, settings: &PageSettings) -> Result<Self, PageError> {
        check(input)?;
        let scene = input.scene;
        let rows = blocks::kept(scene, settings.max_splats);
        if rows.is_empty() {
            return Err(PageError::Empty);
        }
        let packed = blocks::pack(scene, &rows);
        let mut parts = packed.parts;
        let codes = match input.features {
            Some((features, texts)) => {
                Some(pack_codes(features, texts, input, &rows, settings.codes)?)
            }
            None => None,
        };
        let words = Words::of(input.names, input.vocabulary)?;
        if let Some(labels) = input.labels {
            let label = rows.iter().map(|&r| (labels[r] + 1).max(0) as u32);
            parts.push(("label", blocks::planes(label, 2)));
        }
        if let Some(scores) = input.scores {
            let byte = |&r: &usize| (scores[r].clamp(0.0, 1.0) * 255.0).round() as u8;
            parts.push(("score", rows.iter().map(byte).collect()));
        }
        if let Some(instances) = input.catalogue.map(Catalogue::instances) {
            let object = rows.iter().map(|&r| (instances[r] + 1) as u32);
            parts.push(("object", blocks::planes(object, 2)));
        }
        if rows.len() < scene.len() {
            parts.push(("rows", blocks::planes(rows.iter().map(|&r| r as u32), 4)));
        }
        let related = Related::of(input.catalogue.map_or(&[], |c| &c.objects));
        let about = about(input, &rows, &packed.about, codes.as_ref(), &words, &related);
        parts.push(("phrases", words.phrases.as_bytes().to_vec()));
        parts.push(("near", words.near));
        let code_cosine = codes.as_ref().map(|c| c.mean_cosine);
        if let Some(codes) = codes {
            parts.push(("slot", codes.slots));
            parts.push(("codes", codes.values));
            parts.push(("texts", codes.texts));
        }
        let report = PageReport {
            bytes: 0,
            blocks: Vec::new(),
            gaussians: rows.len(),
            left_out: scene.len() - rows.len(),
            code_cosine,
            position_step: packed.step,
            relations: related.pairs.len() + related.left_out,
            relations_left_out: related.left_out,
        };
        Ok(Self { about, parts, report })
    }
}

fn check(input: &PageInput<'_>) -> Result<(), PageError> {
    let expected = input.scene.len();
    let lens = [
        ("labels", input.labels.map(<[i32]>::len)),
        ("scores", input.scores.map(<[f32]>::len)),
        ("catalogue", input.catalogue.map(|c| c.gaussians)),
        ("features", input.features.map(|(f, _)| f.len())),
    ];
    for (field, got) in lens {
        if let Some(got) = got.filter(|&got| got != expected) {
            return Err(PageError::Rows { field, expected, got });
        }
    }
    let objects = input.catalogue.map_or(0, |c| c.objects.len());
    for (what, count) in [("classes", input.names.len()), ("objects", objects)] {
        if count >= MOST_NAMES {
            return Err(PageError::TooMany { what, count });
        }
    }
    Ok(())
}

/// What the page reads first.
fn about(
    input: &PageInput<'_>,
    rows: &[usize],
    places: &Value,
    codes: Option<&PageCodes>,
    words: &Words,
    related: &Related,
) -> Value {
    let mut counts = vec![0u64; input.names.len()];
    for &row in input.labels.map(|_| rows).unwrap_or_default() {
        let label = input.labels.map_or(-1, |l| l[row]);
        if let Some(count) = usize::try_from(label).ok().and_then(|l| counts.get_mut(l)) {
            *count += 1;
        }
    }
    let numbers: Vec<i32> = (0..input.names.len() as i32).collect();
    let classes: Vec<Value> = (input.names.iter().zip(label_colors(&numbers)).zip(&counts))
        .map(|((name, color), count)| json!({ "name": name, "color": color, "count": count }))
        .collect();
    let all: &[Object] = input.catalogue.map_or(&[], |c| &c.objects);
    let objects: Vec<Value> = all.iter().map(object).collect();
    let mut remarks = input.remarks.to_vec();
    if related.left_out > 0 {
        let (known, all) = (related.pairs.len(), related.pairs.len() + related.left_out);
        remarks.push(format!(
            "Relations: {known} of {all} pairs of objects; those that are only near each other, and farthest, are left out."
        ));
    }
    json!({
        "version": 1,
        "title": input.title,
        "count": rows.len(),
        "total": input.scene.len(),
        "up": input.upright,
        "metresPerUnit": input.metres_per_unit,
        "origin": places["origin"],
        "step": places["step"],
        "scaleRange": places["scaleRange"],
        "classes": classes,
        "objects": objects,
        "relations": related.pairs,
        "texts": codes.map_or(input.names, |c| c.names.as_slice()),
        "colorWords": words.colors,
        "foreign": { "articles": words.foreign.0, "names": words.foreign.1 },
        "groups": words.groups,
        "denials": denial_words(),
        "places": place_words(),
        "codes": codes.map(|c| json!({ "width": c.width, "slots": c.count })),
        "hasScores": input.scores.is_some(),
        "phrases": words.phrases.lines().count(),
        "warnings": input.warnings,
        "remarks": remarks,
        "chunks": Value::Null,
    })
}

fn object(o: &Object) -> Value {
    json!({
        "id": o.id,
        "label": o.label,
        "score": o.score,
        "count": o.count,
        "position": o.position,
        "corners": o.corners,
        "size": o.bounds.size,
        "volume": o.volume,
        "aboveFloor": o.above_floor,
        "wallDistance": o.wall_distance,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inference::SceneFeatures;
    use scenesplat_objects::{ObjectInput, ObjectSettings, find_objects};
    use scenesplat_scene::{GaussianScene, TextTable, Up};

    /// Two clusters far apart, and a Gaussian without a class between them.
    fn scene() -> (GaussianScene, Vec<i32>, Vec<String>) {
        let count = 61;
        let coord = (0..count)
            .map(|i| {
                let x = if i < 30 { 0.0 } else { 5.0 };
                if i == 60 { [2.5; 3] } else { [x + 0.01 * i as f32, 0.02 * (i % 5) as f32, 0.0] }
            })
            .collect();
        let scene = GaussianScene {
            coord,
            log_scale: vec![[-4.0; 3]; count],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacity_logit: vec![2.0; count],
            sh_dc: vec![[0.1; 3]; count],
            ..Default::default()
        };
        let labels = (0..count).map(|i| if i == 60 { -1 } else { i32::from(i >= 30) }).collect();
        (scene, labels, vec!["lamp".to_owned(), "desk".to_owned()])
    }

    fn input<'a>(
        scene: &'a GaussianScene,
        labels: &'a [i32],
        names: &'a [String],
    ) -> PageInput<'a> {
        PageInput {
            title: "t",
            scene,
            labels: Some(labels),
            scores: None,
            names,
            catalogue: None,
            features: None,
            vocabulary: None,
            upright: Up::PLUS_Z.upright(),
            metres_per_unit: 1.0,
            warnings: &[],
            remarks: &[],
        }
    }

    #[test]
    fn labels_and_objects_are_numbered_from_one_and_rows_are_those_of_the_scene() {
        let (scene, labels, names) = scene();
        let found = ObjectInput {
            scene: &scene,
            labels: &labels,
            scores: None,
            instances: None,
            features: None,
            names: &names,
            upright: Up::PLUS_Z.upright(),
            metres_per_unit: 1.0,
            floor: None,
        };
        let found = find_objects(&found, &ObjectSettings::default()).unwrap();
        assert_eq!(found.objects.len(), 2);
        let scores: Vec<f32> = (0..61).map(|i| i as f32 / 60.0).collect();
        let input = PageInput {
            scores: Some(&scores),
            catalogue: Some(&found),
            ..input(&scene, &labels, &names)
        };
        let pack = Pack::of(&input, &PageSettings::default()).unwrap();
        let part = |name: &str| &pack.parts.iter().find(|(own, _)| *own == name).unwrap().1;
        for (row, (label, object)) in [(0, (1, 1)), (29, (1, 1)), (30, (2, 2)), (60, (0, 0))] {
            assert_eq!((part("label")[row], part("object")[row]), (label, object), "{row}");
        }
        assert!(part("label")[61..].iter().all(|v| *v == 0), "the high bytes come last");
        assert_eq!((part("score")[0], part("score")[30], part("score")[60]), (0, 128, 255));
        assert!(pack.parts.iter().all(|(name, _)| *name != "rows"), "all rows are there");
        let counts: Vec<_> = (0..2).map(|c| pack.about["classes"][c]["count"].as_u64()).collect();
        assert_eq!(counts, [Some(30), Some(30)]);

        let less = PageSettings { max_splats: Some(3), ..PageSettings::default() };
        let pack = Pack::of(&input, &less).unwrap();
        assert_eq!((pack.report.gaussians, pack.report.left_out), (3, 58));
        let rows = &pack.parts.iter().find(|(own, _)| *own == "rows").unwrap().1;
        assert_eq!(rows[..3], [0, 1, 2], "of equal ones the first");
    }

    #[test]
    fn a_code_times_a_text_is_their_cosine() {
        let (scene, labels, names) = scene();
        let dim = 12;
        let value = |i: usize, k: usize| ((i * 7 + k * 13) % 23) as f32 / 11.0 - 1.0;
        let rows: Vec<f32> = (0..61).flat_map(|i| (0..dim).map(move |k| value(i, k))).collect();
        let features = SceneFeatures::from_rows(rows.clone(), dim).unwrap();
        let values = (0..2).flat_map(|t| (0..dim).map(move |k| value(3 * t + 1, k * k))).collect();
        let texts = TextTable::from_rows(names.clone(), values, dim).unwrap();
        let input =
            PageInput { features: Some((&features, &texts)), ..input(&scene, &labels, &names) };
        let pack = Pack::of(&input, &PageSettings { codes: 12, max_splats: None }).unwrap();
        let part = |name: &str| &pack.parts.iter().find(|(own, _)| *own == name).unwrap().1;
        let (codes, slots) = (part("codes"), part("slot"));
        let weights: Vec<f32> = (part("texts").chunks_exact(4))
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        assert_eq!(weights.len(), 2 * (1 + dim));
        let cosine = |a: &[f32], b: &[f32]| {
            let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
            dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
        };
        for row in 0..61 {
            let slot = slots[row] as usize;
            for (text, own) in weights.chunks_exact(1 + dim).enumerate() {
                let code = &codes[slot * dim..(slot + 1) * dim];
                let got = own[0]
                    + own[1..].iter().zip(code).map(|(w, c)| w * f32::from(*c as i8)).sum::<f32>();
                let want = cosine(
                    &rows[row * dim..(row + 1) * dim],
                    &texts.values[text * dim..(text + 1) * dim],
                );
                assert!((got - want).abs() < 0.03, "{row} {text}: {got} {want}");
            }
        }
    }
}
