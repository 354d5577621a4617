//! Scenes without some of their objects, or with nothing else.

use super::Args;
use crate::commands::labelled::Labelled;
use crate::commands::meant::Asking;
use crate::error::refuse;
use crate::frame::Frame;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::objects::holes::{Hole, Holes, holes};
use scenesplat::outputs::write_scene_preview;
use scenesplat::phrases::shortened;
use scenesplat::preview::{LegendEntry, PreviewSettings};
use scenesplat::scene::formats::inria_ply::write_inria_ply_with;
use scenesplat::scene::{GaussianScene, WriteOptions};

/// Color of what is open, and of what was closed, in edited.png.
const OPEN_COLOR: [u8; 3] = [255, 0, 200];
const CLOSED_COLOR: [u8; 3] = [60, 200, 255];
/// Logit of the opacity of what marks an open cell.
const SOLID: f32 = 6.0;

/// An edit, and what it needs to know of the scene.
pub(super) struct Edit<'a> {
    pub(super) args: &'a Args,
    pub(super) asking: &'a Asking<'a>,
    pub(super) labelled: &'a Labelled,
    pub(super) frame: Frame,
}

impl Edit<'_> {
    /// Writes edited.ply and, where objects are removed, edited.png; prints what is open. `scene`: with its objects in it.
    pub(super) fn write(&self, scene: &GaussianScene) -> Result<()> {
        let keeps = !self.args.keep.is_empty();
        let chosen = self.chosen(scene.len())?;
        let rows: Vec<usize> = (0..scene.len()).filter(|&row| chosen[row] == keeps).collect();
        if rows.is_empty() {
            let flag = if keeps { "--keep" } else { "--remove" };
            refuse!("{flag}: nothing would be left of the scene");
        }
        let session = self.asking.session;
        let mut found = Holes::default();
        if !keeps {
            found = holes(&self.labelled.input(self.frame), self.asking.found, &chosen)?;
        }
        let mut warnings = session.doubts();
        let mut text = format!("edited.ply: {} of {} Gaussians", rows.len(), scene.len());
        if self.args.fill {
            let copies = found.patches.len();
            text += &format!(", and {copies} copies that close what was open");
            let about = "are copies of what is beside them, and close what removed objects hid";
            warnings.extend((copies > 0).then(|| format!("the last {copies} Gaussians {about}")));
        }
        print(&text);
        self.tell(&found);
        let left = if self.args.fill {
            patched(scene, &rows, &found)?
        } else {
            scene.select_rows(&rows)?
        };
        let options = WriteOptions { warnings, ..WriteOptions::default() };
        session.write("edited.ply", |path| write_inria_ply_with(&left, &[], &options, path))?;
        if keeps {
            return Ok(());
        }
        self.picture(&left, rows.len(), &found.holes)
    }

    /// Whether each Gaussian is of an object that is meant.
    fn chosen(&self, len: usize) -> Result<Vec<bool>> {
        let mut chosen = vec![false; len];
        for phrase in self.args.remove.iter().chain(&self.args.keep) {
            let places = self.asking.meant(phrase)?;
            if places.is_empty() {
                let phrase = shortened(phrase);
                print(&format!("{phrase:?}: none; {}", self.asking.there_are()));
            }
            for place in places {
                let rows = &self.asking.found.objects[place].rows;
                rows.iter().for_each(|&row| chosen[row as usize] = true);
            }
        }
        Ok(chosen)
    }

    /// Says what is open, and what of it stays so.
    fn tell(&self, Holes { holes, uneven, .. }: &Holes) {
        if !uneven.is_empty() {
            let ids: Vec<String> = uneven.iter().map(ToString::to_string).collect();
            let ids = ids.join(", ");
            print(&format!(
                "parts of {ids} are not flat, or too far away: no hole is looked for in these"
            ));
        }
        let area = |of: &dyn Fn(&Hole) -> f64| -> f64 { holes.iter().map(of).sum() };
        let [all, closed] = [area(&Hole::area), area(&Hole::closed_area)];
        if holes.is_empty() {
            return;
        }
        let each: Vec<String> = holes
            .iter()
            .map(|hole| format!("{} {} {:.2} m2", hole.class, hole.id, hole.area()))
            .collect();
        let what = match self.args.fill {
            true => format!("{closed:.2} of {all:.2} m2 are closed"),
            false => format!("{all:.2} m2 are open behind them (--fill closes {closed:.2})"),
        };
        let text = format!("{what}: {}", each.join(", "));
        print(&text);
        self.asking.session.receipt.setting("holes", format!("{all:.4} m2"), &text);
    }

    /// What is left, with what is open, and what was closed, in colors of their own.
    fn picture(&self, left: &GaussianScene, own: usize, holes: &[Hole]) -> Result<()> {
        let session = self.asking.session;
        let marks = holes.iter().flat_map(|hole| {
            let closed: &[[f64; 3]] = if self.args.fill { &[] } else { &hole.closed };
            closed.iter().chain(&hole.open).map(|cell| (*cell, hole.cell))
        });
        let marks: Vec<([f64; 3], f64)> = marks.collect();
        let rows: Vec<usize> = (0..left.len()).chain(marks.iter().map(|_| 0)).collect();
        let mut shown = left.select_rows(&rows)?;
        for (row, (middle, cell)) in (left.len()..).zip(&marks) {
            shown.coord[row] = middle.map(|v| v as f32);
            let size = (0.5 * cell / self.frame.metres_per_unit).ln() as f32;
            if let Some(scale) = shown.log_scale.get_mut(row) {
                *scale = [size; 3];
            }
            if let Some(opacity) = shown.opacity_logit.get_mut(row) {
                *opacity = SOLID;
            }
        }
        let color = |row: usize| match row {
            row if row >= left.len() => OPEN_COLOR,
            row if row >= own => CLOSED_COLOR,
            row => shown.color_u8(row),
        };
        let colors: Vec<[u8; 3]> = (0..shown.len()).map(color).collect();
        let entry = |name: &str, color, count: usize| LegendEntry {
            name: name.to_owned(),
            color,
            count: count as u64,
        };
        let legend: Vec<LegendEntry> = [
            entry("open", OPEN_COLOR, marks.len()),
            entry("closed by copies", CLOSED_COLOR, left.len() - own),
        ]
        .into_iter()
        .filter(|entry| entry.count > 0)
        .collect();
        let settings = PreviewSettings {
            title: format!("without {}", self.args.remove.join(", ")),
            warnings: session.doubts(),
            up: self.frame.up,
            ..PreviewSettings::default()
        };
        session.write("edited.png", |path| {
            write_scene_preview(&shown, &colors, &legend, &settings, path)
        })
    }
}

/// What is left, and after it the copies.
fn patched(scene: &GaussianScene, rows: &[usize], found: &Holes) -> Result<GaussianScene> {
    let copied = found.patches.iter().map(|patch| patch.row);
    let mut out = scene.select_rows(&rows.iter().copied().chain(copied).collect::<Vec<_>>())?;
    for (row, patch) in (rows.len()..).zip(&found.patches) {
        out.coord[row] = patch.coord;
    }
    Ok(out)
}
