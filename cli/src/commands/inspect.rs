//! `scenesplat inspect`

use crate::error::WrongUse;
use crate::flags::{NetworkArgs, Shared, SourceArgs, parse_setting, parse_up};
use crate::log;
use crate::session::Session;
use crate::terminal::print;
use anyhow::{Context, Result, bail};
use scenesplat::alignment::{Alignment, AlignmentSettings};
use scenesplat::datasets::Orientation;
use scenesplat::inspect::sheet::{sheet_name, write_sheet};
use scenesplat::inspect::{Finding, InspectSettings, Inspection, inspect};
use scenesplat::kernels::Precision;
use scenesplat::memory::machine_memory;
use scenesplat::models::weights::resolve;
use scenesplat::network::{NetworkChoice, NetworkConfig, WeightOptions, Weights, network_of};
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::{ReadOptions, Up, printable};
use scenesplat::setting::Passes;
use scenesplat::{Network, SceneEncoder, Setting, embedded};
use std::path::PathBuf;

/// Prints what is in a scene, what is wrong with it and what the network will cost, and draws it as
/// SCENE.inspect.png in the output folder.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene, in any format.
    pub scene: PathBuf,
    /// Also writes everything as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Draws the sheet here instead.
    #[arg(long, value_name = "FILE.png", conflicts_with = "no_sheet")]
    pub sheet: Option<PathBuf>,
    /// Draws no sheet.
    #[arg(long)]
    pub no_sheet: bool,
    /// Which way is up; judged by the scene if not given.
    #[arg(long, value_name = "AXIS|X,Y,Z", value_parser = parse_up, allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// Ends with exit code 1 if there is any finding; notes do not count.
    #[arg(long)]
    pub fail_on_findings: bool,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SourceArgs,
    /// The network whose cost is estimated.
    #[command(flatten)]
    pub network: NetworkArgs,
    /// What the network would be run with, as segment takes it: of its parts, voxel, net, patch, stage
    /// and rank change the estimate.
    #[arg(long, value_name = "KEY=VALUE,...", value_parser = parse_setting)]
    pub setting: Option<Setting>,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// The network whose cost is asked for: the flags that name it, its name and what it is.
pub fn asked(args: &Args) -> Result<(NetworkArgs, String, NetworkConfig)> {
    let setting = args.setting.clone().unwrap_or_default();
    let chosen = args.network.with_net(setting.net.as_deref())?;
    let (name, config) = network(&chosen)?;
    Ok((chosen, name, settled(config, &setting)?))
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let (chosen, name, config) = asked(args)?;
    let session = Session::start_with(&args.shared, &chosen, line)?;
    session.outputs.reads(&args.scene)?;
    session.outputs.claim_any("--json", args.json.as_ref())?;
    let sheet = sheet_path(args)?;
    session.outputs.claim_any("--sheet", sheet.as_ref())?;
    let opened = {
        let _stage = session.receipt.stage("read");
        let opened = {
            let options = ReadOptions { sh_rest: true, ..args.source.options() };
            session.read(&args.scene, &options)?
        };
        session.receipt.add_rows_in(opened.loaded.source_rows());
        if args.shared.receipt.is_some() {
            session.receipt.fingerprint("input", &args.scene)?;
        }
        opened
    };
    session.check_stop()?;
    let seen = look(args, &session, (&chosen, name, config), &opened)?;
    let inspection = &seen.inspection;
    print(&if log::is_verbose() { inspection.to_string() } else { inspection.summary() });
    session.check_stop()?;
    if let Some(path) = &args.json {
        session.write_file(path, &serde_json::to_string_pretty(&seen.json()?)?)?;
    }
    if let Some(path) = &sheet {
        let _stage = session.receipt.stage("picture");
        let waiting = session.outputs.file_path(path)?;
        let bytes = write_sheet(&waiting, &opened.loaded.scene, inspection)?;
        session.receipt.add_bytes_written(bytes);
    }
    for finding in &inspection.findings {
        session.receipt.warning(finding.lines_joined());
    }
    session.finish_quietly()?;
    if let Some(path) = &sheet {
        print(&format!("sheet {}; --verbose says more", path.display()));
    }
    if args.fail_on_findings && !inspection.findings.is_empty() {
        let names: Vec<&str> = inspection.findings.iter().map(|f| f.name.as_str()).collect();
        bail!("{}: {} findings: {}", args.scene.display(), names.len(), names.join(", "));
    }
    Ok(())
}

/// What is in a scene, and how it lies.
pub struct Seen {
    /// What is in it, what is wrong with it, what the network will cost.
    pub inspection: Inspection,
    /// How `segment` would read it.
    pub alignment: Alignment,
}

impl Seen {
    /// Everything, as the file of `--json` has it.
    ///
    /// # Errors
    /// If it cannot be written as JSON.
    pub fn json(&self) -> Result<serde_json::Value> {
        let mut report = serde_json::to_value(&self.inspection)?;
        report["alignment"] = serde_json::to_value(self.alignment.report())?;
        Ok(report)
    }
}

/// Looks at a scene. `network`: as the flags name it, its name and what it is.
pub fn look(
    args: &Args,
    session: &Session<'_>,
    (chosen, name, config): (&NetworkArgs, String, NetworkConfig),
    opened: &OpenedScene,
) -> Result<Seen> {
    let alignment = alignment(session, args, chosen, opened, &config)?;
    let _stage = session.receipt.stage("inspect");
    let settings = InspectSettings {
        from_points: opened.converted,
        up: Some(alignment.up.clone()),
        unit: Some(alignment.read_unit()),
        grid_size: config.model.grid_size,
        network: Some((name, config)),
        machine_bytes: machine_memory().map(|bytes| bytes.0),
    };
    let mut inspection = inspect(&opened.loaded, &settings);
    inspection.findings.iter_mut().chain(&mut inspection.notes).for_each(name_flags);
    Ok(Seen { inspection, alignment })
}

/// How `segment` would read the scene. The network inside the program is run only where the scene leaves up or the unit
/// open.
fn alignment(
    session: &Session<'_>,
    args: &Args,
    network: &NetworkArgs,
    opened: &OpenedScene,
    config: &NetworkConfig,
) -> Result<Alignment> {
    let settings = AlignmentSettings {
        up: args.up,
        stated_up: opened.loaded.stated_up,
        square: config.input.orientation == Orientation::Drawn,
        ..AlignmentSettings::default()
    };
    let found = session.shape_alignment(opened, &settings);
    if !(found.is_open() || found.is_size_open()) || !network.is_embedded() {
        return Ok(found);
    }
    let network = Network::load(embedded::config()?, &Weights::Embedded, WeightOptions::default())?;
    session.judged_alignment(opened, &settings, &SceneEncoder::new(&network))
}

/// Where the sheet is drawn, if it is.
fn sheet_path(args: &Args) -> Result<Option<PathBuf>> {
    Ok(match (&args.sheet, args.no_sheet) {
        (_, true) => None,
        (Some(path), _) => Some(path.clone()),
        (None, _) => {
            let out = &args.shared.out;
            std::fs::create_dir_all(out)
                .with_context(|| format!("{}: cannot make the output folder", out.display()))?;
            Some(out.join(sheet_name(&args.scene)))
        }
    })
}

/// The network with a setting, as far as the estimate knows it.
fn settled(config: NetworkConfig, setting: &Setting) -> Result<NetworkConfig> {
    let wrong = |text: String| WrongUse(format!("--setting {text}"));
    let one_pass = Some(Passes::Count(1));
    for (key, value) in setting.parts() {
        let unknown = match key {
            "precision" => setting.precision != Some(Precision::F32),
            "passes" => setting.passes != one_pass,
            "tta" => setting.tta != Some(1),
            "anchor" | "codes" | "k" => true,
            _ => false,
        };
        if unknown {
            let text = format!(
                "{key}={value}: the estimate is of one pass in f32, as it is without this part; \
                 leave it out"
            );
            return Err(wrong(text).into());
        }
    }
    let mut config = setting.apply_to_network(config).map_err(|error| wrong(error.to_string()))?;
    config.model.grid_size = setting.voxel.unwrap_or(config.model.grid_size);
    Ok(config)
}

/// Adds to a finding's help how the program is told so.
fn name_flags(finding: &mut Finding) {
    let flags = match finding.name.as_str() {
        "up" => "--up AXIS of every command; scenesplat convert SCENE OUT --up AXIS turns it",
        "memory" => "--max-memory SIZE of features, segment and query",
        "unread_columns" if !finding.help.is_empty() => "--segment-name NAME of every command",
        "unit" => "--unit mm or km; scenesplat convert SCENE OUT --scale 0.001 (or 1000)",
        _ => return,
    };
    if !finding.help.is_empty() {
        finding.help.push_str("; ");
    }
    finding.help.push_str(flags);
}

/// The network that `segment` would run with the same flags, and what it is called. A configuration
/// alone will do: only its size is asked for.
fn network(args: &NetworkArgs) -> Result<(String, NetworkConfig)> {
    let Some(weights) = &args.weights else {
        return match &args.config {
            Some(choice) => Ok((choice.to_string(), choice.resolve()?)),
            None => Ok((embedded::NAME.to_owned(), embedded::config()?)),
        };
    };
    // Weights that `segment` would refuse are refused here too.
    let name = match (weights, &args.config) {
        (Weights::File(path), choice) => {
            resolve(path)?;
            choice.as_ref().map_or_else(|| printable(path).into_owned(), ToString::to_string)
        }
        (_, Some(choice)) => choice.to_string(),
        (Weights::Embedded, None) => embedded::NAME.to_owned(),
        (Weights::Seeded(_), None) => NetworkChoice::Language.to_string(),
    };
    Ok((name, network_of(weights, args.config.as_ref(), &WeightOptions::default())?))
}
