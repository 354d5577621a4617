//! Scenes of an experiment: where they come from and how they become batches.

use super::config::{
    EvaluationConfig, ExperimentConfig, Task, TextConfig, TrainDataConfig, TransformList,
};
use super::error::{ExperimentError, Place};
use super::teacher::Teacher;
use crate::text::{class_list, read_text_table};
use scenesplat_datasets::teacher::steps_after_look;
use scenesplat_datasets::transforms::{LimitLabels, build_transforms};
use scenesplat_datasets::{
    BatchLoader, Dataset, SceneLoader, SceneTeacher, SomeScenes, SourceConfig, TeacherView,
    TrainBatch, WeightedMix,
};
use scenesplat_rooms::CLASSES;
use scenesplat_rooms::vocabulary::Vocabulary;
use scenesplat_scene::label_set::find_name;
use scenesplat_scene::{LabelSet, TextTable};
use std::sync::Arc;

type Result<T, E = ExperimentError> = std::result::Result<T, E>;

/// Batches to train on, with the rows of a teacher, if there is one.
///
/// # Errors
/// If scenes or transforms cannot be had, or the teacher would not see what the transforms do.
pub fn loader(
    config: &ExperimentConfig,
    teacher: Option<&Teacher>,
) -> Result<Box<dyn BatchLoader<TrainBatch>>> {
    let mut loaders = Vec::with_capacity(config.train.len());
    for (i, entry) in config.train.iter().enumerate() {
        loaders.push(scene_loader(config, entry, teacher).at(|| format!("train[{i}]"))?);
    }
    if loaders.len() == 1 && config.train[0].weight == 1 {
        return Ok(config.limits.of_loader(Box::new(loaders.remove(0))));
    }
    let weights = config.train.iter().map(|entry| entry.weight).collect();
    Ok(config.limits.of_loader(Box::new(WeightedMix::new(loaders, weights, config.mix)?)))
}

fn scene_loader(
    config: &ExperimentConfig,
    entry: &TrainDataConfig,
    teacher: Option<&Teacher>,
) -> Result<SceneLoader> {
    let data = dataset(
        &entry.source,
        &entry.transforms,
        config.model.grid_size,
        entry.labels,
        entry.seed,
        entry.repeat,
        teacher.map(|teacher| &teacher.train),
    )?;
    Ok(SceneLoader::new(data, config.input.clone(), config.loader.clone())?)
}

/// Scenes of an evaluation, with the rows of a teacher, if there is one.
///
/// # Errors
/// If scenes or transforms cannot be had, or the teacher would not see what the transforms do.
pub fn evaluation(
    entry: &EvaluationConfig,
    config: &ExperimentConfig,
    teacher: Option<&Teacher>,
) -> Result<Arc<dyn Dataset>> {
    let source = entry.source.clone().for_evaluation();
    let teacher = teacher.map(|teacher| &teacher.evaluate);
    let mut data = dataset(&source, &entry.transforms, config.model.grid_size, None, 0, 1, teacher)
        .at(|| format!("evaluate {:?}", entry.name))?;
    if let (Some(batches), Some(train)) = (config.limits.overfit, config.train.first()) {
        let seen =
            scene_loader(config, train, None).at(|| "train[0]".to_owned())?.scenes(0, batches);
        data = Arc::new(SomeScenes::named(data, |id| seen.contains(id)));
    }
    if let Some(amount) = config.limits.evaluate {
        let count = amount.of(data.len());
        data = Arc::new(SomeScenes::new(data, 0..count));
    }
    Ok(data)
}

fn dataset(
    source: &SourceConfig,
    transforms: &TransformList,
    grid_size: f64,
    labels: Option<LimitLabels>,
    seed: u64,
    repeat: usize,
    teacher: Option<&Arc<dyn SceneTeacher>>,
) -> Result<Arc<dyn Dataset>> {
    let steps = transforms.steps(grid_size)?;
    let mut built = build_transforms(&steps)?;
    if let Some(labels) = labels {
        built.insert(0, Arc::new(labels));
    }
    let data = source.dataset(built, seed, repeat)?;
    let Some(teacher) = teacher else { return Ok(Arc::new(data)) };
    let steps_after = match teacher.view() {
        TeacherView::Augmented => steps_after_look(&steps)?,
        TeacherView::Scene => steps.len(),
    };
    Ok(Arc::new(data.with_teacher(Arc::clone(teacher), steps_after)))
}

/// Texts of the classes, and which are background.
#[derive(Debug, Clone)]
pub struct ClassTexts {
    /// One row for each class of the labels.
    pub table: TextTable,
    /// Names left out of the averages that begin with f; `None` for what the benchmark leaves out.
    pub exclude: Option<Vec<String>>,
    /// Whether the rows go by the names of the classes, rather than by names that were chosen for
    /// them.
    pub has_class_names: bool,
}

impl ClassTexts {
    /// Refuses texts that are not those of the labels.
    ///
    /// # Errors
    /// If there are more or fewer rows than classes, or the first name that differs.
    fn check(&self, classes: &LabelSet) -> Result<()> {
        let names = &self.table.names;
        if names.len() != classes.len() {
            return Err(ExperimentError::Classes(format!(
                "the labels have {} classes and the texts {} rows; take the table of these classes, \
                 or choose its rows in the order of the labels with `rows`",
                classes.len(),
                names.len()
            )));
        }
        if !self.has_class_names {
            return Ok(());
        }
        let differing = classes
            .names
            .iter()
            .zip(names)
            .enumerate()
            .find(|(_, (class, text))| find_name(std::slice::from_ref(*text), class).is_err());
        match differing {
            None => Ok(()),
            Some((i, (class, text))) => Err(ExperimentError::Classes(format!(
                "class {i} of the labels is {class:?} and row {i} of the texts {text:?}; take the \
                 table of these classes, or choose its rows in the order of the labels with `rows`"
            ))),
        }
    }
}

/// Checks that the labels of every source are those of the texts or of the classifier, where they are
/// used, and that every list of classes can be read.
///
/// # Errors
/// Names the first source whose classes do not fit.
pub fn check_classes(config: &ExperimentConfig, text: Option<&ClassTexts>) -> Result<()> {
    let by_text = config.task != Task::SemanticSegmentation;
    let used_in_training = config.reads_labels();
    let check = |source: &SourceConfig, used: bool, text: Option<&ClassTexts>| -> Result<()> {
        let classes = if used { source.needed_label_set()? } else { source.label_set()? };
        let Some(classes) = classes.filter(|_| used) else { return Ok(()) };
        if let (true, Some(text)) = (by_text, text) {
            return text.check(&classes);
        }
        if let Some(n) = config.model.num_classes().filter(|n| *n != classes.len()) {
            return Err(ExperimentError::Classes(format!(
                "the labels have {} classes and model.num_classes is {n}",
                classes.len()
            )));
        }
        // Texts say which classes averages leave out, and losses may look at them.
        text.map_or(Ok(()), |text| text.check(&classes))
    };
    for (i, entry) in config.train.iter().enumerate() {
        check(&entry.source, used_in_training, text).at(|| format!("train[{i}]"))?;
    }
    for entry in &config.evaluations() {
        let own = entry.text.as_ref().map(text_table).transpose()?;
        check(&entry.source, true, own.as_ref().or(text))
            .at(|| format!("evaluate {:?}", entry.name))?;
    }
    Ok(())
}

/// Classes that the averages of an evaluation leave out: those that the texts name, else those that
/// its benchmark does.
///
/// # Errors
/// If a name is not a class.
pub fn excluded(source: &SourceConfig, text: Option<&ClassTexts>) -> Result<Vec<usize>> {
    if let Some((text, names)) = text.and_then(|text| Some((text, text.exclude.as_ref()?))) {
        return Ok(class_list(&LabelSet::new(text.table.names.clone())?, names)?);
    }
    Ok(source.label_set()?.map_or_else(Vec::new, |classes| classes.excluded))
}

/// Reads or makes the texts of the classes.
///
/// # Errors
/// If a table cannot be read or lacks a row.
pub fn text_table(config: &TextConfig) -> Result<ClassTexts> {
    let (table, exclude, has_class_names) = match config {
        TextConfig::Vocabulary { dim, exclude } => {
            (Vocabulary::new(*dim)?.class_table(), Some(exclude.clone()), true)
        }
        TextConfig::Table { path, names, rows, exclude } => {
            let table = read_text_table(path, names.as_deref())?;
            let table = if rows.is_empty() {
                table
            } else {
                choose(&table, rows, rows.clone()).at(|| path.display().to_string())?
            };
            (table, exclude.clone(), rows.is_empty())
        }
        TextConfig::SyntheticClasses { path, names, exclude } => {
            let table = read_text_table(path, names.as_deref())?;
            let rows: Vec<String> = CLASSES.iter().map(|c| c.scannet200_name.to_owned()).collect();
            let names = CLASSES.iter().map(|c| c.name.to_owned()).collect();
            let table = choose(&table, &rows, names).at(|| path.display().to_string())?;
            (table, Some(exclude.clone()), true)
        }
    };
    Ok(ClassTexts { table, exclude, has_class_names })
}

/// The named rows of a table, in this order, under new names.
fn choose(table: &TextTable, rows: &[String], names: Vec<String>) -> Result<TextTable> {
    let set = LabelSet::new(table.names.clone())?;
    let mut values = Vec::with_capacity(rows.len() * table.dim);
    for name in rows {
        values.extend_from_slice(table.row(set.index_of(name)?).unwrap_or_default());
    }
    Ok(TextTable::from_rows(names, values, table.dim)?)
}
#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_datasets::chunking::{ChunkFolder, ChunkSettings};
    use scenesplat_rooms::{SyntheticRoomSettings, generate};
    use scenesplat_scene::formats::npy_folder::write_npy_folder;
    use scenesplat_test_support::repository;
    use std::path::Path;

    #[test]
    fn few_labels_are_the_same_in_every_epoch() {
        let config = |task: &str, labels: &str| -> ExperimentConfig {
            let text = format!(
                "task = '{task}'\n[model]\ngrid_size = 0.2\nnum_classes = 41\n[[train]]\n{labels}\n\
                 source = {{ type = 'synthetic', count = 1, room = {{ num_gaussians = 3000 }} }}\n\
                 transforms = 'validation'\n[loader]\nbatch_size = 1\nmix_probability = 0.0\nworkers = 0\n\
                 [[losses]]\ntype = 'cross_entropy'"
            );
            toml::from_str(&text).unwrap()
        };
        let labelled = |labels: &str, epoch| -> Vec<usize> {
            let config = config("semantic_segmentation", labels);
            config.check().unwrap();
            let mut loader = loader(&config, None).unwrap();
            let batch = loader.epoch(epoch, 0).next().unwrap().unwrap();
            let segment = batch.segment.unwrap();
            (0..segment.len()).filter(|row| segment[*row] >= 0).collect()
        };
        let (all, few) = (labelled("", 0), labelled("labels = { keep = { share = 0.1 } }", 0));
        assert!(!few.is_empty() && few.len() * 5 < all.len(), "{} of {}", few.len(), all.len());
        assert_eq!(few, labelled("labels = { keep = { share = 0.1 } }", 3));
        assert_ne!(few, labelled("labels = { keep = { share = 0.1 }, seed = 1 }", 0));
        assert!(labelled("labels = { keep = { per_scene = 20 } }", 0).len() <= 20);
        let wrong = told(
            config("semantic_segmentation", "labels = { keep = { share = 2.0 } }")
                .check()
                .unwrap_err(),
        );
        assert!(wrong.contains("train[0]") && wrong.contains("labels.keep.share"), "{wrong}");
        let mut vain = config("language_pretraining", "labels = { keep = { per_scene = 20 } }");
        vain.losses = vec![toml::from_str("type = 'cosine'").unwrap()];
        let vain = told(vain.check().unwrap_err());
        assert!(vain.contains("train[0].labels") && vain.contains("leave it out"), "{vain}");
    }

    /// An error as programs print it.
    fn told(error: ExperimentError) -> String {
        format!("{:#}", anyhow::Error::from(error))
    }

    /// A folder of benchmarks with one small scene in each split, as their preprocessing leaves them.
    fn benchmarks() -> tempfile::TempDir {
        let data = tempfile::tempdir().unwrap();
        let scene = generate(&SyntheticRoomSettings::with_count(400, 3)).unwrap().scene;
        for (name, labels) in [
            ("matterport3d", "segment_nyu_160"),
            ("scannetpp", "segment"),
            ("scannet", "segment200"),
        ] {
            for split in ["train", "val", "test"] {
                let folder = data.path().join(name).join(split).join("scene_00");
                std::fs::create_dir_all(folder.parent().unwrap()).unwrap();
                write_npy_folder(&scene, &folder, false).unwrap();
                if labels != "segment" {
                    std::fs::rename(
                        folder.join("segment.npy"),
                        folder.join(format!("{labels}.npy")),
                    )
                    .unwrap();
                }
            }
        }
        data
    }

    fn cut(data: &Path, benchmark: &str, splits: [&str; 2]) {
        // Small scenes have few Gaussians; all else as the program cuts them.
        let settings = ChunkSettings { minimum_size: 1, ..ChunkSettings::default() };
        for split in splits {
            let folder = ChunkFolder::open(&data.join(benchmark), split, settings.clone()).unwrap();
            let scene = data.join(benchmark).join(split).join("scene_00");
            folder.cut("scene_00", &scene, &mut |_| true).unwrap();
        }
    }

    fn read(file: &str, data: &Path) -> ExperimentConfig {
        let path = repository().join("configs").join(file);
        let value = |_: &str| Some(data.display().to_string());
        ExperimentConfig::read_with(&path, &value).unwrap()
    }

    #[test]
    fn configurations_start_from_what_chunking_writes() {
        let data = benchmarks();
        let run = |file: &str| -> Result<usize> {
            let config = read(file, data.path());
            let loader = loader(&config, None)?;
            for entry in &config.evaluate {
                assert!(!evaluation(entry, &config, None)?.is_empty());
            }
            Ok(loader.batches_per_epoch())
        };
        let files = ["joint", "matterport3d", "scannetpp", "scannet_scannetpp"]
            .map(|name| format!("language_pretraining/{name}.toml"));
        for file in &files {
            let error = told(run(file).err().unwrap());
            assert!(error.contains("scenesplat chunk"), "{file}: {error}");
        }
        cut(data.path(), "matterport3d", ["train", "val"]);
        cut(data.path(), "scannetpp", ["train", "test"]);
        cut(data.path(), "scannet", ["train", "test"]);
        for file in &files {
            assert!(run(file).unwrap() > 0, "{file}");
        }
    }

    fn texts(names: &[String], exclude: Option<Vec<String>>) -> ClassTexts {
        let dim = 2;
        let values = names.iter().flat_map(|_| [1.0, 0.0]).collect();
        let table = TextTable::from_rows(names.to_vec(), values, dim).unwrap();
        ClassTexts { table, exclude, has_class_names: true }
    }

    #[test]
    fn labels_must_be_those_of_the_texts() {
        let data = benchmarks();
        let mut config = read("language_pretraining/scannet.toml", data.path());
        let names = config.evaluate[0].source.label_set().unwrap().unwrap().names;
        check_classes(&config, Some(&texts(&names, None))).unwrap();
        let refused = |config: &ExperimentConfig, text: &ClassTexts| {
            told(check_classes(config, Some(text)).unwrap_err())
        };
        let error = refused(&config, &texts(&names[..199], None));
        assert!(error.contains("200 classes") && error.contains("199 rows"), "{error}");
        let mut swapped = names.clone();
        swapped.swap(3, 7);
        let error = refused(&config, &texts(&swapped, None));
        assert!(error.contains("class 3") && error.contains(&names[3]), "{error}");
        let chosen = ClassTexts { has_class_names: false, ..texts(&swapped, None) };
        check_classes(&config, Some(&chosen)).unwrap();
        // Other spellings are the same names.
        let upper: Vec<String> = names.iter().map(|n| n.to_uppercase().replace(' ', "_")).collect();
        check_classes(&config, Some(&texts(&upper, None))).unwrap();
        let source = &config.evaluate[0].source;
        assert_eq!(excluded(source, Some(&texts(&names, None))).unwrap(), [0, 2, 35]);
        let own = texts(&names, Some(vec!["chair".to_owned()]));
        assert_eq!(excluded(source, Some(&own)).unwrap().len(), 1);
        assert_eq!(excluded(source, None).unwrap(), [0, 2, 35]);
        config = read("semantic_segmentation/scannet20.toml", data.path());
        check_classes(&config, None).unwrap();
        config.model = config.model.with_classes(21);
        let error = told(check_classes(&config, None).unwrap_err());
        assert!(error.contains("20 classes") && error.contains("21"), "{error}");
        let missing = r#"{"type": "generic", "root": ".", "class_names": "nowhere.txt"}"#;
        config.train[0].source = serde_json::from_str(missing).unwrap();
        let error = told(check_classes(&config, None).unwrap_err());
        assert!(error.contains("nowhere.txt"), "{error}");
    }
}
