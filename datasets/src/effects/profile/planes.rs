//! The planes that hold most patches, and which of them bound the scene: walls, floors.

use super::FEWEST_PATCHES;
use super::cells::FAINT;
use super::gaps::{ACROSS, Gaps, Large, THICK};
use super::table::{Patch, Plane, Table, choice, quantile_of};
use rayon::prelude::*;
use scenesplat_scene::vector::{cross, dot};

/// Patches whose planes are tried.
const CANDIDATES: usize = 192;
/// Planes that are looked at, and the least share of the flat patches that one holds: with panes in them, walls have few.
const MOST_PLANES: usize = 12;
const LEAST_SHARE: f64 = 0.02;
/// Planes with less are looked at for panes, and for what these reflected, alone: fronts of furniture before a wall have gaps between
/// them, and curved things have many planes as small.
pub(super) const BOUNDING_SHARE: f64 = 0.04;
/// A plane with more of the Gaussians behind it bounds nothing.
const BEHIND: f64 = 0.1;
/// A room is a scene whose bounding planes have this share of the area of its box, or more. Rooms without
/// a ceiling have 0.69 and more, objects up to 0.59, a house of several rooms 0.45.
const ROOM: f64 = 0.62;
/// Normals of one plane agree so well.
const SAME_NORMAL: f64 = 0.94;

/// The planes that bound a scene.
#[derive(Default)]
pub(super) struct Shell {
    pub(super) walls: Vec<Wall>,
    /// Balls of the panes in large planes that bound nothing, each plane's with the pane's share of it.
    pub(super) partitions: Vec<(f64, Vec<[f32; 4]>)>,
    /// Their area over that of the robust box.
    pub(super) share_of_box: f64,
    /// Opacities of the rows that are looked at, over the median one; all 1 if that is 0.
    pub(super) opacity: Vec<f64>,
}

/// A plane that bounds the scene.
pub(super) struct Wall {
    /// Indices among the rows that are looked at of what is behind it.
    pub(super) behind: Vec<usize>,
    /// The share of all that those behind it are that are not faint.
    pub(super) share_behind: f64,
    /// The share of the flat patches that lies in it.
    pub(super) share: f64,
    /// Where nothing is though it goes on around.
    pub(super) gaps: Gaps,
}

impl Shell {
    pub(super) fn of(table: &Table<'_>) -> Self {
        let diagonal = table.bounds.diagonal();
        let places: Vec<[f64; 3]> =
            table.rows.iter().map(|&row| table.scene.coord[row as usize].map(f64::from)).collect();
        let opacity = opacities(table);
        let wall = |plane: &Large| {
            let behind = plane.beyond(&places, diagonal);
            // What a pane reflects stands behind it, faint: it is no other room.
            let solid = behind.iter().filter(|&&i| opacity[i] >= FAINT).count();
            let share_behind = solid as f64 / places.len() as f64;
            Wall {
                behind,
                share_behind,
                share: plane.share,
                gaps: plane.gaps(&places, &opacity, diagonal),
            }
        };
        let planes: Vec<Wall> = planes(table).par_iter().map(wall).collect();
        let (walls, others): (Vec<Wall>, Vec<Wall>) =
            planes.into_iter().partition(|wall| wall.share_behind <= BEHIND);
        let pane = |wall: Wall| (wall.gaps.pane_share(), wall.gaps.pane_regions().collect());
        let partitions = others.into_iter().map(pane).collect();
        let [x, y, z] = table.bounds.extent();
        let large = walls.iter().filter(|wall| wall.share >= BOUNDING_SHARE);
        let area: f64 = large.map(|wall| wall.gaps.areas[1]).sum();
        Self { share_of_box: area / (2.0 * (x * y + y * z + z * x)), walls, partitions, opacity }
    }

    /// Whether the scene is a room, which all that is known of these effects was learned on.
    pub(super) fn is_room(&self) -> Result<(), &'static str> {
        let is_room = self.share_of_box >= ROOM;
        if is_room {
            Ok(())
        } else {
            Err("no room: large flat surfaces make up too little of the scene's box")
        }
    }
}

/// Opacities of the rows that are looked at, over the median one; all 1 if that is 0.
fn opacities(table: &Table<'_>) -> Vec<f64> {
    let opacity = |&row: &u32| f64::from(table.scene.opacity(row as usize));
    let mut all: Vec<f64> = table.rows.iter().map(opacity).collect();
    match quantile_of(all.iter().copied(), 0.5) {
        Some(usual) if usual > 0.0 => all.iter_mut().for_each(|opacity| *opacity /= usual),
        _ => all.fill(1.0),
    }
    all
}

/// The planes that hold most flat patches, the largest first; each patch counts for one.
fn planes(table: &Table<'_>) -> Vec<Large> {
    let flat: Vec<(&Patch, Plane)> = table.flat().collect();
    let diagonal = table.bounds.diagonal();
    let places: Vec<[f64; 3]> = flat.iter().map(|(p, _)| table.place(p)).collect();
    let candidates = choice(flat.len(), CANDIDATES);
    let holds = |c: usize, i: usize| {
        let (n, m) = (flat[c].1.axes[2], flat[i].1.axes[2]);
        let apart: [f64; 3] = std::array::from_fn(|a| places[i][a] - places[c][a]);
        dot(n, m).abs() >= SAME_NORMAL && dot(n, apart).abs() <= ACROSS * diagonal
    };
    let mut members: Vec<(usize, Vec<usize>)> = candidates
        .par_iter()
        .map(|&c| (c, (0..flat.len()).filter(|&i| holds(c, i)).collect()))
        .collect();
    let least = (LEAST_SHARE * flat.len() as f64).max(FEWEST_PATCHES as f64 / 2.0) as usize;
    let mut is_free = vec![true; flat.len()];
    let mut found = Vec::new();
    while found.len() < MOST_PLANES {
        // The first of the largest.
        let Some(best) = (0..members.len()).rev().max_by_key(|&k| members[k].1.len()) else {
            break;
        };
        let (c, rows) = members.swap_remove(best);
        if rows.len() < least {
            break;
        }
        rows.iter().for_each(|&i| is_free[i] = false);
        members.iter_mut().for_each(|(_, rows)| rows.retain(|&i| is_free[i]));
        members.sort_by_key(|m| m.0);
        let axes = mean_axes(flat[c].1.axes, rows.iter().map(|&i| flat[i].1.axes[2]));
        let middle = |values: Vec<f64>| quantile_of(values.into_iter(), 0.5).unwrap_or(0.0);
        let offset = middle(rows.iter().map(|&i| dot(axes[2], places[i])).collect());
        let fourth = middle(rows.iter().map(|&i| f64::from(flat[i].0.fourth)).collect());
        let again = found.iter_mut().find_map(|other: &mut Large| {
            let sign = dot(other.axes[2], axes[2]);
            let side = sign.signum() * offset;
            let same = sign.abs() > SAME_NORMAL && (other.offset - side).abs() < THICK * diagonal;
            same.then_some((other, side))
        });
        match again {
            Some((other, side)) => other.sides.push(side),
            // Four others lie within that distance.
            None if fourth > 0.0 => {
                let density = 4.0 / (std::f64::consts::PI * fourth * fourth);
                let share = rows.len() as f64 / flat.len() as f64;
                found.push(Large { axes, offset, sides: Vec::new(), density, share });
            }
            None => {}
        }
    }
    found
}

/// Axes with the mean of the normals for a normal.
fn mean_axes(of: [[f64; 3]; 3], normals: impl Iterator<Item = [f64; 3]>) -> [[f64; 3]; 3] {
    let mut sum = [0.0; 3];
    for n in normals {
        let sign = dot(n, of[2]).signum();
        (0..3).for_each(|a| sum[a] += sign * n[a]);
    }
    let unit = |v: [f64; 3]| {
        let length = dot(v, v).sqrt();
        v.map(|x| x / length)
    };
    let normal = unit(sum);
    let along = dot(of[0], normal);
    let first = unit(std::array::from_fn(|a| of[0][a] - along * normal[a]));
    [first, cross(normal, first), normal]
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_rooms::{SyntheticRoomSettings, generate};

    /// Walls of this room are 12 cm thick.
    #[test]
    fn both_sides_of_a_wall_are_one_plane() {
        let room = generate(&SyntheticRoomSettings::with_count(60_000, 7006)).unwrap().scene;
        let found = planes(&Table::of(&room, 100).unwrap());
        let thick = |p: &&Large| p.sides.iter().any(|s| ((s - p.offset).abs() - 0.12).abs() < 0.03);
        assert!(found.iter().filter(thick).count() >= 2, "{:?}", sides(&found));
        // Of a floor there is one side.
        assert!(found.iter().filter(|p| p.axes[2][2].abs() > 0.9).all(|p| !thick(&p)));
    }

    fn sides(planes: &[Large]) -> Vec<([f64; 3], f64, &[f64])> {
        planes.iter().map(|p| (p.axes[2], p.offset, p.sides.as_slice())).collect()
    }
}
