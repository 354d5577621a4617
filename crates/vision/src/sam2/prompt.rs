//! Points as tokens, and where the picture's tokens are.

use super::config::Sam2Config;
use crate::VisionError;
use crate::weights::Weights;

/// What a point says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointLabel {
    /// It lies outside the object.
    Outside,
    /// It lies on the object.
    Inside,
    /// Upper left corner of a box around the object.
    BoxStart,
    /// Lower right corner of it.
    BoxEnd,
}

/// A point of a prompt.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PromptPoint {
    /// Column and row in the picture, pixels; whole numbers are the upper left corners of pixels.
    pub at: [f32; 2],
    /// What it says.
    pub label: PointLabel,
}

impl PromptPoint {
    /// A point on the object.
    pub fn inside(at: [f32; 2]) -> Self {
        Self { at, label: PointLabel::Inside }
    }
}

pub(super) struct PromptEncoder {
    width: usize,
    size: f32,
    /// `[2, width / 2]`
    gaussian: Vec<f32>,
    /// Of the labels 0 to 3. `[4, width]`
    labels: [Vec<f32>; 4],
    no_point: Vec<f32>,
    /// Added to every row of a picture without a mask given.
    pub no_mask: Vec<f32>,
}

impl PromptEncoder {
    pub fn take(weights: &mut Weights, config: &Sam2Config) -> Result<Self, VisionError> {
        let width = config.d_model;
        let name = |part: &str| format!("sam_prompt_encoder.{part}");
        let gaussian = name("pe_layer.positional_encoding_gaussian_matrix");
        let mut label =
            |i: usize| weights.take(&name(&format!("point_embeddings.{i}.weight")), &[1, width]);
        Ok(Self {
            width,
            size: config.image_size as f32,
            labels: [label(0)?, label(1)?, label(2)?, label(3)?],
            gaussian: weights.take(&gaussian, &[2, width / 2])?,
            no_point: weights.take(&name("not_a_point_embed.weight"), &[1, width])?,
            no_mask: weights.take(&name("no_mask_embed.weight"), &[1, width])?,
        })
    }

    /// Sines, then cosines, of a place whose coordinates are shares of the picture.
    fn place(&self, at: [f32; 2], out: &mut [f32]) {
        let half = self.width / 2;
        let [x, y] = at.map(|v| 2.0 * v - 1.0);
        for i in 0..half {
            let turn = x * self.gaussian[i] + y * self.gaussian[half + i];
            let (sin, cos) = (std::f32::consts::TAU * turn).sin_cos();
            (out[i], out[half + i]) = (sin, cos);
        }
    }

    /// Tokens of a prompt: one for each point, and one that says that there is no further.
    ///
    /// Points are given in the square that the network sees, pixels. `[points + 1, width]`
    pub fn tokens(&self, points: &[PromptPoint]) -> Vec<f32> {
        let mut out = vec![0.0; (points.len() + 1) * self.width];
        for (point, row) in points.iter().zip(out.chunks_exact_mut(self.width)) {
            // The middle of the pixel.
            self.place(point.at.map(|v| (v + 0.5) / self.size), row);
            let label = match point.label {
                PointLabel::Outside => 0,
                PointLabel::Inside => 1,
                PointLabel::BoxStart => 2,
                PointLabel::BoxEnd => 3,
            };
            crate::layers::add(row, &self.labels[label]);
        }
        out[points.len() * self.width..].copy_from_slice(&self.no_point);
        out
    }

    /// Where each token of the picture is. `[side², width]`
    pub fn grid(&self, side: usize) -> Vec<f32> {
        let mut out = vec![0.0; side * side * self.width];
        let share = |i: usize| (i as f32 + 0.5) / side as f32;
        for (token, row) in out.chunks_exact_mut(self.width).enumerate() {
            self.place([share(token % side), share(token / side)], row);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_point_gets_the_vector_of_its_label() {
        // Without a direction every place is (0, 1); the labels' vectors are ten times their numbers.
        let encoder = PromptEncoder {
            width: 2,
            size: 64.0,
            gaussian: vec![0.0; 2],
            labels: [0.0, 10.0, 20.0, 30.0].map(|v| vec![v, v]),
            no_point: vec![-1.0, -2.0],
            no_mask: vec![0.0; 2],
        };
        use PointLabel::{BoxEnd, BoxStart, Inside, Outside};
        let points =
            [Outside, Inside, BoxStart, BoxEnd].map(|label| PromptPoint { at: [3.0, 5.0], label });
        let due = [0.0, 1.0, 10.0, 11.0, 20.0, 21.0, 30.0, 31.0, -1.0, -2.0];
        assert_eq!(encoder.tokens(&points), due);
    }

    #[test]
    fn the_grid_runs_along_the_rows() {
        // A turn of an eighth a picture, by the column alone.
        let encoder = PromptEncoder {
            width: 2,
            size: 64.0,
            gaussian: vec![0.125, 0.0],
            labels: [0.0; 4].map(|v| vec![v; 2]),
            no_point: vec![0.0; 2],
            no_mask: vec![0.0; 2],
        };
        let grid = encoder.grid(2);
        // Columns at a quarter and at three quarters: -1/16 and 1/16 of a turn.
        let sines: Vec<f32> = grid.chunks_exact(2).map(|row| row[0]).collect();
        let due = (std::f32::consts::TAU / 16.0).sin();
        for (sine, due) in sines.iter().zip([-due, due, -due, due]) {
            assert!((sine - due).abs() < 1e-6, "{sines:?}");
        }
    }
}
