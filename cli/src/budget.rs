//! `--budget` and `--min-quality`: which setting a command takes, from a front that was measured.

use crate::bench::speeds;
use crate::error::{WrongUse, refuse};
use crate::flags::Inference;
use crate::receipt::{BudgetReport, sha256_of};
use crate::setting::VOTE_K;
use crate::threads::set_threads;
use anyhow::{Context, Result};
use scenesplat::alignment::Alignment;
use scenesplat::datasets::plan::center_shift;
use scenesplat::input::open_input;
use scenesplat::kernels::grid_sample::{KeyOrder, voxel_groups};
use scenesplat::kernels::simd::Isa;
use scenesplat::machine::Machine;
use scenesplat::network::Weights;
use scenesplat::outputs::OpenedScene;
use scenesplat::{Setting, embedded};
use scenesplat_lab::pareto::{Ask, Calibration, Size, seconds_text};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Names the folder of stored fronts, in place of the user's data folder.
pub const FOLDER_VARIABLE: &str = "SCENESPLAT_FRONTS";

/// What the setting is chosen by.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct BudgetArgs {
    /// Most time that the command may take (500ms, 2s, 1m): it takes the best setting that keeps
    /// it, by the front of this machine (scenesplat pareto --calibrate), and says which.
    #[arg(long, value_name = "TIME", value_parser = crate::duration::parse_duration, allow_hyphen_values = true)]
    pub budget: Option<crate::duration::Seconds>,
    /// Least share of the reference setting's quality, 0 to 1: the command takes the cheapest setting
    /// that has it, or with --budget the best of those.
    #[arg(long, value_name = "SHARE", value_parser = parse_share, allow_hyphen_values = true)]
    pub min_quality: Option<f64>,
}

fn parse_share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(share) if share > 0.0 && share <= 1.0 => Ok(share),
        _ => Err(format!("{text:?}: a share above 0 and up to 1 is expected, such as 0.95")),
    }
}

/// A chosen setting.
pub struct Chosen {
    /// The setting.
    pub setting: Setting,
    /// For the receipt; the time spent is noted at its end.
    pub report: BudgetReport,
    /// When the command began.
    pub began: Instant,
    /// What to say.
    pub remarks: Vec<String>,
    /// The scene, which is not read twice, and what to say about it.
    pub input: (OpenedScene, Option<String>),
}

/// What a front is looked up for.
pub struct Job<'a> {
    /// `segment`, `features` or `query`.
    pub command: &'static str,
    /// The scene.
    pub scene: &'a Path,
    /// The flags of the network.
    pub inference: &'a Inference,
    /// --vote-k.
    pub vote_k: Option<usize>,
    /// Features that replace the network.
    pub features: Option<&'a Path>,
}

/// The flags of the network with the setting that a budget chooses, if there is one, and how many neighbors vote.
///
/// # Errors
/// If a flag contradicts the budget or the setting, there is no front, or nothing keeps what is asked for.
pub fn within_budget(
    args: &BudgetArgs,
    threads: Option<usize>,
    job: &Job<'_>,
) -> Result<(Inference, usize, Option<Chosen>)> {
    set_threads(threads)?;
    let chosen = choose(args, job)?;
    let mut inference = job.inference.clone();
    if let Some(chosen) = &chosen {
        inference.setting = Some(chosen.setting.clone());
    }
    let (inference, vote_k) = inference.settled(job.vote_k)?;
    Ok((inference, vote_k, chosen))
}

/// Chooses a setting if the flags ask for it.
fn choose(args: &BudgetArgs, job: &Job<'_>) -> Result<Option<Chosen>> {
    let began = Instant::now();
    if args.budget.is_none() && args.min_quality.is_none() {
        return Ok(None);
    }
    let flag = if args.budget.is_some() { "--budget" } else { "--min-quality" };
    check_flags(flag, job)?;
    let weights_hash = weights_hash(job.inference)?;
    let machine = Machine { simd: Isa::current().name().to_owned(), ..Machine::detect() };
    let (front, slower, mut remarks) = front_of(flag, &weights_hash, &machine)?;
    let input = open_input(job.scene, &job.inference.source.options())?;
    let scene = &input.0.loaded.scene;
    if scene.lang_code.is_some()
        && job.inference.network.weights.is_none()
        && job.command != "features"
    {
        refuse!(
            "{flag} chooses the setting of a network, and {} carries language codes, which are used \
             without one: leave out {flag}, or give --weights too",
            job.scene.display()
        );
    }
    // A turn about the vertical changes the number of voxels next to nothing.
    let alignment = Alignment::of(scene, &job.inference.alignment(&input.0.loaded, false));
    let coord = center_shift(&alignment.apply(scene).coord);
    let native = embedded::config().map_or(0.02, |config| config.model.grid_size);
    let mut sizes = Sizes { coord, native, front: &front, counted: BTreeMap::new() };
    // Counts the voxels, which is a part of what is spent.
    for calibrated in &front.settings {
        sizes.size(&calibrated.setting);
    }
    let ask = Ask {
        seconds: args.budget.map(|b| b.0),
        min_quality: args.min_quality,
        max_memory: job.inference.max_memory.map(|b| b.0),
    };
    let spent = began.elapsed().as_secs_f64();
    let choice = front
        .choose(job.command, &ask, &mut |setting: &str| sizes.size(setting), slower, spent)
        .map_err(|error| WrongUse(format!("{flag}: {error}")))?;
    remarks.push(format!(
        "{flag}: {} ({}); about {} of this command, {:.1} % of the reference's f-mIoU on {}",
        choice.setting,
        choice.why,
        seconds_text(choice.seconds),
        100.0 * choice.share,
        front.scenes
    ));
    let mut setting: Setting = choice.setting.parse()?;
    if job.command == "features" {
        setting.k = None;
    }
    let report = BudgetReport {
        asked_s: ask.seconds,
        expected_s: choice.seconds,
        spent_s: 0.0,
        setting: choice.setting,
    };
    Ok(Some(Chosen { setting, report, began, remarks, input }))
}

/// The size of the job with each setting.
struct Sizes<'a> {
    coord: Vec<[f32; 3]>,
    /// Voxel size of the network.
    native: f64,
    front: &'a Calibration,
    /// Voxels by the bits of their size.
    counted: BTreeMap<u64, usize>,
}

impl Sizes<'_> {
    fn size(&mut self, setting: &str) -> Size {
        let setting: Setting = setting.parse().unwrap_or_default();
        let size = setting.voxel.unwrap_or(self.native);
        let coord = &self.coord;
        let voxels = *self.counted.entry(size.to_bits()).or_insert_with(|| {
            voxel_groups(coord, size, KeyOrder::Morton).map_or(coord.len(), |g| g.num_voxels())
        });
        Size {
            gaussians: coord.len(),
            voxels,
            classes: self.front.classes,
            width: setting.codes.unwrap_or(self.front.width),
            k: setting.k.unwrap_or(VOTE_K),
        }
    }
}

/// Refuses flags that say what the budget is to choose.
fn check_flags(flag: &str, job: &Job<'_>) -> Result<()> {
    let inference = job.inference;
    let flags = [
        (inference.setting.is_some(), "--setting"),
        (inference.precision.is_some(), "--precision"),
        (inference.grid_size.is_some(), "--grid-size"),
        (inference.exact, "--exact"),
        (job.vote_k.is_some(), "--vote-k"),
        (job.features.is_some(), "--features"),
    ];
    match flags.into_iter().find(|(given, _)| *given) {
        Some((_, other)) => {
            refuse!("{flag} chooses the setting: leave out {other}");
        }
        None => Ok(()),
    }
}

fn weights_hash(inference: &Inference) -> Result<String> {
    Ok(match inference.network.weights()? {
        Weights::Embedded => embedded::sha256(),
        Weights::Seeded(seed) => format!("seeded:{seed}"),
        Weights::File(path) => sha256_of(&path)?.0,
    })
}

/// The front of these weights: that of this machine, or the one that comes with the program with the
/// factor between both machines. Also what to say about it.
fn front_of(
    flag: &str,
    weights: &str,
    machine: &Machine,
) -> Result<(Calibration, f64, Vec<String>)> {
    let path = stored_path(weights);
    let mut remarks = Vec::new();
    if let Some(path) = path.as_deref().filter(|path| path.exists()) {
        let stored = Calibration::read(path)?;
        let Some(what) = foreign(&stored, weights, machine) else {
            return Ok((stored, 1.0, remarks));
        };
        remarks.push(format!(
            "*** {}: is of {what} and is not used; scenesplat pareto --calibrate makes it anew ***",
            path.display()
        ));
    }
    if weights != embedded::sha256() {
        let mut text = String::new();
        remarks.iter().for_each(|remark| text += &format!("{remark}; "));
        refuse!(
            "{flag}: {text}there is no front of these weights for this machine; make it with \
             scenesplat pareto --calibrate and the same --weights"
        );
    }
    let shipped = Calibration::shipped().context("the front that comes with the program")?;
    let slower = shipped.f32_flop_s / speeds().f32_flop_s;
    remarks.push(format!(
        "{flag}: no front of this machine; that of {} is used, times {slower:.2} by the speed of the \
         processors (scenesplat pareto --calibrate measures it here, in about three minutes)",
        shipped.machine
    ));
    Ok((shipped, slower, remarks))
}

/// What a stored front is of, if not of this program, these weights and this machine. Each field is
/// looked at by itself: a file that was copied or edited may contradict its own fingerprint.
fn foreign(stored: &Calibration, weights: &str, machine: &Machine) -> Option<String> {
    let versions = [&stored.version, &stored.machine.version];
    if let Some(other) = versions.into_iter().find(|version| **version != machine.version) {
        return Some(format!("version {other}"));
    }
    if stored.weights_hash != weights {
        return Some("other weights".to_owned());
    }
    let here = machine.fingerprint();
    let same = stored.fingerprint == here && stored.machine.fingerprint() == here;
    (!same).then(|| format!("another machine or number of threads ({})", stored.machine))
}

/// Where the front of these weights is stored; `None` where there is no folder for such.
pub fn stored_path(weights: &str) -> Option<PathBuf> {
    let given = std::env::var_os(FOLDER_VARIABLE).filter(|v| !v.is_empty()).map(PathBuf::from);
    let home = || std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".local/share"));
    let data = std::env::var_os("XDG_DATA_HOME").filter(|v| !v.is_empty()).map(PathBuf::from);
    let folder = given.or_else(|| Some(data.or_else(home)?.join("scenesplat")))?;
    let short: String = weights.chars().filter(char::is_ascii_alphanumeric).take(16).collect();
    Some(folder.join(format!("front-{short}.json")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_front_of_something_else_is_foreign_whichever_field_says_so() {
        let here = Machine { version: "1.2.3".to_owned(), threads: 4, ..Machine::default() };
        let own = || {
            let shipped = Calibration::shipped().unwrap();
            Calibration {
                version: here.version.clone(),
                machine: here.clone(),
                fingerprint: here.fingerprint(),
                weights_hash: "abc".to_owned(),
                ..shipped
            }
        };
        assert_eq!(foreign(&own(), "abc", &here), None);
        type Change = fn(&mut Calibration);
        let changes: [(Change, &str); 5] = [
            (|front| front.version = "1.2.2".to_owned(), "version 1.2.2"),
            (|front| front.machine.version = "2.0.0".to_owned(), "version 2.0.0"),
            (|front| front.weights_hash = "abd".to_owned(), "other weights"),
            (|front| front.machine.threads = 5, "another machine"),
            (|front| front.fingerprint = "0".to_owned(), "another machine"),
        ];
        for (change, part) in changes {
            let mut front = own();
            change(&mut front);
            let what = foreign(&front, "abc", &here).unwrap_or_default();
            assert!(what.contains(part), "{what:?}: {part}");
        }
    }
}
