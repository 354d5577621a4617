#![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
use super::*;

/// A folder with empty files.
fn folder(names: &[&str]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    for name in names {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, "").unwrap();
    }
    dir
}

/// What cameras find, as paths below the folder; "-" is nothing.
fn found(
    path: &std::path::Path,
    endings: &[&str],
    cameras: &[&str],
) -> Result<Vec<String>, String> {
    let files = FrameFiles::open(path, endings).unwrap();
    let found = files.find(cameras).map_err(|error| error.to_string())?;
    let name = |file: &Option<usize>| {
        let Some(file) = file else { return "-".to_owned() };
        let path_of = files.path(*file);
        path_of.strip_prefix(path).unwrap().to_string_lossy().replace('\\', "/")
    };
    assert_eq!(found.missing.len(), found.files.iter().filter(|f| f.is_none()).count());
    Ok(found.files.iter().map(name).collect())
}

#[track_caller]
fn finds(names: &[&str], cameras: &[&str], expected: &[&str]) {
    let dir = folder(names);
    assert_eq!(found(dir.path(), PICTURES, cameras).unwrap(), expected);
}

#[test]
fn endings_are_not_what_a_picture_is_called() {
    // Other endings, in capitals, behind the picture's, before a photo's, none at all.
    finds(
        &["a.png", "b.JPG", "c.jpg.png"],
        &["a.jpg", "b.jpeg", "c.jpg"],
        &["a.png", "b.JPG", "c.jpg.png"],
    );
    finds(&["r_0.png", "frame.0001.png"], &["r_0", "frame.0001"], &["r_0.png", "frame.0001.png"]);
    finds(&["frame.0001.png"], &["frame.0002", "frame.0001"], &["-", "frame.0001.png"]);
    // The name as it is comes first, then the order of endings.
    finds(&["a.jpg", "a.png"], &["a.jpg"], &["a.jpg"]);
    finds(&["a.jpeg", "a.jpg", "a.png"], &["a.tif"], &["a.png"]);
    // Two cameras whose names differ in nothing but their endings.
    finds(&["a.jpg.png", "a.png.png"], &["a.png", "a.jpg"], &["a.png.png", "a.jpg.png"]);
    finds(&["a.png"], &["a.jpg", "a.png"], &["-", "a.png"]);
    finds(&["a.txt", "b"], &["a", "b"], &["-", "-"]);
}

#[test]
fn folders_are_those_of_the_names() {
    let rig = ["left/1.png", "left/2.png", "right/1.png"];
    let cameras = ["left/1.jpg", "right/1.jpg", "right/2.jpg"];
    finds(&rig, &cameras, &["left/1.png", "right/1.png", "-"]);
    // The names begin above the folder, in all ways of writing a path.
    finds(&rig, &["./images/left/1.jpg", r"images\right\1.jpg"], &["left/1.png", "right/1.png"]);
    // Names without folders, files in some: only where nothing is beside them.
    finds(&["x/1.png", "y/2.png"], &["1", "2"], &["x/1.png", "y/2.png"]);
    finds(&["1.png", "depth/1.png", "depth/2.png"], &["1", "2"], &["1.png", "-"]);
    // Names of several depths, as long as files are called so.
    finds(&["1.png", "2.png"], &["images/1.png", "2.png"], &["1.png", "2.png"]);
    // A stray one at the top is nobody's.
    finds(&["left/1.png", "1.png"], &["left/1", "right/1"], &["left/1.png", "-"]);
}

#[test]
fn a_folder_called_as_that_of_some_cameras_has_no_files_of_others() {
    let dir = folder(&["left/1.png", "left/2.png", "left/3.png"]);
    let left = dir.path().join("left");
    let cameras = ["left/1.jpg", "right/1.jpg", "right/2.jpg"];
    assert_eq!(found(&left, PICTURES, &cameras).unwrap(), ["1.png", "-", "-"]);
    let cameras = cameras.map(|name| format!("./rig/images/{name}"));
    let cameras = cameras.each_ref().map(String::as_str);
    assert_eq!(found(&left, PICTURES, &cameras).unwrap(), ["1.png", "-", "-"]);
}

#[test]
fn equal_names_in_two_folders_are_refused_and_not_confused() {
    let dir = folder(&["1.png"]);
    let error = found(dir.path(), PICTURES, &["left/1.jpg", "right/1.jpg"]).unwrap_err();
    for part in ["1 belongs to two cameras", "\"left/1.jpg\"", "\"right/1.jpg\"", "put files into"]
    {
        assert!(error.contains(part), "{error}");
    }
    let dir = folder(&["left/1.png", "right/1.png"]);
    let error = found(dir.path(), PICTURES, &["1.jpg"]).unwrap_err();
    assert!(error.contains("\"1.jpg\" may mean left/1 and right/1"), "{error}");
    // A camera that is listed twice is one.
    finds(&["1.png"], &["1.jpg", "1.jpg"], &["1.png", "1.png"]);
}

#[test]
fn counts_name_what_is_missing() {
    let dir = folder(&["1_s.npy", "2_s.npy", "2_f.npy"]);
    let files = FrameFiles::open(dir.path(), &["_s.npy"]).unwrap();
    assert_eq!((files.len(), files.stem(1)), (2, "2".to_owned()));
    let text = files.find(&["1.jpg", "3.jpg", "4.jpg"]).unwrap().text("map");
    assert_eq!(text, "1 of 3 cameras have a map; missing: 2 (3.jpg, …)");
    assert_eq!(files.find(&["1"]).unwrap().text("map"), "1 of 1 cameras have a map; missing: 0");
    assert!(FrameFiles::open(&dir.path().join("none"), PICTURES).is_err());
    let nested = folder(&["1.png", "old/1.png"]);
    let top = FrameFiles::open(nested.path(), PICTURES).unwrap().at_top();
    assert_eq!((top.len(), top.find(&["1"]).unwrap().files), (1, vec![Some(0)]));
}
