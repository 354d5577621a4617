//! How strong an effect is at severity 1; others in proportion.

/// Share of the Gaussians that is missing, in as many balls as the severity is, rounded up.
pub const HOLES_SHARE: f64 = 0.03;
/// Added Gaussians as a share of those that there are.
pub const FLOATERS_SHARE: f64 = 0.004;
/// Standard deviation of the movement along the normal, metres.
pub const SURFACE_METRES: f64 = 0.006;
/// Standard deviation of the turn about any axis, degrees.
pub const SURFACE_DEGREES: f64 = 4.0;
/// Length of the motion while a picture is taken, metres.
pub const BLUR_METRES: f64 = 0.02;
/// Exposure at the far ends of the scene, stops.
pub const LIGHT_STOPS: f64 = 0.25;
/// Gain of red over blue at the far ends, as a share.
pub const LIGHT_BALANCE: f64 = 0.02;
/// Standard deviation of noise that does not depend on the light, of full scale.
pub const NOISE_READ: f64 = 0.002;
/// Standard deviation of noise at full light, which grows with the root of it.
pub const NOISE_SHOT: f64 = 0.01;
