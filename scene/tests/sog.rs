//! Scenes as textures: files of other programs, and what is written comes back.

#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

mod common;

use common::shared;
use scenesplat_scene::formats::sog::{
    is_lod_meta_json, is_sog_archive, is_sog_folder, is_sog_meta_json, read_sog, read_sog_archive,
    write_sog, write_sog_folder,
};
use scenesplat_scene::{
    GaussianScene, LoadedScene, Policy, ReadOptions, SceneKind, WriteOptions, open_scene,
};
use std::path::Path;

const PLAYBOT: &str = "real/objects/playbot_sog2_lod";

fn strict(lod: usize) -> ReadOptions {
    // Real files need no repair, so the strict policy must take them.
    ReadOptions { policy: Policy::Strict, lod, ..ReadOptions::default() }
}

fn real(relative: &str) -> Option<LoadedScene> {
    Some(read_sog(&shared(relative)?, &strict(0)).unwrap())
}

#[test]
fn real_files_have_the_right_number_of_rows() {
    for (name, rows, degree) in [
        ("playbot_sog2_lod/0_0", 500_000, 2),
        ("playbot_sog2_lod/3_0/meta.json", 31_000, 2),
        ("playbot_sog2_lod/4_0", 8_406, 2),
        ("playbot_sog2_lod/5_0", 3_000, 2),
        ("playbot_sog2_lod/6_0", 1_873, 2),
        ("playcanvas_logo_sog1", 307_128, 0),
        ("playcanvas_logo_sog1/meta.json", 307_128, 0),
        ("monkey_0001.sog", 31_658, 0),
    ] {
        let Some(loaded) = real(&format!("real/objects/{name}")) else { continue };
        assert_eq!((loaded.scene.len(), loaded.scene.sh_degree), (rows, degree), "{name}");
        assert_eq!(loaded.kind, SceneKind::Sog);
        for q in &loaded.scene.quat {
            let norm: f64 = q.iter().map(|&v| f64::from(v).powi(2)).sum();
            assert!((norm - 1.0).abs() < 1e-6 && q[0] >= 0.0, "{name} {q:?}");
        }
    }
}

#[test]
fn playbot_as_another_decoder_read_it() {
    let Some(sog) = real(&format!("{PLAYBOT}/4_0")) else { return };
    let Some(ply) = shared("real/parity/playbot_lod4.ply") else { return };
    let ply = open_scene(&ply, &ReadOptions::default()).unwrap().scene;
    let sog = sog.scene;
    println!(
        "{:?} {:?} {:?} {:?} {:?}",
        sog.coord[0], sog.quat[0], sog.log_scale[0], sog.sh_dc[0], sog.opacity_logit[0]
    );
    let far = |a: &[f32], b: &[f32]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| if a == b { 0.0 } else { (a - b).abs() / (1.0 + a.abs()) })
            .fold(0f32, f32::max)
    };
    println!(
        "{} {} {} {} {} {}",
        far(sog.coord.as_flattened(), ply.coord.as_flattened()),
        far(sog.quat.as_flattened(), ply.quat.as_flattened()),
        far(sog.log_scale.as_flattened(), ply.log_scale.as_flattened()),
        far(sog.sh_dc.as_flattened(), ply.sh_dc.as_flattened()),
        far(&sog.opacity_logit, &ply.opacity_logit),
        far(&sog.sh_rest, &ply.sh_rest)
    );
}

#[test]
fn first_round() {
    for name in [
        "playbot_sog2_lod/4_0",
        "playbot_sog2_lod/3_0",
        "monkey_0001.sog",
        "playcanvas_logo_sog1",
        "playbot_sog2_lod/0_0",
    ] {
        let Some(loaded) = real(&format!("real/objects/{name}")) else { continue };
        let dir = tempfile::tempdir().unwrap();
        let t = std::time::Instant::now();
        let a = dir.path().join("a.sog");
        let report = write_sog(&loaded.scene, &a, &WriteOptions::default(), &mut |_| true).unwrap();
        println!("{name} {report} {:?}", t.elapsed());
        let back = read_sog(&a, &strict(0)).unwrap().scene;
        let b = dir.path().join("b.sog");
        let report = write_sog(&back, &b, &WriteOptions::default(), &mut |_| true).unwrap();
        println!("{report}");
        assert!(std::fs::read(a).unwrap() == std::fs::read(b).unwrap());
    }
}
