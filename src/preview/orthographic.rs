//! Level views of a scene: from the front, from the side, from above.

use super::discs::{Canvas, Disc, Lens};
use super::framing::{Framing, LOWEST_ROOM, Upright};
use super::legend::draw_scale_bar;
use super::rows::{PreviewRows, discs_of, visible_rows};
use super::splats::Drawn;
use super::{FAINT_INK, Theme, text};
use scenesplat_scene::Up;
use scenesplat_scene::picture::RgbPicture;

/// Where a level view looks from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Viewpoint {
    /// Along the second level axis.
    Front,
    /// Against the first level axis.
    Right,
    /// Down.
    Above,
}

/// What is shown reaches this far beyond the box, in units of its longest side.
const MARGIN: f64 = 0.06;

const LABEL_GROUND: [u8; 3] = [38, 40, 47];

impl Viewpoint {
    /// Its name, and the axes of its picture: to the right, down, forward.
    fn about(self) -> (&'static str, [[f64; 3]; 3]) {
        match self {
            Self::Front => ("front", [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
            Self::Right => ("side", [[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]),
            Self::Above => ("from above", [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]),
        }
    }
}

/// A scene, ready for views.
pub(crate) struct LevelViews<'a> {
    rows: PreviewRows<'a>,
    /// The rows that are drawn, and each as a disc.
    kept: Vec<usize>,
    discs: Vec<Disc>,
    upright: Upright,
    framing: Framing,
    low: [f64; 3],
    high: [f64; 3],
}

impl<'a> LevelViews<'a> {
    /// Prepares views of the box from `low` to `high`, in the axes of the scene.
    pub(crate) fn new(rows: PreviewRows<'a>, up: Up, low: [f64; 3], high: [f64; 3]) -> Self {
        let upright = Upright::new(up);
        let ends = [low, high].map(|p| upright.turn_exact(p));
        let (low, high) = (
            [0, 1, 2].map(|a| ends[0][a].min(ends[1][a])),
            [0, 1, 2].map(|a| ends[0][a].max(ends[1][a])),
        );
        let kept = visible_rows(&rows);
        let discs = discs_of(&rows, &kept, upright);
        let framing = Framing::of(&discs, true);
        Self { rows, kept, discs, upright, framing, low, high }
    }

    /// Draws a view into the picture, with a scale bar and the names of its axes.
    pub(crate) fn draw(
        &self,
        picture: &mut RgbPicture,
        from: Viewpoint,
        left: u32,
        top: u32,
        view: u32,
    ) {
        let largest = (0..3).map(|a| self.high[a] - self.low[a]).fold(0.0, f64::max);
        // A single point still has surroundings.
        let reach = if largest > 0.0 { MARGIN * largest } else { 1.0 };
        let mut low = self.low.map(|v| v - reach);
        let mut high = self.high.map(|v| v + reach);
        // The wall or ceiling before the camera is left out.
        let (cut_low, cut_high) = self.framing.cut_sides();
        let is_room = self.high[2] - self.low[2] > LOWEST_ROOM;
        let is_cut = match from {
            _ if !is_room => None,
            Viewpoint::Front => cut_low[1].inspect(|&v| low[1] = low[1].max(v)),
            Viewpoint::Right => {
                self.framing.right_wall(&self.discs).inspect(|&v| high[0] = high[0].min(v))
            }
            Viewpoint::Above => cut_high[2].inspect(|&v| high[2] = high[2].min(v)),
        }
        .is_some();
        let (kept, shown): (Vec<usize>, Vec<Disc>) = (self.kept.iter().zip(&self.discs))
            .filter(|(_, d)| (0..3).all(|a| (low[a]..=high[a]).contains(&f64::from(d.centre[a]))))
            .unzip();
        let (name, axes) = from.about();
        let size = (0..3).map(|a| high[a] - low[a]).fold(0.0, f64::max);
        let middle = [0, 1, 2].map(|a| (self.low[a] + self.high[a]) / 2.0);
        let lens = Lens {
            axes,
            eye: [0, 1, 2].map(|a| middle[a] - 1.5 * size * axes[2][a]),
            scale: 2.0 / (largest + 2.0 * reach),
            is_perspective: false,
            size,
            near: 0.0,
        };
        let mut canvas = Canvas::new(view, Theme::Dark);
        Drawn::of(&self.rows, &kept, shown, size).draw(self.upright, &lens, &mut canvas);
        canvas.copy_to(picture, left, top);
        // What is drawn reaches under bar, axes and name; they stand on a ground of their own.
        super::fill(picture, [left, top + view - 36], [view / 4 + 20, 36], LABEL_GROUND);
        draw_scale_bar(picture, &lens, [left, top], view, Theme::Dark);
        let note = if is_cut { format!("{name}, cut open") } else { name.to_owned() };
        super::fill(picture, [left, top], [text::width(&note, 1) + 16, 22], LABEL_GROUND);
        text::draw(picture, left + 8, top + 8, 1, FAINT_INK, &note, view);
        self.draw_axes(picture, axes, left + view - 60, top + view - 24);
    }

    /// A small cross of two axes with the letters of the scene's own axes.
    fn draw_axes(&self, picture: &mut RgbPicture, axes: [[f64; 3]; 3], left: u32, bottom: u32) {
        const LENGTH: u32 = 30;
        super::fill(picture, [left - 14, bottom - 50], [74, 74], LABEL_GROUND);
        super::fill(picture, [left, bottom], [LENGTH, 2], FAINT_INK);
        super::fill(picture, [left, bottom - LENGTH], [2, LENGTH], FAINT_INK);
        let right = self.upright.axis_name(axes[0]);
        let upwards = self.upright.axis_name(axes[1].map(|v| -v));
        text::draw(picture, left + LENGTH + 4, bottom - 3, 1, FAINT_INK, right, 60);
        text::draw(picture, left - 6, bottom - LENGTH - 12, 1, FAINT_INK, upwards, 60);
    }
}
