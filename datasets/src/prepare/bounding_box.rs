//! The box around a scan.

/// The smallest upright box around points: of all boxes with two sides along z the one with the smallest ground plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UprightBox {
    /// Unit directions of the ground plan's sides, x and y.
    pub axes: [[f64; 2]; 2],
    /// Smallest coordinates along both, and z.
    pub low: [f64; 3],
    /// Largest coordinates along both, and z.
    pub high: [f64; 3],
}

impl UprightBox {
    /// Around finite points; `None` without any.
    pub fn around(points: &[[f32; 3]]) -> Option<Self> {
        let hull = hull(points);
        let (&first, _) = hull.split_first()?;
        let z = |pick: fn(f64, f64) -> f64, start: f64| {
            points.iter().map(|p| f64::from(p[2])).fold(start, pick)
        };
        let (bottom, top) = (z(f64::min, f64::INFINITY), z(f64::max, f64::NEG_INFINITY));
        let mut best: Option<(f64, Self)> = None;
        for i in 0..hull.len() {
            let next = hull.get(i + 1).copied().unwrap_or(first);
            let side = [next[0] - hull[i][0], next[1] - hull[i][1]];
            let length = side[0].hypot(side[1]);
            // A side of the smallest rectangle lies along a side of the hull.
            let u = if length > 0.0 { side.map(|v| v / length) } else { [1.0, 0.0] };
            let axes = [u, [-u[1], u[0]]];
            let mut found = Self {
                axes,
                low: [f64::INFINITY, f64::INFINITY, bottom],
                high: [f64::NEG_INFINITY, f64::NEG_INFINITY, top],
            };
            for p in &hull {
                for (k, axis) in axes.iter().enumerate() {
                    let along = p[0] * axis[0] + p[1] * axis[1];
                    found.low[k] = found.low[k].min(along);
                    found.high[k] = found.high[k].max(along);
                }
            }
            let area = (found.high[0] - found.low[0]) * (found.high[1] - found.low[1]);
            if best.as_ref().is_none_or(|(smallest, _)| area < *smallest) {
                best = Some((area, found));
            }
        }
        best.map(|(_, found)| found)
    }

    /// The box with `margin` added to each side's length, half of it at either end.
    #[must_use]
    pub fn grown(&self, margin: f64) -> Self {
        let half = margin / 2.0;
        Self { axes: self.axes, low: self.low.map(|v| v - half), high: self.high.map(|v| v + half) }
    }

    /// Whether a point is inside or on the border.
    pub fn contains(&self, point: [f32; 3]) -> bool {
        let [x, y, z] = point.map(f64::from);
        let along = |k: usize| self.axes[k][0] * x + self.axes[k][1] * y;
        let at = [along(0), along(1), z];
        (0..3).all(|k| at[k] >= self.low[k] && at[k] <= self.high[k])
    }
}

/// The convex hull of the ground plan, against the clock (Andrew's monotone chain).
fn hull(points: &[[f32; 3]]) -> Vec<[f64; 2]> {
    let mut plan: Vec<[f64; 2]> =
        points.iter().map(|p| [f64::from(p[0]), f64::from(p[1])]).collect();
    plan.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    plan.dedup();
    if plan.len() < 3 {
        return plan;
    }
    let turn = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut out: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while out.len() >= 2 && turn(out[out.len() - 2], out[out.len() - 1], p) <= 0.0 {
                out.pop();
            }
            out.push(p);
        }
        out.pop();
        out
    };
    let mut lower = chain(&mut plan.iter().copied());
    lower.extend(chain(&mut plan.iter().rev().copied()));
    lower
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;

    #[test]
    fn a_turned_room_has_a_box_of_its_own_size() {
        let turn = 0.4f64;
        let (sin, cos) = turn.sin_cos();
        let mut points = Vec::new();
        for i in 0..=8 {
            for j in 0..=6 {
                for z in [0.0f32, 2.5] {
                    let (x, y) = (f64::from(i) * 0.5, f64::from(j) * 0.5);
                    points.push([(cos * x - sin * y) as f32, (sin * x + cos * y) as f32, z]);
                }
            }
        }
        let found = UprightBox::around(&points).unwrap();
        let size: Vec<f64> = (0..3).map(|k| found.high[k] - found.low[k]).collect();
        let mut plan = [size[0], size[1]];
        plan.sort_by(f64::total_cmp);
        assert!((plan[0] - 3.0).abs() < 1e-5 && (plan[1] - 4.0).abs() < 1e-5, "{size:?}");
        assert_eq!(size[2], 2.5);
        let at =
            |x: f64, y: f64, z: f32| [(cos * x - sin * y) as f32, (sin * x + cos * y) as f32, z];
        let grown = found.grown(0.5);
        assert!(grown.contains(at(-0.24, 1.0, 1.0)) && !grown.contains(at(-0.26, 1.0, 1.0)));
        assert!(grown.contains(at(2.0, 3.24, 2.74)) && !grown.contains(at(2.0, 1.0, 2.76)));
        assert!(!found.contains(at(-0.01, 1.0, 1.0)));
    }

    #[test]
    fn few_points_have_a_box_too() {
        assert_eq!(UprightBox::around(&[]), None);
        let one = UprightBox::around(&[[1.0, 2.0, 3.0]]).unwrap();
        assert!(
            one.grown(0.1).contains([1.04, 2.0, 2.96])
                && !one.grown(0.1).contains([1.06, 2.0, 3.0])
        );
        let line =
            UprightBox::around(&[[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [1.5, 2.0, 0.0]]).unwrap();
        assert!(((line.high[0] - line.low[0]) - 5.0).abs() < 1e-9, "{line:?}");
    }

    #[test]
    fn every_side_of_a_box_is_where_its_points_end() {
        // A plan of the sides (−3, 4) / 5 and (4, 3) / 5, of 2 by 5 m, from z = 3 to 7, with corners in no order.
        let at = |a: f32, b: f32, z: f32| [-0.6 * a + 0.8 * b + 10.0, 0.8 * a + 0.6 * b - 20.0, z];
        let points =
            [at(2., 5., 3.), at(0., 0., 7.), at(1., 2., 4.), at(2., 0., 5.), at(0., 5., 6.)];
        let found = UprightBox::around(&points).unwrap();
        let [u, v] = found.axes;
        assert!((u[0] * v[0] + u[1] * v[1]).abs() < 1e-9 && (u[0].hypot(u[1]) - 1.0).abs() < 1e-9);
        assert_eq!((found.low[2], found.high[2]), (3.0, 7.0));
        for (name, grown, size) in [("as it is", 0.0, 0.0), ("grown by half a meter", 0.5, 0.25)] {
            let around = found.grown(grown);
            let inside = |a: f64, b: f64, z: f64| around.contains(at(a as f32, b as f32, z as f32));
            let (near, far) = (size - 0.01, size + 0.01);
            assert!(inside(1.0, 2.0, 5.0), "{name}");
            for (a, b, z) in [
                (-1., 0., 0.),
                (1., 0., 0.),
                (0., -1., 0.),
                (0., 1., 0.),
                (0., 0., -1.),
                (0., 0., 1.),
            ] {
                let place = |off: f64| {
                    let middle: [f64; 3] = [1.0, 2.5, 5.0];
                    let half: [f64; 3] = [1.0, 2.5, 2.0];
                    [a, b, z]
                        .iter()
                        .zip(middle.iter().zip(half))
                        .map(|(s, (m, h))| m + s * (h + off))
                        .collect::<Vec<f64>>()
                };
                let [near, far] = [place(near), place(far)];
                assert!(inside(near[0], near[1], near[2]), "{name}: {near:?}");
                assert!(!inside(far[0], far[1], far[2]), "{name}: {far:?}");
            }
        }
        // Of one point the sides are those of the world, and the borders belong to the box.
        let one = UprightBox::around(&[[1.0, -2.0, 3.0]]).unwrap();
        assert_eq!(
            (one.axes, one.low, one.high),
            ([[1.0, 0.0], [0.0, 1.0]], [1.0, -2.0, 3.0], [1.0, -2.0, 3.0])
        );
        assert!(one.contains([1.0, -2.0, 3.0]));
    }

    /// The smallest area over all directions, by trying many.
    fn by_trying(points: &[[f32; 3]]) -> f64 {
        let area = |turn: f64| {
            let (sin, cos) = turn.sin_cos();
            let side = |x: f64, y: f64| {
                let along = points.iter().map(|p| x * f64::from(p[0]) + y * f64::from(p[1]));
                let (low, high) = along
                    .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
                high - low
            };
            side(cos, sin) * side(-sin, cos)
        };
        (0..9000)
            .map(|i| area(f64::from(i) * 1e-4 * std::f64::consts::TAU / 3.6))
            .fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn no_other_direction_has_a_smaller_plan() {
        let area =
            |found: UprightBox| (found.high[0] - found.low[0]) * (found.high[1] - found.low[1]);
        // Triangles with one wide angle, turned, so that each of their sides comes last in the hull once: only the long
        // side lies along the smallest box.
        for turn in 0..12 {
            let (sin, cos) = (f64::from(turn) * 0.53).sin_cos();
            let at = |x: f64, y: f64| [(cos * x - sin * y) as f32, (sin * x + cos * y) as f32, 0.0];
            let points = [at(0.0, 0.0), at(6.0, 0.0), at(2.0, 1.0)];
            let found = area(UprightBox::around(&points).unwrap());
            assert!((found - 6.0).abs() < 1e-4, "{turn}: {found}");
        }
        // Of this one the box with the shortest border has a plan of 54.3, the smallest plan is 45.
        let points = [[2.0, 6.0, 0.0], [5.0, 1.0, 0.0], [8.0, 11.0, 0.0], [3.0, 8.0, 0.0]];
        let found = area(UprightBox::around(&points).unwrap());
        assert!((found - 45.0).abs() < 1e-4, "{found}");
        // Shapes of many corners.
        let mut state = 7u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 16_777_216.0
        };
        for shape in 0..20 {
            let points: Vec<[f32; 3]> = (0..8).map(|_| [5.0 * next(), next(), next()]).collect();
            let (found, tried) = (area(UprightBox::around(&points).unwrap()), by_trying(&points));
            assert!(
                found < tried * (1.0 + 1e-6) && found > tried * 0.99,
                "{shape}: {found} {tried}"
            );
        }
    }
}
