//! Glass and mirrors: a large part of a plane that bounds the scene, in which whatever there is is faint, as a pane is
//! that pictures see through; and behind it things as faint, which it reflected.
//!
//! The area of the cells of a plane in which nothing is opaque, though the surface goes on in nearly all directions, as a
//! share of the plane; and the share of the scene that is fainter than usual behind a plane. Reflections become
//! geometry behind a pane, and pictures disagree about it, so that it stays faint; panes that reflect nothing near them
//! leave none. What really stands behind a wall (the other part of a room with a corner) is as opaque as the rest.

use super::planes::Shell;
use super::table::{Table, quantile_of};
use super::{Figure, Measured, Outcome};

/// What is behind counts so many times what is in the plane.
const BEHIND: f64 = 3.0;

pub(super) fn measure(table: &Table<'_>, shell: &Shell) -> Outcome {
    shell.is_room()?;
    let opacity = |i: usize| f64::from(table.scene.opacity(table.rows[i] as usize));
    let all = table.rows.len();
    let Some(usual) = quantile_of((0..all).map(opacity), 0.5) else {
        return Err("there are no Gaussians");
    };
    let mut best = [0.0f64; 2];
    for wall in &shell.walls {
        let faint = wall.behind.iter().filter(|&&i| opacity(i) < usual).count() as f64;
        // Of what is no fainter than the scene, as much is below its median as above.
        let more = (2.0 * faint - wall.behind.len() as f64) / all as f64;
        let pane = wall.gaps.faint / wall.gaps.areas[1].max(f64::MIN_POSITIVE);
        best = [best[0].max(more), best[1].max(pane)];
    }
    let strength = best[1] + BEHIND * best[0];
    Ok(Measured {
        measure: Figure::new("see_through", strength, ""),
        more: vec![
            Figure::new("faint_area", best[1], ""),
            Figure::new("faint_behind", best[0], ""),
            Figure::new("planes", shell.walls.len() as f64, ""),
        ],
        strength,
        regions: Vec::new(),
    })
}
