//! Hypersim: no mesh, but for each pixel of each picture where it is in the world and what it shows, in HDF5.

use super::super::scan::{Names, ScanPoints, unit_or_zero};
use crate::DataError;
use crate::files::{bad_file, entries, name_of};
use crate::sources::class_lists::{NYU40, names};
use half::f16;
use hdf5_pure::{Datatype, DatatypeByteOrder};
use scenesplat_scene::SceneError;
use scenesplat_scene::input_file::read_text_file;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Side of the cubes of which each becomes one point, meters: a scene has about a hundred million pixels.
const CELL: f64 = 0.02;
/// Most pixels of a picture; those of the data set have 1024 × 768.
const MAX_PIXELS: u64 = 1 << 26;
/// Largest file that is read.
const MAX_FILE: u64 = 1 << 30;
const DAMAGED: &str = "the file is damaged or not of Hypersim, fetch it again";

/// What the pixels in a cube say.
#[derive(Default)]
struct Cell {
    point: [f64; 3],
    normal: [f64; 3],
    pixels: u32,
    /// Label, instance, and how many pixels have both.
    votes: Vec<(i16, i32, u32)>,
}

/// All pictures of all cameras that are there; each needs `position`, `semantic` and `semantic_instance`, and may have
/// `normal_world`.
pub(super) fn read(folder: &Path) -> Result<ScanPoints, DataError> {
    let unit = metres_per_unit(&folder.join("_detail/metadata_scene.csv"))?;
    let pictures = pictures(&folder.join("images"))?;
    let mut numbers: HashMap<[i32; 3], usize> = HashMap::new();
    let mut cells: Vec<Cell> = Vec::new();
    let mut has_normals = true;
    for picture in &pictures {
        has_normals &= picture.add(unit, |place, point, normal, label, instance| {
            // Cells are numbered as they come up: their order does not depend on the map.
            let number = *numbers.entry(place).or_insert_with(|| {
                cells.push(Cell::default());
                cells.len() - 1
            });
            cells[number].add(point, normal, label, instance);
        })?;
    }
    if cells.is_empty() {
        let problem = format!("none of the {} pictures shows anything", pictures.len());
        return Err(bad_file(folder, problem, "is it the right folder?"));
    }
    let classes = names(NYU40);
    let mut known = Names::default();
    let mut out = ScanPoints::default();
    let mut normals = Vec::with_capacity(cells.len());
    for cell in &cells {
        let count = f64::from(cell.pixels);
        out.coord.push(cell.point.map(|v| (v / count) as f32));
        let (label, instance) = cell.most();
        let name = usize::try_from(label - 1).ok().and_then(|at| classes.get(at));
        out.raw.push(name.map_or(-1, |name| known.number(name)));
        out.instance.push(instance);
        normals.push(unit_or_zero(cell.normal));
    }
    out.names = known.list;
    out.normal = has_normals.then_some(normals);
    Ok(out)
}

impl Cell {
    fn add(&mut self, point: [f64; 3], normal: [f64; 3], label: i16, instance: i32) {
        self.pixels += 1;
        for k in 0..3 {
            self.point[k] += point[k];
            self.normal[k] += normal[k];
        }
        match self.votes.iter_mut().find(|(l, i, _)| (*l, *i) == (label, instance)) {
            Some((_, _, count)) => *count += 1,
            None => self.votes.push((label, instance, 1)),
        }
    }

    /// What most pixels say; of equals what comes first, one with a label before none.
    fn most(&self) -> (i16, i32) {
        let none = |label: i16| label < 1;
        let better = |a: &&(i16, i32, u32), b: &&(i16, i32, u32)| {
            a.2.cmp(&b.2).then(none(b.0).cmp(&none(a.0))).then((b.0, b.1).cmp(&(a.0, a.1)))
        };
        self.votes.iter().max_by(better).map_or((-1, -1), |&(label, instance, _)| (label, instance))
    }
}

/// The factor from the artists' units to meters.
pub(in crate::prepare) fn metres_per_unit(path: &Path) -> Result<f64, DataError> {
    const NAME: &str = "meters_per_asset_unit";
    let text = read_text_file(path)?;
    let row =
        text.lines().find_map(|line| line.trim().strip_prefix(NAME)?.trim().strip_prefix(','));
    let value = row.and_then(|value| value.trim().parse::<f64>().ok());
    value.filter(|v| v.is_finite() && *v > 0.0).ok_or_else(|| {
        let problem = match row {
            Some(value) => format!("{NAME} is {:?}", value.trim()),
            None => format!("has no row {NAME}"),
        };
        bad_file(path, problem, "a number above 0 is expected")
    })
}

/// The files of a picture, without their endings.
struct PictureFiles {
    folder: PathBuf,
    frame: String,
}

/// All pictures, by camera and number.
fn pictures(images: &Path) -> Result<Vec<PictureFiles>, DataError> {
    let mut found = Vec::new();
    for folder in entries(images)? {
        let name = name_of(&folder);
        if !(name.starts_with("scene_") && name.ends_with("_geometry_hdf5")) {
            continue;
        }
        for file in entries(&folder)? {
            if let Some(frame) = name_of(&file).strip_suffix(".position.hdf5") {
                found.push(PictureFiles { folder: folder.clone(), frame: frame.to_owned() });
            }
        }
    }
    if found.is_empty() {
        let help = "scene_cam_XX_geometry_hdf5/frame.IIII.position.hdf5 are expected in it";
        return Err(bad_file(images, "holds no picture", help));
    }
    Ok(found)
}

impl PictureFiles {
    fn file(&self, what: &str) -> PathBuf {
        self.folder.join(format!("{}.{what}.hdf5", self.frame))
    }

    /// An array of the same picture as `position`.
    fn array(&self, what: &str, shape: &[u64]) -> Result<Array, DataError> {
        let array = Array::open(&self.file(what))?;
        if array.shape != shape {
            return Err(array.bad_shape(&format!("{shape:?}, as position has")));
        }
        Ok(array)
    }

    /// Hands out the pixels that show something: cube, point (meters), normal, label, instance. Whether there are normals.
    fn add(
        &self,
        unit: f64,
        mut sink: impl FnMut([i32; 3], [f64; 3], [f64; 3], i16, i32),
    ) -> Result<bool, DataError> {
        let place = Array::open(&self.file("position"))?;
        let &[height, width, 3] = place.shape.as_slice() else {
            return Err(place.bad_shape("[height, width, 3]"));
        };
        let points = place.f32()?;
        let labels = self.array("semantic", &[height, width])?.i32()?;
        let instances = self.array("semantic_instance", &[height, width])?.i32()?;
        let normals = match self.file("normal_world").exists() {
            true => Some(self.array("normal_world", &place.shape)?.f32()?),
            false => None,
        };
        for (at, (point, (&label, &instance))) in
            points.chunks_exact(3).zip(labels.iter().zip(&instances)).enumerate()
        {
            // Pixels that show nothing, such as the sky, are NaN.
            if !point.iter().all(|v| v.is_finite()) {
                continue;
            }
            let point = [0, 1, 2].map(|k| f64::from(point[k]) * unit);
            let cube = cube_of(point);
            if cube.iter().any(|v| v.abs() > f64::from(i32::MAX)) {
                let problem = format!("pixel {at} is at {point:?} meters");
                return Err(bad_file(&place.path, problem, "is meters_per_asset_unit right?"));
            }
            let normal = normals.as_ref().map_or([0.0; 3], |normals| {
                let n = [0, 1, 2].map(|k| f64::from(normals[3 * at + k]));
                if n.iter().all(|v| v.is_finite()) { n } else { [0.0; 3] }
            });
            let label = i16::try_from(label).unwrap_or(-1);
            sink(cube.map(|v| v as i32), point, normal, label, instance);
        }
        Ok(normals.is_some())
    }
}

/// The number of the cube that a point is in along each axis.
fn cube_of(point: [f64; 3]) -> [f64; 3] {
    point.map(|v| (v / CELL).floor())
}

/// The one array of such a file, which is called `dataset`.
pub(in crate::prepare) struct Array {
    path: PathBuf,
    data: hdf5_pure::Dataset,
    pub(in crate::prepare) shape: Vec<u64>,
}

impl Array {
    pub(in crate::prepare) fn open(path: &Path) -> Result<Self, DataError> {
        let io = |source| SceneError::Io { path: path.to_owned(), action: "cannot read", source };
        let size = std::fs::metadata(path).map_err(io)?.len();
        if size > MAX_FILE {
            let problem = format!("has {size} bytes, at most {MAX_FILE} are read");
            return Err(bad_file(path, problem, DAMAGED));
        }
        let bad = |error: hdf5_pure::Error| {
            bad_file(path, format!("no HDF5 with an array called dataset: {error}"), DAMAGED)
        };
        let data =
            hdf5_pure::File::open(path).and_then(|file| file.dataset("dataset")).map_err(bad)?;
        let shape = data.shape().map_err(bad)?;
        let out = Self { path: path.to_owned(), data, shape };
        // Sizes are compared before memory is reserved for them.
        let pixels = out.shape.iter().take(2).try_fold(1u64, |a, b| a.checked_mul(*b));
        if pixels.is_none_or(|n| n == 0 || n > MAX_PIXELS) || out.shape.len() > 3 {
            return Err(out.bad_shape("a picture"));
        }
        Ok(out)
    }

    pub(in crate::prepare) fn bad_shape(&self, expected: &str) -> DataError {
        bad_file(&self.path, format!("is {:?}, expected {expected}", self.shape), DAMAGED)
    }

    pub(in crate::prepare) fn f32(&self) -> Result<Vec<f32>, DataError> {
        // Numbers of 16 bits are not among those that the crate converts.
        use {Datatype::FloatingPoint, DatatypeByteOrder::LittleEndian};
        let ty = self.data.datatype();
        if !matches!(ty, Ok(FloatingPoint { size: 2, byte_order: LittleEndian, .. })) {
            return self.checked(self.data.read_f32());
        }
        let half = |bytes: Vec<u8>| {
            let (pairs, _) = bytes.as_chunks::<2>();
            pairs.iter().map(|pair| f16::from_le_bytes(*pair).to_f32()).collect()
        };
        self.checked(self.data.read_raw().map(half))
    }

    pub(in crate::prepare) fn f64(&self) -> Result<Vec<f64>, DataError> {
        self.checked(self.data.read_f64())
    }

    pub(in crate::prepare) fn i32(&self) -> Result<Vec<i32>, DataError> {
        self.checked(self.data.read_i32())
    }

    fn checked<T>(&self, found: Result<Vec<T>, hdf5_pure::Error>) -> Result<Vec<T>, DataError> {
        let values = found.map_err(|error| bad_file(&self.path, error.to_string(), DAMAGED))?;
        let expected: u64 = self.shape.iter().product();
        if values.len() as u64 != expected {
            let problem = format!("has {} values, {:?} are {expected}", values.len(), self.shape);
            return Err(bad_file(&self.path, problem, DAMAGED));
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubes_on_both_sides_of_zero_are_two() {
        assert_eq!(CELL, 0.02);
        assert_eq!(cube_of([-0.001, 0.001, -0.021]), [-1.0, 0.0, -2.0]);
        assert_eq!(cube_of([0.019, 0.021, 0.0]), [0.0, 1.0, 0.0]);
    }
}
