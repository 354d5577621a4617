//! Which class a label means, and which classes the averages leave out.

use scenesplat_rooms::{CLASSES, SyntheticClass};
use scenesplat_scene::label_set::find_name;
use scenesplat_scene::{ClassMap, LabelSet, SceneError, TextTable};

/// Those of wall, floor and ceiling that there are: what the averages that begin with f leave out
/// where no benchmark says otherwise.
pub fn background(classes: &LabelSet) -> Vec<usize> {
    ["wall", "floor", "ceiling"].iter().filter_map(|n| classes.index_of(n).ok()).collect()
}

/// The classes of a network that has its own, as a table: each is its own direction.
///
/// # Errors
/// If there is no name.
pub fn own_directions(names: Vec<String>) -> Result<TextTable, SceneError> {
    let count = names.len();
    let values = (0..count * count).map(|i| f32::from(u8::from(i % (count + 1) == 0))).collect();
    TextTable::from_rows(names, values, count)
}

/// The class that each label means, by a map or else by the same name; -1 for none.
///
/// # Errors
/// If the map names what there is not.
pub fn classes_of_labels(
    labels: &[String],
    map: Option<&ClassMap>,
    classes: &[String],
) -> Result<Vec<i32>, SceneError> {
    match map {
        Some(map) => map.indices(labels, classes),
        None => {
            let same_name = |l: &String| Some((l.clone(), find_name(classes, l).ok()?));
            let pairs = labels.iter().filter_map(same_name);
            ClassMap::from_pairs(pairs.map(|(l, c)| (l, classes[c].clone())))
                .indices(labels, classes)
        }
    }
}

/// The class that each label of the synthetic rooms means, by its name there or in `ScanNet200`; -1
/// for none.
pub fn classes_of_rooms(classes: &[String]) -> Vec<i32> {
    let row = |class: &SyntheticClass| {
        let own = find_name(classes, class.name);
        own.or_else(|_| find_name(classes, class.scannet200_name)).map_or(-1, |row| row as i32)
    };
    CLASSES.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|&name| name.to_owned()).collect()
    }

    #[test]
    fn labels_find_their_classes() {
        let classes = names(&["wall", "office chair"]);
        let labels = names(&["office chair", "lamp", "wall"]);
        assert_eq!(classes_of_labels(&labels, None, &classes).unwrap(), [1, -1, 0]);
        let map = ClassMap::from_pairs([("lamp", "office chair")]);
        assert_eq!(classes_of_labels(&labels, Some(&map), &classes).unwrap(), [-1, 1, -1]);
        let of_rooms = classes_of_rooms(&classes);
        assert_eq!(of_rooms.len(), CLASSES.len());
        assert_eq!(of_rooms[0], 0);
    }
}
