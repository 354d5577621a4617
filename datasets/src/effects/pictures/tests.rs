use super::*;
use crate::effects::strength::GLASS_ALPHA;
use scenesplat_scene::Distortion;
use std::cell::Cell;

/// 64 × 48, f = 100, at the origin, along +z.
pub(super) fn camera() -> Camera {
    Camera {
        name: String::new(),
        width: 64,
        height: 48,
        fx: 100.0,
        fy: 100.0,
        cx: 20.0,
        cy: 24.0,
        distortion: Distortion::None,
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
    }
}

/// A wall at z = 4 with stripes across x, drawn exactly at the centers of pixels.
#[derive(Default)]
struct Stripes {
    drawn: Cell<usize>,
    without_depth: bool,
}

impl Stripes {
    fn value(x: f64) -> f32 {
        (0.5 + 0.4 * (8.0 * x).sin()) as f32
    }
}

impl PictureRenderer for Stripes {
    type Error = std::convert::Infallible;

    fn draw(&self, camera: &Camera, part: Option<&HalfSpace>) -> Result<DrawnPicture, Self::Error> {
        self.drawn.set(self.drawn.get() + 1);
        let (mut rgb, mut depth) = (Vec::new(), Vec::new());
        let (eye, r) = (camera.centre(), camera.rotation);
        for at in 0..camera.width * camera.height {
            let x = (f64::from(at % camera.width) + 0.5 - camera.cx) / camera.fx;
            let y = (f64::from(at / camera.width) + 0.5 - camera.cy) / camera.fy;
            let ray: [f64; 3] = std::array::from_fn(|i| r[0][i] * x + r[1][i] * y + r[2][i]);
            let z = (4.0 - eye[2]) / ray[2];
            let point = std::array::from_fn(|i| eye[i] + z * ray[i]);
            let there = z > 0.0 && part.is_none_or(|part| part.contains(point));
            let value = if there { Self::value(point[0]) } else { 0.3 };
            rgb.extend([value, 0.5 * value, 0.2]);
            depth.push(if there { z as f32 } else { 0.0 });
        }
        Ok(DrawnPicture { rgb, depth: (!self.without_depth).then_some(depth) })
    }
}

fn pane() -> Pane {
    Pane {
        normal: [0.0, 0.0, -1.0],
        across: [1.0, 0.0, 0.0],
        up: [0.0, -1.0, 0.0],
        centre: [0.5, 0.0, 3.0],
        half: [0.6, 0.4],
        alpha: GLASS_ALPHA,
        tint: [0.92, 1.0, 0.96],
        thickness: 0.02,
    }
}

fn take(text: &str, seed: u64, frames: std::ops::Range<u64>) -> Vec<(DrawnPicture, PictureReport)> {
    let set: EffectSet = text.parse().unwrap();
    let mut simulator = PictureSimulator::new(&set, seed, Some(pane()), 0.01).unwrap();
    frames.map(|k| simulator.take(&Stripes::default(), k, &camera()).unwrap()).collect()
}

fn far(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / a.len() as f64
}

#[test]
fn nothing_is_the_render_itself_and_one_render() {
    let plain = Stripes::default().draw(&camera(), None).unwrap();
    for text in ["none", "blur=0,glass=0,light=0,noise=0"] {
        let set: EffectSet = text.parse().unwrap();
        let mut simulator = PictureSimulator::new(&set, 1, Some(pane()), 0.0).unwrap();
        assert!(!simulator.needs_depth());
        let stripes = Stripes { without_depth: true, ..Stripes::default() };
        let (picture, report) = simulator.take(&stripes, 3, &camera()).unwrap();
        assert!(picture.rgb == plain.rgb && stripes.drawn.get() == 1);
        assert_eq!((report.renders, report.poses, report.gain), (1, 1, [1.0; 3]));
    }
}

#[test]
fn each_effect_goes_to_the_identity_and_grows_with_severity() {
    let plain = Stripes::default().draw(&camera(), None).unwrap();
    for name in ["blur", "light", "noise"] {
        let differs = |severity: f64| {
            let all = take(&format!("{name}={severity}"), 2, 0..20);
            all.iter().map(|(picture, _)| far(&picture.rgb, &plain.rgb)).sum::<f64>() / 20.0
        };
        assert!(differs(1e-7) < 1e-6, "{name}: {}", differs(1e-7));
        let curve: Vec<f64> = [0.5, 1.0, 2.0, 3.0, 4.0, 5.0].map(differs).to_vec();
        // Motions below a pixel are none.
        assert!(curve.is_sorted() && curve[5] > 2.0 * curve[2], "{name}: {curve:?}");
        assert!(curve[2] > 5e-5, "{name}: {curve:?}");
    }
}

#[test]
fn a_blurred_picture_is_the_mean_of_its_poses_in_linear_light() {
    let set: EffectSet = "blur=5".parse().unwrap();
    let mut simulator = PictureSimulator::new(&set, 4, None, 0.0).unwrap();
    let frame = (0..99).find(|&k| {
        (3.0..5.0).contains(&blur_pixels(&camera(), &simulator.motion(k), BLUR_DISTANCE))
    });
    let frame = frame.unwrap();
    let stripes = Stripes::default();
    let (picture, report) = simulator.take(&stripes, frame, &camera()).unwrap();
    let count = report.blur_pixels.ceil() as usize;
    assert_eq!((report.poses, report.renders, stripes.drawn.get()), (count, count, count));
    // By hand: every pose, every pixel.
    let twist = simulator.motion(frame);
    let own = RigidMotion::of_camera(&camera());
    let pictures: Vec<DrawnPicture> = (0..count)
        .map(|k| {
            let part = (k as f64 + 0.5) / count as f64 - 0.5;
            let pose = twist.times(part).exp().after(&own).place(&camera());
            stripes.draw(&pose, None).unwrap()
        })
        .collect();
    for at in 0..picture.rgb.len() {
        let sum: f64 = pictures.iter().map(|p| linear(f64::from(p.rgb[at]))).sum();
        let want = display(sum / count as f64);
        assert!((f64::from(picture.rgb[at]) - want).abs() < 1e-6, "{at}");
    }
    // The hand that holds the camera rests.
    let rests = twist.exp();
    let pivot = [0.0, 0.0, -PIVOT_METRES];
    let turned = crate::transforms::quaternion::times(rests.rotation, pivot);
    (0..3).for_each(|i| assert!((turned[i] + rests.translation[i] - pivot[i]).abs() < 1e-12));
}

#[test]
fn angles_of_blur_have_the_stated_spread() {
    let simulator = PictureSimulator::new(&"blur=3".parse().unwrap(), 4, None, 0.0).unwrap();
    let n = 4000;
    for axis in 0..2 {
        let square: f64 = (0..n).map(|k| simulator.motion(k).omega[axis].powi(2)).sum();
        let sd = (square / n as f64).sqrt().to_degrees();
        assert!((sd / (3.0 * BLUR_DEGREES) - 1.0).abs() < 0.06, "{sd}");
    }
}

#[test]
fn glass_reflects_dims_and_hides_depth_where_it_is() {
    let plain = Stripes::default().draw(&camera(), None).unwrap();
    let (picture, report) = take("glass=1", 1, 0..1).remove(0);
    assert_eq!((report.renders, report.poses), (2, 1));
    let depth = picture.depth.as_ref().unwrap();
    let inside = depth.iter().filter(|d| **d == 0.0).count();
    // x from −0.1 to 1.1 at 3 m: pixels 16.67 to 56.67; y ± 0.4: 10.67 to 37.33.
    assert_eq!(inside, 40 * 26);
    assert!((report.glass - inside as f64 / (64.0 * 48.0)).abs() < 1e-12);
    for at in 0..depth.len() {
        let same = picture.rgb[3 * at..3 * at + 3] == plain.rgb[3 * at..3 * at + 3];
        assert_eq!(same, depth[at] != 0.0, "{at}");
    }
    // Behind the camera there is nothing: the mirror shows the 0.3 of the empty picture.
    let at = 24 * 64 + 20;
    let ray: f64 = (0.005f64 * 0.005 * 2.0 + 1.0).sqrt();
    let reflected = schlick(1.0 / ray);
    let behind = linear(f64::from(plain.rgb[3 * at]));
    let want = reflected * linear(f64::from(0.3f32))
        + (1.0 - reflected) * (1.0 - GLASS_ALPHA) * 0.92 * behind;
    assert!((f64::from(picture.rgb[3 * at]) - display(want)).abs() < 1e-6);

    // Not in view: no second render, no change.
    let set: EffectSet = "glass=4".parse().unwrap();
    let aside = Pane { centre: [50.0, 0.0, 3.0], ..pane() };
    let mut simulator = PictureSimulator::new(&set, 1, Some(aside), 0.0).unwrap();
    let stripes = Stripes::default();
    let (picture, report) = simulator.take(&stripes, 0, &camera()).unwrap();
    assert!(picture == plain && stripes.drawn.get() == 1 && report.glass == 0.0);
    // A renderer without depth cannot say what is before the glass.
    let stripes = Stripes { without_depth: true, ..Stripes::default() };
    let error = simulator.take(&stripes, 0, &camera()).unwrap_err().to_string();
    assert!(error.contains("depth: 3072 values are expected"), "{error}");
}

#[test]
fn light_multiplies_linear_light_and_noise_has_the_stated_spread() {
    let plain = Stripes::default().draw(&camera(), None).unwrap();
    for (picture, report) in take("light=4", 3, 0..6) {
        for (at, (got, before)) in picture.rgb.iter().zip(&plain.rgb).enumerate() {
            let want = display((linear(f64::from(*before)) * report.gain[at % 3]).clamp(0.0, 1.0));
            assert!((f64::from(*got) - want).abs() < 1e-6);
        }
        assert_ne!(report.gain, [1.0; 3]);
    }
    // Blue is 0.2 everywhere.
    let (picture, _) = take("noise=4", 3, 0..1).remove(0);
    let light = linear(f64::from(0.2f32));
    let off: Vec<f64> =
        picture.rgb.iter().skip(2).step_by(3).map(|v| linear(f64::from(*v)) - light).collect();
    let n = off.len() as f64;
    let (mean, square) = (off.iter().sum::<f64>() / n, off.iter().map(|v| v * v).sum::<f64>() / n);
    let want = (4.0 * NOISE_READ).hypot(4.0 * NOISE_SHOT * light.sqrt());
    assert!((square.sqrt() / want - 1.0).abs() < 0.05, "{} {want}", square.sqrt());
    assert!(mean.abs() < 4.0 * want / n.sqrt(), "{mean}");
}

#[test]
fn effects_do_not_change_each_others_draws() {
    // The motion of a frame is the same beside other effects, and so is its noise.
    let of = |text: &str| PictureSimulator::new(&text.parse().unwrap(), 5, None, 0.0).unwrap();
    assert_eq!(of("blur=2").motion(7), of("blur=2,light=3,noise=1").motion(7));
    let gain = |text: &str| take(text, 5, 3..4)[0].1.gain;
    assert_eq!(gain("light=2"), gain("light=2,noise=3,blur=1e-9"));
    assert_ne!(gain("light=2"), take("light=2", 6, 3..4)[0].1.gain);
    assert_ne!(gain("light=2"), take("light=2", 5, 4..5)[0].1.gain);
    let (alone, both) = (take("noise=3", 5, 0..1), take("noise=3,light=1e-9", 5, 0..1));
    assert!(far(&alone[0].0.rgb, &both[0].0.rgb) < 1e-6);
    let all = "blur=3,glass=3,light=3,noise=3";
    crate::transforms::testing::on_threads([1, 3], || take(all, 6, 0..3));
}

#[test]
fn effects_on_scenes_are_refused_by_name() {
    let set: EffectSet = "blur=1,floaters=2".parse().unwrap();
    let error = PictureSimulator::new(&set, 0, None, 0.0).unwrap_err().to_string();
    assert!(
        error.contains("floaters is an effect on scenes") && error.contains("blur, glass, light")
    );
    let (scene, pictures) = "holes=2,blur=1,surface=3,glass=4,noise=5"
        .parse::<EffectSet>()
        .unwrap()
        .split_for_pictures();
    assert_eq!(
        (scene.to_string(), pictures.to_string()),
        ("holes=2,surface=3".to_owned(), "blur=1,glass=4,noise=5".to_owned())
    );
}
