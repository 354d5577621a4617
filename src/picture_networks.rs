//! The networks of [`vision`](crate::vision) where labels are collected: SAM 2 cuts pictures, SigLIP 2 describes segments, a
//! detector does both; with the feature `onnx`, networks in ONNX files do either.

use scenesplat_collection::{
    BoxFinder, CollectError, NamedBox, PictureEncoder, PosedPicture, Segmented, Segmenter,
};
use scenesplat_scene::TextTable;
use scenesplat_scene::picture::RgbPicture;
use scenesplat_text::{PhraseError, PhraseTable};
use scenesplat_vision::detector::COCO;
use scenesplat_vision::masks::{ClickNetwork, paint_objects};
#[cfg(feature = "onnx")]
use scenesplat_vision::onnx::OnnxEncoder;
use scenesplat_vision::{
    AutomaticMasks, Detector, MaskSettings, Sam2, SiglipImageEncoder, VisionError, paint,
};

/// The automatic masks of a network that answers clicks, such as SAM 2, painted over each other as SceneSplat's labels were:
/// by `MaskSettings::scenesplat`, which asks for whole objects, largest first; otherwise in the order of the generator.
#[derive(Debug)]
pub struct MaskSegments<N = Sam2> {
    network: N,
    settings: MaskSettings,
    name: String,
}

impl<N: ClickNetwork> MaskSegments<N> {
    /// With these settings; `network_name` says what network it is and with which weights, such as their checksum: what was
    /// computed by others is not taken up.
    ///
    /// # Errors
    /// If a setting is out of its range.
    pub fn new(
        network: N,
        settings: MaskSettings,
        network_name: &str,
    ) -> Result<Self, VisionError> {
        settings.check()?;
        let name = format!("{network_name} {settings:?}");
        Ok(Self { network, settings, name })
    }
}

fn failed<'a>(name: &'a str, frame: &'a str) -> impl FnOnce(VisionError) -> CollectError + 'a {
    move |source| CollectError::Model { name: format!("{name}{frame}"), source: Box::new(source) }
}

impl<N: ClickNetwork + Send> Segmenter for MaskSegments<N> {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn segment(&self, picture: &PosedPicture<'_>) -> Result<Segmented, CollectError> {
        picture.check()?;
        let frame = format!(", frame {:?}", picture.name);
        let masks = AutomaticMasks::new(&self.network, self.settings.clone());
        let masks = masks.and_then(|masks| masks.generate(picture.picture));
        let masks = masks.map_err(failed("the mask generator", &frame))?;
        let (width, height) = (picture.picture.width(), picture.picture.height());
        let whole = self.settings == MaskSettings::scenesplat();
        let painted = if whole { paint_objects } else { paint }(&masks, width, height);
        let ids: Vec<Option<u32>> = painted.ids.iter().map(|&id| u32::try_from(id).ok()).collect();
        Segmented::dense(width, height, &ids, masks.len())
    }
}

/// SigLIP 2's picture tower: one unit row a picture.
#[derive(Debug)]
pub struct SiglipCrops {
    encoder: SiglipImageEncoder,
    name: String,
}

impl SiglipCrops {
    /// `weights` says which weights they are, such as their checksum.
    pub fn new(encoder: SiglipImageEncoder, weights: &str) -> Self {
        Self { encoder, name: format!("siglip2 {weights}") }
    }
}

impl PictureEncoder for SiglipCrops {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn width(&self) -> usize {
        self.encoder.width()
    }

    fn encode(&self, pictures: &[RgbPicture]) -> Result<Vec<f32>, CollectError> {
        self.encoder.encode(pictures).map_err(failed("SigLIP 2", ""))
    }
}

/// A detector's boxes, with those classes of COCO that the phrase table inside the program has words for.
#[derive(Debug)]
pub struct DetectorBoxes {
    detector: Detector,
    name: String,
    /// The row of each class of COCO among the texts.
    rows: Vec<Option<usize>>,
}

impl DetectorBoxes {
    /// The boxes, and the names of their classes with vectors; `weights` says which weights they are, such as their checksum.
    /// Boxes of other classes, such as giraffes, are left out.
    ///
    /// # Errors
    /// If the phrase table is damaged.
    pub fn new(detector: Detector, weights: &str) -> Result<(Self, TextTable), PhraseError> {
        let table = PhraseTable::embedded()?;
        let mut texts = TextTable { names: Vec::new(), dim: table.dim(), values: Vec::new() };
        let mut rows = Vec::with_capacity(COCO.len());
        for name in COCO {
            // With a word that is not known it would be something else: "fire hydrant" would be a fire.
            let understood = table
                .understand(name)
                .ok()
                .filter(|found| found.unknown.is_empty() && found.corrected.is_empty());
            rows.push(understood.map(|found| {
                texts.names.push(name.to_owned());
                texts.values.extend(found.row);
                texts.names.len() - 1
            }));
        }
        let name = format!("detector {weights} {:?}", detector.settings());
        Ok((Self { detector, name, rows }, texts))
    }
}

impl BoxFinder for DetectorBoxes {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn find(&self, picture: &RgbPicture) -> Result<Vec<NamedBox>, CollectError> {
        let found = self.detector.detect(picture).map_err(failed("the detector", ""))?;
        // What is no class here first and foremost is nothing.
        let known = found.into_iter().filter(|thing| self.rows[thing.class()].is_some());
        let named = |scores: Vec<(usize, f32)>| {
            scores
                .into_iter()
                .filter_map(|(class, score)| Some((self.rows[class]?, score)))
                .collect()
        };
        Ok(known.map(|thing| NamedBox { area: thing.area, scores: named(thing.scores) }).collect())
    }
}

/// A picture encoder in an ONNX file: one unit row a picture.
#[cfg(feature = "onnx")]
#[derive(Debug)]
pub struct OnnxCrops {
    encoder: OnnxEncoder,
    name: String,
}

#[cfg(feature = "onnx")]
impl OnnxCrops {
    /// `network_name` says which file it is and which library runs it, such as its checksum and build.
    pub fn new(encoder: OnnxEncoder, network_name: &str) -> Self {
        Self { encoder, name: network_name.to_owned() }
    }
}

#[cfg(feature = "onnx")]
impl PictureEncoder for OnnxCrops {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn width(&self) -> usize {
        self.encoder.width()
    }

    fn encode(&self, pictures: &[RgbPicture]) -> Result<Vec<f32>, CollectError> {
        self.encoder.encode(pictures).map_err(failed("the ONNX encoder", ""))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::Precision;
    use scenesplat_rasterizer::View;
    use scenesplat_rasterizer::lifting::NO_SEGMENT;
    use scenesplat_vision::Sam2Config;
    use scenesplat_vision::masks::Level;

    fn small() -> Sam2 {
        let config = Sam2Config {
            image_size: 128,
            embed_dim: 16,
            num_heads: 1,
            stages: [1, 2, 3, 1],
            global_att_blocks: vec![4],
            window_spec: [8, 4, 4, 2],
            window_pos_embed_bkg_spatial_size: [7, 7],
            d_model: 32,
            decoder_depth: 2,
            decoder_heads: 4,
            decoder_mlp: 64,
            iou_hidden: 32,
        };
        Sam2::seeded(config, 3, Precision::F32).unwrap()
    }

    /// Nearly everything that the network proposes.
    fn all() -> MaskSettings {
        MaskSettings {
            points_per_side: 3,
            pred_iou: 0.0,
            stability: 0.0,
            box_nms: 1.0,
            level: Level::All,
            ..MaskSettings::original()
        }
    }

    #[test]
    fn masks_become_segments_as_they_are_painted() {
        let picture =
            RgbPicture::from_fn(40, 30, |x, y| [(x * 6) as u8, (y * 8) as u8, (x * y % 251) as u8]);
        let world_to_camera = [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.]];
        let (width, height) = (40, 30);
        let view = View { world_to_camera, fx: 30., fy: 30., cx: 20., cy: 15., width, height };
        let posed = PosedPicture { name: "0", picture: &picture, view: &view, depth: None };
        let network = small();
        let masks = AutomaticMasks::new(&network, all()).unwrap().generate(&picture).unwrap();
        let segments = MaskSegments::new(small(), all(), "sam2 3").unwrap();
        let found = segments.segment(&posed).unwrap();
        // By hand: the last mask that holds a pixel is on top.
        let mut shown = std::collections::BTreeSet::new();
        for y in 0..30 {
            for x in 0..40 {
                let top = masks.iter().rposition(|mask| mask.mask.contains(x, y));
                assert_eq!(found.map.at(x, y) == NO_SEGMENT, top.is_none(), "{x} {y}");
                shown.extend(top);
            }
        }
        assert_eq!(found.left_out, masks.len() - shown.len());
        assert!(!shown.is_empty());
        // What was kept under this name is of these settings and weights alone.
        let other = MaskSegments::new(small(), MaskSettings::original(), "sam2 3").unwrap();
        assert_ne!(segments.name(), other.name());
        assert_ne!(segments.name(), MaskSegments::new(small(), all(), "sam2 4").unwrap().name());
    }
}
