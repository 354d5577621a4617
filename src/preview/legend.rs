//! What stands beside the views: the classes with their colors, and a bar of a known length.

use super::discs::Lens;
use super::{MARGIN, Theme, text};
use scenesplat_objects::is_building;
use scenesplat_scene::picture::RgbPicture;
use std::cmp::Reverse;

/// One class of the legend.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LegendEntry {
    /// Its name.
    pub name: String,
    /// Its color in the picture.
    pub color: [u8; 3],
    /// Number of its Gaussians; the legend is sorted by it, parts of the building last.
    pub count: u64,
}

pub(super) const LEGEND_WIDTH: u32 = 340;

/// Most classes that the legend lists.
const LEGEND_ROWS: usize = 24;

/// A bar of a round number of meters in the lower left corner of a view.
pub(super) fn draw_scale_bar(
    picture: &mut RgbPicture,
    lens: &Lens,
    [left, top]: [u32; 2],
    view: u32,
    theme: Theme,
) {
    let Some(metres_per_pixel) = lens.metres_per_pixel(view) else { return };
    let longest = metres_per_pixel * f64::from(view) / 4.0;
    let power = 10.0_f64.powf(longest.log10().floor());
    let length = [5.0, 2.0, 1.0].map(|k| k * power).into_iter().find(|&l| l <= longest);
    let Some(length) = length.filter(|l| l.is_finite() && *l > 0.0) else { return };
    let pixels = (length / metres_per_pixel).round() as u32;
    let (x, y) = (left + 10, top + view - 14);
    if let Some(plate) = theme.plate() {
        fill(picture, [left, y - 18], [pixels + 20, 32], plate);
    }
    fill(picture, [x, y], [pixels, 3], theme.ink());
    let label = if length >= 1.0 {
        format!("{length} m")
    } else if length >= 0.01 {
        format!("{:.0} cm", length * 100.0)
    } else {
        format!("{} mm", length * 1000.0)
    };
    text::draw(picture, x, y - 12, 1, theme.ink(), &label, view);
}

pub(super) fn draw_legend(
    picture: &mut RgbPicture,
    left: u32,
    top: u32,
    legend: &[LegendEntry],
    theme: Theme,
) {
    let mut sorted: Vec<&LegendEntry> = legend.iter().collect();
    sorted.sort_by_key(|entry| (is_building(&entry.name), Reverse(entry.count), &entry.name));
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
        text::draw(picture, count_left, y + 4, 1, theme.faint_ink(), &count, LEGEND_WIDTH);
        let space = count_left.saturating_sub(left + 32);
        text::draw(picture, left + 24, y + 4, 1, theme.ink(), &entry.name, space);
        y += 22;
    }
    if sorted.len() > lines {
        let more = format!("... {} more", sorted.len() - lines);
        text::draw(picture, left + 24, y + 4, 1, theme.faint_ink(), &more, LEGEND_WIDTH);
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

/// Mixes a share of a color into a pixel, if it is inside.
pub(crate) fn blend(picture: &mut RgbPicture, [x, y]: [u32; 2], color: [u8; 3], share: f64) {
    if let Some(below) = picture.get(x, y) {
        let mix = |i: usize| {
            (f64::from(below[i]) * (1.0 - share) + f64::from(color[i]) * share).round() as u8
        };
        picture.set(x, y, [mix(0), mix(1), mix(2)]);
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
