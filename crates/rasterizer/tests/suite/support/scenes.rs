//! Small scenes and a camera for them.

use scenesplat_rasterizer::{Gaussians, View};

/// Looks along +z from the origin; the principal point is not in the middle.
pub fn view(width: u32, height: u32) -> View {
    let (cx, cy) = (0.52 * width as f32, 0.47 * height as f32);
    View { fy: 50.0, cx, cy, ..pinhole([width, height], 60.0, 0.0) }
}

/// Looks along +z at the middle of a picture, from `back` behind the origin.
pub fn pinhole([width, height]: [u32; 2], focal: f32, back: f32) -> View {
    View {
        world_to_camera: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, back]],
        fx: focal,
        fy: focal,
        cx: width as f32 / 2.0,
        cy: height as f32 / 2.0,
        width,
        height,
    }
}

const GAMMA: u64 = 0x9e37_79b9_7f4a_7c15;

/// A generator that is the same everywhere.
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(GAMMA);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// −1..1.
    fn float(&mut self) -> f32 {
        (self.next() >> 40) as f32 / 8_388_608.0 - 1.0
    }
}

/// A number in −1..1 that depends on its name alone.
pub fn noise(name: usize) -> f64 {
    (SplitMix((name as u64).wrapping_mul(GAMMA)).next() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Gaussians of all kinds in front of the camera, some beside and behind it; some depths are equal.
pub fn random(rows: usize, seed: u64) -> Gaussians {
    let mut rng = SplitMix(seed);
    let mut scene = Gaussians { sh_degree: 2, ..Gaussians::default() };
    for _ in 0..rows {
        let depth =
            [0.0, 0.25 * (rng.float() * 6.0).round(), rng.float()][(rng.next() % 3) as usize];
        scene.means.push([rng.float() * 2.0, rng.float() * 2.0, 2.5 + 2.6 * depth]);
        scene.quats.push([(); 4].map(|()| rng.float()));
        scene.scales.push([(); 3].map(|()| (2.0 * rng.float() - 3.0).exp()));
        scene.opacities.push(0.5 + 0.5 * rng.float());
        for _ in 0..27 {
            scene.sh.push(0.3 * rng.float());
        }
    }
    scene
}

/// One Gaussian, gray of the given DC coefficient.
pub fn one(mean: [f32; 3], scale: f32, opacity: f32) -> Gaussians {
    Gaussians {
        means: vec![mean],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        scales: vec![[scale; 3]],
        opacities: vec![opacity],
        sh: vec![1.0; 3],
        sh_degree: 0,
    }
}

/// The rows of both; degrees have to be the same.
pub fn join(mut a: Gaussians, b: &Gaussians) -> Gaussians {
    assert_eq!(a.sh_degree, b.sh_degree);
    a.means.extend(&b.means);
    a.quats.extend(&b.quats);
    a.scales.extend(&b.scales);
    a.opacities.extend(&b.opacities);
    a.sh.extend(&b.sh);
    a
}

/// The rows in another order.
pub fn permute(scene: &Gaussians, order: &[usize]) -> Gaussians {
    let stride = 3 * scene.sh_len();
    Gaussians {
        means: order.iter().map(|&i| scene.means[i]).collect(),
        quats: order.iter().map(|&i| scene.quats[i]).collect(),
        scales: order.iter().map(|&i| scene.scales[i]).collect(),
        opacities: order.iter().map(|&i| scene.opacities[i]).collect(),
        sh: order.iter().flat_map(|&i| scene.sh[stride * i..stride * (i + 1)].to_vec()).collect(),
        sh_degree: scene.sh_degree,
    }
}
