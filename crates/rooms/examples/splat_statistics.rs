//! Shapes and opacities of the Gaussians of real scenes beside those of our rooms, as a table and as histograms:
//! `cargo run --release -p scenesplat-rooms --example splat_statistics -- histograms.png SCENE…`

use scenesplat_rooms::{Capture, SyntheticRoomSettings, generate};
use scenesplat_scene::formats::{ReadOptions, open_scene};
use scenesplat_scene::picture::RgbPicture;
use scenesplat_scene::vector::{dot, rotation};
use scenesplat_scene::{AtomicFile, GaussianScene};
use std::collections::BTreeMap;
use std::path::Path;

/// What is counted, the range of its histogram.
const KINDS: [(&str, [f64; 2]); 5] = [
    ("largest / smallest size, log10", [0.0, 3.5]),
    ("middle / largest size", [0.0, 1.0]),
    ("opacity", [0.0, 1.0]),
    ("largest size / spacing, log10", [-1.5, 1.5]),
    ("normal against its neighborhood's, cosine", [0.0, 1.0]),
];
const BINS: usize = 48;
/// Rooms of each kind.
const ROOMS: u64 = 12;

type Values = [Vec<f64>; 5];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let picture = args.next().ok_or("which picture?")?;
    let mut all: Vec<(String, Values)> = Vec::new();
    for file in args {
        let scene = open_scene(Path::new(&file), &ReadOptions::default())?.scene;
        let name =
            Path::new(&file).file_name().map_or(file.clone(), |n| n.to_string_lossy().into());
        let mut values = Values::default();
        add(&scene, &mut values);
        all.push((name, values));
    }
    for (name, capture, seen_share) in [
        ("made", Capture::Made, 0.0),
        ("scan", Capture::Scan, 0.0),
        ("scan, walked", Capture::Scan, 1.0),
    ] {
        let mut values = Values::default();
        for room in 0..ROOMS {
            let settings = SyntheticRoomSettings {
                room,
                capture,
                seen_share,
                points_share: 0.0,
                ..SyntheticRoomSettings::default()
            };
            add(&generate(&settings)?.scene, &mut values);
        }
        all.push((format!("ours: {name}"), values));
    }
    for (_, values) in &mut all {
        values.iter_mut().for_each(|values| values.sort_by(f64::total_cmp));
    }
    for (kind, (what, _)) in KINDS.iter().enumerate() {
        println!("{what}: 5, 25, 50, 75, 95 %");
        for (name, values) in &all {
            let values = &values[kind];
            let at = |share: f64| values.get((values.len() as f64 * share) as usize).copied();
            let row = [0.05, 0.25, 0.5, 0.75, 0.95].map(|share| at(share).unwrap_or(f64::NAN));
            println!("  {name}: {row:.2?}");
        }
    }
    AtomicFile::write(Path::new(&picture), &draw(&all).encode_png()?)?;
    Ok(())
}

/// The rows of a scene, each in a cell of the size of some neighbors.
fn add(scene: &GaussianScene, values: &mut Values) {
    let sorted = |row: usize| {
        let mut s = scene.scale(row).map(f64::from);
        s.sort_by(f64::total_cmp);
        s
    };
    let mut largest: Vec<f64> = (0..scene.len()).map(|row| sorted(row)[2]).collect();
    largest.sort_by(f64::total_cmp);
    let Some(&usual) = largest.get(largest.len() / 2) else { return };
    let cell = 8.0 * usual;
    let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for row in 0..scene.len() {
        let key = scene.coord[row].map(|v| (f64::from(v) / cell).floor() as i64);
        cells.entry(key).or_default().push(row);
    }
    for rows in cells.values() {
        // As if each cell held a plane of its own width.
        let spacing = cell / (rows.len() as f64).sqrt();
        let normals: Vec<[f64; 3]> = rows.iter().map(|&row| smallest_axis(scene, row)).collect();
        let mean = common(&normals);
        for (&row, normal) in rows.iter().zip(&normals) {
            let [low, middle, high] = sorted(row);
            values[0].push((high / low.max(1e-9)).log10());
            values[1].push(middle / high);
            values[2].push(f64::from(scene.opacity(row)));
            values[3].push((high / spacing).log10());
            if rows.len() >= 8 {
                values[4].push(dot(*normal, mean).abs());
            }
        }
    }
}

/// The direction of the smallest size.
fn smallest_axis(scene: &GaussianScene, row: usize) -> [f64; 3] {
    let s = scene.log_scale[row];
    let axis = (1..3).fold(0, |best, i| if s[i] < s[best] { i } else { best });
    let q = scene.quat[row].map(f64::from);
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-12);
    rotation(q.map(|v| v / norm)).map(|row| row[axis])
}

/// The mean of directions without a sign, by a few turns toward the half that each is in.
fn common(normals: &[[f64; 3]]) -> [f64; 3] {
    let mut mean = normals[0];
    for _ in 0..4 {
        let mut sum = [0.0; 3];
        for n in normals {
            let sign = dot(*n, mean).signum();
            (0..3).for_each(|i| sum[i] += sign * n[i]);
        }
        let norm = sum.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-12);
        mean = sum.map(|v| v / norm);
    }
    mean
}

/// A row for each scene, a column for each thing that is counted.
fn draw(all: &[(String, Values)]) -> RgbPicture {
    let (wide, high, gap) = (4 * BINS as u32, 70, 12);
    let size = [(wide + gap) * KINDS.len() as u32 + gap, (high + gap) * all.len() as u32 + gap];
    let mut picture = RgbPicture::filled(size[0], size[1], [255; 3]);
    for (row, (name, values)) in all.iter().enumerate() {
        let color = if name.starts_with("ours") { [200, 90, 40] } else { [50, 90, 160] };
        for (column, (_, [from, to])) in KINDS.iter().enumerate() {
            let mut counts = [0_usize; BINS];
            for value in &values[column] {
                let at = (value - from) / (to - from) * BINS as f64;
                counts[(at.max(0.0) as usize).min(BINS - 1)] += 1;
            }
            let most = counts.iter().copied().max().unwrap_or(0).max(1);
            let [left, top] = [gap + column as u32 * (wide + gap), gap + row as u32 * (high + gap)];
            for x in 0..wide {
                let count = counts[x as usize / 4];
                let bar = (count as f64 / most as f64 * f64::from(high)).round() as u32;
                for y in 0..high {
                    let is_bar = high - y <= bar;
                    picture.set(left + x, top + y, if is_bar { color } else { [242; 3] });
                }
            }
        }
    }
    picture
}
