//! `scenesplat man`

use crate::terminal::print;
use crate::version::VERSION;
use anyhow::{Context, Result};
use clap::Command;
use clap_mangen::Man;
use scenesplat::scene::AtomicFile;
use std::path::PathBuf;

/// Writes man pages: one of the program, and one of each command.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for the pages, such as ~/.local/share/man/man1; it is made if it is missing.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Runs the command.
pub fn run(args: &Args, mut program: Command) -> Result<()> {
    program.build();
    let mut pages = Vec::new();
    collect(&program, &mut pages)?;
    std::fs::create_dir_all(&args.out).with_context(|| format!("--out {}", args.out.display()))?;
    for (name, page) in &pages {
        AtomicFile::write(&args.out.join(name), page)?;
    }
    print(&format!("{} pages: {}", pages.len(), args.out.display()));
    Ok(())
}

/// The pages of a command and of those in it, with the names of their files.
fn collect(command: &Command, pages: &mut Vec<(String, Vec<u8>)>) -> Result<()> {
    // The name with those of the commands around it, as in scenesplat-prepare-scan.
    let name = command.get_display_name().unwrap_or(command.get_name()).to_owned();
    let mut page = Vec::new();
    Man::new(command.clone()).source(format!("scenesplat {VERSION}")).render(&mut page)?;
    pages.push((format!("{name}.1"), page));
    let shown = command.get_subcommands().filter(|c| !c.is_hide_set() && c.get_name() != "help");
    shown.into_iter().try_for_each(|inner| collect(inner, pages))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::overview::shown_below;
    use crate::commands::program;

    #[test]
    fn every_command_has_a_page_with_its_name_line_and_flags() {
        let mut built = program();
        built.build();
        let mut pages = Vec::new();
        collect(&built, &mut pages).unwrap();
        let mut count = 1;
        shown_below(&program(), "", &mut |path, command| {
            count += 1;
            let name = format!("scenesplat-{}", path.replace(' ', "-"));
            let page = pages.iter().find(|(file, _)| *file == format!("{name}.1"));
            let page = String::from_utf8_lossy(&page.unwrap().1).replace("\\-", "-");
            let about = command.get_about().unwrap().to_string();
            // An apostrophe at the beginning of a line is a command of roff.
            let begin = about.split('\'').next().unwrap();
            assert!(page.contains(&format!("{name} - {begin}")), "{name}: {page}");
            for flag in command.get_arguments().filter(|arg| !arg.is_hide_set()) {
                let Some(long) = flag.get_long() else { continue };
                assert!(page.contains(&format!("--{long}")), "{name}: --{long}");
            }
            assert!(page.contains("Example: scenesplat "), "{name}");
        });
        assert_eq!(pages.len(), count);
        assert!(pages.iter().all(|(_, page)| page.starts_with(b".ie")));
    }
}
