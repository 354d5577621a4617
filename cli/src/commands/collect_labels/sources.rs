//! What cuts pictures, and what describes segments.

use super::args::{Args, FeaturesArg, PicturePrecision, SegmentsArg, TeacherArg};
use super::frames::Frame;
use super::onnx;
use crate::error::WrongUse;
use crate::receipt::sha256_of;
use crate::session::Session;
use anyhow::Result;
use scenesplat::collection::{
    BoxTeacher, ColourStatistics, MaskFolder, PictureEncoder, Segmenter, SuperpixelSettings,
    Superpixels, Teacher,
};
use scenesplat::kernels::Precision;
use scenesplat::picture_networks::{DetectorBoxes, MaskSegments, SiglipCrops};
use scenesplat::scene::TextTable;
use scenesplat::vision::{Detector, DetectorSettings, Sam2, SiglipImageEncoder};
use std::path::Path;

/// What labels pictures.
pub(super) enum Labeler {
    /// One network cuts, another describes.
    Pair { segmenter: Box<dyn Segmenter>, encoder: Box<dyn PictureEncoder> },
    /// One knows names, which are these.
    Teacher { teacher: Box<dyn Teacher>, texts: TextTable },
}

/// It, and where masks are, if they come from files.
pub(super) struct Sources {
    pub(super) labeler: Labeler,
    masks: Option<MaskFolder>,
}

impl Sources {
    /// What the flags ask for.
    pub(super) fn of(session: &Session<'_>, args: &Args) -> Result<Self> {
        if let (Some(TeacherArg::Detector), Some(path)) = (args.teacher, &args.detector) {
            session.outputs.reads(path)?;
            session.receipt.fingerprint("detector", path)?;
            let default = DetectorSettings::default();
            let score = args.detector_score.unwrap_or(default.score);
            let detector = Detector::open(path, DetectorSettings { score, ..default })?;
            let hashes = detector.files().iter().map(|file| Ok(sha256_of(file)?.0));
            let weights = hashes.collect::<Result<Vec<_>>>()?.join(" ");
            let (finder, texts) = DetectorBoxes::new(detector, &weights)?;
            let teacher = Box::new(BoxTeacher::new(finder, &texts.values, texts.dim)?);
            return Ok(Self { labeler: Labeler::Teacher { teacher, texts }, masks: None });
        }
        let precision = match args.picture_precision {
            Some(PicturePrecision::Bf16) => Precision::Bf16,
            Some(PicturePrecision::F32) | None => Precision::F32,
        };
        let mut masks = None;
        let segmenter: Box<dyn Segmenter> = match &args.segments {
            SegmentsArg::Sam2 => {
                let flag = "--segments sam2 needs --sam2-weights, the file of a SAM 2 or 2.1 checkpoint; superpixels need \
                            no weights";
                let path = args.sam2_weights.as_ref().ok_or_else(|| WrongUse(flag.to_owned()))?;
                session.outputs.reads(path)?;
                session.receipt.fingerprint("sam2", path)?;
                let name = format!("sam2 {} {precision}", sha256_of(path)?.0);
                let network = Sam2::open(path, precision)?;
                Box::new(MaskSegments::new(network, args.mask_settings(), &name)?)
            }
            SegmentsArg::Onnx => onnx::segments(session, args)?,
            SegmentsArg::Superpixels => Box::new(Superpixels::new(SuperpixelSettings::default())?),
            SegmentsArg::Folder(path) => {
                let folder = MaskFolder::open(path, args.no_segment)?;
                masks = Some(folder.clone());
                Box::new(folder)
            }
        };
        let encoder: Box<dyn PictureEncoder> = match args.features {
            FeaturesArg::Siglip2 => {
                let flag = "--features siglip2 needs --siglip2-weights, the folder of a SigLIP 2 checkpoint; colour \
                            needs no weights";
                let path =
                    args.siglip2_weights.as_ref().ok_or_else(|| WrongUse(flag.to_owned()))?;
                session.outputs.reads(path)?;
                session.receipt.fingerprint("siglip2", path)?;
                let weights = format!("{} {precision}", sha256_of(path)?.0);
                Box::new(SiglipCrops::new(SiglipImageEncoder::load(path, precision)?, &weights))
            }
            FeaturesArg::Colour => Box::new(ColourStatistics),
            FeaturesArg::Onnx => onnx::features(session, args)?,
        };
        Ok(Self { labeler: Labeler::Pair { segmenter, encoder }, masks })
    }

    /// Finds the masks of the frames, if masks come from files.
    pub(super) fn assign(&mut self, session: &Session<'_>, frames: &[Frame]) -> Result<()> {
        let Some(folder) = &mut self.masks else { return Ok(()) };
        let named: Vec<[&str; 2]> = frames.iter().map(|f| [&*f.name, &*f.camera.name]).collect();
        session.tell_found("map of segments", &folder.assign(&named)?);
        if let Labeler::Pair { segmenter, .. } = &mut self.labeler {
            *segmenter = Box::new(folder.clone());
        }
        Ok(())
    }

    /// Whether the scene's depth is read.
    pub(super) fn wants_depth(&self) -> bool {
        match &self.labeler {
            Labeler::Pair { segmenter, .. } => segmenter.wants_depth(),
            Labeler::Teacher { .. } => true,
        }
    }

    /// The file of a frame's mask, if masks come from files.
    pub(super) fn mask(&self, frame: &str) -> Option<&Path> {
        self.masks.as_ref()?.file(frame)
    }
}
