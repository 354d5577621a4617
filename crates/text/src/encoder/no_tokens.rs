//! Word pieces where there are none: a browser has no folder to read an encoder from.

use super::config::Config;
use crate::PhraseError;
use std::path::Path;

/// There is no such thing.
pub(super) enum Tokens {}

pub(super) struct Ids {
    pub ids: Vec<u32>,
    pub longer: Option<usize>,
}

impl Tokens {
    pub fn read(folder: &Path, _: &Config) -> Result<Self, PhraseError> {
        Err(PhraseError::Model {
            path: folder.to_owned(),
            problem: "cannot be read in a browser".to_owned(),
            help: "use the program",
        })
    }

    pub fn most(&self) -> usize {
        match *self {}
    }

    pub fn of(&self, _: &str) -> Result<Ids, PhraseError> {
        match *self {}
    }
}
