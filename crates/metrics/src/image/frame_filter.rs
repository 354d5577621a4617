//! Which frames of a capture to keep: poses, duplicates, blur.

use super::ImageError;
use std::collections::HashMap;

/// What is known of a frame, in the order of the capture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CapturedFrame {
    /// [`super::sharpness::variance_of_laplacian`] at one width for all frames.
    pub sharpness: f64,
    /// Camera to world or world to camera, row by row; `None` if the capture has none.
    pub pose: Option<[[f64; 4]; 3]>,
    /// A hash of the picture's bytes; `None` = not compared.
    pub image_hash: Option<u64>,
}

/// How frames are judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameFilter {
    /// A frame is blurred if its sharpness is below this share of the median around it, 0 to 1.
    pub sharpness_share: f64,
    /// Frames on each side of a frame that its median is taken over.
    pub half_window: usize,
    /// Largest share of the frames that may be dropped as blurred, 0 to 1.
    pub max_dropped: f64,
    /// Most frames in a row that may be missing because of it.
    pub max_run: usize,
}

impl Default for FrameFilter {
    /// Half of the median of ±15 frames; at most 30 % of the frames and 10 in a row.
    ///
    /// The paper names the measure and no threshold; an absolute one depends on what is filmed.
    fn default() -> Self {
        Self { sharpness_share: 0.5, half_window: 15, max_dropped: 0.3, max_run: 10 }
    }
}

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FrameVerdict {
    /// Kept.
    Sharp,
    /// Blurred, but kept: too many frames, or too many in a row, would be missing otherwise.
    KeptForCoverage {
        /// Its sharpness over the median around it.
        share: f64,
    },
    /// Dropped: much less sharp than its neighbors.
    Blurred {
        /// Its sharpness over the median around it.
        share: f64,
    },
    /// Dropped: the capture has no pose for it.
    NoPose,
    /// Dropped: its pose is not finite or cannot be inverted.
    BadPose,
    /// Dropped: the pose and the picture of an earlier frame.
    Duplicate {
        /// That frame.
        of: usize,
    },
}

impl FrameVerdict {
    /// Whether the frame is used.
    pub fn is_kept(self) -> bool {
        matches!(self, Self::Sharp | Self::KeptForCoverage { .. })
    }
}

impl std::fmt::Display for FrameVerdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sharp => write!(f, "kept"),
            Self::KeptForCoverage { share } => {
                write!(f, "kept for coverage ({:.0} % of the sharpness around it)", 100.0 * share)
            }
            Self::Blurred { share } => {
                write!(f, "blurred ({:.0} % of the sharpness around it)", 100.0 * share)
            }
            Self::NoPose => write!(f, "no pose"),
            Self::BadPose => write!(f, "bad pose"),
            Self::Duplicate { of } => write!(f, "same as frame {of}"),
        }
    }
}

impl FrameFilter {
    /// A verdict for each frame.
    ///
    /// Frames without a usable pose and duplicates go first. Of the rest, those whose sharpness is
    /// below the share of the median around them are dropped, the most blurred first, until the
    /// next one would break a limit: the share of dropped frames among the usable, or the length of
    /// a gap (frames of the capture that are missing in a row, for any reason). A gap that bad
    /// poses alone make longer than allowed is left as it is.
    ///
    /// # Errors
    /// If a setting is out of range, or a sharpness is negative, NaN or infinite.
    pub fn judge(&self, frames: &[CapturedFrame]) -> Result<Vec<FrameVerdict>, ImageError> {
        self.check()?;
        let bad = |f: &CapturedFrame| !(f.sharpness.is_finite() && f.sharpness >= 0.0);
        if let Some(row) = frames.iter().position(bad) {
            let (what, expected) = ("sharpness", "a finite number, 0 or more");
            return Err(ImageError::Row { what, row, value: frames[row].sharpness, expected });
        }
        let mut verdicts = judge_poses(frames);
        let usable = verdicts.iter().filter(|v| v.is_kept()).count();
        let mut blurred = self.blurred(frames, &verdicts);
        // The most blurred first; of equals the earlier.
        blurred.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        let most = (self.max_dropped * usable as f64).floor() as usize;
        let mut dropped = 0;
        for (i, share) in blurred {
            let fits = dropped < most && self.gap_with(&verdicts, i) <= self.max_run;
            verdicts[i] = if fits {
                dropped += 1;
                FrameVerdict::Blurred { share }
            } else {
                FrameVerdict::KeptForCoverage { share }
            };
        }
        Ok(verdicts)
    }

    fn check(&self) -> Result<(), ImageError> {
        let shares = [("sharpness_share", self.sharpness_share), ("max_dropped", self.max_dropped)];
        for (field, value) in shares {
            if !(0.0..=1.0).contains(&value) {
                return Err(ImageError::Setting { field, value, expected: "0 to 1" });
            }
        }
        Ok(())
    }

    /// Usable frames below the threshold, with their share of the median.
    fn blurred(&self, frames: &[CapturedFrame], verdicts: &[FrameVerdict]) -> Vec<(usize, f64)> {
        let mut around = Vec::new();
        let mut found = Vec::new();
        for i in (0..frames.len()).filter(|&i| verdicts[i].is_kept()) {
            let first = i.saturating_sub(self.half_window);
            let end = i.saturating_add(self.half_window).saturating_add(1).min(frames.len());
            around.clear();
            around.extend(
                (first..end).filter(|&j| verdicts[j].is_kept()).map(|j| frames[j].sharpness),
            );
            let median = median(&mut around);
            if frames[i].sharpness < self.sharpness_share * median {
                found.push((i, frames[i].sharpness / median));
            }
        }
        found
    }

    /// Length of the gap that dropping a frame would make.
    fn gap_with(&self, verdicts: &[FrameVerdict], i: usize) -> usize {
        let before = verdicts[..i].iter().rev().take_while(|v| !v.is_kept()).count();
        let after = verdicts[i + 1..].iter().take_while(|v| !v.is_kept()).count();
        before + 1 + after
    }
}

/// The verdicts by pose and hash alone.
fn judge_poses(frames: &[CapturedFrame]) -> Vec<FrameVerdict> {
    let mut first_with = HashMap::new();
    let judge = |(i, frame): (usize, &CapturedFrame)| {
        let Some(pose) = frame.pose else { return FrameVerdict::NoPose };
        if !is_pose(&pose) {
            return FrameVerdict::BadPose;
        }
        let Some(hash) = frame.image_hash else { return FrameVerdict::Sharp };
        match *first_with.entry((hash, pose.map(|row| row.map(f64::to_bits)))).or_insert(i) {
            of if of < i => FrameVerdict::Duplicate { of },
            _ => FrameVerdict::Sharp,
        }
    };
    frames.iter().enumerate().map(judge).collect()
}

/// Whether a pose is finite and can be inverted. Rotations have determinant 1; scaled ones are
/// still poses, flat ones are none.
fn is_pose(pose: &[[f64; 4]; 3]) -> bool {
    let m = |r: usize, c: usize| pose[r][c];
    let determinant = m(0, 0) * (m(1, 1) * m(2, 2) - m(1, 2) * m(2, 1))
        - m(0, 1) * (m(1, 0) * m(2, 2) - m(1, 2) * m(2, 0))
        + m(0, 2) * (m(1, 0) * m(2, 1) - m(1, 1) * m(2, 0));
    pose.iter().flatten().all(|v| v.is_finite()) && determinant.abs() >= 1e-12
}

/// The middle value, or the mean of the two; the list is never empty.
fn median(values: &mut [f64]) -> f64 {
    let (middle, is_odd) = (values.len() / 2, values.len() % 2 == 1);
    let (below, &mut high, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    if is_odd {
        return high;
    }
    below.iter().copied().fold(f64::NEG_INFINITY, f64::max).midpoint(high)
}
