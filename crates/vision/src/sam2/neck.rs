//! The feature pyramid behind Hiera.

use super::config::Sam2Config;
use crate::VisionError;
use crate::layers::{Linear, add};
use crate::weights::Weights;
use rayon::prelude::*;

pub(super) struct Neck {
    /// Of each stage, finest first.
    lateral: Vec<Linear>,
    width: usize,
}

/// Rows of the pyramid that the decoder reads, `d_model` channels each.
pub(super) struct Pyramid {
    /// Quarter of the picture's side.
    pub fine: Vec<f32>,
    /// Eighth.
    pub middle: Vec<f32>,
    /// Sixteenth.
    pub coarse: Vec<f32>,
}

impl Neck {
    pub fn take(weights: &mut Weights, config: &Sam2Config) -> Result<Self, VisionError> {
        let width = config.d_model;
        let layer = |stage: usize| {
            let cin = config.embed_dim << stage;
            // The file counts from the coarsest.
            let name = format!("image_encoder.neck.convs.{}.conv", 3 - stage);
            weights.linear_of(&name, cin, width, &[width, cin, 1, 1])
        };
        Ok(Self { lateral: (0..4).map(layer).collect::<Result<_, _>>()?, width })
    }

    /// Coarse rows are added to the third stage alone: the two finer ones are their own rows (`fpn_top_down_levels`).
    pub fn forward(&self, stages: &[Vec<f32>; 4], side: usize) -> Pyramid {
        let top = self.lateral[3].forward(&stages[3]);
        let mut coarse = self.lateral[2].forward(&stages[2]);
        let (width, side) = (self.width, side / 4);
        coarse.par_chunks_mut(width).enumerate().for_each(|(token, row)| {
            let (y, x) = (token / side / 2, token % side / 2);
            add(row, &top[(y * (side / 2) + x) * width..][..width]);
        });
        Pyramid {
            fine: self.lateral[0].forward(&stages[0]),
            middle: self.lateral[1].forward(&stages[1]),
            coarse,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::Precision;

    #[test]
    fn each_coarse_row_is_added_to_the_four_rows_in_its_place() {
        // Layers that change nothing: two channels, the identity, no bias.
        let weights = Weights::seeded(0, Precision::F32);
        let identity = || weights.pack(&[1.0, 0.0, 0.0, 1.0], 2, 2, vec![0.0; 2]);
        let neck = Neck { lateral: (0..4).map(|_| identity()).collect(), width: 2 };
        // Stages of 16², 8², 4² and 2² rows: the third holds ten times the number of each row, the fourth 1 to 4.
        let third = (0..16).flat_map(|i| [10.0 * i as f32, -10.0 * i as f32]).collect();
        let fourth = vec![1.0, -1.0, 2.0, -2.0, 3.0, -3.0, 4.0, -4.0];
        let stages = [vec![0.5; 2 * 256], vec![0.25; 2 * 64], third, fourth];
        let pyramid = neck.forward(&stages, 16);
        // Of the 4 × 4 rows each quarter gets the one row of the 2 × 2 that lies over it.
        let added = [1, 1, 2, 2, 1, 1, 2, 2, 3, 3, 4, 4, 3, 3, 4, 4];
        let want: Vec<f32> =
            (0..16).map(|i| (10 * i + added[i]) as f32).flat_map(|v| [v, -v]).collect();
        assert_eq!(pyramid.coarse.len(), want.len());
        for (i, (got, want)) in pyramid.coarse.iter().zip(&want).enumerate() {
            assert!((got - want).abs() < 1e-3, "row {}: {got} {want}", i / 2);
        }
        // The finer ones get nothing.
        assert!(pyramid.middle.iter().all(|v| (v - 0.25).abs() < 1e-6));
        assert!(pyramid.fine.iter().all(|v| (v - 0.5).abs() < 1e-6));
    }
}
