//! Rows of Gaussians a decimeter apart, whose pieces are as long as is said.

use super::*;
use crate::made::input;
use scenesplat_rooms::{CLASSES, SyntheticRoomSettings, generate};
use scenesplat_scene::GaussianScene;

/// So many Gaussians of a label, with the same shares each; meters before them besides the usual decimeter.
type Run = (usize, i32, [f32; 3], f32);

const ROW: ObjectSettings = ObjectSettings {
    min_count: 3,
    gap: Some(0.15),
    min_similarity: -1.0,
    reshape: false,
    wall: String::new(),
    floor: String::new(),
};

fn names() -> Vec<String> {
    ["a", "b", "c"].map(str::to_owned).to_vec()
}

fn refined_by(runs: &[Run], settings: RefineSettings) -> Refined {
    let (mut x, mut scene, mut labels, mut rows) =
        (0.0, GaussianScene::default(), Vec::new(), Vec::new());
    for (count, label, shares, before) in runs {
        x += before;
        for _ in 0..*count {
            scene.coord.push([x, 0.0, 0.0]);
            labels.push(*label);
            rows.extend(shares);
            x += 0.1;
        }
    }
    let row_of: Vec<u32> = (0..labels.len() as u32).collect();
    let shares = ClassShares { row_of: &row_of, rows: &rows, num_classes: 3 };
    refine(&input(&scene, &labels, &names()), &shares, &ROW, &settings).unwrap()
}

/// The label of each run after labels and objects refined each other, one for all of its Gaussians.
fn refined(runs: &[Run], settings: RefineSettings) -> Vec<i32> {
    let found = refined_by(runs, settings).labels;
    let mut start = 0;
    let of_run = runs.iter().map(|(count, ..)| {
        let own = &found[start..start + count];
        start += count;
        assert!(own.iter().all(|label| label == &own[0]), "{found:?}");
        own[0]
    });
    of_run.collect()
}

const A: [f32; 3] = [1.0, 0.0, 0.0];
const C: [f32; 3] = [0.0, 0.0, 1.0];

#[test]
fn an_object_becomes_the_larger_one_that_it_touches_and_could_be() {
    let of = |share: f32, before: f32, settings: RefineSettings| {
        refined(&[(10, 0, A, 0.0), (3, 1, [share, 0.5, 0.1], before)], settings)
    };
    let usual = RefineSettings { keep: 0.7, part: 0.5 };
    // 0.36 is 0.72 of 0.5, 0.34 is 0.68; three are 0.3 of ten.
    assert_eq!(of(0.36, 0.0, usual), [0, 0]);
    assert_eq!(of(0.34, 0.0, usual), [0, 1]);
    assert_eq!(of(0.36, 0.0, RefineSettings { keep: 0.73, ..usual }), [0, 1]);
    assert_eq!(of(0.36, 0.0, RefineSettings { part: 0.3, ..usual }), [0, 0]);
    assert_eq!(of(0.36, 0.0, RefineSettings { part: 0.29, ..usual }), [0, 1]);
    // 24 cm apart, and 26.
    assert_eq!(of(0.36, 0.14, usual), [0, 0]);
    assert_eq!(of(0.36, 0.16, usual), [0, 1]);
    // The larger one does not become the smaller one, whatever speaks for it.
    assert_eq!(
        refined(&[(10, 0, [0.5, 0.5, 0.0], 0.0), (3, 1, [0.0, 1.0, 0.0], 0.0)], usual),
        [0, 1]
    );
    let done = refined_by(&[(10, 0, A, 0.0), (3, 1, [0.4, 0.5, 0.1], 0.0)], usual);
    assert_eq!((done.renamed, done.changed), (1, 3));
}

#[test]
fn an_object_that_could_not_be_what_it_is_becomes_what_most_speaks_for() {
    let of = |shares: [f32; 3]| {
        refined(&[(4, 0, A, 0.0), (4, 1, shares, 5.0)], RefineSettings { keep: 0.7, part: 0.5 })
    };
    // 0.3 is 0.6 of 0.5, and 0.75 of 0.4.
    assert_eq!(of([0.2, 0.3, 0.5]), [0, 2]);
    assert_eq!(of([0.3, 0.3, 0.4]), [0, 1]);
    assert_eq!(of([0.5, 0.0, 0.5]), [0, 0], "of equal ones the first");
    assert_eq!(of([0.0, 0.0, 0.0]), [0, 1], "nothing speaks for anything");
    // The mean counts, not how many: 0.95 once and 0.45 twice against 0.05 once and 0.55 twice.
    let sure = [(3, 0, A, 0.0), (1, 1, [0.0, 0.05, 0.95], 5.0), (2, 1, [0.0, 0.55, 0.45], 0.0)];
    assert_eq!(refined(&sure, RefineSettings::default()), [0, 2, 2]);
    // What becomes of what it touches counts before that.
    let beside = [(10, 0, A, 0.0), (3, 1, [0.4, 0.1, 0.5], 0.0)];
    assert_eq!(refined(&beside, RefineSettings { keep: 0.7, part: 0.5 }), [0, 0]);
}

#[test]
fn of_several_that_it_could_be_the_likeliest_then_the_largest_then_the_first() {
    let of = |share: f32, right: usize| {
        let runs = [(10, 0, A, 0.0), (3, 1, [0.4, 0.5, share], 0.0), (right, 2, C, 0.0)];
        refined(&runs, RefineSettings::default())[1]
    };
    assert_eq!([of(0.41, 10), of(0.39, 20)], [2, 0]);
    assert_eq!([of(0.4, 11), of(0.4, 10), of(0.4, 9)], [2, 0, 0]);
}

#[test]
fn gaussians_in_no_object_become_what_is_around_them_if_that_speaks_for_them() {
    let of = |label: i32, shares: [f32; 3]| {
        let runs = [(5, 0, A, 0.0), (2, label, shares, 0.0), (5, 0, A, 0.0)];
        refined(&runs, RefineSettings::default())
    };
    assert_eq!(of(1, [0.4, 0.5, 0.1]), [0, 0, 0]);
    assert_eq!(of(1, [0.3, 0.5, 0.2]), [0, 1, 0]);
    assert_eq!(of(1, [0.0; 3]), [0, 1, 0], "nothing speaks for it");
    assert_eq!(of(-1, A), [0, -1, 0], "without a label it has none");
    // Three of the five within reach are in the right one.
    let between = [(3, 0, A, 0.0), (1, 1, [0.4, 0.4, 0.4], 0.0), (6, 2, C, -0.08)];
    assert_eq!(refined(&between, RefineSettings::default()), [0, 2, 2]);
    assert_eq!(most(&[3, 1, 1, 3, NONE, NONE, NONE, NONE]), Some(1));
    assert_eq!(
        (most(&[NONE; 8]), most(&[NONE, 4, NONE, NONE, NONE, NONE, NONE, NONE])),
        (None, Some(4))
    );
}

#[test]
fn what_was_renamed_makes_other_objects_in_the_next_round() {
    // The last one could be of the first, but touches only the middle one, which is of it after a round.
    let runs = [(12, 0, A, 0.0), (6, 2, [0.4, 0.0, 0.5], 0.0), (3, 1, [0.4, 0.5, 0.0], 0.0)];
    assert_eq!(refined(&runs, RefineSettings::default()), [0, 0, 0]);
    let done = refined_by(&runs, RefineSettings::default());
    assert_eq!((done.renamed, done.changed), (2, 9));
}

#[test]
fn few_gaussians_without_a_place_or_of_one_label_stay() {
    let usual = RefineSettings::default();
    for count in 0..3 {
        let done = refined_by(&[(count, 1, A, 0.0)], usual);
        assert_eq!(done, Refined { labels: vec![1; count], renamed: 0, changed: 0 });
    }
    assert_eq!(refined(&[(20, 2, [0.1, 0.2, 0.7], 0.0)], usual), [2]);
    assert_eq!(refined(&[(20, -1, A, 0.0)], usual), [-1]);
    let nowhere = [(5, 0, A, 0.0), (1, 1, [0.5, 0.5, 0.0], f32::NAN)];
    assert_eq!(refined(&nowhere, usual), [0, 1]);
}

#[test]
fn it_is_the_same_for_any_number_of_threads_and_reads_no_instances() {
    let room = generate(&SyntheticRoomSettings::with_count(8000, 4)).unwrap();
    let names: Vec<String> = CLASSES.iter().map(|class| class.name.to_owned()).collect();
    let (truth, classes) = (room.scene.segment.as_deref().unwrap(), names.len());
    // Every ninth patch is taken for the next class; shares waver between the two.
    let patch =
        |row: usize| (room.scene.coord[row].map(|v| (v * 3.0) as usize)).iter().sum::<usize>();
    let label = |row: usize| match truth[row] {
        own if own >= 0 && patch(row) % 9 == 0 => (own + 1) % classes as i32,
        own => own,
    };
    let labels: Vec<i32> = (0..truth.len()).map(label).collect();
    let mut rows = vec![0.0; truth.len() * classes];
    for (row, (&truth, &label)) in truth.iter().zip(&labels).enumerate() {
        if let (Ok(truth), Ok(label)) = (usize::try_from(truth), usize::try_from(label)) {
            rows[row * classes + label] += 0.5;
            rows[row * classes + truth] += 0.3 + 0.02 * (row % 10) as f32;
        }
    }
    let row_of: Vec<u32> = (0..truth.len() as u32).collect();
    let shares = ClassShares { row_of: &row_of, rows: &rows, num_classes: classes };
    let own = input(&room.scene, &labels, &names);
    let run = |threads: usize, input: &ObjectInput<'_>| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (objects, usual) = (ObjectSettings::default(), RefineSettings::default());
        pool.install(|| refine(input, &shares, &objects, &usual)).unwrap()
    };
    let once = run(1, &own);
    assert_eq!(once, run(3, &own));
    let instances = room.scene.instance.as_deref();
    assert_eq!(once, run(2, &ObjectInput { instances, ..own }));
    let right = |labels: &[i32]| labels.iter().zip(truth).filter(|(a, b)| a == b).count();
    assert!(right(&once.labels) > right(&labels), "{} {}", right(&once.labels), right(&labels));
    assert!(once.renamed > 0 && once.changed > 0);
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let scene = GaussianScene { coord: vec![[0.0; 3]; 4], ..GaussianScene::default() };
    let (labels, names) = ([0, 1, 2, -1], names());
    let input = input(&scene, &labels, &names);
    let (row_of, rows) = ([0; 4], [0.2; 3]);
    let fits = ClassShares { row_of: &row_of, rows: &rows, num_classes: 3 };
    let said = |input: &ObjectInput<'_>, shares: &ClassShares<'_>, settings: RefineSettings| {
        refine(input, shares, &ROW, &settings).map_err(|error| error.to_string())
    };
    let usual = RefineSettings::default();
    assert!(said(&input, &fits, usual).is_ok());
    for bad in [0.0, -0.1, 1.1, f64::NAN] {
        let keep = said(&input, &fits, RefineSettings { keep: bad, ..usual }).unwrap_err();
        let part = said(&input, &fits, RefineSettings { part: bad, ..usual }).unwrap_err();
        assert!(keep.starts_with("keep: ") && part.starts_with("part: "), "{keep} {part}");
    }
    let few = ClassShares { row_of: &row_of[1..], ..fits };
    assert!(said(&input, &few, usual).unwrap_err().starts_with("row_of: expected 4"));
    let short = ObjectInput { names: &names[..2], labels: &[0, 1, 1, -1], ..input };
    assert!(said(&short, &fits, usual).unwrap_err().starts_with("num_classes: 3 is"));
    let long = ObjectInput { labels: &[0; 5], ..input };
    assert!(said(&long, &fits, usual).unwrap_err().starts_with("labels: expected 4"));
    let none = RefineSettings { keep: 1.0, part: 1.0 };
    assert!(refine(&input, &fits, &ObjectSettings { min_count: 0, ..ROW }, &none).is_err());
}
