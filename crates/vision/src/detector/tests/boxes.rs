use super::super::decode::{decode, heads, iou, keep_best};
use super::*;

fn thing(area: [f32; 4], class: usize, score: f32) -> Detection {
    Detection { area, scores: vec![(class, score)] }
}

#[test]
fn boxes_are_means_of_distances_around_the_middle_of_a_place() {
    let head = Head { scores: 0, distances: 1, places: 2, stride: 8 };
    let mut scores = vec![0.01; 4 * 80];
    // Place 3: column 1, row 1. Six classes above the least, of which five are kept, ties in their order.
    for (class, score) in
        [(7, 0.4), (3, 0.9), (60, 0.05), (5, 0.4), (9, 0.06), (70, 0.07), (71, 0.049)]
    {
        scores[3 * 80 + class] = score;
    }
    // Place 1 is below the limit.
    scores[80 + 2] = 0.29;
    let mut distances = vec![0.0; 4 * 44];
    let own = &mut distances[3 * 44..];
    // Left: bins 2 and 3 as likely, 2.5. Top: all alike, 5. Right: ln 3 more for bin 10 than for 0, 7.5. Bottom: bin 1.
    own[..11].fill(-80.0);
    (own[2], own[3]) = (1.0, 1.0);
    own[22..33].fill(-90.0);
    (own[22], own[32]) = (0.0, 3f32.ln());
    own[34] = 70.0;
    let found = decode(&head, &scores, &distances, &DetectorSettings::default());
    let [one] = &*found else { panic!("{found:?}") };
    let area = [12.0 - 20.0, 12.0 - 40.0, 12.0 + 60.0, 12.0 + 8.0];
    assert!((0..4).all(|k| (one.area[k] - area[k]).abs() < 1e-4), "{:?}", one.area);
    assert_eq!(one.scores, [(3, 0.9), (5, 0.4), (7, 0.4), (70, 0.07), (9, 0.06)]);
    // Place 1, at (12, 4), reaches 5 steps of 8 to all sides: over all of the 16 pixels, so it needs 0.2 more.
    let found = |score| {
        let settings = DetectorSettings { score, ..DetectorSettings::default() };
        decode(&head, &scores, &distances, &settings).len()
    };
    assert_eq!([found(0.0899), found(0.0901)], [2, 1]);
    // The other one, from (−8, −28) to (72, 20), too.
    assert_eq!([found(0.6999), found(0.7001)], [1, 0]);
    // A box over a quarter of the picture needs 0.05 more.
    let small = Head { scores: 0, distances: 1, places: 1, stride: 32 };
    let mut sides = vec![-90.0; 44];
    (sides[1], sides[12], sides[22], sides[33]) = (0.0, 0.0, 0.0, 0.0);
    let mut one = vec![0.0; 80];
    one[4] = 0.5;
    let found = |score| {
        decode(&small, &one, &sides, &DetectorSettings { score, ..DetectorSettings::default() })
            .len()
    };
    // From (16 − 32, 16 − 32) to (16, 16): a quarter of it is inside.
    assert_eq!([found(0.4499), found(0.4501)], [1, 0]);
}

#[test]
fn of_boxes_that_overlap_the_best_is_kept() {
    // 10 × 10 each: shifted by 2 they share 80 of 120, by 3 70 of 130.
    let at = |x: f32| [x, 0.0, x + 10.0, 10.0];
    assert_eq!(iou(at(0.0), at(2.0)), 80.0 / 120.0);
    assert_eq!((iou(at(0.0), at(20.0)), iou([0.0; 4], [0.0; 4])), (0.0, 0.0));
    let all = vec![
        thing(at(2.0), 1, 0.5),
        thing(at(0.0), 1, 0.6),
        thing(at(3.0), 1, 0.4),
        thing(at(2.0), 2, 0.5),
        thing([5.0, 5.0, 5.0, 9.0], 3, 0.9),
    ];
    let kept = keep_best(all.clone(), &DetectorSettings::default());
    // The first and the fourth are covered by the second; the third overlaps that by 0.54 only; the last has no area.
    assert_eq!(kept, [all[1].clone(), all[2].clone()]);
    let strict = DetectorSettings { overlap: 0.5, ..DetectorSettings::default() };
    assert_eq!(keep_best(all.clone(), &strict), [all[1].clone()]);
    let loose = DetectorSettings { overlap: 0.99, ..DetectorSettings::default() };
    assert_eq!(keep_best(all.clone(), &loose), [1, 0, 2].map(|i| all[i].clone()));
}

#[test]
fn outputs_are_paired_by_their_number_of_places() {
    let shapes: [(&str, &[usize]); 4] =
        [("a", &[1, 4, 44]), ("b", &[1, 16, 80]), ("c", &[1, 4, 80]), ("d", &[1, 16, 44])];
    let found = heads(&shapes, 32).unwrap();
    let head = |scores, distances, places, stride| Head { scores, distances, places, stride };
    assert_eq!(found, [head(1, 3, 4, 8), head(2, 0, 2, 16)]);
    type Refused<'a> = (&'a [(&'a str, &'a [usize])], &'a str);
    let refused: [Refused<'_>; 5] = [
        (&[("a", &[1, 4, 81])], "81 columns"),
        (&[("a", &[4, 80])], "has shape [4, 80]"),
        (&[("a", &[1, 4, 80])], "no distances of 4 places"),
        (&[("a", &[1, 5, 80]), ("b", &[1, 5, 44])], "5 places, which are no grid"),
        (&[("b", &[1, 5, 44])], "no output has scores"),
    ];
    for (shapes, part) in refused {
        let problem = heads(shapes, 32).unwrap_err();
        assert!(problem.contains(part), "{problem}");
    }
}

#[test]
fn settings_out_of_range_are_named() {
    let good = DetectorSettings::default();
    good.check().unwrap();
    for (bad, part) in [
        (DetectorSettings { score: 0.05, ..good }, "score"),
        (DetectorSettings { score: f32::NAN, ..good }, "score"),
        (DetectorSettings { score: 1.0, ..good }, "score"),
        (DetectorSettings { overlap: 1.1, ..good }, "overlap"),
        (DetectorSettings { tiles: 0, ..good }, "tiles"),
        (DetectorSettings { tiles: 5, ..good }, "tiles"),
    ] {
        let error = bad.check().unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
        assert!(
            Detector::open(Path::new("none.json"), bad).unwrap_err().to_string().contains(part)
        );
    }
}
