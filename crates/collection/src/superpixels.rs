//! Segments without weights: pixels that lie together and look alike.

use crate::lab::lab;
use crate::merge::{Similarity, merge};
use crate::surface::{COLOR, NORMAL, PLANE, Pixels, Surface};
use crate::{CollectError, PosedPicture, Segmented, Segmenter};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Rounds of clustering; centers hardly move after them.
const ROUNDS: usize = 6;

/// How a picture is cut into superpixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SuperpixelSettings {
    /// Side of a superpixel before merging, pixels, 4 to 256.
    pub side: u32,
    /// How much a pixel's place counts beside its looks, above 0, at most 10: large ones are square.
    pub compactness: f32,
    /// How different neighbors may be that become one segment, 0 (none do) to 10, in units of the clusters'
    /// distance: 10 of L*a*b*, 0.4 of normals.
    pub merge: f32,
    /// Segments of fewer pixels join the neighbor that is most alike.
    pub smallest: u32,
}

impl Default for SuperpixelSettings {
    /// For pictures of about 640 × 480: superpixels of 12 × 12, joined to surfaces of one color.
    fn default() -> Self {
        Self { side: 12, compactness: 0.6, merge: 0.5, smallest: 40 }
    }
}

impl SuperpixelSettings {
    /// Checks that every number is in its range.
    ///
    /// # Errors
    /// Names the first that is not.
    pub fn check(&self) -> Result<(), CollectError> {
        let bad = |field, value: f32, range: &str| {
            Err(CollectError::argument(field, format!("is {value}; it has to be {range}")))
        };
        if !(4..=256).contains(&self.side) {
            return bad("side of superpixels", self.side as f32, "from 4 to 256");
        }
        if !(self.compactness > 0.0 && self.compactness <= 10.0) {
            return bad("compactness", self.compactness, "above 0 and at most 10");
        }
        if !(0.0..=10.0).contains(&self.merge) {
            return bad("merge", self.merge, "from 0 to 10");
        }
        Ok(())
    }
}

/// Clusters of pixels by color, normal, plane and place, as SLIC has them, joined where neighbors are alike.
///
/// Depth is the scene's own; without it color and place decide.
///
/// # Source
/// Achanta et al., SLIC Superpixels (2012), with each pixel looking at the nine centers around it as in gSLICr; the
/// joining is Felzenszwalb and Huttenlocher (2004) on superpixels in place of pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Superpixels {
    settings: SuperpixelSettings,
}

impl Superpixels {
    /// With these settings.
    ///
    /// # Errors
    /// If one is out of range.
    pub fn new(settings: SuperpixelSettings) -> Result<Self, CollectError> {
        settings.check()?;
        Ok(Self { settings })
    }
}

impl Segmenter for Superpixels {
    fn name(&self) -> String {
        let SuperpixelSettings { side, compactness, merge, smallest } = self.settings;
        format!(
            "superpixels 1 side {side} compactness {compactness} merge {merge} smallest {smallest}"
        )
    }

    fn wants_depth(&self) -> bool {
        true
    }

    fn segment(&self, picture: &PosedPicture<'_>) -> Result<Segmented, CollectError> {
        picture.check()?;
        let (width, height) = (picture.view.width as usize, picture.view.height as usize);
        let surface = picture.depth.map_or_else(
            || Surface::unknown(width * height),
            |depth| Surface::of(depth, picture.view),
        );
        let lab = lab(picture.picture.pixels()).into_iter().map(Vec3::from).collect();
        let pixels = Pixels { width, height, lab, surface };
        let clusters = cluster(&pixels, &self.settings);
        let similarity =
            Similarity { limit: self.settings.merge, smallest: self.settings.smallest };
        let ids = merge(&pixels, &clusters, similarity);
        let found = ids.iter().max().map_or(0, |&id| id as usize + 1);
        let ids: Vec<Option<u32>> = ids.into_iter().map(Some).collect();
        Segmented::dense(width as u32, height as u32, &ids, found)
    }
}

/// Means of a cluster.
#[derive(Debug, Clone, Copy, Default)]
struct Center {
    x: f32,
    y: f32,
    lab: Vec3,
    /// z is 0 where no pixel has a depth.
    point: Vec3,
    normal: Vec3,
}

/// The cluster of each pixel.
fn cluster(pixels: &Pixels, settings: &SuperpixelSettings) -> Vec<u32> {
    let (width, height) = (pixels.width, pixels.height);
    let side = settings.side as usize;
    let (columns, rows) = (width.div_ceil(side), height.div_ceil(side));
    let home = |at: usize| (at / width * rows / height) * columns + at % width * columns / width;
    let mut ids: Vec<u32> = (0..width * height).map(|at| home(at) as u32).collect();
    let mut centers = means(pixels, &ids, columns * rows, &[]);
    let place = settings.compactness / side as f32;
    for _ in 0..ROUNDS {
        ids.par_iter_mut().enumerate().for_each(|(at, id)| {
            let (row, column) = (home(at) / columns, home(at) % columns);
            let mut best = (f32::INFINITY, *id);
            for r in row.saturating_sub(1)..(row + 2).min(rows) {
                for c in column.saturating_sub(1)..(column + 2).min(columns) {
                    let center = &centers[r * columns + c];
                    let distance = distance(pixels, at, center, place);
                    if distance < best.0 {
                        best = (distance, (r * columns + c) as u32);
                    }
                }
            }
            *id = best.1;
        });
        centers = means(pixels, &ids, columns * rows, &centers);
    }
    ids
}

/// Squared distance of a pixel to a cluster; `place`: weight of a pixel of distance.
fn distance(pixels: &Pixels, at: usize, center: &Center, place: f32) -> f32 {
    let square = |v: f32| v * v;
    let (x, y) = ((at % pixels.width) as f32, (at / pixels.width) as f32);
    let apart = (square(x - center.x) + square(y - center.y)) * square(place);
    let mut sum = apart + pixels.lab[at].distance_squared(center.lab) / square(COLOR);
    let (point, normal) = (pixels.surface.points[at], pixels.surface.normals[at]);
    if point.z > 0.0 && center.point.z > 0.0 {
        let off = center.normal.dot(point - center.point) / point.z.min(center.point.z);
        let turned = normal.distance_squared(center.normal);
        // Far from its plane is far enough.
        sum += square(off / PLANE).min(25.0) + turned / square(NORMAL);
    } else if point.z > 0.0 || center.point.z > 0.0 {
        sum += 1.0;
    }
    sum
}

/// Means of all clusters; one without pixels keeps its old values.
fn means(pixels: &Pixels, ids: &[u32], count: usize, before: &[Center]) -> Vec<Center> {
    #[derive(Clone, Copy, Default)]
    struct Sums {
        pixels: f64,
        place: [f64; 2],
        lab: DVec3,
        known: f64,
        point: DVec3,
        normal: DVec3,
    }
    let mut sums = vec![Sums::default(); count];
    for (at, &id) in ids.iter().enumerate() {
        let sum = &mut sums[id as usize];
        sum.pixels += 1.0;
        sum.place[0] += (at % pixels.width) as f64;
        sum.place[1] += (at / pixels.width) as f64;
        sum.lab += pixels.lab[at].as_dvec3();
        if pixels.surface.points[at].z > 0.0 {
            sum.known += 1.0;
            sum.point += pixels.surface.points[at].as_dvec3();
            sum.normal += pixels.surface.normals[at].as_dvec3();
        }
    }
    let center = |(i, s): (usize, &Sums)| {
        if s.pixels == 0.0 {
            return before.get(i).copied().unwrap_or_default();
        }
        let length = s.normal.length();
        // Where most pixels have no depth, the cluster has none.
        let known = s.known > 0.5 * s.pixels;
        let of = |is: bool, sum: DVec3, by: f64| if is { (sum / by).as_vec3() } else { Vec3::ZERO };
        Center {
            x: (s.place[0] / s.pixels) as f32,
            y: (s.place[1] / s.pixels) as f32,
            lab: (s.lab / s.pixels).as_vec3(),
            point: of(known, s.point, s.known),
            normal: of(known && length > 0.0, s.normal, length),
        }
    };
    sums.iter().enumerate().map(center).collect()
}

#[cfg(test)]
mod by_hand;
#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use crate::segmenter::tests::view;
    use scenesplat_rasterizer::lifting::SegmentMap;
    use scenesplat_scene::picture::RgbPicture;

    fn segment(picture: &RgbPicture, depth: Option<&[f32]>) -> SegmentMap {
        let view = view(picture.width(), picture.height());
        let posed = PosedPicture { name: "a", picture, view: &view, depth };
        let found =
            Superpixels::new(SuperpixelSettings::default()).unwrap().segment(&posed).unwrap();
        assert_eq!(found.left_out, 0);
        found.map
    }

    /// Share of the pixels that are in a segment whose most frequent truth is theirs.
    fn purity(map: &SegmentMap, truth: impl Fn(u32, u32) -> usize) -> f64 {
        let mut counts = vec![[0u32; 8]; map.num_ids()];
        for (at, &id) in map.ids().iter().enumerate() {
            let (x, y) = (at as u32 % map.width(), at as u32 / map.width());
            counts[usize::from(id)][truth(x, y)] += 1;
        }
        let right: u32 = counts.iter().map(|c| c.iter().max().unwrap()).sum();
        f64::from(right) / map.ids().len() as f64
    }

    #[test]
    fn colors_are_told_apart_and_one_surface_is_one_segment() {
        let truth = |x: u32, y: u32| usize::from(x * 2 > y + 60) + 2 * usize::from(y > 50);
        let colors = [[200, 60, 50], [60, 160, 70], [50, 70, 190], [200, 190, 60]];
        let picture = RgbPicture::from_fn(120, 90, |x, y| colors[truth(x, y)]);
        let map = segment(&picture, None);
        assert!(purity(&map, truth) > 0.99, "{}", purity(&map, truth));
        assert!((4..=8).contains(&map.num_ids()), "{}", map.num_ids());
    }

    #[test]
    fn depth_tells_apart_what_color_does_not() {
        // A box before a wall, and the floor: all of one gray.
        let picture = RgbPicture::filled(120, 90, [128; 3]);
        let inside = |x: u32, y: u32| (40..80).contains(&x) && (20..60).contains(&y);
        let truth = |x: u32, y: u32| if inside(x, y) { 1 } else { usize::from(y >= 70) * 2 };
        let depth: Vec<f32> = (0..120 * 90)
            .map(|at| {
                let (x, y) = (at % 120, at / 120);
                // A floor that meets the wall of depth 4 at row 70.
                let down = (y as f32 + 0.5 - 45.0) / 120.0;
                match truth(x, y) {
                    1 => 2.5,
                    2 => 4.0 * (25.0 / 120.0) / down,
                    _ => 4.0,
                }
            })
            .collect();
        let map = segment(&picture, Some(&depth));
        assert!(purity(&map, truth) > 0.97, "{}", purity(&map, truth));
        assert!((3..=12).contains(&map.num_ids()), "{}", map.num_ids());
        assert_eq!(segment(&picture, None).num_ids(), 1);
    }

    #[test]
    fn a_small_segment_joins_its_most_similar_neighbour() {
        // Two halves, and in the left one three pixels that are most like the right one.
        let spot = |at: usize| [25, 26, 33].contains(&at);
        let lab = (0..64)
            .map(|at| match (spot(at), at % 8 < 4) {
                (true, _) => Vec3::new(60.0, 30.0, 0.0),
                (false, left) => Vec3::new(60.0, if left { 0.0 } else { 40.0 }, 0.0),
            })
            .collect();
        let clusters: Vec<u32> =
            (0..64).map(|at| if spot(at) { 2 } else { u32::from(at % 8 >= 4) }).collect();
        let pixels = Pixels { width: 8, height: 8, lab, surface: Surface::unknown(64) };
        let count = |smallest| {
            let ids = merge(&pixels, &clusters, Similarity { limit: 0.0, smallest });
            (ids.iter().max().unwrap() + 1, ids[25] == ids[0])
        };
        // They touch the left half alone.
        assert_eq!((count(3), count(4)), ((3, false), (2, true)));
        // Halves of 29 and 32 pixels join only if both are asked to be larger.
        assert_eq!((count(32).0, count(40).0), (2, 1));
    }

    #[test]
    fn threads_change_nothing_and_odd_sizes_work() {
        let mut rng = 7u32;
        for (width, height) in [(1, 1), (3, 70), (70, 3), (64, 48)] {
            let noise: Vec<[u8; 3]> = (0..width * height)
                .map(|_| {
                    rng = rng.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    [(rng >> 8) as u8, (rng >> 16) as u8, (rng >> 24) as u8]
                })
                .collect();
            let picture = RgbPicture::from_pixels(width, height, noise).unwrap();
            let depth = vec![f32::NAN; (width * height) as usize];
            let all = segment(&picture, Some(&depth));
            let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
            assert_eq!(one.install(|| segment(&picture, Some(&depth))), all);
        }
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let good = SuperpixelSettings::default();
        for (bad, part) in [
            (SuperpixelSettings { side: 3, ..good }, "side"),
            (SuperpixelSettings { compactness: f32::NAN, ..good }, "compactness"),
            (SuperpixelSettings { merge: -1.0, ..good }, "merge"),
        ] {
            let error = Superpixels::new(bad).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn steps_are_parts_of_the_depth() {
        let off_plane = |depth: f32| {
            let point = Vec3::new(0.0, 0.0, 1.01 * depth);
            let surface = Surface { points: vec![point], normals: vec![Vec3::NEG_Z] };
            let pixels = Pixels { width: 1, height: 1, lab: vec![Vec3::ZERO], surface };
            let center = Center {
                x: 0.0,
                y: 0.0,
                lab: Vec3::ZERO,
                point: Vec3::new(0.0, 0.0, depth),
                normal: Vec3::NEG_Z,
            };
            distance(&pixels, 0, &center, 1.0)
        };
        // A hundredth of the depth is half of what counts as 1, near or far.
        for depth in [0.5, 1.0, 4.0] {
            assert!((off_plane(depth) - 0.25).abs() < 1e-3, "{depth}: {}", off_plane(depth));
        }
    }

    #[test]
    fn every_setting_of_superpixels_changes_their_name() {
        let good = SuperpixelSettings::default();
        let all = [
            good,
            SuperpixelSettings { side: 13, ..good },
            SuperpixelSettings { compactness: 0.7, ..good },
            SuperpixelSettings { merge: 0.25, ..good },
            SuperpixelSettings { smallest: 41, ..good },
        ];
        let names = all.map(|settings| Superpixels::new(settings).unwrap().name());
        // Each two of the five settings differ, so each two names have to.
        for (i, name) in names.iter().enumerate() {
            assert!(!names[..i].contains(name), "{name} is twice in {names:?}");
        }
    }
}
