//! Times of ARKit's frames, the lens of Hypersim's, and files that are told apart, each number written out.

use super::super::lens::of_opengl;
use super::lenses::{TURNED, close};
use super::*;

/// A turn by `angle` about a unit axis, by what it does to the three directions.
fn about(axis: [f64; 3], angle: f64) -> [[f64; 3]; 3] {
    let [x, y, z] = axis;
    let mut rows = [[0.0; 3]; 3];
    for j in 0..3 {
        let v: [f64; 3] = std::array::from_fn(|k| f64::from(u8::from(k == j)));
        let across = [y * v[2] - z * v[1], z * v[0] - x * v[2], x * v[1] - y * v[0]];
        let along = x * v[0] + y * v[1] + z * v[2];
        for i in 0..3 {
            rows[i][j] = v[i] * angle.cos()
                + across[i] * angle.sin()
                + axis[i] * along * (1.0 - angle.cos());
        }
    }
    rows
}

#[test]
fn frames_of_arkit_take_the_nearest_pose_and_lens_in_time() {
    let mini = Mini::new();
    let axis = [2.0 / 7.0, -3.0 / 7.0, 6.0 / 7.0];
    let line = |time: f64, angle: f64, x: f64| {
        let [a, b, c] = axis.map(|v| v * angle);
        format!("{time} {a} {b} {c} {x} -2 0.5\n")
    };
    let folder = "v/v_frames";
    for time in ["9.000", "10.000", "12.000", "13.000", "14.000"] {
        mini.picture(&format!("{folder}/lowres_wide/v_{time}.png"));
    }
    for time in ["9.000", "10.002", "12.000", "13.000", "14.003"] {
        mini.write(
            &format!("{folder}/lowres_wide_intrinsics/v_{time}.pincam"),
            "8 6 5 3 3.25 2.75",
        );
    }
    // Not by time; the one before and the one after are looked at, a tenth of a second away at most.
    let lines = [
        line(12.1, 0.9, 5.0),
        line(8.97, 0.7, 1.0),
        line(9.02, 0.0, 2.0),
        line(9.98, 0.5, 3.0),
        "\n".to_owned(),
        line(10.05, 0.6, 4.0),
        line(12.899, 0.8, 6.0),
        line(14.0, 0.8, 7.0),
    ];
    mini.write("v/lowres_wide.traj", lines.concat());
    let (frames, skipped, notes) = read(&mini.at("v"), FrameLayout::Arkitscenes);
    let (no_pose, no_lens) = (SkipReason::NoPose, SkipReason::NoIntrinsics);
    let named = [("v_13_000".to_owned(), no_pose), ("v_14_000".to_owned(), no_lens)];
    assert_eq!((skipped.as_slice(), notes.len()), (&named[..], 0));
    let want = [("v_9_000.png", 0.0, 2.0), ("v_10_000.png", 0.5, 3.0), ("v_12_000.png", 0.9, 5.0)];
    for (frame, (name, angle, x)) in frames.iter().zip(want) {
        let camera = &frame.camera;
        assert_eq!(camera.name, name);
        assert!(close(&camera.translation, &[x, -2.0, 0.5]), "{name}: {:?}", camera.translation);
        let turn = about(axis, angle);
        assert!(close(camera.rotation.as_flattened(), turn.as_flattened()), "{name}");
        assert!(close(&[camera.fx, camera.fy, camera.cx, camera.cy], &[5.0, 3.0, 3.25, 2.75]));
    }
    assert_eq!(frames.len(), 3);
    // A trajectory beside the pictures counts before one above; lines are numbered with the empty ones.
    mini.write(
        &format!("{folder}/lowres_wide.traj"),
        format!("\n{} 1\n", line(9.0, 0.0, 0.0).trim()),
    );
    refused(&mini.at("v"), FrameLayout::Arkitscenes, &["line 2 is not 7 numbers"]);
    mini.write(&format!("{folder}/lowres_wide_intrinsics/v_9.000.pincam"), "8 6 5 3 3.25");
    mini.write(&format!("{folder}/lowres_wide.traj"), line(9.0, 0.0, 0.0));
    refused(&mini.at("v"), FrameLayout::Arkitscenes, &["9.000.pincam", "has 5 numbers"]);
}

#[test]
fn hypersims_default_lens_is_checked_number_by_number() {
    let mini = Mini::new();
    mini.write("d/all/ai_1/_detail/metadata_scene.csv", "meters_per_asset_unit, 0.25\n");
    let at = |camera: &str, name: &str| {
        format!("d/all/ai_1/_detail/{camera}/camera_keyframe_{name}.hdf5")
    };
    let opengl = of_opengl(TURNED);
    let turn: Vec<f64> = opengl[..3].iter().flat_map(|row| row[..3].to_vec()).collect();
    for (camera, numbers) in [("cam_00", None), ("cam_01", Some([5.0, 3.0]))] {
        mini.hdf5(&at(camera, "orientations"), &turn.repeat(2), &[2, 3, 3]);
        mini.hdf5(&at(camera, "positions"), &[4.0, -8.0, 12.0, 0.0, 0.0, 4.0], &[2, 3]);
        if let Some(numbers) = numbers {
            mini.hdf5(&at(camera, "frame_indices"), &numbers, &[2]);
        }
        for number in [0, 1, 3, 5] {
            let preview = format!("d/all/ai_1/images/scene_{camera}_final_preview");
            mini.picture(&format!("{preview}/frame.000{number}.tonemap.jpg"));
            mini.write(&format!("{preview}/frame.000{number}.color.jpg"), "none");
        }
    }
    let (folder, layout) = (mini.at("d/all/ai_1"), FrameLayout::Hypersim);
    let (frames, ..) = read(&folder, layout);
    let names = frames.iter().map(|f| f.camera.name.as_str()).collect::<Vec<_>>();
    assert_eq!(names, ["cam_00_0000.png", "cam_00_0001.png", "cam_01_0005.png", "cam_01_0003.png"]);
    for (frame, place) in frames.iter().zip([[1.0, -2.0, 3.0], [0.0, 0.0, 1.0]].repeat(2)) {
        let camera = &frame.camera;
        // 4 / tan 30° for both axes of 8 × 6 pixels.
        let focal = 4.0 * 3f64.sqrt();
        assert!(close(&[camera.fx, camera.fy, camera.cx, camera.cy], &[focal, focal, 4.0, 3.0]));
        for (i, row) in camera.camera_to_world()[..3].iter().enumerate() {
            assert!(close(row, &[&TURNED[i][..3], &[place[i]]].concat()), "{row:?}");
        }
    }
    mini.hdf5(&at("cam_01", "frame_indices"), &[1.0], &[1]);
    refused(&folder, layout, &["frame_indices.hdf5", "[2], as positions are"]);
    std::fs::remove_file(mini.at(&at("cam_01", "frame_indices"))).unwrap();

    // Of pictures of 1000 × 500 the second factor is twice √3; a row that counts downward is a sign.
    let table = "d/metadata_camera_parameters.csv";
    let columns = [
        ("settings_output_img_width", "1000"),
        ("settings_output_img_height", "500"),
        ("use_camera_physical", "1"),
        ("M_proj_00", "1.73205"),
        ("M_proj_11", "-3.4641"),
        ("M_proj_01", "0"),
        ("M_proj_02", "0.0009"),
        ("M_proj_10", "0"),
        ("M_proj_12", "-0.0009"),
        ("note", "\"a, b\""),
    ];
    let write = |changes: &[(&str, &str)]| {
        let (mut head, mut row) = ("note2,scene_name".to_owned(), "\"x,y\",ai_1".to_owned());
        for (name, value) in columns {
            let value = changes.iter().find(|(n, _)| *n == name).map_or(value, |(_, v)| v);
            head += &format!(",{name}");
            row += &format!(",{value}");
        }
        mini.write(table, format!("{head}\nq,ai_0,{}\n{row}\n", "9,".repeat(9)));
    };
    write(&[]);
    assert!(read(&folder, layout).2.is_empty());
    for (name, value) in [
        ("M_proj_00", "1.7309"),
        ("M_proj_11", "1.73205"),
        ("M_proj_01", "0.0011"),
        ("M_proj_02", "-0.0011"),
        ("M_proj_10", "0.0011"),
        ("M_proj_12", "nan"),
    ] {
        write(&[(name, value)]);
        refused(&folder, layout, &[&format!("{name} is"), "of ai_1"]);
    }
    // Without the projection a physical camera is refused, and one that is not is taken.
    for (word, taken) in [("1", false), ("TRUE", false), ("0", true), ("False", true), ("", true)] {
        write(&[("M_proj_00", ""), ("use_camera_physical", word)]);
        assert_eq!(open_frames(&folder, layout).is_ok(), taken, "{word:?}");
    }
    // The table beside the scene counts before those farther up.
    write(&[("M_proj_00", "1")]);
    mini.write("d/all/metadata_camera_parameters.csv", "scene_name\nai_1\n");
    assert!(read(&folder, layout).2.is_empty());
    mini.write("d/all/ai_1/metadata_camera_parameters.csv", "name\n");
    refused(&folder, layout, &["ai_1/metadata_camera_parameters.csv", "no column scene_name"]);
}

#[test]
fn pictures_of_both_kinds_and_folders_of_streams_are_told_apart() {
    let mini = Mini::new();
    mini.write("s/camera-intrinsics.txt", "5 0 2.75 0 3 2.25 0 0 1");
    mini.write("s/frame-1.pose.txt", words(&TURNED));
    // The head of a JPEG of 6 rows and 8 columns.
    let jpeg = [0xff, 0xd8, 0xff, 0xc0, 0, 11, 8, 0, 6, 0, 8, 1, 1, 0x11, 0, 0xff, 0xd9];
    mini.write("s/frame-1.color.png", jpeg);
    let mut frames = open_frames(&mini.at("s"), FrameLayout::Rgbd).unwrap();
    assert_eq!(
        (format!("{frames:?}"), frames.len(), frames.is_empty()),
        ("Frames(1)".into(), 1, false)
    );
    let FrameRead::Frame(frame) = frames.read(0).unwrap() else { panic!("skipped") };
    assert_eq!((frame.camera.name.as_str(), frame.picture.as_slice()), ("frame-1.jpg", &jpeg[..]));
    assert_eq!((frame.camera.width, frame.camera.height), (8, 6));
    for (row, value) in [([3, 0], 0.5), ([3, 3], 2.0), ([0, 0], -0.6), ([0, 3], 2e12)] {
        mini.write("s/frame-1.pose.txt", words(&with(&TURNED, row, value)));
        let mut frames = open_frames(&mini.at("s"), FrameLayout::Rgbd).unwrap();
        let (name, reason) = ("frame-1".to_owned(), SkipReason::PoseNotRigid);
        assert_eq!(frames.read(0).unwrap(), FrameRead::Skipped { name, reason }, "{row:?}");
    }
    mini.write("r/sequence.zip", "");
    refused(&mini.at("r"), FrameLayout::ThreeRScan, &["still packed", "unpack sequence.zip"]);
    for name in ["m/a.sens", "m/b.sens"] {
        mini.write(name, "");
    }
    refused(&mini.at("m"), FrameLayout::Scannet, &["holds 2 .sens files", "b.sens"]);
}
