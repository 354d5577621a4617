//! What the folders of many scenes are called.

use anyhow::{Result, bail};
use std::collections::BTreeMap;
use std::path::Path;

/// A name for each scene of a list: its own, without the ending; where two would be the same, with the folders
/// in which they differ; at last with the ending. What does not belong into a file name becomes `_`.
///
/// # Errors
/// If two scenes cannot be told apart by that.
pub fn names(scenes: &[String]) -> Result<Vec<String>> {
    let parts: Vec<Vec<&str>> = scenes.iter().map(|scene| split(scene)).collect();
    let folders = parts.iter().map(|parts| parts.len().saturating_sub(1)).min().unwrap_or(0);
    let first = parts.first().map_or(&[][..], Vec::as_slice);
    let common =
        (0..folders).take_while(|&at| parts.iter().all(|parts| parts[at] == first[at])).count();
    let own = |parts: &[&str]| stem(parts[parts.len() - 1]);
    let with_folders = |parts: &[&str]| {
        let (name, folders) = (own(parts), &parts[common..parts.len() - 1]);
        folders.iter().map(|&f| f.to_owned()).chain([name]).collect::<Vec<_>>().join("__")
    };
    let in_full = |parts: &[&str]| parts[common..].join("__");
    type Way<'w> = &'w dyn Fn(&[&str]) -> String;
    let ways: [Way<'_>; 3] = [&own, &with_folders, &in_full];
    for way in ways {
        let names: Vec<String> = parts.iter().map(|parts| usable(&way(parts))).collect();
        if clash(&names).is_none() {
            return Ok(names);
        }
    }
    let names: Vec<String> = parts.iter().map(|parts| usable(&in_full(parts))).collect();
    let (a, b) = clash(&names).unwrap_or_default();
    bail!("{} and {} would both be called {}; rename one", scenes[a], scenes[b], names[a])
}

/// Folders and name; never empty.
fn split(scene: &str) -> Vec<&str> {
    let parts: Vec<&str> =
        scene.split(['/', '\\']).filter(|p| !p.is_empty() && *p != ".").collect();
    if parts.is_empty() { vec![scene] } else { parts }
}

fn stem(name: &str) -> String {
    let lower = name.to_ascii_lowercase();
    let cut = [".compressed.ply", ".ply"]
        .iter()
        .find(|end| lower.ends_with(**end) && lower.len() > end.len());
    match cut {
        Some(end) => name[..name.len() - end.len()].to_owned(),
        None => Path::new(name).file_stem().unwrap_or_default().to_string_lossy().into_owned(),
    }
}

/// The longest name that file systems take, less what is written beside files.
const LONGEST: usize = 200;

fn usable(name: &str) -> String {
    let fits = |c: char| c.is_alphanumeric() || matches!(c, '.' | '_' | '-' | '+');
    let mut name: String = name.chars().map(|c| if fits(c) { c } else { '_' }).collect();
    if name.is_empty() || name.starts_with('.') {
        name.insert(0, '_');
    }
    // The end tells more than the beginning.
    while name.len() > LONGEST {
        name.remove(0);
    }
    name
}

/// Two places with the same name, also where capital letters do not count.
fn clash(names: &[String]) -> Option<(usize, usize)> {
    let mut known = BTreeMap::new();
    let reserved = [
        super::RECORDS,
        "evaluation.json",
        "merged.json",
        "merged.md",
        "costs.json",
        "receipt.json",
        super::MANIFEST,
    ];
    for (at, name) in names.iter().enumerate() {
        if reserved.contains(&name.as_str()) {
            return Some((at, at));
        }
        if let Some(other) = known.insert(name.to_lowercase(), at) {
            return Some((other, at));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(scenes: &[&str]) -> Vec<String> {
        names(&scenes.iter().map(|&s| s.to_owned()).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn names_are_as_short_as_they_can_be() {
        assert_eq!(of(&["data/a.ply", "data/b.compressed.ply", "c/d"]), ["a", "b", "d"]);
        let same = ["data/1/point_cloud.ply", "data/2/point_cloud.ply"];
        assert_eq!(of(&same), ["1__point_cloud", "2__point_cloud"]);
        assert_eq!(of(&["data/a.ply", "data/a.spz"]), ["a.ply", "a.spz"]);
        assert_eq!(of(&["/x/A.ply", "/x/a.spz"]), ["A.ply", "a.spz"]);
        assert_eq!(
            of(&["synthetic:1:7:0", "synthetic:1:7:1"]),
            ["synthetic_1_7_0", "synthetic_1_7_1"]
        );
        assert_eq!(of(&["./room.ply"]), ["room"]);
        assert_eq!(of(&["a/records/", "b"]), ["a__records".to_owned(), "b".to_owned()]);
        assert_eq!(of(&["x/.hidden", "x/ä b.ply"]), ["_.hidden", "ä_b"]);
        assert_eq!(of(&[&format!("{}.ply", "n".repeat(400))])[0].len(), LONGEST);
    }

    #[test]
    fn what_cannot_be_told_apart_is_refused() {
        let error = names(&["a b.ply".to_owned(), "a:b.ply".to_owned()]).unwrap_err().to_string();
        assert!(error.contains("a b.ply and a:b.ply"), "{error}");
    }
}
