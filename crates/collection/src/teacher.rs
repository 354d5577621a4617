//! What tells segments of a picture and their features at once, because it knows names.

use crate::boxes::{Parts, chosen};
use crate::{CollectError, PosedPicture, Segmented, Segmenter, SuperpixelSettings, Superpixels};
use scenesplat_scene::picture::RgbPicture;

/// Side of the superpixels that boxes are filled with: a cup across a table is four of them wide.
const SIDE: u32 = 8;
/// Pixels of the smallest.
const SMALLEST: u32 = 16;

/// Segments of a picture and what each is.
#[derive(Debug, Clone, PartialEq)]
pub struct Taught {
    /// Ids from 0 without gaps.
    pub segmented: Segmented,
    /// Unit rows, one for each id. `[S, D]`
    pub features: Vec<f32>,
}

/// Finds things in pictures and says what they are, as vectors in the space of its texts.
///
/// The same picture gives the same result, whatever came before and on however many threads.
pub trait Teacher: Send + Sync {
    /// What it is and with which weights and settings: what is computed once is kept under this name, so another
    /// result needs another name.
    fn name(&self) -> String;

    /// Values of a feature, at least 1.
    fn width(&self) -> usize;

    /// The things in a picture.
    ///
    /// # Errors
    /// If the picture cannot be used; names the frame.
    fn teach(&self, picture: &PosedPicture<'_>) -> Result<Taught, CollectError>;
}

/// A box in a picture, and what may be in it.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedBox {
    /// Left, top, right, bottom, pixels from the corner of the first; inside the picture.
    pub area: [f32; 4],
    /// Classes and their scores, above 0, best first.
    pub scores: Vec<(usize, f32)>,
}

/// Finds things as boxes.
pub trait BoxFinder: Send + Sync {
    /// As [`Teacher::name`].
    fn name(&self) -> String;

    /// The boxes in a picture, best first.
    ///
    /// # Errors
    /// If the picture cannot be used.
    fn find(&self, picture: &RgbPicture) -> Result<Vec<NamedBox>, CollectError>;
}

/// Boxes as segments: of the superpixels in a box those that hang together around its middle, nearer ones first, without
/// surfaces that go on beyond the box.
///
/// Smaller boxes lie on larger ones. The feature of a segment is the mean of its classes' vectors, weighted by their scores.
/// Depth tells what is before what; without it a box is filled.
#[derive(Debug)]
pub struct BoxTeacher<F> {
    finder: F,
    superpixels: Superpixels,
    surfaces: Superpixels,
    /// One of each class, unit. `[C, D]`
    vectors: Vec<f32>,
    width: usize,
}

impl<F: BoxFinder> BoxTeacher<F> {
    /// `vectors`: one of each class that the finder names, `[classes, width]`.
    ///
    /// # Errors
    /// If a vector is 0 or not finite, or their number does not fit.
    pub fn new(finder: F, vectors: &[f32], width: usize) -> Result<Self, CollectError> {
        let bad = |problem| Err(CollectError::argument("vectors of classes", problem));
        if width == 0 || vectors.is_empty() || !vectors.len().is_multiple_of(width) {
            return bad(format!("{} values are no rows of {width}", vectors.len()));
        }
        let mut unit = Vec::with_capacity(vectors.len());
        for (class, row) in vectors.chunks_exact(width).enumerate() {
            match direction(row.iter().map(|v| f64::from(*v))) {
                Some(row) => unit.extend(row),
                None => return bad(format!("that of class {class} has no direction")),
            }
        }
        let settings =
            SuperpixelSettings { side: SIDE, merge: 0.0, smallest: SMALLEST, ..Default::default() };
        let superpixels = Superpixels::new(settings)?;
        let surfaces = Superpixels::new(SuperpixelSettings::default())?;
        Ok(Self { finder, superpixels, surfaces, vectors: unit, width })
    }

    /// The feature of a box.
    fn feature(&self, named: &NamedBox) -> Result<Vec<f32>, CollectError> {
        let mut sum = vec![0f64; self.width];
        for (class, score) in &named.scores {
            let row = self.vectors.get(class * self.width..(class + 1) * self.width);
            let problem = || CollectError::argument("class", format!("{class} has no vector"));
            let row = row.ok_or_else(problem)?;
            sum.iter_mut().zip(row).for_each(|(sum, v)| *sum += f64::from(*score) * f64::from(*v));
        }
        let problem = || format!("the classes {:?} have no direction together", named.scores);
        direction(sum.into_iter()).ok_or_else(|| CollectError::argument("feature", problem()))
    }
}

impl<F: BoxFinder> Teacher for BoxTeacher<F> {
    fn name(&self) -> String {
        // The vectors are part of it: other names make other features.
        let sum = self.vectors.iter().fold(0u64, |hash, v| {
            (hash.rotate_left(5) ^ u64::from(v.to_bits())).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        });
        format!("boxes 2 of {} as {} {sum:016x}", self.finder.name(), self.superpixels.name())
    }

    fn width(&self) -> usize {
        self.width
    }

    fn teach(&self, picture: &PosedPicture<'_>) -> Result<Taught, CollectError> {
        picture.check()?;
        let boxes = self.finder.find(picture.picture)?;
        let clusters = self.superpixels.segment(picture)?.map;
        let surfaces = self.surfaces.segment(picture)?.map;
        let parts = Parts::of(&clusters, &surfaces, picture.depth);
        // From large to small, equal ones in their order: what lies on a table has a smaller box.
        let area = |i: &usize| {
            let [left, top, right, bottom] = boxes[*i].area;
            (right - left) * (bottom - top)
        };
        let mut order: Vec<usize> = (0..boxes.len()).collect();
        order.sort_by(|a, b| area(b).total_cmp(&area(a)));
        let mut owner: Vec<Option<u32>> = vec![None; parts.len()];
        for i in order {
            for part in chosen(&parts, &clusters, boxes[i].area) {
                owner[part] = Some(i as u32);
            }
        }
        let ids: Vec<Option<u32>> =
            clusters.ids().iter().map(|id| owner[usize::from(*id)]).collect();
        let segmented = Segmented::dense(clusters.width(), clusters.height(), &ids, boxes.len())?;
        let mut shown: Vec<u32> = owner.into_iter().flatten().collect();
        shown.sort_unstable();
        shown.dedup();
        let rows = shown.iter().map(|i| self.feature(&boxes[*i as usize]));
        let features = rows.collect::<Result<Vec<_>, _>>()?.concat();
        Ok(Taught { segmented, features })
    }
}

/// A row of length 1, if it has a direction.
fn direction(row: impl Iterator<Item = f64> + Clone) -> Option<Vec<f32>> {
    let norm = row.clone().map(|v| v * v).sum::<f64>().sqrt();
    (norm.is_finite() && norm > 0.0).then(|| row.map(|v| (v / norm) as f32).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use crate::segmenter::tests::view;
    use scenesplat_rasterizer::lifting::NO_SEGMENT;

    /// Finds what it was given.
    #[derive(Debug)]
    struct Given(Vec<NamedBox>);

    impl BoxFinder for Given {
        fn name(&self) -> String {
            format!("{} boxes", self.0.len())
        }

        fn find(&self, _: &RgbPicture) -> Result<Vec<NamedBox>, CollectError> {
            Ok(self.0.clone())
        }
    }

    fn named(area: [f32; 4], scores: &[(usize, f32)]) -> NamedBox {
        NamedBox { area, scores: scores.to_vec() }
    }

    /// Three classes in two dimensions.
    const VECTORS: [f32; 6] = [2.0, 0.0, 0.0, 5.0, 3.0, 4.0];

    /// A wall 4 away, a gray table 2 away below row 60 that is brown, and a white cup on it.
    fn is_cup(x: u32, y: u32) -> bool {
        (48..64).contains(&x) && (64..80).contains(&y)
    }

    fn teach(boxes: Vec<NamedBox>, depth: Option<&[f32]>) -> Taught {
        let picture = RgbPicture::from_fn(128, 96, |x, y| match (is_cup(x, y), y >= 56) {
            (true, _) => [250; 3],
            (_, true) => [120, 80, 40],
            _ => [90, 90, 200],
        });
        let view = view(128, 96);
        let posed = PosedPicture { name: "a", picture: &picture, view: &view, depth };
        BoxTeacher::new(Given(boxes), &VECTORS, 2).unwrap().teach(&posed).unwrap()
    }

    /// As many pixels have the id as `is` says, but for at most `off`.
    fn is_segment(taught: &Taught, id: u16, off: usize, is: impl Fn(u32, u32) -> bool) {
        let map = &taught.segmented.map;
        let wrong = (0..128 * 96u32)
            .filter(|at| (map.at(at % 128, at / 128) == id) != is(at % 128, at / 128));
        let wrong = wrong.count();
        assert!(wrong <= off, "{wrong} pixels of segment {id} are wrong");
    }

    #[test]
    fn small_boxes_lie_on_large_ones_and_only_the_near_surface_is_taken() {
        let depth: Vec<f32> =
            (0..96).flat_map(|y| vec![if y >= 56 { 2.0 } else { 4.0 }; 128]).collect();
        // The cup comes first, as its score is best; both boxes reach over what they show.
        let boxes = vec![
            named([46.0, 62.0, 66.0, 82.0], &[(1, 0.8)]),
            named([0.0, 34.0, 128.0, 96.0], &[(0, 0.5), (2, 0.25)]),
        ];
        let taught = teach(boxes.clone(), Some(&depth));
        is_segment(&taught, 0, 30, is_cup);
        is_segment(&taught, 1, 60, |x, y| y >= 56 && !is_cup(x, y));
        assert_eq!(taught.segmented.left_out, 0);
        // 0.5 (1, 0) + 0.25 (0.6, 0.8) = (0.65, 0.2).
        let long = 0.65f32.hypot(0.2);
        let rows = [0.0, 1.0, 0.65 / long, 0.2 / long];
        assert!(
            taught.features.iter().zip(rows).all(|(a, b)| (a - b).abs() < 1e-6),
            "{:?}",
            taught.features
        );
        // Without depth the wall is left out all the same: most of it is outside of the box. From row 24 on it is not.
        let flat = teach(boxes.clone(), None);
        is_segment(&flat, 1, 60, |x, y| y >= 56 && !is_cup(x, y));
        let wide = |depth| teach(vec![named([0.0, 24.0, 128.0, 96.0], &[(0, 0.5)])], depth);
        is_segment(&wide(None), 0, 60, |_, y| y >= 24);
        is_segment(&wide(Some(&depth)), 0, 60, |_, y| y >= 56);
        // The other way around in the list: the same places, other numbers.
        let turned = teach(boxes.into_iter().rev().collect(), Some(&depth));
        is_segment(&turned, 1, 30, is_cup);
        assert_eq!(turned.features[2..], [0.0, 1.0]);
    }

    #[test]
    fn of_two_surfaces_the_nearer_one_is_the_thing() {
        // A frame, as the back of a chair, before a wall that fills its middle: 2 of 4 pixels each.
        let frame = |x: u32, y: u32| {
            (32..96).contains(&x)
                && (24..72).contains(&y)
                && !((48..80).contains(&x) && (40..56).contains(&y))
        };
        let depth: Vec<f32> =
            (0..128 * 96u32).map(|at| if frame(at % 128, at / 128) { 1.5 } else { 4.0 }).collect();
        let picture =
            RgbPicture::from_fn(
                128,
                96,
                |x, y| if frame(x, y) { [120, 80, 40] } else { [90, 90, 200] },
            );
        let view = view(128, 96);
        let posed = PosedPicture { name: "a", picture: &picture, view: &view, depth: Some(&depth) };
        let boxes = vec![named([30.0, 22.0, 98.0, 74.0], &[(0, 0.9)])];
        let taught = BoxTeacher::new(Given(boxes), &VECTORS, 2).unwrap().teach(&posed).unwrap();
        is_segment(&taught, 0, 250, frame);
    }

    #[test]
    fn of_two_boxes_around_a_thing_the_smaller_has_it_and_not_the_narrower() {
        // A square of 16 × 16 in a box of 64 × 16 and in one of 32 × 48, which is the larger.
        let is_square = |x: u32, y: u32| (24..40).contains(&x) && (16..32).contains(&y);
        let picture =
            RgbPicture::from_fn(64, 48, |x, y| [if is_square(x, y) { 250 } else { 40 }; 3]);
        let view = view(64, 48);
        let posed = PosedPicture { name: "a", picture: &picture, view: &view, depth: None };
        let flat = named([0.0, 16.0, 64.0, 32.0], &[(0, 0.9)]);
        let tall = named([16.0, 0.0, 48.0, 48.0], &[(1, 0.9)]);
        for boxes in [[flat.clone(), tall.clone()], [tall, flat]] {
            let teacher = BoxTeacher::new(Given(boxes.to_vec()), &VECTORS, 2).unwrap();
            let taught = teacher.teach(&posed).unwrap();
            let shown = taught.segmented.map.ids().iter().filter(|id| **id == 0).count();
            assert!((200..=330).contains(&shown), "{shown}");
            assert_eq!((taught.features, taught.segmented.left_out), (vec![1.0, 0.0], 1));
        }
    }

    #[test]
    fn boxes_that_show_nothing_are_left_out() {
        // Between superpixels, all of which lie mostly outside.
        let thin = vec![
            named([20.0, 20.0, 23.0, 23.0], &[(0, 0.9)]),
            named([-5.0, -5.0, 0.0, 0.0], &[(0, 0.9)]),
        ];
        let taught = teach(thin, None);
        assert!(taught.segmented.map.ids().iter().all(|id| *id == NO_SEGMENT));
        assert_eq!((taught.segmented.left_out, taught.features.len()), (2, 0));
        let nothing = teach(Vec::new(), Some(&[f32::NAN; 128 * 96]));
        assert_eq!((nothing.segmented.left_out, nothing.features.len()), (0, 0));
    }

    #[test]
    fn vectors_that_are_none_are_refused_and_names_say_all() {
        let given = || Given(Vec::new());
        for (vectors, width, part) in [
            (&[1.0, 0.0, 0.0][..], 2, "3 values are no rows of 2"),
            (&[], 2, "no rows"),
            (&[1.0], 0, "no rows"),
            (&[1.0, 0.0, 0.0, 0.0], 2, "class 1 has no direction"),
            (&[1.0, f32::NAN], 2, "class 0 has no direction"),
        ] {
            let error = BoxTeacher::new(given(), vectors, width).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
        let name =
            |boxes, vectors: &[f32]| BoxTeacher::new(Given(boxes), vectors, 2).unwrap().name();
        let one = vec![named([0.0; 4], &[])];
        assert_ne!(name(Vec::new(), &VECTORS), name(one, &VECTORS));
        assert_ne!(name(Vec::new(), &VECTORS), name(Vec::new(), &VECTORS[..4]));
        assert_ne!(
            name(Vec::new(), &[1.0, 0.0, 0.0, 1.0]),
            name(Vec::new(), &[0.0, 1.0, 1.0, 0.0])
        );
        // A class without a vector, and classes that cancel out.
        let picture = RgbPicture::filled(32, 32, [9; 3]);
        let view = view(32, 32);
        let posed = PosedPicture { name: "a", picture: &picture, view: &view, depth: None };
        let area = [0.0, 0.0, 32.0, 32.0];
        let opposite = [1.0, 0.0, -1.0, 0.0];
        for (scores, part) in
            [(&[(2, 0.5)][..], "2 has no vector"), (&[(0, 0.5), (1, 0.5)], "no direction together")]
        {
            let teacher = BoxTeacher::new(Given(vec![named(area, scores)]), &opposite, 2).unwrap();
            let error = teacher.teach(&posed).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }
}
