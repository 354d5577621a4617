//! Up by the cameras of a capture: whoever holds one looks up, down and around, but seldom tilts it to a side.

use super::direction::Up;
use glam::{DMat3, DVec3};

/// Mean square of the cosine between up and what is to the right of the cameras: more is no way to hold one.
const MOST_ROLL: f64 = 0.05;

/// The next direction must be so many times worse: cameras that look along one line do not say how they are pitched.
const LEAST_LEAD: f64 = 4.0;

/// Cosine between up and the mean of what is above in the pictures: cameras that are held every way up say nothing.
const LEAST_ABOVE: f64 = 0.3;

/// Rounds of the inverse iteration; each shrinks what is left of the next direction by the lead at least.
const ROUNDS: usize = 40;

/// The direction that is most at right angles to what is to the right of all cameras. `None` of no camera, or where they do not
/// tell.
///
/// `axes`: of each camera, in the world, what is to the right and what is down in its picture, unit vectors.
pub fn up_of_cameras(axes: impl IntoIterator<Item = [[f64; 3]; 2]>) -> Option<Up> {
    let (mut squares, mut above, mut count) = (DMat3::ZERO, DVec3::ZERO, 0.0);
    for [right, down] in axes {
        let right = DVec3::from(right);
        squares += DMat3::from_cols(right * right.x, right * right.y, right * right.z);
        above -= DVec3::from(down);
        count += 1.0;
    }
    let squares = squares * (1.0 / count);
    let above = above.try_normalize()?;
    // Far below what is told apart, so that the inverse is there.
    let inverse = (squares + DMat3::from_diagonal(DVec3::splat(1e-9))).inverse();
    let mut up = above;
    for _ in 0..ROUNDS {
        up = (inverse * up).try_normalize()?;
    }
    let roll = up.dot(squares * up);
    let next = least_across(&squares, up);
    let is_told = roll <= MOST_ROLL && next >= LEAST_LEAD * roll && next >= 1e-3;
    let up = up * up.dot(above).signum();
    if !is_told || up.dot(above) < LEAST_ABOVE { None } else { Up::new(up.to_array()) }
}

/// The least value of a quadratic form at right angles to a direction.
fn least_across(form: &DMat3, direction: DVec3) -> f64 {
    let (u, v) = direction.any_orthonormal_pair();
    let (a, b, c) = (u.dot(*form * u), u.dot(*form * v), v.dot(*form * v));
    (a + c) / 2.0 - ((a - c) / 2.0).hypot(b)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;

    /// A camera that looks at this yaw and pitch with this roll, degrees, in a world whose up is +z; right and down.
    fn camera(yaw: f64, pitch: f64, roll: f64) -> [DVec3; 2] {
        let [yaw, pitch, roll] = [yaw, pitch, roll].map(f64::to_radians);
        let forward = DVec3::new(yaw.cos() * pitch.cos(), yaw.sin() * pitch.cos(), pitch.sin());
        let right = DVec3::new(yaw.sin(), -yaw.cos(), 0.0);
        let down = forward.cross(right);
        [right * roll.cos() + down * roll.sin(), down * roll.cos() - right * roll.sin()]
    }

    fn up_of(cameras: &[[DVec3; 2]], turn: glam::DQuat) -> Option<Up> {
        up_of_cameras(cameras.iter().map(|axes| axes.map(|a| (turn * a).to_array())))
    }

    #[test]
    fn cameras_that_look_down_and_around_say_where_up_is() {
        // All look 30 degrees down, within 100 degrees of one another, a few degrees tilted: the mean of what is above in
        // their pictures is off by 20 degrees and more.
        let cameras: Vec<_> = (0..40)
            .map(|i| {
                let i = f64::from(i);
                camera(2.5 * i, -30.0 + 5.0 * (i * 1.7).sin(), 4.0 * (i * 0.9).sin())
            })
            .collect();
        for turn in [glam::DQuat::IDENTITY, glam::DQuat::from_xyzw(0.3, -0.5, 0.2, 0.8).normalize()]
        {
            let up = up_of(&cameras, turn).unwrap();
            let due = Up::new((turn * DVec3::Z).to_array()).unwrap();
            assert!(up.degrees_from(due) < 1.5, "{}", up.degrees_from(due));
        }
        let above: DVec3 = cameras.iter().map(|[_, down]| -*down).sum();
        assert!(
            above.normalize().angle_between(DVec3::Z).to_degrees() > 15.0,
            "the test is too easy"
        );
    }

    #[test]
    fn cameras_that_do_not_tell_say_nothing() {
        assert_eq!(up_of(&[], glam::DQuat::IDENTITY), None);
        assert_eq!(up_of(&[camera(20.0, -30.0, 0.0)], glam::DQuat::IDENTITY), None);
        // Along one line, however pitched.
        let line: Vec<_> = (0..9).map(|i| camera(20.0, 10.0 * f64::from(i) - 60.0, 0.0)).collect();
        assert_eq!(up_of(&line, glam::DQuat::IDENTITY), None);
        // Rolled every way, as by a drone or a robot's wrist.
        let rolled: Vec<_> =
            (0..36).map(|i| camera(37.0 * f64::from(i), -20.0, 10.0 * f64::from(i))).collect();
        assert_eq!(up_of(&rolled, glam::DQuat::IDENTITY), None);
        // From nearly straight above, all around, they do: nobody tilts them.
        let above: Vec<_> = (0..36).map(|i| camera(10.0 * f64::from(i), -85.0, 0.0)).collect();
        assert!(up_of(&above, glam::DQuat::IDENTITY).unwrap().degrees_from(Up::PLUS_Z) < 0.1);
        let nan = [DVec3::NAN, DVec3::NAN];
        assert_eq!(up_of(&[nan, camera(0.0, 0.0, 0.0)], glam::DQuat::IDENTITY), None);
    }
}
