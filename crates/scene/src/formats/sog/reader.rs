//! From textures to the arrays of a scene.

use super::codes::{ByteTable, LogAxis, decode_quat};
use super::meta::SogMeta;
use super::source::{PartBytes, Source};
use super::texture::TextureHead;
use crate::SceneError;
use crate::gaussian_scene::{GaussianScene, sh_rest_len};
use rayon::prelude::*;
use std::ops::Range;
use std::path::PathBuf;

/// Rows that one task turns from texels into values.
const ROWS_PER_TASK: usize = 16_384;
/// From so many rows on, a table of all 65,536 codes is quicker than computing each position.
pub(super) const ROWS_FOR_TABLE: usize = 32_768;
/// Centroids of the palette in a line of their texture.
pub(super) const CENTROIDS_PER_LINE: usize = 64;
/// Rows that any file may have, and rows for each byte of its positions beyond that. Real files
/// have a quarter of a row per byte; textures of one color would allow any number.
const FREE_ROWS: usize = 1 << 18;
const ROWS_PER_BYTE: u64 = 32;
/// Texels that any texture may have.
const FREE_TEXELS: usize = 1 << 20;

/// How many rows so many bytes of positions can stand for.
pub(super) fn plausible_rows(position_bytes: u64) -> u64 {
    position_bytes.saturating_mul(ROWS_PER_BYTE).saturating_add(FREE_ROWS as u64)
}

/// A texture that is there, with its size.
struct Texture<'a> {
    path: PathBuf,
    part: PartBytes<'a>,
    head: TextureHead,
}

impl Texture<'_> {
    fn decode(&self) -> Result<Vec<u8>, SceneError> {
        self.head.decode(self.part.bytes(), &self.path)
    }
}

/// The higher coefficients, opened.
struct ShRest<'a> {
    degree: u8,
    entries: usize,
    table: Box<ByteTable>,
    centroids: Texture<'a>,
    labels: Texture<'a>,
}

/// A scene whose textures are all there and of the right size, before any is decoded.
pub(super) struct OpenSog<'a> {
    pub(super) meta: SogMeta,
    means: [Texture<'a>; 2],
    quats: Texture<'a>,
    scales: Texture<'a>,
    sh0: Texture<'a>,
    sh_rest: Option<ShRest<'a>>,
}

impl<'a> OpenSog<'a> {
    /// Reads `meta.json` and the heads of the textures. No memory is taken by any count before it
    /// was held against the bytes that are really there.
    pub(super) fn open(source: &Source<'a>, with_rest: bool) -> Result<Self, SceneError> {
        let (meta_path, text) = source.meta()?;
        let mut meta = SogMeta::parse(text.bytes(), &meta_path)?;
        let there: u64 = meta.means.iter().map(|name| source.bytes_there(name)).sum();
        if meta.count as u64 > plausible_rows(there) {
            let problem = format!("has count {}, but only {there} bytes of positions", meta.count);
            return Err(SceneError::format(&meta_path, problem, "export the scene again"));
        }
        let count = meta.count;
        // Padding beyond four times the rows, or a megapixel, would be for no reason.
        let texels = count.saturating_mul(4).max(FREE_TEXELS);
        let open = |name: &str| -> Result<Texture<'a>, SceneError> {
            let (path, part) = source.part(name, texels.saturating_mul(8))?;
            let head = TextureHead::find(part.bytes(), &path)?;
            Ok(Texture { path, part, head })
        };
        let of_rows = |name: &str| -> Result<Texture<'a>, SceneError> {
            let texture = open(name)?;
            let (width, height) = (texture.head.width, texture.head.height);
            if !(count..=texels).contains(&texture.head.texels()) {
                let problem = format!("is {width}×{height} texels for {count} Gaussians");
                return Err(SceneError::format(&texture.path, problem, "export the scene again"));
            }
            Ok(texture)
        };
        let means = [of_rows(&meta.means[0])?, of_rows(&meta.means[1])?];
        let quats = of_rows(&meta.quats)?;
        let scales = of_rows(&meta.scales)?;
        let sh0 = of_rows(&meta.sh0)?;
        let sh_rest = match meta.sh_rest.take().filter(|_| with_rest) {
            None => None,
            Some(rest) => {
                let labels = of_rows(&rest.labels)?;
                let centroids = open(&rest.centroids)?;
                let bad = |problem: String| {
                    SceneError::format(&centroids.path, problem, "export the scene again")
                };
                let (width, height) = (centroids.head.width, centroids.head.height);
                let degree = [1u8, 2, 3].into_iter().find(|&d| width == line_width(d));
                let Some(degree) = degree.filter(|&d| rest.degree.is_none_or(|due| due == d))
                else {
                    let due = rest.degree.map_or("192, 512 or 960".into(), |d| {
                        format!("{} for {d} bands", line_width(d))
                    });
                    return Err(bad(format!("is {width} texels wide, not {due}")));
                };
                let entries = rest.entries.unwrap_or(CENTROIDS_PER_LINE * height);
                if entries > CENTROIDS_PER_LINE * height || height > 1024 {
                    return Err(bad(format!("is {height} texels high for {entries} centroids")));
                }
                Some(ShRest { degree, entries, table: rest.table, centroids, labels })
            }
        };
        Ok(Self { meta, means, quats, scales, sh0, sh_rest })
    }

    /// Degree of the harmonics that [`decode`](Self::decode) fills in.
    pub(super) fn sh_degree(&self) -> u8 {
        self.sh_rest.as_ref().map_or(0, |rest| rest.degree)
    }

    /// Decodes the runs of rows into rows of a scene, from `first` on.
    ///
    /// Textures are decoded at the same time, as there are threads, and dropped as soon as their
    /// values are in the scene. A scene of a higher degree keeps its zeros beyond that of the file.
    pub(super) fn decode(
        &self,
        runs: &[Range<usize>],
        scene: &mut GaussianScene,
        first: usize,
    ) -> Result<(), SceneError> {
        let rows = first..first + runs.iter().map(Range::len).sum::<usize>();
        let rest_len = scene.sh_rest_len() * 3;
        let rest_rows = rows.start * rest_len..rows.end * rest_len;
        let coord = &mut scene.coord[rows.clone()];
        let quat = &mut scene.quat[rows.clone()];
        let log_scale = &mut scene.log_scale[rows.clone()];
        let opacity = &mut scene.opacity_logit[rows.clone()];
        let sh_dc = &mut scene.sh_dc[rows];
        let sh_rest = &mut scene.sh_rest[rest_rows];
        let (means, (quats, (scales, (colors, rest)))) = rayon::join(
            || self.decode_means(runs, coord),
            || {
                rayon::join(
                    || self.decode_quats(runs, quat),
                    || {
                        rayon::join(
                            || self.decode_scales(runs, log_scale),
                            || {
                                rayon::join(
                                    || self.decode_colors(runs, sh_dc, opacity),
                                    || self.decode_rest(runs, sh_rest, rest_len),
                                )
                            },
                        )
                    },
                )
            },
        );
        means.and(quats).and(scales).and(colors).and(rest)
    }

    fn decode_means(
        &self,
        runs: &[Range<usize>],
        coord: &mut [[f32; 3]],
    ) -> Result<(), SceneError> {
        let [low, high] = &self.means;
        let (low, high) = rayon::join(|| low.decode(), || high.decode());
        let (low, high) = (low?, high?);
        let (low, high) = (low.as_chunks::<4>().0, high.as_chunks::<4>().0);
        let code = |row: usize, i: usize| u16::from_le_bytes([low[row][i], high[row][i]]);
        let (mins, maxs) = (&self.meta.mins, &self.meta.maxs);
        let axes = [0, 1, 2].map(|i| LogAxis { min: mins[i], max: maxs[i] });
        if coord.len() < ROWS_FOR_TABLE {
            fill(runs, coord, |row| [0, 1, 2].map(|i| axes[i].decode(code(row, i))));
        } else {
            let tables = axes.map(|axis| -> Vec<f32> {
                (0..=u16::MAX).into_par_iter().map(|code| axis.decode(code)).collect()
            });
            let [x, y, z] = &tables;
            let at = |table: &[f32], row: usize, i: usize| table[usize::from(code(row, i))];
            fill(runs, coord, |row| [at(x, row, 0), at(y, row, 1), at(z, row, 2)]);
        }
        Ok(())
    }

    fn decode_quats(&self, runs: &[Range<usize>], quat: &mut [[f32; 4]]) -> Result<(), SceneError> {
        let texels = self.quats.decode()?;
        let texels = texels.as_chunks::<4>().0;
        fill(runs, quat, |row| decode_quat(texels[row]));
        Ok(())
    }

    fn decode_scales(
        &self,
        runs: &[Range<usize>],
        log_scale: &mut [[f32; 3]],
    ) -> Result<(), SceneError> {
        let texels = self.scales.decode()?;
        let texels = texels.as_chunks::<4>().0;
        let [x, y, z] = &*self.meta.scale_tables;
        fill(runs, log_scale, |row| look_up([x, y, z], texels[row]));
        Ok(())
    }

    fn decode_colors(
        &self,
        runs: &[Range<usize>],
        sh_dc: &mut [[f32; 3]],
        opacity: &mut [f32],
    ) -> Result<(), SceneError> {
        let texels = self.sh0.decode()?;
        let texels = texels.as_chunks::<4>().0;
        let [r, g, b, alpha] = &*self.meta.color_tables;
        fill(runs, sh_dc, |row| look_up([r, g, b], texels[row]));
        fill(runs, opacity, |row| alpha[usize::from(texels[row][3])]);
        Ok(())
    }

    fn decode_rest(
        &self,
        runs: &[Range<usize>],
        sh_rest: &mut [f32],
        rest_len: usize,
    ) -> Result<(), SceneError> {
        let Some(rest) = &self.sh_rest else { return Ok(()) };
        let (centroids, labels) = rayon::join(|| rest.centroids.decode(), || rest.labels.decode());
        let (centroids, labels) = (centroids?, labels?);
        let labels = labels.as_chunks::<4>().0;
        let label = |row: usize| usize::from(u16::from_le_bytes([labels[row][0], labels[row][1]]));
        for run in runs {
            let wrong = run.clone().into_par_iter().find_first(|&row| label(row) >= rest.entries);
            if let Some(row) = wrong {
                let problem =
                    format!("row {row} has label {} of {} centroids", label(row), rest.entries);
                let path = &rest.labels.path;
                return Err(SceneError::format(path, problem, "export the scene again"));
            }
        }
        // Texels of an entry follow each other, so the palette is the texture row by row.
        let width = sh_rest_len(rest.degree) * 3;
        let palette: Vec<f32> = centroids
            .as_chunks::<4>()
            .0
            .iter()
            .take(rest.entries * sh_rest_len(rest.degree))
            .flat_map(|t| [0, 1, 2].map(|i| rest.table[usize::from(t[i])]))
            .collect();
        drop(centroids);
        let mut after = sh_rest;
        for run in runs {
            let (here, others) = after.split_at_mut(run.len() * rest_len);
            after = others;
            let tasks = here.par_chunks_mut(ROWS_PER_TASK * rest_len).enumerate();
            tasks.for_each(|(task, rows)| {
                for (i, out) in rows.chunks_exact_mut(rest_len).enumerate() {
                    let label = label(run.start + task * ROWS_PER_TASK + i);
                    out[..width].copy_from_slice(&palette[label * width..(label + 1) * width]);
                }
            });
        }
        Ok(())
    }
}

/// The values of the first three bytes of a texel.
fn look_up(tables: [&ByteTable; 3], texel: [u8; 4]) -> [f32; 3] {
    let [x, y, z] = tables;
    [x[usize::from(texel[0])], y[usize::from(texel[1])], z[usize::from(texel[2])]]
}

/// Width of the texture of centroids.
pub(super) fn line_width(degree: u8) -> usize {
    CENTROIDS_PER_LINE * sh_rest_len(degree)
}

/// Fills `out` with the values of the rows in the runs, in their order.
fn fill<T: Send>(runs: &[Range<usize>], out: &mut [T], value: impl Fn(usize) -> T + Sync) {
    let mut after = out;
    for run in runs {
        let (here, others) = after.split_at_mut(run.len());
        after = others;
        let one_task = |(task, out): (usize, &mut [T])| {
            for (i, out) in out.iter_mut().enumerate() {
                *out = value(run.start + task * ROWS_PER_TASK + i);
            }
        };
        if run.len() <= ROWS_PER_TASK {
            one_task((0, here));
        } else {
            here.par_chunks_mut(ROWS_PER_TASK).enumerate().for_each(one_task);
        }
    }
}
