//! Scalars for TensorBoard.

use crate::TrainError;
use crate::event::{Callback, Event, Flow, Progress};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Writes an event file that TensorBoard reads: `tensorboard --logdir FOLDER`.
///
/// The format is a sequence of records (length, checksum, content, checksum) whose content is a
/// protocol-buffer `Event`. Only the four fields that a scalar needs are written, by hand: the
/// crates for it bring a code generator along.
#[derive(Debug)]
pub struct TensorBoard {
    folder: PathBuf,
    file: Option<BufWriter<File>>,
}

impl TensorBoard {
    /// Writes into `folder`, which is made when the run starts. Each start opens a new file, as
    /// TensorBoard expects.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), file: None }
    }

    fn open(&mut self, step: u64) -> Result<(), TrainError> {
        std::fs::create_dir_all(&self.folder)
            .map_err(TrainError::io(&self.folder, "cannot make"))?;
        let seconds = now() as u64;
        let name = format!("events.out.tfevents.{seconds:010}.scenesplat.{step}");
        let file = create(&self.folder.join(name))
            .map_err(TrainError::io(&self.folder, "cannot write in"))?;
        let mut file = BufWriter::new(file);
        // Field 3 of an event: the version of the file.
        let mut event = field_f64(1, now());
        event.extend(field_bytes(3, b"brain.Event:2"));
        record(&mut file, &event).map_err(TrainError::io(&self.folder, "cannot write in"))?;
        self.file = Some(file);
        Ok(())
    }
}

/// Makes a file that was not there: a run that is resumed within a second gets one of its own.
fn create(path: &Path) -> std::io::Result<File> {
    let mut number = 0;
    loop {
        let mut name = path.as_os_str().to_owned();
        if number > 0 {
            name.push(format!(".{number}"));
        }
        match File::create_new(&name) {
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists && number < 1000 => number += 1,
            made => return made,
        }
    }
}

impl Callback for TensorBoard {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        let measurements = match event {
            Event::FitStart { .. } => {
                self.open(at.step)?;
                return Ok(Flow::Continue);
            }
            Event::Step { measurements } | Event::Eval { measurements, .. } => *measurements,
            _ => return Ok(Flow::Continue),
        };
        let error = TrainError::io(&self.folder, "cannot write in");
        let Some(file) = &mut self.file else { return Ok(Flow::Continue) };
        for m in measurements {
            record(file, &scalar(at.step, &m.name, m.value as f32)).map_err(&error)?;
        }
        file.flush().map_err(&error)?;
        Ok(Flow::Continue)
    }
}

/// Seconds since 1970, for the horizontal axis "wall time".
fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64())
}

/// `Event { wall_time: 1, step: 2, summary: 5 { value: 1 { tag: 1, simple_value: 2 } } }`
fn scalar(step: u64, tag: &str, value: f32) -> Vec<u8> {
    let mut entry = field_bytes(1, tag.as_bytes());
    entry.push(2 << 3 | 5);
    entry.extend(value.to_le_bytes());
    let mut event = field_f64(1, now());
    event.push(2 << 3);
    event.extend(varint(step));
    event.extend(field_bytes(5, &field_bytes(1, &entry)));
    event
}

fn field_f64(number: u8, value: f64) -> Vec<u8> {
    let mut out = vec![number << 3 | 1];
    out.extend(value.to_le_bytes());
    out
}

fn field_bytes(number: u8, bytes: &[u8]) -> Vec<u8> {
    let mut out = vec![number << 3 | 2];
    out.extend(varint(bytes.len() as u64));
    out.extend(bytes);
    out
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut out = Vec::new();
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
    out
}

fn record(file: &mut impl Write, content: &[u8]) -> std::io::Result<()> {
    let length = (content.len() as u64).to_le_bytes();
    file.write_all(&length)?;
    file.write_all(&masked(&length))?;
    file.write_all(content)?;
    file.write_all(&masked(content))
}

/// The checksum as these files hold it: rotated, and moved by a constant.
fn masked(bytes: &[u8]) -> [u8; 4] {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xA282_EAD8).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_have_the_documented_layout() {
        let mut out = Vec::new();
        record(&mut out, b"abc").unwrap();
        assert_eq!(out.len(), 8 + 4 + 3 + 4);
        assert_eq!(out[..8], 3_u64.to_le_bytes());
        assert_eq!(out[12..15], *b"abc");
        // CRC-32C of eight zero bytes is 8c28b28a; masked as the format prescribes.
        let expected = 0x8c28_b28a_u32.rotate_right(15).wrapping_add(0xA282_EAD8);
        assert_eq!(masked(&[0; 8]), expected.to_le_bytes());
    }

    #[test]
    fn scalars_are_protocol_buffers() {
        let event = scalar(300, "train/loss", 1.5);
        assert_eq!(event[0], 0x09, "wall time: field 1, eight bytes");
        assert_eq!(event[9..12], [0x10, 0xAC, 0x02], "step 300: field 2, varint");
        let summary = &event[12..];
        assert_eq!(summary[..2], [0x2A, 19], "summary: field 5, 19 bytes");
        assert_eq!(summary[2..4], [0x0A, 17], "value: field 1, 17 bytes");
        assert_eq!(summary[4..6], [0x0A, 10], "tag: field 1, ten bytes");
        assert_eq!(&summary[6..16], b"train/loss");
        assert_eq!(summary[16], 0x15, "value: field 2, four bytes");
        assert_eq!(summary[17..], 1.5_f32.to_le_bytes());
    }
}
