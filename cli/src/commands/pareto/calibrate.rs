//! `pareto --calibrate`: what the commands take on this machine, and what settings are worth.

use super::args::Args;
use super::campaign::Campaign;
use super::inputs;
use crate::bench::process::{Scratch, run_in_a_process};
use crate::bench::speeds;
use crate::budget::stored_path;
use crate::error::{WrongUse, refuse};
use crate::progress::Progress;
use crate::receipt::ReceiptReport;
use crate::terminal::print;
use anyhow::{Context, Result, bail};
use scenesplat::Setting;
use scenesplat::datasets::plan::center_shift;
use scenesplat::kernels::grid_sample::{KeyOrder, voxel_groups};
use scenesplat::network::{WeightOptions, network_of};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::edit::merge;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::{AtomicFile, GaussianScene, printable};
use scenesplat_lab::pareto::{
    Calibrated, Calibration, CostModel, Grid, Kind, Observation, Records, Size, points,
    seconds_text,
};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Rooms whose quality is measured: of a seed that no training of the project uses.
const SCENES: &str = "synthetic:10:1022";
/// Seed of the rooms that are timed.
const TIMED: u64 = 1023;
/// Gaussians of a room, about, in turn: larger scenes are several rooms, for voxels have to grow along, and
/// rooms are dense in one scene and thin in the next, or nothing would tell the cost of a voxel from that of a
/// Gaussian.
const ROOM: [usize; 2] = [100_000, 30_000];
/// Distance from room to room, meters.
const APART: f32 = 12.0;
/// Runs of a command: two at least, three if that takes no longer than this. The model is fitted to the
/// fastest, for what else happens on a machine only adds to a time; all of them say how much that is.
const RUNS: [usize; 2] = [2, 3];
const RUNS_SECONDS: f64 = 1.5;

/// Calibrates, and stores the front.
pub fn calibrate(args: &Args) -> Result<()> {
    let began = Instant::now();
    let progress = Progress::start(&args.running)?;
    let weights = args.network.weights()?;
    let options = WeightOptions::default();
    let native = network_of(&weights, args.network.config.as_ref(), &options)?.model.grid_size;
    let (grid, settings) =
        args.grid_or(|| Grid::calibration(native).map_err(|e| WrongUse(e.to_string())))?;
    if settings.iter().any(|s| s.net.is_some()) {
        refuse!("--calibrate: a front is of one network; give it with --weights, not as net");
    }
    let scratch = Scratch::new()?;
    let mut records = Records::open(&scratch.path().join("records.jsonl"))?;
    let given = Some(args.scenes()).filter(|given| !given.is_empty());
    let given = given.unwrap_or_else(|| vec![SCENES.to_owned()]);
    let sets = inputs::sets(&given, scratch.path(), &progress)?;
    // Quality alone is asked for here; times are those of whole commands.
    let campaign = Campaign::new(args, &grid, &sets, scratch.path(), &progress, 1);
    let weights_hash = campaign.weights_hash(&grid.reference)?;
    let path = stored_path(&weights_hash)
        .context("there is no data folder of this user: name one with SCENESPLAT_FRONTS")?;
    for setting in &settings {
        campaign.check_limit(began)?;
        campaign.complete(setting, &mut records, scratch.path())?;
    }
    let Some(first) = records.all.iter().find(|r| r.kind == Kind::Setting).cloned() else {
        bail!("nothing was measured");
    };
    let sizes = SizeOf { native, width: first.width, classes: first.classes };
    let (runs, all_runs) = campaign.times(&settings, &sizes, began)?;
    let quality = points(&records.all, Kind::Setting, &given);
    let front = Calibration {
        version: campaign.machine.version.clone(),
        fingerprint: campaign.machine.fingerprint(),
        machine: campaign.machine.clone(),
        weights_hash,
        f32_flop_s: speeds().f32_flop_s,
        reference: grid.reference.to_string(),
        scenes: given.join(", "),
        width: first.width,
        classes: first.classes,
        settings: quality
            .into_iter()
            .filter_map(|p| Some(Calibrated { f_miou: p.f_miou?, setting: p.setting }))
            .collect(),
        model: CostModel::fit(&runs).with_spread(&all_runs),
    };
    store(&front, &path)?;
    print(&format!(
        "{} settings, {} runs in {}; nine of ten of the fastest are within {:.0} % of the model, a run takes {:.2} \
         times as long as those in the middle, and nineteen of twenty at most {:.0} % more",
        front.settings.len(),
        all_runs.len(),
        seconds_text(began.elapsed().as_secs_f64()),
        100.0 * front.model.error,
        front.model.typical,
        100.0 * front.model.reserve
    ));
    print(&format!("wrote {}", printable(&path)));
    Ok(())
}

fn store(front: &Calibration, path: &Path) -> Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    Ok(AtomicFile::write(path, (serde_json::to_string_pretty(front)? + "\n").as_bytes())?)
}

/// What the size of a job depends on beside its scene and setting.
struct SizeOf {
    /// Voxel size of the network.
    native: f64,
    /// Of its features.
    width: usize,
    classes: usize,
}

impl SizeOf {
    fn size(&self, scene: &GaussianScene, setting: &Setting) -> Result<Size> {
        let voxel = setting.voxel.unwrap_or(self.native);
        let groups = voxel_groups(&center_shift(&scene.coord), voxel, KeyOrder::Morton)?;
        Ok(Size {
            gaussians: scene.len(),
            voxels: groups.num_voxels(),
            classes: self.classes,
            width: setting.codes.unwrap_or(self.width),
            k: setting.k.unwrap_or(crate::setting::VOTE_K),
        })
    }
}

/// A scene of that many Gaussians: a room, or several side by side.
fn timed_scene(number: u64, count: usize) -> Result<GaussianScene> {
    let rooms = count.div_ceil(ROOM[(number % 2) as usize]).max(1);
    let side = (1..).find(|side| side * side >= rooms).unwrap_or(1);
    let scenes = (0..rooms).map(|room| {
        let each = count * (room + 1) / rooms - count * room / rooms;
        let settings = SyntheticRoomSettings {
            room: number * 1000 + room as u64,
            ..SyntheticRoomSettings::with_count(each, TIMED)
        };
        let mut scene = generate(&settings)?.scene;
        for coord in &mut scene.coord {
            coord[0] += APART * (room % side) as f32;
            coord[1] += APART * (room / side) as f32;
        }
        Ok(scene)
    });
    Ok(merge(scenes.collect::<Result<_>>()?)?.0)
}

/// A run to time.
struct Timed<'a> {
    command: &'a str,
    scene: &'a Path,
    setting: &'a Setting,
    size: Size,
    width: usize,
}

impl Campaign<'_> {
    /// # Errors
    /// If the time that was allowed is over.
    fn check_limit(&self, began: Instant) -> Result<()> {
        let limit = self.args.limit.0;
        if began.elapsed().as_secs_f64() > limit {
            bail!(
                "--limit: {} were over before the calibration was complete; nothing was stored",
                seconds_text(limit)
            );
        }
        Ok(())
    }

    /// The fastest run of each command, size and setting, and all runs.
    fn times(
        &self,
        settings: &[Setting],
        sizes: &SizeOf,
        began: Instant,
    ) -> Result<(Vec<Observation>, Vec<Observation>)> {
        let (mut runs, mut all_runs) = (Vec::new(), Vec::new());
        let width = sizes.width;
        for (i, &count) in self.args.sizes.iter().enumerate() {
            let scene = timed_scene(i as u64, count)?;
            let file = self.scratch.join(format!("timed-{i}.ply"));
            write_inria_ply(&scene, &[], &file)?;
            if let Some(setting) = settings.first() {
                // The first run of a size pays for pages that the system has yet to give.
                let size = Size::default();
                self.time(&Timed { command: "segment", scene: &file, setting, size, width })?;
            }
            for (j, setting) in settings.iter().enumerate() {
                let commands = ["segment", "features", "query"];
                for command in if j == 0 { &commands[..] } else { &commands[..1] } {
                    self.check_limit(began)?;
                    let size = sizes.size(&scene, setting)?;
                    let timed = Timed { command, scene: &file, setting, size, width };
                    let timed = self.timed_runs(&timed)?;
                    runs.extend(timed.iter().min_by(|a, b| a.wall.total_cmp(&b.wall)).cloned());
                    all_runs.extend(timed);
                    self.progress.say(format!(
                        "  {command} of {count} Gaussians, {setting}: {}",
                        seconds_text(runs[runs.len() - 1].wall)
                    ));
                }
            }
        }
        Ok((runs, all_runs))
    }

    /// Several runs.
    fn timed_runs(&self, timed: &Timed<'_>) -> Result<Vec<Observation>> {
        let mut runs: Vec<Observation> = Vec::new();
        while runs.len() < RUNS[0]
            || (runs.len() < RUNS[1] && runs.iter().map(|run| run.wall).sum::<f64>() < RUNS_SECONDS)
        {
            runs.push(self.time(timed)?);
        }
        Ok(runs)
    }

    /// Runs a command as a user does, and reads its receipt.
    fn time(&self, timed: &Timed<'_>) -> Result<Observation> {
        let Timed { command, scene, setting, size, width } = timed;
        let out: PathBuf = self.scratch.join("out");
        let receipt = self.scratch.join("receipt.json");
        let mut words = vec![(*command).to_owned(), scene.display().to_string()];
        if *command == "query" {
            words.push("chair".to_owned());
        }
        let given = if *command == "features" {
            Setting { k: None, ..(*setting).clone() }
        } else {
            (*setting).clone()
        };
        if !given.is_empty() {
            words.push(format!("--setting={given}"));
        }
        let mut flags = self.args.flags(None);
        if *command == "features" {
            // It knows no classes.
            flags.retain(|flag| {
                !["--text", "--without", "--min-score", "--min-margin"]
                    .iter()
                    .any(|f| flag.starts_with(f))
            });
        } else if !self.args.network.is_embedded()
            && self.args.classes.text.is_none()
            && self.args.classes.text_names.is_none()
        {
            flags.push(format!("--text=vocabulary:{width}"));
        }
        words.extend(flags);
        words.push(format!("--out={}", out.display()));
        words.push(format!("--receipt={}", receipt.display()));
        words.push(format!("--threads={}", self.machine.threads));
        words.push("--quiet".to_owned());
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        run_in_a_process(&words, &[]).with_context(|| format!("{command} with {setting}"))?;
        let report: ReceiptReport = serde_json::from_str(&std::fs::read_to_string(&receipt)?)?;
        let outer = report.stages.into_iter().filter(|s| !s.name.contains('/'));
        Ok(Observation {
            command: (*command).to_owned(),
            setting: setting.to_string(),
            size: *size,
            stages: outer.map(|s| (s.name, s.seconds)).collect(),
            wall: report.wall_seconds,
            peak_bytes: report.peak_memory_bytes.unwrap_or(0),
        })
    }
}
