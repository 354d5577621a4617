//! Reading any version.

use super::attributes::{
    ByteTables, decode_bytes, decode_positions, decode_rest, decode_triples, rest_factors,
};
use super::extensions::Records;
use super::header::{ANTIALIASED, Block, Contents, Header, MAGIC, read_legacy};
use super::quaternion::QuatCoding;
use super::rows::{Buffers, both, read_block, skip_block};
use super::signs::Signs;
use super::source::{LEGACY_SIZE, Source, Trailing};
use crate::formats::{LoadedScene, ReadOptions, SceneFormat, SpzFrame, semantics};
use crate::frame::Frame;
use crate::value_policy::Rule;
use crate::{GaussianScene, RepairReport, SceneError};
use std::path::Path;

/// Reads a scene from the bytes of an SPZ file of version 1 to 4.
///
/// Versions 1 to 3 may be a gzip stream, a zstd frame, or not compressed. Alpha 0 and 255 become
/// the logits ±inf, which is what they say. Numbers are converted from the frame that the file
/// names, or else from `options.spz_frame`; with [`SpzFrame::Raw`] they are never converted.
/// Labels that the writer added are read; other extension records are skipped,
/// and the report says so.
///
/// No more is decompressed than the header calls for, and memory grows with what is really there. A
/// scene of more than 32 MiB without compression must not be more than 256 times its file.
///
/// # Errors
/// As [`open_scene`](crate::open_scene); also if the file is of another version, ends early, fails
/// its checksum, or contradicts itself.
pub fn read_spz(
    bytes: &[u8],
    path: &Path,
    options: &ReadOptions,
) -> Result<LoadedScene, SceneError> {
    let (scene, report) = read_spz_as_stored(bytes, path, options)?;
    LoadedScene::finish(scene, report, options.policy, path, SceneFormat::Spz)
}

/// As [`read_spz`], with bad values still in place.
pub(crate) fn read_spz_as_stored(
    bytes: &[u8],
    path: &Path,
    options: &ReadOptions,
) -> Result<(GaussianScene, RepairReport), SceneError> {
    let mut read = match v4_header(bytes) {
        Some(header) => header.and_then(|header| read_v4(bytes, header, options)),
        None => read_legacy_file(bytes, options),
    }
    .map_err(|problem| damaged(path, problem))?;
    let mut report = RepairReport { notes: read.records.notes, ..RepairReport::default() };
    let rows = read.header.rows;
    match read.trailing {
        Trailing::Nothing => {}
        Trailing::Behind(n) => report.add(Rule::FileTrailing, 1, rows, &format!("{n} bytes")),
        Trailing::Within => report.add(Rule::FileTrailing, 1, rows, "a longer stream"),
    }
    read.scene.antialiased = read.header.flags & ANTIALIASED != 0;
    if let Some(frame) = read.stated {
        if options.spz_frame == SpzFrame::Raw {
            report.notes.push(format!("says that it is {frame}; not converted, as asked"));
        } else {
            restate(&mut read.scene, &read.signs, frame);
            report.notes.push(format!("says that it is {frame}; converted from there"));
        }
    }
    if let Some(block) = &read.labels {
        semantics::decode(block, rows, &mut read.scene, &mut report, path)?;
    }
    Ok((read.scene, report))
}

/// The number of Gaussians and the degree of their harmonics, checked as when they are read.
///
/// # Errors
/// As [`read_spz`], for what can be said of the header alone.
pub(crate) fn peek_spz(bytes: &[u8], path: &Path) -> Result<(usize, u8), SceneError> {
    let header = match v4_header(bytes) {
        Some(header) => header.and_then(|header| header.check_size(bytes.len()).map(|()| header)),
        None => Source::open(bytes).and_then(|mut source| read_legacy(&mut source, bytes.len())),
    };
    let header = header.map_err(|problem| damaged(path, problem))?;
    Ok((header.rows, header.degree))
}

fn damaged(path: &Path, problem: String) -> SceneError {
    SceneError::format(path, problem, "copy the file again, or export the scene again as SPZ")
}

/// The header of a file that is not wrapped in a stream and not of an older version.
fn v4_header(bytes: &[u8]) -> Option<Result<Header, String>> {
    let head = bytes.first_chunk::<LEGACY_SIZE>().filter(|head| head.starts_with(&MAGIC))?;
    match Header::parse(head) {
        Ok(header) if header.version < 4 => None,
        other => Some(other),
    }
}

/// What came out of a file.
struct ReadFile {
    header: Header,
    scene: GaussianScene,
    /// The frame that the file says it is in.
    stated: Option<Frame>,
    /// The signs that `scene` was decoded with.
    signs: Signs,
    labels: Option<Vec<u8>>,
    records: Records,
    trailing: Trailing,
}

/// Converts from the frame that the file states, where it is not the one that was assumed.
fn restate(scene: &mut GaussianScene, assumed: &Signs, frame: Frame) {
    match Signs::of(frame) {
        Some(signs) if signs == *assumed => {}
        Some(signs) => {
            assumed.apply(scene);
            signs.apply(scene);
        }
        None => {
            assumed.apply(scene);
            scene.change_frame(frame, Frame::CANONICAL);
        }
    }
}

/// Decodes the blocks of one file.
struct Decoder {
    header: Header,
    signs: Signs,
    tables: ByteTables,
    factors: Vec<f32>,
}

impl Decoder {
    fn new(header: Header, signs: Signs) -> Self {
        Self { header, signs, tables: ByteTables::new(), factors: rest_factors(&header, &signs) }
    }

    fn positions(&self, from: &mut Source<'_>, by: &mut Buffers) -> Result<Vec<[f32; 3]>, String> {
        read_block(from, by, &self.header, Block::Positions, 1, |bytes, out| {
            decode_positions(bytes, &self.header, &self.signs, out);
        })
    }

    fn alphas(&self, from: &mut Source<'_>, by: &mut Buffers) -> Result<Vec<f32>, String> {
        read_block(from, by, &self.header, Block::Alphas, 1, |bytes, out| {
            decode_bytes(bytes, &self.tables.logit, out);
        })
    }

    fn colors(&self, from: &mut Source<'_>, by: &mut Buffers) -> Result<Vec<[f32; 3]>, String> {
        read_block(from, by, &self.header, Block::Colors, 1, |bytes, out| {
            decode_triples(bytes, &self.tables.color, out);
        })
    }

    fn scales(&self, from: &mut Source<'_>, by: &mut Buffers) -> Result<Vec<[f32; 3]>, String> {
        read_block(from, by, &self.header, Block::Scales, 1, |bytes, out| {
            decode_triples(bytes, &self.tables.scale, out);
        })
    }

    fn rotations(&self, from: &mut Source<'_>, by: &mut Buffers) -> Result<Vec<[f32; 4]>, String> {
        let coding = QuatCoding::of(self.header.version);
        read_block(from, by, &self.header, Block::Rotations, 1, |bytes, out| {
            coding.decode_rows(bytes, &self.signs, out);
        })
    }

    fn rest(&self, from: &mut Source<'_>, by: &mut Buffers) -> Result<Vec<f32>, String> {
        let per_row = self.header.rest_len() * 3;
        read_block(from, by, &self.header, Block::Harmonics, per_row, |bytes, out| {
            decode_rest(bytes, &self.factors, out);
        })
    }
}

/// Versions 1 to 3: one stream, block after block.
fn read_legacy_file(bytes: &[u8], options: &ReadOptions) -> Result<ReadFile, String> {
    let mut source = Source::open(bytes)?;
    let header = read_legacy(&mut source, bytes.len())?;
    let signs = Signs::assumed(options.spz_frame);
    let decoder = Decoder::new(header, signs);
    // On a thread of the pool, so that parts are handed over without waking anyone.
    let scene = both(&header, || legacy_blocks(&mut source, &decoder, options), || ()).0?;
    let records = match header.has_extensions() {
        true => Records::read(&mut source, header.rows)?,
        false => Records::default(),
    };
    let trailing = source.trailing()?;
    let labels = records.label_block(header.rows)?;
    Ok(ReadFile { header, scene, stated: records.frame, signs, labels, records, trailing })
}

fn legacy_blocks(
    from: &mut Source<'_>,
    decoder: &Decoder,
    options: &ReadOptions,
) -> Result<GaussianScene, String> {
    let (by, header) = (&mut Buffers::default(), &decoder.header);
    let mut scene = GaussianScene {
        // Fields are evaluated in the order they are written in, which is that of the file.
        coord: decoder.positions(from, by)?,
        opacity_logit: decoder.alphas(from, by)?,
        sh_dc: decoder.colors(from, by)?,
        log_scale: decoder.scales(from, by)?,
        quat: decoder.rotations(from, by)?,
        ..GaussianScene::default()
    };
    if options.sh_rest && header.degree > 0 {
        scene.sh_rest = decoder.rest(from, by)?;
        scene.sh_degree = header.degree;
    } else if header.degree > 0 {
        // Still decompressed: what follows and the checksum at the end count.
        skip_block(from, by, header, Block::Harmonics)?;
    }
    Ok(scene)
}

/// Version 4: a stream per block, decoded side by side.
fn read_v4(bytes: &[u8], header: Header, options: &ReadOptions) -> Result<ReadFile, String> {
    let contents = Contents::parse(bytes, &header)?;
    // After the table, whose mistakes say more about a damaged file.
    header.check_size(bytes.len())?;
    let records = match header.has_extensions() {
        true => Records::read(&mut Source::Raw(contents.extensions), header.rows)?,
        false => Records::default(),
    };
    let signs = match options.spz_frame {
        SpzFrame::Rub => records.frame.and_then(Signs::of),
        SpzFrame::Raw => None,
    };
    let signs = signs.unwrap_or(Signs::assumed(options.spz_frame));
    let decoder = Decoder::new(header, signs);
    let labels = records.label_block(header.rows)?;
    let mut scene = GaussianScene::default();
    if header.rows > 0 {
        let wants_rest = options.sh_rest && header.degree > 0;
        let (h, c, d) = (&header, &contents, &decoder);
        let rest = || match wants_rest {
            true => stream(c, d, Block::Harmonics, Decoder::rest),
            false => Ok(Vec::new()),
        };
        let coord = || stream(c, d, Block::Positions, Decoder::positions);
        let quat = || stream(c, d, Block::Rotations, Decoder::rotations);
        let scale = || stream(c, d, Block::Scales, Decoder::scales);
        let color = || stream(c, d, Block::Colors, Decoder::colors);
        let alpha = || stream(c, d, Block::Alphas, Decoder::alphas);
        let places = || both(h, coord, quat);
        let looks = || both(h, scale, || both(h, color, alpha));
        // The harmonics are most of the file and of the work, so they come first and alone.
        let (rest, ((coord, quat), (log_scale, (sh_dc, opacity_logit)))) =
            both(h, rest, || both(h, places, looks));
        // In the order of the file, so that the first error is the same for any number of threads.
        scene.coord = coord?;
        scene.opacity_logit = opacity_logit?;
        scene.sh_dc = sh_dc?;
        scene.log_scale = log_scale?;
        scene.quat = quat?;
        scene.sh_rest = rest?;
        scene.sh_degree = if wants_rest { header.degree } else { 0 };
    }
    let trailing = match contents.trailing {
        0 => Trailing::Nothing,
        n => Trailing::Behind(n),
    };
    Ok(ReadFile { header, scene, stated: records.frame, signs, labels, records, trailing })
}

/// Decodes one stream and checks that nothing follows in it.
fn stream<T>(
    contents: &Contents<'_>,
    decoder: &Decoder,
    block: Block,
    decode: impl Fn(&Decoder, &mut Source<'_>, &mut Buffers) -> Result<Vec<T>, String>,
) -> Result<Vec<T>, String> {
    let fail = |problem: String| format!("its {} {problem}", block.name());
    let stream = contents.streams.iter().find(|stream| stream.block == block);
    let stream = stream.ok_or_else(|| fail("are missing".to_owned()))?;
    let due = decoder.header.block_bytes(block);
    let mut source = Source::zstd(stream.compressed, due).map_err(fail)?;
    let values = decode(decoder, &mut source, &mut Buffers::default())?;
    match source.trailing().map_err(fail)? {
        Trailing::Nothing => Ok(values),
        _ => Err(fail(format!("go on after {due} bytes"))),
    }
}
