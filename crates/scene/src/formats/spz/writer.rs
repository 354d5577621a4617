//! Writing versions 2, 3 and 4.

use super::attributes::{
    ByteTables, COLOR_RANGE, COLOR_STEP, MAX_POSITION, REST_RANGE, SCALE_RANGE, SCALE_STEP,
    encode_alpha, encode_color, encode_position, encode_rest, encode_scale, rest_bucket,
};
use super::extensions::records_of;
use super::header::{ANTIALIASED, Block, Header, USUAL_BITS, V4_SIZE};
use super::quaternion::QuatCoding;
use super::signs::Signs;
use crate::AtomicFile;
use crate::disk::File;
use crate::formats::limit_tally::{LimitTally, Limits};
use crate::formats::{WriteOptions, WriteProgress, WriteReport};
use crate::{GaussianScene, SceneError};
use flate2::Compression;
use flate2::write::GzEncoder;
use rayon::prelude::*;
use std::io::{BufWriter, Write};
use std::ops::Range;
use std::path::Path;
use zstd::stream::write::Encoder;

/// Level of the zstd streams, that of the reference.
const LEVEL: i32 = 12;
/// Rows compressed between two calls of `progress`: a few milliseconds for the longest stream.
const ROWS_PER_STEP: usize = 8192;
/// Bytes compressed between two calls of `progress` where there is only one stream.
const BYTES_PER_STEP: usize = 256 << 10;

/// Writes a scene as an SPZ file of version `options.spz_version` (2, 3 or 4), in the frame
/// `options.spz_frame`; labels go along in an extension record.
///
/// Positions are stored in steps of 2⁻¹² m, as all programs do, if they are within ±2048 m. Else
/// the step is doubled until all fit; the report then says what it is and which row is to blame.
/// The bytes are the same on any number of threads, and the same again when the file is read and
/// written another time.
///
/// # Errors
/// As [`write_scene`](crate::write_scene); also if the scene, larger than 32 MiB, compresses to less
/// than a 256th: [`read_spz`](super::read_spz) would not believe the file. Versions 2 and 3 hold no harmonics of degree 4.
pub(in crate::formats) fn write_spz(
    scene: &GaussianScene,
    file: &AtomicFile,
    options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let path = file.target();
    let coder = Coder::new(scene, path, options)?;
    let records = records_of(scene).map_err(|problem| SceneError::format(path, problem, ""))?;
    let write = if coder.header.version == 4 { write_v4 } else { write_legacy };
    let limits = write(&coder, &records, file, progress)?;
    check_size(&coder.header, file)?;
    report_limits(limits, &coder.grid, report);
    Ok(())
}

/// Refuses what compresses so far that readers would take the file for a damaged one.
fn check_size(header: &Header, file: &AtomicFile) -> Result<(), SceneError> {
    let about = file.file().metadata();
    let about = about.map_err(SceneError::io(file.target(), "cannot write the scene"))?;
    header.check_size(usize::try_from(about.len()).unwrap_or(usize::MAX)).map_err(|problem| {
        SceneError::format(file.target(), problem, "remove Gaussians that are equal to others")
    })
}

/// What the format cannot hold, as it is reported after positions on a coarser grid.
const LIMITS: [(&str, &str); 5] = [
    ("coord", "clipped to ±8388607 m"),
    ("log_scale", "clipped to -10..5.9375 (4.5e-5 m to 379 m)"),
    ("opacity_logit", "alpha below 1/510 or above 1 - 1/510 becomes exactly 0 or 1"),
    ("sh_dc", "clipped to ±3.3333"),
    ("sh_rest", "clipped to -1..0.9922"),
];

fn report_limits(
    Limits([coarse, rest @ ..]): Limits<6>,
    grid: &PositionGrid,
    report: &mut WriteReport,
) {
    let step = 1.0 / f64::from(1u32 << grid.bits);
    report.limit(
        "coord",
        format!(
            "stored in steps of {step} m instead of 1/4096 m, for row {} at {} m to be in range; \
             leave out far rows to keep the others fine",
            grid.farthest_row, grid.farthest
        ),
        coarse,
    );
    report.limits(LIMITS, Limits(rest));
}

/// Turns rows of a scene into bytes of a block.
struct Coder<'a> {
    scene: &'a GaussianScene,
    header: Header,
    rows: u32,
    signs: Signs,
    grid: PositionGrid,
    quats: QuatCoding,
    tables: ByteTables,
}

impl<'a> Coder<'a> {
    fn new(
        scene: &'a GaussianScene,
        path: &Path,
        options: &WriteOptions,
    ) -> Result<Self, SceneError> {
        let bad = |problem: String, help: &str| Err(SceneError::format(path, problem, help));
        let version = options.spz_version;
        if !(2..=4).contains(&version) {
            return bad(format!("cannot be written as SPZ version {version}"), "choose 2, 3 or 4");
        }
        let degree = scene.sh_degree;
        if degree > 4 || (degree == 4 && version < 4) {
            let problem =
                format!("of SPZ version {version} cannot hold harmonics of degree {degree}");
            return bad(problem, "write version 4, or fewer harmonics");
        }
        let Ok(rows) = u32::try_from(scene.len()) else {
            return bad(format!("cannot hold {} Gaussians", scene.len()), "split the scene");
        };
        let grid = PositionGrid::of(scene);
        let header = Header {
            version: version.into(),
            rows: scene.len(),
            degree,
            fractional_bits: grid.bits,
            flags: if scene.antialiased { ANTIALIASED } else { 0 },
        };
        let signs = Signs::assumed(options.spz_frame);
        let (quats, tables) = (QuatCoding::of(header.version), ByteTables::new());
        Ok(Self { scene, header, rows, signs, grid, quats, tables })
    }

    /// The blocks that have bytes.
    fn blocks(&self) -> impl Iterator<Item = Block> {
        Block::ALL.into_iter().filter(|&block| self.header.block_bytes(block) > 0)
    }

    /// Appends the bytes of some rows.
    fn encode(&self, block: Block, rows: Range<usize>, out: &mut Vec<u8>, limits: &mut Limits<6>) {
        let scene = self.scene;
        let Limits([step, range, cut_scale, ends, cut_color, cut_rest]) = limits;
        match block {
            Block::Positions => self.encode_positions(rows, out, [step, range]),
            Block::Alphas => {
                for row in rows {
                    let logit = scene.opacity_logit[row];
                    let byte = encode_alpha(logit);
                    if (byte == 0 || byte == 255) && logit.is_finite() {
                        // As far as alpha was from 0 or 1.
                        let change = 1.0 / (1.0 + f64::from(logit.abs()).exp());
                        ends.add(row, change);
                    }
                    out.push(byte);
                }
            }
            Block::Colors => {
                for row in rows {
                    let (dc, half) = (scene.sh_dc[row], COLOR_STEP / 2.0);
                    let bytes = dc.map(encode_color);
                    let back = bytes.map(|b| self.tables.color[usize::from(b)]);
                    let range = [-COLOR_RANGE, COLOR_RANGE];
                    if let Some(change) = clipped(&dc, &back, range, half) {
                        cut_color.add(row, change);
                    }
                    out.extend_from_slice(&bytes);
                }
            }
            Block::Scales => {
                for row in rows {
                    let (scale, half) = (scene.log_scale[row], SCALE_STEP / 2.0);
                    let bytes = scale.map(encode_scale);
                    let back = bytes.map(|b| self.tables.scale[usize::from(b)]);
                    if let Some(change) = clipped(&scale, &back, SCALE_RANGE, half) {
                        cut_scale.add(row, change);
                    }
                    out.extend_from_slice(&bytes);
                }
            }
            Block::Rotations => {
                let width = Block::Rotations.row_bytes(&self.header);
                for row in rows {
                    // Quaternions without a direction were refused before.
                    let code = self.quats.encode(scene.quat[row], &self.signs).unwrap_or_default();
                    out.extend_from_slice(&code.to_le_bytes()[..width]);
                }
            }
            Block::Harmonics => self.encode_rest(rows, out, cut_rest),
        }
    }

    fn encode_positions(
        &self,
        rows: Range<usize>,
        out: &mut Vec<u8>,
        [coarse, clipped]: [&mut LimitTally; 2],
    ) {
        let step = 1.0 / f64::from(1u32 << self.grid.bits);
        let usual_error = 0.5 / f64::from(1u32 << USUAL_BITS);
        for row in rows {
            let (mut worst, mut fits) = (0.0f64, true);
            for (value, sign) in self.scene.coord[row].into_iter().zip(self.signs.coord) {
                let value = value * sign;
                let (code, within) = encode_position(value, self.grid.bits);
                fits &= within;
                worst = worst.max((f64::from(value) - f64::from(code) * step).abs());
                out.extend_from_slice(&code.to_le_bytes()[..3]);
            }
            if !fits {
                clipped.add(row, worst);
            } else if worst > usual_error {
                coarse.add(row, worst);
            }
        }
    }

    fn encode_rest(&self, rows: Range<usize>, out: &mut Vec<u8>, cut: &mut LimitTally) {
        let width = self.header.rest_len() * 3;
        for row in rows {
            let values = &self.scene.sh_rest[row * width..][..width];
            let mut worst: Option<f64> = None;
            for (k, (rgb, sign)) in
                values.as_chunks::<3>().0.iter().zip(self.signs.rest).enumerate()
            {
                let bucket = rest_bucket(k);
                let rgb = rgb.map(|v| v * sign);
                let bytes = rgb.map(|v| encode_rest(v, bucket));
                let back = bytes.map(|b| (f32::from(b) - 128.0) / 128.0);
                let half = (bucket + 1) as f32 / 256.0;
                if let Some(change) = clipped(&rgb, &back, REST_RANGE, half) {
                    worst = Some(worst.map_or(change, |w| w.max(change)));
                }
                out.extend_from_slice(&bytes);
            }
            if let Some(worst) = worst {
                cut.add(row, worst);
            }
        }
    }
}

/// The largest change of values outside of the range, unless rounding explains it (`half` a step).
fn clipped(values: &[f32; 3], back: &[f32; 3], range: [f32; 2], half: f32) -> Option<f64> {
    let mut worst: Option<f64> = None;
    for (&value, &back) in values.iter().zip(back) {
        if !(range[0]..=range[1]).contains(&value) {
            let change = (value - back).abs();
            if change > half {
                worst = Some(worst.unwrap_or(0.0).max(f64::from(change)));
            }
        }
    }
    worst
}

/// How positions are stored, and why.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PositionGrid {
    /// Fractional bits.
    bits: u8,
    /// The row that needs most range.
    farthest_row: usize,
    /// Its largest coordinate.
    farthest: f32,
}

impl PositionGrid {
    /// The finest grid, at most the usual one, on which all positions fit into 24 bits.
    ///
    /// On the grid that is chosen, the farthest position is rounded to at least half of the range,
    /// so that from the rounded positions the same grid is chosen again.
    fn of(scene: &GaussianScene) -> Self {
        let far =
            |(row, v): (usize, &[f32; 3])| (v.iter().fold(0.0f32, |m, v| m.max(v.abs())), row);
        // Of equal ones the first, whatever the number of threads.
        let farther = |a: (f32, usize), b: (f32, usize)| {
            if b.0 > a.0 || (b.0 == a.0 && b.1 < a.1) { b } else { a }
        };
        let none = || (-1.0, usize::MAX);
        let (farthest, farthest_row) =
            scene.coord.par_iter().enumerate().map(far).reduce(none, farther);
        let fits =
            |bits: &u8| (f64::from(farthest) * f64::from(1u32 << bits)).round() <= MAX_POSITION;
        let bits = (0..=USUAL_BITS).rev().find(fits).unwrap_or(0);
        Self { bits, farthest_row, farthest }
    }
}

/// A block on its way into a zstd stream.
struct Stream {
    block: Block,
    encoder: Encoder<'static, Vec<u8>>,
    bytes: Vec<u8>,
    limits: Limits<6>,
}

fn write_v4(
    coder: &Coder<'_>,
    records: &[u8],
    file: &AtomicFile,
    progress: WriteProgress<'_>,
) -> Result<Limits<6>, SceneError> {
    let io = || SceneError::io(file.target(), "cannot write the scene");
    let start = |block| -> std::io::Result<Stream> {
        let mut encoder = Encoder::new(Vec::new(), LEVEL)?;
        // The size in the frame lets readers check it before they reserve memory.
        encoder.set_pledged_src_size(Some(coder.header.block_bytes(block)))?;
        encoder.include_contentsize(true)?;
        Ok(Stream { block, encoder, bytes: Vec::new(), limits: Limits::default() })
    };
    let streams: std::io::Result<Vec<Stream>> = coder.blocks().map(start).collect();
    let mut streams = streams.map_err(io())?;
    let rows = coder.header.rows;
    // All streams go on together, so that whoever waits at the end of a step waits briefly.
    for first in (0..rows).step_by(ROWS_PER_STEP) {
        let part = first..(first + ROWS_PER_STEP).min(rows);
        let end = part.end;
        let step = streams.par_iter_mut().with_max_len(1).try_for_each(|stream| {
            stream.bytes.clear();
            coder.encode(stream.block, part.clone(), &mut stream.bytes, &mut stream.limits);
            stream.encoder.write_all(&stream.bytes)
        });
        step.map_err(io())?;
        if !progress(0.95 * end as f64 / rows as f64) {
            return Err(SceneError::Stopped);
        }
    }
    let limits = streams.iter().fold(Limits::default(), |all, stream| all.merge(stream.limits));
    let frames: std::io::Result<Vec<(Block, Vec<u8>)>> = streams
        .into_par_iter()
        .with_max_len(1)
        .map(|stream| Ok((stream.block, stream.encoder.finish()?)))
        .collect();
    let frames = frames.map_err(io())?;

    let head = v4_head(coder, records, &frames, file)?;
    let mut to = file.file();
    to.write_all(&head).map_err(io())?;
    for (_, frame) in &frames {
        to.write_all(frame).map_err(io())?;
        if !progress(0.97) {
            return Err(SceneError::Stopped);
        }
    }
    Ok(limits)
}

/// What is before the frames: header, records, and the sizes of the frames.
fn v4_head(
    coder: &Coder<'_>,
    records: &[u8],
    frames: &[(Block, Vec<u8>)],
    file: &AtomicFile,
) -> Result<Vec<u8>, SceneError> {
    let too_long = || SceneError::format(file.target(), "cannot hold labels of that size", "");
    let toc = u32::try_from(V4_SIZE + records.len()).map_err(|_| too_long())?;
    let header = coder.header.with_records(!records.is_empty());
    let mut head = header.to_bytes(coder.rows, frames.len() as u8).to_vec();
    head.extend_from_slice(&toc.to_le_bytes());
    head.resize(V4_SIZE, 0);
    head.extend_from_slice(records);
    for (block, frame) in frames {
        head.extend_from_slice(&(frame.len() as u64).to_le_bytes());
        head.extend_from_slice(&coder.header.block_bytes(*block).to_le_bytes());
    }
    Ok(head)
}

fn write_legacy(
    coder: &Coder<'_>,
    records: &[u8],
    file: &AtomicFile,
    progress: WriteProgress<'_>,
) -> Result<Limits<6>, SceneError> {
    let io = || SceneError::io(file.target(), "cannot write the scene");
    let header = coder.header.with_records(!records.is_empty());
    let mut to: GzEncoder<BufWriter<&File>> =
        GzEncoder::new(BufWriter::new(file.file()), Compression::default());
    to.write_all(&header.to_bytes(coder.rows, 0)).map_err(io())?;

    let rows = coder.header.rows;
    let parts: Vec<(Block, Range<usize>)> = coder
        .blocks()
        .flat_map(|block| {
            let step = BYTES_PER_STEP / block.row_bytes(&coder.header);
            (0..rows).step_by(step).map(move |row| (block, row..(row + step).min(rows)))
        })
        .collect();
    let mut limits = Limits::default();
    let (mut ready, mut next) = (Vec::new(), Vec::new());
    // One part is compressed while the next is encoded.
    for at in 0..=parts.len() {
        let encode = || {
            next.clear();
            if let Some((block, rows)) = parts.get(at) {
                coder.encode(*block, rows.clone(), &mut next, &mut limits);
            }
        };
        rayon::join(|| to.write_all(&ready), encode).0.map_err(io())?;
        std::mem::swap(&mut ready, &mut next);
        if !progress(0.95 * at as f64 / parts.len() as f64) {
            return Err(SceneError::Stopped);
        }
    }
    for part in records.chunks(BYTES_PER_STEP) {
        to.write_all(part).map_err(io())?;
        if !progress(0.97) {
            return Err(SceneError::Stopped);
        }
    }
    let to = to.finish().map_err(io())?;
    to.into_inner().map_err(|e| io()(e.into_error()))?;
    Ok(limits)
}
