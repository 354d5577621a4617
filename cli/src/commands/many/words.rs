//! The flags of a command line, to be given to the command once more for a single scene.

use super::Asked;
use crate::error::refuse;
use anyhow::Result;
use clap::ArgAction;
use clap::parser::ValueSource;
use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::path::Path;

/// Flags that are about all scenes, or change no result.
const ABOUT_ALL: [&str; 4] = ["manifest", "shard", "again", "out"];
/// Flags that change no result.
const WITHOUT_EFFECT: [&str; 6] =
    ["threads", "quiet", "verbose", "warnings-as-errors", "log-format", "no-config"];
/// Flags that name one file for the results of one scene.
const ONE_FILE: [(&str, &str); 2] = [("json", "figures"), ("receipt", "receipt")];

/// The flags that were given.
#[derive(Debug)]
pub struct Words {
    /// Names and values; no value for a switch.
    given: BTreeMap<String, Vec<OsString>>,
    /// All that the command knows, and whether they take a value.
    known: BTreeMap<String, bool>,
}

impl Words {
    /// Of what is asked for.
    ///
    /// # Errors
    /// If a flag can only be about one scene.
    pub fn of(command: &clap::Command, asked: &Asked<'_>) -> Result<Self> {
        let (mut given, mut known) = (BTreeMap::new(), BTreeMap::new());
        let command = command.find_subcommand(asked.command);
        for arg in command.iter().flat_map(|command| command.get_arguments()) {
            let (id, Some(long)) = (arg.get_id().as_str(), arg.get_long()) else { continue };
            if ABOUT_ALL.contains(&id) || matches!(id, "help" | "version") {
                continue;
            }
            let takes_value = !matches!(arg.get_action(), ArgAction::SetTrue | ArgAction::SetFalse);
            known.insert(long.to_owned(), takes_value);
            if asked.flags.value_source(id) != Some(ValueSource::CommandLine) {
                continue;
            }
            if let Some((_, what)) = ONE_FILE.iter().find(|(name, _)| *name == id) {
                refuse!(
                    "--{long} names one file; the {what} of each scene goes into its folder of --out"
                );
            }
            let values = asked.flags.get_raw(id).filter(|_| takes_value);
            given.insert(
                long.to_owned(),
                values.into_iter().flatten().map(OsStr::to_owned).collect(),
            );
        }
        Ok(Self { given, known })
    }

    /// The flags for one scene: what a manifest says of it replaces what is given for all; `{name}`, `{scene}` and
    /// `{folder}` in values become the scene's.
    pub fn for_scene(&self, name: &str, scene: &str, own: &BTreeMap<String, Vec<String>>) -> Flags {
        let mut flags = self.given.clone();
        for (flag, values) in own {
            flags.insert(flag.clone(), values.iter().map(OsString::from).collect());
        }
        let folder =
            Path::new(scene).parent().map_or(String::new(), |f| f.to_string_lossy().into_owned());
        let folder = if folder.is_empty() { ".".to_owned() } else { folder };
        for value in flags.values_mut().flatten() {
            if let Some(text) = value.to_str() {
                let text = text.replace("{name}", name).replace("{scene}", scene);
                *value = text.replace("{folder}", &folder).into();
            }
        }
        Flags(flags)
    }

    /// Whether the command has such a flag, and it takes a value.
    pub fn takes_value(&self, flag: &str) -> Option<bool> {
        let refused =
            WITHOUT_EFFECT.contains(&flag) || ONE_FILE.iter().any(|(name, _)| *name == flag);
        self.known.get(flag).copied().filter(|_| !refused)
    }

    /// The flags that a manifest may give, for messages.
    pub fn names(&self) -> String {
        let names = self.known.keys().filter(|flag| self.takes_value(flag).is_some());
        names.cloned().collect::<Vec<_>>().join(", ")
    }
}

/// The flags of one scene.
#[derive(Debug)]
pub struct Flags(BTreeMap<String, Vec<OsString>>);

impl Flags {
    /// As words of a command line.
    pub fn words(&self) -> Vec<OsString> {
        let mut words = Vec::new();
        for (flag, values) in &self.0 {
            let word = OsString::from(format!("--{flag}"));
            if values.is_empty() {
                words.push(word);
                continue;
            }
            for value in values {
                // In one word: values may begin with a dash.
                let mut word = word.clone();
                word.push("=");
                word.push(value);
                words.push(word);
            }
        }
        words
    }

    /// Those that change results, with their values.
    pub fn that_matter(&self) -> impl Iterator<Item = (&str, &[OsString])> {
        let all = self.0.iter().filter(|(flag, _)| !WITHOUT_EFFECT.contains(&flag.as_str()));
        all.map(|(flag, values)| (flag.as_str(), values.as_slice()))
    }
}
