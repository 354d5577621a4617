//! From evidence to decisions.

use super::{Bound, Decision, HARMONICS_LIMIT, ISOTROPY_LIMIT, PlanRequest, RenderPlan};
use crate::profile::FAINT;
use crate::{RasterSettings, SceneProfile};

/// Faint Gaussians are taken out if they are at least this share: moving the rest costs too.
const FAINT_SHARE: f64 = 0.05;

/// Largest `σ` inside an ellipse: `½ · 3.33²`.
const SIGMA_MAX: f32 = 5.55;

pub(super) fn auto(
    profile: &SceneProfile,
    settings: RasterSettings,
    request: PlanRequest,
) -> RenderPlan {
    let (sh_degree, harmonics) = harmonics(profile, &settings, &request);
    let (isotropic, rotations) = rotations(profile, &settings, &request);
    let (drop_faint, faint) = faint(profile, &settings, &request);
    let (background, behind) = background(&settings, &request);
    let decisions = vec![
        harmonics,
        rotations,
        faint,
        behind,
        antialiasing(&settings),
        depth(&request),
        gradients(&request),
    ];
    RenderPlan {
        settings: RasterSettings { isotropic, background, ..settings },
        request,
        sh_degree,
        drop_faint,
        decisions,
        is_full: false,
        profile: profile.clone(),
        given: settings,
    }
}

pub(super) fn full(
    profile: &SceneProfile,
    settings: RasterSettings,
    request: PlanRequest,
) -> RenderPlan {
    let sh_degree = wanted(profile, &request);
    let forced = |effect, verdict: &str| Decision {
        effect,
        verdict: verdict.to_owned(),
        evidence: "forced".to_owned(),
        bound: Bound::Exact,
    };
    let decisions = vec![
        forced("harmonics", &format!("degree {sh_degree}")),
        forced("rotations", "on"),
        forced("faint Gaussians", "kept"),
        forced("background", "added"),
        antialiasing(&settings),
        forced("depth", "accumulated, expected, median"),
        gradients(&request),
    ];
    let background = Some(settings.background.unwrap_or_default());
    RenderPlan {
        settings: RasterSettings { isotropic: false, background, ..settings },
        request,
        sh_degree,
        drop_faint: false,
        decisions,
        is_full: true,
        profile: profile.clone(),
        given: settings,
    }
}

/// The highest band that is both stored and asked for.
fn wanted(profile: &SceneProfile, request: &PlanRequest) -> u8 {
    request.render.sh_degree.unwrap_or(3).min(profile.harmonics.degree)
}

/// Whether what is never drawn under the profile's cut is never drawn under the settings'.
fn cut_holds(settings: &RasterSettings) -> bool {
    settings.alpha_cut >= FAINT
}

fn harmonics(
    profile: &SceneProfile,
    settings: &RasterSettings,
    request: &PlanRequest,
) -> (u8, Decision) {
    let wanted = wanted(profile, request);
    let stored = profile.harmonics.degree;
    let tail = &profile.harmonics.tail;
    let said = |degree: u8, evidence: String, bound| {
        let verdict = if request.render.rgb {
            format!("degree {degree} of {stored}")
        } else {
            "off".to_owned()
        };
        (degree, Decision { effect: "harmonics", verdict, evidence, bound })
    };
    if !request.render.rgb {
        return said(wanted, "no colour asked for".to_owned(), Bound::Exact);
    }
    if request.gradients.sh {
        return said(wanted, "bands that are 0 have gradients".to_owned(), Bound::Exact);
    }
    if !cut_holds(settings) {
        let evidence = "the alpha cut is below the one of the evidence".to_owned();
        return said(wanted, evidence, Bound::Exact);
    }
    let lost = |l: u8| tail[usize::from(l)];
    let least = (0..=wanted).find(|&l| lost(l) < HARMONICS_LIMIT || l == wanted).unwrap_or(wanted);
    if least == wanted {
        let evidence = match (wanted < stored, profile.harmonics.witness) {
            (true, _) => "as asked".to_owned(),
            (false, Some(row)) if wanted > 0 => {
                let most = tail[usize::from(wanted) - 1];
                format!("band {wanted} changes Gaussian {row} by up to {most:.3}")
            }
            _ => "no higher band stored".to_owned(),
        };
        return said(wanted, evidence, Bound::Exact);
    }
    let change = lost(least);
    let evidence = if change == 0.0 {
        format!("bands above {least} are 0 in all {} drawable Gaussians", profile.drawable)
    } else {
        format!("bands above {least} change no colour by more than {change:.5}, limit 1/512")
    };
    said(least, evidence, if change == 0.0 { Bound::Exact } else { Bound::Color(change) })
}

fn rotations(
    profile: &SceneProfile,
    settings: &RasterSettings,
    request: &PlanRequest,
) -> (bool, Decision) {
    let said = |isotropic: bool, evidence: String, bound| {
        let verdict = if isotropic { "off" } else { "on" }.to_owned();
        (isotropic, Decision { effect: "rotations", verdict, evidence, bound })
    };
    let on = |evidence: String| said(false, evidence, Bound::Exact);
    if settings.isotropic {
        return said(true, "the caller's promise".to_owned(), Bound::Rounding);
    }
    if profile.drawable == 0 {
        return on("no drawable Gaussian".to_owned());
    }
    if !profile.is_isotropic(ISOTROPY_LIMIT) {
        let ratio = profile.anisotropy + 1.0;
        return on(format!("scales of a Gaussian differ up to {ratio:.3} times"));
    }
    if request.gradients.scales || request.gradients.quats {
        return on("spheres, but gradients of scales or quaternions are asked for".to_owned());
    }
    if !cut_holds(settings) {
        return on("the alpha cut is below the one of the evidence".to_owned());
    }
    if profile.no_direction > 0 {
        let lost = profile.no_direction;
        return on(format!("spheres, but {lost} have no quaternion and must not be drawn"));
    }
    if !settings.normalize_quats && profile.quat_off_unit > ISOTROPY_LIMIT {
        let off = profile.quat_off_unit;
        return on(format!("spheres, but quaternions are not normalised and off by {off:.1e}"));
    }
    let (excess, count) = (profile.anisotropy, profile.drawable);
    let evidence = match excess {
        0.0 => format!("all {count} drawable Gaussians are spheres"),
        _ => format!("all {count} drawable Gaussians are spheres within {excess:.0e}"),
    };
    // σ moves by 2·excess·σ at most, a weight by that share of itself, and weights sum to 1.
    let bound = match 2.0 * SIGMA_MAX * excess {
        0.0 => Bound::Rounding,
        change => Bound::Color(change),
    };
    said(true, evidence, bound)
}

fn faint(
    profile: &SceneProfile,
    settings: &RasterSettings,
    request: &PlanRequest,
) -> (bool, Decision) {
    let said = |drop: bool, evidence: String| {
        let verdict = if drop { "taken out" } else { "skipped one by one" }.to_owned();
        (drop, Decision { effect: "faint Gaussians", verdict, evidence, bound: Bound::Exact })
    };
    let count = profile.faint;
    let share = count as f64 / profile.gaussians.max(1) as f64;
    if share < FAINT_SHARE {
        return said(false, format!("{count} below 1/255, {:.1} % of all", 100.0 * share));
    }
    if request.gradients.any() || request.render.contributions || request.render.last {
        return said(false, format!("{count} below 1/255, but outputs are by row of the scene"));
    }
    if !cut_holds(settings) {
        return said(false, "the alpha cut is below 1/255".to_owned());
    }
    said(true, format!("{count} below 1/255, {:.1} % of all", 100.0 * share))
}

fn background(settings: &RasterSettings, request: &PlanRequest) -> (Option<[f32; 3]>, Decision) {
    let said = |background, verdict: &str, evidence: &str| {
        let (verdict, evidence) = (verdict.to_owned(), evidence.to_owned());
        (background, Decision { effect: "background", verdict, evidence, bound: Bound::Exact })
    };
    match settings.background {
        None => said(None, "off", "none asked for"),
        Some(_) if !request.render.rgb => said(None, "off", "no colour asked for"),
        Some([r, g, b]) if r == 0.0 && g == 0.0 && b == 0.0 => said(None, "off", "black"),
        Some([r, g, b]) => {
            said(settings.background, "added", &format!("{r:.3}, {g:.3}, {b:.3} asked for"))
        }
    }
}

fn antialiasing(settings: &RasterSettings) -> Decision {
    let (verdict, evidence) = match settings.antialiased {
        true => ("on", "asked for: the scene was trained with it"),
        false => ("off", "not asked for: a scene looks as it was trained"),
    };
    let (verdict, evidence) = (verdict.to_owned(), evidence.to_owned());
    Decision { effect: "antialiasing", verdict, evidence, bound: Bound::Exact }
}

fn depth(request: &PlanRequest) -> Decision {
    let d = request.render.depth;
    let kinds = [("accumulated", d.accumulated), ("expected", d.expected), ("median", d.median)];
    let asked: Vec<&str> = kinds.iter().filter(|k| k.1).map(|k| k.0).collect();
    let (verdict, evidence) = if asked.is_empty() {
        ("off".to_owned(), "none asked for")
    } else {
        (asked.join(", "), "asked for")
    };
    Decision { effect: "depth", verdict, evidence: evidence.to_owned(), bound: Bound::Exact }
}

fn gradients(request: &PlanRequest) -> Decision {
    let g = request.gradients;
    let groups = [
        ("means", g.means),
        ("quats", g.quats),
        ("scales", g.scales),
        ("opacities", g.opacities),
        ("sh", g.sh),
    ];
    let asked: Vec<&str> = groups.iter().filter(|k| k.1).map(|k| k.0).collect();
    let (verdict, evidence) = if asked.is_empty() {
        ("off".to_owned(), "none asked for")
    } else {
        (asked.join(", "), "asked for")
    };
    Decision { effect: "gradients", verdict, evidence: evidence.to_owned(), bound: Bound::Exact }
}
