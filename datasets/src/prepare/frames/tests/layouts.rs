//! The layouts that keep each frame in files of its own, one test each.

use super::*;
use serde_json::json;

#[test]
fn scannet_exported() {
    let mini = Mini::new();
    let lens = "4 0 3.5 0\n0 4 2.5 0\n0 0 1 0\n0 0 0 1\n";
    mini.write("s/intrinsic/intrinsic_color.txt", lens);
    mini.write("s/intrinsic/intrinsic_depth.txt", lens);
    for (name, pose) in [
        ("0", words(&POSE)),
        ("2", "-inf ".repeat(16)),
        ("10", words(&with(&POSE, [0, 2], 1.5))),
        ("11", words(&POSE).replace('2', "-nan(ind)")),
        ("12", words(&POSE)),
    ] {
        mini.write(&format!("s/pose/{name}.txt"), pose);
        if name != "12" {
            mini.picture(&format!("s/color/{name}.jpg"));
        }
        mini.depth(&format!("s/depth/{name}.png"), 2000, 65535);
    }
    mini.picture("s/color/1.jpg");
    let (folder, scannet) = (mini.at("s"), FrameLayout::Scannet);
    let (frames, skipped, _) = read(&folder, scannet);
    near(world_point(&frames[0], PIXEL), POINT);
    // In the order of their numbers, each with its reason.
    let reason = |name: &str, reason| (name.to_owned(), reason);
    assert_eq!(
        skipped,
        [
            reason("1", SkipReason::NoPose),
            reason("2", SkipReason::PoseNotFinite),
            reason("10", SkipReason::PoseNotRigid),
            reason("11", SkipReason::PoseNotFinite),
            reason("12", SkipReason::NoPicture),
        ]
    );
    // Depths may be missing, and be smaller: 4 × 3 pixels, whose pixel (3, 0) is the color's (6..8, 0..2).
    let half = lens.replace("4 0 3.5", "2 0 1.5").replace("4 2.5", "2 1");
    mini.write("s/intrinsic/intrinsic_depth.txt", half);
    let mut values = [0; 12];
    values[3] = 2000;
    mini.write("s/depth/0.png", depth_png([4, 3], &values));
    let (frames, ..) = read(&folder, scannet);
    assert!(!frames[0].depth.as_ref().unwrap().resampled);
    // (3.5 − 2) / 2 · 2 and (0.5 − 1.5) / 2 · 2.
    near(world_point(&frames[0], [3, 0]), [3.0, 0.5, 4.0]);
    std::fs::remove_file(mini.at("s/depth/0.png")).unwrap();
    assert!(read(&folder, scannet).0[0].depth.is_none());
    mini.write("s/intrinsic/extrinsic_depth.txt", "2 ".repeat(16));
    assert!(read(&folder, scannet).2[0].contains("extrinsic_depth.txt"));
    mini.write("s/pose/0.txt", "1 0 0 0");
    refused(&folder, scannet, &["0.txt", "has 4 numbers"]);
    mini.write("s/pose/0.txt", "one");
    refused(&folder, scannet, &["0.txt", "\"one\" is no number"]);
    mini.write("s/intrinsic/intrinsic_color.txt", "1 2 3");
    refused(&folder, scannet, &["intrinsic_color.txt", "has 3 numbers"]);
}

#[test]
fn scannetpp_camera() {
    let mini = Mini::new();
    let file = "s/dslr/nerfstudio/transforms_undistorted.json";
    // nerfstudio's world has x and y exchanged and z turned: rows 1, 0 and −2 of the pose.
    let [x, y, z, w] = OPENGL;
    let moved: Pose = [y, x, z.map(|v| -v), w];
    let list = |model: &str, name: &str| {
        json!({"fl_x": 4.0, "fl_y": 4.0, "cx": 4.0, "cy": 3.0, "w": 8, "h": 6, "k1": 0.0,
        "camera_model": model, "frames": [
            {"file_path": name, "transform_matrix": moved, "is_bad": false},
            {"file_path": "b.JPG", "transform_matrix": moved, "is_bad": true}],
        "test_frames": [{"file_path": "c.JPG", "transform_matrix": moved}]})
        .to_string()
    };
    mini.write("s/dslr/nerfstudio/transforms.json", list("OPENCV_FISHEYE", "a.JPG"));
    let (folder, layout) = (mini.at("s"), FrameLayout::ScannetPp);
    refused(&folder, layout, &["transforms.json", "fisheye", "undistort"]);
    mini.write(file, list("PINHOLE", "a.JPG"));
    refused(&folder, layout, &["resized_undistorted_images", "undistort"]);
    mini.picture("s/dslr/resized_undistorted_images/a.JPG");
    let (frames, skipped, notes) = read(&folder, layout);
    assert_eq!(skipped, [("b".to_owned(), SkipReason::MarkedBad)]);
    assert!(notes[0].contains("mesh") && notes[1].contains("1 test frames"), "{notes:?}");
    let camera = &frames[0].camera;
    let pixel = camera.project(POINT).unwrap();
    assert!((pixel[0] - 6.5).abs() < 1e-9 && (pixel[1] - 1.5).abs() < 1e-9, "{pixel:?}");
    assert!(frames[0].depth.is_none());
    for name in ["/etc/passwd", "../../secret.jpg", ""] {
        mini.write(file, list("PINHOLE", name));
        refused(&folder, layout, &["transforms_undistorted.json", "not below its folder"]);
    }
    mini.write(file, list("OPENCV_FISHEYE", "a.JPG"));
    refused(&folder, layout, &["OPENCV_FISHEYE", "undistort"]);
    mini.write(file, "{");
    refused(&folder, layout, &["no list of frames"]);
    refused(&mini.at(""), layout, &["holds neither"]);
}

#[test]
fn scannetpp_phone() {
    let mini = Mini::new();
    let file = "s/iphone/pose_intrinsic_imu.json";
    let intrinsic = [[4.0, 0.0, 4.0], [0.0, 4.0, 3.0], [0.0, 0.0, 1.0]];
    let away = with(&POSE, [0, 3], 9.0);
    mini.write(
        file,
        json!({
            "frame_000000": {"timestamp": 0.0, "pose": away, "aligned_pose": POSE, "intrinsic": intrinsic},
            "frame_000001": {"pose": POSE, "aligned_pose": POSE, "intrinsic": intrinsic},
            "frame_000002": {"pose": away, "intrinsic": intrinsic}})
        .to_string(),
    );
    let (folder, layout) = (mini.at("s"), FrameLayout::ScannetPp);
    refused(&folder, layout, &["no frame whose picture is in rgb"]);
    for number in [0, 2] {
        mini.picture(&format!("s/iphone/rgb/frame_00000{number}.jpg"));
        mini.depth(&format!("s/iphone/depth/frame_00000{number}.png"), 2000, 0);
    }
    let (frames, _, notes) = read(&folder, layout);
    near(world_point(&frames[0], PIXEL), POINT);
    near(world_point(&frames[1], PIXEL), [POINT[0] + 8.0, POINT[1], POINT[2]]);
    assert!(notes[0].contains("1 of 3 frames") && notes[1].contains("aligned_pose"), "{notes:?}");
    // The folder of the phone itself.
    assert_eq!(read(&mini.at("s/iphone"), layout).0, frames);
    mini.write(file, json!({"../x": {"intrinsic": intrinsic}}).to_string());
    refused(&folder, layout, &["\"../x.png\"", "not below its folder"]);
}

/// The camera's turn is a third of a circle about (1, −1, 1) / √3 from the world's axes to its own: x → −y of the world
/// is right, and so on.
#[test]
fn arkitscenes() {
    let mini = Mini::new();
    let third = 2.0 * std::f64::consts::PI / 3.0 / 3f64.sqrt();
    // World to camera: right −y, down −z, forward x of the world; shift −R c = (2, 3, −1).
    let line = |time: f64| format!("{time} {third} {} {third} 2 3 -1\n", -third);
    mini.write("41/lowres_wide.traj", [line(10.05), line(11.0)].concat());
    for time in ["10.000", "10.500", "11.001"] {
        mini.picture(&format!("41/lowres_wide/41_{time}.png"));
        mini.depth(&format!("41/lowres_depth/41_{time}.png"), 2000, 500);
    }
    let lens = |time: &str| {
        mini.write(&format!("41/lowres_wide_intrinsics/41_{time}.pincam"), "8 6 4 4 4 3\n");
    };
    lens("10.000");
    lens("10.500");
    let (folder, layout) = (mini.at("41"), FrameLayout::Arkitscenes);
    let (frames, skipped, _) = read(&folder, layout);
    near(world_point(&frames[0], PIXEL), POINT);
    assert_eq!(frames[0].camera.name, "41_10_000.png");
    let names: Vec<_> = skipped.iter().map(|(name, reason)| (name.as_str(), *reason)).collect();
    let no_lens = SkipReason::NoIntrinsics;
    assert_eq!(names, [("41_10_500", SkipReason::NoPose), ("41_11_001", no_lens)]);
    lens("10.999");
    assert_eq!(read(&folder, layout).0.len(), 2);
    mini.write("41/lowres_wide_intrinsics/41_10.000.pincam", "9 6 4 4 4 3");
    refused(&folder, layout, &["41_10.000.png", "is 8 × 6, its camera is for 9 × 6"]);
    mini.write("41/lowres_wide_intrinsics/41_10.000.pincam", "8 6 0 4 4 3");
    refused(&folder, layout, &["fx, fy, cx, cy = [0.0"]);
    mini.write("41/lowres_wide.traj", "1 2 3");
    refused(&folder, layout, &["lowres_wide.traj", "line 1 is not 7 numbers"]);
    mini.picture("41/lowres_wide/cover.png");
    mini.write("41/lowres_wide.traj", line(10.0));
    refused(&folder, layout, &["cover.png", "without a time"]);
    refused(&mini.at(""), layout, &["no folder lowres_wide"]);
}

/// Rows count from the lower edge: a principal point of 2 there is 4 from the upper edge, so the pixel's center is
/// 2 · (1.5 − 4) / 4 = −1.25 below the axis.
#[test]
fn matterport3d() {
    let mini = Mini::new();
    let file = "s/undistorted_camera_parameters/s.conf";
    let head = "dataset matterport\nn_images 2\ndepth_directory undistorted_depth_images\n\
                intrinsics_matrix 4 0 4  0 4 2  0 0 1\n";
    let scan = |depth: &str, color: &str| format!("scan {depth} {color} {}\n", words(&OPENGL));
    mini.write(file, [head, &scan("a_d0_0.png", "a_i0_0.jpg"), &scan("b.png", "b.jpg")].concat());
    mini.picture("s/undistorted_color_images/a_i0_0.jpg");
    // 0.25 mm a step, and one value too far for nothing: 65535 is unknown.
    mini.depth("s/undistorted_depth_images/a_d0_0.png", 8000, 65535);
    let (folder, layout) = (mini.at("s"), FrameLayout::Matterport3d);
    let (frames, skipped, _) = read(&folder, layout);
    assert_eq!(skipped, [("b".to_owned(), SkipReason::NoPicture)]);
    near(world_point(&frames[0], PIXEL), [3.0, 0.75, 4.25]);
    assert_eq!(frames[0].camera.name, "a_i0_0.png");
    for (line, part) in [
        (scan("/etc/a.png", "a.jpg"), "/etc/a.png"),
        (scan("a.png", "../../a.jpg"), "../../a.jpg"),
        ("scan a.png b.jpg 1 2 3\n".to_owned(), "line 5 has not 16 numbers"),
        ("intrinsics_matrix 4 0\n".to_owned(), "line 5 has no matrix"),
    ] {
        mini.write(file, [head, &line].concat());
        refused(&folder, layout, &["s.conf", part]);
    }
    mini.write(file, scan("a.png", "a.jpg"));
    refused(&folder, layout, &["line 1 comes before any intrinsics_matrix"]);
    mini.write(file, head);
    refused(&folder, layout, &["has no frames"]);
    mini.write("s/undistorted_camera_parameters/t.conf", head);
    refused(&folder, layout, &["2 files .conf"]);
}

fn pgm(size: [u32; 2], values: &[u16]) -> Vec<u8> {
    let mut out = format!("P5\n# depth\n{} {}\n65535\n", size[0], size[1]).into_bytes();
    out.extend(values.iter().flat_map(|v| v.to_be_bytes()));
    out
}

/// The depth has 4 × 6 pixels, so its pixels are twice as wide as the color's, and the shape is another: it is brought to
/// 8 × 6.
#[test]
fn three_r_scan() {
    let mini = Mini::new();
    let info = |width: u32, shift: f64| {
        format!(
            "m_versionNumber = 4\nm_colorWidth = 8\nm_colorHeight = 6\nm_depthWidth = {width}\nm_depthHeight = 6\n\
             m_depthShift = {shift}\nm_calibrationColorIntrinsic = 4 0 3.5 0 0 4 2.5 0 0 0 1 0 0 0 0 1\n\
             m_calibrationDepthIntrinsic = 2 0 1.5 0 0 4 2.5 0 0 0 1 0 0 0 0 1 \nm_frames.size = 2\n"
        )
    };
    mini.write("s/sequence/_info.txt", info(4, 1000.0));
    mini.picture("s/sequence/frame-000000.color.jpg");
    mini.write("s/sequence/frame-000000.pose.txt", words(&POSE));
    let mut values = [1000; 24];
    values[4 + 3] = 2000;
    let depth = "s/sequence/frame-000000.depth.pgm";
    mini.write(depth, pgm([4, 6], &values));
    let (folder, layout) = (mini.at("s"), FrameLayout::ThreeRScan);
    let (frames, _, notes) = read(&folder, layout);
    let found = frames[0].depth.as_ref().unwrap();
    assert!(found.resampled && [found.picture.width(), found.picture.height()] == SIZE);
    near(world_point(&frames[0], PIXEL), POINT);
    assert_eq!(notes, ["_info.txt says there are 2 frames, 1 are here"]);
    for (bytes, part) in [
        (b"P6 4 6 65535\n".to_vec(), "no binary PGM"),
        (b"P5 4 6 255\n".to_vec(), "values up to 255"),
        (b"P5 4000000000 4000000000 65535\n..".to_vec(), "holds 2 bytes"),
        (pgm([4, 7], &values), "4 × 7 pixels"),
        (pgm([3, 8], &values), "3 × 8, its depth camera is for 4 × 6"),
    ] {
        mini.write(depth, bytes);
        refused(&folder, layout, &[part]);
    }
    mini.write("s/sequence/_info.txt", info(4, 0.0));
    refused(&folder, layout, &["_info.txt", "m_depthShift is 0"]);
    mini.write("s/sequence/_info.txt", info(0, 1000.0));
    refused(&folder, layout, &["m_depthWidth is 0"]);
    mini.write("s/sequence/_info.txt", "m_colorWidth = 8");
    refused(&folder, layout, &["m_colorHeight"]);
}

/// The lens of 60 degrees: 4 / tan 30° = 6.928 pixels for 8. The pixel is off the axis by (2.5, −1.5) / 6.928 =
/// (0.36084, −0.21651) at distance 1 along it; there a distance of √(1 + 0.13021 + 0.04688) · 2 = 2.16988 m is 2 m.
#[test]
fn hypersim() {
    let mini = Mini::new();
    mini.write(
        "all/ai_1/_detail/metadata_scene.csv",
        "parameter_name,parameter_value\nmeters_per_asset_unit,0.5\n",
    );
    let [x, y, z, _] = OPENGL;
    let turn: Vec<f64> = [&x[..3], &y[..3], &z[..3]].concat();
    let away: Vec<f64> = vec![f64::NAN; 9];
    let at = |name: &str| format!("all/ai_1/_detail/cam_00/camera_keyframe_{name}.hdf5");
    mini.hdf5(&at("orientations"), &[&turn[..], &away, &turn].concat(), &[3, 3, 3]);
    mini.hdf5(&at("positions"), &[2.0, 4.0, 6.0, 0.0, 0.0, 0.0, 2.0, 4.0, 6.0], &[3, 3]);
    let images = "all/ai_1/images/scene_cam_00";
    let depth = format!("{images}_geometry_hdf5/frame.0000.depth_meters.hdf5");
    let mut values = vec![f64::NAN; 48];
    values[8 + 6] = 2.16988;
    values[0] = 100.0;
    mini.hdf5(&depth, &values, &[6, 8]);
    mini.picture(&format!("{images}_final_preview/frame.0000.tonemap.jpg"));
    mini.picture(&format!("{images}_final_preview/frame.0001.color.jpg"));
    let (folder, layout) = (mini.at("all/ai_1"), FrameLayout::Hypersim);
    let (frames, skipped, notes) = read(&folder, layout);
    near(world_point(&frames[0], PIXEL), [3.0, 2.0 - 0.72169, 3.0 + 0.43301]);
    let found = frames[0].depth.as_ref().unwrap();
    let Samples::Sixteen(values) = found.picture.samples() else { panic!("16 bits") };
    // Nothing there; and farther than 16 bits of millimeters.
    assert_eq!((values[1], values[0], found.too_far), (0, 0, 1));
    assert_eq!(skipped[0], ("cam_00_0001".to_owned(), SkipReason::PoseNotFinite));
    assert_eq!(skipped[1], ("cam_00_0002".to_owned(), SkipReason::NoPicture));
    assert!(notes[0].contains("metadata_camera_parameters.csv is not beside"), "{notes:?}");

    let table = "all/metadata_camera_parameters.csv";
    let names = "scene_name,use_camera_physical,M_proj_00,M_proj_11,M_proj_02\n";
    mini.write(table, format!("{names}ai_1,True,1.7320508,2.3094011,0.0\n"));
    assert!(read(&folder, layout).2.is_empty());
    mini.write(table, format!("{names}\"ai_1\",False,1.7320508,2.3094011,0.02\n"));
    refused(&folder, layout, &["M_proj_02 is 0.02 of ai_1", "leave the scene out"]);
    mini.write(table, "scene_name,use_camera_physical\nai_1,True\n");
    refused(&folder, layout, &["use_camera_physical is set of ai_1"]);
    mini.write(table, format!("{names}ai_2,True,1,1,1\n"));
    assert!(read(&folder, layout).2[0].contains("no row ai_1"));
    mini.hdf5(&depth, &[1.0; 4], &[4, 1]);
    refused(&folder, layout, &["is 8 × 6, its depth 1 × 4"]);
    mini.write(&depth, "no HDF5");
    refused(&folder, layout, &["depth_meters.hdf5", "HDF5"]);
    mini.hdf5(&at("positions"), &[0.0; 6], &[2, 3]);
    refused(&folder, layout, &["orientations.hdf5", "[2, 3, 3]"]);
}

#[test]
fn replica() {
    let mini = Mini::new();
    let camera = |scale: f64| {
        json!({"camera": {"w": 8, "h": 6, "fx": 4.0, "fy": 4.0, "cx": 3.5, "cy": 2.5, "scale": scale}})
            .to_string()
    };
    mini.write("cam_params.json", camera(6553.5));
    mini.write("room0/traj.txt", format!("{}\n{}\n", words(&POSE), words(&POSE)));
    mini.picture("room0/results/frame000000.jpg");
    mini.picture("room0/results/frame000007.jpg");
    // 2 m in steps of 1 / 6553.5 m.
    mini.depth("room0/results/depth000000.png", 13107, 0);
    let (folder, layout) = (mini.at("room0"), FrameLayout::Replica);
    let (frames, skipped, _) = read(&folder, layout);
    near(world_point(&frames[0], PIXEL), POINT);
    let names: Vec<_> = skipped.iter().map(|(name, reason)| (name.as_str(), *reason)).collect();
    let no_picture = ("frame000001", SkipReason::NoPicture);
    assert_eq!(names, [no_picture, ("frame000007", SkipReason::NoPose)]);
    mini.write("room0/cam_params.json", camera(0.0));
    refused(&folder, layout, &["cam_params.json", "scale is 0"]);
    mini.write("room0/cam_params.json", "{}");
    refused(&folder, layout, &["no camera of Replica"]);
    mini.write("room0/cam_params.json", camera(1000.0));
    mini.write("room0/traj.txt", "1 2 3\n");
    refused(&folder, layout, &["traj.txt", "line 1 is not 16 numbers"]);
}

#[test]
fn rgbd() {
    let mini = Mini::new();
    mini.write("s/camera-intrinsics.txt", "4 0 3.5\n0 4 2.5\n0 0 1\n");
    mini.picture("s/frame-000010.color.jpg");
    mini.write("s/frame-000010.pose.txt", words(&POSE));
    mini.depth("s/frame-000010.depth.png", 2000, 65535);
    let (folder, layout) = (mini.at("s"), FrameLayout::Rgbd);
    let (frames, ..) = read(&folder, layout);
    near(world_point(&frames[0], PIXEL), POINT);
    assert_eq!(frames[0].camera.name, "frame-000010.png");
    mini.write("s/frame-000010.depth.png", depth_png([4, 1], &[1; 4]));
    refused(&folder, layout, &["is 8 × 6, its depth 4 × 1"]);
    mini.write("s/frame-000010.depth.png", color());
    refused(&folder, layout, &["depth.png", "gray with 16 bits"]);
    mini.write("s/frame-000010.color.jpg", "");
    refused(&folder, layout, &["color.jpg", "0 bytes that are no PNG or JPEG"]);
    // Pictures of two sizes have two lenses, of which one is known.
    mini.picture("s/frame-000010.color.jpg");
    mini.depth("s/frame-000010.depth.png", 1, 1);
    mini.write("s/frame-000011.pose.txt", words(&POSE));
    let other = RgbPicture::filled(16, 12, [0; 3]).encode_png().unwrap();
    mini.write("s/frame-000011.color.png", other);
    refused(&folder, layout, &["frame-000011.color.png", "is 16 × 12"]);
}
