//! One feature per segment of a picture.

use crate::crops::{Crops, boxes, crops_in};
use crate::{CollectError, PictureEncoder};
use scenesplat_rasterizer::lifting::{FrameWeight, SegmentMap, fuse_crops};
use scenesplat_scene::picture::RgbPicture;

/// Crops that wait for the encoder, at most.
const BATCH: usize = 32;
/// Bytes of crops that wait, about: large photos have large crops.
const BATCH_BYTES: usize = 64 << 20;

/// How segments are described.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DescribeSettings {
    /// As the public label collection of SceneSplat's authors: the whole frame goes to the encoder with red and blue
    /// exchanged, and a frame of a single segment gives it the feature of the frame. Without it channels are
    /// right, and a single segment keeps what is its own.
    pub original: bool,
}

/// Features of the segments of a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Described {
    /// Unit features; a row is 0 where no pixel has the id, or the crops cancel out. `[S, D]`
    pub features: Vec<f32>,
    /// Pictures that were encoded: the frame, and two for each segment with pixels.
    pub encoded: usize,
    /// Whether there was but one segment with pixels, so that its weight was no softmax.
    pub single_segment: bool,
}

/// Encodes the frame and two crops of each segment, and fuses the three with weights that follow from them
/// ([`fuse_crops`]): softmax over the segments of the frame.
///
/// Memory: about 64 MB of crops at a time beyond what the encoder takes.
///
/// # Errors
/// If the map is of another size than the picture, or the encoder fails or gives other rows than it promises.
pub fn describe(
    picture: &RgbPicture,
    map: &SegmentMap,
    encoder: &dyn PictureEncoder,
    settings: DescribeSettings,
) -> Result<Described, CollectError> {
    if (picture.width(), picture.height()) != (map.width(), map.height()) {
        let problem = format!(
            "is {}×{}, its picture {}×{}",
            map.width(),
            map.height(),
            picture.width(),
            picture.height()
        );
        return Err(CollectError::argument("segment map", problem));
    }
    let (width, ids) = (encoder.width(), map.num_ids());
    let mut out = Described { features: vec![0.0; ids * width], encoded: 0, single_segment: false };
    let places: Vec<_> = (0..).zip(boxes(map)).filter_map(|(id, b)| Some((id, b?))).collect();
    if places.is_empty() {
        return Ok(out);
    }
    let frame = if settings.original { swapped(picture) } else { picture.clone() };
    let frame = checked(encoder, encoder.encode_frame(&frame)?, 1)?;
    let (mut around, mut alone) = (Vec::new(), Vec::new());
    let mut batch = Batch { encoder, pictures: Vec::new(), bytes: 0 };
    for &(id, place) in &places {
        let Crops { with_surroundings, alone: own } = crops_in(picture, map, id, place);
        if !batch.fits(&own) {
            batch.flush(&mut around, &mut alone)?;
        }
        batch.push(with_surroundings);
        batch.push(own);
    }
    batch.flush(&mut around, &mut alone)?;
    let fused = fuse_crops(&frame, &around, &alone, FrameWeight::Softmax)?;
    out.encoded = 1 + 2 * places.len();
    out.single_segment = fused.single_segment;
    let rows =
        if settings.original && fused.single_segment { unit(&frame) } else { fused.features };
    for (&(id, _), row) in places.iter().zip(rows.chunks_exact(width)) {
        out.features[usize::from(id) * width..][..width].copy_from_slice(row);
    }
    Ok(out)
}

fn swapped(picture: &RgbPicture) -> RgbPicture {
    RgbPicture::from_fn(picture.width(), picture.height(), |x, y| {
        let [r, g, b] = picture.get(x, y).unwrap_or_default();
        [b, g, r]
    })
}

fn unit(row: &[f32]) -> Vec<f32> {
    let norm = row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
    row.iter().map(|v| (f64::from(*v) / norm) as f32).collect()
}

/// Refuses rows that are not what an encoder promises.
fn checked(
    encoder: &dyn PictureEncoder,
    rows: Vec<f32>,
    pictures: usize,
) -> Result<Vec<f32>, CollectError> {
    let expected = pictures * encoder.width();
    if rows.len() != expected {
        let problem = format!(
            "{} gave {} values for {pictures} pictures, expected {expected}",
            encoder.name(),
            rows.len()
        );
        return Err(CollectError::argument("features", problem));
    }
    if let Some(at) = rows.iter().position(|v| !v.is_finite()) {
        let problem =
            format!("{} gave {} in column {}", encoder.name(), rows[at], at % encoder.width());
        return Err(CollectError::argument("features", problem));
    }
    Ok(rows)
}

/// Crops that wait: with surroundings, alone, with surroundings, …
struct Batch<'a> {
    encoder: &'a dyn PictureEncoder,
    pictures: Vec<RgbPicture>,
    bytes: usize,
}

impl Batch<'_> {
    /// Whether two more of this size can wait.
    fn fits(&self, crop: &RgbPicture) -> bool {
        let bytes = self.bytes + 2 * 3 * crop.pixels().len();
        self.pictures.is_empty() || self.pictures.len() + 2 <= BATCH && bytes <= BATCH_BYTES
    }

    fn push(&mut self, picture: RgbPicture) {
        self.bytes += 3 * picture.pixels().len();
        self.pictures.push(picture);
    }

    fn flush(&mut self, around: &mut Vec<f32>, alone: &mut Vec<f32>) -> Result<(), CollectError> {
        if self.pictures.is_empty() {
            return Ok(());
        }
        let rows = self.encoder.encode(&self.pictures)?;
        let rows = checked(self.encoder, rows, self.pictures.len())?;
        for pair in rows.chunks_exact(2 * self.encoder.width()) {
            let (with, own) = pair.split_at(self.encoder.width());
            around.extend_from_slice(with);
            alone.extend_from_slice(own);
        }
        self.pictures.clear();
        self.bytes = 0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use scenesplat_rasterizer::lifting::NO_SEGMENT;
    use std::sync::Mutex;

    /// Mean color, and how many pictures came at once.
    struct Means(Mutex<Vec<usize>>);

    impl PictureEncoder for Means {
        fn name(&self) -> String {
            "means".to_owned()
        }

        fn width(&self) -> usize {
            3
        }

        fn encode(&self, pictures: &[RgbPicture]) -> Result<Vec<f32>, CollectError> {
            self.0.lock().unwrap().push(pictures.len());
            let mean = |p: &RgbPicture| {
                let sum = |c: usize| p.pixels().iter().map(|v| f64::from(v[c])).sum::<f64>();
                [0, 1, 2].map(|c| (sum(c) / p.pixels().len() as f64) as f32)
            };
            Ok(pictures.iter().flat_map(mean).collect())
        }
    }

    /// The formulas of the paper, written out for one segment.
    fn by_hand(f: [f64; 3], l: [f64; 3], m: [f64; 3], w: f64) -> [f64; 3] {
        let unit = |v: [f64; 3]| v.map(|x| x / v.iter().map(|y| y * y).sum::<f64>().sqrt());
        let (f, l, m) = (unit(f), unit(l), unit(m));
        let r: f64 = (0..3).map(|k| l[k] * m[k]).sum();
        let mix = |k: usize| w * f[k] + (1.0 - w) * (1.0 - r) * l[k] + (1.0 - w) * r * m[k];
        unit([mix(0), mix(1), mix(2)])
    }

    fn phi(f: [f64; 3], l: [f64; 3], m: [f64; 3]) -> f64 {
        // With w = 0 the result is the local feature.
        let local = by_hand(f, l, m, 0.0);
        let norm = f.iter().map(|v| v * v).sum::<f64>().sqrt();
        (0..3).map(|k| local[k] * f[k] / norm).sum()
    }

    #[test]
    fn three_crops_weigh_as_the_paper_says() {
        // Red left, green right below, blue the rest; ids 0, 2 and none, and id 1 without a pixel.
        let color = |x: u32, y: u32| match (x < 2, y < 2) {
            (true, _) => [200, 10, 10],
            (false, false) => [10, 160, 10],
            (false, true) => [20, 20, 90],
        };
        let picture = RgbPicture::from_fn(4, 4, color);
        let id = |i: u16| match (i % 4 < 2, i / 4 < 2) {
            (true, _) => 0,
            (false, false) => 2,
            (false, true) => NO_SEGMENT,
        };
        let map = SegmentMap::new(4, 4, (0..16).map(id).collect()).unwrap();
        let encoder = Means(Mutex::default());
        let found = describe(&picture, &map, &encoder, DescribeSettings::default()).unwrap();
        assert_eq!((found.encoded, found.single_segment), (5, false));
        assert_eq!(*encoder.0.lock().unwrap(), [1, 4]);
        assert_eq!(found.features[3..6], [0.0; 3]);
        // Half red, a quarter each of the others. The red box is 2 × 4: half of its square is black.
        let frame = [107.5, 50.0, 30.0];
        let red = [100.0, 5.0, 5.0];
        let green = [10.0, 160.0, 10.0];
        let [a, b] = [phi(frame, red, red), phi(frame, green, green)].map(f64::exp);
        for (row, own, w) in [(0, red, a / (a + b)), (2, green, b / (a + b))] {
            let want = by_hand(frame, own, own, w);
            let got = &found.features[3 * row..3 * row + 3];
            assert!((0..3).all(|k| (f64::from(got[k]) - want[k]).abs() < 1e-5), "{got:?} {want:?}");
        }
        // The original's frame has red and blue exchanged.
        let original = DescribeSettings { original: true };
        let found = describe(&picture, &map, &encoder, original).unwrap();
        let frame = [30.0, 50.0, 107.5];
        let [a, b] = [phi(frame, red, red), phi(frame, green, green)].map(f64::exp);
        let want = by_hand(frame, red, red, a / (a + b));
        let got = &found.features[..3];
        assert!((0..3).all(|k| (f64::from(got[k]) - want[k]).abs() < 1e-5), "{got:?} {want:?}");
    }

    #[test]
    fn a_single_segment_keeps_its_own_feature_unless_the_original_is_asked_for() {
        let picture =
            RgbPicture::from_fn(4, 2, |x, _| if x < 2 { [200, 0, 0] } else { [0, 0, 200] });
        let ids = (0..8).map(|i| if i % 4 < 2 { 0 } else { NO_SEGMENT }).collect();
        let map = SegmentMap::new(4, 2, ids).unwrap();
        let encoder = Means(Mutex::default());
        let ours = describe(&picture, &map, &encoder, DescribeSettings::default()).unwrap();
        // By hand: r = 1, φ = √½, and the logistic function of it, 0.6698, for the frame.
        let want = [0.861_58, 0.0, 0.507_62];
        let near = (0..3).all(|k| (ours.features[k] - want[k]).abs() < 1e-4);
        assert!(ours.single_segment && near, "{ours:?}");
        let original = DescribeSettings { original: true };
        let theirs = describe(&picture, &map, &encoder, original).unwrap();
        let half = std::f32::consts::FRAC_1_SQRT_2;
        assert!(
            (theirs.features[0] - half).abs() < 1e-6 && (theirs.features[2] - half).abs() < 1e-6
        );
        let none = SegmentMap::new(4, 2, vec![NO_SEGMENT; 8]).unwrap();
        let found = describe(&picture, &none, &encoder, original).unwrap();
        assert!(found.features.is_empty() && found.encoded == 0);
        let small = SegmentMap::new(1, 1, vec![0]).unwrap();
        let error = describe(&picture, &small, &encoder, original).unwrap_err().to_string();
        assert!(error.contains("1×1") && error.contains("4×2"), "{error}");
    }

    #[test]
    fn batches_hold_at_most_32_crops() {
        let picture = RgbPicture::from_fn(40, 1, |x, _| [x as u8 + 1, 1, 1]);
        let map = SegmentMap::new(40, 1, (0..40).collect()).unwrap();
        let encoder = Means(Mutex::default());
        describe(&picture, &map, &encoder, DescribeSettings::default()).unwrap();
        assert_eq!(*encoder.0.lock().unwrap(), [1, 32, 32, 16]);
    }

    #[test]
    fn encoders_that_break_their_promise_are_named() {
        struct Bad(Vec<f32>);
        impl PictureEncoder for Bad {
            fn name(&self) -> String {
                "bad".to_owned()
            }
            fn width(&self) -> usize {
                2
            }
            fn encode(&self, _: &[RgbPicture]) -> Result<Vec<f32>, CollectError> {
                Ok(self.0.clone())
            }
        }
        let picture = RgbPicture::filled(2, 2, [1, 2, 3]);
        let map = SegmentMap::new(2, 2, vec![0; 4]).unwrap();
        for (rows, part) in [(vec![1.0], "1 values"), (vec![f32::NAN, 0.0], "NaN")] {
            let error = describe(&picture, &map, &Bad(rows), DescribeSettings::default());
            let error = error.unwrap_err().to_string();
            assert!(error.contains("bad") && error.contains(part), "{error}");
        }
    }

    #[test]
    fn crops_with_surroundings_and_alone_have_their_own_weights() {
        // Left a square of red with one blue pixel of no segment, right a square of green.
        let picture = RgbPicture::from_fn(4, 2, |x, y| match (x, y) {
            (1, 1) => [0, 0, 160],
            (0 | 1, _) => [200, 0, 0],
            _ => [0, 120, 0],
        });
        let map = SegmentMap::new(4, 2, vec![0, 0, 1, 1, 0, NO_SEGMENT, 1, 1]).unwrap();
        let encoder = Means(Mutex::default());
        let found = describe(&picture, &map, &encoder, DescribeSettings::default()).unwrap();
        // Of the eight pixels 3 are red, 1 is blue, 4 are green. The red square is ¾ red and ¼ blue, alone ¼ black.
        let frame = [75.0, 60.0, 20.0];
        let (around, alone) = ([150.0, 0.0, 40.0], [150.0, 0.0, 0.0]);
        let green = [0.0, 120.0, 0.0];
        let [a, b] = [phi(frame, around, alone), phi(frame, green, green)].map(f64::exp);
        let want = by_hand(frame, around, alone, a / (a + b));
        let got = &found.features[..3];
        assert!((0..3).all(|k| (f64::from(got[k]) - want[k]).abs() < 1e-5), "{got:?} {want:?}");
        let want = by_hand(frame, green, green, b / (a + b));
        let got = &found.features[3..];
        assert!((0..3).all(|k| (f64::from(got[k]) - want[k]).abs() < 1e-5), "{got:?} {want:?}");
    }

    #[test]
    fn a_batch_takes_32_crops_or_64_mib() {
        let encoder = Means(Mutex::default());
        let crop = RgbPicture::filled(5, 5, [1; 3]);
        let batch = |count: usize, bytes: usize| {
            let pictures = vec![crop.clone(); count];
            Batch { encoder: &encoder, pictures, bytes }.fits(&crop)
        };
        // Two crops of 25 pixels are 150 bytes more.
        let most = 64 * 1024 * 1024 - 150;
        assert!(batch(30, 0) && !batch(31, 0) && batch(2, most) && !batch(2, most + 1));
        // One that is too large by itself goes alone.
        assert!(batch(0, most + 1));
        let mut batch = Batch { encoder: &encoder, pictures: Vec::new(), bytes: 0 };
        batch.push(crop.clone());
        batch.push(RgbPicture::filled(2, 1, [4; 3]));
        assert_eq!(batch.bytes, 75 + 6);
        let (mut around, mut alone) = (Vec::new(), Vec::new());
        batch.flush(&mut around, &mut alone).unwrap();
        assert_eq!((around, alone, batch.bytes), (vec![1.0; 3], vec![4.0; 3], 0));
    }

    #[test]
    fn frames_have_an_encoder_of_their_own_and_crops_are_checked_too() {
        /// Frames are told from crops, of which the last is bad.
        struct Two(usize);
        impl PictureEncoder for Two {
            fn name(&self) -> String {
                "two".to_owned()
            }
            fn width(&self) -> usize {
                2
            }
            fn encode(&self, pictures: &[RgbPicture]) -> Result<Vec<f32>, CollectError> {
                let mut rows = [0.0, 1.0].repeat(pictures.len());
                rows[self.0] = f32::INFINITY;
                Ok(rows)
            }
            fn encode_frame(&self, frame: &RgbPicture) -> Result<Vec<f32>, CollectError> {
                assert_eq!((frame.width(), frame.height()), (3, 2));
                Ok(vec![1.0, 0.0])
            }
        }
        let picture = RgbPicture::filled(3, 2, [1, 2, 3]);
        let map = SegmentMap::new(3, 2, vec![0; 6]).unwrap();
        let settings = DescribeSettings::default();
        assert!(!settings.original);
        for column in [0, 1] {
            let error = describe(&picture, &map, &Two(2 + column), settings).unwrap_err();
            let want = format!("features: two gave inf in column {column}");
            assert!(error.to_string().contains(&want), "{error}");
        }
        // The default of a frame is that of any picture.
        let means = Means(Mutex::default());
        assert_eq!(means.encode_frame(&picture).unwrap(), [1.0, 2.0, 3.0]);
    }
}
