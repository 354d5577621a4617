//! Whether labels depend on how a scene lies: random poses of a scene against the scene itself.

use crate::reader::{Read, ReadError, Reader};
use scenesplat::calibration::Calibration;
use scenesplat::evaluation::{Evaluation, EvaluationError, EvaluationSettings};
use scenesplat::kernels::random::{direction, sample_rng, unit};
use scenesplat::labels::Agreement;
use scenesplat::recognition::{KNOWN, Recognition};
use scenesplat::scene::vector::{dot, rotation};
use scenesplat::scene::{GaussianScene, Similarity, StatedUp, TextTable, Up};
use scenesplat::{Alignment, AlignmentSettings, embedded};

/// Why a scene could not be labeled.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PoseError {
    /// It could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The features have no labels.
    #[error(transparent)]
    Labels(#[from] EvaluationError),
}

type Result<T> = std::result::Result<T, PoseError>;

/// Smallest and largest unit of a pose, and how far it is moved.
const UNITS: [f64; 2] = [0.05, 20.0];
const FARTHEST: f64 = 1e6;

/// What one pose of a scene made of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseResult {
    /// Share of the Gaussians with the label that they have in the scene itself, 0..=1.
    pub same: f64,
    /// Degrees between the direction that was taken for up and the one of the scene itself.
    pub tilt: f64,
    /// Meters that were taken for one of the scene itself.
    pub unit: f64,
    /// Whether the program warns that up or unit is open.
    pub is_warned: bool,
}

/// The network inside the program, with labels as `segment` gives them.
pub struct Labeller {
    reader: Reader,
    texts: TextTable,
    calibration: Calibration,
    known: Recognition,
}

impl Labeller {
    /// Loads it.
    ///
    /// # Errors
    /// If the program was built with broken files.
    pub fn embedded() -> Result<Self> {
        Ok(Self {
            reader: Reader::embedded()?,
            texts: embedded::vocabulary().map_err(ReadError::from)?.class_table(),
            calibration: Calibration::embedded().map_err(ReadError::from)?,
            known: Recognition::embedded().map_err(ReadError::from)?,
        })
    }

    /// Labels, −1 for what is strange, and how the scene was read.
    ///
    /// # Errors
    /// If the network refuses the scene.
    pub fn label(
        &self,
        scene: &GaussianScene,
        stated_up: StatedUp,
    ) -> Result<(Vec<i32>, Alignment)> {
        let settings = AlignmentSettings { stated_up, ..AlignmentSettings::default() };
        let alignment = self.reader.alignment(scene, &settings)?;
        let Read { features, surfaces, squareness } = self.reader.read(scene, alignment.clone())?;
        let agreement = Agreement {
            temperature: Some(self.calibration.temperature),
            surfaces: Some(&surfaces),
            least_area: &self.calibration.least_area(&self.texts.names),
            ..Agreement::default()
        };
        let evaluation = Evaluation::new(&self.texts, EvaluationSettings::default())?;
        let mut labels = evaluation.label_agreeing(&features, false, &agreement)?;
        let known = self.known.of(&features, Some(surfaces.largest()), squareness);
        if let Some(known) = known.map_err(ReadError::from)? {
            let strange = known.strange(KNOWN);
            labels.iter_mut().zip(strange).filter(|(_, is)| *is).for_each(|(label, _)| *label = -1);
        }
        Ok((labels, alignment))
    }
}

/// A random pose: any rotation, and, if `any_unit`, any scale of 0.05 to 20 and a place up to 10⁶ away.
pub fn random_pose(seed: u64, number: u64, any_unit: bool) -> Similarity {
    let mut rng = sample_rng(seed, number, 0);
    // A uniform turn: a uniform point on the sphere of quaternions, by two angles and a share.
    let share = unit(&mut rng);
    let [a, b] = [0; 2].map(|_| std::f64::consts::TAU * unit(&mut rng));
    let (s, c) = ((1.0 - share).sqrt(), share.sqrt());
    let turn = rotation([c * b.cos(), s * a.sin(), s * a.cos(), c * b.sin()]);
    let [low, high] = UNITS.map(f64::ln);
    let scale = if any_unit { (low + (high - low) * unit(&mut rng)).exp() } else { 1.0 };
    let away = if any_unit { FARTHEST * unit(&mut rng) } else { 0.0 };
    let translation = direction(&mut rng).map(|v| away * v);
    Similarity { rotation: turn, scale, translation }
}

/// Labels a scene in `count` random poses. `told` is called after each.
///
/// A pose keeps its place in doubles: positions are relative to an origin, as readers make them.
///
/// # Errors
/// If the network refuses the scene.
pub fn poses(
    labeller: &Labeller,
    scene: &GaussianScene,
    stated_up: StatedUp,
    (seed, count): (u64, u64),
    any_unit: bool,
    mut told: impl FnMut(&PoseResult),
) -> Result<Vec<PoseResult>> {
    let (due, still) = labeller.label(scene, stated_up)?;
    let mut results = Vec::new();
    for number in 0..count {
        let pose = random_pose(seed, number, any_unit);
        let mut lying = scene.clone();
        lying.transform(&Similarity { translation: [0.0; 3], ..pose });
        lying.origin = pose.translation;
        let (labels, found) = labeller.label(&lying, stated_up)?;
        let same = labels.iter().zip(&due).filter(|(a, b)| a == b).count() as f64;
        let up = pose.rotation.map(|row| dot(row, still.turned_from.vector()));
        let result = PoseResult {
            same: same / due.len().max(1) as f64,
            tilt: Up::new(up).map_or(180.0, |up| up.degrees_from(found.turned_from)),
            unit: found.scale * pose.scale / still.scale,
            is_warned: found.remarks.iter().any(|remark| remark.is_warning()),
        };
        told(&result);
        results.push(result);
    }
    Ok(results)
}
