//! Which split a scene is in, by lists of names.

use anyhow::Result;
use scenesplat::scene::input_file::read_text_file;
use std::path::PathBuf;

/// A split and the file with the names of its scenes, one a line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SplitList {
    pub name: String,
    pub file: PathBuf,
}

/// Reads `train=FILE`.
pub fn parse(text: &str) -> Result<SplitList, String> {
    let wrong = || format!("{text:?}: write a split and its list: train=scannetv2_train.txt");
    let (name, file) = text.split_once('=').ok_or_else(wrong)?;
    let plain = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if !plain || file.is_empty() {
        return Err(wrong());
    }
    Ok(SplitList { name: name.to_owned(), file: file.into() })
}

/// The split of a scene: the first whose list has its name, `test` if none has; `None` without lists.
pub fn of(scene: &str, lists: &[SplitList]) -> Result<Option<String>> {
    for list in lists {
        let text = read_text_file(&list.file)?;
        if text.lines().any(|line| line.trim() == scene) {
            return Ok(Some(list.name.clone()));
        }
    }
    Ok((!lists.is_empty()).then(|| "test".to_owned()))
}
