//! `scenesplat convert`, and what other commands make of its files.

use crate::support::*;
use scenesplat::scene::GaussianScene;
use std::collections::BTreeMap;
use std::path::Path;

/// Every format that can be written, by the name of its file.
const TARGETS: [&str; 8] =
    ["a.ply", "a.compressed.ply", "a.spz", "a.splat", "a.glb", "a.sog", "sog/meta.json", "folder"];

/// The largest difference between two lists of positions, on one axis: infinite where only one is no number.
fn apart(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
    assert_eq!(a.len(), b.len());
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    // `f32::max` passes NaN over.
    let between = |(a, b): (&f32, &f32)| match (a - b).abs() {
        _ if a.to_bits() == b.to_bits() => 0.0,
        far if far.is_nan() => f32::INFINITY,
        far => far,
    };
    pairs.map(between).fold(0.0, f32::max)
}

fn moved(scene: &GaussianScene, by: impl Fn([f32; 3]) -> [f32; 3]) -> Vec<[f32; 3]> {
    scene.coord.iter().map(|p| by(*p)).collect()
}

#[test]
fn labels_go_through_every_format() {
    let folder = Folder::new();
    let (from, report) = (asset_at("room.ply"), folder.at("report.json"));
    let room = read(&from);
    // Formats may reorder rows, so the labels are compared by the center of each class.
    let centers = |scene: &GaussianScene| {
        let mut sums = BTreeMap::<i32, (usize, [f64; 3])>::new();
        for (p, &label) in scene.coord.iter().zip(scene.segment.as_ref().unwrap()) {
            let entry = sums.entry(label).or_default();
            entry.0 += 1;
            (0..3).for_each(|i| entry.1[i] += f64::from(p[i]));
        }
        sums
    };
    let due = centers(&room);
    for name in TARGETS {
        let (to, back) = (folder.at(name), folder.at("back.ply"));
        done(&run!("convert {from} {to} --json {report}"));
        let scene = read(&to);
        assert_eq!(scene.len(), room.len(), "{name}");
        let got = centers(&scene);
        assert!(got.keys().eq(due.keys()), "{name}");
        for (label, (count, sum)) in &due {
            let (n, s) = got[label];
            assert_eq!(n, *count, "{name}, class {label}");
            let far = (0..3).map(|i| (s[i] - sum[i]).abs() / n as f64).fold(0.0, f64::max);
            assert!(far < 2e-3, "{name}, class {label}: {far} m");
        }
        let report = json(&report);
        assert_eq!(report["from"]["gaussians"], room.len(), "{name}");
        assert_eq!(report["to"]["gaussians"], room.len(), "{name}");
        // And back to the format that loses nothing more.
        done(&run!("convert {to} {back} --overwrite"));
        assert_eq!(read(&back), scene, "{name}");
    }
}

#[test]
fn scenes_are_cut_thinned_turned_and_resized() {
    let folder = Folder::new();
    let (from, to, again) = (asset_at("room.ply"), folder.at("part.ply"), folder.at("again.ply"));
    let room = read(&from);
    done(&run!("convert {from} {to} --sample 25% --seed 3"));
    assert_eq!(read(&to).len(), room.len() / 4);
    done(&run!("convert {from} {again} --sample 25% --seed 3 --threads 1"));
    assert!(bytes(&to) == bytes(&again));
    let edit = "--crop -1,-1,-1,1,1,1 --frame RUB --scale 1000";
    done(&run!("convert {from} {to} --overwrite {edit}"));
    let inside = |p: &[f32; 3]| p.iter().all(|v| (-1.0..=1.0).contains(v));
    let rows: Vec<usize> = (0..room.len()).filter(|&row| inside(&room.coord[row])).collect();
    let due = moved(&room.select_rows(&rows).unwrap(), |[x, y, z]| {
        [x * 1000.0, -y * 1000.0, -z * 1000.0]
    });
    assert!(apart(&read(&to).coord, &due) < 1e-3);
}

fn walk(folder: &Path) -> Vec<String> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            names.extend(walk(&path));
        }
        names.push(path.display().to_string());
    }
    names
}

#[test]
fn targets_are_not_replaced_by_accident() {
    let (folder, from) = (Folder::new(), asset_at("room.ply"));
    for name in TARGETS {
        let to = folder.at(name);
        done(&run!("convert {from} {to} --sample 100"));
        refused(&run!("convert {from} {to} --sample 200"), 1, &[]);
        assert_eq!(read(&to).len(), 100, "{name}");
        done(&run!("convert {from} {to} --sample 200 --overwrite"));
        assert_eq!(read(&to).len(), 200, "{name}");
    }
    assert!(walk(folder.root()).iter().all(|name| !name.contains(".part")));
}

#[test]
fn wrong_use_is_said() {
    let (folder, from) = (Folder::new(), asset_at("room.ply"));
    let convert = |words: &str| run!("convert {from} {}", folder.at(words));
    let cases = [
        ("a.obj", 2, "--format"),
        ("a.obj", 2, ".compressed.ply (compressed-ply), .ply (ply), .spz (spz), .glb (glb)"),
        ("a.ksplat", 2, "ksplat files are read, not written; what can be written: "),
        ("a.ply --format ksplat", 2, "[possible values: compressed-ply, ply, "),
        ("a.spz --frame RDF:RUB", 2, "--to-spz-frame raw"),
        ("a.glb --frame LUF", 2, "converted to it when it is written"),
        ("a.ply --scale -1", 2, "above 0"),
        ("a.ply --rotate 1,2", 2, "three angles"),
        ("a.ply --up z+", 2, "no direction"),
        ("a.ply --crop 1,2,3", 2, "X0,Y0,Z0,X1,Y1,Z1"),
        ("a.ply --sample 0", 2, "100000"),
        ("a.ply --frame XYZ", 2, "RDF"),
        ("a.ply --language-code 8", 2, "--features"),
        ("a.ply --sh 5", 2, "5"),
        ("a.ply --crop 90,90,90,91,91,91", 1, "the scene lies in"),
    ];
    all_refused(cases, convert);
    refused(&run!("convert {} {}", folder.at("none.ply"), folder.at("a.ply")), 1, &[]);
    assert_eq!(folder.count(), 0);
}

#[test]
fn language_codes_answer_queries_without_a_network() {
    let folder = Folder::new();
    let [room, texts] = ["room.ply", "classes.safetensors"].map(asset_at);
    let (made, spz, out) = (folder.at("features"), folder.at("room.spz"), folder.at("out"));
    done(&run!("features {room} {TINY} --out {made}"));
    let coded = run!("convert {room} {spz} --language-code 32 --features {made}/features.npy");
    has(&told(&coded), &["mean cosine"]);
    let found = || labels(folder.path("out/labels.npy"));
    done(&run!("segment {room} {TINY} --text {texts} --out {out}"));
    let by_network = found();
    let said = told(&run!("segment {spz} --text {texts} --out {out}"));
    has(&said, &["language codes"]);
    let same = by_network.iter().zip(found()).filter(|(a, b)| **a == *b).count();
    assert!(same * 100 >= by_network.len() * 95, "{same} of {} agree", by_network.len());
    done(&run!("query {spz} chair --text {texts} --out {out}"));
    // A scene without codes goes to the network inside the program, whose texts these are not.
    refused(&run!("query {room} chair --text {texts} --out {out}"), 2, &["--weights"]);
}

/// A room of flat Gaussians, 4 × 3 × 2.5 m: floor at 0.7, two walls.
fn room_of_discs() -> GaussianScene {
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let (mut coord, mut quat) = (Vec::new(), Vec::new());
    for i in 0..50 {
        for j in 0..50 {
            let (a, b) = (i as f32 / 49.0, j as f32 / 49.0);
            coord.extend([[4.0 * a, 3.0 * b, 0.7], [4.0 * a, 0.0, 0.7 + 2.5 * b]]);
            coord.push([0.0, 3.0 * a, 0.7 + 2.5 * b]);
            quat.extend([[1.0, 0.0, 0.0, 0.0], [half, half, 0.0, 0.0], [half, 0.0, half, 0.0]]);
        }
    }
    let log_scale = vec![[0.04f32.ln(), 0.04f32.ln(), 0.002f32.ln()]; coord.len()];
    GaussianScene { quat, log_scale, ..balls(coord, 1.0, 3.0) }
}

#[test]
fn scenes_are_made_level_turned_and_moved() {
    let folder = Folder::new();
    let scene = room_of_discs();
    let room = folder.scene("room.ply", &scene);
    let convert = |from: &str, to: &str, more: &str| {
        let output = run!("convert {from} {} {more}", folder.at(to));
        (told(&output), read(folder.path(to)))
    };
    convert(&room, "tilted.ply", "--rotate 8,-5,30");
    let report = folder.at("report.json");
    let level = format!("--level --up +z --json {report}");
    let (said, found) = convert(&folder.at("tilted.ply"), "level.ply", &level);
    has(&said, &["level: turned by"]);
    let off = found.coord.iter().step_by(3).map(|p| p[2].abs()).fold(0.0, f32::max);
    assert!(off < 2e-3, "the floor is off by {off}");
    let tilt = json(report)["edit"]["level"]["tilt"].as_f64().unwrap();
    let due = (8f64.to_radians().cos() * 5f64.to_radians().cos()).acos().to_degrees();
    assert!((tilt - due).abs() < 0.05, "{tilt} {due}");

    // Quarter turns, and up as found.
    convert(&room, "side.ply", "--rotate 90,0,0");
    let (_, found) = convert(&folder.at("side.ply"), "up.ply", "--up -y");
    let heights = |scene: &GaussianScene| moved(scene, |p| [0.0, 0.0, p[2]]);
    assert!(apart(&heights(&found), &heights(&scene)) < 1e-6);
    let (_, found) = convert(&room, "moved.ply", "--translate 1,-2,-0.7");
    let due = moved(&scene, |[x, y, z]| [x + 1.0, y - 2.0, z - 0.7]);
    assert!(apart(&found.coord, &due) < 1e-6);
    // Where nothing is level, that is said, and nothing is turned.
    let balls = GaussianScene { log_scale: vec![[-3.0; 3]; scene.len()], ..scene };
    let from = folder.scene("balls.ply", &balls);
    let (said, found) = convert(&from, "still.ply", "--level --up +z");
    has(&said, &["no level surface was found"]);
    assert_eq!(found.quat, balls.quat);
}

#[test]
fn a_frame_of_the_format_is_not_applied_twice() {
    let folder = Folder::new();
    let scene = room_of_discs();
    let (room, to) = (folder.scene("room.ply", &scene), folder.at("b.ply"));
    for (name, frame) in [("a.spz", "RUB:RDF"), ("a.glb", "LUF:RDF")] {
        let file = folder.at(name);
        done(&run!("convert {room} {file}"));
        assert!(apart(&read(&file).coord, &scene.coord) < 1e-3, "{name}");
        refused(&run!("convert {file} {to} --frame {frame}"), 2, &["was converted to RDF"]);
    }
    // As it is in the file, it can be turned.
    let raw = folder.at("raw.spz");
    done(&run!("convert {room} {raw} --frame RUB --to-spz-frame raw"));
    done(&run!("convert {raw} {to} --spz-frame raw --frame RUB:RDF"));
    assert!(apart(&read(&to).coord, &scene.coord) < 1e-3);
}

#[test]
fn scenes_are_merged_and_floaters_removed() {
    let folder = Folder::new();
    let mut room = room_of_discs();
    let n = room.len();
    let a = folder.scene("a.ply", &room);
    room.segment = Some(vec![3; n]);
    room.coord[10] = [2.0, 1.5, 9.0];
    room.log_scale[20] = [9f32.ln(); 3];
    let (b, both, report) =
        (folder.scene("b.ply", &room), folder.at("both.ply"), folder.at("report.json"));
    has(&told(&run!("convert {a} {b} {both} --json {report}")), &["no label (scene 1)"]);
    let scene = read(&both);
    assert_eq!(scene.coord[n..], room.coord);
    let labels = scene.segment.unwrap();
    assert_eq!((labels[n - 1], labels[n]), (-1, 3));
    assert_eq!(json(&report)["from"]["scenes"].as_array().unwrap().len(), 2);
    assert_eq!(json(&report)["from"]["gaussians"], 2 * n);

    let output = run!("convert {b} {both} --remove-floaters --overwrite --json {report}");
    has(&told(&output), &[&format!("floaters: 1 isolated and 1 giant Gaussians of {n}")]);
    let rows: Vec<usize> = (0..n).filter(|row| ![10, 20].contains(row)).collect();
    assert_eq!(read(&both).coord, room.select_rows(&rows).unwrap().coord);
    assert_eq!(json(&report)["floaters"]["giants"], 1);
    // The source is never its own target.
    refused(&run!("convert {a}"), 2, &[]);
}
