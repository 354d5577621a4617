//! The lens models of COLMAP.

use crate::Distortion;

/// A lens as its file says it.
pub(super) struct Lens {
    pub id: u32,
    pub model: &'static Model,
    pub width: u64,
    pub height: u64,
    /// As many as the model has.
    pub params: Vec<f64>,
}

/// A model of lenses.
#[derive(Debug, PartialEq)]
pub(super) struct Model {
    id: i32,
    pub name: &'static str,
    pub params: usize,
}

const fn model(id: i32, name: &'static str, params: usize) -> Model {
    Model { id, name, params }
}

/// Ids, names and numbers of parameters from COLMAP's `sensor/models.h`.
static MODELS: [Model; 18] = [
    model(0, "SIMPLE_PINHOLE", 3),
    model(1, "PINHOLE", 4),
    model(2, "SIMPLE_RADIAL", 4),
    model(3, "RADIAL", 5),
    model(4, "OPENCV", 8),
    model(5, "OPENCV_FISHEYE", 8),
    model(6, "FULL_OPENCV", 12),
    model(7, "FOV", 5),
    model(8, "SIMPLE_RADIAL_FISHEYE", 4),
    model(9, "RADIAL_FISHEYE", 5),
    model(10, "THIN_PRISM_FISHEYE", 12),
    model(11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
    model(12, "SIMPLE_DIVISION", 4),
    model(13, "DIVISION", 5),
    model(14, "SIMPLE_FISHEYE", 3),
    model(15, "FISHEYE", 4),
    model(16, "EUCM", 6),
    model(17, "EQUIRECTANGULAR", 2),
];

/// The model of that id.
pub(super) fn by_id(id: i32) -> Option<&'static Model> {
    MODELS.iter().find(|model| model.id == id)
}

/// The model of that name.
pub(super) fn by_name(name: &str) -> Option<&'static Model> {
    MODELS.iter().find(|model| model.name == name)
}

/// `fx, fy, cx, cy` and the distortion; the error is about a model that [`Distortion`] lacks.
pub(super) fn intrinsics(lens: &Lens) -> Result<(f64, f64, f64, f64, Distortion), String> {
    let cv = |k: [f64; 6], p: [f64; 2]| Distortion::open_cv(k, p);
    let fish = |k: [f64; 4]| Distortion::Fisheye { k };
    Ok(match (lens.model.name, lens.params.as_slice()) {
        ("SIMPLE_PINHOLE", &[f, x, y]) => (f, f, x, y, Distortion::None),
        ("PINHOLE", &[fx, fy, x, y]) => (fx, fy, x, y, Distortion::None),
        ("SIMPLE_RADIAL", &[f, x, y, k]) => (f, f, x, y, cv([k, 0., 0., 0., 0., 0.], [0.; 2])),
        ("RADIAL", &[f, x, y, k1, k2]) => (f, f, x, y, cv([k1, k2, 0., 0., 0., 0.], [0.; 2])),
        ("OPENCV", &[fx, fy, x, y, k1, k2, p1, p2]) => {
            (fx, fy, x, y, cv([k1, k2, 0., 0., 0., 0.], [p1, p2]))
        }
        ("FULL_OPENCV", &[fx, fy, x, y, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            (fx, fy, x, y, cv([k1, k2, k3, k4, k5, k6], [p1, p2]))
        }
        ("SIMPLE_FISHEYE", &[f, x, y]) => (f, f, x, y, fish([0.; 4])),
        ("FISHEYE", &[fx, fy, x, y]) => (fx, fy, x, y, fish([0.; 4])),
        ("SIMPLE_RADIAL_FISHEYE", &[f, x, y, k]) => (f, f, x, y, fish([k, 0., 0., 0.])),
        ("RADIAL_FISHEYE", &[f, x, y, k1, k2]) => (f, f, x, y, fish([k1, k2, 0., 0.])),
        ("OPENCV_FISHEYE", &[fx, fy, x, y, k1, k2, k3, k4]) => {
            (fx, fy, x, y, fish([k1, k2, k3, k4]))
        }
        (name, _) => {
            return Err(format!(
                "camera {} is of the lens model {name}, which is not known",
                lens.id
            ));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_and_names_find_the_same_model() {
        for (id, model) in MODELS.iter().enumerate() {
            assert_eq!(by_id(id as i32), Some(model));
            assert_eq!(by_name(model.name), Some(model));
        }
        assert_eq!((by_id(-1), by_id(18), by_name("pinhole")), (None, None, None));
    }
}
