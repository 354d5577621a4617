//! The floor and the walls that places are measured from.

use crate::error::Result;
use scenesplat_kernels::neighbors::KdTree;
use serde::Serialize;

/// Rows of walls, and of an object, that distances are measured between.
const WALL_ROWS: usize = 40_000;
const OBJECT_ROWS: usize = 400;

/// Whether a class is of a kind: of that name, or its last word is it. `HouseWall`, `house_wall` and `brick wall` are
/// walls, a wall cabinet is none.
pub fn is_kind(class: &str, kind: &str) -> bool {
    let letters: Vec<char> = class.trim().chars().collect();
    let begins_word = |i: usize| {
        let after_case = letters[i].is_uppercase() && letters[i - 1].is_lowercase();
        after_case || !letters[i - 1].is_alphanumeric()
    };
    let start = (1..letters.len()).rev().find(|&i| begins_word(i)).unwrap_or(0);
    let last: String = letters[start..].iter().collect();
    class.eq_ignore_ascii_case(kind) || last.eq_ignore_ascii_case(kind)
}

/// Whether a class is a part of the building that things stand in: a floor, a wall or a ceiling.
pub fn is_building(class: &str) -> bool {
    ["floor", "wall", "ceiling"].iter().any(|kind| is_kind(class, kind))
}

/// Where the floor is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Floor {
    /// Its height along up, meters.
    pub height: f64,
    /// Whether Gaussians labeled as floor say so, rather than the lowest ones.
    pub is_labelled: bool,
    /// Whether it was known before.
    pub is_given: bool,
}

impl Floor {
    /// A floor of known height, meters.
    pub(crate) fn given(height: f64) -> Self {
        Self { height, is_labelled: false, is_given: true }
    }

    /// The middle of what is labeled floor, or of the lowest percent of all. `coord`: upright.
    pub(crate) fn find(coord: &[[f32; 3]], labelled: &[u32]) -> Self {
        let middle = |mut heights: Vec<f32>, share: f64| {
            let at = ((heights.len().max(1) - 1) as f64 * share) as usize;
            if heights.is_empty() {
                return 0.0;
            }
            f64::from(*heights.select_nth_unstable_by(at, f32::total_cmp).1)
        };
        if labelled.is_empty() {
            let all = coord.iter().map(|c| c[2]).filter(|z| z.is_finite()).collect();
            return Self { height: middle(all, 0.01), is_labelled: false, is_given: false };
        }
        let own = labelled.iter().map(|&r| coord[r as usize][2]).collect();
        Self { height: middle(own, 0.5), is_labelled: true, is_given: false }
    }
}

/// Walls, for distances.
#[derive(Debug)]
pub(crate) struct Walls(Option<KdTree>);

impl Walls {
    pub(crate) fn new(coord: &[[f32; 3]], rows: &[u32]) -> Result<Self> {
        if rows.is_empty() {
            return Ok(Self(None));
        }
        let step = rows.len().div_ceil(WALL_ROWS);
        let places: Vec<[f32; 3]> = rows.iter().step_by(step).map(|&r| coord[r as usize]).collect();
        Ok(Self(Some(KdTree::new(&places)?)))
    }

    /// Least distance of some rows from a wall, meters; `None` without walls.
    pub(crate) fn distance(&self, coord: &[[f32; 3]], rows: &[u32]) -> Option<f64> {
        let tree = self.0.as_ref()?;
        let step = rows.len().div_ceil(OBJECT_ROWS).max(1);
        let of =
            |&row: &u32| tree.nearest(coord[row as usize], 1).first().map(|n| n.distance_squared);
        rows.iter().step_by(step).filter_map(of).reduce(f64::min).map(f64::sqrt)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_word_says_the_kind() {
        for name in
            ["wall", "Wall", "HouseWall", "house_wall", "brick wall", "interior-wall", " wall "]
        {
            assert!(is_kind(name, "wall"), "{name}");
        }
        for name in ["wall cabinet", "drywall", "WallLamp", "walls", "", "w", "wall_"] {
            assert!(!is_kind(name, "wall"), "{name}");
        }
        assert!(is_kind("raised floor", "raised floor"));
        assert!(is_building("RoomWall") && is_building("Ceiling") && !is_building("floor lamp"));
    }

    #[test]
    fn an_object_is_as_far_from_a_wall_as_its_nearest_part() {
        let coord = [[0.0; 3], [3.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        let walls = Walls::new(&coord, &[0]).unwrap();
        // The parts are 3, 1 and 2 m from the only Gaussian of a wall.
        assert_eq!(walls.distance(&coord, &[1, 2, 3]), Some(1.0));
        assert_eq!(walls.distance(&coord, &[1, 3]), Some(2.0));
        assert_eq!(Walls::new(&coord, &[]).unwrap().distance(&coord, &[1]), None);
    }

    #[test]
    fn the_floor_is_the_middle_of_its_gaussians_or_the_lowest_percent() {
        let coord: Vec<[f32; 3]> = (0..202)
            .map(|i| [7.0, -3.0, if i == 3 { f32::NAN } else { (i * 37 % 202) as f32 }])
            .collect();
        // 201 heights, 0 to 201 without 111: the third from below.
        let lowest = Floor { height: 2.0, is_labelled: false, is_given: false };
        assert_eq!(Floor::find(&coord, &[]), lowest);
        // Heights 0, 37, 74, 148: of four the lower of the middle two.
        let labelled = Floor { height: 37.0, is_labelled: true, is_given: false };
        assert_eq!(Floor::find(&coord, &[0, 1, 2, 4]), labelled);
        assert_eq!(Floor::find(&[], &[]), Floor { height: 0.0, ..lowest });
        assert_eq!(Floor::given(-1.5), Floor { height: -1.5, is_labelled: false, is_given: true });
    }

    #[test]
    fn of_many_rows_some_are_looked_at() {
        // Of 40,001 rows of a wall every second; the one at 1 m is the second.
        let mut coord = vec![[0.0f32; 3]; 40_001];
        coord[1] = [1.0, 0.0, 0.0];
        coord.push([2.0, 0.0, 0.0]);
        let rows: Vec<u32> = (0..40_001).collect();
        let of = |count: usize| Walls::new(&coord, &rows[..count]).unwrap();
        assert_eq!(
            (of(40_001).distance(&coord, &[40_001]), of(40_000).distance(&coord, &[40_001])),
            (Some(2.0), Some(1.0))
        );
        // Of 401 rows of an object every second.
        let near = of(1);
        let mut object = vec![40_001; 401];
        object[1] = 1;
        assert_eq!(
            (near.distance(&coord, &object), near.distance(&coord, &object[..400])),
            (Some(2.0), Some(1.0))
        );
    }
}
