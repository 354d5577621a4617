//! The first lines that a command prints: what was found, and how far it is to be trusted.

use crate::receipt::thousands;
use crate::session::Session;
use scenesplat::outputs::legend;
use scenesplat::scene::printable;
use std::path::Path;

/// Classes that are named; of more it says how many.
const MOST_CLASSES: usize = 6;
/// Letters of a name that are shown.
const LONGEST_NAME: usize = 40;

/// How much of a scene has a label, and the classes with their shares, the largest first.
pub fn labels(name: &str, labels: &[i32], names: &[String]) -> String {
    let labelled = labels.iter().filter(|label| **label >= 0).count();
    let mut classes = legend(labels, names);
    classes.retain(|class| names.contains(&class.name));
    classes.sort_by_key(|class| std::cmp::Reverse(class.count));
    let share = |count: u64| 100.0 * count as f64 / labels.len().max(1) as f64;
    let shown = classes.iter().take(MOST_CLASSES);
    let shown = shown.map(|class| format!("{} {:.0} %", short(&class.name), share(class.count)));
    let mut shown = shown.collect::<Vec<_>>().join(", ");
    if classes.len() > MOST_CLASSES {
        shown += &format!(" and {} more", classes.len() - MOST_CLASSES);
    }
    format!(
        "{}: {} of {} Gaussians labeled, {} classes{}{shown}",
        printable(name),
        thousands(labelled as u64),
        thousands(labels.len() as u64),
        classes.len(),
        if classes.is_empty() { "" } else { ": " },
    )
}

/// How the network read the scene, and how far the labels are to be trusted; `None` where no network was run.
pub fn certainty(session: &Session<'_>) -> Option<String> {
    let receipt = &session.receipt;
    let up = receipt.setting_of("up")?;
    let unit = receipt.setting_of("unit").map_or("meters".to_owned(), |unit| format!("{unit} m"));
    let mut text = format!("read with {up} up, one unit as {unit}");
    if let Some(share) = receipt.setting_of("known").and_then(|share| share.parse::<f64>().ok()) {
        text += &format!("; {:.0} % of it is like the rooms of the training", 100.0 * share);
    }
    match session.doubts().len() {
        0 => {}
        1 => text += "; DOUBTFUL, see the warning",
        count => text += &format!("; DOUBTFUL, see {count} warnings"),
    }
    Some(text)
}

/// What to run next with a scene: command lines, each without the program's name, `SCENE` for its path.
pub fn next(scene: &Path, lines: &[&str]) -> String {
    let path = printable(scene);
    let path = if path.contains(char::is_whitespace) { format!("\"{path}\"") } else { path.into() };
    let each = lines.iter().map(|line| format!("scenesplat {}", line.replace("SCENE", &path)));
    format!("next: {}", each.collect::<Vec<_>>().join(" | "))
}

/// A name that does not fill the line.
pub fn short(name: &str) -> String {
    let name = printable(name);
    match name.char_indices().nth(LONGEST_NAME) {
        Some((end, _)) => format!("{}…", &name[..end]),
        None => name.into_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_counted_and_the_largest_come_first() {
        let names: Vec<String> = (0..9).map(|i| format!("c{i}")).collect();
        // Class i has i + 1 Gaussians; 45 of 50 have one.
        let mut all: Vec<i32> = (0..9).flat_map(|i| vec![i; i as usize + 1]).collect();
        all.extend([-1; 5]);
        assert_eq!(
            labels("a\nb.ply", &all, &names),
            "a\\nb.ply: 45 of 50 Gaussians labeled, 9 classes: c8 18 %, c7 16 %, c6 14 %, c5 12 %, c4 10 %, c3 8 % and 3 more"
        );
        assert_eq!(labels("x", &[-1, -1], &names), "x: 0 of 2 Gaussians labeled, 0 classes");
        assert_eq!(labels("x", &[], &[]), "x: 0 of 0 Gaussians labeled, 0 classes");
    }

    #[test]
    fn lines_to_run_next_name_the_scene_as_a_shell_reads_it() {
        let lines = ["view SCENE", "query SCENE \"chair\""];
        assert_eq!(
            next(Path::new("my room.ply"), &lines),
            "next: scenesplat view \"my room.ply\" | scenesplat query \"my room.ply\" \"chair\""
        );
        assert!(next(Path::new("a.ply"), &lines).contains("view a.ply |"));
    }

    #[test]
    fn long_names_are_cut() {
        assert_eq!(short("chair"), "chair");
        let long = short(&"ä".repeat(400));
        assert!(long.chars().count() == LONGEST_NAME + 1 && long.ends_with('…'), "{long}");
    }
}
