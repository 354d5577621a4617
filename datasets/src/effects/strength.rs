//! How strong an effect is at severity 1; others in proportion.

/// Share of the Gaussians that is missing, in as many balls as the severity is, rounded up.
pub const HOLES_SHARE: f64 = 0.03;
/// Added Gaussians as a share of those that there are.
pub const FLOATERS_SHARE: f64 = 0.004;
/// Standard deviation of the movement along the normal, meters.
pub const SURFACE_METRES: f64 = 0.006;
/// Standard deviation of the turn about any axis, degrees.
pub const SURFACE_DEGREES: f64 = 4.0;
/// Length of the motion while a picture is taken, meters.
pub const BLUR_METRES: f64 = 0.02;
/// Exposure at the far ends of the scene, stops.
pub const LIGHT_STOPS: f64 = 0.25;
/// Gain of red over blue at the far ends, as a share.
pub const LIGHT_BALANCE: f64 = 0.02;
/// Standard deviation of noise that does not depend on the light, of full scale.
pub const NOISE_READ: f64 = 0.002;
/// Standard deviation of noise at full light, which grows with the root of it.
pub const NOISE_SHOT: f64 = 0.01;
/// Part of the largest upright plane that is a pane of glass.
pub const GLASS_SHARE: f64 = 0.12;
/// Part of the light that a pane takes in.
pub const GLASS_ALPHA: f64 = 0.06;
/// In pictures: standard deviation of the turn of a camera during an exposure, about each of its two axes
/// across the view, degrees. A fifth is two pixels of a picture 640 wide that shows 60°.
pub const BLUR_DEGREES: f64 = 0.2;
/// In pictures: standard deviation of the logarithm of the exposure from picture to picture.
pub const LIGHT_LOG_GAIN: f64 = 0.1;
/// In pictures: part of the automatic exposure that a camera does.
pub const LIGHT_AUTOMATIC: f64 = 0.2;
