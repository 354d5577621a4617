//! Writes a synthetic room as PLY with previews in colors and in classes:
//! `cargo run --release --example synthetic_room -- 7 room 4000` writes `room.ply`, `room.png` and
//! `room.classes.png` of room 7, with 4000 Gaussians per square meter.

use anyhow::Context;
use scenesplat::preview::{
    LegendEntry, PreviewRows, PreviewSettings, UNLABELLED_COLOR, class_color, write_preview,
};
use scenesplat::rooms::{CLASSES, Group, SyntheticRoomSettings, generate};
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use std::path::Path;

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let room = args.next().context("which room?")?.parse()?;
    let name = args.next().context("which name for the files?")?;
    let gaussians_per_m2 = args.next().map_or(Ok(500.0), |d| d.parse())?;
    let settings = SyntheticRoomSettings { room, gaussians_per_m2, ..Default::default() };
    let room = generate(&settings)?;
    let scene = &room.scene;
    write_inria_ply(scene, &[], Path::new(&format!("{name}.ply")))?;

    let rows = 0..scene.len();
    let title = format!("{:?}, {} Gaussians, points: {}", room.kind, scene.len(), room.is_points);
    let settings = PreviewSettings { title, view_size: 1000, ..PreviewSettings::default() };
    // All of one size: what is where shows better than how it was captured. Not shown: floaters, the
    // ceiling, and walls that turn their back to the camera, which looks along +x +y.
    let radius = vec![0.6 / gaussians_per_m2.sqrt(); scene.len()];
    let segment = scene.segment.as_deref().context("labels")?;
    let normal = scene.normal.as_deref().context("normals")?;
    let is_shown = |row: usize| {
        let Ok(class) = usize::try_from(segment[row]) else { return false };
        let is_building = CLASSES[class].groups.contains(&Group::Structure);
        !is_building
            || normal[row][2].abs() < 0.5 && normal[row][0] + normal[row][1] < 0.3
            || CLASSES[class].name == "floor"
    };
    let opacity: Vec<f32> = rows.clone().map(|row| f32::from(u8::from(is_shown(row)))).collect();
    let colors: Vec<[u8; 3]> = rows.map(|row| scene.color_u8(row)).collect();
    let drawn = PreviewRows {
        coord: &scene.coord,
        color: &colors,
        radius: &radius,
        opacity: &opacity,
        shapes: None,
    };
    write_preview(Path::new(&format!("{name}.png")), &drawn, &[], &settings)?;

    let class_colors: Vec<[u8; 3]> = (segment.iter())
        .map(|&s| usize::try_from(s).map_or(UNLABELLED_COLOR, class_color))
        .collect();
    let count = |class| segment.iter().filter(|&&s| s == class as i32).count() as u64;
    let legend: Vec<LegendEntry> = (CLASSES.iter().enumerate())
        .map(|(i, c)| (c.name.to_owned(), class_color(i), count(i)))
        .filter(|&(_, _, count)| count > 0)
        .map(|(name, color, count)| LegendEntry { name, color, count })
        .collect();
    let drawn = PreviewRows { color: &class_colors, ..drawn };
    write_preview(Path::new(&format!("{name}.classes.png")), &drawn, &legend, &settings)?;
    Ok(())
}
