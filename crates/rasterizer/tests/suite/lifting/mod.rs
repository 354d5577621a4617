//! Labels lifted from pictures: goldens, properties, files of segments.

mod golden;
mod panes;
mod planted;
mod properties;
mod recovery;
mod segments;
mod support;
mod weights;
