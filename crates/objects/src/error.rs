//! What can be wrong with what objects are looked for in.

use scenesplat_kernels::neighbors::NeighborError;

/// Why there is no catalogue.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ObjectError {
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
    /// A label without a name.
    #[error(
        "labels[{row}] is {label}, but there are {names} names; give the names of these labels"
    )]
    Label {
        /// Row of the Gaussian.
        row: usize,
        /// What it is labeled.
        label: i32,
        /// Names that there are.
        names: usize,
    },
    /// A setting out of range.
    #[error("{setting}: {value} is not possible, expected {expected}")]
    Setting {
        /// Which setting.
        setting: &'static str,
        /// Its value.
        value: String,
        /// What would be right.
        expected: &'static str,
    },
    /// Cubes of colliders that are too small.
    #[error(
        "cubes of {cell} m are too small for this scene: its Gaussians cover {places} places half a cube apart, at most {most} are \
         looked at; give larger cubes"
    )]
    SmallCubes {
        /// Edge of the cubes, meters.
        cell: f64,
        /// Places of this scene.
        places: u64,
        /// Most that is possible.
        most: u64,
    },
    /// Positions that have no neighbors.
    #[error(transparent)]
    Neighbors(#[from] NeighborError),
}

pub(crate) type Result<T, E = ObjectError> = std::result::Result<T, E>;

/// That a setting is in its range.
#[expect(clippy::needless_pass_by_value, reason = "numbers and texts are passed alike")]
pub(crate) fn check_setting(
    is_in_range: bool,
    setting: &'static str,
    value: impl ToString,
    expected: &'static str,
) -> Result<()> {
    if is_in_range {
        return Ok(());
    }
    Err(ObjectError::Setting { setting, value: value.to_string(), expected })
}

/// That an array has one row per Gaussian.
pub(crate) fn check_rows(field: &'static str, expected: usize, got: usize) -> Result<()> {
    if expected == got { Ok(()) } else { Err(ObjectError::Rows { field, expected, got }) }
}

/// That every label has a name.
pub(crate) fn check_labels(labels: &[i32], names: usize) -> Result<()> {
    let has_no_name = |label: &i32| usize::try_from(*label).is_ok_and(|label| label >= names);
    match labels.iter().position(has_no_name) {
        Some(row) => Err(ObjectError::Label { row, label: labels[row], names }),
        None => Ok(()),
    }
}
