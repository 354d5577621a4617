//! What an SPZ file cannot hold, counted while a scene is encoded.

use crate::formats::WriteReport;
use crate::formats::limit_tally::LimitTally;

/// Rows concerned, by limit.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Limits {
    /// Positions off by more than the usual step allows.
    pub(super) position_step: LimitTally,
    /// Positions beyond 24 bits.
    pub(super) position_range: LimitTally,
    pub(super) scale: LimitTally,
    pub(super) alpha: LimitTally,
    pub(super) color: LimitTally,
    pub(super) rest: LimitTally,
    pub(super) quat: LimitTally,
}

impl Limits {
    pub(super) fn merge(self, other: Self) -> Self {
        Self {
            position_step: self.position_step.merge(other.position_step),
            position_range: self.position_range.merge(other.position_range),
            scale: self.scale.merge(other.scale),
            alpha: self.alpha.merge(other.alpha),
            color: self.color.merge(other.color),
            rest: self.rest.merge(other.rest),
            quat: self.quat.merge(other.quat),
        }
    }

    /// Notes them; `grid` says how positions are stored.
    pub(super) fn report(self, grid: &PositionGrid, report: &mut WriteReport) {
        let bits = grid.bits;
        let step = 1.0 / f64::from(1u32 << bits);
        report.limit(
            "coord",
            format!(
                "stored in steps of {step} m instead of 1/4096 m, for row {} at {} m to be in range; \
                 leave out far rows to keep the others fine",
                grid.farthest_row, grid.farthest
            ),
            self.position_step,
        );
        report.limit("coord", "clipped to ±8388607 m", self.position_range);
        report.limit("log_scale", "clipped to -10..5.9375 (4.5e-5 m to 379 m)", self.scale);
        report.limit("quat", "without a direction: written as no rotation", self.quat);
        report.limit(
            "opacity_logit",
            "alpha below 1/510 or above 1 - 1/510 becomes exactly 0 or 1",
            self.alpha,
        );
        report.limit("sh_dc", "clipped to ±3.3333", self.color);
        report.limit("sh_rest", "clipped to -1..0.9922", self.rest);
    }
}

/// How positions are stored, and why.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PositionGrid {
    /// Fractional bits.
    pub(super) bits: u8,
    /// The row that needs most range.
    pub(super) farthest_row: usize,
    /// Its largest coordinate.
    pub(super) farthest: f32,
}
