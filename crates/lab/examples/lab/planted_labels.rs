//! Lifts labels whose truth is known, and shows what wrong ones do: takes pictures of a synthetic room with 60
//! cameras, cuts them by the true objects, lifts these segments back onto the Gaussians, first as they are,
//! then with some named after other objects, each time with all pixels and with those only whose depth
//! agrees, and draws truth and results.

use crate::Arguments;
use crate::planted::{Planted, Recovered, Size};
use anyhow::Result;
use scenesplat::outputs::{label_colors, write_scene_preview};
use scenesplat::scene::UpAxis;
use scenesplat_rasterizer::lifting::{
    DepthProbe, DepthTolerance, FinaliseSettings, LiftSettings, Robust,
};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Part of the segments of each picture that have the name of another object.
const WRONG: f64 = 0.2;

pub fn run(mut args: Arguments) -> Result<()> {
    let out: PathBuf = args.needed("which folder for the pictures?")?;
    let (gaussians, room) = (args.or(200_000)?, args.or(0)?);
    let out = out.as_path();
    std::fs::create_dir_all(out)?;
    let size = Size { gaussians, views: 60, picture: [640, 480], room };
    let planted = Planted::new(size);
    println!("{gaussians} Gaussians, {} objects, {size:?}", planted.num_objects());
    draw(&planted, &planted.object, "truth", out)?;

    let settings = |depth| LiftSettings { depth, ..LiftSettings::default() };
    let agreeing = Some(DepthTolerance::RENDERED);
    for (name, depth) in [("lifted", None), ("lifted_depth", agreeing)] {
        let start = Instant::now();
        let mut lifter = planted.lifter(0.0, settings(depth))?;
        let seconds = start.elapsed().as_secs_f64();
        println!("{name}: {seconds:.3} s for the weights of {} pictures", planted.views.len());
        let clean = planted.recover(&mut lifter, &FinaliseSettings::default())?;
        report("true segments, weighted mean", &clean);
        draw(&planted, &clean.object, name, out)?;
        let robust = planted.recover(&mut lifter, &FinaliseSettings::robust())?;
        report("true segments, robust rule", &robust);
    }
    for wrong in [0.0, 0.05, 0.1, WRONG, 0.3, 0.4] {
        let start = Instant::now();
        let effect =
            planted.depth_effect(wrong, planted.views.len().div_ceil(DepthProbe::PICTURES))?;
        println!(
            "{wrong} wrong: labels at another depth mislead by {:.3}, {:.3} of the weight agrees ({} in \
             {:.2} s)",
            effect.misleading.unwrap_or(0.0),
            effect.kept,
            if effect.helps() { "depth agreement on" } else { "off" },
            start.elapsed().as_secs_f64()
        );
        if wrong == 0.0 {
            continue;
        }
        for depth in [None, agreeing] {
            let mut lifter = planted.lifter(wrong, settings(depth))?;
            for (name, finalise) in
                [("mean", FinaliseSettings::default()), ("robust", FinaliseSettings::robust())]
            {
                let noisy = planted.recover(&mut lifter, &finalise)?;
                let with = if depth.is_some() { "_depth" } else { "" };
                let name = format!("wrong{:.0}_{name}{with}", 100.0 * wrong);
                report(&name, &noisy);
                if wrong == WRONG {
                    draw(&planted, &noisy.object, &name, out)?;
                }
            }
        }
    }
    Ok(())
}

fn report(what: &str, found: &Recovered) {
    let disagreement = found.disagreement.unwrap_or(0.0);
    println!(
        "{what}: {:.4} of the weight and {:.4} of {} Gaussians with coverage ½ have their own \
         object; 1 − cosine to its feature {:.5}; disagreement {disagreement:.4} ({})",
        found.mass,
        found.gaussians,
        found.covered,
        found.error,
        if Robust::default().decide(found.disagreement) { "guarded" } else { "not guarded" },
    );
}

/// Draws objects in colours of their own, those without one grey.
fn draw(planted: &Planted, object: &[i32], name: &str, out: &Path) -> Result<()> {
    let path = out.join(format!("{name}.png"));
    let colors = label_colors(object);
    write_scene_preview(&planted.scene, &colors, &[], name, UpAxis::PlusZ, &path)?;
    println!("wrote {}", path.display());
    Ok(())
}
