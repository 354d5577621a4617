//! Whether pictures were taken with changing exposure or white balance, told before there is a scene.
//!
//! Points on the measured surface are looked up in all pictures that see them. A picture's gain is what
//! its colors of these points have in common against the other pictures' colors of the same points.

use crate::frame::TrainingFrame;
use rayon::prelude::*;
use scenesplat_scene::linear_light::linear;

/// Points that are looked up; more say nothing more about a gain.
const POINTS: usize = 4000;
/// How far a point may lie from what a picture measured there, a share of the distance.
const DEPTH_SHARE: f32 = 0.03;
/// From here on a value is taken for clipped.
const CLIPPED: f32 = 250.0 / 255.0;
/// Linear light that is neither clipped nor mostly noise.
const LIGHT: [f64; 2] = [0.004, 0.9];
/// Points that a picture has to share with others to be judged.
const FEWEST_POINTS: usize = 50;
/// Pictures below which a spread means nothing.
const FEWEST_FRAMES: usize = 6;
/// Rounds of medians over points and over pictures; the gains of connected pictures have settled by then.
const ROUNDS: usize = 8;
/// Standard deviation of the logarithm of the exposure that is called 1, and of red against blue: as the
/// probe of finished scenes counts them.
const EXPOSURE_UNIT: f64 = 0.10;
const BALANCE_UNIT: f64 = 0.02;

/// What the pictures say about the camera's automatic exposure.
#[derive(Debug, Clone, PartialEq)]
pub struct ExposureDrift {
    /// Natural logarithms of red, green and blue in linear light against the median picture; `None` where a
    /// picture shares too few points with others.
    pub log_gains: Vec<Option<[f64; 3]>>,
    /// Standard deviation over the pictures of the mean of the three, nat, by the median distance.
    pub exposure: f64,
    /// The same of half of red less blue.
    pub balance: f64,
}

impl ExposureDrift {
    /// Below this [`severity`](Self::severity) exposure is taken for constant.
    pub const THRESHOLD: f64 = 0.75;

    /// How strong the drift is: the larger of exposure in tenths and balance in fiftieths, 0 and more.
    pub fn severity(&self) -> f64 {
        (self.exposure / EXPOSURE_UNIT).max(self.balance / BALANCE_UNIT)
    }

    /// Whether it is worth learning a gain for each picture.
    pub fn is_present(&self) -> bool {
        self.severity() >= Self::THRESHOLD
    }
}

/// The drift of pictures with depths, at points of their surface (world, units of the scene).
///
/// `None` where that is unknown: fewer than six pictures have depth and share 50 points with others.
pub fn exposure_drift(frames: &[TrainingFrame], points: &[[f32; 3]]) -> Option<ExposureDrift> {
    let stride = points.len().div_ceil(POINTS).max(1);
    let points: Vec<[f32; 3]> = points.iter().step_by(stride).copied().collect();
    // [frames][points]: logarithms of linear light, where a picture shows the point.
    let seen: Vec<Vec<Option<[f64; 3]>>> = frames
        .par_iter()
        .map(|frame| points.iter().map(|point| color_of(frame, *point)).collect())
        .collect();
    let shared: Vec<bool> =
        (0..points.len()).map(|p| seen.iter().filter(|f| f[p].is_some()).count() >= 2).collect();
    let count = |frame: &Vec<Option<[f64; 3]>>| {
        frame.iter().zip(&shared).filter(|(color, shared)| color.is_some() && **shared).count()
    };
    let judged: Vec<bool> = seen.iter().map(|frame| count(frame) >= FEWEST_POINTS).collect();
    if judged.iter().filter(|judged| **judged).count() < FEWEST_FRAMES {
        return None;
    }
    let channels: [Vec<f64>; 3] =
        std::array::from_fn(|c| gains_of_channel(&seen, &shared, &judged, c));
    let log_gains: Vec<Option<[f64; 3]>> =
        (0..frames.len()).map(|f| judged[f].then(|| [0, 1, 2].map(|c| channels[c][f]))).collect();
    let known = || log_gains.iter().flatten();
    let exposures: Vec<f64> = known().map(|g| (g[0] + g[1] + g[2]) / 3.0).collect();
    let balances: Vec<f64> = known().map(|g| 0.5 * (g[0] - g[2])).collect();
    let (exposure, balance) = (deviation(&exposures), deviation(&balances));
    Some(ExposureDrift { log_gains, exposure, balance })
}

/// Gains of one channel: medians over points of what a picture has more than the points' own color, which is
/// the median over pictures of what they show less their gain, in turn. Their median is 0.
fn gains_of_channel(
    seen: &[Vec<Option<[f64; 3]>>],
    shared: &[bool],
    judged: &[bool],
    channel: usize,
) -> Vec<f64> {
    let mut gains = vec![0.0; seen.len()];
    let mut own = vec![0.0; shared.len()];
    let frames = || (0..seen.len()).filter(|f| judged[*f]);
    for _ in 0..ROUNDS {
        for (p, own) in own.iter_mut().enumerate().filter(|(p, _)| shared[*p]) {
            let colors = frames().filter_map(|f| Some(seen[f][p]?[channel] - gains[f])).collect();
            *own = median(colors).unwrap_or(0.0);
        }
        for f in frames() {
            let points = seen[f].iter().enumerate().filter(|(p, _)| shared[*p]);
            let more = points.filter_map(|(p, color)| Some((*color)?[channel] - own[p])).collect();
            gains[f] = median(more).unwrap_or(0.0);
        }
        let middle = median(frames().map(|f| gains[f]).collect()).unwrap_or(0.0);
        frames().for_each(|f| gains[f] -= middle);
    }
    gains
}

/// Logarithms of the mean linear color of the 3 × 3 pixels around where a picture shows a point; `None` if it
/// does not, or they are masked, clipped or dark.
fn color_of(frame: &TrainingFrame, point: [f32; 3]) -> Option<[f64; 3]> {
    let (view, depth) = (&frame.view, frame.depth.as_ref()?);
    let [x, y, z] = view.to_camera(point);
    let (width, height) = (view.width as usize, view.height as usize);
    if z.is_nan() || z <= 0.0 || width < 3 || height < 3 {
        return None;
    }
    let (u, v) = (x / z * view.fx + view.cx, y / z * view.fy + view.cy);
    // NaN fails both comparisons.
    let inside = u >= 1.0 && v >= 1.0 && u < (width - 1) as f32 && v < (height - 1) as f32;
    if !inside {
        return None;
    }
    let (column, row) = (u as usize, v as usize);
    let surface = depth[row * width + column];
    let visible = (surface - z).abs() <= DEPTH_SHARE * z;
    if !visible {
        return None;
    }
    let mut sum = [0.0; 3];
    for at in
        (row - 1..=row + 1).flat_map(|r| (column - 1..=column + 1).map(move |c| r * width + c))
    {
        if !frame.shows(at) {
            return None;
        }
        let color = [0, 1, 2].map(|c| frame.rgb.at(3 * at + c));
        if color.iter().any(|v| *v >= CLIPPED) {
            return None;
        }
        (0..3).for_each(|c| sum[c] += linear(f64::from(color[c])) / 9.0);
    }
    sum.iter().all(|v| (LIGHT[0]..LIGHT[1]).contains(v)).then(|| sum.map(f64::ln))
}

/// The median of finite values, of an even number the upper of the two in the middle.
fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The standard deviation of normally distributed values by the median of their distances from their median.
fn deviation(values: &[f64]) -> f64 {
    let Some(middle) = median(values.to_vec()) else { return 0.0 };
    1.4826 * median(values.iter().map(|v| (v - middle).abs()).collect()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Colors;
    use crate::frame::tests::view;

    /// Linear light as a value of a picture, 0 to 1.
    fn shown(light: f64) -> f32 {
        scenesplat_scene::linear_light::display(light) as f32
    }

    /// Cameras side by side before a wall at z = 1 with a pattern, each with a gain of its own.
    fn frames(gains: &[[f64; 3]]) -> Vec<TrainingFrame> {
        let (width, height) = (64u32, 48u32);
        let frame = |(i, gain): (usize, &[f64; 3])| {
            let mut view = view(width, height);
            view.world_to_camera[0][3] = 0.05 * i as f32;
            let mut rgb = Vec::new();
            for y in 0..height {
                for x in 0..width {
                    let world = (x as f32 + 0.5 - view.cx) / view.fx * 3.0 - 0.05 * i as f32;
                    let row = (y as f32 + 0.5 - view.cy) / view.fy * 3.0;
                    let light = 0.2 + 0.05 * f64::from((3.0 * world).sin() + (2.0 * row).cos());
                    rgb.extend(gain.map(|g| shown(light * g)));
                }
            }
            TrainingFrame {
                name: i.to_string(),
                view,
                rgb: Colors::Floats(rgb),
                alpha: None,
                depth: Some(vec![3.0; (width * height) as usize]),
                mask: None,
            }
        };
        gains.iter().enumerate().map(frame).collect()
    }

    fn wall() -> Vec<[f32; 3]> {
        (0..900)
            .map(|i| [(i % 30) as f32 / 20.0 - 0.75, (i / 30) as f32 / 25.0 - 0.6, 1.0])
            .collect()
    }

    #[test]
    fn equal_exposures_are_constant() {
        let drift = exposure_drift(&frames(&[[1.0; 3]; 8]), &wall()).unwrap();
        assert!(drift.severity() < 0.05 && !drift.is_present(), "{drift:?}");
    }

    #[test]
    fn gains_are_those_of_the_camera() {
        let made: Vec<[f64; 3]> = (0..9)
            .map(|i| {
                let (g, tint) = (0.7 + 0.075 * f64::from(i), 1.0 + 0.02 * f64::from(i % 3));
                [g * tint, g, g / tint]
            })
            .collect();
        let drift = exposure_drift(&frames(&made), &wall()).unwrap();
        let middle = made[4];
        for (got, made) in drift.log_gains.iter().zip(&made) {
            let got = got.unwrap();
            for c in 0..3 {
                // The median of each channel is a picture of its own; tints move it by less than 0.05.
                assert!((got[c] - (made[c] / middle[c]).ln()).abs() < 0.05, "{got:?} {made:?}");
            }
        }
        assert!(drift.is_present() && drift.exposure > 0.15, "{drift:?}");
        assert!((0.005..0.04).contains(&drift.balance), "{drift:?}");
    }

    #[test]
    fn what_cannot_be_told_is_not_guessed() {
        let mut frames = frames(&[[1.0; 3]; 8]);
        assert!(exposure_drift(&frames[..5], &wall()).is_none());
        assert!(exposure_drift(&frames, &[]).is_none());
        assert!(exposure_drift(&frames, &[[f32::NAN; 3]; 400]).is_none());
        frames.iter_mut().for_each(|f| f.depth = None);
        assert!(exposure_drift(&frames, &wall()).is_none());
    }

    #[test]
    fn hidden_points_do_not_count() {
        let mut frames = frames(&[[1.0; 3]; 8]);
        // One picture has something else before the wall, twice as bright.
        frames[3].depth = Some(vec![1.0; 64 * 48]);
        frames[3].rgb = Colors::Floats(vec![0.8; 3 * 64 * 48]);
        let drift = exposure_drift(&frames, &wall()).unwrap();
        assert!(drift.log_gains[3].is_none() && !drift.is_present(), "{drift:?}");
    }

    #[test]
    fn points_that_one_picture_alone_shows_say_nothing() {
        let mut frames = frames(&[[1.0; 3]; 8]);
        // The last one stands before another part of the wall.
        frames[7].view.world_to_camera[0][3] = -100.0;
        let far = wall().into_iter().map(|[x, y, z]| [x + 100.0, y, z]);
        let points: Vec<[f32; 3]> = wall().into_iter().chain(far).collect();
        let drift = exposure_drift(&frames, &points).unwrap();
        let judged: Vec<bool> = drift.log_gains.iter().map(Option::is_some).collect();
        assert_eq!(judged, [true, true, true, true, true, true, true, false]);
    }

    #[test]
    fn a_point_before_what_was_measured_there_is_not_seen() {
        let mut frame = frames(&[[1.0; 3]]).remove(0);
        let point = [0.1, 0.1, 1.0];
        for (depth, seen) in [(3.0, true), (9.0, false), (1.0, false)] {
            frame.depth = Some(vec![depth; 64 * 48]);
            assert_eq!(color_of(&frame, point).is_some(), seen, "{depth}");
        }
    }

    #[test]
    fn balance_is_of_red_against_blue() {
        let tints: Vec<f64> = (0..9).map(|i| 0.9 + 0.05 * f64::from(i % 5)).collect();
        let made: Vec<[f64; 3]> = tints.iter().map(|t| [*t, 1.0, 1.0 / t]).collect();
        let drift = exposure_drift(&frames(&made), &wall()).unwrap();
        let want = deviation(&tints.iter().map(|t| t.ln()).collect::<Vec<_>>());
        assert!((drift.balance / want - 1.0).abs() < 0.3, "{} {want}", drift.balance);
    }

    #[test]
    fn a_color_is_the_mean_light_of_nine_pixels() {
        // A picture of 9 × 7 pixels, each of its own color; the point is at pixel (5, 2).
        let mut frame = crate::frame::tests::frame(view(9, 7), Some(2.0));
        (frame.view.fx, frame.view.fy) = (9.0, 8.0);
        let rgb = |k: usize| 0.2 + 0.003 * k as f32;
        frame.rgb = Colors::Floats((0..189).map(rgb).collect());
        let point = [(5.25 - 4.5) / 9.0 * 2.0, (2.75 - 3.5) / 8.0 * 2.0, 0.0];
        let found = color_of(&frame, point).unwrap();
        for c in 0..3 {
            let light = |at: usize| ((f64::from(rgb(3 * at + c)) + 0.055) / 1.055).powf(2.4);
            let nine = [13, 14, 15, 22, 23, 24, 31, 32, 33].map(light);
            assert!((found[c] - (nine.iter().sum::<f64>() / 9.0).ln()).abs() < 1e-6, "{found:?}");
        }
        let with = |change: &dyn Fn(&mut TrainingFrame)| {
            let mut frame = frame.clone();
            change(&mut frame);
            color_of(&frame, point).is_some()
        };
        let float = |f: &mut TrainingFrame, k: usize, to: f32| match &mut f.rgb {
            Colors::Floats(values) => values[k] = to,
            Colors::Bytes(_) => panic!("bytes"),
        };
        // One of the nine masked, half transparent or clipped hides it; the next ones do not.
        for (pixel, is_seen) in [(13, false), (33, false), (12, true), (34, true), (40, true)] {
            assert_eq!(
                with(&|f| f.mask = Some((0..63).map(|i| u8::from(i != pixel)).collect())),
                is_seen
            );
            assert_eq!(with(&|f| float(f, 3 * pixel + 1, 250.0 / 255.0)), is_seen, "{pixel}");
            assert!(with(&|f| float(f, 3 * pixel + 1, 249.9 / 255.0)), "{pixel}");
        }
        // The depth of its own pixel alone, to within 3 %.
        for (depth, is_seen) in
            [(2.05, true), (1.95, true), (2.07, false), (1.93, false), (f32::NAN, false)]
        {
            assert_eq!(with(&|f| f.depth.as_mut().unwrap()[23] = depth), is_seen, "{depth}");
        }
        assert!(with(
            &|f| f.depth = Some((0..63).map(|i| if i == 23 { 2.0 } else { 9.0 }).collect())
        ));
        // Light below 0.004 or from 0.9 on says nothing: 0.05 is 0.0039, 0.96 is 0.908.
        for (value, is_seen) in [(0.05, false), (0.06, true), (0.95, true), (0.96, false)] {
            assert_eq!(with(&|f| f.rgb = Colors::Floats(vec![value; 189])), is_seen, "{value}");
        }
        // The outermost pixels have no nine around them.
        let at =
            |u: f32, v: f32| color_of(&frame, [(u - 4.5) / 4.5, (v - 3.5) / 4.0, 0.0]).is_some();
        let seen = [
            at(1.01, 3.0),
            at(0.99, 3.0),
            at(7.99, 3.0),
            at(8.01, 3.0),
            at(4.0, 0.99),
            at(4.0, 6.01),
        ];
        assert_eq!(seen, [true, false, true, false, false, false]);
        assert!(at(4.0, 1.01) && at(4.0, 5.99));
        assert_eq!(color_of(&frame, [0.0, 0.0, -2.0]), None);
        assert_eq!(color_of(&frame, [0.0, 0.0, -4.0]), None);
    }

    #[test]
    fn gains_and_spreads_by_hand() {
        // Three pictures of three points; the second is 0.5 brighter, the third 0.25 darker, one value is off.
        let seen: Vec<Vec<Option<[f64; 3]>>> = [0.0, 0.5, -0.25]
            .iter()
            .map(|gain| (0..3).map(|p| Some([9.0, f64::from(p) + gain, 9.0])).collect())
            .collect();
        let all = gains_of_channel(&seen, &[true; 3], &[true; 3], 1);
        for (got, want) in all.iter().zip([0.0, 0.5, -0.25]) {
            assert!((got - want).abs() < 1e-9, "{all:?}");
        }
        // What is not judged has no gain and no say: the upper median of the others is 0.
        let some = gains_of_channel(&seen, &[true, true, false], &[false, true, true], 1);
        assert_eq!((some[0], some[1]), (0.0, 0.0));
        assert!((some[2] + 0.75).abs() < 1e-9, "{some:?}");
        assert_eq!(median(vec![3.0, 1.0, 2.0, 4.0]), Some(3.0));
        assert_eq!((median(Vec::new()), deviation(&[])), (None, 0.0));
        // About the median 2: distances 1, 0, 3.
        assert!((deviation(&[1.0, 2.0, 5.0]) - 1.4826).abs() < 1e-12);
        let drift = |exposure, balance| ExposureDrift { log_gains: Vec::new(), exposure, balance };
        assert!((drift(0.05, 0.001).severity() - 0.5).abs() < 1e-12);
        assert!((drift(0.05, 0.03).severity() - 1.5).abs() < 1e-12);
        assert_eq!(
            (drift(0.0751, 0.0).is_present(), drift(0.0749, 0.0149).is_present()),
            (true, false)
        );
        assert_eq!((ExposureDrift::THRESHOLD, drift(0.0, 0.0151).is_present()), (0.75, true));
    }

    #[test]
    fn exposure_is_of_the_mean_and_balance_of_half_of_red_less_blue() {
        // Gains whose medians are those of picture 3; channels by ratios that do not cancel.
        let logs: Vec<[f64; 3]> = [-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]
            .iter()
            .map(|k| [0.06 * k, 0.03 * k, -0.01 * k])
            .collect();
        let made: Vec<[f64; 3]> = logs.iter().map(|l| l.map(f64::exp)).collect();
        let mut frames = frames(&made);
        let drift = exposure_drift(&frames, &wall()).unwrap();
        // Means (0.08 / 3) k: the median distance is that of k = 2. Red less blue: 0.07 k, half of it.
        assert!((drift.exposure - 1.4826 * 0.16 / 3.0).abs() < 0.005, "{drift:?}");
        assert!((drift.balance - 1.4826 * 0.07).abs() < 0.005, "{drift:?}");
        for (got, want) in drift.log_gains.iter().zip(&logs) {
            for c in 0..3 {
                assert!((got.unwrap()[c] - want[c]).abs() < 0.02, "{got:?} {want:?}");
            }
        }
        // Points are at rows 11, 12, 12, … of the picture, thirty each; of the nine pixels none may be masked.
        for (rows, is_judged) in [(13, false), (14, true)] {
            frames[6].mask = Some((0..64 * 48).map(|i| u8::from(i / 64 < rows)).collect());
            let drift = exposure_drift(&frames, &wall()).unwrap();
            assert_eq!(drift.log_gains[6].is_some(), is_judged, "{rows}");
        }
        frames[6].mask = None;
        assert!(exposure_drift(&frames, &wall()[..50]).is_some());
        assert!(exposure_drift(&frames, &wall()[..49]).is_none());
        // Six pictures are enough.
        assert!(exposure_drift(&frames[..6], &wall()).is_some());
        // Of 8,000 points every second is looked up: the others may be anywhere.
        let doubled: Vec<[f32; 3]> =
            wall().iter().cycle().take(4000).flat_map(|p| [*p, [1e9; 3]]).collect();
        assert!(exposure_drift(&frames, &doubled).unwrap().log_gains[0].is_some());
    }
}
