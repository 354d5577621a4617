//! `objects`, `view` and `segment --instances`: what they write, agree on and refuse.

use crate::support::*;
use scenesplat::scene::Similarity;
use serde_json::{Value, json};

/// A room with its labels and instances, and the names of its classes.
fn world() -> Folder {
    let folder = Folder::new();
    folder.room("room.ply", 12_000, 9);
    folder.names();
    folder
}

fn objects(folder: &Folder, scene: &str, out: &str, more: &str) -> std::process::Output {
    let [scene, names, out] = [scene, "names.txt", out].map(|name| folder.at(name));
    run!("objects {scene} --label-names {names} --out {out} {more}")
}

#[test]
fn objects_are_listed_drawn_exported_and_taken_out() {
    let folder = world();
    let scene = read(folder.path("room.ply"));
    let run = |more: &str| {
        let file = folder.at("objects.json");
        objects(&folder, "room.ply", "out", &format!("--json {file} {more}"))
    };
    let said = printed(&run("--remove wall,ceiling --export parts --find wall"));
    let out = |name: &str| folder.path("out").join(name);
    let table = json(folder.path("objects.json"));
    assert_eq!(table, json(out("objects.json")));
    let all = table["objects"].as_array().unwrap();
    // The room has instances: each of at least 20 Gaussians is an object.
    let ids = scene.instance.as_ref().unwrap();
    let count = |id: i32| ids.iter().filter(|i| **i == id).count();
    let large = (0..=*ids.iter().max().unwrap()).filter(|id| count(*id) >= 20).count();
    assert_eq!(all.len(), large);
    has(
        &said,
        &[&format!("{large} objects (the instances that the scene carries): "), "\"wall\": "],
    );
    for object in all {
        for field in ["class", "count", "box", "position"] {
            assert!(!object[field].is_null(), "{field}: {object}");
        }
    }
    let instances = labels(out("instances.npy"));
    let of = |place: usize| instances.iter().filter(|i| **i == place as i64).count();
    assert!(all.iter().enumerate().all(|(i, o)| o["count"] == of(i)));
    assert_eq!(text(out("objects.csv")).lines().count(), large + 1);
    assert!(bytes(out("objects.png")).len() > 20_000);
    // Parts are the scene again, and what is removed is gone.
    assert_eq!(std::fs::read_dir(out("parts")).unwrap().count(), large);
    assert_eq!((read(out("parts/001-wall.ply")).len(), &all[0]["class"]), (of(0), &"wall".into()));
    let edited = read(out("edited.ply"));
    let is_gone = |i: &usize| ["wall", "ceiling"].contains(&all[*i]["class"].as_str().unwrap());
    let gone: usize = (0..all.len()).filter(is_gone).map(of).sum();
    assert_eq!(edited.len(), scene.len() - gone);
    assert!(edited.segment.unwrap().iter().all(|l| *l != 0));

    // A hull for each object, in the box of the scene; wide cubes are fewer.
    let glb = |file: &[u8]| -> Value {
        let length = u32::from_le_bytes(*file[12..].first_chunk().unwrap()) as usize;
        serde_json::from_slice(&file[20..20 + length]).unwrap()
    };
    let said = printed(&run("--colliders=0.2"));
    let (hulls, coarse) = (glb(&bytes(out("colliders.glb"))), bytes(out("colliders.glb")).len());
    has(&said, &[&format!("colliders.glb: {large} of {large} objects as cubes of 0.2 m")]);
    assert_eq!(hulls["nodes"].as_array().unwrap().len(), large);
    assert_eq!(hulls["nodes"][0]["name"], "001-wall");
    // glTF turns the signs of the other two axes.
    let up = |v: &Value, end: &str| v[end][2].as_f64().unwrap();
    let positions = hulls["accessors"].as_array().unwrap().iter().step_by(2);
    let heights = scene.coord.iter().map(|p| f64::from(p[2]));
    let (low, high) = heights.fold((9.0f64, -9.0f64), |(l, h), z| (l.min(z), h.max(z)));
    for hull in positions {
        assert!(up(hull, "min") >= low - 0.4 && up(hull, "max") <= high + 0.4, "{hull}");
    }
    done(&run("--colliders"));
    let fine = bytes(out("colliders.glb")).len();
    assert!(fine > 2 * coarse);
    // Cubes lie along the walls: no stairs in a room that is turned.
    let mut turned = scene.clone();
    let (s, c) = 30f64.to_radians().sin_cos();
    let rotation = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]];
    turned.transform(&Similarity { rotation, ..Similarity::IDENTITY });
    folder.scene("turned.ply", &turned);
    done(&objects(&folder, "turned.ply", "turned", "--colliders"));
    let other = bytes(folder.path("turned").join("colliders.glb")).len();
    assert!(2 * other < 3 * fine, "{other} bytes, {fine} before it was turned");

    // What a phrase denies is told by the objects that remain; a place that objects do not tell is refused.
    let said = printed(&run("--find 'not a wall'"));
    assert!(!said.contains("\"wall\": "), "{said}");
    has(&said, &["floor"]);
    refused(&run("--find 'table left of a wall'"), 2, &["left of"]);
    done(&run("--keep floor --pieces"));
    assert!(read(out("edited.ply")).segment.unwrap().iter().all(|l| *l == 1));
    for (more, part) in [
        ("--remove spaceship", "nothing in this vocabulary is like \"spaceship\""),
        ("--export ../parts", "one plain name"),
        ("--remove wall --keep floor", "cannot be used with"),
        ("--weights seeded:0", "leave out --weights"),
        ("--gap 0", "above 0"),
        ("--colliders=0.001", "0.005 to 2 meters"),
        ("--colliders=wide", "0.005 to 2 meters"),
        ("--min-count 0", "min_count"),
    ] {
        let output = run(more);
        assert!(!output.status.success(), "{more}");
        has(&stderr(&output), &[part]);
    }
}

#[test]
fn boxes_are_level_in_a_room_that_is_not_and_heights_begin_at_a_given_floor() {
    let folder = world();
    let mut scene = read(folder.path("room.ply"));
    let (s, c) = 7f64.to_radians().sin_cos();
    let rotation = [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]];
    scene.transform(&Similarity { rotation, ..Similarity::IDENTITY });
    folder.scene("tilted.ply", &scene);
    let run = |scene: &str, out: &str, more: &str| {
        let said = printed(&objects(&folder, scene, out, more));
        (json(folder.path(out).join("objects.json")), said)
    };
    let (level, said) = run("room.ply", "level", "");
    // What has fewer than 20 Gaussians is no object, and said.
    let some_small = level["small_instances"].as_u64().unwrap() > 0;
    let is_said = said.contains("instances of the scene are none, having too few");
    assert_eq!(is_said, some_small, "{said}");
    assert_eq!(
        (&level["labels_from"], &level["instances_from"]),
        (&"scene".into(), &"scene".into())
    );
    has(&said, &["(the instances that the scene carries)"]);
    let (other, _) = run("tilted.ply", "tilted", "");
    let (a, b) = (level["objects"].as_array().unwrap(), other["objects"].as_array().unwrap());
    assert_eq!(a.len(), b.len());
    // 7 degrees of tilt would make a floor of 4 m half a meter thick.
    let size = |o: &Value, axis: usize| o["box"]["size"][axis].as_f64().unwrap();
    for (a, b) in a.iter().zip(b) {
        assert!((size(a, 2) - size(b, 2)).abs() < 0.06, "{a} {b}");
    }
    let (given, said) = run("room.ply", "given", "--floor -1 --unit cm");
    has(&said, &["heights are over the floor that was given"]);
    assert_eq!(given["floor"]["height"].as_f64(), Some(-0.01));
    assert_eq!(given["floor"]["given"], true);
    let first = |v: &Value| size(&v["objects"][0], 0);
    assert!((first(&given) * 100.0 - first(&level)).abs() < 0.02);
}

#[test]
fn boxes_are_those_of_the_table() {
    let folder = world();
    done(&objects(&folder, "room.ply", "out", "--boxes --unit cm"));
    let out = |name: &str| json(folder.path("out").join(name));
    let (table, file) = (out("objects.json"), out("boxes.json"));
    assert_eq!(file["info"]["metres_per_unit"], 0.01);
    assert_eq!(file["info"]["labels_from"], "scene");
    assert_eq!(file["images"][0]["file_name"], "room.ply");
    let names = class_names();
    assert_eq!(file["categories"].as_array().unwrap().len(), names.len());
    let (all, boxes) =
        (table["objects"].as_array().unwrap(), file["annotations"].as_array().unwrap());
    assert!(all.len() > 10 && all.len() == boxes.len());
    for (object, found) in all.iter().zip(boxes) {
        assert_eq!((&found["id"], &found["count"]), (&object["id"], &object["count"]));
        let category = found["category_id"].as_u64().unwrap() as usize;
        assert_eq!(
            (&found["category_name"], object["class"].as_str()),
            (&object["class"], Some(&*names[category]))
        );
        assert_eq!(
            (&found["bbox3D_scene"], &found["center_scene"]),
            (&object["box"]["corners"], &object["position"])
        );
        let meters: Vec<f64> = serde_json::from_value(found["bbox3D"].clone()).unwrap();
        assert_eq!(
            (json!(meters[3..6]), json!(meters[6])),
            (object["box"]["size"].clone(), object["box"]["yaw"].clone())
        );
    }
    done(&objects(&folder, "room.ply", "other", ""));
    assert!(!folder.path("other/boxes.json").exists());
}

/// A browser that asks, and Ctrl-C: `view --serve` says where, gives the page to who knows the address, and ends well.
#[cfg(unix)]
#[test]
fn a_served_page_ends_with_an_interrupt() {
    use std::io::{BufRead, Read, Write};
    use std::process::{Command, Stdio};
    let folder = world();
    let (scene, receipt) = (folder.at("room.ply"), folder.at("receipt.json"));
    let line = format!("view {scene} --label-names {} --serve", folder.at("names.txt"));
    let mut child = program()
        .args(words(&format!("{line} --receipt {receipt}")))
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = std::io::BufReader::new(child.stdout.take().unwrap()).lines();
    let mut lines = lines.map(Result::unwrap);
    let line = lines.by_ref().find(|l| l.starts_with("open http")).unwrap();
    let url = line.split(' ').nth(1).unwrap();
    let (host, path) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
    assert!(host.starts_with("127.0.0.1:"), "{url}");
    let ask = |path: &str, host_header: &str| {
        let mut stream = std::net::TcpStream::connect(host).unwrap();
        write!(stream, "GET /{path} HTTP/1.1\r\nHost: {host_header}\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    };
    assert!(ask(path, host).contains("<!doctype html>"));
    assert!(ask("", host).starts_with("HTTP/1.1 404"));
    assert!(ask(path, "attacker.example").starts_with("HTTP/1.1 403"));
    let kill = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(kill.success());
    let said = told(&child.wait_with_output().unwrap());
    has(&said, &["a browser opened the page", "got nothing (403)"]);
    let last = lines.find(|l| l.starts_with("opened 1 times")).unwrap();
    has(&last, &["2 requests got nothing"]);
    has(&json(&receipt).to_string(), &["opened 1 times"]);
    assert_eq!(folder.count(), 3, "no file but the receipt");
    let cases = [
        ("--serve --out x.html", 2, "cannot be used with"),
        ("--port 80", 2, "--serve"),
        ("--plain --floor 1", 2, "--plain leaves out"),
        ("--plain --unit m --precision bf16", 2, "--plain leaves out"),
    ];
    all_refused(cases, |more| run!("view {scene} {more}"));
}

#[test]
fn segment_and_objects_find_the_same() {
    let folder = Folder::new();
    let [room, texts] = ["room.ply", "classes.safetensors"].map(asset_at);
    let [one, two] = ["one", "two"].map(|name| folder.at(name));
    done(&run!("segment {room} {TINY} --text {texts} --out {one} --instances"));
    done(&run!("objects {room} {TINY} --text {texts} --out {two}"));
    let file = |folder: &str, name: &str| bytes(format!("{folder}/{name}"));
    for name in ["objects.json", "instances.npy"] {
        assert!(file(&one, name) == file(&two, name), "{name}");
    }
    // What the terminal warned of stands in the files, too.
    let found = json(folder.path("one/objects.json"));
    assert_eq!(
        (&found["labels_from"], &found["instances_from"]),
        (&"network".into(), &"scene".into())
    );
    has(&found["warnings"].to_string(), &["SEEDED WEIGHTS (0)"]);
    let head = bytes(folder.path("one/segmented.ply"));
    let head = String::from_utf8_lossy(&head[..2000]);
    has(&head, &["\ncomment scenesplat warning: SEEDED WEIGHTS (0)"]);
    assert!(!folder.path("one/objects.png").exists());
}

#[test]
fn a_place_is_told_by_the_objects_in_query_as_in_find() {
    let folder = Folder::new();
    let room = asset_at("room.ply");
    let [one, two] = ["one", "two"].map(|name| folder.at(name));
    let phrase = "'chair near the table'";
    let said = printed(&run!("objects {room} --out {one} --find {phrase}"));
    let ids: Vec<i64> = said
        .lines()
        .filter_map(|line| line.strip_prefix("\"chair near the table\": "))
        .map(|rest| rest.split(' ').next().unwrap().parse().unwrap())
        .collect();
    assert!(!ids.is_empty(), "{said}");
    // Numbers of objects begin at 1, those of the file at 0.
    let of_object = labels(format!("{one}/instances.npy"));
    let due: Vec<i64> = of_object.iter().map(|id| i64::from(ids.contains(&(id + 1)))).collect();
    let said = printed(&run!("query {room} {phrase} --out {two}"));
    assert_eq!(labels(format!("{two}/selection.npy")), due);
    has(&said, &[&format!("{} of 16000 Gaussians", due.iter().sum::<i64>())]);
    // Understood, and not there: no error, in all three.
    let said = printed(&run!("objects {room} --out {one} --find toilet --remove toilet"));
    has(&said, &["\"toilet\": none; there are: wall", "edited.ply: 16000 of 16000"]);
    has(&printed(&run!("query {room} toilet --out {two}")), &["\"toilet\": "]);
    has(&printed(&run!("query {room} 'toilet on the table' --out {two}")), &["nothing selected"]);
    refused(&run!("query {room} 'spaceship on the table' --out {two}"), 2, &["spaceship"]);
}

/// A text that a page carries.
fn block(page: &str, name: &str) -> String {
    use base64::prelude::{BASE64_STANDARD, Engine};
    use std::io::Read;
    let (_, rest) = page.split_once(&format!("id=\"block-{name}\"")).unwrap();
    let (packed, _) = rest.split_once('>').unwrap().1.split_once('<').unwrap();
    let packed = BASE64_STANDARD.decode(packed.trim()).unwrap();
    let mut text = String::new();
    flate2::read::ZlibDecoder::new(&packed[..]).read_to_string(&mut text).unwrap();
    text
}

#[test]
fn a_page_is_one_file_that_loads_nothing() {
    let (folder, other) = (Folder::new(), Folder::new());
    let [room, texts] = ["room.ply", "classes.safetensors"].map(asset_at);
    let out = folder.at("room.html");
    let page = |more: &str| run!("view {room} --out {out} {more}");
    let said = printed(&page(&format!("{TINY} --text {texts}")));
    has(&said, &["16000 Gaussians", "24 code numbers"]);
    let whole = text(&out);
    assert!(whole.starts_with("<!doctype html>"));
    has(&whole, &["default-src 'none'", "id=\"block-codes\"", "id=\"block-program\""]);
    has(&block(&whole, "about"), &["\"warnings\":[\"SEEDED WEIGHTS (0)"]);
    assert!(!whole.contains("src=") && !whole.contains("import "));
    assert_eq!(folder.count(), 1, "one file");

    done(&page(&format!("--label-names {}", other.names())));
    let labels = text(&out);
    assert!(labels.contains("id=\"block-label\"") && !labels.contains("id=\"block-codes\""));
    has(&block(&labels, "about"), &["\"warnings\":[]", "those that the scene carries"]);
    done(&page("--plain --max-splats 500"));
    assert!(bytes(&out).len() < whole.len());
    let cases = [
        ("--max-splats 0", 2, "--max-splats"),
        ("--codes 33", 2, "--codes"),
        ("--plain --weights seeded:0", 2, "--plain runs no network"),
        ("--plain --precision bf16", 2, "--plain leaves out"),
    ];
    all_refused(cases, page);
}

#[test]
fn near_ties_are_decided_by_what_is_there() {
    let folder = Folder::new();
    let (room, out) = (asset_at("room.ply"), folder.at("out"));
    let selected = |phrase: &str| {
        let said = run!("query {room} '{phrase}' --out {out}");
        done(&said);
        (labels(format!("{out}/selection.npy")), stderr(&said))
    };
    let mut decided = 0;
    for (phrase, first, other) in [
        ("ceiling fan", "ceiling", "lamp"),
        ("digital computer", "monitor", "laptop"),
        ("charcoal burner", "stove", "radiator"),
        ("computer bed", "bed", "laptop"),
        ("fabric bed", "bed", "sofa"),
        ("dining wardrobe", "wardrobe", "table"),
    ] {
        let [of_first, of_other] = [first, other].map(|class| selected(class).0);
        let (found, said) = selected(phrase);
        has(&said, &[&format!("\"{first}\": {first} 0."), &format!("near: {other}")]);
        let is_there = of_first.contains(&1);
        if is_there || !of_other.contains(&1) {
            assert!(found == of_first || !is_there, "{phrase}");
            continue;
        }
        decided += 1;
        has(&said, &[&format!("\"{other}\": as near")]);
        assert!(found == of_other, "{phrase}");
    }
    assert!(decided > 0, "no class of the room is the second of a tie");
}
