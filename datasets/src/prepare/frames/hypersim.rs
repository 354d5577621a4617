//! Hypersim: tone-mapped pictures, distances from the camera, and cameras in the artists' units.

use super::files::{DepthOf, FrameEntry, MAX_PICTURE, PoseOf, SeparateFiles, picture_at};
use super::frame::Listed;
use super::lens::{IDENTITY, Lens, of_opengl};
use crate::DataError;
use crate::files::{bad_file, entries, name_of};
use crate::prepare::readers::hypersim::{Array, metres_per_unit};
use scenesplat_scene::formats::cameras::picture_size;
use scenesplat_scene::input_file::{read_file, read_text_file};
use std::path::{Path, PathBuf};

/// Half the horizontal angle of view of all scenes whose lens was not changed, radians.
const HALF_ANGLE: f64 = std::f64::consts::FRAC_PI_6;
/// Sizes that the pictures have unless the table of lenses says otherwise.
const SIZE: [u32; 2] = [1024, 768];
/// How much an entry of a projection may differ from the default's.
const TOLERANCE: f64 = 1e-3;
const LENSES: &str = "metadata_camera_parameters.csv";

pub(super) fn open(folder: &Path) -> Result<Listed, DataError> {
    let unit = metres_per_unit(&folder.join("_detail/metadata_scene.csv"))?;
    let scene = name_of(&folder.canonicalize().unwrap_or_else(|_| folder.to_owned()));
    let mut notes = Vec::new();
    match lens_table(folder) {
        Some(path) => check_projection(&path, &scene, &mut notes)?,
        None => notes.push(format!(
            "{LENSES} is not beside the scene: its lens is taken for the default one of 60 degrees"
        )),
    }
    let mut list = Vec::new();
    for camera in entries(&folder.join("_detail"))? {
        if camera.is_dir() && name_of(&camera).starts_with("cam_") {
            add_camera(&mut list, folder, &camera, unit)?;
        }
    }
    let first = list.iter().find_map(|entry| entry.picture.as_ref());
    if let Some(path) = first {
        let bytes = read_file(path, MAX_PICTURE)?;
        let Some((width, height)) = picture_size(&bytes) else {
            return Err(bad_file(path, "is no PNG or JPEG picture", "fetch it again"));
        };
        list.iter_mut().for_each(|entry| entry.lens = default_lens([width, height]));
    }
    let files = SeparateFiles { list, depth: DepthOf::Distance, depth_lens: None };
    Ok(Listed { files: Box::new(files), notes })
}

/// The lens of scenes that changed nothing about it, for pictures of a size.
fn default_lens(size: [u32; 2]) -> Lens {
    let [width, height] = size.map(f64::from);
    let focal = width / 2.0 / HALF_ANGLE.tan();
    Lens::of_corner([focal, focal, width / 2.0, height / 2.0], Some(size))
}

/// All frames of a camera.
fn add_camera(
    list: &mut Vec<FrameEntry>,
    folder: &Path,
    camera: &Path,
    unit: f64,
) -> Result<(), DataError> {
    let open = |what: &str| Array::open(&camera.join(format!("camera_keyframe_{what}.hdf5")));
    let (places, turns) = (open("positions")?, open("orientations")?);
    let &[count, 3] = places.shape.as_slice() else {
        return Err(places.bad_shape("[frames, 3]"));
    };
    if turns.shape != [count, 3, 3] {
        return Err(turns.bad_shape(&format!("[{count}, 3, 3]")));
    }
    let (places, turns) = (places.f64()?, turns.f64()?);
    let numbers = frame_numbers(&camera.join("camera_keyframe_frame_indices.hdf5"), count)?;
    let name = name_of(camera);
    let images = folder.join("images");
    let preview = images.join(format!("scene_{name}_final_preview"));
    let geometry = images.join(format!("scene_{name}_geometry_hdf5"));
    let poses = places.chunks_exact(3).zip(turns.chunks_exact(9));
    for (number, (place, turn)) in numbers.into_iter().zip(poses) {
        let mut pose = IDENTITY;
        for i in 0..3 {
            pose[i][..3].copy_from_slice(&turn[3 * i..3 * i + 3]);
            pose[i][3] = place[i] * unit;
        }
        let frame = format!("frame.{number:04}");
        let picture =
            ["tonemap", "color"].map(|kind| picture_at(&preview, &format!("{frame}.{kind}")));
        list.push(FrameEntry {
            name: format!("{name}_{number:04}"),
            picture: picture.into_iter().flatten().next(),
            depth: Some(geometry.join(format!("{frame}.depth_meters.hdf5"))),
            pose: PoseOf::Known(Ok(of_opengl(pose))),
            lens: default_lens(SIZE),
        });
    }
    Ok(())
}

/// The numbers of the pictures of all keyframes: counted, unless a file says them.
fn frame_numbers(path: &Path, count: u64) -> Result<Vec<i32>, DataError> {
    if !path.is_file() {
        return Ok((0..count as i32).collect());
    }
    let array = Array::open(path)?;
    if array.shape != [count] {
        return Err(array.bad_shape(&format!("[{count}], as positions are")));
    }
    array.i32()
}

/// The table of lenses, in the scene's folder or in one of the two around it.
fn lens_table(folder: &Path) -> Option<PathBuf> {
    ["", "..", "../.."].map(|up| folder.join(up).join(LENSES)).into_iter().find(|p| p.is_file())
}

/// Refuses a scene whose projection is not the default one.
fn check_projection(path: &Path, scene: &str, notes: &mut Vec<String>) -> Result<(), DataError> {
    let text = read_text_file(path)?;
    let mut lines = text.lines();
    let header = cells(lines.next().unwrap_or_default());
    let column = |name: &str| header.iter().position(|cell| cell == name);
    let Some(name_at) = column("scene_name") else {
        return Err(bad_file(path, "has no column scene_name", "fetch the table again"));
    };
    let row = lines.map(cells).find(|row| row.get(name_at).is_some_and(|name| name == scene));
    let Some(row) = row else {
        notes.push(format!("{LENSES} has no row {scene}: its lens is taken for the default one"));
        return Ok(());
    };
    let cell = |name: &str| column(name).and_then(|at| row.get(at));
    let number = |name: &str| cell(name).and_then(|text| text.parse::<f64>().ok());
    let side = |name: &str, k: usize| number(name).unwrap_or(f64::from(SIZE[k]));
    let ratio = side("settings_output_img_width", 0) / side("settings_output_img_height", 1);
    let focal = 1.0 / HALF_ANGLE.tan();
    let refuse = |what: String| {
        let problem = format!("{what} of {scene}: not the default lens of 60 degrees");
        let help = "such a lens may be tilted or shifted, which a pinhole cannot hold: leave the scene out";
        Err(bad_file(path, problem, help))
    };
    let wanted =
        [("00", focal), ("11", focal * ratio), ("01", 0.0), ("02", 0.0), ("10", 0.0), ("12", 0.0)];
    for (place, want) in wanted {
        let name = format!("M_proj_{place}");
        // Rows may count downward, which is a sign.
        let Some(value) = number(&name) else { continue };
        let off = (value.abs() - want).abs();
        if off.is_nan() || off > TOLERANCE {
            return refuse(format!("{name} is {value}"));
        }
    }
    if number("M_proj_00").is_none()
        && cell("use_camera_physical").is_some_and(|text| is_true(text))
    {
        return refuse("use_camera_physical is set".to_owned());
    }
    Ok(())
}

fn is_true(text: &str) -> bool {
    text.eq_ignore_ascii_case("true") || text.parse::<f64>().is_ok_and(|value| value != 0.0)
}

/// The cells of a line of a table, which may be quoted.
fn cells(line: &str) -> Vec<String> {
    let (mut out, mut quoted) = (vec![String::new()], false);
    for letter in line.trim_end().chars() {
        match letter {
            '"' => quoted = !quoted,
            ',' if !quoted => out.push(String::new()),
            letter => {
                if let Some(cell) = out.last_mut() {
                    cell.push(letter);
                }
            }
        }
    }
    out
}
