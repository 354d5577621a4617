//! `scenesplat lift-labels`

mod depth;
mod pictures;
mod write;

use super::WrongUse;
use crate::flags::{Shared, SourceArgs, parse_up};
use crate::progress::interrupted;
use crate::session::Session;
use anyhow::{Context, Result};
use clap::ValueEnum;
use clap::builder::TypedValueParser;
use depth::DepthArg;
use pictures::Pictures;
use scenesplat::memory::Bytes;
use scenesplat::outputs::OpenedScene;
use scenesplat::rasterizer::Gaussians;
use scenesplat::rasterizer::lifting::{
    Aggregate, DepthTolerance, FinaliseSettings, LiftError, LiftSettings, Lifter, Robust,
};
use scenesplat::rasterizer::segments::{CameraMatches, SegmentFolder, SegmentOptions};
use scenesplat::scene::{Camera, UpAxis, guess_up, open_cameras};
use std::path::PathBuf;

/// Lifts the segments of pictures onto the Gaussians: writes lang_feat.npy ([N, D], f16, one row per
/// Gaussian of the file, 0 without a label), valid_feat_mask.npy, confidence.npy, views.npy,
/// coverage.npy, preview.png (coloured by the features) and a receipt.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The scene, in any format.
    pub scene: PathBuf,
    /// cameras.json, transforms.json or a COLMAP folder; pinhole cameras in the frame of the scene.
    #[arg(long, value_name = "PATH")]
    pub cameras: PathBuf,
    /// Folder with FRAME_s.npy and FRAME_f.npy, or FRAME.png with feature tables; frames are named
    /// as the cameras' pictures.
    #[arg(long, value_name = "DIR")]
    pub segments: PathBuf,
    /// Which pixels label a Gaussian.
    #[arg(long, value_enum, default_value_t = RuleArg::AlphaWeighted)]
    pub rule: RuleArg,
    /// Granularities of the maps, up to 4, comma-separated; several write into folders level-N.
    #[arg(long, value_name = "0..3", value_delimiter = ',', default_value = "0",
          value_parser = parse_level)]
    pub level: Vec<usize>,
    /// Guards against wrong labels: always, never, or if the pictures contradict each other.
    #[arg(long, value_enum, default_value_t = RobustArg::Auto)]
    pub robust: RobustArg,
    /// What guarding means.
    #[arg(long, value_enum, default_value_t = RobustRuleArg::Median)]
    pub robust_rule: RobustRuleArg,
    /// Power of the weight a picture has: 1 counts pixels, 0 gives every picture one vote.
    #[arg(long, value_name = "GAMMA", default_value_t = 1.0)]
    pub view_exponent: f32,
    /// Least labelled weight of a Gaussian, in pixels over all pictures; less gets no feature.
    #[arg(long, value_name = "TAU", default_value_t = 0.0)]
    pub coverage: f32,
    /// Least part of a Gaussian's weight that lies in segments.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    pub labelled_share: f32,
    /// Leaves out pixels this near to the border of a segment.
    #[arg(long, value_name = "PIXELS", default_value_t = 0)]
    pub erode: u32,
    /// Leaves out pixels whose depth is not the Gaussian's: `render` by the median depth of the scene
    /// itself (1 % and two standard deviations), or a folder of FRAME.npy, [H, W], 0 = unknown (3 %
    /// and 0.05 units); `auto` does what `render` does if up to 16 of the pictures, spread evenly, show
    /// in the first level that it leaves out wrong labels and keeps half of the weight (`off`
    /// with the rule centre-pixel).
    #[arg(
        long,
        value_name = "auto|off|render|DIR",
        default_value = "auto",
        value_parser = clap::builder::PathBufValueParser::new().map(DepthArg::from)
    )]
    pub depth: DepthArg,
    /// Keeps the weighted mean as it is instead of dividing it by its length.
    #[arg(long)]
    pub unnormalised: bool,
    /// Value of PNG pixels that belong to no segment; by default the largest, 255 or 65535.
    #[arg(long, value_name = "VALUE")]
    pub no_segment: Option<u16>,
    /// Memory for weights that wait (8GB, 512MB; at least 49.2 kB); more wait in a file in the output
    /// folder.
    #[arg(long, value_name = "SIZE")]
    pub max_memory: Option<Bytes>,
    /// Which way is up in the preview; judged by the scene if not given.
    #[arg(long, value_name = "AXIS", value_parser = parse_up, allow_hyphen_values = true)]
    pub up: Option<UpAxis>,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// Reads the number of a granularity.
fn parse_level(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(level @ 0..=3) => Ok(level),
        _ => Err(format!("{text:?}: levels are 0 to 3")),
    }
}

/// Which pixels count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RuleArg {
    /// All that show it, by their blending weights.
    AlphaWeighted,
    /// The one at its centre, as Occam's LGS, with the constants of gsplat 1.4.
    CentrePixel,
}

/// When to guard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RobustArg {
    /// If measured disagreement is high.
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// How to guard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RobustRuleArg {
    /// Geometric median.
    Median,
    /// The heaviest group of labels that are alike.
    HeaviestGroup,
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.shared, line)?;
    // Whatever can be wrong with flags and names is found before anything expensive.
    args.finalise(false).check().map_err(|e| WrongUse(e.to_string()))?;
    args.check_memory()?;
    for path in [&args.scene, &args.cameras, &args.segments] {
        session.outputs.reads(path)?;
    }
    let (cameras, folder, matches) = args.pictures(&session)?;
    let views = pictures::views(&cameras, &matches, &args.cameras)?;
    session.make_out(if args.level.len() == 1 { &write::FILES } else { &[] })?;
    let opened = args.open(&session)?;
    let gaussians = Gaussians::from_scene(&opened.loaded.scene)?;
    args.record(&session)?;
    let pictures = Pictures::new(&folder, pictures::paired(&views, &matches), &args.depth);
    let settings = args.settings(args.decide_depth(&session, &gaussians, &pictures)?);
    let mut lifter = args.lift(&session, &gaussians, &pictures, &settings)?;
    for (number, &level) in args.level.iter().enumerate() {
        let robust = args.decide(&session, &mut lifter, number, level)?;
        args.write(&session, &opened, &mut lifter, number, level, robust)?;
    }
    session.finish()
}

impl Args {
    /// Refuses a limit that could not be kept.
    fn check_memory(&self) -> Result<()> {
        // Trying depth agreement takes two lists of weights.
        let least = Bytes(LiftSettings::least_memory(self.level.len().max(2)));
        match self.max_memory {
            Some(limit) if limit < least => {
                let text = format!("--max-memory {limit}: weights need at least {least}");
                Err(WrongUse(text).into())
            }
            _ => Ok(()),
        }
    }

    /// Cameras and the frames that belong to them.
    fn pictures(
        &self,
        session: &Session<'_>,
    ) -> Result<(Vec<Camera>, SegmentFolder, CameraMatches)> {
        let _stage = session.receipt.stage("pictures");
        let set = open_cameras(&self.cameras)?;
        for note in &set.notes {
            session.progress.say(note);
        }
        let options =
            SegmentOptions { levels: self.level.clone(), png_no_segment: self.no_segment };
        let folder = SegmentFolder::open(&self.segments, options)?;
        let names: Vec<&str> = set.cameras.iter().map(|c| c.name.as_str()).collect();
        let matches = folder.match_cameras(&names)?;
        let text = format!(
            "{} cameras, {} frames, {} with both",
            names.len(),
            folder.len(),
            matches.num_matched()
        );
        session.progress.say(&text);
        if let Some(frame) = matches.without_camera.first() {
            let count = matches.without_camera.len();
            session.receipt.warning(format!("{count} frames have no camera ({frame}, …)"));
        }
        if let Some(camera) = names.iter().zip(&matches.frames).find(|(_, f)| f.is_none()) {
            let count = names.len() - matches.num_matched();
            session.receipt.warning(format!("{count} cameras have no segments ({}, …)", camera.0));
        }
        session.receipt.setting("pictures", matches.num_matched(), "cameras with segments");
        Ok((set.cameras, folder, matches))
    }

    fn open(&self, session: &Session<'_>) -> Result<OpenedScene> {
        let _stage = session.receipt.stage("read");
        let opened = session.read(&self.scene, &self.source.options())?;
        if !opened.loaded.report.is_clean() {
            let text = opened.loaded.report.to_string();
            session.progress.say(&text);
            session.receipt.warning(text);
        }
        session.receipt.add_rows_in(opened.loaded.source_rows());
        session.receipt.fingerprint("input", &self.scene)?;
        // A folder may hold the pictures, too.
        if self.cameras.is_file() {
            session.receipt.fingerprint("cameras", &self.cameras)?;
        }
        Ok(opened)
    }

    /// Notes in the receipt what changes the result.
    fn record(&self, session: &Session<'_>) -> Result<()> {
        let receipt = &session.receipt;
        let rule = self.rule.to_possible_value().map_or(String::new(), |v| v.get_name().to_owned());
        receipt.setting("rule", rule, "which pixels label a Gaussian");
        receipt.setting("segments", self.segments.display(), "maps and features");
        if self.erode > 0 {
            receipt.setting("erode", self.erode, "pixels along borders that label nothing");
        }
        if self.coverage > 0.0 {
            receipt.setting("coverage", self.coverage, "least labelled weight, pixels");
        }
        if self.labelled_share > 0.0 {
            receipt.setting("labelled_share", self.labelled_share, "least labelled part");
        }
        Ok(())
    }

    fn settings(&self, depth: Option<DepthTolerance>) -> LiftSettings {
        let base = match self.rule {
            RuleArg::AlphaWeighted => LiftSettings::default(),
            RuleArg::CentrePixel => LiftSettings::centre_pixel(),
        };
        LiftSettings {
            erosion: self.erode,
            depth,
            memory: self.max_memory.map_or(base.memory, |b| b.0),
            spill_folder: self.shared.out.clone(),
            ..base
        }
    }

    fn finalise(&self, robust: bool) -> FinaliseSettings {
        let base = if robust { FinaliseSettings::robust() } else { FinaliseSettings::default() };
        let aggregate = match self.robust_rule {
            RobustRuleArg::HeaviestGroup if robust => Aggregate::HEAVIEST_GROUP,
            _ => base.aggregate,
        };
        FinaliseSettings {
            aggregate,
            view_exponent: self.view_exponent,
            min_coverage: self.coverage,
            min_labelled_share: self.labelled_share,
            normalise: !self.unnormalised,
        }
    }

    /// Collects the weights of all pictures.
    fn lift<'a>(
        &self,
        session: &Session<'_>,
        gaussians: &'a Gaussians,
        pictures: &Pictures<'_>,
        settings: &LiftSettings,
    ) -> Result<Lifter<'a>> {
        let _stage = session.receipt.stage("lift");
        let mut lifter: Option<Lifter<'a>> = None;
        let (mut without_feature, mut weight, mut labelled) = (0, 0.0, 0.0);
        for number in 0..pictures.len() {
            session.check_stop()?;
            session.progress.advance("lifting", number as f64 / pictures.len() as f64);
            let picture = pictures.read(number)?;
            let lifter = match &mut lifter {
                Some(lifter) => lifter,
                none => {
                    let (levels, dim) = (self.level.len(), picture.segments.dim);
                    none.insert(Lifter::new(gaussians, levels, dim, settings.clone())?)
                }
            };
            picture.check_dim(lifter.tables().dim())?;
            let report = lifter
                .add(&picture.labelled())
                .with_context(|| format!("frame {}", picture.name))?;
            without_feature += report.without_feature;
            weight += report.weight;
            labelled += report.labelled.first().copied().unwrap_or(0.0);
        }
        session.progress.finish();
        let lifter = lifter.context("no camera has segments")?;
        anyhow::ensure!(
            !lifter.tables().is_empty(),
            "{}: no picture has a segment with a feature",
            self.segments.display()
        );
        if without_feature > 0 {
            let text =
                format!("{without_feature} segments have a feature of zeros: they label nothing");
            session.receipt.warning(text);
        }
        session.progress.say(format!(
            "{} segments, {} weights ({} on disk), {:.1} % of the weight is in segments",
            lifter.tables().len(),
            lifter.num_weights(),
            Bytes(lifter.bytes_on_disk()),
            100.0 * labelled / f64::max(weight, 1e-9)
        ));
        Ok(lifter)
    }

    /// Whether to guard against wrong labels, by what was measured.
    fn decide(
        &self,
        session: &Session<'_>,
        lifter: &mut Lifter<'_>,
        number: usize,
        level: usize,
    ) -> Result<bool> {
        let _stage = session.receipt.stage("disagreement");
        let rule = match self.robust {
            RobustArg::Auto => Robust::default(),
            RobustArg::On => Robust::On,
            RobustArg::Off => Robust::Off,
        };
        let measured = lifter.disagreement(number)?;
        let robust = rule.decide(measured.value());
        let figure = measured.value().map_or("unknown".to_owned(), |v| format!("{v:.3}"));
        session.progress.say(format!(
            "level {level}: disagreement between pictures {figure} on {} Gaussians; {}",
            measured.gaussians(),
            if robust { "guarding against wrong labels" } else { "taking the weighted mean" }
        ));
        let why = "variance of a Gaussian's labels over pictures, of that of all labels";
        session.receipt.setting(&format!("disagreement[{level}]"), figure, why);
        session.receipt.setting(
            &format!("robust[{level}]"),
            robust,
            "by --robust and the measurement",
        );
        Ok(robust)
    }

    /// Makes the features of one level and writes all files.
    fn write(
        &self,
        session: &Session<'_>,
        opened: &OpenedScene,
        lifter: &mut Lifter<'_>,
        number: usize,
        level: usize,
        robust: bool,
    ) -> Result<()> {
        let folder = match self.level.len() {
            1 => session.outputs.main_folder()?,
            _ => session.outputs.inner_folder(&format!("level-{level}"))?,
        };
        let stage = session.receipt.stage("features");
        let mut writer = write::Writer::new(opened, &folder, lifter.tables())?;
        let rows = opened.loaded.scene.len().max(1);
        lifter.features(number, &self.finalise(robust), |block| {
            if interrupted() {
                return Err(LiftError::Stopped);
            }
            session.progress.advance("features", block.first as f64 / rows as f64);
            writer.add(&block)
        })?;
        session.progress.finish();
        let written = writer.finish()?;
        drop(stage);
        for (path, bytes) in &written.files {
            session.wrote(path, *bytes);
        }
        session.receipt.add_rows_out(opened.loaded.source_rows());
        session.progress.say(format!(
            "level {level}: {} of {} Gaussians have a feature; mean confidence {:.3}, seen by {:.1} \
             pictures on average",
            written.valid,
            opened.loaded.scene.len(),
            written.mean_confidence,
            written.mean_views
        ));
        session.check_stop()?;
        let _stage = session.receipt.stage("picture");
        let name = self.scene.file_name().unwrap_or_default().to_string_lossy();
        let title = format!("{name}: lifted labels (principal components as colours)");
        let scene = &opened.loaded.scene;
        let up = self.up.unwrap_or_else(|| guess_up(scene).axis);
        let path = folder.join("preview.png");
        let bytes = scenesplat::outputs::write_scene_preview(
            scene,
            &written.colors,
            &[],
            &title,
            up,
            &path,
        )?;
        session.wrote(&path, bytes);
        Ok(())
    }
}
