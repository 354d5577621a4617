//! PLY files with one float per property, as 3D Gaussian splatting trainers write them.

use super::color_columns::{color_names, read_colors};
use super::label_column::{read_instance, read_segment, segment_name};
use super::language_columns::{CODE_COLUMN, CODEBOOK, codebook_element, read_language_code};
use super::limit_tally::LimitTally;
use super::memory::zeroed;
use super::mip_filter::{FILTER, fuse};
use super::output_names::output_names;
use super::ply::{
    ANTIALIASED, ColumnSource, ColumnValues, Gather, PlyColumn, PlyElement, PlyFile, PlyNumbers,
    Remarks, warning_comment, write_new_ply,
};
use super::{LoadedScene, ReadOptions, SceneFormat, WriteOptions, WriteProgress, WriteReport};
use crate::gaussian_scene::u8_to_dc;
use crate::value_policy::{DEFAULT_GREY, DEFAULT_SCALE, FLAT_SCALE, Rule};
use crate::{AtomicFile, ExtraColumn, GaussianScene, RepairReport, SceneError};
use std::path::Path;

const VERTEX: &str = "vertex";
const SCALE: [&str; 3] = ["scale_0", "scale_1", "scale_2"];
const ROT: [&str; 4] = ["rot_0", "rot_1", "rot_2", "rot_3"];
const DC: [&str; 3] = ["f_dc_0", "f_dc_1", "f_dc_2"];
/// How sure the label is.
const SCORE: &str = "score";
/// Most columns that are written; no more are read.
const MAX_COLUMNS: usize = 1 << 14;

/// Reads a scene from an open PLY file.
///
/// Required are `x y z`; doubles far from 0 are kept relative to an origin. The others have defaults, each reported: `scale_0..2` (0.01 m; one scale
/// counts for all axes; without `scale_2` the third axis is 1e-7 m), `rot_0..3` (`w x y z`; no
/// rotation), `opacity` (alpha 1), `f_dc_0..2` (from `red green blue`, `r g b` or
/// `diffuse_red diffuse_green diffuse_blue`, in bytes, 16 bits or fractions, else gray). Read if there:
/// `f_rest_*` (all of one degree), `nx ny nz` (unless all are 0), `segment` or `label` with their
/// `score`, `instance`, and `lang_code_*` with the element `lang_codebook`. Other properties are
/// kept in `extra` if `options.extra` asks for them, else named. A `filter_3D` of Mip-Splatting becomes
/// part of sizes and opacities.
///
/// # Errors
/// As [`super::open_scene`]; a group of properties that is there in part is malformed.
pub fn read_inria_ply(file: &PlyFile, options: &ReadOptions) -> Result<LoadedScene, SceneError> {
    let Some(vertex) = file.element(VERTEX) else {
        return Err(SceneError::format(file.path(), "has no element vertex", ""));
    };
    let mut reader = Reader { file, vertex, report: RepairReport::default() };
    file.report_trailing(vertex.count, &mut reader.report);
    let rows = vertex.count;
    let mut scene = GaussianScene::default();
    // One pass over the rows fills every array of floats; fields without columns of their own are
    // filled on the side.
    let mut pass = Gather::new(file, VERTEX);
    let [x, y, z] = ["x", "y", "z"];
    if !reader.group(&[x, y, z])? {
        let problem = format!("is no scene: {}", Rule::CoordMissing.about().bad_value);
        return Err(SceneError::format(file.path(), problem, "vertices need a position"));
    }
    let path = file.path();
    match file.far_positions(VERTEX)? {
        Some((coord, origin)) => (scene.coord, scene.origin) = (coord, origin),
        None => reader.fill(&mut pass, &[x, y, z], &mut scene.coord)?,
    }
    scene.log_scale = match reader.odd_scale()? {
        Some(values) => values,
        None => zeroed(rows, path)?,
    };
    if reader.has_all(&SCALE) {
        pass.add(&SCALE, scene.log_scale.as_flattened_mut())?;
    }
    reader.fill_rotations(&mut pass, &mut scene.quat)?;
    reader.fill_opacities(&mut pass, &mut scene.opacity_logit)?;
    if reader.group(&DC)? {
        reader.fill(&mut pass, &DC, &mut scene.sh_dc)?;
    } else {
        scene.sh_dc = reader.dc_from_colors()?;
    }
    scene.sh_degree = reader.fill_rest(&mut pass, options.sh_rest, &mut scene.sh_rest)?;
    if reader.group(&["nx", "ny", "nz"])? {
        reader.fill(&mut pass, &["nx", "ny", "nz"], scene.normal.insert(Vec::new()))?;
    }
    // A score by itself may be that of a query, or anything.
    if vertex.has(SCORE) && segment_name(vertex, options.segment.as_deref()).is_some() {
        let score = scene.segment_score.insert(zeroed(rows, path)?);
        pass.add(&[SCORE], score)?;
    }
    pass.run()?;
    let remarks = reader.train_marks(&mut scene)?;
    let is_read = |name: &str| reader.is_read(name, options.segment.as_deref());
    let (extra, unread) = file.unknown(vertex, is_read, &[CODEBOOK], options.extra)?;
    scene.extra = extra;
    scene.segment = read_segment(file, vertex, options.segment.as_deref(), &mut reader.report)?;
    scene.instance = read_instance(file, vertex, &mut reader.report)?;
    scene.lang_code = read_language_code(file, vertex, &mut reader.report)?;
    let loaded =
        LoadedScene::finish(scene, reader.report, options.policy, file.path(), SceneFormat::Ply)?;
    Ok(LoadedScene { unread, ..loaded.with_remarks(&remarks) })
}

struct Reader<'a> {
    file: &'a PlyFile,
    vertex: &'a PlyElement,
    report: RepairReport,
}

impl Reader<'_> {
    /// Has `pass` fill a new array with these columns.
    fn fill<'p, const W: usize>(
        &self,
        pass: &mut Gather<'p>,
        names: &[&str; W],
        into: &'p mut Vec<[f32; W]>,
    ) -> Result<(), SceneError> {
        *into = zeroed(self.vertex.count, self.file.path())?;
        pass.add(names, into.as_flattened_mut())
    }

    fn fill_rotations<'p>(
        &mut self,
        pass: &mut Gather<'p>,
        into: &'p mut Vec<[f32; 4]>,
    ) -> Result<(), SceneError> {
        if self.group(&ROT)? {
            return self.fill(pass, &ROT, into);
        }
        self.missing(Rule::QuatMissing);
        *into = zeroed(self.vertex.count, self.file.path())?;
        into.fill([1.0, 0.0, 0.0, 0.0]);
        Ok(())
    }

    fn fill_opacities<'p>(
        &mut self,
        pass: &mut Gather<'p>,
        into: &'p mut Vec<f32>,
    ) -> Result<(), SceneError> {
        *into = zeroed(self.vertex.count, self.file.path())?;
        if self.vertex.has("opacity") {
            return pass.add(&["opacity"], into);
        }
        self.missing(Rule::OpacityMissing);
        into.fill(f32::INFINITY);
        Ok(())
    }

    /// Has `pass` fill the higher harmonics, if they are wanted; returns their degree.
    fn fill_rest<'p>(
        &mut self,
        pass: &mut Gather<'p>,
        wanted: bool,
        into: &'p mut Vec<f32>,
    ) -> Result<u8, SceneError> {
        let names = self.rest_columns(wanted)?;
        if names.is_empty() {
            return Ok(0);
        }
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        // The columns are there, so a row is at least as wide and the product fits.
        *into = zeroed(self.vertex.count * names.len(), self.file.path())?;
        pass.add(&names, into)?;
        Ok(sh_degree(names.len()).unwrap_or(0))
    }

    /// What the file says of how it was trained, and fuses the filter that goes with that.
    fn train_marks(&mut self, scene: &mut GaussianScene) -> Result<Remarks, SceneError> {
        let remarks = self.file.remarks(&mut self.report);
        scene.antialiased = remarks.antialiased.unwrap_or(false);
        if self.vertex.has(FILTER) {
            fuse(scene, &self.file.column_f32(VERTEX, FILTER)?);
            // Mip-Splatting always has the filter of the picture as well.
            scene.antialiased = remarks.antialiased.unwrap_or(true);
            let note = "the smoothing filter of Mip-Splatting (filter_3D) was made part of the sizes \
                        and opacities";
            self.report.notes.push(note.to_owned());
        }
        Ok(remarks)
    }

    /// Whether a column has a meaning here.
    fn is_read(&self, name: &str, segment: Option<&str>) -> bool {
        let vertex = self.vertex;
        let labels = segment_name(vertex, segment);
        let colors = color_names(vertex).filter(|_| !self.has_all(&DC)).unwrap_or_default();
        let of_labels = Some(name) == labels || (name == SCORE && labels.is_some());
        has_meaning(name) || of_labels || name == "instance" || colors.contains(&name)
    }

    fn missing(&mut self, rule: Rule) {
        self.report.add(rule, self.vertex.count, 0, "");
    }

    /// Whether all of the properties are there; an error if only some are.
    fn group(&self, names: &[&str]) -> Result<bool, SceneError> {
        let missing: Vec<&str> = names.iter().copied().filter(|n| !self.vertex.has(n)).collect();
        if missing.is_empty() || missing.len() == names.len() {
            return Ok(missing.is_empty());
        }
        let problem = format!("of {} its vertices lack {}", names.join(", "), missing.join(", "));
        Err(SceneError::format(self.file.path(), problem, "export the scene again"))
    }

    fn has_all(&self, names: &[&str]) -> bool {
        names.iter().all(|name| self.vertex.has(name))
    }

    /// Scales where there are not three of them; `None` where there are.
    fn odd_scale(&mut self) -> Result<Option<Vec<[f32; 3]>>, SceneError> {
        let [a, b, _] = SCALE;
        let there = SCALE.map(|name| self.vertex.has(name));
        Ok(Some(match there {
            [true, false, false] => {
                self.missing(Rule::ScaleOne);
                self.file.rows_f32(VERTEX, [a])?.into_iter().map(|[s]| [s; 3]).collect()
            }
            [true, true, false] => {
                self.missing(Rule::ScaleTwo);
                let flat = FLAT_SCALE.ln();
                self.file.rows_f32(VERTEX, [a, b])?.into_iter().map(|[s, t]| [s, t, flat]).collect()
            }
            _ if self.group(&SCALE)? => return Ok(None),
            _ => {
                self.missing(Rule::ScaleMissing);
                vec![[DEFAULT_SCALE.ln(); 3]; self.vertex.count]
            }
        }))
    }

    fn dc_from_colors(&mut self) -> Result<Vec<[f32; 3]>, SceneError> {
        let Some(colors) = read_colors(self.file, self.vertex, &mut self.report)? else {
            self.missing(Rule::ColorMissing);
            return Ok(vec![[u8_to_dc(DEFAULT_GREY); 3]; self.vertex.count]);
        };
        self.report.add(Rule::ColorFromBytes, self.vertex.count, 0, "");
        Ok(colors.dc())
    }

    /// The columns of the higher harmonics in the order of the scene; none for degree 0.
    fn rest_columns(&mut self, wanted: bool) -> Result<Vec<String>, SceneError> {
        let names = self.vertex.properties.iter().filter(|p| p.name.starts_with("f_rest_"));
        let count = names.count();
        let Some(degree) = sh_degree(count) else {
            let rule = Rule::RestCount.about().bad_value;
            let problem = format!("its vertices have {count} f_rest columns: {rule}");
            return Err(SceneError::format(self.file.path(), problem, "export the scene again"));
        };
        if degree == 0 || !wanted {
            return Ok(Vec::new());
        }
        let names = rest_names(count);
        self.group(&names.iter().map(String::as_str).collect::<Vec<_>>())?;
        Ok(names)
    }
}

/// Whether a column is taken for a part of the Gaussians by its name alone.
fn has_meaning(name: &str) -> bool {
    let fixed = ["x", "y", "z", "nx", "ny", "nz", "opacity", FILTER];
    let series = [CODE_COLUMN, "f_rest_"];
    [&fixed[..], &SCALE, &ROT, &DC].iter().any(|names| names.contains(&name))
        || series.iter().any(|prefix| name.starts_with(prefix))
}

/// The degree that has this many coefficients beyond DC for three channels.
pub(super) fn sh_degree(num_rest: usize) -> Option<u8> {
    [0, 9, 24, 45, 72].iter().position(|&n| n == num_rest).map(|degree| degree as u8)
}

/// The names of `f_rest` columns in the order of the scene: coefficient by coefficient, with the
/// channels inside. In the file each channel has its coefficients together.
pub(super) fn rest_names(num_rest: usize) -> Vec<String> {
    let k = num_rest / 3;
    (0..num_rest).map(|i| format!("f_rest_{}", i % 3 * k + i / 3)).collect()
}

/// Writes a scene as PLY in the property order of the original trainer.
///
/// `x y z nx ny nz f_dc_0..2 f_rest_* opacity scale_0..2 rot_0..3`, then `segment`, `score`,
/// `instance` and `lang_code_*` if the scene has them, its columns of unknown meaning, then `extra`; after the vertices the element
/// `lang_codebook` where there are codes. All floats are written as they are, so that reading gives
/// the same scene; a scene with an origin has it added to `x y z`, which are `double` then. Normals are 0 where the scene has none. Language features and labeled points
/// have no place in this format.
///
/// # Errors
/// If the scene is empty or its arrays do not match, if a name in `extra` is taken, or if the file
/// cannot be written; then nothing is left behind.
pub fn write_inria_ply(
    scene: &GaussianScene,
    extra: &[PlyColumn<'_>],
    path: &Path,
) -> Result<(), SceneError> {
    write_inria_ply_with(scene, extra, &WriteOptions::default(), path)
}

/// As [`write_inria_ply`], with the comments that the options ask for.
///
/// # Errors
/// As [`write_inria_ply`].
pub fn write_inria_ply_with(
    scene: &GaussianScene,
    extra: &[PlyColumn<'_>],
    options: &WriteOptions,
    path: &Path,
) -> Result<(), SceneError> {
    scene.check_rows()?;
    if scene.is_empty() {
        return Err(SceneError::format(path, "would hold no Gaussian at all", ""));
    }
    let file = AtomicFile::create(path)?;
    let mut report = WriteReport::new(SceneFormat::Ply, scene.len());
    write_columns(scene, extra, &file, options, &mut report, &mut |_| true)?;
    Ok(file.commit()?)
}

/// Writes a PLY file of floats.
pub(super) fn write_ply(
    scene: &GaussianScene,
    file: &AtomicFile,
    options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    write_columns(scene, &[], file, options, report, progress)
}

/// The comments of a PLY file: how it was trained, which way is up, and warnings.
pub(super) fn comments(scene: &GaussianScene, options: &WriteOptions) -> Vec<String> {
    let mark = scene.antialiased.then(|| ANTIALIASED.to_owned());
    let up = options.stated_up.map(|up| format!("Vertical axis: {up}"));
    let warnings = options.warnings.iter().map(|text| warning_comment(text));
    mark.into_iter().chain(up).chain(warnings).collect()
}

/// Columns of unknown meaning as PLY has them, with their names; says what became of them.
fn extra_numbers<'a>(
    scene: &'a GaussianScene,
    taken: &[(String, ColumnSource<'_>)],
    report: &mut WriteReport,
) -> Vec<(PlyNumbers<'a>, Vec<String>)> {
    let columns = taken.len() + scene.extra.iter().map(ExtraColumn::width).sum::<usize>();
    if columns > MAX_COLUMNS {
        report.left_out("extra", &format!("{columns} columns are more than a PLY file may have"));
        return Vec::new();
    }
    let labels = scene.segment.is_some();
    let is_taken = |name: &str| {
        has_meaning(name)
            || name.starts_with("packed_")
            || taken.iter().any(|(other, _)| other == name)
            || match name {
                "segment" | "instance" => true,
                "label" => !labels,
                SCORE => labels,
                _ => false,
            }
    };
    let allowed = |c: char| !c.is_whitespace() && !c.is_control();
    let (names, renamed) = output_names(&scene.extra, true, allowed, is_taken);
    renamed.iter().for_each(|text| report.left_out("extra", text));
    let mut numbers = Vec::new();
    for (column, names) in scene.extra.iter().zip(names) {
        let of = PlyNumbers::of(column);
        let (rows, first_row) = of.rounded;
        let tally = LimitTally { rows, first_row, largest_change: f64::NAN };
        report.limit(
            "extra",
            format!("column {}: integers above 2⁵³ are rounded", column.name),
            tally,
        );
        numbers.push((of, names));
    }
    numbers
}

fn write_columns(
    scene: &GaussianScene,
    extra: &[PlyColumn<'_>],
    file: &AtomicFile,
    options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let mut columns: Vec<(String, ColumnSource<'_>)> = Vec::new();
    columns.extend(positions(scene));
    match &scene.normal {
        Some(normal) => columns.extend(strided(&["nx", "ny", "nz"], normal.as_flattened())),
        None => columns.extend(["nx", "ny", "nz"].map(|n| (n.to_owned(), ColumnSource::Zero))),
    }
    columns.extend(strided(&DC, scene.sh_dc.as_flattened()));
    let width = scene.sh_rest_len() * 3;
    for i in 0..width {
        let k = width / 3;
        let at = i % k * 3 + i / k;
        let source = ColumnSource::Strided { values: &scene.sh_rest, width, at };
        columns.push((format!("f_rest_{i}"), source));
    }
    columns.extend(strided(&["opacity"], &scene.opacity_logit));
    columns.extend(strided(&SCALE, scene.log_scale.as_flattened()));
    columns.extend(strided(&ROT, scene.quat.as_flattened()));
    let whole = |values| ColumnSource::Values(ColumnValues::I32(values));
    if let Some(values) = &scene.segment {
        columns.push(("segment".to_owned(), whole(values)));
    }
    if let Some(values) = &scene.segment_score {
        columns.extend(strided(&[SCORE], values));
    }
    if let Some(values) = &scene.instance {
        columns.push(("instance".to_owned(), whole(values)));
    }
    let mut after = Vec::new();
    if let Some(code) = &scene.lang_code {
        let width = code.width();
        for at in 0..width {
            let source = ColumnSource::StridedHalf { values: &code.values, width, at };
            columns.push((format!("{CODE_COLUMN}{at}"), source));
        }
        after.push(codebook_element(&code.codebook));
    }
    columns.extend(extra.iter().map(|c| (c.name.to_owned(), ColumnSource::Values(c.values))));
    let unknown = extra_numbers(scene, &columns, report);
    columns.extend(unknown.iter().flat_map(|(numbers, names)| numbers.columns(names)));
    write_new_ply(file, &comments(scene, options), scene.len(), &columns, &after, progress)
}

/// The columns of the positions: doubles where f32 would not hold them.
fn positions(scene: &GaussianScene) -> Vec<(String, ColumnSource<'_>)> {
    let (names, values) = (["x", "y", "z"], scene.coord.as_flattened());
    if !scene.has_origin() {
        return strided(&names, values).collect();
    }
    let source = |at| ColumnSource::Placed { values, width: 3, at, add: scene.origin[at] };
    names.iter().enumerate().map(|(at, &name)| (name.to_owned(), source(at))).collect()
}

/// The columns of a row-major array.
fn strided<'a>(
    names: &[&str],
    values: &'a [f32],
) -> impl Iterator<Item = (String, ColumnSource<'a>)> + use<'a> {
    let width = names.len();
    let names: Vec<String> = names.iter().map(|&n| n.to_owned()).collect();
    let source = move |at| ColumnSource::Strided { values, width, at };
    names.into_iter().enumerate().map(move |(at, name)| (name, source(at)))
}
