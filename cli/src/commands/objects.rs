//! `scenesplat objects`

mod edit;

use super::answer::{certainty, short};
use super::labelled::{LabelArgs, Labelled};
use super::meant::Asking;
use crate::error::refuse;
use crate::flags::Shared;
use crate::frame::{Frame, frame};
use crate::log;
use crate::session::Session;
use crate::terminal::print;
use anyhow::{Context, Result};
use edit::Edit;
use scenesplat::object_picture;
use scenesplat::objects::colliders::{
    ColliderSettings, Colliders, REACH, colliders, colliders_glb,
};
use scenesplat::objects::{Catalogue, Floor, Object, ObjectInput, boxes, is_building, table};
use scenesplat::phrases::shortened;
use scenesplat::preview::write_png;
use scenesplat::scene::formats::inria_ply::write_inria_ply;
use scenesplat::scene::{AtomicFile, GaussianScene, printable_text};
use std::path::PathBuf;

/// Lists the objects of a scene: class, score, Gaussians, box, volume, place, distance from the walls, height over the
/// floor. Writes objects.json, objects.csv, objects.md, instances.npy (the object of each Gaussian from 0, −1 = none),
/// objects.png (numbered boxes) and a receipt.
///
/// Labels are those that segment gives, or with --label-names those that the scene carries. Instances that the scene
/// carries are its objects; else pieces of one class that hang together in space and feature are (docs/objects.md).
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// Where labels come from.
    #[command(flatten)]
    pub labels: LabelArgs,
    /// Also writes the table as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Also writes each object as a PLY file into the folder DIR of the output folder.
    #[arg(long, value_name = "DIR")]
    pub export: Option<String>,
    /// Also writes boxes.json: the boxes in the form of COCO's files, with the 3D fields of Omni3D and ScanNet (docs/objects.md).
    #[arg(long)]
    pub boxes: bool,
    /// Also writes colliders.glb, a mesh for each object, floor and walls among them: the surface of the cubes, this wide in
    /// meters, that its Gaussians touch.
    #[arg(
        long,
        value_name = "METERS",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "0.05",
        value_parser = parse_cell
    )]
    pub colliders: Option<f64>,
    /// Also writes edited.ply without the objects of these classes, or that a phrase such as "lamp on the desk" or "not a
    /// wall" means, comma-separated; and edited.png, which shows what they leave open.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', conflicts_with = "keep")]
    pub remove: Vec<String>,
    /// Closes what removed objects leave open in the floor, the walls and the ceiling by copies of the Gaussians beside.
    #[arg(long, requires = "remove")]
    pub fill: bool,
    /// Also writes edited.ply with nothing but the objects of these classes or phrases.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub keep: Vec<String>,
    /// Prints the objects that a phrase means, such as "lamp on the desk" (on, above, under, in, near) or "everything except
    /// the walls".
    #[arg(long, value_name = "PHRASE")]
    pub find: Option<String>,
    /// Flags of all commands.
    #[command(flatten)]
    pub shared: Shared,
}

/// Things that are printed; of more it says how many.
const MOST_OBJECTS: usize = 5;

/// What every catalogue is written as.
pub const OBJECT_FILES: [&str; 3] = ["instances.npy", "objects.json", "objects.csv"];

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let labels = &args.labels.settled()?;
    let inference = &labels.labelling.inference;
    let session = Session::start_network(&args.shared, inference, None, line)?;
    labels.claim_inputs(&session)?;
    session.outputs.claim_any("--json", args.json.as_ref())?;
    let folder =
        args.export.as_deref().map(|name| check_folder(name).map(|()| name)).transpose()?;
    let edits = !args.remove.is_empty() || !args.keep.is_empty();
    let mut more = Vec::new();
    more.extend(edits.then_some("edited.ply"));
    more.extend((!args.remove.is_empty()).then_some("edited.png"));
    more.extend(args.colliders.map(|_| "colliders.glb"));
    more.extend(args.boxes.then_some("boxes.json"));
    session
        .outputs
        .open_folder(&[&OBJECT_FILES[..], &["objects.md", "objects.png"], &more].concat())?;
    let labelled = labels.label(&session, edits || folder.is_some())?;
    let frame = frame(&session, &labelled.opened, inference);
    let found = labelled.objects(&session, &labels.settings(), labels.pieces, frame)?;
    session.check_stop()?;
    let is_quiet = args.shared.running.quiet;
    if !is_quiet {
        print(&summary(&found));
        match log::is_verbose() {
            true => print(&table::markdown(&found)),
            false => largest(&found).iter().for_each(|line| print(line)),
        }
        certainty(&session).iter().for_each(|text| session.tell(text));
    }
    let asking = Asking { session: &session, found: &found, labels: &labelled.names };
    if let Some(phrase) = &args.find {
        print(&answer(&asking, phrase)?);
    }
    write_objects(&session, &labelled, &found)?;
    if let Some(path) = &args.json {
        session
            .write_file(path, &serde_json::to_string_pretty(&json(&session, &labelled, &found))?)?;
    }
    {
        let _stage = session.receipt.stage("picture");
        let picture = object_picture(&labelled.opened.loaded.scene, &found, frame.up)?;
        session.write("objects.png", |path| write_png(path, &picture))?;
    }
    let _stage = session.receipt.stage("write");
    session.write_text("objects.md", &table::markdown(&found))?;
    write_forms(args, &session, &labelled, frame, &found)?;
    let scene = with_instances(&labelled, &found);
    if let Some(folder) = folder {
        export(&session, &scene, &found, folder)?;
    }
    if edits {
        Edit { args, asking: &asking, labelled: &labelled, frame }.write(&scene)?;
    }
    session.receipt.add_rows_out(scene.len());
    drop(_stage);
    session.finish()
}

/// The largest things, without what the room itself is made of; a line each, and how many more there are.
fn largest(found: &Catalogue) -> Vec<String> {
    let mut things: Vec<&Object> =
        found.objects.iter().filter(|o| !is_building(&o.class)).collect();
    things.sort_by(|a, b| b.volume.total_cmp(&a.volume));
    let more = things.len().saturating_sub(MOST_OBJECTS);
    let line = |o: &&Object| {
        let ([l, w, h], [x, y, z]) = (o.bounds.size, o.position);
        format!(
            "{:>4}  {:20} {l:.2} x {w:.2} x {h:.2} m at {x:.2}, {y:.2}, {z:.2}",
            o.id,
            short(&o.class)
        )
    };
    let mut lines: Vec<String> = things.iter().take(MOST_OBJECTS).map(line).collect();
    if more > 0 {
        lines.push(format!("      and {more} more things in objects.md (--verbose prints all)"));
    }
    lines
}

/// One line: how many objects of which classes.
pub fn summary(found: &Catalogue) -> String {
    let counts = found.counts();
    let each: Vec<String> = counts
        .iter()
        .map(|(name, objects, _)| {
            let name: String = printable_text(name).chars().take(60).collect();
            format!("{objects} {name}")
        })
        .collect();
    let floor = match found.floor {
        Floor { is_given: true, .. } => "the floor that was given",
        Floor { is_labelled: true, .. } => "the floor",
        _ => "the lowest Gaussians",
    };
    format!(
        "{} objects{}: {}; {} labeled Gaussians in no object{}; heights are over {floor}",
        found.objects.len(),
        if found.is_carried { " (the instances that the scene carries)" } else { "" },
        if each.is_empty() { "none".to_owned() } else { each.join(", ") },
        found.left_over,
        left_out(found)
    )
}

/// Which instances of the scene are no objects; nothing if all are.
pub fn left_out(found: &Catalogue) -> String {
    let mut text = String::new();
    for (count, why) in [
        (found.small_instances, "too few Gaussians (--min-count)"),
        (found.nameless_instances, "no class"),
    ] {
        if count > 0 {
            text += &format!("; {count} instances of the scene are none, having {why}");
        }
    }
    text
}

/// Writes `OBJECT_FILES` into the output folder.
pub fn write_objects(session: &Session<'_>, labelled: &Labelled, found: &Catalogue) -> Result<()> {
    session.write_rows("instances.npy", &labelled.opened, &found.instances(), -1)?;
    let json = serde_json::to_string_pretty(&json(session, labelled, found))?;
    for (name, text) in [("objects.json", json), ("objects.csv", table::csv(found))] {
        session.write_text(name, &text)?;
    }
    Ok(())
}

/// The objects, where their labels and pieces come from, and what makes them doubtful.
pub fn json(session: &Session<'_>, labelled: &Labelled, found: &Catalogue) -> serde_json::Value {
    let mut json = table::json(found);
    json["labels_from"] = labelled.origin.name().into();
    json["warnings"] = session.doubts().into();
    json
}

/// Writes the objects in the forms of other programs that are asked for.
fn write_forms(
    args: &Args,
    session: &Session<'_>,
    labelled: &Labelled,
    frame: Frame,
    found: &Catalogue,
) -> Result<()> {
    if let Some(cell) = args.colliders {
        write_colliders(session, labelled, frame, found, cell)?;
    }
    if !args.boxes {
        return Ok(());
    }
    let name = labelled.opened.loaded.path.file_name().unwrap_or_default().to_string_lossy();
    let mut json = boxes::json(found, &labelled.input(frame), &name);
    json["info"]["labels_from"] = labelled.origin.name().into();
    json["info"]["warnings"] = session.doubts().into();
    session.write_text("boxes.json", &serde_json::to_string_pretty(&json)?)
}

fn parse_cell(text: &str) -> Result<f64, String> {
    let cell = text.parse().ok().filter(|cell| (0.005..=2.0).contains(cell));
    cell.ok_or_else(|| "expected the edge of cubes, 0.005 to 2 meters".to_owned())
}

fn write_colliders(
    session: &Session<'_>,
    labelled: &Labelled,
    frame: Frame,
    found: &Catalogue,
    cell: f64,
) -> Result<()> {
    let scene = &labelled.opened.loaded.scene;
    // Cubes lie along the walls.
    let input = ObjectInput { upright: frame.turn, ..labelled.input(frame) };
    let settings = ColliderSettings { cell, ..ColliderSettings::default() };
    let Colliders { hulls, faint, far, cut } = colliders(&input, found, &settings)?;
    let triangles: usize = hulls.iter().map(|hull| hull.triangles.len()).sum();
    let (of, objects) = (hulls.len(), found.objects.len());
    let mut text = format!(
        "colliders.glb: {of} of {objects} objects as cubes of {cell} m, {triangles} triangles; left out: {} labeled Gaussians in no \
         object, {faint} fainter than {}",
        found.left_over, settings.min_opacity
    );
    if far > 0 {
        text += &format!(", {far} too far away");
    }
    if cut > 0 {
        text += &format!("; {cut} wider than {REACH} m count as that");
    }
    print(&text);
    let file = colliders_glb(&hulls, scene.origin)
        .context("colliders.glb would exceed 4 GiB: give larger cubes, such as --colliders=0.1")?;
    session.write("colliders.glb", |path| AtomicFile::write(path, &file))
}

/// The scene with its labels, scores and objects in it.
fn with_instances(labelled: &Labelled, found: &Catalogue) -> GaussianScene {
    GaussianScene {
        segment: Some(labelled.labels.clone()),
        segment_score: labelled.scores.clone(),
        instance: Some(found.instances()),
        lang_feat: None,
        valid_feat_mask: None,
        ..labelled.opened.loaded.scene.clone()
    }
}

fn answer(asking: &Asking<'_>, phrase: &str) -> Result<String> {
    let (places, found) = (asking.meant(phrase)?, asking.found);
    let phrase = shortened(phrase);
    if places.is_empty() {
        return Ok(format!("{phrase:?}: none; {}", asking.there_are()));
    }
    let line = |&i: &usize| {
        let Object { id, class, position: [x, y, z], .. } = &found.objects[i];
        format!("{phrase:?}: {id} {} at {x:.2}, {y:.2}, {z:.2}", printable_text(class))
    };
    Ok(places.iter().map(line).collect::<Vec<_>>().join("\n"))
}

/// A folder of the output folder: one plain name.
fn check_folder(name: &str) -> Result<()> {
    let plain = !name.is_empty()
        && name.len() <= 100
        && !name.starts_with('.')
        && name.chars().all(|c| c.is_ascii_alphanumeric() || "._-".contains(c));
    if plain {
        return Ok(());
    }
    refuse!("--export {name:?}: give one plain name, such as objects; the folder is made in --out");
}

fn export(
    session: &Session<'_>,
    scene: &GaussianScene,
    found: &Catalogue,
    folder: &str,
) -> Result<()> {
    for object in &found.objects {
        let rows: Vec<usize> = object.rows.iter().map(|&r| r as usize).collect();
        let part = scene.select_rows(&rows)?;
        session.write(
            &format!("{folder}/{:03}-{}.ply", object.id, file_name(&object.class)),
            |path| write_inria_ply(&part, &[], path),
        )?;
        session.check_stop()?;
    }
    Ok(())
}

/// A class as a part of a file's name.
fn file_name(class: &str) -> String {
    let safe = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    let name: String = class.chars().take(40).map(safe).collect();
    let name = name.trim_matches('-').to_owned();
    if name.is_empty() { "object".to_owned() } else { name }
}
