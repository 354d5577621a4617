//! Labels lifted from pictures: goldens, properties, files of segments.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod golden;
mod panes;
mod planted;
mod properties;
mod recovery;
mod segments;
mod support;
