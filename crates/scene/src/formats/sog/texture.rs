//! Textures: lossless WebP, one texel per Gaussian.

use crate::SceneError;
use image_webp::{ColorType, EncoderParams, WebPDecoder, WebPEncoder};
use std::io::Cursor;
use std::ops::Range;
use std::path::Path;

/// What to do about a texture that cannot be read.
const MEND: &str = "export the scene again";
/// Widest and highest texture; the format has 14 bits for each, and the decoder one value less.
pub(super) const MAX_SIDE: usize = 16_383;
/// Position of the dimensions in the files that are handed to the decoder.
const HEAD_LEN: usize = 21;

/// The size of a texture and where its data are.
#[derive(Debug, Clone)]
pub(super) struct TextureHead {
    pub(super) width: usize,
    pub(super) height: usize,
    payload: Range<usize>,
}

impl TextureHead {
    /// Finds the lossless image in a WebP file, without decoding it.
    pub(super) fn find(bytes: &[u8], path: &Path) -> Result<Self, SceneError> {
        let bad = |problem: &str| SceneError::format(path, problem, MEND);
        if bytes.get(..4) != Some(b"RIFF") || bytes.get(8..12) != Some(b"WEBP") {
            return Err(bad("is no WebP image"));
        }
        let mut at = 12;
        // Files with metadata have an extended header and other chunks first.
        while let Some(head) = bytes.get(at..at + 8) {
            let size = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) as usize;
            let start = at + 8;
            match &head[..4] {
                b"VP8L" => {
                    let payload = start..start.saturating_add(size);
                    if payload.end > bytes.len() {
                        let problem = format!(
                            "ends after {} bytes, but its image data end at {}",
                            bytes.len(),
                            payload.end
                        );
                        return Err(bad(&problem));
                    }
                    return Self::of_payload(bytes, payload).map_err(|e| bad(&e));
                }
                b"VP8 " | b"ALPH" => {
                    return Err(bad("is a lossy WebP image, which destroys the codes in it"));
                }
                b"ANIM" | b"ANMF" => return Err(bad("is an animation")),
                _ => {}
            }
            at = start.saturating_add(size).saturating_add(size & 1);
        }
        Err(bad("is a WebP image without image data"))
    }

    fn of_payload(bytes: &[u8], payload: Range<usize>) -> Result<Self, String> {
        let Some([0x2f, bits @ ..]) = bytes[payload.clone()].first_chunk::<5>() else {
            return Err("has image data that are not lossless WebP".into());
        };
        let bits = u32::from_le_bytes(*bits);
        let width = (bits & 0x3fff) as usize + 1;
        let height = (bits >> 14 & 0x3fff) as usize + 1;
        if width > MAX_SIDE || height > MAX_SIDE {
            return Err(format!("is {width}×{height} texels; {MAX_SIDE} is the most"));
        }
        Ok(Self { width, height, payload })
    }

    /// Number of texels.
    pub(super) fn texels(&self) -> usize {
        self.width * self.height
    }

    /// Decodes the texels, four bytes each; without alpha in the image the fourth is arbitrary.
    pub(super) fn decode(&self, bytes: &[u8], path: &Path) -> Result<Vec<u8>, SceneError> {
        let bad = |e: String| SceneError::format(path, format!("cannot be decoded: {e}"), MEND);
        let payload = &bytes[self.payload.clone()];
        let mut plain = Vec::with_capacity(HEAD_LEN + payload.len() + 4);
        plain.extend_from_slice(b"RIFF");
        let size = payload.len() as u32;
        plain.extend_from_slice(&size.saturating_add(12).to_le_bytes());
        plain.extend_from_slice(b"WEBPVP8L");
        plain.extend_from_slice(&size.to_le_bytes());
        plain.extend_from_slice(payload);
        // The bit that says whether alpha is used is a hint only. Set, the decoder writes straight
        // into the result; else it decodes into a copy of four bytes a texel and drops one.
        plain[HEAD_LEN + 3] |= 0x10;
        let mut decoder = WebPDecoder::new(Cursor::new(&plain)).map_err(|e| bad(e.to_string()))?;
        let mut texels = vec![0; self.texels() * 4];
        decoder.read_image(&mut texels).map_err(|e| bad(e.to_string()))?;
        Ok(texels)
    }
}

/// The size that textures of so many Gaussians have: nearly square, sides divisible by 4.
///
/// As `splat-transform` does it. `None` beyond what a texture can hold.
pub(super) fn texture_size(rows: usize) -> Option<(usize, usize)> {
    let side = (rows as f64).sqrt().ceil() as usize;
    let width = side.max(1).next_multiple_of(4);
    let height = rows.div_ceil(width).max(1).next_multiple_of(4);
    (width <= MAX_SIDE && height <= MAX_SIDE).then_some((width, height))
}

/// Encodes texels of 3 or 4 bytes without loss.
pub(super) fn encode(
    texels: &[u8],
    (width, height): (usize, usize),
    path: &Path,
) -> Result<Vec<u8>, SceneError> {
    let color = if texels.len() == width * height * 4 { ColorType::Rgba8 } else { ColorType::Rgb8 };
    // Which is smaller depends on whether codes of neighbors are near, and costs little to try.
    let attempt = |use_predictor_transform: bool| -> Result<Vec<u8>, SceneError> {
        let mut params = EncoderParams::default();
        params.use_predictor_transform = use_predictor_transform;
        let mut out = Vec::new();
        let mut encoder = WebPEncoder::new(&mut out);
        encoder.set_params(params);
        encoder
            .encode(texels, width as u32, height as u32, color)
            .map_err(|e| SceneError::format(path, format!("cannot be encoded: {e}"), ""))?;
        Ok(out)
    };
    let (plain, predicted) = rayon::join(|| attempt(false), || attempt(true));
    let (plain, predicted) = (plain?, predicted?);
    Ok(if plain.len() < predicted.len() { plain } else { predicted })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_hold_all_rows_and_little_more() {
        for rows in [1, 2, 15, 16, 17, 8406, 500_000, 268_000_000] {
            let (width, height) = texture_size(rows).unwrap();
            assert!(width * height >= rows && width * (height - 4) < rows, "{rows}");
        }
        assert_eq!(texture_size(8406), Some((92, 92)));
        assert_eq!(texture_size(269_000_000), None);
    }

    #[test]
    fn texels_come_back_with_and_without_alpha() {
        for channels in [3, 4] {
            let texels: Vec<u8> =
                (0..64 * 48 * channels).map(|i| (i * i / 7 % 251) as u8).collect();
            let bytes = encode(&texels, (64, 48), Path::new("x")).unwrap();
            let head = TextureHead::find(&bytes, Path::new("x")).unwrap();
            assert_eq!((head.width, head.height), (64, 48));
            let back = head.decode(&bytes, Path::new("x")).unwrap();
            for (a, b) in texels.chunks_exact(channels).zip(back.chunks_exact(4)) {
                assert_eq!(a, &b[..channels]);
            }
            for cut in 0..bytes.len() {
                assert!(TextureHead::find(&bytes[..cut], Path::new("x")).is_err(), "{cut}");
            }
        }
    }

    #[test]
    fn lossy_images_are_refused() {
        let lossy = b"RIFF\x12\0\0\0WEBPVP8 \x06\0\0\0\0\0\0\0\0\0";
        let error = TextureHead::find(lossy, Path::new("x")).unwrap_err().to_string();
        assert!(error.contains("lossy"), "{error}");
    }
}
