//! Errors of this crate.

/// Why a room cannot be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RoomError {
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
    /// The catalogue of furniture cannot be used.
    #[error("furniture: {0}")]
    Furniture(#[from] crate::catalogue::CatalogueError),
}
