//! The table over many scenes, and its picture.

use crate::session::Session;
use crate::terminal::print;
use anyhow::{Context, Result, ensure};
use scenesplat::optimisation::curation::{SceneQuality, markdown};
use scenesplat::preview::write_png;
use scenesplat::scene::picture::RgbPicture;
use std::path::Path;

/// Sides of the picture, pixels, and what is left free around the plot.
const SIZE: [u32; 2] = [640, 400];
const MARGIN: u32 = 40;
const KEPT: [u8; 3] = [30, 120, 60];
const REJECTED: [u8; 3] = [190, 60, 50];
const FRAME: [u8; 3] = [120, 120, 120];

/// Reads the quality of each scene in a folder of folders and writes the table.
pub(super) fn write(session: &Session<'_>, folder: &Path) -> Result<()> {
    let mut places: Vec<_> = std::fs::read_dir(folder)
        .with_context(|| format!("--scenes {}", folder.display()))?
        .flatten()
        .map(|entry| entry.path().join("scene_quality.json"))
        .filter(|path| path.is_file())
        .collect();
    places.sort();
    ensure!(
        !places.is_empty(),
        "--scenes {}: no folder in it has a scene_quality.json; run curate --scene for each",
        folder.display()
    );
    let mut scenes: Vec<SceneQuality> = Vec::with_capacity(places.len());
    for path in &places {
        let named = || path.display().to_string();
        let text = std::fs::read_to_string(path).with_context(named)?;
        scenes.push(serde_json::from_str(&text).with_context(named)?);
    }
    let (table, mut text) = markdown(&scenes);
    let labelled = scenes.iter().filter(|s| s.miou.is_some() && s.psnr.is_some()).count();
    text += if labelled > 0 {
        "\nscenes.png: mIoU over PSNR, a square a scene; green ones are kept.\n"
    } else {
        "\nscenes.png: PSNR of the scenes in their order; green ones are kept. No scene has labels.\n"
    };
    print(&text);
    session.write_text("scenes.md", &text)?;
    session.write("scenes.png", |path| write_png(path, &picture(&scenes, labelled > 0)))?;
    session.progress.say(format!("{} of {} scenes are kept", table.kept, table.scenes));
    Ok(())
}

/// PSNR along x from 10 to 50 dB, mIoU along y from 0 to 1; without labels the number of the scene along x
/// and PSNR along y.
fn picture(scenes: &[SceneQuality], labelled: bool) -> RgbPicture {
    let [width, height] = SIZE;
    let mut picture = RgbPicture::filled(width, height, [255; 3]);
    for x in MARGIN..=width - MARGIN {
        picture.set(x, MARGIN, FRAME);
        picture.set(x, height - MARGIN, FRAME);
    }
    for y in MARGIN..=height - MARGIN {
        picture.set(MARGIN, y, FRAME);
        picture.set(width - MARGIN, y, FRAME);
    }
    let decibels = |psnr: f64| ((psnr - 10.0) / 40.0).clamp(0.0, 1.0);
    for (i, scene) in scenes.iter().enumerate() {
        let Some(psnr) = scene.psnr.filter(|p| p.is_finite()) else { continue };
        let [x, y] = match (labelled, scene.miou) {
            (true, Some(miou)) => [decibels(psnr), miou.clamp(0.0, 1.0)],
            (true, None) => continue,
            (false, _) => [(i as f64 + 0.5) / scenes.len() as f64, decibels(psnr)],
        };
        let color = if scene.keep { KEPT } else { REJECTED };
        let across = MARGIN + (x * f64::from(width - 2 * MARGIN)) as u32;
        let down = height - MARGIN - (y * f64::from(height - 2 * MARGIN)) as u32;
        for dy in 0..7 {
            for dx in 0..7 {
                picture.set((across + dx).saturating_sub(3), (down + dy).saturating_sub(3), color);
            }
        }
    }
    picture
}
