//! Colors of what a picture has besides the scene.

/// Whether a preview is for the screen or for paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Theme {
    /// Light letters on a dark ground.
    #[default]
    Dark,
    /// Dark letters on white.
    Light,
}

impl Theme {
    /// Around the views.
    pub(super) fn ground(self) -> [u8; 3] {
        match self {
            Self::Dark => super::BACKGROUND,
            Self::Light => [255, 255, 255],
        }
    }

    /// Behind the scene: at the upper edge of a view, and how much lighter it is at the lower one.
    pub(super) fn backdrop(self) -> ([f32; 3], f32) {
        match self {
            Self::Dark => ([44.0, 47.0, 54.0], 14.0),
            Self::Light => ([240.0, 241.0, 243.0], -12.0),
        }
    }

    /// Below letters that stand on a view: dark letters on a dark scene could not be read.
    pub(super) fn plate(self) -> Option<[u8; 3]> {
        match self {
            Self::Dark => None,
            Self::Light => Some([255, 255, 255]),
        }
    }

    /// Letters.
    pub(super) fn ink(self) -> [u8; 3] {
        match self {
            Self::Dark => super::INK,
            Self::Light => [40, 44, 52],
        }
    }

    /// Letters of lesser things.
    pub(super) fn faint_ink(self) -> [u8; 3] {
        match self {
            Self::Dark => super::FAINT_INK,
            Self::Light => [90, 97, 109],
        }
    }

    /// Warnings.
    pub(super) fn warning_ink(self) -> [u8; 3] {
        match self {
            Self::Dark => [240, 170, 80],
            Self::Light => [168, 74, 16],
        }
    }
}
