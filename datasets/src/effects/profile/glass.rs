//! Glass and mirrors: behind a plane that bounds the scene there is something, and it is fainter than the scene.
//!
//! Reflections become geometry behind a pane, and pictures disagree about it, so that it stays faint. What really
//! stands behind a wall (the other part of a room with a corner) is as opaque as the rest. Panes that reflect
//! nothing near them leave no such trace.

use super::planes::Large;
use super::table::{Table, quantile_of};
use super::{Figure, Measured, Outcome};

/// A plane with more behind it bounds nothing.
const BEHIND: f64 = 0.25;

pub(super) fn measure(table: &Table<'_>, planes: &[Large]) -> Outcome {
    let scene = table.scene;
    let opacity = |row: u32| f64::from(scene.opacity(row as usize));
    let places: Vec<[f64; 3]> =
        table.rows.iter().map(|&row| scene.coord[row as usize].map(f64::from)).collect();
    let Some(usual) = quantile_of(table.rows.iter().map(|&row| opacity(row)), 0.5) else {
        return Err("there are no Gaussians");
    };
    let diagonal = table.bounds.diagonal();
    let all = places.len() as f64;
    let mut best = [0.0; 2];
    let mut bounding = 0;
    for plane in planes {
        let beyond = plane.beyond(&places, diagonal);
        if beyond.len() as f64 > BEHIND * all {
            continue;
        }
        bounding += 1;
        let faint = beyond.iter().filter(|&&i| opacity(table.rows[i]) < usual).count() as f64;
        // Of what is no fainter than the scene, as much is below its median as above.
        let more = 2.0 * faint - beyond.len() as f64;
        if more / all > best[0] {
            best = [more / all, beyond.len() as f64 / all];
        }
    }
    if bounding == 0 {
        return Err("no large flat surface bounds the scene");
    }
    Ok(Measured {
        measure: Figure::new("faint_behind", best[0], ""),
        more: vec![
            Figure::new("behind", best[1], ""),
            Figure::new("planes", f64::from(bounding), ""),
        ],
        strength: best[0],
    })
}
