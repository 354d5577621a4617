//! `scenesplat view`

use super::labelled::{LabelArgs, LabelOrigin, Labelled};
use super::objects::left_out;
use crate::error::refuse;
use crate::flags::{Running, Shared};
use crate::frame::frame;
use crate::progress::interrupted;
use crate::session::Session;
use crate::terminal::{check_output, print};
use anyhow::Result;
use scenesplat::embedded;
use scenesplat::memory::Bytes;
use scenesplat::objects::Catalogue;
use scenesplat::page::{
    PageInput, PageReport, PageServer, PageSettings, Refusal, ServeEvent, ServedPage, write_page,
};
use scenesplat::scene::printable_text;
use std::path::{Path, PathBuf};

/// Writes one HTML file to look at a scene and to query it: it opens from disk in any browser with WebGL 2, without a
/// server, and loads nothing from anywhere. With --serve there is no file: the page is given in chunks to a browser on
/// this machine, for scenes too large for a file, until Ctrl-C.
///
/// Labels, objects and language codes are those of segment and objects, or with --label-names the scene's own labels;
/// typed phrases are answered in the page (docs/view.md).
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// Where labels come from.
    #[command(flatten)]
    pub labels: LabelArgs,
    /// The page. [default: scene.html]
    #[arg(long, value_name = "FILE.html", conflicts_with = "serve")]
    pub out: Option<PathBuf>,
    /// Writes no file: gives the page to a browser on this machine, at an address on 127.0.0.1 that is printed and
    /// that nobody else knows, until Ctrl-C.
    #[arg(long)]
    pub serve: bool,
    /// The port for --serve; 0 for any free one.
    #[arg(long, value_name = "N", default_value_t = 0, requires = "serve")]
    pub port: u16,
    /// Shows the Gaussians alone: no labels, no network.
    #[arg(long, conflicts_with_all = ["label_names", "features"])]
    pub plain: bool,
    /// Numbers of a language code of a Gaussian, 1 to 32.
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u8).range(1..=32))]
    pub codes: u8,
    /// Keeps so many Gaussians, those that are seen most.
    #[arg(long, value_name = "N")]
    pub max_splats: Option<usize>,
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
    /// Also writes what was done and what it cost as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub receipt: Option<PathBuf>,
}

const DEFAULT_OUT: &str = "scene.html";
/// From this size on browsers take long to open a page.
const LARGE: u64 = 150 << 20;
/// Requests without an answer that are told one by one.
const MOST_TOLD: usize = 10;

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let labels = &LabelArgs { labelling: args.labels.labelling.settled()?, ..args.labels.clone() };
    let inference = &labels.labelling.inference;
    let shared = args.shared();
    let session = Session::start_network(&shared, inference, None, line)?;
    labels.claim_inputs(&session)?;
    let out = args.out.as_deref().unwrap_or(Path::new(DEFAULT_OUT));
    if !args.serve {
        session.outputs.claim("--out", out)?;
    }
    let name = labels.scene.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let settings = PageSettings { codes: usize::from(args.codes), max_splats: args.max_splats };
    if settings.max_splats == Some(0) {
        refuse!("--max-splats: give a number above 0");
    }
    // A port that is taken is better known before the work than after.
    let server = if args.serve { Some(PageServer::bind(args.port)?) } else { None };
    let labelled =
        if args.plain { plain(labels, &session)? } else { labels.label(&session, false)? };
    let frame = frame(&session, &labelled.opened, inference);
    let objects = || labelled.objects(&session, &labels.settings(), labels.pieces, frame);
    let found = (!args.plain).then(objects).transpose()?;
    session.check_stop()?;
    // Of the width of the texts, which --text vocabulary:D sets.
    let vocabulary = match labelled.is_vocabulary {
        true => Some(labels.labelling.classes.vocabulary()?.map_or_else(embedded::vocabulary, Ok)?),
        false => None,
    };
    let remarks = remarks(args, &labelled, found.as_ref());
    let stage = session.receipt.stage("page");
    let input = PageInput {
        title: &name,
        scene: &labelled.opened.loaded.scene,
        labels: (!args.plain).then_some(&labelled.labels[..]),
        scores: labelled.scores.as_deref(),
        names: &labelled.names,
        catalogue: found.as_ref(),
        features: labelled.features.as_ref().map(|(features, text)| (features, text)),
        vocabulary: vocabulary.as_ref(),
        upright: frame.upright,
        metres_per_unit: frame.metres_per_unit,
        warnings: &session.doubts(),
        remarks: &remarks,
    };
    let Some(server) = server else {
        let waiting = session.outputs.file_path(out)?;
        let report = write_page(&waiting, &input, &settings)?;
        session.wrote(&waiting, report.bytes);
        tell_file(&session, out, &report, args);
        drop(stage);
        return session.finish_quietly();
    };
    let page = ServedPage::new(&input, &settings)?;
    // The page has all it needs; a large scene need not stay twice.
    drop((remarks, found, labelled));
    session.receipt.add_rows_out(page.report().gaussians);
    print(&format!("{}: {}", printable_text(&name), summary(page.report(), args)));
    drop(stage);
    session.check_stop()?;
    serve(&session, &server, &page)
}

/// Says what the file of a page holds.
fn tell_file(session: &Session<'_>, out: &Path, report: &PageReport, args: &Args) {
    session.receipt.add_rows_out(report.gaussians);
    print(&format!("{}: {}; opens from disk", out.display(), summary(report, args)));
    if report.bytes > LARGE {
        session.warn(
            "the page is large for a browser: --max-splats N or fewer --codes make it smaller, \
                    --serve shows it without a file",
        );
    }
}

/// What the page holds, in a line.
fn summary(report: &PageReport, args: &Args) -> String {
    let codes = report.code_cosine.map_or(String::new(), |c| {
        format!(", {} code numbers a Gaussian (mean cosine {c:.4})", args.codes)
    });
    let left_out = match report.left_out {
        0 => String::new(),
        n => format!(", {n} Gaussians left out"),
    };
    let relations = match report.relations_left_out {
        0 => String::new(),
        n => format!(", {n} of {} relations left out", report.relations),
    };
    format!(
        "{} Gaussians, {}{codes}{left_out}{relations}; positions to {:.1e} units",
        report.gaussians,
        Bytes(report.bytes),
        report.position_step / 2.0
    )
}

/// Gives the page to browsers until Ctrl-C, which is the end of it and no error.
fn serve(session: &Session<'_>, server: &PageServer, page: &ServedPage) -> Result<()> {
    let _stage = session.receipt.stage("serve");
    // The address is the result, whatever --quiet says.
    print(&format!("open {} in a browser on this machine; Ctrl-C ends", server.url()));
    check_output()?;
    let mut told = 0;
    let mut refused = 0;
    let mut event = |event: ServeEvent| match event {
        ServeEvent::Opened => {
            told = 0;
            session.progress.say("a browser opened the page");
        }
        ServeEvent::Sent { sent, total } => {
            let tenths = (10 * sent).checked_div(total).unwrap_or(10);
            if tenths > told {
                told = tenths;
                let part = format!("sent {} of {}", Bytes(sent.min(total)), Bytes(total));
                session.progress.say(match sent >= total {
                    true => format!("{part}: the page needs this program no longer"),
                    false => part,
                });
            }
        }
        ServeEvent::Refused(Refusal { status, why }) => {
            refused += 1;
            if refused <= MOST_TOLD {
                session.progress.say(format!("a request got nothing ({status}): {why}"));
            }
            if refused == MOST_TOLD {
                session
                    .progress
                    .say("of further such requests only the number is said, at the end");
            }
        }
        _ => {}
    };
    let served = server.run(page, &interrupted, &mut event)?;
    let text = format!(
        "opened {} times, {} sent, {} requests got nothing",
        served.pages,
        Bytes(served.bytes),
        served.refused
    );
    session.receipt.setting("served", &text, "until it was stopped");
    print(&text);
    drop(_stage);
    session.finish_stopped()
}

/// The Gaussians without labels.
fn plain(labels: &LabelArgs, session: &Session<'_>) -> Result<Labelled> {
    let inference = &labels.labelling.inference;
    // Without labels no height is measured.
    let floor = inference.floor.map(|_| "--floor");
    if let Some(flag) = inference.only_network_flag().or(floor) {
        refuse!("{flag} is about a network, which --plain leaves out");
    }
    if inference.network.weights.is_some() || inference.network.config.is_some() {
        refuse!("--plain runs no network: leave out --weights and --config");
    }
    let opened = session.open_with(&labels.scene, &inference.source.options())?;
    Ok(Labelled {
        opened,
        labels: Vec::new(),
        scores: None,
        names: Vec::new(),
        features: None,
        is_vocabulary: false,
        origin: LabelOrigin::Scene,
        effects: Vec::new(),
        remark: "",
    })
}

/// What a reader of the page has to know.
fn remarks(args: &Args, labelled: &Labelled, found: Option<&Catalogue>) -> Vec<String> {
    let mut out = Vec::new();
    if !args.plain {
        let from = match labelled.origin {
            LabelOrigin::Scene => "Labels: those that the scene carries.",
            LabelOrigin::Embedded => {
                "Labels: a small network trained on synthetic rooms; it knows a closed set of classes (assets/embedded/README.md)."
            }
            LabelOrigin::Network => "Labels: those of the network that was given.",
            LabelOrigin::Features => "Labels: those nearest to the features that were given.",
        };
        out.push(from.to_owned());
        if found.is_some_and(|found| found.is_carried) {
            out.push("Objects: the instances that the scene carries.".to_owned());
        }
    }
    out.extend(labelled.effects.iter().map(|effect| format!("Effect of the capture: {effect}.")));
    if let Some(text) = found.map(left_out).filter(|text| !text.is_empty()) {
        out.push(format!("Objects{text}."));
    }
    if labelled.opened.loaded.scene.antialiased {
        let text = "The scene was trained for antialiased rendering, which this page does not do: small things \
                    look too solid from afar (render does it).";
        out.push(text.to_owned());
    }
    out.push("Colors are those of the zeroth harmonic, seen from every side alike.".to_owned());
    out
}

impl Args {
    fn shared(&self) -> Shared {
        let out = self.out.as_deref().and_then(Path::parent);
        let folder = out.filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Shared {
            running: self.running.clone(),
            out: folder.to_owned(),
            receipt: self.receipt.clone(),
        }
    }
}
