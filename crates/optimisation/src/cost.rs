//! What a run costs in time and memory, and which run a time allows.

use crate::frame::TrainingFrame;
use crate::settings::{OptimiseSettings, Strategy};

/// Time of a step, measured at two sizes of pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepCost {
    /// Gaussians it was measured with.
    pub gaussians: usize,
    /// Seconds of a step at full size.
    pub full: f64,
    /// Seconds of a step at half of width and height.
    pub half: f64,
}

/// Part of the pixels that half a size has.
const QUARTER: f64 = 0.25;
/// Steps below which a scene is not worth the name; a smaller one is drawn instead.
const ENOUGH: u64 = 5000;
/// Part of the time that is planned with: steps become slower while Gaussians become larger.
const PLANNED: f64 = 0.85;

impl StepCost {
    /// Seconds of a step: a part grows with pixels, one with Gaussians.
    pub fn of(&self, half: bool, gaussians: usize) -> f64 {
        let pixels = ((self.full - self.half) / (1.0 - QUARTER)).clamp(0.0, self.full);
        let rest = self.full - pixels;
        let share = gaussians as f64 / self.gaussians.max(1) as f64;
        let pixels = if half { QUARTER * pixels } else { pixels };
        pixels + rest * share
    }

    /// The settings that fit into `seconds`: the preset's numbers if they do, else fewer Gaussians, then
    /// pictures of half the size, then fewer steps. Gives them with the reason.
    pub fn fit(&self, settings: OptimiseSettings, seconds: f64) -> (OptimiseSettings, String) {
        let cap = cap_of(&settings).unwrap_or(self.gaussians);
        let caps = [cap, 500_000, 200_000, 100_000, 50_000].map(|c| c.min(cap).max(self.gaussians));
        let mut tried = Vec::new();
        for half in [false, true] {
            for cap in caps {
                // Between what it begins with and the cap.
                let mean = (self.gaussians + 3 * cap) / 4;
                let steps = (PLANNED * seconds / self.of(half, mean)) as u64;
                tried.push((half, cap, steps.clamp(1, settings.steps)));
            }
        }
        let enough = ENOUGH.min(settings.steps);
        let chosen = tried.iter().find(|t| t.2 >= enough).or(tried.last()).copied();
        let (half, cap, steps) = chosen.unwrap_or((true, cap, 1));
        let mut out = settings.with_steps(steps);
        set_cap(&mut out, cap);
        if half {
            out.half_steps = steps;
        }
        let text = format!(
            "{steps} steps of at most {cap} Gaussians at {} size: {:.3} s a step expected \
             (measured with {} Gaussians: {:.3} s, {:.3} s at half size)",
            if half { "half" } else { "full" },
            self.of(half, (self.gaussians + 3 * cap) / 4),
            self.gaussians,
            self.full,
            self.half
        );
        (out, text)
    }
}

/// The most Gaussians that settings allow; `None` if the number never changes.
pub fn cap_of(settings: &OptimiseSettings) -> Option<usize> {
    match &settings.strategy {
        Strategy::Mcmc(s) => Some(s.cap),
        Strategy::Default(s) => Some(s.cap),
        Strategy::Fixed => None,
    }
}

/// Sets the most Gaussians, where there is such a number.
pub fn set_cap(settings: &mut OptimiseSettings, cap: usize) {
    match &mut settings.strategy {
        Strategy::Mcmc(s) => s.cap = cap,
        Strategy::Default(s) => s.cap = cap,
        Strategy::Fixed => {}
    }
}

/// Bytes of a run, about: frames, and for each Gaussian parameters, two moments, a derivative, what is
/// drawn and its places in the lists of tiles; twice that while rows are added.
pub fn memory_of(settings: &OptimiseSettings, gaussians: usize, frames: &[TrainingFrame]) -> u64 {
    let harmonics = 3 * (u64::from(settings.initial.sh_degree) + 1).pow(2);
    let values = 11 + harmonics;
    let each = 4 * (4 * values + 4) + 88 + 10 * 60;
    let pixels = frames.iter().map(|f| f.view.pixels()).max().unwrap_or(0) as u64;
    let pictures: u64 = frames.iter().map(|f| f.bytes() as u64).sum();
    pictures + 120 * pixels + 2 * each * gaussians as u64
}

/// The most Gaussians that there may be after the next refinement of so many.
pub fn next_count(settings: &OptimiseSettings, gaussians: usize) -> usize {
    let grown = match &settings.strategy {
        Strategy::Mcmc(s) => s.grown(gaussians),
        // Each may be halved, and goes only when its halves are there.
        Strategy::Default(_) => 3 * gaussians,
        Strategy::Fixed => gaussians,
    };
    cap_of(settings).map_or(grown, |cap| grown.min(cap.max(gaussians)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_refinement_adds_a_twentieth_or_triples_up_to_the_cap() {
        let mut settings = OptimiseSettings::scenesplat();
        let Strategy::Mcmc(mcmc) = &mut settings.strategy else { panic!("not MCMC") };
        (mcmc.cap, mcmc.few) = (5000, 100);
        assert_eq!(
            [99, 1000, 4900, 6000].map(|n| next_count(&settings, n)),
            [198, 1050, 5000, 6000]
        );
        settings.strategy =
            Strategy::Default(crate::DefaultSettings { cap: 2500, ..Default::default() });
        assert_eq!([500, 1000].map(|n| next_count(&settings, n)), [1500, 2500]);
        settings.strategy = Strategy::Fixed;
        assert_eq!(next_count(&settings, 7), 7);
    }

    #[test]
    fn a_run_fits_its_time() {
        let cost = StepCost { gaussians: 100_000, full: 0.4, half: 0.1 };
        // All of it grows with pixels.
        assert!((cost.of(true, 1_000_000) - 0.1).abs() < 1e-12);
        let cost = StepCost { gaussians: 100_000, full: 0.4, half: 0.25 };
        // 0.2 s of pixels, 0.2 s of Gaussians.
        assert!((cost.of(false, 200_000) - 0.6).abs() < 1e-12);
        let preset = OptimiseSettings::scenesplat();
        let (day, _) = cost.fit(preset, 1e6);
        assert_eq!((day.steps, cap_of(&day), day.half_steps), (30_000, Some(1_500_000), 0));
        let (hour, text) = cost.fit(preset, 3600.0);
        assert!(hour.steps >= 5000 && cap_of(&hour) < Some(1_500_000), "{text}");
        let (minute, text) = cost.fit(preset, 60.0);
        assert!(minute.half_steps == minute.steps && minute.steps < 5000, "{text}");
        minute.check().unwrap();
    }

    #[test]
    fn a_gaussian_costs_at_least_what_is_stored_of_it() {
        let settings = OptimiseSettings::scenesplat();
        let harmonics = 3 * (u64::from(settings.initial.sh_degree) + 1).pow(2);
        // Place, rotation, sizes, opacity and harmonics: value, two moments, derivative, of four bytes each; twice while
        // rows are added.
        let each = (3 + 4 + 3 + 1 + harmonics) * 4 * 4 * 2;
        let more = memory_of(&settings, 2000, &[]) - memory_of(&settings, 1000, &[]);
        assert!((1000 * each..4000 * each).contains(&more), "{more} {each}");
        // And a frame at least its pixels.
        let frame = crate::frame::tests::frame(crate::frame::tests::view(64, 48), Some(1.0));
        let pictures = memory_of(&settings, 0, std::slice::from_ref(&frame));
        assert!(pictures >= 64 * 48 * (3 + 4), "{pictures}");
    }

    #[test]
    fn what_fits_is_tried_from_full_size_and_many_gaussians_down() {
        // 0.2 s of pixels, 0.2 s of 100,000 Gaussians; a mean is a quarter of these and three of the cap.
        let cost = StepCost { gaussians: 100_000, full: 0.4, half: 0.25 };
        let preset = OptimiseSettings::scenesplat();
        let fit = |seconds: f64| {
            let (s, text) = cost.fit(preset, seconds);
            ((s.steps, cap_of(&s).unwrap(), s.half_steps), text)
        };
        // 500,000: 0.2 + 0.8 s, 3060 steps. 200,000: 0.2 + 0.35 s, 0.85 · 3600 / 0.55 = 5563.6.
        let (chosen, text) = fit(3600.0);
        assert_eq!(chosen, (5563, 200_000, 0));
        let want = "5563 steps of at most 200000 Gaussians at full size: 0.550 s a step expected \
                    (measured with 100000 Gaussians: 0.400 s, 0.250 s at half size)";
        assert_eq!(text, want);
        // At full size 0.4 s are 3187 steps; at half 100,000 Gaussians take 0.25 s.
        let (chosen, text) = fit(1500.0);
        assert_eq!(chosen, (5100, 100_000, 5100));
        assert!(
            text.starts_with("5100 steps of at most 100000 Gaussians at half size: 0.250 s"),
            "{text}"
        );
        // 50,000 at least, but not fewer than there are: then fewer steps, one at least.
        assert_eq!((fit(60.0).0, fit(0.0).0), ((204, 100_000, 204), (1, 100_000, 1)));
        // A run that is short anyway is not made smaller for 5000 steps; its schedule is scaled.
        let short = preset.with_steps(3000);
        let (s, _) = cost.fit(short, 3600.0);
        assert_eq!((s.steps, cap_of(&s)), (3000, Some(500_000)));
        let (s, _) = cost.fit(OptimiseSettings { strategy: Strategy::Fixed, ..preset }, 3600.0);
        assert_eq!((s.steps, cap_of(&s), s.half_steps), (7650, None, 0));
        let mut doubling = OptimiseSettings::gsplat_default();
        set_cap(&mut doubling, 77);
        assert_eq!(cap_of(&doubling), Some(77));
        // A picture that is slower at half its size: all of it grows with Gaussians.
        let odd = StepCost { half: 0.5, ..cost };
        assert!((odd.of(true, 50_000) - 0.2).abs() < 1e-12);
        assert!((cost.of(true, 300_000) - (0.05 + 0.6)).abs() < 1e-12);
    }

    #[test]
    fn memory_is_of_frames_the_largest_picture_and_gaussians() {
        let mut settings = OptimiseSettings::scenesplat();
        settings.initial.sh_degree = 1;
        let frames = [(8, 4), (20, 10)]
            .map(|(w, h)| crate::frame::tests::frame(crate::frame::tests::view(w, h), None));
        // 11 + 12 values; 4 · (4 · 23 + 4) + 88 + 600 bytes each, twice. Frames of 96 and 600 bytes.
        assert_eq!(memory_of(&settings, 10, &frames), 96 + 600 + 120 * 200 + 2 * 1072 * 10);
    }
}
