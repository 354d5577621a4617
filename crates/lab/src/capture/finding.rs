//! Evidence for effects, from pictures.

use super::frame::FrameFigures;
use scenesplat_datasets::effects::MOST_SEVERE;
use std::fmt;

/// A number with its unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    /// What it is.
    pub name: &'static str,
    /// Its value, finite.
    pub value: f64,
    /// Its unit; empty for a plain number.
    pub unit: &'static str,
}

/// Whether pictures show an effect, and how strong.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureFinding {
    /// `blur`, `light`, `noise`, `saturation`, `coverage`.
    pub effect: &'static str,
    /// What is compared with the threshold; the same scale as the severity. `None`: the pictures do not say.
    pub measure: Option<f64>,
    /// Below it there is no effect.
    pub threshold: f64,
    /// 0 (absent) to 5.
    pub severity: f64,
    /// What it rests on.
    pub figures: Vec<Figure>,
}

impl CaptureFinding {
    pub(super) fn new(
        effect: &'static str,
        measure: Option<f64>,
        threshold: f64,
        figures: Vec<Figure>,
    ) -> Self {
        let severity = measure.filter(|m| *m >= threshold).map_or(0.0, |m| m.min(MOST_SEVERE));
        Self { effect, measure, threshold, severity, figures }
    }

    /// Whether the effect is there.
    pub fn is_present(&self) -> bool {
        self.severity > 0.0
    }
}

impl fmt::Display for CaptureFinding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.measure {
            None => write!(f, "{}: the pictures do not say", self.effect)?,
            Some(_) if self.is_present() => {
                write!(f, "{}: severity {:.1}", self.effect, self.severity)?;
            }
            Some(measure) => {
                write!(f, "{}: absent ({measure:.2} below {})", self.effect, self.threshold)?;
            }
        }
        for figure in &self.figures {
            let space = if figure.unit.is_empty() { "" } else { " " };
            write!(f, "; {} {:.3}{space}{}", figure.name, figure.value, figure.unit)?;
        }
        Ok(())
    }
}

/// What is known of one photo.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameEvidence {
    /// Of its camera.
    pub name: String,
    /// What it says by itself.
    pub figures: FrameFigures,
    /// Its sharpness over that of the scene's own picture from there, over the same of the sharpest fifth of
    /// the photos: 1 sharp, 0 all blurred. `None` where the scene's picture shows nothing sharp.
    pub sharpness_share: Option<f64>,
    /// How much more of one direction's fine detail it lacks than of another's, against the scene's own picture
    /// from there, natural logarithm: motion blur. 0 = none; `None` where there is too little detail or
    /// too much noise to tell.
    pub motion: Option<f64>,
    /// What its linear red, green and blue have to be divided by to be like the median photo's; `None` where
    /// too little of it shows the scene.
    pub gain: Option<[f64; 3]>,
}

/// What the pictures of a capture say.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureReport {
    /// One for each picture, in the order in which they were added.
    pub frames: Vec<FrameEvidence>,
    /// One for each effect that was looked for.
    pub findings: Vec<CaptureFinding>,
}

/// Motion below which a picture is as good as any: detail lacking along it, nat.
const HARMLESS_MOTION: f64 = 0.23;
/// Least weight of a picture: it may be the only one that shows something.
const LEAST_WEIGHT: f64 = 0.05;

/// How much a picture's labels should count, above 0 and at most 1, by the detail that it lacks along its
/// motion ([`FrameEvidence::motion`]): the part of it that is left. 1 where that is not known.
pub fn frame_weight(motion: Option<f64>) -> f32 {
    let excess = motion.map_or(0.0, |motion| (motion - HARMLESS_MOTION).max(0.0));
    (-excess).exp().max(LEAST_WEIGHT) as f32
}

impl CaptureReport {
    /// The weight of each picture's labels: 1 for all where no blur was found.
    pub fn frame_weights(&self) -> Vec<f32> {
        let blurred = self.finding("blur").is_some_and(CaptureFinding::is_present);
        self.frames.iter().map(|f| frame_weight(f.motion.filter(|_| blurred))).collect()
    }

    /// The finding about an effect.
    pub fn finding(&self, effect: &str) -> Option<&CaptureFinding> {
        self.findings.iter().find(|finding| finding.effect == effect)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_fall_with_motion_and_stay_above_nothing() {
        assert_eq!([None, Some(0.0), Some(0.2)].map(frame_weight), [1.0; 3]);
        assert!((frame_weight(Some(0.23 + 0.5f64.recip().ln())) - 0.5).abs() < 1e-6);
        assert_eq!(frame_weight(Some(99.0)), 0.05);
        let frame = |motion| FrameEvidence {
            name: String::new(),
            figures: FrameFigures::default(),
            sharpness_share: None,
            motion,
            gain: None,
        };
        let report = |measure| CaptureReport {
            frames: vec![frame(Some(3.0)), frame(None)],
            findings: vec![CaptureFinding::new("blur", measure, 0.75, Vec::new())],
        };
        // One picture that lacks something is no blurred capture.
        assert_eq!(report(Some(0.5)).frame_weights(), [1.0, 1.0]);
        let weights = report(Some(2.0)).frame_weights();
        assert!(weights[0] < 0.1 && weights[1] == 1.0);
    }
}
