//! The sentence encoder, and the meaning of phrases.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod colloquial;
mod encoder;
mod meaning;
