//! What a network leaves out for speed.

use std::fmt;
use std::str::FromStr;

/// On which voxels the blocks of the last decoder stage run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LastStage {
    /// On the voxels of the input, as the network was trained.
    #[default]
    Fine,
    /// On those of the next coarser scale.
    Coarse,
}

/// What inference may leave out of a network whose weights stay as they are: no part of what a file
/// says, and nothing to train with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Shortcuts {
    /// Voxels of the last decoder stage.
    pub stage: LastStage,
    /// Rank of the convolutions of the last decoder stage, 1 to their width; `None`: as they are.
    pub rank: Option<usize>,
}

impl fmt::Display for LastStage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Fine => "fine",
            Self::Coarse => "coarse",
        })
    }
}

impl FromStr for LastStage {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "fine" => Ok(Self::Fine),
            "coarse" => Ok(Self::Coarse),
            _ => Err(format!("unknown stage {text:?}: choose fine or coarse")),
        }
    }
}
