//! Two evaluations: by class and by scene.

use crate::commands::evaluate::{EVALUATION, Written};
use anyhow::{Context, Result, bail};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat::metrics::TesterReport;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Draws of scenes for the bounds of a change.
const DRAWS: usize = 1000;
const SEED: u64 = 0xC0_4A_4E;

/// The evaluations of one side.
struct Side {
    classes: Vec<String>,
    excluded: Value,
    vote_k: Value,
    meaningless: bool,
    whole: TesterReport,
    scenes: BTreeMap<String, TesterReport>,
}

/// Both numbers of something.
pub(super) struct Row {
    pub(super) name: String,
    /// Labeled Gaussians of it, in the first evaluation.
    pub(super) labelled: u64,
    pub(super) iou: [Option<f64>; 2],
    pub(super) accuracy: [Option<f64>; 2],
}

/// What two evaluations say.
pub(super) struct Comparison {
    /// Classes that occur in either.
    pub(super) classes: Vec<Row>,
    /// Scenes that both have: their f-mIoU and f-mAcc.
    pub(super) scenes: Vec<Row>,
    /// Means over classes: mIoU and mAcc, those without the excluded classes, and the share of right labels.
    pub(super) means: [Row; 2],
    pub(super) all_accuracy: [Option<f64>; 2],
    /// Change of f-mIoU, and the bounds of 95 % of its values where scenes are drawn with replacement.
    pub(super) bounds: Option<[f64; 3]>,
    pub(super) remarks: Vec<String>,
}

/// The evaluations that two paths lead to; `None` if neither leads to one.
pub(super) fn find(a: &Path, b: &Path) -> Result<Option<Comparison>> {
    match (files(a)?, files(b)?) {
        (None, None) => Ok(None),
        (Some(in_a), Some(in_b)) => compare(&side(in_a)?, &side(in_b)?, [a, b]).map(Some),
        (Some(_), None) => bail!("{}: holds no {EVALUATION}, as {} does", b.display(), a.display()),
        (None, Some(_)) => bail!("{}: holds no {EVALUATION}, as {} does", a.display(), b.display()),
    }
}

/// Files of one side: of all scenes together, and of each by its folder's name.
struct Files {
    whole: Option<PathBuf>,
    scenes: BTreeMap<String, PathBuf>,
}

fn files(path: &Path) -> Result<Option<Files>> {
    if path.is_file() {
        let is_json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
        let whole = is_json.then(|| path.to_owned());
        return Ok(whole.map(|whole| Files { whole: Some(whole), scenes: BTreeMap::new() }));
    }
    if !path.is_dir() {
        return Ok(None);
    }
    let whole = Some(path.join(EVALUATION)).filter(|file| file.is_file());
    let mut scenes = BTreeMap::new();
    for entry in std::fs::read_dir(path).with_context(|| path.display().to_string())? {
        let entry = entry.with_context(|| path.display().to_string())?;
        let file = entry.path().join(EVALUATION);
        if file.is_file() {
            scenes.insert(entry.file_name().to_string_lossy().into_owned(), file);
        }
    }
    Ok((whole.is_some() || !scenes.is_empty()).then_some(Files { whole, scenes }))
}

fn read(path: &Path) -> Result<(Written, TesterReport)> {
    let file = Written::read(path)?;
    let scored = file.counts.model.clone().with_context(|| {
        format!("{}: no labels were scored, only those that scenes carry", path.display())
    })?;
    if scored.classes.len() != file.classes.len() {
        bail!(
            "{}: {} classes have names, {} have counts",
            path.display(),
            file.classes.len(),
            scored.classes.len()
        );
    }
    Ok((file, scored))
}

fn side(files: Files) -> Result<Side> {
    let mut first: Option<(PathBuf, Written)> = None;
    let mut scenes = BTreeMap::new();
    let mut whole = None;
    let mut meaningless = false;
    let all = files.whole.map(|path| (None, path));
    let parts = files.scenes.into_iter().map(|(name, path)| (Some(name), path));
    for (name, path) in all.into_iter().chain(parts) {
        let (file, scored) = read(&path)?;
        meaningless |= file.meaningless;
        match &first {
            Some((other, known)) => {
                if known.classes != file.classes || known.excluded != file.excluded {
                    bail!("{}: other classes than {}", path.display(), other.display());
                }
            }
            None => first = Some((path, file)),
        }
        match name {
            Some(name) => drop(scenes.insert(name, scored)),
            None => whole = Some(scored),
        }
    }
    let (_, Written { classes, excluded, vote_k, .. }) = first.context("no evaluation")?;
    let whole = whole.or_else(|| TesterReport::sum(scenes.values()));
    let whole = whole.context("the evaluations of the scenes cannot be added up")?;
    Ok(Side { classes, excluded, vote_k, meaningless, whole, scenes })
}

fn compare(a: &Side, b: &Side, paths: [&Path; 2]) -> Result<Comparison> {
    let [first, second] = paths.map(|path| path.display());
    if a.classes != b.classes {
        let differs = |names: &[String], others: &[String]| -> Vec<String> {
            names.iter().filter(|name| !others.contains(name)).take(3).cloned().collect()
        };
        let (only_a, only_b) = (differs(&a.classes, &b.classes), differs(&b.classes, &a.classes));
        bail!(
            "{first} has {} classes, {second} {}; only there: {only_a:?}, {only_b:?}",
            a.classes.len(),
            b.classes.len()
        );
    }
    if a.excluded != b.excluded {
        bail!(
            "f-mIoU leaves out {} in {first} and {} in {second}: evaluate both alike",
            a.excluded,
            b.excluded
        );
    }
    let mut remarks = Vec::new();
    if a.vote_k != b.vote_k {
        let text =
            format!("votes of {} neighbors in {first}, of {} in {second}", a.vote_k, b.vote_k);
        remarks.push(text);
    }
    for (side, path) in [(a, &first), (b, &second)] {
        if side.meaningless {
            remarks.push(format!("{path}: the labels come from seeded weights and mean nothing"));
        }
    }
    for (one, other, path) in [(a, b, &second), (b, a, &first)] {
        let lost: Vec<&str> = one
            .scenes
            .keys()
            .filter(|n| !other.scenes.contains_key(*n))
            .map(String::as_str)
            .collect();
        if !lost.is_empty() && !other.scenes.is_empty() {
            remarks.push(format!(
                "not in {path}, and so not in the rows of scenes: {}",
                lost.join(", ")
            ));
        }
    }
    let counts = |side: &Side| side.whole.classes.iter().map(|c| c.target).collect::<Vec<_>>();
    if counts(a) != counts(b) {
        remarks
            .push("the two evaluations are of other scenes: classes have other counts".to_owned());
    }
    let classes = a.classes.iter().zip(a.whole.classes.iter().zip(&b.whole.classes));
    let classes = classes.filter(|(_, (in_a, in_b))| in_a.union > 0 || in_b.union > 0);
    let classes = classes.map(|(name, (in_a, in_b))| Row {
        name: name.clone(),
        labelled: in_a.target,
        iou: [in_a.iou, in_b.iou],
        accuracy: [in_a.accuracy, in_b.accuracy],
    });
    let scenes: Vec<(&String, [&TesterReport; 2])> = a
        .scenes
        .iter()
        .filter_map(|(name, in_a)| Some((name, [in_a, b.scenes.get(name)?])))
        .collect();
    let both = [&a.whole, &b.whole];
    let mean = |name: &str, of: [fn(&TesterReport) -> Option<f64>; 2]| Row {
        name: name.to_owned(),
        labelled: labelled(&a.whole),
        iou: both.map(of[0]),
        accuracy: both.map(of[1]),
    };
    Ok(Comparison {
        classes: classes.collect(),
        means: [
            mean("all classes", [|r| r.mean_iou, |r| r.mean_accuracy]),
            mean("foreground", [|r| r.foreground_mean_iou, |r| r.foreground_mean_accuracy]),
        ],
        all_accuracy: both.map(|r| r.all_accuracy),
        bounds: bounds(&scenes),
        scenes: scenes
            .into_iter()
            .map(|(name, both)| Row {
                name: name.clone(),
                labelled: labelled(both[0]),
                iou: both.map(|r| r.foreground_mean_iou),
                accuracy: both.map(|r| r.foreground_mean_accuracy),
            })
            .collect(),
        remarks,
    })
}

fn labelled(report: &TesterReport) -> u64 {
    report.classes.iter().map(|class| class.target).sum()
}

/// Change of the f-mIoU over all these scenes, and how far it moves with other scenes of their kind.
fn bounds(scenes: &[(&String, [&TesterReport; 2])]) -> Option<[f64; 3]> {
    let change = |picks: &[usize]| -> Option<f64> {
        let of = |side: usize| {
            let sum = TesterReport::sum(picks.iter().map(|&pick| scenes[pick].1[side]))?;
            sum.foreground_mean_iou
        };
        Some(of(1)? - of(0)?)
    };
    let all: Vec<usize> = (0..scenes.len()).collect();
    let value = change(&all)?;
    if scenes.len() < 2 {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let draws = (0..DRAWS).filter_map(|_| {
        let picks: Vec<usize> = all.iter().map(|_| rng.random_range(0..all.len())).collect();
        change(&picks)
    });
    let mut values: Vec<f64> = draws.collect();
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((share * (values.len().max(1) - 1) as f64).round() as usize);
    Some([value, *at(0.025)?, *at(0.975)?])
}

impl Row {
    /// Change of the IoU, where both have one.
    pub(super) fn change(&self) -> Option<f64> {
        change(self.iou)
    }

    fn json(&self) -> Value {
        json!({
            "name": self.name, "labelled": self.labelled, "iou": self.iou, "accuracy": self.accuracy,
            "iou_change": self.change(), "accuracy_change": change(self.accuracy),
        })
    }
}

fn change([a, b]: [Option<f64>; 2]) -> Option<f64> {
    Some(b? - a?)
}

impl Comparison {
    /// All numbers, 0 to 1, the first evaluation's before the second's.
    pub(super) fn json(&self) -> Value {
        let [all, foreground] = &self.means;
        json!({
            "classes": self.classes.iter().map(Row::json).collect::<Vec<_>>(),
            "scenes": self.scenes.iter().map(Row::json).collect::<Vec<_>>(),
            "miou": all.iou, "macc": all.accuracy, "all_acc": self.all_accuracy,
            "f_miou": foreground.iou, "f_macc": foreground.accuracy,
            "f_miou_change_of_scenes": self.bounds,
            "remarks": self.remarks,
        })
    }

    /// A table in percent: classes, scenes, means.
    pub(super) fn table(&self) -> String {
        let names = self.classes.iter().chain(&self.scenes).map(|row| row.name.chars().count());
        let widest = names.max().unwrap_or(0).max(12);
        let title = |name: &str| {
            format!(
                "{name:widest$}  {:>10}  {:>7} {:>7} {:>8}  {:>7} {:>7} {:>8}",
                "Gaussians", "IoU a", "b", "change", "acc. a", "b", "change"
            )
        };
        let line = |row: &Row| {
            let [iou, accuracy] = [row.iou, row.accuracy].map(|pair| {
                let [a, b] = pair.map(percent);
                format!("{a:>7} {b:>7} {:>8}", signed(change(pair)))
            });
            let pad = widest.saturating_sub(row.name.chars().count());
            format!("{}{:pad$}  {:>10}  {iou}  {accuracy}", row.name, "", row.labelled)
        };
        let mut lines = vec![title("class")];
        lines.extend(self.classes.iter().map(line));
        if !self.scenes.is_empty() {
            lines.extend([String::new(), title("scene (without excluded classes)")]);
            lines.extend(self.scenes.iter().map(line));
        }
        lines.extend([String::new(), title("mean")]);
        lines.extend(self.means.iter().map(line));
        let [a, b] = self.all_accuracy.map(percent);
        lines.push(format!("right labels: {a} %, {b} % ({})", signed(change(self.all_accuracy))));
        let better = self.classes.iter().filter(|r| r.change().is_some_and(|c| c > 0.0)).count();
        let worse = self.classes.iter().filter(|r| r.change().is_some_and(|c| c < 0.0)).count();
        lines.push(format!("IoU: {better} classes are better in b, {worse} are worse"));
        if let Some([value, low, high]) = self.bounds {
            let sure = if low > 0.0 || high < 0.0 { "" } else { ": other scenes could turn it" };
            lines.push(format!(
                "f-mIoU over {} scenes: {} points, 95 % of draws of scenes between {} and {}{sure}",
                self.scenes.len(),
                signed(Some(value)),
                signed(Some(low)),
                signed(Some(high)),
            ));
        }
        lines.join("\n")
    }
}

fn percent(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{:.2}", 100.0 * v))
}

fn signed(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{:+.2}", 100.0 * v))
}
