//! Errors of this crate.

/// What input the kernels refuse.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum KernelError {
    /// A voxel index that the curves cannot code.
    #[error(
        "grid_coord row {row}, axis {axis}: {value} is not in 0..=2097151 (21 bits); \
         remove far outliers or use larger voxels"
    )]
    GridCoord {
        /// Row of the voxel.
        row: usize,
        /// 0, 1, 2 for x, y, z.
        axis: usize,
        /// The coordinate.
        value: i32,
    },
    /// More rows than a 32-bit row number can name.
    #[error("{rows} rows are more than the 4294967294 that one batch can hold; split the scene")]
    TooManyRows {
        /// Rows asked for.
        rows: usize,
    },
    /// Offsets that do not describe consecutive scenes.
    #[error("offsets must start at 0, never fall and end at {rows}: {offsets:?}")]
    Offsets {
        /// Rows of the batch.
        rows: usize,
        /// The offsets given.
        offsets: Vec<usize>,
    },
    /// Groups that do not hold every row once.
    #[error("groups of {rows} rows: {problem}")]
    Groups {
        /// Rows listed.
        rows: usize,
        /// What is wrong.
        problem: String,
    },
    /// A kernel size that has no center.
    #[error("kernel size {0}: a submanifold convolution needs 1, 3, 5 or 7")]
    KernelSize(usize),
    /// A point that cannot be put on the grid.
    #[error("coord row {row}, axis {axis}: {value} cannot be put on a grid; {help}")]
    Coord {
        /// Row of the point.
        row: usize,
        /// 0, 1, 2 for x, y, z.
        axis: usize,
        /// The coordinate, meters.
        value: f64,
        /// What the user can do.
        help: &'static str,
    },
    /// A voxel size that is not a positive finite number.
    #[error("grid size {0}: must be positive and finite (meters)")]
    GridSize(f64),
}

/// Checks that `offsets` (`[B + 1]`) cuts `rows` rows into consecutive scenes.
///
/// # Errors
/// If it does not, or if there are more rows than a row number can name.
pub fn check_offsets(offsets: &[usize], rows: usize) -> Result<(), KernelError> {
    if rows >= u32::MAX as usize {
        return Err(KernelError::TooManyRows { rows });
    }
    let good = offsets.first() == Some(&0)
        && offsets.last() == Some(&rows)
        && offsets.windows(2).all(|w| w[0] <= w[1]);
    if good { Ok(()) } else { Err(KernelError::Offsets { rows, offsets: offsets.to_vec() }) }
}
