//! Joined segments by hand, and by a slow version in f64.

use super::*;
use crate::surface::Surface;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[test]
fn a_crease_is_the_step_and_the_turn_from_three_pixels_away() {
    // A row of eight of depth 2, 0.1 apart; what looks left turns by (0.6, 0, 0.2) in the middle.
    let points: Vec<Vec3> = (0..8).map(|i| Vec3::new(0.1 * i as f32, 0.0, 2.0)).collect();
    let normals = |turned: usize| -> Vec<Vec3> {
        let tilted = Vec3::new(0.6, 0.0, -0.8);
        (0..8).map(|i| if i < turned { Vec3::NEG_Z } else { tilted }).collect()
    };
    let of = |points: &[Vec3], normals: Vec<Vec3>, p, q| {
        let surface = Surface { points: points.to_vec(), normals };
        crease(&Pixels { width: 8, height: 1, lab: vec![Vec3::ZERO; 8], surface }, p, q)
    };
    let near = |found: f32, want: f32| assert!((found - want).abs() < 2e-3, "{found} {want}");
    near(of(&points, normals(8), 3, 4), 0.0);
    // From 3 on the one side three pixels on is 0, on the other 7: 0.4 / 0.16, with no step, as one normal sees none.
    near(of(&points, normals(4), 3, 4), 2.5);
    near(of(&points, normals(4), 4, 3), 2.5);
    // A turn two pixels to the right is seen, three pixels to the right, too; four are behind.
    near(of(&points, normals(7), 3, 4), 2.5);
    near(of(&points, normals(7), 2, 3), 0.0);
    // The step of one in both normals: 0.02 of the depth is 1, and 0.1 and more is 25.
    let step = |by: f32| -> Vec<Vec3> {
        points
            .iter()
            .enumerate()
            .map(|(i, p)| *p + if i > 3 { by * Vec3::Z } else { Vec3::ZERO })
            .collect()
    };
    near(of(&step(0.04), normals(8), 3, 4), 1.0);
    near(of(&step(-0.02), normals(8), 3, 4), (0.02f32 / 1.98 / 0.02).powi(2));
    near(of(&step(1.0), normals(8), 3, 4), 25.0);
    // Across a jump of more than 5 % of the depth there is another surface: the normal beside the border counts.
    let tilted_end = normals(7);
    near(of(&step(0.2), tilted_end.clone(), 3, 4), 25.0 + 2.5);
    let mut far = step(0.0);
    far[7].z = 2.11;
    near(of(&far, tilted_end.clone(), 3, 4), 0.0);
    far[7].z = 2.09;
    near(of(&far, tilted_end, 3, 4), 2.5);
    // Depth that is known of one alone counts 1, of none 0.
    let mut holes = points.clone();
    holes[4] = Vec3::ZERO;
    near(of(&holes, normals(8), 3, 4), 1.0);
    near(of(&holes, normals(8), 4, 3), 1.0);
    holes[3] = Vec3::ZERO;
    near(of(&holes, normals(8), 3, 4), 0.0);
}

#[test]
fn edges_are_between_neighbors_in_both_directions() {
    // Three parts in three rows of two: 0 0 / 1 0 / 1 2.
    let parts = [0, 0, 1, 0, 1, 2];
    let lightness = [0.0, 6.0, 20.0, 9.0, 30.0, 2.0];
    let mut surface = Surface::unknown(6);
    // Depth in pixel 1 alone: part 0 has borders of 1 and 0.
    (surface.points[1], surface.normals[1]) = (Vec3::Z, Vec3::NEG_Z);
    let lab = lightness.map(|l| Vec3::new(l, 0.0, 0.0)).to_vec();
    let all = Pixels { width: 2, height: 3, lab, surface };
    let found: Vec<_> = edges(&all, &parts, 3).iter().map(|e| ((e.a, e.b), e.difference)).collect();
    // Means 5, 25 and 2. Parts 0 and 1 differ by 20 of 10; all of their borders are without depth.
    let want = [((0, 1), 2.0), ((0, 2), 0.3), ((1, 2), 2.3)];
    assert_eq!(found.len(), 3);
    for (found, want) in found.iter().zip(want) {
        assert!(found.0 == want.0 && (found.1 - want.1).abs() < 1e-5, "{found:?} {want:?}");
    }
    // With depth in pixel 2 the border of 0 and 1 is 1 in two of its two places, then: √(4 + 1).
    let mut all = all;
    (all.surface.points[2], all.surface.points[1]) = (Vec3::Z, Vec3::ZERO);
    let found = edges(&all, &parts, 3)[0].difference;
    assert!((found - 5.0f32.sqrt()).abs() < 1e-5, "{found}");
}

/// Felzenszwalb and Huttenlocher on parts: by lists of sets that are written anew at each step.
fn slow(all: &Pixels, clusters: &[u32], limit: f64, smallest: usize) -> Vec<usize> {
    let (w, count) = (all.width, clusters.len());
    let beside =
        |p: usize, q: usize| p + w == q || q + w == p || (p / w == q / w && p.abs_diff(q) == 1);
    // Each pixel takes the least number of its connected cluster, until none changes; these are numbered in order.
    let mut least: Vec<usize> = (0..count).collect();
    loop {
        let before = least.clone();
        for (p, q) in (0..count).flat_map(|p| (0..count).map(move |q| (p, q))) {
            if beside(p, q) && clusters[p] == clusters[q] {
                least[p] = least[p].min(least[q]);
            }
        }
        if least == before {
            break;
        }
    }
    let mut first: Vec<usize> = least.clone();
    first.sort_unstable();
    first.dedup();
    let parts: Vec<usize> = least.iter().map(|l| first.binary_search(l).unwrap()).collect();
    let of = |part: usize| (0..count).filter(|p| parts[*p] == part).collect::<Vec<usize>>();
    let mean = |part: usize| {
        of(part).iter().map(|p| all.lab[*p].as_dvec3()).sum::<DVec3>() / of(part).len() as f64
    };
    let mut edges = Vec::new();
    for (a, b) in (0..first.len()).flat_map(|a| (a + 1..first.len()).map(move |b| (a, b))) {
        let (in_a, in_b) = (of(a), of(b));
        let pairs = in_a.iter().flat_map(|p| in_b.iter().map(move |q| (*p, *q)));
        let borders: Vec<f64> = pairs
            .filter(|(p, q)| beside(*p, *q))
            .map(|(p, q)| f64::from(crease(all, p.min(q), p.max(q))))
            .collect();
        if !borders.is_empty() {
            let surface = borders.iter().sum::<f64>() / borders.len() as f64;
            edges.push(((mean(a).distance_squared(mean(b)) / 100.0 + surface).sqrt(), a, b));
        }
    }
    edges.sort_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    // The set of each part, and the largest difference that was joined inside of each.
    let mut set: Vec<usize> = (0..first.len()).collect();
    let mut inner = vec![0.0f64; first.len()];
    for pass in 0..2 {
        for &(difference, a, b) in &edges {
            let (s, t) = (set[a], set[b]);
            let members = |s: usize| set.iter().filter(|v| **v == s).count() as f64;
            let pixels = |s: usize| parts.iter().filter(|p| set[**p] == s).count();
            let bound = |s: usize| (inner[s] + limit / members(s)).max(limit / 2.0);
            let joins = match pass {
                0 => limit > 0.0 && difference <= bound(s) && difference <= bound(t),
                _ => pixels(s) < smallest || pixels(t) < smallest,
            };
            if s != t && joins {
                inner[s] = inner[s].max(inner[t]).max(difference);
                set.iter_mut().filter(|v| **v == t).for_each(|v| *v = s);
            }
        }
    }
    let mut seen = Vec::new();
    let number = |p: &usize| {
        let own = set[*p];
        seen.iter().position(|s| *s == own).unwrap_or_else(|| {
            seen.push(own);
            seen.len() - 1
        })
    };
    parts.iter().map(number).collect()
}

#[test]
fn segments_are_those_of_the_slow_version() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut counts = Vec::new();
    for (width, height, limit, smallest) in
        [(11, 8, 0.0, 0), (8, 11, 0.5, 0), (11, 8, 1.0, 5), (9, 9, 0.3, 9), (10, 7, 0.0, 4)]
    {
        let count = width * height;
        let mut draw = |from: f32, to: f32| rng.random_range(from..to);
        let mut surface = Surface::unknown(count);
        let mut lab = Vec::new();
        for at in 0..count {
            lab.push(Vec3::new(draw(40.0, 52.0), draw(-4.0, 4.0), draw(-4.0, 4.0)));
            if draw(0.0, 1.0) < 0.8 {
                surface.points[at] = Vec3::new(at as f32 * 0.01, 0.0, draw(2.0, 2.03));
                surface.normals[at] = Vec3::new(draw(-0.1, 0.1), draw(-0.1, 0.1), -1.0).normalize();
            }
        }
        let clusters: Vec<u32> = (0..count)
            .map(|at| (at % width / 3 + 4 * (at / width / 3)) as u32 + (draw(0.0, 1.15) as u32))
            .collect();
        let all = Pixels { width, height, lab, surface };
        let found = merge(&all, &clusters, Similarity { limit, smallest });
        let found: Vec<usize> = found.iter().map(|id| *id as usize).collect();
        assert_eq!(
            found,
            slow(&all, &clusters, f64::from(limit), smallest as usize),
            "{limit} {smallest}"
        );
        counts.push(found.iter().max().unwrap() + 1);
    }
    println!("{counts:?}");
    assert!(counts.iter().all(|c| *c > 1), "{counts:?}");
}
