use super::*;
use std::cell::RefCell;

fn settings(seconds: f64, seed: u64) -> SoakSettings {
    SoakSettings { duration: Duration::from_secs_f64(seconds), seed }
}

#[test]
fn a_short_soak_finds_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let shares = RefCell::new(Vec::new());
    let report = soak(settings(1.0, 1), folder.path(), &mut |share, _, _| {
        shares.borrow_mut().push(share);
        true
    })
    .unwrap();
    // Other tests of this process take memory beside it; the program's own test looks at that.
    assert!(report.problems.is_empty() && !report.stopped, "{report}");
    assert!(report.kinds.iter().all(|kind| kind.rounds > 0), "{report}");
    assert_eq!(report.rounds, report.kinds.iter().map(|kind| kind.rounds).sum::<u64>());
    assert!(shares.borrow().is_sorted());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "files are left behind");
    let json = serde_json::to_string(&report).unwrap();
    assert_eq!(serde_json::from_str::<SoakReport>(&json).unwrap(), report);
}

const FINE: Kind = Kind { name: "fine", run: |_, _| Ok(Outcome::Sound) };

/// Each thing that a soak looks for, planted.
#[test]
fn what_goes_wrong_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let run = |kind: Kind| {
        let go_on = &mut |_, round, _| round < 40;
        super::run(&[FINE, kind], settings(1e6, 3), folder.path(), go_on).unwrap()
    };
    let panicking = run(Kind {
        name: "panicking",
        run: |_, rng| match rng.below(2) {
            0 => Ok(Outcome::Refused),
            _ => panic!("planted"),
        },
    });
    assert!(!panicking.passed && panicking.kinds[0].problems == 0);
    assert!(panicking.kinds[1].problems > 0 && panicking.kinds[1].refused > 0, "{panicking}");
    let first = &panicking.problems[0];
    assert_eq!((first.kind.as_str(), first.text.as_str()), ("panicking", "panicked: planted"));
    assert!(first.round % 2 == 1 && panicking.problems.len() <= TOLD);
    let failing = run(Kind { name: "failing", run: |_, _| Err(Failure("not finite".to_owned())) });
    assert!(!failing.passed && failing.to_string().contains("(failing): not finite"), "{failing}");
    // The same seed has the same rounds: what failed fails again.
    let mut bath = Bath::new(folder.path()).unwrap();
    let draw = |bath: &mut Bath, seed, round| {
        let kind = Kind { name: "draw", run: |_, rng| Err(Failure(rng.next().to_string())) };
        once(&kind, bath, seed, round).err().unwrap().0
    };
    assert_eq!(draw(&mut bath, 7, 12), draw(&mut bath, 7, 12));
    assert_ne!(draw(&mut bath, 7, 12), draw(&mut bath, 7, 13));
    assert_ne!(draw(&mut bath, 7, 12), draw(&mut bath, 8, 12));
}

#[cfg(target_os = "linux")]
#[test]
fn memory_that_grows_is_seen() {
    let folder = tempfile::tempdir().unwrap();
    let leak = Kind {
        name: "leak",
        run: |_, _| {
            std::thread::sleep(Duration::from_millis(2));
            // Written to, or the system hands out no page.
            std::mem::forget(vec![1u8; 1 << 20]);
            Ok(Outcome::Sound)
        },
    };
    let report = super::run(&[leak], settings(1.5, 1), folder.path(), &mut |_, _, _| true).unwrap();
    let memory = &report.memory;
    assert!(memory.flat == Some(false) && !report.passed, "{report}");
    assert!(memory.start < memory.middle && memory.middle < memory.end, "{memory}");
    assert!(memory.peak >= memory.end && report.to_string().contains("it GROWS"));
}

#[test]
fn it_stops_when_asked_to() {
    let folder = tempfile::tempdir().unwrap();
    let report =
        super::run(&[FINE], settings(1e6, 1), folder.path(), &mut |_, round, _| round < 5).unwrap();
    assert!(report.stopped && report.rounds == 5, "{report}");
    assert!(report.to_string().ends_with("passed, stopped before its time"), "{report}");
}
