//! `lift-labels`: both layouts of segments, what is written, what is refused.

use crate::support::*;
use half::f16;
use scenesplat::scene::formats::npy_writer::write_npy;
use scenesplat::scene::picture::{Channels, Picture, Samples};
use scenesplat::scene::{Camera, GaussianScene, TextTable};
use std::process::Output;

const W: usize = 64;
const H: usize = 48;

/// Two blobs left and right, and one behind all cameras.
fn scene() -> GaussianScene {
    balls(vec![[-1.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 0.0, -5.0]], 0.2, 2.0)
}

fn at(name: &str, x: f64) -> Camera {
    camera(name, [W as u32, H as u32], [x, 0.0, 0.0])
}

/// A scene, its cameras and their segments.
struct World(Folder);

impl World {
    /// The left half is segment 0, the right half segment 1, at level 1 all is segment 2.
    fn new() -> Self {
        let folder = Folder::new();
        folder.scene("room.ply", &scene());
        let cameras = [at("a.png", 0.0), at("b.png", 0.1), at("lonely.png", 0.0)];
        folder.cameras("cameras.json", &cameras);
        let halves = (0..W * H).map(|i| i32::from(i % W >= W / 2));
        let ids: Vec<i32> = halves.chain(vec![2; W * H]).collect();
        let features = [3.0f32, 0.0, 0.0, 4.0, 1.0, 1.0].map(f16::from_f32);
        std::fs::create_dir(folder.path("segments")).unwrap();
        for frame in ["a", "b"] {
            write_npy(&folder.path(&format!("segments/{frame}_s.npy")), &[2, H, W], &ids).unwrap();
            let table = folder.path(&format!("segments/{frame}_f.npy"));
            write_npy(&table, &[3, 2], &features).unwrap();
        }
        Self(folder)
    }

    /// A blob right behind another one for two cameras, beside it for two others; all segments are true.
    fn hidden() -> Self {
        let folder = Folder::new();
        let mut two = balls(vec![[0.0, 0.0, 3.0], [0.0, 0.0, 6.0]], 0.4, 4.0);
        two.log_scale[1] = [0.1f32.ln(); 3];
        folder.scene("room.ply", &two);
        // The near blob is left of column 12, right of column 51, or everywhere.
        let pictures = [("a", -2.0, 0..12), ("b", 2.0, 52..W), ("c", 0.0, 0..W), ("d", 0.02, 0..W)];
        let cameras = pictures.clone().map(|(name, x, _)| at(&format!("{name}.png"), x));
        folder.cameras("cameras.json", &cameras);
        std::fs::create_dir(folder.path("segments")).unwrap();
        for (frame, _, near) in pictures {
            let ids: Vec<i32> = (0..W * H).map(|i| i32::from(!near.contains(&(i % W)))).collect();
            write_npy(&folder.path(&format!("segments/{frame}_s.npy")), &[H, W], &ids).unwrap();
            let table = folder.path(&format!("segments/{frame}_f.npy"));
            write_npy(&table, &[2, 2], &[1.0f32, 0.0, 0.0, 1.0]).unwrap();
        }
        Self(folder)
    }

    fn lift(&self, more: &str) -> Output {
        let [scene, cameras, segments, out] =
            ["room.ply", "cameras.json", "segments", "out"].map(|name| self.0.at(name));
        run!("lift-labels {scene} --cameras {cameras} --segments {segments} --out {out} {more}")
    }

    fn values(&self, name: &str) -> Vec<f32> {
        floats(self.0.path("out").join(name))
    }

    fn receipt(&self) -> String {
        text(self.0.path("out/receipt.json"))
    }
}

#[test]
fn labels_reach_their_gaussians() {
    let world = World::new();
    has(&told(&world.lift("")), &["3 cameras, 2 frames, 2 with both"]);
    let file = npy(world.0.path("out/lang_feat.npy"));
    assert_eq!((file.shape(), file.ty().size()), (&[3, 2][..], 2));
    assert_eq!(file.read_f32().unwrap(), [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    assert_eq!(world.values("valid_feat_mask.npy"), [1.0, 1.0, 0.0]);
    assert_eq!(world.values("views.npy"), [2.0, 2.0, 0.0]);
    let confidence = world.values("confidence.npy");
    assert!(confidence[0] > 0.999 && confidence[1] > 0.999 && confidence[2] == 0.0);
    let coverage = world.values("coverage.npy");
    assert!(coverage[0] > 10.0 && coverage[1] > 10.0 && coverage[2] == 0.0, "{coverage:?}");
    // Nothing hides anything: depth agreement stays off.
    let parts = ["alpha-weighted", "disagreement[0]", "auto: off"];
    has(&world.receipt(), &parts);
    has(&world.receipt(), &["2 of 3 cameras have a map of segments; missing: 1 (lonely.png"]);
    assert!(world.0.path("out/preview.png").is_file());

    // The other rule, all guards and a tiny memory still give the same here.
    for more in [
        "--robust on --depth render --erode 1 --max-memory 50kB",
        "--rule centre-pixel --unnormalised",
    ] {
        done(&world.lift(more));
        assert_eq!(world.values("lang_feat.npy")[..4], [1.0, 0.0, 0.0, 1.0], "{more}");
    }
    done(&world.lift("--coverage 1e6"));
    assert_eq!(world.values("valid_feat_mask.npy"), [0.0; 3]);
    assert_eq!(world.values("lang_feat.npy"), [0.0; 6]);
}

#[test]
fn the_index_form_has_a_number_for_each_gaussian_and_a_feature_for_each_cluster() {
    let world = World::new();
    let out = |name: &str| world.0.path("out").join(name);
    has(
        &told(&world.lift("--form index")),
        &["2 of 3 Gaussians have one of 2 clusters of 4 segments"],
    );
    let index = npy(out("segment_index.npy"));
    assert_eq!((index.shape(), index.ty().size()), (&[3][..], 2));
    assert_eq!(index.read_i64().unwrap(), [0, 1, 65_535]);
    let table = npy(out("segment_features.npy"));
    assert_eq!((table.shape(), table.ty().size()), (&[2, 2][..], 2));
    assert_eq!(table.read_f32().unwrap(), [1.0, 0.0, 0.0, 1.0]);
    assert_eq!(world.values("views.npy"), [2.0, 2.0, 0.0]);
    let confidence = world.values("confidence.npy");
    assert!(confidence[0] > 0.999 && confidence[1] > 0.999 && confidence[2] == 0.0);
    assert!(!out("lang_feat.npy").exists() && !out("valid_feat_mask.npy").exists());
    has(&world.receipt(), &["clusters[0]", "segment_features.npy"]);
    let files = ["segment_index.npy", "segment_features.npy", "confidence.npy", "coverage.npy"];
    let read = || files.map(|name| bytes(out(name)));
    let first = read();
    done(&world.lift("--form index --threads 1 --max-memory 50kB"));
    assert_eq!(read(), first);
    // What labels a Gaussian is chosen as before; one level or several.
    done(&world.lift("--form index --coverage 1e6"));
    assert_eq!(npy(out("segment_index.npy")).read_i64().unwrap(), [65_535; 3]);
    assert_eq!(npy(out("segment_features.npy")).shape(), [0, 2]);
    done(&world.lift("--form index --level 1,0"));
    assert_eq!(npy(out("level-1/segment_index.npy")).read_i64().unwrap(), [0, 0, 65_535]);
    assert_eq!(bytes(out("level-0/segment_index.npy")), first[0]);
    // A row that was left out has no number.
    let mut scene = scene().select_rows(&[0, 0, 1, 2]).unwrap();
    scene.coord[0][0] = f32::NAN;
    world.0.scene("room.ply", &scene);
    done(&world.lift("--form index"));
    assert_eq!(npy(out("segment_index.npy")).read_i64().unwrap(), [65_535, 0, 1, 65_535]);
}

#[test]
fn both_forms_give_the_same_labels_and_do_not_mix() {
    let world = World::new();
    let texts = TextTable::from_rows(
        ["left", "right"].map(str::to_owned).to_vec(),
        vec![0.9, 0.1, 0.2, 0.8],
        2,
    );
    world.0.write("texts.safetensors", texts.unwrap().to_safetensors().unwrap());
    let labels = |file: &str| {
        let [scene, features, texts, out] =
            ["room.ply", file, "texts.safetensors", "seen"].map(|name| world.0.at(name));
        let words = format!("segment {scene} --features {features} --text {texts} --vote-k 1");
        done(&run!("{words} --out {out}"));
        npy(world.0.path("seen/labels.npy")).read_i64().unwrap()
    };
    done(&world.lift(""));
    assert_eq!(labels("out/lang_feat.npy"), [0, 1, -1]);
    // Features of two forms in one folder would be of two runs.
    refused(&world.lift("--form index"), 2, &["lang_feat.npy", "remove it"]);
    for name in ["lang_feat.npy", "valid_feat_mask.npy"] {
        std::fs::remove_file(world.0.path("out").join(name)).unwrap();
    }
    done(&world.lift("--form index"));
    assert_eq!(labels("out/segment_index.npy"), [0, 1, -1]);
    has(&text(world.0.path("seen/receipt.json")), &["segment_features.npy"]);
    refused(&world.lift(""), 2, &["segment_index.npy", "remove it"]);
    // What is about the features of single Gaussians has no effect on clusters.
    for flag in
        ["--robust on", "--robust-rule heaviest-group", "--view-exponent 0", "--unnormalised"]
    {
        let name = flag.split(' ').next().unwrap();
        refused(&world.lift(&format!("--form index {flag}")), 2, &[name, "--form index has none"]);
    }
    refused(&world.lift("--form index --coverage nan"), 2, &["coverage"]);
}

#[test]
fn what_shines_through_does_not_take_the_name_of_what_hides_it() {
    let world = World::hidden();
    let said = told(&world.lift("--depth off --robust off"));
    assert!(!said.contains("depth agreement"), "{said}");
    let mixed = world.values("lang_feat.npy");
    assert!(mixed[2] > 0.02, "{mixed:?}");
    // What the measurement finds is done, said and recorded.
    has(&told(&world.lift("--robust off")), &["depth agreement: render"]);
    let agreeing = world.values("lang_feat.npy");
    assert_eq!(agreeing[2..], [0.0, 1.0]);
    has(&world.receipt(), &["auto: render", "depth_kept"]);
    done(&world.lift("--depth render --robust off"));
    assert_eq!(world.values("lang_feat.npy"), agreeing);
}

#[test]
fn levels_get_folders_of_their_own() {
    let world = World::new();
    done(&world.lift("--level 1,0"));
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let all = world.values("level-1/lang_feat.npy");
    assert!(all[..4].iter().all(|v| (v - half).abs() < 1e-3), "{all:?}");
    assert_eq!(world.values("level-0/lang_feat.npy"), [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
}

#[test]
fn rows_that_are_left_out_stay_in_the_files() {
    let world = World::new();
    let mut scene = scene().select_rows(&[0, 0, 1, 2]).unwrap();
    scene.coord[0][0] = f32::NAN;
    world.0.scene("room.ply", &scene);
    done(&world.lift(""));
    assert_eq!(world.values("lang_feat.npy"), [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    assert_eq!(world.values("views.npy"), [0.0, 2.0, 2.0, 0.0]);
}

#[test]
fn pictures_of_ids_with_one_table() {
    let world = World::new();
    std::fs::remove_dir_all(world.0.path("segments")).unwrap();
    let ids = (0..W * H / 4).map(|i| u8::from(i % (W / 2) >= W / 4)).collect();
    let (w, h) = (W as u32 / 2, H as u32 / 2);
    let map = Picture::new(w, h, Channels::Gray, Samples::Eight(ids)).unwrap();
    world.0.write("segments/b.png", map.encode_png().unwrap());
    let table = world.0.path("segments/features.npy");
    write_npy(&table, &[2, 2], &[1.0f32, 0.0, 0.0, 1.0]).unwrap();
    done(&world.lift(""));
    assert_eq!(world.values("lang_feat.npy"), [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    // A measured depth: the left blob is where it says, the right one is not.
    let depth = world.0.path("depth/b.npy");
    std::fs::create_dir(world.0.path("depth")).unwrap();
    let far = |i: usize| if i % W < W / 2 { 3.0f32 } else { 9.0 };
    let metres: Vec<f32> = (0..W * H).map(far).collect();
    write_npy(&depth, &[H, W], &metres).unwrap();
    let by_depth = format!("--depth {}", world.0.at("depth"));
    done(&world.lift(&by_depth));
    assert_eq!(world.values("valid_feat_mask.npy"), [1.0, 0.0, 0.0]);
    write_npy(&depth, &[2, W], &metres[..2 * W]).unwrap();
    has(&stderr(&world.lift(&by_depth)), &["b.npy", "is 64 × 2, its picture 64 × 48"]);
    // The same as render writes it, of half the size, for the name that COLMAP gives masks.
    std::fs::remove_file(depth).unwrap();
    let half = |i: usize| (500.0 * metres[(i / (W / 2)) * 2 * W + i % (W / 2) * 2]) as u16;
    let steps = Samples::Sixteen((0..W * H / 4).map(half).collect());
    let picture = Picture::new(w, h, Channels::Gray, steps).unwrap();
    world.0.write("depth/b.png.png", picture.encode_png().unwrap());
    let said = told(&world.lift(&format!("{by_depth} --depth-scale 500")));
    has(&said, &["1 of 1 cameras have a depth; missing: 0"]);
    assert_eq!(world.values("valid_feat_mask.npy"), [1.0, 0.0, 0.0]);
    std::fs::remove_file(world.0.path("depth/b.png.png")).unwrap();
    refused(&world.lift(&by_depth), 1, &["--depth", "holds the depth of none of the 1 cameras"]);
}

/// Lenses of a rig number their frames alike; their maps are in folders.
#[test]
fn frames_of_a_rig_are_found_in_their_folders() {
    let world = World::new();
    world.0.cameras("cameras.json", &[at("rig/left/a.jpg", 0.0), at("rig/right/a.jpg", 0.1)]);
    // Flat, nobody knows whose it is.
    refused(&world.lift(""), 1, &["a belongs to two cameras", "rig/left/a.jpg", "rig/right/a.jpg"]);
    for lens in ["left", "right"] {
        for name in ["a_s.npy", "a_f.npy"] {
            world.0.write(
                &format!("rigged/{lens}/{name}"),
                bytes(world.0.path("segments").join(name)),
            );
        }
    }
    std::fs::remove_dir_all(world.0.path("segments")).unwrap();
    std::fs::rename(world.0.path("rigged"), world.0.path("segments")).unwrap();
    has(&told(&world.lift("")), &["2 of 2 cameras have a map of segments; missing: 0"]);
    assert_eq!(world.values("views.npy"), [2.0, 2.0, 0.0]);
}

#[test]
fn what_does_not_fit_is_refused_before_anything_is_written() {
    let world = World::new();
    let refused = |more: &str, code: i32, parts: &[&str]| {
        refused(&world.lift(more), code, parts);
        assert!(!world.0.path("out/lang_feat.npy").exists());
    };
    refused("--view-exponent 2", 2, &["view exponent", "is 2"]);
    refused("--coverage nan", 2, &["coverage"]);
    refused("--level 7", 2, &["--level", "\"7\"", "0 to 3"]);
    refused("--max-memory 1kB", 2, &["--max-memory 1.0 kB", "at least 49.2 kB"]);
    refused("--max-memory 60kB --level 0,1,2", 2, &["at least 73.7 kB"]);
    refused("--level 3", 1, &["a_s.npy", "level 3"]);
    world.0.cameras("cameras.json", &[at("x.png", 0.0)]);
    refused("", 1, &["segments", "x.png"]);
    world.0.cameras("cameras.json", &[Camera { width: 70, ..at("a.png", 0.0) }]);
    refused("", 1, &["a_s.npy", "is 64×48, its camera 70×48"]);
}

#[test]
fn photos_are_looked_at_and_change_nothing_unless_they_are_blurred() {
    let world = World::new();
    let [scene, cameras] = ["room.ply", "cameras.json"].map(|name| world.0.at(name));
    let render = |out: &str, more: &str| {
        let out = world.0.at(out);
        done(&run!("render {scene} --cameras {cameras} --out {out} {more}"));
    };
    render("photos", "");
    let files = ["lang_feat.npy", "confidence.npy", "coverage.npy", "views.npy"];
    let read = || files.map(|f| bytes(world.0.path("out").join(f)));
    done(&world.lift(""));
    let plain = read();
    let photos = format!("--photos {}", world.0.at("photos"));
    let said = told(&world.lift(&format!("{photos} --frame-weights auto")));
    has(&said, &["blur: ", "light: ", "coverage: ", "0 of 2 pictures count less"]);
    assert_eq!(read(), plain);
    has(&world.receipt(), &["photos/blur", "frame_weights"]);
    // Wrong folders and sizes are named.
    render("large", "--size 128x96");
    for (folder, part) in
        [("segments", "holds the photo of none of the 2 cameras"), ("large", "[128, 96]")]
    {
        refused(&world.lift(&format!("--photos {}", world.0.at(folder))), 1, &[part]);
    }
    refused(&world.lift("--frame-weights auto"), 2, &["--photos"]);
}

#[test]
fn glass_is_looked_for_and_other_effects_are_refused_by_name() {
    let world = World::new();
    done(&world.lift(""));
    let plain = world.values("lang_feat.npy");
    has(&world.receipt(), &["\"effect\": \"glass\""]);
    // Three blobs are no room: a wish that cannot be fulfilled is said.
    for (effect, part) in [("off", "off by choice"), ("on", "no pane was found")] {
        done(&world.lift(&format!("--effect glass={effect}")));
        assert_eq!(world.values("lang_feat.npy"), plain);
        has(&world.receipt(), &[part]);
    }
    // The decisions of an earlier run are read, if there is one.
    let before = world.0.write("before.json", world.receipt());
    let before_flag = format!("--effect-before {before}");
    done(&world.lift(&before_flag));
    has(&world.receipt(), &["effects before"]);
    world.0.write("before.json", "{}");
    refused(&world.lift(&before_flag), 2, &[]);
    refused(&world.lift("--effect holes=on"), 2, &["acted on here: glass"]);
}
