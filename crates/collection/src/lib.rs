//! Posed pictures → segments → features, for lifting onto 3D Gaussians.
//!
//! ```text
//! PosedPicture ─ Segmenter ─► Segmented { map } ─ Crops ─► PictureEncoder ─ fuse_crops ─► [S, D]     (describe)
//! ```
//!
//! | role | trait | without weights |
//! |---|---|---|
//! | cuts a picture into segments | [`Segmenter`] | [`Superpixels`], [`MaskFolder`] |
//! | turns crops into rows | [`PictureEncoder`] | [`ColourStatistics`] |
//!
//! A [`Teacher`] knows names and does both at once: [`BoxTeacher`] makes segments of a detector's boxes.
//!
//! What comes out is a [`SegmentMap`](scenesplat_rasterizer::lifting::SegmentMap) with one row of features per id:
//! what [`Lifter`](scenesplat_rasterizer::lifting::Lifter) takes. Results do not depend on the number of threads, nor
//! on which crops share a batch.
//!
//! Which pictures: [`plan_views`] stands cameras where there are no photos, [`choose_pictures`] takes of many those that
//! show most.
//!
//! Not for: lifting (see `scenesplat_rasterizer::lifting`), lenses with distortion.

mod boxes;
mod choice;
mod colour_statistics;
mod crops;
mod describe;
mod error;
mod lab;
mod mask_folder;
mod merge;
mod photo;
mod picture_encoder;
mod seen;
mod segmenter;
mod superpixels;
mod surface;
mod teacher;
mod view_plan;

pub use choice::{Shown, choose_pictures, relative_sharpness};
pub use colour_statistics::ColourStatistics;
pub use crops::{Crops, crops_of};
pub use describe::{DescribeSettings, Described, describe};
pub use error::CollectError;
pub use mask_folder::MaskFolder;
pub use photo::{PhotoRemark, fit_photo};
pub use picture_encoder::PictureEncoder;
pub use seen::{Seen, seen_in};
pub use segmenter::{PosedPicture, Segmented, Segmenter};
pub use superpixels::{SuperpixelSettings, Superpixels};
pub use teacher::{BoxFinder, BoxTeacher, NamedBox, Taught, Teacher};
pub use view_plan::{ViewPlan, ViewPlanSettings, plan_views};
