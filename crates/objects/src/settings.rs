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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_refused() {
        let with = |min_similarity| ObjectSettings { min_similarity, ..ObjectSettings::default() };
        for cosine in [-1.0, 0.0, 1.0] {
            assert!(with(cosine).check().is_ok(), "{cosine}");
        }
        for cosine in [-1.01, 1.01, f32::NAN] {
            assert!(with(cosine).check().is_err(), "{cosine}");
        }
        let gap = |gap| ObjectSettings { gap: Some(gap), ..ObjectSettings::default() };
        assert!(
            gap(0.05).check().is_ok() && gap(0.0).check().is_err() && gap(11.0).check().is_err()
        );
        assert!(ObjectSettings { min_count: 0, ..ObjectSettings::default() }.check().is_err());
    }

    #[test]
    fn defaults_are_the_documented_ones_and_limits_belong_to_their_ranges() {
        let want = ObjectSettings {
            min_count: 20,
            gap: None,
            min_similarity: 0.3,
            reshape: true,
            wall: "wall".to_owned(),
            floor: "floor".to_owned(),
        };
        assert_eq!(ObjectSettings::default(), want);
        let gap = |gap| ObjectSettings { gap: Some(gap), ..ObjectSettings::default() }.check();
        assert!(gap(1e-3).is_ok() && gap(10.0).is_ok() && gap(9e-4).is_err());
        assert_eq!(
            gap(11.5).unwrap_err().to_string(),
            "gap: 11.5 is not possible, expected 0.001 to 10 meters"
        );
        ObjectSettings { min_count: 1, ..ObjectSettings::default() }.check().unwrap();
    }
}
