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
    let forced = |effect, verdict: &str| Decision::exact(effect, verdict, "forced");
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

impl Decision {
    /// One that does not change the picture.
    fn exact(
        effect: &'static str,
        verdict: impl Into<String>,
        evidence: impl Into<String>,
    ) -> Self {
        Self { effect, verdict: verdict.into(), evidence: evidence.into(), bound: Bound::Exact }
    }

    /// Computes what the request names.
    fn asked(effect: &'static str, kinds: &[(&str, bool)]) -> Self {
        let asked: Vec<&str> = kinds.iter().filter(|k| k.1).map(|k| k.0).collect();
        match asked.is_empty() {
            true => Self::exact(effect, "off", "none asked for"),
            false => Self::exact(effect, asked.join(", "), "asked for"),
        }
    }
}

/// Why nothing is decided by evidence that holds for another cut.
const OTHER_CUT: &str = "the alpha cut is below the one of the evidence";

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
    let verdict = |degree: u8| match request.render.rgb {
        true => format!("degree {degree} of {stored}"),
        false => "off".to_owned(),
    };
    let all = |evidence: &str| (wanted, Decision::exact("harmonics", verdict(wanted), evidence));
    if !request.render.rgb {
        return all("no color asked for");
    }
    if request.gradients.sh {
        return all("bands that are 0 have gradients");
    }
    if !cut_holds(settings) {
        return all(OTHER_CUT);
    }
    let lost = |l: u8| profile.harmonics.tail[usize::from(l)];
    let least = (0..=wanted).find(|&l| lost(l) < HARMONICS_LIMIT || l == wanted).unwrap_or(wanted);
    if least == wanted {
        return match (wanted < stored, profile.harmonics.witness) {
            (true, _) => all("as asked"),
            (false, Some(row)) if wanted > 0 => {
                let most = lost(wanted - 1);
                all(&format!("band {wanted} changes Gaussian {row} by up to {most:.3}"))
            }
            _ => all("no higher band stored"),
        };
    }
    let change = lost(least);
    let count = profile.drawable;
    let (evidence, bound) = match change {
        0.0 => {
            (format!("bands above {least} are 0 in all {count} drawable Gaussians"), Bound::Exact)
        }
        _ => (
            format!("bands above {least} change no color by more than {change:.5}, limit 1/512"),
            Bound::Color(change),
        ),
    };
    (least, Decision { bound, ..Decision::exact("harmonics", verdict(least), evidence) })
}

fn rotations(
    profile: &SceneProfile,
    settings: &RasterSettings,
    request: &PlanRequest,
) -> (bool, Decision) {
    let on = |evidence: &str| (false, Decision::exact("rotations", "on", evidence));
    let off = |evidence: &str, bound| {
        (true, Decision { bound, ..Decision::exact("rotations", "off", evidence) })
    };
    if settings.isotropic {
        return off("the caller's promise", Bound::Rounding);
    }
    if profile.drawable == 0 {
        return on("no drawable Gaussian");
    }
    if !profile.is_isotropic(ISOTROPY_LIMIT) {
        let ratio = profile.anisotropy + 1.0;
        return on(&format!("scales of a Gaussian differ up to {ratio:.3} times"));
    }
    if request.gradients.scales || request.gradients.quats {
        return on("spheres, but gradients of scales or quaternions are asked for");
    }
    if !cut_holds(settings) {
        return on(OTHER_CUT);
    }
    if profile.no_direction > 0 {
        let lost = profile.no_direction;
        return on(&format!("spheres, but {lost} have no quaternion and must not be drawn"));
    }
    if !settings.normalize_quats && profile.quat_off_unit > ISOTROPY_LIMIT {
        let error = profile.quat_off_unit;
        return on(&format!("spheres, but quaternions are not normalized and off by {error:.1e}"));
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
    off(&evidence, bound)
}

fn faint(
    profile: &SceneProfile,
    settings: &RasterSettings,
    request: &PlanRequest,
) -> (bool, Decision) {
    let said = |drop: bool, evidence: String| {
        let verdict = if drop { "taken out" } else { "skipped one by one" };
        (drop, Decision::exact("faint Gaussians", verdict, evidence))
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
    let off = |evidence| (None, Decision::exact("background", "off", evidence));
    match settings.background {
        None => off("none asked for"),
        Some(_) if !request.render.rgb => off("no color asked for"),
        Some([r, g, b]) if r == 0.0 && g == 0.0 && b == 0.0 => off("black"),
        Some([r, g, b]) => {
            let evidence = format!("{r:.3}, {g:.3}, {b:.3} asked for");
            (settings.background, Decision::exact("background", "added", evidence))
        }
    }
}

fn antialiasing(settings: &RasterSettings) -> Decision {
    let verdict = if settings.antialiased { "on" } else { "off" };
    Decision::exact("antialiasing", verdict, "as the scene's file or the request says")
}

fn depth(request: &PlanRequest) -> Decision {
    let d = request.render.depth;
    let kinds = [("accumulated", d.accumulated), ("expected", d.expected), ("median", d.median)];
    Decision::asked("depth", &kinds)
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
    Decision::asked("gradients", &groups)
}
