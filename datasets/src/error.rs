//! Errors of this crate.

use scenesplat_kernels::grid_sample::GridSampleError;
use scenesplat_scene::SceneError;
use std::path::PathBuf;

/// Why data cannot become network input. Every variant says where, what and how to fix it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DataError {
    /// A scene of a source could not be read.
    #[error("scene {id}")]
    Scene {
        /// Id of the scene.
        id: String,
        /// What is wrong with it.
        #[source]
        source: Box<SceneError>,
    },
    /// A scene of a source of one's own could not be read.
    #[error("scene {id}")]
    Unreadable {
        /// Id of the scene.
        id: String,
        /// What is wrong with it.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A source has no scene of this id.
    #[error("no scene is called {id} ({known} scenes are known)")]
    UnknownScene {
        /// The id asked for.
        id: String,
        /// Number of scenes in the source.
        known: usize,
    },
    /// A scene or folder of scenes is not as it should be, such as arrays of different lengths.
    #[error(transparent)]
    Rows(Box<SceneError>),
    /// A synthetic room cannot be made.
    #[error(transparent)]
    Room(#[from] scenesplat_rooms::RoomError),
    /// Rows cannot be grouped into voxels.
    #[error(transparent)]
    Grid(#[from] GridSampleError),
    /// The network wants normals and the scene has none.
    #[error(
        "the network reads normals and the scene has none (estimate them from the positions, read \
         a file with normals, or use a network without them)"
    )]
    NoNormals,
    /// A value that would reach the network is NaN or infinite.
    #[error("Gaussian {row}, {field}: {value} is not finite (repair the scene or remove the row)")]
    NotFinite {
        /// Row in the scene or point cloud.
        row: usize,
        /// Which array.
        field: &'static str,
        /// The value.
        value: f32,
    },
    /// A row number beyond the scene.
    #[error("row {row} is out of range for {rows} rows")]
    RowOutOfRange {
        /// The row number.
        row: usize,
        /// Number of rows.
        rows: usize,
    },
    /// An array has the wrong number of values.
    #[error("{field}: expected {expected} values, got {got}")]
    Length {
        /// Which array.
        field: &'static str,
        /// Length expected.
        expected: usize,
        /// Length found.
        got: usize,
    },
    /// A sample could not be made of a scene.
    #[error("scene {id}")]
    Sample {
        /// Id of the scene.
        id: String,
        /// What is wrong with it.
        #[source]
        source: Box<DataError>,
    },
    /// Making a sample panicked: a bug, in a source or a transform.
    #[error("scene {id}: reading or changing it panicked: {message} (a bug; please report it)")]
    Panicked {
        /// Id of the scene.
        id: String,
        /// The message of the panic.
        message: String,
    },
    /// A folder of scenes that a split is made of is not there.
    #[error(
        "{}: has no folder {folder}; it has {} (name others in `folders`, or cut the scenes into \
         chunks with `scenesplat chunk`)",
        root.display(),
        if there.is_empty() { "none" } else { there }
    )]
    NoSplit {
        /// Where it was looked for.
        root: PathBuf,
        /// The folder.
        folder: String,
        /// The folders there are, separated by commas.
        there: String,
    },
    /// Nothing is known of the classes of a benchmark.
    #[error(
        "the names of the classes of {benchmark} do not come with the program (give a file with one \
         name a line, in the order of the labels, as `class_names`)"
    )]
    NoClassNames {
        /// Name of the benchmark.
        benchmark: &'static str,
    },
    /// A step of a pipeline needs what an earlier step makes.
    #[error("{step}: the sample has no {missing} ({help})")]
    Missing {
        /// The step.
        step: &'static str,
        /// What it needs.
        missing: &'static str,
        /// What to do.
        help: &'static str,
    },
    /// A teacher has no rows for a scene.
    #[error("the teacher has no rows for this scene")]
    Teacher {
        /// Why.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A setting outside its range.
    #[error("{setting}: {value} is not allowed, expected {expected}")]
    Setting {
        /// Which setting.
        setting: &'static str,
        /// The value given.
        value: String,
        /// What is allowed.
        expected: &'static str,
    },
}

impl DataError {
    /// A source of one's own cannot read a scene, because of `error`; any error type will do.
    pub fn unreadable(
        id: &str,
        error: impl Into<Box<dyn std::error::Error + Send + Sync>>,
    ) -> Self {
        Self::Unreadable { id: id.to_owned(), source: error.into() }
    }

    /// A teacher has no rows for a scene, because of `error`; made for `map_err`.
    pub fn teacher(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self::Teacher { source: error.into() }
    }

    /// A step lacks the cells of Gaussians.
    pub(crate) fn no_cells(step: &'static str) -> Self {
        let help = "end the transforms with a grid sample";
        Self::Missing { step, missing: "cells", help }
    }

    /// Says of which scene this is, unless it does already.
    pub(crate) fn in_scene(self, id: &str) -> Self {
        match self {
            Self::Scene { .. }
            | Self::Unreadable { .. }
            | Self::Sample { .. }
            | Self::Panicked { .. } => self,
            other => Self::Sample { id: id.to_owned(), source: Box::new(other) },
        }
    }
}

/// A [`DataError::Setting`].
pub(crate) fn bad_setting(
    setting: &'static str,
    value: impl std::fmt::Display,
    expected: &'static str,
) -> DataError {
    DataError::Setting { setting, value: value.to_string(), expected }
}

impl From<SceneError> for DataError {
    fn from(error: SceneError) -> Self {
        Self::Rows(Box::new(error))
    }
}

/// A [`DataError::Setting`] unless the value is all right.
pub(crate) fn require(
    ok: bool,
    setting: &'static str,
    value: impl std::fmt::Display,
    expected: &'static str,
) -> Result<(), DataError> {
    if ok { Ok(()) } else { Err(bad_setting(setting, value, expected)) }
}

pub(crate) fn check_probability(setting: &'static str, value: f64) -> Result<(), DataError> {
    require((0.0..=1.0).contains(&value), setting, value, "a probability in 0..=1")
}

pub(crate) fn check_positive(setting: &'static str, value: f64) -> Result<(), DataError> {
    require(value.is_finite() && value > 0.0, setting, value, "a finite number above 0")
}

/// Two finite numbers in order.
pub(crate) fn check_range(setting: &'static str, [low, high]: [f64; 2]) -> Result<(), DataError> {
    let ok = low.is_finite() && high.is_finite() && low <= high;
    let expected = "two finite numbers, the lower first";
    require(ok, setting, format_args!("[{low}, {high}]"), expected)
}

/// Two parts of a whole in order.
pub(crate) fn check_shares(setting: &'static str, [low, high]: [f64; 2]) -> Result<(), DataError> {
    let ok = 0.0 <= low && low <= high && high <= 1.0;
    let expected = "two shares in 0..=1, the lower first";
    require(ok, setting, format_args!("[{low}, {high}]"), expected)
}

pub(crate) fn check_length(
    field: &'static str,
    expected: usize,
    got: usize,
) -> Result<(), DataError> {
    if expected == got { Ok(()) } else { Err(DataError::Length { field, expected, got }) }
}

pub(crate) fn check_finite(field: &'static str, rows: &[[f32; 3]]) -> Result<(), DataError> {
    for (row, values) in rows.iter().enumerate() {
        if let Some(&value) = values.iter().find(|v| !v.is_finite()) {
            return Err(DataError::NotFinite { row, field, value });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_out_of_range_are_refused_and_shown() {
        let nan = f64::NAN;
        for bad in [-0.1, 1.1, nan, f64::INFINITY] {
            assert!(check_probability("share", bad).is_err(), "{bad}");
        }
        for bad in [0.0, -1.0, nan, f64::INFINITY] {
            assert!(check_positive("size", bad).is_err(), "{bad}");
        }
        for bad in [[1.1, 0.9], [nan, 1.0], [0.0, nan], [0.0, f64::INFINITY]] {
            assert!(check_range("range", bad).is_err(), "{bad:?}");
        }
        for bad in [[0.5, 0.1], [-0.1, 0.5], [0.5, 1.1], [nan, 1.0], [0.0, nan]] {
            assert!(check_shares("ratio", bad).is_err(), "{bad:?}");
        }
        let good = [[0.0, 0.0], [0.0, 1.0]];
        assert!(good.iter().all(|g| check_shares("", *g).is_ok() && check_range("", *g).is_ok()));
        assert!(check_probability("", 0.0).is_ok() && check_probability("", 1.0).is_ok());
        let error = check_range("range", [2.0, 1.0]).unwrap_err().to_string();
        assert!(error.starts_with("range: [2, 1] is not allowed"), "{error}");
    }
}
