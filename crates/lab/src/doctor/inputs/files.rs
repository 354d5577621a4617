//! Small scenes and files of them, written independently of the readers.

use crate::doctor::noise::Noise;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_scene::formats::{FORMATS, FormatRow};
use scenesplat_scene::value_policy::{Action, Rule};
use scenesplat_scene::{
    GaussianScene, LoadedScene, Policy, ReadOptions, SceneError, SceneFormat, WriteOptions,
    open_scene, write_scene,
};
use std::path::Path;

/// Gaussians of the files; one of them is bad.
pub(in crate::doctor) const ROWS: usize = 6;
/// The row that is bad.
pub(in crate::doctor) const BAD: usize = 3;

/// A scene that cleaning leaves as it is.
pub(in crate::doctor) fn scene(rows: usize, sh_degree: u8, seed: u64) -> GaussianScene {
    let mut rng = Noise::new(seed);
    let mut scene = GaussianScene { sh_degree, ..GaussianScene::default() };
    for _ in 0..rows {
        scene.coord.push([(); 3].map(|()| rng.float()));
        scene.log_scale.push([(); 3].map(|()| rng.float() - 4.0));
        let quat = [(); 4].map(|()| f64::from(rng.float()));
        let norm = quat.iter().map(|v| v * v).sum::<f64>().sqrt().copysign(quat[0]);
        scene.quat.push(quat.map(|v| (v / norm) as f32));
        scene.opacity_logit.push(rng.float() * 4.0);
        scene.sh_dc.push([(); 3].map(|()| rng.float()));
        for _ in 0..scene.sh_rest_len() * 3 {
            scene.sh_rest.push(rng.float() * 0.5);
        }
    }
    scene
}

/// Columns of a file, by name.
pub(in crate::doctor) type Columns = Vec<(String, Vec<f32>)>;

/// The columns of the original trainer, degree 1, with normals and labels.
pub(in crate::doctor) fn columns(rows: usize) -> Columns {
    let scene = scene(rows, 1, 9);
    let mut columns: Columns = Vec::new();
    let mut add = |name: &str, i: Option<usize>, values: Vec<f32>| {
        columns.push((i.map_or(name.to_owned(), |i| format!("{name}{i}")), values));
    };
    for (i, name) in ["x", "y", "z"].into_iter().enumerate() {
        add(name, None, scene.coord.iter().map(|v| v[i]).collect());
    }
    for (i, name) in ["nx", "ny", "nz"].into_iter().enumerate() {
        add(name, None, vec![[0.0, 0.6, 0.8][i]; rows]);
    }
    for i in 0..3 {
        add("f_dc_", Some(i), scene.sh_dc.iter().map(|v| v[i]).collect());
    }
    for i in 0..9 {
        // Planar in the file: three coefficients of red, then of green, then of blue.
        let (channel, coefficient) = (i / 3, i % 3);
        let of = |row: &[f32]| row[coefficient * 3 + channel];
        add("f_rest_", Some(i), scene.sh_rest.chunks_exact(9).map(of).collect());
    }
    add("opacity", None, scene.opacity_logit.clone());
    for i in 0..3 {
        add("scale_", Some(i), scene.log_scale.iter().map(|v| v[i]).collect());
    }
    for i in 0..4 {
        add("rot_", Some(i), scene.quat.iter().map(|v| v[i]).collect());
    }
    add("segment", None, (0..rows).map(|i| (i % 4) as f32).collect());
    add("score", None, vec![0.5; rows]);
    add("instance", None, (0..rows).map(|i| (i % 3) as f32).collect());
    columns
}

/// The columns with one value changed.
pub(in crate::doctor) fn with(mut columns: Columns, name: &str, row: usize, value: f32) -> Columns {
    for (_, values) in columns.iter_mut().filter(|(n, _)| n == name) {
        values[row] = value;
    }
    columns
}

/// How a file is encoded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::doctor) enum Encoding {
    Ascii,
    Little,
    Big,
}

/// A PLY file of float columns.
pub(in crate::doctor) fn ply(columns: &Columns, encoding: Encoding, line_end: &str) -> Vec<u8> {
    let rows = columns.first().map_or(0, |(_, values)| values.len());
    let format = match encoding {
        Encoding::Ascii => "ascii",
        Encoding::Little => "binary_little_endian",
        Encoding::Big => "binary_big_endian",
    };
    let mut head = format!("ply\nformat {format} 1.0\nelement vertex {rows}\n");
    columns.iter().for_each(|(name, _)| head += &format!("property float {name}\n"));
    head += "end_header\n";
    let mut out = head.replace('\n', line_end).into_bytes();
    for row in 0..rows {
        let values = columns.iter().map(|(_, values)| values[row]);
        match encoding {
            Encoding::Ascii => {
                let words: Vec<String> = values.map(|v| v.to_string()).collect();
                out.extend_from_slice((words.join(" ") + line_end).as_bytes());
            }
            Encoding::Little => values.for_each(|v| out.extend_from_slice(&v.to_le_bytes())),
            Encoding::Big => values.for_each(|v| out.extend_from_slice(&v.to_be_bytes())),
        }
    }
    out
}

/// As most trainers write it.
pub(in crate::doctor) fn little(columns: &Columns) -> Vec<u8> {
    ply(columns, Encoding::Little, "\n")
}

/// The header of a binary file, and the rest.
pub(in crate::doctor) fn cut_header(bytes: &[u8]) -> (String, &[u8]) {
    const END: &[u8] = b"end_header\n";
    let at =
        bytes.windows(END.len()).position(|w| w == END).map_or(bytes.len(), |at| at + END.len());
    (String::from_utf8_lossy(&bytes[..at]).into_owned(), &bytes[at..])
}

/// Reads a file by the given policy.
pub(in crate::doctor) fn open(path: &Path, policy: Policy) -> Result<LoadedScene, SceneError> {
    open_scene(path, &ReadOptions { policy, ..ReadOptions::default() })
}

/// Reads a file that both policies have to take.
pub(in crate::doctor) fn open_legal(path: &Path) -> Result<LoadedScene, Failure> {
    open(path, Policy::Strict)
        .map_err(|e| Failure(format!("the strict policy refuses what is legal: {e}")))?;
    let loaded = open(path, Policy::Repair)?;
    ensure!(loaded.report.is_clean(), "reported as repaired: {}", loaded.report);
    Ok(loaded)
}

/// Reads a file in which one row needs a repair: the strict policy has to refuse it and name the row.
pub(in crate::doctor) fn open_repaired(
    path: &Path,
    rule: Rule,
    row: usize,
) -> Result<LoadedScene, Failure> {
    let loaded = open(path, Policy::Repair)?;
    let Some(finding) = loaded.report.finding(rule) else {
        return Err(Failure(format!("no finding {rule:?} in the report: {}", loaded.report)));
    };
    ensure!(finding.action == Action::Repair, "{rule:?} counts as {:?}", finding.action);
    ensure!(
        finding.first_element == row && finding.count > 0,
        "{rule:?}: row {} named, {row} is bad",
        finding.first_element
    );
    refused(open(path, Policy::Strict), &[&format!("element {row}"), finding.field])?;
    Ok(loaded)
}

/// That a file is refused, with all of these words in the error.
pub(in crate::doctor) fn refused<T, E: std::error::Error>(
    result: Result<T, E>,
    words: &[&str],
) -> Result<(), Failure> {
    let error = match result {
        Ok(_) => return Err(Failure("was not refused".to_owned())),
        Err(error) => Failure::from(error).0,
    };
    for word in words {
        ensure!(error.contains(word), "the refusal does not say {word:?}: {error}");
    }
    Ok(())
}

/// That a quaternion has norm 1 and a real part of at least 0.
pub(in crate::doctor) fn check_quats(scene: &GaussianScene) -> Result<(), Failure> {
    for (row, quat) in scene.quat.iter().enumerate() {
        let norm: f64 = quat.iter().map(|&v| f64::from(v).powi(2)).sum();
        ensure!((norm - 1.0).abs() < 1e-6 && quat[0] >= 0.0, "quat of row {row} is {quat:?}");
    }
    Ok(())
}

/// Formats that the library writes as one file.
pub(in crate::doctor) fn files_of_scenes() -> impl Iterator<Item = SceneFormat> {
    let one_file = |row: &&FormatRow| row.is_writable() && ending(row).is_some();
    FORMATS.iter().filter(one_file).map(|row| row.format)
}

fn ending(row: &FormatRow) -> Option<&'static str> {
    row.endings.iter().find(|ending| ending.starts_with('.')).copied()
}

/// The name of a scene in a format.
pub(in crate::doctor) fn file_name(format: SceneFormat) -> String {
    format!("scene{}", ending(format.row()).unwrap_or_default())
}

/// Writes a scene by the library's writer and reads it back.
pub(in crate::doctor) fn through(
    trial: &Trial<'_>,
    scene: &GaussianScene,
    format: SceneFormat,
) -> Result<LoadedScene, Failure> {
    let path = trial.folder().join(file_name(format));
    write_scene(scene, &path, format, &WriteOptions::default(), &mut |_| true)?;
    Ok(open(&path, Policy::Repair)?)
}
