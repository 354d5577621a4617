//! Objects of a labeled scene of 3D Gaussians: which there are, their boxes and places.
//!
//! [`find_objects`] takes labels (and, where there are some, features or known instances) and gives a
//! [`Catalogue`]; [`table`] writes it as JSON, CSV or Markdown, [`boxes`] in COCO's form, [`relations`] answers "the lamp on
//! the desk", [`agreement`] compares with true instances, [`refine`] lets labels and objects correct each other,
//! [`colliders`] makes meshes of them, [`holes`] says what is open where some were removed.
//!
//! Everything is geometry on slices: no network, no tensor library, nothing random, and the same
//! answer for any number of threads. It is only as good as the labels: what a network calls by
//! another name is another object.
//!
//! ```
//! use scenesplat_objects::{ObjectInput, ObjectSettings, find_objects};
//! use scenesplat_rooms::{CLASSES, SyntheticRoomSettings, generate};
//! use scenesplat_scene::Up;
//!
//! let room = generate(&SyntheticRoomSettings::with_count(20_000, 1))?;
//! let names: Vec<String> = CLASSES.iter().map(|c| c.name.to_owned()).collect();
//! let input = ObjectInput {
//!     scene: &room.scene,
//!     labels: room.scene.segment.as_deref().unwrap_or_default(),
//!     scores: None,
//!     instances: None,
//!     features: None,
//!     names: &names,
//!     upright: Up::PLUS_Z.upright(),
//!     metres_per_unit: 1.0,
//!     floor: None,
//! };
//! let found = find_objects(&input, &ObjectSettings::default())?;
//! assert!(found.objects.iter().filter(|o| o.class == "wall").count() >= 4);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod agreement;
pub mod boxes;
mod catalogue;
mod cells;
pub mod colliders;
mod error;
mod fragments;
pub mod holes;
mod input;
#[cfg(test)]
mod made;
mod panels;
mod panoptic;
mod refine;
pub mod relations;
mod settings;
pub mod surfaces;
mod surroundings;
pub mod table;
mod upright_box;
mod walls;

pub use agreement::Agreement;
pub use catalogue::{Catalogue, Object, find_objects};
pub use error::ObjectError;
pub use input::{AddFeature, ObjectInput};
pub use panoptic::PanopticQuality;
pub use refine::{RefineSettings, Refined, refine};
pub use settings::ObjectSettings;
pub use surroundings::{Floor, is_building, is_kind};
pub use upright_box::UprightBox;
