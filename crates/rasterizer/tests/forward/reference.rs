//! The obvious renderer: f64, every Gaussian at every pixel, the covariance by the book.

use crate::scenes::{random, view};
use scenesplat_rasterizer::*;

pub struct Picture {
    pub rgb: Vec<f64>,
    pub transmittance: Vec<f64>,
    pub depth: Vec<f64>,
    /// Whether a decision of the pixel is within float noise.
    pub doubtful: Vec<bool>,
}

struct Splat {
    z: f64,
    mean: [f64; 2],
    conic: [f64; 3],
    opacity: f64,
    color: [f64; 3],
}

type M3 = [[f64; 3]; 3];

fn product(a: &M3, b: &M3) -> M3 {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

fn transposed(a: &M3) -> M3 {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

fn splat(g: &Gaussians, i: usize, view: &View, settings: &RasterSettings) -> Option<Splat> {
    let pose = view.world_to_camera.map(|row| row.map(f64::from));
    let (m, s) = (g.means[i].map(f64::from), g.scales[i].map(f64::from));
    let p: [f64; 3] =
        std::array::from_fn(|r| (0..3).map(|k| pose[r][k] * m[k]).sum::<f64>() + pose[r][3]);
    let q = g.quats[i].map(f64::from);
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let finite = p.iter().chain(&s).chain(&q).all(|v| v.is_finite());
    if !finite || norm < 1e-6 || p[2] < f64::from(settings.near) {
        return None;
    }
    let [w, x, y, z] = q.map(|v| v / norm);
    let turn = [
        [1. - 2. * (y * y + z * z), 2. * (x * y - w * z), 2. * (x * z + w * y)],
        [2. * (x * y + w * z), 1. - 2. * (x * x + z * z), 2. * (y * z - w * x)],
        [2. * (x * z - w * y), 2. * (y * z + w * x), 1. - 2. * (x * x + y * y)],
    ];
    let sized: M3 = std::array::from_fn(|a| std::array::from_fn(|b| turn[a][b] * s[b]));
    let world = product(&sized, &transposed(&sized));
    let rotation: M3 = std::array::from_fn(|a| std::array::from_fn(|b| pose[a][b]));
    let camera = product(&product(&rotation, &world), &transposed(&rotation));
    let (fx, fy) = (f64::from(view.fx), f64::from(view.fy));
    let (cx, cy) = (f64::from(view.cx), f64::from(view.cy));
    let limit = |t: f64, f: f64, c: f64, size: u32| {
        let size = f64::from(size);
        t.clamp(-(c / f + 0.15 * size / f), (size - c) / f + 0.15 * size / f)
    };
    let tx = limit(p[0] / p[2], fx, cx, view.width);
    let ty = limit(p[1] / p[2], fy, cy, view.height);
    let j = [[fx / p[2], 0., -fx * tx / p[2]], [0., fy / p[2], -fy * ty / p[2]], [0.; 3]];
    let flat = product(&product(&j, &camera), &transposed(&j));
    let eps = f64::from(settings.eps2d);
    let (a, b, c) = (flat[0][0] + eps, flat[0][1], flat[1][1] + eps);
    let det = a * c - b * b;
    let sharp = flat[0][0] * flat[1][1] - b * b;
    let factor = (sharp / det).max(f64::from(settings.antialias_floor).powi(2)).sqrt();
    let factor = if settings.antialiased { factor } else { 1.0 };
    let opacity = f64::from(g.opacities[i]).min(1.0) * factor;
    let to = view.centre();
    let basis = spherical_harmonics::basis::<16>(std::array::from_fn(|k| g.means[i][k] - to[k]));
    let bands = g.sh_len();
    let color = std::array::from_fn(|ch| {
        let sum: f64 = (0..bands)
            .map(|k| f64::from(basis[k]) * f64::from(g.sh[3 * (bands * i + k) + ch]))
            .sum();
        (0.5 + sum).max(0.0)
    });
    Some(Splat {
        z: p[2],
        mean: [fx * p[0] / p[2] + cx, fy * p[1] / p[2] + cy],
        conic: [c / det, -b / det, a / det],
        opacity,
        color,
    })
}

pub fn picture(g: &Gaussians, view: &View, settings: &RasterSettings) -> Picture {
    let mut splats: Vec<Splat> = (0..g.len()).filter_map(|i| splat(g, i, view, settings)).collect();
    // As f32, so that depths that are equal there keep their order.
    splats.sort_by(|a, b| (a.z as f32).total_cmp(&(b.z as f32)));
    let pixels = view.pixels();
    let mut out = Picture {
        rgb: vec![0.0; 3 * pixels],
        transmittance: vec![1.0; pixels],
        depth: vec![0.0; pixels],
        doubtful: vec![false; pixels],
    };
    let (cut, stop) = (f64::from(settings.alpha_cut), f64::from(settings.stop));
    for i in 0..pixels {
        let x = (i % view.width as usize) as f64 + 0.5;
        let y = (i / view.width as usize) as f64 + 0.5;
        let mut t = 1.0;
        for s in &splats {
            let (dx, dy) = (s.mean[0] - x, s.mean[1] - y);
            let [a, b, c] = s.conic;
            let sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy;
            let full = s.opacity * (-sigma).exp();
            out.doubtful[i] |= (full / cut - 1.0).abs() < 2e-3;
            if full < cut {
                continue;
            }
            let alpha = full.min(f64::from(settings.alpha_max));
            let after = t * (1.0 - alpha);
            out.doubtful[i] |= (after / stop - 1.0).abs() < 2e-3;
            if after <= stop {
                break;
            }
            for k in 0..3 {
                out.rgb[3 * i + k] += alpha * t * s.color[k];
            }
            out.depth[i] += alpha * t * s.z;
            t = after;
        }
        out.transmittance[i] = t;
        let background = settings.background.unwrap_or_default();
        for k in 0..3 {
            out.rgb[3 * i + k] += t * f64::from(background[k]);
        }
    }
    out
}

/// Compares a render with the reference outside doubtful pixels.
pub fn compare(g: &Gaussians, view: &View, settings: &RasterSettings) {
    let depth = DepthRequest { accumulated: true, ..DepthRequest::default() };
    let request = RenderRequest { depth, ..RenderRequest::rgb() };
    let got = render(g, view, settings, &request).unwrap();
    let expected = picture(g, view, settings);
    let (rgb, depth) = (got.rgb.unwrap(), got.depth_accumulated.unwrap());
    let mut doubtful = 0;
    for i in 0..view.pixels() {
        if expected.doubtful[i] {
            doubtful += 1;
            continue;
        }
        for k in 0..3 {
            let (a, b) = (f64::from(rgb[3 * i + k]), expected.rgb[3 * i + k]);
            assert!((a - b).abs() < 3e-5, "rgb {k} of pixel {i}: {a}, not {b}");
        }
        let t = f64::from(got.transmittance[i]) - expected.transmittance[i];
        assert!(t.abs() < 3e-5, "transmittance of pixel {i} off by {t}");
        let z = f64::from(depth[i]) - expected.depth[i];
        assert!(z.abs() < 2e-4, "depth of pixel {i} off by {z}");
    }
    assert!(10 * doubtful <= 2 * view.pixels() + 20, "{doubtful} pixels are not compared");
}

#[test]
fn random_scenes() {
    for (rows, seed) in [(0, 1), (1, 2), (2, 3), (30, 4), (200, 5)] {
        let scene = random(rows, seed);
        for (width, height) in [(1, 1), (16, 16), (17, 33), (50, 40)] {
            let settings = RasterSettings::default();
            compare(&scene, &view(width, height), &settings);
            let antialiased = RasterSettings { antialiased: true, ..settings };
            compare(&scene, &view(width, height), &antialiased);
        }
    }
}
