//! What cuts pictures, and what describes segments.

use super::args::{Args, FeaturesArg, SegmentsArg};
use crate::commands::WrongUse;
use anyhow::Result;
use scenesplat::collection::{
    ColourStatistics, MaskFolder, PictureEncoder, Segmenter, SuperpixelSettings, Superpixels,
};
use std::path::PathBuf;

/// Both, and where masks are, if they come from files.
pub(super) struct Sources {
    pub(super) segmenter: Box<dyn Segmenter>,
    pub(super) encoder: Box<dyn PictureEncoder>,
    masks: Option<MaskFolder>,
}

impl Sources {
    /// What the flags ask for.
    pub(super) fn of(args: &Args) -> Result<Self> {
        let absent = |flag: &str, name: &str, others: &str| {
            WrongUse(format!(
                "{flag} {name}: this program was built without that network; {others}"
            ))
        };
        let mut masks = None;
        let segmenter: Box<dyn Segmenter> = match &args.segments {
            SegmentsArg::Sam2 => {
                let others = "give superpixels, or a folder of id maps that it has made elsewhere";
                return Err(absent("--segments", "sam2", others).into());
            }
            SegmentsArg::Superpixels => Box::new(Superpixels::new(SuperpixelSettings::default())?),
            SegmentsArg::Folder(path) => {
                let folder = MaskFolder::open(path, args.no_segment)?;
                masks = Some(folder.clone());
                Box::new(folder)
            }
        };
        let encoder: Box<dyn PictureEncoder> = match args.features {
            FeaturesArg::Siglip2 => {
                let others =
                    "give colour, or lift features that it has made elsewhere by lift-labels";
                return Err(absent("--features", "siglip2", others).into());
            }
            FeaturesArg::Colour => Box::new(ColourStatistics),
        };
        Ok(Self { segmenter, encoder, masks })
    }

    /// The file of a frame's mask, if masks come from files.
    pub(super) fn mask(&self, frame: &str) -> Option<PathBuf> {
        self.masks.as_ref().map(|folder| folder.file(frame))
    }
}
