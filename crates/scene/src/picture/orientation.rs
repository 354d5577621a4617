//! How a camera was held: the mark that programs turn pictures by.

use super::jpeg::segments;

/// How to turn the stored pixels so that up is up, as Exif numbers it: 1 as they are, 3 half a turn, 6 a quarter turn
/// clockwise, 8 one against it, 2, 4, 5, 7 the same mirrored. `None` without a mark, or with one that is none.
///
/// Reads the Exif block of JPEG and PNG files. [`read_picture`](super::read_picture) applies none of them: which one
/// a file of cameras means depends on the program that made it.
pub fn orientation(bytes: &[u8]) -> Option<u8> {
    exif_of_jpeg(bytes).or_else(|| exif_of_png(bytes)).and_then(mark)
}

fn exif_of_jpeg(bytes: &[u8]) -> Option<&[u8]> {
    let exif = segments(bytes).filter(|(marker, _)| *marker == 0xe1);
    exif.map(|(_, content)| content).find_map(|content| content.strip_prefix(b"Exif\0\0"))
}

fn exif_of_png(bytes: &[u8]) -> Option<&[u8]> {
    let mut rest = bytes.strip_prefix(b"\x89PNG\r\n\x1a\n")?;
    loop {
        let length = u32::from_be_bytes(*rest.first_chunk::<4>()?) as usize;
        let name = rest.get(4..8)?;
        let block = rest.get(8..8usize.checked_add(length)?)?;
        match name {
            b"eXIf" => return Some(block),
            b"IEND" => return None,
            _ => rest = rest.get(length.checked_add(12)?..)?,
        }
    }
}

/// The value of the tag 0x0112 in the first directory of a TIFF block.
fn mark(exif: &[u8]) -> Option<u8> {
    let little = match exif.get(..4)? {
        b"II*\0" => true,
        b"MM\0*" => false,
        _ => return None,
    };
    let u16_at = |at: usize| {
        let two = exif.get(at..at.checked_add(2)?)?.first_chunk()?;
        Some(if little { u16::from_le_bytes(*two) } else { u16::from_be_bytes(*two) })
    };
    let u32_at = |at: usize| {
        let four = exif.get(at..at.checked_add(4)?)?.first_chunk()?;
        Some(if little { u32::from_le_bytes(*four) } else { u32::from_be_bytes(*four) })
    };
    let directory = u32_at(4)? as usize;
    let entries = usize::from(u16_at(directory)?);
    let entry =
        (0..entries).map(|i| directory + 2 + 12 * i).find(|&at| u16_at(at) == Some(0x0112))?;
    // One short number.
    let is_short = u16_at(entry + 2)? == 3 && u32_at(entry + 4)? == 1;
    let value = u16_at(entry + 8)?;
    (is_short && (1..=8).contains(&value)).then_some(value as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A TIFF block with another entry before the mark.
    fn tiff(little: bool, value: u16) -> Vec<u8> {
        let two = |v: u16| if little { v.to_le_bytes() } else { v.to_be_bytes() };
        let four = |v: u32| if little { v.to_le_bytes() } else { v.to_be_bytes() };
        let mut out = if little { b"II*\0".to_vec() } else { b"MM\0*".to_vec() };
        out.extend(four(8));
        out.extend(two(2));
        for (tag, value) in [(0x010f, 7), (0x0112, value)] {
            out.extend(two(tag));
            out.extend(two(3));
            out.extend(four(1));
            out.extend(two(value));
            out.extend([0, 0]);
        }
        out
    }

    fn jpeg(exif: &[u8]) -> Vec<u8> {
        let mut out = b"\xff\xd8\xff\xe0\x00\x04JF\xff\xff\xe1".to_vec();
        out.extend((exif.len() as u16 + 8).to_be_bytes());
        out.extend(b"Exif\0\0");
        out.extend(exif);
        out.extend(b"\xff\xda");
        out
    }

    fn png(exif: &[u8]) -> Vec<u8> {
        let mut out = b"\x89PNG\r\n\x1a\n\0\0\0\x02IHDRabcrc_".to_vec();
        out.extend((exif.len() as u32).to_be_bytes());
        out.extend(b"eXIf");
        out.extend(exif);
        out
    }

    #[test]
    fn marks_of_both_byte_orders_in_both_formats() {
        for little in [true, false] {
            for value in 1..=8 {
                let block = tiff(little, value);
                assert_eq!(orientation(&jpeg(&block)), Some(value as u8));
                assert_eq!(orientation(&png(&block)), Some(value as u8));
            }
            for value in [0, 9, 600] {
                assert_eq!(orientation(&jpeg(&tiff(little, value))), None);
            }
        }
    }

    #[test]
    fn damaged_blocks_have_no_mark() {
        let whole = jpeg(&tiff(true, 6));
        for length in 0..whole.len() - 2 {
            let _ = orientation(&whole[..length]);
        }
        let mut far = tiff(true, 6);
        far[4..8].fill(0xff);
        assert_eq!(orientation(&jpeg(&far)), None);
        let mut png = png(&tiff(true, 6));
        png[8..12].fill(0xff);
        assert_eq!(orientation(&png), None);
        assert_eq!(orientation(b"no picture"), None);
    }
}
