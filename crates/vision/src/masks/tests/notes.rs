//! The generator through a network that writes down what it is asked, by hand.

use super::*;

/// Size, first and last pixel of a picture.
type Shown = ([u32; 2], [u8; 3], [u8; 3]);

/// A network that writes down what it is shown and asked, and whose levels have masks of their own.
#[derive(Debug, Default)]
struct Notes {
    shown: std::sync::Mutex<Vec<Shown>>,
    asked: std::sync::Mutex<Vec<Vec<[f32; 2]>>>,
    /// Whether all levels have the cells in the middle.
    blob: bool,
}

impl ClickNetwork for Notes {
    type Seen = ();

    fn see(&self, p: &RgbPicture) -> Result<(), VisionError> {
        let size = [p.width(), p.height()];
        let last = p.get(size[0] - 1, size[1] - 1).unwrap();
        self.shown.lock().unwrap().push((size, p.get(0, 0).unwrap(), last));
        Ok(())
    }

    fn mask_side(&self) -> usize {
        4
    }

    fn click(&self, (): &(), points: &[[f32; 2]]) -> Result<Vec<MaskPrediction>, VisionError> {
        self.asked.lock().unwrap().push(points.to_vec());
        // Of level i the first i columns of 4 × 4 cells; or the four cells in the middle.
        let inside = |level: usize, x: usize, y: usize| match self.blob {
            true => (1..3).contains(&x) && (1..3).contains(&y),
            false => x < level,
        };
        let value = |i: usize| if inside(i / 16, i % 4, i / 4 % 4) { 10.0 } else { -10.0 };
        let logits: Vec<f32> = (0..16 * MASKS).map(value).collect();
        let answer = |_| MaskPrediction {
            logits: logits.clone(),
            iou: [0.99, 0.85, 0.97, 0.9],
            object_score: -3.0,
        };
        Ok(points.iter().map(answer).collect())
    }
}

#[test]
fn each_level_has_the_mask_the_iou_and_the_stability_of_its_own() {
    let network = Notes::default();
    let settings = MaskSettings { points_per_side: 1, ..MaskSettings::original() };
    let picture = RgbPicture::from_fn(100, 60, |x, y| [x as u8, y as u8, 7]);
    let run = |change: fn(&mut MaskSettings)| {
        let mut settings = settings.clone();
        change(&mut settings);
        AutomaticMasks::new(&network, settings).unwrap().generate_counted(&picture).unwrap()
    };
    // Cells of 25 columns: the logit falls by 0.8 a pixel and is 0 at 25, 50 and 75. One and a quarter pixels before it
    // is 1, so 24 of 26, 49 of 51 and 74 of 76 columns are sure.
    let stability = |sure: f64| (sure / (sure + 2.0)) as f32;
    let (found, counts) = run(|s| s.stability = 0.9);
    // The surest first: levels 2, 3, 1. Level 0 is never asked for.
    let told: Vec<_> = found.iter().map(|p| (p.mask.bounds().unwrap(), p.predicted_iou)).collect();
    assert_eq!(told, [([0, 0, 49, 59], 0.97), ([0, 0, 74, 59], 0.9), ([0, 0, 24, 59], 0.85)]);
    for (p, sure) in found.iter().zip([49.0, 74.0, 24.0]) {
        assert!((p.stability - stability(sure)).abs() < 1e-6);
        assert_eq!((p.point, p.crop), ([50.0, 30.0], [0, 0, 100, 60]));
    }
    let of = |answered, expected, stable, single| MaskCounts {
        answered,
        expected,
        stable,
        whole: stable,
        single,
        kept: single,
    };
    assert_eq!(counts, of(3, 3, 3, 3));
    // By default 0.923 is not stable. Exactly the limit is.
    assert_eq!(run(|_| ()).1, of(3, 3, 2, 2));
    assert_eq!(run(|s| s.stability = (74.0f64 / 76.0) as f32).1, of(3, 3, 1, 1));
    // Two and three eighths of a pixel to either side are 1.9: 23 of 27, 48 of 52 and 73 of 77 columns.
    assert_eq!(run(|s| (s.stability, s.stability_offset) = (0.94, 1.9)).1, of(3, 3, 1, 1));
    assert_eq!(run(|s| (s.stability, s.pred_iou) = (0.0, 0.85)).1, of(3, 2, 2, 2));
    // Boxes of 49 and 74 columns overlap by 49/74 = 0.66, those of 24 and 49 by 0.49.
    assert_eq!(run(|s| (s.stability, s.box_nms) = (0.0, 0.66)).1, of(3, 3, 3, 2));
    assert_eq!(run(|s| (s.stability, s.box_nms) = (0.0, 0.48)).1, of(3, 3, 3, 1));
    assert_eq!(run(|s| s.level = Level::Whole).0[0].mask.bounds(), Some([0, 0, 74, 59]));
}

#[test]
fn crops_are_shown_asked_and_put_back_where_they_were_cut() {
    let network = Notes { blob: true, ..Notes::default() };
    let settings = MaskSettings {
        points_per_side: 4,
        point_downscale: 2,
        points_per_batch: 3,
        stability: 0.5,
        min_region: 0,
        ..MaskSettings::scenesplat()
    };
    let picture = RgbPicture::from_fn(200, 120, |x, y| [x as u8, y as u8, 7]);
    let (found, counts) =
        AutomaticMasks::new(&network, settings).unwrap().generate_counted(&picture).unwrap();
    // Overlap int(512/1500 · 120) = 40: crops of 120 × 80 in steps of 80 and 40.
    let shown = network.shown.into_inner().unwrap();
    let color = |x: u8, y: u8| [x, y, 7];
    let crop = |x: u8, y: u8| ([120, 80], color(x, y), color(x + 119, y + 79));
    let whole = ([200, 120], color(0, 0), color(199, 119));
    assert_eq!(shown, [whole, crop(0, 0), crop(0, 40), crop(80, 0), crop(80, 40)]);
    // 16 points of the picture in lots of three, then four of each crop in lots of three and one.
    let asked = network.asked.into_inner().unwrap();
    let lots: Vec<usize> = asked.iter().map(Vec::len).collect();
    assert_eq!(lots, [3, 3, 3, 3, 3, 1, 3, 1, 3, 1, 3, 1, 3, 1]);
    assert_eq!(asked[0], [[25.0, 15.0], [75.0, 15.0], [125.0, 15.0]]);
    assert_eq!(asked[6], [[30.0, 20.0], [90.0, 20.0], [30.0, 60.0]]);
    // The two cells in the middle are columns 30 to 89 and rows 20 to 59 of a crop. Of both lower ones the upper edge is
    // 20 pixels from the crop's: cut off. All masks of a crop are one by their boxes; the whole picture comes last.
    let told: Vec<_> = found.iter().map(|p| (p.mask.bounds().unwrap(), p.point, p.crop)).collect();
    let want = [
        ([30, 20, 89, 59], [30.0, 20.0], [0, 0, 120, 80]),
        ([110, 20, 169, 59], [110.0, 20.0], [80, 0, 200, 80]),
        ([50, 30, 149, 89], [25.0, 15.0], [0, 0, 200, 120]),
    ];
    assert_eq!(told, want);
    let want = MaskCounts { answered: 32, expected: 32, stable: 32, whole: 24, single: 3, kept: 3 };
    assert_eq!(counts, want);
}

#[test]
fn a_box_is_cut_off_at_any_of_four_sides() {
    let place = Place { picture: [900, 700], left: 300, top: 200, width: 300, height: 250 };
    // The crop ends at column 600 and row 450. Twenty pixels from a side are cut off, twenty-one are not.
    for (bounds, is_cut) in [
        ([321, 221, 579, 429], false),
        ([320, 221, 579, 429], true),
        ([321, 220, 579, 429], true),
        ([321, 221, 580, 429], true),
        ([321, 221, 579, 430], true),
    ] {
        assert_eq!(is_cut_off(bounds, place), is_cut, "{bounds:?}");
    }
    // Near the picture's own left edge, too: 20 pixels are near, 21 are not.
    let left = |left| Place { left, ..place };
    assert!(!is_cut_off([20, 221, 279, 429], left(15)));
    assert!(is_cut_off([21, 221, 279, 429], left(15)));
}
