//! A run is resumed with the settings that it began with.

use super::Data;
use super::outcome::outcome;
use scenesplat::experiment::MAY_CHANGE;
use scenesplat::trainers::TrainerConfig;
use serde_json::Value;

/// `/train/0/source/count` as `train[0].source.count`.
fn setting(pointer: &str) -> String {
    let mut name = String::new();
    for part in pointer.split('/').skip(1) {
        match part.parse::<usize>() {
            Ok(i) => name.push_str(&format!("[{i}]")),
            Err(_) if name.is_empty() => name.push_str(part),
            Err(_) => name.push_str(&format!(".{part}")),
        }
    }
    name
}

/// Whether a setting is in the list, by its name.
fn may_change(setting: &str) -> bool {
    let digits: String = setting.chars().filter(|c| !c.is_ascii_digit()).collect();
    let name = digits.replace("[]", "[*]");
    let inside = |listed: &str| {
        let rest = name.strip_prefix(listed);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
    };
    // A preset may be written out; what its steps do may not change, so another preset is another run.
    !name.ends_with(".transforms")
        && (MAY_CHANGE.iter().any(|(listed, _)| inside(listed))
            || TrainerConfig::MAY_CHANGE.iter().any(|listed| inside(&format!("trainer.{listed}"))))
}

/// Resumes a copy of the run `base` with a changed setting: it is refused by its name, and its record is as
/// before; or the setting may change, and what it names is compared.
pub fn check(data: &Data, base: &str, changed: &Value, pointer: &str) -> Result<(), String> {
    let (folder, copy) = (data.path().join(base), data.path().join("resumed").join(base));
    copy_folder(&folder, &copy);
    let after = outcome(data, changed, &format!("resumed/{base}"), true);
    let record = |folder: &std::path::Path| std::fs::read(folder.join("config.toml")).unwrap();
    let untouched = record(&folder) == record(&copy);
    std::fs::remove_dir_all(&copy).unwrap();
    let name = setting(pointer);
    match (after.error, may_change(&name)) {
        (None, true) => Ok(()),
        (None, false) => Err("resumed with another value".to_owned()),
        (Some(error), _) if !untouched => Err(format!("the record is another: {error}")),
        (Some(error), false) if error.contains(&name) => Ok(()),
        (Some(error), true)
            if ["content was", "scenes was", "classes was"].iter().any(|w| error.contains(w)) =>
        {
            Ok(())
        }
        (Some(error), _) => Err(format!("resuming {name}: {error}")),
    }
}

fn copy_folder(from: &std::path::Path, to: &std::path::Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let (path, target) = (entry.as_ref().unwrap().path(), to.join(entry.unwrap().file_name()));
        if path.is_dir() {
            copy_folder(&path, &target);
        } else {
            std::fs::copy(&path, &target).unwrap();
        }
    }
}
