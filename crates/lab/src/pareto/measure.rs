//! A setting on a set of scenes: how long, how much memory, how good.

use super::ParetoError;
use super::bootstrap::{f_miou_with_bounds, quantile_of};
use super::grid::Written;
use super::quality::{Hits, add_scene};
use super::record::{Kind, Record, SceneRecord, Stage};
use scenesplat::evaluation::{Evaluation, EvaluationSettings};
use scenesplat::inference::{SceneEncoder, SceneFeatures};
use scenesplat::input::open_input;
use scenesplat::labels::{Classes, Labels, label_with_vote};
use scenesplat::machine::{Machine, peak_memory_bytes};
use scenesplat::network::Network;
use scenesplat::outputs::{FeatureType, OpenedScene, write_features_npy};
use scenesplat_metrics::{
    ConfidenceBins, ConfusionMatrix, Metric, SceneTruth, Scores, TesterReport, VoteRule,
};
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::formats::npy_writer::write_npy;
use scenesplat_scene::{LabelIds, ReadOptions, TextTable};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Least share of the time that the stages have to explain.
pub const LEAST_COVERAGE: f64 = 0.97;

/// A scene to measure on.
#[derive(Debug, Clone)]
pub struct SceneInput {
    /// What records call it.
    pub name: String,
    /// Its file.
    pub path: PathBuf,
    /// What the ids of its labels stand for; if `None`, they are labels as they are.
    pub label_ids: Option<LabelIds>,
    /// Which class each of its labels means, -1 for none; labels are classes without it.
    pub class_of: Option<Vec<i32>>,
}

/// What is measured, and on what.
#[derive(Debug)]
pub struct Job<'a> {
    /// The setting, for messages and the record.
    pub setting: String,
    /// The set of scenes, as it was given.
    pub set: String,
    /// Runs the network as the setting says.
    pub encoder: SceneEncoder<'a>,
    /// The classes.
    pub text: &'a TextTable,
    /// Classes left out of the foreground averages, how labels are chosen, and the vote's k.
    pub evaluation: EvaluationSettings,
    /// The scenes.
    pub scenes: &'a [SceneInput],
    /// How they are read.
    pub read: ReadOptions,
    /// Repeats after the warm-up; at least one.
    pub repeats: usize,
    /// What is written each time.
    pub writes: Vec<Written>,
    /// Where it is written; it is replaced each time.
    pub scratch: PathBuf,
    /// Folder of the reference's labels, to agree with or not.
    pub reference: Option<PathBuf>,
    /// Folder that takes the labels.
    pub keep_labels: Option<PathBuf>,
    /// Whether the evaluator is checked, and oracle and random labels are scored, too. They depend on the
    /// scenes, the classes and the vote alone, and the vote over the truth takes as long as a network.
    pub bounds: bool,
    /// What all records of a folder share.
    pub conditions: String,
    /// SHA-256 of the weights.
    pub weights_hash: String,
    /// SHA-256 of the scenes.
    pub input_hash: String,
    /// Time to load the weights.
    pub load_seconds: f64,
    /// Where this runs.
    pub machine: Machine,
}

/// What a measurement gives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The setting's record.
    pub setting: Record,
    /// Those of the oracle and of random labels, where [`Job::bounds`] asks for them.
    pub bounds: Option<[Record; 2]>,
}

/// What one run over one scene gives.
struct Run {
    opened: OpenedScene,
    features: SceneFeatures,
    labels: Labels,
    seconds: f64,
    stages: Vec<f64>,
    bytes: u64,
}

impl Job<'_> {
    fn network(&self) -> &Network {
        self.encoder.network
    }

    fn classes(&self) -> Classes<'_> {
        match self.network().is_classifier() {
            true => Classes::Probabilities(self.text.len()),
            false => Classes::Texts(self.text),
        }
    }

    fn stage_names(&self) -> Vec<&'static str> {
        let mut names = vec!["read", "network", "labels"];
        for written in &self.writes {
            names.push(match written {
                Written::Labels => "write_labels",
                Written::Features => "write_features",
            });
        }
        names
    }

    /// Reads, runs, labels and writes, as the commands do, with the time of each.
    fn run(&self, scene: &SceneInput) -> Result<Run, ParetoError> {
        let began = Instant::now();
        let mut last = began;
        let mut stages = Vec::new();
        let mut lap = || {
            let now = Instant::now();
            stages.push((now - last).as_secs_f64());
            last = now;
        };
        let (opened, _) = open_input(&scene.path, &self.read)?;
        lap();
        let features = self.encoder.encode(&opened.loaded.scene, &mut |_| Ok(()))?;
        lap();
        let labels = label_with_vote(
            &features,
            self.classes(),
            &self.evaluation.options,
            &opened.loaded.scene.coord,
            self.evaluation.vote_k,
        )?;
        lap();
        let mut bytes = 0;
        for written in &self.writes {
            bytes += match written {
                Written::Labels => self.write_labels(&opened, &labels)?,
                Written::Features => {
                    let path = self.scratch.join("features.npy");
                    write_features_npy(&opened, &features, FeatureType::F16, &path)?
                }
            };
            lap();
        }
        let seconds = began.elapsed().as_secs_f64();
        Ok(Run { opened, features, labels, seconds, stages, bytes })
    }

    fn write_labels(&self, opened: &OpenedScene, labels: &Labels) -> Result<u64, ParetoError> {
        let rows = opened.loaded.source_rows();
        let path = self.scratch.join("labels.npy");
        write_npy(&path, &[rows], &opened.loaded.to_source_rows(&labels.labels, -1)?)?;
        let mut bytes = file_size(&path)?;
        let path = self.scratch.join("scores.npy");
        write_npy(&path, &[rows], &opened.loaded.to_source_rows(&labels.scores, 0.0)?)?;
        bytes += file_size(&path)?;
        Ok(bytes)
    }
}

/// What scoring adds up over scenes.
#[derive(Default)]
struct Quality {
    matrices: Vec<ConfusionMatrix>,
    calibration: ConfidenceBins,
    hits: Hits,
    agreeing: usize,
    compared: usize,
    truth: Sha256,
    oracle_seconds: Vec<f64>,
    random_seconds: Vec<f64>,
}

/// Measures a setting: a warm-up on the first scene, then so many runs over all scenes, then one more
/// run whose labels are scored. All runs have to give the same labels.
///
/// # Errors
/// If a scene cannot be read, labeled or scored, its oracle, where it is asked for, falls short of its
/// analytic value, a repeat gives other labels, or the stages leave more than 3 % of the time unexplained.
pub fn measure(job: &Job<'_>) -> Result<Measured, ParetoError> {
    let names = job.stage_names();
    let scenes = job.scenes;
    let first = scenes.first().ok_or_else(|| ParetoError::Empty { quality: "scene".to_owned() })?;
    drop(job.run(first).map_err(in_scene(first))?);
    let mut per_scene: Vec<SceneRecord> = scenes
        .iter()
        .map(|scene| SceneRecord {
            name: scene.name.clone(),
            stage_seconds: vec![0.0; names.len()],
            ..SceneRecord::default()
        })
        .collect();
    let mut bytes = 0;
    for repeat in 1..=job.repeats.max(1) {
        for (scene, record) in scenes.iter().zip(&mut per_scene) {
            let run = job.run(scene).map_err(in_scene(scene))?;
            let hash = labels_hash(&run.labels.labels);
            if repeat == 1 {
                record.prediction_hash = hash;
            } else if record.prediction_hash != hash {
                return Err(ParetoError::NotRepeatable { scene: scene.name.clone(), repeat });
            }
            record.seconds.push(run.seconds);
            for (sum, seconds) in record.stage_seconds.iter_mut().zip(&run.stages) {
                *sum += seconds / job.repeats.max(1) as f64;
            }
            let summary = run.features.summary;
            record.gaussians = run.features.len();
            (record.voxels, record.passes, record.tiles) =
                (summary.voxels, summary.passes, summary.tiles);
            bytes += run.bytes;
        }
    }
    // Before anything is scored: what a user's run would take.
    let peak_bytes = peak_memory_bytes().unwrap_or(0);
    let mut evaluation = Evaluation::new(job.text, job.evaluation.clone())?;
    let mut quality = Quality::default();
    for (index, (scene, record)) in scenes.iter().zip(&mut per_scene).enumerate() {
        score(job, &mut evaluation, &mut quality, index, record).map_err(in_scene(scene))?;
    }
    let bytes_written = mean_bytes(bytes, job.repeats, scenes.len());
    let setting = finish(job, &names, per_scene, &quality, peak_bytes, bytes_written)?;
    let bounds = job.bounds.then(|| quality.rows(&evaluation, &setting));
    Ok(Measured { setting, bounds })
}

impl Quality {
    /// Checks the evaluator on a scene, and adds what the truth and random labels score there.
    fn add_bounds(
        &mut self,
        evaluation: &mut Evaluation<'_>,
        truth: &SceneTruth<'_>,
    ) -> Result<(), ParetoError> {
        let began = Instant::now();
        let checked = evaluation.check(truth, None)?;
        self.oracle_seconds.push(began.elapsed().as_secs_f64());
        evaluation.add_oracle(truth, &checked)?;
        let began = Instant::now();
        evaluation.add_random(truth)?;
        self.random_seconds.push(began.elapsed().as_secs_f64());
        Ok(())
    }

    /// The two rows that are no settings.
    fn rows(&self, evaluation: &Evaluation<'_>, setting: &Record) -> [Record; 2] {
        let scored = evaluation.report();
        let row = |kind, name: &str, report: &TesterReport, seconds: &[f64]| {
            let mut record = Record {
                kind,
                setting: name.to_owned(),
                changes_result: None,
                repeats: 1,
                seconds_p50: quantile_of(seconds, 0.5),
                seconds_p95: quantile_of(seconds, 0.95),
                seconds_low: quantile_of(seconds, 0.5),
                seconds_high: quantile_of(seconds, 0.5),
                load_seconds: 0.0,
                bytes_written: 0,
                agreement: None,
                query_hit1: None,
                ece: None,
                stages: Vec::new(),
                stage_coverage: 1.0,
                prediction_hash: String::new(),
                per_scene: Vec::new(),
                ..setting.clone()
            };
            figures(&mut record, report);
            (record.f_miou_low, record.f_miou_high) = (record.f_miou, record.f_miou);
            record
        };
        [
            row(Kind::Oracle, "oracle", &scored.oracle, &self.oracle_seconds),
            row(Kind::Random, "random labels", &scored.random, &self.random_seconds),
        ]
    }
}

/// Runs a scene once more and scores its labels.
fn score(
    job: &Job<'_>,
    evaluation: &mut Evaluation<'_>,
    quality: &mut Quality,
    index: usize,
    record: &mut SceneRecord,
) -> Result<(), ParetoError> {
    let input = &job.scenes[index];
    let Run { mut opened, features, labels, .. } = job.run(input)?;
    if labels_hash(&labels.labels) != record.prediction_hash {
        let (scene, repeat) = (input.name.clone(), job.repeats + 1);
        return Err(ParetoError::NotRepeatable { scene, repeat });
    }
    if let Some(ids) = input.label_ids {
        let found = ids.number(&mut opened.loaded.scene)?;
        record.unnamed = found.unnamed_text();
        found.decided()?;
    }
    let scene = &opened.loaded.scene;
    let truth = evaluation.truth(scene, input.class_of.as_deref())?;
    if job.bounds {
        quality.add_bounds(evaluation, &truth)?;
    }
    let mut scores = Scores::new(job.text.len(), &job.evaluation.excluded)?;
    scores.add_labels(&truth, labels.labels.clone(), &scoring_rule(job.evaluation.vote_k))?;
    let report = scores.model.tester_report();
    record.f_miou = report.foreground_mean_iou;
    let text = (!job.network().is_classifier()).then_some(job.text);
    let hits =
        add_scene(&mut quality.calibration, &features, text, &labels.labels, truth.labels())?;
    quality.hits.hits += hits.hits;
    quality.hits.asked += hits.asked;
    for label in truth.scored() {
        quality.truth.update(label.to_le_bytes());
    }
    quality.matrices.push(scores.model);
    if let Some(folder) = &job.reference {
        let theirs = NpyFile::open(&labels_path(folder, index))?.read_i64()?;
        let same = theirs.iter().zip(&labels.labels).filter(|(a, b)| **a == i64::from(**b)).count();
        record.agreement = Some(same as f64 / labels.labels.len().max(1) as f64);
        quality.agreeing += same;
        quality.compared += labels.labels.len();
    }
    if let Some(folder) = &job.keep_labels {
        std::fs::create_dir_all(folder)
            .map_err(ParetoError::io(folder, "cannot make the folder"))?;
        write_npy(&labels_path(folder, index), &[labels.labels.len()], &labels.labels)?;
    }
    Ok(())
}

/// Bytes of a scene, of those of all repeats over all scenes.
fn mean_bytes(bytes: u64, repeats: usize, scenes: usize) -> u64 {
    bytes / (repeats.max(1) * scenes) as u64
}

/// How labels are brought to what is scored. Gaussians were voted on already; points get theirs from the
/// Gaussians around them.
fn scoring_rule(vote_k: usize) -> VoteRule {
    VoteRule { points_k: vote_k.max(1), ..VoteRule::of(1) }
}

/// Where the labels of a scene of a set are kept.
pub fn labels_path(folder: &Path, index: usize) -> PathBuf {
    folder.join(format!("{index:05}.npy"))
}

fn finish(
    job: &Job<'_>,
    names: &[&str],
    per_scene: Vec<SceneRecord>,
    quality: &Quality,
    peak_bytes: u64,
    bytes_written: u64,
) -> Result<Record, ParetoError> {
    let samples: Vec<f64> = per_scene.iter().flat_map(|s| s.seconds.iter().copied()).collect();
    let of_repeat = |r: usize| {
        let all: Vec<f64> = per_scene.iter().filter_map(|s| s.seconds.get(r).copied()).collect();
        quantile_of(&all, 0.5)
    };
    let medians: Vec<f64> = (0..job.repeats.max(1)).map(of_repeat).collect();
    let (stages, coverage) = stages(job, names, &per_scene, &samples)?;
    let bounds = f_miou_with_bounds(&quality.matrices)?;
    let hashes: String = per_scene.iter().map(|scene| scene.prediction_hash.as_str()).collect();
    let share = |part: usize, of: usize| (of > 0).then(|| part as f64 / of as f64);
    let mut record = Record {
        kind: Kind::Setting,
        setting: job.setting.clone(),
        changes_result: Some(true),
        neutral: None,
        rule: None,
        holds: None,
        scenes: job.set.clone(),
        repeats: job.repeats.max(1),
        seconds_p50: quantile_of(&samples, 0.5),
        seconds_p95: quantile_of(&samples, 0.95),
        seconds_low: quantile_of(&medians, 0.0),
        seconds_high: quantile_of(&medians, 1.0),
        load_seconds: job.load_seconds,
        peak_bytes,
        bytes_written,
        f_miou: None,
        f_miou_low: bounds.map(|b| b[1]),
        f_miou_high: bounds.map(|b| b[2]),
        miou: None,
        f_macc: None,
        macc: None,
        all_acc: None,
        agreement: share(quality.agreeing, quality.compared),
        query_hit1: share(quality.hits.hits, quality.hits.asked),
        ece: quality.calibration.error(),
        stages,
        stage_coverage: coverage,
        width: job.network().model().out_channels(),
        classes: job.text.len(),
        prediction_hash: hex(Sha256::new_with_prefix(hashes)),
        conditions: job.conditions.clone(),
        weights_hash: job.weights_hash.clone(),
        input_hash: job.input_hash.clone(),
        truth_hash: hex(quality.truth.clone()),
        fingerprint: job.machine.fingerprint(),
        machine: job.machine.clone(),
        per_scene,
    };
    figures(&mut record, &pooled(job, quality)?);
    Ok(record)
}

/// How long each part of a scene takes, and the share of the time that they explain.
fn stages(
    job: &Job<'_>,
    names: &[&str],
    per_scene: &[SceneRecord],
    samples: &[f64],
) -> Result<(Vec<Stage>, f64), ParetoError> {
    let scenes = per_scene.len() as f64;
    let wall = samples.iter().sum::<f64>() / samples.len().max(1) as f64;
    let stage = |(i, name): (usize, &&str)| {
        let seconds = per_scene.iter().map(|s| s.stage_seconds[i]).sum::<f64>() / scenes;
        Stage { name: (*name).to_owned(), seconds, share: seconds / wall }
    };
    let stages: Vec<Stage> = names.iter().enumerate().map(stage).collect();
    let coverage = stages.iter().map(|s| s.share).sum::<f64>();
    if coverage < LEAST_COVERAGE {
        let (setting, least) = (job.setting.clone(), LEAST_COVERAGE);
        return Err(ParetoError::Stages { setting, coverage, least });
    }
    Ok((stages, coverage))
}

/// What the labels of all scenes together are worth.
fn pooled(job: &Job<'_>, quality: &Quality) -> Result<TesterReport, ParetoError> {
    let mut pooled =
        ConfusionMatrix::new(job.text.len())?.with_excluded(&job.evaluation.excluded)?;
    for matrix in &quality.matrices {
        pooled.merge(matrix)?;
    }
    Ok(pooled.tester_report())
}

fn figures(record: &mut Record, report: &TesterReport) {
    record.f_miou = report.foreground_mean_iou;
    record.miou = report.mean_iou;
    record.f_macc = report.foreground_mean_accuracy;
    record.macc = report.mean_accuracy;
    record.all_acc = report.all_accuracy;
}

fn labels_hash(labels: &[i32]) -> String {
    let mut hasher = Sha256::new();
    let mut piece = Vec::with_capacity(4 * 4096);
    for labels in labels.chunks(4096) {
        piece.clear();
        labels.iter().for_each(|label| piece.extend(label.to_le_bytes()));
        hasher.update(&piece);
    }
    hex(hasher)
}

fn hex(hasher: Sha256) -> String {
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

fn file_size(path: &Path) -> Result<u64, ParetoError> {
    Ok(std::fs::metadata(path).map_err(ParetoError::io(path, "cannot measure"))?.len())
}

fn in_scene(scene: &SceneInput) -> impl FnOnce(ParetoError) -> ParetoError {
    let scene = scene.name.clone();
    move |source| ParetoError::Scene { scene, source: Box::new(source) }
}

#[cfg(test)]
mod by_hand;
#[cfg(test)]
mod tests {
    use super::super::record::tests::record;
    use super::*;
    use scenesplat::evaluation::own_directions;

    #[test]
    fn bytes_written_are_the_mean_of_a_scene() {
        // 3 repeats over 4 scenes are 12 results of 500 bytes.
        assert_eq!(mean_bytes(12 * 500, 3, 4), 500);
        // Without repeats each scene is still run once.
        assert_eq!(mean_bytes(2 * 700, 0, 2), 700);
    }

    #[test]
    fn only_points_are_voted_on_when_labels_are_scored() {
        let coord = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
        let said = || vec![1, 0, 0];
        // A vote of all three Gaussians would make the first a 0: its label was voted on and stays.
        let truth = SceneTruth::new(&coord, Some(&[1, 0, 0]), None, 2).unwrap().unwrap();
        assert_eq!(truth.carry(said(), &scoring_rule(3)).unwrap(), [1, 0, 0]);
        // A point beside the first Gaussian is a 0 by two of three votes, and a 1 by the nearest alone.
        let points = [[0.1, 0.0, 0.0]];
        let truth = SceneTruth::new(&coord, None, Some((&points, &[0])), 2).unwrap().unwrap();
        assert_eq!(truth.carry(said(), &scoring_rule(3)).unwrap(), [0]);
        assert_eq!(truth.carry(said(), &scoring_rule(0)).unwrap(), [1]);
    }

    #[test]
    fn the_rows_that_are_no_settings_have_bounds_of_their_own() {
        let text = own_directions(["wall", "chair"].map(str::to_owned).to_vec()).unwrap();
        let settings = EvaluationSettings { vote_k: 1, ..EvaluationSettings::default() };
        let mut evaluation = Evaluation::new(&text, settings).unwrap();
        let coord = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]];
        let truth = SceneTruth::new(&coord, Some(&[0, 1, 1, 0]), None, 2).unwrap().unwrap();
        let mut quality = Quality::default();
        quality.add_bounds(&mut evaluation, &truth).unwrap();
        // The setting's own value is 0.5, between 0.48 and 0.52.
        let [oracle, random] = quality.rows(&evaluation, &record("k=8", 1.0, 0.5));
        assert_eq!((oracle.kind, random.kind), (Kind::Oracle, Kind::Random));
        // The truth answers everything right. No spread is known of either row.
        for bound in [oracle.f_miou, oracle.f_miou_low, oracle.f_miou_high] {
            assert!((bound.unwrap() - 1.0).abs() < 1e-6, "{bound:?}");
        }
        assert!(random.f_miou.is_some());
        assert_eq!((random.f_miou_low, random.f_miou_high), (random.f_miou, random.f_miou));
    }
}
