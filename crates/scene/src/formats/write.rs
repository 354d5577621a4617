//! Writing a scene in any format, and saying what the format could not hold.

use super::limit_tally::{LimitTally, Limits};
use super::packed_values::check_storable;
use super::semantics::Sidecar;
use super::{SceneFormat, SpzFrame, Writer};
use crate::disk;
#[cfg(target_family = "wasm")]
use crate::disk::take;
use crate::place::origin_text;
use crate::{AtomicFile, GaussianScene, SceneError, Up};
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};

/// How to write.
#[derive(Debug, Clone, PartialEq)]
pub struct WriteOptions {
    /// Version of SPZ files: 2, 3 or 4.
    pub spz_version: u8,
    /// The frame of the numbers in SPZ files.
    pub spz_frame: SpzFrame,
    /// Levels of detail of streamed SOG scenes, 1 to 8; each has a quarter of the Gaussians of the one
    /// before.
    pub lod_levels: u8,
    /// Whether an existing scene may be replaced.
    pub overwrite: bool,
    /// The way up in the scene, where the file it came from says so itself; formats with comments say it
    /// again.
    pub stated_up: Option<Up>,
    /// What a reader must know of the values; formats with comments say it.
    pub warnings: Vec<String>,
}

impl Default for WriteOptions {
    fn default() -> Self {
        Self {
            spz_version: 4,
            spz_frame: SpzFrame::Rub,
            lod_levels: 4,
            overwrite: false,
            stated_up: None,
            warnings: Vec::new(),
        }
    }
}

/// Called with the fraction done, 0 to 1; gives `false` to stop, and then nothing is left behind.
pub type WriteProgress<'a> = &'a mut dyn FnMut(f64) -> bool;

/// Something that the format could not hold as it was.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PrecisionLimit {
    /// Which array of the scene.
    pub field: &'static str,
    /// What the format does to it.
    pub limit: String,
    /// Rows concerned.
    pub rows: usize,
    /// The first of them.
    pub first_row: usize,
    /// The largest change, in the unit of the field.
    pub largest_change: f64,
}

/// What became of a scene on the way to its file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WriteReport {
    /// The format.
    pub format: SceneFormat,
    /// Gaussians written.
    pub gaussians: usize,
    /// Size of everything written.
    pub bytes: u64,
    /// Files written; the scene first.
    pub files: Vec<PathBuf>,
    /// Values beyond what the format can hold, and arrays it has no place for. Rounding to the
    /// format's own steps is not listed.
    pub limits: Vec<PrecisionLimit>,
    /// Row of the scene that each written row came from, where the format needed another order.
    #[serde(skip)]
    pub order: Option<Vec<u32>>,
}

impl WriteReport {
    /// For a scene of which nothing was lost so far.
    pub(crate) fn new(format: SceneFormat, gaussians: usize) -> Self {
        Self { format, gaussians, bytes: 0, files: Vec::new(), limits: Vec::new(), order: None }
    }

    /// Notes a file that was written.
    pub(crate) fn wrote(&mut self, path: &Path) -> Result<(), SceneError> {
        self.bytes += disk::length(path).map_err(SceneError::io(path, "cannot read its size"))?;
        self.files.push(path.to_owned());
        Ok(())
    }

    /// Notes rows that the format changes beyond its rounding; nothing if there are none.
    pub(crate) fn limit(
        &mut self,
        field: &'static str,
        limit: impl Into<String>,
        tally: LimitTally,
    ) {
        if tally.rows > 0 {
            self.limits.push(PrecisionLimit {
                field,
                limit: limit.into(),
                rows: tally.rows,
                first_row: tally.first_row,
                largest_change: tally.largest_change,
            });
        }
    }

    /// Notes all limits of a table of fields and what becomes of them.
    pub(crate) fn limits<const N: usize>(
        &mut self,
        about: [(&'static str, &str); N],
        tallies: Limits<N>,
    ) {
        about
            .iter()
            .zip(tallies.0)
            .for_each(|((field, limit), tally)| self.limit(field, *limit, tally));
    }

    /// Adds what became of a part of the scene, whose rows are these of the whole.
    pub(crate) fn add_part(&mut self, part: &WriteReport, rows: &[u32]) {
        for limit in &part.limits {
            let first = rows.get(limit.first_row).map_or(0, |&row| row as usize);
            let known = self
                .limits
                .iter_mut()
                .find(|known| known.field == limit.field && known.limit == limit.limit);
            match known {
                Some(known) => {
                    known.rows += limit.rows;
                    known.first_row = known.first_row.min(first);
                    known.largest_change = known.largest_change.max(limit.largest_change);
                }
                None => self.limits.push(PrecisionLimit { first_row: first, ..limit.clone() }),
            }
        }
    }

    /// Notes an array that the format has no place for.
    pub(crate) fn left_out(&mut self, field: &'static str, why: &str) {
        let all = LimitTally { rows: self.gaussians, first_row: 0, largest_change: f64::NAN };
        self.limit(field, why, all);
    }
}

impl fmt::Display for WriteReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} Gaussians as {}, {} bytes", self.gaussians, self.format.name(), self.bytes)?;
        if self.order.is_some() {
            write!(f, ", in another order")?;
        }
        for limit in &self.limits {
            write!(
                f,
                "\n  {}: {} ({} rows, first {}",
                limit.field, limit.limit, limit.rows, limit.first_row
            )?;
            if limit.largest_change.is_finite() {
                write!(f, ", by up to {:.6}", limit.largest_change)?;
            }
            write!(f, ")")?;
        }
        Ok(())
    }
}

/// Writes a scene; the file appears under its name when it is complete.
///
/// Labels, scores, instances and language codes go along in every format: as columns of a PLY file,
/// as an extension record of an SPZ file, as primvars of USD, inside a SOG archive, else in a file beside the scene
/// (`NAME.labels.safetensors`) that [`open_scene`](super::open_scene) finds. Programs that do not
/// know them open the scene as before. Such a file of an earlier scene is removed if this one has
/// nothing of the kind.
///
/// A scene with an origin is written in the coordinates of its file by the formats that hold doubles
/// or an offset (PLY, `.glb`, USD, `.npy`); by the others relative to the origin, which the report says.
///
/// # Errors
/// If the scene is empty or its arrays do not match, if a position, size, rotation, opacity or color
/// is not a number, if there is a file already (of the scene or of its labels) and
/// `options.overwrite` is not set, if the format cannot hold the scene, if `progress` says stop, or
/// if the file cannot be written. Then nothing is left behind and an old file is as it was.
pub fn write_scene(
    scene: &GaussianScene,
    path: &Path,
    format: SceneFormat,
    options: &WriteOptions,
    progress: WriteProgress<'_>,
) -> Result<WriteReport, SceneError> {
    let Some(writer) = format.row().writer else {
        let problem = format!("cannot be written: {} is only read", format.name());
        let help = format!("what can be written: {}", SceneFormat::writable_endings());
        return Err(SceneError::format(path, problem, help));
    };
    scene.check_rows()?;
    if scene.is_empty() {
        return Err(SceneError::format(path, "would hold no Gaussian at all", ""));
    }
    if !options.overwrite && format != SceneFormat::NpyFolder && path.exists() {
        return Err(SceneError::format(
            path,
            "is there already",
            "overwrite it or choose another name",
        ));
    }
    check_storable(scene, path)?;
    if !progress(0.0) {
        return Err(SceneError::Stopped);
    }
    // The writers ask a last time when all is written, before the file gets its name.
    let mut report = WriteReport::new(format, scene.len());
    match writer {
        Writer::Files(write) => write(scene, path, options, &mut report, progress)?,
        Writer::File(write) => {
            let file = AtomicFile::create(path)?;
            write(scene, &file, options, &mut report, progress)?;
            file.commit()?;
            report.wrote(path)?;
        }
        Writer::Beside(write) => {
            let labels = Sidecar::prepare(scene, path, options.overwrite)?;
            let file = AtomicFile::create(path)?;
            write(scene, &file, options, &mut report, progress)?;
            let labels = labels.commit(scene, report.order.as_deref(), file)?;
            report.wrote(path)?;
            labels.iter().try_for_each(|labels| report.wrote(labels))?;
        }
    }
    note_origin(scene, &mut report);
    note_left_out(scene, &mut report);
    note_unsaid(scene, options, &mut report);
    progress(1.0);
    Ok(report)
}

/// As [`write_scene`], and gives the bytes of the file; for formats that are one file.
///
/// # Errors
/// As [`write_scene`].
#[cfg(target_family = "wasm")]
pub fn written_scene(
    scene: &GaussianScene,
    format: SceneFormat,
    options: &WriteOptions,
    progress: WriteProgress<'_>,
) -> Result<Vec<u8>, SceneError> {
    let path = Path::new("scene").with_extension(format.name());
    // What was not taken is of a run that ended before.
    let _ = take(&path);
    write_scene(scene, &path, format, options, progress)?;
    take(&path).ok_or_else(|| SceneError::format(&path, "was written as several files", ""))
}

/// Notes that the positions in the file are not those of a scene with an origin.
fn note_origin(scene: &GaussianScene, report: &mut WriteReport) {
    if !scene.has_origin() || report.format.row().keeps.origin {
        return;
    }
    let origin = origin_text(scene.origin);
    let limit = format!(
        "positions are about {origin}, further out than this format holds them: they were written \
         relative to that origin"
    );
    let far = scene.origin.iter().map(|v| v * v).sum::<f64>().sqrt();
    let all = LimitTally { rows: scene.len(), first_row: 0, largest_change: far };
    report.limit("coord", limit, all);
}

/// Notes columns of unknown meaning and marks that the format has no place for.
fn note_unsaid(scene: &GaussianScene, options: &WriteOptions, report: &mut WriteReport) {
    let row = report.format.row();
    if !scene.extra.is_empty() && !row.keeps.extra {
        let names: Vec<&str> = scene.extra.iter().map(|column| column.name.as_str()).collect();
        report.left_out("extra", &format!("no place in this format for {}", names.join(", ")));
    }
    if scene.antialiased && !row.keeps.antialiased {
        let why = "this format cannot say that the scene was trained for antialiased rendering";
        report.left_out("antialiased", why);
    }
    // What the format says of all its files need not be said again.
    let stated = options.stated_up.filter(|up| *up != report.format.stated_up().direction);
    if let Some(up) = stated.filter(|_| !row.keeps.up) {
        report
            .left_out("up", &format!("this format cannot say that {up} is up, as the source does"));
    }
}

/// Notes the arrays that no writer of the format takes.
fn note_left_out(scene: &GaussianScene, report: &mut WriteReport) {
    let keeps = report.format.row().keeps;
    if scene.sh_degree > 0 && !keeps.harmonics {
        report.left_out("sh_rest", "no place in this format");
    }
    if scene.lang_feat.is_some() && !keeps.features {
        let why = if scene.lang_code.is_some() {
            "no place in this format; the language codes stand for them"
        } else {
            "no place in this format; write language codes instead"
        };
        report.left_out("lang_feat", why);
    }
    if scene.labelled_points.is_some() && !keeps.features {
        report.left_out("labelled_points", "no place in this format");
    }
    if scene.normal.is_some() && !keeps.normals {
        report.left_out("normal", "no place in this format");
    }
}
