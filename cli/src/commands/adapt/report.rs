//! What is said of an adaptation, and what its record says.

use super::{Args, FIGURES, Lesson};
use crate::session::Session;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::Network;
use scenesplat::adaptation::{Figures, Right};
use scenesplat::calibration::Calibration;
use scenesplat::network::Weights;
use serde_json::json;

/// Below this part of rooms that is right, a network reads another vocabulary.
const STRANGER: f64 = 0.1;
/// Classes that are listed.
const SHOWN: usize = 12;

/// Records the weights that are started from.
pub fn note_weights(session: &Session<'_>, network: &Network, args: &Args) {
    for (path, sha256) in network.files() {
        let bytes = std::fs::metadata(path).map_or(0, |about| about.len());
        session.receipt.fingerprint_known("weights", path, bytes, sha256);
    }
    if args.weights == Weights::Embedded {
        let sha256 = scenesplat::embedded::sha256();
        session.receipt.setting("weights", scenesplat::embedded::NAME, &sha256);
    }
}

/// Warns where a network seems to be read with other texts.
pub fn warn_of_strangers(session: &Session<'_>, before: &Figures) {
    let right = before.rooms.and_then(|rooms| rooms.all.share());
    if let Some(right) = right.filter(|right| *right < STRANGER) {
        session.warn(format!(
            "only {:.1} % of synthetic rooms are right by the built-in vocabulary: these weights seem to be read with other texts",
            100.0 * right
        ));
    }
}

/// One line of the table.
struct Row {
    name: String,
    /// Part that is right before and after, 0..=1.
    values: [Option<f64>; 2],
}

/// The lines of the table.
fn rows(figures: [&Figures; 2]) -> Vec<Row> {
    let mut rows = Vec::new();
    let mut right = |name: &str, of: &dyn Fn(&Figures) -> Option<Right>| {
        let both = figures.map(of);
        if let Some(found) = both[0].filter(|found| found.rows > 0) {
            let name = format!("{name} ({})", found.rows);
            rows.push(Row { name, values: both.map(|found| found?.share()) });
        }
    };
    right("labels that were learned", &|f| Some(f.learned));
    right("labels held out", &|f| Some(f.held_out));
    let classes = &figures[0].held_out_classes;
    for (class, _) in classes.iter().take(SHOWN) {
        right(&format!("  {class}"), &|f| {
            f.held_out_classes.iter().find(|(name, _)| name == class).map(|(_, right)| *right)
        });
    }
    right("truth of the scene", &|f| f.truth.map(|truth| truth.all));
    right("  where a label was learned", &|f| f.truth.map(|truth| truth.labeled));
    right("  elsewhere", &|f| f.truth.map(|truth| truth.unlabeled));
    right("  classes that labels name", &|f| f.truth.map(|truth| truth.known));
    right("  other classes", &|f| f.truth.map(|truth| truth.others));
    let mut share = |name: &str, of: &dyn Fn(&Figures) -> Option<f64>| {
        let values = figures.map(of);
        if values[0].is_some() {
            rows.push(Row { name: name.to_owned(), values });
        }
    };
    share("  f-mIoU", &|f| f.truth?.f_miou);
    if let Some(rooms) = figures[0].rooms {
        share(&format!("{} synthetic rooms", rooms.rooms), &|f| f.rooms?.all.share());
        share("  f-mIoU", &|f| f.rooms?.f_miou);
        share("  mIoU of classes that labels name", &|f| f.rooms?.known);
        share("  mIoU of other classes", &|f| f.rooms?.others);
    }
    rows
}

fn percent(value: Option<f64>) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{:.1}", 100.0 * value))
}

/// Prints what the network knew and knows, and how it is used.
pub fn tell(args: &Args, lesson: &Lesson, figures: [&Figures; 2], calibration: &Calibration) {
    let rows = rows(figures);
    let width = rows.iter().map(|row| row.name.chars().count()).max().unwrap_or(0);
    print(&format!("{:width$}  before   after", "right, %"));
    for Row { name, values: [before, after] } in rows {
        print(&format!("{name:width$}  {:>6}  {:>6}", percent(before), percent(after)));
    }
    let more = figures[0].held_out_classes.len().saturating_sub(SHOWN);
    if more > 0 {
        print(&format!("{more} more classes were held out: {FIGURES}"));
    }
    let dim = lesson.texts.dim;
    let own = scenesplat::embedded::vocabulary().is_ok_and(|own| own.dim() == dim);
    let texts = if own { "vocabulary".to_owned() } else { format!("vocabulary:{dim}") };
    print(&format!("use it with --weights {} --text {texts}", args.shared.out.display()));
    if let Some(flags) = lesson.flags() {
        print(&format!("and, as it was found out by the network before, with {flags}"));
    }
    print(&format!(
        "its probabilities are calibrated anew on synthetic rooms (off by {:.1} %). What was measured on the network inside the \
         program alone is no more said: --strange, costs of effects, up and unit where the scene's shape leaves them open",
        100.0 * calibration.ece
    ));
}

/// Writes the figures, and notes them in the receipt.
pub fn write(
    session: &Session<'_>,
    args: &Args,
    lesson: &Lesson,
    [before, after]: [&Figures; 2],
) -> Result<()> {
    let receipt = &session.receipt;
    let settings = args.settings();
    receipt.setting("steps", settings.steps, "of a part of the scene and a part of a room each");
    receipt.setting("seed", settings.seed, "order, augmentation, rooms, held-out labels");
    receipt.setting("lr", settings.lr, "largest learning rate");
    receipt.setting("held_out", settings.held_out, "share of the labels that are compared with");
    receipt.setting(
        "share",
        settings.share,
        "how far weights go from those before to those trained",
    );
    let mut group = String::new();
    for row in rows([before, after]) {
        let name = row.name.trim();
        if !row.name.starts_with(' ') {
            group = name.to_owned();
        }
        let inner = row.name.starts_with(' ').then(|| format!("{group}: {name}"));
        let values = row.values.map(percent).join(" to ");
        receipt.setting(
            &inner.unwrap_or_else(|| name.to_owned()),
            values,
            "right before and after, %",
        );
    }
    let json = json!({
        "known": lesson.known(),
        "settings": settings,
        "up": lesson.alignment.turned_from.to_string(),
        "metres_per_unit": lesson.alignment.scale,
        "flags": lesson.flags(),
        "before": before,
        "after": after,
    });
    session.write_text(FIGURES, &serde_json::to_string_pretty(&json)?)
}
