//! The thresholds: what counts as a finding, and in which words.

use super::content::{Distribution, TooWide};
use super::duplicates::Duplicates;
use super::estimate::Estimate;
use super::findings::{Findings, Severity};
use super::neighbourhood::{FEWEST_ROWS, Neighbourhood, reach};
use super::statistics::{Counted, count_rows, largest};
use super::unit::{LengthUnit, UnitGuess, is_surely_no_metre, short};
use crate::memory::Bytes;
use scenesplat_scene::{Bounds, GaussianScene, UnreadColumn, Up, UpGuess, label_names};

/// A Gaussian is an outlier when its distance from the robust box exceeds so many of its diagonals.
/// The badly converged capture of the calibration reaches 1.6, clean scenes 0.03.
pub(super) const OUTLIER_DIAGONALS: f64 = 10.0;

/// A Gaussian is a giant when its reach of three standard deviations exceeds this share of the
/// diagonal. Clean scenes: at most 0.35; one as large as the scene: above 1.7.
const GIANT_DIAGONALS: f64 = 0.75;

/// Giants fainter than this tint by less than five of 255.
const GIANT_OPACITY: f32 = 0.02;

/// Share of isolated Gaussians that is a finding. Captures and generated rooms have up to 0.2 %.
const ISOLATED_SHARE: f64 = 0.003;

/// Share of repeated rows that is a finding. Clean scenes have none at all; one snapshot of a
/// training that clones Gaussians has 35 %.
const DUPLICATE_SHARE: f64 = 0.001;

/// Where 95 % of the Gaussians are fainter than this, the training has not converged. The clean
/// scenes: 0.6 to 1; the badly converged capture: 0.23.
const CONVERGED_OPACITY: f64 = 1.0 / 3.0;

/// Fainter Gaussians are skipped by renderers.
const INVISIBLE: f32 = 1.0 / 255.0;

/// Share of invisible Gaussians that is worth a remark.
const INVISIBLE_SHARE: f64 = 0.05;

/// Coordinates whose f32 step exceeds this were rounded to a fifth of a voxel or worse, meters.
const COARSEST_STEP: f32 = 0.004;

pub(super) fn check_positions(
    findings: &mut Findings<'_>,
    scene: &GaussianScene,
    bounds: &Bounds,
    robust: &Bounds,
    too_wide: Option<&TooWide>,
) {
    let rows = scene.len();
    if let Some(TooWide { row, message }) = too_wide {
        findings
            .add(
                Severity::Error,
                "grid_too_wide",
                Counted { count: 1, first: Some(*row) },
                format!("the scene does not fit on the voxel grid: {message}"),
            )
            .example(format!("{:?}", scene.coord[*row]))
            .help("remove the outliers, or rescale the scene to meters; the networks refuse it so");
    }
    if rows < FEWEST_ROWS {
        findings.add(Severity::Note, "few_rows", Counted::of(rows), format!(
                    "fewer than {FEWEST_ROWS} Gaussians: outliers, sizes, isolation, unit and convergence \
                     are not judged"
                ));
    }
    if bounds.largest_extent() == 0.0 && rows > 1 {
        findings
            .add(
                Severity::Warning,
                "one_place",
                Counted { count: rows, first: Some(0) },
                "all Gaussians are in one place".to_owned(),
            )
            .example(format!("{:?}", scene.coord[0]))
            .help("export the scene again; its positions are lost");
    }
    let furthest =
        (0..3).map(|a| robust.low[a].abs().max(robust.high[a].abs())).fold(0.0, f64::max);
    let step = (furthest as f32).next_up() - furthest as f32;
    if step > COARSEST_STEP && too_wide.is_none() {
        findings
            .add(
                Severity::Warning,
                "coarse_coordinates",
                Counted::of(rows),
                format!(
                    "so far from the origin, single precision has rounded positions to {} m",
                    short(f64::from(step))
                ),
            )
            .example(format!("coordinates up to {}", short(furthest)))
            .help("subtract the origin of the survey before exporting; rounding cannot be undone");
    }
}

/// Gaussians far from everything else.
pub(super) fn check_outliers(findings: &mut Findings<'_>, scene: &GaussianScene, robust: &Bounds) {
    let rows = scene.len();
    let limit = OUTLIER_DIAGONALS * robust.diagonal();
    if rows < FEWEST_ROWS || limit == 0.0 {
        return;
    }
    let distance = |row: usize| robust.distance(scene.coord[row]);
    let far = count_rows(rows, |row| distance(row) > limit);
    let farthest = largest(rows, |row| Some(distance(row)));
    if let (Some(first), Some((_, metres))) = (far.first, farthest) {
        findings.add(Severity::Warning, "outliers", far, format!(
                "{} of the Gaussians lie more than {OUTLIER_DIAGONALS} diagonals outside the scene, \
                 which is {} m across; the farthest is {} m away",
                percent(far.count, rows),
                short(robust.diagonal()),
                short(metres)
            )).example(format!("{:?}", scene.coord[first])).help("cut the scene to its box; each outlier costs a voxel and spoils whatever uses \
                   the full bounds");
    }
}

/// Degrees out of level that change labels.
const TILT: f64 = 1.0;

/// What networks make of the direction.
pub(super) fn check_up(findings: &mut Findings<'_>, rows: usize, up: &UpGuess) {
    if rows < FEWEST_ROWS || (up.is_sure() && up.direction.degrees_from(Up::PLUS_Z) < TILT) {
        return;
    }
    let message = if up.is_sure() {
        let up = up.direction.described();
        format!("up is {up}: networks read a copy turned to +z, files keep their frame")
    } else {
        format!(
            "which way is up is unclear, {} is taken: networks lose most labels if it is not; say which \
             it is, or turn the scene",
            up.direction.described()
        )
    };
    let example = format!("confidence {:.2}", up.confidence);
    findings.add(Severity::Note, "up", Counted::of(rows), message).example(example);
}

/// A need beyond the machine.
pub(super) fn check_memory(
    findings: &mut Findings<'_>,
    estimate: Option<&Estimate>,
    machine_bytes: Option<u64>,
) {
    let Some((estimate, there)) = estimate.zip(machine_bytes) else { return };
    if estimate.bytes > there {
        findings
            .add(
                Severity::Warning,
                "memory",
                Counted::of(0),
                format!(
                    "the {} network needs about {} for the whole scene, this machine has {}",
                    estimate.network,
                    Bytes(estimate.bytes),
                    Bytes(there)
                ),
            )
            .example(format!("{} voxels", estimate.voxels))
            .help(
                "limit the memory to less than the machine has: the scene then goes through the \
                       network in tiles",
            );
    }
}

pub(super) fn check_unit(
    findings: &mut Findings<'_>,
    rows: usize,
    unit: Option<&UnitGuess>,
    robust: &Bounds,
) {
    let Some(guess) = unit.filter(|_| rows >= FEWEST_ROWS) else { return };
    let (severity, help) = match guess.unit {
        LengthUnit::Metre => return,
        LengthUnit::Centimetre => (Severity::Note, ""),
        LengthUnit::Millimetre if is_surely_no_metre(guess, robust) => (
            Severity::Warning,
            "networks read a copy in meters; scaled by 0.001 it is so for all programs",
        ),
        LengthUnit::Millimetre => (
            Severity::Warning,
            "networks take it for metres and warn, unless told that it is millimetres; scaling by \
             0.001 makes positions and sizes metres",
        ),
        LengthUnit::Kilometre => (
            Severity::Warning,
            "networks take it for metres and warn, unless told that it is kilometres: as it is, all \
             of it falls into a few voxels; scaling by 1000 makes it metres",
        ),
    };
    findings
        .add(
            severity,
            "unit",
            Counted::of(rows),
            format!("one unit seems to be 1 {}, not 1 m", guess.unit.symbol()),
        )
        .example(guess.evidence.clone())
        .help(help);
}

pub(super) fn check_sizes(findings: &mut Findings<'_>, scene: &GaussianScene, robust: &Bounds) {
    let diagonal = robust.diagonal();
    let too_few = scene.len() < FEWEST_ROWS;
    if diagonal <= 0.0 || too_few {
        return;
    }
    let is_giant = |row: usize| is_giant(scene, row, robust);
    let giants = count_rows(scene.len(), is_giant);
    let largest = largest(scene.len(), |row| is_giant(row).then(|| reach(scene, row)));
    if let (Some(first), Some((_, metres))) = (giants.first, largest) {
        findings.add(Severity::Warning, "giant_splats", giants, format!(
                "three standard deviations reach over {GIANT_DIAGONALS} diagonals of the scene, \
                 which is {} m across; the largest reaches {} m",
                short(diagonal),
                short(metres)
            )).example(format!(
                "reaches {} m, opacity {:.2}",
                short(reach(scene, first)),
                scene.opacity(first)
            )).help("remove them, or clamp their scale; each tints much of every picture");
    }
}

/// Whether a Gaussian is larger than the scene, whose robust bounds have an extent.
pub(super) fn is_giant(scene: &GaussianScene, row: usize, robust: &Bounds) -> bool {
    let reach = reach(scene, row);
    reach > GIANT_DIAGONALS * robust.diagonal()
        && scene.opacity(row) >= GIANT_OPACITY
        // A background that ends before the scene begins does no harm.
        && robust.distance(scene.coord[row]) <= reach
}

pub(super) fn check_isolated(
    findings: &mut Findings<'_>,
    scene: &GaussianScene,
    near: &Neighbourhood,
) {
    let (Some(first), Some((_, metres))) = (near.isolated.first, near.most_isolated) else {
        return;
    };
    let count = near.isolated.count;
    let is_many = count as f64 > ISOLATED_SHARE * scene.len() as f64;
    let severity = if is_many { Severity::Warning } else { Severity::Note };
    findings.add(severity, "floaters", Counted { count, first: near.isolated.first }, format!(
                "{} of the Gaussians are isolated: the 4th neighbor is up to {} m away, usually {} m",
                percent(count, scene.len()),
                short(metres),
                short(near.spacing.unwrap_or(0.0))
            )).example(format!("{:?}", scene.coord[first])).help(if is_many {
                "remove floaters; each gets a label of its own and may answer queries"
            } else {
                ""
            });
}

pub(super) fn check_duplicates(findings: &mut Findings<'_>, found: &Duplicates, rows: usize) {
    let whole = found.whole;
    if whole.count > 0 {
        let is_many = whole.count as f64 > DUPLICATE_SHARE * rows as f64;
        let severity = if is_many { Severity::Warning } else { Severity::Note };
        findings.add(severity, "duplicates", whole, format!(
                "{} of the rows repeat an earlier one in position, scale, rotation, opacity and \
                 color",
                percent(whole.count, rows)
            )).help(if is_many {
                "remove the copies; a snapshot in the middle of training has them where Gaussians \
                 were just cloned: train on"
            } else {
                ""
            });
    }
    let elsewhere = found.position.count - whole.count;
    if elsewhere > 0 {
        findings.add(
            Severity::Note,
            "same_position",
            Counted { count: elsewhere, first: found.position.first },
            "Gaussians stand where another one stands, but differ from it".to_owned(),
        );
    }
}

pub(super) fn check_opacity(
    findings: &mut Findings<'_>,
    scene: &GaussianScene,
    opacity: &Distribution,
) {
    let rows = scene.len();
    let Some(q) = opacity.quantiles else { return };
    if q.p95 < CONVERGED_OPACITY && rows >= FEWEST_ROWS {
        findings
            .add(
                Severity::Warning,
                "low_opacity",
                Counted::of(rows),
                "nearly everything is transparent: the training has not converged".to_owned(),
            )
            .example(format!("median {:.3}, 95 % below {:.3}", q.p50, q.p95))
            .help("train longer, or check the poses; labels of haze mean little");
    }
    let invisible = count_rows(rows, |row| scene.opacity(row) < INVISIBLE);
    if invisible.count as f64 > INVISIBLE_SHARE * rows as f64 {
        findings.add(
            Severity::Note,
            "invisible",
            invisible,
            format!(
                "{} of the Gaussians have an opacity below 1/255, which no renderer draws",
                percent(invisible.count, rows)
            ),
        );
    }
}

pub(super) fn check_harmonics(findings: &mut Findings<'_>, scene: &GaussianScene, used: u8) {
    if used < scene.sh_degree {
        findings.add(
            Severity::Note,
            "unused_harmonics",
            Counted::of(scene.len()),
            format!(
                "degree {} is declared, but coefficients beyond degree {used} are all zero",
                scene.sh_degree
            ),
        );
    }
}

fn percent(count: usize, of: usize) -> String {
    let share = 100.0 * count as f64 / of.max(1) as f64;
    match share {
        s if s >= 0.1 => format!("{s:.1} %"),
        s if s >= 0.01 => format!("{s:.2} %"),
        _ => "fewer than 0.01 %".to_owned(),
    }
}
/// Most columns that a message lists.
const MAX_LISTED: usize = 12;

/// Columns that nothing reads, and which of them may be labels.
pub(super) fn check_unread(findings: &mut Findings<'_>, unread: &[UnreadColumn]) {
    if unread.is_empty() {
        return;
    }
    let listed = unread.iter().take(MAX_LISTED).map(|c| format!("{} ({})", c.name, c.kind));
    let listed = listed.collect::<Vec<_>>().join(", ");
    let more = match unread.len().saturating_sub(MAX_LISTED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let message = format!("the file also holds what nothing here reads: {listed}{more}");
    let help = label_names(unread).map(|names| format!("choose {names} if these are its labels"));
    findings
        .add(Severity::Note, "unread_columns", Counted::of(0), message)
        .help(&help.unwrap_or_default());
}
