//! What a teacher of pictures saw, as labels of Gaussians: the folder that `collect-labels --teacher` leaves.

use crate::lifted::{IndexedRows, LiftedError, LiftedFiles};
use crate::text::{TextError, read_text_table};
use half::f16;
use rayon::prelude::*;
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::{SceneError, printable};
use scenesplat_text::{PhraseError, PhraseReader, Verdict};
use std::path::{Path, PathBuf};

/// Names of a teacher's texts with their vectors, in its folder.
pub const TEXTS: &str = "classes.safetensors";

/// Why a teacher's labels could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TaughtError {
    /// A file that cannot be read.
    #[error(transparent)]
    File(#[from] SceneError),
    /// Features in their index form that cannot be read.
    #[error(transparent)]
    Lifted(#[from] LiftedError),
    /// Texts that cannot be read.
    #[error(transparent)]
    Text(#[from] TextError),
    /// The phrase table inside the program is damaged.
    #[error(transparent)]
    Phrases(#[from] PhraseError),
    /// Files that do not belong together.
    #[error(
        "{}: {problem} (give the folder that collect-labels --teacher wrote for this scene)",
        printable(path)
    )]
    Folder {
        /// Which file.
        path: PathBuf,
        /// What does not fit.
        problem: String,
    },
}

/// Labels that a teacher gives.
#[derive(Debug, Clone, PartialEq)]
pub struct TaughtLabels {
    /// Class of each row of the scene's file, −1 where the teacher names none of the classes. `[N]`
    pub labels: Vec<i32>,
    /// How much the pictures agree, 0 to 1. `[N]`
    pub confidence: Vec<f32>,
    /// The teacher's names that are no class, with the number of rows that have them, most first.
    pub unused: Vec<(String, usize)>,
}

/// The class that each of a teacher's texts is: that of its name; where the classes are the built-in vocabulary's, the one that
/// its phrase surely means.
pub(crate) fn classes_of_names(
    texts: &[String],
    names: &[String],
    is_vocabulary: bool,
) -> Result<Vec<Option<usize>>, PhraseError> {
    let reader = is_vocabulary.then(|| PhraseReader::new(None)).transpose()?;
    let class = |text: &String| {
        let own = names.iter().position(|name| name == text);
        let meant = || {
            let reading = reader.as_ref()?.read(text).ok()?;
            let nearest = reading.nearest.first()?;
            let is_class = reading.colors.is_empty() && reading.purpose.is_none();
            (reading.verdict == Verdict::Sure && is_class).then_some(nearest.class.about().name)
        };
        own.or_else(|| meant().and_then(|meant| names.iter().position(|name| name == meant)))
    };
    Ok(texts.iter().map(class).collect())
}

/// Reads what a teacher saw as some of the classes `names`. A text of the teacher is the class of its name; where the classes
/// are the built-in vocabulary's (`is_vocabulary`), it is what its phrase surely means ("dining table" a table).
///
/// # Errors
/// If a file is missing, is damaged, or does not fit the others.
pub fn taught_labels(
    folder: &Path,
    names: &[String],
    is_vocabulary: bool,
) -> Result<TaughtLabels, TaughtError> {
    let texts = read_text_table(&folder.join(TEXTS), None)?;
    let classes = classes_of_names(&texts.names, names, is_vocabulary)?;

    let bad = |path: &Path, problem: String| TaughtError::Folder { path: path.to_owned(), problem };
    let files = LiftedFiles::of(folder)?;
    let (features, dim, cluster_of) = match &files {
        LiftedFiles::Full(path) => {
            let file = NpyFile::open(path)?;
            let &[_, dim] = file.shape() else {
                let problem = format!("has shape {:?}, not [Gaussians, values]", file.shape());
                return Err(bad(path, problem));
            };
            (file.read_f16()?, dim, None)
        }
        LiftedFiles::Index(index, clusters) => {
            let found = IndexedRows::read(index, clusters)?;
            (found.rows, found.dim, Some(found.cluster_of))
        }
    };
    if dim != texts.dim {
        let problem = format!("has {dim} values a row, the texts beside it {}", texts.dim);
        return Err(bad(files.features(), problem));
    }
    // The nearest text of each row, the first of equally near ones.
    let text_of = |row: usize| {
        let own = &features[row * dim..][..dim];
        if own.iter().all(|v| *v == f16::ZERO) {
            return None;
        }
        let mut best = (f32::NEG_INFINITY, None);
        for (text, vector) in texts.values.chunks_exact(dim).enumerate() {
            let similarity: f32 = own.iter().zip(vector).map(|(a, b)| a.to_f32() * b).sum();
            if similarity > best.0 {
                best = (similarity, Some(text));
            }
        }
        best.1
    };
    let nearest: Vec<Option<usize>> =
        (0..features.len() / dim).into_par_iter().map(text_of).collect();
    let nearest = match cluster_of {
        None => nearest,
        Some(of) => {
            let text_of = |cluster: &Option<u16>| nearest[usize::from((*cluster)?)];
            of.iter().map(text_of).collect()
        }
    };
    let confidence_path = folder.join("confidence.npy");
    let confidence = NpyFile::open(&confidence_path)?.read_f32()?;
    if confidence.len() != nearest.len() {
        let rows = nearest.len();
        let problem = format!("has {} values for {rows} rows of features", confidence.len());
        return Err(bad(&confidence_path, problem));
    }
    let mut counts = vec![0; texts.names.len()];
    nearest.iter().flatten().for_each(|text| counts[*text] += 1);
    let unused = texts.names.iter().zip(&classes).zip(&counts);
    let mut unused: Vec<(String, usize)> = unused
        .filter(|((_, class), count)| class.is_none() && **count > 0)
        .map(|((name, _), count)| (name.clone(), *count))
        .collect();
    unused.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)));
    let label =
        |text: &Option<usize>| text.and_then(|text| classes[text]).map_or(-1, |class| class as i32);
    Ok(TaughtLabels { labels: nearest.iter().map(label).collect(), confidence, unused })
}

impl TaughtLabels {
    /// Puts the teacher's labels over others', where it has one; gives the number of labels that changed. `rows`: the row
    /// of the file that each label is of, where some were left out.
    pub fn overrule(&self, labels: &mut [i32], scores: &mut [f32], rows: Option<&[u32]>) -> usize {
        let mut changed = 0;
        for (at, (label, score)) in labels.iter_mut().zip(scores).enumerate() {
            let row = rows.map_or(at, |rows| rows[at] as usize);
            let taught = self.labels[row];
            if taught >= 0 {
                changed += usize::from(*label != taught);
                (*label, *score) = (taught, self.confidence[row]);
            }
        }
        changed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_scene::TextTable;
    use scenesplat_scene::formats::npy_writer::write_npy;

    /// Texts along three axes.
    fn write(folder: &Path, names: [&str; 3], rows: &[[f32; 3]], confidence: &[f32]) {
        let values = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let table = TextTable { names: names.map(str::to_owned).to_vec(), dim: 3, values };
        std::fs::write(folder.join(TEXTS), table.to_safetensors().unwrap()).unwrap();
        let values: Vec<half::f16> =
            rows.iter().flatten().map(|v| half::f16::from_f32(*v)).collect();
        write_npy(&folder.join("lang_feat.npy"), &[rows.len(), 3], &values).unwrap();
        write_npy(&folder.join("confidence.npy"), &[confidence.len()], confidence).unwrap();
    }

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn rows_get_the_class_that_the_nearest_name_surely_means() {
        let folder = tempfile::tempdir().unwrap();
        let rows = [[0.9, 0.3, 0.0], [0.0; 3], [0.1, 0.8, 0.2], [0.0, 0.0, 1.0], [0.5, 0.5, 0.0]];
        write(
            folder.path(),
            ["dining table", "bottle", "chair"],
            &rows,
            &[0.9, 0.0, 0.8, 0.7, 0.6],
        );
        let classes = names(&["wall", "table", "chair"]);
        let found = taught_labels(folder.path(), &classes, true).unwrap();
        // A bottle is none of the classes; of equally near names the first counts.
        assert_eq!(found.labels, [1, -1, -1, 2, 1]);
        assert_eq!(found.unused, [("bottle".to_owned(), 1)]);
        // In other vocabularies only the name itself is the class.
        let plain = taught_labels(folder.path(), &classes, false).unwrap();
        assert_eq!(plain.labels, [-1, -1, -1, 2, -1]);
        assert_eq!(plain.unused, [("dining table".to_owned(), 2), ("bottle".to_owned(), 1)]);

        // Rows 0, 2, 3 of the file were kept.
        let (mut labels, mut scores) = ([0, 0, 2], [0.1, 0.2, 0.3]);
        assert_eq!(found.overrule(&mut labels, &mut scores, Some(&[0, 2, 3])), 1);
        assert_eq!((labels, scores), ([1, 0, 2], [0.9, 0.2, 0.7]));
        let (mut labels, mut scores) = ([-1; 5], [0.5; 5]);
        assert_eq!(found.overrule(&mut labels, &mut scores, None), 3);
        assert_eq!((labels, scores), ([1, -1, -1, 2, 1], [0.9, 0.5, 0.5, 0.7, 0.6]));
    }

    #[test]
    fn both_forms_of_features_are_read_and_not_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        let rows = [[0.9, 0.3, 0.0], [0.0; 3], [0.1, 0.8, 0.2], [0.9, 0.3, 0.0], [0.0, 0.0, 1.0]];
        write(path, ["table", "bottle", "chair"], &rows, &[0.9, 0.0, 0.8, 0.7, 0.6]);
        let classes = names(&["table", "chair"]);
        let full = taught_labels(path, &classes, false).unwrap();
        let table: Vec<f16> = [&rows[2], &rows[0], &rows[4]]
            .into_iter()
            .flatten()
            .map(|v| f16::from_f32(*v))
            .collect();
        write_npy(&path.join("segment_index.npy"), &[5], &[1, 65_535, 0, 1, 2]).unwrap();
        write_npy(&path.join("segment_features.npy"), &[3, 3], &table).unwrap();
        let error = taught_labels(path, &classes, false).unwrap_err().to_string();
        assert!(error.contains("remove one of them"), "{error}");
        std::fs::remove_file(path.join("lang_feat.npy")).unwrap();
        let found = taught_labels(path, &classes, false).unwrap();
        assert_eq!(found.labels, [0, -1, -1, 0, 1]);
        assert_eq!(found, full);
        // One confidence too few, and features of another width.
        write_npy(&path.join("confidence.npy"), &[4], &[1.0_f32; 4]).unwrap();
        let error = taught_labels(path, &classes, false).unwrap_err().to_string();
        assert!(error.contains("has 4 values for 5 rows"), "{error}");
        write_npy(&path.join("segment_features.npy"), &[9, 1], &table).unwrap();
        let error = taught_labels(path, &classes, false).unwrap_err().to_string();
        assert!(error.contains("segment_features.npy: has 1 values a row"), "{error}");
    }

    #[test]
    fn what_is_not_surely_a_class_is_none_and_names_of_nothing_are_not_listed() {
        let folder = tempfile::tempdir().unwrap();
        let rows = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        // A word that is not known may change what a chair is, and red tables are but some; no row is a lamp.
        write(folder.path(), ["qwzxk chair", "red table", "lamp"], &rows, &[0.9, 0.8]);
        let classes = names(&["chair", "table"]);
        let found = taught_labels(folder.path(), &classes, true).unwrap();
        assert_eq!(found.labels, [-1, -1]);
        let unused = ["qwzxk chair", "red table"].map(|name| (name.to_owned(), 1));
        assert_eq!(found.unused, unused);
        // Without that word it is one.
        write(folder.path(), ["dining chair", "red table", "lamp"], &rows, &[0.9, 0.8]);
        assert_eq!(taught_labels(folder.path(), &classes, true).unwrap().labels, [0, -1]);
    }

    #[test]
    fn files_that_do_not_fit_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |part: &str| {
            let error =
                taught_labels(folder.path(), &names(&["chair"]), true).unwrap_err().to_string();
            assert!(error.contains(part), "{error}, not {part:?}");
        };
        refused(TEXTS);
        let path = folder.path();
        write(path, ["chair", "a", "b"], &[[1.0, 0.0, 0.0]], &[0.5, 0.5]);
        refused("confidence.npy: has 2 values for 1 rows");
        write_npy(&path.join("lang_feat.npy"), &[1, 2], &[half::f16::ONE; 2]).unwrap();
        refused("lang_feat.npy: has 2 values a row, the texts beside it 3");
        write_npy(&path.join("lang_feat.npy"), &[3], &[half::f16::ONE; 3]).unwrap();
        refused("lang_feat.npy: has shape [3]");
        std::fs::remove_file(path.join("confidence.npy")).unwrap();
        write_npy(&path.join("lang_feat.npy"), &[1, 3], &[half::f16::ONE; 3]).unwrap();
        refused("confidence.npy");
    }
}
