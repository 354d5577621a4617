//! Features that many Gaussians share: the index form of lifted labels.

use super::slots::SlotStore;
use super::{EncodeError, EncodeSummary, SceneFeatures};
use scenesplat_models::ops::normalize_rows;

impl SceneFeatures {
    /// Features that were made before in their index form: a row for each cluster, `[K, width]`, and the cluster of each
    /// Gaussian, `None` for one without a feature. `[N]` Distinct rows are those of clusters that Gaussians have, in
    /// the order of their first one, at unit length; what is without a feature has a row of zeros, and no class.
    ///
    /// # Errors
    /// If there is no Gaussian, the number of values is no multiple of `width`, or a cluster has no row.
    pub fn from_clusters(
        rows: &[f32],
        width: usize,
        cluster_of: &[Option<u16>],
    ) -> Result<Self, EncodeError> {
        if width == 0 || cluster_of.is_empty() || !rows.len().is_multiple_of(width) {
            return Err(EncodeError::Setting(format!(
                "features: {} values of clusters are no rows of {width} for {} Gaussians",
                rows.len(),
                cluster_of.len()
            )));
        }
        // The last one is of what has no cluster.
        let none = rows.len() / width;
        let mut slot_of = vec![None; none + 1];
        let (mut values, mut inverse, mut sampled) = (Vec::new(), Vec::new(), Vec::new());
        for (gaussian, cluster) in (0_u32..).zip(cluster_of) {
            if let Some(cluster) = cluster.filter(|cluster| usize::from(*cluster) >= none) {
                let text = format!("features: cluster {cluster}, there are {none}");
                return Err(EncodeError::Setting(text));
            }
            let cluster = cluster.map_or(none, usize::from);
            let slot = *slot_of[cluster].get_or_insert_with(|| {
                match cluster == none {
                    true => values.resize(values.len() + width, 0.0),
                    false => values.extend(&rows[cluster * width..][..width]),
                }
                sampled.push(gaussian);
                sampled.len() as u32 - 1
            });
            inverse.push(slot);
        }
        normalize_rows(&mut values, width);
        let summary = EncodeSummary { voxels: sampled.len(), ..EncodeSummary::default() };
        Ok(Self { sampled, ..Self::new(SlotStore::rows(values, width), inverse, summary) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussians_of_a_cluster_share_a_row() {
        let rows = vec![3.0, 4.0, 0.0, 2.0, -1.0, 0.0];
        let of = [Some(2), None, Some(0), Some(2), None];
        let found = SceneFeatures::from_clusters(&rows, 2, &of).unwrap();
        // In the order of the first Gaussian; cluster 1 is of none.
        assert_eq!((found.inverse(), found.sampled()), (&[0, 1, 2, 0, 1][..], &[0, 1, 2][..]));
        assert_eq!((found.len(), found.num_slots(), found.width()), (5, 3, 2));
        assert_eq!(found.slot_rows(0..3).unwrap(), [-1.0, 0.0, 0.0, 0.0, 0.6, 0.8]);
        assert_eq!(found.gaussian_rows(2..4).unwrap(), [0.6, 0.8, -1.0, 0.0]);
        let all = SceneFeatures::from_clusters(&rows, 2, &[Some(1)]).unwrap();
        assert_eq!((all.num_slots(), all.slot_rows(0..1).unwrap()), (1, vec![0.0, 1.0]));
        let none = SceneFeatures::from_clusters(&[], 2, &[None; 3]).unwrap();
        assert_eq!((none.num_slots(), none.slot_rows(0..1).unwrap()), (1, vec![0.0; 2]));
        let refused = |width: usize, of: &[Option<u16>], part: &str| {
            let error = SceneFeatures::from_clusters(&rows, width, of).unwrap_err();
            assert!(error.to_string().contains(part), "{error}");
        };
        refused(2, &[Some(3)], "cluster 3, there are 3");
        refused(0, &of, "are no rows of 0");
        refused(4, &of, "6 values of clusters are no rows of 4 for 5 Gaussians");
        refused(2, &[], "for 0 Gaussians");
    }
}
