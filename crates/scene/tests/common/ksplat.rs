//! `.ksplat` files, written independently of the crate.

use half::f16;

/// A section. Buckets hold 4.
pub struct Section {
    degree: u16,
    full: u32,
    partial: Vec<u32>,
    /// Records there is room for beyond those there are.
    spare: u32,
}

impl Section {
    fn rows(&self) -> u32 {
        4 * self.full + self.partial.iter().sum::<u32>()
    }
}

/// What row `row` of all holds, whatever the level.
pub struct Expected {
    pub offset: [u16; 3],
    pub scale: [f32; 3],
    pub quat: [f32; 4],
    pub color: [u8; 4],
}

pub fn expected(row: u32) -> Expected {
    Expected {
        offset: [row as u16, 32_767, 65_534 - row as u16],
        scale: [0.5, 0.25, 0.125].map(|s| s * (1.0 + (row % 4) as f32 * 0.25)),
        quat: [[1.0, 0.0, 0.0, 0.0], [0.5, -0.5, 0.5, 0.5], [0.0, 0.0, 1.0, 0.0]][row as usize % 3],
        color: [row as u8, 100, 200, 128],
    }
}

/// The coefficient for coefficient `k`, `channel`, of a row.
pub fn coefficient(row: u32, k: usize, channel: usize) -> f32 {
    (k * 3 + channel) as f32 / 64.0 - (row % 2) as f32 * 0.5
}

pub const RANGE: f64 = 32_767.0;
pub const BLOCK: f64 = 8.0;

pub fn center(section: usize, bucket: usize) -> [f32; 3] {
    [section as f32 * 10.0, bucket as f32, -1.0]
}

/// Writes numbers at places.
fn put<const N: usize>(out: &mut [u8], from: usize, values: [(usize, u32); N]) {
    for (at, value) in values {
        out[from + at..from + at + 4].copy_from_slice(&value.to_le_bytes());
    }
}

/// A row as a record of a level.
fn put_record(out: &mut Vec<u8>, level: u16, row: u32, degree: u16) {
    let e = expected(row);
    let shape = e.scale.iter().chain(&e.quat);
    if level == 0 {
        let floats = e.offset.map(f32::from);
        floats.iter().chain(shape).for_each(|v| out.extend(v.to_le_bytes()));
    } else {
        e.offset.iter().for_each(|v| out.extend(v.to_le_bytes()));
        shape.for_each(|&v| out.extend(f16::from_f32(v).to_le_bytes()));
    }
    out.extend(e.color);
    let mut first = 0;
    for band in 1..=usize::from(degree) {
        for channel in 0..3 {
            for m in 0..2 * band + 1 {
                let value = coefficient(row, first + m, channel);
                match level {
                    0 => out.extend(value.to_le_bytes()),
                    1 => out.extend(f16::from_f32(value).to_le_bytes()),
                    _ => out.push(((value + 1.0) / 2.0 * 255.0) as u8),
                }
            }
        }
        first += 2 * band + 1;
    }
}

pub fn ksplat(level: u16, sections: &[Section]) -> Vec<u8> {
    let total: u32 = sections.iter().map(Section::rows).sum();
    let count = sections.len() as u32;
    let mut out = vec![0u8; 4096 + 1024 * sections.len()];
    out[1] = 1;
    put(&mut out, 0, [(4, count), (8, count), (12, total), (16, total), (20, level.into())]);
    put(&mut out, 0, [(36, (-1.0f32).to_bits()), (40, 1.0f32.to_bits())]);
    let mut row = 0;
    for (index, section) in sections.iter().enumerate() {
        let partial = section.partial.len() as u32;
        let buckets = section.full + partial;
        let header = [
            (0, section.rows()),
            (4, section.rows() + section.spare),
            (8, 4),
            (12, buckets),
            (16, (BLOCK as f32).to_bits()),
            (20, 12),
            (32, section.full),
            (36, partial),
            (40, section.degree.into()),
        ];
        put(&mut out, 4096 + 1024 * index, header);
        section.partial.iter().for_each(|count| out.extend(count.to_le_bytes()));
        for bucket in 0..buckets as usize {
            center(index, bucket).iter().for_each(|v| out.extend(v.to_le_bytes()));
        }
        let start = out.len();
        for _ in 0..section.rows() {
            put_record(&mut out, level, row, section.degree);
            row += 1;
        }
        let record = (out.len() - start) / section.rows().max(1) as usize;
        out.extend(vec![0xee; record * section.spare as usize]);
    }
    out
}

pub fn sections() -> [Section; 4] {
    [
        Section { degree: 1, full: 2, partial: vec![3, 1], spare: 0 },
        Section { degree: 0, full: 0, partial: vec![], spare: 0 },
        Section { degree: 2, full: 0, partial: vec![1, 0, 2], spare: 2 },
        Section { degree: 2, full: 1, partial: vec![], spare: 0 },
    ]
}
