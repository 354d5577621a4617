//! `adapt`: a network learns the labels of one scene, and forgets no room.

use crate::support::*;
use scenesplat::scene::formats::npy_folder::write_npy_folder;
use scenesplat::scene::formats::npy_writer::write_npy;
use std::process::Output;

/// What makes it small.
const SMALL: &str = "--room-gaussians 1500 --rooms 1 --quiet";

fn adapt(folder: &Folder, words: &str) -> Output {
    line(&format!("adapt {SMALL} {words}").replace('@', &folder.at("")))
}

/// A room with labels in `room`, and in `half.npy` those of half of its objects.
fn half_labeled(folder: &Folder) -> Vec<i32> {
    let room = room(1500, 3);
    let (segment, instance) = (room.segment.clone().unwrap(), room.instance.clone().unwrap());
    let half = |(label, object): (&i32, &i32)| if object % 2 == 0 { *label } else { -1 };
    let labels: Vec<i32> = segment.iter().zip(&instance).map(half).collect();
    write_npy_folder(&room, &folder.path("room"), false).unwrap();
    write_npy(&folder.path("half.npy"), &[labels.len()], &labels).unwrap();
    labels
}

#[test]
#[ignore = "24 steps of the network inside the program"]
fn a_network_learns_what_it_is_shown() {
    let folder = Folder::new();
    half_labeled(&folder);
    let words = "@room --labels @half.npy --truth --steps 24 --lr 0.002 --share 1 --seed 5";
    done(&adapt(&folder, &format!("{words} --out @one")));
    let found = json(folder.path("one/adaptation.json"));
    let share = |at: &str, of: &str| {
        let right = &found[at].pointer(of).unwrap();
        right["right"].as_f64().unwrap() / right["rows"].as_f64().unwrap()
    };
    for of in ["/learned", "/truth/labeled"] {
        let (before, after) = (share("before", of), share("after", of));
        assert!(after > before + 0.1, "{of}: {before} to {after}");
    }
}

#[test]
fn an_adapted_network_is_a_model_that_commands_take() {
    let folder = Folder::new();
    half_labeled(&folder);
    let words = "@room --labels @half.npy --truth --steps 2 --lr 0.002 --share 1 --seed 5";
    let said = printed(&adapt(&folder, &format!("{words} --threads 1 --out @one")));
    has(&said, &["labels that were learned", "labels held out", "mIoU of other classes"]);
    has(&said, &["one --text vocabulary", "no more said: --strange"]);
    let found = json(folder.path("one/adaptation.json"));
    // What was held out was not learned, and is a part of the labels.
    let rows = |of: &str| found["before"].pointer(of).unwrap()["rows"].as_u64().unwrap();
    assert!(rows("/held_out") > 0 && rows("/learned") > rows("/held_out"));
    assert_eq!(rows("/truth/all"), rows("/truth/labeled") + rows("/truth/unlabeled"));
    assert_eq!(rows("/truth/all"), rows("/truth/known") + rows("/truth/others"));
    assert!(rows("/truth/others") > 0 && rows("/rooms/all") == 1500);
    let receipt = json(folder.path("one/receipt.json"));
    let settings = receipt["settings"].as_array().unwrap();
    let elsewhere =
        settings.iter().find(|s| s["name"].as_str().unwrap().contains("): elsewhere ("));
    has(elsewhere.unwrap()["value"].as_str().unwrap(), &[" to "]);

    // The same bits on any number of threads; another seed is another network.
    done(&adapt(&folder, &format!("{words} --threads 3 --out @two")));
    let weights = |out: &str| bytes(folder.path(out).join("model.safetensors"));
    assert!(weights("one") == weights("two"), "other bits with other threads");
    assert_eq!(found, json(folder.path("two/adaptation.json")));
    // Once more: nothing is left to train, and the result stays.
    let loud = format!("adapt {} {words} --out @two", SMALL.replace("--quiet", ""));
    has(&told(&line(&loud.replace('@', &folder.at("")))), &["gone on with"]);
    assert!(weights("one") == weights("two"));

    // A model like any other, with probabilities that are its own.
    let run = |words: &str| line(&words.replace('@', &folder.at("")));
    let model = "--weights @one --text vocabulary";
    done(&run(&format!("segment @room {model} --min-probability 0.5 --out @labels")));
    done(&run(&format!("evaluate @room {model} --out @figures")));
    // It can learn more.
    done(&adapt(&folder, "@room --labels @half.npy --steps 1 --weights @one --out @more"));
    assert!(weights("more") != weights("one"));
}

#[test]
fn labels_come_with_names_or_maps() {
    let folder = Folder::new();
    let labels = half_labeled(&folder);
    let names = class_names();
    // Two names of others' for two classes, and the rest by theirs.
    let other = |name: &str| match name {
        "table" => "dining table".to_owned(),
        "chair" => "Stuhl".to_owned(),
        name => name.to_owned(),
    };
    let others: Vec<String> = names.iter().map(|name| other(name)).collect();
    folder.write("own/classes.json", serde_json::to_string(&others).unwrap());
    write_npy(&folder.path("own/labels.npy"), &[labels.len()], &labels).unwrap();
    folder.write("map.toml", "Stuhl = \"chair\"\nwall = \"wall\"\n");
    let known = |out: &str| -> Vec<String> {
        let found = json(folder.path(out).join("adaptation.json"));
        serde_json::from_value(found["known"].clone()).unwrap()
    };
    let of = |id: usize| labels.contains(&i32::try_from(id).unwrap());
    let labeled = (0..names.len()).filter(|id| of(*id)).map(|id| names[id].clone());
    let labeled: Vec<String> = labeled.collect();
    assert!(labeled.len() > 4, "{labeled:?}");
    let only = |keep: &dyn Fn(&str) -> bool| -> Vec<String> {
        labeled.iter().filter(|name| keep(name)).cloned().collect()
    };
    let named = |more: &str| adapt(&folder, &format!("@room --labels @own --out @out {more}"));
    done(&named("--steps 1"));
    assert_eq!(known("out"), only(&|name| name != "chair"));

    // Of something else than what lies there.
    refused(&named("--steps 2"), 2, &["an adaptation of other settings", "--anew"]);
    let map = "--label-names @own/classes.json --class-map @map.toml --steps 1";
    refused(&named(map), 2, &["an adaptation of other names of labels"]);
    let mapped = format!("@room --labels @half.npy {map} --out @out");
    refused(&adapt(&folder, &mapped), 2, &["an adaptation of other labels"]);
    let said = told(&adapt(&folder, &format!("{mapped} --anew")));
    has(&said, &["the training of something else is removed"]);
    assert_eq!(known("out"), only(&|name| ["chair", "wall"].contains(&name)));
}

#[test]
fn what_cannot_be_learned_is_refused() {
    let folder = Folder::new();
    let labels = half_labeled(&folder);
    folder.write("map.toml", "Stuhl = \"chair\"\nwall = \"wall\"\n");
    let short = &labels[1..];
    write_npy(&folder.path("short.npy"), &[short.len()], short).unwrap();
    write_npy(&folder.path("high.npy"), &[labels.len()], &vec![41; labels.len()]).unwrap();
    write_npy(&folder.path("none.npy"), &[labels.len()], &vec![255; labels.len()]).unwrap();
    write_npy(&folder.path("wide.npy"), &[labels.len() / 2, 2], &labels[..labels.len() / 2 * 2])
        .unwrap();
    folder.write("empty/a.txt", "");
    folder.room("bare.ply", 500, 1);
    all_refused(
        [
            ("@room --labels @short.npy", 1, "has 1499 rows, the scene 1500"),
            ("@room --labels @high.npy", 1, "row 0 has id 41, and there are 41 names"),
            ("@room --labels @none.npy", 2, "name none of the classes"),
            ("@room --labels @wide.npy", 1, "not [Gaussians]"),
            ("@room --labels @empty", 1, "holds neither classes.safetensors nor labels.npy"),
            ("@room --labels @nowhere.npy", 1, "nowhere.npy"),
            ("@room --labels @half.npy --held-out 1", 2, "0 to below 1"),
            ("@room --labels @half.npy --held-out 0.999999", 2, "nothing is left to learn"),
            ("@room --labels @half.npy --steps 0", 2, "--steps"),
            ("@room --labels @half.npy --weights seeded:1", 2, "has nothing to keep"),
            ("@room --labels @half.npy --class-map @map.toml", 2, "--label-names"),
        ],
        |words: &str| adapt(&folder, &format!("{words} --out @refused")),
    );
}

#[cfg(target_os = "linux")]
#[test]
fn a_stopped_adaptation_goes_on_with_the_same_bits() {
    let folder = Folder::new();
    half_labeled(&folder);
    let command = |out: &str| {
        format!("adapt {SMALL} @room --labels @half.npy --steps 4 --out @{out}")
            .replace('@', &folder.at(""))
    };
    done(&line(&command("whole")));
    let mut child = program().args(words(&command("stopped"))).spawn().unwrap();
    let log = folder.path("stopped/run/metrics.jsonl");
    while !std::fs::read(&log).is_ok_and(|bytes| bytes.contains(&b'\n')) {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it was stopped");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let interrupt = format!("kill -INT {}", child.id());
    assert!(std::process::Command::new("sh").args(["-c", &interrupt]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(4));
    assert!(!folder.path("stopped/model.safetensors").exists());
    done(&line(&command("stopped")));
    for name in ["model.safetensors", "calibration.json", "adaptation.json"] {
        let of = |out: &str| bytes(folder.path(out).join(name));
        assert!(of("stopped") == of("whole"), "{name}");
    }
}
