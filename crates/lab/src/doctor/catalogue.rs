//! All cases, in one table.

use super::case::{Case, Level};
use super::{inputs, operators, scenes, training};
use scenesplat_scene::label_set;
use std::fmt::Write;

/// Every hard case, level by level.
pub fn catalogue() -> Vec<Case> {
    let mut cases = inputs::cases();
    cases.extend(operators::cases());
    cases.extend(training::cases());
    cases.extend(scenes::cases());
    cases
}

/// The names most like one that no case has, best first.
pub fn nearest_names(name: &str) -> Vec<String> {
    const SUGGESTIONS: usize = 5;
    let names: Vec<String> = catalogue().into_iter().map(|case| case.name).collect();
    label_set::nearest_names(&names, name, SUGGESTIONS).into_iter().map(str::to_owned).collect()
}

/// The table as the documentation shows it.
pub fn markdown() -> String {
    let cases = catalogue();
    let mut text = String::new();
    for level in Level::ALL {
        let of_level: Vec<&Case> = cases.iter().filter(|case| case.level == level).collect();
        let quick = of_level.iter().filter(|case| case.quick).count();
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "## Level {}: {level}\n\n{} cases, {quick} of them in the quick subset (·).\n",
            level.number(),
            of_level.len()
        );
        text +=
            "| case | about | expected | tolerance, and why | origin |\n|---|---|---|---|---|\n";
        for case in of_level {
            let quick = if case.quick { " ·" } else { "" };
            let _ = writeln!(
                text,
                "| `{}`{quick} | {} | {} | {} | {} |",
                case.name,
                case.area,
                case.policy,
                tolerance(case),
                cell(case.origin)
            );
        }
        text.push('\n');
    }
    text + &super::attacks::markdown()
}

fn tolerance(case: &Case) -> String {
    match case.tolerance {
        0.0 => format!("0: {}", cell(case.reason)),
        t => format!("{t:e}: {}", cell(case.reason)),
    }
}

/// Text that does not end its cell.
fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}
