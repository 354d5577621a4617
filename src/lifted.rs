//! Lifted features as files have them: a row for each row of a scene's file, or the index form of `lift-labels --form
//! index`, a cluster for each and a row of features for each cluster.

use half::f16;
use scenesplat_rasterizer::lifting::NO_CLUSTER;
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::{SceneError, printable};
use std::path::{Path, PathBuf};

/// Features of the full form, one row for each of the scene's file.
pub const FULL: &str = "lang_feat.npy";
/// The cluster of each row of the scene's file, `[N]` u16; 65535 = none.
pub const INDEX: &str = "segment_index.npy";
/// Features of the clusters, beside it. `[K, D]` f16
pub const CLUSTERS: &str = "segment_features.npy";

/// Why features in their index form could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LiftedError {
    /// A file that cannot be read.
    #[error(transparent)]
    File(#[from] SceneError),
    /// Files that do not belong together.
    #[error("{}: {problem} (give what lift-labels wrote in one run)", printable(path))]
    Index {
        /// Which file.
        path: PathBuf,
        /// What does not fit.
        problem: String,
    },
}

/// Features of clusters, and which one each row of a scene's file has.
#[derive(Debug, Clone, PartialEq)]
pub struct IndexedRows {
    /// The cluster of each row; `None`: it has no feature. `[N]`
    pub cluster_of: Vec<Option<u16>>,
    /// Features of the clusters. `[K, dim]`
    pub rows: Vec<f16>,
    /// Values of one.
    pub dim: usize,
}

/// The table that belongs to a file, if that is an index by its name.
pub fn clusters_beside(path: &Path) -> Option<PathBuf> {
    let is_index = path.file_name().is_some_and(|name| name == INDEX);
    is_index.then(|| path.with_file_name(CLUSTERS))
}

/// The files of one of the two forms.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LiftedFiles {
    /// The full form.
    Full(PathBuf),
    /// The index form: the index, and the features of the clusters.
    Index(PathBuf, PathBuf),
}

impl LiftedFiles {
    /// Those in a folder; the full form if it has neither, so that what is missing has a name.
    ///
    /// # Errors
    /// If it has both: nobody knows which is newer.
    pub fn of(folder: &Path) -> Result<Self, LiftedError> {
        let [full, index, clusters] = [FULL, INDEX, CLUSTERS].map(|name| folder.join(name));
        match (full.exists(), index.exists()) {
            (true, true) => {
                let problem = format!("lies beside {FULL}, of another run: remove one of them");
                Err(LiftedError::Index { path: index, problem })
            }
            (false, true) => Ok(Self::Index(index, clusters)),
            (_, false) => Ok(Self::Full(full)),
        }
    }

    /// That of features.
    pub fn features(&self) -> &Path {
        match self {
            Self::Full(path) | Self::Index(_, path) => path,
        }
    }

    /// Their paths.
    pub fn paths(&self) -> Vec<PathBuf> {
        match self {
            Self::Full(path) => vec![path.clone()],
            Self::Index(index, clusters) => vec![index.clone(), clusters.clone()],
        }
    }
}

impl IndexedRows {
    /// Reads an index and the table of its clusters.
    ///
    /// # Errors
    /// If a file is missing or damaged, or a cluster has no feature.
    pub fn read(index: &Path, clusters: &Path) -> Result<Self, LiftedError> {
        let bad =
            |path: &Path, problem: String| LiftedError::Index { path: path.to_owned(), problem };
        let file = NpyFile::open(clusters)?;
        let &[count, dim] = file.shape() else {
            return Err(bad(
                clusters,
                format!("has shape {:?}, not [clusters, values]", file.shape()),
            ));
        };
        let rows = file.read_f16()?;
        let file = NpyFile::open(index)?;
        if file.shape().len() != 1 {
            return Err(bad(index, format!("has shape {:?}, not [Gaussians]", file.shape())));
        }
        let mut cluster_of = Vec::with_capacity(file.len());
        for (row, value) in file.read_i64()?.into_iter().enumerate() {
            let cluster = u16::try_from(value).ok();
            let fits = cluster.is_some_and(|c| c == NO_CLUSTER || usize::from(c) < count);
            if !fits {
                let problem =
                    format!("row {row} is of cluster {value}, and {CLUSTERS} has {count}");
                return Err(bad(index, problem));
            }
            cluster_of.push(cluster.filter(|c| *c != NO_CLUSTER));
        }
        Ok(Self { cluster_of, rows, dim })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_scene::formats::npy_writer::write_npy;

    #[test]
    fn a_folder_has_one_of_both_forms() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        assert_eq!(LiftedFiles::of(folder.path()).unwrap().paths(), [at(FULL)]);
        std::fs::write(at(INDEX), "").unwrap();
        assert_eq!(LiftedFiles::of(folder.path()).unwrap().paths(), [at(INDEX), at(CLUSTERS)]);
        std::fs::write(at(FULL), "").unwrap();
        let error = LiftedFiles::of(folder.path()).unwrap_err().to_string();
        assert!(error.contains(INDEX) && error.contains("remove one of them"), "{error}");
        std::fs::remove_file(at(INDEX)).unwrap();
        assert_eq!(LiftedFiles::of(folder.path()).unwrap(), LiftedFiles::Full(at(FULL)));
    }

    #[test]
    fn clusters_are_those_of_the_table_and_none() {
        let folder = tempfile::tempdir().unwrap();
        let [index, clusters] = [INDEX, CLUSTERS].map(|name| folder.path().join(name));
        assert_eq!(clusters_beside(&index), Some(clusters.clone()));
        assert_eq!(clusters_beside(&folder.path().join(FULL)), None);
        let write = |values: &[i32], shape: &[usize], rows: usize| {
            write_npy(&index, shape, values).unwrap();
            write_npy(&clusters, &[rows, 3], &vec![f16::ONE; 3 * rows]).unwrap();
            IndexedRows::read(&index, &clusters).map_err(|error| error.to_string())
        };
        let found = write(&[1, 65_535, 0], &[3], 2).unwrap();
        assert_eq!(
            (found.cluster_of, found.rows.len(), found.dim),
            (vec![Some(1), None, Some(0)], 6, 3)
        );
        // Nothing has a cluster, and there is no Gaussian.
        assert_eq!(write(&[65_535], &[1], 0).unwrap().cluster_of, [None]);
        assert!(write(&[], &[0], 1).unwrap().cluster_of.is_empty());
        for (values, value) in [([0, 2], "2"), ([-1, 2], "-1"), ([0, 65_536], "65536")] {
            let error = write(&values, &[2], 2).unwrap_err();
            assert!(
                error.contains(INDEX) && error.contains(&format!("cluster {value}, ")),
                "{error}"
            );
        }
        assert!(write(&[0; 4], &[2, 2], 1).unwrap_err().contains("[2, 2], not [Gaussians]"));
        write_npy(&clusters, &[3], &[f16::ONE; 3]).unwrap();
        let error = IndexedRows::read(&index, &clusters).unwrap_err().to_string();
        assert!(error.contains("[3], not [clusters, values]"), "{error}");
        assert!(IndexedRows::read(&index, &folder.path().join("none.npy")).is_err());
    }
}
