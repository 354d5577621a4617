//! A PNG that shows a scene at a glance: a perspective view, a view from above, and a legend.
//!
//! Scenes are drawn by the renderer, shaded by depth so that things of one color stand apart; points without shapes as
//! discs with a depth buffer. Neither is for judging image quality: `scenesplat render` is.

mod depth_picture;
mod discs;
mod framing;
mod inside;
mod legend;
mod orbit;
pub(crate) mod orthographic;
mod palette;
mod png;
mod rendered;
mod rows;
mod splats;
pub(crate) mod text;
mod theme;
mod walls;

pub use depth_picture::depth_picture;
pub use inside::inside_views;
pub use legend::LegendEntry;
pub use orbit::{Ceiling, Orbit};
pub use palette::{UNLABELLED_COLOR, class_color};
pub use png::{write_png, write_png16};
pub use rendered::{depth_steps, picture_of, rendered_picture, solid_depth};
pub use rows::{PreviewRows, SceneRows, SplatShapes};
pub use theme::Theme;

pub(crate) use legend::{blend, fill, thousands};

use discs::{Canvas, Disc};
use framing::{Framing, Upright};
use legend::{LEGEND_WIDTH, draw_legend, draw_scale_bar};
use rows::{discs_of, visible_rows};
pub use scenesplat_scene::LookAt;
use scenesplat_scene::picture::RgbPicture;
use scenesplat_scene::{Up, WriteError};
use splats::Drawn;
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

/// How to draw.
#[derive(Debug, Clone, PartialEq)]
pub struct PreviewSettings {
    /// First line of the picture.
    pub title: String,
    /// What a viewer must know, a line each below the title; of many the first and how many more.
    pub warnings: Vec<String>,
    /// Which way is up.
    pub up: Up,
    /// Width and height of each view, pixels.
    pub view_size: u32,
    /// Colors around the scene.
    pub theme: Theme,
    /// Leaves out the ceiling and the walls between camera and room, where there are such.
    pub open_rooms: bool,
}

impl Default for PreviewSettings {
    fn default() -> Self {
        Self {
            title: String::new(),
            warnings: Vec::new(),
            up: Up::PLUS_Z,
            view_size: 720,
            theme: Theme::default(),
            open_rooms: true,
        }
    }
}

pub(crate) const BACKGROUND: [u8; 3] = [30, 32, 38];
pub(crate) const INK: [u8; 3] = [232, 232, 228];
pub(crate) const FAINT_INK: [u8; 3] = [150, 152, 158];

const MARGIN: u32 = 12;
const TITLE_HEIGHT: u32 = 40;
const WARNING_HEIGHT: u32 = 18;
/// Warnings that have a line each.
const MOST_WARNINGS: usize = 3;

/// Draws the picture.
///
/// # Errors
/// If the arrays differ in length or the views are too small or too large.
pub fn render_preview(
    rows: &PreviewRows<'_>,
    legend: &[LegendEntry],
    settings: &PreviewSettings,
) -> Result<RgbPicture, PreviewError> {
    check(rows, settings)?;
    let (view, theme) = (settings.view_size, settings.theme);
    let upright = Upright::new(settings.up);
    let kept = visible_rows(rows);
    let discs = discs_of(rows, &kept, upright);
    let framing = Framing::of(&discs, settings.open_rooms);
    let (kept, shown): (Vec<usize>, Vec<Disc>) =
        kept.into_iter().zip(discs).filter(|(_, d)| framing.shows(d.centre)).unzip();

    let drawn = Drawn::of(rows, &kept, shown, framing.top().size);

    let legend_width = if legend.is_empty() { 0 } else { LEGEND_WIDTH };
    let width = 2 * view + 3 * MARGIN + legend_width;
    let warnings = warning_lines(&settings.warnings);
    let top = TITLE_HEIGHT + WARNING_HEIGHT * warnings.len() as u32;
    let height = top + view + MARGIN;
    let mut picture = RgbPicture::filled(width, height, theme.ground());
    let right = 2 * MARGIN + view;

    for (left, lens) in [(MARGIN, framing.perspective()), (right, framing.top())] {
        let mut canvas = Canvas::new(view, theme);
        drawn.draw(upright, &lens, &mut canvas);
        canvas.copy_to(&mut picture, left, top);
    }

    text::draw(&mut picture, MARGIN, 13, 2, theme.ink(), &settings.title, width - 2 * MARGIN);
    for (line, at) in warnings.iter().zip((TITLE_HEIGHT..).step_by(WARNING_HEIGHT as usize)) {
        text::draw(&mut picture, MARGIN, at, 1, theme.warning_ink(), line, width - 2 * MARGIN);
    }
    let caption = top + 8;
    let note = if framing.is_cut_open() { "perspective, cut open" } else { "perspective" };
    for (left, note) in [(MARGIN, note), (right, "from above")] {
        if let Some(plate) = theme.plate() {
            let width = (text::width(note, 1) + 16).min(view);
            fill(&mut picture, [left, top], [width, 20], plate);
        }
        text::draw(&mut picture, left + 8, caption, 1, theme.faint_ink(), note, view);
    }
    draw_scale_bar(&mut picture, &framing.top(), [right, top], view, theme);
    if !legend.is_empty() {
        draw_legend(&mut picture, right + view + MARGIN, top, legend, theme);
    }
    Ok(picture)
}

fn warning_lines(warnings: &[String]) -> Vec<String> {
    let cut = warnings.len() > MOST_WARNINGS;
    let shown = if cut { MOST_WARNINGS - 1 } else { warnings.len() };
    let more = cut.then(|| format!("and {} more warnings", warnings.len() - shown));
    warnings[..shown].iter().map(|text| format!("! {text}")).chain(more).collect()
}

fn check(rows: &PreviewRows<'_>, settings: &PreviewSettings) -> Result<(), PreviewError> {
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
    let view_size = settings.view_size;
    if !(64..=4096).contains(&view_size) {
        return Err(PreviewError::ViewSize { view_size });
    }
    Ok(())
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
        let shapes = SplatShapes {
            quat: &vec![[1.0, 0.0, 0.0, 0.0]; n],
            scale: &vec![[0.02; 3]; n],
            antialiased: false,
        };
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
        // Three arms of different lengths: mirrored, turned or scaled it would be elsewhere.
        let arm = |axis: usize, count: u16| {
            (0..count).map(move |i| {
                let mut p = [0.0; 3];
                p[axis] = 0.01 * f32::from(i);
                p
            })
        };
        let coord: Vec<[f32; 3]> = arm(0, 300).chain(arm(1, 200)).chain(arm(2, 120)).collect();
        for up in Up::AXES {
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
        let shapes = Some(SplatShapes {
            quat: &[[1.0, 0.0, 0.0, 0.0]],
            scale: &[[0.01, 0.01, 0.1]],
            antialiased: false,
        });
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
        for up in Up::AXES {
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
        let shapes = Some(SplatShapes { quat: &quat, scale: &scale, antialiased: false });
        let color = &vec![[200, 40, 40]; coord.len()];
        let opacity = &vec![0.5; coord.len()];
        let rows = PreviewRows { color, opacity, shapes, ..rows };
        let left_out = red(&render_preview(&rows, &[], &small()).unwrap());
        let round = vec![[1.0, 0.0, 0.0, 0.0]; coord.len()];
        let whole =
            SplatShapes { quat: &round, scale: &vec![[0.02; 3]; coord.len()], antialiased: false };
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
    fn a_light_picture_is_white_with_dark_letters() {
        let rows = PreviewRows { coord: &[], color: &[], radius: &[], opacity: &[], shapes: None };
        let legend = [LegendEntry { name: "chair".into(), color: [250, 0, 0], count: 7 }];
        let draw = |theme| {
            let (title, warnings) = ("a scene".to_owned(), vec!["a warning".to_owned()]);
            let settings = PreviewSettings { theme, title, warnings, ..small() };
            render_preview(&rows, &legend, &settings).unwrap()
        };
        let (dark, light) = (draw(Theme::Dark), draw(Theme::Light));
        assert_eq!((dark.width(), dark.height()), (light.width(), light.height()));
        let share = |picture: &RgbPicture, is: fn([u8; 3]) -> bool| {
            let all = picture.enumerate().count() as f64;
            picture.enumerate().filter(|(_, _, pixel)| is(*pixel)).count() as f64 / all
        };
        let (is_light, is_dark) =
            (|pixel: [u8; 3]| pixel[1] > 200, |pixel: [u8; 3]| pixel[1] < 110);
        // Ground and views against letters and the color of the class.
        assert!(share(&light, is_light) > 0.9 && share(&dark, is_dark) > 0.9);
        assert!(share(&light, is_dark) > 0.005 && share(&dark, is_light) > 0.002);
    }

    #[test]
    fn warnings_are_lines_above_the_views() {
        let rows = PreviewRows { coord: &[], color: &[], radius: &[], opacity: &[], shapes: None };
        let draw = |count: usize| {
            let warnings = (0..count).map(|i| format!("warning {i} ").repeat(40)).collect();
            render_preview(&rows, &[], &PreviewSettings { warnings, ..small() }).unwrap()
        };
        let plain = draw(0);
        for (count, lines) in [(1, 1), (3, 3), (4, 3), (90, 3)] {
            let picture = draw(count);
            assert_eq!(picture.height(), plain.height() + lines * WARNING_HEIGHT, "{count}");
            let orange = |y: u32| {
                let is = |[r, g, b]: [u8; 3]| r > 120 && r > g && g > b;
                (0..picture.width()).any(|x| is(picture.get(x, y).unwrap()))
            };
            let inked = |line: u32| {
                (0..WARNING_HEIGHT).any(|y| orange(TITLE_HEIGHT + line * WARNING_HEIGHT + y))
            };
            assert!((0..lines).all(inked) && !inked(lines), "{count}");
        }
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
            let title = "title ".repeat(500);
            let warnings = vec![title.clone()];
            let settings = PreviewSettings { title, warnings, view_size, ..small() };
            for classes in [1, 24, 25, 200] {
                render_preview(&rows, &legend[..classes], &settings).unwrap();
            }
        }
        let settings = PreviewSettings { view_size: 5, ..small() };
        let error = render_preview(&rows, &legend, &settings);
        assert!(matches!(error, Err(PreviewError::ViewSize { view_size: 5 })));
        let shapes = Some(SplatShapes { quat: &[], scale: &[[1.0; 3]], antialiased: false });
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
