//! Extension records: `u32` type, `u32` length, and so many bytes, one after the other.
//!
//! The upper half of a type names who made it up. Two are known here: the frame of the file, and
//! our labels. Programs that do not know a type skip it by its length, and so do we.

use super::source::{Source, Trailing};
use crate::GaussianScene;
use crate::formats::semantics;
use crate::frame::Frame;

/// Ours: one zstd frame of labels, scores, instances and language codes (see
/// `formats::semantics`), in the order of the Gaussians.
pub(super) const LABELS: u32 = 0x5353_0001;
/// `SPZ_ADOBE_coordinate_system`: a `u32`, the frame that the numbers are in.
const COORDINATE_SYSTEM: u32 = 0xadbe_0003;
/// Its values; 0 is unspecified. Order of `CoordinateSystem` in the reference's `splat-types.h`.
const COORDINATE_SYSTEMS: [&str; 17] = [
    "", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF", "LFD", "RFD", "LFU", "RFU", "LBD",
    "RBD", "LBU", "RBU",
];

/// Bytes read at a time.
const STEP: usize = 64 << 10;
/// Most skipped types that are named.
const NAMED: usize = 4;
/// Level of the labels; they are small.
const LEVEL: i32 = 12;

/// What the records of a file say.
#[derive(Debug, Default)]
pub(super) struct Records {
    /// The zstd frame of our record.
    labels: Option<Vec<u8>>,
    /// The frame that the file says it is in.
    pub(super) frame: Option<Frame>,
    /// Remarks for the report.
    pub(super) notes: Vec<String>,
}

impl Records {
    /// Reads records until the source ends; `rows` bounds what labels may take.
    pub(super) fn read(source: &mut Source<'_>, rows: usize) -> Result<Self, String> {
        let mut records = Self::default();
        let mut skipped: Vec<u32> = Vec::new();
        let mut num_skipped = 0u64;
        loop {
            let mut head = [0; 8];
            let got = source.fill(&mut head)?;
            if got < head.len() {
                if head[..got].iter().any(|&b| b != 0) {
                    return Err(format!("ends after {got} bytes of an extension record"));
                }
                break;
            }
            let [a, b, c, d, e, f, g, h] = head;
            let (kind, size) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
            match kind {
                LABELS if records.labels.is_none() => {
                    if u64::from(size) > most_label_bytes(rows, usize::MAX) {
                        return Err(format!("has labels of {size} bytes for {rows} Gaussians"));
                    }
                    records.labels = Some(read_payload(source, kind, size, true)?);
                }
                COORDINATE_SYSTEM if size == 4 && records.frame.is_none() => {
                    let value = read_payload(source, kind, size, true)?;
                    records.set_frame(&value);
                }
                _ => {
                    read_payload(source, kind, size, false)?;
                    num_skipped += 1;
                    if skipped.len() < NAMED && !skipped.contains(&kind) {
                        skipped.push(kind);
                    }
                }
            }
        }
        if num_skipped > 0 {
            let types: Vec<String> = skipped.iter().map(|kind| format!("{kind:#010x}")).collect();
            let types = types.join(", ");
            let note = format!("skipped {num_skipped} extension records, of type {types}");
            records.notes.push(note);
        }
        Ok(records)
    }

    fn set_frame(&mut self, value: &[u8]) {
        let value = value.iter().rev().fold(0, |sum, &b| sum << 8 | usize::from(b));
        match COORDINATE_SYSTEMS.get(value).map(|name| name.parse()) {
            Some(Ok(frame)) => self.frame = Some(frame),
            Some(Err(_)) => self.notes.push("says that its frame is unspecified".to_owned()),
            None => self.notes.push(format!("says that its frame is number {value}, not known")),
        }
    }

    /// The block of labels.
    pub(super) fn label_block(&self, rows: usize) -> Result<Option<Vec<u8>>, String> {
        let Some(payload) = &self.labels else { return Ok(None) };
        let fail = |problem| format!("its labels {problem}");
        let most = most_label_bytes(rows, payload.len());
        let mut source = Source::zstd(payload, most).map_err(fail)?;
        let mut block = Vec::new();
        let mut step = vec![0; STEP];
        loop {
            let got = source.fill(&mut step).map_err(fail)?;
            if (block.len() + got) as u64 > most {
                return Err(fail(format!("are more than {most} bytes")));
            }
            block.extend_from_slice(&step[..got]);
            if got < STEP {
                break;
            }
        }
        match source.trailing().map_err(fail)? {
            Trailing::Nothing => Ok(Some(block)),
            _ => Err(fail("go on after their end".to_owned())),
        }
    }
}

/// Bytes that labels of so many Gaussians can take, if they are `compressed` to so many.
///
/// For each Gaussian segment, instance, score, and a language code of up to 1024 numbers, which may
/// all be the same. Beside them a codebook: as much as 1024 axes of 4096 numbers and a description
/// of 64 KiB, but only if that many bytes may be in the file: measured numbers hardly compress.
fn most_label_bytes(rows: usize, compressed: usize) -> u64 {
    const DESCRIPTION: u64 = 64 << 10;
    const CODEBOOK: u64 = 4096 * 1024 * 4;
    let codebook = (compressed as u64).saturating_mul(256).min(CODEBOOK);
    rows as u64 * (4 + 4 + 4 + 2 * 1024) + DESCRIPTION + codebook
}

/// The bytes of a record, or nothing, but read all the same. Memory grows with what really comes.
fn read_payload(
    source: &mut Source<'_>,
    kind: u32,
    size: u32,
    keep: bool,
) -> Result<Vec<u8>, String> {
    let mut payload = Vec::new();
    let mut step = vec![0; STEP.min(size as usize)];
    let mut left = size as usize;
    while left > 0 {
        let want = left.min(STEP);
        let got = source.fill(&mut step[..want])?;
        if got < want {
            let there = size as usize - left + got;
            return Err(format!(
                "ends after {there} of {size} bytes of an extension record of type {kind:#010x}"
            ));
        }
        if keep {
            payload.extend_from_slice(&step[..got]);
        }
        left -= got;
    }
    Ok(payload)
}

/// The records that belong to a scene, ready to be written; empty if there is nothing to carry.
pub(super) fn records_of(scene: &GaussianScene) -> Result<Vec<u8>, String> {
    let Some(block) = semantics::encode(scene, None) else { return Ok(Vec::new()) };
    let payload = zstd::bulk::compress(&block, LEVEL)
        .map_err(|e| format!("cannot compress its labels: {e}"))?;
    if block.len() as u64 > most_label_bytes(scene.len(), payload.len()) {
        return Err(format!("cannot hold labels of {} bytes for {}", block.len(), scene.len()));
    }
    let size = u32::try_from(payload.len())
        .map_err(|_| format!("cannot hold labels of {} bytes", payload.len()))?;
    let mut record = Vec::with_capacity(8 + payload.len());
    record.extend_from_slice(&LABELS.to_le_bytes());
    record.extend_from_slice(&size.to_le_bytes());
    record.extend_from_slice(&payload);
    Ok(record)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(kind: u32, payload: &[u8]) -> Vec<u8> {
        let size = payload.len() as u32;
        [&kind.to_le_bytes(), &size.to_le_bytes(), payload].concat()
    }

    fn read(bytes: &[u8]) -> Result<Records, String> {
        Records::read(&mut Source::Raw(bytes), 1)
    }

    #[test]
    fn frames_are_those_of_the_reference() {
        for (value, frame) in
            [(4, "RUB"), (6, "RDF"), (7, "LUF"), (9, "LFD"), (12, "RFU"), (16, "RBU")]
        {
            let bytes = record(COORDINATE_SYSTEM, &u32::to_le_bytes(value));
            assert_eq!(read(&bytes).unwrap().frame, Some(frame.parse().unwrap()));
        }
        for value in [0, 17, u32::MAX] {
            let records = read(&record(COORDINATE_SYSTEM, &value.to_le_bytes())).unwrap();
            assert_eq!((records.frame, records.notes.len()), (None, 1), "{value}");
        }
        // The second half of the frames are the first, turned a quarter about x.
        for i in 1..=8 {
            let turned = |name: &str| {
                let [x, y, z] = name.as_bytes().try_into().unwrap();
                let back = |c| if c == b'B' { b'F' } else { b'B' };
                String::from_utf8(vec![x, back(z), y]).unwrap()
            };
            assert_eq!(COORDINATE_SYSTEMS[i + 8], turned(COORDINATE_SYSTEMS[i]));
        }
    }

    #[test]
    fn unknown_records_are_skipped_and_cut_ones_refused() {
        let mut bytes = record(0x1234_0001, &[7; 100_000]);
        bytes.extend(record(0xadbe_0002, &[1; 12]));
        bytes.extend(record(COORDINATE_SYSTEM, &[6, 0, 0, 0]));
        let records = read(&bytes).unwrap();
        assert_eq!(records.frame, Some(Frame::CANONICAL));
        assert!(records.notes[0].contains("2 extension records, of type 0x12340001, 0xadbe0002"));
        let whole = [0, 100_008, 100_028];
        for cut in (0..bytes.len()).step_by(997).chain(100_000..bytes.len()) {
            assert_eq!(read(&bytes[..cut]).is_ok(), whole.contains(&cut), "{cut}");
        }
        bytes.extend([0; 5]);
        assert!(read(&bytes).is_ok(), "padding is no record");
        let error = read(&record(LABELS, &[])[..4]).unwrap_err();
        assert!(error.contains("4 bytes of an extension record"), "{error}");
    }
}
