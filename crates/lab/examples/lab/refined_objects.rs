//! Whether labels and objects that refine each other are better: f-mIoU and panoptic quality without and with, on rooms
//! that nothing was trained on and on a scene of a file.

use crate::Arguments;
use anyhow::{Context, Result};
use scenesplat::AlignmentSettings;
use scenesplat::calibration::Calibration;
use scenesplat::embedded;
use scenesplat::evaluation::{Evaluation, EvaluationSettings, background, classes_of_labels};
use scenesplat::input::open_input;
use scenesplat::labels::{Agreement, Classes, RefinedObjects, label_agreeing_with_vote};
use scenesplat::metrics::ZeroShotOptions;
use scenesplat::objects::{
    self, ObjectInput, ObjectSettings, PanopticQuality, RefineSettings, find_objects,
};
use scenesplat::prelude::*;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::label_set::read_names;
use scenesplat::scene::{ClassMap, LabelSet, ReadOptions, TextTable};
use scenesplat_lab::reader::{Read, Reader};
use std::path::Path;

/// None, and when an object is what it touches: `keep` and `part`.
const SETTINGS: [Option<[f64; 2]>; 6] = [
    None,
    Some([0.3, 0.5]),
    Some([0.5, 0.5]),
    Some([0.7, 0.5]),
    Some([0.9, 0.5]),
    Some([0.7, 0.2]),
];

/// Neighbors that vote, as in `segment`.
const VOTE_K: usize = 25;

/// What one setting gives over scenes.
struct Sums<'a> {
    refine: Option<RefineSettings>,
    evaluation: Evaluation<'a>,
    quality: PanopticQuality,
    found: usize,
    matches: usize,
    truth: usize,
}

pub fn run(mut args: Arguments) -> Result<()> {
    let (rooms, seed): (u64, u64) = (args.or(20)?, args.or(777)?);
    let (texts, reader) = (embedded::vocabulary()?.class_table(), Reader::embedded()?);
    let measure = Measure { texts: &texts, reader: &reader };
    let mut sums = measure.sums()?;
    for room in 0..rooms {
        let settings = SyntheticRoomSettings { seed, room, ..Default::default() };
        measure.add(&mut sums, &generate(&settings)?.scene)?;
    }
    println!("| scenes | keep | part | f-mIoU | right | objects | precision | recall | PQ |");
    println!("|---|---|---|---|---|---|---|---|---|");
    show("rooms", &sums)?;
    let Some(path) = args.word() else { return Ok(()) };
    let names: String = args.needed("which names have the labels?")?;
    let map: String = args.needed("which map of classes?")?;
    let names = read_names(Path::new(&names))?;
    let map = ClassMap::read(Path::new(&map))?;
    let class_of = classes_of_labels(&names, Some(&map), &texts.names)?;
    let mut scene = open_input(Path::new(&path), &ReadOptions::default())?.0.loaded.scene;
    let of =
        |label: i32| usize::try_from(label).ok().and_then(|label| class_of.get(label).copied());
    let segment = scene.segment.as_mut().context("the scene has labels")?;
    segment.iter_mut().for_each(|label| *label = of(*label).unwrap_or(-1));
    let mut sums = measure.sums()?;
    measure.add(&mut sums, &scene)?;
    show(&path, &sums)
}

/// What scenes are read with.
struct Measure<'a> {
    texts: &'a TextTable,
    reader: &'a Reader,
}

impl<'a> Measure<'a> {
    fn sums(&self) -> Result<Vec<Sums<'a>>> {
        let excluded = background(&LabelSet::new(self.texts.names.clone())?);
        let of = |refine: &Option<[f64; 2]>| -> Result<Sums<'a>> {
            let settings = EvaluationSettings { excluded: excluded.clone(), ..Default::default() };
            Ok(Sums {
                refine: refine.map(|[keep, part]| RefineSettings { keep, part }),
                evaluation: Evaluation::new(self.texts, settings)?,
                quality: PanopticQuality::default(),
                found: 0,
                matches: 0,
                truth: 0,
            })
        };
        SETTINGS.iter().map(of).collect()
    }

    /// Adds a scene whose labels are classes; instances without one are of no class.
    fn add(&self, sums: &mut [Sums<'a>], scene: &GaussianScene) -> Result<()> {
        let truth = scene.segment.as_deref().context("the scene has labels")?;
        let ids = scene.instance.as_deref().context("the scene has instances")?;
        let ids: Vec<i32> =
            ids.iter().zip(truth).map(|(id, label)| if *label < 0 { -1 } else { *id }).collect();
        let calibration = Calibration::embedded()?;
        let least_area = calibration.least_area(&self.texts.names);
        let alignment = self.reader.alignment(scene, &AlignmentSettings::default())?;
        let (upright, metres_per_unit) = (alignment.upright(), alignment.scale);
        let Read { features, surfaces, .. } = self.reader.read(scene, alignment)?;
        let (names, coord) = (self.texts.names.as_slice(), scene.coord.as_slice());
        for sums in sums {
            let objects = sums.refine.map(|settings| RefinedObjects {
                scene,
                names,
                upright,
                metres_per_unit,
                settings,
            });
            let agreement = Agreement {
                surfaces: Some(&surfaces),
                temperature: Some(calibration.temperature),
                min_probability: None,
                least_area: &least_area,
                objects,
            };
            let labels = sums.evaluation.label_agreeing(&features, false, &agreement)?;
            let scored = sums.evaluation.truth(scene, None)?;
            sums.evaluation.add_labels(&scored, labels)?;
            let (texts, options) = (Classes::Texts(self.texts), ZeroShotOptions::default());
            let voted =
                label_agreeing_with_vote(&features, texts, &options, &agreement, coord, VOTE_K)?;
            let input = ObjectInput {
                scene,
                labels: &voted.labels,
                scores: None,
                instances: None,
                features: None,
                names,
                upright,
                metres_per_unit,
                floor: None,
            };
            let settings = ObjectSettings::default();
            let found = find_objects(&input, &settings)?;
            let agreed = objects::Agreement::of(&found, &ids, truth, settings.min_count);
            sums.quality.add(&agreed, &found, &ids, truth);
            sums.found += agreed.found;
            sums.matches += agreed.matches.len();
            sums.truth += agreed.truth;
        }
        Ok(())
    }
}

fn show(name: &str, sums: &[Sums<'_>]) -> Result<()> {
    for sums in sums {
        let model = sums.evaluation.report().model.context("labels were scored")?;
        let percent = |share: Option<f64>| 100.0 * share.unwrap_or(f64::NAN);
        let share = |of: usize| 100.0 * sums.matches as f64 / of.max(1) as f64;
        let [keep, part] = sums.refine.map_or(["off".to_owned(), String::new()], |settings| {
            [settings.keep, settings.part].map(|value| value.to_string())
        });
        println!(
            "| {name} | {keep} | {part} | {:.2} | {:.2} | {} of {} | {:.1} | {:.1} | {:.2} |",
            percent(model.foreground_mean_iou),
            percent(model.all_accuracy),
            sums.found,
            sums.truth,
            share(sums.found),
            share(sums.truth),
            percent(sums.quality.mean()),
        );
    }
    Ok(())
}
