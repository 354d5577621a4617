//! What is measured in which order, each in a process of its own.

use super::args::{Args, weights_text};
use super::inputs::Set;
use super::request::Request;
use crate::bench::Stopped;
use crate::bench::process::run_in_a_process;
use crate::commands::classes::Classes;
use crate::error::refuse;
use crate::progress::Progress;
use crate::receipt::sha256_of;
use anyhow::{Context, Result};
use scenesplat::kernels::simd::Isa;
use scenesplat::machine::Machine;
use scenesplat::network::Weights;
use scenesplat::{Setting, embedded};
use scenesplat_lab::pareto::{Grid, Kind, Measured, Record, Records, Written, seconds_text};
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A run of the command.
pub struct Campaign<'a> {
    /// Its flags.
    pub args: &'a Args,
    /// What is tried.
    pub grid: &'a Grid,
    /// The scenes.
    pub sets: &'a [Set],
    /// Folder for what is thrown away.
    pub scratch: &'a Path,
    /// This machine, with as many threads as work.
    pub machine: Machine,
    /// Repeats after the warm-up.
    pub repeats: usize,
    /// What is shown.
    pub progress: &'a Progress,
    /// Requests so far.
    asked: Cell<usize>,
    /// Hashes of weights, by the network that a setting names.
    weights: RefCell<BTreeMap<Option<String>, String>>,
}

/// What a process may be given beside its setting.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Beside {
    /// Other number of threads.
    pub threads: Option<usize>,
    /// A memory limit.
    pub max_memory: Option<String>,
    /// An instruction set.
    pub isa: Option<String>,
    /// Whether the evaluator is checked, and oracle and random labels are scored.
    pub bounds: bool,
}

/// Whether scenes were evaluated with the classes and the vote of a setting, where `measured` was.
fn is_checked<'a>(mut measured: impl Iterator<Item = &'a str>, setting: &Setting) -> bool {
    measured.any(|name| {
        name.parse::<Setting>().is_ok_and(|s| (&s.net, s.k) == (&setting.net, setting.k))
    })
}

impl<'a> Campaign<'a> {
    /// On this machine, with the threads that the flags say.
    pub fn new(
        args: &'a Args,
        grid: &'a Grid,
        sets: &'a [Set],
        scratch: &'a Path,
        progress: &'a Progress,
        repeats: usize,
    ) -> Self {
        let threads = args.running.threads.unwrap_or_else(rayon::current_num_threads);
        let simd = Isa::current().name().to_owned();
        let machine = Machine { threads, simd, ..Machine::detect() };
        let (asked, weights) = (Cell::default(), RefCell::default());
        Self { args, grid, sets, scratch, machine, repeats, progress, asked, weights }
    }

    /// SHA-256 of the weights that a setting takes.
    pub fn weights_hash(&self, setting: &Setting) -> Result<String> {
        if let Some(known) = self.weights.borrow().get(&setting.net) {
            return Ok(known.clone());
        }
        let hash = self.hash_weights(setting)?;
        self.weights.borrow_mut().insert(setting.net.clone(), hash.clone());
        Ok(hash)
    }

    /// What all records share, in words: records of other reference, classes or files do not compare.
    pub fn conditions(&self) -> Result<String> {
        let Args { classes, exclude, label_names, label_ids, class_map, source, .. } = self.args;
        let mut parts = vec![format!("reference {}", self.grid.reference)];
        for (name, path) in [
            ("text", &classes.text),
            ("text names", &classes.text_names),
            ("label names", label_names),
            ("class map", class_map),
        ] {
            let Some(path) = path else { continue };
            // Vocabularies are no files.
            let hash = if path.is_file() { sha256_of(path)?.0 } else { String::new() };
            parts.push(format!("{name} {} {}", path.display(), hash.get(..12).unwrap_or_default()));
        }
        parts.extend(label_ids.label_base.map(|base| format!("label base {base}")));
        parts.extend(exclude.as_ref().map(|names| format!("exclude {}", names.join(","))));
        parts.extend(source.segment_name.as_ref().map(|name| format!("segment {name}")));
        if let Some(folder) = &classes.text_model {
            parts.push(format!("text model {} {:?}", folder.display(), classes.template));
        }
        let Classes { without, min_score, min_margin, .. } = classes;
        if !without.is_empty() || min_score.is_some() || min_margin.is_some() {
            parts.push(format!("classes {without:?} {min_score:?} {min_margin:?}"));
        }
        parts.push(format!("writes {:?}", self.grid.writes));
        Ok(parts.join("; "))
    }

    fn hash_weights(&self, setting: &Setting) -> Result<String> {
        let weights = match setting.net.as_deref() {
            None => weights_text(&self.args.network.weights()?),
            Some(net) => match self.grid.networks.get(net) {
                Some(network) => network.weights.display().to_string(),
                None => {
                    let network = self.args.network.with_net(Some(net))?;
                    weights_text(&network.weights()?)
                }
            },
        };
        Ok(match weights.parse::<Weights>() {
            Ok(Weights::Embedded) => embedded::sha256(),
            Ok(Weights::Seeded(_)) | Err(_) => weights,
            Ok(Weights::File(path)) => sha256_of(&path)?.0,
        })
    }

    /// Measures a setting on a set.
    pub fn measure(
        &self,
        setting: &Setting,
        set: &Set,
        repeats: usize,
        beside: &Beside,
        labels: Labels<'_>,
    ) -> Result<Measured> {
        let named = setting.net.as_ref().and_then(|net| self.grid.networks.get(net));
        let given = match named {
            Some(_) => Setting { net: None, ..setting.clone() },
            None => setting.clone(),
        };
        let number = self.asked.get();
        self.asked.set(number + 1);
        let file = |name: &str| self.scratch.join(format!("{name}-{number}.json"));
        let (answer, asked) = (file("answer"), file("request"));
        let folder = |keep: bool| (labels.keep == keep).then(|| labels.folder.map(Path::to_owned));
        let request = Request {
            setting: setting.to_string(),
            given: given.to_string(),
            flags: self.args.flags(named),
            set: set.name.clone(),
            scenes: set.scenes.clone(),
            label_names: self.args.label_names.clone(),
            label_base: self.args.label_ids.label_base,
            class_map: self.args.class_map.clone(),
            exclude: self.args.exclude.clone(),
            repeats,
            features: self.grid.writes.contains(&Written::Features),
            labels: self.grid.writes.contains(&Written::Labels),
            threads: beside.threads.unwrap_or(self.machine.threads),
            max_memory: beside.max_memory.clone(),
            conditions: self.conditions()?,
            weights_hash: self.weights_hash(setting)?,
            input_hash: set.hash.clone(),
            reference: folder(false).flatten(),
            keep_labels: folder(true).flatten(),
            bounds: beside.bounds,
            scratch: self.scratch.to_owned(),
            answer: answer.clone(),
        };
        std::fs::write(&asked, serde_json::to_string(&request)?)
            .with_context(|| asked.display().to_string())?;
        let variables: Vec<(&str, &str)> =
            beside.isa.iter().map(|isa| ("SCENESPLAT_ISA", isa.as_str())).collect();
        let words = ["pareto-point", &asked.to_string_lossy()];
        run_in_a_process(&words, &variables).map_err(|error| {
            if error.is::<Stopped>() {
                return error;
            }
            let text = if setting.is_empty() { "the commands' own setting" } else { "" };
            error.context(format!("{text}{setting} on {}", set.name))
        })?;
        let text = std::fs::read_to_string(&answer).context("a process gave no answer")?;
        Ok(serde_json::from_str(&text)?)
    }

    /// Measures a setting on all sets, as far as it is not in the records.
    pub fn complete(&self, setting: &Setting, records: &mut Records, out: &Path) -> Result<()> {
        let name = setting.to_string();
        let is_reference = *setting == self.grid.reference;
        for set in self.sets {
            let folder = reference_folder(out, set);
            let known = records.find(Kind::Setting, &name, None, &set.name).cloned();
            if let Some(known) = known {
                if is_reference && !kept(&folder, &known) {
                    self.keep_again(setting, set, &known, &folder)?;
                }
                continue;
            }
            let labels = Labels { folder: Some(&folder), keep: is_reference };
            let measured = records.all.iter();
            let measured = measured
                .filter(|r| r.kind == Kind::Setting && r.scenes == set.name)
                .map(|r| r.setting.as_str());
            let bounds = !is_checked(measured, setting);
            let beside = Beside { bounds, ..Beside::default() };
            let Measured { setting: mut record, bounds } =
                self.measure(setting, set, self.repeats, &beside, labels)?;
            if is_reference {
                for scene in &record.per_scene {
                    if let Some(lost) = &scene.unnamed {
                        let name = &scene.name;
                        self.progress
                            .say(format!("  WARNING: {name}: {lost}: counted as unlabeled"));
                    }
                }
                record.agreement = Some(1.0);
                for row in bounds.into_iter().flatten() {
                    if records.find(row.kind, &row.setting, None, &set.name).is_none() {
                        records.append(row)?;
                    }
                }
            }
            self.say(&record);
            records.append(record)?;
        }
        Ok(())
    }

    /// Labels of the reference that are not there any more.
    fn keep_again(
        &self,
        setting: &Setting,
        set: &Set,
        known: &Record,
        folder: &Path,
    ) -> Result<()> {
        let labels = Labels { folder: Some(folder), keep: true };
        let record = self.measure(setting, set, 1, &Beside::default(), labels)?.setting;
        if record.prediction_hash != known.prediction_hash {
            let (setting, set) = (&record.setting, &set.name);
            anyhow::bail!(
                "{setting} on {set}: other labels than its record says; use another --out"
            );
        }
        Ok(())
    }

    /// Says what was measured.
    pub fn say(&self, record: &Record) {
        let quality = record.f_miou.map_or("none".to_owned(), |v| format!("{:.2} %", 100.0 * v));
        let neutral = record.neutral.as_ref().map_or(String::new(), |n| format!(" [{n}]"));
        let setting = if record.setting.is_empty() { "(no part)" } else { &record.setting };
        self.progress.say(format!(
            "  {setting}{neutral} on {}: {} a scene, f-mIoU {quality}",
            record.scenes,
            seconds_text(record.seconds_p50)
        ));
    }

    /// Refuses records of other weights.
    pub fn check_weights(&self, records: &Records, settings: &[Setting]) -> Result<()> {
        for record in records.all.iter().filter(|r| r.kind == Kind::Setting) {
            let Some(setting) = settings.iter().find(|s| s.to_string() == record.setting) else {
                continue;
            };
            if self.weights_hash(setting)? != record.weights_hash {
                let setting = &record.setting;
                refuse!(
                    "{}: the record of {setting} is of other weights; give another --out",
                    self.args.out.display()
                );
            }
        }
        Ok(())
    }
}

/// Where the labels of the reference are, or go.
#[derive(Debug, Clone, Copy)]
pub struct Labels<'a> {
    /// Which folder.
    pub folder: Option<&'a Path>,
    /// Whether they go there; else they are compared with.
    pub keep: bool,
}

/// Folder of the reference's labels on a set.
pub fn reference_folder(out: &Path, set: &Set) -> PathBuf {
    out.join("reference").join(set.hash.get(..16).unwrap_or(&set.hash))
}

/// Whether the labels of all scenes are there.
fn kept(folder: &Path, record: &Record) -> bool {
    (0..record.per_scene.len()).all(|i| scenesplat_lab::pareto::labels_path(folder, i).is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_network_and_vote_is_checked_once() {
        let checked = |measured: &[&str], setting: &str| {
            is_checked(measured.iter().copied(), &setting.parse().unwrap())
        };
        assert!(!checked(&[], "k=25"));
        assert!(checked(&["voxel=0.06,k=25"], "voxel=0.12,precision=bf16,k=25"));
        assert!(!checked(&["voxel=0.06,k=25"], "voxel=0.06,k=8"));
        assert!(!checked(&["k=25"], "net=student,k=25"));
        assert!(checked(&["k=1", "net=student,k=25"], "net=student,passes=2,k=25"));
    }
}
