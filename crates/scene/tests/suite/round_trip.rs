//! Every format: what is written comes back, with its labels, the same bytes the second time.

use super::compressed_ply::check_close;
use crate::common::{
    SplitMix, close, contents, dot, flat, labelled, limit, open, order_of, pool, random_scene,
    shared, strict, write, write_as,
};
use rayon::prelude::*;
use scenesplat_scene::{
    GaussianScene, ReadOptions, SceneFormat, SpzFrame, WriteOptions, open_scene,
};
use std::path::Path;

/// A format, and options that matter to it.
#[derive(Clone, Copy, Debug)]
struct Case {
    format: SceneFormat,
    name: &'static str,
    spz_version: u8,
    spz_frame: SpzFrame,
}

const fn case(format: SceneFormat, name: &'static str) -> Case {
    Case { format, name, spz_version: 4, spz_frame: SpzFrame::Rub }
}

const SPZ: Case = case(SceneFormat::Spz, "a.spz");

const CASES: [Case; 13] = [
    case(SceneFormat::Ply, "a.ply"),
    case(SceneFormat::CompressedPly, "a.compressed.ply"),
    case(SceneFormat::Splat, "a.splat"),
    case(SceneFormat::Sog, "a.sog"),
    case(SceneFormat::SogFolder, "sog/meta.json"),
    case(SceneFormat::Glb, "a.glb"),
    case(SceneFormat::NpyFolder, "npy"),
    SPZ,
    Case { spz_version: 2, ..SPZ },
    Case { spz_version: 3, ..SPZ },
    Case { spz_frame: SpzFrame::Raw, ..SPZ },
    case(SceneFormat::Usda, "a.usda"),
    case(SceneFormat::Usdz, "a.usdz"),
];

impl Case {
    fn options(self) -> WriteOptions {
        let Self { spz_version, spz_frame, .. } = self;
        WriteOptions { spz_version, spz_frame, overwrite: true, ..WriteOptions::default() }
    }

    fn read(self, path: &Path) -> GaussianScene {
        let options = ReadOptions { spz_frame: self.spz_frame, ..strict() };
        let loaded = open_scene(path, &options).unwrap_or_else(|e| panic!("{self:?}: {e}"));
        assert!(loaded.kept_rows.is_none(), "{self:?}");
        loaded.scene
    }

    /// The highest degree that a file of this kind holds.
    fn degree(self) -> u8 {
        match self.format {
            SceneFormat::Splat | SceneFormat::NpyFolder => 0,
            SceneFormat::Spz if self.spz_version == 4 => 4,
            SceneFormat::Ply | SceneFormat::Glb => 4,
            SceneFormat::Usda | SceneFormat::Usdz => 4,
            _ => 3,
        }
    }
}

type Change = fn(&mut GaussianScene, &mut SplitMix);

/// Values that are hard to keep as they are.
const CHANGES: [(&str, Change); 13] = [
    ("equal rows", |s, _| *s = s.select_rows(&vec![0; s.len()]).unwrap()),
    ("tiny range", |s, r| {
        s.coord.iter_mut().flatten().for_each(|v| *v = 1000.0 + r.float() * 1e-3);
    }),
    ("tiny values", |s, r| s.coord.iter_mut().flatten().for_each(|v| *v = r.float() * 1e-38)),
    ("huge values", |s, r| {
        s.coord.iter_mut().flatten().for_each(|v| *v = r.float() * f32::MAX);
        s.sh_dc.iter_mut().flatten().for_each(|v| *v = r.float() * 1e38);
        s.sh_rest.iter_mut().for_each(|v| *v = r.float() * 1e38);
    }),
    ("any positions in every other row", |s, r| {
        for row in (0..s.len()).step_by(2) {
            s.coord[row] = [(); 3].map(|()| f32::from_bits(r.next() as u32 & 0xff7f_ffff));
            s.log_scale[row] = [(); 3].map(|()| r.float() * 120.0);
        }
    }),
    ("any size of colors", |s, r| {
        for v in s.sh_dc.iter_mut().flatten().chain(&mut s.sh_rest) {
            *v = r.float() * 10f32.powi(r.below(9) as i32 - 4);
        }
    }),
    ("one far off", |s, _| {
        s.coord[0] = [-1e30, 1e30, 0.0];
        s.log_scale[0] = [80.0; 3];
    }),
    ("zero scales", |s, r| {
        for v in s.log_scale.iter_mut().flatten() {
            *v = if r.below(3) == 0 { f32::NEG_INFINITY } else { *v * 10.0 };
        }
    }),
    ("only zero scales", |s, _| {
        s.log_scale.iter_mut().flatten().for_each(|v| *v = f32::NEG_INFINITY);
    }),
    ("ends of sizes", |s, r| {
        let picks =
            [f32::MAX, f32::MIN, -0.0, 88.722_84, 88.722_83, -103.5, -10.03, 5.97, 0.031_25];
        s.log_scale.iter_mut().flatten().for_each(|v| *v = picks[r.below(9)]);
    }),
    ("infinite opacity", |s, r| {
        for v in &mut s.opacity_logit {
            *v = [f32::INFINITY, f32::NEG_INFINITY, *v * 4.0, 0.0, -0.0, 6.3][r.below(6)];
        }
    }),
    ("equal components", |s, r| {
        let half = 0.5f32.sqrt();
        for q in &mut s.quat {
            *q = [
                [0.5, 0.5, -0.5, 0.5],
                [half, 0.0, half, 0.0],
                [0.0, half, 0.0, -half],
                [1.0, 0.0, 0.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
            ][r.below(5)];
        }
    }),
    ("ends of codes", |s, r| {
        let zero = |r: &mut SplitMix| [0.0, -0.0][r.below(2)];
        s.coord.iter_mut().flatten().for_each(|v| *v = zero(r));
        let picks = [3.34, -3.34, 100.0, 0.0, -0.0, 1.772_454, -1.772_454];
        s.sh_dc.iter_mut().flatten().for_each(|v| *v = picks[r.below(7)]);
        let picks = [-1.0, 1.0, 0.968_75, -0.97, 2.2, -2.2, 1e38, -0.031_25, 0.0625, -0.0];
        s.sh_rest.iter_mut().for_each(|v| *v = picks[r.below(10)]);
    }),
];

fn hard_scenes() -> Vec<(String, GaussianScene)> {
    let mut all = Vec::new();
    for (rows, degrees) in [
        (1, 0..=4),
        (2, 0..=4),
        (3, 0..=4),
        (255, 0..=1),
        (256, 0..=4),
        (257, 0..=1),
        (2600, 3..=3),
    ] {
        for degree in degrees {
            let scene = random_scene(rows, degree, rows as u64 + u64::from(degree));
            all.push((format!("{rows} rows of degree {degree}"), scene));
        }
    }
    for rows in [1, 2, 300] {
        for (what, change) in CHANGES {
            let mut scene = random_scene(rows, 1, rows as u64);
            change(&mut scene, &mut SplitMix(rows as u64));
            all.push((format!("{what}, {rows} rows"), scene));
        }
    }
    for (i, far) in
        [2047.999, 2_047.999_9, 2048.0, 2_048.000_1, 1e6, 8_388_607.4, 1e9, -2048.0, 3e38]
            .into_iter()
            .enumerate()
    {
        let mut scene = random_scene(40, 0, 100 + i as u64);
        scene.coord[7][i % 3] = far;
        all.push((format!("far: {far}"), scene));
    }
    for name in ["parity/playbot_lod4.ply", "objects/tmp_model_unnormalised.ply"] {
        let path = shared(&format!("real/{name}"));
        all.extend(path.map(|path| (name.to_owned(), open(&path).scene)));
    }
    all
}

/// Writes, reads and writes again.
fn check_fixed_point(case: Case, scene: &GaussianScene, what: &str) {
    let what = &format!("{case:?}, {what}");
    let mut scene = scene.clone();
    if [SceneFormat::Glb, SceneFormat::Usda, SceneFormat::Usdz].contains(&case.format) {
        // Zeros lose their sign where the frame is turned.
        let values = scene.coord.iter_mut().flatten().chain(&mut scene.sh_rest);
        values.for_each(|value| *value += 0.0);
    }
    let scene = &scene;
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["1", "2"].map(|name| folder.path().join(name));
    let [first, second] = [&a, &b].map(|folder| folder.join(case.name));
    [&a, &b].into_iter().for_each(|folder| std::fs::create_dir(folder).unwrap());
    let report = match write_as(scene, &first, case.format, &case.options()) {
        Ok(report) => report,
        Err(error) => {
            let text = error.to_string();
            // Such a file could not be told from noise.
            assert!(case.format == SceneFormat::Splat && text.contains("±1e9 m"), "{what}: {text}");
            return;
        }
    };
    assert_eq!((report.gaussians, report.format), (scene.len(), case.format), "{what}");
    let back = case.read(&first);
    assert_eq!(back.len(), scene.len(), "{what}: no row is lost");
    assert_eq!(back.sh_degree, scene.sh_degree.min(case.degree()), "{what}");
    let due = scene.select_rows(&order_of(&report)).unwrap();
    match case.format {
        SceneFormat::Ply => assert_eq!(back, due, "{what}"),
        SceneFormat::CompressedPly => check_close(&due, &back, what),
        SceneFormat::Glb | SceneFormat::Usda | SceneFormat::Usdz => {
            assert_eq!((&back.coord, &back.sh_dc), (&due.coord, &due.sh_dc));
        }
        SceneFormat::Splat | SceneFormat::NpyFolder => assert_eq!(back.coord, due.coord),
        _ => {}
    }
    for row in 0..due.len() {
        let near = dot(&due.quat[row], &back.quat[row]);
        assert!(near > if case.spz_version == 2 { 0.995 } else { 0.999_8 }, "{what}: {near}");
        assert!((due.opacity(row) - back.opacity(row)).abs() < 0.502 / 255.0, "{what}");
    }
    let again = write_as(&back, &second, case.format, &case.options()).unwrap();
    assert!(again.limits.is_empty(), "{what}: nothing is lost a second time: {again}");
    assert!(again.order.is_none(), "{what}: the order is kept");
    let bytes = |folder| contents(folder).into_iter().map(|(_, bytes)| bytes);
    assert!(bytes(&a).eq(bytes(&b)), "{what}: the second file differs");
}

#[test]
fn written_read_and_written_again_is_the_same() {
    hard_scenes().par_iter().for_each(|(what, scene)| {
        for case in CASES {
            if case.format == SceneFormat::Spz && case.degree() < scene.sh_degree {
                let folder = tempfile::tempdir().unwrap();
                let path = folder.path().join(case.name);
                let error = write_as(scene, &path, case.format, &case.options()).unwrap_err();
                assert!(error.to_string().contains("version 4"), "{error}");
                continue;
            }
            check_fixed_point(case, scene, what);
        }
    });
}

#[test]
fn real_files_are_written_again_as_they_are() {
    for (case, name) in [
        (CASES[1], "objects/guitar.compressed.ply"),
        (CASES[2], "parity/playbot_lod4.splat"),
        (CASES[3], "objects/playbot_sog2_lod/3_0"),
        (CASES[4], "objects/playbot_sog2_lod/4_0"),
    ] {
        let Some(path) = shared(&format!("real/{name}")) else { continue };
        let scene = open(&path).scene;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(case.name);
        let report = write(&scene, &path, case.format);
        // Its order is good, and all its values have codes already.
        assert!(report.order.is_none() && report.limits.is_empty(), "{name}: {report}");
        let back = case.read(&path);
        close(
            flat(&back.coord),
            flat(&scene.coord),
            if case.name == "a.splat" { 0.0 } else { 1e-3 },
        );
        // Each chunk of a compressed PLY gets new bounds; how near it comes is checked below.
        if case.format != SceneFormat::CompressedPly {
            assert!(back.sh_dc == scene.sh_dc && back.sh_rest == scene.sh_rest, "{name}");
            assert!(back.opacity_logit == scene.opacity_logit, "{name}");
        }
        check_fixed_point(case, &scene, name);
    }
}

#[test]
fn labels_and_codes_follow_their_rows() {
    for case in CASES {
        for rows in [1, 200, 6000] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join(case.name);
            let scene = labelled(rows, 1);
            let report = write_as(&scene, &path, case.format, &case.options()).unwrap();
            let due = scene.select_rows(&order_of(&report)).unwrap();
            let back = case.read(&path);
            assert_eq!(
                (&back.segment, &back.instance, &back.segment_score, &back.lang_code),
                (&due.segment, &due.instance, &due.segment_score, &due.lang_code),
                "{case:?}"
            );
            let before = contents(folder.path());
            write_as(&back, &path, case.format, &case.options()).unwrap();
            assert!(contents(folder.path()) == before, "{case:?}");
        }
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let scene = labelled(20_000, 1);
    for case in CASES {
        let run = |threads| {
            pool(threads).install(|| {
                let folder = tempfile::tempdir().unwrap();
                let path = folder.path().join(case.name);
                let report = write_as(&scene, &path, case.format, &case.options()).unwrap();
                let bytes: Vec<_> =
                    contents(folder.path()).into_iter().map(|file| file.1).collect();
                // As text: where a field has no place, its largest change is NaN.
                (report.order, format!("{:?}", report.limits), bytes, case.read(&path))
            })
        };
        let (one, three) = (run(1), run(3));
        assert!(one.0 == three.0, "{case:?}: order");
        assert_eq!(one.1, three.1, "{case:?}");
        assert!(one.2 == three.2, "{case:?}: bytes");
        assert!(one.3 == three.3, "{case:?}: values");
    }
}

#[test]
fn harmonics_are_left_out_on_request() {
    let scene = random_scene(5000, 2, 3);
    for case in CASES {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(case.name);
        write_as(&scene, &path, case.format, &case.options()).unwrap();
        let options = ReadOptions { sh_rest: false, spz_frame: case.spz_frame, ..strict() };
        let bare = open_scene(&path, &options).unwrap().scene;
        let whole = GaussianScene { sh_degree: 0, sh_rest: Vec::new(), ..case.read(&path) };
        assert_eq!(bare, whole, "{case:?}");
    }
}

/// 700 Gaussians of which formats cannot hold some.
fn beyond_formats() -> GaussianScene {
    let mut scene = random_scene(700, 4, 4);
    scene.sh_dc = vec![[0.5; 3]; 700];
    scene.opacity_logit = vec![0.0; 700];
    scene.sh_dc[80] = [0.0, 2.0, -3.0];
    scene.sh_dc[81] = [1.772_454, -1.772_454, 1.775];
    (scene.opacity_logit[600], scene.opacity_logit[602]) = (8.0, -200.0);
    scene.opacity_logit[601] = f32::INFINITY;
    scene.log_scale[11][1] = 90.0;
    scene.log_scale[12] = [-200.0; 3];
    scene.log_scale[13][1] = f32::NEG_INFINITY;
    scene
}

fn near(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-4
}

#[test]
fn what_files_of_bytes_and_floats_cannot_hold_is_counted() {
    let scene = beyond_formats();
    for case in [CASES[2], CASES[6]] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(case.name);
        let report = write(&scene, &path, case.format);
        let find = |field, word| limit(&report, field, word);
        let (rows, first, change) = find("log_scale", "larger");
        assert!((rows, first) == (1, 11) && near(change, 90.0 - 88.722_84), "{change}");
        assert_eq!(find("log_scale", "becomes 0"), (1, 12, f64::INFINITY));
        let (rows, first, change) = find("sh_dc", "clipped");
        assert!((rows, first) == (1, 80) && near(change, 3.0 - 1.772_454), "{change}");
        let (rows, first, change) = find("opacity_logit", "0 or 1");
        let due = match case.format {
            SceneFormat::Splat => (2, 600, 1.0 / (1.0 + 8f64.exp())),
            _ => (1, 602, 0.0),
        };
        assert!((rows, first) == (due.0, due.1) && near(change, due.2), "{report}");
        assert_eq!(find("sh_rest", "no place").0, 700);
        assert_eq!(report.limits.len(), 5, "{report}");
    }
}

/// Field, rows, first row and largest change of each limit of what is written.
fn limits_of(scene: &GaussianScene, case: Case) -> Vec<(&'static str, usize, usize, f64)> {
    let folder = tempfile::tempdir().unwrap();
    let limits = write(scene, &folder.path().join(case.name), case.format).limits;
    limits.iter().map(|l| (l.field, l.rows, l.first_row, l.largest_change)).collect()
}

#[test]
fn what_packed_files_cannot_hold_is_counted() {
    let mut scene = beyond_formats();
    scene.log_scale[10] = [-25.0, 0.0, 21.0];
    scene.log_scale[6] = [20.0, -20.0, 0.0];
    scene.sh_rest[72 * 8 + 1] = 4.5;
    scene.sh_rest[72 * 9] = -6.0;
    scene.sh_rest[72 * 12 + 60] = 100.0;
    scene.sh_dc[80][0] = -1e33;
    let packed = limits_of(&scene, CASES[1]);
    assert_eq!(packed[0], ("log_scale", 4, 10, f64::INFINITY));
    assert_eq!((packed[1].0, packed[1].1, packed[1].2), ("opacity_logit", 2, 600));
    assert!(near(packed[1].3, 1.0 / (1.0 + 8f64.exp())));
    assert_eq!((packed[2].0, packed[2].1, packed[2].2), ("sh_dc", 1, 80));
    // The one in band 4 is beyond the format anyway.
    assert_eq!(packed[3], ("sh_rest", 2, 8, 2.0));
    assert_eq!((packed[4].0, packed[4].1, packed.len()), ("sh_rest", 700, 5));
}

#[test]
fn what_textures_cannot_hold_is_counted() {
    let mut scene = random_scene(50, 4, 1);
    scene.log_scale[7][1] = f32::NEG_INFINITY;
    scene.opacity_logit.fill(6.0);
    scene.opacity_logit[3] = 9.0;
    scene.opacity_logit[5] = f32::INFINITY;
    scene.sh_rest[72 * 20..].fill(0.0);
    let cut = (0..20).flat_map(|row| &scene.sh_rest[row * 72 + 45..(row + 1) * 72]);
    let largest = f64::from(cut.fold(0f32, |a, v| a.max(v.abs())));
    let textures = limits_of(&scene, CASES[3]);
    let due = [("log_scale", 1, 7), ("opacity_logit", 1, 3), ("sh_rest", 20, 0)];
    assert!(textures.iter().map(|l| (l.0, l.1, l.2)).eq(due), "{textures:?}");
    assert_eq!(textures[2].3, largest);
}
