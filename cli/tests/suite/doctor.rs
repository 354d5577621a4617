//! `doctor`: cases run, verdicts are told, wrong names are refused, and it stops when asked to.

use crate::support::*;

/// Runs `doctor` with a report, and gives what it prints and the report. As a process: it may run itself under other
/// instruction sets, and watches the memory of its process.
fn doctor(folder: &Folder, more: &str) -> (String, serde_json::Value) {
    let file = folder.at("doctor.json");
    let said = printed(&process(&words(&format!("doctor {more} --json {file}"))));
    (said, json(file))
}

/// One level, to be quick: the whole catalogue runs in the library's tests.
#[test]
fn the_quick_operators_pass_and_are_told_as_json() {
    let folder = Folder::new();
    let (table, report) = doctor(&folder, "--level operators");
    let number = |field: &str| report[field].as_u64().unwrap();
    assert!(number("cases") > 80, "{}", number("cases"));
    assert_eq!((number("passed"), number("failed")), (number("cases"), 0));
    assert!(report["seconds"].as_f64().unwrap() > 0.0);
    let verdicts = report["verdicts"].as_array().unwrap();
    assert_eq!(verdicts.len() as u64, number("cases"));
    for verdict in verdicts {
        let name = verdict["name"].as_str().unwrap();
        assert!(table.contains(name), "{name} is not in the table");
        assert_eq!((&verdict["passed"], &verdict["level"]), (&true.into(), &"operators".into()));
        for field in ["origin", "reason", "area"] {
            assert!(!verdict[field].as_str().unwrap().is_empty(), "{field} of {name}");
        }
    }
    let machine = &report["surroundings"];
    assert!(machine["instruction_sets"].as_array().unwrap().contains(&"portable".into()));
    assert!(machine["threads"][1].as_u64().unwrap() >= 2, "{machine}");
    has(&table, &["instruction sets: portable", "memory: "]);
    assert_eq!(folder.count(), 1, "only the report is left");
}

#[test]
fn one_case_keeps_what_it_made() {
    let folder = Folder::new();
    for (case, file) in [("ply-quat-w-zero", "scene.ply"), ("product-f32-odd-shapes", "a_1x1.npy")]
    {
        let line = format!("doctor --case {case} --out {}", folder.at("out"));
        let kept = folder.path("out").join(case);
        let said = printed(&process(&words(&line)));
        has(&said, &["1 cases, 1 passed, 0 failed", kept.to_str().unwrap()]);
        assert!(kept.join(file).is_file(), "{file} of {case}");
        // A second run does not write into the folder of the first.
        refused(&run!("{line}"), 2, &["is there already"]);
    }
}

#[test]
fn wrong_use_and_flags_that_would_do_nothing_are_refused() {
    let cases = [
        ("--case ply-quat-w-zer0", 2, "no such case"),
        ("--case ply-quat-w-zer0", 2, "ply-quat-w-zero"),
        ("--level operator", 2, ""),
        ("--threads 0", 2, ""),
        ("--case ply-ascii --full", 2, ""),
        ("--case ply-ascii --json no/folder/a.json", 1, "a.json"),
        ("--seed 3", 2, ""),
        ("--steps 3", 2, ""),
        ("--recipe gaussian-ssl", 2, ""),
        ("--training --recipe none", 2, ""),
        ("--training --steps 0", 2, ""),
        ("--training --seeds 0", 2, ""),
        ("--soak 1s --full", 2, ""),
        ("--soak 1s --training", 2, ""),
        ("--round 3 --json a.json", 2, ""),
        ("--soak soon", 2, ""),
    ];
    all_refused(cases, |more| run!("doctor {more}"));
}

/// Ctrl-C: it says so, and leaves nothing behind.
#[cfg(target_os = "linux")]
#[test]
fn ctrl_c_stops_it() {
    interrupted("doctor", "inputs");
}

#[test]
fn a_short_soak_is_told_as_json_and_a_round_runs_again() {
    let folder = Folder::new();
    let (said, report) = doctor(&folder, "--soak 2s --seed 5");
    assert!(said.contains("seed 5") && said.trim_end().ends_with("passed"), "{said}");
    assert_eq!((&report["passed"], &report["seed"]), (&true.into(), &5.into()));
    assert!(report["rounds"].as_u64().unwrap() >= 7);
    assert!(report["problems"].as_array().unwrap().is_empty());
    #[cfg(target_os = "linux")]
    assert!(report["memory"]["end"].as_u64().unwrap() > 0);
    let said = printed(&process(&["doctor", "--round", "3", "--seed", "5"]));
    has(&said, &["round 3 of seed 5 (network): passed"]);
}

/// The thread that trains is one of those that compute: as a mere caller it would sleep and be woken around every operation,
/// a thousand times a step.
#[cfg(target_os = "linux")]
#[test]
#[expect(clippy::zombie_processes, reason = "`wait4` waits, and tells what was used")]
fn the_calling_thread_works_itself() {
    let child = program()
        .args(["doctor", "--training", "--steps", "3", "--seeds", "1", "--threads", "1"])
        .args(["--recipe", "self-distillation"])
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let (mut status, mut usage) = (0, std::mem::MaybeUninit::<libc::rusage>::zeroed());
    // SAFETY: the process is a child that nobody else waits for, and both places are there to be written.
    let waited = unsafe { libc::wait4(child.id() as i32, &mut status, 0, usage.as_mut_ptr()) };
    assert_eq!((waited, status), (child.id() as i32, 0));
    // SAFETY: zeros are a value, and `wait4` wrote it.
    let switches = unsafe { usage.assume_init() }.ru_nvcsw;
    assert!(switches < 1000, "{switches} times asleep in twelve steps");
}

#[test]
fn a_short_grid_of_trainings_is_told_as_json() {
    let folder = Folder::new();
    let (said, report) = doctor(&folder, "--training --steps 1 --seeds 1");
    has(&said, &["24 trainings, 0 failed"]);
    assert_eq!(report["runs"].as_array().unwrap().len(), 24);
    assert_eq!(report["poison"]["recovered"], true);
    let (said, _) = doctor(&folder, "--training --steps 1 --seeds 1 --recipe gaussian-ssl");
    assert!(said.contains("4 trainings, 0 failed") && !said.contains("poisoned"), "{said}");
}

#[test]
fn curves_are_told_and_drawn() {
    let folder = Folder::new();
    let few = format!("doctor --curves {} --rooms 1 --gaussians", folder.at("curves"));
    let said = printed(&process(&words(&format!("{few} 1000"))));
    has(&said, &["holes", "floaters", "f-mIoU", "largest fall", "rank correlation", "far away"]);
    let found = json(folder.path("curves/severity.json"));
    assert!(found["curves"].as_array().unwrap().len() >= 6, "{found}");
    assert!(folder.path("curves/severity.png").is_file());
    assert!(folder.path("curves/severity.svg").is_file());
    refused(&run!("{few} 10"), 2, &[]);
}
