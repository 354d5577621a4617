//! What objects are looked for in.

use crate::error::{Result, check_labels, check_rows, check_setting};
use glam::{DMat3, DVec3};
use scenesplat_scene::GaussianScene;
use scenesplat_scene::frame::Matrix3;

/// Adds the feature of a Gaussian (first argument) to a row of sums.
pub type AddFeature<'a> = &'a (dyn Fn(usize, &mut [f32]) + Sync);

/// What is known of a scene.
#[derive(Clone, Copy)]
pub struct ObjectInput<'a> {
    /// The Gaussians.
    pub scene: &'a GaussianScene,
    /// Class of each, −1 = none. `[N]`
    pub labels: &'a [i32],
    /// How sure the class is. `[N]`
    pub scores: Option<&'a [f32]>,
    /// Instances that are known already, −1 = none; then none are looked for. `[N]`
    pub instances: Option<&'a [i32]>,
    /// Width of features and what adds them, if any speak against joining what touches.
    pub features: Option<(usize, AddFeature<'a>)>,
    /// Names of the classes.
    pub names: &'a [String],
    /// The rotation that brings +z up: its rows are the axes of the upright frame.
    pub upright: Matrix3,
    /// What one unit of the scene is, meters.
    pub metres_per_unit: f64,
    /// Height of the floor along up, meters, where it is known; else it is looked for.
    pub floor: Option<f64>,
}

impl ObjectInput<'_> {
    pub(crate) fn check(&self) -> Result<()> {
        let expected = self.scene.len();
        let lens = [
            ("labels", Some(self.labels.len())),
            ("scores", self.scores.map(<[f32]>::len)),
            ("instances", self.instances.map(<[i32]>::len)),
        ];
        for (field, got) in lens {
            check_rows(field, expected, got.unwrap_or(expected))?;
        }
        check_labels(self.labels, self.names.len())?;
        let (unit, upright) = (self.metres_per_unit, self.upright);
        let fits = unit.is_finite() && unit > 0.0;
        check_setting(fits, "metres_per_unit", unit, "a finite number above 0")?;
        let axes = "a rotation: three axes of length 1, at right angles";
        check_setting(is_rotation(&upright), "upright", format!("{upright:?}"), axes)?;
        let floor = self.floor.unwrap_or_default();
        check_setting(floor.is_finite(), "floor", floor, "a finite height, meters")
    }

    /// Positions in meters with +z up.
    pub(crate) fn upright(&self) -> Vec<[f32; 3]> {
        upright(&self.scene.coord, &self.upright, self.metres_per_unit)
    }

    /// A place of the scene in meters with +z up.
    pub(crate) fn to_upright(self, p: [f32; 3]) -> [f64; 3] {
        let p = DVec3::from(p.map(f64::from)) * self.metres_per_unit;
        self.upright.map(|row| DVec3::from(row).dot(p))
    }

    /// The axes of a Gaussian with +z up, and its standard deviations along them in meters; points have none.
    pub(crate) fn upright_axes(self, row: usize) -> ([[f64; 3]; 3], [f64; 3]) {
        let scene = self.scene;
        let (Some(scale), Some(quat)) = (scene.log_scale.get(row), scene.quat.get(row)) else {
            return (DMat3::IDENTITY.to_cols_array_2d(), [0.0; 3]);
        };
        let m = scenesplat_scene::vector::rotation(*quat).map(|r| r.map(f64::from));
        let axis = |k: usize| {
            let axis = DVec3::new(m[0][k], m[1][k], m[2][k]);
            self.upright.map(|row| DVec3::from(row).dot(axis))
        };
        let size = |k: usize| f64::from(scale[k]).exp() * self.metres_per_unit;
        ([0, 1, 2].map(axis), [0, 1, 2].map(size))
    }

    /// A place of the upright frame, meters, in the frame and unit of the scene.
    pub(crate) fn to_scene(self, p: [f64; 3]) -> [f64; 3] {
        let place = DMat3::from_cols_array_2d(&self.upright) * DVec3::from(p);
        // Adding 0 makes no −0 of a product with 0.
        (place / self.metres_per_unit + 0.0).to_array()
    }

    /// Normals of flat Gaussians with +z up: the shortest axis, `None` where a Gaussian is not flat.
    pub(crate) fn upright_normal(&self, row: usize) -> Option<[f32; 3]> {
        let scale = self.scene.log_scale.get(row)?;
        let shortest = (0..3).fold(0, |s, a| if scale[a] < scale[s] { a } else { s });
        let others = [(shortest + 1) % 3, (shortest + 2) % 3];
        let next = scale[others[0]].min(scale[others[1]]);
        // As elsewhere in the workspace: flat is e times as thin as the next axis.
        let thin = next - scale[shortest];
        if thin.is_nan() || thin <= 1.0 {
            return None;
        }
        let m = scenesplat_scene::vector::rotation(*self.scene.quat.get(row)?);
        let n = [m[0][shortest], m[1][shortest], m[2][shortest]];
        let turn = self.upright.map(|r| r.map(|v| v as f32));
        Some(turn.map(|r| scenesplat_scene::vector::dot(r, n)))
    }
}

/// Places in meters with +z up.
pub(crate) fn upright(coord: &[[f32; 3]], turn: &Matrix3, metres_per_unit: f64) -> Vec<[f32; 3]> {
    let place = |c: &[f32; 3]| {
        let c = DVec3::from(c.map(f64::from)) * metres_per_unit;
        turn.map(|row| DVec3::from(row).dot(c) as f32)
    };
    coord.iter().map(place).collect()
}

fn is_rotation(m: &Matrix3) -> bool {
    let [x, y, z] = m.map(DVec3::from);
    let near = |a: f64, b: f64| (a - b).abs() < 1e-6;
    [x, y, z].iter().all(|row| near(row.length_squared(), 1.0))
        && near(x.dot(y), 0.0)
        && near(x.cross(y).dot(z), 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_has_a_normal_and_a_needle_has_none() {
        let unturned = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let scene = GaussianScene {
            coord: vec![[0.0; 3]; 4],
            log_scale: vec![[-1.0, -5.0, -1.5], [-5.0, -5.0, -1.0], [-5.0, -1.0, -4.5], [-2.0; 3]],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; 4],
            ..GaussianScene::default()
        };
        let input = ObjectInput {
            scene: &scene,
            labels: &[],
            scores: None,
            instances: None,
            features: None,
            names: &[],
            upright: unturned,
            metres_per_unit: 1.0,
            floor: None,
        };
        // The logarithms of the middle and the shortest axis differ by 3.5, 0, 0.5 and 0; above 1 is flat.
        assert_eq!(input.upright_normal(0), Some([0.0, 1.0, 0.0]));
        for row in 1..4 {
            assert_eq!(input.upright_normal(row), None, "{row}");
        }
    }

    const NAMES: [&str; 2] = ["chair", "wall"];

    #[test]
    fn places_and_normals_are_turned_and_scaled_and_back() {
        // Up is −y: x, z and −y of the scene are x, y and z; a unit is half a meter.
        let upright_axes = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]];
        let (half, names) = (std::f32::consts::FRAC_1_SQRT_2, NAMES.map(str::to_owned));
        let scene = GaussianScene {
            coord: vec![[2.0, -4.0, 6.0]; 3],
            // Flat across its own z, x and y.
            log_scale: vec![[-1.0, -2.0, -3.01], [-4.0, -1.0, -2.9], [-1.0, -3.0, -2.0]],
            // A quarter turn about x brings z to −y and y to z.
            quat: vec![[half, half, 0.0, 0.0]; 3],
            ..GaussianScene::default()
        };
        let input = ObjectInput {
            scene: &scene,
            labels: &[0; 3],
            scores: None,
            instances: None,
            features: None,
            names: &names,
            upright: upright_axes,
            metres_per_unit: 0.5,
            floor: Some(0.0),
        };
        assert_eq!(input.upright(), [[1.0, 3.0, 2.0]; 3]);
        assert_eq!(input.to_scene([1.0, 3.0, 2.0]), [2.0, -4.0, 6.0]);
        let near = |row: usize, want: [f32; 3]| {
            let found = input.upright_normal(row).unwrap();
            assert!(found.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-6), "{row}: {found:?}");
        };
        // −y of the scene is up; x stays; the third is thinner by 1 exactly, which is not above.
        near(0, [0.0, 0.0, 1.0]);
        near(1, [1.0, 0.0, 0.0]);
        assert_eq!((input.upright_normal(2), input.upright_normal(3)), (None, None));
        input.check().unwrap();
        let (scores, ids) = ([0.5; 2], [0; 4]);
        let swapped = [upright_axes[1], upright_axes[0], upright_axes[2]];
        let cases = [
            (
                ObjectInput { labels: &[0; 2], ..input },
                "labels: expected 3 rows, one a Gaussian, got 2",
            ),
            (
                ObjectInput { scores: Some(&scores), ..input },
                "scores: expected 3 rows, one a Gaussian, got 2",
            ),
            (
                ObjectInput { instances: Some(&ids), ..input },
                "instances: expected 3 rows, one a Gaussian, got 4",
            ),
            (
                ObjectInput { labels: &[-5, 1, 2], ..input },
                "labels[2] is 2, but there are 2 names; give the names of these labels",
            ),
            (
                ObjectInput { metres_per_unit: 0.0, ..input },
                "metres_per_unit: 0 is not possible, expected a finite number above 0",
            ),
            (
                ObjectInput { metres_per_unit: f64::INFINITY, ..input },
                "metres_per_unit: inf is not possible, expected a finite number above 0",
            ),
            (
                ObjectInput { floor: Some(f64::NAN), ..input },
                "floor: NaN is not possible, expected a finite height, meters",
            ),
        ];
        for (input, want) in cases {
            assert_eq!(input.check().unwrap_err().to_string(), want);
        }
        let skewed = [[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]];
        for upright in [swapped, skewed, upright_axes.map(|row| row.map(|v| 1.1 * v))] {
            let error = ObjectInput { upright, ..input }.check().unwrap_err().to_string();
            assert!(
                error.starts_with("upright: ") && error.ends_with("at right angles"),
                "{error}"
            );
        }
    }
}
