//! Safe code cannot make the rasterizer write where it should not: parts that do not belong together
//! are refused before tiles are handed out.
#![forbid(unsafe_code)]

use crate::support::{one, pinhole};
use scenesplat_rasterizer::{
    RasterSettings, Span, TILE, TileVisitor, View, blend, project, tile_lists,
};
use std::panic::{AssertUnwindSafe, catch_unwind};

fn refusal(run: impl FnOnce()) -> String {
    let error = catch_unwind(AssertUnwindSafe(run)).expect_err("parts that lie were believed");
    let text = error.downcast_ref::<String>().cloned();
    text.or_else(|| error.downcast_ref::<&str>().map(|s| (*s).to_owned())).unwrap()
}

struct Nothing;

impl TileVisitor for Nothing {
    type Output = ();
    fn span(&mut self, _: u32, _: u32, _: Span<'_>) {}
    fn finish(self, _: &[f32; TILE * TILE], _: &[u32; TILE * TILE]) {}
}

#[test]
fn lists_belong_to_their_view() {
    let (dot, view) = (one([0.0, 0.0, 2.0], 0.1, 0.5), pinhole([40, 40], 40.0, 0.0));
    let settings = RasterSettings::default();
    let projected = project(&dot, &view, &settings).unwrap();
    let lists = tile_lists(&projected, &view, &settings);
    assert_eq!(blend(&projected, &lists, &view, &settings, |_| Nothing).len(), 9);

    let wide = View { width: 80, ..view };
    let mut short = lists.clone();
    short.offsets.pop();
    let mut uneven = lists.clone();
    uneven.reach.pop();
    let mut columns = lists.clone();
    (columns.columns, columns.rows) = (1, 9);
    for (lists, view) in [(&lists, &wide), (&short, &view), (&uneven, &view), (&columns, &view)] {
        let said = refusal(|| drop(blend(&projected, lists, view, &settings, |_| Nothing)));
        assert!(said.contains("other tiles"), "{said}");
    }
    // Positions that are not in the list, Gaussians that are not there.
    let mut beyond = lists.clone();
    *beyond.offsets.last_mut().unwrap() += 1;
    refusal(|| drop(blend(&projected, &beyond, &view, &settings, |_| Nothing)));
    let mut missing = lists.clone();
    missing.entries.fill(7);
    refusal(|| drop(blend(&projected, &missing, &view, &settings, |_| Nothing)));

    // More tiles than the lists can number.
    let huge = View { width: u32::MAX, height: u32::MAX, ..view };
    let said = refusal(|| drop(tile_lists(&projected, &huge, &settings)));
    assert!(said.contains("tiles"), "{said}");
    // Arrays of another length.
    let mut torn = projected;
    torn.conic.clear();
    refusal(|| drop(tile_lists(&torn, &view, &settings)));
    refusal(|| drop(blend(&torn, &lists, &view, &settings, |_| Nothing)));
}
