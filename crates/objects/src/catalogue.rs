//! The objects of a scene.

use crate::cells::pieces;
use crate::error::Result;
use crate::fragments;
use crate::input::ObjectInput;
use crate::settings::ObjectSettings;
use crate::surroundings::{Floor, Walls, is_kind};
use crate::upright_box::UprightBox;
use crate::{panels, walls};
use rayon::prelude::*;
use scenesplat_kernels::neighbors::KdTree;
use serde::Serialize;

/// Rows of a class whose spacing is looked at.
const SPACING_SAMPLE: usize = 4000;
/// Gaps within an object, in spacings of its class.
const GAP_SPACINGS: f64 = 2.5;
/// Least and largest gap, meters.
const GAPS: [f64; 2] = [0.04, 0.25];
/// A normal is level within this cosine, and a piece stands when this share of its normals is.
const UPRIGHT: f32 = 0.35;
const STANDS: f64 = 0.7;
/// Words of classes whose halves hang apart and are one thing.
const PAIRED: [&str; 3] = ["curtain", "drape", "curtains"];

/// An object.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Object {
    /// Its number, from 1: by class, then by place.
    pub id: usize,
    /// Name of its class.
    pub class: String,
    /// Row of its class among the names.
    pub label: usize,
    /// Mean score of its Gaussians.
    pub score: Option<f64>,
    /// Number of its Gaussians.
    pub count: usize,
    /// The box around it; meters, upright frame (+z is up).
    #[serde(rename = "upright_box")]
    pub bounds: UprightBox,
    /// Middle of the box, in the frame and unit of the scene.
    pub position: [f64; 3],
    /// Corners of the box, in the frame and unit of the scene, the lower four first.
    pub corners: [[f64; 3]; 8],
    /// Volume of the box, m³.
    pub volume: f64,
    /// Height of its lowest part over the floor, meters.
    pub above_floor: f64,
    /// Distance from the nearest wall, meters; `None` for walls and where there are none.
    pub wall_distance: Option<f64>,
    /// Its Gaussians, rising.
    #[serde(skip)]
    pub rows: Vec<u32>,
}

/// The objects of a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Catalogue {
    /// The objects, by class and then by place.
    pub objects: Vec<Object>,
    /// Where heights are measured from.
    pub floor: Floor,
    /// Labeled Gaussians in pieces too small to be objects.
    pub left_over: usize,
    /// Instances that the scene carries and that are no objects, for they have too few Gaussians.
    pub small_instances: usize,
    /// Instances that the scene carries and that are no objects, for none of their Gaussians has a class.
    pub nameless_instances: usize,
    /// Gaussians of the scene.
    pub gaussians: usize,
    /// Whether the objects are instances that the scene carries, not pieces of its classes.
    pub is_carried: bool,
}

/// Finds the objects of a labeled scene.
///
/// Where instances are given, each is an object, of the class that most of its Gaussians have. Else
/// an object is a piece of one class that hangs together in space and feature; pieces along lines in
/// plan (walls) are split into these, rows of boxes between their panels, and fragments are joined.
/// The same for any number of threads.
///
/// # Errors
/// If arrays and names do not fit each other, or a setting is out of range.
pub fn find_objects(input: &ObjectInput<'_>, settings: &ObjectSettings) -> Result<Catalogue> {
    settings.check()?;
    input.check()?;
    let coord = input.upright();
    let by_class = rows_by_class(input, &coord);
    let of_kind = |kind: &str| -> Vec<u32> {
        let own = input.names.iter().zip(&by_class).filter(|(name, _)| is_kind(name, kind));
        own.flat_map(|(_, rows)| rows.iter().copied()).collect()
    };
    let floor =
        input.floor.map_or_else(|| Floor::find(&coord, &of_kind(&settings.floor)), Floor::given);
    let walls = Walls::new(&coord, &of_kind(&settings.wall))?;
    let (groups, nameless_instances) = match input.instances {
        Some(instances) => known(instances, input.labels, &coord),
        None => {
            let classes = by_class.par_iter().enumerate();
            let found: Result<Vec<Vec<Vec<u32>>>> = classes
                .map(|(label, rows)| of_class(input, settings, &coord, label, rows))
                .collect();
            let found = found?.into_iter().enumerate();
            let found = found.flat_map(|(label, parts)| parts.into_iter().map(move |p| (label, p)));
            (found.collect(), 0)
        }
    };
    let labelled: usize = by_class.iter().map(Vec::len).sum();
    let is_small = |rows: &[u32]| rows.len() < settings.min_count;
    let (small, kept): (Vec<_>, Vec<_>) = groups.into_iter().partition(|(_, rows)| is_small(rows));
    let small_instances = if input.instances.is_some() { small.len() } else { 0 };
    let describe = |(label, rows): &(usize, Vec<u32>)| {
        let walls = (!is_kind(&input.names[*label], &settings.wall)).then_some(&walls);
        describe(input, &coord, *label, rows, &floor, walls)
    };
    let mut objects: Vec<Object> = kept.par_iter().filter_map(describe).collect();
    number(&mut objects);
    let is_labelled = |row: &&u32| input.labels[**row as usize] >= 0;
    let in_objects: usize = objects.iter().map(|o| o.rows.iter().filter(is_labelled).count()).sum();
    Ok(Catalogue {
        objects,
        floor,
        left_over: labelled.saturating_sub(in_objects),
        small_instances,
        nameless_instances,
        gaussians: input.scene.len(),
        is_carried: input.instances.is_some(),
    })
}

/// The labeled Gaussians of each class that have a place.
fn rows_by_class(input: &ObjectInput<'_>, coord: &[[f32; 3]]) -> Vec<Vec<u32>> {
    let mut by_class: Vec<Vec<u32>> = vec![Vec::new(); input.names.len()];
    for (row, (&label, c)) in (0u32..).zip(input.labels.iter().zip(coord)) {
        if let Some(rows) = usize::try_from(label).ok().and_then(|l| by_class.get_mut(l))
            && c.iter().all(|v| v.is_finite())
        {
            rows.push(row);
        }
    }
    by_class
}

/// Numbers by class and place: the same scene with its rows in another order has the same ones.
fn number(objects: &mut [Object]) {
    objects.sort_by(|a, b| {
        let place = |o: &Object| o.bounds.center;
        let by_place = (0..3).map(|i| place(a)[i].total_cmp(&place(b)[i]));
        let by_place = by_place.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then);
        a.label.cmp(&b.label).then(by_place).then(a.rows.cmp(&b.rows))
    });
    for (id, object) in (1..).zip(objects) {
        object.id = id;
    }
}

/// An object without a number; distances are from `walls`.
fn describe(
    input: &ObjectInput<'_>,
    coord: &[[f32; 3]],
    label: usize,
    rows: &[u32],
    floor: &Floor,
    walls: Option<&Walls>,
) -> Option<Object> {
    let bounds = UprightBox::around(coord, rows)?;
    let score =
        |s: &[f32]| rows.iter().map(|&r| f64::from(s[r as usize])).sum::<f64>() / rows.len() as f64;
    Some(Object {
        id: 0,
        class: input.names[label].clone(),
        label,
        score: input.scores.map(score).filter(|s| s.is_finite()),
        count: rows.len(),
        bounds,
        position: input.to_scene(bounds.center),
        corners: bounds.corners().map(|c| input.to_scene(c)),
        volume: bounds.volume(),
        above_floor: bounds.heights()[0] - floor.height,
        wall_distance: walls.and_then(|walls| walls.distance(coord, rows)),
        rows: rows.to_vec(),
    })
}

/// The objects of one class.
fn of_class(
    input: &ObjectInput<'_>,
    settings: &ObjectSettings,
    coord: &[[f32; 3]],
    label: usize,
    rows: &[u32],
) -> Result<Vec<Vec<u32>>> {
    if rows.len() < settings.min_count {
        return Ok(Vec::new());
    }
    let gap = match settings.gap {
        Some(gap) => gap,
        None => (GAP_SPACINGS * spacing(coord, rows)?).clamp(GAPS[0], GAPS[1]),
    };
    let mean = |rows: &[u32]| {
        let (width, add) = input.features?;
        let mut sum = vec![0f32; width];
        rows.iter().for_each(|&row| add(row as usize, &mut sum));
        let norm = sum.iter().map(|v| v * v).sum::<f32>().sqrt();
        (norm > 0.0).then(|| sum.into_iter().map(|v| v / norm).collect())
    };
    let found = pieces(rows, coord, gap, &mean, settings.min_similarity);
    if !settings.reshape {
        return Ok(found);
    }
    let facing = |row: u32, d: [f32; 2]| {
        input.upright_normal(row as usize).map(|n| n[0] * d[0] + n[1] * d[1])
    };
    let name = input.names[label].to_lowercase();
    let pairs = PAIRED.contains(&name.as_str());
    let found = fragments::join(found, coord, gap, settings.min_count, pairs);
    let mut out = Vec::new();
    for piece in found {
        if let Some(lines) = walls::split(&piece, coord, stands(input, &piece)) {
            out.extend(lines.into_iter().filter(|part| part.len() >= settings.min_count));
        } else {
            out.extend(panels::split(&piece, coord, facing).unwrap_or_else(|| vec![piece]));
        }
    }
    Ok(fragments::join_sides(out, coord))
}

/// Whether most flat Gaussians of a piece are upright.
fn stands(input: &ObjectInput<'_>, rows: &[u32]) -> bool {
    let step = rows.len().div_ceil(SPACING_SAMPLE).max(1);
    let normals = rows.iter().step_by(step).filter_map(|&r| input.upright_normal(r as usize));
    let (flat, upright) =
        normals.fold((0, 0), |(flat, up), n| (flat + 1, up + u32::from(n[2].abs() < UPRIGHT)));
    flat > 0 && f64::from(upright) >= STANDS * f64::from(flat)
}

/// Distance of a row of a class from the fourth nearest one, in the middle: 1.09 of the spacing
/// 1/√(rows per area) on a plane.
fn spacing(coord: &[[f32; 3]], rows: &[u32]) -> Result<f64> {
    let places: Vec<[f32; 3]> = rows.iter().map(|&r| coord[r as usize]).collect();
    let tree = KdTree::new(&places)?;
    let sample: Vec<[f32; 3]> =
        places.iter().step_by(places.len().div_ceil(SPACING_SAMPLE)).copied().collect();
    let mut far = tree.map_nearest(
        &sample,
        5,
        || (),
        |(), _, near| near.last().map_or(0.0, |n| n.distance_squared.sqrt()),
    );
    let middle = far.len() / 2;
    Ok(*far.select_nth_unstable_by(middle, f64::total_cmp).1 / 1.09)
}

/// The rows of each instance, with the class that most of them have, the first of equal ones; and how
/// many instances are without any class.
fn known(instances: &[i32], labels: &[i32], coord: &[[f32; 3]]) -> (Vec<(usize, Vec<u32>)>, usize) {
    let mut rows: Vec<(i32, u32)> = (0u32..)
        .zip(instances)
        .filter(|(row, id)| **id >= 0 && coord[*row as usize].iter().all(|v| v.is_finite()))
        .map(|(row, &id)| (id, row))
        .collect();
    rows.sort_unstable();
    let class_of = |rows: &[(i32, u32)]| {
        let mut own: Vec<i32> =
            rows.iter().map(|(_, r)| labels[*r as usize]).filter(|l| *l >= 0).collect();
        own.sort_unstable();
        let runs = own.chunk_by(|a, b| a == b);
        let most = runs.fold(&[][..], |most, run| if run.len() > most.len() { run } else { most });
        most.first().and_then(|l| usize::try_from(*l).ok())
    };
    let (mut named, mut nameless) = (Vec::new(), 0);
    for run in rows.chunk_by(|a, b| a.0 == b.0) {
        match class_of(run) {
            Some(class) => named.push((class, run.iter().map(|(_, row)| *row).collect())),
            None => nameless += 1,
        }
    }
    (named, nameless)
}

impl Catalogue {
    /// Number of the object of each Gaussian, from 0 as in `objects`; −1 = none. `[N]`
    pub fn instances(&self) -> Vec<i32> {
        let mut out = vec![-1; self.gaussians];
        for (i, object) in (0i32..).zip(&self.objects) {
            object.rows.iter().for_each(|&row| out[row as usize] = i);
        }
        out
    }

    /// Objects of each class that has some, by class: name, objects, Gaussians.
    pub fn counts(&self) -> Vec<(&str, usize, usize)> {
        let runs = self.objects.chunk_by(|a, b| a.label == b.label);
        runs.map(|run| (run[0].class.as_str(), run.len(), run.iter().map(|o| o.count).sum()))
            .collect()
    }
}

#[cfg(test)]
mod tests;
