//! Every column, flag and comment with a meaning comes out of a conversion, or is named.

use crate::common::ply::{Encoding, inria_columns, ply_bytes, with_header};
use crate::common::{SplitMix, random_scene};
use scenesplat_scene::edit::{SampleSize, SceneEdit, merge};
use scenesplat_scene::formats::FORMATS;
use scenesplat_scene::{
    ExtraColumn, GaussianScene, LoadedScene, NumberType, ReadOptions, SceneFormat, StatedUp, Up,
    WriteOptions, WriteReport, open_scene, write_scene,
};
use std::path::Path;

const TYPES: [NumberType; 12] = [
    NumberType::Bool,
    NumberType::Int(1),
    NumberType::Int(2),
    NumberType::Int(4),
    NumberType::Int(8),
    NumberType::UInt(1),
    NumberType::UInt(2),
    NumberType::UInt(4),
    NumberType::UInt(8),
    NumberType::Float(2),
    NumberType::Float(4),
    NumberType::Float(8),
];
/// Harmless names, and those that mean something in one format or the other.
const NAMES: [&str; 16] = [
    "age",
    "class",
    "sem 1",
    "opacity",
    "scale",
    "scale_0",
    "f_rest_7",
    "segment",
    "segment20",
    "label",
    "score",
    "../out",
    "pc_coord",
    "lang_code_0",
    "packed_position",
    "Age",
];

fn keeping() -> ReadOptions {
    ReadOptions { extra: true, ..ReadOptions::default() }
}

/// Columns whose every number is a function of the row, so that a row out of step shows.
fn column(name: &str, ty: NumberType, row_shape: &[usize], rows: usize) -> ExtraColumn {
    let width: usize = row_shape.iter().product();
    let of = |at: usize| -> Vec<u8> {
        let v = at % 100;
        match ty {
            NumberType::Bool => vec![u8::from(v.is_multiple_of(3))],
            NumberType::Int(_) | NumberType::UInt(_) => v.to_le_bytes()[..ty.size()].to_vec(),
            NumberType::Float(2) => half::f16::from_f32(v as f32).to_le_bytes().to_vec(),
            NumberType::Float(4) => (v as f32 + 0.5).to_le_bytes().to_vec(),
            NumberType::Float(_) => (v as f64 + 0.1).to_le_bytes().to_vec(),
        }
    };
    let bytes = (0..rows * width).flat_map(of).collect();
    ExtraColumn { name: name.to_owned(), ty, row_shape: row_shape.to_vec(), bytes }
}

/// The numbers of a column, row by row, whatever their type.
fn numbers(column: &ExtraColumn) -> Vec<f64> {
    let of = |bytes: &[u8]| -> f64 {
        let mut le = [0; 8];
        le[..bytes.len()].copy_from_slice(bytes);
        let bits = u64::from_le_bytes(le);
        match column.ty {
            NumberType::Float(2) => half::f16::from_bits(bits as u16).to_f64(),
            NumberType::Float(4) => f64::from(f32::from_bits(bits as u32)),
            NumberType::Float(_) => f64::from_bits(bits),
            _ => bits as f64,
        }
    };
    column.bytes.chunks_exact(column.ty.size()).map(of).collect()
}

/// The numbers of what a column became: under its name or another, whole or split.
fn found(scene: &GaussianScene, name: &str, width: usize) -> Option<Vec<f64>> {
    let by_name = |name: &str| scene.extra.iter().find(|c| c.name == name).map(numbers);
    if let Some(whole) = by_name(name) {
        return Some(whole);
    }
    let parts: Option<Vec<_>> = (0..width).map(|i| by_name(&format!("{name}_{i}"))).collect();
    let parts = parts.filter(|parts| !parts.is_empty())?;
    Some((0..parts[0].len()).flat_map(|row| parts.iter().map(move |part| part[row])).collect())
}

fn limits_of<'a>(report: &'a WriteReport, field: &str) -> Vec<&'a str> {
    report.limits.iter().filter(|l| l.field == field).map(|l| l.limit.as_str()).collect()
}

/// Checks a conversion; gives how many things came out, and how many were named.
fn check(
    scene: &GaussianScene,
    options: &WriteOptions,
    back: &LoadedScene,
    report: &WriteReport,
) -> (usize, usize) {
    let (mut out, mut named) = (0, 0);
    let mut count = |came: bool, text: &[&str], what: &str| {
        assert!(came == text.is_empty(), "{}: {what}: {came}, {text:?}", report.format.name());
        out += usize::from(came);
        named += usize::from(!came);
    };
    let texts = limits_of(report, "extra");
    let lost = texts.iter().find_map(|t| t.strip_prefix("no place in this format for "));
    for column in &scene.extra {
        let renamed = texts.iter().find_map(|text| {
            let rest = text.strip_prefix(&format!("column {} is called ", column.name))?;
            rest.strip_suffix(" in the file")
        });
        let there = found(&back.scene, renamed.unwrap_or(&column.name), column.width());
        let lost = lost.filter(|names| names.split(", ").any(|name| name == column.name));
        if let Some(there) = &there {
            assert_eq!(*there, numbers(column), "{}: {}", report.format.name(), column.name);
        }
        count(there.is_some(), lost.as_slice(), &column.name);
    }
    if scene.antialiased {
        count(back.scene.antialiased, &limits_of(report, "antialiased"), "antialiased");
    } else {
        assert!(!back.scene.antialiased);
    }
    if let Some(up) = options.stated_up {
        count(back.stated_up.direction == up, &limits_of(report, "up"), "up");
    }
    (out, named)
}

/// A scene with columns of any type and name.
fn scene_with_columns(rng: &mut SplitMix) -> GaussianScene {
    let rows = 1 + rng.below(40);
    let mut scene = random_scene(rows, 0, rng.next());
    if rng.below(2) == 0 {
        scene.segment = Some((0..rows as i32).collect());
    }
    scene.antialiased = rng.below(2) == 0;
    let first = rng.below(NAMES.len());
    for i in 0..rng.below(6) {
        let name = NAMES[(first + i) % NAMES.len()];
        let shape: &[usize] = [&[][..], &[], &[3], &[2, 2], &[1]][rng.below(5)];
        scene.extra.push(column(name, TYPES[rng.below(TYPES.len())], shape, rows));
    }
    scene
}

#[test]
fn all_comes_out_of_every_format_or_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut rng = SplitMix(48);
    let (mut conversions, mut out, mut named) = (0, 0, 0);
    for case in 0..40 {
        let scene = scene_with_columns(&mut rng);
        let stated_up = [None, Some(Up::PLUS_Z), Some(Up::MINUS_Y)][rng.below(3)];
        let options = WriteOptions { stated_up, ..WriteOptions::default() };
        for row in FORMATS.iter().filter(|row| row.is_writable()) {
            let ending = row.endings.first().copied().unwrap_or("");
            let dot = if ending.starts_with('.') { "scene" } else { "" };
            let path = folder.path().join(format!("{case}_{}/{dot}{ending}", row.name));
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            let report = write_scene(&scene, &path, row.format, &options, &mut |_| true).unwrap();
            let back = open_scene(&path, &keeping()).unwrap();
            let (a, b) = check(&scene, &options, &back, &report);
            (conversions, out, named) = (conversions + 1, out + a, named + b);
        }
    }
    println!("{conversions} conversions: {out} came out, {named} were named");
    assert!(out > 400 && named > 400, "{out} came out, {named} were named");
}

/// What is read of a file, kept of it, and named of it is all of it.
#[test]
fn every_column_of_a_file_is_read_kept_or_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    let scene = random_scene(5, 0, 3);
    let mut columns = inria_columns(&scene);
    let read = columns.len();
    for name in ["class", "filter", "red", "time", "sem_score"] {
        columns.push((name.to_owned(), (0..5).map(|i| i as f32).collect()));
    }
    for encoding in [Encoding::Ascii, Encoding::Little, Encoding::Big] {
        std::fs::write(&path, ply_bytes(&columns, encoding, "\n")).unwrap();
        let named = open_scene(&path, &ReadOptions::default()).unwrap();
        let names: Vec<&str> = named.unread.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["class", "filter", "red", "time", "sem_score"]);
        let labels: Vec<bool> = named.unread.iter().map(|c| c.may_be_labels).collect();
        assert_eq!(labels, [true, false, false, false, false]);
        let kept = open_scene(&path, &keeping()).unwrap();
        assert!(kept.unread.is_empty());
        assert_eq!(kept.scene.extra.len() + read, columns.len());
        assert_eq!(numbers(&kept.scene.extra[3]), [0.0, 1.0, 2.0, 3.0, 4.0], "{encoding:?}");
        // The labels that were chosen have been read.
        let segment = Some("class".to_owned());
        let chosen = open_scene(&path, &ReadOptions { segment, ..keeping() }).unwrap();
        assert_eq!(chosen.scene.segment, Some(vec![0, 1, 2, 3, 4]));
        assert_eq!(chosen.scene.extra.len(), 4);
    }
    let segment = Some("klass".to_owned());
    let wrong = open_scene(&path, &ReadOptions { segment, ..keeping() }).unwrap_err().to_string();
    assert!(wrong.contains("klass") && wrong.contains("look like labels: class"), "{wrong}");
    let bytes = ply_bytes(&columns, Encoding::Little, "\n");
    let mesh = "element face 0\nproperty list uchar int vertex_indices\nend_header\n";
    std::fs::write(&path, with_header(&bytes, "end_header\n", mesh)).unwrap();
    let loaded = open_scene(&path, &keeping()).unwrap();
    assert_eq!((loaded.unread.len(), loaded.unread[0].name.as_str()), (1, "face"));
}

/// Rows that are cut, sorted and merged take their columns with them.
#[test]
fn columns_follow_their_rows() {
    let folder = tempfile::tempdir().unwrap();
    let mark = |scene: &GaussianScene| -> Vec<u8> {
        scene.coord.iter().flat_map(|p| p[0].to_le_bytes()).collect()
    };
    let marked = |rows, seed| {
        let mut scene = random_scene(rows, 0, seed);
        let (name, ty, bytes) = ("mark".to_owned(), NumberType::Float(4), mark(&scene));
        scene.extra.push(ExtraColumn { name, ty, row_shape: Vec::new(), bytes });
        scene
    };
    let mut broken = marked(300, 1);
    // Left out on reading.
    broken.opacity_logit[7] = f32::NAN;
    broken.coord[9][1] = f32::NAN;
    let path = folder.path().join("broken.ply");
    let columns = inria_columns(&broken);
    let with = [columns, vec![("mark".to_owned(), broken.coord.iter().map(|p| p[0]).collect())]];
    std::fs::write(&path, ply_bytes(&with.concat(), Encoding::Big, "\n")).unwrap();
    let read = open_scene(&path, &keeping()).unwrap().scene;
    assert_eq!((read.len(), &read.extra[0].bytes), (298, &mark(&read)));

    let (joined, _) = merge(vec![read, marked(50, 2)]).unwrap();
    assert_eq!(joined.extra[0].bytes, mark(&joined));
    let edit = SceneEdit { sample: Some(SampleSize::Count(77)), seed: 5, ..SceneEdit::default() };
    let (sampled, _) = edit.apply(joined).unwrap();
    assert_eq!((sampled.len(), &sampled.extra[0].bytes), (77, &mark(&sampled)));
    for (format, name) in [(SceneFormat::Ply, "out.ply"), (SceneFormat::NpyFolder, "out")] {
        let path = folder.path().join(name);
        write_scene(&sampled, &path, format, &WriteOptions::default(), &mut |_| true).unwrap();
        let back = open_scene(&path, &keeping()).unwrap().scene;
        assert_eq!(back.extra[0].bytes, mark(&back), "{name}");
    }
}

fn with_comment(path: &Path, columns: &[(String, Vec<f32>)], comment: &str) {
    let bytes = ply_bytes(columns, Encoding::Little, "\n");
    let comment = format!("comment {comment}\n");
    std::fs::write(path, with_header(&bytes, "comment made by a test\n", &comment)).unwrap();
}

#[test]
fn comments_on_antialiasing_are_understood() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    let columns = inria_columns(&random_scene(4, 0, 9));
    for (comment, due) in [
        ("SplatRenderMode: mip", true),
        ("  SPLATRENDERMODE:  MIP ", true),
        ("SplatRenderMode: default", false),
        ("SplatRenderMode: 2dgs", false),
        ("antialiased 1", true),
        ("antialiased 0", false),
        ("train_flags antialiasing", true),
        ("train_flags exposure", false),
        ("Exported from Brush", false),
        ("not antialiased 1", false),
        ("antialiased 1\ncomment SplatRenderMode: default", false),
        ("antialiased 0\ncomment SplatRenderMode: mip", true),
    ] {
        with_comment(&path, &columns, comment);
        let loaded = open_scene(&path, &ReadOptions::default()).unwrap();
        assert_eq!(loaded.scene.antialiased, due, "{comment}");
        let notes = loaded.report.notes.join("; ");
        assert_eq!(notes.contains("antialiased rendering"), due, "{comment}: {notes}");
        assert_eq!(notes.contains("2dgs"), comment.contains("2dgs"));
    }
}

#[test]
fn an_axis_in_a_comment_is_understood() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    let columns = inria_columns(&random_scene(4, 0, 9));
    for (comment, due) in
        [("Vertical axis: z", "+z"), ("Vertical Axis: -y", "-y"), ("Vertical axis: 0 -1 0", "-y")]
    {
        with_comment(&path, &columns, comment);
        let loaded = open_scene(&path, &ReadOptions::default()).unwrap();
        assert_eq!(loaded.stated_up.direction.to_string(), due);
        assert_eq!(loaded.stated_up.source, StatedUp::COMMENT);
    }
}

/// The filter becomes part of the Gaussians once: what is written has no column of it.
#[test]
fn the_filter_of_mip_splatting_is_fused() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("scene.ply"), folder.path().join("out.ply"));
    let scene = random_scene(20, 0, 4);
    let mut columns = inria_columns(&scene);
    columns.push(("filter_3D".to_owned(), vec![0.1; 20]));
    std::fs::write(&path, ply_bytes(&columns, Encoding::Little, "\n")).unwrap();
    let loaded = open_scene(&path, &keeping()).unwrap();
    assert!(loaded.scene.antialiased && loaded.scene.extra.is_empty());
    assert!(loaded.report.notes.iter().any(|n| n.contains("filter_3D")));
    for row in 0..20 {
        let (before, after) = (scene.scale(row), loaded.scene.scale(row));
        let mut share = 1.0;
        for i in 0..3 {
            let due = (before[i] * before[i] + 0.01).sqrt();
            assert!((after[i] / due - 1.0).abs() < 1e-5, "{} instead of {due}", after[i]);
            share *= before[i] / due;
        }
        let due = scene.opacity(row) * share;
        assert!((loaded.scene.opacity(row) / due - 1.0).abs() < 1e-4);
    }
    let options = WriteOptions::default();
    write_scene(&loaded.scene, &out, SceneFormat::Ply, &options, &mut |_| true).unwrap();
    assert_eq!(open_scene(&out, &keeping()).unwrap().scene, loaded.scene);
}

/// Columns of an earlier scene in a folder would be read as those of the new one.
#[test]
fn an_old_column_in_a_folder_is_not_taken_for_a_new_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room");
    let mut scene = random_scene(6, 0, 1);
    scene.extra.push(column("age", NumberType::Int(4), &[], 6));
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    let write = |scene: &GaussianScene| {
        write_scene(scene, &path, SceneFormat::NpyFolder, &options, &mut |_| true)
    };
    write(&scene).unwrap();
    // Replaced.
    write(&scene).unwrap();
    let error = write(&random_scene(6, 0, 2)).unwrap_err().to_string();
    assert!(error.contains("age.npy") && error.contains("move them away"), "{error}");
    // With other rows it is no column, and stays.
    write(&random_scene(7, 0, 2)).unwrap();
    let loaded = open_scene(&path, &keeping()).unwrap();
    assert!(loaded.scene.extra.is_empty());
    assert_eq!(loaded.unread.len(), 1);
    assert!(loaded.unread[0].kind.contains("not of 7 rows"), "{:?}", loaded.unread);
}
