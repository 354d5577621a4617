//! A file with values for flags that the command line does not give.

use crate::error::{WrongUse, refuse};
use anyhow::{Context, Result};
use clap::{Arg, ArgAction, Command};
use scenesplat::scene::input_file::read_text_file;
use scenesplat::scene::label_set::nearest_names;
use std::cell::RefCell;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Names the file; empty: there is none.
pub const FILE_VARIABLE: &str = "SCENESPLAT_CONFIG";
/// The file's name in the working folder.
const IN_FOLDER: &str = "scenesplat.toml";
/// Flags that say where flags come from, or end the command at once.
const NEVER: [&str; 3] = ["no-config", "help", "version"];

/// A flag that the file gave.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Taken {
    /// Its name, without dashes.
    pub flag: String,
    /// Its value; none of a switch.
    pub value: Option<String>,
}

impl Taken {
    /// As on a command line.
    pub fn word(&self) -> String {
        match &self.value {
            Some(value) => format!("--{}={value}", self.flag),
            None => format!("--{}", self.flag),
        }
    }
}

thread_local! {
    /// What the command of this thread took, and of which file.
    static TAKEN: RefCell<Option<(PathBuf, Vec<Taken>)>> = const { RefCell::new(None) };
}

/// Notes what the command that begins took of a file.
pub fn note(taken: Option<(PathBuf, Vec<Taken>)>) {
    TAKEN.set(taken.filter(|(_, flags)| !flags.is_empty()));
}

/// What the command took, and of which file.
pub fn taken() -> Option<(PathBuf, Vec<Taken>)> {
    TAKEN.with_borrow(Clone::clone)
}

/// The file of this process: the one that the variable names, else the one of the working folder, else the user's.
pub fn find() -> Option<PathBuf> {
    let variable = |name: &str| std::env::var_os(name);
    if let Some(named) = variable(FILE_VARIABLE) {
        return (!named.is_empty()).then(|| PathBuf::from(named));
    }
    let user = variable("XDG_CONFIG_HOME").filter(|folder| !folder.is_empty()).map(PathBuf::from);
    let user = user.or_else(|| Some(PathBuf::from(variable("HOME")?).join(".config")));
    let user = user.map(|folder| folder.join("scenesplat/config.toml"));
    [Some(PathBuf::from(IN_FOLDER)), user].into_iter().flatten().find(|path| path.is_file())
}

/// A file of defaults.
#[derive(Debug)]
pub struct Defaults {
    path: PathBuf,
    table: Table,
}

impl Defaults {
    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read, or is no TOML.
    pub fn read(path: &Path) -> Result<Self> {
        let place = || path.display().to_string();
        let text = read_text_file(path).with_context(place)?;
        let table = text.parse().map_err(|error: toml::de::Error| {
            WrongUse(format!("{}: no TOML: {}", path.display(), error.to_string().trim_end()))
        })?;
        Ok(Self { path: path.to_owned(), table })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The command line with the flags of the file that it does not give itself, and those flags. `root` has been built.
    ///
    /// # Errors
    /// If the file names a command or a flag that does not exist, or a value has the wrong kind.
    pub fn complete(
        &self,
        root: &Command,
        args: &[OsString],
    ) -> Result<(Vec<OsString>, Vec<Taken>)> {
        self.check(root, &self.table, &mut Vec::new())?;
        let line = Line::of(root, args);
        let mut taken: Vec<Taken> = Vec::new();
        // From the general to the special: the later of two replaces the earlier.
        let mut section = Some(&self.table);
        for name in std::iter::once(None).chain(line.path.iter().map(Some)) {
            section = match name {
                None => section,
                Some(name) => section.and_then(|s| s.get(name)).and_then(Value::as_table),
            };
            for (flag, value) in section.into_iter().flatten() {
                let arg = flag_of(line.command, flag).filter(|arg| !line.gives(arg));
                // A table is a section, also where it has the name of a flag.
                let Some(arg) = arg.filter(|_| !value.is_table()) else { continue };
                taken.retain(|earlier| earlier.flag != *flag);
                taken.extend(self.values(arg, flag, value)?);
            }
        }
        let mut complete = args[..line.at].to_vec();
        complete.extend(taken.iter().map(|flag| OsString::from(flag.word())));
        complete.extend_from_slice(&args[line.at..]);
        Ok((complete, taken))
    }

    /// That every name of a section is one of a command or flag.
    fn check(&self, command: &Command, section: &Table, path: &mut Vec<String>) -> Result<()> {
        for (name, value) in section {
            if let (Some(inner), Some(table)) = (shown(command, name), value.as_table()) {
                path.push(name.clone());
                self.check(inner, table, path)?;
                path.pop();
                continue;
            }
            let mut known = Vec::new();
            flags_below(command, path.is_empty(), &mut known);
            if known.contains(name) && !value.is_table() {
                continue;
            }
            if value.is_table() {
                known =
                    command.get_subcommands().filter(|c| !c.is_hide_set()).map(name_of).collect();
            }
            let (file, near) = (self.path.display(), nearest_names(&known, name, 3).join(", "));
            let place =
                if path.is_empty() { String::new() } else { format!("[{}]: ", path.join(".")) };
            let what = if value.is_table() { "command" } else { "flag" };
            refuse!("{file}: {place}{name}: no such {what}; nearest: {near}");
        }
        Ok(())
    }

    /// A flag with its value, or with each of its values.
    fn values(&self, arg: &Arg, flag: &str, value: &Value) -> Result<Vec<Taken>> {
        let one = |value: Option<String>| Taken { flag: flag.to_owned(), value };
        let wrong = |expected: &str| -> Result<Vec<Taken>> {
            refuse!("{}: {flag} = {value}: {expected} is expected", self.path.display())
        };
        if !arg.get_action().takes_values() {
            return match value {
                Value::Boolean(true) => Ok(vec![one(None)]),
                Value::Boolean(false) => Ok(Vec::new()),
                _ => wrong("true or false"),
            };
        }
        let text = |value: &Value| match value {
            Value::String(text) => Some(text.clone()),
            Value::Integer(_) | Value::Float(_) | Value::Boolean(_) => Some(value.to_string()),
            _ => None,
        };
        let Value::Array(list) = value else {
            return match text(value) {
                Some(text) => Ok(vec![one(Some(text))]),
                None => wrong("a text or a number"),
            };
        };
        let texts: Option<Vec<String>> = list.iter().map(text).collect();
        match (texts, arg.get_value_delimiter(), arg.get_action()) {
            (Some(texts), Some(comma), _) => Ok(vec![one(Some(texts.join(&comma.to_string())))]),
            (Some(texts), None, ArgAction::Append) => {
                Ok(texts.into_iter().map(|text| one(Some(text))).collect())
            }
            _ => wrong("one text or number"),
        }
    }
}

fn name_of(command: &Command) -> String {
    command.get_name().to_owned()
}

/// The command of that name, unless it is for the program itself.
fn shown<'c>(command: &'c Command, name: &str) -> Option<&'c Command> {
    command.find_subcommand(name).filter(|found| !found.is_hide_set())
}

/// The flag of that name.
fn flag_of<'c>(command: &'c Command, name: &str) -> Option<&'c Arg> {
    let mut flags = command.get_arguments().filter(|arg| !arg.is_hide_set());
    flags.find(|arg| arg.get_long() == Some(name) && !NEVER.contains(&name))
}

/// Names of the flags of a command; `all`: of those in it, too.
fn flags_below(command: &Command, all: bool, names: &mut Vec<String>) {
    let flags = command.get_arguments().filter(|arg| !arg.is_hide_set());
    let flags = flags.filter_map(|arg| arg.get_long()).filter(|name| !NEVER.contains(name));
    for name in flags {
        if !names.iter().any(|known| known == name) {
            names.push(name.to_owned());
        }
    }
    // Those of `prepare` are those of its parts.
    let inner = command.get_subcommands().filter(|inner| !inner.is_hide_set());
    if all || command.get_arguments().all(|arg| arg.get_long().is_none()) {
        inner.for_each(|inner| flags_below(inner, all, names));
    }
}

/// What a command line says before it is parsed.
struct Line<'c> {
    /// The innermost command.
    command: &'c Command,
    /// The names of the commands, outermost first.
    path: Vec<String>,
    /// Where flags of that command may stand.
    at: usize,
    /// Flags that are given, without dashes.
    given: Vec<String>,
}

impl<'c> Line<'c> {
    fn of(root: &'c Command, args: &[OsString]) -> Self {
        let mut line =
            Self { command: root, path: Vec::new(), at: args.len().min(1), given: Vec::new() };
        let mut may_be_command = true;
        let mut words =
            args.iter().enumerate().skip(1).map(|(i, word)| (i, word.to_string_lossy()));
        while let Some((i, word)) = words.next() {
            if word == "--" {
                break;
            }
            if let Some(flag) = word.strip_prefix("--") {
                let name = flag.split('=').next().unwrap_or(flag);
                line.given.push(name.to_owned());
                let takes = |arg: &Arg| arg.get_action().takes_values() && !flag.contains('=');
                if may_be_command && flag_of(line.command, name).is_some_and(takes) {
                    // Its value is no command.
                    words.next();
                }
            } else if word == "-v" {
                line.given.push("verbose".to_owned());
            } else if may_be_command && !word.starts_with('-') {
                match shown(line.command, &word) {
                    Some(inner) => {
                        line.command = inner;
                        line.path.push(name_of(inner));
                        line.at = i + 1;
                        may_be_command = inner.has_subcommands();
                    }
                    None => may_be_command = false,
                }
            }
        }
        line
    }

    /// Whether the command line gives a flag, or one that excludes it.
    fn gives(&self, arg: &Arg) -> bool {
        let is_given = |arg: &Arg| {
            let aliases = arg.get_all_aliases().unwrap_or_default();
            let mut names = arg.get_long().into_iter().chain(aliases);
            names.any(|name| self.given.iter().any(|given| given == name))
        };
        let excludes = |one: &Arg, other: &Arg| {
            !one.is_global_set()
                && self
                    .command
                    .get_arg_conflicts_with(one)
                    .iter()
                    .any(|found| found.get_id() == other.get_id())
        };
        // These two exclude each other, though one is of every command and the other of the whole program.
        let opposite = match arg.get_long() {
            Some("quiet") => "verbose",
            Some("verbose") => "quiet",
            _ => "",
        };
        is_given(arg)
            || self.given.iter().any(|given| given == opposite)
            || self
                .command
                .get_arguments()
                .any(|other| is_given(other) && (excludes(arg, other) || excludes(other, arg)))
    }
}
