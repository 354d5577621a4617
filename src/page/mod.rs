//! A scene, its labels, objects and language codes as one page that opens from disk without a server.
//!
//! [`write_page`] packs everything into one HTML file: the program (TypeScript in the folder `page`, with three.js and
//! Spark), the Gaussians with rounded values, and what is needed to answer typed queries. The page loads nothing: its
//! policy forbids it. Names and texts of any file are data in it, never markup.

mod blocks;
mod codes;
mod html;
mod words;

use crate::inference::{EncodeError, SceneFeatures};
use crate::labels::LabelError;
use crate::language_codes::CodeError;
use crate::outputs::label_colors;
use codes::{PageCodes, pack_codes};
use scenesplat_objects::relations::{Relation, distance};
use scenesplat_objects::{Catalogue, Object};
use scenesplat_rooms::Vocabulary;
use scenesplat_scene::{AtomicFile, GaussianScene, TextTable, UpAxis, WriteError};
use scenesplat_text::PhraseError;
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;
use words::Words;

/// The licences of what the page is made of besides our own code.
pub const LICENSES: &str = include_str!("../../page/dist/LICENSES.txt");

/// Most classes and most objects: 16 bits number them, and 0 is none.
const MOST_NAMES: usize = 65_535;
/// Objects whose relations are written, and most of these.
const RELATED: usize = 400;
const MOST_RELATIONS: usize = 20_000;

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PageError {
    /// There is nothing to show.
    #[error("the scene has no Gaussian with a place: there is nothing to show")]
    Empty,
    /// An array does not have one value per Gaussian.
    #[error("{field}: expected {expected} rows, one a Gaussian, got {got}")]
    Rows {
        /// Which array.
        field: &'static str,
        /// Gaussians of the scene.
        expected: usize,
        /// Rows found.
        got: usize,
    },
    /// More than the page can number.
    #[error("{count} {what}, a page holds at most {MOST_NAMES}")]
    TooMany {
        /// What there are too many of.
        what: &'static str,
        /// How many.
        count: usize,
    },
    /// Codes cannot be made of the features.
    #[error(transparent)]
    Codes(#[from] CodeError),
    /// Features that went to a file could not be read.
    #[error(transparent)]
    Features(#[from] EncodeError),
    /// Texts of another network.
    #[error(transparent)]
    Labels(#[from] LabelError),
    /// The phrase table is broken.
    #[error(transparent)]
    Phrases(#[from] PhraseError),
    /// The page could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The page could not be written.
    #[error("{}", path.display())]
    Io {
        /// Which file.
        path: std::path::PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
}

/// What is shown.
#[derive(Clone, Copy)]
pub struct PageInput<'a> {
    /// First line of the page.
    pub title: &'a str,
    /// The Gaussians.
    pub scene: &'a GaussianScene,
    /// Class of each, −1 = none. `[N]`
    pub labels: Option<&'a [i32]>,
    /// How sure it is, 0..=1 is shown. `[N]`
    pub scores: Option<&'a [f32]>,
    /// Names of the classes.
    pub names: &'a [String],
    /// The objects.
    pub catalogue: Option<&'a Catalogue>,
    /// Features, and the texts of `names` that are compared with them.
    pub features: Option<(&'a SceneFeatures, &'a TextTable)>,
    /// The vocabulary that names and texts are of: colours and groups can be asked for.
    pub vocabulary: Option<&'a Vocabulary>,
    /// Which way is up.
    pub up: UpAxis,
    /// What one unit of the scene is, metres.
    pub metres_per_unit: f64,
    /// What a reader has to know, such as that weights were seeded.
    pub remarks: &'a [String],
}

/// What the page holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PageSettings {
    /// Numbers of a language code, 1 to 32.
    pub codes: usize,
    /// Gaussians kept, those that are seen most (opacity times surface) first; all if `None`.
    pub max_splats: Option<usize>,
}

impl Default for PageSettings {
    fn default() -> Self {
        Self { codes: 24, max_splats: None }
    }
}

/// What was written.
#[derive(Debug, Clone, PartialEq)]
pub struct PageReport {
    /// Bytes of the file.
    pub bytes: u64,
    /// Bytes of each block in it, as text.
    pub blocks: Vec<(String, usize)>,
    /// Gaussians in it.
    pub gaussians: usize,
    /// Gaussians left out: without a place, or more than asked for.
    pub left_out: usize,
    /// Mean cosine between features and what their codes say; `None` without codes.
    pub code_cosine: Option<f64>,
    /// Largest rounding of a position, units of the scene.
    pub position_step: f64,
}

/// Writes a page.
///
/// # Errors
/// If arrays do not fit each other, there is nothing to show, or the file cannot be written; then nothing is left
/// behind.
pub fn write_page(
    path: &Path,
    input: &PageInput<'_>,
    settings: &PageSettings,
) -> Result<PageReport, PageError> {
    check(input)?;
    let scene = input.scene;
    let rows = blocks::kept(scene, settings.max_splats);
    if rows.is_empty() {
        return Err(PageError::Empty);
    }
    let packed = blocks::pack(scene, &rows);
    let mut parts = packed.parts;
    let codes = match input.features {
        Some((features, texts)) => Some(pack_codes(features, texts, input, &rows, settings.codes)?),
        None => None,
    };
    let words = Words::of(input.names, input.vocabulary)?;
    let instances = input.catalogue.map(Catalogue::instances);
    if let Some(labels) = input.labels {
        parts.push((
            "label",
            blocks::planes(rows.iter().map(|&r| (labels[r] + 1).max(0) as u32), 2),
        ));
    }
    if let Some(scores) = input.scores {
        let byte = |&r: &usize| (scores[r].clamp(0.0, 1.0) * 255.0).round() as u8;
        parts.push(("score", rows.iter().map(byte).collect()));
    }
    if let Some(instances) = &instances {
        parts.push(("object", blocks::planes(rows.iter().map(|&r| (instances[r] + 1) as u32), 2)));
    }
    if rows.len() < scene.len() {
        parts.push(("rows", blocks::planes(rows.iter().map(|&r| r as u32), 4)));
    }
    let about = about(input, &rows, &packed.about, codes.as_ref(), &words);
    parts.push(("about", about.to_string().into_bytes()));
    parts.push(("phrases", words.phrases.join("\n").into_bytes()));
    parts.push(("near", words.near));
    let code_cosine = codes.as_ref().map(|c| c.mean_cosine);
    if let Some(codes) = codes {
        parts.push(("slot", codes.slots));
        parts.push(("codes", codes.values));
        parts.push(("texts", codes.texts));
    }
    let (page, blocks) = html::assemble(input.title, parts);
    let io = |source| PageError::Io { path: path.to_owned(), source };
    {
        let part = AtomicFile::create(path)?;
        let mut file = part.file()?;
        file.write_all(page.as_bytes()).map_err(io)?;
        part.commit()?;
    }
    Ok(PageReport {
        bytes: page.len() as u64,
        blocks,
        gaussians: rows.len(),
        left_out: scene.len() - rows.len(),
        code_cosine,
        position_step: packed.step,
    })
}

fn check(input: &PageInput<'_>) -> Result<(), PageError> {
    let expected = input.scene.len();
    let lens = [
        ("labels", input.labels.map(<[i32]>::len)),
        ("scores", input.scores.map(<[f32]>::len)),
        ("catalogue", input.catalogue.map(|c| c.gaussians)),
        ("features", input.features.map(|(f, _)| f.len())),
    ];
    for (field, got) in lens {
        if let Some(got) = got.filter(|&got| got != expected) {
            return Err(PageError::Rows { field, expected, got });
        }
    }
    let objects = input.catalogue.map_or(0, |c| c.objects.len());
    for (what, count) in [("classes", input.names.len()), ("objects", objects)] {
        if count >= MOST_NAMES {
            return Err(PageError::TooMany { what, count });
        }
    }
    Ok(())
}

/// What the page reads first.
fn about(
    input: &PageInput<'_>,
    rows: &[usize],
    places: &Value,
    codes: Option<&PageCodes>,
    words: &Words,
) -> Value {
    let mut counts = vec![0u64; input.names.len()];
    for &row in input.labels.map(|_| rows).unwrap_or_default() {
        let label = input.labels.map_or(-1, |l| l[row]);
        if let Some(count) = usize::try_from(label).ok().and_then(|l| counts.get_mut(l)) {
            *count += 1;
        }
    }
    let numbers: Vec<i32> = (0..input.names.len() as i32).collect();
    let classes: Vec<Value> = (input.names.iter().zip(label_colors(&numbers)).zip(&counts))
        .map(|((name, color), count)| json!({ "name": name, "color": color, "count": count }))
        .collect();
    let all: &[Object] = input.catalogue.map_or(&[], |c| &c.objects);
    let objects: Vec<Value> = all.iter().map(object).collect();
    json!({
        "version": 1,
        "title": input.title,
        "count": rows.len(),
        "total": input.scene.len(),
        "up": input.up.upright(),
        "metresPerUnit": input.metres_per_unit,
        "origin": places["origin"],
        "step": places["step"],
        "scaleRange": places["scaleRange"],
        "classes": classes,
        "objects": objects,
        "relations": relations(all),
        "texts": codes.map_or(input.names, |c| c.names.as_slice()),
        "colorWords": words.colors,
        "groups": words.groups,
        "codes": codes.map(|c| json!({ "width": c.width, "slots": c.count })),
        "hasScores": input.scores.is_some(),
        "phrases": words.phrases.len(),
        "remarks": input.remarks,
    })
}

fn object(o: &Object) -> Value {
    json!({
        "id": o.id,
        "label": o.label,
        "score": o.score,
        "count": o.count,
        "position": o.position,
        "corners": o.corners,
        "size": o.bounds.size,
        "volume": o.volume,
        "aboveFloor": o.above_floor,
        "wallDistance": o.wall_distance,
    })
}

/// Pairs that stand in a relation: place, relation, place.
fn relations(objects: &[Object]) -> Vec<(usize, &'static str, usize)> {
    let kinds = [
        (Relation::On, "on"),
        (Relation::Above, "above"),
        (Relation::Under, "under"),
        (Relation::In, "in"),
        (Relation::Near, "near"),
    ];
    let mut found = Vec::new();
    let few = &objects[..objects.len().min(RELATED)];
    for (relation, name) in kinds {
        for (i, a) in few.iter().enumerate() {
            for (j, b) in few.iter().enumerate().filter(|(j, _)| *j != i) {
                if distance(a, b, relation).is_some() && found.len() < MOST_RELATIONS {
                    found.push((i, name, j));
                }
            }
        }
    }
    found
}
