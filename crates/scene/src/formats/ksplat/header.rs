//! The headers of a `.ksplat` file, checked against its length.

use crate::gaussian_scene::sh_rest_len;

/// Bytes before the headers of the sections.
pub(super) const HEADER_BYTES: usize = 4096;
/// Bytes of the header of a section.
pub(super) const SECTION_HEADER_BYTES: usize = 1024;
/// The highest level of compression.
pub(super) const MAX_LEVEL: u16 = 2;
/// Bytes of the center of a bucket.
const CENTER_BYTES: usize = 12;
/// Offsets of positions go from 0 to twice this, unless a section says otherwise.
const DEFAULT_RANGE: u32 = 32_767;
/// Bytes stand for coefficients from −1.5 to 1.5, unless the file says otherwise.
const DEFAULT_SH_BOUND: f32 = 1.5;

/// Where everything is.
pub(super) struct KsplatFile<'a> {
    /// 0 floats, 1 halves, 2 halves with coefficients as bytes.
    pub(super) level: u16,
    pub(super) rows: usize,
    /// What coefficients 0 and 255 stand for, at level 2.
    pub(super) sh_bounds: [f32; 2],
    /// Only sections that hold Gaussians.
    pub(super) sections: Vec<Section<'a>>,
    /// Where the last section ends.
    pub(super) end: usize,
}

pub(super) struct Section<'a> {
    /// Its first row in the scene.
    pub(super) first_row: usize,
    pub(super) rows: usize,
    pub(super) sh_degree: u8,
    pub(super) record_bytes: usize,
    pub(super) records: &'a [u8],
    /// `None` at level 0, where positions are whole.
    pub(super) buckets: Option<Buckets<'a>>,
}

pub(super) struct Buckets<'a> {
    /// Row, within the section, at which each bucket starts. Full buckets are not listed.
    partial_starts: Vec<usize>,
    full_count: usize,
    size: usize,
    centers: &'a [[u8; CENTER_BYTES]],
    /// What is taken from an offset, and the length of its step in meters.
    pub(super) range: f64,
    pub(super) step: f64,
}

impl Buckets<'_> {
    /// The bucket of a row of the section.
    pub(super) fn of_row(&self, row: usize) -> usize {
        if row < self.full_count * self.size {
            return row / self.size;
        }
        // The first start is the end of the full buckets, so at least one start is not after it.
        self.full_count + self.partial_starts.partition_point(|&start| start <= row) - 1
    }

    /// The row of the section after the last one of a bucket.
    pub(super) fn end_of(&self, bucket: usize) -> usize {
        if bucket < self.full_count {
            return (bucket + 1) * self.size;
        }
        self.partial_starts.get(bucket - self.full_count + 1).copied().unwrap_or(usize::MAX)
    }

    /// The center of a bucket, meters.
    pub(super) fn center(&self, bucket: usize) -> [f64; 3] {
        [0, 4, 8].map(|at| f64::from(f32_at(&self.centers[bucket], at)))
    }
}

pub(super) fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

pub(super) fn f32_at(bytes: &[u8], at: usize) -> f32 {
    f32::from_bits(u32_at(bytes, at))
}

/// Finds all sections; nothing of the size of a count is reserved before the file is known to
/// hold that much.
pub(super) fn parse(bytes: &[u8]) -> Result<KsplatFile<'_>, String> {
    let Some(header) = bytes.get(..HEADER_BYTES) else {
        return Err(format!(
            "has {} bytes, fewer than the header of a .ksplat file ({HEADER_BYTES})",
            bytes.len()
        ));
    };
    if header[0] != 0 || header[1] == 0 {
        return Err(format!("is .ksplat version {}.{}, not 0.1", header[0], header[1]));
    }
    let level = u16_at(header, 20);
    if level > MAX_LEVEL {
        return Err(format!("has compression level {level}; 0, 1 and 2 are known"));
    }
    let section_count = u32_at(header, 4) as usize;
    let table = bytes[HEADER_BYTES..].as_chunks::<SECTION_HEADER_BYTES>().0;
    let Some(table) = table.get(..section_count) else {
        return Err(format!(
            "should have {section_count} headers of sections, but only {} fit into the file",
            table.len()
        ));
    };
    // 0 and NaN mean that the file does not say.
    let bound = |at, default| {
        let value = f32_at(header, at);
        if value == 0.0 || value.is_nan() { default } else { value }
    };
    let mut file = KsplatFile {
        level,
        rows: 0,
        sh_bounds: [bound(36, -DEFAULT_SH_BOUND), bound(40, DEFAULT_SH_BOUND)],
        sections: Vec::new(),
        end: HEADER_BYTES + section_count * SECTION_HEADER_BYTES,
    };
    for (i, header) in table.iter().enumerate() {
        let section = parse_section(bytes, header, &mut file)
            .map_err(|problem| format!("section {i} {problem}"))?;
        if section.rows > 0 {
            file.rows += section.rows;
            file.sections.push(section);
        }
    }
    let due = u32_at(header, 16) as usize;
    if file.rows != due {
        let rows = file.rows;
        return Err(format!("counts {due} Gaussians, but its sections hold {rows}"));
    }
    Ok(file)
}

/// The section that starts at `file.end`, which becomes the end of it.
fn parse_section<'a>(
    bytes: &'a [u8],
    header: &[u8; SECTION_HEADER_BYTES],
    file: &mut KsplatFile<'_>,
) -> Result<Section<'a>, String> {
    let field = |at: usize| u32_at(header, at) as usize;
    let (rows, max_rows) = (field(0), field(4));
    if rows > max_rows {
        return Err(format!("counts {rows} Gaussians of at most {max_rows}"));
    }
    let sh_degree = match u16_at(header, 40) {
        degree @ 0..=3 => degree as u8,
        degree => return Err(format!("has harmonics of degree {degree}; 0 to 3 are known")),
    };
    let coefficient_bytes = [4, 2, 1][usize::from(file.level)];
    let fixed_bytes = if file.level == 0 { 44 } else { 24 };
    let record_bytes = fixed_bytes + 3 * sh_rest_len(sh_degree) * coefficient_bytes;

    let (bucket_count, partial_count) = (field(12), field(36));
    let center_bytes = usize::from(u16_at(header, 20));
    if file.level > 0 && bucket_count > 0 && center_bytes != CENTER_BYTES {
        return Err(format!("has {center_bytes} bytes for the center of a bucket, not 12"));
    }
    let mut take = |what: &str, count: usize, size: usize| {
        let left = bytes.len() - file.end;
        let length = count.checked_mul(size).filter(|&length| length <= left).ok_or_else(|| {
            format!("should have {count} {what} of {size} bytes, but {left} bytes are left")
        })?;
        let start = file.end;
        file.end += length;
        Ok::<_, String>(&bytes[start..file.end])
    };
    let fill = take("counts of buckets", partial_count, 4)?;
    let centers = take("centers of buckets", bucket_count, center_bytes)?;
    // What follows starts after all the records there is room for.
    let records = take("Gaussians", max_rows, record_bytes)?;
    let records = &records[..rows * record_bytes];
    let buckets = if file.level == 0 || rows == 0 {
        None
    } else {
        Some(parse_buckets(header, fill, centers.as_chunks().0)?)
    };
    Ok(Section { first_row: file.rows, rows, sh_degree, record_bytes, records, buckets })
}

/// Checks that the buckets hold the rows of the section, no more and no fewer.
fn parse_buckets<'a>(
    header: &[u8; SECTION_HEADER_BYTES],
    fill: &[u8],
    centers: &'a [[u8; CENTER_BYTES]],
) -> Result<Buckets<'a>, String> {
    let field = |at: usize| u32_at(header, at) as usize;
    let (rows, max_rows, size, full_count) = (field(0), field(4), field(8), field(32));
    let fill = fill.as_chunks::<4>().0;
    if full_count.saturating_add(fill.len()) > centers.len() {
        return Err(format!(
            "has {full_count} full and {} other buckets, but {} centers",
            fill.len(),
            centers.len()
        ));
    }
    let mut held = full_count.checked_mul(size).ok_or("has too large buckets")?;
    let mut partial_starts = Vec::with_capacity(fill.len());
    for (i, count) in fill.iter().enumerate() {
        let count = u32::from_le_bytes(*count) as usize;
        if count > size {
            return Err(format!("has {count} Gaussians in bucket {}, of {size}", full_count + i));
        }
        partial_starts.push(held);
        held = held.saturating_add(count);
    }
    if held != rows && held != max_rows {
        return Err(format!("has {held} Gaussians in its buckets, but counts {rows}"));
    }
    let range = match u32_at(header, 24) {
        0 => DEFAULT_RANGE,
        range => range,
    };
    let (range, block) = (f64::from(range), f64::from(f32_at(header, 16)));
    Ok(Buckets { partial_starts, full_count, size, centers, range, step: block / 2.0 / range })
}
