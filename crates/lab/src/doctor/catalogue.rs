//! All cases.

use super::case::Case;
use super::{inputs, operators, scenes, training};
use scenesplat_scene::label_set;

/// Every hard case, level by level.
pub fn catalogue() -> Vec<Case> {
    let mut cases = inputs::cases();
    cases.extend(operators::cases());
    cases.extend(training::cases());
    cases.extend(scenes::cases());
    cases
}

/// The names most like one that no case has, best first.
pub fn nearest_names(name: &str) -> Vec<String> {
    const SUGGESTIONS: usize = 5;
    let names: Vec<String> = catalogue().into_iter().map(|case| case.name).collect();
    label_set::nearest_names(&names, name, SUGGESTIONS).into_iter().map(str::to_owned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Level;
    use crate::doctor::table::rows;
    use scenesplat::shipped::HARD_CASES;

    /// Each row has a check and each check a row, in one order.
    #[test]
    fn the_documentation_has_every_case() {
        let (named, due): (Vec<&str>, Vec<String>) = (
            rows().map(|(name, _)| name).collect(),
            catalogue().into_iter().map(|c| c.name).collect(),
        );
        assert_eq!(named, due);
        let count = |level: Level| rows().filter(|(_, row)| row.level == level).count();
        let quick =
            |level: Level| rows().filter(|(_, row)| row.level == level && row.quick).count();
        for level in Level::ALL {
            let (number, all, quick) = (level.number(), count(level), quick(level));
            let said = format!(
                "## Level {number}: {level}\n\n{all} cases, {quick} of them in the quick subset"
            );
            assert!(HARD_CASES.contains(&said), "{said}");
        }
        assert!(HARD_CASES.contains(&format!("with {} cases", due.len())));
    }
}
