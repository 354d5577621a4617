//! Which scenes are cut, and what their chunks are called.

use anyhow::{Context, Result};
use scenesplat::datasets::DataSource;
use scenesplat::datasets::sources::SceneFolders;
use scenesplat::scene::input_file::read_text_file;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Scenes to cut: what their chunks are called, and their id.
pub fn chunk_names(scenes: &SceneFolders, subset: Option<&Path>) -> Result<Vec<(String, String)>> {
    let mut wanted: Option<BTreeSet<String>> = None;
    if let Some(path) = subset {
        let text = read_text_file(path).context("--scenes")?;
        let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
        wanted = Some(lines.map(str::to_owned).collect());
    }
    let mut by_name: BTreeMap<String, String> = BTreeMap::new();
    for id in scenes.scene_ids() {
        // The ending of a file is no part of the name of its chunks.
        let is_file = scenes.path(id)?.is_file();
        let stem = Path::new(id).file_stem().filter(|_| is_file).and_then(|stem| stem.to_str());
        let name = stem.unwrap_or(id).to_owned();
        if let Some(wanted) = &mut wanted
            && !wanted.remove(&name)
            && !wanted.remove(id)
        {
            continue;
        }
        if let Some(other) = by_name.insert(name.clone(), id.clone()) {
            anyhow::bail!("{other} and {id} would both give chunks called {name}_…; move one away");
        }
    }
    if let Some(unknown) = wanted.and_then(|wanted| wanted.into_iter().next()) {
        anyhow::bail!("--scenes: there is no scene called {unknown}");
    }
    Ok(by_name.into_iter().collect())
}
