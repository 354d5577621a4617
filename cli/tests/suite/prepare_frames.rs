//! `prepare frames`: one room, filmed once and written as each benchmark writes its frames, becomes the same posed folder
//! by each, and that folder a scene, labels and a network.

use crate::collect_end_to_end::{Size, train, world};
use crate::support::*;
use hdf5_pure::FileBuilder;
use scenesplat::scene::Camera;
use scenesplat::scene::formats::cameras::open_cameras;
use scenesplat::scene::picture::{Channels, Picture, RgbPicture, Samples, read_png};
use serde_json::{Map, Value, json};

const WIDTH: u32 = 64;
const HEIGHT: u32 = 48;
/// Pixels; Hypersim's 60 degrees for this width.
const FOCAL: f64 = 55.425_625_842_204_07;
/// The principal point: the middle, counted from the corner of the first pixel.
const MIDDLE: [f64; 2] = [32.0, 24.0];

type Pose = [[f64; 4]; 4];

/// What one camera saw.
pub(crate) struct Shot {
    camera: Camera,
    /// A PNG.
    pub(crate) color: Vec<u8>,
    /// Millimeters along the axis, 0 where nothing is.
    depth: Vec<u16>,
}

impl Shot {
    fn pose(&self) -> Pose {
        self.camera.camera_to_world()
    }

    /// Camera to world, axes right, up, back.
    fn opengl(&self) -> Pose {
        self.pose().map(|[right, down, forward, place]| [right, -down, -forward, place])
    }

    /// The depth times a number as a PNG.
    fn depth_png(&self, times: u16) -> Vec<u8> {
        let samples = Samples::Sixteen(self.depth.iter().map(|v| v * times).collect());
        Picture::new(WIDTH, HEIGHT, Channels::Gray, samples).unwrap().encode_png().unwrap()
    }
}

/// Eight pictures of a small room, with depths, and what `collect-labels` and `train` want of it.
pub(crate) fn film(folder: &Folder) -> Vec<Shot> {
    let size = Size {
        gaussians: 4000,
        views: 8,
        picture: [WIDTH, HEIGHT],
        room: 0,
        grid_size: 0.15,
        epochs: 1,
    };
    world(folder.root(), &size);
    let mut cameras = open_cameras(&folder.path("cameras.json")).unwrap().cameras;
    for camera in &mut cameras {
        (camera.fx, camera.fy, camera.cx, camera.cy) = (FOCAL, FOCAL, MIDDLE[0], MIDDLE[1]);
    }
    folder.cameras("filmed.json", &cameras);
    let render = "render @scene --cameras @filmed.json --depth --out @shots --quiet";
    done(&line(&render.replace('@', &folder.at(""))));
    let shot = |camera: Camera| {
        let color = bytes(folder.path(&format!("shots/{}.png", camera.name)));
        let depth = read_png(&folder.path(&format!("shots/depth/{}.png", camera.name))).unwrap();
        let Samples::Sixteen(depth) = depth.into_samples() else { panic!("16 bits") };
        Shot { camera, color, depth }
    };
    cameras.into_iter().map(shot).collect()
}

/// Numbers as text.
fn words(values: &[f64]) -> String {
    values.iter().map(|v| format!("{v} ")).collect()
}

/// A matrix of the lens, three rows of numbers; `half` is what the file's count of pixels is behind ours.
fn lens(half: f64) -> [[f64; 3]; 3] {
    [[FOCAL, 0.0, MIDDLE[0] - half], [0.0, FOCAL, MIDDLE[1] - half], [0.0, 0.0, 1.0]]
}

/// The same in a matrix of four rows.
fn lens_of_four(half: f64) -> Pose {
    let [[fx, _, cx], [_, fy, cy], _] = lens(half);
    [[fx, 0.0, cx, 0.0], [0.0, fy, cy, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
}

/// One `.sens` file: PNG colors, raw depths of 1000 steps per meter; the last frame has lost its pose.
fn sens(folder: &Folder, shots: &[Shot]) {
    let matrix = |rows: Pose| -> Vec<u8> {
        rows.as_flattened().iter().flat_map(|v| (*v as f32).to_le_bytes()).collect()
    };
    let lens = matrix(lens_of_four(0.5));
    let still = matrix([0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| f64::from(u8::from(i == j)))));
    let mut out = [&4u32.to_le_bytes()[..], &4u64.to_le_bytes(), b"Test"].concat();
    [&lens, &still, &lens, &still].into_iter().for_each(|bytes| out.extend(bytes));
    [1, 0, WIDTH, HEIGHT, WIDTH, HEIGHT].iter().for_each(|v| out.extend(v.to_le_bytes()));
    out.extend(1000f32.to_le_bytes());
    out.extend((shots.len() as u64 + 1).to_le_bytes());
    let lost = [[f64::NEG_INFINITY; 4]; 4];
    let poses = shots.iter().map(Shot::pose).chain([lost]);
    for (pose, shot) in poses.zip(shots.iter().chain(shots.first())) {
        let depth: Vec<u8> = shot.depth.iter().flat_map(|v| v.to_le_bytes()).collect();
        out.extend(matrix(pose));
        let counts = [0, 0, shot.color.len() as u64, depth.len() as u64];
        counts.iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(&shot.color);
        out.extend(depth);
    }
    folder.write("scan/scene0000_00.sens", out);
}

/// ScanNet as its tool exports it.
fn exported(folder: &Folder, shots: &[Shot]) {
    for kind in ["color", "depth"] {
        let path = format!("scan/intrinsic/intrinsic_{kind}.txt");
        folder.write(&path, words(lens_of_four(0.5).as_flattened()));
    }
    for (number, shot) in shots.iter().enumerate() {
        folder.write(&format!("scan/color/{number}.jpg"), &shot.color);
        folder.write(&format!("scan/depth/{number}.png"), shot.depth_png(1));
        folder.write(&format!("scan/pose/{number}.txt"), words(shot.pose().as_flattened()));
    }
}

/// The frames of ScanNet++'s phone.
fn phone(folder: &Folder, shots: &[Shot]) {
    let mut list = Map::new();
    for (number, shot) in shots.iter().enumerate() {
        let name = format!("frame_{number:06}");
        folder.write(&format!("scan/iphone/rgb/{name}.jpg"), &shot.color);
        folder.write(&format!("scan/iphone/depth/{name}.png"), shot.depth_png(1));
        let pose = shot.pose();
        list.insert(name, json!({"pose": pose, "aligned_pose": pose, "intrinsic": lens(0.0)}));
    }
    folder.write("scan/iphone/pose_intrinsic_imu.json", Value::Object(list).to_string());
}

/// ARKitScenes: a turn is an axis times an angle, world to camera.
fn arkitscenes(folder: &Folder, shots: &[Shot]) {
    let mut trajectory = String::new();
    for (number, shot) in shots.iter().enumerate() {
        let Camera { rotation: r, translation: t, .. } = &shot.camera;
        let angle = ((r[0][0] + r[1][1] + r[2][2] - 1.0) / 2.0).acos();
        let axis = [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]];
        let turn = axis.map(|v| v / (2.0 * angle.sin()) * angle);
        let time = format!("{}.500", 100 + number);
        trajectory += &format!("{time} {}{}\n", words(&turn), words(t));
        folder.write(&format!("scan/lowres_wide/41_{time}.png"), &shot.color);
        folder.write(&format!("scan/lowres_depth/41_{time}.png"), shot.depth_png(1));
        let pincam =
            words(&[f64::from(WIDTH), f64::from(HEIGHT), FOCAL, FOCAL, MIDDLE[0], MIDDLE[1]]);
        folder.write(&format!("scan/lowres_wide_intrinsics/41_{time}.pincam"), pincam);
    }
    folder.write("scan/lowres_wide.traj", trajectory);
}

/// Matterport3D: rows count from the lower edge, a step of depth is a quarter of a millimeter.
fn matterport(folder: &Folder, shots: &[Shot]) {
    let [cx, cy] = [MIDDLE[0], f64::from(HEIGHT) - MIDDLE[1]];
    let mut list = format!("intrinsics_matrix {FOCAL} 0 {cx} 0 {FOCAL} {cy} 0 0 1\n");
    for (number, shot) in shots.iter().enumerate() {
        let [depth, color] = [format!("a_d0_{number}.png"), format!("a_i0_{number}.jpg")];
        list += &format!("scan {depth} {color} {}\n", words(shot.opengl().as_flattened()));
        folder.write(&format!("scan/undistorted_color_images/{color}"), &shot.color);
        folder.write(&format!("scan/undistorted_depth_images/{depth}"), shot.depth_png(4));
    }
    folder.write("scan/undistorted_camera_parameters/scan.conf", list);
}

fn three_r_scan(folder: &Folder, shots: &[Shot]) {
    let lens = words(lens_of_four(0.5).as_flattened());
    let info = format!(
        "m_colorWidth = {WIDTH}\nm_colorHeight = {HEIGHT}\nm_depthWidth = {WIDTH}\nm_depthHeight = {HEIGHT}\n\
         m_depthShift = 1000\nm_frames.size = {}\nm_calibrationColorIntrinsic = {lens}\nm_calibrationDepthIntrinsic = {lens}\n",
        shots.len()
    );
    folder.write("scan/sequence/_info.txt", info);
    for (number, shot) in shots.iter().enumerate() {
        let at = |ending: &str| format!("scan/sequence/frame-{number:06}.{ending}");
        folder.write(&at("color.jpg"), &shot.color);
        folder.write(&at("pose.txt"), words(shot.pose().as_flattened()));
        let mut pgm = format!("P5 {WIDTH} {HEIGHT} 65535\n").into_bytes();
        pgm.extend(shot.depth.iter().flat_map(|v| v.to_be_bytes()));
        folder.write(&at("depth.pgm"), pgm);
    }
}

/// Hypersim: a unit is half a meter; depths are distances to the camera.
fn hypersim(folder: &Folder, shots: &[Shot]) {
    let hdf5 = |path: &str, values: &[f64], shape: &[u64]| {
        let path = folder.write(path, "");
        let mut file = FileBuilder::new();
        file.create_dataset("dataset").with_data(values).with_shape(shape);
        file.write(path).unwrap();
    };
    folder.write(
        "scan/_detail/metadata_scene.csv",
        "parameter_name,parameter_value\nmeters_per_asset_unit,0.5\n",
    );
    let (mut turns, mut places) = (Vec::new(), Vec::new());
    for (number, shot) in shots.iter().enumerate() {
        for [x, y, z, place] in &shot.opengl()[..3] {
            turns.extend([*x, *y, *z]);
            places.push(place * 2.0);
        }
        let distance = |(at, depth): (usize, &u16)| {
            let [x, y] = [at % WIDTH as usize, at / WIDTH as usize].map(|v| v as f64 + 0.5);
            let [u, v] = [(x - MIDDLE[0]) / FOCAL, (y - MIDDLE[1]) / FOCAL];
            let along = if *depth == 0 { f64::NAN } else { f64::from(*depth) / 1000.0 };
            along * (1.0 + u * u + v * v).sqrt()
        };
        let distances: Vec<f64> = shot.depth.iter().enumerate().map(distance).collect();
        let images = "scan/images/scene_cam_00";
        let depth = format!("{images}_geometry_hdf5/frame.{number:04}.depth_meters.hdf5");
        hdf5(&depth, &distances, &[HEIGHT.into(), WIDTH.into()]);
        let color = format!("{images}_final_preview/frame.{number:04}.tonemap.jpg");
        folder.write(&color, &shot.color);
    }
    let count = shots.len() as u64;
    hdf5("scan/_detail/cam_00/camera_keyframe_orientations.hdf5", &turns, &[count, 3, 3]);
    hdf5("scan/_detail/cam_00/camera_keyframe_positions.hdf5", &places, &[count, 3]);
}

fn replica(folder: &Folder, shots: &[Shot]) {
    let [[_, _, cx], [_, _, cy], _] = lens(0.5);
    let lens = json!({"w": WIDTH, "h": HEIGHT, "fx": FOCAL, "fy": FOCAL, "cx": cx, "cy": cy, "scale": 1000.0});
    folder.write("scan/cam_params.json", json!({ "camera": lens }).to_string());
    let mut trajectory = String::new();
    for (number, shot) in shots.iter().enumerate() {
        trajectory += &format!("{}\n", words(shot.pose().as_flattened()));
        folder.write(&format!("scan/results/frame{number:06}.jpg"), &shot.color);
        folder.write(&format!("scan/results/depth{number:06}.png"), shot.depth_png(1));
    }
    folder.write("scan/traj.txt", trajectory);
}

/// Folders as 3DMatch's.
pub(crate) fn rgbd(folder: &Folder, shots: &[Shot]) {
    folder.write("scan/camera-intrinsics.txt", words(lens(0.5).as_flattened()));
    for (number, shot) in shots.iter().enumerate() {
        let at = |ending: &str| format!("scan/frame-{number:06}.{ending}");
        folder.write(&at("color.png"), &shot.color);
        folder.write(&at("pose.txt"), words(shot.pose().as_flattened()));
        folder.write(&at("depth.png"), shot.depth_png(1));
    }
}

/// That `frames` holds the shots: poses, lens, pictures to the byte, depths to the millimeter.
fn holds(folder: &Folder, shots: &[Shot], layout: &str) {
    let found = open_cameras(&folder.path("frames/cameras.json")).unwrap().cameras;
    assert_eq!(found.len(), shots.len(), "{layout}");
    for (found, shot) in found.iter().zip(shots) {
        let name = &found.name;
        let near = |a: f64, b: f64| (a - b).abs() < 1e-4;
        let lens = [found.fx, found.fy, found.cx, found.cy];
        let expected = [FOCAL, FOCAL, MIDDLE[0], MIDDLE[1]];
        assert!((0..4).all(|k| near(lens[k], expected[k])), "{layout} {name}: {lens:?}");
        let (pose, expected) = (found.camera_to_world(), shot.pose());
        let mut pairs = pose.as_flattened().iter().zip(expected.as_flattened());
        assert!(pairs.all(|(a, b)| near(*a, *b)), "{layout} {name}: {pose:?}, not {expected:?}");
        assert!(bytes(folder.path(&format!("frames/images/{name}"))) == shot.color, "{layout}");
        let depth = read_png(&folder.path(&format!("frames/depth/{name}"))).unwrap();
        let Samples::Sixteen(depth) = depth.into_samples() else { panic!("16 bits") };
        let off = depth.iter().zip(&shot.depth).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(off <= Some(1) && depth.len() == shot.depth.len(), "{layout} {name}: {off:?} mm");
    }
}

/// From each benchmark's files to a network that is measured, by commands alone.
#[test]
fn frames_of_benchmarks_become_scenes_labels_and_networks() {
    let folder = Folder::new();
    let run = |words: &str| line(&words.replace('@', &folder.at("")));
    let shots = film(&folder);
    assert!(shots.iter().any(|shot| shot.depth.iter().any(|v| *v > 0)), "there is depth");
    type Write = fn(&Folder, &[Shot]);
    let layouts: [(&str, Write); 9] = [
        ("scannet", sens),
        ("scannet", exported),
        ("scannetpp", phone),
        ("arkitscenes", arkitscenes),
        ("matterport3d", matterport),
        ("3rscan", three_r_scan),
        ("hypersim", hypersim),
        ("replica", replica),
        ("rgbd", rgbd),
    ];
    for (layout, write) in layouts {
        write(&folder, &shots);
        let output = run(&format!("prepare frames @scan --layout {layout} --out @frames"));
        done(&output);
        let frames = "--cameras @frames/cameras.json --images @frames/images";
        let next =
            format!("next: scenesplat optimise {frames} --depth @frames/depth --out @frames-scene");
        has(&stdout(&output), &[&next.replace('@', &folder.at(""))]);
        let report = json(folder.path("frames/frames.json"));
        assert_eq!((&report["written"], &report["with_depth"]), (&8.into(), &8.into()), "{layout}");
        if folder.path("scan/scene0000_00.sens").is_file() {
            let lost = ["8 frames", "of 9 chosen", "1 frames were skipped (1: pose not finite)"];
            has(&stderr(&output), &lost);
            assert_eq!(report["skipped"][0]["frame"], "000008");
        }
        holds(&folder, &shots, layout);

        // What follows reads the frames alone, which are the same for all.
        if ["scannet", "hypersim", "rgbd"].contains(&layout) {
            teach(&folder, layout, frames);
        }
        let made = ["scan", "frames", "made", "labels", "train", "run", "score"];
        for made in made.map(|name| folder.path(name)).iter().filter(|made| made.is_dir()) {
            std::fs::remove_dir_all(made).unwrap();
        }
    }
}

/// Frames become a scene, labels, and a network.
fn teach(folder: &Folder, layout: &str, frames: &str) {
    let run = |words: &str| line(&words.replace('@', &folder.at("")));
    let optimise = "--depth @frames/depth --initial 1500 --cap 1500 --steps 20 --test-every 0";
    done(&run(&format!("optimise {frames} {optimise} --out @made --quiet")));
    done(&run(&format!("collect-labels @made/scene.ply {frames} --out @labels {SMALL_PICTURE}")));
    std::fs::create_dir(folder.path("train")).unwrap();
    done(&run("convert @made/scene.ply @train/room"));
    for name in ["lang_feat.npy", "valid_feat_mask.npy"] {
        std::fs::copy(folder.path("labels").join(name), folder.path("train/room").join(name))
            .unwrap();
    }
    let f_miou = train(folder.root(), 0.15, 1);
    assert!((0.0..=1.0).contains(&f_miou), "{layout}: {f_miou}");
}

#[test]
fn frames_are_chosen_and_what_does_not_fit_is_refused() {
    let folder = Folder::new();
    let run = |words: &str| line(&format!("prepare frames {words}").replace('@', &folder.at("")));
    folder.write("scan/camera-intrinsics.txt", "40 0 19.5\n0 40 14.5\n0 0 1\n");
    let png = RgbPicture::filled(40, 30, [9; 3]).encode_png().unwrap();
    for number in 0..9 {
        folder.write(&format!("scan/frame-{number}.color.png"), &png);
        folder.write(&format!("scan/frame-{number}.pose.txt"), "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1");
    }
    let said = told(&run("@scan --layout rgbd --out @few --every 2 --max-frames 2"));
    has(&said, &["2 frames", "2 chosen, 9 in all", "2 of 2 frames have no depth"]);
    let names = open_cameras(&folder.path("few/cameras.json")).unwrap().cameras;
    assert_eq!([&names[0].name, &names[1].name], ["frame-0.png", "frame-4.png"]);
    assert!(!folder.path("few/depth").exists());
    // Again into the same folder; not into one of others.
    done(&run("@scan --layout rgbd --out @few"));
    folder.write("other/depth/a.png", &png);
    let cases = [
        ("@scan --layout rgbd --out @other", 2, "other/depth is there"),
        ("@scan --layout nuscenes --out @out", 2, "no layout; there are: scannet, scannetpp"),
        ("@scan --layout replica --out @out", 1, "cam_params.json"),
        ("@scan --layout rgbd --every 0 --out @out", 2, "--every"),
    ];
    all_refused(cases, run);
    for number in 0..9 {
        folder.write(&format!("scan/frame-{number}.pose.txt"), "nan ".repeat(16));
    }
    let none = run("@scan --layout rgbd --out @out");
    refused(&none, 1, &["none of 9 frames can be used (9: pose not finite)"]);
    assert!(!folder.path("out/cameras.json").exists());
}
