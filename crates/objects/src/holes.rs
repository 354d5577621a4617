//! What removed objects leave open in the floor, the walls and the ceiling, and the Gaussians that close it.

use crate::error::{Result, check_rows};
use crate::surroundings::{is_building, is_kind};
use crate::upright_box::UprightBox;
use crate::{Catalogue, Object, ObjectInput, walls};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use scenesplat_kernels::neighbors::KdTree;
use std::collections::{BTreeMap, BTreeSet};

/// Standard deviations of a removed Gaussian that it hides a surface within.
const SHADOW: f64 = 1.0;
/// How far a removed Gaussian may be before the surface that it hid, meters.
const BEFORE: f64 = 1.2;
/// What is left and this near to a surface, meters, covers it.
const THICK: f64 = 0.12;
/// Least and largest edge of the cells that a surface is divided into, meters; and that edge in spacings of its Gaussians.
const CELLS: [f64; 2] = [0.05, 0.3];
const SPACINGS: f64 = 2.5;
/// Cells that are farther from what is left of their surface, meters, stay open.
const FARTHEST: f64 = 1.5;
/// Largest standard deviation that counts, meters.
const WIDEST: f64 = 0.5;
/// Surfaces that reach farther from the origin, meters, are not looked at.
const FAR: f64 = 1e7;
/// Fainter Gaussians neither hide nor cover anything.
const FAINTEST: f32 = 0.3;
/// Part of the cells around a hole that are covered.
const ENCLOSED: f64 = 0.7;
/// Part of the Gaussians of a surface that lies in its plane.
const FLAT: f64 = 0.6;

/// An opening in a surface of the room.
#[derive(Debug, Clone, PartialEq)]
pub struct Hole {
    /// Number of the surface among the objects.
    pub id: usize,
    /// Its class.
    pub class: String,
    /// Edge of its cells, meters.
    pub cell: f64,
    /// Middles of the cells that patches close, in the frame and unit of the scene. `[C, 3]`
    pub closed: Vec<[f64; 3]>,
    /// Middles of those that stay open, for nothing of the surface is near enough to be copied. `[O, 3]`
    pub open: Vec<[f64; 3]>,
}

impl Hole {
    /// How large it is, m².
    pub fn area(&self) -> f64 {
        (self.closed.len() + self.open.len()) as f64 * self.cell * self.cell
    }

    /// How much of it patches close, m².
    pub fn closed_area(&self) -> f64 {
        self.closed.len() as f64 * self.cell * self.cell
    }
}

/// A copy of a Gaussian that closes a part of a hole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Row of the Gaussian that is copied.
    pub row: usize,
    /// Where the copy is, in the frame and unit of the scene.
    pub coord: [f32; 3],
}

/// All openings, and what closes them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Holes {
    /// At most one for each flat part of a surface, in the order of the catalogue.
    pub holes: Vec<Hole>,
    /// Copies of what is beside them.
    pub patches: Vec<Patch>,
    /// Numbers of floors, walls and ceilings with parts that are not flat, or too far from the origin: in these no hole is
    /// looked for.
    pub uneven: Vec<usize>,
}

type Cell = [i32; 2];

/// Finds what the removed Gaussians hid: the cells of floor, walls and ceiling that have a removed Gaussian at most 1.2 m
/// before them and nothing of what is left at most 12 cm away, where at least 70 % of the cells around such cells are covered.
/// A cell is closed by the Gaussians of the cell that mirrors it at the edge of the hole, else by those of the edge.
///
/// `removed`: of each Gaussian. `[N]`. The same for any number of threads.
///
/// # Errors
/// If arrays do not fit each other.
pub fn holes(input: &ObjectInput<'_>, catalogue: &Catalogue, removed: &[bool]) -> Result<Holes> {
    input.check()?;
    check_rows("removed", input.scene.len(), removed.len())?;
    if !removed.contains(&true) {
        return Ok(Holes::default());
    }
    let coord = input.upright();
    let all: Vec<&Object> = catalogue.objects.iter().filter(|o| is_building(&o.class)).collect();
    let parts: Vec<(&Object, Vec<u32>)> = (all.par_iter())
        .flat_map_iter(|object| {
            parts(input, object, &coord).into_iter().map(|part| (*object, part))
        })
        .collect();
    let found = parts.par_iter().filter_map(|(object, rows)| {
        let left: Vec<u32> = rows.iter().copied().filter(|row| !removed[*row as usize]).collect();
        let surface = Surface::of(object, rows, &left, &coord)?;
        match surface.is_flat(left.len()) {
            true => surface.hole(input, &coord, removed).transpose(),
            false => Some(Ok(Found::Uneven(object.id))),
        }
    });
    let mut out = Holes::default();
    for part in found.collect::<Vec<Result<Found>>>() {
        match part? {
            Found::Uneven(id) if out.uneven.last() == Some(&id) => {}
            Found::Uneven(id) => out.uneven.push(id),
            Found::Open(hole, patches) => {
                out.holes.push(hole);
                out.patches.extend(patches);
            }
        }
    }
    Ok(out)
}

/// What a part of a surface is that is not whole.
enum Found {
    Uneven(usize),
    Open(Hole, Vec<Patch>),
}

/// The flat parts of a surface: the walls of a house that are one object stand along several lines.
fn parts(input: &ObjectInput<'_>, object: &Object, coord: &[[f32; 3]]) -> Vec<Vec<u32>> {
    let is_inside = |row: &u32| input.scene.len() > *row as usize;
    let rows: Vec<u32> = object.rows.iter().copied().filter(is_inside).collect();
    let lines = is_kind(&object.class, "wall").then(|| walls::split(&rows, coord, true)).flatten();
    lines.unwrap_or_else(|| vec![rows])
}

/// What is left of a floor, a wall or a ceiling: a plane with two axes.
struct Surface<'a> {
    object: &'a Object,
    axes: [DVec3; 2],
    normal: DVec3,
    offset: f64,
    /// Edge of its cells, meters.
    cell: f64,
    /// Gaussians whose middle is in a cell.
    rows: BTreeMap<Cell, Vec<u32>>,
    /// Lowest and highest place along the axes.
    span: [[f64; 2]; 2],
}

impl<'a> Surface<'a> {
    /// `rows`: of the surface, `left`: those that stay. `None` if nothing of it is left.
    fn of(object: &'a Object, rows: &[u32], left: &[u32], coord: &[[f32; 3]]) -> Option<Self> {
        let bounds = UprightBox::around(coord, rows)?;
        let side = bounds.side();
        let along = DVec3::new(side.x, side.y, 0.0);
        let stands = is_kind(&object.class, "wall");
        let across = if stands { DVec3::Z } else { DVec3::new(-side.y, side.x, 0.0) };
        let normal = along.cross(across);
        let mut depths: Vec<f64> =
            left.iter().map(|&row| normal.dot(place(coord, row as usize))).collect();
        let at = depths.len() / 2;
        let offset =
            (!depths.is_empty()).then(|| *depths.select_nth_unstable_by(at, f64::total_cmp).1)?;
        let size = [bounds.size[0], bounds.size[if stands { 2 } else { 1 }]];
        let (center, axes) = (DVec3::from(bounds.center), [along, across]);
        let span = [0, 1].map(|a| {
            let c = axes[a].dot(center);
            [c - size[a] / 2.0, c + size[a] / 2.0]
        });
        let rows = BTreeMap::new();
        let mut surface = Self { object, axes, normal, offset, cell: 0.0, rows, span };
        surface.cell = surface.edge(left, coord);
        for &row in left {
            let p = place(coord, row as usize);
            if (normal.dot(p) - offset).abs() <= THICK {
                surface.rows.entry(surface.cell_of(p)).or_default().push(row);
            }
        }
        Some(surface)
    }

    /// Whether most of the Gaussians that are left, so many, lie in its plane, and cells of it can be numbered.
    fn is_flat(&self, left: usize) -> bool {
        if self.span.as_flattened().iter().any(|end| end.abs() > FAR) {
            return false;
        }
        let in_plane: usize = self.rows.values().map(Vec::len).sum();
        in_plane as f64 >= FLAT * left as f64
    }

    /// The edge of its cells, so that hardly any cell of a whole surface is empty.
    fn edge(&self, left: &[u32], coord: &[[f32; 3]]) -> f64 {
        const COARSE: f64 = 0.2;
        let coarse = |row: &u32| {
            let p = place(coord, *row as usize);
            self.axes.map(|axis| (axis.dot(p) / COARSE).floor() as i32)
        };
        let filled = left.iter().map(coarse).collect::<BTreeSet<Cell>>().len() as f64;
        let spacing = (filled * COARSE * COARSE / left.len().max(1) as f64).sqrt();
        (SPACINGS * spacing).clamp(CELLS[0], CELLS[1])
    }

    fn cell_of(&self, p: DVec3) -> Cell {
        self.axes.map(|axis| (axis.dot(p) / self.cell).floor() as i32)
    }

    /// Middle of a cell along the axes.
    fn middle(&self, cell: Cell) -> DVec2 {
        DVec2::from(cell.map(|v| (f64::from(v) + 0.5) * self.cell))
    }

    /// Whether a cell is within what the surface had before.
    fn has(&self, cell: Cell) -> bool {
        let middle = self.middle(cell).to_array();
        (0..2).all(|a| (self.span[a][0]..=self.span[a][1]).contains(&middle[a]))
    }

    /// Whether a Gaussian may be over the surface, however wide it is; none without a place is.
    fn is_over(&self, p: DVec3) -> bool {
        (0..2).all(|a| {
            let at = self.axes[a].dot(p);
            (self.span[a][0] - WIDEST..=self.span[a][1] + WIDEST).contains(&at)
        })
    }

    /// Cells that a Gaussian is over, within so many standard deviations.
    fn cells_under(&self, input: &ObjectInput<'_>, p: DVec3, row: usize, reach: f64) -> Vec<Cell> {
        let (axes, sizes) = input.upright_axes(row);
        // How far the ellipsoid reaches along each axis of the surface.
        let [u, v] = self.axes.map(|axis| {
            let square: f64 =
                (0..3).map(|k| (DVec3::from(axes[k]).dot(axis) * sizes[k]).powi(2)).sum();
            (reach * square.sqrt()).min(WIDEST)
        });
        let range = |a: usize, reach: f64| {
            let at = self.axes[a].dot(p);
            let [low, high] = [at - reach, at + reach].map(|v| (v / self.cell).floor() as i32);
            low..=high
        };
        let columns = range(1, v);
        range(0, u).flat_map(|i| columns.clone().map(move |j| [i, j])).collect()
    }

    fn hole(
        &self,
        input: &ObjectInput<'_>,
        coord: &[[f32; 3]],
        removed: &[bool],
    ) -> Result<Option<Found>> {
        let (mut hidden, mut covered) = (BTreeSet::new(), BTreeSet::new());
        for (row, is_removed) in removed.iter().enumerate() {
            let p = place(coord, row);
            let depth = (self.normal.dot(p) - self.offset).abs();
            let reach = if *is_removed { BEFORE } else { THICK };
            let is_near = depth <= reach && self.is_over(p);
            if !is_near || input.scene.opacity(row) < FAINTEST {
                continue;
            }
            let cells = self.cells_under(input, p, row, SHADOW).into_iter();
            let cells = cells.filter(|cell| self.has(*cell));
            if *is_removed { hidden.extend(cells) } else { covered.extend(cells) }
        }
        let hidden: BTreeSet<Cell> = hidden.difference(&covered).copied().collect();
        let hidden = self.enclosed(&hidden, &covered);
        if hidden.is_empty() {
            return Ok(None);
        }
        let beside = self.beside(&hidden)?;
        let middles = |is_closed: bool| {
            let of = beside.iter().filter(|(_, from)| from.is_some() == is_closed);
            of.map(|(cell, _)| self.in_scene(input, *cell)).collect()
        };
        let hole = Hole {
            id: self.object.id,
            class: self.object.class.clone(),
            cell: self.cell,
            closed: middles(true),
            open: middles(false),
        };
        let patches = beside.iter().filter_map(|(cell, from)| Some((*cell, (*from)?)));
        let patches = patches.flat_map(|(cell, from)| self.copies(input, cell, from)).collect();
        Ok(Some(Found::Open(hole, patches)))
    }

    /// The hidden cells that the surface is around: of cells that hang together, those whose neighbors are mostly covered. A
    /// sofa before a passage hides no wall.
    fn enclosed(&self, hidden: &BTreeSet<Cell>, covered: &BTreeSet<Cell>) -> Vec<Cell> {
        let mut left = hidden.clone();
        let mut out = Vec::new();
        while let Some(first) = left.pop_first() {
            let (mut group, mut at) = (vec![first], 0);
            let (mut closed, mut around) = (0_u32, 0_u32);
            while let Some([i, j]) = group.get(at).copied() {
                at += 1;
                for next in [[i - 1, j], [i + 1, j], [i, j - 1], [i, j + 1]] {
                    if left.remove(&next) {
                        group.push(next);
                    } else if !hidden.contains(&next) && self.has(next) {
                        around += 1;
                        closed += u32::from(covered.contains(&next));
                    }
                }
            }
            if around > 0 && f64::from(closed) >= ENCLOSED * f64::from(around) {
                out.extend(group);
            }
        }
        out.sort_unstable();
        out
    }

    /// Middle of a cell in the frame and unit of the scene.
    fn in_scene(&self, input: &ObjectInput<'_>, cell: Cell) -> [f64; 3] {
        let m = self.middle(cell);
        let p = self.axes[0] * m.x + self.axes[1] * m.y + self.normal * self.offset;
        input.to_scene(p.to_array())
    }

    /// Each cell with the one that is copied into it: its mirror image at the edge of the hole, else the edge; none where
    /// that is too far away.
    fn beside(&self, cells: &[Cell]) -> Result<Vec<(Cell, Option<Cell>)>> {
        let filled: Vec<Cell> = self.rows.keys().copied().collect();
        let level = |cell: &Cell| {
            let m = self.middle(*cell);
            [m.x as f32, m.y as f32, 0.0]
        };
        let tree = KdTree::new(&filled.iter().map(level).collect::<Vec<_>>())?;
        let from = |cell: &Cell| {
            let near = *tree.nearest(level(cell), 1).first()?;
            let edge = *filled.get(near.row as usize)?;
            let mirrored = [0, 1].map(|a| 2 * edge[a] - cell[a]);
            let source = if self.rows.contains_key(&mirrored) { mirrored } else { edge };
            (near.distance_squared <= FARTHEST * FARTHEST).then_some(source)
        };
        Ok(cells.iter().map(|cell| (*cell, from(cell))).collect())
    }

    /// The Gaussians of a cell, in another.
    fn copies(&self, input: &ObjectInput<'_>, cell: Cell, from: Cell) -> Vec<Patch> {
        let [u, v] = [0, 1].map(|a| f64::from(cell[a] - from[a]) * self.cell);
        let step = DVec3::from(input.to_scene((self.axes[0] * u + self.axes[1] * v).to_array()));
        let copy = |&row: &u32| {
            let row = row as usize;
            let p = DVec3::from(input.scene.coord[row].map(f64::from)) + step;
            Patch { row, coord: p.to_array().map(|v| v as f32) }
        };
        self.rows[&from].iter().map(copy).collect()
    }
}

fn place(coord: &[[f32; 3]], row: usize) -> DVec3 {
    DVec3::from(coord[row].map(f64::from))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made::input;
    use crate::{ObjectSettings, find_objects};
    use scenesplat_scene::GaussianScene;

    const NAMES: [&str; 4] = ["floor", "wall", "sofa", "rug"];

    /// Floor of 4 × 3 m and a wall of 2.4 m at y = 3; a sofa of 1.6 × 0.8 × 0.8 m before the wall, behind and under which
    /// nothing was seen.
    fn room() -> (GaussianScene, Vec<i32>) {
        let (mut coord, mut labels) = (Vec::new(), Vec::new());
        let mut add = |p: [f32; 3], label| {
            coord.push(p);
            labels.push(label);
        };
        let behind = |x: f32| (1.2..2.8).contains(&x);
        for i in 0..80_u8 {
            let x = 0.05 * f32::from(i) + 0.025;
            for j in 0..60_u8 {
                let y = 0.05 * f32::from(j) + 0.025;
                if !(behind(x) && y > 2.2) {
                    add([x, y, 0.0], 0);
                }
                if behind(x) && y > 2.2 && j % 2 == 0 {
                    add([x, y, 0.8], 2);
                }
            }
            for k in 0..48_u8 {
                let z = 0.05 * f32::from(k) + 0.025;
                if !(behind(x) && z < 0.8) {
                    add([x, 3.0, z], 1);
                } else {
                    add([x, 2.2, z], 2);
                }
            }
        }
        let n = coord.len();
        let scene = GaussianScene {
            coord,
            quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
            log_scale: vec![[0.02_f32.ln(); 3]; n],
            opacity_logit: vec![3.0; n],
            sh_dc: vec![[0.0; 3]; n],
            ..GaussianScene::default()
        };
        (scene, labels)
    }

    fn names() -> Vec<String> {
        NAMES.map(str::to_owned).to_vec()
    }

    fn without_sofa(scene: &GaussianScene, labels: &[i32]) -> (Holes, Vec<bool>) {
        let names = names();
        let input = input(scene, labels, &names);
        let found = find_objects(&input, &ObjectSettings::default()).unwrap();
        let removed: Vec<bool> = labels.iter().map(|label| *label == 2).collect();
        (holes(&input, &found, &removed).unwrap(), removed)
    }

    fn of<'a>(holes: &'a Holes, class: &str) -> &'a Hole {
        holes.holes.iter().find(|hole| hole.class == class).unwrap()
    }

    #[test]
    fn what_a_sofa_hid_is_as_large_as_the_sofa() {
        let (scene, labels) = room();
        let (found, _) = without_sofa(&scene, &labels);
        assert_eq!(found.holes.len(), 2);
        for (class, area) in [("floor", 1.6 * 0.8), ("wall", 1.6 * 0.8)] {
            let hole = of(&found, class);
            // Cells at the edge have something of both.
            assert!((hole.area() / area - 1.0).abs() < 0.25, "{class}: {} of {area}", hole.area());
            assert_eq!((hole.open.len(), hole.closed_area()), (0, hole.area()), "{class}");
            assert!(hole.closed.iter().all(|c| (1.1..2.9).contains(&c[0])), "{class}: {hole:?}");
        }
    }

    #[test]
    fn patches_lie_in_the_plane_and_leave_nothing_open() {
        let (mut scene, labels) = room();
        let (found, _) = without_sofa(&scene, &labels);
        assert!(!found.patches.is_empty());
        for patch in &found.patches {
            let is = |label| labels[patch.row] == label;
            let [x, y, z] = patch.coord;
            assert!(is(0) && z.abs() < 1e-5 || is(1) && (y - 3.0).abs() < 1e-5, "{patch:?}");
            assert!((1.0..3.0).contains(&x));
        }
        let mut closed = labels.clone();
        for patch in &found.patches {
            scene.coord.push(patch.coord);
            scene.quat.push(scene.quat[patch.row]);
            scene.log_scale.push(scene.log_scale[patch.row]);
            scene.opacity_logit.push(3.0);
            scene.sh_dc.push([0.0; 3]);
            closed.push(labels[patch.row]);
        }
        let (left, _) = without_sofa(&scene, &closed);
        let open: f64 = left.holes.iter().map(Hole::area).sum();
        let before: f64 = found.holes.iter().map(Hole::area).sum();
        assert!(open < 0.02 * before, "{open} of {before} m² are still open");
    }

    #[test]
    fn what_is_covered_is_no_hole() {
        let (mut scene, mut labels) = room();
        // A rug on the floor under the sofa.
        for i in 0..34_u8 {
            for j in 0..20_u8 {
                scene.coord.push([1.15 + 0.05 * f32::from(i), 2.05 + 0.05 * f32::from(j), 0.01]);
                labels.push(3);
            }
        }
        let n = scene.coord.len();
        scene.quat.resize(n, [1.0, 0.0, 0.0, 0.0]);
        scene.log_scale.resize(n, [0.02_f32.ln(); 3]);
        scene.opacity_logit.resize(n, 3.0);
        scene.sh_dc.resize(n, [0.0; 3]);
        let (found, _) = without_sofa(&scene, &labels);
        assert!(found.holes.iter().all(|hole| hole.class != "floor"), "{:?}", found.holes);
        // Nothing removed, nothing open.
        let names = names();
        let input = input(&scene, &labels, &names);
        let catalogue = find_objects(&input, &ObjectSettings::default()).unwrap();
        let none = holes(&input, &catalogue, &vec![false; n]).unwrap();
        assert_eq!(none, Holes::default());
        assert!(holes(&input, &catalogue, &[false]).is_err());
        // A surface that is gone itself closes nothing.
        let all = holes(&input, &catalogue, &vec![true; n]).unwrap();
        assert_eq!(all, Holes::default());
    }

    #[test]
    fn a_sofa_before_a_passage_hides_no_wall() {
        let (scene, labels) = room();
        // Between both ends of the wall there is none, behind the sofa and above it.
        let stays = |row: &usize| labels[*row] != 1 || !(1.1..2.9).contains(&scene.coord[*row][0]);
        let kept: Vec<usize> = (0..scene.len()).filter(stays).collect();
        let open = scene.select_rows(&kept).unwrap();
        let labels: Vec<i32> = kept.iter().map(|&row| labels[row]).collect();
        let names = names();
        let input = input(&open, &labels, &names);
        let ids: Vec<i32> = labels.clone();
        let input = ObjectInput { instances: Some(&ids), ..input };
        let found = find_objects(&input, &ObjectSettings::default()).unwrap();
        let removed: Vec<bool> = labels.iter().map(|label| *label == 2).collect();
        let found = holes(&input, &found, &removed).unwrap();
        let classes: Vec<&str> = found.holes.iter().map(|hole| hole.class.as_str()).collect();
        assert_eq!(classes, ["floor"]);
    }

    #[test]
    fn walls_that_are_one_object_are_looked_at_one_by_one() {
        let (mut scene, mut labels) = room();
        // A second wall at a right angle to the first, of the same instance.
        for j in 0..60_u8 {
            for k in 0..48_u8 {
                scene.coord.push([0.0, 0.05 * f32::from(j), 0.05 * f32::from(k) + 0.025]);
                labels.push(1);
            }
        }
        let n = labels.len();
        scene.quat.resize(n, [1.0, 0.0, 0.0, 0.0]);
        scene.log_scale.resize(n, [0.02_f32.ln(); 3]);
        scene.opacity_logit.resize(n, 3.0);
        scene.sh_dc.resize(n, [0.0; 3]);
        let names = names();
        let input = ObjectInput { instances: Some(&labels), ..input(&scene, &labels, &names) };
        let found = find_objects(&input, &ObjectSettings::default()).unwrap();
        assert_eq!(found.objects.iter().filter(|o| o.class == "wall").count(), 1);
        let removed: Vec<bool> = labels.iter().map(|label| *label == 2).collect();
        let corner = holes(&input, &found, &removed).unwrap();
        let wall = of(&corner, "wall");
        assert!((wall.area() / 1.28 - 1.0).abs() < 0.25, "{}", wall.area());
        assert_eq!((corner.holes.len(), corner.uneven.len()), (2, 0));
        // What is no plane is said.
        let blob = |(i, (c, label)): (usize, (&[f32; 3], &i32))| {
            let place = [i % 97, i % 89, i % 83].map(|part| 0.025 * part as f32);
            if *label == 1 { place } else { *c }
        };
        let coord = scene.coord.iter().zip(&labels).enumerate().map(blob).collect();
        let scene = GaussianScene { coord, ..scene.clone() };
        let input = ObjectInput { scene: &scene, ..input };
        let found = find_objects(&input, &ObjectSettings::default()).unwrap();
        let wall = found.objects.iter().find(|o| o.class == "wall").unwrap();
        assert_eq!(holes(&input, &found, &removed).unwrap().uneven, [wall.id]);
    }

    #[test]
    fn surfaces_without_an_end_are_not_looked_at() {
        let (mut scene, labels) = room();
        for (c, label) in scene.coord.iter_mut().zip(&labels) {
            if *label == 0 {
                *c = c.map(|v| 1e30 * v);
            }
        }
        let (found, _) = without_sofa(&scene, &labels);
        assert!(!found.uneven.is_empty() && found.holes.iter().all(|h| h.class != "floor"));
    }

    #[test]
    fn turned_scenes_in_other_units_have_the_same_holes() {
        let (scene, labels) = room();
        let (plain, removed) = without_sofa(&scene, &labels);
        // y is up, units of 20 cm.
        let turned = GaussianScene {
            coord: scene.coord.iter().map(|c| [c[0], c[2], -c[1]].map(|v| 5.0 * v)).collect(),
            log_scale: vec![[0.1_f32.ln(); 3]; labels.len()],
            ..scene
        };
        let names = names();
        let turned = ObjectInput {
            upright: [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
            metres_per_unit: 0.2,
            ..input(&turned, &labels, &names)
        };
        let catalogue = find_objects(&turned, &ObjectSettings::default()).unwrap();
        let found = holes(&turned, &catalogue, &removed).unwrap();
        for (a, b) in plain.holes.iter().zip(&found.holes) {
            let (a, b) = (a.area(), b.area());
            assert!((a - b).abs() < 0.1 * a, "{a} and {b} m²");
        }
        assert_eq!(plain.holes.len(), found.holes.len());
        let flat = |p: &&Patch| labels[p.row] != 0 || p.coord[1].abs() < 1e-4;
        assert_eq!(found.patches.iter().filter(flat).count(), found.patches.len());
    }
}
