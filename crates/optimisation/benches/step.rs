//! Parts of a training step at 640 × 480 on the Gaussians of a synthetic surface, on one and two threads, each
//! beside its floor: the same bytes read and written with nothing computed, or as many vector instructions
//! as the part cannot do without, at the rate of multiply–adds that never leave the registers. Both in the
//! same run, as machines differ and are shared.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, criterion_group, criterion_main};
use rayon::ThreadPool;
use rayon::prelude::*;
use scenesplat_kernels::simd::compiled;
use scenesplat_optimisation::depth_loss::{DepthOutliers, DepthScratch, depth_loss};
use scenesplat_optimisation::initial::{InitialSettings, from_points};
use scenesplat_optimisation::{
    Adam, AdamSettings, Colors, ImageComparison, Model, OptimiseSettings, Optimiser, Regularisers,
    SsimPadding, TrainingFrame,
};
use scenesplat_rasterizer::backward::{
    GradMask, Gradients, Trace, TraceRequest, Upstream, Workspace, trace,
};
use scenesplat_rasterizer::{
    Gaussians, Projected, RasterSettings, Span, TILE, TileLists, TileVisitor, View, blend, colors,
    project, tile_lists,
};
use std::hint::black_box;
use std::time::Duration;

/// As the program: the system's allocator would add page faults to every picture.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const ROWS: usize = 100_000;
const SIZE: [u32; 2] = [640, 480];

/// Points of a wavy wall that fills the picture.
fn model() -> Model {
    let side = (ROWS as f64).sqrt() as usize;
    let at = |i: usize| {
        let (x, y) = ((i % side) as f32 / side as f32, (i / side) as f32 / side as f32);
        [3.2 * x - 1.6, 2.4 * y - 1.2, 2.0 + 0.3 * (9.0 * x).sin() * (7.0 * y).cos()]
    };
    let points: Vec<[f32; 3]> = (0..ROWS).map(at).collect();
    let color = |p: &[f32; 3]| p.map(|v| 0.5 + 0.5 * (13.0 * v).sin());
    let colors: Vec<[f32; 3]> = points.iter().map(color).collect();
    let settings = InitialSettings { opacity: 0.5, scale: 1.0, sh_degree: 3, random_quats: true };
    from_points(&points, &colors, &settings, 1).expect("a wall")
}

fn frame() -> TrainingFrame {
    let [width, height] = SIZE;
    let view = View {
        world_to_camera: [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.]],
        fx: 400.0,
        fy: 400.0,
        cx: 320.0,
        cy: 240.0,
        width,
        height,
    };
    let pixels = view.pixels();
    let rgb = (0..3 * pixels).map(|i| (128.0 + 100.0 * (i as f32 * 0.01).sin()) as u8).collect();
    let depth = Some(vec![2.0; pixels]);
    TrainingFrame {
        name: "wall".into(),
        view,
        rgb: Colors::Bytes(rgb),
        alpha: None,
        depth,
        mask: None,
    }
}

/// What a part cannot do without.
#[derive(Clone, Copy)]
enum Floor {
    /// Bytes read or written; what is read and written counts twice.
    Bytes(usize),
    /// Instructions on eight values.
    Instructions(usize),
}

/// Independent sums: enough to hide the latency of a multiply–add on two units.
const SUMS: usize = 12;

impl Floor {
    /// Does that much, on all threads of the pool.
    fn run(self, memory: &mut [u64]) {
        let threads = rayon::current_num_threads();
        match self {
            Self::Bytes(bytes) => {
                let len = (bytes / 16).min(memory.len());
                memory[..len].par_chunks_mut(1 << 14).for_each(|part| {
                    for v in part {
                        *v = v.wrapping_add(1);
                    }
                });
            }
            Self::Instructions(count) => {
                let rounds = count / SUMS / threads;
                black_box(rayon::broadcast(|_| {
                    compiled(
                        #[inline(always)]
                        || {
                            let factor = black_box(0.5f32);
                            let mut sums = [[factor; 8]; SUMS];
                            for _ in 0..rounds {
                                for sum in sums.as_flattened_mut() {
                                    *sum = sum.mul_add(factor, factor);
                                }
                            }
                            sums.as_flattened().iter().sum::<f32>()
                        },
                    )
                }));
            }
        }
    }
}

/// Counts groups of eight pixels that are computed for a Gaussian.
struct Groups(usize);

impl TileVisitor for Groups {
    type Output = usize;
    #[inline(always)]
    fn span(&mut self, _: u32, _: u32, span: Span<'_>) {
        self.0 += span.weights.len() / 8;
    }
    fn finish(self, _: &[f32; TILE * TILE], _: &[u32; TILE * TILE]) -> usize {
        self.0
    }
}

/// Of each part, from counts of what is drawn.
struct Floors {
    project: Floor,
    colors: Floor,
    tiles: Floor,
    blend: Floor,
    ssim: Floor,
    backward: Floor,
    adam: Floor,
}

impl Floors {
    fn of(projected: &Projected, lists: &TileLists, view: &View, raster: &RasterSettings) -> Self {
        let groups: usize = blend(projected, lists, view, raster, |_| Groups(0)).into_iter().sum();
        let (visible, pairs) = (projected.len(), lists.entries.len());
        println!("{visible} visible, {pairs} places in lists, {groups} groups of 8 pixels");
        Self {
            // Center, quaternion, scale, opacity in; 56 bytes of what is visible out.
            project: Floor::Bytes(44 * ROWS + 56 * visible),
            // Sixteen coefficients of three channels and the center in, a color out.
            colors: Floor::Bytes((4 * 48 + 12 + 12) * visible),
            // Three passes over keys of 8 bytes; of each Gaussian 36 bytes in; each hit out, in, and out.
            tiles: Floor::Bytes((12 + 3 * 16 + 36) * visible + (8 + 8 + 5) * pairs),
            // Exponent 3, power of two 13, limits, tests and selections 14, four channels 4.
            blend: Floor::Instructions(34 * groups),
            // Eleven taps of two means and three products down (7 each), five maps across; back three
            // maps both ways; quotients and L1 about 36. Of eight values each.
            ssim: Floor::Instructions((77 + 55 + 66 + 36) * 3 * view.pixels() / 8),
            // As blending 24, then light 5, channels 8, what is behind 6, six moments 7.
            backward: Floor::Instructions(50 * groups),
            // Value, derivative and two moments, each in and out.
            adam: Floor::Bytes(59 * 32 * ROWS),
        }
    }
}

impl Floors {
    fn bench(
        &self,
        group: &mut BenchmarkGroup<'_, WallTime>,
        pool: &ThreadPool,
        memory: &mut [u64],
    ) {
        for (part, floor) in [
            ("project", self.project),
            ("colors_sh3", self.colors),
            ("sort_and_tiles", self.tiles),
            ("blend", self.blend),
            ("l1_ssim", self.ssim),
            ("backward", self.backward),
            ("adam_59", self.adam),
        ] {
            let threads = pool.current_num_threads();
            group.bench_function(format!("floor_of_{part}/{threads}_threads"), |b| {
                b.iter(|| pool.install(|| floor.run(memory)));
            });
        }
    }
}

/// The backward pass of color and depth, with gradients like those of L1.
fn bench_backward(
    group: &mut BenchmarkGroup<'_, WallTime>,
    pool: &ThreadPool,
    (g, view, raster): (&Gaussians, &View, &RasterSettings),
    (traced, rgb, drawn): (&Trace, &[f32], &[f32]),
    workspace: &mut Workspace,
) {
    let sign = |v: &f32| if *v > 0.3 { 1e-6 } else { -1e-6 };
    let (up_rgb, up_depth): (Vec<f32>, Vec<f32>) =
        (rgb.iter().map(sign).collect(), drawn.iter().map(sign).collect());
    let upstream =
        Upstream { rgb: Some(&up_rgb), depth_accumulated: Some(&up_depth), ..Upstream::default() };
    let (mut gradients, all) = (Gradients::zeros(g, 0), GradMask::all());
    let threads = pool.current_num_threads();
    group.bench_function(format!("backward/{threads}_threads"), |b| {
        b.iter(|| {
            let out = &mut gradients;
            pool.install(|| workspace.backward(g, view, raster, traced, &upstream, all, out))
        });
    });
}

/// The losses of a picture and of a depth map, with their slopes.
fn bench_losses(
    group: &mut BenchmarkGroup<'_, WallTime>,
    pool: &ThreadPool,
    (rgb, truth): (&[f32], &[f32]),
    (drawn, measured): (&[f32], &[f32]),
) {
    let threads = pool.current_num_threads();
    for padding in [SsimPadding::Reflect, SsimPadding::Valid] {
        let weights = scenesplat_optimisation::ImageWeights { ssim: 0.2, padding };
        let mut both = ImageComparison::new(640, 480, weights).expect("a size");
        let mut slope = vec![0.0; rgb.len()];
        group.bench_function(format!("l1_ssim_{padding}/{threads}_threads"), |b| {
            b.iter(|| pool.install(|| both.compare(rgb, truth, None, &mut slope)));
        });
    }
    let (mut scratch, mut slope) = (DepthScratch::default(), vec![0.0; drawn.len()]);
    group.bench_function(format!("depth_l1/{threads}_threads"), |b| {
        let rule = DepthOutliers::MedianRule;
        b.iter(|| depth_loss(drawn, measured, None, rule, 1.0, &mut scratch, &mut slope));
    });
}

/// The update of the values alone, and a whole step.
fn bench_steps(
    group: &mut BenchmarkGroup<'_, WallTime>,
    pool: &ThreadPool,
    model: &Model,
    frame: &TrainingFrame,
    settings: OptimiseSettings,
) {
    let threads = pool.current_num_threads();
    let (mut other, mut gradients) = (model.clone(), Gradients::zeros(model.gaussians(), 0));
    let mut adam = Adam::new(&other, AdamSettings::default());
    let rates = settings.rates_at(0, 1.0);
    group.bench_function(format!("adam_59/{threads}_threads"), |b| {
        b.iter(|| {
            let regularisers = Regularisers { opacity: 0.01, scale: 0.01 };
            pool.install(|| {
                adam.step(&mut other, &mut gradients, &rates, regularisers, 3);
            });
        });
    });
    let frames = [frame.clone()];
    let mut optimiser = Optimiser::new(model.clone(), &frames, settings).expect("a wall");
    group.bench_function(format!("step/{threads}_threads"), |b| {
        b.iter(|| pool.install(|| optimiser.step(&frames)));
    });
}

fn parts(c: &mut Criterion) {
    let (model, frame) = (model(), frame());
    let settings = OptimiseSettings { sh_every: 0, ..OptimiseSettings::scenesplat() };
    let (raster, view, g) = (settings.raster(), &frame.view, model.gaussians());
    let mut truth = Vec::new();
    frame.rgb.put(&mut truth);
    let request = TraceRequest { rgb: true, depth: true, sh_degree: Some(3) };
    let traced = trace(g, view, &raster, request).expect("a wall");
    let rgb = traced.picture.rgb.clone().unwrap_or_default();
    let drawn = traced.picture.depth_accumulated.clone().unwrap_or_default();
    let measured = frame.depth.clone().unwrap_or_default();
    let projected = project(g, view, &raster).expect("a wall");
    let floors = Floors::of(&projected, &tile_lists(&projected, view, &raster), view, &raster);
    let mut memory = vec![1u64; 1 << 24];
    let mut group = c.benchmark_group("optimise_100k_640x480");
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let name = |part: &str| format!("{part}/{threads}_threads");
        floors.bench(&mut group, &pool, &mut memory);
        group.bench_function(name("project"), |b| {
            b.iter(|| pool.install(|| project(g, view, &raster)));
        });
        group.bench_function(name("colors_sh3"), |b| {
            b.iter(|| pool.install(|| colors(g, view, &projected, 3)));
        });
        group.bench_function(name("sort_and_tiles"), |b| {
            b.iter(|| pool.install(|| tile_lists(&projected, view, &raster)));
        });
        let (mut workspace, mut again) = (Workspace::new(), Trace::default());
        group.bench_function(name("trace_rgb_depth"), |b| {
            b.iter(|| {
                let out = &mut again;
                pool.install(|| workspace.trace(g, view, &raster, request, out))
            });
        });
        bench_losses(&mut group, &pool, (&rgb, &truth), (&drawn, &measured));
        bench_backward(
            &mut group,
            &pool,
            (g, view, &raster),
            (&traced, &rgb, &drawn),
            &mut workspace,
        );
        bench_steps(&mut group, &pool, &model, &frame, settings);
    }
    group.finish();
}

fn criterion() -> Criterion {
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
}

criterion_group!(name = benches; config = criterion(); targets = parts);
criterion_main!(benches);
