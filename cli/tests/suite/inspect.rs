//! `inspect`: planted defects are named, clean scenes are not blamed, hard scenes do not stop it.

use crate::support::*;
use scenesplat::datasets::sample_rng;
use scenesplat::inspect::sheet::render_sheet;
use scenesplat::inspect::{InspectSettings, Inspection, LengthUnit, Severity, inspect};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::formats::ply::PlyFile;
use scenesplat::scene::{
    GaussianScene, LanguageCode, LanguageCodebook, ReadOptions, Up, open_scene,
};
use std::collections::BTreeSet;

/// What is said about a scene once it went through a file.
fn look(scene: &GaussianScene) -> Inspection {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ply");
    write_inria_ply(scene, &[], &path).unwrap();
    let loaded = open_scene(&path, &ReadOptions::default()).unwrap();
    inspect(&loaded, &InspectSettings::default())
}

fn names(seen: &Inspection) -> Vec<&str> {
    seen.findings.iter().map(|f| f.name.as_str()).collect()
}

fn room() -> GaussianScene {
    generate(&SyntheticRoomSettings::with_count(20_000, 5)).unwrap().scene
}

fn biker() -> Option<GaussianScene> {
    let path = shared("real/objects/biker.compressed.ply")?;
    Some(open_scene(&path, &ReadOptions::default()).unwrap().scene)
}

/// Plants a defect in a generated room and in a real object, and expects one finding by that name.
fn planted(name: &str, plant: impl Fn(&mut GaussianScene) -> (usize, Option<usize>)) {
    for (which, scene) in [("room", Some(room())), ("biker", biker())] {
        let Some(mut scene) = scene else { continue };
        let (count, first) = plant(&mut scene);
        let seen = look(&scene);
        assert_eq!(names(&seen), [name], "{which}: {:#?}", seen.findings);
        let finding = &seen.findings[0];
        assert_eq!((finding.count, finding.first_row), (count, first), "{which}: {finding:?}");
        assert!(!finding.help.is_empty() && !finding.message.is_empty());
        assert_eq!(seen.gaussians, scene.len());
    }
}

#[test]
fn what_cannot_be_used_is_an_error_with_its_rows() {
    let rows = [700, 7, 19_000];
    planted("coord_not_finite", |scene| {
        rows.iter().for_each(|&r| scene.coord[r][1] = f32::NAN);
        (3, Some(7))
    });
    planted("scale_nan", |scene| {
        rows.iter().for_each(|&r| scene.log_scale[r][2] = f32::NAN);
        (3, Some(7))
    });
    let mut scene = room();
    rows.iter().for_each(|&r| scene.coord[r][0] = f32::INFINITY);
    let seen = look(&scene);
    assert_eq!((seen.gaussians, seen.usable, seen.dropped), (20_000, 19_997, 3));
    assert_eq!(
        (seen.findings[0].severity, seen.findings[0].example.as_str()),
        (Severity::Error, "inf")
    );
}

#[test]
fn zero_quaternions_are_a_warning() {
    planted("quat_zero", |scene| {
        scene.quat[11] = [0.0; 4];
        scene.quat[12_345] = [0.0; 4];
        (2, Some(11))
    });
}

#[test]
fn outliers_at_a_kilometre() {
    planted("outliers", |scene| {
        let rows: Vec<usize> = (42..scene.len()).step_by(100).collect();
        for (i, &row) in rows.iter().enumerate() {
            // All around, not one behind the other.
            let angle = i as f32;
            scene.coord[row] = [1000.0 * angle.cos(), 1000.0 * angle.sin(), 300.0];
        }
        (rows.len(), Some(42))
    });
    // In one place they have neighbors; and one alone is enough.
    planted("outliers", |scene| {
        for row in (42..scene.len()).step_by(100) {
            scene.coord[row] = [1000.0, 0.0, 0.0];
        }
        ((scene.len() - 42).div_ceil(100), Some(42))
    });
    planted("outliers", |scene| {
        scene.coord[99] = [0.0, -1000.0, 0.0];
        (1, Some(99))
    });
}

#[test]
fn row_numbers_are_those_of_the_file() {
    let mut scene = room();
    (0..50).for_each(|row| scene.opacity_logit[row] = f32::NAN);
    scene.coord[99] = [0.0, -1000.0, 0.0];
    let seen = look(&scene);
    assert_eq!(names(&seen), ["opacity_nan", "outliers"], "the worst comes first");
    assert_eq!(seen.findings[1].first_row, Some(99));
}

#[test]
fn millimetres_instead_of_metres() {
    let mm = |scales: bool| {
        move |scene: &mut GaussianScene| {
            scene.coord.iter_mut().flatten().for_each(|v| *v *= 1000.0);
            if scales {
                scene.log_scale.iter_mut().flatten().for_each(|v| *v += 1000f32.ln());
            }
            (scene.len(), None)
        }
    };
    planted("unit", mm(true));
    planted("unit", mm(false));
    let mut scene = room();
    mm(true)(&mut scene);
    let seen = look(&scene);
    let unit = seen.unit.unwrap();
    assert!(unit.unit == LengthUnit::Millimetre && unit.confidence > 0.8, "{unit:?}");
    assert!(seen.findings[0].help.contains("by 0.001"));
    // The other way round: kilometers.
    planted("unit", |scene| {
        scene.coord.iter_mut().flatten().for_each(|v| *v /= 1000.0);
        scene.log_scale.iter_mut().flatten().for_each(|v| *v -= 1000f32.ln());
        (scene.len(), None)
    });
}

#[test]
fn terrain_of_some_hundred_metres_is_in_metres() {
    for (side, n) in [(200.0f32, 300), (500.0, 500)] {
        let mut rng = sample_rng(1, 0, 0);
        let mut unit = || rand::Rng::random::<f32>(&mut rng);
        let coord: Vec<[f32; 3]> = (0..n * n)
            .map(|_| {
                let [x, y] = [unit() * side, unit() * side];
                [x, y, 8.0 * (x * 0.03).sin() + 0.2 * unit()]
            })
            .collect();
        let len = coord.len();
        let scene = GaussianScene {
            coord,
            log_scale: vec![[-1.2, -1.2, -4.0]; len],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; len],
            opacity_logit: vec![3.0; len],
            sh_dc: vec![[0.2; 3]; len],
            ..GaussianScene::default()
        };
        let seen = look(&scene);
        assert_eq!(names(&seen), [""; 0], "{side} m: {:#?}", seen.findings);
        assert!(seen.up.direction.vector()[2].abs() > 0.999, "waves look alike from below");
        assert_eq!(seen.unit.unwrap().unit, LengthUnit::Metre);
    }
}

#[test]
fn one_giant() {
    planted("giant_splats", |scene| {
        scene.log_scale[1234] = [2.0, 2.5, -1.0];
        scene.opacity_logit[1234] = 0.0;
        (1, Some(1234))
    });
    // What nobody can see does no harm, nor does a backdrop that ends before the scene.
    let mut scene = room();
    scene.log_scale[1234] = [2.5; 3];
    scene.opacity_logit[1234] = -9.0;
    scene.coord[1235] = [40.0, 1.0, 1.0];
    scene.log_scale[1235] = [2.0; 3];
    assert_eq!(names(&look(&scene)), [""; 0]);
}

#[test]
fn rows_that_stand_twice() {
    planted("duplicates", |scene| {
        let n = scene.len();
        let copies = n / 20;
        let mut rows: Vec<usize> = (0..n).collect();
        rows.extend((0..copies).map(|i| i * 20));
        *scene = scene.select_rows(&rows).unwrap();
        (copies, Some(n))
    });
    // The same places in other colors are nothing to complain about.
    let mut scene = room();
    for row in 0..1000 {
        scene.coord[row] = scene.coord[row + 10_000];
    }
    let seen = look(&scene);
    assert_eq!(names(&seen), [""; 0]);
    let note = seen.notes.iter().find(|n| n.name == "same_position").unwrap();
    assert_eq!((note.count, note.first_row), (1000, Some(10_000)));
}

#[test]
fn floaters_around_the_scene() {
    for (which, scene) in [("room", Some(room())), ("biker", biker())] {
        let Some(scene) = scene else { continue };
        let before = look(&scene);
        let own = before.notes.iter().find(|n| n.name == "floaters").map_or(0, |n| n.count);
        let n = scene.len();
        let copies = n / 100;
        let mut rows: Vec<usize> = (0..n).collect();
        rows.extend((0..copies).map(|i| (i * 97) % n));
        let mut scene = scene.select_rows(&rows).unwrap();
        let size = before.extent.into_iter().fold(0.0, f64::max) as f32;
        let mut rng = sample_rng(2, 0, 0);
        let mut unit = || rand::Rng::random::<f32>(&mut rng) - 0.5;
        for coord in &mut scene.coord[n..] {
            // A cube three times as large, without the part where the scene is.
            let mut offset = [0.0; 3];
            while offset.iter().all(|v: &f32| v.abs() < 0.7 * size) {
                offset = [0.0; 3].map(|_: f32| 3.0 * size * unit());
            }
            let centre = |a: usize| {
                (before.robust_bounds.low[a] + before.robust_bounds.high[a]) as f32 / 2.0
            };
            *coord = [0, 1, 2].map(|a| centre(a) + offset[a]);
        }
        let seen = look(&scene);
        assert_eq!(names(&seen), ["floaters"], "{which}: {:#?}", seen.findings);
        let count = seen.findings[0].count;
        assert!(count > copies * 9 / 10 && count <= copies + own, "{which}: {count} of {copies}");
        assert!(seen.findings[0].first_row.unwrap() <= n + 10);
    }
}

#[test]
fn haze_has_not_converged() {
    planted("low_opacity", |scene| {
        scene.opacity_logit.iter_mut().for_each(|v| *v = v.min(3.0) * 0.2 - 3.0);
        (scene.len(), None)
    });
}

#[test]
fn coordinates_of_a_survey() {
    planted("coarse_coordinates", |scene| {
        scene.coord.iter_mut().for_each(|c| *c = [c[0] + 400_000.0, c[1] - 60_000.0, c[2]]);
        // Rounding to 3 cm makes some positions meet; their rows differ.
        (scene.len(), None)
    });
}

#[test]
fn clean_scenes_raise_nothing() {
    let mut seen = vec![look(&room())];
    for (num_gaussians, seed) in [(500, 0), (2_000, 1), (60_000, 2)] {
        seen.push(look(
            &generate(&SyntheticRoomSettings::with_count(num_gaussians, seed)).unwrap().scene,
        ));
    }
    let real = [
        "objects/biker.compressed.ply",
        "objects/guitar.compressed.ply",
        "objects/hamburger.ply",
        "objects/monkey404.ply",
        "parity/playbot_lod4.ply",
        "parity/playbot_lod4.compressed.ply",
        "parity/biker.compressed.ply",
        "fixtures/unitCube-ascii.ply",
    ];
    let real = real.iter().filter_map(|name| shared(&format!("real/{name}")));
    for path in real.chain([asset("room.ply")]) {
        let loaded = open_scene(&path, &ReadOptions::default()).unwrap();
        seen.push(inspect(&loaded, &InspectSettings::default()));
    }
    for seen in seen {
        assert_eq!(names(&seen), [""; 0], "{}: {:#?}", seen.path, seen.findings);
        assert!(seen.notes.iter().all(|n| n.severity == Severity::Note));
        assert_eq!(seen.unit.unwrap().unit, LengthUnit::Metre);
    }
}

#[test]
fn a_snapshot_of_a_training_has_copies() {
    let Some(path) = shared("real/objects/tmp_model_unnormalised.ply") else { return };
    let loaded = open_scene(&path, &ReadOptions::default()).unwrap();
    let seen = inspect(&loaded, &InspectSettings::default());
    assert_eq!(names(&seen), ["duplicates"]);
    assert_eq!(seen.findings[0].count, 17_230);
    assert!(seen.notes.iter().any(|n| n.name == "quat_not_unit"), "legal, so a note");
}

#[test]
fn legal_extremes_are_notes() {
    for scene in [Some(room()), biker()].into_iter().flatten() {
        let mut scene = scene;
        for row in 0..200 {
            scene.opacity_logit[row] = if row % 2 == 0 { f32::INFINITY } else { f32::NEG_INFINITY };
            scene.log_scale[row + 300][0] = f32::NEG_INFINITY;
            scene.log_scale[row + 600] = [f32::NEG_INFINITY; 3];
            scene.quat[row + 900] = [0.0, 1.0, 0.0, 0.0];
            scene.quat[row + 1200] = scene.quat[row + 1200].map(|v| v * 3.0);
        }
        let seen = look(&scene);
        assert_eq!(names(&seen), [""; 0], "{:#?}", seen.findings);
        for name in ["opacity_infinite", "scale_zero", "quat_half_turn", "quat_not_unit"] {
            let note = seen.notes.iter().find(|n| n.name == name);
            assert!(note.is_some_and(|n| n.count >= 200), "{name}: {note:?}");
        }
    }
}

fn rows(coord: Vec<[f32; 3]>) -> GaussianScene {
    let n = coord.len();
    GaussianScene {
        coord,
        log_scale: (0..n).map(|i| [-3.0 - (i % 7) as f32 * 0.1, -3.0, -5.0]).collect(),
        quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logit: (0..n).map(|i| 1.0 + (i % 11) as f32 * 0.1).collect(),
        sh_dc: (0..n).map(|i| [0.1, 0.2, i as f32 * 1e-4]).collect(),
        ..GaussianScene::default()
    }
}

/// Every number of a JSON value is finite by the format itself; this checks that none is missing that
/// should be there.
fn is_complete(json: &serde_json::Value) {
    for field in ["gaussians", "usable", "dropped", "sh_degree", "sh_degree_used"] {
        assert!(json[field].is_u64(), "{field}: {}", json[field]);
    }
    assert!(json["format"].is_string() && json["findings"].is_array() && json["notes"].is_array());
    for axis in 0..3 {
        assert!(
            json["bounds"]["low"][axis].is_f64() && json["robust_bounds"]["high"][axis].is_f64()
        );
    }
    assert!(json["up"]["axis"].is_string() && json["opacity"]["quantiles"]["p50"].is_f64());
    for finding in json["findings"].as_array().unwrap() {
        assert!(finding["name"].is_string() && finding["severity"].is_string());
        assert!(finding["count"].is_u64() && finding["message"].is_string());
        assert!(finding["first_row"].is_u64() || finding["first_row"].is_null());
        assert!(finding["example"].is_string() && finding["help"].is_string());
    }
}

#[test]
fn hard_shapes_are_looked_at_all_the_same() {
    let line: Vec<[f32; 3]> = (0..2000).map(|i| [i as f32 * 0.01, 2.0, -1.0]).collect();
    let huge: Vec<[f32; 3]> = room().coord.iter().map(|c| c.map(|v| v * 1e30)).collect();
    let mut one_huge = room().coord;
    one_huge[77] = [1e30, -1e30, 1e30];
    let ends = vec![[f32::MAX; 3], [f32::MIN; 3], [0.0; 3]];
    let same = rows(vec![[1.0, 2.0, 3.0]; 1000]);
    let identical = same.select_rows(&[5; 1000]).unwrap();
    for (what, scene, expected) in [
        ("one", rows(vec![[1.0, 2.0, 3.0]]), vec![]),
        ("two", rows(vec![[1.0, 2.0, 3.0], [2.0, 2.0, 3.0]]), vec![]),
        ("three", rows(line[..3].to_vec()), vec!["unit"; 0]),
        ("one place", same, vec!["one_place"]),
        ("identical", identical, vec!["one_place", "duplicates"]),
        ("line", rows(line), vec![]),
        (
            "plane",
            rows((0..2500).map(|i| [(i % 50) as f32, (i / 50) as f32, 0.0]).collect()),
            vec![],
        ),
        ("huge", rows(huge), vec!["grid_too_wide", "unit"]),
        ("one huge", rows(one_huge), vec!["grid_too_wide", "outliers"]),
        ("ends of f32", rows(ends), vec!["grid_too_wide"]),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.ply");
        write_inria_ply(&scene, &[], &path).unwrap();
        let loaded = open_scene(&path, &ReadOptions::default()).unwrap();
        let seen = inspect(&loaded, &InspectSettings::default());
        assert_eq!(names(&seen), expected, "{what}: {:#?}", seen.findings);
        is_complete(&serde_json::to_value(&seen).unwrap());
        render_sheet(&loaded.scene, &seen).unwrap();
        assert!(seen.to_string().lines().count() > 8);
    }
    // What can be put on the grid is still counted.
    let mut scene = room();
    scene.coord[77] = [1e30, 0.0, 0.0];
    let seen = look(&scene);
    let voxels = seen.voxels.unwrap();
    assert!(voxels.left_out == 1 && voxels.count > 10_000, "{voxels:?}");
    assert_eq!(seen.findings[0].first_row, Some(77));
}

#[test]
fn harmonics_labels_and_codes_are_counted() {
    let mut scene = room();
    scene.sh_degree = 3;
    scene.sh_rest = vec![0.0; scene.len() * 45];
    // Coefficient 2 of band 1, coefficient 7 (band 2) below what a byte shows.
    scene.sh_rest[45 * 10 + 3] = -0.4;
    scene.sh_rest[45 * 10 + 7 * 3] = 0.001;
    let seen = look(&scene);
    assert_eq!((seen.sh_degree, seen.sh_degree_used), (3, 1));
    let bands: Vec<(u8, usize)> = seen.sh_bands.iter().map(|b| (b.band, b.rows)).collect();
    assert_eq!(bands, [(1, 1), (2, 0), (3, 0)]);
    assert!((seen.sh_bands[0].largest - 0.4).abs() < 1e-6);
    assert_eq!(names(&seen), [""; 0]);
    assert!(seen.notes.iter().any(|n| n.name == "unused_harmonics"));
    let labels = seen.labels.unwrap();
    assert!(labels.classes > 5 && labels.labelled > 19_000 && labels.instances > 5, "{labels:?}");
    assert_eq!(seen.language_codes, None);
    let mut loaded = open_scene(&asset("room.ply"), &ReadOptions::default()).unwrap();
    let codebook = LanguageCodebook { mean: vec![0.0; 4], axes: vec![1.0; 12] };
    let values = vec![Default::default(); 3 * loaded.scene.len()];
    loaded.scene.lang_code = Some(LanguageCode { values, codebook });
    let codes = inspect(&loaded, &InspectSettings::default()).language_codes.unwrap();
    assert_eq!((codes.width, codes.feature_width), (3, 4));
}

#[test]
fn the_demo_room_by_numbers() {
    let loaded = open_scene(&asset("room.ply"), &ReadOptions::default()).unwrap();
    let seen = inspect(&loaded, &InspectSettings::default());
    assert_eq!((seen.gaussians, seen.format, seen.up.direction), (16_000, "ply", Up::PLUS_Z));
    let voxels = seen.voxels.as_ref().unwrap();
    assert_eq!(voxels.by_gaussians.iter().sum::<u64>() as usize, voxels.count);
    let opacity = &seen.opacity.histogram;
    assert_eq!(opacity.counts.iter().sum::<u64>() + opacity.below + opacity.above, 16_000);
    // The same by hand.
    let mut largest: Vec<f32> =
        (0..16_000).map(|row| loaded.scene.scale(row).into_iter().fold(0.0, f32::max)).collect();
    largest.sort_by(f32::total_cmp);
    let median = seen.largest_scale.quantiles.unwrap().p50;
    assert!((median / f64::from(largest[8000]) - 1.0).abs() < 1e-5, "{median}");
    let cells: BTreeSet<[i64; 3]> = {
        let shifted = scenesplat::datasets::plan::center_shift(&loaded.scene.coord);
        let cell = |v: f32| (f64::from(v) / 0.02).floor() as i64;
        shifted.iter().map(|c| c.map(cell)).collect()
    };
    assert_eq!(cells.len(), voxels.count);
}

#[test]
fn threads_change_nothing() {
    for scene in [Some(room()), biker()].into_iter().flatten() {
        let mut scene = scene;
        for row in (3..scene.len()).step_by(50) {
            scene.coord[row] = scene.coord[row].map(|v| v * 9.0);
        }
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let seen = look(&scene);
                let folder = tempfile::tempdir().unwrap();
                let path = folder.path().join("scene.ply");
                write_inria_ply(&scene, &[], &path).unwrap();
                let loaded = open_scene(&path, &ReadOptions::default()).unwrap();
                let picture = render_sheet(&loaded.scene, &seen).unwrap();
                (Inspection { path: String::new(), ..seen }, picture)
            })
        };
        let one = on(1);
        // The title of the sheet is the file's name, which is the same.
        assert!(one == on(2) && one == on(5));
    }
}

#[test]
fn the_command_prints_and_writes() {
    let folder = Folder::new();
    let (room, file) = (asset_at("room.ply"), folder.at("seen.json"));
    let inspect = |more: &str| run!("inspect {room} --json {file} --quiet {more}");
    let output = inspect(&format!("--out {} --threads 2", folder.at("out")));
    let said = printed(&output);
    // The sheet is named.
    has(&said, &["16 000 (ply)", "no findings", "room.ply.inspect.png"]);
    assert_eq!(stderr(&output), "");
    let sheet = folder.path("out/room.ply.inspect.png");
    let sheet = scenesplat::scene::picture::read_picture(&sheet).unwrap();
    assert_eq!((sheet.width(), sheet.height()), (1600, 1080));
    let seen = json(&file);
    is_complete(&seen);
    assert_eq!((&seen["gaussians"], &seen["format"]), (&16_000.into(), &"ply".into()));
    assert_eq!(seen["findings"].as_array().unwrap().len(), 0);
    let ply = PlyFile::open(&asset("room.ply")).unwrap();
    let labels: BTreeSet<i64> = ply.column_i64("vertex", "segment").unwrap().into_iter().collect();
    assert_eq!(seen["labels"]["classes"], labels.iter().filter(|label| **label >= 0).count());
    let estimate = &seen["estimate"];
    assert!(estimate["seconds"].as_f64().unwrap() > 0.0, "{estimate}");
    // The network that `segment` runs without flags, at its own voxel size.
    assert!(estimate["bytes"].as_u64().unwrap() < 400_000_000, "{estimate}");
    assert_eq!((&estimate["network"], &estimate["threads"]), (&"embedded".into(), &2.into()));
    assert_eq!(seen["voxels"]["size"], 0.06);
    done(&inspect("--no-sheet --config language"));
    let language = json(&file)["estimate"]["bytes"].as_u64().unwrap();
    assert!(language > 400_000_000, "weights alone are as large");
    let missing = inspect(&format!("--no-sheet --weights {}", folder.at("no.pth")));
    refused(&missing, 1, &["no.pth"]);

    // Another network, another sheet, a direction.
    done(&inspect(&format!("--config semseg --up -y --sheet {}", folder.at("s.png"))));
    assert!(folder.path("s.png").exists());
    let seen = json(&file);
    assert_eq!((&seen["up"]["axis"], &seen["up"]["given"]), (&"-y".into(), &true.into()));
    assert!(seen["estimate"]["bytes"].as_u64().unwrap() < language);

    // No sheet, no folder; a receipt if asked for.
    let (none, receipt) = (folder.at("none"), folder.at("r.json"));
    done(&inspect(&format!("--no-sheet --out {none} --receipt {receipt}")));
    assert!(!folder.path("none").exists());
    assert_eq!(json(receipt)["rows_in"], 16_000);
    refused(&inspect("--sheet a.png --no-sheet"), 2, &[]);
    refused(&inspect("--up up"), 2, &[]);
    refused(&run!("inspect {}", folder.at("nothing.ply")), 1, &[]);
}

#[test]
fn findings_fail_only_if_asked_to() {
    let folder = Folder::new();
    let mut scene = room();
    scene.coord[5] = [f32::NAN; 3];
    let inspect = |scene: &str, more: &str| run!("inspect {scene} --no-sheet --quiet {more}");
    let bad = folder.scene("bad.ply", &scene);
    let said = printed(&inspect(&bad, ""));
    has(&said, &["1 finding\n  error coord_not_finite: 1 row, first 5 (NaN)"]);
    let file = folder.at("seen.json");
    let failed = inspect(&bad, &format!("--fail-on-findings --json {file}"));
    refused(&failed, 1, &["coord_not_finite"]);
    assert_eq!(json(file)["findings"][0]["first_row"], 5, "the report is there");
    done(&inspect(&asset_at("room.ply"), "--fail-on-findings"));
}

#[test]
fn other_sources_are_named() {
    use scenesplat::scene::formats::npy_folder::write_npy_folder;
    let folder = Folder::new();
    let file = folder.at("seen.json");
    let format = |scene: &str| {
        done(&run!("inspect {scene} --json {file} --out {}", folder.at("out")));
        let seen = json(&file);
        assert_eq!(seen["findings"].as_array().unwrap().len(), 0, "{}", seen["findings"]);
        seen
    };
    write_npy_folder(&room(), &folder.path("scene.v1"), false).unwrap();
    assert_eq!(format(&folder.at("scene.v1"))["format"], "npy");
    assert!(folder.path("out/scene.v1.inspect.png").exists());

    let mut points =
        "ply\nformat ascii 1.0\nelement vertex 900\nproperty float x\nproperty float y\n\
         property float z\nproperty uchar red\nproperty uchar green\n\
         property uchar blue\nproperty int label\nend_header\n"
            .to_owned();
    for i in 0..900 {
        let (x, y) = (i % 30, i / 30);
        points += &format!("{} {} 0 200 100 50 {}\n", 0.1 * x as f32, 0.1 * y as f32, x / 10);
    }
    let seen = format(&folder.write("points.ply", points));
    assert_eq!((&seen["format"], &seen["gaussians"]), (&"points".into(), &900.into()));
    assert_eq!(seen["labels"]["classes"], 3);
    let Some(packed) = shared("real/objects/guitar.compressed.ply") else { return };
    assert_eq!(format(packed.to_str().unwrap())["format"], "compressed-ply");
}

#[test]
fn effects_of_the_capture_are_in_the_json_by_name() {
    use scenesplat::datasets::effects::{Effect, simulate};
    let folder = Folder::new();
    let look = |effects: &str| -> serde_json::Value {
        let scene = simulate(&room(), &effects.parse().unwrap(), 2).unwrap().scene;
        let (scene, file) = (folder.scene("scene.ply", &scene), folder.at("seen.json"));
        let table = printed(&run!("inspect {scene} --no-sheet --json {file}"));
        has(&table, &["capture effects, severity 0 to 5"]);
        json(file)["effects"].take()
    };
    let (clean, rough) = (look("none"), look("surface=4"));
    for effect in Effect::ALL {
        for seen in [&clean[effect.name()], &rough[effect.name()]] {
            assert!((0.0..=5.0).contains(&seen["severity"].as_f64().unwrap()), "{seen}");
            let present = seen["present"].as_bool().unwrap();
            assert_eq!(present, seen["severity"].as_f64().unwrap() > 0.0, "{seen}");
            let first = &seen["evidence"][0];
            let judged = seen["judged"].as_bool().unwrap();
            assert_eq!(judged, first["value"].is_f64() && first["name"].is_string(), "{seen}");
            assert!(seen["threshold"].as_f64().unwrap() > 0.0);
        }
    }
    assert_eq!(clean.as_object().unwrap().len(), Effect::ALL.len());
    let [before, after] = [&clean, &rough].map(|e| e["surface"]["severity"].as_f64().unwrap());
    assert!(before == 0.0 && after > 3.0, "{before} {after}");
}
