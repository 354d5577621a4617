//! What can be wrong with a setting.

use super::Setting;

/// Why a setting cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SettingError {
    /// A key that there is not.
    #[error("setting {key:?} is unknown; known are {}", Setting::KEYS.join(", "))]
    UnknownKey {
        /// The key as it was written.
        key: String,
    },
    /// A key that is there already.
    #[error(
        "setting {key}: it stands there twice, with {first:?} and with {second:?}; leave one out"
    )]
    Twice {
        /// Which key.
        key: &'static str,
        /// Its first value.
        first: String,
        /// Its second value.
        second: String,
    },
    /// A part that is not a key with a value.
    #[error("setting: {part:?} is no KEY=VALUE; parts are separated by single commas")]
    NoPair {
        /// The part as it was written.
        part: String,
    },
    /// A value out of range, or of another kind.
    #[error("setting {key}: {value:?} is not {expected}")]
    Value {
        /// Which key.
        key: &'static str,
        /// The value as it was written.
        value: String,
        /// What it may be.
        expected: String,
    },
    /// A part that what is run has nothing of.
    #[error("setting {key}={value} cannot be used here: {why}; leave it out")]
    NotHere {
        /// Which key.
        key: &'static str,
        /// Its value.
        value: String,
        /// Why not.
        why: String,
    },
}

impl SettingError {
    pub(super) fn not_here(key: &'static str, value: &impl ToString, why: &str) -> Self {
        Self::NotHere { key, value: value.to_string(), why: why.to_owned() }
    }
}
