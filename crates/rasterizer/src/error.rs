//! Errors of this crate.

/// What can go wrong. Every variant names the field and the value, and how to fix it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RasterError {
    /// An array of the wrong length.
    #[error("{field}: expected {expected} values, got {got}")]
    Length {
        /// Which array.
        field: &'static str,
        /// Values expected.
        expected: usize,
        /// Values found.
        got: usize,
    },
    /// Spherical harmonics beyond degree 3.
    #[error(
        "spherical harmonics of degree {degree} cannot be rendered, the highest is 3; drop the \
         higher bands"
    )]
    Degree {
        /// The degree.
        degree: u8,
    },
    /// A camera that looks nowhere.
    #[error(
        "a camera at {eye:?} cannot look at {target:?} with an angle of view of {fov} degrees; give another target and an \
         angle above 0 and below 180"
    )]
    LookAt {
        /// Where it stands.
        eye: [f64; 3],
        /// What it looks at.
        target: [f64; 3],
        /// Its angle of view, degrees.
        fov: f64,
    },
    /// A camera whose lens is not a pinhole.
    #[error(
        "camera {camera:?} has lens distortion ({model}); undistort the pictures and give pinhole \
         cameras"
    )]
    Distortion {
        /// Its name.
        camera: String,
        /// Which model of the lens.
        model: &'static str,
    },
    /// A pose that is no rotation.
    #[error(
        "the world-to-camera matrix of a view is off a rotation by {off}, more than 1e-4; scale the \
         scene instead of the camera"
    )]
    Pose {
        /// Largest entry of `RRᵀ − 1`, or 2 for a mirrored pose.
        off: f32,
    },
    /// A number outside its range.
    #[error("{field} is {value}; it has to be {range}")]
    Number {
        /// Which number.
        field: &'static str,
        /// What it is.
        value: f64,
        /// What it has to be.
        range: &'static str,
    },
    /// A value of one row that nothing can be made of.
    #[error("{field}, row {row}: {value}; it has to be {range}; repair or remove the row")]
    Row {
        /// Which array.
        field: &'static str,
        /// Which row.
        row: usize,
        /// What is there.
        value: String,
        /// What it has to be.
        range: &'static str,
    },
    /// A picture with no pixel or too many.
    #[error(
        "a picture of {width} × {height} pixels; sides go from 1 to 65,535 and 2²⁸ pixels in all"
    )]
    Picture {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
    },
    /// More than the row numbers hold or memory could.
    #[error("{what}: {count} is more than the {limit} that can be rendered")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many.
        count: usize,
        /// How many there may be.
        limit: usize,
    },
}
