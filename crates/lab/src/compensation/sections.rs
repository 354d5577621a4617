//! Decisions that others made, as parts of the one plan.

use scenesplat::inference::EncodeSummary;
use scenesplat_datasets::effects::plan::{EffectChoice, EffectDecision, PlanSection};
use scenesplat_rasterizer::RenderPlan;

/// Whether the scene went through tiles with context around them.
pub fn tiles_section(summary: &EncodeSummary, limited: bool) -> PlanSection {
    let on = summary.tiles > summary.passes;
    let limit = match summary.limited_by_device {
        true => "what one array of the device holds",
        false => "the limit of memory",
    };
    let why = match (on, limited) {
        (true, _) => format!(
            "{} tiles to keep {limit}, halo of {} voxels or more",
            summary.tiles, summary.smallest_halo
        ),
        (false, true) => "the scene fits the limit of memory in one piece".to_owned(),
        (false, false) => "no limit of memory: the scene is read in one piece".to_owned(),
    };
    let action = Some("voxels of halos computed besides".to_owned());
    let besides = summary.voxels_computed.saturating_sub(summary.voxels * summary.passes);
    let changed = Some(if on { besides } else { 0 });
    let effect = "halo".to_owned();
    let decision = EffectDecision { effect, on, action, why, changed, ..EffectDecision::default() };
    PlanSection::new("tiles", vec![decision])
}

/// What a renderer's plan leaves out.
pub fn render_section(plan: &RenderPlan) -> PlanSection {
    let forced = plan.is_full();
    let choice = if forced { EffectChoice::On } else { EffectChoice::Auto };
    let decisions = plan.decisions.iter().map(|d| EffectDecision {
        effect: d.effect.to_owned(),
        choice,
        on: d.verdict != "off",
        action: Some(d.verdict.clone()),
        why: format!("{} ({})", d.evidence, d.bound),
        ..EffectDecision::default()
    });
    PlanSection::new("render", decisions.collect())
}
