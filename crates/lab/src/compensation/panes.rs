//! Which Gaussians are panes of glass, and which may be their mirror images.

use super::regions::inside;
use scenesplat_datasets::effects::plan::{
    EffectChoices, EffectDecision, EffectModule, PlanSection, decide,
};
use scenesplat_datasets::effects::profile::{FAINT, profile_of};
use scenesplat_datasets::effects::{Effect, EffectError};
use scenesplat_kernels::neighbors::{KdTree, Neighbor};
use scenesplat_kernels::symmetric_eigen::symmetric_eigen;
use scenesplat_rasterizer::lifting::Panes;
use scenesplat_scene::GaussianScene;
use scenesplat_scene::quantile::quantile;
use std::collections::{BTreeMap, VecDeque};

/// Balls of one pane overlap: the middles of two next to each other are nearer than this many radii.
const NEXT: f64 = 2.1;
/// A mirror image is so many radii of the balls from where it would be, at most: walls are thick.
const MIRRORED: f64 = 1.5;
/// Mirror images that are searched on either side.
const MOST_PLACES: usize = 4096;

/// What lifting can do about glass.
pub const TWO_LAYERS: EffectModule = EffectModule {
    effect: Effect::Glass,
    action: "pictures whose segments name a pane or what is behind it, not both",
    by_itself: true,
    worth: "it is worth more than a point of labels at and behind panes (docs/lifting.md)",
};

/// Looks for glass, unless that is off by choice, and decides whether labels are lifted in two layers. `before`: the
/// decisions of an earlier run on this scene: an automatic one stays until its measure is well on the other side of
/// its threshold.
///
/// # Errors
/// If something is asked for about another effect.
pub fn glass_decision(
    scene: &GaussianScene,
    choices: &EffectChoices,
    before: Option<&PlanSection>,
) -> Result<EffectDecision, EffectError> {
    let wanted = super::looked_for(&[TWO_LAYERS], choices);
    let section = decide(&[TWO_LAYERS], choices, &profile_of(scene, 1.0, &wanted), before)?;
    Ok(section.of(Effect::Glass).cloned().unwrap_or_default())
}

/// The panes in some balls (center, radius), as the profile finds them: each of the balls that hang together is a pane.
/// Its Gaussians are those in it that are fainter than usual; what is as faint behind it may be mirror images.
/// Behind is the side
/// of which more that is faint has something solid where its mirror image would be.
pub fn panes_of(scene: &GaussianScene, balls: &[[f32; 4]]) -> Panes {
    let mut opacities: Vec<f32> = (0..scene.len()).map(|row| scene.opacity(row)).collect();
    let limit = FAINT as f32 * quantile(&mut opacities, 0.5).unwrap_or(0.0);
    let is_faint = |row: usize| scene.opacity(row) < limit;
    let mut panes = Panes {
        is_sheet: vec![false; scene.len()],
        is_doubtful: vec![false; scene.len()],
        balls: together(balls),
    };
    let solid = Solid::of(scene, |row| !is_faint(row));
    for pane in &panes.balls {
        let in_pane = inside(pane, &scene.coord);
        (0..scene.len()).for_each(|row| panes.is_sheet[row] |= in_pane[row] && is_faint(row));
        let Some(plane) = Plane::of(pane) else { continue };
        let heights: Vec<f64> = scene.coord.iter().map(|p| plane.height(p)).collect();
        let radius = f64::from(pane[0][3]);
        // The point of the plane next to each Gaussian, far away where it is in the pane.
        let next = |row: usize| match heights[row].abs() > radius {
            true => plane.next_to(&scene.coord[row], heights[row]),
            false => [f32::NAN; 3],
        };
        let next: Vec<[f32; 3]> = (0..scene.len()).map(next).collect();
        let beside = inside(pane, &next);
        let before = |sign: f64| {
            let faint = |row: &usize| beside[*row] && sign * heights[*row] > 0.0 && is_faint(*row);
            let rows = (0..scene.len()).filter(faint);
            let mirrored =
                rows.map(|row| plane.mirrored(&scene.coord[row], heights[row])).collect();
            solid.share_near(mirrored, MIRRORED * radius)
        };
        let back = if before(1.0) > before(-1.0) { 1.0 } else { -1.0 };
        for row in 0..scene.len() {
            panes.is_doubtful[row] |= beside[row] && back * heights[row] > 0.0 && is_faint(row);
        }
    }
    panes
}

/// What is not faint.
struct Solid(Option<KdTree>);

impl Solid {
    fn of(scene: &GaussianScene, is_solid: impl Fn(usize) -> bool) -> Self {
        let there = |row: &usize| is_solid(*row) && scene.coord[*row].iter().all(|v| v.is_finite());
        let coord: Vec<[f32; 3]> =
            (0..scene.len()).filter(there).map(|row| scene.coord[row]).collect();
        Self(KdTree::new(&coord).ok().filter(|_| !coord.is_empty()))
    }

    /// The share of some places within a distance of which there is something.
    fn share_near(&self, places: Vec<[f32; 3]>, distance: f64) -> f64 {
        let step = places.len().div_ceil(MOST_PLACES).max(1);
        let places: Vec<[f32; 3]> = places.into_iter().step_by(step).collect();
        let Self(Some(tree)) = self else { return 0.0 };
        let is_near = tree.map_nearest(
            &places,
            1,
            || (),
            |(), _, near: &[Neighbor]| {
                near.first().is_some_and(|n| n.distance_squared <= distance * distance)
            },
        );
        is_near.iter().filter(|is| **is).count() as f64 / is_near.len().max(1) as f64
    }
}

/// The plane through the middles of balls.
struct Plane {
    middle: [f64; 3],
    normal: [f64; 3],
}

impl Plane {
    /// `None` where they lie on a line.
    fn of(balls: &[[f32; 4]]) -> Option<Self> {
        let count = balls.len() as f64;
        let middle: [f64; 3] =
            std::array::from_fn(|a| balls.iter().map(|b| f64::from(b[a])).sum::<f64>() / count);
        let mut matrix = [0.0; 9];
        for ball in balls {
            let from: [f64; 3] = std::array::from_fn(|a| f64::from(ball[a]) - middle[a]);
            (0..9).for_each(|i| matrix[i] += from[i / 3] * from[i % 3]);
        }
        let eigen = symmetric_eigen(&matrix, 3, 3);
        let is_plane = eigen.values[1] > 1e-6 * eigen.values[0];
        is_plane.then(|| Self { middle, normal: std::array::from_fn(|a| eigen.vectors[6 + a]) })
    }

    fn height(&self, p: &[f32; 3]) -> f64 {
        (0..3).map(|a| self.normal[a] * (f64::from(p[a]) - self.middle[a])).sum()
    }

    fn mirrored(&self, p: &[f32; 3], height: f64) -> [f32; 3] {
        self.next_to(p, 2.0 * height)
    }

    fn next_to(&self, p: &[f32; 3], height: f64) -> [f32; 3] {
        std::array::from_fn(|a| (f64::from(p[a]) - height * self.normal[a]) as f32)
    }
}

/// Balls that hang together, in the order of their first ones.
fn together(balls: &[[f32; 4]]) -> Vec<Vec<[f32; 4]>> {
    let usable = |b: &&[f32; 4]| b.iter().all(|v| v.is_finite()) && b[3] > 0.0;
    let balls: Vec<[f32; 4]> = balls.iter().filter(usable).copied().collect();
    let widest = balls.iter().map(|b| f64::from(b[3])).fold(0.0, f64::max);
    let cell = |b: &[f32; 4]| -> [i64; 3] {
        std::array::from_fn(|a| (f64::from(b[a]) / (NEXT * widest)).floor() as i64)
    };
    let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    balls.iter().enumerate().for_each(|(i, b)| cells.entry(cell(b)).or_default().push(i));
    let mut is_taken = vec![false; balls.len()];
    let mut out = Vec::new();
    for first in 0..balls.len() {
        if std::mem::replace(&mut is_taken[first], true) {
            continue;
        }
        let (mut pane, mut queue) = (Vec::new(), VecDeque::from([first]));
        while let Some(i) = queue.pop_front() {
            pane.push(balls[i]);
            let at = cell(&balls[i]);
            for step in 0..27i64 {
                let steps = [step / 9 - 1, step / 3 % 3 - 1, step % 3 - 1];
                let near: [i64; 3] = std::array::from_fn(|a| at[a].saturating_add(steps[a]));
                for &j in cells.get(&near).map_or(&[][..], Vec::as_slice) {
                    let apart: f64 =
                        (0..3).map(|a| f64::from(balls[i][a] - balls[j][a]).powi(2)).sum();
                    let reach = NEXT * f64::from(balls[i][3].max(balls[j][3]));
                    if !is_taken[j] && apart <= reach * reach {
                        is_taken[j] = true;
                        queue.push_back(j);
                    }
                }
            }
        }
        out.push(pane);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_datasets::effects::simulate;
    use scenesplat_rooms::{SyntheticRoomSettings, generate};

    #[test]
    fn glass_is_found_by_itself_and_an_earlier_decision_is_not_changed_by_a_trifle() {
        let clean = generate(&SyntheticRoomSettings::with_count(20_000, 1003)).unwrap().scene;
        let auto = EffectChoices::default();
        let none = glass_decision(&clean, &auto, None).unwrap();
        assert!(!none.on && none.regions.is_empty() && none.measure.is_some(), "{none:?}");
        let glass = simulate(&clean, &"glass=3".parse().unwrap(), 3).unwrap().scene;
        let found = glass_decision(&glass, &auto, None).unwrap();
        assert!(found.on && !found.regions.is_empty(), "{found:?}");
        let panes = panes_of(&glass, &found.regions);
        assert!(panes.is_sheet.iter().filter(|is| **is).count() > 10, "{found:?}");
        let off = glass_decision(&glass, &"glass=off".parse().unwrap(), None).unwrap();
        assert!(!off.on && off.measure.is_none(), "{off:?}");
        let refused = glass_decision(&glass, &"holes=on".parse().unwrap(), None);
        assert!(refused.unwrap_err().to_string().contains("acted on here: glass"));
        // A scene whose measure is just at the threshold stays what it was said to be.
        let at = |factor: f64, was: bool| {
            let before =
                PlanSection::new("lifting", vec![EffectDecision { on: was, ..found.clone() }]);
            let mut profile = profile_of(&glass, 1.0, &[Effect::Glass]);
            for evidence in &mut profile.effects {
                if let Some(measure) = &mut evidence.measure {
                    measure.value = factor * evidence.threshold;
                }
            }
            let section = decide(&[TWO_LAYERS], &auto, &profile, Some(&before)).unwrap();
            section.is_on(Effect::Glass)
        };
        assert_eq!([at(0.97, true), at(0.97, false)], [true, false]);
        assert_eq!([at(1.03, true), at(1.03, false)], [true, false]);
        assert_eq!([at(0.9, true), at(1.1, false)], [false, true]);
    }
    use scenesplat_scene::gaussian_scene::probability_to_logit;

    /// Balls of 10 cm around a square meter at x = 2, and a single one far away.
    fn balls() -> Vec<[f32; 4]> {
        let mut balls: Vec<[f32; 4]> =
            (0..36).map(|i| [2.0, 0.2 * (i % 6) as f32, 0.2 * (i / 6) as f32, 0.14]).collect();
        balls.insert(7, [9.0, 0.0, 0.0, 0.14]);
        balls.push([f32::NAN, 0.0, 0.0, 1.0]);
        balls
    }

    #[test]
    fn what_is_faint_is_glass_and_behind_it_doubtful() {
        // Much before the pane, some of it where a mirror would have it; in it: faint, solid; behind: faint, solid, faint but not behind the pane.
        let mut coord = vec![[1.5, 0.42, 0.42]; 20];
        coord.extend([
            [2.0, 0.42, 0.42],
            [2.02, 0.42, 0.42],
            [2.5, 0.42, 0.42],
            [2.5, 0.62, 0.42],
            [2.5, 5.0, 0.42],
        ]);
        let faint = [20, 22, 24];
        let opacity = |row| if faint.contains(&row) { 0.2 } else { 0.9 };
        let scene = GaussianScene {
            opacity_logit: (0..25).map(|row| probability_to_logit(opacity(row))).collect(),
            log_scale: vec![[-3.0; 3]; 25],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; 25],
            sh_dc: vec![[0.0; 3]; 25],
            coord,
            ..GaussianScene::default()
        };
        let found = panes_of(&scene, &balls());
        let rows = |is: &[bool]| (0..25).filter(|&row| is[row]).collect::<Vec<_>>();
        assert_eq!((rows(&found.is_sheet), rows(&found.is_doubtful)), (vec![20], vec![22]));
        assert_eq!(found.balls.iter().map(Vec::len).collect::<Vec<_>>(), [36, 1]);
        let none = panes_of(&scene, &[]);
        assert!(none.balls.is_empty() && rows(&none.is_sheet).is_empty());
        assert!(panes_of(&GaussianScene::default(), &balls()).is_sheet.is_empty());
    }
}
