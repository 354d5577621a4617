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
