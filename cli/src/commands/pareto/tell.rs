//! What the command prints.

use crate::terminal::print;
use anyhow::{Result, bail};
use scenesplat_lab::pareto::{Compared, Point, Summary, seconds_text};
use std::path::Path;

/// Prints the front, the classes, the two rows, what was neutral and what bought nothing.
pub fn tell(summary: &Summary) {
    for curve in &summary.training {
        print(&format!(
            "{}: {} of {:.2} %, 99 % of it after {} of training",
            curve.name,
            curve.metric,
            100.0 * curve.best,
            seconds_text(curve.seconds_to_99)
        ));
    }
    if summary.points.is_empty() {
        return;
    }
    tell_points(summary);
    tell_neutral(summary);
    for ruled_out in &summary.skipped {
        print(&format!("not measured: {}, ruled out by {}", ruled_out.setting, ruled_out.by));
    }
    for setting in &summary.unmeasured {
        print(&format!("not measured: {setting}, time was over"));
    }
    match summary.findings.as_slice() {
        [] => print("bought nothing: none found; every dearer choice bought something"),
        found => found.iter().for_each(|f| print(&format!("bought nothing: {f}"))),
    }
}

/// Prints all points, marks the front, and says what the classes take.
fn tell_points(summary: &Summary) {
    print(&format!(
        "{:>10} {:>10} {:>9} {:>8} {:>8} {:>8} {:>7} {:>7}  setting",
        "p50", "p95", "peak MB", "f-mIoU", "mIoU", "agrees", "hit@1", "ECE"
    ));
    let mut all: Vec<&Point> = summary.all().collect();
    all.sort_by(|a, b| a.seconds_p50.total_cmp(&b.seconds_p50));
    for point in all {
        let on_front = summary.points.iter().any(|p| p.setting == point.setting);
        let is_knee = summary.knee.as_deref() == Some(&point.setting);
        let mark = if is_knee {
            "  <- knee"
        } else if on_front {
            "  *"
        } else {
            ""
        };
        print(&line(point, mark));
    }
    for point in summary.oracle.iter().chain(&summary.random_labels) {
        print(&line(point, ""));
    }
    print("* the front: no other setting is both no dearer and no worse");
    for class in &summary.classes {
        let found = class.setting.as_deref().zip(class.seconds_p50);
        let text = found.map_or("none".to_owned(), |(setting, seconds)| {
            format!("{} with {}", seconds_text(seconds), shown(setting))
        });
        print(&format!(">= {:.1} % of the reference: {text}", 100.0 * class.share));
    }
}

/// Prints whether what must not change the labels did not.
fn tell_neutral(summary: &Summary) {
    for row in &summary.neutral {
        let said = if row.equal {
            "the same labels".to_owned()
        } else {
            format!("agreement {:.4}", row.agreement.unwrap_or(f64::NAN))
        };
        let verdict = if row.holds { "holds" } else { "DOES NOT HOLD" };
        print(&format!("{} on {}: {said}; {}: {verdict}", row.neutral, row.scenes, row.rule));
    }
}

fn shown(setting: &str) -> &str {
    if setting.is_empty() { "(no part named)" } else { setting }
}

fn line(point: &Point, mark: &str) -> String {
    let percent = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{:.2}", 100.0 * v));
    format!(
        "{:>10} {:>10} {:>9.1} {:>8} {:>8} {:>8} {:>7} {:>7}  {}{mark}",
        seconds_text(point.seconds_p50),
        seconds_text(point.seconds_p95),
        point.peak_bytes / 1e6,
        percent(point.f_miou),
        percent(point.miou),
        percent(point.agreement),
        percent(point.query_hit1),
        point.ece.map_or("-".to_owned(), |v| format!("{v:.4}")),
        shown(&point.setting)
    )
}

/// Says how an earlier run compares; an error if something became worse, or slower on the same machine.
pub fn compared(found: &Compared, path: &Path) -> Result<()> {
    for setting in &found.other_conditions {
        print(&format!("against: not compared, measured under other conditions: {setting}"));
    }
    let Some([least, most]) = found.times else {
        bail!(
            "--against {}: none of its settings was measured here with this input, under the same conditions",
            path.display()
        );
    };
    let machine = if found.same_machine { "" } else { " (another machine: times are not judged)" };
    print(&format!(
        "against {}: {} settings, {} with the same labels to the last one; {least:.2} to {most:.2} times \
         the time{machine}",
        path.display(),
        found.common,
        found.same_labels
    ));
    for setting in &found.missing {
        print(&format!(
            "against: {setting} is not compared, it was not measured here with this input"
        ));
    }
    for regression in &found.regressions {
        print(&format!("against: {regression}"));
    }
    match found.failures().count() {
        0 => Ok(()),
        count => bail!("--against {}: {count} settings became worse or slower", path.display()),
    }
}
