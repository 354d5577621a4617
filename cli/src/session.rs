//! What most commands begin with: the output folder, the network, the scene.

use crate::budget::Chosen;
use crate::commands::WrongUse;
use crate::flags::{Inference, NetworkArgs, Shared};
use crate::outputs::Outputs;
use crate::progress::{Progress, interrupted, listen_for_interrupt};
use crate::receipt::{Receipt, WrittenFile};
use crate::terminal::print;
use crate::threads::set_threads;
use anyhow::{Context, Result};
use scenesplat::alignment::{Alignment, Remark};
use scenesplat::familiarity::Familiarity;
use scenesplat::inference::{EncodeError, Fidelity};
use scenesplat::input::{open_input, read_features};
use scenesplat::kernels::simd::Isa;
use scenesplat::memory::Bytes;
use scenesplat::models::{Compute, DeviceChoice, LoadPolicy, OpenDevice};
use scenesplat::network::{NetworkChoice, WeightOptions, Weights, network_of};
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::formats::npy_writer::{NpyElement, write_npy};
use scenesplat::scene::{GaussianScene, ReadOptions, UpAxis, guess_up, printable};
use scenesplat::{Network, SceneEncoder, SceneFeatures};
use scenesplat_lab::compensation::{Compensation, tiles_section};
use std::cell::RefCell;
use std::path::{Path, PathBuf};

/// Where features come from.
pub enum FeatureSource {
    /// A network that is run over the scene.
    Network(Box<Network>),
    /// The language codes of the scene.
    Codes,
    /// A file with a row per Gaussian.
    File(PathBuf),
}

impl FeatureSource {
    /// The network, if it is one with classes of its own.
    pub fn classifier(&self) -> Option<&Network> {
        match self {
            Self::Network(network) if network.is_classifier() => Some(network),
            _ => None,
        }
    }

    /// Whether a network is run.
    pub fn is_network(&self) -> bool {
        matches!(self, Self::Network(_))
    }

    /// Whether the features come from seeded weights, and mean nothing.
    pub fn has_random_weights(&self) -> bool {
        matches!(self, Self::Network(network) if network.has_random_weights())
    }

    /// What to add to a title where the result means nothing.
    pub fn remark(&self) -> &'static str {
        if self.has_random_weights() { " (seeded weights: no meaning)" } else { "" }
    }
}

/// How strange a scene is to the network inside the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Strangeness {
    /// Not at all: as rooms are.
    None,
    /// More than any room it was checked on.
    Some,
    /// Far more.
    Clear,
}

/// A running command.
pub struct Session<'a> {
    /// Shared flags.
    pub shared: &'a Shared,
    /// What is recorded.
    pub receipt: Receipt,
    /// What is shown.
    pub progress: Progress,
    /// What is read and written.
    pub outputs: Outputs,
    written: RefCell<Vec<(PathBuf, u64)>>,
    /// The scene, where a budget had to look at it before.
    input: RefCell<Option<(OpenedScene, Option<String>)>>,
}

impl<'a> Session<'a> {
    /// Sets up threads, the output folder, Ctrl-C and the receipt.
    pub fn start(shared: &'a Shared, command: &str) -> Result<Self> {
        set_threads(shared.threads)?;
        // A handler is there already when several commands run in one process.
        let _ = listen_for_interrupt();
        let receipt = Receipt::new(format!("scenesplat {command}"));
        receipt.computation("f32", Isa::current().name());
        receipt.threads(rayon::current_num_threads());
        let progress = Progress::new(shared.quiet);
        let outputs = Outputs::new(&shared.out);
        outputs.claim_any("--receipt", shared.receipt.as_ref())?;
        let (written, input) = (RefCell::default(), RefCell::default());
        Ok(Self { shared, receipt, progress, outputs, written, input })
    }

    /// As [`start`](Self::start) for a command with a network, whose files are inputs.
    pub fn start_with(shared: &'a Shared, network: &NetworkArgs, command: &str) -> Result<Self> {
        let session = Self::start(shared, command)?;
        if let Some(Weights::File(path)) = &network.weights {
            session.outputs.reads(path)?;
        }
        if let Some(NetworkChoice::File(path)) = &network.config {
            session.outputs.reads(path)?;
        }
        Ok(session)
    }

    /// Notes the setting, in its canonical form.
    pub fn note_setting(&self, inference: &Inference) {
        if !inference.effective.is_empty() {
            let why = "the parts that --setting and flags name (docs/settings.md)";
            self.receipt.setting("setting", &inference.effective, why);
        }
    }

    /// Says and notes the setting that a budget chose, and keeps the scene that it was chosen for.
    pub fn note_budget(&self, chosen: Option<Chosen>) {
        let Some(chosen) = chosen else { return };
        for remark in &chosen.remarks {
            self.progress.say(remark);
            self.receipt.warning(remark);
        }
        self.receipt.budget(chosen.report, chosen.began);
        *self.input.borrow_mut() = Some(chosen.input);
    }

    /// Makes the output folder, for files of these names and the receipt, and keeps other runs out
    /// of it; called before anything expensive, when the inputs are known.
    pub fn make_out(&self, names: &[&str]) -> Result<()> {
        self.outputs.open_folder(names)
    }

    /// Where to write a file of the output folder; it gets there when the command is done.
    pub fn out(&self, name: &str) -> Result<PathBuf> {
        self.outputs.path(name)
    }

    /// Notes a written file.
    pub fn wrote(&self, path: &Path, bytes: u64) {
        self.receipt.add_bytes_written(bytes);
        self.written.borrow_mut().push((self.outputs.shown(path), bytes));
    }

    /// Writes one value for each row of the scene's file, `fill` for those that were left out.
    pub fn write_rows<T: NpyElement>(
        &self,
        name: &str,
        opened: &OpenedScene,
        values: &[T],
        fill: T,
    ) -> Result<()> {
        let rows = opened.loaded.source_rows();
        let path = self.out(name)?;
        write_npy(&path, &[rows], &opened.loaded.to_source_rows(values, fill)?)?;
        let bytes = std::fs::metadata(&path).with_context(|| path.display().to_string())?.len();
        self.wrote(&path, bytes);
        Ok(())
    }

    /// Writes a text file outside of the output folder, which was claimed.
    pub fn write_file(&self, path: &Path, text: &str) -> Result<()> {
        self.outputs.file(path, text.as_bytes())?;
        self.wrote(path, text.len() as u64);
        Ok(())
    }

    /// Builds the network.
    pub fn network(&self, inference: &Inference) -> Result<Network> {
        let stage = self.receipt.stage("weights");
        let weights = &inference.network.weights()?;
        if *weights == Weights::Embedded && inference.network.config.is_some() {
            let text = "--config: the network inside the program has its own; leave it out";
            return Err(WrongUse(text.to_owned()).into());
        }
        let precision = inference.precision.unwrap_or_default();
        let compute = Compute { precision, fold: !inference.exact };
        self.receipt.computation(precision.name(), Isa::current().name());
        let why = "form of the numbers that products multiply; sums are f32";
        self.receipt.setting("precision", precision, why);
        let options = WeightOptions {
            policy: if inference.partial_weights {
                LoadPolicy::Partial
            } else {
                LoadPolicy::Strict
            },
            branch: inference.branch.into(),
            conv_layout: inference.conv_layout.into(),
        };
        let config = network_of(weights, inference.network.config.as_ref(), options)?;
        let config = inference.effective.apply_to_network(config.with_compute(compute));
        let config = config.map_err(|error| WrongUse(format!("--setting: {error}")))?;
        let device = self.device(inference.device)?;
        let network = Network::load_on(config, weights, options, &device.device)?;
        for (path, sha256) in network.files() {
            self.progress.say(format!("weights {} sha256 {sha256}", printable(path)));
            let bytes = std::fs::metadata(path).map_or(0, |m| m.len());
            self.receipt.fingerprint_known("weights", path, bytes, sha256);
        }
        match weights {
            Weights::Seeded(seed) => {
                let text = format!(
                    "SEEDED WEIGHTS ({seed}): features, labels and scores mean nothing; they show \
                     the mechanism and its cost"
                );
                self.progress.say(format!("*** {text} ***"));
                self.receipt.warning(text);
                self.receipt.setting("weights", format!("seeded:{seed}"), "values from a hash");
            }
            Weights::Embedded => {
                self.progress.say(
                    "weights: the small network inside the program, trained on synthetic rooms \
                     (its card: assets/embedded/README.md)",
                );
                let sha256 = scenesplat::embedded::sha256();
                self.receipt.setting("weights", scenesplat::embedded::NAME, &sha256);
            }
            Weights::File(_) => self.progress.say(format!("weights: {}", network.report())),
        }
        if inference.partial_weights && !network.report().is_complete() {
            self.receipt.warning(format!("partial weights: {}", network.report()));
        }
        drop(stage);
        Ok(network)
    }

    /// Makes the device ready that --device names, and says which it is.
    fn device(&self, choice: DeviceChoice) -> Result<OpenDevice> {
        let opened = choice.open().context("--device")?;
        if choice != DeviceChoice::Cpu {
            let name = match choice {
                DeviceChoice::Auto => opened.name.as_str().to_owned(),
                choice => format!("{choice} ({})", opened.name),
            };
            self.progress.say(format!("device: {name}"));
            self.receipt.setting("device", &name, "where the network computes");
        }
        if let Some(why) = &opened.fell_back {
            let text = format!("--device auto: computing on the cpu: {why}");
            self.progress.say(format!("*** {text} ***"));
            self.receipt.warning(text);
        }
        Ok(opened)
    }

    /// Reads a scene as a network's flags say; a labelled point cloud is turned into Gaussians.
    pub fn open(&self, path: &Path, inference: &Inference) -> Result<OpenedScene> {
        self.open_with(path, &inference.source.options())
    }

    /// Reads a scene, says what was wrong with it, and notes it in the receipt; a labelled point cloud
    /// is turned into Gaussians.
    pub fn open_with(&self, path: &Path, options: &ReadOptions) -> Result<OpenedScene> {
        let stage = self.receipt.stage("read");
        let opened = self.read(path, options)?;
        if !opened.loaded.report.is_clean() {
            let text = opened.loaded.report.to_string();
            self.progress.say(&text);
            self.receipt.warning(text);
        }
        self.receipt.add_rows_in(opened.loaded.source_rows());
        self.receipt.fingerprint("input", path)?;
        drop(stage);
        Ok(opened)
    }

    /// Reads a scene without a word about its values; a labelled point cloud is turned into
    /// Gaussians.
    pub fn read(&self, path: &Path, options: &ReadOptions) -> Result<OpenedScene> {
        self.outputs.reads(path)?;
        self.progress.say(format!("reading {}", path.display()));
        let before = self.input.take().filter(|(opened, _)| opened.loaded.path == path);
        let (opened, remark) = before.map_or_else(|| open_input(path, options), Ok)?;
        if let Some(text) = remark {
            self.progress.say(text);
            self.receipt.setting("input", "point cloud", "points were turned into Gaussians");
        }
        Ok(opened)
    }

    /// Reads a scene and decides where its features come from: from the network of --weights, or,
    /// without that, from the language codes that the scene carries. `check` looks at the network
    /// before anything is read.
    pub fn open_with_source(
        &self,
        path: &Path,
        inference: &Inference,
        file: Option<&Path>,
        check: impl FnOnce(&Network) -> Result<()>,
    ) -> Result<(OpenedScene, FeatureSource)> {
        if let Some(file) = file {
            if inference.network.weights.is_some() || inference.network.config.is_some() {
                let text = "--features are there already: leave out --weights and --config";
                return Err(WrongUse(text.to_owned()).into());
            }
            if let Some(flag) = inference.network_flag() {
                let text = format!("{flag} is about the network, which --features replace");
                return Err(WrongUse(text).into());
            }
            self.outputs.reads(file)?;
            self.receipt.fingerprint("features", file)?;
            return Ok((self.open(path, inference)?, FeatureSource::File(file.to_owned())));
        }
        if inference.network.weights.is_some() {
            let network = self.network(inference)?;
            check(&network)?;
            return Ok((self.open(path, inference)?, FeatureSource::Network(Box::new(network))));
        }
        if !path.exists() {
            // The missing file is the better message.
            return self.open(path, inference).map(|opened| (opened, FeatureSource::Codes));
        }
        let opened = self.open(path, inference)?;
        let Some(code) = &opened.loaded.scene.lang_code else {
            let network = self.network(inference)?;
            check(&network)?;
            return Ok((opened, FeatureSource::Network(Box::new(network))));
        };
        if let Some(flag) = inference.network_flag() {
            let text = format!("{flag} is about the network; give --weights too");
            return Err(WrongUse(text).into());
        }
        if inference.network.config.is_some() {
            return Err(WrongUse("--config names a network; give --weights too".to_owned()).into());
        }
        let text = format!(
            "no --weights: using the language codes of the scene, {} numbers a Gaussian",
            code.width()
        );
        self.progress.say(text);
        self.receipt.setting("features", "codes", "language codes that the scene carries");
        Ok((opened, FeatureSource::Codes))
    }

    /// The features of a scene from their source; `about`: what a network does not read.
    pub fn features(
        &self,
        opened: &OpenedScene,
        source: &FeatureSource,
        inference: &Inference,
        about: &Compensation,
    ) -> Result<SceneFeatures> {
        let scene = &opened.loaded.scene;
        match source {
            FeatureSource::Network(network) => self.encode(scene, network, inference, about),
            FeatureSource::File(path) => Ok(read_features(path, &opened.loaded)?),
            FeatureSource::Codes => {
                SceneFeatures::from_codes(scene).context("the scene carries no language codes")
            }
        }
    }

    /// How strange the scene is to the network inside the program, whose features these are; `None` if they do not tell.
    /// Says so if it is, and what follows from it, by `what`. Labels of a strange scene mean little: the network has a class for everything.
    pub fn strangeness(
        &self,
        features: &SceneFeatures,
        what: impl Fn(Strangeness) -> &'static str,
    ) -> Result<Option<Strangeness>> {
        let _stage = self.receipt.stage("familiarity");
        let familiar = Familiarity::embedded()?;
        let Some(found) = familiar.strangeness(features)? else {
            let why = "codes, or features without direction, do not tell how strange a scene is";
            self.receipt.setting("strangeness", "not judged", why);
            return Ok(None);
        };
        let [least, most] = familiar.rooms();
        let (limit, clear) = (familiar.limit(), familiar.clear_limit());
        let how = match found {
            found if found > clear => Strangeness::Clear,
            found if found > limit => Strangeness::Some,
            _ => Strangeness::None,
        };
        let why = format!(
            "rooms have {least:.1} to {most:.1}, strange is above {limit:.1}, clearly so above {clear:.1}"
        );
        self.receipt.setting("strangeness", format!("{found:.2}"), &why);
        if how > Strangeness::None {
            let text = format!(
                "this looks like nothing that the network inside the program was trained on (strangeness \
                 {found:.1}; {why}): {}",
                what(how)
            );
            self.progress.say(&text);
            self.receipt.warning(text);
        }
        Ok(Some(how))
    }

    /// Runs the network over a scene, without what it shall not read.
    pub fn encode(
        &self,
        scene: &GaussianScene,
        network: &Network,
        inference: &Inference,
        about: &Compensation,
    ) -> Result<SceneFeatures> {
        let stage = self.receipt.stage("network");
        let grid_size = inference.grid_size.unwrap_or(network.grid_size());
        let encoder = SceneEncoder {
            fidelity: if inference.exact { Fidelity::Exact } else { Fidelity::Fast },
            grid_size,
            max_memory: inference.max_memory.map(|b| b.0),
            halo: inference.halo,
            shuffle_orders: inference.shuffle_orders.then_some(inference.seed),
            spill_folder: self.shared.out.clone(),
            ..SceneEncoder::new(network)
        };
        let encoder = inference.effective.apply_to_encoder(encoder);
        let alignment = Alignment::of(scene, &inference.alignment(network.is_square()));
        self.tell(&alignment, inference.as_is);
        self.tell_floor(&alignment, network.input().reads_height(), inference.floor)?;
        let receipt = &self.receipt;
        let why = "fast: one Gaussian a voxel; exact: a sampling at half the voxel size, averaged";
        let fidelity = match encoder.fidelity {
            Fidelity::Fast => "fast".to_owned(),
            Fidelity::Passes(passes) => format!("at most {passes} passes of exact"),
            Fidelity::Exact => "exact".to_owned(),
        };
        receipt.setting("fidelity", fidelity, why);
        receipt.setting("grid_size", encoder.grid_size, "metres");
        if inference.shuffle_orders {
            receipt.setting("shuffle_orders", inference.seed, "seed");
        }
        let kept = about.kept(scene.len());
        let features = encoder.encode_kept(scene, alignment, &kept, &mut |at| {
            if interrupted() {
                return Err(EncodeError::Stopped);
            }
            let tiles = if at.tiles > 1 {
                format!(", tile {}/{}", at.tile, at.tiles)
            } else {
                String::new()
            };
            let passes = if at.passes > 1 {
                format!(", pass {}/{}", at.pass, at.passes)
            } else {
                String::new()
            };
            self.progress.advance(&format!("network{passes}{tiles}"), at.done);
            Ok(())
        });
        self.progress.finish();
        let features = features.map_err(|error| match error {
            EncodeError::Memory { .. } => anyhow::Error::from(error).context("--max-memory"),
            other => other.into(),
        })?;
        let s = features.summary;
        receipt.plan(scene.len(), tiles_section(&s, inference.max_memory.is_some()));
        if s.tiles > s.passes {
            receipt.setting("tiles", s.tiles, "the scene was cut to stay below --max-memory");
            receipt.setting("halo", s.smallest_halo, "narrowest context around a tile, voxels");
        }
        if s.shrunk_halos > 0 {
            let text = format!(
                "{} tiles had to narrow their halo to as little as {} voxels; features near their \
                 borders differ from an untiled run (allow more memory)",
                s.shrunk_halos, s.smallest_halo
            );
            self.progress.say(&text);
            receipt.warning(text);
        }
        self.progress.say(format!(
            "{} Gaussians, {} voxels, {} passes, {} tiles, {} voxels computed",
            features.len(),
            s.voxels,
            s.passes,
            s.tiles,
            s.voxels_computed
        ));
        if !features.calibrated.is_empty() {
            let shares = features
                .calibrated
                .iter()
                .map(|(name, kept)| format!("{:.2} % in {name}", 100.0 * kept));
            let text = shares.collect::<Vec<_>>().join(", ");
            self.progress.say(format!("rank: convolutions keep {text}"));
            receipt.setting("rank_keeps", text, "of their variance, on a part of the scene");
        }
        if let Some(codes) = features.codes() {
            let text = format!("{:.2} %", 100.0 * codes.kept);
            self.progress.say(format!(
                "codes: {} of {} numbers keep {text} of the features' squared length",
                codes.codes(),
                codes.width
            ));
            receipt.setting("codes_keep", text, "of the features' squared length");
        }
        drop(stage);
        Ok(features)
    }

    /// Notes what heights are measured from, and says it where it is not plain.
    fn tell_floor(&self, alignment: &Alignment, is_read: bool, given: Option<f64>) -> Result<()> {
        if !is_read {
            return match given {
                Some(_) => {
                    Err(WrongUse("--floor: this network reads no heights".to_owned()).into())
                }
                None => Ok(()),
            };
        }
        let floors = &alignment.floors;
        let shown: Vec<String> =
            floors.heights.iter().map(|h| format!("{:.2}", h / alignment.scale)).collect();
        let heights = shown.join(", ");
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let why = match (floors.given, floors.has_plane()) {
            (true, _) => "as given".to_owned(),
            (false, true) => format!(
                "a level surface over {} of the ground plan; {} of what is seen lies below it",
                percent(floors.cover),
                percent(floors.below)
            ),
            (false, false) => {
                "no level surface was found; 1 % of what is seen lies below it".to_owned()
            }
        };
        self.receipt.setting("floor", &heights, &format!("height along up: {why}"));
        let is_plain = floors.has_plane() && floors.heights.len() == 1 && floors.below < 0.02;
        if !is_plain && !floors.given {
            let what = if floors.heights.len() == 1 { "the floor is" } else { "the floors are" };
            self.progress.say(format!(
                "{what} at {heights} along up: {why} (--floor HEIGHT if it is another)"
            ));
        }
        Ok(())
    }

    /// Says and notes what the network makes of a scene that lies otherwise than it knows.
    pub fn tell(&self, alignment: &Alignment, as_is: bool) {
        let up = &alignment.up;
        let why = match (as_is, up.given) {
            (true, _) => "as is: the network takes +z for up",
            (false, true) => "up in the scene, as given",
            (false, false) => "up in the scene, by its shape",
        };
        self.receipt.setting("up", up.axis, why);
        for remark in &alignment.remarks {
            let text = match *remark {
                Remark::Turned { from } => {
                    let why =
                        "the network read a copy turned from this up to +z; files keep theirs";
                    self.receipt.setting("turned", from, why);
                    format!(
                        "up is {from}{}: the network reads a copy turned to +z; files keep their \
                         frame (--up AXIS if it is another, --as-is to leave it)",
                        if up.given { "" } else { ", by the shape of the scene" }
                    )
                }
                Remark::Scaled { by } => {
                    let why = "metres per unit; the network read a copy in metres";
                    self.receipt.setting("unit", by, why);
                    format!(
                        "one unit is {by} m: the network reads a copy in metres; files keep their \
                         unit (--unit UNIT if it is another, --as-is to leave it)"
                    )
                }
                Remark::Leveled { tilt } => {
                    let why = "degrees that the floor was off; the network read a level copy";
                    self.receipt.setting("leveled", format!("{tilt:.1}"), why);
                    format!(
                        "the floor is {tilt:.1} degrees out of level: the network reads a level \
                         copy; files keep their frame (--as-is to leave it)"
                    )
                }
                Remark::Squared { yaw } => {
                    let why =
                        "degrees that walls were off the axes; the network read a turned copy";
                    self.receipt.setting("squared", format!("{yaw:.1}"), why);
                    format!(
                        "walls are turned by {yaw:.1} degrees: the network reads a copy with its \
                         walls along the axes; files keep their frame (--as-is to leave it)"
                    )
                }
                Remark::ScaledToRoom { by, height } => {
                    let why = "metres per unit, by the height of the walls; the network read a \
                               copy in metres";
                    self.receipt.setting("unit", format!("{by:.4}"), why);
                    format!(
                        "the walls are {height:.2} units high, and no room is: the network reads a \
                         copy with {by:.3} m per unit; files keep their unit (--unit m if these \
                         are metres)"
                    )
                }
                Remark::UpUnclear { likely, confidence } => format!(
                    "WHICH WAY IS UP IS UNCLEAR ({likely} is likeliest, confidence {confidence:.2}): \
                     the network takes +z for up, and most labels are lost if it is not; say it with \
                     --up AXIS"
                ),
                Remark::UnitUnclear { likely, confidence } => format!(
                    "THE UNIT IS UNCLEAR ({} is likeliest, confidence {confidence:.2}): the network \
                     takes it for metres, and labels mean little if it is not; say it with --unit \
                     {} or --unit m",
                    likely.symbol(),
                    likely.symbol()
                ),
            };
            if remark.is_warning() {
                self.progress.say(format!("*** {text} ***"));
            } else {
                self.progress.say(&text);
            }
            // Each scene of several has its own.
            self.receipt.warning(text);
        }
    }

    /// Which way is up.
    pub fn up(&self, scene: &GaussianScene, inference: &Inference) -> UpAxis {
        inference.up.unwrap_or_else(|| guess_up(scene).axis)
    }

    /// Stops here if the user asked to.
    pub fn check_stop(&self) -> Result<()> {
        if interrupted() { Err(EncodeError::Stopped.into()) } else { Ok(()) }
    }

    /// Puts everything in place, the receipt last, and prints it.
    pub fn finish(&self) -> Result<()> {
        self.check_stop()?;
        self.put_in_place()
    }

    /// For a command that goes on until it is stopped: being stopped is its end. Writes a receipt if the user asked
    /// for one.
    pub fn finish_stopped(&self) -> Result<()> {
        if self.shared.receipt.is_some() { self.put_in_place() } else { Ok(()) }
    }

    fn put_in_place(&self) -> Result<()> {
        let written = self.written.borrow();
        let file = |(path, bytes): &(PathBuf, u64)| {
            let path = path.strip_prefix(&self.shared.out).unwrap_or(path);
            let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
            WrittenFile { path: parts.join("/"), bytes: *bytes }
        };
        self.receipt.written(written.iter().map(file).collect());
        for fallback in scenesplat::kernels::fallbacks::take() {
            self.receipt.warning(scenesplat::device::on_the_cpu(&fallback));
        }
        let report = self.receipt.finish();
        let text = report.to_json()?;
        self.outputs.commit(Some((&text, self.shared.receipt.as_deref())))?;
        self.say_written();
        if !self.shared.quiet {
            print(&report.to_string());
        }
        Ok(())
    }

    /// Puts everything in place, without a receipt unless the user asked for one.
    pub fn finish_quietly(&self) -> Result<()> {
        if self.shared.receipt.is_some() {
            return self.finish();
        }
        self.check_stop()?;
        self.outputs.commit(None)?;
        self.say_written();
        Ok(())
    }

    fn say_written(&self) {
        for (path, bytes) in self.written.borrow().iter() {
            self.progress.say(format!("wrote {} ({})", printable(path), Bytes(*bytes)));
        }
    }
}
