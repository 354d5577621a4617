//! Lenses, matrices, numbers and names by hand: each axis has numbers of its own, so that none can stand for another.

use super::super::lens::{IDENTITY, inverse, is_finite, of_opengl, pixels, pose_of, product};
use super::super::text::{below, keyed, numbers_of, stem};
use super::*;
use serde_json::json;

const C: f64 = 5.0 / 13.0;
const S: f64 = 12.0 / 13.0;
/// About z by the angle of 3, 4, 5, after about x by that of 5, 12, 13; at (1, −2, 3).
pub(super) const TURNED: Pose = [
    [0.6, -0.8 * C, 0.8 * S, 1.0],
    [0.8, 0.6 * C, -0.6 * S, -2.0],
    [0.0, S, C, 3.0],
    [0.0, 0.0, 0.0, 1.0],
];

pub(super) fn close(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9)
}

#[track_caller]
fn same(got: &Pose, want: &Pose) {
    assert!(close(got.as_flattened(), want.as_flattened()), "{got:?}, not {want:?}");
}

#[test]
fn matrices_are_inverted_multiplied_and_turned_as_by_hand() {
    // Rows of the transposed turn; −Rᵀ (1, −2, 3) = (−(0.6 − 1.6), 2 c − 3 s, −2 s − 3 c).
    let back = [
        [0.6, 0.8, 0.0, 1.0],
        [-0.8 * C, 0.6 * C, S, 2.0 * C - 3.0 * S],
        [0.8 * S, -0.6 * S, C, -2.0 * S - 3.0 * C],
        [0.0, 0.0, 0.0, 1.0],
    ];
    same(&inverse(&TURNED), &back);
    same(&product(&TURNED, &back), &IDENTITY);
    // The second is done first: (1, 0, 0) becomes (0.6, 0.8, 0) before the shift.
    let shift = with(&IDENTITY, [0, 3], 1.0);
    let [after, before] = [product(&TURNED, &shift), product(&shift, &TURNED)];
    assert!(close(&after.map(|row| row[3]), &[1.6, -1.2, 3.0, 1.0]), "{after:?}");
    assert!(close(&before.map(|row| row[3]), &[2.0, -2.0, 3.0, 1.0]), "{before:?}");
    let numbers: Vec<f64> = (0..17).map(f64::from).collect();
    let rows = [0.0, 4.0, 8.0, 12.0].map(|v| [v, v + 1.0, v + 2.0, v + 3.0]);
    assert_eq!(pose_of(&numbers[..16]), Some(rows));
    assert!([0, 15, 17].iter().all(|n| pose_of(&numbers[..*n]).is_none()));
    assert_eq!(of_opengl(rows), rows.map(|[a, b, c, d]| [a, -b, -c, d]));
    assert!(is_finite(&rows) && !is_finite(&with(&rows, [3, 2], f64::INFINITY)));
    assert_eq!(pixels(70_000, 70_001), 4_900_070_000);
    // A camera has the world to camera, which is the inverse.
    let lens = Lens::of_corner([5.0, 3.0, 3.25, 2.75], None);
    let camera = lens.camera("a".to_owned(), [8, 6], &TURNED);
    let numbers = [camera.fx, camera.fy, camera.cx, camera.cy];
    assert_eq!((camera.name.as_str(), camera.width, camera.height), ("a", 8, 6));
    assert_eq!(numbers, [5.0, 3.0, 3.25, 2.75]);
    for (i, row) in camera.rotation.iter().enumerate() {
        assert!(close(row, &back[i][..3]) && (camera.translation[i] - back[i][3]).abs() < 1e-12);
    }
}

#[test]
fn lenses_are_read_moved_and_scaled_along_their_own_axes() {
    let own = |focal, centre, size| Lens { focal, centre, size, from_below: false };
    let corner = Lens::of_corner([5.0, 3.0, 4.0, 2.0], Some([8, 6]));
    assert_eq!(corner, own([5.0, 3.0], [4.0, 2.0], Some([8, 6])));
    let centre = own([5.0, 3.0], [4.5, 2.5], None);
    assert_eq!(Lens::of_centre([5.0, 3.0, 4.0, 2.0], None), centre);
    let rows = [[5.0, 0.1, 4.0, 9.0], [0.2, 3.0, 2.0, 9.0], [0.0, 0.3, 1.0, 9.0], [9.0; 4]];
    assert_eq!(Lens::of_matrix(rows.as_flattened(), None), Some(centre));
    let nine: Vec<f64> = rows[..3].iter().flat_map(|row| &row[..3]).copied().collect();
    assert_eq!(Lens::of_matrix(&nine, Some([8, 6])), Some(Lens { size: Some([8, 6]), ..centre }));
    assert_eq!(Lens::of_matrix(&rows.as_flattened()[..12], None), None);
    // From the lower edge of 6 rows 1.5 is 4.5; what counts from the upper one stays.
    let below = Lens { from_below: true, ..own([5.0, 3.0], [4.0, 1.5], None) };
    assert_eq!(below.upright([8, 6]), own([5.0, 3.0], [4.0, 4.5], Some([8, 6])));
    assert_eq!(corner.upright([8, 7]), own([5.0, 3.0], [4.0, 2.0], Some([8, 7])));
    let wide = corner.resized([8, 6], [16, 9]);
    assert_eq!(wide, own([10.0, 4.5], [8.0, 3.0], Some([16, 9])));
    // (9 − 4) / 5 · 10 + 1 and (5 − 2) / 3 · 9 + 7.
    let other = own([10.0, 9.0], [1.0, 7.0], None);
    assert_eq!(corner.place_in(&other, [9.0, 5.0]), [11.0, 16.0]);
}

#[test]
fn numbers_names_and_paths_of_lists_are_taken_apart() {
    let found = numbers_of("1, -2.5\t3e2\n\nnan 1.#INF -1.#QNAN -inf").unwrap();
    assert_eq!((found.len(), &found[..3]), (7, &[1.0, -2.5, 300.0][..]));
    assert!(found[3..6].iter().all(|v| v.is_nan()) && found[6] == f64::NEG_INFINITY);
    assert_eq!(numbers_of(&format!("1 {}", "x".repeat(50))), Err("x".repeat(40)));
    let (folder, list) = (Path::new("f"), Path::new("list"));
    assert_eq!(below(folder, "a/b.jpg", list).unwrap(), Path::new("f/a/b.jpg"));
    assert_eq!(below(folder, "./b.jpg", list).unwrap(), Path::new("f/b.jpg"));
    assert!(["", "/a", "a/../../b"].iter().all(|name| below(folder, name, list).is_err()));
    let stems = ["a/b.c.jpg", "a\\b.png", "none", "x/none"].map(stem);
    assert_eq!(stems, ["b.c", "b", "none", "none"]);
    let mini = Mini::new();
    for name in
        ["frame-x.png", "frame-10.png", "frame-2.png", "frame-10.jpg", "other-1.png", "frame-3.txt"]
    {
        mini.write(name, "");
    }
    let found = keyed(&mini.at(""), "frame-", &[".jpg", ".png"]).unwrap();
    let found: Vec<(u64, &str, String)> = found
        .iter()
        .map(|((number, key), path)| (*number, key.as_str(), crate::files::name_of(path)))
        .collect();
    let entry = |number, key, name: &str| (number, key, name.to_owned());
    // By number, and of one key the file of the first ending.
    let [two, ten] = [entry(2, "2", "frame-2.png"), entry(10, "10", "frame-10.jpg")];
    assert_eq!(found, [two, ten, entry(u64::MAX, "x", "frame-x.png")]);
    let reasons = [
        (SkipReason::NoPicture, "no picture"),
        (SkipReason::NoPose, "no pose"),
        (SkipReason::PoseNotFinite, "pose not finite"),
        (SkipReason::PoseNotRigid, "pose no rigid motion"),
        (SkipReason::NoIntrinsics, "no intrinsics"),
        (SkipReason::MarkedBad, "marked bad"),
    ];
    assert!(reasons.iter().all(|(reason, text)| reason.text() == *text));
    let layouts = "scannet scannetpp arkitscenes matterport3d 3rscan hypersim replica rgbd";
    assert_eq!(FrameLayout::ALL.map(FrameLayout::name).join(" "), layouts);
    assert_eq!(STEPS_PER_METRE, 1000.0);
}

/// The one frame of a layout has focal lengths 5 and 3 and the principal point (3.25, 2.75) from the upper left corner,
/// and stands at [`TURNED`]. `poses`: whether the layout can hold that pose.
#[track_caller]
fn has_the_lens(path: &Path, layout: FrameLayout, name: &str) -> Read {
    let found = read(path, layout);
    let camera = &found.0[0].camera;
    assert_eq!((camera.name.as_str(), camera.width, camera.height), (name, 8, 6), "{layout:?}");
    let numbers = [camera.fx, camera.fy, camera.cx, camera.cy];
    assert!(close(&numbers, &[5.0, 3.0, 3.25, 2.75]), "{layout:?}: {numbers:?}");
    for (got, want) in camera.camera_to_world().iter().zip(&TURNED) {
        assert!(close(got, want), "{layout:?}: {got:?}, not {want:?}");
    }
    found
}

#[test]
fn every_layout_keeps_the_two_axes_of_a_lens_apart() {
    let mini = Mini::new();
    let (nine, pose) = ("5 0 2.75 0 3 2.25 0 0 1", words(&TURNED));
    let sixteen = "5 0 2.75 0 0 3 2.25 0 0 0 1 0 0 0 0 1";
    let opengl = of_opengl(TURNED);

    mini.write("scannet/intrinsic/intrinsic_color.txt", sixteen);
    mini.write("scannet/intrinsic/extrinsic_color.txt", words(&TURNED));
    mini.write("scannet/intrinsic/extrinsic_depth.txt", words(&IDENTITY));
    mini.write("scannet/pose/7.txt", &pose);
    mini.picture("scannet/color/7.png");
    let (_, _, notes) = has_the_lens(&mini.at("scannet"), FrameLayout::Scannet, "7.png");
    assert!(notes.len() == 1 && notes[0].starts_with("extrinsic_color.txt is not"), "{notes:?}");

    mini.write("rgbd/camera-intrinsics.txt", nine);
    mini.write("rgbd/frame-07.pose.txt", &pose);
    mini.picture("rgbd/frame-07.color.JPG");
    has_the_lens(&mini.at("rgbd"), FrameLayout::Rgbd, "frame-07.png");

    mini.write(
        "rscan/_info.txt",
        format!(
            "m_colorWidth = 8\nm_colorHeight = 6\nm_depthWidth = 4\nm_depthHeight = 3\nm_depthShift = 500\n\
             m_calibrationColorIntrinsic = {sixteen}\n\
             m_calibrationDepthIntrinsic = 2.5 0 1.125 0 0 1.5 0.875 0 0 0 1 0 0 0 0 1\nm_frames.size = 1\n"
        ),
    );
    mini.write("rscan/frame-000007.pose.txt", &pose);
    mini.picture("rscan/frame-000007.color.jpg");
    let mut pgm = b"P5 #c\n4 # w\n 3 65535\n".to_vec();
    pgm.extend((1..13u16).flat_map(u16::to_be_bytes));
    mini.write("rscan/frame-000007.depth.pgm", pgm);
    let (frames, _, notes) =
        has_the_lens(&mini.at("rscan"), FrameLayout::ThreeRScan, "frame-000007.png");
    // 500 steps per meter are 2 mm each; the depth's lens is half of the color's, so it stays.
    let depth = frames[0].depth.as_ref().unwrap();
    let values: Vec<u16> = (1..13).map(|v| 2 * v).collect();
    assert_eq!(depth.picture.samples(), &Samples::Sixteen(values));
    assert!(!depth.resampled && notes.is_empty(), "{notes:?}");

    // The file here counts, not the one above; the second line is of the second picture and its own depth.
    let camera = |fx: f64, scale: f64| {
        json!({"camera": {"w": 8, "h": 6, "fx": fx, "fy": 3.0, "cx": 2.75, "cy": 2.25, "scale": scale}})
            .to_string()
    };
    mini.write("replica/cam_params.json", camera(4.0, 1.0));
    mini.write("replica/room/cam_params.json", camera(5.0, 2000.0));
    mini.write("replica/room/traj.txt", format!("\n{}\n{pose}\n", words(&POSE)));
    for number in [0, 1] {
        mini.picture(&format!("replica/room/results/frame00000{number}.png"));
    }
    mini.depth("replica/room/results/depth000001.png", 4000, 10);
    let (frames, ..) = read(&mini.at("replica/room"), FrameLayout::Replica);
    assert!(frames[0].depth.is_none() && frames[0].camera.name == "frame000000.png");
    let Samples::Sixteen(values) = frames[1].depth.as_ref().unwrap().picture.samples() else {
        panic!("16 bits")
    };
    assert_eq!(values[13..15], [5, 2000]);
    mini.write("replica/room/traj.txt", &pose);
    std::fs::remove_file(mini.at("replica/room/results/frame000001.png")).unwrap();
    has_the_lens(&mini.at("replica/room"), FrameLayout::Replica, "frame000000.png");

    // A second lens holds for what comes after it; rows of the file count from the lower edge: 6 − 2.75.
    mini.write(
        "mp/undistorted_camera_parameters/a.conf",
        format!(
            "intrinsics_matrix 4 0 4 0 4 2 0 0 1\nscan d0.png a.jpg {m}\n\
             intrinsics_matrix 5 0 3.25 0 3 3.25 0 0 1\nscan d1.png b.c.jpg {m}\n",
            m = words(&opengl)
        ),
    );
    mini.picture("mp/undistorted_color_images/b.c.jpg");
    let (_, skipped, _) = has_the_lens(&mini.at("mp"), FrameLayout::Matterport3d, "b_c.png");
    assert_eq!(skipped, [("a".to_owned(), SkipReason::NoPicture)]);

    let intrinsic = [[5.0, 0.0, 3.25], [0.0, 3.0, 2.75], [0.0, 0.0, 1.0]];
    let phone = json!({"f": {"aligned_pose": TURNED, "intrinsic": intrinsic}}).to_string();
    mini.write("phone/pose_intrinsic_imu.json", phone);
    mini.picture("phone/rgb/f.png");
    let (_, _, notes) = has_the_lens(&mini.at("phone"), FrameLayout::ScannetPp, "f.png");
    assert!(notes.is_empty(), "{notes:?}");
}

#[test]
fn poses_of_nerfstudio_come_back_by_the_transform_that_its_file_names() {
    let mini = Mini::new();
    let file = "s/nerfstudio/transforms_undistorted.json";
    // Some other world: turned by TURNED, of which the file says all rows or the first three.
    let moved = product(&TURNED, &of_opengl(TURNED));
    let list = |extra: serde_json::Value| {
        let mut list = json!({"fl_x": 5.0, "fl_y": 3.0, "cx": 3.25, "cy": 2.75, "w": 8, "h": 6,
            "frames": [{"file_path": "sub/a.JPG", "transform_matrix": moved}]});
        let object = list.as_object_mut().unwrap();
        object.extend(extra.as_object().unwrap().clone());
        list.to_string()
    };
    mini.picture("s/undistorted_images/sub/a.JPG");
    let (folder, layout) = (mini.at("s"), FrameLayout::ScannetPp);
    for rows in [3, 4] {
        mini.write(
            file,
            list(json!({"applied_transform": TURNED[..rows], "camera_model": "OPENCV"})),
        );
        let (_, _, notes) = has_the_lens(&folder, layout, "a.png");
        assert_eq!(notes.len(), 1);
    }
    for rows in [1, 2] {
        mini.write(file, list(json!({"applied_transform": TURNED[..rows]})));
        refused(&folder, layout, &["applied_transform of", "rows"]);
    }
    for k in ["k1", "k2", "k3", "k4"] {
        mini.write(file, list(json!({ k: 0.01 })));
        refused(&folder, layout, &["camera model PINHOLE", "undistort"]);
    }
    // Pictures of the first folder win; the phone beside is named, and so are frames of the test.
    mini.picture("s/resized_undistorted_images/sub/a.JPG");
    let small = RgbPicture::filled(4, 3, [0; 3]).encode_png().unwrap();
    mini.write("s/undistorted_images/sub/a.JPG", small);
    mini.write("s/iphone/pose_intrinsic_imu.json", "{}");
    let test = json!({"file_path": "t.JPG", "transform_matrix": moved});
    let test = [test.clone(), test];
    mini.write(file, list(json!({"applied_transform": TURNED, "test_frames": test})));
    let (_, _, notes) = has_the_lens(&folder, layout, "a.png");
    assert!(notes[1].starts_with("2 test frames"), "{notes:?}");
    assert!(notes[2].contains("phone") && notes[2].contains("s/iphone"), "{notes:?}");
}
