//! Cutting scenes into overlapping squares, so that training reads a part of a scene and not all of
//! it.
//!
//! [`plan_chunks`] decides which Gaussians are in which chunk; [`ChunkFolder`] writes the chunks of
//! many scenes, and goes on where it was interrupted.

mod folder;
mod npy_copy;
mod plan;
mod write;

pub use folder::ChunkFolder;
pub use plan::{Chunk, ChunkPlan, plan_chunks};
pub use write::ChunkReport;

use crate::DataError;
use crate::error::{check_positive, require};

scenesplat_kernels::settings! {
    /// How scenes are cut. The default is what the original's chunks are made with.
    pub struct ChunkSettings {
        /// Keeps one Gaussian in each cell of this size first, meters; `None` keeps all.
        pub grid_size: Option<f64> = Some(0.01),
        /// Sides of a chunk along x and y, meters.
        pub range: [f64; 2] = [6.0; 2],
        /// Distance from one chunk to the next along x and y, meters.
        pub stride: [f64; 2] = [3.0; 2],
        /// Chunks with fewer Gaussians are left out.
        pub minimum_size: usize = 10_000,
        /// Most chunks of a scene: those with most Gaussians; `None` keeps all.
        pub max_chunks: Option<usize> = None,
        /// Seed of what is drawn: which of the Gaussians of a cell that have a feature is kept.
        pub seed: u64 = 0,
        /// Loses what the original loses: scenes not longer than `range - stride`, and what lies exactly
        /// where the last chunk ends.
        pub exact: bool = false,
    }
}

impl ChunkSettings {
    /// Checks every setting.
    ///
    /// # Errors
    /// Names the first that is out of range.
    pub fn check(&self) -> Result<(), DataError> {
        /// A Gaussian is in (range / stride)² chunks.
        const MAX_OVERLAP: f64 = 16.0;
        let positive = |v: f64| v.is_finite() && v > 0.0;
        self.grid_size.map_or(Ok(()), |size| check_positive("grid_size", size))?;
        for (range, stride) in self.range.into_iter().zip(self.stride) {
            require(positive(range), "range", range, "a finite number of meters above 0")?;
            let expected = "a finite number of meters, at least a 16th of the range";
            let ok = positive(stride) && stride >= range / MAX_OVERLAP;
            require(ok, "stride", stride, expected)?;
            let expected = "no more than the range, or Gaussians between chunks would be lost";
            require(stride <= range, "stride", stride, expected)?;
        }
        require(self.max_chunks != Some(0), "max_chunks", 0, "a number of 1 or more")
    }

    /// The name of the folder that the chunks of a split come into, such as
    /// `train_grid1.0cm_chunk6x6_stride3x3`.
    pub fn folder_name(&self, split: &str) -> String {
        let grid = self.grid_size.map_or_else(String::new, |g| format!("_grid{:.1}cm", g * 100.0));
        let ([rx, ry], [sx, sy]) = (self.range, self.stride);
        format!("{split}{grid}_chunk{rx}x{ry}_stride{sx}x{sy}")
    }
}
