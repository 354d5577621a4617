//! Plans as people read them.

use super::{EffectChoice, EffectDecision, EffectPlan, PlanSection};
use std::fmt;

/// What is decided, with its strength or what it changed.
impl fmt::Display for EffectDecision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let state = match (self.on, self.level) {
            (true, level) if level > 0.0 => format!("on {level:.1}"),
            (true, _) => "on".to_owned(),
            (false, _) => "off".to_owned(),
        };
        write!(f, "{:<16} {state:<7} {}", self.effect, self.why)?;
        match (&self.action, self.changed) {
            (Some(action), Some(changed)) if self.on => write!(f, "; {action}: {changed}"),
            (Some(action), None) if self.on => write!(f, "; {action}"),
            _ => Ok(()),
        }
    }
}

/// One line for each decision that somebody can make; those that nothing acts on share one.
impl fmt::Display for PlanSection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "plan, {}", self.name)?;
        if let Some(seconds) = self.seconds {
            write!(f, " ({seconds:.3} s)")?;
        }
        let is_idle = |d: &&EffectDecision| d.action.is_none();
        for decision in self.decisions.iter().filter(|d| !is_idle(d)) {
            write!(f, "\n  {decision}")?;
        }
        let idle = self.decisions.iter().filter(is_idle);
        let idle: Vec<String> = idle
            .map(|d| match d.choice {
                EffectChoice::Off => format!("{} (off by choice)", d.effect),
                _ => d.effect.clone(),
            })
            .collect();
        match idle.is_empty() {
            true => Ok(()),
            false => write!(f, "\n  nothing here acts on {}", idle.join(", ")),
        }
    }
}

impl fmt::Display for EffectPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, section) in self.sections.iter().enumerate() {
            write!(f, "{}{section}", if i == 0 { "" } else { "\n" })?;
        }
        Ok(())
    }
}
