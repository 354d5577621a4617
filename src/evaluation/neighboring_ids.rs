use scenesplat_scene::GaussianScene;
use std::collections::BTreeSet;

/// By how much of all labels more have to agree where ids are taken for their neighbors.
const MORE: f64 = 0.2;
/// Classes that have to agree there: a single one may be taken for its neighbor by a network.
const CLASSES: usize = 3;

/// Labels that would agree far better with what was found if every id stood for a name beside its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OtherIds {
    /// Which name of the list: 1 for the next one, -1 for the one before.
    pub by: i64,
    /// Share of labels that agree as they are read.
    pub agree: f64,
    /// Share of labels that would agree then.
    pub would_agree: f64,
}

/// Whether the labels of a scene are one name off. The oracle cannot tell, as it shares the list of names with the
/// truth; `found`, the classes that a network gave where the scene is scored, do not. `[M]`
///
/// `class_of`: the class that each name means, -1 for none; without it, labels are classes.
pub fn other_ids(
    scene: &GaussianScene,
    found: &[i32],
    class_of: Option<&[i32]>,
) -> Option<OtherIds> {
    let points = scene.labelled_points.as_ref().and_then(|points| points.segment.as_deref());
    let rows = points.or(scene.segment.as_deref())?;
    let class = |row: i64| match class_of {
        Some(map) => usize::try_from(row).ok().and_then(|row| map.get(row).copied()),
        None => i32::try_from(row).ok(),
    };
    let labelled = rows.iter().filter(|row| **row >= 0).count();
    let agreeing = |by: i64| {
        let hits = rows.iter().zip(found).filter(|(row, found)| {
            **row >= 0 && **found >= 0 && class(i64::from(**row) + by) == Some(**found)
        });
        let hits: Vec<i32> = hits.map(|(row, _)| *row).collect();
        let classes = hits.iter().collect::<BTreeSet<_>>().len();
        (hits.len() as f64 / labelled.max(1) as f64, classes)
    };
    let (agree, _) = agreeing(0);
    let others = [-1, 1].into_iter().map(|by| (by, agreeing(by)));
    let far_better = others.filter(|(_, (share, classes))| {
        *share >= agree + MORE && *share >= 2.0 * agree && *classes >= CLASSES
    });
    let best = far_better.max_by(|a, b| a.1.0.total_cmp(&b.1.0));
    best.map(|(by, (would_agree, _))| OtherIds { by, agree, would_agree })
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_scene::LabelledPoints;

    fn scene(labels: &[i32]) -> GaussianScene {
        GaussianScene { segment: Some(labels.to_vec()), ..GaussianScene::default() }
    }

    #[test]
    fn labels_that_are_one_name_off_are_noticed() {
        let found = [0, 0, 1, 2, 2, 3];
        let off = scene(&[1, 1, 2, 3, 3, 4]);
        let other = other_ids(&off, &found, None).unwrap();
        assert_eq!((other.by, other.agree, other.would_agree), (-1, 0.0, 1.0));
        let off = scene(&[-1, -1, 0, 1, 1, 2]);
        assert_eq!(other_ids(&off, &found, None).unwrap().by, 1);
        assert_eq!(other_ids(&scene(&found), &found, None), None);
        // Names that mean other classes.
        let map = [7, 0, 1, 2, 3];
        let off = scene(&[2, 2, 3, 4, 4, -1]);
        assert_eq!(other_ids(&off, &found, Some(&map)).unwrap().by, -1);
        assert_eq!(other_ids(&scene(&[1, 1, 2, 3, 3, 4]), &found, Some(&map)), None);
        let points = LabelledPoints {
            coord: vec![[0.0; 3]; 6],
            segment: Some(vec![1, 1, 2, 3, 3, 4]),
            instance: None,
        };
        let of_points = GaussianScene { labelled_points: Some(points), ..scene(&[9]) };
        assert_eq!(other_ids(&of_points, &found, None).unwrap().by, -1);
    }

    #[test]
    fn a_network_that_is_wrong_is_not_taken_for_it() {
        // One class taken for its neighbor, and a network that knows nothing.
        assert_eq!(other_ids(&scene(&[1, 1, 1, 1, 2]), &[0, 0, 0, 0, 2], None), None);
        assert_eq!(other_ids(&scene(&[1, 2, 3, 4, 5]), &[9, 9, 9, 9, -1], None), None);
        assert_eq!(other_ids(&scene(&[-1, -1]), &[0, 1], None), None);
        assert_eq!(other_ids(&GaussianScene::default(), &[], None), None);
    }
}
