//! The picture of an inspection: three level views, histograms, key figures and findings.

use super::table::{plural, thousands};
use super::{Finding, Histogram, Inspection, Severity};
use crate::input::scene_name;
use crate::preview::orthographic::{LevelViews, Viewpoint};
use crate::preview::{BACKGROUND, FAINT_INK, INK, PreviewError, SceneRows, fill, text, write_png};
use scenesplat_scene::GaussianScene;
use scenesplat_scene::picture::RgbPicture;
use std::ffi::OsString;
use std::path::Path;

const WIDTH: u32 = 1600;
const HEIGHT: u32 = 1080;
const EDGE: u32 = 13;
const TITLE_HEIGHT: u32 = 40;
const VIEW: u32 = (WIDTH - 4 * EDGE) / 3;

/// Upper edge of everything below the views.
const LOWER: u32 = TITLE_HEIGHT + VIEW + 2 * EDGE;

/// Histograms stand in two columns of two.
const CHART_WIDTH: u32 = 372;
const CHART_HEIGHT: u32 = 236;

/// Height of a line of findings, and the gap between two of them.
const LINE: u32 = 15;
const BLOCK_GAP: u32 = 5;

/// Left edge of the text block.
const TEXT_LEFT: u32 = 2 * (CHART_WIDTH + EDGE) + 2 * EDGE;

const BAR: [u8; 3] = [112, 164, 212];
const PANEL: [u8; 3] = [40, 43, 50];
const ERROR: [u8; 3] = [255, 116, 104];
const WARNING: [u8; 3] = [250, 190, 88];
const GOOD: [u8; 3] = [136, 210, 138];

/// Draws the sheet: 1600 × 1080 pixels.
///
/// # Errors
/// If `seen` is not of this scene.
pub fn render_sheet(scene: &GaussianScene, seen: &Inspection) -> Result<RgbPicture, PreviewError> {
    if scene.len() != seen.usable {
        let (expected, got) = (seen.usable, scene.len());
        return Err(PreviewError::Rows { field: "coord", expected, got });
    }
    let mut picture = RgbPicture::filled(WIDTH, HEIGHT, BACKGROUND);
    draw_title(&mut picture, seen);
    draw_views(&mut picture, scene, seen);
    let by_gaussians = occupancy(seen);
    let charts = [
        Chart::of(&seen.opacity.histogram, "opacity", ["0", "1"]),
        Chart::of(
            &seen.largest_scale.histogram,
            "largest scale, m (logarithmic)",
            ["1e-7", "1000"],
        ),
        Chart::of(&seen.anisotropy.histogram, "largest / smallest scale", ["1", "1e6"]),
        Chart {
            title: "Gaussians per voxel: 1, 2, 3-4, 5-8, ...",
            ends: ["1", ""],
            counts: &by_gaussians,
            outside: [0, 0],
        },
    ];
    for (i, chart) in (0..).zip(&charts) {
        let left = EDGE + (i % 2) * (CHART_WIDTH + EDGE);
        chart.draw(&mut picture, left, LOWER + (i / 2) * (CHART_HEIGHT + EDGE));
    }
    draw_text(&mut picture, seen);
    Ok(picture)
}

/// Draws the sheet into a PNG file, beside the path first, then renamed. Returns its size.
///
/// # Errors
/// As [`render_sheet`], and if the file cannot be written.
pub fn write_sheet(
    path: &Path,
    scene: &GaussianScene,
    seen: &Inspection,
) -> Result<u64, PreviewError> {
    write_png(path, &render_sheet(scene, seen)?)
}

fn draw_title(picture: &mut RgbPicture, seen: &Inspection) {
    let name = scene_name(Path::new(&seen.path)).map(|n| n.to_string_lossy().into_owned());
    let title = format!(
        "{}: {} Gaussians ({})",
        name.unwrap_or_else(|| seen.path.clone()),
        thousands(seen.gaussians),
        seen.format
    );
    let (verdict, color) = verdict(seen);
    let verdict_left = WIDTH - EDGE - text::width(&verdict, 2);
    text::draw(picture, EDGE, 13, 2, INK, &title, verdict_left - 2 * EDGE);
    text::draw(picture, verdict_left, 13, 2, color, &verdict, WIDTH);
}

fn verdict(seen: &Inspection) -> (String, [u8; 3]) {
    let worst = seen.findings.first().map(|f| f.severity);
    match (seen.findings.len(), worst) {
        (0, _) => ("no findings".to_owned(), GOOD),
        (n, severity) => (plural(n, "finding"), severity.map_or(WARNING, ink_of)),
    }
}

fn ink_of(severity: Severity) -> [u8; 3] {
    match severity {
        Severity::Error => ERROR,
        Severity::Warning => WARNING,
        Severity::Note => FAINT_INK,
    }
}

/// Below this number of Gaussians, their sizes matter to what a view must show.
const FEW: usize = 1000;

fn draw_views(picture: &mut RgbPicture, scene: &GaussianScene, seen: &Inspection) {
    let color: Vec<[u8; 3]> = (0..scene.len()).map(|row| scene.color_u8(row)).collect();
    let sizes = SceneRows::of(scene);
    let rows = sizes.rows(scene, &color);
    let bounds = seen.robust_bounds;
    // Bounds are those of the centers; where there are few, the Gaussians themselves reach far out.
    let reach = if scene.len() < FEW { middle_radius(rows.radius) } else { 0.0 };
    let (low, high) = (bounds.low.map(|v| v - reach), bounds.high.map(|v| v + reach));
    let views = LevelViews::new(rows, seen.up.direction, low, high);
    for (i, from) in (0..).zip([Viewpoint::Front, Viewpoint::Right, Viewpoint::Above]) {
        views.draw(picture, from, EDGE + i * (VIEW + EDGE), TITLE_HEIGHT, VIEW);
    }
}

/// The median of the finite radii; 0 without any.
fn middle_radius(radius: &[f32]) -> f64 {
    let mut finite: Vec<f32> = radius.iter().copied().filter(|r| r.is_finite()).collect();
    finite.sort_by(f32::total_cmp);
    finite.get(finite.len() / 2).map_or(0.0, |&r| f64::from(r))
}

fn occupancy(seen: &Inspection) -> Vec<u64> {
    let mut counts = seen.voxels.as_ref().map_or(Vec::new(), |v| v.by_gaussians.clone());
    // A chart of one bar would look as if something were missing.
    counts.resize(counts.len().max(8), 0);
    counts
}

/// A histogram as bars.
struct Chart<'a> {
    title: &'static str,
    ends: [&'static str; 2],
    counts: &'a [u64],
    /// Rows below the first and above the last bin.
    outside: [u64; 2],
}

impl<'a> Chart<'a> {
    fn of(histogram: &'a Histogram, title: &'static str, ends: [&'static str; 2]) -> Self {
        let outside = [histogram.below, histogram.above];
        Self { title, ends, counts: &histogram.counts, outside }
    }

    fn draw(&self, picture: &mut RgbPicture, left: u32, top: u32) {
        fill(picture, [left, top], [CHART_WIDTH, CHART_HEIGHT], PANEL);
        text::draw(picture, left + 8, top + 8, 1, INK, self.title, CHART_WIDTH - 16);
        let highest = self.counts.iter().copied().max().unwrap_or(0);
        let most = format!("highest bar {}", thousands(highest as usize));
        text::draw(picture, left + 8, top + 22, 1, FAINT_INK, &most, CHART_WIDTH - 16);
        let (inner_left, inner_width) = (left + 8, CHART_WIDTH - 16);
        let (base, room) = (top + CHART_HEIGHT - 24, CHART_HEIGHT - 64);
        fill(picture, [inner_left, base], [inner_width, 1], FAINT_INK);
        let bars = self.counts.len().max(1) as u32;
        let width = inner_width / bars;
        // Centered, as the width is rarely a multiple of the number of bars.
        let first = inner_left + (inner_width - width * bars) / 2;
        for (i, &count) in (0..).zip(self.counts) {
            if count == 0 || highest == 0 {
                continue;
            }
            let share = count as f64 / highest as f64;
            // Even the rarest value is seen.
            let height = ((share * f64::from(room)).round() as u32).clamp(1, room);
            let bar = [width.saturating_sub(1).max(1), height];
            fill(picture, [first + i * width, base - height], bar, BAR);
        }
        text::draw(picture, inner_left, base + 8, 1, FAINT_INK, self.ends[0], inner_width);
        let right = inner_left + inner_width - text::width(self.ends[1], 1);
        text::draw(picture, right, base + 8, 1, FAINT_INK, self.ends[1], inner_width);
        let [below, above] = self.outside;
        if below + above > 0 {
            let note =
                format!("{} below, {} above", thousands(below as usize), thousands(above as usize));
            let middle = left + (CHART_WIDTH - text::width(&note, 1).min(CHART_WIDTH)) / 2;
            text::draw(picture, middle, base + 8, 1, FAINT_INK, &note, CHART_WIDTH);
        }
    }
}

/// Key figures, then findings, then notes, as far as there is room.
fn draw_text(picture: &mut RgbPicture, seen: &Inspection) {
    let width = WIDTH - TEXT_LEFT - EDGE;
    let mut y = LOWER;
    for (what, value) in seen.figures() {
        text::draw(picture, TEXT_LEFT, y, 1, FAINT_INK, what, 100);
        text::draw(picture, TEXT_LEFT + 100, y, 1, INK, &value, width - 100);
        y += 15;
    }
    y += 12;
    let (verdict, color) = verdict(seen);
    text::draw(picture, TEXT_LEFT, y, 2, color, &verdict, width);
    y += 26;
    let letters = (width / 8) as usize - 4;
    let all: Vec<&Finding> = seen.findings.iter().chain(&seen.notes).collect();
    let mut blocks: Vec<Vec<String>> = all.iter().map(|f| f.lines(letters)).collect();
    let room = (HEIGHT - EDGE).saturating_sub(y);
    let height = |lines: &[String]| LINE * lines.len() as u32 + BLOCK_GAP;
    if blocks.iter().map(|b| height(b)).sum::<u32>() > room {
        // The names of all are worth more than the words about a few.
        blocks = all.iter().map(|f| vec![f.head()]).collect();
    }
    for (i, (finding, lines)) in all.iter().zip(&blocks).enumerate() {
        let left_over = all.len() - i;
        let needed = height(lines) + if left_over > 1 { LINE } else { 0 };
        if y + needed > HEIGHT - EDGE {
            let more = format!("... {left_over} more, see the table");
            text::draw(picture, TEXT_LEFT, y, 1, FAINT_INK, &more, width);
            return;
        }
        for line in lines {
            text::draw(picture, TEXT_LEFT, y, 1, ink_of(finding.severity), line, width);
            y += LINE;
        }
        y += BLOCK_GAP;
    }
}

/// What to call the sheet of a scene: `room.ply` → `room.ply.inspect.png`; the description of a folder is named after the folder.
pub fn sheet_name(scene: &Path) -> OsString {
    // A path such as `.` has a name only once it is resolved.
    let full = std::fs::canonicalize(scene).unwrap_or_else(|_| scene.to_owned());
    let mut name = scene_name(&full).unwrap_or("scene".as_ref()).to_owned();
    name.push(".inspect.png");
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sheets_are_named_after_the_scene() {
        for (scene, name) in [
            ("somewhere/room.ply", "room.ply.inspect.png"),
            ("room.spz", "room.spz.inspect.png"),
            ("robot/meta.json", "robot.inspect.png"),
        ] {
            assert_eq!(sheet_name(Path::new(scene)), name);
        }
        let here = tempfile::tempdir().unwrap();
        let folder = here.path().join("scene.v1");
        std::fs::create_dir(&folder).unwrap();
        assert_eq!(sheet_name(&folder), "scene.v1.inspect.png");
        assert_eq!(sheet_name(&folder.join(".")), "scene.v1.inspect.png");
    }
}
