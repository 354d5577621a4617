//! The generator on pictures with planted objects, through a network that knows them.

mod notes;

use super::*;

/// A network that answers with the true object under the click: its color in the picture.
///
/// Its logits are the share of each cell that the object covers, between −`sure` and `sure`.
#[derive(Debug)]
struct Truth {
    side: usize,
    sure: f32,
    /// Of part, larger part and whole.
    iou: [f32; MASKS],
}

impl ClickNetwork for Truth {
    type Seen = RgbPicture;

    fn see(&self, picture: &RgbPicture) -> Result<RgbPicture, VisionError> {
        Ok(picture.clone())
    }

    fn mask_side(&self) -> usize {
        self.side
    }

    fn click(
        &self,
        p: &RgbPicture,
        points: &[[f32; 2]],
    ) -> Result<Vec<MaskPrediction>, VisionError> {
        let answer = |at: &[f32; 2]| {
            let color = p.get(at[0] as u32, at[1] as u32).unwrap();
            let mut logits = vec![-self.sure; self.side * self.side];
            for (i, logit) in logits.iter_mut().enumerate() {
                let (y, x) = (i / self.side, i % self.side);
                let mut inside = 0;
                for k in 0..9 {
                    let place = |cell: usize, k: u32, length: u32| {
                        let share = (f64::from(k) + 0.5) / 3.0 + cell as f64;
                        (share / self.side as f64 * f64::from(length)) as u32
                    };
                    let (u, v) = (place(x, k % 3, p.width()), place(y, k / 3, p.height()));
                    inside += i32::from(p.get(u, v) == Some(color));
                }
                *logit = self.sure * (inside as f32 / 4.5 - 1.0);
            }
            MaskPrediction { logits: logits.repeat(MASKS), iou: self.iou, object_score: 1.0 }
        };
        Ok(points.par_iter().map(answer).collect())
    }
}

fn truth() -> Truth {
    Truth { side: 128, sure: 30.0, iou: [0.0, 0.9, 0.91, 0.95] }
}

/// A background, disks, a bar, and a ring around a disk.
fn planted(x: u32, y: u32) -> u8 {
    let disk =
        |cx: i64, cy: i64, r: i64| (i64::from(x) - cx).pow(2) + (i64::from(y) - cy).pow(2) < r * r;
    match () {
        () if disk(80, 90, 30) => 2,
        () if disk(80, 90, 60) => 1,
        () if disk(300, 80, 45) => 3,
        () if (200..420).contains(&x) && (200..240).contains(&y) => 4,
        () if disk(60, 230, 25) => 5,
        () => 0,
    }
}

const SIZE: [u32; 2] = [450, 300];

fn picture() -> RgbPicture {
    RgbPicture::from_fn(SIZE[0], SIZE[1], |x, y| [planted(x, y) * 40, 10, 200])
}

#[test]
fn planted_objects_are_found() {
    for settings in [MaskSettings::original(), MaskSettings::scenesplat()] {
        let settings = MaskSettings { points_per_side: 12, ..settings };
        let network = truth();
        let (found, counts) = AutomaticMasks::new(&network, settings.clone())
            .unwrap()
            .generate_counted(&picture())
            .unwrap();
        for object in 0..6 {
            let object = Mask::from_fn(SIZE[0], SIZE[1], |x, y| planted(x, y) == object);
            let best = found.iter().map(|p| p.mask.iou(&object)).fold(0.0, f64::max);
            println!("{} pixels: IoU {best:.3}", object.area());
            assert!(best >= 0.9, "{} pixels: IoU {best}, {:?}", object.area(), settings.level);
        }
        println!("{counts:?}");
        let each = if settings.level == Level::All { 3 * 144 } else { 5 * 144 };
        assert_eq!(counts.answered, each);
        assert!(counts.kept < 40, "the same object was kept {} times", counts.kept);
        // What is painted is what was planted.
        let map = paint_objects(&found, SIZE[0], SIZE[1]);
        let right = (0..SIZE[0] * SIZE[1]).filter(|i| {
            let (x, y) = (i % SIZE[0], i / SIZE[0]);
            let id = map.ids[*i as usize];
            let [u, v] = found[id.max(0) as usize].point;
            id >= 0 && planted(u as u32, v as u32) == planted(x, y)
        });
        let share = right.count() as f64 / f64::from(SIZE[0] * SIZE[1]);
        assert!(share > 0.97, "{share}");
    }
}

#[allow(clippy::needless_pass_by_value, reason = "settings are written where they are used")]
fn run(network: &Truth, settings: MaskSettings) -> (Vec<MaskProposal>, MaskCounts) {
    let settings = MaskSettings { points_per_side: 8, ..settings };
    AutomaticMasks::new(network, settings).unwrap().generate_counted(&picture()).unwrap()
}

/// Settings under which every mask passes.
fn open() -> MaskSettings {
    MaskSettings {
        pred_iou: 0.0,
        stability: 0.0,
        box_nms: 1.0,
        crop_nms: 1.0,
        ..MaskSettings::original()
    }
}

#[test]
fn each_filter_alone() {
    let (open, network) = (open(), truth());
    let (_, counts) = run(&network, open.clone());
    let all = 3 * 64;
    assert_eq!(
        (counts.answered, counts.expected, counts.stable, counts.whole),
        (all, all, all, all)
    );
    assert_eq!((counts.single, counts.kept), (all, all), "boxes that are equal are not above 1");

    // Predicted IoU: strictly above.
    let (found, counts) = run(&network, MaskSettings { pred_iou: 0.91, ..open });
    assert_eq!((counts.expected, found.len()), (64, 64));
    assert!(found.iter().all(|p| p.predicted_iou == 0.95));
    let nan = Truth { iou: [f32::NAN; MASKS], ..truth() };
    assert_eq!(run(&nan, open.clone()).1.expected, 0);

    // Stability: a soft edge falls below, a hard one does not.
    let soft = Truth { sure: 1.2, ..truth() };
    let strict = MaskSettings { stability: 0.9, ..open };
    assert_eq!(run(&network, strict.clone()).1.stable, all);
    let (soft_found, soft_counts) = run(&soft, strict);
    assert!(soft_counts.stable < all, "{soft_counts:?}");
    assert!(soft_found.iter().all(|p| p.stability >= 0.9));

    // Boxes of one crop.
    let (found, counts) = run(&network, MaskSettings { box_nms: 0.7, ..open });
    assert_eq!((counts.whole, counts.single), (all, found.len()));
    assert!(found.len() < 12, "{}", found.len());
    assert!(found.iter().all(|p| p.predicted_iou == 0.95), "the surest stay");

    // Only whole objects.
    let (_, counts) = run(&network, MaskSettings { level: Level::Whole, ..open });
    assert_eq!(counts.answered, 64);
}

#[test]
fn edges_of_crops_and_boxes_among_crops() {
    let network = truth();
    let cropped = MaskSettings { crop_layers: 1, box_nms: 0.7, ..open() };
    let (found, counts) = run(&network, cropped.clone());
    assert_eq!(counts.answered, 5 * 3 * 64);
    assert!(counts.whole < counts.stable, "{counts:?}");
    let inner = |p: &&MaskProposal| p.crop != [0, 0, SIZE[0], SIZE[1]];
    for p in found.iter().filter(inner) {
        let b = p.mask.bounds().unwrap();
        for (i, whole) in [0, 0, SIZE[0], SIZE[1]].into_iter().enumerate() {
            assert!(
                b[i].abs_diff(p.crop[i]) > 20 || b[i].abs_diff(whole) <= 20,
                "{b:?} {:?}",
                p.crop
            );
        }
    }
    let (fewer, counts) = run(&network, MaskSettings { crop_nms: 0.7, ..cropped });
    assert_eq!((counts.kept, fewer.len()), (fewer.len(), fewer.len()));
    assert!(fewer.len() < found.len());
    // Small crops come first; the picture's own masks last.
    let whole = fewer.iter().position(|p| p.crop == [0, 0, SIZE[0], SIZE[1]]).unwrap();
    assert!(fewer[whole..].iter().all(|p| !inner(&p)));
}

#[test]
fn small_regions_are_removed_and_filled() {
    // A disk of 16 pixels is 4.6 by 6.8 of the network's, about 97 in all.
    let speck = RgbPicture::from_fn(450, 300, |x, y| {
        let inside = (i64::from(x) - 200).pow(2) + (i64::from(y) - 150).pow(2) < 256;
        [if inside { 200 } else { 0 }, 0, 0]
    });
    let count = |min_region| {
        let (network, settings) =
            (truth(), MaskSettings { points_per_side: 16, min_region, ..open() });
        let found = AutomaticMasks::new(&network, settings).unwrap().generate(&speck).unwrap();
        let small = found.iter().filter(|p| p.mask.area() < 1000).count();
        let holes = found.iter().filter(|p| p.mask.area() > 1000 && !p.mask.contains(200, 150));
        (small, holes.count())
    };
    let (small, holes) = count(0);
    assert!(small > 0 && holes > 0);
    assert_eq!(count(200), (0, 0), "the speck is gone, and so is its hole");
}

#[test]
fn batches_and_threads_change_nothing() {
    let network = truth();
    let settings = MaskSettings { points_per_batch: 64, ..MaskSettings::scenesplat() };
    let all = run(&network, settings.clone());
    assert_eq!(all, run(&network, MaskSettings { points_per_batch: 7, ..settings }));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(5).build().unwrap();
    assert_eq!(all, pool.install(|| run(&network, settings)));
}

#[test]
fn bad_settings_and_pictures_are_refused_by_name() {
    let network = truth();
    let message = |settings| AutomaticMasks::new(&network, settings).unwrap_err().to_string();
    let open = MaskSettings::original;
    assert!(message(MaskSettings { pred_iou: f32::NAN, ..open() }).contains("pred_iou is NaN"));
    assert!(
        message(MaskSettings { points_per_side: 0, ..open() }).contains("points_per_side is 0")
    );
    assert!(message(MaskSettings { crop_layers: 9, ..open() }).contains("crop_layers is 9"));
    assert!(message(MaskSettings { box_nms: 1.5, ..open() }).contains("box_nms is 1.5"));
    let empty = RgbPicture::filled(0, 4, [0; 3]);
    let error = AutomaticMasks::new(&network, open()).unwrap().generate(&empty).unwrap_err();
    assert!(error.to_string().contains("0 × 4"), "{error}");
}

#[test]
fn a_picture_of_one_pixel_is_one_object_or_none() {
    let network = Truth { side: 4, ..truth() };
    let settings = MaskSettings { points_per_side: 2, ..MaskSettings::scenesplat() };
    let one = RgbPicture::filled(1, 1, [9; 3]);
    let found = AutomaticMasks::new(&network, settings).unwrap().generate(&one).unwrap();
    assert!(found.iter().all(|p| p.mask.area() == 1));
}

#[test]
fn masks_are_cut_off_by_crops_and_not_by_the_picture() {
    // The first of four crops of a picture of 616 × 456.
    let place = Place { picture: [616, 456], left: 0, top: 0, width: 386, height: 306 };
    for (bounds, is_cut) in [
        // Left, top, right, bottom: inside; at the picture's own edges; at the crop's right; at its bottom.
        ([40, 50, 200, 200], false),
        ([0, 5, 200, 200], false),
        ([40, 50, 380, 200], true),
        ([0, 50, 100, 290], true),
        // Twenty pixels count, twenty-one do not.
        ([40, 50, 366, 200], true),
        ([40, 50, 365, 200], false),
    ] {
        assert_eq!(super::is_cut_off(bounds, place), is_cut, "{bounds:?}");
    }
    let whole = Place { picture: [616, 456], left: 0, top: 0, width: 616, height: 456 };
    assert!(!super::is_cut_off([0, 0, 615, 455], whole));
}

#[test]
fn a_smaller_crop_is_closer() {
    assert!((closeness([10, 20, 30, 60]) - 1.0 / 800.0).abs() < 1e-12);
    assert!(closeness([0, 0, 50, 50]) > closeness([0, 0, 100, 50]));
}
