//! Copying rows of the arrays of a folder, whatever they hold.

use crate::files::picked;
use half::f16;
use scenesplat_scene::SceneError;
use scenesplat_scene::formats::npy::{NpyFile, NpyType};
use scenesplat_scene::formats::npy_writer::{NpyElement, write_npy};
use std::path::Path;

/// Writes rows of an array, one file for each of `parts`, in a type that holds the same values.
/// `change` sees the values of float arrays of two bytes first.
///
/// Types stay, but for unsigned integers, which become the next larger signed ones, and booleans,
/// which become bytes.
pub(super) fn copy_rows(
    file: &NpyFile,
    parts: &[(&[u32], &Path)],
    change: impl FnOnce(&mut [f16]),
) -> Result<(), SceneError> {
    let shape = file.shape();
    match file.ty() {
        NpyType::Float(2) => {
            let mut values = file.read_f16()?;
            change(&mut values);
            write(&values, shape, parts)
        }
        NpyType::Float(4) => write(&file.read_f32()?, shape, parts),
        NpyType::Float(_) => write(&file.read_f64()?, shape, parts),
        NpyType::Bool | NpyType::UInt(1) => write(&file.read_u8()?, shape, parts),
        NpyType::Int(1 | 2) => write(&narrowed(&file.read_i64()?, |v| v as i16), shape, parts),
        NpyType::UInt(2) | NpyType::Int(4) => {
            write(&narrowed(&file.read_i64()?, |v| v as i32), shape, parts)
        }
        NpyType::Int(_) | NpyType::UInt(_) => write(&file.read_i64()?, shape, parts),
    }
}

/// The type was chosen so that nothing is lost.
fn narrowed<T>(values: &[i64], cast: impl Fn(i64) -> T) -> Vec<T> {
    values.iter().map(|&v| cast(v)).collect()
}

fn write<T: NpyElement>(
    values: &[T],
    shape: &[usize],
    parts: &[(&[u32], &Path)],
) -> Result<(), SceneError> {
    let width: usize = shape[1..].iter().product();
    for (rows, path) in parts {
        let mut shape = shape.to_vec();
        shape[0] = rows.len();
        write_npy(path, &shape, &picked(values, width, rows))?;
    }
    Ok(())
}
