//! Measures a scene before it is processed: its contents, its faults, and the cost of a network.
//!
//! [`inspect`] measures and judges; [`sheet`] draws the result; [`Inspection`] prints as a table and
//! is written as JSON. Every number is finite or null. The thresholds were set on the real scenes
//! listed in `docs/inspect.md`, which raise no finding.

mod checks;
mod content;
mod duplicates;
mod estimate;
mod findings;
mod floaters;
mod neighbourhood;
mod rates;
pub mod sheet;
mod statistics;
mod table;
mod unit;

pub use content::{Distribution, LabelCounts, LanguageCodes, ShBand, Voxels};
pub use estimate::{Estimate, estimate};
pub use findings::{Finding, Severity};
pub use floaters::{Floaters, find_floaters};
pub(crate) use rates::PROCESS_BYTES;
pub use statistics::{Border, Histogram, Quantiles};
pub use unit::{LengthUnit, ReadUnit, SizedUnit, UnitGuess};
pub(crate) use unit::{guess_unit, is_surely_no_metre, may_be_no_metre, usual_spacing};

use crate::NetworkConfig;
use crate::datasets::effects::profile::{EffectProfile, profile};
use content::TooWide;
use findings::Findings;
use neighbourhood::Neighbourhood;
use scenesplat_kernels::simd::Isa;
pub use scenesplat_scene::{Bounds, UpEvidence, UpGuess};
use scenesplat_scene::{LoadedScene, UnreadColumn, guess_up, raw_bounds, robust_bounds};
use serde::Serialize;

/// Settings of [`inspect`].
#[derive(Debug, Clone)]
pub struct InspectSettings {
    /// Whether the scene was a point cloud that was turned into Gaussians.
    pub from_points: bool,
    /// Which way is up, if it is known; judged by the shape of the scene if not.
    pub up: Option<UpGuess>,
    /// In what unit a network reads the scene, if it is known; judged by the extent if not.
    pub unit: Option<ReadUnit>,
    /// Voxel size, meters.
    pub grid_size: f64,
    /// The network to estimate the cost of, and its name; `None`: no estimate.
    pub network: Option<(String, NetworkConfig)>,
    /// Memory of the machine, bytes: more is a finding. `None`: not known.
    pub machine_bytes: Option<u64>,
}

impl Default for InspectSettings {
    fn default() -> Self {
        Self {
            from_points: false,
            up: None,
            unit: None,
            grid_size: 0.02,
            network: None,
            machine_bytes: None,
        }
    }
}

/// Result of [`inspect`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// The file or folder.
    pub path: String,
    /// What it is: `ply`, `compressed-ply`, `npy`, `splat`, `spz`, `sog`, `ksplat`, `gltf`, `usda`,
    /// `usdz`, or `points` for a labeled point cloud.
    pub format: &'static str,
    /// Rows in the file.
    pub gaussians: usize,
    /// Rows that can be used; everything below is about them.
    pub usable: usize,
    /// Rows left out.
    pub dropped: usize,
    /// What was subtracted from all positions on reading; the boxes and examples of findings are
    /// relative to it. `None` near 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub origin: Option<[f64; 3]>,
    /// Box around everything, meters.
    pub bounds: Bounds,
    /// Box around the scene without what is stray, meters.
    pub robust_bounds: Bounds,
    /// Sides of the robust box, meters.
    pub extent: [f64; 3],
    /// Median distance to the fourth neighbor, meters.
    pub spacing: Option<f64>,
    /// Which way seems to be up.
    pub up: UpGuess,
    /// What one unit seems to be; `None` without any extent, or where it is none of the usual ones.
    pub unit: Option<UnitGuess>,
    /// The unit by things of known size, if a network looked for them.
    pub sized: Option<SizedUnit>,
    /// Spherical-harmonic degree that the file declares.
    pub sh_degree: u8,
    /// Highest degree with a coefficient that could change a color.
    pub sh_degree_used: u8,
    /// The higher bands one by one.
    pub sh_bands: Vec<ShBand>,
    /// Opacity, 0..=1.
    pub opacity: Distribution,
    /// Largest standard deviation of each Gaussian, meters; its histogram is of log10.
    pub largest_scale: Distribution,
    /// Smallest standard deviation of each Gaussian, meters; its histogram is of log10.
    pub smallest_scale: Distribution,
    /// Largest standard deviation divided by the smallest; its histogram is of log10.
    pub anisotropy: Distribution,
    /// Occupancy of the network's voxels; `None` if not even the robust part fits on the grid.
    pub voxels: Option<Voxels>,
    /// Whether there are normals.
    pub has_normals: bool,
    /// Class labels, if there are any.
    pub labels: Option<LabelCounts>,
    /// Language codes, if there are any.
    pub language_codes: Option<LanguageCodes>,
    /// Whether the scene was trained for antialiased rendering, and is drawn so.
    pub antialiased: bool,
    /// Columns, arrays and elements of the file that nothing reads.
    pub unread: Vec<UnreadColumn>,
    /// What the scene says about its capture, by effect.
    pub effects: EffectProfile,
    /// What is wrong, the worst first; empty for a clean scene.
    pub findings: Vec<Finding>,
    /// What is worth knowing though nothing is wrong.
    pub notes: Vec<Finding>,
    /// What a network will cost; `None` if not asked for or without voxels.
    pub estimate: Option<Estimate>,
}

/// Measures a scene and lists findings.
///
/// The result is the same for any number of threads, except for the time of the estimate.
///
/// ```
/// use scenesplat::inspect::{InspectSettings, inspect};
/// use scenesplat::scene::{ReadOptions, open_scene};
///
/// # use scenesplat::rooms::{SyntheticRoomSettings, generate};
/// # let folder = std::env::temp_dir().join(format!("inspect-{}", std::process::id()));
/// # let (room, _) = (folder.join("room.ply"), std::fs::create_dir_all(&folder)?);
/// # let scene = generate(&SyntheticRoomSettings::with_count(16_000, 7))?.scene;
/// # scenesplat::scene::formats::inria_ply::write_inria_ply(&scene, &[], &room)?;
/// let loaded = open_scene(&room, &ReadOptions::default())?;
/// # std::fs::remove_dir_all(&folder)?;
/// let seen = inspect(&loaded, &InspectSettings::default());
/// assert_eq!((seen.gaussians, seen.findings.len()), (16_000, 0));
/// println!("{seen}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn inspect(loaded: &LoadedScene, settings: &InspectSettings) -> Inspection {
    let scene = &loaded.scene;
    let bounds = raw_bounds(&scene.coord);
    let robust = robust_bounds(&scene.coord);
    let zone = robust.grown(checks::OUTLIER_DIAGONALS * robust.diagonal());
    let near = neighbourhood::neighbourhood(scene, &zone);
    let (voxels, too_wide) = content::voxels(scene, settings.grid_size, &zone);
    let unit = unit::guess_unit(&robust, near.spacing);
    let (unit, sized) = unit::as_read(unit, settings.unit.as_ref());
    let up = settings.up.clone().unwrap_or_else(|| guess_up(scene, loaded.stated_up));
    let sh_bands = content::sh_bands(scene);
    let sh_degree_used = sh_bands.iter().filter(|b| b.rows > 0).map(|b| b.band).max().unwrap_or(0);
    let opacity = content::opacity(scene);
    let (largest_scale, smallest_scale, anisotropy) = content::scales(scene);

    let metres = unit.as_ref().map_or(1.0, |guess| guess.unit.metres());
    let effects = profile(scene, metres);
    let estimate =
        settings.network.as_ref().zip(voxels.as_ref()).map(|((name, config), voxels)| {
            let threads = rayon::current_num_threads();
            estimate(scene, voxels.count, name, config, threads, Isa::current())
        });
    let mut seen = Inspection {
        path: loaded.path.display().to_string(),
        format: if settings.from_points { "points" } else { loaded.kind.name() },
        gaussians: loaded.source_rows(),
        usable: scene.len(),
        dropped: loaded.report.dropped_rows,
        origin: scene.has_origin().then_some(scene.origin),
        bounds,
        robust_bounds: robust,
        extent: robust.extent(),
        spacing: near.spacing,
        up,
        unit,
        sized,
        sh_degree: scene.sh_degree,
        sh_degree_used,
        sh_bands,
        opacity,
        largest_scale,
        smallest_scale,
        anisotropy,
        voxels,
        has_normals: scene.normal.is_some(),
        labels: content::labels(scene),
        language_codes: content::language_codes(scene),
        antialiased: scene.antialiased,
        unread: loaded.unread.clone(),
        effects,
        findings: Vec::new(),
        notes: Vec::new(),
        estimate,
    };
    let mut findings = findings(loaded, &seen, &near, too_wide.as_ref());
    checks::check_memory(&mut findings, seen.estimate.as_ref(), settings.machine_bytes);
    (seen.findings, seen.notes) = findings.split();
    seen
}

/// What the checks of the scene find.
fn findings<'a>(
    loaded: &'a LoadedScene,
    seen: &Inspection,
    near: &Neighbourhood,
    too_wide: Option<&TooWide>,
) -> Findings<'a> {
    let scene = &loaded.scene;
    let (rows, robust) = (scene.len(), &seen.robust_bounds);
    let mut findings = Findings::of_reading(loaded);
    checks::check_positions(&mut findings, scene, &seen.bounds, robust, too_wide);
    checks::check_outliers(&mut findings, scene, robust);
    checks::check_up(&mut findings, rows, &seen.up);
    checks::check_unit(&mut findings, rows, seen.unit.as_ref(), robust);
    checks::check_sizes(&mut findings, scene, robust);
    checks::check_isolated(&mut findings, scene, near);
    checks::check_duplicates(&mut findings, &duplicates::find_duplicates(scene), rows);
    checks::check_opacity(&mut findings, scene, &seen.opacity);
    checks::check_harmonics(&mut findings, scene, seen.sh_degree_used);
    checks::check_unread(&mut findings, &loaded.unread);
    findings
}
