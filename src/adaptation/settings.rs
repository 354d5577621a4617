use serde::Serialize;
use std::path::{Path, PathBuf};

/// How a network learns from a scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AdaptSettings {
    /// Optimizer steps, each of a part of the scene and a part of a room; at least 1.
    pub steps: u64,
    /// Seed of all that is random.
    pub seed: u64,
    /// Largest learning rate, of parameters outside of blocks; those inside have a tenth.
    pub lr: f64,
    /// Share of the labels that are held out, 0 to below 1.
    pub held_out: f64,
    /// How far the weights go from those before to those trained, above 0 to 1.
    pub share: f64,
    /// Rooms that figures are of.
    pub rooms: usize,
    /// Gaussians of rooms, to learn from and to score; by their size if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub room_gaussians: Option<usize>,
}

impl Default for AdaptSettings {
    fn default() -> Self {
        Self {
            steps: 80,
            seed: 0,
            lr: 1e-3,
            held_out: 0.2,
            share: 0.5,
            rooms: 6,
            room_gaussians: None,
        }
    }
}

/// Where an adaptation keeps what it works with.
#[derive(Debug, Clone)]
pub struct Folders {
    out: PathBuf,
}

impl Folders {
    /// Below this folder, made absolute: the training's record names paths.
    pub fn new(out: &Path) -> Self {
        Self { out: std::path::absolute(out).unwrap_or_else(|_| out.to_owned()) }
    }

    /// The folder itself.
    pub fn out(&self) -> &Path {
        &self.out
    }

    /// The folder of the scene as it is learned from.
    pub fn data(&self) -> PathBuf {
        self.out.join("data")
    }

    /// The weights to start from, where they are inside the program.
    pub fn start(&self) -> PathBuf {
        self.out.join("start")
    }

    /// The network between the one before and the one trained.
    pub fn model(&self) -> PathBuf {
        self.out.join("blended")
    }

    /// The training.
    pub fn run(&self) -> PathBuf {
        self.out.join("run")
    }
}
