//! Glass and mirrors: behind a plane that bounds the scene there is something, and it is fainter than the scene.
//!
//! Reflections become geometry behind a pane, and pictures disagree about it, so that it stays faint. What really
//! stands behind a wall (the other part of a room with a corner) is as opaque as the rest. Panes that reflect
//! nothing near them leave no such trace.

use super::planes::Shell;
use super::table::{Table, quantile_of};
use super::{Figure, Measured, Outcome};

pub(super) fn measure(table: &Table<'_>, shell: &Shell) -> Outcome {
    shell.is_room()?;
    let opacity = |i: usize| f64::from(table.scene.opacity(table.rows[i] as usize));
    let all = table.rows.len();
    let Some(usual) = quantile_of((0..all).map(opacity), 0.5) else {
        return Err("there are no Gaussians");
    };
    let mut best = [0.0; 2];
    for wall in &shell.walls {
        let faint = wall.behind.iter().filter(|&&i| opacity(i) < usual).count() as f64;
        // Of what is no fainter than the scene, as much is below its median as above.
        let more = 2.0 * faint - wall.behind.len() as f64;
        if more / all as f64 > best[0] {
            best = [more / all as f64, wall.share_behind];
        }
    }
    Ok(Measured {
        measure: Figure::new("faint_behind", best[0], ""),
        more: vec![
            Figure::new("behind", best[1], ""),
            Figure::new("planes", shell.walls.len() as f64, ""),
        ],
        strength: best[0],
        regions: Vec::new(),
    })
}
