//! Whose rows a distilled network learns: from a table of the file to what scenes are shown.

mod cache;
mod config;
mod network;
mod record;
mod stored;

pub use config::{CacheConfig, NetworkTeacherConfig, StoredTeacherConfig, TeacherConfig};
pub use record::TeacherRecord;

use super::config::ExperimentConfig;
use super::error::{ExperimentError, Place};
use crate::network::{Network, NetworkConfig, WeightOptions, Weights, network_of};
use cache::Cache;
use network::{NetworkTeacher, Reader};
use scenesplat_datasets::{SceneTeacher, TeacherView};
use scenesplat_models::Compute;
use sha2::{Digest, Sha256};
use std::sync::Arc;
use stored::StoredTeacher;

type Result<T, E = ExperimentError> = std::result::Result<T, E>;

/// The teacher of an experiment.
pub struct Teacher {
    /// Looks at scenes to train on.
    pub train: Arc<dyn SceneTeacher>,
    /// Looks at scenes to evaluate, which come again unchanged: a cache keeps its rows whatever it is
    /// shown.
    pub evaluate: Arc<dyn SceneTeacher>,
    /// What it has done so far.
    pub record: Arc<TeacherRecord>,
    /// A checksum of what decides its rows; `None` for features that the scenes hold themselves.
    pub content: Option<String>,
}

impl Teacher {
    /// The teacher that an experiment names; `None` if it names none.
    ///
    /// # Errors
    /// If it cannot be read, gives classes instead of features, or its rows are not as wide as the
    /// student's.
    pub fn open(config: &ExperimentConfig) -> Result<Option<Self>> {
        match &config.teacher {
            None => Ok(None),
            Some(TeacherConfig::Network(teacher)) => {
                Self::network(teacher, config).at(|| "teacher".to_owned()).map(Some)
            }
            Some(TeacherConfig::Features(teacher)) => {
                Self::stored(teacher, config).at(|| "teacher".to_owned()).map(Some)
            }
        }
    }

    fn network(config: &NetworkTeacherConfig, experiment: &ExperimentConfig) -> Result<Self> {
        let weights = config::weights(&config.weights)?;
        let choice = match &config.config {
            None => None,
            Some(name) => {
                let parsed = name.to_string_lossy().parse();
                Some(parsed.map_err(|e: String| ExperimentError::setting("config", e))?)
            }
        };
        if choice.is_some() && weights == Weights::Embedded {
            let problem = "the embedded network has its own; leave it out";
            return Err(ExperimentError::setting("config", problem));
        }
        let options = WeightOptions::default();
        let of_weights = network_of(&weights, choice.as_ref(), &options)?;
        let precision = config::precision(&config.precision)?;
        let compute = Compute { precision, ..of_weights.model.backbone.get().compute() };
        let network = Network::load(of_weights.clone().with_compute(compute), &weights, options)?;
        if network.is_classifier() {
            let problem = "gives classes; a teacher gives features";
            return Err(ExperimentError::setting("weights", problem));
        }
        check_width(network.model().out_channels(), experiment)?;
        let content = content(&of_weights, &weights, &network)?;
        let identity = format!("{content}, {precision:?}");
        let reader = Arc::new(Reader::new(network, identity));
        let record = Arc::new(TeacherRecord::new(Some(content.clone())));
        let cache = match &config.cache {
            Some(cache) => {
                let opened = Cache::new(cache, Arc::clone(&record));
                Some(Arc::new(opened.map_err(ExperimentError::io(&cache.folder))?))
            }
            None => None,
        };
        let looking = |cache: Option<Arc<Cache>>| -> Arc<dyn SceneTeacher> {
            let (reader, record) = (Arc::clone(&reader), Arc::clone(&record));
            Arc::new(NetworkTeacher { reader, view: config.view, cache, record })
        };
        // What is augmented never comes again.
        let again = cache.clone().filter(|_| config.view == TeacherView::Scene);
        Ok(Self {
            train: looking(again),
            evaluate: looking(cache),
            record: Arc::clone(&record),
            content: Some(content),
        })
    }

    fn stored(config: &StoredTeacherConfig, experiment: &ExperimentConfig) -> Result<Self> {
        let content = match &config.folder {
            None => None,
            Some(folder) => {
                let mut hash = Sha256::new();
                let train = experiment.train.iter().map(|entry| &entry.source);
                let evaluate = experiment.evaluate.iter().map(|entry| &entry.source);
                for source in train.chain(evaluate) {
                    for id in source.build()?.scene_ids() {
                        let path = stored::feature_file(folder, id).at(|| id.clone())?;
                        check_width(stored::width(&path)?, experiment)
                            .at(|| path.display().to_string())?;
                        hash.update(id);
                        stored::fingerprint(&path, &mut hash)?;
                    }
                }
                Some(super::identity::hex(hash))
            }
        };
        let record = Arc::new(TeacherRecord::new(content.clone()));
        let folder = config.folder.clone();
        let teacher: Arc<dyn SceneTeacher> =
            Arc::new(StoredTeacher { folder, record: Arc::clone(&record) });
        Ok(Self { train: Arc::clone(&teacher), evaluate: teacher, record, content })
    }
}

fn check_width(width: usize, experiment: &ExperimentConfig) -> Result<()> {
    let student = experiment.model.out_channels();
    if width == student {
        return Ok(());
    }
    let problem = format!(
        "the student's features are {student} wide and the teacher's {width}; set it to {width}"
    );
    Err(ExperimentError::setting("model.projection", problem))
}

/// A checksum of a network: its configuration and the bytes of its weights.
fn content(config: &NetworkConfig, weights: &Weights, network: &Network) -> Result<String> {
    let mut hash = Sha256::new();
    hash.update(serde_json::to_string(config)?);
    match weights {
        Weights::Embedded => hash.update(crate::embedded::sha256()),
        Weights::Seeded(seed) => hash.update(format!("seeded:{seed}")),
        Weights::File(_) => network.files().iter().for_each(|(_, sha)| hash.update(sha)),
    }
    Ok(super::identity::hex(hash))
}
