use super::*;

#[test]
fn a_suite_has_clean_scenes_single_effects_and_pairs() {
    let all = mixed(24);
    let with = |n: usize| all.iter().filter(|effects| effects.len() == n).count();
    assert_eq!([with(0), with(1), with(2)], [6, 7, 11]);
    let mut distinct: Vec<String> = all.iter().map(|e| names(e)).collect();
    distinct.sort();
    distinct.dedup();
    assert_eq!(distinct.len(), 1 + 7 + 11);
    assert_eq!(pairs().len(), 21);
    assert_eq!(mixed(25)[24], all[0]);
}

#[test]
fn a_small_suite_is_run_and_nothing_is_done_by_itself() {
    let settings =
        SuiteSettings { scenes: 3, pair_rooms: 0, gaussians: 12_000, ..SuiteSettings::default() };
    let mut shares = Vec::new();
    let report = effect_suite(&settings, &mut |_, share| {
        shares.push(share);
        true
    })
    .unwrap();
    assert!(shares.is_sorted() && shares.iter().all(|s| (0.0..=1.0).contains(s)), "{shares:?}");
    let effects: Vec<&str> = report.rows.iter().map(|row| row.effects.as_str()).collect();
    assert_eq!(effects, ["none", "holes", "floaters"]);
    let mode = |name: &str| report.modes.iter().find(|m| m.mode == name).unwrap();
    let (off, auto, on) = (mode("off"), mode("auto"), mode("on"));
    assert_eq!((off.f_miou, off.ece, off.unknown), (auto.f_miou, auto.ece, auto.unknown));
    assert_eq!((off.left_out, off.withheld, auto.left_out, auto.withheld), (0, 0, 0, 0));
    assert!(on.left_out > 0 && on.withheld > 0 && on.unknown > 0.0, "{report}");
    assert_eq!(report.worth.len(), 2);
    let json = serde_json::to_string(&report).unwrap();
    assert_eq!(serde_json::from_str::<SuiteReport>(&json).unwrap(), report);
    assert!(report.to_string().contains("where there are floaters"), "{report}");
    let stopped = effect_suite(&settings, &mut |_, share| share < 0.3);
    assert!(matches!(stopped, Err(SeverityError::Stopped)));
    for wrong in [
        SuiteSettings { scenes: 0, ..settings.clone() },
        SuiteSettings { gaussians: 10, ..settings.clone() },
        SuiteSettings { severity: f64::NAN, ..settings },
    ] {
        assert!(matches!(
            effect_suite(&wrong, &mut |_, _| true),
            Err(SeverityError::Setting { .. })
        ));
    }
}

#[test]
fn what_is_worth_it_and_what_two_effects_add_up_to_by_hand() {
    let figures = |f_miou: f64, ece: f64| Figures {
        mode: String::new(),
        f_miou,
        ece,
        unknown: 0.0,
        right: 0.5,
        seconds: 1.0,
        left_out: 0,
        withheld: 0,
    };
    let worth = |f_miou, ece| Worth {
        effect: "holes".to_owned(),
        off: figures(0.5, 0.1),
        on: figures(f_miou, ece),
    };
    assert!(worth(0.511, 0.1).is_worth_it() && worth(0.4, 0.079).is_worth_it());
    assert!(!worth(0.509, 0.081).is_worth_it());
    let pair =
        PairRow { effects: "holes+blur".to_owned(), clean: 0.9, alone: [0.8, 0.85], together: 0.7 };
    assert!((pair.excess() - 0.05).abs() < 1e-12);
}
