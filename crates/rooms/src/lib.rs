//! Furnished rooms as Gaussians with exact class and instance labels: data for training that needs
//! no download and no license form.
//!
//! A room is laid out (kind, plan, openings, furniture, clutter), every object is a set of surfaces
//! with textures, and Gaussians are scattered on the surfaces. The same settings give the same
//! bits on any machine with any number of threads: all values come from operations that IEEE 754
//! rounds exactly, except logarithms, which are rounded to 1/1024.
//!
//! Not for: judging accuracy on captures (nothing here is a picture of a real room), or rendering.
//!
//! # Figures of real scenes that are used
//! Measured with `scenesplat inspect` and on the raw scales (5, 25, 50, 75, 95 %):
//!
//! | scene | largest σ ÷ spacing | largest ÷ smallest σ | opacity |
//! |---|---|---|---|
//! | robot, LOD 4, 8 406 | 0.33 0.56 **0.83** 1.2 2.2 | 3.1 8.6 **25** 67 182 | .40 .78 **.98** 1.0 1.0 |
//! | logo, 307 128 | 0.25 0.44 **0.62** 0.91 2.6 | 3.3 8.2 **17** 52 195 | .09 .46 **.83** .94 .98 |
//! | guitar, 90 854 | 0.42 1.2 **2.4** 3.9 7.2 | 4.0 14 **34** 101 775 | .02 .07 **.24** .74 .99 |
//! | room corner, badly converged, 116 906 | 0.28 0.69 **1.3** 2.4 6.8 | 2.2 9.1 **26** 71 657 | .01 .02 **.05** .09 .23 |
//!
//! The spacing is 1/√(Gaussians per area), taken from the distance of the fourth neighbor, which
//! is 1.09 of it on a plane. Middle ÷ largest σ of the robot: .06 .18 **.34** .56 .84; smallest ÷
//! middle: .01 .06 **.17** .38 .72; each of the three stored axes is the smallest equally often.
//! Isolated Gaussians: 0.3 % in the room corner. From these come, per room: median of the largest σ
//! 0.6 to 1.35 spacings with a spread of e^0.5 to e^0.75, the two ratios, opacity logits of mean −1
//! to 3.4 with a spread of 1.3 to 2, floaters 0.05 to 0.6 %.
//!
//! A share of the rooms looks as points of a mesh do after `gaussians_from_points` of
//! `scenesplat-datasets`: round discs a tenth as thick, one opacity, no noise, undersides and backs
//! present.
//!
//! In those rooms density and size of the Gaussians tell the class, and networks read it. Rooms of
//! [`Capture::Scan`] have no such leak, and vary as scans do; nor have those of [`Capture::Model`], which are points
//! as worlds of simulators give them, and those of [`Capture::Depth`], which are what a depth camera leaves. A [share](SyntheticRoomSettings::flat_share) of the scenes may be flats: rooms on
//! both sides of a corridor, and another [share](SyntheticRoomSettings::public_share) places other than homes.
//!
//! # Furniture
//! Objects are built from parameters; with a [`Catalogue`] most are models of real furniture in their real sizes
//! instead, and things without a class are added. Gaussians are made of both by one function.

pub mod catalogue;
pub mod classes;
mod depth;
mod dice;
mod error;
mod flat;
mod furniture;
mod generate;
mod jitter;
mod material;
mod model;
mod place;
mod recipe;
mod scan;
mod seen;
mod shape;
mod shell;
mod splats;
mod stock;
mod variation;
mod vector;
pub mod vocabulary;
mod walk;

pub use catalogue::{Catalogue, CatalogueError, FurnitureSplit};
pub use classes::{CLASSES, ClassId, Group, SyntheticClass};
pub use error::RoomError;
pub use generate::{
    Capture, MAX_GAUSSIANS, MAX_STRAY, SyntheticObject, SyntheticRoom, SyntheticRoomSettings,
    generate,
};
pub use material::ColorName;
pub use recipe::RoomKind;
pub use vocabulary::Vocabulary;
