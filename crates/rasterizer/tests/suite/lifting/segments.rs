//! Folders of segments: both layouts, and what is wrong with them.

use half::f16;
use scenesplat_rasterizer::lifting::NO_SEGMENT;
use scenesplat_rasterizer::segments::{SegmentFolder, SegmentLayout, SegmentOptions};
use scenesplat_scene::formats::npy_writer::{NpyElement, write_npy};
use scenesplat_scene::picture::{Channels, Picture, RgbPicture, Samples};
use std::path::Path;
use tempfile::TempDir;

/// What to do to a folder, and what the error has to say.
type Case<'a> = (&'a dyn Fn(&Path), &'a [&'a str]);

const W: u32 = 6;
const H: u32 = 4;

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn npy<T: NpyElement>(dir: &Path, name: &str, shape: &[usize], values: &[T]) {
    write_npy(&dir.join(name), shape, values).unwrap();
}

fn gray_png(path: &Path, samples: Samples) {
    let picture = Picture::new(W, H, Channels::Gray, samples).unwrap();
    std::fs::write(path, picture.encode_png().unwrap()).unwrap();
}

fn options(levels: &[usize]) -> SegmentOptions {
    SegmentOptions { levels: levels.to_vec(), ..SegmentOptions::default() }
}

/// Ids of four granularities, −1 in the first pixel of each.
fn four_levels() -> Vec<i64> {
    let pixels = i64::from(W * H);
    let id = |level: i64, i: i64| if i == 0 { -1 } else { (i + level) % 3 + level };
    (0..4).flat_map(|level| (0..pixels).map(move |i| id(level, i))).collect()
}

#[test]
fn maps_of_any_number_type() {
    let dir = folder();
    let shape = [4, H as usize, W as usize];
    let ids = four_levels();
    npy(dir.path(), "a_s.npy", &shape, &ids.iter().map(|&v| v as i32).collect::<Vec<_>>());
    npy(dir.path(), "b_s.npy", &shape, &ids.iter().map(|&v| v as f32).collect::<Vec<_>>());
    npy(
        dir.path(),
        "c_s.npy",
        &shape[1..],
        &ids[..24].iter().map(|&v| v as i16).collect::<Vec<_>>(),
    );
    let features: Vec<f32> = (0..12).map(|v| v as f32 / 8.0).collect();
    npy(dir.path(), "a_f.npy", &[6, 2], &features);
    npy(
        dir.path(),
        "b_f.npy",
        &[6, 2],
        &features.iter().map(|v| f16::from_f32(*v)).collect::<Vec<_>>(),
    );
    npy(
        dir.path(),
        "c_f.npy",
        &[6, 2],
        &features.iter().map(|v| f64::from(*v)).collect::<Vec<_>>(),
    );
    let open = SegmentFolder::open(dir.path(), options(&[2, 0])).unwrap();
    assert_eq!((open.layout(), open.len(), open.name(1)), (SegmentLayout::Npy, 3, "b".to_owned()));
    let [a, b] = [0, 1].map(|frame| open.read(frame, W, H).unwrap());
    assert_eq!(a, b);
    assert_eq!((a.dim, &a.features), (2, &features));
    assert_eq!(a.levels[1].ids()[..4], [NO_SEGMENT, 1, 2, 0]);
    assert_eq!(a.levels[0].ids()[..4], [NO_SEGMENT, 2, 3, 4]);
    // A single map has level 0 only.
    let error = open.read(2, W, H).unwrap_err().to_string();
    assert!(error.contains("c_s.npy") && error.contains("level 2"), "{error}");
    let open = SegmentFolder::open(dir.path(), options(&[0])).unwrap();
    assert_eq!(open.read(2, W, H).unwrap().levels[0], a.levels[1]);
    // Twice as large, and of another shape.
    assert_eq!(open.read(0, 2 * W, 2 * H).unwrap().levels[0].at(3, 0), 1);
    let error = open.read(0, W, 2 * H).unwrap_err().to_string();
    assert!(error.contains("is 6×4, its camera 6×8"), "{error}");
}

#[test]
fn maps_as_pictures() {
    let dir = folder();
    let id = |i: u32, none: u16| if i.is_multiple_of(W) { none } else { (i / W % 2) as u16 };
    let bytes = (0..W * H).map(|i| id(i, 255) as u8).collect();
    let words = (0..W * H).map(|i| id(i, u16::MAX)).collect();
    gray_png(&dir.path().join("one.png"), Samples::Eight(bytes));
    gray_png(&dir.path().join("two.png"), Samples::Sixteen(words));
    npy(dir.path(), "one.npy", &[2, 3], &[1.0f32; 6]);
    let tensor = [1.0f32; 6].map(f32::to_le_bytes).concat();
    let view = safetensors::tensor::TensorView::new(safetensors::Dtype::F32, vec![2, 3], &tensor);
    let bytes = safetensors::serialize([("features", view.unwrap())], None).unwrap();
    std::fs::write(dir.path().join("two.safetensors"), bytes).unwrap();
    let open = SegmentFolder::open(dir.path(), SegmentOptions::default()).unwrap();
    assert_eq!((open.layout(), open.len()), (SegmentLayout::Png, 2));
    let [one, two] = [0, 1].map(|frame| open.read(frame, W, H).unwrap());
    assert_eq!(one, two);
    assert_eq!(one.levels[0].ids()[..8], [NO_SEGMENT, 0, 0, 0, 0, 0, NO_SEGMENT, 1]);

    // One table for all, and another value for no segment.
    std::fs::remove_file(dir.path().join("two.safetensors")).unwrap();
    npy(dir.path(), "features.npy", &[300, 3], &[1.0f32; 900]);
    let none = SegmentOptions { png_no_segment: Some(0), ..SegmentOptions::default() };
    let open = SegmentFolder::open(dir.path(), none).unwrap();
    assert_eq!(open.layout(), SegmentLayout::PngSharedTable);
    let one = open.read(0, W, H).unwrap();
    assert_eq!(
        one.levels[0].ids()[..8],
        [255, NO_SEGMENT, NO_SEGMENT, NO_SEGMENT, NO_SEGMENT, NO_SEGMENT, 255, 1]
    );
    let error = open.read(1, W, H).unwrap_err().to_string();
    assert!(error.contains("two.png") && error.contains("id 65535"), "{error}");
    assert!(SegmentFolder::open(dir.path(), options(&[1])).is_err(), "PNG maps have level 0");
}

#[test]
fn frames_are_found_by_the_names_of_cameras() {
    let dir = folder();
    for name in ["frame_1", "b.c", "stray"] {
        npy(dir.path(), &format!("{name}_s.npy"), &[1, 1], &[0i32]);
        npy(dir.path(), &format!("{name}_f.npy"), &[1, 1], &[1.0f32]);
    }
    let open = SegmentFolder::open(dir.path(), SegmentOptions::default()).unwrap();
    let found = open.match_cameras(&["images/frame_1.v2.jpg", "b.c.png", "none.jpg"]).unwrap();
    assert_eq!(
        found.frames().iter().map(|f| f.map(|f| open.name(f))).collect::<Vec<_>>(),
        [Some("frame_1".to_owned()), Some("b.c".to_owned()), None]
    );
    assert_eq!((found.num_matched(), &found.without_camera[..]), (2, &["stray".to_owned()][..]));
    assert_eq!(open.match_cameras(&[r"a\stray"]).unwrap().num_matched(), 1);
    let error = open.match_cameras(&["a/stray.png", "b/stray.jpg"]).unwrap_err().to_string();
    assert!(error.contains("a/stray.png") && error.contains("b/stray.jpg"), "{error}");
    let error = open.match_cameras(&["x.png"]).unwrap_err().to_string();
    assert!(error.contains("\"x.png\"") && error.contains("\"b.c\""), "{error}");
    assert!(open.match_cameras(&[]).is_err());
}

/// A folder that is right but for one file.
fn spoilt(spoil: impl Fn(&Path)) -> String {
    let dir = folder();
    npy(dir.path(), "a_s.npy", &[H as usize, W as usize], &[0i32; 24]);
    npy(dir.path(), "a_f.npy", &[2, 3], &[1.0f32; 6]);
    SegmentFolder::open(dir.path(), SegmentOptions::default()).unwrap().read(0, W, H).unwrap();
    spoil(dir.path());
    let open = SegmentFolder::open(dir.path(), SegmentOptions::default());
    open.and_then(|open| open.read(0, W, H)).unwrap_err().to_string()
}

#[test]
fn what_is_wrong_is_named_with_its_file_and_place() {
    let ids = |at: usize, id: i32| {
        let mut ids = vec![0; 24];
        ids[at] = id;
        ids
    };
    let shape = [H as usize, W as usize];
    let cases: [Case<'_>; 12] = [
        (
            &|d| npy(d, "a_s.npy", &shape, &ids(9, 2)),
            &["a_s.npy", "row 1, column 3: id 2", "2 rows"],
        ),
        (&|d| npy(d, "a_s.npy", &shape, &ids(0, -2)), &["row 0, column 0: id -2", "-1 is no"]),
        (&|d| npy(d, "a_s.npy", &shape, &[0.5f32; 24]), &["a_s.npy", "not whole"]),
        (&|d| npy(d, "a_s.npy", &shape, &[f32::NAN; 24]), &["a_s.npy"]),
        (&|d| npy(d, "a_s.npy", &[5, 1, 1], &[0i32; 5]), &["a_s.npy", "[5, 1, 1]"]),
        (&|d| npy(d, "a_s.npy", &[0, 3], &[0i32; 0]), &["a_s.npy", "3×0"]),
        (&|d| npy(d, "a_f.npy", &[6], &[1.0f32; 6]), &["a_f.npy", "[6]"]),
        (&|d| npy(d, "a_f.npy", &[2, 3], &[1i32; 6]), &["a_f.npy", "Int(4)"]),
        (
            &|d| npy(d, "a_f.npy", &[2, 2], &[1.0, 2.0, 3.0, f32::NAN]),
            &["a_f.npy", "row 1, column 1: NaN"],
        ),
        (&|d| std::fs::write(d.join("a_f.npy"), b"no").unwrap(), &["a_f.npy", "no .npy"]),
        (
            &|d| std::fs::remove_file(d.join("a_f.npy")).unwrap(),
            &["a_s.npy", "no a_f.npy beside it"],
        ),
        (
            &|d| {
                let half = std::fs::read(d.join("a_s.npy")).unwrap();
                std::fs::write(d.join("a_s.npy"), &half[..half.len() - 4]).unwrap();
            },
            &["a_s.npy", "should hold"],
        ),
    ];
    for (spoil, about) in cases {
        let error = spoilt(spoil);
        assert!(about.iter().all(|text| error.contains(text)), "{error}: {about:?}");
    }
    // A table without rows may claim any width, and a safetensors file too.
    let wide = spoilt(|d| npy(d, "a_f.npy", &[0, 1 << 24], &[0.0f32; 0]));
    assert!(wide.contains("a_f.npy") && wide.contains("16777216 values"), "{wide}");
    let many = spoilt(|d| npy(d, "a_f.npy", &[65_536, 1], &vec![1.0f32; 65_536]));
    assert!(many.contains("65536 segments"), "{many}");
}

#[test]
fn pictures_that_are_no_maps_are_refused() {
    let spoilt = |save: &dyn Fn(&Path)| {
        let dir = folder();
        npy(dir.path(), "features.npy", &[2, 3], &[1.0f32; 6]);
        save(&dir.path().join("a.png"));
        let open = SegmentFolder::open(dir.path(), SegmentOptions::default()).unwrap();
        open.read(0, W, H).unwrap_err().to_string()
    };
    let color = spoilt(&|path| {
        let color = RgbPicture::filled(W, H, [0; 3]).encode_png().unwrap();
        std::fs::write(path, color).unwrap();
    });
    assert!(color.contains("a.png") && color.contains("Rgb"), "{color}");
    let broken = spoilt(&|path| std::fs::write(path, b"\x89PNG\r\n\x1a\nno").unwrap());
    assert!(broken.contains("a.png") && broken.contains("no PNG"), "{broken}");
    let outside = spoilt(&|path| gray_png(path, Samples::Eight(vec![7; (W * H) as usize])));
    assert!(outside.contains("row 0, column 0: id 7"), "{outside}");

    let dir = folder();
    let open = |dir: &Path| SegmentFolder::open(dir, SegmentOptions::default()).unwrap_err();
    assert!(open(dir.path()).to_string().contains("no maps"));
    gray_png(&dir.path().join("a.png"), Samples::Eight(vec![0; (W * H) as usize]));
    assert!(open(dir.path()).to_string().contains("no feature table"));
    assert!(open(&dir.path().join("missing")).to_string().contains("missing"));
    for levels in [&[][..], &[4], &[1, 1]] {
        assert!(SegmentFolder::open(dir.path(), options(levels)).is_err(), "{levels:?}");
    }
}
