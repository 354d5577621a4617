//! COLMAP models, written independently of the crate.

use super::SplitMix;
use std::fmt::Write as _;

/// Ids, names and parameter counts as COLMAP documents them.
pub const MODELS: [(i32, &str, usize); 18] = [
    (0, "SIMPLE_PINHOLE", 3),
    (1, "PINHOLE", 4),
    (2, "SIMPLE_RADIAL", 4),
    (3, "RADIAL", 5),
    (4, "OPENCV", 8),
    (5, "OPENCV_FISHEYE", 8),
    (6, "FULL_OPENCV", 12),
    (7, "FOV", 5),
    (8, "SIMPLE_RADIAL_FISHEYE", 4),
    (9, "RADIAL_FISHEYE", 5),
    (10, "THIN_PRISM_FISHEYE", 12),
    (11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
    (12, "SIMPLE_DIVISION", 4),
    (13, "DIVISION", 5),
    (14, "SIMPLE_FISHEYE", 3),
    (15, "FISHEYE", 4),
    (16, "EUCM", 6),
    (17, "EQUIRECTANGULAR", 2),
];

pub struct Lens {
    pub id: u32,
    pub model: usize,
    pub size: [u64; 2],
    pub params: Vec<f64>,
}

pub struct Picture {
    pub id: u32,
    pub quat: [f64; 4],
    pub translation: [f64; 3],
    pub lens: u32,
    pub name: &'static str,
    pub points: Vec<([f64; 2], i64)>,
}

pub struct Point {
    pub at: [f64; 3],
    pub color: [u8; 3],
    pub track: Vec<[u32; 2]>,
}

#[derive(Default)]
pub struct Model {
    pub lenses: Vec<Lens>,
    pub pictures: Vec<Picture>,
    pub points: Vec<Point>,
}

impl Model {
    pub fn binary(&self) -> [Vec<u8>; 3] {
        let mut cameras = (self.lenses.len() as u64).to_le_bytes().to_vec();
        for lens in &self.lenses {
            cameras.extend_from_slice(&lens.id.to_le_bytes());
            cameras.extend_from_slice(&MODELS[lens.model].0.to_le_bytes());
            lens.size.iter().for_each(|v| cameras.extend_from_slice(&v.to_le_bytes()));
            lens.params.iter().for_each(|v| cameras.extend_from_slice(&v.to_le_bytes()));
        }
        let mut images = (self.pictures.len() as u64).to_le_bytes().to_vec();
        for picture in &self.pictures {
            images.extend_from_slice(&picture.id.to_le_bytes());
            let pose = picture.quat.iter().chain(&picture.translation);
            pose.for_each(|v| images.extend_from_slice(&v.to_le_bytes()));
            images.extend_from_slice(&picture.lens.to_le_bytes());
            images.extend_from_slice(picture.name.as_bytes());
            images.push(0);
            images.extend_from_slice(&(picture.points.len() as u64).to_le_bytes());
            for (pixel, point) in &picture.points {
                pixel.iter().for_each(|v| images.extend_from_slice(&v.to_le_bytes()));
                images.extend_from_slice(&point.to_le_bytes());
            }
        }
        let mut points = (self.points.len() as u64).to_le_bytes().to_vec();
        for (id, point) in self.points.iter().enumerate() {
            points.extend_from_slice(&(id as u64).to_le_bytes());
            point.at.iter().for_each(|v| points.extend_from_slice(&v.to_le_bytes()));
            points.extend_from_slice(&point.color);
            points.extend_from_slice(&0.5f64.to_le_bytes());
            points.extend_from_slice(&(point.track.len() as u64).to_le_bytes());
            let track = point.track.iter().flatten();
            track.for_each(|v| points.extend_from_slice(&v.to_le_bytes()));
        }
        [cameras, images, points]
    }

    pub fn text(&self) -> [Vec<u8>; 3] {
        let words = |v: &[f64]| v.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        let mut cameras = "# Camera list with one line of data per camera:\n".to_owned();
        let _ = writeln!(cameras, "# Number of cameras: {}", self.lenses.len());
        for lens in &self.lenses {
            let ([w, h], name) = (lens.size, MODELS[lens.model].1);
            let _ = writeln!(cameras, "{} {name} {w} {h} {}", lens.id, words(&lens.params));
        }
        let mut images = format!("# Number of images: {}, mean: 1\n", self.pictures.len());
        for p in &self.pictures {
            let (q, t) = (words(&p.quat), words(&p.translation));
            let _ = writeln!(images, "{} {q} {t} {} {}", p.id, p.lens, p.name);
            let points = p.points.iter().map(|([x, y], id)| format!("{x} {y} {id}"));
            let _ = writeln!(images, "{}", points.collect::<Vec<_>>().join(" "));
        }
        let mut points = format!("# Number of points: {}, mean track: 1\n", self.points.len());
        for (id, p) in self.points.iter().enumerate() {
            let [r, g, b] = p.color;
            let track: String = p.track.iter().map(|[i, j]| format!(" {i} {j}")).collect();
            let _ = writeln!(points, "{id} {} {r} {g} {b} 0.5{track}", words(&p.at));
        }
        [cameras, images, points].map(String::into_bytes)
    }
}

/// Every model that can be held, with numbers that are not round.
pub fn model() -> Model {
    let mut rng = SplitMix(1);
    let mut model = Model::default();
    for (i, &(_, name, params)) in MODELS.iter().enumerate() {
        let known = !matches!(i, 7 | 10..=13 | 16 | 17);
        let focals = if params == 3 || name.starts_with("SIMPLE") || name.starts_with("RADIAL") {
            1
        } else {
            2
        };
        let mut values = vec![500.1 + i as f64; focals];
        values.extend([320.7, 240.3]);
        while values.len() < params {
            values.push(f64::from(rng.float()) / 30.0);
        }
        values.truncate(params);
        let id = 40 - i as u32;
        model.lenses.push(Lens { id, model: i, size: [640, 480], params: values });
        if known {
            model.pictures.push(Picture {
                id: 7 + i as u32,
                quat: [(); 4].map(|()| f64::from(rng.float())),
                translation: [(); 3].map(|()| f64::from(rng.float()) * 3.0),
                lens: id,
                name: ["a.jpg", "sub/b c.png", "ü.jpg"][i % 3],
                points: vec![([1.5, 2.25], -1), ([3.0, 4.0], 0)][..i % 3].to_vec(),
            });
        }
    }
    for i in 0..20u8 {
        model.points.push(Point {
            at: [(); 3].map(|()| f64::from(rng.float()) * 5.0),
            color: [i, 2 * i, 255 - i],
            track: vec![[1, 2]; usize::from(i % 4)],
        });
    }
    model
}
