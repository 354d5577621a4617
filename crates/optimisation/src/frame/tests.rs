//! Frames by hand, and what other tests make theirs with.

use super::*;

pub(crate) fn view(width: u32, height: u32) -> View {
    View {
        world_to_camera: [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 2.]],
        fx: width as f32,
        fy: width as f32,
        cx: width as f32 / 2.0,
        cy: height as f32 / 2.0,
        width,
        height,
    }
}

/// A black frame of that view, maybe with one depth everywhere.
pub(crate) fn frame(view: View, depth: Option<f32>) -> TrainingFrame {
    let pixels = view.pixels();
    TrainingFrame {
        name: String::new(),
        view,
        rgb: Colors::Bytes(vec![0; 3 * pixels]),
        alpha: None,
        depth: depth.map(|z| vec![z; pixels]),
        mask: None,
    }
}

#[test]
fn halves_by_hand() {
    let frame = TrainingFrame {
        name: "a".to_owned(),
        view: view(3, 2),
        rgb: Colors::Bytes((0..18).collect()),
        alpha: Some(vec![255, 127, 0, 8, 1, 0]),
        depth: Some(vec![1.0, f32::NAN, 9.0, 0.0, 2.0, 9.0]),
        mask: Some(vec![1, 1, 1, 1, 0, 1]),
    };
    frame.check().unwrap();
    let half = frame.halved();
    half.check().unwrap();
    // Into what a frame of another size and kind has left.
    let mut used = TrainingFrame {
        name: "b".to_owned(),
        view: view(4, 4),
        rgb: Colors::Floats(vec![0.5; 48]),
        alpha: None,
        depth: Some(vec![1.0; 16]),
        mask: None,
    };
    let floats = used.halved();
    assert_eq!((floats.rgb.clone(), floats.mask), (Colors::Floats(vec![0.5; 12]), None));
    frame.halve_into(&mut used);
    assert_eq!(used, half);
    // Pixels 0, 1, 3, 4: reds 0, 3, 9, 12.
    assert_eq!(half.rgb, Colors::Bytes(vec![6, 7, 8]));
    assert_eq!((half.alpha, half.depth), (Some(vec![98]), Some(vec![1.5])));
    assert_eq!(half.mask, Some(vec![0]));
    assert_eq!((half.view.width, half.view.height, half.view.cx), (1, 1, 0.75));
    let bad = TrainingFrame { rgb: Colors::Bytes(vec![0; 17]), ..frame };
    let error = bad.check().unwrap_err().to_string();
    assert!(error.contains("\"a\"") && error.contains("18") && error.contains("17"), "{error}");
}

#[test]
fn the_scale_of_cameras_is_about_their_mean() {
    let at = |x: f32| {
        let mut view = view(4, 4);
        view.world_to_camera[0][3] = -x;
        frame(view, None)
    };
    // 1 from their mean at 11.
    assert!((scale_of_cameras(&[at(10.0), at(12.0)]) - 1.1).abs() < 1e-6);
    assert_eq!(scale_of_cameras(&[at(10.0), at(10.0)]), 1.0);
    assert_eq!(scale_of_cameras(&[]), 1.0);
}

#[test]
fn a_picture_is_put_over_a_background_once() {
    // Colors are multiplied by alpha already: 0.2 + (1 − 0.4) · 0.5.
    let mut frame = frame(view(1, 1), None);
    frame.rgb = Colors::Bytes(vec![51, 102, 0]);
    frame.alpha = Some(vec![102]);
    let mut out = Vec::new();
    frame.put_over([0.5, 1.0, 0.0], &mut out);
    assert!(out.iter().zip([0.5, 1.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{out:?}");
    frame.put_over([0.0; 3], &mut out);
    assert!(out.iter().zip([0.2, 0.4, 0.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{out:?}");
}

#[test]
fn halves_of_a_larger_picture_are_means_of_their_four_pixels() {
    // The last of five columns is left out. A value is 0.1 y + 0.01 x + 0.001 c: linear, so its mean is that
    // of the middle of four pixels.
    let of = |x: f32, y: f32, c: f32| 0.1 * y + 0.01 * x + 0.001 * c;
    let at = |i: usize| [(i % 5) as f32, (i / 5) as f32];
    let mut frame = frame(view(5, 4), None);
    (frame.view.fx, frame.view.fy, frame.view.cy) = (6.0, 7.0, 1.5);
    frame.rgb =
        Colors::Floats((0..60).map(|k| of(at(k / 3)[0], at(k / 3)[1], (k % 3) as f32)).collect());
    frame.depth = Some((0..20).map(|i| 1.0 + of(at(i)[0], at(i)[1], 0.0)).collect());
    // Of the first four one is negative and one infinite.
    let depth = frame.depth.as_mut().unwrap();
    (depth[0], depth[6]) = (-3.0, f32::INFINITY);
    frame.mask = Some((0..20).map(|i| [1, 2, 3, 4, 0][i % 5]).collect());
    let half = frame.halved();
    let Colors::Floats(rgb) = &half.rgb else { panic!("{:?}", half.rgb) };
    for (k, got) in rgb.iter().enumerate() {
        let (x, y) = (2.0 * (k / 3 % 2) as f32 + 0.5, 2.0 * (k / 6) as f32 + 0.5);
        assert!((got - of(x, y, (k % 3) as f32)).abs() < 1e-6, "{k}: {got}");
    }
    // What is left of the first: pixels 1 and 5, 1.01 and 1.1.
    for (got, want) in half.depth.unwrap().iter().zip([1.055, 1.075, 1.255, 1.275]) {
        assert!((got - want).abs() < 1e-6, "{got} {want}");
    }
    assert_eq!((rgb.len(), half.mask.unwrap()), (12, vec![1, 3, 1, 3]));
    let v = half.view;
    assert_eq!([v.fx, v.fy, v.cx, v.cy], [3.0, 3.5, 1.25, 0.75]);
    assert_eq!((v.width, v.height, v.world_to_camera), (2, 2, frame.view.world_to_camera));
    // Bytes are rounded: (1 + 2 + 3 + 4) / 4 is 2.5, (1 + 1 + 1 + 2) / 4 is 1.25.
    let rows: Vec<[u8; 3]> = vec![[1, 1, 0], [2, 1, 0], [3, 1, 0], [4, 2, 1]];
    let small =
        TrainingFrame { rgb: Colors::Bytes(rows.concat()), ..tests::frame(view(2, 2), None) };
    assert_eq!(small.halved().rgb, Colors::Bytes(vec![3, 1, 0]));
}

#[test]
fn a_frame_names_what_does_not_fit_it() {
    let good = || TrainingFrame {
        name: "n".to_owned(),
        alpha: Some(vec![0; 6]),
        mask: Some(vec![0; 6]),
        ..frame(view(3, 2), Some(1.0))
    };
    good().check().unwrap();
    type Case<'a> = (&'a dyn Fn(&mut TrainingFrame), &'a str);
    let cases: [Case<'_>; 6] = [
        (&|f| f.alpha = Some(vec![0; 5]), "alpha: expected 6 values, got 5"),
        (&|f| f.depth = Some(vec![0.0; 7]), "depth: expected 6 values, got 7"),
        (&|f| f.mask = Some(vec![0; 2]), "mask: expected 6 values, got 2"),
        (&|f| f.rgb = Colors::Floats(vec![0.0; 6]), "picture: expected 18 values, got 6"),
        (
            &|f| f.rgb = Colors::Floats([[0.0; 17].as_slice(), &[f32::NAN]].concat()),
            "has to be finite",
        ),
        (&|f| f.view.fx = 0.0, "fx"),
    ];
    for (change, want) in cases {
        let mut frame = good();
        change(&mut frame);
        let error = frame.check().unwrap_err().to_string();
        assert!(error.starts_with("frame \"n\": ") && error.contains(want), "{error}");
    }
    // 18 bytes of color, 4 · 6 of depth, 6 of mask, 6 of alpha; floats take four times that.
    assert_eq!(good().bytes(), 54);
    let floats = TrainingFrame { rgb: Colors::Floats(vec![0.0; 18]), mask: None, ..good() };
    assert_eq!(floats.bytes(), 102);
}

#[test]
fn colors_are_0_to_1_and_a_pixel_shows_what_is_half_opaque() {
    let (bytes, floats) = (Colors::Bytes(vec![0, 51, 255]), Colors::Floats(vec![0.5, 2.0]));
    let mut out = vec![9.0; 5];
    bytes.put(&mut out);
    assert_eq!((bytes.at(1), &out[..]), (0.2, &[0.0, 0.2, 1.0][..]));
    floats.put(&mut out);
    assert_eq!((floats.at(1), &out[..]), (2.0, &[0.5, 2.0][..]));
    assert_eq!((bytes.len(), floats.len(), floats.is_empty()), (3, 2, false));
    assert!(Colors::default().is_empty());
    let mut frame = frame(view(2, 2), None);
    assert!((0..4).all(|i| frame.shows(i)));
    frame.alpha = Some(vec![127, 128, 255, 255]);
    frame.mask = Some(vec![1, 1, 0, 9]);
    assert_eq!([0, 1, 2, 3].map(|i| frame.shows(i)), [false, true, false, true]);
    // Each pixel is put over by its own alpha.
    frame.alpha = Some(vec![255, 0, 51, 204]);
    frame.put_over([1.0, 0.5, 0.0], &mut out);
    let want = [0.0, 0.0, 0.0, 1.0, 0.5, 0.0, 0.8, 0.4, 0.0, 0.2, 0.1, 0.0];
    assert!(out.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-6), "{out:?}");
    // Cameras at 0, 0 and 3: the mean is 1, the farthest 2 from it.
    let at = |y: f32| {
        let mut view = view(4, 4);
        view.world_to_camera[1][3] = -y;
        tests::frame(view, None)
    };
    assert!((scale_of_cameras(&[at(0.0), at(0.0), at(3.0)]) - 2.2).abs() < 1e-6);
}
