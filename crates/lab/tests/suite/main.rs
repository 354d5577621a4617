//! The laboratory as a user of the library meets it.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod doctor;
mod poses;
