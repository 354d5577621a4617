//! What is taken for one object.

use crate::error::{Result, check_setting};
use serde::Serialize;

/// What is taken for one object; lengths in meters.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ObjectSettings {
    /// Fewest Gaussians of an object, at least 1.
    pub min_count: usize,
    /// Gaussians of a class this near to each other belong together; by default 2.5 times the
    /// spacing of the class, 0.04 to 0.25.
    pub gap: Option<f64>,
    /// Neighboring cells whose mean features have a lower cosine are different objects; −1 joins whatever
    /// touches.
    pub min_similarity: f32,
    /// Whether pieces are split along walls and panels, and fragments joined.
    pub reshape: bool,
    /// Name of the classes that distances to walls are measured from; see [`is_kind`](crate::is_kind).
    pub wall: String,
    /// Name of the classes that heights are measured from, likewise.
    pub floor: String,
}

impl Default for ObjectSettings {
    fn default() -> Self {
        Self {
            min_count: 20,
            gap: None,
            min_similarity: 0.3,
            reshape: true,
            wall: "wall".to_owned(),
            floor: "floor".to_owned(),
        }
    }
}

impl ObjectSettings {
    pub(crate) fn check(&self) -> Result<()> {
        let (count, gap, cosine) = (self.min_count, self.gap, self.min_similarity);
        check_setting(count > 0, "min_count", count, "a number above 0")?;
        let fits = gap.is_none_or(|gap| (1e-3..=10.0).contains(&gap));
        check_setting(fits, "gap", gap.unwrap_or_default(), "0.001 to 10 meters")?;
        let fits = (-1.0..=1.0).contains(&cosine);
        check_setting(fits, "min_similarity", cosine, "a cosine, -1 to 1")
    }
}
