//! The sentence encoder.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod encoder;
