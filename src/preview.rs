//! A PNG that shows a scene at a glance: a perspective view, a view from above, and a legend.
//!
//! Scenes are drawn by the renderer, shaded by depth so that things of one colour stand apart; points
//! without shapes, and the sheets of `inspect`, as discs with a depth buffer. Neither is for judging
//! image quality: `scenesplat render` is.

mod depth_picture;
mod discs;
mod framing;
mod inside;
mod look_at;
mod orbit;
pub(crate) mod orthographic;
mod palette;
mod rendered;
mod splats;
pub(crate) mod text;

pub use depth_picture::depth_picture;
pub use inside::inside_views;
pub use look_at::LookAt;
pub use orbit::{Ceiling, Orbit};
pub use palette::{UNLABELLED_COLOR, class_color};
pub use rendered::{depth_steps, rendered_picture, solid_depth};

use discs::{Canvas, Disc, Lens};
use framing::{Framing, Upright};
use scenesplat_scene::picture::{Channels, Picture, RgbPicture, Samples};
use scenesplat_scene::{AtomicFile, GaussianScene, UpAxis, WriteError};
use std::path::Path;

/// Why there is no preview.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PreviewError {
    /// An array does not have one value per Gaussian.
    #[error("preview: {field} has {got} rows, expected {expected}")]
    Rows {
        /// Which array.
        field: &'static str,
        /// Rows expected.
        expected: usize,
        /// Rows found.
        got: usize,
    },
    /// The picture size is out of range.
    #[error("preview: views of {view_size} pixels are not possible, allowed are 64 to 4096")]
    ViewSize {
        /// The size given.
        view_size: u32,
    },
    /// The picture could not be encoded.
    #[error("preview: the picture cannot be encoded as PNG")]
    Encode(#[source] std::io::Error),
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// What to draw, one row per Gaussian.
#[derive(Debug, Clone, Copy)]
pub struct PreviewRows<'a> {
    /// Centres, metres. Rows that are not finite are left out. `[N, 3]`
    pub coord: &'a [[f32; 3]],
    /// Colours: of the scene, or [`class_color`] of its labels. `[N, 3]`
    pub color: &'a [[u8; 3]],
    /// Size, metres: the standard deviation, say the middle one of three. `[N]`
    pub radius: &'a [f32],
    /// Opacity in 0..=1; the faintest Gaussians are left out. `[N]`
    pub opacity: &'a [f32],
    /// Gaussians are rendered with their shapes; without, as discs.
    pub shapes: Option<SplatShapes<'a>>,
}

/// Shapes of Gaussians.
#[derive(Debug, Clone, Copy)]
pub struct SplatShapes<'a> {
    /// `w, x, y, z`, any norm. `[N, 4]`
    pub quat: &'a [[f32; 4]],
    /// Standard deviations, metres. `[N, 3]`
    pub scale: &'a [[f32; 3]],
}

/// Sizes and opacities of a scene, to make [`PreviewRows`] of.
#[derive(Debug, Clone)]
pub struct SceneRows {
    scale: Vec<[f32; 3]>,
    /// The middle one of the three.
    radius: Vec<f32>,
    opacity: Vec<f32>,
}

impl SceneRows {
    /// Of all rows of a scene.
    pub fn of(scene: &GaussianScene) -> Self {
        let scale: Vec<[f32; 3]> = (0..scene.len()).map(|row| scene.scale(row)).collect();
        let middle = |s: &[f32; 3]| {
            let mut s = *s;
            s.sort_by(f32::total_cmp);
            s[1]
        };
        let radius = scale.iter().map(middle).collect();
        let opacity = (0..scene.len()).map(|row| scene.opacity(row)).collect();
        Self { scale, radius, opacity }
    }

    /// `color`: one per Gaussian of the same scene.
    pub fn rows<'a>(&'a self, scene: &'a GaussianScene, color: &'a [[u8; 3]]) -> PreviewRows<'a> {
        let Self { scale, radius, opacity } = self;
        let shapes = Some(SplatShapes { quat: &scene.quat, scale });
        PreviewRows { coord: &scene.coord, color, radius, opacity, shapes }
    }
}

/// One class of the legend.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LegendEntry {
    /// Its name.
    pub name: String,
    /// Its colour in the picture.
    pub color: [u8; 3],
    /// Number of its Gaussians; the legend is sorted by it.
    pub count: u64,
}

/// How to draw.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PreviewSettings {
    /// First line of the picture.
    pub title: String,
    /// Which way is up.
    pub up: UpAxis,
    /// Width and height of each view, pixels.
    pub view_size: u32,
    /// Leaves out the ceiling and the walls between camera and room, where there are such.
    pub open_rooms: bool,
}

impl Default for PreviewSettings {
    fn default() -> Self {
        Self { title: String::new(), up: UpAxis::PlusZ, view_size: 720, open_rooms: true }
    }
}

pub(crate) const BACKGROUND: [u8; 3] = [30, 32, 38];
pub(crate) const INK: [u8; 3] = [232, 232, 228];
pub(crate) const FAINT_INK: [u8; 3] = [150, 152, 158];

/// Most classes that the legend lists.
const LEGEND_ROWS: usize = 24;

const MARGIN: u32 = 12;
const TITLE_HEIGHT: u32 = 40;
const LEGEND_WIDTH: u32 = 340;

/// Draws the picture.
///
/// # Errors
/// If the arrays differ in length or the views are too small or too large.
pub fn render_preview(
    rows: &PreviewRows<'_>,
    legend: &[LegendEntry],
    settings: &PreviewSettings,
) -> Result<RgbPicture, PreviewError> {
    let expected = rows.coord.len();
    let shapes = rows.shapes.map_or((expected, expected), |s| (s.quat.len(), s.scale.len()));
    for (field, got) in [
        ("color", rows.color.len()),
        ("radius", rows.radius.len()),
        ("opacity", rows.opacity.len()),
        ("quat", shapes.0),
        ("scale", shapes.1),
    ] {
        if got != expected {
            return Err(PreviewError::Rows { field, expected, got });
        }
    }
    let view = settings.view_size;
    if !(64..=4096).contains(&view) {
        return Err(PreviewError::ViewSize { view_size: view });
    }

    let upright = Upright::new(settings.up);
    let kept = visible_rows(rows);
    let discs = discs_of(rows, &kept, upright);
    let framing = Framing::of(&discs, settings.open_rooms);
    let (kept, shown): (Vec<usize>, Vec<Disc>) =
        kept.into_iter().zip(discs).filter(|(_, d)| framing.shows(d.centre)).unzip();
    let gaussians = rows.shapes.map(|shapes| {
        let size = framing.top().size;
        splats::gather(rows, &shapes, &kept, size)
    });

    let legend_width = if legend.is_empty() { 0 } else { LEGEND_WIDTH };
    let width = 2 * view + 3 * MARGIN + legend_width;
    let height = TITLE_HEIGHT + view + MARGIN;
    let mut picture = RgbPicture::filled(width, height, BACKGROUND);
    let right = 2 * MARGIN + view;

    for (left, lens) in [(MARGIN, framing.perspective()), (right, framing.top())] {
        let mut canvas = Canvas::new(view);
        // What the renderer refuses, such as far too many large Gaussians, is drawn as discs: a
        // preview is no reason to fail.
        let rendered = gaussians.as_ref().map(|g| splats::draw(g, upright, &lens, &mut canvas));
        if !matches!(rendered, Some(Ok(()))) {
            canvas.draw(&shown, &lens);
        }
        canvas.copy_to(&mut picture, left, TITLE_HEIGHT);
    }

    text::draw(&mut picture, MARGIN, 13, 2, INK, &settings.title, width - 2 * MARGIN);
    let caption = TITLE_HEIGHT + 8;
    let note = if framing.is_cut_open() { "perspective, cut open" } else { "perspective" };
    text::draw(&mut picture, MARGIN + 8, caption, 1, FAINT_INK, note, view);
    text::draw(&mut picture, right + 8, caption, 1, FAINT_INK, "from above", view);
    draw_scale_bar(&mut picture, &framing.top(), [right, TITLE_HEIGHT], view);
    if !legend.is_empty() {
        draw_legend(&mut picture, right + view + MARGIN, TITLE_HEIGHT, legend);
    }
    Ok(picture)
}

/// Draws the picture into a PNG file, beside the path first, then renamed. Returns its size.
///
/// # Errors
/// As [`render_preview`], and if the file cannot be written.
pub fn write_preview(
    path: &Path,
    rows: &PreviewRows<'_>,
    legend: &[LegendEntry],
    settings: &PreviewSettings,
) -> Result<u64, PreviewError> {
    let picture = render_preview(rows, legend, settings)?;
    write_png(path, &picture)
}

/// Writes a picture, which appears when it is complete. Returns the size of the file.
///
/// # Errors
/// If it cannot be encoded or written.
pub fn write_png(path: &Path, picture: &RgbPicture) -> Result<u64, PreviewError> {
    put_png(path, picture.encode_png())
}

/// As [`write_png`], of 16-bit grey values, row by row; `size`: width, height.
///
/// # Errors
/// As [`write_png`].
pub fn write_png16(path: &Path, values: &[u16], size: [u32; 2]) -> Result<u64, PreviewError> {
    let (expected, got) = (size[0] as usize * size[1] as usize, values.len());
    let picture = Picture::new(size[0], size[1], Channels::Gray, Samples::Sixteen(values.to_vec()))
        .ok_or(PreviewError::Rows { field: "depth", expected, got })?;
    put_png(path, picture.encode_png())
}

fn put_png(path: &Path, png: std::io::Result<Vec<u8>>) -> Result<u64, PreviewError> {
    let png = png.map_err(PreviewError::Encode)?;
    AtomicFile::write(path, &png)?;
    Ok(png.len() as u64)
}

/// Rows to draw: not the faintest, which hide the rest in captures with much haze.
fn visible_rows(rows: &PreviewRows<'_>) -> Vec<usize> {
    let mut opacities: Vec<f32> = rows.opacity.iter().copied().filter(|o| o.is_finite()).collect();
    if opacities.is_empty() {
        return Vec::new();
    }
    let middle = opacities.len() / 2;
    let median = *opacities.select_nth_unstable_by(middle, f32::total_cmp).1;
    // A badly converged capture may be faint throughout; half of it is drawn in any case.
    let least = median.min(0.25);
    (0..rows.coord.len())
        .filter(|&i| rows.opacity[i] >= least && rows.coord[i].iter().all(|v| v.is_finite()))
        .collect()
}

/// Rows as discs in the upright frame.
fn discs_of(rows: &PreviewRows<'_>, kept: &[usize], upright: Upright) -> Vec<Disc> {
    let disc = |&i: &usize| Disc {
        centre: upright.turn(rows.coord[i]),
        radius: if rows.radius[i].is_finite() { rows.radius[i].max(0.0) } else { 0.0 },
        color: rows.color[i],
    };
    kept.iter().map(disc).collect()
}

/// Both.
fn visible_discs(rows: &PreviewRows<'_>, upright: Upright) -> Vec<Disc> {
    discs_of(rows, &visible_rows(rows), upright)
}

/// A bar of a round number of metres in the lower left corner of a view.
fn draw_scale_bar(picture: &mut RgbPicture, lens: &Lens, [left, top]: [u32; 2], view: u32) {
    let Some(metres_per_pixel) = lens.metres_per_pixel(view) else { return };
    let longest = metres_per_pixel * f64::from(view) / 4.0;
    let power = 10.0_f64.powf(longest.log10().floor());
    let length = [5.0, 2.0, 1.0].map(|k| k * power).into_iter().find(|&l| l <= longest);
    let Some(length) = length.filter(|l| l.is_finite() && *l > 0.0) else { return };
    let pixels = (length / metres_per_pixel).round() as u32;
    let (x, y) = (left + 10, top + view - 14);
    fill(picture, [x, y], [pixels, 3], INK);
    let label = if length >= 1.0 {
        format!("{length} m")
    } else if length >= 0.01 {
        format!("{:.0} cm", length * 100.0)
    } else {
        format!("{} mm", length * 1000.0)
    };
    text::draw(picture, x, y - 12, 1, INK, &label, view);
}

fn draw_legend(picture: &mut RgbPicture, left: u32, top: u32, legend: &[LegendEntry]) {
    let mut sorted: Vec<&LegendEntry> = legend.iter().collect();
    sorted.sort_by(|a, b| b.count.cmp(&a.count).then_with(|| a.name.cmp(&b.name)));
    let room = (picture.height().saturating_sub(top + MARGIN)) / 22;
    // The last line is kept for the number of classes left out.
    let lines = if sorted.len() > LEGEND_ROWS.min(room as usize) {
        LEGEND_ROWS.min(room.saturating_sub(1) as usize)
    } else {
        sorted.len()
    };
    let right = left + LEGEND_WIDTH - MARGIN;
    let mut y = top;
    for entry in &sorted[..lines] {
        fill(picture, [left, y], [16, 16], entry.color);
        let count = thousands(entry.count);
        let count_left = right - text::width(&count, 1);
        text::draw(picture, count_left, y + 4, 1, FAINT_INK, &count, LEGEND_WIDTH);
        // Long names are set in small letters before they are cut.
        let space = count_left.saturating_sub(left + 32);
        let size = if text::width(&entry.name, 2) <= space { 2 } else { 1 };
        let drop = if size == 2 { 0 } else { 4 };
        text::draw(picture, left + 24, y + drop, size, INK, &entry.name, space);
        y += 22;
    }
    if sorted.len() > lines {
        let more = format!("... {} more", sorted.len() - lines);
        text::draw(picture, left + 24, y + 4, 1, FAINT_INK, &more, LEGEND_WIDTH);
    }
}

/// Fills a rectangle, as far as it is inside.
pub(crate) fn fill(
    picture: &mut RgbPicture,
    [left, top]: [u32; 2],
    [width, height]: [u32; 2],
    color: [u8; 3],
) {
    for y in top..(top + height).min(picture.height()) {
        for x in left..(left + width).min(picture.width()) {
            picture.set(x, y, color);
        }
    }
}

/// A whole number with a space between thousands.
pub(crate) fn thousands(value: u64) -> String {
    let digits = value.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The scene as discs and rendered.
    fn both(coord: &[[f32; 3]], settings: &PreviewSettings) -> [RgbPicture; 2] {
        let n = coord.len();
        let rows = PreviewRows {
            coord,
            color: &vec![[200, 40, 40]; n],
            radius: &vec![0.02; n],
            opacity: &vec![0.9; n],
            shapes: None,
        };
        let discs = render_preview(&rows, &[], settings).unwrap();
        let shapes =
            SplatShapes { quat: &vec![[1.0, 0.0, 0.0, 0.0]; n], scale: &vec![[0.02; 3]; n] };
        let rows = PreviewRows { shapes: Some(shapes), ..rows };
        let splats = render_preview(&rows, &[], settings).unwrap();
        [discs, splats]
    }

    /// As discs, after a look that the rendered picture shows the same.
    fn render(coord: &[[f32; 3]], settings: &PreviewSettings) -> RgbPicture {
        let [discs, splats] = both(coord, settings);
        let counts = red(&discs).into_iter().zip(red(&splats));
        assert!(counts.clone().all(|(d, s)| s >= d), "{counts:?}");
        for (d, s) in middle(&discs).into_iter().zip(middle(&splats)) {
            assert!((d - s).abs() < 2.5, "the middle is at {d} and at {s}");
        }
        discs
    }

    /// First and last column and row of the reddish pixels of each view.
    fn bounds(picture: &RgbPicture) -> [[f64; 4]; 2] {
        let mut bounds = [[f64::MAX, f64::MAX, 0.0, 0.0]; 2];
        for (x, y, _) in picture.enumerate().filter(|p| is_red(p.2)) {
            let b = &mut bounds[usize::from(x > MARGIN + 96)];
            let (x, y) = (f64::from(x), f64::from(y));
            *b = [b[0].min(x), b[1].min(y), b[2].max(x), b[3].max(y)];
        }
        bounds
    }

    #[test]
    fn rendered_views_are_those_of_discs() {
        use UpAxis::{MinusX, MinusY, MinusZ, PlusX, PlusY, PlusZ};
        // Three arms of different lengths: mirrored, turned or scaled it would be elsewhere.
        let arm = |axis: usize, count: u16| {
            (0..count).map(move |i| {
                let mut p = [0.0; 3];
                p[axis] = 0.01 * f32::from(i);
                p
            })
        };
        let coord: Vec<[f32; 3]> = arm(0, 300).chain(arm(1, 200)).chain(arm(2, 120)).collect();
        for up in [PlusX, MinusX, PlusY, MinusY, PlusZ, MinusZ] {
            let [discs, splats] = both(&coord, &PreviewSettings { up, ..small() });
            for (d, s) in bounds(&discs).into_iter().zip(bounds(&splats)) {
                let off = d.iter().zip(s).map(|(d, s)| (d - s).abs()).fold(0.0, f64::max);
                assert!(off <= 4.0, "{up:?}: {d:?} as discs, {s:?} rendered");
            }
            let away: f64 = middle(&discs)
                .iter()
                .zip(middle(&splats))
                .map(|(d, s)| (d - s).abs())
                .fold(0.0, f64::max);
            assert!(away < 5.0, "{up:?}: {away}");
        }
    }

    #[test]
    fn a_single_needle_is_rendered() {
        let shapes =
            Some(SplatShapes { quat: &[[1.0, 0.0, 0.0, 0.0]], scale: &[[0.01, 0.01, 0.1]] });
        let rows = PreviewRows {
            coord: &[[1.0, 2.0, 3.0]],
            color: &[[200, 40, 40]],
            radius: &[0.01],
            opacity: &[0.9],
            shapes,
        };
        let counts = red(&render_preview(&rows, &[], &small()).unwrap());
        assert!(counts[0] > 50 && counts[1] > 50, "{counts:?}");
    }

    /// Mean place of the reddish pixels of each view, x and y.
    fn middle(picture: &RgbPicture) -> [f64; 4] {
        let (mut sums, counts) = ([0.0; 4], red(picture));
        for (x, y, pixel) in picture.enumerate() {
            let view = usize::from(x > MARGIN + 96);
            if is_red(pixel) {
                sums[2 * view] += f64::from(x) / counts[view] as f64;
                sums[2 * view + 1] += f64::from(y) / counts[view] as f64;
            }
        }
        sums
    }

    fn is_red(pixel: [u8; 3]) -> bool {
        let [r, g, b] = pixel.map(i32::from);
        r > g + 30 && r > b + 30
    }

    fn small() -> PreviewSettings {
        PreviewSettings { view_size: 96, ..PreviewSettings::default() }
    }

    /// Pixels of each view that a reddish disc covers.
    fn red(picture: &RgbPicture) -> [usize; 2] {
        let mut counts = [0; 2];
        for (x, _, pixel) in picture.enumerate() {
            if is_red(pixel) {
                counts[usize::from(x > MARGIN + 96)] += 1;
            }
        }
        counts
    }

    #[test]
    fn nothing_one_and_broken_gaussians() {
        assert_eq!(red(&render(&[], &small())), [0, 0]);
        let one = red(&render(&[[3.0, -2.0, 7.0]], &small()));
        assert!(one[0] > 50 && one[1] > 50, "{one:?}");
        let broken = [[f32::NAN, 0.0, 0.0], [0.0, f32::INFINITY, 0.0], [3.0, -2.0, 7.0]];
        assert_eq!(red(&render(&broken, &small())), one);
        assert_eq!(red(&render(&broken[..2], &small())), [0, 0]);
        let same = red(&render(&[[3.0, -2.0, 7.0]; 99], &small()));
        assert_eq!(same, one);
    }

    fn blob() -> Vec<[f32; 3]> {
        (0..1000_u16)
            .map(|i| {
                let (x, y, z) = (i % 10, i / 10 % 10, i / 100);
                [f32::from(x) * 0.1, f32::from(y) * 0.1, f32::from(z) * 0.1]
            })
            .collect()
    }

    #[test]
    fn an_outlier_does_not_shrink_the_scene() {
        let mut coord = blob();
        let before = red(&render(&coord, &small()));
        coord.push([1000.0, 1000.0, 0.0]);
        coord.push([f32::MAX, f32::MIN, 0.0]);
        let after = red(&render(&coord, &small()));
        assert!(after[0] * 10 > before[0] * 9 && after[1] * 10 > before[1] * 9);
    }

    #[test]
    fn every_up_axis_and_bad_radii() {
        use UpAxis::{MinusX, MinusY, MinusZ, PlusX, PlusY, PlusZ};
        for up in [PlusX, MinusX, PlusY, MinusY, PlusZ, MinusZ] {
            let counts = red(&render(&blob(), &PreviewSettings { up, ..small() }));
            assert!(counts[0] > 500 && counts[1] > 500, "{up:?} {counts:?}");
        }
        let coord = blob();
        let mut radius = vec![f32::NAN; coord.len()];
        radius[1] = f32::INFINITY;
        radius[2] = f32::MAX;
        radius[3] = -1.0;
        let rows = PreviewRows {
            coord: &coord,
            color: &vec![[255; 3]; coord.len()],
            radius: &radius,
            opacity: &vec![f32::NAN; coord.len()],
            shapes: None,
        };
        render_preview(&rows, &[], &small()).unwrap();
        let rows = PreviewRows { opacity: &vec![0.01; coord.len()], ..rows };
        render_preview(&rows, &[], &small()).unwrap();
        // Shapes that cannot be drawn are left out.
        let (mut quat, mut scale) = (vec![[0.0; 4]; coord.len()], vec![[0.02; 3]; coord.len()]);
        (quat[0], quat[1]) = ([f32::NAN; 4], [1.0, 0.0, 0.0, 0.0]);
        (scale[1], scale[2]) = ([f32::INFINITY; 3], [f32::MAX; 3]);
        let shapes = Some(SplatShapes { quat: &quat, scale: &scale });
        let color = &vec![[200, 40, 40]; coord.len()];
        let opacity = &vec![0.5; coord.len()];
        let rows = PreviewRows { color, opacity, shapes, ..rows };
        let left_out = red(&render_preview(&rows, &[], &small()).unwrap());
        let round = vec![[1.0, 0.0, 0.0, 0.0]; coord.len()];
        let whole = SplatShapes { quat: &round, scale: &vec![[0.02; 3]; coord.len()] };
        let rows = PreviewRows { shapes: Some(whole), ..rows };
        let drawn = red(&render_preview(&rows, &[], &small()).unwrap());
        assert!(left_out == [0, 0] && drawn[0] > 100, "{left_out:?} {drawn:?}");
    }

    #[test]
    fn threads_do_not_change_the_picture() {
        let coord = blob();
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| both(&coord, &small()))
        };
        assert!(on(1) == on(3));
    }

    #[test]
    fn long_legends_and_titles_fit() {
        let legend: Vec<LegendEntry> = (0..200)
            .map(|i| LegendEntry {
                name: format!("a class with quite a long name, number {i} Ä→"),
                color: class_color(i),
                count: if i == 0 { u64::MAX } else { i as u64 },
            })
            .collect();
        let rows = PreviewRows { coord: &[], color: &[], radius: &[], opacity: &[], shapes: None };
        for view_size in [64, 200] {
            let settings = PreviewSettings { title: "title ".repeat(500), view_size, ..small() };
            for classes in [1, 24, 25, 200] {
                render_preview(&rows, &legend[..classes], &settings).unwrap();
            }
        }
        let settings = PreviewSettings { view_size: 5, ..small() };
        let error = render_preview(&rows, &legend, &settings);
        assert!(matches!(error, Err(PreviewError::ViewSize { view_size: 5 })));
        let shapes = Some(SplatShapes { quat: &[], scale: &[[1.0; 3]] });
        let error = render_preview(&PreviewRows { shapes, ..rows }, &legend, &small());
        assert!(matches!(error, Err(PreviewError::Rows { field: "scale", .. })));
        let rows = PreviewRows { radius: &[1.0], ..rows };
        let error = render_preview(&rows, &legend, &small());
        assert!(matches!(error, Err(PreviewError::Rows { field: "radius", .. })));
    }

    #[test]
    fn files_are_renamed_into_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("room.png");
        let rows = PreviewRows {
            coord: &[[0.0; 3]],
            color: &[[255, 0, 0]],
            radius: &[0.1],
            opacity: &[1.0],
            shapes: None,
        };
        let bytes = write_preview(&path, &rows, &[], &small()).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().len(), bytes);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert_eq!(std::fs::read(&path).unwrap()[1..4], *b"PNG");
        let error = write_preview(&folder.path().join("no/room.png"), &rows, &[], &small());
        assert!(matches!(error, Err(PreviewError::Write { .. })));
    }
}
