//! Streamed scenes: a tree whose leaves name runs of rows in chunk files, one for each level.

use super::meta::{is_inside, parse_json};
use super::reader::OpenSog;
use super::source::Source;
use crate::formats::scene_blocks::zero_scene;
use crate::formats::{LoadedScene, ReadOptions, SceneFormat};
use crate::input_file::InputFile;
use crate::{RepairReport, SceneError};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Longest `lod-meta.json` that is looked at; a leaf takes about 300 bytes.
const MAX_LOD_META_BYTES: usize = 64 << 20;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct LodMeta {
    lod_levels: usize,
    #[serde(default)]
    environment: Option<String>,
    filenames: Vec<String>,
    tree: Node,
}

#[derive(Deserialize)]
struct Node {
    #[serde(default)]
    children: Vec<Node>,
    /// By level; the keys are texts in JSON.
    #[serde(default)]
    lods: BTreeMap<usize, Run>,
}

#[derive(Clone, Copy, Deserialize)]
struct Run {
    file: usize,
    offset: usize,
    count: usize,
}

/// Whether a JSON text describes a streamed scene.
pub fn is_lod_meta_json(bytes: &[u8]) -> bool {
    parse_json(bytes, MAX_LOD_META_BYTES).is_some_and(|value| {
        value["lodLevels"].is_number() && value["filenames"].is_array() && value["tree"].is_object()
    })
}

/// Names of the chunk files of a streamed scene that this program wrote or can read.
pub(super) fn part_names(json: &[u8]) -> Option<Vec<String>> {
    let meta: LodMeta = serde_json::from_slice(json).ok()?;
    Some(meta.filenames)
}

impl Node {
    fn leaves<'a>(&'a self, out: &mut Vec<&'a BTreeMap<usize, Run>>) {
        if !self.lods.is_empty() {
            out.push(&self.lods);
        }
        // As deep as the JSON, whose depth the parser limits.
        self.children.iter().for_each(|child| child.leaves(out));
    }
}

/// The run to use in a leaf: of that level, else of the nearest coarser, else of the nearest finer.
fn pick(leaf: &BTreeMap<usize, Run>, level: usize) -> Option<(usize, Run)> {
    let coarser = leaf.range(level..).next();
    coarser.or_else(|| leaf.range(..level).next_back()).map(|(&level, &run)| (level, run))
}

/// Reads one level of a streamed scene, from its `lod-meta.json`.
pub(super) fn read_streamed(path: &Path, options: &ReadOptions) -> Result<LoadedScene, SceneError> {
    let bad = |problem: String| SceneError::format(path, problem, "export the scene again");
    let file = InputFile::open(path)?;
    if file.bytes().len() > MAX_LOD_META_BYTES {
        return Err(bad(format!("is {} bytes long", file.bytes().len())));
    }
    let meta: LodMeta = serde_json::from_slice(file.bytes())
        .map_err(|e| bad(format!("is no description of a streamed scene: {e}")))?;
    drop(file);
    if options.lod >= meta.lod_levels {
        let problem = format!("has {} levels of detail, no level {}", meta.lod_levels, options.lod);
        let help = match meta.lod_levels {
            0 | 1 => "ask for level 0".to_owned(),
            levels => format!("ask for one of 0 (finest) to {} (coarsest)", levels - 1),
        };
        return Err(SceneError::format(path, problem, help));
    }
    if let Some(name) = meta.filenames.iter().find(|name| !is_inside(name)) {
        return Err(bad(format!("names {name:?}, which is no file below this folder")));
    }
    let mut leaves = Vec::new();
    meta.tree.leaves(&mut leaves);
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut there = BTreeMap::new();
    let files = &meta.filenames;
    let mut is_there =
        |file: usize| *there.entry(file).or_insert_with(|| folder.join(&files[file]).is_file());

    let mut report = RepairReport::default();
    let (runs, elsewhere) = runs_of_level(&leaves, options.lod, files.len()).map_err(bad)?;
    let missing: Vec<&str> =
        runs.keys().filter(|&&f| !is_there(f)).map(|&f| files[f].as_str()).collect();
    if !missing.is_empty() {
        let complete: Vec<String> = (0..meta.lod_levels.min(MAX_LEVELS))
            .filter(|&level| {
                runs_of_level(&leaves, level, files.len())
                    .is_ok_and(|(runs, _)| runs.keys().all(|&f| is_there(f)))
            })
            .map(|level| level.to_string())
            .collect();
        return Err(missing_files(path, options.lod, &missing, &complete));
    }
    if elsewhere > 0 {
        report.notes.push(format!(
            "{elsewhere} of {} leaves have no level {}; the nearest was taken",
            leaves.len(),
            options.lod
        ));
    }
    if let Some(name) = meta.environment.filter(|name| !name.is_empty()) {
        report.notes.push(format!("the backdrop {name} is no part of the scene and was not read"));
    }
    let chunks: Vec<(PathBuf, Vec<Range<usize>>)> =
        runs.into_iter().map(|(file, runs)| (folder.join(&files[file]), runs)).collect();
    read_chunks(path, &chunks, report, options)
}

/// More levels than any scene has; bounds the search for complete ones.
const MAX_LEVELS: usize = 64;

fn missing_files(path: &Path, level: usize, missing: &[&str], complete: &[String]) -> SceneError {
    let shown = missing.iter().take(5).copied().collect::<Vec<_>>().join(", ");
    let more =
        if missing.len() > 5 { format!(" and {} more", missing.len() - 5) } else { "".into() };
    let help = if complete.is_empty() {
        "copy all files of the scene".to_owned()
    } else {
        format!("copy all files of the scene; levels that are complete: {}", complete.join(", "))
    };
    let problem = format!("needs for level {level} files that are not there: {shown}{more}");
    SceneError::format(path, problem, help)
}

/// The runs of one level in each chunk file, in the order of the file, and how many leaves had to
/// give another level. No row may be in two leaves.
#[expect(clippy::type_complexity, reason = "used in two places of this file")]
fn runs_of_level(
    leaves: &[&BTreeMap<usize, Run>],
    level: usize,
    files: usize,
) -> Result<(BTreeMap<usize, Vec<Range<usize>>>, usize), String> {
    let mut out: BTreeMap<usize, Vec<Range<usize>>> = BTreeMap::new();
    let mut elsewhere = 0;
    for (number, leaf) in leaves.iter().enumerate() {
        let Some((used, run)) = pick(leaf, level) else { continue };
        elsewhere += usize::from(used != level);
        if run.file >= files {
            return Err(format!("leaf {number} is in file {} of {files}", run.file));
        }
        let Some(end) = run.offset.checked_add(run.count) else {
            return Err(format!("leaf {number} ends beyond any file"));
        };
        if run.count > 0 {
            out.entry(run.file).or_default().push(run.offset..end);
        }
    }
    for (file, runs) in &mut out {
        runs.sort_unstable_by_key(|run| run.start);
        if let Some(pair) = runs.windows(2).find(|pair| pair[0].end > pair[1].start) {
            return Err(format!("has row {} of file {file} in two leaves", pair[1].start));
        }
    }
    Ok((out, elsewhere))
}

fn read_chunks(
    path: &Path,
    chunks: &[(PathBuf, Vec<Range<usize>>)],
    mut report: RepairReport,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    // A chunk is checked when it is opened, and only open while it is read: scenes of hundreds of
    // chunks would hold thousands of files.
    let (mut rows, mut sh_degree, mut labelled, mut antialiased) = (0usize, 0, false, true);
    let mut degrees = BTreeSet::new();
    for (chunk, runs) in chunks {
        with_chunk(chunk, options, |sog| {
            let end = runs.last().map_or(0, |run| run.end);
            if end > sog.meta.count {
                let problem = format!(
                    "needs rows up to {end} of {}, which has {}",
                    chunk.display(),
                    sog.meta.count
                );
                return Err(SceneError::format(path, problem, "copy all files of the same export"));
            }
            rows += runs.iter().map(Range::len).sum::<usize>();
            sh_degree = sh_degree.max(sog.sh_degree());
            degrees.insert(sog.sh_degree());
            labelled |= sog.meta.labels.is_some();
            antialiased &= sog.meta.antialiased;
            Ok(())
        })?;
    }
    if labelled {
        report.notes.push("labels in chunks of a streamed scene are not read".into());
    }
    if degrees.len() > 1 {
        report.notes.push("chunks have different numbers of bands; missing ones became 0".into());
    }
    let mut scene = zero_scene(rows, sh_degree);
    scene.antialiased = antialiased && !chunks.is_empty();
    let mut first = 0;
    for (chunk, runs) in chunks {
        with_chunk(chunk, options, |sog| sog.decode(runs, &mut scene, first))?;
        first += runs.iter().map(Range::len).sum::<usize>();
    }
    LoadedScene::finish(scene, report, options.policy, path, SceneFormat::Sog)
}

/// Opens a chunk, a `meta.json` or an archive, for as long as `then` runs.
fn with_chunk<T>(
    path: &Path,
    options: &ReadOptions,
    then: impl FnOnce(&OpenSog<'_>) -> Result<T, SceneError>,
) -> Result<T, SceneError> {
    let file = InputFile::open(path)?;
    let source = if file.bytes().starts_with(b"PK") {
        Source::archive(file.bytes(), path)?
    } else {
        Source::beside(path)
    };
    then(&OpenSog::open(&source, options.sh_rest)?)
}
