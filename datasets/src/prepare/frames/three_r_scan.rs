//! 3RScan: `_info.txt` and, of each frame, a JPEG, a PGM of depth and a pose.

use super::files::{DepthOf, Kind, SeparateFiles, first_folder, paired};
use super::frame::Listed;
use super::lens::Lens;
use super::text::numbers_of;
use crate::DataError;
use crate::files::bad_file;
use scenesplat_scene::input_file::read_text_file;
use std::path::{Path, PathBuf};

/// The lines of `_info.txt`, `name = numbers`.
struct Info {
    path: PathBuf,
    text: String,
}

impl Info {
    fn numbers(&self, name: &str) -> Result<Vec<f64>, DataError> {
        let line = self.text.lines().find_map(|line| {
            let (key, value) = line.split_once('=')?;
            (key.trim() == name).then_some(value)
        });
        let values = line.and_then(|line| numbers_of(line).ok());
        values.filter(|values| !values.is_empty()).ok_or_else(|| {
            let problem = format!("has no line {name:?} of numbers");
            bad_file(&self.path, problem, "fetch the scan's sequence.zip again and unpack it")
        })
    }

    fn number(&self, name: &str) -> Result<f64, DataError> {
        Ok(self.numbers(name)?[0])
    }

    /// The lens of `Color` or `Depth`.
    fn lens(&self, what: &str) -> Result<Lens, DataError> {
        let bad = |problem: String| bad_file(&self.path, problem, "fetch the scan again");
        let side = |name: &str| -> Result<u32, DataError> {
            let value = self.number(name)?;
            let whole = value.fract() == 0.0 && (1.0..=65536.0).contains(&value);
            if whole { Ok(value as u32) } else { Err(bad(format!("{name} is {value}"))) }
        };
        let prefix = what.to_lowercase();
        let size = [side(&format!("m_{prefix}Width"))?, side(&format!("m_{prefix}Height"))?];
        let name = format!("m_calibration{what}Intrinsic");
        let values = self.numbers(&name)?;
        Lens::of_matrix(&values, Some(size))
            .ok_or_else(|| bad(format!("{name} has {} numbers, expected 16", values.len())))
    }
}

pub(super) fn open(path: &Path) -> Result<Listed, DataError> {
    let folder = first_folder([path.join("sequence")]).unwrap_or_else(|| path.to_owned());
    let info = folder.join("_info.txt");
    if !info.is_file() && path.join("sequence.zip").is_file() {
        let help = "unpack sequence.zip into a folder sequence beside it";
        return Err(bad_file(path, "holds sequence.zip, which is still packed", help));
    }
    let info = Info { text: read_text_file(&info)?, path: info };
    let (lens, depth_lens) = (info.lens("Color")?, info.lens("Depth")?);
    let steps = info.number("m_depthShift")?;
    if !(steps.is_finite() && steps > 0.0) {
        let problem = format!("m_depthShift is {steps}, expected steps per meter");
        return Err(bad_file(&info.path, problem, "fetch the scan again"));
    }
    let kinds: [&[&str]; 3] = [&[".color.jpg"], &[".depth.pgm"], &[".pose.txt"]];
    let kinds = kinds.map(|endings| Kind(folder.clone(), "frame-", endings));
    let list = paired(kinds, |key| format!("frame-{key}"), lens)?;
    let stated = info.number("m_frames.size")?;
    let mut notes = Vec::new();
    if stated != list.len() as f64 {
        notes.push(format!("_info.txt says there are {stated} frames, {} are here", list.len()));
    }
    let files = SeparateFiles { list, depth: DepthOf::Pgm(steps), depth_lens: Some(depth_lens) };
    Ok(Listed { files: Box::new(files), notes })
}
