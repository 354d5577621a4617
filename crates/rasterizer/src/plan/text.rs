//! Plans as people read them.

use super::{Bound, RenderPlan};
use std::fmt::{Display, Formatter, Result};

impl Display for Bound {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        match self {
            Self::Exact => f.write_str("exact"),
            Self::Rounding => f.write_str("exact but for rounding"),
            Self::Color(most) => write!(f, "changes a color by at most {most:.1e}"),
        }
    }
}

impl Display for RenderPlan {
    /// One line per decision: what, because of what, and how far it can move the picture.
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        let kind = if self.is_full { "full" } else { "auto" };
        let p = &self.profile;
        write!(
            f,
            "plan: {kind}; {} Gaussians, {} drawable, {} not finite",
            p.gaussians, p.drawable, p.not_finite
        )?;
        for d in &self.decisions {
            let (effect, verdict) = (d.effect, &d.verdict);
            write!(f, "\n  {effect:<16} {verdict:<18} {} ({})", d.evidence, d.bound)?;
        }
        Ok(())
    }
}
