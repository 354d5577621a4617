//! The smallest upright box around points.

use glam::DVec2;
use serde::Serialize;

/// An upright box in meters; +z is up.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UprightBox {
    /// Middle.
    pub center: [f64; 3],
    /// Length along its first side, along its second, and height; the first is the longer one.
    pub size: [f64; 3],
    /// Angle from the x axis to its first side, radians, −π/2 < yaw ≤ π/2.
    pub yaw: f64,
}

/// Share of the rows, at each end of a side, that may be stray.
const STRAY: f64 = 0.005;

impl UprightBox {
    /// The box of least area in plan around most of some rows: 0.5 % at each end of each side may be
    /// outside. `None` without rows.
    ///
    /// `coord`: meters, +z up, finite. `[N, 3]`
    pub fn around(coord: &[[f32; 3]], rows: &[u32]) -> Option<Self> {
        if rows.is_empty() {
            return None;
        }
        let points: Vec<[f64; 3]> =
            rows.iter().map(|&r| coord[r as usize].map(f64::from)).collect();
        // Strays would turn the box; they are left out along 8 directions before the hull is made.
        let mut inner = vec![true; points.len()];
        for step in 0..8 {
            let (s, c) = (f64::from(step) * std::f64::consts::PI / 8.0).sin_cos();
            let along: Vec<f64> = points.iter().map(|p| c * p[0] + s * p[1]).collect();
            let [low, high] = span(&along);
            inner.iter_mut().zip(&along).for_each(|(i, a)| *i &= *a >= low && *a <= high);
        }
        let inside = points.iter().zip(&inner).filter(|(_, i)| **i);
        let plan = inside.map(|(p, _)| DVec2::new(p[0], p[1])).collect();
        let yaw = least_yaw(&hull(plan));
        let (s, c) = yaw.sin_cos();
        let sides = [
            span(&points.iter().map(|p| c * p[0] + s * p[1]).collect::<Vec<_>>()),
            span(&points.iter().map(|p| c * p[1] - s * p[0]).collect::<Vec<_>>()),
            span(&points.iter().map(|p| p[2]).collect::<Vec<_>>()),
        ];
        let middle = sides.map(|[low, high]| low.midpoint(high));
        let mut size = sides.map(|[low, high]| high - low);
        let mut yaw = yaw;
        if size[1] > size[0] {
            size.swap(0, 1);
            yaw += std::f64::consts::FRAC_PI_2;
        }
        if yaw > std::f64::consts::FRAC_PI_2 {
            yaw -= std::f64::consts::PI;
        }
        let center = [c * middle[0] - s * middle[1], s * middle[0] + c * middle[1], middle[2]];
        Some(Self { center: center.map(|v| v + 0.0), size, yaw: yaw + 0.0 })
    }

    /// Lowest and highest z.
    pub fn heights(&self) -> [f64; 2] {
        let half = self.size[2] / 2.0;
        [self.center[2] - half, self.center[2] + half]
    }

    /// Volume, m³.
    pub fn volume(&self) -> f64 {
        self.size.iter().product()
    }

    /// The four corners in plan, around it.
    pub fn plan(&self) -> [[f64; 2]; 4] {
        let (s, c) = self.yaw.sin_cos();
        [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(u, v)| {
            let (u, v) = (u * self.size[0], v * self.size[1]);
            [self.center[0] + c * u - s * v, self.center[1] + s * u + c * v]
        })
    }

    /// The eight corners, the lower four first.
    pub fn corners(&self) -> [[f64; 3]; 8] {
        let (plan, z) = (self.plan(), self.heights());
        std::array::from_fn(|i| [plan[i % 4][0], plan[i % 4][1], z[i / 4]])
    }

    /// Distance of a point from the box in plan, 0 inside.
    pub fn plan_distance(&self, [x, y]: [f64; 2]) -> f64 {
        let own = self.in_plan(DVec2::new(x, y));
        let out = [0, 1].map(|a| (own[a].abs() - self.size[a] / 2.0).max(0.0));
        out[0].hypot(out[1])
    }

    /// The direction of its first side.
    pub(crate) fn side(&self) -> DVec2 {
        DVec2::from_angle(self.yaw)
    }

    pub(crate) fn plan_center(&self) -> DVec2 {
        DVec2::new(self.center[0], self.center[1])
    }

    /// A place in plan from its middle, along its sides.
    pub(crate) fn in_plan(&self, p: DVec2) -> [f64; 2] {
        let (side, d) = (self.side(), p - self.plan_center());
        [side.dot(d), side.perp_dot(d)]
    }

    /// Least distance of the two boxes in plan: exact for boxes apart, 0 where they overlap.
    pub fn plan_gap(&self, other: &Self) -> f64 {
        if self.overlaps_in_plan(other) {
            return 0.0;
        }
        // Of two rectangles apart, a corner of one is nearest to the other.
        let from = |a: &Self, b: &Self| {
            a.plan().into_iter().map(|p| b.plan_distance(p)).fold(f64::INFINITY, f64::min)
        };
        from(self, other).min(from(other, self))
    }

    /// Distance between the heights of two boxes, 0 where they share some.
    pub fn height_gap(&self, other: &Self) -> f64 {
        let ([a, b], [c, d]) = (self.heights(), other.heights());
        (c - b).max(a - d).max(0.0)
    }

    fn overlaps_in_plan(&self, other: &Self) -> bool {
        let d = self.plan_center() - other.plan_center();
        let axes = |b: &Self| [b.side(), b.side().perp()];
        let reach = |axis: DVec2, b: &Self| -> f64 {
            axes(b).iter().zip(b.size).map(|(own, size)| size / 2.0 * axis.dot(*own).abs()).sum()
        };
        axes(self)
            .into_iter()
            .chain(axes(other))
            .all(|axis| axis.dot(d).abs() < reach(axis, self) + reach(axis, other))
    }
}

/// From the `STRAY` to the 1 − `STRAY` quantile; all of fewer than 200 values.
fn span(values: &[f64]) -> [f64; 2] {
    let mut sorted = values.to_vec();
    let cut = (values.len() as f64 * STRAY) as usize;
    let last = sorted.len() - 1;
    let (_, low, _) = sorted.select_nth_unstable_by(cut, f64::total_cmp);
    let low = *low;
    let (_, high, _) = sorted.select_nth_unstable_by(last - cut, f64::total_cmp);
    [low, *high]
}

/// The convex hull, around it; Andrew's monotone chain.
fn hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let mut chain: Vec<DVec2> = Vec::new();
    for _half in 0..2 {
        let start = chain.len();
        for &p in &points {
            while let [.., a, b] = chain[start..]
                && (b - a).perp_dot(p - a) <= 0.0
            {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        points.reverse();
    }
    chain
}

/// The direction of the hull's side that the rectangle of least area lies along; 0 for a point.
fn least_yaw(hull: &[DVec2]) -> f64 {
    let mut best = (f64::INFINITY, 0.0);
    for (i, a) in hull.iter().enumerate() {
        let side = hull[(i + 1) % hull.len()] - a;
        let length = side.x.hypot(side.y);
        if length < 1e-9 {
            continue;
        }
        let side = side / length;
        let extent = |u: DVec2| {
            let along = hull.iter().map(|p| u.dot(*p));
            let (low, high) =
                along.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            high - low
        };
        let area = extent(side) * extent(side.perp());
        if area < best.0 {
            best = (area, side.y.atan2(side.x));
        }
    }
    // Directions of a rectangle are the same a quarter turn on.
    best.1.rem_euclid(std::f64::consts::FRAC_PI_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(size: [f32; 3], yaw: f32, at: [f32; 3]) -> Vec<[f32; 3]> {
        let (s, c) = yaw.sin_cos();
        let mut out = Vec::new();
        for i in 0..=10 {
            for j in 0..=10 {
                for k in 0..=4 {
                    let p = [
                        (i as f32 / 10.0 - 0.5) * size[0],
                        (j as f32 / 10.0 - 0.5) * size[1],
                        (k as f32 / 4.0 - 0.5) * size[2],
                    ];
                    out.push([
                        at[0] + c * p[0] - s * p[1],
                        at[1] + s * p[0] + c * p[1],
                        at[2] + p[2],
                    ]);
                }
            }
        }
        out
    }

    #[test]
    fn a_turned_box_is_found_again() {
        for yaw in [0.0f32, 0.3, 1.2, -0.7, std::f32::consts::FRAC_PI_2] {
            let coord = grid([2.0, 1.0, 0.5], yaw, [3.0, -1.0, 0.7]);
            let rows: Vec<u32> = (0..coord.len() as u32).collect();
            let found = UprightBox::around(&coord, &rows).unwrap();
            // Half a percent of 605 rows lie in the outermost planes anyway.
            for (got, want) in found.size.into_iter().zip([2.0, 1.0, 0.5]) {
                assert!((got - want).abs() < 0.02, "{found:?}");
            }
            for (got, want) in found.center.into_iter().zip([3.0, -1.0, 0.7]) {
                assert!((got - want).abs() < 0.02, "{found:?}");
            }
            let off = (found.yaw - f64::from(yaw)).rem_euclid(std::f64::consts::PI);
            assert!(off.min(std::f64::consts::PI - off) < 0.03, "{yaw}: {found:?}");
        }
    }

    #[test]
    fn a_stray_row_of_many_changes_little() {
        let mut coord = grid([2.0, 1.0, 0.5], 0.3, [0.0; 3]);
        coord.push([40.0, -30.0, 9.0]);
        let rows: Vec<u32> = (0..coord.len() as u32).collect();
        let found = UprightBox::around(&coord, &rows).unwrap();
        assert!((found.volume() - 1.0).abs() < 0.05, "{found:?}");
    }

    #[test]
    fn points_and_lines_have_boxes_too() {
        let one = UprightBox::around(&[[1.0, 2.0, 3.0]], &[0]).unwrap();
        assert_eq!((one.center, one.size), ([1.0, 2.0, 3.0], [0.0; 3]));
        let line = UprightBox::around(&[[0.0; 3], [0.0, 2.0, 0.0]], &[0, 1]).unwrap();
        assert_eq!(line.size, [2.0, 0.0, 0.0]);
        assert_eq!(UprightBox::around(&[], &[]), None);
    }

    #[test]
    fn gaps_between_turned_boxes() {
        let unit = UprightBox { center: [0.0; 3], size: [1.0; 3], yaw: 0.0 };
        let turned =
            UprightBox { center: [2.0, 0.0, 0.0], yaw: std::f64::consts::FRAC_PI_4, ..unit };
        assert!((unit.plan_gap(&turned) - (1.5 - 0.5f64.sqrt())).abs() < 1e-12);
        assert_eq!(unit.plan_gap(&unit), 0.0);
        let above = UprightBox { center: [0.0, 0.0, 3.0], ..unit };
        assert_eq!(unit.height_gap(&above), 2.0);
    }

    /// Sides along (4, 3) / 5 and (−3, 4) / 5.
    fn leaning() -> UprightBox {
        UprightBox { center: [1.0, 2.0, 3.0], size: [4.0, 2.0, 6.0], yaw: 3f64.atan2(4.0) }
    }

    fn near(a: &[f64], b: &[f64]) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9)
    }

    #[test]
    fn places_of_a_leaning_box_by_hand() {
        let b = leaning();
        let plan = [[0.0, 0.0], [3.2, 2.4], [2.0, 4.0], [-1.2, 1.6]];
        assert!(near(b.plan().as_flattened(), plan.as_flattened()), "{:?}", b.plan());
        for (i, corner) in b.corners().iter().enumerate() {
            assert!(near(corner, &[plan[i % 4][0], plan[i % 4][1], [0.0, 6.0][i / 4]]), "{i}");
        }
        assert_eq!((b.heights(), b.volume()), ([0.0, 6.0], 48.0));
        // 5 along both sides from the middle: 3 past one end, 4 past the other.
        assert!(near(&b.in_plan(DVec2::new(2.0, 9.0)), &[5.0, 5.0]));
        // 3 against the second side.
        assert!(near(&b.in_plan(DVec2::new(2.8, -0.4)), &[0.0, -3.0]));
        assert!((b.plan_distance([2.0, 9.0]) - 5.0).abs() < 1e-9);
        assert!((b.plan_distance([2.8, -0.4]) - 2.0).abs() < 1e-9);
        assert_eq!(b.plan_distance([1.5, 2.3]), 0.0);
        let above = UprightBox { center: [9.0, 9.0, 8.5], size: [1.0, 1.0, 2.0], ..b };
        assert_eq!((b.height_gap(&above), above.height_gap(&b), b.height_gap(&b)), (1.5, 1.5, 0.0));
        // Its corner, 3.2 to the right, is nearest to a wall at 5; nothing of it is at the cross through it.
        let wall = UprightBox {
            center: [5.5, 2.4, 3.0],
            size: [8.0, 1.0, 6.0],
            yaw: std::f64::consts::FRAC_PI_2,
        };
        assert!((b.plan_gap(&wall) - 1.8).abs() < 1e-9 && (wall.plan_gap(&b) - 1.8).abs() < 1e-9);
        let bar = UprightBox {
            center: [1.0, 2.0, 0.0],
            size: [9.0, 0.1, 1.0],
            yaw: b.yaw + std::f64::consts::FRAC_PI_2,
        };
        assert_eq!((b.plan_gap(&bar), bar.plan_gap(&b)), (0.0, 0.0));
    }

    #[test]
    fn four_corners_give_their_rectangle_whatever_its_side_is_called() {
        // Longer along its second axis: the first side is a quarter turn back.
        let quarter = std::f64::consts::FRAC_PI_2;
        let cases = [
            (3.0, 0.4, 0.4),
            (3.0, -0.4, -0.4),
            (0.5, 0.4, 0.4 - quarter),
            (0.5, 1.2, 1.2 - quarter),
        ];
        for (long, yaw, want) in cases {
            let given = UprightBox { center: [5.0, -7.0, 1.0], size: [long, 1.0, 2.0], yaw };
            let coord: Vec<[f32; 3]> =
                given.corners().iter().map(|c| c.map(|v| v as f32)).collect();
            let mut all = vec![[90.0; 3]];
            all.extend(coord);
            let found = UprightBox::around(&all, &[1, 2, 3, 4, 5, 6, 7, 8]).unwrap();
            let size = [long.max(1.0), long.min(1.0), 2.0];
            for (got, want) in
                found.center.iter().chain(&found.size).zip([5.0, -7.0, 1.0].iter().chain(&size))
            {
                assert!((got - want).abs() < 1e-5, "{found:?}");
            }
            assert!((found.yaw - want).abs() < 1e-5, "{long} {yaw}: {found:?}");
        }
        let points =
            [[0.0, 0.0], [2.0, 1.0], [1.0, 0.0], [0.0, 1.0], [2.0, 0.0], [1.0, 0.5], [0.0, 0.0]];
        let found = hull(points.map(DVec2::from).to_vec());
        assert_eq!(found, [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]].map(DVec2::from));
        // Of a triangle with sides 4, 3 and 5 each side has a rectangle of twice its area: the first.
        assert_eq!(least_yaw(&[DVec2::ONE]), 0.0);
        // A wide hexagon: along its long sides.
        let wide = [[0.0, 0.0], [4.0, 0.0], [5.0, 1.0], [4.0, 2.0], [0.0, 2.0], [-1.0, 1.0]];
        let turned = wide.map(|p| DVec2::from_angle(0.3).rotate(DVec2::from(p)));
        assert!((least_yaw(&turned) - 0.3).abs() < 1e-9);
        // Of 400 values two at each end are strays, of 199 none.
        let values = |n: i32| (0..n).rev().map(f64::from).collect::<Vec<_>>();
        assert_eq!(
            (span(&values(400)), span(&values(199)), span(&values(200))),
            ([2.0, 397.0], [0.0, 198.0], [1.0, 198.0])
        );
    }
}
