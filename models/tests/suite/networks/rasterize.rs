//! The rasterizer as an operation: its gradients.

use crate::support::flat;
use candle_core::{DType, Device, Tensor, Var};
use scenesplat_models::ops::{DepthChannel, GaussianTensors, rasterize};
use scenesplat_rasterizer::backward::{GradMask, TraceRequest, Upstream, backward, trace};
use scenesplat_rasterizer::{Gaussians, RasterSettings, View};

const COUNT: usize = 40;
const SIZE: [usize; 2] = [40, 32];

/// A number in −1..1 that depends on the name alone.
fn noise(name: usize) -> f32 {
    let mut x = (name as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ x >> 31) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
}

fn view() -> View {
    View {
        world_to_camera: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0]],
        fx: 36.0,
        fy: 36.0,
        cx: 20.0,
        cy: 16.0,
        width: SIZE[0] as u32,
        height: SIZE[1] as u32,
    }
}

/// Stored parameters: logarithms of the scales, logits of the opacities.
struct Stored {
    means: Var,
    quats: Var,
    log_scales: Var,
    logits: Var,
    sh: Var,
}

impl Stored {
    fn new(seed: usize) -> Self {
        let var = |name: usize, shape: &[usize], f: fn(f32) -> f32| {
            let len: usize = shape.iter().product();
            let values: Vec<f32> = (0..len).map(|i| f(noise(seed + 10_000 * name + i))).collect();
            Var::from_vec(values, shape, &Device::Cpu).unwrap()
        };
        Self {
            means: var(0, &[COUNT, 3], |v| 1.4 * v),
            quats: var(1, &[COUNT, 4], |v| v),
            log_scales: var(2, &[COUNT, 3], |v| 0.4 * v - 1.4),
            logits: var(3, &[COUNT], |v| v),
            sh: var(4, &[COUNT, 4, 3], |v| 0.8 * v),
        }
    }

    fn activated(&self) -> GaussianTensors {
        let logits = self.logits.as_tensor();
        GaussianTensors {
            means: self.means.as_tensor().clone(),
            quats: self.quats.as_tensor().clone(),
            scales: self.log_scales.exp().unwrap(),
            opacities: (logits.neg().unwrap().exp().unwrap() + 1.0).unwrap().recip().unwrap(),
            sh: self.sh.as_tensor().clone(),
        }
    }
}

fn rows<const N: usize>(t: &Tensor) -> Vec<[f32; N]> {
    flat(t).as_chunks::<N>().0.to_vec()
}

fn gaussians(t: &GaussianTensors) -> Gaussians {
    Gaussians {
        means: rows(&t.means),
        quats: rows(&t.quats),
        scales: rows(&t.scales),
        opacities: flat(&t.opacities),
        sh: flat(&t.sh),
        sh_degree: 1,
    }
}

/// The operation gives what the crate gives, in every channel and for every parameter.
#[test]
fn gradients_are_the_crate_s() {
    let settings =
        RasterSettings { background: Some([0.2, 0.4, 0.1]), ..RasterSettings::default() };
    for depth in [DepthChannel::None, DepthChannel::Accumulated, DepthChannel::Expected] {
        let stored = Stored::new(1);
        let tensors = stored.activated();
        let out = rasterize(&tensors, &view(), &settings, depth).unwrap();
        let channels = if depth == DepthChannel::None { 4 } else { 5 };
        assert_eq!(out.dims(), [SIZE[1], SIZE[0], channels]);
        let up: Vec<f32> = (0..out.elem_count()).map(|i| noise(500_000 + i)).collect();
        let noise = Tensor::from_vec(up.clone(), out.dims(), &Device::Cpu).unwrap();
        let grads = (&out * noise).unwrap().sum_all().unwrap().backward().unwrap();

        let scene = gaussians(&tensors);
        let traced = trace(&scene, &view(), &settings, TraceRequest::rgb_depth()).unwrap();
        let plane =
            |k: usize| -> Vec<f32> { up.iter().skip(k).step_by(channels).copied().collect() };
        let rgb: Vec<f32> = up.chunks(channels).flat_map(|p| p[..3].to_vec()).collect();
        let (alpha, more) = (plane(3), plane(4.min(channels - 1)));
        let upstream = Upstream {
            rgb: Some(&rgb),
            alpha: Some(&alpha),
            depth_accumulated: (depth == DepthChannel::Accumulated).then_some(&more),
            depth_expected: (depth == DepthChannel::Expected).then_some(&more),
            features: None,
        };
        let want =
            backward(&scene, &view(), &settings, &traced, &upstream, GradMask::all()).unwrap();
        let got = |var: &Var| flat(grads.get(var).unwrap());
        assert_eq!(got(&stored.means), want.means.as_flattened());
        assert_eq!(got(&stored.quats), want.quats.as_flattened());
        assert_eq!(got(&stored.sh), want.sh);
        // ∂/∂log s = s ∂/∂s, ∂/∂logit = o (1 − o) ∂/∂o
        let close = |got: Vec<f32>, want: Vec<f32>| {
            let most = want.iter().fold(0.0f32, |m, v| m.max(v.abs()));
            for (g, w) in got.iter().zip(&want) {
                assert!((g - w).abs() <= 1e-5 * most, "{g} {w}");
            }
        };
        let scales = want.scales.as_flattened().iter().zip(scene.scales.as_flattened());
        close(got(&stored.log_scales), scales.map(|(g, s)| g * s).collect());
        let opacities = want.opacities.iter().zip(&scene.opacities);
        close(got(&stored.logits), opacities.map(|(g, o)| g * o * (1.0 - o)).collect());
    }
}

/// Only inputs that require a gradient get one.
#[test]
fn frozen_groups_stay_out() {
    let stored = Stored::new(3);
    let mut tensors = stored.activated();
    tensors.means = tensors.means.detach();
    tensors.quats = tensors.quats.detach();
    tensors.scales = tensors.scales.detach();
    tensors.opacities = tensors.opacities.detach();
    let settings = RasterSettings::default();
    let out = rasterize(&tensors, &view(), &settings, DepthChannel::None).unwrap();
    let grads = out.sum_all().unwrap().backward().unwrap();
    assert!(grads.get(&stored.means).is_none());
    let all = rasterize(&stored.activated(), &view(), &settings, DepthChannel::None).unwrap();
    let all = all.sum_all().unwrap().backward().unwrap();
    assert_eq!(flat(grads.get(&stored.sh).unwrap()), flat(all.get(&stored.sh).unwrap()));
}

#[test]
fn bad_input_is_named() {
    let stored = Stored::new(9);
    let settings = RasterSettings::default();
    let error = |tensors: &GaussianTensors| {
        rasterize(tensors, &view(), &settings, DepthChannel::None).unwrap_err().to_string()
    };
    let good = stored.activated();
    let short = good.means.narrow(0, 0, 7).unwrap();
    let text = error(&GaussianTensors { means: short, ..good.clone() });
    assert!(text.contains("rasterize: means: expected [40, 3], got [7, 3]"), "{text}");
    let wide = good.scales.to_dtype(DType::F64).unwrap();
    let text = error(&GaussianTensors { scales: wide, ..good.clone() });
    assert!(text.contains("scales: expected f32, got F64"), "{text}");
    let odd = Tensor::zeros((COUNT, 5, 3), DType::F32, &Device::Cpu).unwrap();
    let text = error(&GaussianTensors { sh: odd, ..good.clone() });
    assert!(text.contains("sh: expected [N, 1 | 4 | 9 | 16, 3], got [40, 5, 3]"), "{text}");
    let far = View { width: 0, ..view() };
    let error = rasterize(&good, &far, &settings, DepthChannel::None).unwrap_err();
    assert!(error.to_string().contains("0 × 32 pixels"), "{error}");
    // A loss that is not finite stops at its pixel instead of spreading over the scene.
    let out = rasterize(&good, &view(), &settings, DepthChannel::None).unwrap();
    let error = out.affine(f64::NAN, 0.0).unwrap().sum_all().unwrap().backward().unwrap_err();
    let text = error.to_string();
    assert!(text.contains("upstream gradient of rgb at pixel (0, 0)"), "{text}");
}
