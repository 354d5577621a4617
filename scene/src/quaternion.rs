//! Turns as unit quaternions `w, x, y, z`.

/// The unit quaternion `w, x, y, z` that turns +z to a unit vector by the shortest way.
pub fn quat_from_z_to([x, y, z]: [f64; 3]) -> [f64; 4] {
    let w = 1.0 + z;
    if w < 1e-9 {
        // Half a turn about any horizontal axis.
        return [0.0, 1.0, 0.0, 0.0];
    }
    let norm = (w * w + x * x + y * y).sqrt();
    [w / norm, -y / norm, x / norm, 0.0]
}
