//! `scenesplat completions`

use crate::terminal::print;
use anyhow::Result;
use clap_complete::Shell;

/// Prints a script by which a shell completes commands and flags.
///
/// Where each shell looks for such files is in docs/command_line.md.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The shell.
    #[arg(value_enum)]
    pub shell: Shell,
}

/// Runs the command.
pub fn run(args: &Args, mut program: clap::Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "scenesplat", &mut script);
    print(String::from_utf8(script)?.trim_end());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::overview::shown_below;
    use crate::commands::program;
    use crate::terminal::captured;
    use clap::ValueEnum;
    use std::io::Write;
    use std::process::{Command, Stdio};

    fn script(shell: Shell) -> String {
        let (done, said) = captured(|| run(&Args { shell }, program()));
        done.unwrap();
        String::from_utf8(said.stdout).unwrap()
    }

    #[test]
    fn every_shell_completes_every_command_and_flag() {
        for shell in Shell::value_variants() {
            let script = script(*shell);
            shown_below(&program(), "", &mut |path, command| {
                let flags = command.get_arguments().filter(|arg| !arg.is_hide_set());
                let flags = flags.filter_map(|arg| arg.get_long());
                for word in flags.chain([command.get_name()]) {
                    assert!(script.contains(word), "{shell}: {path}: {word}");
                }
            });
        }
    }

    #[test]
    fn bash_reads_its_script() {
        let bash = Command::new("bash").arg("-n").stdin(Stdio::piped()).spawn();
        let Ok(mut bash) = bash else {
            println!("skipped: there is no bash here");
            return;
        };
        let mut input = bash.stdin.take().unwrap();
        input.write_all(script(Shell::Bash).as_bytes()).unwrap();
        drop(input);
        assert!(bash.wait().unwrap().success());
    }
}
