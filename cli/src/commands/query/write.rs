//! What `query` prints and writes.

use super::Args;
use crate::session::Session;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::outputs::{OpenedScene, ResultColumns, write_colored_ply};
use scenesplat::phrases::shortened;
use scenesplat::preview::LegendEntry;
use scenesplat::query::{OTHERS_COLOR, SELECTED_COLOR, Selection};

/// Writes the files of the output folder.
pub fn write(
    args: &Args,
    session: &Session<'_>,
    opened: &OpenedScene,
    remark: &str,
    found: &Selection,
) -> Result<()> {
    let scene = &opened.loaded.scene;
    let Selection { scores, selected } = found;
    let colors = found.colors();
    {
        let _stage = session.receipt.stage("write");
        session.write_rows("scores.npy", opened, scores, 0.0)?;
        let bytes: Vec<u8> = selected.iter().map(|s| *s as u8).collect();
        session.write_rows("selection.npy", opened, &bytes, 0)?;
        let warnings = &session.doubts();
        let columns = ResultColumns { label: Some(selected), score: Some(scores), warnings };
        session.write("query.ply", |path| write_colored_ply(opened, &colors, &columns, path))?;
        session.receipt.add_rows_out(opened.loaded.source_rows());
    }
    let _stage = session.receipt.stage("picture");
    let count = selected.iter().filter(|s| **s == 1).count() as u64;
    let others = selected.len() as u64 - count;
    let entries = [
        LegendEntry { name: shortened(&args.query), color: SELECTED_COLOR, count },
        LegendEntry { name: "everything else".to_owned(), color: OTHERS_COLOR, count: others },
    ];
    let title = format!("\"{}\"{}", shortened(&args.query), remark);
    let up = session.up(opened, &args.inference);
    session.write_preview(scene, &colors, &entries, title, up, args.preview)
}

/// Prints how much was found and where.
pub fn describe(query: &str, found: &Selection, coord: &[[f32; 3]]) {
    let query = shortened(query);
    let best = found.best_score().unwrap_or(f32::NEG_INFINITY);
    let Some(place) = found.place(coord) else {
        print(&format!("{query:?}: nothing selected; the best score is {best:.4}"));
        return;
    };
    let [center, low, high] = [place.center, place.low.map(f64::from), place.high.map(f64::from)]
        .map(|[x, y, z]| format!("({x:.2}, {y:.2}, {z:.2})"));
    print(&format!(
        "{query:?}: {} of {} Gaussians, center {center} m, box {low} to {high} m, best score \
         {best:.4}",
        place.count,
        found.selected.len(),
    ));
}
