//! Pictures of Gaussians, forward.

use super::{kernels, radix_sort, scan};
use crate::launch::{
    Items::{PerBlock, PerThread},
    Launcher,
    Scalar::{F32, U32},
};

kernels! { "rasterize":
    /// Footprints, colors and the tiles they meet.
    PROJECT_GAUSSIANS = project_gaussians, 128, PerThread;
    /// How many were not drawn, and why.
    COUNT_FATES = count_fates, 256, PerThread;
    /// Pairs of tile and Gaussian.
    LIST_TILE_PAIRS = list_tile_pairs, 128, PerThread;
    /// First pair of each tile.
    TILE_STARTS = tile_starts, 256, PerThread;
    /// A tile a block, a pixel a thread.
    BLEND_TILES = blend_tiles, 256, PerBlock(1);
}

/// Most pairs of Gaussian and tile: 12 GiB while they are sorted.
pub const MOST_PAIRS: u64 = 1 << 29;
/// Side of a tile, pixels.
const TILE: u32 = 16;
/// Values of the array of what does not depend on the Gaussian.
const LENS_VALUES: usize = 36;

/// A pinhole camera, as the rasterizer's `View`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// World to camera, row by row: `[R | t]`.
    pub world_to_camera: [[f32; 4]; 3],
    /// Focal lengths along x and y, pixels.
    pub focal: [f32; 2],
    /// Principal point, pixels from the upper left corner.
    pub centre: [f32; 2],
    /// Pixels across and down.
    pub size: [u32; 2],
}

impl View {
    /// Tiles across and down.
    fn tiles(&self) -> [u32; 2] {
        self.size.map(|s| s.div_ceil(TILE))
    }

    /// Where the camera is in the world: `−Rᵀt`.
    fn eye(&self) -> [f32; 3] {
        let m = &self.world_to_camera;
        let along = |k: usize| (0..3).map(|i| f64::from(m[i][k]) * f64::from(m[i][3])).sum::<f64>();
        [0, 1, 2].map(|k| -along(k) as f32)
    }

    /// Lowest and highest tangent that the Jacobian of the projection sees along an axis.
    fn tangents(&self, axis: usize, about_the_middle: bool) -> [f32; 2] {
        let (f, c, size) = (self.focal[axis], self.centre[axis], self.size[axis] as f32);
        let half = size / (2.0 * f);
        if about_the_middle {
            [-1.3 * half, 1.3 * half]
        } else {
            [-(c / f + 0.3 * half), (size - c) / f + 0.3 * half]
        }
    }
}

/// Constants of a render, as the rasterizer's `RasterSettings`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Nearest and farthest depth drawn.
    pub depth: [f32; 2],
    /// Whether a center exactly at the nearest is not drawn.
    pub near_excluded: bool,
    /// Variance added to the projected covariance, px².
    pub eps2d: f32,
    /// Largest α of one Gaussian at one pixel.
    pub alpha_max: f32,
    /// Below this α a Gaussian does not count at a pixel.
    pub alpha_cut: f32,
    /// A pixel goes on while its transmittance would be above this.
    pub stop_above: f32,
    /// Standard deviations and least value under the root of the square that a Gaussian is cut off at; `None` for
    /// the ellipse, which loses no pixel.
    pub circle: Option<[f32; 2]>,
    /// Whether quaternions are normalized.
    pub normalize_quats: bool,
    /// Whether tangents are limited about the middle of the picture.
    pub centred_tangents: bool,
    /// Least value of the factor by which opacity makes up for `eps2d`; `None` without.
    pub antialias_floor: Option<f32>,
    /// Color behind everything.
    pub background: [f32; 3],
    /// The caller's promise that the three scales of every Gaussian are equal.
    pub isotropic: bool,
}

/// Gaussians with activated values, on the device.
#[derive(Debug)]
pub struct Gaussians<'a, B> {
    /// Centers. `[N, 3]`
    pub means: &'a B,
    /// Orientation `w, x, y, z`. `[N, 4]`
    pub quats: &'a B,
    /// Standard deviations. `[N, 3]`
    pub scales: &'a B,
    /// In 0..=1. `[N]`
    pub opacities: &'a B,
    /// Spherical harmonics. `[N, K, 3]`, `K = (sh_degree + 1)²`
    pub sh: &'a B,
    /// Degree of `sh`, 0 to 3.
    pub sh_degree: u32,
    /// Gaussians, N.
    pub count: u32,
}

/// Gaussians that were not drawn, by the first reason that applied.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CullCounts {
    /// Drawn, or at least listed.
    pub drawn: u32,
    /// A center, a quaternion or a scale that is not finite.
    pub not_finite: u32,
    /// Nearer or farther than the depths drawn.
    pub depth: u32,
    /// Beside the picture.
    pub outside: u32,
    /// A quaternion without a direction.
    pub zero_quat: u32,
    /// A footprint that f32 does not hold.
    pub overflow: u32,
    /// Opacity below the cut, or NaN.
    pub opacity: u32,
    /// A color that is not finite.
    pub color: u32,
}

/// A picture on the device, row by row.
#[derive(Debug)]
pub struct Picture<B> {
    /// Color with the background; not written where no color was asked for. `[H, W, 3]`
    pub rgb: B,
    /// What is left of the light. `[H, W]`
    pub transmittance: B,
    /// `Σ w z`. `[H, W]`
    pub depth: B,
    /// Depth of the last Gaussian with more than half of the light before it, 0 for none. `[H, W]`
    pub median_depth: B,
    /// What was not drawn.
    pub culled: CullCounts,
    /// Pairs of Gaussian and tile.
    pub pairs: u32,
}

/// Why a picture is not rendered.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RasterizeError<E: std::error::Error> {
    /// Gaussians that cover too many tiles together.
    #[error(
        "{pairs} pairs of Gaussians and tiles, at most {MOST_PAIRS} are possible (render parts of the picture)"
    )]
    TooManyPairs {
        /// Pairs counted.
        pairs: u64,
    },
    /// The device reports an error.
    #[error(transparent)]
    Launch(#[from] E),
}

fn lens(view: &View, settings: &Settings) -> [f32; LENS_VALUES] {
    let mut lens = [0.0; LENS_VALUES];
    lens[..12].copy_from_slice(view.world_to_camera.as_flattened());
    lens[12..14].copy_from_slice(&view.focal);
    lens[14..16].copy_from_slice(&view.centre);
    lens[16..18].copy_from_slice(&view.size.map(|s| s as f32));
    lens[18..20].copy_from_slice(&view.tangents(0, settings.centred_tangents));
    lens[20..22].copy_from_slice(&view.tangents(1, settings.centred_tangents));
    lens[22..24].copy_from_slice(&settings.depth);
    lens[24] = settings.eps2d;
    lens[25] = settings.antialias_floor.unwrap_or(0.0);
    lens[26] = settings.alpha_cut;
    // Standard deviations at which opacity 1 falls below the cut.
    lens[27] = (-2.0 * settings.alpha_cut.ln()).sqrt();
    lens[28..30].copy_from_slice(&settings.circle.unwrap_or_default());
    lens[30..33].copy_from_slice(&view.eye());
    lens
}

fn flags(settings: &Settings) -> u32 {
    let bits = [
        settings.near_excluded,
        settings.circle.is_some(),
        settings.normalize_quats,
        settings.antialias_floor.is_some(),
        settings.isotropic,
    ];
    bits.iter().enumerate().map(|(i, &on)| u32::from(on) << i).sum()
}

/// Gaussians as a view sees them, a row each.
struct Projected<B> {
    splats: B,
    colors: B,
    boxes: B,
    /// Tiles that each meets.
    counts: B,
    fates: B,
}

fn project<L: Launcher>(
    l: &L,
    gaussians: &Gaussians<'_, L::Buffer>,
    view: &View,
    settings: &Settings,
    degree: Option<u32>,
) -> Result<Projected<L::Buffer>, L::Error> {
    let Gaussians { means, quats, scales, opacities, sh, sh_degree, count: n } = *gaussians;
    let stride = 3 * (sh_degree + 1).pow(2);
    let used = degree.map_or(0, |d| (d + 1).pow(2));
    assert!(sh_degree <= 3 && degree.is_none_or(|d| d <= sh_degree), "degree");
    let rows = u64::from(n);
    l.expect::<[f32; 3]>("means", means, rows);
    l.expect::<[f32; 4]>("quats", quats, rows);
    l.expect::<[f32; 3]>("scales", scales, rows);
    l.expect::<f32>("opacities", opacities, rows);
    l.expect::<f32>("harmonics", sh, rows * u64::from(stride));
    let [columns, tile_rows] = view.tiles();
    let lens = l.upload_values(&lens(view, settings))?;
    let mut seen = Projected {
        splats: l.alloc_values::<[f32; 8]>(n as usize)?,
        colors: l.alloc_values::<[f32; 3]>(n as usize)?,
        boxes: l.alloc_values::<[u32; 4]>(n as usize)?,
        counts: l.alloc_values::<u32>(n as usize)?,
        fates: l.alloc_values::<u32>(n as usize)?,
    };
    let Projected { splats, colors, boxes, counts, fates } = &mut seen;
    let numbers =
        [n, flags(settings), stride, used, degree.is_some().into(), columns, tile_rows].map(U32);
    l.run(
        &PROJECT_GAUSSIANS,
        rows,
        &[means, quats, scales, opacities, sh, &lens],
        &mut [splats, colors, boxes, counts, fates],
        &numbers,
    )?;
    Ok(seen)
}

/// How many were drawn and were not, and the pairs of Gaussian and tile.
fn count<L: Launcher>(
    l: &L,
    seen: &Projected<L::Buffer>,
    n: u32,
) -> Result<(CullCounts, u32), RasterizeError<L::Error>> {
    let mut totals = l.upload_values(&[0u64; 9])?;
    let inputs = [&seen.fates, &seen.counts];
    l.run(&COUNT_FATES, n.into(), &inputs, &mut [&mut totals], &[U32(n)])?;
    let [fates @ .., pairs] = l.download_values::<[u64; 9]>(&totals, 1)?[0];
    if pairs > MOST_PAIRS {
        return Err(RasterizeError::TooManyPairs { pairs });
    }
    let [drawn, not_finite, depth, outside, zero_quat, overflow, opacity, color] =
        fates.map(|count| count as u32);
    let culled =
        CullCounts { drawn, not_finite, depth, outside, zero_quat, overflow, opacity, color };
    Ok((culled, pairs as u32))
}

/// First pair of each tile, and the Gaussian of each pair, near ones first.
fn sort_by_tile<L: Launcher>(
    l: &L,
    seen: &Projected<L::Buffer>,
    n: u32,
    pairs: u32,
    [columns, tile_rows]: [u32; 2],
) -> Result<[L::Buffer; 2], L::Error> {
    let before = scan::running_sums(l, &seen.counts, n.into())?.before;
    let mut keys = l.alloc_values::<u64>(pairs as usize)?;
    let mut of = l.alloc_values::<u32>(pairs as usize)?;
    l.run(
        &LIST_TILE_PAIRS,
        n.into(),
        &[&seen.splats, &seen.boxes, &seen.counts, &before],
        &mut [&mut keys, &mut of],
        &[U32(n), U32(columns)],
    )?;
    let tiles = columns * tile_rows;
    let bits = u32::BITS + (u32::BITS - tiles.saturating_sub(1).leading_zeros());
    let pairs_of = radix_sort::Sorted { codes: keys, rows: of };
    let sorted = radix_sort::sort_further(l, pairs_of, pairs, 0, bits)?;
    let mut starts = l.alloc_values::<u32>(tiles as usize + 1)?;
    let (items, numbers) = (u64::from(tiles) + 1, [U32(pairs), U32(tiles)]);
    l.run(&TILE_STARTS, items, &[&sorted.codes], &mut [&mut starts], &numbers)?;
    Ok([starts, sorted.rows])
}

/// Renders a view. `degree` is the highest band of the harmonics to use; `None` renders no color.
///
/// # Errors
/// If Gaussians and tiles make more than [`MOST_PAIRS`], and the launcher's.
///
/// # Panics
/// If arrays are too short, or the degree is above that of the harmonics.
pub fn render<L: Launcher>(
    l: &L,
    gaussians: &Gaussians<'_, L::Buffer>,
    view: &View,
    settings: &Settings,
    degree: Option<u32>,
) -> Result<Picture<L::Buffer>, RasterizeError<L::Error>> {
    let seen = project(l, gaussians, view, settings, degree)?;
    let (culled, pairs) = count(l, &seen, gaussians.count)?;
    let [columns, tile_rows] = view.tiles();
    let [starts, of] = sort_by_tile(l, &seen, gaussians.count, pairs, view.tiles())?;
    let [width, height] = view.size;
    let pixels = width as usize * height as usize;
    let mut picture = Picture {
        rgb: l.alloc_values::<[f32; 3]>(if degree.is_some() { pixels } else { 0 })?,
        transmittance: l.alloc_values::<f32>(pixels)?,
        depth: l.alloc_values::<f32>(pixels)?,
        median_depth: l.alloc_values::<f32>(pixels)?,
        culled,
        pairs,
    };
    let Picture { rgb, transmittance, depth, median_depth, .. } = &mut picture;
    let [red, green, blue] = settings.background;
    let Settings { alpha_cut, alpha_max, stop_above, .. } = *settings;
    let sizes = [width, height, columns].map(U32);
    let light = [alpha_cut, alpha_max, stop_above, red, green, blue].map(F32);
    let numbers = [&sizes[..], &light, &[U32(degree.is_some().into())]].concat();
    l.run(
        &BLEND_TILES,
        u64::from(columns * tile_rows),
        &[&seen.splats, &seen.colors, &starts, &of],
        &mut [rgb, transmittance, depth, median_depth],
        &numbers,
    )?;
    Ok(picture)
}
