//! Joining several scenes into one.

use super::EditError;
use crate::extra_columns::{ExtraColumn, join_columns};
use crate::language_code::LanguageCode;
use crate::place::{NO_ORIGIN, origin_of, origin_text, sample_step};
use crate::{GaussianScene, LabelledPoints, LanguageFeatures};
use serde::Serialize;

/// What joining scenes did beyond putting their rows one after the other.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct MergeReport {
    /// Rows of each scene, in order.
    pub rows: Vec<usize>,
    /// What was lost or filled in, in words, each with the scenes concerned (numbered from 1).
    pub notes: Vec<String>,
}

/// Puts the rows of several scenes one after the other.
///
/// - Harmonics: the highest degree of all; missing bands become 0, which changes no color.
/// - Labels, scores, instances: where a scene has none, its rows have no label (−1), a score of 0.
///   Instances are counted on, so that no two scenes share one; classes are not: they are numbers
///   of the same list.
/// - Language codes are kept if all scenes that have any share one codebook, else dropped. Features
///   are kept if all that have any are as wide. Rows without get zeros: no feature.
/// - Normals are kept only if all scenes have them.
/// - Columns of unknown meaning are kept; where a scene has none of that name, its rows get 0.
/// - The result is marked as antialiased only if all scenes are.
/// - Scenes with different origins are brought to one, that of the first if it is near all of their
///   positions; to none where these are not far from 0 together. Scenes without origins stay as they
///   are.
///
/// # Errors
/// If there is no scene, or the arrays of one do not fit together.
pub fn merge(scenes: Vec<GaussianScene>) -> Result<(GaussianScene, MergeReport), EditError> {
    for scene in &scenes {
        scene.check_rows()?;
    }
    let mut report = MergeReport::default();
    report.rows.extend(scenes.iter().map(GaussianScene::len));
    let mut scenes = scenes;
    if scenes.len() == 1 {
        return Ok((scenes.swap_remove(0), report));
    }
    join_origins(&mut scenes, &mut report);
    let Some(degree) = scenes.iter().map(|s| s.sh_degree).max() else {
        return Err(EditError::NoScene);
    };
    let origin = scenes[0].origin;
    let mut out = GaussianScene { sh_degree: degree, origin, ..GaussianScene::default() };
    let labels = "rows without class labels got no label";
    out.segment = rows_of(&scenes, labels, &mut report, |s| s.segment.as_deref(), -1);
    let scores = "rows without scores got a score of 0";
    out.segment_score = rows_of(&scenes, scores, &mut report, |s| s.segment_score.as_deref(), 0.0);
    let starts = instance_starts(&scenes);
    out.instance = instances(&scenes, starts.as_deref(), &mut report);
    out.lang_code = codes(&scenes, &mut report);
    out.lang_feat = features(&scenes, &mut report);
    out.valid_feat_mask = masks(&scenes, out.lang_feat.is_some());
    out.normal = normals(&scenes, &mut report);
    out.extra = extra(&scenes, &mut report);
    out.antialiased = antialiased(&scenes, &mut report);
    out.labelled_points = labelled_points(&scenes, starts.as_deref());
    let lower = numbers(&scenes, |s| s.sh_degree < degree);
    if !lower.is_empty() {
        let bands = "missing bands of spherical harmonics became 0";
        report.notes.push(format!("{bands} ({})", scenes_text(&lower)));
    }
    let width = out.sh_rest_len() * 3;
    for scene in scenes {
        let rest = scene.sh_rest_len() * 3;
        for row in 0..scene.len() {
            out.sh_rest.extend_from_slice(&scene.sh_rest[row * rest..(row + 1) * rest]);
            out.sh_rest.resize(out.sh_rest.len() + width - rest, 0.0);
        }
        out.coord.extend(scene.coord);
        out.log_scale.extend(scene.log_scale);
        out.quat.extend(scene.quat);
        out.opacity_logit.extend(scene.opacity_logit);
        out.sh_dc.extend(scene.sh_dc);
    }
    out.check_rows()?;
    Ok((out, report))
}

/// Gives all scenes one origin.
fn join_origins(scenes: &mut [GaussianScene], report: &mut MergeReport) {
    let Some(first) = scenes.first().map(|s| s.origin) else { return };
    if scenes.iter().all(|s| s.origin == first) {
        return;
    }
    let step = sample_step(scenes.iter().map(GaussianScene::len).sum());
    let rows = |s: &GaussianScene| (0..s.len()).step_by(step);
    let sample: Vec<[f64; 3]> =
        scenes.iter().flat_map(|s| rows(s).map(|row| s.position(row))).collect();
    let mut origin = origin_of(sample.iter().copied());
    let about_first = |p: &[f64; 3]| [0, 1, 2].map(|i| p[i] - first[i]);
    if origin != NO_ORIGIN && origin_of(sample.iter().map(about_first)) == NO_ORIGIN {
        // As good, and the rows of the first scene stay as they are.
        origin = first;
    }
    scenes.iter_mut().for_each(|s| s.move_origin(origin));
    let about = origin_text(origin);
    report.notes.push(format!("positions were brought to one origin, {about}"));
}

/// Numbers, from 1, of the scenes for which something is so.
fn numbers(scenes: &[GaussianScene], is_so: impl Fn(&GaussianScene) -> bool) -> Vec<usize> {
    (1..).zip(scenes).filter(|(_, s)| is_so(s)).map(|(number, _)| number).collect()
}

fn scenes_text(numbers: &[usize]) -> String {
    let list: Vec<String> = numbers.iter().map(usize::to_string).collect();
    format!("scene {}", list.join(", "))
}

/// One value per row of all scenes, if any scene has them; `fill` for the others, which a note says.
fn rows_of<T: Copy>(
    scenes: &[GaussianScene],
    note: &str,
    report: &mut MergeReport,
    values: impl Fn(&GaussianScene) -> Option<&[T]>,
    fill: T,
) -> Option<Vec<T>> {
    scenes.iter().any(|s| values(s).is_some()).then(|| {
        note_without(scenes, note, report, |s| values(s).is_some());
        filled(scenes.iter().map(|s| (values(s), s.len())), fill)
    })
}

/// The values one after the other; so many times `fill` where there are none.
fn filled<'a, T: Copy + 'a>(
    parts: impl Iterator<Item = (Option<&'a [T]>, usize)>,
    fill: T,
) -> Vec<T> {
    let mut out = Vec::new();
    for (values, count) in parts {
        match values {
            Some(values) => out.extend_from_slice(values),
            None => out.resize(out.len() + count, fill),
        }
    }
    out
}

/// Notes the scenes that lack something.
fn note_without(
    scenes: &[GaussianScene],
    note: &str,
    report: &mut MergeReport,
    has: impl Fn(&GaussianScene) -> bool,
) {
    let without = numbers(scenes, |s| !has(s));
    if !without.is_empty() {
        report.notes.push(format!("{note} ({})", scenes_text(&without)));
    }
}

/// What is added to the instances of each scene, so that no two scenes share one; `None` if their
/// numbers would not fit.
fn instance_starts(scenes: &[GaussianScene]) -> Option<Vec<i32>> {
    let mut next = 0i32;
    let mut starts = Vec::with_capacity(scenes.len());
    for scene in scenes {
        let points = scene.labelled_points.as_ref().and_then(|p| p.instance.as_ref());
        let ids = scene.instance.iter().flatten().chain(points.into_iter().flatten());
        starts.push(next);
        if let Some(most) = ids.copied().max().filter(|most| *most >= 0) {
            next = next.checked_add(most)?.checked_add(1)?;
        }
    }
    Some(starts)
}

fn moved_on(ids: &[i32], start: i32) -> Vec<i32> {
    ids.iter().map(|&id| if id < 0 { id } else { id + start }).collect()
}

/// Instances, counted on from scene to scene.
fn instances(
    scenes: &[GaussianScene],
    starts: Option<&[i32]>,
    report: &mut MergeReport,
) -> Option<Vec<i32>> {
    if scenes.iter().all(|s| s.instance.is_none()) {
        return None;
    }
    let Some(starts) = starts else {
        report.notes.push("instances were dropped: their numbers do not fit 32 bits".to_owned());
        return None;
    };
    report.notes.push("instances were numbered on from scene to scene".to_owned());
    let none = "rows without instances got no instance";
    note_without(scenes, none, report, |s| s.instance.is_some());
    let rows = |(scene, start): (&GaussianScene, &i32)| match &scene.instance {
        Some(ids) => moved_on(ids, *start),
        None => vec![-1; scene.len()],
    };
    Some(scenes.iter().zip(starts).flat_map(rows).collect())
}

fn codes(scenes: &[GaussianScene], report: &mut MergeReport) -> Option<LanguageCode> {
    let mut books = scenes.iter().filter_map(|s| s.lang_code.as_ref()).map(|c| &c.codebook);
    let first = books.next()?;
    if books.any(|book| book != first) {
        let text = "language codes were dropped: the scenes have different codebooks; make codes of \
                    the features of all";
        report.notes.push(text.to_owned());
        return None;
    }
    note_without(scenes, "rows without language code", report, |s| s.lang_code.is_some());
    let width = first.code_width();
    let parts =
        scenes.iter().map(|s| (s.lang_code.as_ref().map(|c| c.values.as_slice()), s.len() * width));
    Some(LanguageCode { values: filled(parts, half::f16::ZERO), codebook: first.clone() })
}

fn features(scenes: &[GaussianScene], report: &mut MergeReport) -> Option<LanguageFeatures> {
    let mut widths = scenes.iter().filter_map(|s| s.lang_feat.as_ref()).map(|f| f.dim);
    let dim = widths.next()?;
    if let Some(other) = widths.find(|other| *other != dim) {
        let text = format!("language features were dropped: of {dim} and of {other} numbers");
        report.notes.push(text);
        return None;
    }
    note_without(scenes, "rows without language features", report, |s| s.lang_feat.is_some());
    let parts =
        scenes.iter().map(|s| (s.lang_feat.as_ref().map(|f| f.values.as_slice()), s.len() * dim));
    Some(LanguageFeatures { values: filled(parts, half::f16::ZERO), dim })
}

/// Which rows have features: needed where some have none.
fn masks(scenes: &[GaussianScene], has_features: bool) -> Option<Vec<bool>> {
    let needed = scenes.iter().any(|s| s.valid_feat_mask.is_some() || s.lang_feat.is_none());
    (has_features && needed).then(|| {
        let rows = |s: &GaussianScene| {
            s.valid_feat_mask.clone().unwrap_or_else(|| vec![s.lang_feat.is_some(); s.len()])
        };
        scenes.iter().flat_map(rows).collect()
    })
}

fn normals(scenes: &[GaussianScene], report: &mut MergeReport) -> Option<Vec<[f32; 3]>> {
    if scenes.iter().all(|s| s.normal.is_none()) {
        return None;
    }
    let dropped = "normals were dropped: some scenes have none";
    let without = numbers(scenes, |s| s.normal.is_none());
    if !without.is_empty() {
        report.notes.push(format!("{dropped} ({})", scenes_text(&without)));
        return None;
    }
    Some(scenes.iter().flat_map(|s| s.normal.iter().flatten().copied()).collect())
}

fn extra(scenes: &[GaussianScene], report: &mut MergeReport) -> Vec<ExtraColumn> {
    let parts: Vec<_> = scenes.iter().map(|s| (s.extra.as_slice(), s.len())).collect();
    let (columns, notes) = join_columns(&parts);
    let notes = notes.into_iter().map(|(text, of)| format!("{text} ({})", scenes_text(&of)));
    report.notes.extend(notes);
    columns
}

/// One picture is drawn one way.
fn antialiased(scenes: &[GaussianScene], report: &mut MergeReport) -> bool {
    let marked = numbers(scenes, |s| s.antialiased);
    if !marked.is_empty() && marked.len() < scenes.len() {
        let text = "trained for antialiased rendering, unlike the others: the mark was dropped";
        report.notes.push(format!("{text} ({})", scenes_text(&marked)));
    }
    marked.len() == scenes.len()
}

/// Points of all scenes; as for Gaussians, those without a label have −1.
fn labelled_points(scenes: &[GaussianScene], starts: Option<&[i32]>) -> Option<LabelledPoints> {
    let starts = starts.map_or_else(|| vec![0; scenes.len()], <[i32]>::to_vec);
    let of = || {
        let pairs = scenes.iter().zip(&starts);
        pairs.filter_map(|(s, start)| Some((s.labelled_points.as_ref()?, *start)))
    };
    of().next()?;
    let segment = of()
        .any(|(p, _)| p.segment.is_some())
        .then(|| filled(of().map(|(p, _)| (p.segment.as_deref(), p.coord.len())), -1));
    let instance = of().any(|(p, _)| p.instance.is_some()).then(|| {
        let rows = |p: &LabelledPoints, start| match &p.instance {
            Some(ids) => moved_on(ids, start),
            None => vec![-1; p.coord.len()],
        };
        of().flat_map(|(p, start)| rows(p, start)).collect()
    });
    Some(LabelledPoints {
        coord: of().flat_map(|(p, _)| p.coord.iter().copied()).collect(),
        segment,
        instance,
    })
}
