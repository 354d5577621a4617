//! What a page asks, one scene at a time.

use crate::labelling::{Labelled, Stage, Tell, label};
use scenesplat::inference::EncodeError;
use scenesplat::input::{InputError, open_input_owned};
use scenesplat::labels::LabelError;
use scenesplat::network::{NetworkError, WeightOptions, Weights};
use scenesplat::objects::ObjectError;
use scenesplat::page::{PageError, PageInput, PageSettings, near_classes, page_parts};
#[cfg(any(test, target_family = "wasm"))]
use scenesplat::scene::SceneFormat;
#[cfg(target_family = "wasm")]
use scenesplat::scene::{GaussianScene, WriteOptions, formats::written_scene};
use scenesplat::scene::{LoadedScene, ReadOptions, SceneError};
use scenesplat::{Network, embedded};
use serde_json::{Value, json};
use std::path::Path;

/// Gaussians of the largest scene that is labeled: with more, the four gigabytes that a browser's program can address are
/// too few (about 1.2 kB a Gaussian are needed at the same time).
pub const MOST_GAUSSIANS: usize = 2_000_000;

/// Why something that was asked cannot be done. Messages are for people who dropped a file on a page.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// The file cannot be read.
    #[error(transparent)]
    Input(InputError),
    /// The scene cannot be written.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The scene is larger than a browser can label.
    #[error(
        "the scene has {count} Gaussians, a browser labels at most {MOST_GAUSSIANS}: crop or thin it first, or use the \
         program (scenesplat view FILE), which has no such limit"
    )]
    TooLarge {
        /// Gaussians of the scene.
        count: usize,
    },
    /// Something is asked about a scene before there is one.
    #[error("no scene was {0} yet")]
    Missing(&'static str),
    /// A name that does not exist.
    #[error("{given:?} is no {what}; there are {known}")]
    Unknown {
        /// What is named.
        what: &'static str,
        /// The name.
        given: String,
        /// Names that would do.
        known: String,
    },
    /// A list with one value a Gaussian has another length.
    #[error("{field}: expected {expected} values, one a Gaussian, got {got}")]
    Rows {
        /// Which list.
        field: &'static str,
        /// Gaussians of the scene.
        expected: usize,
        /// Values.
        got: usize,
    },
    /// The network cannot be loaded.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The network refused the scene.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// No labels.
    #[error(transparent)]
    Label(#[from] LabelError),
    /// No surfaces or objects.
    #[error(transparent)]
    Objects(#[from] ObjectError),
    /// Nothing to show.
    #[error(transparent)]
    Page(#[from] PageError),
    /// Data that belong to the program are missing or were given twice.
    #[error("the page is damaged: {0}")]
    Asset(String),
}

/// A network, and the scene that was read last.
pub struct Engine {
    network: Network,
    loaded: Option<LoadedScene>,
    /// How its Gaussians came about, where the file has none.
    made: Option<String>,
    labelled: Option<Labelled>,
}

impl Engine {
    /// The network that comes with the program.
    ///
    /// # Errors
    /// If it cannot be loaded.
    pub fn new() -> Result<Self, EngineError> {
        let config = embedded::config()?;
        let network = Network::load(config, &Weights::Embedded, WeightOptions::default())?;
        Ok(Self { network, loaded: None, made: None, labelled: None })
    }

    /// Gives the library one of the large files that it is without in a browser: `weights` or `phrases`.
    ///
    /// # Errors
    /// If there is no such file, or the library has it.
    pub fn give(name: &str, bytes: Vec<u8>) -> Result<(), EngineError> {
        let asset = match name {
            "weights" => embedded::weights(),
            "phrases" => near_classes(),
            _ => return Err(unknown("asset", name, "weights, phrases")),
        };
        asset.give(bytes).map_err(EngineError::Asset)
    }

    /// Reads a scene; the last one is forgotten. `name`: that of the file, for messages.
    ///
    /// # Errors
    /// If the bytes are no scene, or it is too large.
    pub fn parse(
        &mut self,
        name: &str,
        bytes: Vec<u8>,
        tell: Tell<'_>,
    ) -> Result<Value, EngineError> {
        (self.loaded, self.made, self.labelled) = (None, None, None);
        tell(Stage::Read, 0.0);
        let options = ReadOptions::default();
        let opened = open_input_owned(bytes, Path::new(name), &options, MOST_GAUSSIANS);
        let (opened, made) = opened.map_err(|error| match error {
            InputError::TooMany { count, .. } => EngineError::TooLarge { count },
            other => EngineError::Input(other),
        })?;
        let (loaded, is_cloud) = (opened.loaded, opened.converted);
        if loaded.scene.len() > MOST_GAUSSIANS {
            return Err(EngineError::TooLarge { count: loaded.scene.len() });
        }
        let about = json!({
            "name": name,
            "format": if is_cloud { "points" } else { loaded.kind.name() },
            "gaussians": loaded.scene.len(),
            "rowsOfFile": loaded.source_rows(),
            "shDegree": loaded.scene.sh_degree,
            "repairs": (!loaded.report.is_clean()).then(|| loaded.report.to_string()),
        });
        (self.loaded, self.made) = (Some(loaded), made);
        Ok(about)
    }

    /// Labels the scene and finds its objects.
    ///
    /// # Errors
    /// If there is none, or the network refuses it.
    pub fn segment(&mut self, tell: Tell<'_>) -> Result<Value, EngineError> {
        let loaded = self.loaded.as_ref().ok_or(EngineError::Missing("read"))?;
        self.labelled = None;
        let found = label(&self.network, loaded, tell)?;
        let about = json!({
            "classes": found.text.names,
            "objects": found.catalogue.objects,
            "up": found.alignment.turned_from.to_string(),
            "metresPerUnit": found.alignment.scale,
            "voxels": found.features.summary.voxels,
            "warnings": found.warnings,
            "remarks": found.remarks,
        });
        self.labelled = Some(found);
        Ok(about)
    }

    /// The blocks of the page that shows the labeled scene.
    ///
    /// # Errors
    /// If nothing was labeled.
    pub fn page(
        &self,
        title: &str,
        tell: Tell<'_>,
    ) -> Result<Vec<(&'static str, Vec<u8>)>, EngineError> {
        let (loaded, found) = self.labelled()?;
        tell(Stage::Page, 0.0);
        let mut remarks = vec![
            "Labels: a small network trained on synthetic rooms; it knows a closed set of classes."
                .to_owned(),
        ];
        remarks.extend(self.made.clone());
        if !loaded.report.is_clean() {
            remarks.push(loaded.report.to_string());
        }
        remarks.extend(found.remarks.iter().cloned());
        remarks.push(
            "Colors are those of the zeroth harmonic, seen from every side alike.".to_owned(),
        );
        let vocabulary = embedded::vocabulary()?;
        let input = PageInput {
            title,
            scene: &loaded.scene,
            labels: Some(&found.labels),
            scores: Some(&found.scores),
            names: &found.text.names,
            catalogue: Some(&found.catalogue),
            features: Some((&found.features, &found.text)),
            vocabulary: Some(&vocabulary),
            upright: found.alignment.upright(),
            metres_per_unit: found.alignment.scale,
            warnings: &found.warnings,
            remarks: &remarks,
        };
        Ok(page_parts(&input, &PageSettings::default())?)
    }

    /// One value or row a Gaussian, little-endian: `labels` and `instances` (i32, −1 = none), `scores`, `positions` [N, 3] and
    /// `features` [N, D] (f32).
    ///
    /// # Errors
    /// If there is no such list, or nothing was labeled.
    pub fn values(&self, name: &str) -> Result<Vec<u8>, EngineError> {
        let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect();
        if name == "positions" {
            let loaded = self.loaded.as_ref().ok_or(EngineError::Missing("read"))?;
            return Ok(floats(loaded.scene.coord.as_flattened()));
        }
        let (_, found) = self.labelled()?;
        Ok(match name {
            "labels" => found.labels.iter().flat_map(|v| v.to_le_bytes()).collect(),
            "instances" => {
                found.catalogue.instances().iter().flat_map(|v| v.to_le_bytes()).collect()
            }
            "scores" => floats(&found.scores),
            "features" => floats(&found.features.gaussian_rows(0..found.labels.len())?),
            _ => {
                return Err(unknown(
                    "list",
                    name,
                    "positions, labels, instances, scores, features",
                ));
            }
        })
    }

    #[cfg(target_family = "wasm")]
    /// The scene as a file of another format, with labels, scores and objects if it was labeled. `keep`: 0 for each Gaussian
    /// that is left out; empty for none.
    ///
    /// # Errors
    /// If there is no scene or format of this name, or the format cannot hold it.
    pub fn write(&self, format: &str, keep: &[u8], tell: Tell<'_>) -> Result<Vec<u8>, EngineError> {
        let loaded = self.loaded.as_ref().ok_or(EngineError::Missing("read"))?;
        let kind = SceneFormat::from_name(format).filter(|kind| WRITTEN.contains(kind));
        let known = || WRITTEN.map(SceneFormat::name).join(", ");
        let kind = kind.ok_or_else(|| unknown("format", format, &known()))?;
        let scene = self.outgoing(&loaded.scene, keep)?;
        let stated_up = Some(loaded.stated_up.direction);
        let options = WriteOptions { stated_up, ..WriteOptions::default() };
        tell(Stage::Write, 0.0);
        let mut progress = |share| {
            tell(Stage::Write, share);
            true
        };
        Ok(written_scene(&scene, kind, &options, &mut progress)?)
    }

    #[cfg(target_family = "wasm")]
    /// The scene with what was found, without the rows that are left out.
    fn outgoing(&self, scene: &GaussianScene, keep: &[u8]) -> Result<GaussianScene, EngineError> {
        if !keep.is_empty() && keep.len() != scene.len() {
            let (expected, got) = (scene.len(), keep.len());
            return Err(EngineError::Rows { field: "keep", expected, got });
        }
        let rows: Vec<usize> =
            (0..scene.len()).filter(|&row| keep.get(row).is_none_or(|k| *k != 0)).collect();
        let mut out = scene.select_rows(&rows)?;
        if let Some(found) = &self.labelled {
            let instances = found.catalogue.instances();
            out.segment = Some(rows.iter().map(|&row| found.labels[row]).collect());
            out.segment_score = Some(rows.iter().map(|&row| found.scores[row]).collect());
            out.instance = Some(rows.iter().map(|&row| instances[row]).collect());
        }
        Ok(out)
    }

    fn labelled(&self) -> Result<(&LoadedScene, &Labelled), EngineError> {
        let both = self.loaded.as_ref().zip(self.labelled.as_ref());
        both.ok_or(EngineError::Missing("labeled"))
    }
}

#[cfg(target_family = "wasm")]
/// Formats that hold everything in one file.
const WRITTEN: [SceneFormat; 2] = [SceneFormat::Ply, SceneFormat::Spz];

fn unknown(what: &'static str, given: &str, known: &str) -> EngineError {
    EngineError::Unknown { what, given: given.to_owned(), known: known.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat::rooms::{SyntheticRoomSettings, generate};
    use scenesplat::scene::{WriteOptions, write_scene};

    #[test]
    fn bytes_of_a_room_become_labels_objects_and_a_page() {
        let room = generate(&SyntheticRoomSettings::with_count(12_000, 3)).unwrap().scene;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("room.spz");
        let options = WriteOptions::default();
        write_scene(&room, &path, SceneFormat::Spz, &options, &mut |_| true).unwrap();
        let mut engine = Engine::new().unwrap();
        assert!(matches!(engine.values("labels"), Err(EngineError::Missing("labeled"))));
        let mut stages = Vec::new();
        let mut tell = |stage, _| {
            if stages.last() != Some(&stage) {
                stages.push(stage);
            }
        };
        let about = engine.parse("room.spz", std::fs::read(&path).unwrap(), &mut tell).unwrap();
        assert_eq!((&about["format"], &about["gaussians"]), (&json!("spz"), &json!(room.len())));
        let found = engine.segment(&mut tell).unwrap();
        let parts = engine.page("room", &mut tell).unwrap();
        assert!(stages.is_sorted_by_key(|stage| *stage as u32), "{stages:?}");
        assert_eq!(stages.len(), Stage::Page as usize + 1);
        let labels = engine.values("labels").unwrap();
        let labels: Vec<i32> =
            labels.as_chunks().0.iter().map(|bytes| i32::from_le_bytes(*bytes)).collect();
        let names = found["classes"].as_array().unwrap();
        let walls = labels.iter().filter(|l| **l >= 0 && names[**l as usize] == "wall").count();
        assert!(walls > room.len() / 20, "{walls} of {} are wall", room.len());
        assert!(
            parts.iter().any(|(name, bytes)| *name == "label" && bytes.len() == 2 * room.len())
        );
        assert!(engine.values("names").unwrap_err().to_string().contains("positions, labels"));
        let error = engine.parse("a.ply", b"ply nonsense".to_vec(), &mut |_, _| ()).unwrap_err();
        assert!(error.to_string().contains("a.ply"), "{error}");
        assert!(matches!(engine.segment(&mut |_, _| ()), Err(EngineError::Missing("read"))));
    }

    #[test]
    fn points_become_the_discs_that_the_program_makes_of_them() {
        let mut text = "ply\nformat ascii 1.0\nelement vertex 400\n".to_owned();
        for name in
            ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue", "int label"]
        {
            text += &format!("property {name}\n");
        }
        text += "end_header\n";
        for i in 0..400 {
            text += &format!(
                "{} {} 0 200 100 50 {}\n",
                0.05 * f64::from(i % 20),
                0.05 * f64::from(i / 20),
                i % 3
            );
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.ply");
        std::fs::write(&path, &text).unwrap();
        let (expected, said) =
            scenesplat::input::open_input(&path, &ReadOptions::default()).unwrap();
        let mut engine = Engine::new().unwrap();
        let about = engine.parse("points.ply", text.into_bytes(), &mut |_, _| ()).unwrap();
        assert_eq!((&about["format"], &about["gaussians"]), (&json!("points"), &json!(400)));
        let floats =
            |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        assert_eq!(
            engine.values("positions").unwrap(),
            floats(expected.loaded.scene.coord.as_flattened())
        );
        assert_eq!(engine.loaded.as_ref().unwrap().scene, expected.loaded.scene);
        let made = engine.made.as_deref().unwrap();
        assert!(
            said.unwrap().ends_with(made) && made.contains("400 points became discs"),
            "{made}"
        );
        // What follows has none of it.
        let error = engine.parse("a.ply", b"ply nonsense".to_vec(), &mut |_, _| ()).unwrap_err();
        assert!(error.to_string().contains("a.ply") && engine.made.is_none(), "{error}");
    }
}
