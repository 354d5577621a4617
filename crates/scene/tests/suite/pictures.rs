//! Pictures: what is read of PNG and JPEG, and what is refused before memory is reserved.

use scenesplat_scene::picture::{
    Channels, MAX_PIXELS, Picture, RgbPicture, Samples, decode_picture, read_picture, read_png,
    read_png_numbers,
};
use std::path::Path;

fn decode(bytes: &[u8]) -> Result<Picture, String> {
    decode_picture(bytes, Path::new("a.picture")).map_err(|e| e.to_string())
}

/// A baseline JPEG file of flat blocks of 8 × 8: `blocks[k]` are the values of block k, one per
/// component. Quantized by 8, the mean of a block is the number in the file.
fn jpeg(width: u16, height: u16, components: u8, blocks: &[Vec<u8>]) -> Vec<u8> {
    let mut out = vec![0xff, 0xd8];
    let segment = |out: &mut Vec<u8>, marker: u8, body: &[u8]| {
        out.extend([0xff, marker]);
        out.extend((body.len() as u16 + 2).to_be_bytes());
        out.extend(body);
    };
    segment(&mut out, 0xdb, &[vec![0], vec![8; 64]].concat());
    let [h, w] = [height, width].map(u16::to_be_bytes);
    let mut frame = vec![8, h[0], h[1], w[0], w[1], components];
    (1..=components).for_each(|id| frame.extend([id, 0x11, 0]));
    segment(&mut out, 0xc0, &frame);
    // Lengths of differences 0 to 11 as codes of 4 bits; of the other table, "nothing follows" as 0.
    segment(&mut out, 0xc4, &[vec![0, 0, 0, 0, 12], vec![0; 12], (0..12).collect()].concat());
    segment(&mut out, 0xc4, &[vec![0x10, 1], vec![0; 15], vec![0]].concat());
    let mut scan = vec![components];
    (1..=components).for_each(|id| scan.extend([id, 0]));
    scan.extend([0, 63, 0]);
    segment(&mut out, 0xda, &scan);
    let mut bits = String::new();
    let mut last = vec![128i32; components.into()];
    for block in blocks {
        for (value, last) in block.iter().zip(&mut last) {
            let step = i32::from(*value) - std::mem::replace(last, i32::from(*value));
            let size = 32 - step.unsigned_abs().leading_zeros();
            bits += &format!("{size:04b}");
            if size > 0 {
                let number = if step > 0 { step } else { step + (1 << size) - 1 };
                bits += &format!("{number:0width$b}", width = size as usize);
            }
            bits += "0";
        }
    }
    while !bits.len().is_multiple_of(8) {
        bits += "1";
    }
    for byte in bits.as_bytes().chunks(8) {
        let byte = u8::from_str_radix(std::str::from_utf8(byte).unwrap(), 2).unwrap();
        out.push(byte);
        if byte == 0xff {
            out.push(0);
        }
    }
    out.extend([0xff, 0xd9]);
    out
}

#[test]
fn gray_and_color_jpeg() {
    let gray = jpeg(16, 8, 1, &[vec![51], vec![200]]);
    let picture = decode(&gray).unwrap();
    assert_eq!((picture.width(), picture.height(), picture.channels()), (16, 8, Channels::Gray));
    let Samples::Eight(values) = picture.samples() else { panic!("8 bits") };
    assert!(values.chunks(8).enumerate().all(|(i, v)| v == [[51, 200][i % 2]; 8]), "{values:?}");
    assert_eq!(picture.to_rgb_f32()[..3], [0.2; 3]);
    assert_eq!(picture.to_rgb8().get(8, 0), Some([200; 3]));

    // Y, Cb, Cr of the original definition: r = y + 1.402 (cr − 128) and so on.
    let color = decode(&jpeg(8, 8, 3, &[vec![100, 90, 160]])).unwrap();
    assert_eq!(color.channels(), Channels::Rgb);
    let [r, g, b] = color.to_rgb8().get(7, 7).unwrap().map(i32::from);
    assert!((r - 145).abs() <= 1 && (g - 90).abs() <= 1 && (b - 33).abs() <= 1, "{r} {g} {b}");
}

#[test]
fn damaged_and_foreign_jpeg_is_refused() {
    let whole = jpeg(16, 16, 1, &[vec![51], vec![200], vec![3], vec![90]]);
    for cut in 3..whole.len() - 3 {
        let text = decode(&whole[..cut]).unwrap_err();
        assert!(text.contains("a.picture: is a JPEG that cannot be read"), "{cut}: {text}");
    }
    let print = decode(&jpeg(8, 8, 4, &[vec![1, 2, 3, 4]])).unwrap_err();
    assert!(print.contains("CMYK"), "{print}");
    // 65,500 × 65,500 pixels are refused by their number.
    let large = decode(&jpeg(65_500, 65_500, 1, &[vec![51]])).unwrap_err();
    assert!(large.contains("65500 × 65500") && large.contains(&MAX_PIXELS.to_string()), "{large}");
}

#[test]
fn png_comes_back_as_it_was() {
    let n = 7 * 5;
    let eight = |c: usize| Samples::Eight((0..n * c).map(|i| (i * 37 % 256) as u8).collect());
    let sixteen = |c: usize| Samples::Sixteen((0..n * c).map(|i| (i * 3571) as u16).collect());
    for channels in [Channels::Gray, Channels::GrayAlpha, Channels::Rgb, Channels::Rgba] {
        for samples in [eight(channels.count()), sixteen(channels.count())] {
            let picture = Picture::new(7, 5, channels, samples).unwrap();
            assert_eq!(decode(&picture.encode_png().unwrap()).unwrap(), picture);
        }
    }
    assert!(Picture::new(7, 5, Channels::Rgb, eight(1)).is_none());
    assert!(RgbPicture::filled(0, 5, [0; 3]).encode_png().is_err());
}

#[test]
fn rgb_of_every_kind() {
    let samples = Samples::Eight(vec![10, 255, 20, 254]);
    let picture = Picture::new(2, 1, Channels::GrayAlpha, samples).unwrap();
    assert!(picture.is_transparent());
    assert_eq!(picture.to_rgb8().pixels(), [[10; 3], [20; 3]]);
    let samples = Samples::Sixteen(vec![0, 257, 65535, 65535]);
    let picture = Picture::new(1, 1, Channels::Rgba, samples).unwrap();
    assert!(!picture.is_transparent());
    assert_eq!(picture.to_rgb8().pixels(), [[0, 1, 255]]);
    assert_eq!(picture.to_rgb_f32(), [0.0, 257.0 / 65535.0, 1.0]);
}

/// A PNG file whose header says another size; its checksum is right.
fn png_of_size(width: u32, height: u32, body: usize) -> Vec<u8> {
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let chunk = |out: &mut Vec<u8>, name: &[u8; 4], data: &[u8]| {
        out.extend((data.len() as u32).to_be_bytes());
        let start = out.len();
        out.extend(name);
        out.extend(data);
        let sum = crc32fast::hash(&out[start..]);
        out.extend(sum.to_be_bytes());
    };
    let [w, h] = [width, height].map(u32::to_be_bytes);
    chunk(&mut out, b"IHDR", &[&w[..], &h[..], &[8, 0, 0, 0, 0]].concat());
    chunk(&mut out, b"IDAT", &vec![0; body]);
    chunk(&mut out, b"IEND", &[]);
    out
}

#[test]
fn sizes_are_not_believed() {
    let bomb = decode(&png_of_size(22_000, 22_000, 470_000)).unwrap_err();
    assert!(bomb.contains("22000 × 22000 pixels"), "{bomb}");
    let lie = decode(&png_of_size(10_000, 10_000, 100)).unwrap_err();
    assert!(lie.contains("cannot hold"), "{lie}");
    let most = decode(&png_of_size(u32::MAX >> 1, u32::MAX >> 1, 100)).unwrap_err();
    assert!(most.contains("2147483647 × 2147483647"), "{most}");
    assert!(decode(b"").unwrap_err().contains("is empty"));
    assert!(decode(b"GIF89a").unwrap_err().contains("PNG and JPEG"));
}

#[test]
fn every_cut_of_a_png_is_refused() {
    let picture = RgbPicture::from_fn(9, 6, |x, y| [x as u8 * 20, y as u8 * 30, 7]);
    let bytes = picture.encode_png().unwrap();
    assert_eq!(decode(&bytes).unwrap().to_rgb8(), picture);
    // Without its last chunk, which holds nothing, every pixel is there.
    for cut in 0..bytes.len() - 12 {
        assert!(decode(&bytes[..cut]).is_err(), "{cut} of {}", bytes.len());
    }
}

#[test]
fn files_are_told_apart_by_content() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("photo.png");
    std::fs::write(&path, jpeg(8, 8, 1, &[vec![51]])).unwrap();
    assert_eq!(read_picture(&path).unwrap().to_rgb8().get(0, 0), Some([51; 3]));
    assert!(read_png(&path).unwrap_err().to_string().contains("is no PNG"));
    assert!(read_picture(dir.path()).is_err());
}

/// A PNG of 5 × 3 numbers below `2^bits`, with a palette whose colors say nothing about their place, or gray.
fn png_of_numbers(bits: u8, has_palette: bool) -> (Vec<u8>, Vec<u8>) {
    let largest = ((1u16 << bits) - 1) as u8;
    let numbers: Vec<u8> = (0..15u8).map(|i| i.wrapping_mul(37) & largest).collect();
    let mut packed = Vec::new();
    for row in numbers.chunks(5) {
        let text: String =
            row.iter().map(|v| format!("{v:0width$b}", width = bits.into())).collect();
        let text = format!("{text:0<width$}", width = text.len().div_ceil(8) * 8);
        let byte = |bits: &[u8]| u8::from_str_radix(std::str::from_utf8(bits).unwrap(), 2).unwrap();
        packed.extend(text.as_bytes().chunks(8).map(byte));
    }
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, 5, 3);
    encoder.set_color(if has_palette {
        png::ColorType::Indexed
    } else {
        png::ColorType::Grayscale
    });
    encoder.set_depth(png::BitDepth::from_u8(bits).unwrap());
    if has_palette {
        encoder.set_palette((0..=largest).flat_map(|i| [255 - i, 7, 99]).collect::<Vec<u8>>());
        encoder.set_trns(vec![0, 128]);
    }
    encoder.write_header().unwrap().write_image_data(&packed).unwrap();
    (out, numbers)
}

/// Ids are the numbers that a file stores: the indices of a palette, and of few bits nothing is spread.
#[test]
fn numbers_are_read_as_they_are_stored() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("ids.png");
    for bits in [1, 2, 4, 8] {
        for has_palette in [false, true] {
            let (file, numbers) = png_of_numbers(bits, has_palette);
            std::fs::write(&path, file).unwrap();
            let picture = read_png_numbers(&path).unwrap();
            assert_eq!((picture.width(), picture.height()), (5, 3));
            assert_eq!(picture.channels(), Channels::Gray, "{bits} bits, palette: {has_palette}");
            assert_eq!(picture.into_samples(), Samples::Eight(numbers));
        }
    }
    let deep = Picture::new(2, 1, Channels::Gray, Samples::Sixteen(vec![300, 65_535])).unwrap();
    std::fs::write(&path, deep.encode_png().unwrap()).unwrap();
    assert_eq!(read_png_numbers(&path).unwrap(), deep);
    std::fs::write(&path, "no picture").unwrap();
    assert!(read_png_numbers(&path).unwrap_err().to_string().contains("ids.png"));
}

/// Where a picture is transparent nothing is there: it is black on black.
#[test]
fn opacity_is_given_and_applied() {
    let rgba = Picture::new(
        3,
        1,
        Channels::Rgba,
        Samples::Eight(vec![200, 100, 50, 255, 200, 100, 50, 51, 9, 9, 9, 0]),
    )
    .unwrap();
    assert_eq!(rgba.alpha8(), Some(vec![255, 51, 0]));
    assert_eq!(rgba.over_black().pixels(), [[200, 100, 50], [40, 20, 10], [0; 3]]);
    let deep =
        Picture::new(1, 1, Channels::GrayAlpha, Samples::Sixteen(vec![65_535, 32_896])).unwrap();
    assert_eq!((deep.alpha8(), deep.over_black().pixels()), (Some(vec![128]), &[[128; 3]][..]));
    let opaque = Picture::new(1, 1, Channels::GrayAlpha, Samples::Eight(vec![7, 255])).unwrap();
    assert_eq!((opaque.alpha8(), opaque.over_black()), (None, opaque.to_rgb8()));
}
