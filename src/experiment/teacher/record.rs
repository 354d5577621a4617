//! Counts of a teacher, for the record of the run.

use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Most scenes that are named.
const MOST_NAMED: usize = 20;

/// Counts of one run, since it was last started.
#[derive(Debug, Default)]
pub struct TeacherRecord {
    content: Option<String>,
    counts: Mutex<Counts>,
}

#[derive(Debug, Default)]
pub(super) struct Counts {
    /// Scenes whose rows were computed, or read from where they are stored for good.
    pub(super) taught: u64,
    /// Scenes whose rows were taken from the cache.
    pub(super) read: u64,
    /// Scenes whose rows were put into the cache.
    pub(super) kept: u64,
    not_kept: u64,
    why_not_kept: Option<String>,
    remade: u64,
    why_remade: BTreeMap<String, String>,
}

impl TeacherRecord {
    /// Of a teacher of this [content](super::Teacher::content).
    pub(super) fn new(content: Option<String>) -> Self {
        Self { content, counts: Mutex::default() }
    }

    pub(super) fn with<T>(&self, change: impl FnOnce(&mut Counts) -> T) -> T {
        change(&mut self.counts.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Rows of a scene could not be put into the cache.
    pub(super) fn not_kept(&self, why: impl FnOnce() -> String) {
        self.with(|counts| {
            counts.not_kept += 1;
            counts.why_not_kept.get_or_insert_with(why);
        });
    }

    /// The cache held something else under the name of a scene's rows, which were computed again.
    pub(super) fn remade(&self, scene: &str, why: String) {
        self.with(|counts| {
            counts.remade += 1;
            if counts.why_remade.len() < MOST_NAMED {
                counts.why_remade.insert(scene.to_owned(), why);
            }
        });
    }

    /// As JSON: which it is, how often it taught, and what came of a cache.
    pub fn to_json(&self) -> Value {
        self.with(|c| {
            json!({
                "content": self.content,
                "taught": c.taught,
                "cache": {
                    "read": c.read,
                    "kept": c.kept,
                    "not_kept": c.not_kept,
                    "why_not_kept": c.why_not_kept,
                    "remade": c.remade,
                    "why_remade": c.why_remade,
                },
            })
        })
    }

    /// What is worth a line, if anything is.
    pub fn remark(&self) -> Option<String> {
        self.with(|c| {
            let mut text = String::new();
            if c.remade > 0 {
                let first = c.why_remade.first_key_value();
                let first = first.map(|(id, why)| format!(" ({id}: {why})")).unwrap_or_default();
                text +=
                    &format!("; rows of {} scenes in the cache were made again{first}", c.remade);
            }
            if let Some(why) = &c.why_not_kept {
                text += &format!("; rows of {} scenes were not kept: {why}", c.not_kept);
            }
            (!text.is_empty()).then(|| format!("teacher: {} scenes from the cache{text}", c.read))
        })
    }
}
