//! Labels of a scan onto the Gaussians of its scene.

use super::{LabelTable, ScanPoints, UprightBox};
use crate::DataError;
use crate::error::check_length;
use crate::from_points::tree;
use scenesplat_scene::formats::npy_folder::write_npy_folder;
use scenesplat_scene::formats::npy_writer::write_npy;
use scenesplat_scene::{GaussianScene, LabelledPoints, SceneError, WholeFolder};
use std::collections::BTreeMap;
use std::path::Path;

/// How labels get onto Gaussians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrepareSettings {
    /// A Gaussian whose nearest point is farther than this has no label, meters; `None`: it takes the label however
    /// far, as the original does.
    pub max_distance: Option<f64>,
    /// Gaussians outside of the upright box around the scan, each side longer by this, are dropped, meters; `None`
    /// keeps all.
    pub margin: Option<f64>,
    /// Whether the labeled points themselves are written (`pc_*`), to evaluate on.
    pub points: bool,
}

impl Default for PrepareSettings {
    /// Labels from within 0.25 m; the box with 0.5 m; points.
    fn default() -> Self {
        Self { max_distance: Some(0.25), margin: Some(0.5), points: true }
    }
}

/// Class numbers of one file of labels.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentColumn {
    /// Stem of the file.
    pub stem: String,
    /// Of the Gaussians that are kept. `[N]`
    pub gaussians: Vec<i32>,
    /// Of the points of the scan. `[M]`
    pub points: Vec<i32>,
}

/// A scene ready for training.
#[derive(Debug, Clone, PartialEq)]
pub struct PreparedScene {
    /// The Gaussians that are kept, with instance and normal of their nearest points, and the points.
    pub scene: GaussianScene,
    /// Rows of the scene before. `[N]`
    pub kept: Vec<usize>,
    /// The files of labels.
    pub segments: Vec<SegmentColumn>,
}

/// What came of it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PrepareReport {
    /// Gaussians before.
    pub gaussians: usize,
    /// Gaussians outside of the box.
    pub outside: usize,
    /// Gaussians that are kept and farther from any point than the limit.
    pub too_far: usize,
    /// Gaussians with a label, of each file.
    pub labelled: Vec<(String, usize)>,
    /// Names that are no class in any of the tables, with their numbers of points, the most frequent first.
    pub unknown: Vec<(String, usize)>,
}

/// Gives each Gaussian the labels of the nearest point of a scan; of equally near ones of the first.
///
/// # Errors
/// If arrays have different lengths, positions are not finite, or no Gaussian is inside the box.
pub fn prepare(
    scene: &GaussianScene,
    scan: &ScanPoints,
    tables: &[LabelTable],
    settings: &PrepareSettings,
) -> Result<(PreparedScene, PrepareReport), DataError> {
    check_length("raw labels", scan.coord.len(), scan.raw.len())?;
    check_length("instances", scan.coord.len(), scan.instance.len())?;
    let mut report = PrepareReport { gaussians: scene.len(), ..PrepareReport::default() };
    let kept = inside(scene, scan, settings)?;
    report.outside = scene.len() - kept.len();
    let mut out = scene.select_rows(&kept)?;
    let tree = tree(&scan.coord)?;
    let limit = settings.max_distance.map_or(f64::INFINITY, |d| d * d);
    let nearest: Vec<Option<u32>> = tree.map_nearest(
        &out.coord,
        1,
        || (),
        |(), _, near| near.first().filter(|n| n.distance_squared <= limit).map(|n| n.row),
    );
    report.too_far = nearest.iter().filter(|n| n.is_none()).count();
    let of = |values: &[i32]| -> Vec<i32> {
        nearest.iter().map(|n| n.map_or(-1, |row| values[row as usize])).collect()
    };
    let mut segments = Vec::with_capacity(tables.len());
    let mut known = vec![false; scan.names.len()];
    for table in tables {
        let classes: Vec<i32> = scan.names.iter().map(|name| table.class_of(name)).collect();
        for (known, class) in known.iter_mut().zip(&classes) {
            *known |= *class >= 0;
        }
        let class = |raw: &i32| usize::try_from(*raw).map_or(-1, |raw| classes[raw]);
        let points: Vec<i32> = scan.raw.iter().map(class).collect();
        let gaussians = of(&points);
        let labelled = gaussians.iter().filter(|v| **v >= 0).count();
        report.labelled.push((table.stem.clone(), labelled));
        segments.push(SegmentColumn { stem: table.stem.clone(), gaussians, points });
    }
    report.unknown = unknown(scan, &known);
    out.segment = None;
    out.instance = Some(of(&scan.instance));
    if let Some(normal) = &scan.normal {
        let of = |n: &Option<u32>| n.map_or([0.0; 3], |row| normal[row as usize]);
        out.normal = Some(nearest.iter().map(of).collect());
    }
    out.labelled_points = settings.points.then(|| LabelledPoints {
        coord: scan.coord.clone(),
        segment: None,
        instance: Some(scan.instance.clone()),
    });
    Ok((PreparedScene { scene: out, kept, segments }, report))
}

/// Rows inside the box of the scan.
fn inside(
    scene: &GaussianScene,
    scan: &ScanPoints,
    settings: &PrepareSettings,
) -> Result<Vec<usize>, DataError> {
    let Some(margin) = settings.margin else { return Ok((0..scene.len()).collect()) };
    let around = UprightBox::around(&scan.coord).map(|b| b.grown(margin));
    let is_inside = |row: &usize| around.is_some_and(|b| b.contains(scene.coord[*row]));
    let kept: Vec<usize> = (0..scene.len()).filter(is_inside).collect();
    if kept.is_empty() {
        let count = scene.len();
        let problem = format!("none of the {count} Gaussians is inside the box around the scan");
        let help = "both have to be in one frame and in meters".to_owned();
        return Err(SceneError::Classes { problem, help }.into());
    }
    Ok(kept)
}

fn unknown(scan: &ScanPoints, known: &[bool]) -> Vec<(String, usize)> {
    let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
    for raw in scan.raw.iter().filter_map(|raw| usize::try_from(*raw).ok()) {
        if !known[raw] {
            *counts.entry(raw).or_default() += 1;
        }
    }
    let mut out: Vec<(String, usize)> =
        counts.into_iter().map(|(raw, count)| (scan.names[raw].clone(), count)).collect();
    out.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)));
    out
}

impl PreparedScene {
    /// Writes the folder that training reads; it appears as a whole, in the place of one that is there.
    ///
    /// # Errors
    /// If it cannot be written; then everything is as it was.
    pub fn write(&self, folder: &Path) -> Result<(), DataError> {
        let whole = WholeFolder::create(folder).map_err(SceneError::from)?;
        let waiting = whole.waiting();
        write_npy_folder(&self.scene, waiting, false)?;
        for column in &self.segments {
            let write = |prefix: &str, rows: &[i32]| {
                let path = waiting.join(format!("{prefix}{}.npy", column.stem));
                write_npy(&path, &[rows.len()], rows)
            };
            write("", &column.gaussians)?;
            if self.scene.labelled_points.is_some() {
                write("pc_", &column.points)?;
            }
        }
        whole.commit().map_err(SceneError::from)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use scenesplat_scene::formats::npy::NpyFile;

    fn scene(coord: Vec<[f32; 3]>) -> GaussianScene {
        let n = coord.len();
        GaussianScene {
            log_scale: vec![[-3.0; 3]; n],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logit: vec![1.0; n],
            sh_dc: vec![[0.1; 3]; n],
            coord,
            ..GaussianScene::default()
        }
    }

    fn scan() -> ScanPoints {
        ScanPoints {
            coord: vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 1.0]],
            normal: Some(vec![[0.0, 0.0, 1.0]; 4]),
            raw: vec![0, 1, 2, -1],
            names: ["sofa", "lamp", "odd"].map(str::to_owned).to_vec(),
            instance: vec![5, 6, 7, -1],
        }
    }

    #[test]
    fn gaussians_take_what_is_nearest_and_near_enough() {
        let coord = vec![
            [0.1, 0.0, 0.0],
            [0.9, 0.1, 0.0],
            [0.5, 0.5, 0.5],
            [9.0, 0.0, 0.0],
            [0.0, 1.1, 1.0],
            [1.0, 1.05, 0.0],
        ];
        let table = LabelTable::of_names("segment", vec!["lamp".to_owned(), "sofa".to_owned()]);
        let settings = PrepareSettings::default();
        let (found, report) = prepare(&scene(coord), &scan(), &[table], &settings).unwrap();
        assert_eq!(found.kept, [0, 1, 2, 4, 5]);
        assert_eq!(found.segments[0].gaussians, [1, 0, -1, -1, -1]);
        assert_eq!(found.segments[0].points, [1, 0, -1, -1]);
        assert_eq!(found.scene.instance, Some(vec![5, 6, -1, -1, 7]));
        assert_eq!(found.scene.normal.as_ref().unwrap()[2], [0.0; 3]);
        assert_eq!((report.gaussians, report.outside, report.too_far), (6, 1, 1));
        assert_eq!(report.labelled, [("segment".to_owned(), 2)]);
        assert_eq!(report.unknown, [("odd".to_owned(), 1)]);
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("train/a");
        found.write(&folder).unwrap();
        let shape = |name: &str| NpyFile::open(&folder.join(name)).unwrap().shape().to_vec();
        assert_eq!((shape("coord.npy"), shape("segment.npy")), (vec![5, 3], vec![5]));
        assert_eq!((shape("pc_coord.npy"), shape("pc_segment.npy")), (vec![4, 3], vec![4]));
        assert_eq!((shape("pc_instance.npy"), shape("normal.npy")), (vec![4], vec![5, 3]));
    }

    #[test]
    fn without_limits_it_is_what_the_original_does() {
        let coord = vec![[0.5, 0.4, 0.0], [9.0, 0.0, 0.0]];
        let table = LabelTable::of_names("segment", vec!["lamp".to_owned(), "sofa".to_owned()]);
        let settings = PrepareSettings { max_distance: None, margin: None, points: false };
        let (found, report) =
            prepare(&scene(coord), &scan(), std::slice::from_ref(&table), &settings).unwrap();
        // Of equally near ones the first.
        assert_eq!(found.segments[0].gaussians, [1, 0]);
        assert_eq!(
            (report.outside, report.too_far, found.scene.labelled_points.is_some()),
            (0, 0, false)
        );
        let far = scene(vec![[90.0, 0.0, 0.0]]);
        let error = prepare(&far, &scan(), &[table], &PrepareSettings::default()).unwrap_err();
        assert!(error.to_string().contains("none of the 1 Gaussians"), "{error}");
    }

    #[test]
    fn labels_are_the_scans_alone_and_from_within_the_limit() {
        // 0.4 m from the lamp, which is more than 0.25 m; 0.2 m from it; and labels that came with the scene.
        let mut given = scene(vec![[0.6, 0.0, 0.0], [0.8, 0.0, 0.0]]);
        given.segment = Some(vec![3, 3]);
        let names = |list: &[&str]| list.iter().map(|n| (*n).to_owned()).collect();
        // What one of several tables knows is known, whichever comes last.
        let tables = [
            LabelTable::of_names("segment", names(&["odd", "lamp"])),
            LabelTable::of_names("segment20", names(&["sofa"])),
        ];
        let (found, report) =
            prepare(&given, &scan(), &tables, &PrepareSettings::default()).unwrap();
        assert_eq!(found.segments[0].gaussians, [-1, 1]);
        assert_eq!((found.scene.segment, report.too_far), (None, 1));
        assert_eq!(report.unknown, []);
        // Gaussians count, not the two points and the one that have such names.
        let labelled = [("segment".to_owned(), 1), ("segment20".to_owned(), 0)];
        assert_eq!(report.labelled, labelled);
    }

    #[test]
    fn what_is_written_and_reported_is_of_each_table_and_each_point() {
        let defaults =
            PrepareSettings { max_distance: Some(0.25), margin: Some(0.5), points: true };
        assert_eq!(PrepareSettings::default(), defaults);
        let normals = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.6, 0.8]];
        let raw = vec![2, 1, 2, 0];
        let names = ["b", "sofa", "a"].map(str::to_owned).to_vec();
        let scan = ScanPoints { normal: Some(normals.to_vec()), raw, names, ..scan() };
        // Above the box by 0.25, which is on its border; below it by more; the third takes the last point.
        let given = scene(vec![[1.0, 0.0, 0.25], [1.0, 0.0, -0.26], [0.0, 1.0, 1.1]]);
        let table = |stem: &str, list: &[&str]| {
            LabelTable::of_names(stem, list.iter().map(|n| (*n).to_owned()).collect())
        };
        let tables = [table("segment", &["x", "sofa"]), table("segment9", &["sofa"])];
        let (found, report) = prepare(&given, &scan, &tables, &defaults).unwrap();
        assert_eq!(found.kept, [0, 2]);
        let columns: Vec<_> = (found.segments.iter())
            .map(|c| (c.stem.as_str(), c.gaussians.clone(), c.points.clone()))
            .collect();
        let first = ("segment", vec![1, -1], vec![-1, 1, -1, -1]);
        assert_eq!(columns, [first, ("segment9", vec![0, -1], vec![-1, 0, -1, -1])]);
        assert_eq!(found.scene.normal, Some(vec![normals[1], normals[3]]));
        assert_eq!(found.scene.instance, Some(vec![6, -1]));
        let points = found.scene.labelled_points.as_ref().unwrap();
        assert_eq!((&points.coord, &points.instance), (&scan.coord, &Some(vec![5, 6, 7, -1])));
        assert_eq!((report.gaussians, report.outside, report.too_far), (3, 1, 0));
        assert_eq!(report.labelled, [("segment".to_owned(), 1), ("segment9".to_owned(), 1)]);
        // The most frequent first.
        assert_eq!(report.unknown, [("a".to_owned(), 2), ("b".to_owned(), 1)]);
        let once = ScanPoints { raw: vec![0, 1, 2, -1], ..scan.clone() };
        let (_, report) = prepare(&given, &once, &tables, &defaults).unwrap();
        assert_eq!(report.unknown, [("a".to_owned(), 1), ("b".to_owned(), 1)], "then by name");
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("a");
        let read = |name: &str| {
            let file = NpyFile::open(&folder.join(name)).unwrap();
            file.read_i64().unwrap()
        };
        for points in [true, false] {
            let settings = PrepareSettings { points, ..defaults };
            prepare(&given, &scan, &tables, &settings).unwrap().0.write(&folder).unwrap();
            assert_eq!((read("segment.npy"), read("segment9.npy")), (vec![1, -1], vec![0, -1]));
            assert_eq!(folder.join("pc_segment9.npy").exists(), points);
            if points {
                assert_eq!(read("pc_segment9.npy"), [-1, 0, -1, -1]);
                assert_eq!(read("pc_instance.npy"), [5, 6, 7, -1]);
            }
        }
        // Exactly as far as the limit is near enough; without normals there are none.
        let bare = ScanPoints { normal: None, ..scan.clone() };
        let edge = scene(vec![[1.25, 0.0, 0.0], [1.251, 0.0, 0.0]]);
        let (found, report) =
            prepare(&edge, &bare, &tables, &PrepareSettings { margin: None, ..defaults }).unwrap();
        assert_eq!((found.scene.instance, found.scene.normal), (Some(vec![6, -1]), None));
        assert_eq!((report.too_far, report.outside), (1, 0));
        for (short, what) in [
            (ScanPoints { raw: vec![0; 3], ..scan.clone() }, "raw labels"),
            (ScanPoints { instance: vec![0; 5], ..scan }, "instances"),
        ] {
            let error = prepare(&edge, &short, &tables, &defaults).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
    }
}
