//! Bytes of a file, decompressed as they are asked for.

use flate2::bufread::GzDecoder;
use std::io::{ErrorKind, Read};
use zstd::stream::read::Decoder;
use zstd::zstd_safe::get_frame_content_size;

/// Size of the header of versions 1 to 3.
pub(super) const LEGACY_SIZE: usize = 16;

/// First bytes of a gzip stream.
pub(super) const GZIP: [u8; 2] = [0x1f, 0x8b];
/// First bytes of a zstd frame.
pub(super) const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// Most bytes that deflate makes of one: a match of 258 in two bits.
const DEFLATE_RATIO: u64 = 1032;
/// Most bytes for each of the file that a scene may be without compression, if it is not small.
///
/// Real scenes are below 4; one with harmonics of 0 and positions on a grid might reach 100. Above
/// [`ALWAYS_FITS`] this is stricter than the 1024 / 9 Gaussians a byte of the reference, as none has
/// less than 16 bytes. zstd could make 32 768 bytes of one: 20 million Gaussians of 40 KB.
const MOST_EXPANSION: u64 = 256;
/// Bytes that a scene may be without compression whatever the file is: some hundred thousand equal
/// Gaussians compress to nothing. In memory they are at most four times that.
const ALWAYS_FITS: u64 = 32 << 20;
/// Window that a zstd decoder should always support (RFC 8878, 3.1.1.1.2).
const SMALLEST_WINDOW: u64 = 8 << 20;

/// Most bytes that a file of that size is believed to hold, all blocks together, whatever it says.
pub(super) fn most_decompressed(file_bytes: usize) -> u64 {
    (file_bytes as u64).saturating_mul(MOST_EXPANSION).max(ALWAYS_FITS)
}

/// A stream of bytes.
pub(super) enum Source<'a> {
    /// Stored as they are.
    Raw(&'a [u8]),
    /// One gzip stream; the size of the file.
    Gzip(Box<GzDecoder<&'a [u8]>>, usize),
    /// zstd frames, and the most bytes that they may hold.
    Zstd(Decoder<'static, &'a [u8]>, u64),
}

impl<'a> Source<'a> {
    /// A file of version 1 to 3, by its first bytes.
    pub(super) fn open(file: &'a [u8]) -> Result<Self, String> {
        if file.starts_with(&GZIP) {
            return Ok(Self::Gzip(Box::new(GzDecoder::new(file)), file.len()));
        }
        if file.starts_with(&ZSTD) {
            let most = match get_frame_content_size(file) {
                Ok(Some(size)) => size,
                Ok(None) => u64::MAX,
                Err(_) => return Err("has a damaged zstd header".to_owned()),
            };
            let most = most.min(most_decompressed(file.len()));
            return Ok(Self::Zstd(decoder(file, most)?.single_frame(), most));
        }
        Ok(Self::Raw(file))
    }

    /// A zstd stream that decompresses to at most `most` bytes, if it is honest.
    pub(super) fn zstd(stream: &'a [u8], most: u64) -> Result<Self, String> {
        match get_frame_content_size(stream) {
            Ok(Some(size)) if size > most => Err(format!("hold {size} bytes instead of {most}")),
            Ok(_) => Ok(Self::Zstd(decoder(stream, most)?, most)),
            Err(_) => Err("are no zstd stream".to_owned()),
        }
    }

    /// Most bytes that there can be, from what is known before decompression.
    pub(super) fn most(&self) -> u64 {
        match self {
            Self::Raw(left) => left.len() as u64 + LEGACY_SIZE as u64,
            Self::Gzip(_, size) => {
                (*size as u64).saturating_mul(DEFLATE_RATIO).min(most_decompressed(*size))
            }
            Self::Zstd(_, most) => *most,
        }
    }

    /// Compressed bytes not read yet.
    pub(super) fn left(&self) -> usize {
        match self {
            Self::Raw(left) => left.len(),
            Self::Gzip(decoder, _) => decoder.get_ref().len(),
            Self::Zstd(decoder, _) => decoder.get_ref().len(),
        }
    }

    /// Fills `out` and gives how many bytes there were; fewer only at the end.
    ///
    /// To find the end is also what checks the sum at the end of a gzip stream.
    pub(super) fn fill(&mut self, out: &mut [u8]) -> Result<usize, String> {
        let mut done = 0;
        while done < out.len() {
            match self.read(&mut out[done..]) {
                Ok(0) => break,
                Ok(n) => done += n,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                // The compressed stream was cut off: what came so far is all there is.
                Err(e) if e.kind() == ErrorKind::UnexpectedEof => break,
                Err(e) => return Err(format!("cannot be decompressed: {e}")),
            }
        }
        Ok(done)
    }

    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        match self {
            Self::Raw(left) => left.read(out),
            Self::Gzip(decoder, _) => decoder.read(out),
            Self::Zstd(decoder, _) => decoder.read(out),
        }
    }

    /// Whether the stream begins with `mark`, or is cut off or damaged before that can be told.
    ///
    /// Decompresses no more than the decoder's first block.
    pub(super) fn may_begin_with(mut self, mark: [u8; 4]) -> bool {
        let (mut head, mut done) = ([0; 4], 0);
        while done < head.len() {
            match self.read(&mut head[done..]) {
                Ok(0) => return false,
                Ok(n) => done += n,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => break,
            }
        }
        mark.starts_with(&head[..done])
    }

    /// Bytes that are still there: of the stream, or, once it is over, behind it in the file.
    ///
    /// # Errors
    /// If the stream is damaged, cut off, or fails its checksum.
    pub(super) fn trailing(&mut self) -> Result<Trailing, String> {
        if let Self::Raw(left) = self {
            return Ok(Trailing::behind(left.len()));
        }
        match self.read(&mut [0]) {
            Ok(0) => Ok(Trailing::behind(self.left())),
            Ok(_) => Ok(Trailing::Within),
            Err(e) => Err(format!("cannot be decompressed to its end: {e}")),
        }
    }
}

/// What there is after the last byte that was wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trailing {
    Nothing,
    /// The stream goes on; how long is not worth finding out.
    Within,
    /// So many bytes follow the stream.
    Behind(usize),
}

impl Trailing {
    fn behind(bytes: usize) -> Self {
        if bytes == 0 { Self::Nothing } else { Self::Behind(bytes) }
    }
}

/// A decoder whose window is bounded by what an honest stream of that length needs.
fn decoder(stream: &[u8], most: u64) -> Result<Decoder<'static, &[u8]>, String> {
    let fail = |e: std::io::Error| format!("cannot be decompressed: {e}");
    let mut decoder = Decoder::with_buffer(stream).map_err(fail)?;
    // A frame of known size has no larger window than that; 64 : 1 is far above real scenes.
    let window = most.min((stream.len() as u64).saturating_mul(64)).max(SMALLEST_WINDOW);
    // The most that the library takes.
    let most_log = if cfg!(target_pointer_width = "64") { 31 } else { 30 };
    let log = window.next_power_of_two().trailing_zeros().min(most_log);
    decoder.window_log_max(log).map_err(fail)?;
    Ok(decoder)
}
