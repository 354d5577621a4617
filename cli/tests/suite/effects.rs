//! What commands with a network do about effects of the capture.

use crate::support::*;
use scenesplat::scene::GaussianScene;
use scenesplat::scene::formats::npy_folder::write_npy_folder;
use serde_json::Value;

/// A room with a hole in its floor.
fn with_hole() -> GaussianScene {
    let scene = room(6000, 9);
    let [low, high] = [f32::min, f32::max]
        .map(|f| [0, 1].map(|a| scene.coord.iter().map(|p| p[a]).reduce(f).unwrap()));
    let middle = [0, 1].map(|a| 0.5 * (low[a] + high[a]));
    let gone = |p: &[f32; 3]| p[2] < 0.3 && (0..2).all(|a| (p[a] - middle[a]).abs() < 0.7);
    let rows: Vec<usize> = (0..scene.len()).filter(|&row| !gone(&scene.coord[row])).collect();
    scene.select_rows(&rows).unwrap()
}

fn decision<'a>(receipt: &'a Value, section: &str, effect: &str) -> &'a Value {
    let sections = receipt["effect_plan"]["sections"].as_array().unwrap();
    let section = sections.iter().find(|s| s["name"] == section).unwrap();
    section["decisions"].as_array().unwrap().iter().find(|d| d["effect"] == effect).unwrap()
}

#[test]
fn effects_are_compensated_for_when_asked_and_a_receipt_says_how_to_do_it_again() {
    let folder = Folder::new();
    let mut scene = with_hole();
    // And a Gaussian far away.
    scene.coord[0] = [70.0, 3.0, 4.0];
    let count = scene.len();
    let scene = folder.scene("room.ply", &scene);
    let run = |out: &str, more: &str| {
        let said = told(&run!("segment {scene} --as-is --out {} {more}", folder.at(out)));
        let read = |name: &str| bytes(folder.path(out).join(name));
        (["labels.npy", "scores.npy", "segmented.ply"].map(read), said)
    };
    let receipt = |out: &str| json(folder.path(out).join("receipt.json"));
    let (auto, said) = run("auto", "");
    has(&said, &["nothing here acts on surface, blur, glass, light, noise"]);
    let found = receipt("auto");
    for effect in ["holes", "floaters", "glass"] {
        let about = decision(&found, "effects", effect);
        assert_eq!((&about["on"], &about["changed"]), (&false.into(), &0.into()), "{effect}");
    }
    has(decision(&found, "tiles", "halo")["why"].as_str().unwrap(), &["one piece"]);
    assert!(found["effect_plan"]["sections"][0].get("seconds").is_none());
    // What is found is said, with its cost and what to do, whether or not anything is done about it.
    let effects = found["effects"].as_array().unwrap();
    let holes = effects.iter().find(|e| e["effect"] == "holes").unwrap();
    assert!(holes["severity"].as_f64().unwrap() >= 0.5 && holes["f_miou_lost"].is_number());
    has(
        &said,
        &["effect of the capture: holes of severity", "capture the parts that no picture shows"],
    );
    let off = "holes=off,floaters=off,surface=off,blur=off,glass=off,light=off,noise=off";
    assert!(run("off", &format!("--effect {off}")).0 == auto, "auto without a finding is off");

    let (on, said) = run("on", "--effect holes=on,floaters=on");
    has(&said, &["withheld at the rims of holes"]);
    let found = receipt("on");
    let [holes, floaters] = ["holes", "floaters"].map(|e| decision(&found, "effects", e));
    let rims = holes["changed"].as_u64().unwrap() as usize;
    assert!(rims > 10 && rims < count / 2, "{rims}");
    assert!(floaters["changed"].as_u64().unwrap() >= 1);
    let labels_of = |out: &str| floats(folder.path(out).join("labels.npy"));
    assert_eq!(labels_of("on").iter().filter(|label| **label < 0.0).count(), rims);
    assert!(labels_of("auto").iter().all(|label| *label >= 0.0));

    // Nothing is looked for again, and every bit is the same; also by a plan without its receipt.
    let stored = folder.at("on/receipt.json");
    assert!(run("again", &format!("--effect-plan {stored}")).0 == on);
    let section = |receipt: &Value| receipt["effect_plan"]["sections"][0].clone();
    assert!(section(&receipt("again")).get("seconds").is_none());
    assert_eq!(section(&receipt("again"))["decisions"], section(&found)["decisions"]);
    let plan = folder.write("plan.json", found["effect_plan"].to_string());
    assert!(run("third", &format!("--effect-plan {plan} --threads 1")).0 == on);

    queries_follow_a_plan(&folder, &scene, &stored, &labels_of("on"));
    features_withhold_nothing(&folder, &scene, &stored);
    assert_eq!(npy(folder.path("features/features.npy")).shape()[0], count);
}

/// What a plan withholds is found by no query; `labels` are those of the plan.
fn queries_follow_a_plan(folder: &Folder, scene: &str, stored: &str, labels: &[f32]) {
    let query = |out: &str, more: &str| {
        done(&run!("query {scene} floor --as-is --out {} {more}", folder.at(out)));
        floats(folder.path(out).join("selection.npy"))
    };
    // What is read without floaters in both, so that rims alone make the difference.
    let all = query("q", "--effect floaters=on");
    let fewer = query("q-on", &format!("--effect-plan {stored}"));
    for (row, ((all, fewer), label)) in all.iter().zip(&fewer).zip(labels).enumerate() {
        let due = if *label < 0.0 { 0.0 } else { *all };
        assert_eq!(*fewer, due, "row {row}");
    }
    let [all, fewer] = [all, fewer].map(|rows| rows.iter().sum::<f32>());
    assert!(fewer < all && fewer > 0.0, "{fewer} {all}");
}

/// Neither by a flag nor by a plan.
fn features_withhold_nothing(folder: &Folder, scene: &str, stored: &str) {
    let features = |more: &str| run!("features {scene} --out {} {more}", folder.at("features"));
    let cases = [
        ("--effect holes=on", 2, "acted on here: floaters"),
        (&format!("--effect-plan {stored}"), 2, "acted on here: floaters"),
        ("--effect glass=on", 2, "nothing here acts on glass"),
    ];
    all_refused(cases, features);
    done(&features("--effect floaters=on"));
}

#[test]
fn wishes_that_nothing_follows_are_refused() {
    let folder = Folder::new();
    let scene = folder.scene("room.ply", &room(6000, 9).select_rows(&[1, 2, 3]).unwrap());
    let none = folder.write("none.json", "{\"command\": \"segment\"}");
    let other = "{\"gaussians\": 7, \"sections\": [{\"name\": \"effects\", \"decisions\": []}]}";
    let other = folder.write("other.json", other);
    let empty = folder.write("empty.json", "{\"gaussians\": 3, \"sections\": []}");
    let cases = [
        ("--effect glass=on", 2, "acted on here: holes, floaters"),
        ("--effect dust=on", 2, "there are holes, floaters"),
        ("--effect holes=3", 2, "on, off or auto"),
        (&format!("--effect-plan {none}"), 2, "no receipt with a plan"),
        (&format!("--effect-plan {other}"), 2, "a scene of 7 Gaussians, this one has 3"),
        (&format!("--effect-plan {empty}"), 2, "decides nothing about effects"),
        ("--effect-plan missing.json", 1, "missing.json"),
        (&format!("--effect auto --effect-plan {other}"), 2, "cannot be used with"),
        // Features that are there already are in no voxels.
        ("--features f.npy --effect floaters=on", 2, "acted on here: holes"),
    ];
    all_refused(cases, |more| run!("segment {scene} --out {} {more}", folder.at("out")));
}

#[test]
fn evaluate_counts_withheld_labels_as_wrong_and_as_not_asked_for() {
    let folder = Folder::new();
    write_npy_folder(&with_hole(), &folder.path("room"), false).unwrap();
    let (scene, names) = (folder.at("room"), folder.names());
    let words = format!("evaluate {scene} --as-is --label-names {names}");
    let evaluate = |out: &str, more: &str| run!("{words} --out {} {more}", folder.at(out));
    let figures = |out: &str| json(folder.path(out).join("evaluation.json"));
    let said = printed(&evaluate("off", ""));
    let off = figures("off");
    assert_eq!(off["withheld"], 0);
    assert!(off.get("of_those_given").is_none() && !said.contains("of those given"), "{said}");

    let said = printed(&evaluate("on", "--effect holes=on"));
    let on = figures("on");
    let withheld = on["withheld"].as_u64().unwrap();
    assert!(withheld > 10, "{withheld}");
    has(&said, &[&format!("{withheld} labels were withheld"), "of those given"]);
    let right = |json: &Value| json["all_acc"].as_f64().unwrap();
    assert!(right(&on) < right(&off) && right(&on["of_those_given"]) > right(&on));
    // A stored plan gives the same figures without looking again.
    let stored = folder.at("on/receipt.json");
    done(&evaluate("again", &format!("--effect-plan {stored}")));
    for key in ["all_acc", "f_miou", "withheld", "of_those_given"] {
        assert_eq!(figures("again")[key], on[key], "{key}");
    }
    let cases = [
        ("--features oracle --effect holes=on", 2, "nothing here acts on holes"),
        (&format!("synthetic:500:1 --effect-plan {stored}"), 2, "one scene only"),
    ];
    all_refused(cases, |more| evaluate("no", more));
}
