//! Scenes, cameras and golden files that several modules use.

pub mod reference;
mod scenes;

pub use scenes::{join, noise, one, permute, pinhole, random, view};

use scenesplat_rasterizer::backward::Gradients;
use scenesplat_rasterizer::{DepthRequest, Gaussians, RenderRequest, View};
use scenesplat_test_support::Golden;

/// A golden file of Gaussians and cameras.
pub struct Scene {
    pub golden: Golden,
    pub gaussians: Gaussians,
    pub views: Vec<View>,
}

impl Scene {
    /// A file of `goldens/raster`, for pictures of `[height, width]`.
    fn open(name: &str, [height, width]: [u32; 2]) -> Option<Self> {
        let golden = Golden::raster(name)?;
        let (poses, lenses) = (golden.rows::<16>("viewmats"), golden.rows::<9>("Ks"));
        let view = |(pose, k): (&[f32; 16], &[f32; 9])| {
            let row = |r: usize| [0, 1, 2, 3].map(|c| pose[4 * r + c]);
            let world_to_camera = [row(0), row(1), row(2)];
            View { world_to_camera, fx: k[0], fy: k[4], cx: k[2], cy: k[5], width, height }
        };
        let views = poses.iter().zip(&lenses).map(view).collect();
        Some(Self { gaussians: gaussians(&golden), golden, views })
    }

    /// The synthetic scene.
    pub fn synthetic() -> Option<Self> {
        Self::open("scene", [64, 96])
    }

    /// The same with hostile Gaussians after its own.
    pub fn hazards() -> Option<Self> {
        let clean = Self::synthetic()?;
        let gaussians = gaussians(&Golden::raster("hazards")?);
        Some(Self { gaussians, ..clean })
    }

    pub fn garden() -> Option<Self> {
        Self::open("garden", [70, 108])
    }
}

fn gaussians(golden: &Golden) -> Gaussians {
    Gaussians {
        means: golden.rows("means"),
        quats: golden.rows("quats"),
        scales: golden.rows("scales"),
        opacities: golden.f32s("opacities"),
        sh: golden.f32s("sh"),
        sh_degree: 3,
    }
}

/// A render of everything there is.
pub fn everything() -> RenderRequest {
    RenderRequest {
        rgb: true,
        depth: DepthRequest { accumulated: true, expected: true, median: true },
        contributions: true,
        last: true,
        sh_degree: None,
    }
}

/// Gradients by group, each flattened.
pub fn groups(g: &Gradients) -> [(&'static str, &[f32]); 6] {
    [
        ("means", g.means.as_flattened()),
        ("quats", g.quats.as_flattened()),
        ("scales", g.scales.as_flattened()),
        ("opacities", &g.opacities),
        ("sh", &g.sh),
        ("features", &g.features),
    ]
}

/// Runs on a pool of so many threads.
pub fn on_threads<T: Send>(threads: usize, run: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(run)
}
