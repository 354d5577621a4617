//! Writing streamed scenes: several levels of detail in chunks, and the tree that names them.

use super::LOD_META_NAME;
use super::folder::FolderWriter;
use super::levels::{Leaf, leaves};
use super::ticker::Ticker;
use super::writer::{Order, encode};
use crate::formats::{SceneFormat, WriteOptions, WriteProgress, WriteReport};
use crate::{GaussianScene, SceneError};
use serde_json::{Map, Value, json};
use std::path::Path;

/// Most rows of a chunk, as in the program of the format's authors.
const CHUNK_ROWS: usize = 1 << 19;

/// The leaves of one chunk of one level, and their rows one after the other.
struct Chunk {
    leaves: Vec<(usize, Vec<u32>, f64)>,
    rows: usize,
}

/// Writes a scene as a streamed one: `path`, which is its `lod-meta.json`, and folders
/// `<level>_<number>` of textures beside it.
///
/// Level 0 is the whole scene; each further level has a quarter of the Gaussians of each leaf, those
/// that cover the most, grown to cover what all did (at most to twice the size). Values are as those
/// of [`write_sog`](super::write_sog), chunk by chunk. The files appear together when all are
/// complete; chunks of the scene that was there before are removed.
///
/// # Errors
/// As [`write_scene`](super::super::write_scene); also if `options.lod_levels` is not 1 to 8.
pub(in crate::formats) fn write_sog_streamed(
    scene: &GaussianScene,
    path: &Path,
    options: &WriteOptions,
    report: &mut WriteReport,
    progress: WriteProgress<'_>,
) -> Result<(), SceneError> {
    let levels = options.lod_levels;
    if !(1..=8).contains(&levels) {
        let problem = format!("cannot have {levels} levels of detail");
        return Err(SceneError::format(path, problem, "ask for 1 to 8"));
    }
    let mut ticker = Ticker::new(progress);
    let mut folder = FolderWriter::create(path)?;
    let (root, leaves) = leaves(scene);
    ticker.tick(0.05)?;
    let bounds: Vec<[[f64; 3]; 2]> = leaves.iter().map(|leaf| leaf.bound(scene)).collect();
    let mut lods = vec![Map::new(); leaves.len()];
    let (mut names, mut counts, mut order) = (Vec::new(), Vec::new(), Vec::new());
    for level in 0..levels {
        let chunks = chunks(scene, &leaves, level);
        let share = |chunk: usize| {
            let done = chunk as f64 / chunks.len() as f64;
            0.05 + 0.9 * (f64::from(level) + done) / f64::from(levels)
        };
        let mut count = 0;
        for (number, chunk) in chunks.iter().enumerate() {
            let name = format!("{level}_{number}");
            let file = names.len();
            let mut offset = 0;
            for (leaf, rows, _) in &chunk.leaves {
                let run = json!({ "file": file, "offset": offset, "count": rows.len() });
                lods[*leaf].insert(level.to_string(), run);
                offset += rows.len();
            }
            let (part, rows) = part_of(scene, chunk)?;
            let mut about = WriteReport::new(SceneFormat::SogStreamed, part.len());
            let mut ticker = ticker.part(share(number), share(number + 1));
            encode(&part, path, Order::Kept, &mut about, &mut ticker, &mut |texture, bytes| {
                folder.write(&format!("{name}/{texture}"), bytes)
            })?;
            if level == 0 {
                report.add_part(&about, &rows);
                order.extend(rows);
            }
            names.push(format!("{name}/meta.json"));
            count += part.len();
        }
        counts.push(count);
    }
    let lods: Vec<Value> = lods.into_iter().map(Value::Object).collect();
    let meta = json!({
        "version": 1,
        "count": scene.len(),
        "counts": counts,
        "lodLevels": levels,
        "environment": null,
        "filenames": names,
        "tree": root.to_json(&bounds, &lods),
    });
    let own_name = path.file_name().and_then(|name| name.to_str()).unwrap_or(LOD_META_NAME);
    folder.write(own_name, meta.to_string().as_bytes())?;
    ticker.tick(0.99)?;
    folder.commit(options.overwrite, report)?;
    let in_order = order.iter().enumerate().all(|(place, &row)| place == row as usize);
    report.order = (!in_order).then_some(order);
    for (field, is_there) in [
        ("segment", scene.segment.is_some()),
        ("segment_score", scene.segment_score.is_some()),
        ("instance", scene.instance.is_some()),
        ("lang_code", scene.lang_code.is_some()),
    ] {
        if is_there {
            report.left_out(field, "no place in a streamed scene");
        }
    }
    Ok(())
}

/// The leaves of a level in as many chunks as are needed.
fn chunks(scene: &GaussianScene, leaves: &[Leaf], level: u8) -> Vec<Chunk> {
    let mut chunks: Vec<Chunk> = Vec::new();
    for (number, leaf) in leaves.iter().enumerate() {
        let (rows, growth) = leaf.at_level(scene, level);
        let count = rows.len();
        match chunks.last_mut().filter(|chunk| chunk.rows + count <= CHUNK_ROWS) {
            Some(chunk) => {
                chunk.leaves.push((number, rows, growth));
                chunk.rows += count;
            }
            None => chunks.push(Chunk { leaves: vec![(number, rows, growth)], rows: count }),
        }
    }
    chunks
}

/// The Gaussians of a chunk, and their rows.
fn part_of(scene: &GaussianScene, chunk: &Chunk) -> Result<(GaussianScene, Vec<u32>), SceneError> {
    let rows: Vec<u32> =
        chunk.leaves.iter().flat_map(|(_, rows, _)| rows.iter().copied()).collect();
    let wanted: Vec<usize> = rows.iter().map(|&row| row as usize).collect();
    let mut part = scene.select_rows(&wanted)?;
    // Labels have no place, and would make each chunk larger for nothing.
    (part.segment, part.segment_score, part.instance, part.lang_code) = (None, None, None, None);
    part.extra.clear();
    let mut at = 0;
    for (_, rows, growth) in &chunk.leaves {
        let add = growth.ln() as f32;
        if add > 0.0 {
            part.log_scale[at..at + rows.len()].iter_mut().flatten().for_each(|s| *s += add);
        }
        at += rows.len();
    }
    Ok((part, rows))
}
