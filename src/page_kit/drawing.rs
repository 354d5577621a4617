//! A few shapes, and the two forms that they are written in: SVG and PNG.

use super::escaped;
use crate::preview::{PreviewError, blend, text, write_png};
use scenesplat_scene::picture::RgbPicture;
use std::fmt::Write;
use std::path::Path;

/// Color, 0 to 255.
pub type Color = [u8; 3];

/// Where a text begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// At its left end.
    Start,
    /// At its middle.
    Middle,
    /// At its right end.
    End,
}

/// Something drawn; places in pixels from the upper left.
#[derive(Debug, Clone, PartialEq)]
enum Shape {
    Line {
        from: [f64; 2],
        to: [f64; 2],
        width: f64,
        color: Color,
        dashed: bool,
    },
    Disc {
        at: [f64; 2],
        radius: f64,
        fill: Color,
        rim: Color,
    },
    /// `size`: 8 pixels each; `at`: upper edge.
    Text {
        at: [f64; 2],
        size: u32,
        color: Color,
        anchor: Anchor,
        text: String,
    },
}

/// A picture of shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    width: u32,
    height: u32,
    shapes: Vec<Shape>,
}

const PAPER: Color = [252, 252, 250];

impl Drawing {
    /// An empty sheet of so many pixels.
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height, shapes: Vec::new() }
    }

    /// Draws a line.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], width: f64, color: Color) {
        self.shapes.push(Shape::Line { from, to, width, color, dashed: false });
    }

    /// Draws a dashed line.
    pub fn dashes(&mut self, from: [f64; 2], to: [f64; 2], color: Color) {
        self.shapes.push(Shape::Line { from, to, width: 1.5, color, dashed: true });
    }

    /// Draws a filled disc with a rim.
    pub fn disc(&mut self, at: [f64; 2], radius: f64, fill: Color, rim: Color) {
        self.shapes.push(Shape::Disc { at, radius, fill, rim });
    }

    /// Writes a text of `size` times 8 pixels height, whose upper edge is at `at`.
    pub fn text(&mut self, at: [f64; 2], size: u32, color: Color, anchor: Anchor, text: &str) {
        self.shapes.push(Shape::Text { at, size, color, anchor, text: text.to_owned() });
    }

    /// Puts another one below this.
    pub fn append(&mut self, below: Self) {
        let shift = f64::from(self.height);
        let moved = |[x, y]: [f64; 2]| [x, y + shift];
        self.shapes.extend(below.shapes.into_iter().map(|shape| match shape {
            Shape::Line { from, to, width, color, dashed } => {
                Shape::Line { from: moved(from), to: moved(to), width, color, dashed }
            }
            Shape::Disc { at, radius, fill, rim } => {
                Shape::Disc { at: moved(at), radius, fill, rim }
            }
            Shape::Text { at, size, color, anchor, text } => {
                Shape::Text { at: moved(at), size, color, anchor, text }
            }
        }));
        self.width = self.width.max(below.width);
        self.height += below.height;
    }

    /// As SVG.
    pub fn to_svg(&self) -> String {
        let Self { width, height, shapes } = self;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"ui-monospace, monospace\">\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"{}\"/>\n",
            hex(PAPER)
        );
        for shape in shapes {
            // Writing to a String does not fail.
            let _ = match shape {
                Shape::Line { from: [x1, y1], to: [x2, y2], width, color, dashed } => {
                    let dash = if *dashed { " stroke-dasharray=\"6 5\"" } else { "" };
                    writeln!(
                        svg,
                        "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" \
                         stroke=\"{}\" stroke-width=\"{width}\"{dash}/>",
                        hex(*color)
                    )
                }
                Shape::Disc { at: [x, y], radius, fill, rim } => writeln!(
                    svg,
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{}\" stroke=\"{}\" \
                     stroke-width=\"2\"/>",
                    hex(*fill),
                    hex(*rim)
                ),
                Shape::Text { at: [x, y], size, color, anchor, text } => {
                    let anchor = match anchor {
                        Anchor::Start => "start",
                        Anchor::Middle => "middle",
                        Anchor::End => "end",
                    };
                    // A letter of the monospaced fonts is 0.6 of its size wide, as in pictures.
                    let font = 13.0 * f64::from(*size);
                    let base = y + 8.0 * f64::from(*size);
                    writeln!(
                        svg,
                        "<text x=\"{x:.1}\" y=\"{base:.1}\" font-size=\"{font}\" fill=\"{}\" \
                         text-anchor=\"{anchor}\">{}</text>",
                        hex(*color),
                        escaped(text)
                    )
                }
            };
        }
        svg + "</svg>\n"
    }

    /// As pixels.
    pub fn to_picture(&self) -> RgbPicture {
        let mut picture = RgbPicture::filled(self.width, self.height, PAPER);
        for shape in &self.shapes {
            match shape {
                Shape::Line { from, to, width, color, dashed } => {
                    let reach = |p: [f64; 2]| segment_distance(p, *from, *to) - width / 2.0;
                    let along = |p: [f64; 2]| (p[0] - from[0]).hypot(p[1] - from[1]) % 11.0 < 6.0;
                    paint(&mut picture, [*from, *to], width + 1.0, *color, |p| {
                        if *dashed && !along(p) { f64::INFINITY } else { reach(p) }
                    });
                }
                Shape::Disc { at, radius, fill, rim } => {
                    let from_rim = |p: [f64; 2]| (p[0] - at[0]).hypot(p[1] - at[1]) - radius;
                    paint(&mut picture, [*at; 2], radius + 3.0, *fill, from_rim);
                    paint(&mut picture, [*at; 2], radius + 3.0, *rim, |p| from_rim(p).abs() - 1.0);
                }
                Shape::Text { at, size, color, anchor, text: words } => {
                    let wide = f64::from(text::width(words, *size));
                    let left = match anchor {
                        Anchor::Start => at[0],
                        Anchor::Middle => at[0] - wide / 2.0,
                        Anchor::End => at[0] - wide,
                    };
                    let left = left.max(0.0) as u32;
                    let room = self.width.saturating_sub(left);
                    text::draw(
                        &mut picture,
                        left,
                        at[1].max(0.0) as u32,
                        *size,
                        *color,
                        words,
                        room,
                    );
                }
            }
        }
        picture
    }

    /// Writes both forms. Returns their sizes in bytes.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, svg: &Path, png: &Path) -> Result<[u64; 2], PreviewError> {
        let text = self.to_svg();
        scenesplat_scene::AtomicFile::write(svg, text.as_bytes())?;
        Ok([text.len() as u64, write_png(png, &self.to_picture())?])
    }
}

/// Mixes a color into the pixels around some corners, as far as `distance` from the shape's inside
/// allows: half a pixel of soft edge.
fn paint(
    picture: &mut RgbPicture,
    corners: [[f64; 2]; 2],
    margin: f64,
    color: Color,
    distance: impl Fn([f64; 2]) -> f64,
) {
    let range = |axis: usize, most: u32| {
        let low = corners[0][axis].min(corners[1][axis]) - margin;
        let high = corners[0][axis].max(corners[1][axis]) + margin;
        (low.max(0.0) as u32)..((high.max(0.0) as u32).saturating_add(1)).min(most)
    };
    for y in range(1, picture.height()) {
        for x in range(0, picture.width()) {
            let share = (0.5 - distance([f64::from(x) + 0.5, f64::from(y) + 0.5])).clamp(0.0, 1.0);
            if share > 0.0 {
                blend(picture, [x, y], color, share);
            }
        }
    }
}

fn segment_distance(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let length = dx * dx + dy * dy;
    let t = if length > 0.0 { ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / length } else { 0.0 };
    let t = t.clamp(0.0, 1.0);
    (p[0] - a[0] - t * dx).hypot(p[1] - a[1] - t * dy)
}

fn hex([r, g, b]: Color) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_show_the_same_shapes() {
        let mut drawing = Drawing::new(60, 40);
        drawing.line([5.0, 10.5], [55.0, 10.5], 1.0, [255, 0, 0]);
        let mut below = Drawing::new(50, 30);
        below.disc([20.0, 15.0], 6.0, [0, 0, 255], [0, 255, 0]);
        below.text([2.0, 2.0], 1, [0; 3], Anchor::Start, "a<b");
        drawing.append(below);
        assert_eq!((drawing.width, drawing.height), (60, 70));
        let svg = drawing.to_svg();
        assert!(svg.contains("a&lt;b") && svg.contains("cy=\"55.0\""), "{svg}");
        let picture = drawing.to_picture();
        assert_eq!(picture.get(30, 10), Some([255, 0, 0]));
        assert_eq!(picture.get(30, 13), Some(PAPER));
        assert_eq!(picture.get(20, 55), Some([0, 0, 255]));
        let rim = picture.get(26, 55).unwrap();
        assert!(rim[1] > 240 && rim[2] < 15, "{rim:?}");
    }
}
