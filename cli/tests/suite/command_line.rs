//! What is around the commands: help, version, a file of defaults, the form of messages.

use crate::support::*;
use serde_json::Value;
use std::process::Output;

/// Runs a command line with a file of defaults.
#[track_caller]
fn by(file: &str, line: &str) -> Output {
    with_defaults(&words(line), Some(file.as_ref()))
}

/// The lines of standard error, each a JSON object.
#[track_caller]
fn objects(output: &Output) -> Vec<Value> {
    let said = stderr(output);
    let parse = |line: &str| {
        let value: Value = serde_json::from_str(line).unwrap_or_else(|e| panic!("{line}: {e}"));
        assert!(value["message"].is_string(), "{line}");
        assert!(["info", "warning", "error"].iter().any(|l| value["level"] == *l), "{line}");
        value
    };
    said.lines().map(parse).collect()
}

#[test]
fn the_version_says_what_was_built() {
    let version = env!("CARGO_PKG_VERSION");
    assert_eq!(printed(&run!("-V")), format!("scenesplat {version}\n"));
    let long = printed(&run!("--version"));
    let mut lines = long.lines();
    assert_eq!(lines.next(), Some(&*format!("scenesplat {version}")));
    for name in ["commit", "target", "features", "compiler"] {
        let line = lines.next().unwrap();
        let value = line.strip_prefix(&format!("{name}: ")).unwrap_or_default();
        assert!(!value.is_empty(), "{name}: {long}");
    }
    has(&long, &[std::env::consts::ARCH, "rustc "]);
}

#[test]
fn misspelt_commands_and_flags_get_the_nearest() {
    refused(&run!("segmnt room.ply"), 2, &["'segment'"]);
    refused(&run!("segment room.ply --vote-q 3"), 2, &["'--vote-k'"]);
    let folder = Folder::new();
    let room = folder.room("room.ply", 500, 1);
    let misspelt = run!("segment {room} --without cieling --out {}", folder.at("out"));
    refused(&misspelt, 1, &["cieling", "ceiling"]);
}

#[test]
fn negative_numbers_are_values_that_flags_refuse() {
    for line in ["segment room.ply --vote-k -1", "objects room.ply --gap -0.1"] {
        let output = run!("{line}");
        refused(&output, 2, &["invalid value '-"]);
        assert!(!stderr(&output).contains("-- -"), "{}", stderr(&output));
    }
}

#[test]
fn a_file_gives_what_the_command_line_does_not() {
    let folder = Folder::new();
    let room = folder.room("room.ply", 1500, 1);
    let file = folder.write(
        "scenesplat.toml",
        "vote-k = 3\nthreads = 2\n[features]\nhalf = 1\n[segment]\nwithout = \"ceiling,floor\"\n\
         vote-k = 0\nquiet = true\nas-is = false\n",
    );
    refused(&by(&file, "inspect x"), 2, &["[features]: half: no such flag; nearest: halo"]);
    let file = folder.write("scenesplat.toml", text(&file).replace("half = 1", "halo = 40"));
    let out = folder.at("out");
    let line = format!("segment {room} --out {out} --preview-size 64 --brief");
    let said = told(&by(&file, &line));
    let first = said.lines().next().unwrap();
    let mut found: Vec<&str> = first.split(' ').filter(|word| word.starts_with("--")).collect();
    found.sort_unstable();
    assert_eq!(found, ["--quiet", "--threads=2", "--vote-k=0", "--without=ceiling,floor"]);
    let receipt = json(folder.path("out/receipt.json"));
    assert_eq!(setting(&receipt, "vote_k").as_deref(), Some("0"));
    let defaults = receipt["defaults"].as_array().unwrap();
    let of = |name: &str| defaults.iter().find(|d| d["name"] == name).map(|d| d["value"].clone());
    assert_eq!(of("--without"), Some("ceiling,floor".into()));
    assert_eq!(of("--quiet"), Some("true".into()));
    assert_eq!(defaults[0]["why"], file.as_str());
    let by_file = bytes(folder.path("out/labels.npy"));
    done(&run!("{line} --threads 1 --vote-k 0 --without ceiling,floor"));
    assert!(by_file == bytes(folder.path("out/labels.npy")), "the same flags, other labels");
    assert_eq!(json(folder.path("out/receipt.json"))["defaults"], Value::Null);

    // The command line wins, in both spellings; the file is ignored when it is told to be.
    for more in ["--vote-k 5", "--vote-k=5"] {
        let said = told(&by(&file, &format!("{line} {more}")));
        assert!(!said.contains("--vote-k"), "{said}");
        assert_eq!(setting(&json(folder.path("out/receipt.json")), "vote_k").as_deref(), Some("5"));
    }
    // So it does where it excludes what the file gives.
    let said = told(&by(&file, &line.replace("--brief", "-v")));
    assert!(!said.lines().next().unwrap().contains("--quiet"), "{said}");
    let said = told(&by(&file, &format!("{line} --no-config")));
    assert!(!said.contains("scenesplat.toml"), "{said}");
    assert_eq!(setting(&json(folder.path("out/receipt.json")), "vote_k").as_deref(), Some("25"));
}

#[test]
fn a_flag_of_the_command_line_puts_out_what_it_excludes() {
    let folder = Folder::new();
    let room = folder.room("room.ply", 500, 1);
    let file = folder.write("defaults.toml", "[segment]\nunit = \"cm\"\nvote-k = 1\n");
    let line = format!("segment {room} --out {} --preview-size 64", folder.at("out"));
    let said = told(&by(&file, &format!("{line} --as-is")));
    assert!(said.contains("--vote-k=1") && !said.contains("--unit"), "{said}");
    has(&told(&by(&file, &line)), &["--unit=cm"]);
}

#[test]
fn files_of_defaults_that_mean_nothing_are_refused() {
    let folder = Folder::new();
    for (text, part) in [
        ("[segmnt]\nvote-k = 1", "segmnt: no such command; nearest: segment"),
        ("[segment]\nvote_k = 1", "[segment]: vote_k: no such flag; nearest: vote-k"),
        ("[prepare.scans]\nkeep-all = true", "[prepare]: scans: no such command; nearest: scan"),
        ("[inspect]\nscene = \"a.ply\"", "scene: no such flag"),
        ("no-config = true", "no-config: no such flag"),
        ("[pareto-point]\nthreads = 1", "pareto-point: no such command"),
        ("[inspect]\nquiet = 1", "quiet = 1: true or false is expected"),
        ("[inspect]\nthreads = [1, 2]", "threads = [1, 2]: one text or number is expected"),
        ("[inspect]\nthreads = \"many\"", "--threads=many"),
        ("vote-k = ", "no TOML"),
    ] {
        let file = folder.write("defaults.toml", text);
        let said = refused(&by(&file, "inspect nowhere.ply --brief"), 2, &["defaults.toml"]);
        has(&said, &[part]);
    }
    let gone = folder.at("gone.toml");
    refused(&by(&gone, "inspect nowhere.ply"), 1, &["gone.toml"]);
    // What a shell asks for when it starts is not about the file.
    done(&by(&gone, "completions bash"));
}

#[test]
fn parts_of_commands_have_sections_and_lists_are_given_again() {
    let folder = Folder::new();
    let file = folder.write(
        "defaults.toml",
        "log-format = \"json\"\n[prepare.scan]\nlayout = \"points\"\n[train]\nset = [\"trainer.epochs=3\", \"loader.workers=0\"]\n",
    );
    // The flag that is required is there, so what is missing is the scan.
    let said = refused(&by(&file, "prepare scan nowhere.ply --scan here"), 1, &["here: cannot"]);
    has(&said, &["--layout=points", "\"level\":\"error\""]);
    let config = folder.write("experiment.toml", small_segmentation());
    has(&printed(&by(&file, &format!("train {config} --check"))), &["epochs = 3", "workers = 0"]);
    let changed = format!("train {config} --check --set trainer.epochs=5");
    has(&printed(&by(&file, &changed)), &["epochs = 5", "workers = 1"]);
}

#[test]
fn a_process_finds_its_file_of_defaults() {
    let folder = Folder::new();
    let config = folder.write("experiment.toml", small_segmentation());
    let run = |change: &dyn Fn(&mut std::process::Command)| {
        let mut program = program();
        program.args(["train", &config, "--check"]).current_dir(folder.root());
        program.env_remove("SCENESPLAT_CONFIG").env("XDG_CONFIG_HOME", folder.at("xdg"));
        change(&mut program);
        printed(&program.output().unwrap())
    };
    let with = |epochs: u32| format!("[train]\nset = [\"trainer.epochs={epochs}\"]\n");
    folder.write("xdg/scenesplat/config.toml", with(11));
    has(&run(&|_| {}), &["epochs = 11"]);
    folder.write("scenesplat.toml", with(12));
    has(&run(&|_| {}), &["epochs = 12"]);
    let named = folder.write("named.toml", with(13));
    has(&run(&|program| _ = program.env("SCENESPLAT_CONFIG", &named)), &["epochs = 13"]);
    has(&run(&|program| _ = program.env("SCENESPLAT_CONFIG", "")), &["epochs = 2"]);
}

#[test]
fn messages_are_json_where_they_are_asked_for() {
    let folder = Folder::new();
    let room = folder.room("room.ply", 1500, 1);
    let output =
        run!("segment {room} --out {} --preview-size 64 --log-format json", folder.at("out"));
    done(&output);
    let all = objects(&output);
    assert!(all.iter().any(|m| m["stage"].is_string() && m["total"] == 1 && m["done"].is_number()));
    // Results are what they were.
    assert_eq!(printed(&run!("text sofa --log-format json")), printed(&run!("text sofa")));
    // Failures and wrong uses too, also where the command line is not understood.
    let failed = objects(&run!("inspect {room}.ply --log-format json"));
    assert_eq!(failed.last().unwrap()["level"], "error");
    has(failed.last().unwrap()["message"].as_str().unwrap(), &["room.ply.ply"]);
    assert_eq!(objects(&run!("--log-format json inspct"))[0]["level"], "error");
    refused(&run!("inspect {room} --log-format xml"), 2, &["xml"]);
}

#[test]
fn colors_can_be_switched_off() {
    let help = |variables: &[(&str, &str)]| {
        let mut program = program();
        program.arg("--help").env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE");
        printed(&program.envs(variables.iter().copied()).output().unwrap())
    };
    let (plain, forced) = (help(&[]), help(&[("CLICOLOR_FORCE", "1")]));
    assert!(forced.contains("\x1b[") && !plain.contains("\x1b["));
    assert_eq!(help(&[("CLICOLOR_FORCE", "1"), ("NO_COLOR", "1")]), plain);
    has(&plain, &["\nLook:\n  inspect"]);
}

#[test]
fn a_report_of_a_bug_has_what_is_needed_and_no_paths() {
    let mut program = program();
    program.args(["doctor", "--report"]).env("SCENESPLAT_ISA", "avx2");
    program.env("HOME", "/srv/somebody").env("SCENESPLAT_FRONTS", "/srv/somebody/fronts");
    let said = printed(&program.output().unwrap());
    has(
        &said,
        &["scenesplat ", "\ncommit: ", "\ntarget: ", "\nsystem: ", "\nprocessor: ", "\nmemory: "],
    );
    has(&said, &["SCENESPLAT_FRONTS (set), SCENESPLAT_ISA=avx2", "cases passed"]);
    assert!(!said.contains("somebody") && !said.contains("; failed: "), "{said}");
    let folder = env!("CARGO_MANIFEST_DIR");
    assert!(!said.contains(folder), "{said}");
    refused(&run!("doctor --report --full"), 2, &["--full"]);
    refused(&run!("doctor --report --json report.json"), 2, &["--json"]);
}

#[test]
fn schemas_are_printed() {
    for (of, part) in [("train", "early_stopping"), ("grid", "neutral")] {
        let schema: Value = serde_json::from_str(&printed(&run!("schema {of}"))).unwrap();
        assert!(schema["properties"][part].is_object(), "{of}: {schema}");
        assert_eq!(schema["additionalProperties"], false);
    }
    refused(&run!("schema tarin"), 2, &["'train'"]);
}
