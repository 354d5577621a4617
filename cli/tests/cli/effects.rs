//! What commands with a network do about effects of the capture.

use crate::{done, scenesplat, stderr};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::GaussianScene;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::npy::NpyFile;
use serde_json::Value;
use std::path::Path;

fn room() -> GaussianScene {
    generate(&SyntheticRoomSettings::with_count(6000, 9)).unwrap().scene
}

/// A room with a hole in its floor and a Gaussian far away.
fn damaged(path: &Path) -> usize {
    let mut scene = room();
    let [low, high] = [f32::min, f32::max]
        .map(|f| [0, 1].map(|a| scene.coord.iter().map(|p| p[a]).reduce(f).unwrap()));
    let middle = [0, 1].map(|a| 0.5 * (low[a] + high[a]));
    let gone = |p: &[f32; 3]| p[2] < 0.3 && (0..2).all(|a| (p[a] - middle[a]).abs() < 0.7);
    let rows: Vec<usize> = (0..scene.len()).filter(|&row| !gone(&scene.coord[row])).collect();
    scene = scene.select_rows(&rows).unwrap();
    scene.coord[0] = [70.0, 3.0, 4.0];
    write_inria_ply(&scene, &[], path).unwrap();
    scene.len()
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn decision<'a>(receipt: &'a Value, section: &str, effect: &str) -> &'a Value {
    let sections = receipt["effect_plan"]["sections"].as_array().unwrap();
    let section = sections.iter().find(|s| s["name"] == section).unwrap();
    section["decisions"].as_array().unwrap().iter().find(|d| d["effect"] == effect).unwrap()
}

#[test]
fn effects_are_compensated_for_when_asked_and_a_receipt_says_how_to_do_it_again() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let count = damaged(Path::new(&at("room.ply")));
    let run = |out: &str, more: &[&str]| {
        let (scene, out) = (at("room.ply"), at(out));
        let mut args = vec!["segment", &scene, "--as-is", "--out", &out];
        args.extend(more);
        let output = scenesplat(&args);
        done(&output);
        let read = |name: &str| std::fs::read(Path::new(&out).join(name)).unwrap();
        (["labels.npy", "scores.npy", "segmented.ply"].map(read), stderr(&output))
    };
    let (auto, said) = run("auto", &[]);
    assert!(said.contains("nothing here acts on surface, blur, glass, light, noise"), "{said}");
    let receipt = json(&folder.path().join("auto/receipt.json"));
    for effect in ["holes", "floaters", "glass"] {
        let about = decision(&receipt, "effects", effect);
        assert_eq!((&about["on"], &about["changed"]), (&false.into(), &0.into()), "{effect}");
    }
    assert!(decision(&receipt, "tiles", "halo")["why"].as_str().unwrap().contains("one piece"));
    assert!(receipt["effect_plan"]["sections"][0].get("seconds").is_none());
    let off = "holes=off,floaters=off,surface=off,blur=off,glass=off,light=off,noise=off";
    assert!(run("off", &["--effect", off]).0 == auto, "auto without a finding is off");

    let (on, said) = run("on", &["--effect", "holes=on,floaters=on"]);
    assert!(said.contains("withheld at the rims of holes"), "{said}");
    let receipt = json(&folder.path().join("on/receipt.json"));
    let [holes, floaters] = ["holes", "floaters"].map(|e| decision(&receipt, "effects", e));
    let rims = holes["changed"].as_u64().unwrap() as usize;
    assert!(rims > 10 && rims < count / 2, "{rims}");
    assert!(floaters["changed"].as_u64().unwrap() >= 1);
    let labels = |out: &str| {
        let file = NpyFile::open(&folder.path().join(out).join("labels.npy")).unwrap();
        file.read_f32().unwrap()
    };
    let unknown = labels("on").iter().filter(|label| **label < 0.0).count();
    assert_eq!(unknown, rims);
    assert!(labels("auto").iter().all(|label| *label >= 0.0));

    // Nothing is looked at again, and every bit is the same; also by a plan without its receipt.
    let stored = at("on/receipt.json");
    assert!(run("again", &["--effect-plan", &stored]).0 == on);
    let again = json(&folder.path().join("again/receipt.json"));
    assert!(again["effect_plan"]["sections"][0].get("seconds").is_none());
    assert_eq!(
        again["effect_plan"]["sections"][0]["decisions"],
        receipt["effect_plan"]["sections"][0]["decisions"]
    );
    std::fs::write(at("plan.json"), receipt["effect_plan"].to_string()).unwrap();
    let (third, _) = run("third", &["--effect-plan", &at("plan.json"), "--threads", "1"]);
    assert!(third == on);

    let query = |out: &str, more: &[&str]| {
        let (scene, out) = (at("room.ply"), at(out));
        let mut args = vec!["query", &scene, "floor", "--as-is", "--out", &out];
        args.extend(more);
        done(&scenesplat(&args));
        let file = NpyFile::open(&Path::new(&out).join("selection.npy")).unwrap();
        file.read_f32().unwrap()
    };
    // What is read without floaters in both, so that rims alone make the difference.
    let all = query("q", &["--effect", "floaters=on"]);
    let fewer = query("q-on", &["--effect-plan", &stored]);
    let rows = all.iter().zip(&fewer).zip(labels("on"));
    for (row, ((all, fewer), label)) in rows.enumerate() {
        let due = if label < 0.0 { 0.0 } else { *all };
        assert_eq!(*fewer, due, "row {row}");
    }
    let [all, fewer] = [all, fewer].map(|rows| rows.iter().sum::<f32>());
    assert!(fewer < all && fewer > 0.0, "{fewer} {all}");

    // features cannot withhold anything: neither by a flag nor by a plan.
    let (scene, out) = (at("room.ply"), at("features"));
    for (more, part) in [
        (["--effect", "holes=on"], "acted on here: floaters"),
        (["--effect-plan", &stored], "acted on here: floaters"),
        (["--effect", "glass=on"], "nothing here acts on glass"),
    ] {
        let mut args = vec!["features", &scene, "--out", &out];
        args.extend(more);
        let output = scenesplat(&args);
        assert!(output.status.code() == Some(2) && stderr(&output).contains(part));
    }
    done(&scenesplat(&["features", &scene, "--out", &out, "--effect", "floaters=on"]));
    let features = NpyFile::open(&Path::new(&out).join("features.npy")).unwrap();
    assert_eq!(features.shape()[0], count);
}

#[test]
fn wishes_that_nothing_follows_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let scene = at("room.ply");
    write_inria_ply(&room().select_rows(&[1, 2, 3]).unwrap(), &[], Path::new(&scene)).unwrap();
    std::fs::write(at("none.json"), "{\"command\": \"segment\"}").unwrap();
    let other = "{\"gaussians\": 7, \"sections\": [{\"name\": \"effects\", \"decisions\": []}]}";
    std::fs::write(at("other.json"), other).unwrap();
    std::fs::write(at("empty.json"), "{\"gaussians\": 3, \"sections\": []}").unwrap();
    let [none, other, empty] = ["none.json", "other.json", "empty.json"].map(at);
    let missing = at("missing.json");
    for (args, code, part) in [
        (["--effect", "glass=on"], 2, "acted on here: holes, floaters"),
        (["--effect", "dust=on"], 2, "there are holes, floaters"),
        (["--effect", "holes=3"], 2, "on, off or auto"),
        (["--effect-plan", &none], 2, "no receipt with a plan"),
        (["--effect-plan", &other], 2, "a scene of 7 Gaussians, this one has 3"),
        (["--effect-plan", &empty], 2, "decides nothing about effects"),
        (["--effect-plan", &missing], 1, "missing.json"),
    ] {
        let out = at("out");
        let mut all = vec!["segment", &scene, "--out", &out];
        all.extend(args);
        let output = scenesplat(&all);
        let said = stderr(&output);
        assert!(output.status.code() == Some(code) && said.contains(part), "{args:?}: {said}");
    }
    let both = ["segment", &scene, "--effect", "auto", "--effect-plan", &other];
    assert_eq!(scenesplat(&both).status.code(), Some(2));
    // Features that are there already are in no voxels.
    let given = ["segment", &scene, "--features", "f.npy", "--effect", "floaters=on"];
    let output = scenesplat(&given);
    assert!(stderr(&output).contains("acted on here: holes"), "{}", stderr(&output));
}

#[test]
fn evaluate_counts_withheld_labels_as_wrong_and_as_not_asked_for() {
    use scenesplat::scene::formats::npy_folder::write_npy_folder;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let full = room();
    let middle = |a: usize| {
        let [low, high] =
            [f32::min, f32::max].map(|f| full.coord.iter().map(|p| p[a]).reduce(f).unwrap());
        0.5 * (low + high)
    };
    let gone = |p: &[f32; 3]| p[2] < 0.3 && (0..2).all(|a| (p[a] - middle(a)).abs() < 0.7);
    let rows: Vec<usize> = (0..full.len()).filter(|&row| !gone(&full.coord[row])).collect();
    write_npy_folder(&full.select_rows(&rows).unwrap(), Path::new(&at("room")), false).unwrap();
    let names: Vec<&str> = scenesplat::rooms::CLASSES.iter().map(|class| class.name).collect();
    std::fs::write(at("names.txt"), names.join("\n")).unwrap();
    let run = |out: &str, more: &[&str]| {
        let (scene, names, out) = (at("room"), at("names.txt"), at(out));
        let mut args = vec!["evaluate", &scene, "--as-is", "--label-names", &names, "--out", &out];
        args.extend(more);
        let output = scenesplat(&args);
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        (output, said, Path::new(&out).join("evaluation.json"))
    };
    let (output, said, path) = run("off", &[]);
    done(&output);
    let off = json(&path);
    assert_eq!(off["withheld"], 0);
    assert!(off.get("of_those_given").is_none() && !said.contains("of those given"), "{said}");

    let (output, said, path) = run("on", &["--effect", "holes=on"]);
    done(&output);
    let on = json(&path);
    let withheld = on["withheld"].as_u64().unwrap();
    assert!(withheld > 10 && said.contains(&format!("{withheld} labels were withheld")), "{said}");
    assert!(said.contains("of those given"), "{said}");
    let right = |json: &Value| json["all_acc"].as_f64().unwrap();
    assert!(right(&on) < right(&off) && right(&on["of_those_given"]) > right(&on));
    // A stored plan gives the same figures without looking again.
    let (output, _, path) = run("again", &["--effect-plan", &at("on/receipt.json")]);
    done(&output);
    let again = json(&path);
    for key in ["all_acc", "f_miou", "withheld", "of_those_given"] {
        assert_eq!(again[key], on[key], "{key}");
    }
    for (more, part) in [
        (vec!["--features", "oracle", "--effect", "holes=on"], "nothing here acts on holes"),
        (vec!["synthetic:500:1", "--effect-plan", &at("on/receipt.json")], "one scene only"),
    ] {
        let (output, ..) = run("no", &more);
        let text = stderr(&output);
        assert!(output.status.code() == Some(2) && text.contains(part), "{text}");
    }
}
