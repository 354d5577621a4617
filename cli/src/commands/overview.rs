//! The commands in groups, an example of each, and the help that shows them.

use clap::builder::styling::Styles;
use clap::{Arg, Command};

/// One command, or one part of a command.
struct Row {
    /// What the user is about; empty for a part of a command.
    group: &'static str,
    /// The names on the command line.
    path: &'static str,
    /// A command line that works once its files are there.
    example: &'static str,
}

const fn row(group: &'static str, path: &'static str, example: &'static str) -> Row {
    Row { group, path, example }
}

/// All commands, in the order in which the help shows them.
const ROWS: [Row; 38] = [
    row("Look", "inspect", "scenesplat inspect scene.ply --json scene.json"),
    row("Look", "view", "scenesplat view room.ply --out room.html"),
    row("Look", "app", "scenesplat app --out scenesplat.html"),
    row("Look", "serve", "scenesplat serve room.ply --mcp"),
    row("Look", "render", "scenesplat render scene.ply --cameras cameras.json --out pictures"),
    row("Look", "convert", "scenesplat convert scene.ply scene.spz --remove-floaters"),
    row("Label", "demo", "scenesplat demo"),
    row("Label", "segment", "scenesplat segment room.ply --without ceiling --out labels"),
    row("Label", "room", "scenesplat room scans/kitchen --out kitchen"),
    row("Label", "query", "scenesplat query room.ply \"red chair\""),
    row("Label", "objects", "scenesplat objects room.ply --min-count 50"),
    row(
        "Label",
        "features",
        "scenesplat features scene.ply --weights model.pth --config language --out features",
    ),
    row("Label", "text", "scenesplat text sofa \"office chair\""),
    row(
        "Label",
        "collect-labels",
        "scenesplat collect-labels scene.ply --cameras cameras.json --images photos",
    ),
    row(
        "Label",
        "lift-labels",
        "scenesplat lift-labels scene.ply --cameras cameras.json --segments masks",
    ),
    row("Measure", "evaluate", "scenesplat evaluate synthetic:5:777 --json figures.json"),
    row("Measure", "merge", "scenesplat merge labels"),
    row("Measure", "compare", "scenesplat compare rendered photos"),
    row(
        "Measure",
        "simulate",
        "scenesplat simulate room.ply --effect holes=2,blur=1 --out damaged",
    ),
    row("Measure", "probe", "scenesplat probe runs/mine/model synthetic:8:1"),
    row("Measure", "reconstruct", "scenesplat reconstruct runs/mine room.ply"),
    row(
        "Measure",
        "pareto",
        "scenesplat pareto --grid grid.toml --scenes synthetic:5:777 --out front",
    ),
    row(
        "Train",
        "train",
        "scenesplat train experiment.toml --set optimizer.lr=1e-3 --out runs/mine",
    ),
    row("Train", "adapt", "scenesplat adapt kitchen.ply --labels taught --out adapted"),
    row(
        "Train",
        "prepare",
        "scenesplat prepare scan scene.ply --scan scene0000_00 --layout scannet --out prepared",
    ),
    row(
        "",
        "prepare scan",
        "scenesplat prepare scan scene.ply --scan scene0000_00 --layout scannet --out prepared",
    ),
    row("", "prepare chunks", "scenesplat prepare chunks scenes chunks"),
    row(
        "",
        "prepare frames",
        "scenesplat prepare frames scene0000_00.sens --layout scannet --every 10",
    ),
    row("Train", "chunk", "scenesplat chunk scenes --out chunks"),
    row("Train", "codes", "scenesplat codes runs/codes/model scenes/kitchen --out coded"),
    row("Train", "weights", "scenesplat weights model.pth"),
    row("Train", "schema", "scenesplat schema train > train.schema.json"),
    row(
        "Pictures",
        "optimise",
        "scenesplat optimise --cameras sparse/0 --images photos --out scene",
    ),
    row("Pictures", "curate", "scenesplat curate --cameras sparse/0 --images photos"),
    row("System", "bench", "scenesplat bench --quick"),
    row("System", "doctor", "scenesplat doctor --report"),
    row("System", "completions", "scenesplat completions zsh > _scenesplat"),
    row("System", "man", "scenesplat man --out man1"),
];

/// The exit codes, below the help of the program.
const EXIT_CODES: &str = "Exit codes: 0 done, 1 failed, 2 wrong use, 3 some of many scenes failed, 4 a training was \
                          stopped and saved";

/// The command with groups in its help, and with an example in the help of each command in it.
pub fn dressed(command: Command) -> Command {
    let mut command = with_examples(command, &mut Vec::new());
    command = command.after_help(EXIT_CODES);
    let header = Styles::styled();
    let header = header.get_header();
    let heading = |text: &str| format!("{header}{text}:{header:#}\n");
    let mut template = "{about-with-newline}\n{usage-heading} {usage}\n\n".to_owned();
    for group in groups() {
        template += &heading(group);
        for (name, about) in of_group(&command, group) {
            template += &format!("  {name:NAME_WIDTH$}  {about}\n");
        }
        template.push('\n');
    }
    template += &heading("Options");
    template += "{options}{after-help}";
    command.help_template(template)
}

/// Characters of the longest name.
const NAME_WIDTH: usize = 14;

/// The groups, in order.
fn groups() -> Vec<&'static str> {
    let mut groups: Vec<&str> =
        ROWS.iter().map(|row| row.group).filter(|g| !g.is_empty()).collect();
    groups.dedup();
    groups
}

/// Names and first lines of the help of the commands of a group.
fn of_group(command: &Command, group: &str) -> Vec<(String, String)> {
    let of = |name: &str| {
        let found = command.find_subcommand(name);
        let about = found.and_then(Command::get_about).map(ToString::to_string);
        (name.to_owned(), about.unwrap_or_default())
    };
    ROWS.iter().filter(|row| row.group == group).map(|row| of(row.path)).collect()
}

/// Calls `found` with each command that users see, parts of commands included, and its path.
#[cfg(test)]
pub fn shown_below(command: &Command, before: &str, found: &mut dyn FnMut(&str, &Command)) {
    for inner in command.get_subcommands().filter(|inner| !inner.is_hide_set()) {
        let path = format!("{before}{}", inner.get_name());
        shown_below(inner, &format!("{path} "), found);
        found(&path, inner);
    }
}

fn with_examples(mut command: Command, path: &mut Vec<String>) -> Command {
    let names: Vec<String> = command.get_subcommands().map(|c| c.get_name().to_owned()).collect();
    for name in names {
        path.push(name.clone());
        let whole = path.join(" ");
        command = command.mut_subcommand(&name, |inner| {
            let inner = with_examples(inner, path).mut_args(with_negative_numbers);
            match ROWS.iter().find(|row| row.path == whole) {
                Some(row) => inner.after_help(format!("Example: {}", row.example)),
                None => inner,
            }
        });
        path.pop();
    }
    command
}

/// A negative number after a flag is its value, which the flag may refuse: clap would call it a flag that does not exist, and
/// suggest `-- -1`, which is a scene.
fn with_negative_numbers(arg: Arg) -> Arg {
    let takes = arg.get_action().takes_values() && !arg.is_positional();
    arg.allow_negative_numbers(takes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::program;
    use std::collections::BTreeSet;

    #[test]
    fn every_command_has_a_group_and_an_example_that_parses() {
        let program = program();
        let mut all = BTreeSet::new();
        shown_below(&program, "", &mut |path, _| _ = all.insert(path.to_owned()));
        let rows: BTreeSet<String> = ROWS.iter().map(|row| row.path.to_owned()).collect();
        assert_eq!(rows, all);
        assert_eq!(ROWS.len(), all.len(), "a command is there twice");
        for Row { group, path, example } in &ROWS {
            assert_eq!(group.is_empty(), path.contains(' '), "{path}");
            // As a shell reads it, up to where the output goes.
            let line = example.split(" > ").next().unwrap_or_default();
            let quoted = line.split('"').enumerate();
            let words: Vec<&str> = quoted
                .flat_map(|(i, part)| match i % 2 {
                    0 => part.split_whitespace().collect(),
                    _ => vec![part],
                })
                .collect();
            let parsed = program.clone().try_get_matches_from(&words);
            assert!(parsed.is_ok(), "{example}: {}", parsed.unwrap_err());
            assert!(
                line.starts_with(&format!("scenesplat {path}")) || *path == "prepare",
                "{example}"
            );
        }
    }

    #[test]
    fn the_help_shows_each_command_once_below_its_group() {
        let help = program().render_help().to_string();
        let mut group = "";
        for row in ROWS.iter().filter(|row| !row.group.is_empty()) {
            let line = format!("\n  {:NAME_WIDTH$}  ", row.path);
            assert_eq!(help.matches(&line).count(), 1, "{}: {help}", row.path);
            if row.group != group {
                group = row.group;
                assert!(help.contains(&format!("\n{group}:{line}")), "{group}: {help}");
            }
        }
        assert!(help.contains("--warnings-as-errors") && help.contains("Exit codes: 0"), "{help}");
    }
}
