//! What is done to a scene before a network reads it: networks know rooms with +z up, in metres.
//!
//! A room that lies on its side loses most labels, and nothing in its file says how it lies. So up
//! and unit are estimated (as [`inspect`](crate::inspect::inspect) does); where the evidence suffices, a copy is
//! turned and scaled for the network alone, and where it does not, a [`Remark`] says so. Outputs
//! belong to rows, so they need no turning back. The floor needs no step of its own: voxels are
//! counted from the lowest Gaussian, and heights from the ground of the copy.

use crate::inspect::{
    LengthUnit, UnitGuess, guess_unit, is_surely_no_metre, may_be_no_metre, usual_spacing,
};
use rayon::prelude::*;
use scenesplat_scene::similarity::{matrix_to_quat, quat_product};
use scenesplat_scene::{Bounds, GaussianScene, UpAxis, UpGuess, guess_up_within, robust_bounds};
use serde::Serialize;
use std::borrow::Cow;

/// With fewer Gaussians neither up nor unit is judged.
const FEWEST_ROWS: usize = 100;

/// What the user knows about a scene.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct AlignmentSettings {
    /// Which way is up; estimated if not given.
    pub up: Option<UpAxis>,
    /// What one unit of the scene is, metres; estimated if not given. Finite, above 0.
    pub metres_per_unit: Option<f64>,
    /// Leaves the scene as it is, whatever is known or seen.
    pub as_is: bool,
}

/// How a scene is changed for a network, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Alignment {
    /// Which way is up in the scene.
    pub up: UpGuess,
    /// What one unit is, where it is not clearly a metre.
    pub unit: Option<UnitGuess>,
    /// The direction that is turned to +z; +z for none.
    pub turned_from: UpAxis,
    /// Factor that brings the scene to metres; 1 for none.
    pub scale: f64,
    /// What a user must know, the most important first.
    pub remarks: Vec<Remark>,
}

/// Something about a scene that changes what a network makes of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "what")]
pub enum Remark {
    /// A turned copy is read.
    Turned {
        /// What was up.
        from: UpAxis,
    },
    /// Up is not clear; the scene is read as if it were +z.
    UpUnclear {
        /// The likeliest direction.
        likely: UpAxis,
        /// How sure.
        confidence: f64,
    },
    /// A scaled copy is read.
    Scaled {
        /// Metres per unit.
        by: f64,
    },
    /// The unit seems to be another one; the scene is read as if it were the metre.
    UnitUnclear {
        /// The likeliest unit.
        likely: LengthUnit,
        /// How sure.
        confidence: f64,
    },
}

impl Remark {
    /// Whether nothing was done about it, so that labels may be wrong.
    pub fn is_warning(&self) -> bool {
        matches!(self, Self::UpUnclear { .. } | Self::UnitUnclear { .. })
    }
}

impl Alignment {
    /// Looks at a scene. The same for any number of threads.
    pub fn of(scene: &GaussianScene, settings: &AlignmentSettings) -> Self {
        let robust = robust_bounds(&scene.coord);
        let is_judged = scene.len() >= FEWEST_ROWS;
        let mut alignment = Self {
            up: settings.up.map_or_else(|| guess_up_within(scene, &robust), UpGuess::given),
            unit: None,
            turned_from: UpAxis::PlusZ,
            scale: 1.0,
            remarks: Vec::new(),
        };
        if settings.as_is {
            return alignment;
        }
        if settings.up.is_some() || is_judged {
            alignment.decide_up();
        }
        match settings.metres_per_unit {
            Some(metres) => alignment.set_scale(metres),
            None if is_judged && may_be_no_metre(&robust) => {
                alignment.decide_unit(&robust, usual_spacing(&scene.coord));
            }
            None => {}
        }
        alignment.remarks.sort_by_key(|remark| !remark.is_warning());
        alignment
    }

    fn decide_up(&mut self) {
        let UpGuess { axis, confidence, .. } = self.up;
        if !self.up.is_sure() {
            self.remarks.push(Remark::UpUnclear { likely: axis, confidence });
        } else if axis != UpAxis::PlusZ {
            self.turned_from = axis;
            self.remarks.push(Remark::Turned { from: axis });
        }
    }

    fn decide_unit(&mut self, robust: &Bounds, spacing: Option<f64>) {
        let Some(guess) = guess_unit(robust, spacing) else { return };
        if guess.unit == LengthUnit::Metre {
            return;
        }
        let (likely, confidence) = (guess.unit, guess.confidence);
        if is_surely_no_metre(&guess, robust) {
            self.set_scale(likely.metres());
        } else {
            self.remarks.push(Remark::UnitUnclear { likely, confidence });
        }
        self.unit = Some(guess);
    }

    fn set_scale(&mut self, metres: f64) {
        if metres != 1.0 {
            self.scale = metres;
            self.remarks.push(Remark::Scaled { by: metres });
        }
    }

    /// Whether the network reads the scene itself.
    pub fn is_identity(&self) -> bool {
        self.turned_from == UpAxis::PlusZ && self.scale == 1.0
    }

    /// The scene as the network reads it: itself, bit for bit, if nothing is to be done, else a copy
    /// of what networks read (no labels, no higher harmonics).
    pub fn apply<'a>(&self, scene: &'a GaussianScene) -> Cow<'a, GaussianScene> {
        if self.is_identity() {
            return Cow::Borrowed(scene);
        }
        let rotation = self.turned_from.upright();
        let turn = matrix_to_quat(&rotation);
        let is_turned = self.turned_from != UpAxis::PlusZ;
        // A row of the rotation has one ±1 and two zeros: no rounding.
        let direction =
            |v: &[f32; 3]| rotation.map(|r| (0..3).map(|a| r[a] * f64::from(v[a])).sum::<f64>());
        let add = self.scale.ln();
        Cow::Owned(GaussianScene {
            coord: scene
                .coord
                .par_iter()
                .map(|p| direction(p).map(|v| (self.scale * v) as f32))
                .collect(),
            log_scale: scene
                .log_scale
                .par_iter()
                .map(|s| s.map(|s| (f64::from(s) + add) as f32))
                .collect(),
            quat: scene
                .quat
                .par_iter()
                .map(|&q| if is_turned { turned(turn, q) } else { q })
                .collect(),
            normal: scene
                .normal
                .as_ref()
                .map(|n| n.par_iter().map(|n| direction(n).map(|v| v as f32)).collect()),
            opacity_logit: scene.opacity_logit.clone(),
            sh_dc: scene.sh_dc.clone(),
            ..GaussianScene::default()
        })
    }
}

/// The quaternion of an orientation that is turned. Where `w` is 0 but for rounding, both signs fit
/// `w ≥ 0`; the largest component decides, as in generated rooms, so that a wall's Gaussians agree.
fn turned(turn: [f64; 4], quat: [f32; 4]) -> [f32; 4] {
    const ROUNDING: f32 = 1e-6;
    let q = quat_product(turn, quat);
    let largest = q.iter().copied().fold(0.0f32, |a, v| if v.abs() > a.abs() { v } else { a });
    if q[0].abs() < ROUNDING && largest < 0.0 { q.map(|v| -v) } else { q }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_rooms::{SyntheticRoomSettings, generate};
    use scenesplat_scene::Similarity;

    fn room() -> GaussianScene {
        let settings = SyntheticRoomSettings { num_gaussians: Some(8_000), ..Default::default() };
        generate(&settings).unwrap().scene
    }

    /// The scene with another direction up.
    fn lying(scene: &GaussianScene, up: UpAxis) -> GaussianScene {
        let m = up.upright();
        let rotation = [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[j][i]));
        let mut scene = scene.clone();
        scene.transform(&Similarity { rotation, scale: 1.0, translation: [0.0; 3] });
        scene
    }

    #[test]
    fn an_upright_room_in_metres_is_read_as_it_is() {
        let room = room();
        let alignment = Alignment::of(&room, &AlignmentSettings::default());
        assert!(alignment.is_identity() && alignment.remarks.is_empty(), "{alignment:?}");
        assert!(matches!(alignment.apply(&room), Cow::Borrowed(_)));
    }

    #[test]
    fn a_turned_room_comes_back_with_its_orientations() {
        let room = room();
        for up in UpAxis::ALL.into_iter().filter(|up| *up != UpAxis::PlusZ) {
            let alignment = Alignment::of(&lying(&room, up), &AlignmentSettings::default());
            assert_eq!(alignment.turned_from, up);
            assert_eq!(alignment.remarks, [Remark::Turned { from: up }]);
            let lying = lying(&room, up);
            let back = alignment.apply(&lying);
            assert_eq!(back.coord, room.coord, "{up}");
            // The same ellipsoid: |w| of the difference of two rotations is 1. Half a turn may
            // change the order of a product, which an ellipsoid does not show.
            let near = |a: &[f32; 4], b: &[f32; 4]| {
                a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>().abs() > 1.0 - 1e-5
            };
            if up != UpAxis::MinusZ {
                assert!(back.quat.iter().zip(&room.quat).all(|(a, b)| near(a, b)), "{up}");
            }
            assert_eq!(back.normal, room.normal, "{up}");
        }
    }

    #[test]
    fn millimetres_become_metres_and_what_is_unclear_is_said() {
        let room = room();
        let scaled = |by: f64| {
            let mut scene = room.clone();
            let rotation = UpAxis::PlusZ.upright();
            scene.transform(&Similarity { rotation, scale: by, translation: [0.0; 3] });
            scene
        };
        let mm = scaled(1000.0);
        let alignment = Alignment::of(&mm, &AlignmentSettings::default());
        assert_eq!(alignment.remarks, [Remark::Scaled { by: 0.001 }]);
        let back = alignment.apply(&mm);
        let close = |a: f32, b: f32| (a - b).abs() < 1e-4;
        assert!((0..3).all(|a| close(back.coord[7][a], room.coord[7][a])));
        assert!((0..3).all(|a| close(back.log_scale[7][a], room.log_scale[7][a])));
        for (by, unit) in [(100.0, LengthUnit::Centimetre), (0.01, LengthUnit::Kilometre)] {
            let alignment = Alignment::of(&scaled(by), &AlignmentSettings::default());
            assert!(alignment.is_identity());
            let [remark @ Remark::UnitUnclear { likely, .. }] = alignment.remarks[..] else {
                panic!("{alignment:?}")
            };
            assert_eq!((likely, remark.is_warning()), (unit, true));
        }
        let given = AlignmentSettings { metres_per_unit: Some(0.01), ..Default::default() };
        assert_eq!(Alignment::of(&scaled(100.0), &given).scale, 0.01);
    }

    #[test]
    fn the_user_decides() {
        let room = room();
        let lying = lying(&room, UpAxis::MinusY);
        let as_is =
            AlignmentSettings { as_is: true, up: Some(UpAxis::MinusY), metres_per_unit: Some(2.0) };
        let alignment = Alignment::of(&lying, &as_is);
        assert!(alignment.is_identity() && alignment.remarks.is_empty(), "{alignment:?}");
        assert_eq!(alignment.up.axis, UpAxis::MinusY);
        let given = AlignmentSettings { up: Some(UpAxis::PlusX), ..Default::default() };
        assert_eq!(Alignment::of(&room, &given).turned_from, UpAxis::PlusX);
    }

    #[test]
    fn what_cannot_be_told_is_a_warning_unless_there_is_next_to_nothing() {
        let ball = |n: usize| {
            let mut scene = GaussianScene::default();
            for i in 0..n {
                // Points on a sphere: no side differs from another.
                let z = 1.0 - 2.0 * (i as f32 + 0.5) / n as f32;
                let (r, phi) = ((1.0 - z * z).sqrt(), 2.4 * i as f32);
                scene.coord.push([r * phi.cos(), r * phi.sin(), z]);
            }
            scene.log_scale = vec![[-4.0; 3]; n];
            scene.quat = vec![[1.0, 0.0, 0.0, 0.0]; n];
            scene.opacity_logit = vec![2.0; n];
            scene.sh_dc = vec![[0.0; 3]; n];
            scene
        };
        let alignment = Alignment::of(&ball(3000), &AlignmentSettings::default());
        assert!(alignment.is_identity());
        assert!(matches!(alignment.remarks[..], [Remark::UpUnclear { .. }]), "{alignment:?}");
        assert!(Alignment::of(&ball(50), &AlignmentSettings::default()).remarks.is_empty());
        assert!(Alignment::of(&ball(0), &AlignmentSettings::default()).is_identity());
    }
}
