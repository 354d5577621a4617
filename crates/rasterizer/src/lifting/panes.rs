//! Two layers of labels where pictures look through glass.
//!
//! A pixel of a pane shows the pane, faintly, and what is behind it, and a segment names one of the two. One that
//! has the pane's outline names the pane: there its label is for the Gaussians of the pane alone, and any other one
//! for all but them.

use super::LiftError;
use super::segment_map::{NO_SEGMENT, SegmentMap};
use super::spool::SegmentWeight;
use super::view_weights::{DepthTolerance, Drawn, LabelledView, LiftRule, ViewWeights, check};
use crate::{Gaussians, RasterSettings, View};

/// A segment names a pane if its outline and the pane's agree so well: what they share, of what either has.
const SAME_OUTLINE: f64 = 0.5;
/// What is this much nearer than a pane, as a part of its depth, stands before it.
const BEFORE: f32 = 0.02;
/// Of the confidence of what may be a mirror image, so much is left.
const DOUBT: f32 = 0.25;
/// No pane shows in a pixel.
const NO_PANE: u16 = u16::MAX;

/// Where panes of glass are in a scene.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Panes {
    /// Whether a Gaussian is part of a pane. `[N]`
    pub is_sheet: Vec<bool>,
    /// Whether a Gaussian may be a mirror image: its confidence is divided by four. `[N]`
    pub is_doubtful: Vec<bool>,
    /// Each pane as balls (center, radius) that cover it, in units of the world.
    pub balls: Vec<Vec<[f32; 4]>>,
}

impl Panes {
    /// Checks that the arrays are of so many Gaussians.
    pub(super) fn check(&self, gaussians: usize) -> Result<(), LiftError> {
        for (rows, field) in [(&self.is_sheet, "sheet of panes"), (&self.is_doubtful, "doubtful")] {
            if rows.len() != gaussians {
                let problem = format!("{} rows, there are {gaussians} Gaussians", rows.len());
                return Err(LiftError::argument(field, problem));
            }
        }
        if self.balls.len() >= usize::from(NO_PANE) {
            let problem = format!("{}, less than {NO_PANE} are expected", self.balls.len());
            return Err(LiftError::argument("panes", problem));
        }
        Ok(())
    }

    /// The confidence of a Gaussian.
    pub(super) fn confidence(&self, gaussian: usize, confidence: f32) -> f32 {
        if self.is_doubtful[gaussian] { DOUBT * confidence } else { confidence }
    }

    /// The weights of a picture, and whether it shows a pane; if not, they are what they would be without panes,
    /// bit for bit. `own`: as of [`weights_with_own_depth`](super::view_weights::weights_with_own_depth).
    pub(super) fn weights(
        &self,
        gaussians: &Gaussians,
        picture: &LabelledView<'_>,
        own: Option<DepthTolerance>,
        rule: LiftRule,
        settings: &RasterSettings,
    ) -> Result<(ViewWeights, bool), LiftError> {
        check(picture)?;
        let drawn = Drawn::new(gaussians, picture.view, settings)?;
        let discs = self.discs(picture.view);
        if discs.is_empty() && own.is_none() {
            return Ok((drawn.weights(gaussians, picture, rule, settings), false));
        }
        let median = drawn.median_depth(picture.view, settings);
        let depth = own.map(|tolerance| (&median[..], tolerance)).or(picture.depth);
        let picture = LabelledView { depth, ..*picture };
        let shown = silhouettes(&discs, &median, picture.view);
        if shown.iter().all(|pane| *pane == NO_PANE) {
            return Ok((drawn.weights(gaussians, &picture, rule, settings), false));
        }
        let (behind, panes): (Vec<_>, Vec<_>) =
            picture.levels.iter().map(|map| self.split(map, &shown)).unzip();
        let back = LabelledView { levels: &behind, ..picture };
        let mut out = drawn.weights(gaussians, &back, rule, settings);
        let is_sheet = |w: &SegmentWeight| self.is_sheet[w.gaussian as usize];
        // Level by level: what one says is no other's affair.
        let names_pane = |map: &SegmentMap| map.num_ids() > 0;
        for (weights, map) in out.levels.iter_mut().zip(&panes) {
            // Where depth agrees, what is left of a pane is seen by itself.
            if names_pane(map) || depth.is_none() {
                weights.retain(|w| !is_sheet(w));
            }
        }
        if panes.iter().any(names_pane) {
            // The median depth is that of what is behind.
            let front = LabelledView { levels: &panes, depth: None, ..picture };
            let front = drawn.weights(gaussians, &front, rule, settings);
            for (weights, of_panes) in out.levels.iter_mut().zip(front.levels) {
                weights.extend(of_panes.into_iter().filter(is_sheet));
                // Stable: by Gaussian, then by segment, as they were.
                weights.sort_by_key(|w| w.gaussian);
            }
        }
        Ok((out, true))
    }

    /// What the balls before the camera cover of its picture.
    fn discs(&self, view: &View) -> Vec<Disc> {
        let disc = |pane: usize, ball: &[f32; 4]| {
            let at = view
                .world_to_camera
                .map(|row| row[0] * ball[0] + row[1] * ball[1] + row[2] * ball[2] + row[3]);
            let [x, y, depth] = at;
            let radius = ball[3];
            // What the camera stands in or right at covers anything.
            if !(depth > radius && radius > 0.0 && at.iter().all(|v| v.is_finite())) {
                return None;
            }
            let middle = [view.fx * x / depth + view.cx, view.fy * y / depth + view.cy];
            let reach = [view.fx, view.fy].map(|f| f * radius / depth);
            let size = [view.width as f32, view.height as f32];
            let inside =
                (0..2).all(|a| middle[a] + reach[a] > 0.0 && middle[a] - reach[a] < size[a]);
            inside.then_some(Disc { pane: pane as u16, middle, reach, depth: depth - radius })
        };
        let balls = self.balls.iter().enumerate();
        balls.flat_map(|(pane, balls)| balls.iter().filter_map(move |b| disc(pane, b))).collect()
    }

    /// A map without the pixels that name a pane, and one of these alone. `shown`: the pane of each pixel
    fn split(&self, map: &SegmentMap, shown: &[u16]) -> (SegmentMap, SegmentMap) {
        let (ids, panes) = (map.num_ids(), self.balls.len());
        let mut of_segment = vec![0u32; ids];
        let mut of_pane = vec![0u32; panes];
        let mut shared = vec![0u32; ids * panes];
        for (&id, &pane) in map.ids().iter().zip(shown) {
            let (id, pane) = (usize::from(id), usize::from(pane));
            if pane < panes {
                of_pane[pane] += 1;
            }
            if id < ids {
                of_segment[id] += 1;
                if pane < panes {
                    shared[id * panes + pane] += 1;
                }
            }
        }
        // A segment may name several panes at once: all of which it has most.
        let names = |id: usize, pane: usize| 2 * shared[id * panes + pane] > of_pane[pane];
        let is_of_panes = |id: usize| {
            let named = (0..panes).filter(|&pane| names(id, pane));
            let (both, area) = named.fold((0u32, 0u32), |(both, area), pane| {
                (both + shared[id * panes + pane], area + of_pane[pane])
            });
            f64::from(both) >= SAME_OUTLINE * f64::from(of_segment[id] + area - both) && both > 0
        };
        let is_of_panes: Vec<bool> = (0..ids).map(is_of_panes).collect();
        let names_pane = |id: u16, pane: u16| {
            let (id, pane) = (usize::from(id), usize::from(pane));
            id < ids && pane < panes && is_of_panes[id] && names(id, pane)
        };
        let only = |of_panes: bool| {
            let pixels = map.ids().iter().zip(shown);
            map.with_ids(pixels.map(|(&id, &pane)| match names_pane(id, pane) == of_panes {
                true => id,
                false => NO_SEGMENT,
            }))
        };
        (only(false), only(true))
    }
}

/// A ball in a picture.
struct Disc {
    pane: u16,
    /// Pixels.
    middle: [f32; 2],
    /// Half axes, pixels.
    reach: [f32; 2],
    /// Of its nearest point.
    depth: f32,
}

/// The pane that each pixel shows: the nearest that nothing stands before. `median`: `[H, W]`, 0 where there is
/// nothing
fn silhouettes(discs: &[Disc], median: &[f32], view: &View) -> Vec<u16> {
    let mut shown = vec![NO_PANE; view.pixels()];
    let mut nearest = vec![f32::INFINITY; view.pixels()];
    for disc in discs {
        let span = |a: usize, size: u32| {
            let [first, end] = [-1.0, 1.0].map(|side| disc.middle[a] + side * disc.reach[a]);
            // Saturating.
            (first.floor() as u32).min(size)..(end.ceil() as u32).min(size)
        };
        for y in span(1, view.height) {
            for x in span(0, view.width) {
                let from =
                    |a: usize, pixel: u32| (pixel as f32 + 0.5 - disc.middle[a]) / disc.reach[a];
                let at = (y * view.width + x) as usize;
                let behind = median[at] <= 0.0 || median[at] >= (1.0 - BEFORE) * disc.depth;
                let covers = from(0, x).powi(2) + from(1, y).powi(2) <= 1.0;
                if covers && behind && disc.depth < nearest[at] {
                    nearest[at] = disc.depth;
                    shown[at] = disc.pane;
                }
            }
        }
    }
    shown
}
