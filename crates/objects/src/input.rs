//! What objects are looked for in.

use crate::error::{ObjectError, Result};
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
    /// What one unit of the scene is, metres.
    pub metres_per_unit: f64,
    /// Height of the floor along up, metres, where it is known; else it is looked for.
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
            if let Some(got) = got.filter(|&got| got != expected) {
                return Err(ObjectError::Rows { field, expected, got });
            }
        }
        let names = self.names.len();
        let nameless = |l: &i32| usize::try_from(*l).is_ok_and(|l| l >= names);
        if let Some(row) = self.labels.iter().position(nameless) {
            return Err(ObjectError::Label { row, label: self.labels[row], names });
        }
        if !(self.metres_per_unit.is_finite() && self.metres_per_unit > 0.0) {
            return Err(ObjectError::Setting {
                setting: "metres_per_unit",
                value: self.metres_per_unit.to_string(),
                expected: "a finite number above 0",
            });
        }
        if !is_rotation(&self.upright) {
            return Err(ObjectError::Setting {
                setting: "upright",
                value: format!("{:?}", self.upright),
                expected: "a rotation: three axes of length 1, at right angles",
            });
        }
        if let Some(floor) = self.floor.filter(|f| !f.is_finite()) {
            return Err(ObjectError::Setting {
                setting: "floor",
                value: floor.to_string(),
                expected: "a finite height, metres",
            });
        }
        Ok(())
    }

    /// Positions in metres with +z up.
    pub(crate) fn upright(&self) -> Vec<[f32; 3]> {
        upright(&self.scene.coord, &self.upright, self.metres_per_unit)
    }

    /// A place of the upright frame, metres, in the frame and unit of the scene.
    pub(crate) fn to_scene(self, p: [f64; 3]) -> [f64; 3] {
        let turn = self.upright;
        [0, 1, 2].map(|a| {
            let v = turn[0][a] * p[0] + turn[1][a] * p[1] + turn[2][a] * p[2];
            // Adding 0 makes no −0 of a product with 0.
            v / self.metres_per_unit + 0.0
        })
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

/// Places in metres with +z up.
pub(crate) fn upright(coord: &[[f32; 3]], turn: &Matrix3, metres_per_unit: f64) -> Vec<[f32; 3]> {
    let place = |c: &[f32; 3]| {
        let c = c.map(|v| f64::from(v) * metres_per_unit);
        turn.map(|row| (row[0] * c[0] + row[1] * c[1] + row[2] * c[2]) as f32)
    };
    coord.iter().map(place).collect()
}

fn is_rotation(m: &Matrix3) -> bool {
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let [x, y, z] = *m;
    let third = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
    let near = |a: f64, b: f64| (a - b).abs() < 1e-6;
    m.iter().all(|row| near(dot(*row, *row), 1.0))
        && near(dot(x, y), 0.0)
        && near(dot(third, z), 1.0)
}
