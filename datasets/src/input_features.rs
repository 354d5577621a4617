//! What the network reads of a Gaussian.

use crate::error::require;
use crate::{DataError, Sample};
use rayon::prelude::*;
use scenesplat_scene::quaternion::drawn_axes;
use scenesplat_scene::{FloorRow, Floors, GaussianScene};
use serde::{Deserialize, Serialize};

mod activation;

/// With a larger share of a sample's rows below it, a level surface is no floor.
const CROPPED: f64 = 0.2;

/// One group of input channels, after activation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InputChannel {
    /// Color byte / 127.5 − 1, in −1..=1. 3 channels
    Color,
    /// Opacity in 0..=1. 1 channel
    Opacity,
    /// Unit quaternion `w, x, y, z`. 4 channels
    Quat,
    /// Standard deviations, meters. 3 channels
    Scale,
    /// Unit surface normal. 3 channels
    Normal,
    /// Meters above the floor, which is looked for in the whole scene ([`Floors`]); the scene's z axis
    /// must point up. 1 channel. Not part of the original.
    Height,
    /// Meters from the middle of the whole scene's bounding box along x and y, and above its lowest point along z.
    /// 3 channels. What Sonata and Concerto read.
    Position,
    /// Color byte / 255, in 0..=1. 3 channels. What Sonata and Concerto read.
    UnitColor,
}

impl InputChannel {
    /// Number of channels.
    pub fn width(self) -> usize {
        match self {
            Self::Opacity | Self::Height => 1,
            Self::Quat => 4,
            Self::Color | Self::Scale | Self::Normal | Self::Position | Self::UnitColor => 3,
        }
    }

    fn field(self) -> &'static str {
        match self {
            Self::Color | Self::UnitColor => "color",
            Self::Opacity => "opacity",
            Self::Quat => "quat",
            Self::Scale => "scale",
            Self::Normal => "normal",
            Self::Height => "coord z",
            Self::Position => "coord",
        }
    }
}

/// How the orientation of a splat is written: 24 pairs of sizes and quaternion are the same ellipsoid,
/// its axes permuted and turned round.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Orientation {
    /// As the scene has it. What the original reads.
    #[default]
    AsStored,
    /// One of the 24, drawn, whichever the scene has: see [`drawn_axes`]. Inference also brings the walls
    /// of a room along the axes for such a network.
    Drawn,
}

scenesplat_kernels::settings! {
    /// Which channels the network reads, in order, how orientations are written and how scales are limited.
    ///
    /// The default is the input of the language networks: color, opacity, quat, scale (11 channels)
    /// with scales clipped as in their training.
    pub struct InputFeatures {
        /// Channel groups in the order of the network's input.
        pub channels: Vec<InputChannel> = {
            use InputChannel::{Color, Opacity, Quat, Scale};
            vec![Color, Opacity, Quat, Scale]
        },
        /// Lower and upper limit of the scales, meters; `None` (`"none"` in files) passes them on as they
        /// are.
        #[serde(with = "scale_clip")]
        pub scale_clip: Option<[f32; 2]> = Some([0.0, 1.5]),
        /// How orientations are written, in the channels `quat` and `scale`.
        pub orientation: Orientation = Orientation::AsStored,
    }
}

/// `None` is a word in files: an entry that is left out means the default.
mod scale_clip {
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Clip {
        Word(String),
        Limits([f32; 2]),
        Null(()),
    }

    pub(super) fn serialize<S: Serializer>(
        clip: &Option<[f32; 2]>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        match clip {
            Some(limits) => limits.serialize(serializer),
            None => serializer.serialize_str("none"),
        }
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<[f32; 2]>, D::Error> {
        let wrong = || de::Error::custom("scale_clip: expected [low, high] in meters or \"none\"");
        match Clip::deserialize(deserializer).map_err(|_| wrong())? {
            Clip::Limits(limits) => Ok(Some(limits)),
            Clip::Null(()) => Ok(None),
            Clip::Word(word) if word == "none" => Ok(None),
            Clip::Word(_) => Err(wrong()),
        }
    }
}

/// A Gaussian that is read: color 0..=255 (or NaN), everything else activated.
struct Row {
    /// Which of the scene or sample it is.
    number: usize,
    coord: [f32; 3],
    color: [f32; 3],
    opacity: f32,
    scale: [f32; 3],
    quat: [f32; 4],
    normal: [f32; 3],
}

impl InputFeatures {
    /// Number of channels of a row.
    pub fn width(&self) -> usize {
        self.channels.iter().map(|c| c.width()).sum()
    }

    /// Input rows of the given Gaussians.
    ///
    /// # Shapes
    /// - `rows`: `[M]` rows of `scene`, may repeat · returns: `[M, width]` row-major
    ///
    /// # Errors
    /// If a row is out of range, normals are wanted and missing, or a value is not finite. Values
    /// that a limit makes finite (scale `+inf` when clipped, opacity logit `±inf`) are allowed.
    ///
    /// # Source
    /// `NormalizeColor`, `Collect` and the scene loaders of SceneSplat be9d5e1. Differs: its
    /// inference script does not clip scales although training did; `scale_clip: None` does that.
    pub fn rows(&self, scene: &GaussianScene, rows: &[u32]) -> Result<Vec<f32>, DataError> {
        self.rows_above(scene, rows, None)
    }

    /// As [`rows`](Self::rows), above floors that are known.
    ///
    /// # Errors
    /// As [`rows`](Self::rows).
    pub fn rows_above(
        &self,
        scene: &GaussianScene,
        rows: &[u32],
        floors: Option<&Floors>,
    ) -> Result<Vec<f32>, DataError> {
        scene.check_rows()?;
        if let Some(&row) = rows.iter().find(|&&r| r as usize >= scene.len()) {
            return Err(DataError::RowOutOfRange { row: row as usize, rows: scene.len() });
        }
        self.check(scene.normal.is_some())?;
        // Of the whole scene, so that a tile of it gets the heights of the scene.
        let reads = self.reads_height();
        let found = (reads && floors.is_none()).then(|| Floors::of_scene(scene));
        let floors = floors.filter(|_| reads).or(found.as_ref());
        let origin = self.origin(&scene.coord);
        self.filled(rows.len(), (floors, origin), |at| {
            let row = rows[at] as usize;
            let (bytes, dc) = (scene.color_u8(row), scene.sh_dc[row]);
            // A byte cannot be NaN; the value must be, to be found.
            let color = |c: usize| if dc[c].is_nan() { dc[c] } else { f32::from(bytes[c]) };
            Row {
                number: row,
                coord: scene.coord[row],
                color: std::array::from_fn(color),
                opacity: activation::opacity(scene, row),
                scale: activation::scale(scene, row),
                quat: scene.quat[row],
                normal: scene.normal.as_ref().map_or([0.0; 3], |normal| normal[row]),
            }
        })
    }

    /// Input rows of all Gaussians of a sample; of a scene that no transform has changed, the same
    /// as [`rows`](Self::rows), bit for bit.
    ///
    /// # Shapes
    /// - returns: `[N, width]` row-major
    ///
    /// # Errors
    /// As [`rows`](Self::rows).
    pub fn sample_rows(&self, sample: &Sample) -> Result<Vec<f32>, DataError> {
        sample.check()?;
        self.check(sample.normal.is_some())?;
        let floors = self.reads_height().then(|| {
            let floors = Floors::of(sample.len(), |row| FloorRow {
                coord: sample.coord[row],
                opacity: sample.opacity[row],
                scale: sample.scale[row],
                quat: sample.quat[row],
            });
            // A crop that the floor is not in has other level surfaces, a ceiling at worst.
            if floors.below > CROPPED { Floors::lowest(&sample.coord) } else { floors }
        });
        let origin = self.origin(&sample.coord);
        self.filled(sample.len(), (floors.as_ref(), origin), |row| Row {
            number: row,
            coord: sample.coord[row],
            color: sample.color[row],
            opacity: sample.opacity[row],
            scale: sample.scale[row],
            quat: sample.quat[row],
            normal: sample.normal.as_ref().map_or([0.0; 3], |normal| normal[row]),
        })
    }

    /// Checks the limits, and that there are normals if they are read.
    fn check(&self, normals: bool) -> Result<(), DataError> {
        if self.channels.contains(&InputChannel::Normal) && !normals {
            return Err(DataError::NoNormals);
        }
        let Some([low, high]) = self.scale_clip else { return Ok(()) };
        let expected = "a lower and an upper limit in meters";
        require(low <= high, "scale_clip", format_args!("[{low}, {high}]"), expected)
    }

    /// The channels of so many rows, all of them finite.
    fn filled(
        &self,
        rows: usize,
        place: (Option<&Floors>, [f32; 3]),
        read: impl Fn(usize) -> Row + Sync,
    ) -> Result<Vec<f32>, DataError> {
        let width = self.width();
        let mut feat = vec![0.0; rows * width];
        if width == 0 {
            return Ok(feat);
        }
        feat.par_chunks_exact_mut(width).enumerate().with_min_len(4096).for_each(|(at, out)| {
            let mut row = read(at);
            if self.orientation == Orientation::Drawn {
                let [r, g, b] = row.color;
                (row.scale, row.quat) = drawn_axes(row.scale, row.quat, [r, g, b, row.opacity]);
            }
            let mut rest = out;
            for &channel in &self.channels {
                let (part, behind) = rest.split_at_mut(channel.width());
                self.write(channel, &row, place, part);
                rest = behind;
            }
        });
        match feat.par_iter().position_first(|v| !v.is_finite()) {
            None => Ok(feat),
            Some(at) => Err(self.not_finite(read(at / width).number, at % width, feat[at])),
        }
    }

    /// Whether a channel asks for floors.
    pub fn reads_height(&self) -> bool {
        self.channels.contains(&InputChannel::Height)
    }

    /// What positions are relative to: the middle of the bounding box along x and y, its lower end along z; what is
    /// not finite does not count.
    fn origin(&self, coord: &[[f32; 3]]) -> [f32; 3] {
        if !self.channels.contains(&InputChannel::Position) {
            return [0.0; 3];
        }
        let mut bounds = [[f32::INFINITY, f32::NEG_INFINITY]; 3];
        for p in coord.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
            for ([low, high], v) in bounds.iter_mut().zip(p) {
                (*low, *high) = (low.min(*v), high.max(*v));
            }
        }
        let [x, y, z] = bounds;
        if z[0] > z[1] { [0.0; 3] } else { [x[0].midpoint(x[1]), y[0].midpoint(y[1]), z[0]] }
    }

    fn write(
        &self,
        channel: InputChannel,
        row: &Row,
        (floors, origin): (Option<&Floors>, [f32; 3]),
        out: &mut [f32],
    ) {
        match channel {
            InputChannel::Position => {
                out.copy_from_slice(&std::array::from_fn::<_, 3, _>(|c| row.coord[c] - origin[c]));
            }
            InputChannel::UnitColor => out.copy_from_slice(&row.color.map(|c| c / 255.0)),
            InputChannel::Color => out.copy_from_slice(&row.color.map(|c| c / 127.5 - 1.0)),
            InputChannel::Opacity => out[0] = row.opacity,
            InputChannel::Quat => out.copy_from_slice(&row.quat),
            InputChannel::Scale => {
                let [low, high] = self.scale_clip.unwrap_or([f32::NEG_INFINITY, f32::INFINITY]);
                out.copy_from_slice(&row.scale.map(|s| s.clamp(low, high)));
            }
            InputChannel::Normal => out.copy_from_slice(&row.normal),
            InputChannel::Height => {
                let z = row.coord[2];
                out[0] = floors.map_or(z, |floors| floors.height(z));
            }
        }
    }

    fn not_finite(&self, row: usize, column: usize, value: f32) -> DataError {
        let mut end = 0;
        let channel = self.channels.iter().find(|c| {
            end += c.width();
            column < end
        });
        DataError::NotFinite { row, field: channel.map_or("feature", |c| c.field()), value }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_scene::gaussian_scene::u8_to_dc;

    fn scene() -> GaussianScene {
        GaussianScene {
            coord: vec![[0.0; 3]; 2],
            log_scale: vec![[0.01_f32.ln(), 1.0, f32::NEG_INFINITY]; 2],
            quat: vec![[1.0, 0.0, 0.0, 0.0], [0.5, 0.5, -0.5, 0.5]],
            opacity_logit: vec![0.0, f32::INFINITY],
            sh_dc: vec![[u8_to_dc(0), u8_to_dc(255), u8_to_dc(51)]; 2],
            ..GaussianScene::default()
        }
    }

    #[test]
    fn default_rows_by_hand() {
        let feat = InputFeatures::default().rows(&scene(), &[1, 0]).unwrap();
        assert_eq!(feat.len(), 22);
        assert_eq!(feat[..8], [-1.0, 1.0, 51.0 / 127.5 - 1.0, 1.0, 0.5, 0.5, -0.5, 0.5]);
        assert!((feat[8] - 0.01).abs() < 1e-8);
        assert_eq!(feat[9..11], [1.5, 0.0]);
        assert_eq!(feat[14], 0.5);
    }

    #[test]
    fn positions_are_those_of_the_whole_scene() {
        use InputChannel::{Position, UnitColor};
        let mut scene = scene();
        scene.coord = vec![[1.0, 2.0, 3.0], [2.0, 2.5, 3.5]];
        let channels = vec![Position, UnitColor];
        let input = InputFeatures { channels, ..InputFeatures::default() };
        assert_eq!(input.width(), 6);
        let rows = input.rows(&scene, &[1]).unwrap();
        assert_eq!(rows, [0.5, 0.25, 0.5, 0.0, 1.0, 0.2]);
        let sample = Sample::from_scene("a", scene.clone());
        assert_eq!(input.sample_rows(&sample).unwrap()[6..], rows[..]);
        // What has no place says so, and moves nothing else.
        scene.coord[0] = [f32::NAN, 0.0, 0.0];
        assert_eq!(input.rows(&scene, &[1]).unwrap()[..3], [0.0; 3]);
        let error = input.rows(&scene, &[0]).unwrap_err().to_string();
        assert!(error.contains("coord"), "{error}");
    }

    #[test]
    fn samples_give_the_rows_of_their_scene() {
        use InputChannel::{Color, Normal, Opacity, Quat, Scale};
        let mut scene = scene();
        scene.normal = Some(vec![[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]]);
        let sample = Sample::from_scene("a", scene.clone());
        let clips = [Some([0.0, 1.5]), Some([0.02, 0.5]), None];
        let spellings = [Orientation::AsStored, Orientation::Drawn];
        for (scale_clip, orientation) in clips.into_iter().flat_map(|c| spellings.map(|s| (c, s))) {
            let channels = vec![Normal, Scale, Color, Quat, Opacity];
            let features = InputFeatures { channels, orientation, scale_clip };
            let bits = |rows: Vec<f32>| rows.into_iter().map(f32::to_bits).collect::<Vec<_>>();
            let expected = bits(features.rows(&scene, &[0, 1]).unwrap());
            assert_eq!(bits(features.sample_rows(&sample).unwrap()), expected);
        }
        let mut broken = sample.clone();
        broken.opacity.pop();
        assert!(InputFeatures::default().sample_rows(&broken).is_err());
        broken = sample;
        broken.color[1][0] = f32::NAN;
        let error = InputFeatures::default().sample_rows(&broken).unwrap_err();
        assert!(matches!(error, DataError::NotFinite { row: 1, field: "color", .. }), "{error}");
        broken.normal = None;
        let channels = vec![Normal];
        let features = InputFeatures { channels, ..InputFeatures::default() };
        assert!(matches!(features.sample_rows(&broken), Err(DataError::NoNormals)));
    }

    #[test]
    fn height_is_above_the_floor_of_the_whole_scene() {
        // 100 centers on the floor at z = 2, one floater far below, one lamp 1.5 m above.
        let mut scene = GaussianScene {
            coord: (0..100).map(|i| [i as f32, 0.0, 2.0]).collect(),
            ..GaussianScene::default()
        };
        scene.coord.push([0.0, 0.0, -40.0]);
        scene.coord.push([0.0, 0.0, 3.5]);
        let rows = scene.coord.len();
        scene.log_scale = vec![[0.0; 3]; rows];
        scene.quat = vec![[1.0, 0.0, 0.0, 0.0]; rows];
        scene.opacity_logit = vec![0.0; rows];
        scene.sh_dc = vec![[0.0; 3]; rows];
        let features =
            InputFeatures { channels: vec![InputChannel::Height], ..InputFeatures::default() };
        assert_eq!(features.rows(&scene, &[101, 0, 100]).unwrap(), [1.5, 0.0, -42.0]);
        let sample = Sample::from_scene("a", scene.clone());
        assert_eq!(features.sample_rows(&sample).unwrap()[100..], [-42.0, 1.5]);
        let given = Floors::given(1.0);
        assert_eq!(features.rows_above(&scene, &[101, 0], Some(&given)).unwrap(), [2.5, 1.0]);
        scene.coord[7][2] = f32::NAN;
        let error = features.rows(&scene, &[6, 7]).unwrap_err();
        assert!(matches!(error, DataError::NotFinite { row: 7, field: "coord z", .. }), "{error}");
        assert!(features.rows(&GaussianScene::default(), &[]).unwrap().is_empty());
    }

    #[test]
    fn a_crop_without_floor_is_no_storey() {
        // A ceiling and what hangs below it: most rows lie below the only level surface.
        let mut scene = GaussianScene::default();
        for i in 0..900 {
            scene.coord.push([0.1 * (i % 30) as f32, 0.1 * (i / 30) as f32, 2.5]);
        }
        for i in 0..1100 {
            scene.coord.push([1.0, 1.0, 1.0 + 0.001 * i as f32]);
        }
        let rows = scene.coord.len();
        scene.log_scale = vec![[-3.0, -3.0, -7.0]; rows];
        scene.quat = vec![[1.0, 0.0, 0.0, 0.0]; rows];
        scene.opacity_logit = vec![3.0; rows];
        scene.sh_dc = vec![[0.0; 3]; rows];
        let features =
            InputFeatures { channels: vec![InputChannel::Height], ..InputFeatures::default() };
        let found = features.sample_rows(&Sample::from_scene("a", scene)).unwrap();
        assert!((found[0] - 1.48).abs() < 0.02, "{} m above the lowest rows", found[0]);
    }

    #[test]
    fn clipping_can_be_switched_off() {
        let features = InputFeatures { scale_clip: None, ..InputFeatures::default() };
        assert_eq!(features.rows(&scene(), &[0]).unwrap()[9], 1.0_f32.exp());
    }

    #[test]
    fn infinite_scales_pass_only_when_clipped() {
        let mut scene = scene();
        scene.log_scale[1][2] = f32::INFINITY;
        assert_eq!(InputFeatures::default().rows(&scene, &[1]).unwrap()[10], 1.5);
        let features = InputFeatures { scale_clip: None, ..InputFeatures::default() };
        let error = features.rows(&scene, &[0, 1]).unwrap_err();
        assert!(matches!(error, DataError::NotFinite { row: 1, field: "scale", .. }), "{error}");
    }

    #[test]
    fn nan_is_named_in_every_channel() {
        let features = InputFeatures {
            channels: {
                use InputChannel::{Color, Normal, Opacity, Quat, Scale};
                vec![Normal, Scale, Quat, Opacity, Color]
            },
            ..InputFeatures::default()
        };
        type Poison = fn(&mut GaussianScene);
        let poison: [(&str, Poison); 5] = [
            ("color", |s| s.sh_dc[1][2] = f32::NAN),
            ("opacity", |s| s.opacity_logit[1] = f32::NAN),
            ("quat", |s| s.quat[1][3] = f32::NAN),
            ("scale", |s| s.log_scale[1][0] = f32::NAN),
            ("normal", |s| s.normal = Some(vec![[0.0; 3], [f32::NAN; 3]])),
        ];
        for (name, poison) in poison {
            let mut scene = scene();
            scene.normal = Some(vec![[0.0, 0.0, 1.0]; 2]);
            assert!(features.rows(&scene, &[0, 1]).is_ok());
            poison(&mut scene);
            let error = features.rows(&scene, &[0, 1]).unwrap_err();
            assert!(
                matches!(error, DataError::NotFinite { row: 1, field, .. } if field == name),
                "{error}"
            );
        }
    }

    #[test]
    fn missing_normals_and_wrong_rows_are_errors() {
        let features =
            InputFeatures { channels: vec![InputChannel::Normal], ..InputFeatures::default() };
        assert!(matches!(features.rows(&scene(), &[0]), Err(DataError::NoNormals)));
        let error = InputFeatures::default().rows(&scene(), &[0, 2]);
        assert!(matches!(error, Err(DataError::RowOutOfRange { row: 2, rows: 2 })));
        let features = InputFeatures { scale_clip: Some([1.0, f32::NAN]), ..Default::default() };
        assert!(matches!(features.rows(&scene(), &[0]), Err(DataError::Setting { .. })));
        assert!(InputFeatures::default().rows(&scene(), &[]).unwrap().is_empty());
    }
}
