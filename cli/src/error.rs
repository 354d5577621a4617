//! The error of a command line that asks for something impossible.

/// The command line is right in form but asks for something that does not fit together. Exit code 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct WrongUse(pub String);

/// A training was asked to stop, and saved what a resume needs. Exit code 4; said already.
#[derive(Debug, thiserror::Error)]
#[error("stopped and saved")]
pub struct Saved;

/// Returns a [`WrongUse`] with a formatted message from the function.
macro_rules! refuse {
    ($($message:tt)*) => {
        return Err($crate::error::WrongUse(format_args!($($message)*).to_string()).into())
    };
}
pub(crate) use refuse;
