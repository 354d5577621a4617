//! The sorted list of scenes that all parts agree on.

use super::{Asked, names, words::Words};
use crate::commands::evaluate::one_by_one;
use crate::error::refuse;
use anyhow::{Context, Result, bail};
use scenesplat::datasets::DataSource;
use scenesplat::datasets::sources::{SceneFolders, SceneFoldersOptions};
use scenesplat::scene::AtomicFile;
use scenesplat::scene::input_file::read_text_file;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Its name in the output folder.
pub const MANIFEST: &str = "manifest.json";

/// All scenes of all parts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The command.
    pub command: String,
    /// Sorted by path.
    pub scenes: Vec<Entry>,
}

/// One scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// What its folder in the output folder is called.
    pub name: String,
    /// The file or folder.
    pub scene: String,
    /// Flags of this scene alone.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub flags: BTreeMap<String, Vec<String>>,
}

type Flags = BTreeMap<String, Vec<String>>;

/// The scenes that the arguments and the manifest name.
///
/// # Errors
/// If there is none, one is there twice, or the manifest cannot be understood.
pub fn gather(asked: &Asked<'_>, words: &Words) -> Result<Manifest> {
    let mut scenes: Vec<(String, Flags)> = Vec::new();
    for scene in asked.flags.get_raw(asked.positional).into_iter().flatten() {
        let Some(scene) = scene.to_str() else {
            refuse!("{}: names of many scenes have to be Unicode", scene.display());
        };
        scenes.push((scene.to_owned(), Flags::new()));
    }
    if let Some(path) = &asked.many.manifest {
        scenes.extend(read(path, words)?);
    }
    let mut scenes: Vec<(String, Flags)> = match asked.command {
        "evaluate" => {
            let each = |(scene, flags): (String, Flags)| {
                one_by_one(&scene).into_iter().map(move |scene| (scene, flags.clone()))
            };
            scenes.into_iter().flat_map(each).collect()
        }
        _ => scenes,
    };
    scenes.sort();
    if let Some(twice) = scenes.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        refuse!("{}: this scene is given twice", twice[0].0);
    }
    if scenes.is_empty() {
        refuse!("there is no scene to work on");
    }
    let paths: Vec<String> = scenes.iter().map(|(scene, _)| scene.clone()).collect();
    let names = names::names(&paths)?;
    let entry = |(name, (scene, flags))| Entry { name, scene, flags };
    let scenes = names.into_iter().zip(scenes).map(entry).collect();
    Ok(Manifest { command: asked.command.to_owned(), scenes })
}

fn read(path: &Path, words: &Words) -> Result<Vec<(String, Flags)>> {
    let text_of = |path: &Path| {
        let text = path.to_str().map(str::to_owned);
        text.with_context(|| format!("{}: names of many scenes have to be Unicode", path.display()))
    };
    if path.is_dir() {
        let scenes =
            SceneFolders::new(path, &[], SceneFoldersOptions::default()).context("--manifest")?;
        let ids = scenes.scene_ids().iter();
        return ids.map(|id| Ok((text_of(scenes.path(id)?)?, Flags::new()))).collect();
    }
    let text = read_text_file(path).context("--manifest")?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let at = |scene: &str| match scene.split_once(':') {
        Some(("synthetic" | "scanned" | "furnished" | "public" | "depth", _)) => {
            Ok(scene.to_owned())
        }
        _ => text_of(&folder.join(scene)),
    };
    if !text.trim_start().starts_with('[') {
        let lines = text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('#'));
        return lines.map(|line| Ok((at(line)?, Flags::new()))).collect();
    }
    let list: Vec<Value> = serde_json::from_str(&text)
        .with_context(|| format!("{}: no JSON list of scenes", path.display()))?;
    let folder = text_of(folder)?;
    let folder = if folder.is_empty() { "." } else { folder.as_str() };
    let each = |(place, value): (usize, &Value)| {
        let (scene, flags) = entry(value, words, folder)
            .with_context(|| format!("{}: entry {place} of the list", path.display()))?;
        Ok((at(&scene)?, flags))
    };
    list.iter().enumerate().map(each).collect()
}

/// A scene of a JSON list; `{manifest}` in a value becomes the folder of the list.
fn entry(value: &Value, words: &Words, folder: &str) -> Result<(String, Flags)> {
    let fields = match value {
        Value::String(scene) => return Ok((scene.clone(), Flags::new())),
        Value::Object(fields) => fields,
        other => bail!("{other} is neither a path nor an object with \"scene\""),
    };
    let Some(Value::String(scene)) = fields.get("scene") else {
        bail!("\"scene\", the path of the scene, is missing");
    };
    let mut flags = Flags::new();
    for (flag, value) in fields.iter().filter(|(name, _)| *name != "scene") {
        let text = |value: &Value| match value {
            Value::String(text) => Ok(text.replace("{manifest}", folder)),
            Value::Number(number) => Ok(number.to_string()),
            other => bail!("{flag}: {other} is no value of a flag"),
        };
        let values = match (words.takes_value(flag), value) {
            (None, _) => bail!("{flag:?} is no flag that a scene may have: {}", words.names()),
            (Some(false), Value::Bool(true)) => Vec::new(),
            (Some(false), other) => bail!("{flag}: {other}; write true, or leave it out"),
            (Some(true), Value::Array(values)) if !values.is_empty() => {
                values.iter().map(text).collect::<Result<_>>()?
            }
            (Some(true), value) => vec![text(value)?],
        };
        flags.insert(flag.clone(), values);
    }
    Ok((scene.clone(), flags))
}

impl Manifest {
    /// That of an output folder, if there is one.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn read(out: &Path) -> Result<Option<Self>> {
        let path = out.join(MANIFEST);
        if !path.exists() {
            return Ok(None);
        }
        let text = read_text_file(&path)?;
        let read = serde_json::from_str(&text);
        read.map(Some)
            .with_context(|| format!("{}: no list of scenes of this program", path.display()))
    }

    /// Writes it into the output folder, unless it is there; a list may grow.
    ///
    /// # Errors
    /// If there is the list of another command, or one with other scenes.
    pub fn agree(&self, out: &Path) -> Result<()> {
        if let Some(there) = Self::read(out)? {
            let path = out.join(MANIFEST);
            if there.command != self.command {
                refuse!(
                    "{}: here are results of `{}`; give `{}` another --out",
                    path.display(),
                    there.command,
                    self.command
                );
            }
            let known: BTreeMap<&str, &Entry> =
                self.scenes.iter().map(|e| (e.name.as_str(), e)).collect();
            let lost = there
                .scenes
                .iter()
                .find(|old| known.get(old.name.as_str()).is_none_or(|new| new.scene != old.scene));
            if let Some(lost) = lost {
                refuse!(
                    "{}: {} ({}) is no part of these scenes; a list may grow, but not lose or rename scenes: run in \
                     the same folder with all of them, or give another --out",
                    path.display(),
                    lost.name,
                    lost.scene
                );
            }
            if there == *self {
                return Ok(());
            }
        }
        let text = serde_json::to_string_pretty(self)? + "\n";
        Ok(AtomicFile::write(&out.join(MANIFEST), text.as_bytes())?)
    }
}
