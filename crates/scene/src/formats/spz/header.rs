//! The headers, and which blocks follow them.

use crate::gaussian_scene::sh_rest_len;

use super::source::{LEGACY_SIZE, Source, most_decompressed};

/// First bytes of every header.
pub(super) const MAGIC: [u8; 4] = *b"NGSP";
/// Size of the header of version 4.
pub(super) const V4_SIZE: usize = 32;
/// Flag: the scene was trained for antialiased rendering.
pub(super) const ANTIALIASED: u8 = 1;
/// Flag: extension records follow.
pub(super) const EXTENSIONS: u8 = 2;
/// Step of positions, as a power of two, of all known writers: 2⁻¹² m.
pub(super) const USUAL_BITS: u8 = 12;

/// What both kinds of header have in common.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) version: u32,
    pub(super) rows: usize,
    pub(super) degree: u8,
    pub(super) fractional_bits: u8,
    pub(super) flags: u8,
}

impl Header {
    /// From the first 15 bytes, which every version has.
    pub(super) fn parse(bytes: &[u8; LEGACY_SIZE]) -> Result<Self, String> {
        let word = |at: usize| {
            u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        if bytes[..4] != MAGIC {
            return Err(format!("begins with {:02x?}, not with NGSP", &bytes[..4]));
        }
        let (version, [degree, fractional_bits, flags]) =
            (word(4), [bytes[12], bytes[13], bytes[14]]);
        if !(1..=4).contains(&version) {
            return Err(format!("is of SPZ version {version}; known are 1 to 4"));
        }
        if degree > 4 {
            return Err(format!("has harmonics of degree {degree}; at most 4 are known"));
        }
        if fractional_bits > 31 && version > 1 {
            return Err(format!("has positions with {fractional_bits} fractional bits, above 31"));
        }
        let rows = usize::try_from(word(8)).map_err(|_| "has too many Gaussians".to_owned())?;
        Ok(Self { version, rows, degree, fractional_bits, flags })
    }

    /// With the flag of extension records, if there are any.
    pub(super) fn with_records(self, any: bool) -> Self {
        let flags = if any { self.flags | EXTENSIONS } else { self.flags };
        Self { flags, ..self }
    }

    /// The part that every version has; byte 15 is the number of streams in version 4, else 0.
    pub(super) fn to_bytes(self, rows: u32, byte_15: u8) -> [u8; LEGACY_SIZE] {
        let mut bytes = [0; LEGACY_SIZE];
        bytes[..4].copy_from_slice(&MAGIC);
        bytes[4..8].copy_from_slice(&self.version.to_le_bytes());
        bytes[8..12].copy_from_slice(&rows.to_le_bytes());
        bytes[12..].copy_from_slice(&[self.degree, self.fractional_bits, self.flags, byte_15]);
        bytes
    }

    pub(super) fn has_extensions(&self) -> bool {
        self.flags & EXTENSIONS != 0
    }

    /// Coefficients per channel beyond the DC term.
    pub(super) fn rest_len(&self) -> usize {
        sh_rest_len(self.degree)
    }

    /// Bytes of one Gaussian, all blocks together.
    pub(super) fn row_bytes(&self) -> usize {
        Block::ALL.iter().map(|block| block.row_bytes(self)).sum()
    }

    /// Refuses a number of Gaussians that no file of `file_bytes` holds, before anything is reserved
    /// for them.
    pub(super) fn check_size(&self, file_bytes: usize) -> Result<(), String> {
        let (size, most) = (self.total_bytes(), most_decompressed(file_bytes));
        if size <= most {
            return Ok(());
        }
        Err(format!(
            "claims {} Gaussians, {size} bytes; a file of {file_bytes} bytes is not believed to \
             hold more than {most}",
            self.rows
        ))
    }

    /// Bytes of all blocks together.
    fn total_bytes(&self) -> u64 {
        self.rows as u64 * self.row_bytes() as u64
    }

    /// Bytes of a block; no overflow, as there are at most 2³² rows of 72 bytes.
    pub(super) fn block_bytes(&self, block: Block) -> u64 {
        self.rows as u64 * block.row_bytes(self) as u64
    }
}

/// The blocks of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Block {
    Positions,
    Alphas,
    Colors,
    Scales,
    Rotations,
    Harmonics,
}

impl Block {
    /// In the order of the file.
    pub(super) const ALL: [Self; 6] = [
        Self::Positions,
        Self::Alphas,
        Self::Colors,
        Self::Scales,
        Self::Rotations,
        Self::Harmonics,
    ];

    /// For messages.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Positions => "positions",
            Self::Alphas => "alphas",
            Self::Colors => "colors",
            Self::Scales => "scales",
            Self::Rotations => "rotations",
            Self::Harmonics => "spherical harmonics",
        }
    }

    /// Bytes of one Gaussian.
    pub(super) fn row_bytes(self, header: &Header) -> usize {
        match self {
            Self::Positions if header.version == 1 => 6,
            Self::Positions => 9,
            Self::Alphas => 1,
            Self::Colors | Self::Scales => 3,
            Self::Rotations if header.version < 3 => 3,
            Self::Rotations => 4,
            Self::Harmonics => 3 * header.rest_len(),
        }
    }
}

/// A stream of version 4, from the table of contents.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stream<'a> {
    pub(super) compressed: &'a [u8],
    pub(super) block: Block,
}

/// Where things are in a file of version 4.
#[derive(Debug)]
pub(super) struct Contents<'a> {
    /// Extension records.
    pub(super) extensions: &'a [u8],
    /// One for each block that is not empty, in the order of the file.
    pub(super) streams: Vec<Stream<'a>>,
    /// Bytes after the last stream.
    pub(super) trailing: usize,
}

impl<'a> Contents<'a> {
    /// Reads the table of contents of `file` and checks every size in it against the header and
    /// the length of the file. Reserves nothing but the table.
    pub(super) fn parse(file: &'a [u8], header: &Header) -> Result<Self, String> {
        let cut = |what: &str| format!("ends within its {what}, at byte {}", file.len());
        let [.., streams, a, b, c, d] = *file.first_chunk::<20>().ok_or_else(|| cut("header"))?;
        let toc = u64::from(u32::from_le_bytes([a, b, c, d]));
        if file.len() < V4_SIZE {
            return Err(cut("header"));
        }
        let toc = usize::try_from(toc).unwrap_or(usize::MAX);
        if toc < V4_SIZE || toc > file.len() {
            let size = file.len();
            return Err(format!("has its table of contents at byte {toc} of {size}"));
        }
        let (extensions, after) = (&file[V4_SIZE..toc], &file[toc..]);
        let size = usize::from(streams) * 16;
        let (table, mut data) =
            after.split_at_checked(size).ok_or_else(|| cut("table of contents"))?;
        let mut blocks = Block::ALL.iter().filter(|&&block| header.block_bytes(block) > 0);
        let mut found = Vec::new();
        for (i, entry) in table.as_chunks::<16>().0.iter().enumerate() {
            let [compressed, size] =
                [0, 8].map(|at| u64::from_le_bytes(std::array::from_fn(|byte| entry[at + byte])));
            let available = data.len();
            let Some((stream, rest)) =
                usize::try_from(compressed).ok().and_then(|n| data.split_at_checked(n))
            else {
                return Err(format!(
                    "has a stream {i} of {compressed} bytes, but only {available} are left"
                ));
            };
            data = rest;
            if size == 0 {
                continue;
            }
            let Some(&block) = blocks.next() else {
                return Err(format!("has {streams} streams, more than its header calls for"));
            };
            let due = header.block_bytes(block);
            if size != due {
                return Err(format!(
                    "says that its {} take {size} bytes; {} Gaussians take {due}",
                    block.name(),
                    header.rows
                ));
            }
            found.push(Stream { compressed: stream, block });
        }
        if let Some(block) = blocks.next() {
            return Err(format!("has {streams} streams, none of them for its {}", block.name()));
        }
        Ok(Self { extensions, streams: found, trailing: data.len() })
    }
}

/// Reads and checks the header of versions 1 to 3, of a file of `file_bytes`.
pub(super) fn read_legacy(source: &mut Source<'_>, file_bytes: usize) -> Result<Header, String> {
    let mut bytes = [0; LEGACY_SIZE];
    let got = source.fill(&mut bytes)?;
    if got < LEGACY_SIZE {
        return Err(format!("ends within its header, after {got} bytes of {LEGACY_SIZE}"));
    }
    let header = Header::parse(&bytes)?;
    if header.version > 3 {
        return Err(format!("holds a file of version {} within a stream", header.version));
    }
    header.check_size(file_bytes)?;
    let size = LEGACY_SIZE as u64 + header.total_bytes();
    if size > source.most() {
        return Err(format!(
            "claims {} Gaussians, {size} bytes; it cannot hold more than {}",
            header.rows,
            source.most()
        ));
    }
    Ok(header)
}
