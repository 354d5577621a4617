//! What of a model is seen from outside: depth pictures from all around and from above.

use super::mesh::Mesh;
use crate::vector::{V3, basis, dot, unit_or};

/// Pixels along a side of a picture.
const SIDE: usize = 160;

/// Below this height what looks down is seen by nobody: it stands on a floor.
const LOW: f64 = 0.3;

/// A picture of depths from far away in one direction; larger is nearer.
struct View {
    toward: V3,
    axes: [V3; 2],
    low: [f64; 2],
    pixel: f64,
    depth: Vec<f32>,
}

/// Which sides of points are seen: how many pictures show the side of the normal, and the other side.
pub(super) struct Views(Vec<View>);

/// Directions toward cameras: a little from below, a little from above, from above.
fn directions() -> Vec<V3> {
    let around: [[f64; 2]; 16] = [
        [1.0, 0.0],
        [2.0, 1.0],
        [1.0, 1.0],
        [1.0, 2.0],
        [0.0, 1.0],
        [-1.0, 2.0],
        [-1.0, 1.0],
        [-2.0, 1.0],
        [-1.0, 0.0],
        [-2.0, -1.0],
        [-1.0, -1.0],
        [-1.0, -2.0],
        [0.0, -1.0],
        [1.0, -2.0],
        [1.0, -1.0],
        [2.0, -1.0],
    ];
    let mut all = vec![[0.0, 0.0, 1.0]];
    for (number, [x, y]) in around.into_iter().enumerate() {
        let long = (x * x + y * y).sqrt();
        for slope in [-0.2, 0.35, 1.0] {
            // From high up half as many do.
            if slope < 1.0 || number % 2 == 0 {
                all.push(unit_or([x, y, slope * long], [0.0, 0.0, 1.0]));
            }
        }
    }
    all
}

impl Views {
    pub(super) fn of(mesh: &Mesh) -> Self {
        Self(directions().into_iter().map(|toward| View::of(mesh, toward)).collect())
    }

    /// How many pictures show a point from the side of its normal, and from the other side.
    pub(super) fn count(&self, coord: V3, normal: V3) -> [u32; 2] {
        let mut count = [0; 2];
        for view in &self.0 {
            let facing = dot(normal, view.toward);
            let out = if facing < 0.0 { -normal[2] } else { normal[2] };
            let is_under = view.toward[2] < 0.0 && coord[2] < LOW && out < -0.7;
            if facing.abs() > 0.15 && !is_under && view.shows(coord, facing.abs()) {
                count[usize::from(facing < 0.0)] += 1;
            }
        }
        count
    }
}

impl View {
    fn of(mesh: &Mesh, toward: V3) -> Self {
        let axes = basis(toward);
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in mesh.triangles.iter().flat_map(|t| t.corners) {
            for i in 0..2 {
                low[i] = low[i].min(dot(p, axes[i]));
                high[i] = high[i].max(dot(p, axes[i]));
            }
        }
        let pixel = ((high[0] - low[0]).max(high[1] - low[1]) / (SIDE - 1) as f64).max(1e-5);
        let depth = vec![f32::NEG_INFINITY; SIDE * SIDE];
        let mut view = Self { toward, axes, low, pixel, depth };
        for triangle in &mesh.triangles {
            if mesh.paints[triangle.paint as usize].hides() {
                view.fill(triangle.corners);
            }
        }
        view
    }

    /// Place in pixels, and depth.
    fn project(&self, p: V3) -> V3 {
        let place = |i: usize| (dot(p, self.axes[i]) - self.low[i]) / self.pixel;
        [place(0), place(1), dot(p, self.toward)]
    }

    fn fill(&mut self, corners: [V3; 3]) {
        let [a, b, c] = corners.map(|p| self.project(p));
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        if area.abs() < 1e-12 {
            return;
        }
        let range = |i: usize| {
            let low = a[i].min(b[i]).min(c[i]).ceil().max(0.0) as usize;
            let high = a[i].max(b[i]).max(c[i]).floor().min((SIDE - 1) as f64);
            low..(high + 1.0).max(0.0) as usize
        };
        let columns = range(0);
        for row in range(1) {
            let y = row as f64;
            for column in columns.clone() {
                let x = column as f64;
                let u = ((c[1] - a[1]) * (x - a[0]) - (c[0] - a[0]) * (y - a[1])) / area;
                let v = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area;
                if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
                    let depth = (a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])) as f32;
                    let there = &mut self.depth[row * SIDE + column];
                    *there = there.max(depth);
                }
            }
        }
    }

    /// Whether nothing is before a point of a surface that is `facing` (a cosine) the camera.
    fn shows(&self, p: V3, facing: f64) -> bool {
        let [x, y, depth] = self.project(p);
        let place = |v: f64| (v.round().max(0.0) as usize).min(SIDE - 1);
        let nearest = f64::from(self.depth[place(y) * SIDE + place(x)]);
        // Across a pixel a tilted surface is at other depths itself.
        let slope = ((1.0 - facing * facing).max(0.0)).sqrt() / facing;
        depth > nearest - self.pixel * (0.5 + 0.75 * slope.min(4.0))
    }
}
