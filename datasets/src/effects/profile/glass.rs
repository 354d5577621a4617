//! Glass and mirrors: a large part of a large plane, in which whatever there is is faint, as a pane is
//! that pictures see through; and behind it things as faint, which it reflected.
//!
//! The area of connected cells of a plane in which nothing is solid and some things are faint, though the surface goes
//! on in nearly all directions, as a share of the plane (the largest of them); and the share of the scene that is fainter than usual behind a plane that bounds it. Reflections become
//! geometry behind a pane, and pictures disagree about it, so that it stays faint; panes that reflect nothing near them
//! leave none. What really stands behind a wall (the other part of a room with a corner) is as opaque as the rest.

use super::planes::Shell;
use super::{Figure, Measured, Outcome};

/// What is behind counts so many times what is in the plane.
const BEHIND: f64 = 4.0;

pub(super) fn measure(shell: &Shell) -> Outcome {
    shell.is_room()?;
    let all = shell.opacity.len();
    let mut best = [0.0f64; 2];
    for wall in &shell.walls {
        let faint = wall.behind.iter().filter(|&&i| shell.opacity[i] < 1.0).count() as f64;
        // Of what is no fainter than the scene, as much is below its median as above.
        let more = (2.0 * faint - wall.behind.len() as f64) / all as f64;
        let pane = wall.gaps.pane_share();
        best = [best[0].max(more), best[1].max(pane)];
    }
    // With another room behind them.
    for (pane, _) in &shell.partitions {
        best[1] = best[1].max(*pane);
    }
    let of_walls = shell.walls.iter().flat_map(|wall| wall.gaps.pane_regions());
    let of_partitions = shell.partitions.iter().flat_map(|(_, balls)| balls.iter().copied());
    let strength = best[1] + BEHIND * best[0];
    Ok(Measured {
        measure: Figure::new("see_through", strength, ""),
        more: vec![
            Figure::new("pane_share", best[1], ""),
            Figure::new("faint_behind", best[0], ""),
            Figure::new("planes", shell.walls.len() as f64, ""),
        ],
        strength,
        regions: of_walls.chain(of_partitions).collect(),
    })
}
