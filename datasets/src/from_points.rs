//! A labeled point cloud as a scene of Gaussians: every point becomes a small disc.

use crate::DataError;
use crate::error::{check_length, require};
use rayon::prelude::*;
use scenesplat_kernels::grid_sample::GridSampleError;
use scenesplat_kernels::neighbors::{KdTree, Neighbor, NeighborError};
use scenesplat_scene::GaussianScene;
use scenesplat_scene::gaussian_scene::u8_to_dc;
use scenesplat_scene::quaternion::quat_from_z_to;

/// Neighbors whose mean distance is the local spacing.
const SPACING_NEIGHBOURS: usize = 3;

/// Smallest standard deviation, meters: duplicates have no spacing.
const MIN_SCALE: f64 = 1e-4;

/// The normal of a point without a surface around it.
const UP: [f64; 3] = [0.0, 0.0, 1.0];

/// Points of a surface with what is known about each.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SurfacePoints {
    /// Positions, meters. `[N, 3]`
    pub coord: Vec<[f32; 3]>,
    /// sRGB bytes; mid gray if absent. `[N, 3]`
    pub color: Option<Vec<[u8; 3]>>,
    /// Surface normals of any length; estimated where absent, zero or not finite. `[N, 3]`
    pub normal: Option<Vec<[f32; 3]>>,
    /// Class index, `-1` = no label. `[N]`
    pub segment: Option<Vec<i32>>,
    /// Instance id, `-1` = none. `[N]`
    pub instance: Option<Vec<i32>>,
}

/// How points become Gaussians.
#[derive(Debug, Clone, PartialEq)]
pub struct PointSettings {
    /// Opacity of every Gaussian, inside 0..1.
    pub opacity: f32,
    /// Standard deviation in the surface, in units of the local spacing.
    pub spread: f32,
    /// Standard deviation along the normal, in units of the one in the surface.
    pub thickness: f32,
    /// Largest standard deviation, meters: keeps isolated points small.
    pub max_scale: f32,
    /// Neighbors that estimate a missing normal.
    pub normal_neighbours: usize,
}

impl Default for PointSettings {
    fn default() -> Self {
        Self { opacity: 0.95, spread: 1.0, thickness: 0.1, max_scale: 0.1, normal_neighbours: 16 }
    }
}

/// The scene, and what had to be guessed.
#[derive(Debug, Clone, PartialEq)]
pub struct ConvertedPoints {
    /// One Gaussian per point, in the order of the points.
    pub scene: GaussianScene,
    /// Points whose normal was estimated from their neighbors.
    pub num_estimated_normals: usize,
    /// Points without a normal and without a surface around them (alone, all neighbors on a line
    /// or in one place): they became balls, with normal +z.
    pub num_balls: usize,
}

/// Turns points into Gaussians: discs as wide as the local spacing, thin along the normal.
///
/// In the surface `σ = spread ·` mean distance to the 3 nearest other points, at most `max_scale`;
/// a single point gets `max_scale`. Along the normal `thickness · σ`. The quaternion turns z to
/// the normal by the shortest way.
///
/// # Errors
/// If arrays have different lengths, a coordinate is not finite, or a setting is out of range.
pub fn gaussians_from_points(
    points: &SurfacePoints,
    settings: &PointSettings,
) -> Result<ConvertedPoints, DataError> {
    settings.check()?;
    let n = points.coord.len();
    for (field, rows) in [
        ("color", points.color.as_ref().map(Vec::len)),
        ("normal", points.normal.as_ref().map(Vec::len)),
        ("segment", points.segment.as_ref().map(Vec::len)),
        ("instance", points.instance.as_ref().map(Vec::len)),
    ] {
        check_length(field, n, rows.unwrap_or(n))?;
    }

    let given = |row: usize| points.normal.as_ref().and_then(|normal| unit_normal(normal[row]));
    let k = match (0..n).into_par_iter().all(|row| given(row).is_some()) {
        true => SPACING_NEIGHBOURS,
        false => settings.normal_neighbours.max(SPACING_NEIGHBOURS),
    };
    let discs: Vec<Disc> = map_around(&points.coord, k, |row, found| {
        let (normal, origin) = match given(row) {
            Some(normal) => (normal, NormalOrigin::Given),
            None => match plane_normal(&points.coord, row, found) {
                Some(normal) => (normal, NormalOrigin::Estimated),
                None => (UP, NormalOrigin::Unknown),
            },
        };
        Disc { scale: settings.scale(found), normal, origin }
    })?;

    let thickness = f64::from(settings.thickness);
    let log_scale = |disc: &Disc| {
        let thin = if disc.origin == NormalOrigin::Unknown { 1.0 } else { thickness };
        let [wide, thin] = [disc.scale, disc.scale * thin].map(|s| s.ln() as f32);
        [wide, wide, thin]
    };
    let opacity = f64::from(settings.opacity);
    let count = |origin| discs.iter().filter(|d| d.origin == origin).count();
    let scene = GaussianScene {
        coord: points.coord.clone(),
        log_scale: discs.iter().map(log_scale).collect(),
        quat: discs.iter().map(|d| quat_from_z_to(d.normal).map(|v| v as f32)).collect(),
        opacity_logit: vec![(opacity / (1.0 - opacity)).ln() as f32; n],
        sh_dc: match &points.color {
            Some(color) => color.iter().map(|c| c.map(u8_to_dc)).collect(),
            None => vec![[0.0; 3]; n],
        },
        normal: Some(discs.iter().map(|d| d.normal.map(|v| v as f32)).collect()),
        segment: points.segment.clone(),
        instance: points.instance.clone(),
        ..GaussianScene::default()
    };
    Ok(ConvertedPoints {
        scene,
        num_estimated_normals: count(NormalOrigin::Estimated),
        num_balls: count(NormalOrigin::Unknown),
    })
}

/// Normals of a surface given by points only: the direction in which the `neighbours` nearest
/// points spread least. `[N, 3]`, unit.
///
/// The sign is a convention: toward +z, then +y, then +x. Points without a surface around them
/// get +z.
///
/// # Errors
/// If a coordinate is not finite or there are too many points.
pub fn estimate_normals(coord: &[[f32; 3]], neighbours: usize) -> Result<Vec<[f32; 3]>, DataError> {
    map_around(coord, neighbours, |row, found| {
        plane_normal(coord, row, found).unwrap_or(UP).map(|v| v as f32)
    })
}

/// Neighbors among points.
pub(crate) fn tree(coord: &[[f32; 3]]) -> Result<KdTree, DataError> {
    KdTree::new(coord).map_err(|error| match error {
        NeighborError::NotFinite { row, value: [x, y, z] } => {
            let value = [x, y].into_iter().find(|v| !v.is_finite()).unwrap_or(z);
            DataError::NotFinite { row, field: "coord", value }
        }
        NeighborError::TooManyRows { rows } => GridSampleError::TooManyRows { rows }.into(),
    })
}

/// `answer(row, its k nearest other points)` for every row; all others if there are fewer.
fn map_around<T: Default + Send>(
    coord: &[[f32; 3]],
    k: usize,
    answer: impl Fn(usize, &[Neighbor]) -> T + Sync,
) -> Result<Vec<T>, DataError> {
    let tree = tree(coord)?;
    // Among k + 1 neighbors a point finds itself, unless that many others share its place.
    let answers = tree.map_nearest(coord, k.saturating_add(1), Vec::new, |others, row, found| {
        others.clear();
        others.extend(found.iter().filter(|n| n.row as usize != row).take(k));
        answer(row, others)
    });
    Ok(answers)
}

#[derive(Clone, Copy, PartialEq, Eq, Default)]
enum NormalOrigin {
    Given,
    Estimated,
    #[default]
    Unknown,
}

#[derive(Default)]
struct Disc {
    scale: f64,
    normal: [f64; 3],
    origin: NormalOrigin,
}

impl PointSettings {
    fn check(&self) -> Result<(), DataError> {
        let ok = self.opacity > 0.0 && self.opacity < 1.0;
        require(ok, "opacity", self.opacity, "a number inside 0..1")?;
        for (setting, value) in
            [("spread", self.spread), ("thickness", self.thickness), ("max_scale", self.max_scale)]
        {
            let ok = value.is_finite() && value > 0.0;
            require(ok, setting, value, "a finite number above 0")?;
        }
        Ok(())
    }

    fn scale(&self, found: &[Neighbor]) -> f64 {
        let near = &found[..found.len().min(SPACING_NEIGHBOURS)];
        let max = f64::from(self.max_scale);
        if near.is_empty() {
            return max;
        }
        let spacing =
            near.iter().map(|n| n.distance_squared.sqrt()).sum::<f64>() / near.len() as f64;
        (spacing * f64::from(self.spread)).max(MIN_SCALE).min(max)
    }
}

fn unit_normal(normal: [f32; 3]) -> Option<[f64; 3]> {
    let normal = normal.map(f64::from);
    let norm = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
    (norm.is_finite() && norm > 1e-12).then(|| normal.map(|v| v / norm))
}

/// Direction of least spread of a point and its neighbors; `None` if they span no plane.
fn plane_normal(coord: &[[f32; 3]], row: usize, found: &[Neighbor]) -> Option<[f64; 3]> {
    let centre = coord[row].map(f64::from);
    // Relative to the point, so that coordinates far from the origin keep their digits.
    let relative = |r: u32| -> [f64; 3] {
        std::array::from_fn(|a| f64::from(coord[r as usize][a]) - centre[a])
    };
    let n = found.len() as f64 + 1.0;
    let mut mean = [0.0; 3];
    for neighbor in found {
        let p = relative(neighbor.row);
        for a in 0..3 {
            mean[a] += p[a] / n;
        }
    }
    let mut covariance = [[0.0; 3]; 3];
    for r in found.iter().map(|n| n.row).chain([row as u32]) {
        let p = relative(r);
        for a in 0..3 {
            for b in 0..3 {
                covariance[a][b] += (p[a] - mean[a]) * (p[b] - mean[b]) / n;
            }
        }
    }
    let (values, vectors) = symmetric_eigen(covariance);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let [least, middle, most] = order;
    // A line of points has two free directions; the limit is far above rounding of f32 inputs
    // and far below any surface.
    if !(values[most] > 0.0 && values[middle] > 1e-6 * values[most]) {
        return None;
    }
    let normal: [f64; 3] = std::array::from_fn(|a| vectors[a][least]);
    let norm = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
    let leading = [2, 1, 0].map(|a| normal[a] / norm).into_iter().find(|v| v.abs() > 1e-6)?;
    Some(normal.map(|v| v / norm * leading.signum()))
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix, by Jacobi rotations.
pub(crate) fn symmetric_eigen(mut m: [[f64; 3]; 3]) -> ([f64; 3], [[f64; 3]; 3]) {
    let mut v = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    // Convergence is quadratic: 4 to 6 sweeps reach the last bit.
    for _ in 0..12 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if m[p][q] == 0.0 {
                continue;
            }
            let theta = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            for row in &mut m {
                (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
            }
            let (row_p, row_q) = (m[p], m[q]);
            m[p] = std::array::from_fn(|k| c * row_p[k] - s * row_q[k]);
            m[q] = std::array::from_fn(|k| s * row_p[k] + c * row_q[k]);
            for row in &mut v {
                (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
            }
        }
    }
    ([m[0][0], m[1][1], m[2][2]], v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::{direction, sample_rng, unit};

    /// A flat square lattice with the given spacing, turned so that its normal is `normal`.
    fn lattice(side: usize, spacing: f64, normal: [f64; 3]) -> Vec<[f32; 3]> {
        let q = quat_from_z_to(normal);
        (0..side * side)
            .map(|i| {
                let p = [(i % side) as f64 * spacing, (i / side) as f64 * spacing, 0.0];
                rotate(q, p).map(|v| v as f32)
            })
            .collect()
    }

    fn rotate([w, x, y, z]: [f64; 4], p: [f64; 3]) -> [f64; 3] {
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let t = cross([x, y, z], p).map(|v| 2.0 * v);
        let u = cross([x, y, z], t);
        std::array::from_fn(|a| p[a] + w * t[a] + u[a])
    }

    #[test]
    fn quaternion_turns_z_to_the_normal() {
        let mut rng = sample_rng(1, 0, 0);
        let mut normals: Vec<[f64; 3]> = (0..200).map(|_| direction(&mut rng)).collect();
        normals.extend([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]);
        for normal in normals {
            let q = quat_from_z_to(normal);
            assert!(q[0] >= 0.0);
            let turned = rotate(q, [0.0, 0.0, 1.0]);
            for a in 0..3 {
                assert!((turned[a] - normal[a]).abs() < 1e-6, "{normal:?} {turned:?}");
            }
        }
    }

    #[test]
    fn a_lattice_becomes_discs_in_its_plane() {
        let normal = [0.6, 0.0, 0.8];
        let coord = lattice(20, 0.03, normal);
        let cloud = SurfacePoints {
            color: Some(vec![[10, 200, 255]; coord.len()]),
            segment: Some(vec![4; coord.len()]),
            instance: Some(vec![9; coord.len()]),
            coord,
            ..SurfacePoints::default()
        };
        let out = gaussians_from_points(&cloud, &PointSettings::default()).unwrap();
        out.scene.check_rows().unwrap();
        assert_eq!((out.num_estimated_normals, out.num_balls), (400, 0));
        let row = 10 * 20 + 10;
        let scale = out.scene.scale(row);
        assert!((scale[0] - 0.03).abs() < 1e-5 && (scale[2] - 0.003).abs() < 1e-6, "{scale:?}");
        assert!((out.scene.opacity(row) - 0.95).abs() < 1e-6);
        assert_eq!(out.scene.color_u8(row), [10, 200, 255]);
        assert_eq!((out.scene.segment.unwrap()[row], out.scene.instance.unwrap()[row]), (4, 9));
        for found in out.scene.normal.unwrap() {
            assert!((f64::from(found[0]) - 0.6).abs() < 1e-4, "{found:?}");
        }
    }

    #[test]
    fn given_normals_win_and_bad_ones_are_estimated() {
        let coord = lattice(8, 0.02, [0.0, 0.0, 1.0]);
        let mut normal = vec![[0.0, 3.0, 0.0]; 64];
        normal[5] = [0.0; 3];
        normal[6] = [f32::NAN, 0.0, 0.0];
        let cloud = SurfacePoints { coord, normal: Some(normal), ..SurfacePoints::default() };
        let out = gaussians_from_points(&cloud, &PointSettings::default()).unwrap();
        assert_eq!(out.num_estimated_normals, 2);
        let normal = out.scene.normal.unwrap();
        assert_eq!(normal[0], [0.0, 1.0, 0.0]);
        assert!(normal[5][2] > 0.999 && normal[6][2] > 0.999);
    }

    #[test]
    fn too_few_points_for_a_plane_become_balls() {
        let line: Vec<[f32; 3]> = (0..30).map(|i| [i as f32 * 0.01, 0.0, 0.0]).collect();
        for coord in [vec![], vec![[1.0; 3]], vec![[0.0; 3], [0.1; 3]], vec![[2.0; 3]; 40], line] {
            let n = coord.len();
            let cloud = SurfacePoints { coord, ..SurfacePoints::default() };
            let out = gaussians_from_points(&cloud, &PointSettings::default()).unwrap();
            assert_eq!(out.num_balls, n);
            for row in 0..n {
                let [a, b, c] = out.scene.scale(row);
                assert!(a == b && b == c && (0.99e-4..=0.101).contains(&a), "{a}");
                assert_eq!(out.scene.quat[row], [1.0, 0.0, 0.0, 0.0]);
            }
        }
    }

    #[test]
    fn an_outlier_keeps_a_small_gaussian() {
        let mut coord = lattice(10, 0.02, [0.0, 0.0, 1.0]);
        coord.push([1000.0, 0.0, 0.0]);
        let cloud = SurfacePoints { coord, ..SurfacePoints::default() };
        let out = gaussians_from_points(&cloud, &PointSettings::default()).unwrap();
        assert!(out.scene.scale(100).iter().all(|&s| s <= 0.1001));
    }

    #[test]
    fn wrong_input_is_named() {
        let settings = PointSettings::default();
        let cloud =
            SurfacePoints { coord: vec![[0.0; 3], [0.0, f32::NAN, 0.0]], ..Default::default() };
        let error = gaussians_from_points(&cloud, &settings).unwrap_err();
        assert!(matches!(error, DataError::NotFinite { row: 1, field: "coord", .. }), "{error}");
        let cloud =
            SurfacePoints { coord: vec![[0.0; 3]], segment: Some(vec![]), ..Default::default() };
        assert!(matches!(
            gaussians_from_points(&cloud, &settings),
            Err(DataError::Length { field: "segment", expected: 1, got: 0 })
        ));
        for bad in [
            PointSettings { opacity: 1.0, ..settings.clone() },
            PointSettings { opacity: f32::NAN, ..settings.clone() },
            PointSettings { thickness: 0.0, ..settings.clone() },
            PointSettings { max_scale: f32::INFINITY, ..settings },
        ] {
            let error = gaussians_from_points(&SurfacePoints::default(), &bad);
            assert!(matches!(error, Err(DataError::Setting { .. })));
        }
    }

    #[test]
    fn eigenvectors_diagonalise() {
        let mut rng = sample_rng(2, 0, 0);
        for _ in 0..100 {
            let mut m = [[0.0; 3]; 3];
            for (a, b) in [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)] {
                m[a][b] = unit(&mut rng) - 0.5;
                m[b][a] = m[a][b];
            }
            let (values, vectors) = symmetric_eigen(m);
            for k in 0..3 {
                for a in 0..3 {
                    let product: f64 = (0..3).map(|b| m[a][b] * vectors[b][k]).sum();
                    assert!((product - values[k] * vectors[a][k]).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn estimated_normals_do_not_depend_on_threads() {
        let mut rng = sample_rng(3, 0, 0);
        let coord: Vec<[f32; 3]> =
            (0..40_000).map(|_| direction(&mut rng).map(|v| v as f32)).collect();
        let of = || estimate_normals(&coord, 16).unwrap();
        let normals = crate::transforms::testing::on_threads([1, 3], of);
        // A sphere's normal is its radius.
        for (n, c) in normals.iter().zip(&coord).step_by(97) {
            let dot: f32 = n.iter().zip(c).map(|(a, b)| a * b).sum();
            assert!(dot.abs() > 0.99, "{dot}");
        }
    }
}
