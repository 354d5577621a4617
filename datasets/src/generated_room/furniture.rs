//! What stands where in a generated room.

use super::CLASS_NAMES;
use super::surface::{Pattern, Shape, Surface};
use crate::rng::{SampleRng, cos_sin, unit};

pub(super) struct Layout {
    pub(super) surfaces: Vec<Surface>,
    pub(super) num_instances: usize,
}

/// Furnishes a room of the given extent, its corner at the origin.
pub(super) fn furnish(size: [f64; 3], rng: &mut SampleRng) -> Layout {
    let mut room = Room { surfaces: Vec::new(), num_instances: 0, class: 0, density: 1.0 };
    let [length, width, height] = size;
    // Furniture of small rooms is smaller, down to a child's size.
    let fit = (width / 4.0).clamp(0.6, 1.0);
    let area = length * width;
    room.shell(size, rng);

    // Dining groups along the middle of the room, one per 18 m².
    let groups = ((area / 18.0) as usize).max(1);
    for i in 0..groups {
        let x = length * (i as f64 + 0.5) / groups as f64 + 0.2 * (unit(rng) - 0.5);
        let y = width * 0.55 + 0.1 * (unit(rng) - 0.5);
        room.dining_group([x, y], fit, rng);
    }

    // Along the wall y = 0: sofas with a rug before each; the door keeps the corner at x = 0 free.
    let sofas = ((length / 4.0) as usize).max(1);
    for i in 0..sofas {
        let x = length * (i as f64 + 0.6) / sofas as f64;
        room.sofa([x, 0.08], fit, rng);
    }
    // Along the wall y = width: bookshelves, with pictures between them.
    let shelves = ((length / 2.2) as usize).max(1);
    for i in 0..shelves {
        let x = length * (i as f64 + 0.4) / shelves as f64;
        room.bookshelf([x - 0.45 * fit, width - 0.31], fit, rng);
        room.picture([x + 0.55 * fit, width], [0.0, -1.0], 0.4 * fit, rng);
    }
    room.picture([length, width * 0.5], [-1.0, 0.0], 0.6 * fit, rng);
    room.picture([length * 0.6, 0.0], [0.0, 1.0], 0.6 * fit, rng);

    // Corners: plants and standing lamps; more lamps hang in large rooms.
    let corner = 0.35 * fit + 0.05;
    room.plant([length - corner, corner], fit, rng);
    room.lamp([length - corner, width - corner], fit, rng);
    if area > 20.0 {
        room.plant([corner, width - corner], 0.8 * fit, rng);
        room.lamp([corner, width * 0.3], 0.9 * fit, rng);
    }
    for i in 0..groups {
        let x = length * (i as f64 + 0.5) / groups as f64;
        room.hanging_lamp([x, width * 0.55], height, fit, rng);
    }
    let balls = 1 + (area / 12.0) as usize;
    for _ in 0..balls {
        let x = length * (0.2 + 0.6 * unit(rng));
        let y = width * (0.22 + 0.1 * unit(rng));
        room.ball([x, y], fit, rng);
    }
    Layout { surfaces: room.surfaces, num_instances: room.num_instances as usize }
}

struct Room {
    surfaces: Vec<Surface>,
    num_instances: i32,
    /// Class and density of the object being built.
    class: usize,
    density: f64,
}

/// A level frame: a place on the floor and which way an object faces.
#[derive(Clone, Copy)]
struct Frame {
    origin: [f64; 3],
    /// Cosine and sine of the turn about z.
    turn: [f64; 2],
}

impl Frame {
    fn at([x, y]: [f64; 2], turn: [f64; 2]) -> Self {
        Self { origin: [x, y, 0.0], turn }
    }

    fn vector(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [c, s] = self.turn;
        [c * x - s * y, s * x + c * y, z]
    }

    fn point(&self, p: [f64; 3]) -> [f64; 3] {
        let v = self.vector(p);
        std::array::from_fn(|a| self.origin[a] + v[a])
    }
}

/// A turn of up to ± `size` radians, roughly, in exact operations.
fn small_turn(size: f64, rng: &mut SampleRng) -> [f64; 2] {
    let s = size * (2.0 * unit(rng) - 1.0);
    [(1.0 - s * s).sqrt(), s]
}

fn vary(color: [f64; 3], by: f64, rng: &mut SampleRng) -> [f64; 3] {
    color.map(|c| c + by * (2.0 * unit(rng) - 1.0))
}

const WOOD: [f64; 3] = [150.0, 103.0, 62.0];

impl Room {
    /// Starts an object; the surfaces added next belong to it.
    fn object(&mut self, class: &str, density: f64) {
        self.class = CLASS_NAMES.iter().position(|&c| c == class).unwrap_or(0);
        self.density = density;
        self.num_instances += 1;
    }

    fn add(&mut self, shape: Shape, color: [f64; 3], pattern: Pattern) {
        self.surfaces.push(Surface {
            shape,
            color,
            pattern,
            class: self.class,
            instance: self.num_instances - 1,
            density: self.density,
        });
    }

    /// The six faces of a box with corner `low` and the given extent.
    fn cuboid(&mut self, frame: Frame, low: [f64; 3], extent: [f64; 3], color: [f64; 3]) {
        let high = [low[0] + extent[0], low[1] + extent[1], low[2] + extent[2]];
        let [x, y, z] = [[extent[0], 0.0, 0.0], [0.0, extent[1], 0.0], [0.0, 0.0, extent[2]]];
        let back = |v: [f64; 3]| v.map(|c| -c);
        for (corner, u, v) in [
            // `u × v` points outwards.
            (high, back(x), back(y)),
            (high, back(z), back(x)),
            (high, back(y), back(z)),
            (low, y, x),
            (low, x, z),
            (low, z, y),
        ] {
            self.add(
                Shape::Quad { corner: frame.point(corner), u: frame.vector(u), v: frame.vector(v) },
                color,
                Pattern::Plain,
            );
        }
    }

    fn shell(&mut self, [length, width, height]: [f64; 3], rng: &mut SampleRng) {
        let (x, y, z) = ([length, 0.0, 0.0], [0.0, width, 0.0], [0.0, 0.0, height]);
        self.object("floor", 1.0);
        let floor = vary([158.0, 122.0, 84.0], 14.0, rng);
        self.add(Shape::Quad { corner: [0.0; 3], u: x, v: y }, floor, Pattern::Boards(0.18));
        self.object("ceiling", 0.7);
        let white = vary([236.0, 234.0, 228.0], 6.0, rng);
        self.add(Shape::Quad { corner: [0.0, 0.0, height], u: y, v: x }, white, Pattern::Plain);
        let paint = vary([206.0, 208.0, 198.0], 16.0, rng);
        // Normals look into the room.
        for (corner, u, v) in [
            ([0.0; 3], z, x),
            ([0.0, width, 0.0], x, z),
            ([0.0; 3], y, z),
            ([length, 0.0, 0.0], z, y),
        ] {
            self.object("wall", 0.8);
            let color = vary(paint, 5.0, rng);
            self.add(Shape::Quad { corner, u, v }, color, Pattern::Plain);
        }
        self.object("door", 1.2);
        let color = vary([122.0, 78.0, 48.0], 12.0, rng);
        let frame = Frame::at([0.0, 0.15], [1.0, 0.0]);
        self.cuboid(frame, [0.0; 3], [0.05, 0.85, 2.05], color);
        self.add(
            Shape::Ball { centre: [0.09, 0.9, 1.0], radius: 0.035 },
            [205.0, 190.0, 120.0],
            Pattern::Plain,
        );
    }

    fn dining_group(&mut self, at: [f64; 2], fit: f64, rng: &mut SampleRng) {
        let frame = Frame::at(at, small_turn(0.15, rng));
        let [long, deep, high] = [1.5 * fit, 0.85 * fit, 0.74];
        self.object("table", 1.6);
        let wood = vary(WOOD, 18.0, rng);
        let [l, d] = [long / 2.0, deep / 2.0];
        self.cuboid(frame, [-l, -d, high - 0.04], [long, deep, 0.04], wood);
        for (x, y) in [(-l, -d), (l - 0.06, -d), (-l, d - 0.06), (l - 0.06, d - 0.06)] {
            self.cuboid(frame, [x, y, 0.0], [0.06, 0.06, high - 0.04], wood);
        }
        let seat = vary([62.0, 110.0, 150.0], 30.0, rng);
        for (x, side) in [(-0.25, -1.0), (0.25, -1.0), (-0.25, 1.0), (0.25, 1.0)] {
            let out = (deep / 2.0 + 0.18 * fit + 0.1 * unit(rng)) * side;
            let origin = frame.point([x * long, out, 0.0]);
            let [c, s] = frame.turn;
            let [dc, ds] = small_turn(0.3, rng);
            // The back rest is away from the table.
            let turn = [side * (c * dc - s * ds), side * (s * dc + c * ds)];
            self.chair(Frame { origin, turn }, fit, seat);
        }
    }

    fn chair(&mut self, frame: Frame, fit: f64, color: [f64; 3]) {
        self.object("chair", 1.8);
        let (w, h) = (0.42 * fit, 0.45);
        let half = w / 2.0;
        self.cuboid(frame, [-half, -half, h - 0.04], [w, w, 0.04], color);
        self.cuboid(frame, [-half, half - 0.03, h + 0.1], [w, 0.03, 0.4], color);
        let leg = color.map(|c| c * 0.6);
        for (x, y) in [(-half, -half), (half - 0.035, -half)] {
            self.cuboid(frame, [x, y, 0.0], [0.035, 0.035, h - 0.04], leg);
        }
        for x in [-half, half - 0.035] {
            self.cuboid(frame, [x, half - 0.035, 0.0], [0.035, 0.035, h + 0.5], leg);
        }
    }

    fn sofa(&mut self, [x, y]: [f64; 2], fit: f64, rng: &mut SampleRng) {
        let (w, d) = (1.7 * fit, 0.8 * fit);
        let frame = Frame::at([x, y], [1.0, 0.0]);
        self.object("sofa", 1.4);
        let color = vary([150.0, 62.0, 58.0], 35.0, rng);
        let lighter = color.map(|c| c + 18.0);
        self.cuboid(frame, [-w / 2.0, 0.0, 0.05], [w, d, 0.25], color);
        self.cuboid(frame, [-w / 2.0, 0.0, 0.3], [w, 0.2 * fit, 0.5], color);
        for side in [-w / 2.0, w / 2.0 - 0.16 * fit] {
            self.cuboid(frame, [side, 0.0, 0.3], [0.16 * fit, d, 0.28], color);
        }
        let inner = w - 0.36 * fit;
        for i in 0..2 {
            let left = -inner / 2.0 + inner / 2.0 * f64::from(i);
            let low = [left + 0.01, 0.22 * fit, 0.3];
            self.cuboid(frame, low, [inner / 2.0 - 0.02, d - 0.24 * fit, 0.14], lighter);
        }
        self.object("rug", 1.1);
        let (dark, light) = (vary([70.0, 82.0, 130.0], 25.0, rng), [222.0, 214.0, 190.0]);
        self.add(
            Shape::Quad {
                corner: [x - 0.8 * w / 1.7, y + d + 0.08, 0.02],
                u: [1.6 * w / 1.7, 0.0, 0.0],
                v: [0.0, 0.75 * fit, 0.0],
            },
            dark,
            Pattern::Checks(0.2 * fit, light),
        );
    }

    fn bookshelf(&mut self, at: [f64; 2], fit: f64, rng: &mut SampleRng) {
        let (w, d, h) = (0.9 * fit, 0.28, 1.9);
        let frame = Frame::at(at, [1.0, 0.0]);
        self.object("bookshelf", 1.3);
        let wood = vary([120.0, 84.0, 52.0], 15.0, rng);
        for x in [0.0, w - 0.03] {
            self.cuboid(frame, [x, 0.0, 0.0], [0.03, d, h], wood);
        }
        for i in 0..6 {
            let z = f64::from(i) * (h - 0.03) / 5.0;
            self.cuboid(frame, [0.0, 0.0, z], [w, d, 0.03], wood);
        }
        for i in 0..5 {
            let z = 0.03 + f64::from(i) * (h - 0.03) / 5.0;
            let filled = w * (0.55 + 0.4 * unit(rng)) - 0.06;
            let tall = 0.22 + 0.08 * unit(rng);
            let corner = frame.point([0.03, 0.05, z]);
            self.add(
                Shape::Quad { corner, u: [filled, 0.0, 0.0], v: [0.0, 0.0, tall] },
                [120.0; 3],
                Pattern::Books(0.035),
            );
        }
    }

    /// A picture on the wall at `at`, looking along `facing`.
    fn picture(&mut self, at: [f64; 2], facing: [f64; 2], w: f64, rng: &mut SampleRng) {
        self.object("picture", 1.3);
        let along = [-facing[1], facing[0]];
        let h = 0.7 * w + 0.1;
        let at_height = |s: f64, z: f64, off: f64| {
            [
                at[0] + s * along[0] + off * facing[0],
                at[1] + s * along[1] + off * facing[1],
                1.5 + z,
            ]
        };
        let u = [along[0] * w, along[1] * w, 0.0];
        let color = vary([170.0, 140.0, 90.0], 60.0, rng);
        let other = vary([70.0, 110.0, 140.0], 60.0, rng);
        self.add(
            Shape::Quad { corner: at_height(-w / 2.0, -h / 2.0, 0.025), u, v: [0.0, 0.0, h] },
            color,
            Pattern::Checks(0.16, other),
        );
    }

    fn plant(&mut self, [x, y]: [f64; 2], fit: f64, rng: &mut SampleRng) {
        self.object("plant", 0.9);
        let pot = vary([176.0, 98.0, 62.0], 15.0, rng);
        let r = 0.17 * fit;
        let base = [x, y, 0.0];
        self.add(
            Shape::Cone { base, bottom: 0.75 * r, top: r, height: 0.3 * fit },
            pot,
            Pattern::Plain,
        );
        let earth = [x, y, 0.28 * fit];
        self.add(
            Shape::Disc { centre: earth, radius: 0.95 * r },
            [72.0, 52.0, 38.0],
            Pattern::Plain,
        );
        self.add(
            Shape::Tube { base: earth, radius: 0.02, height: 0.4 * fit },
            [96.0, 78.0, 50.0],
            Pattern::Plain,
        );
        for _ in 0..6 {
            let [c, s] = cos_sin(rng);
            let reach = 0.14 * fit * unit(rng);
            let centre = [x + reach * c, y + reach * s, fit * (0.6 + 0.5 * unit(rng))];
            let green = vary([58.0, 128.0, 52.0], 22.0, rng);
            self.add(Shape::Foliage { centre, radius: 0.17 * fit }, green, Pattern::Plain);
        }
    }

    fn lamp(&mut self, [x, y]: [f64; 2], fit: f64, rng: &mut SampleRng) {
        self.object("lamp", 1.6);
        let metal = [92.0, 92.0, 98.0];
        let h = 1.45 * (0.7 + 0.3 * fit);
        self.add(Shape::Disc { centre: [x, y, 0.02], radius: 0.14 * fit }, metal, Pattern::Plain);
        self.add(
            Shape::Tube { base: [x, y, 0.02], radius: 0.014, height: h },
            metal,
            Pattern::Plain,
        );
        let shade = vary([246.0, 222.0, 150.0], 8.0, rng);
        let base = [x, y, h - 0.05];
        self.add(
            Shape::Cone { base, bottom: 0.24 * fit, top: 0.13 * fit, height: 0.28 },
            shade,
            Pattern::Plain,
        );
    }

    fn hanging_lamp(&mut self, [x, y]: [f64; 2], height: f64, fit: f64, rng: &mut SampleRng) {
        self.object("lamp", 1.6);
        let shade = vary([250.0, 232.0, 176.0], 6.0, rng);
        self.add(
            Shape::Tube { base: [x, y, height - 0.5], radius: 0.008, height: 0.5 },
            [60.0; 3],
            Pattern::Plain,
        );
        self.add(
            Shape::Ball { centre: [x, y, height - 0.62], radius: 0.16 * fit },
            shade,
            Pattern::Plain,
        );
    }

    fn ball(&mut self, [x, y]: [f64; 2], fit: f64, rng: &mut SampleRng) {
        self.object("ball", 1.4);
        let radius = (0.1 + 0.06 * unit(rng)) * fit;
        let color = vary([225.0, 120.0, 40.0], 30.0, rng);
        let centre = [x, y, radius];
        self.add(Shape::Ball { centre, radius }, color, Pattern::Checks(0.09, [240.0; 3]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::sample_rng;

    #[test]
    fn faces_of_a_box_look_outwards() {
        let mut room = Room { surfaces: Vec::new(), num_instances: 1, class: 0, density: 1.0 };
        let frame = Frame::at([1.0, 2.0], [0.8, 0.6]);
        let (low, extent) = ([0.1, 0.2, 0.3], [0.4, 0.5, 0.6]);
        room.cuboid(frame, low, extent, [0.0; 3]);
        let centre = frame.point(std::array::from_fn(|a| low[a] + extent[a] / 2.0));
        let mut rng = sample_rng(0, 0, 0);
        assert_eq!(room.surfaces.len(), 6);
        for surface in &room.surfaces {
            for _ in 0..20 {
                let p = surface.sample(&mut rng);
                let out: f64 = (0..3).map(|a| (p.coord[a] - centre[a]) * p.normal[a]).sum();
                assert!(out > 0.19, "{out}");
            }
        }
        let area: f64 = room.surfaces.iter().map(Surface::area).sum();
        assert!((area - 2.0 * (0.2 + 0.24 + 0.3)).abs() < 1e-12);
    }
}
