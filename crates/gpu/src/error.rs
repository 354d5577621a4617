//! What can go wrong on a graphics processor.

/// Why a graphics processor cannot be used, or stopped.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No interface or no driver.
    #[error("no graphics processor: {0}")]
    NoAdapter(String),
    /// The one asked for is not among them.
    #[error("no graphics processor {asked:?}; there are: {there}")]
    NotFound {
        /// Its number or a part of its name.
        asked: String,
        /// Those that there are.
        there: String,
    },
    /// It lacks something that the kernels need.
    #[error("{adapter} has {has} of {what}, the kernels need {needs}; compute on cpu")]
    TooSmall {
        /// Its name.
        adapter: String,
        /// The limit.
        what: &'static str,
        /// Its value.
        has: u64,
        /// The value needed.
        needs: u64,
    },
    /// It has no 16-bit numbers.
    #[error("{0} has no 16-bit floating-point numbers; use --precision f32")]
    NoF16(String),
    /// The driver does not open it.
    #[error("{adapter} cannot be opened: {problem}")]
    Unusable {
        /// Its name.
        adapter: String,
        /// What the driver said.
        problem: String,
    },
    /// One array is larger than a kernel can read.
    #[error(
        "{what}: {bytes} bytes are more than the {limit} that {adapter} gives to one array; use smaller tiles"
    )]
    TooLarge {
        /// Which array.
        what: String,
        /// Its size.
        bytes: u64,
        /// The largest.
        limit: u64,
        /// Its name.
        adapter: String,
    },
    /// Its memory is used up.
    #[error("{0}: out of memory; use smaller tiles, or compute on cpu")]
    OutOfMemory(String),
    /// It was removed, or the driver stopped it.
    #[error("the graphics processor was lost: {0}; results of this scene are incomplete")]
    Lost(String),
    /// Sizes that do not fit together.
    #[error("{0}")]
    Shape(String),
    /// A mistake in this crate, which the interface refused.
    #[error("the graphics interface refused a command: {0}")]
    Refused(String),
}

/// What most functions of this crate return.
pub type Result<T> = std::result::Result<T, GpuError>;

/// An error about sizes.
pub(crate) fn shape<T>(message: impl Into<String>) -> Result<T> {
    Err(GpuError::Shape(message.into()))
}
