//! An inspection as lines of text.

use super::unit::short;
use super::{Distribution, Estimate, Finding, Inspection, Quantiles};
use crate::memory::Bytes;
use std::fmt;

/// Widest line of the messages.
const LINE: usize = 96;
/// Findings of the summary; of more it says how many.
const MOST_FINDINGS: usize = 3;

impl Inspection {
    /// The figures, one line each: what it is and its value.
    pub(super) fn figures(&self) -> Vec<(&'static str, String)> {
        let left_out = match self.dropped {
            0 => String::new(),
            n => format!(", {} left out", thousands(n)),
        };
        let of_all = (self.bounds != self.robust_bounds).then(|| self.bounds.extent());
        let b = self.robust_bounds;
        let centre = [0, 1, 2].map(|a| short((b.low[a] + b.high[a]) / 2.0)).join(", ");
        let unit = match (&self.sized, &self.unit) {
            (Some(sized), _) => {
                Some(format!("{} m, {}", short(sized.metres), sure(sized.confidence)))
            }
            (None, unit) => {
                unit.as_ref().map(|u| format!("{}, {}", u.unit.symbol(), sure(u.confidence)))
            }
        };
        let up = &self.up;
        let how = if up.given { "as given".to_owned() } else { sure(up.confidence) };
        let harmonics = match (self.sh_degree, self.sh_degree_used) {
            (declared, used) if declared == used => format!("degree {declared}"),
            (declared, used) => format!("degree {declared} declared, {used} used"),
        };
        let gaussians = format!("{} ({}){left_out}", thousands(self.gaussians), self.format);
        let rows = [
            ("Gaussians", Some(gaussians)),
            ("extent", Some(format!("{} m", sides(self.extent)))),
            ("all of it", of_all.map(|extent| format!("{} m", sides(extent)))),
            ("center", Some(centre)),
            ("relative to", self.origin.map(|[x, y, z]| format!("{x}, {y}, {z}"))),
            ("unit", unit),
            ("up", Some(format!("{}, {how}", up.direction))),
            ("spacing", self.spacing.map(|s| format!("{} m to the 4th neighbor", short(s)))),
            ("scale", Some(five(&self.largest_scale, " m"))),
            ("anisotropy", Some(five(&self.anisotropy, ""))),
            ("opacity", Some(five(&self.opacity, ""))),
            ("harmonics", Some(harmonics)),
            ("also", self.more()),
            ("voxels", Some(self.voxel_figures())),
            ("cost", self.estimate.as_ref().map(cost)),
        ];
        rows.into_iter().filter_map(|(what, value)| Some((what, value?))).collect()
    }

    /// What is most worth knowing, in at most ten lines: what it is, how it lies, what it shows, its cost, the worst
    /// findings.
    pub fn summary(&self) -> String {
        let figures = self.figures();
        let of =
            |name: &str| figures.iter().find(|(what, _)| *what == name).map(|(_, v)| v.as_str());
        let mut lines = vec![format!(
            "{}: {} Gaussians, {}",
            self.path,
            of("Gaussians").unwrap_or_default(),
            of("extent").unwrap_or_default()
        )];
        lines.push(format!(
            "  up {}; unit {}",
            of("up").unwrap_or_default(),
            of("unit").unwrap_or("unknown")
        ));
        let has = format!("  harmonics {}", of("harmonics").unwrap_or_default());
        lines.push(of("also").map_or(has.clone(), |also| format!("{has}; {also}")));
        let seen = self.effects.present();
        let seen = seen.map(|e| format!("{} {:.1} of 5", e.effect.name(), e.severity));
        let seen: Vec<String> = seen.collect();
        lines.push(format!(
            "  effects of the capture: {}",
            if seen.is_empty() { "none above its threshold".to_owned() } else { seen.join(", ") }
        ));
        lines.extend(of("cost").map(|cost| format!("  {cost}")));
        lines.push(match self.findings.len() {
            0 => "no findings".to_owned(),
            count => plural(count, "finding"),
        });
        let shown = self.findings.iter().take(MOST_FINDINGS);
        lines.extend(shown.map(|finding| {
            let head = format!("  {}", finding.head());
            match head.char_indices().nth(LINE) {
                Some((end, _)) => format!("{}…", &head[..end]),
                None => head,
            }
        }));
        if self.findings.len() > MOST_FINDINGS {
            lines.push(format!("  and {} more", self.findings.len() - MOST_FINDINGS));
        }
        lines.join("\n")
    }

    /// What the scene has besides Gaussians.
    fn more(&self) -> Option<String> {
        let labels = self.labels.as_ref();
        let labels = labels.map(|l| format!("{} classes, {} instances", l.classes, l.instances));
        let codes = self.language_codes.as_ref();
        let codes = codes.map(|codes| format!("language codes of {} values", codes.width));
        let normals = self.has_normals.then(|| "normals".to_owned());
        let all: Vec<String> = [normals, labels, codes].into_iter().flatten().collect();
        (!all.is_empty()).then(|| all.join("; "))
    }

    fn voxel_figures(&self) -> String {
        let Some(v) = &self.voxels else { return "the scene does not fit on the grid".to_owned() };
        format!(
            "{} of {} cm, {:.2} Gaussians each, at most {}",
            thousands(v.count),
            (v.size * 1e5).round() / 1e3,
            v.mean,
            thousands(v.largest)
        )
    }
}

fn cost(estimate: &Estimate) -> String {
    let [low, high] = estimate.seconds_range.map(duration);
    let Estimate { network, threads, bytes, .. } = estimate;
    let bytes = Bytes(*bytes);
    format!("segment with the {network} network: {low} to {high} on {threads} threads, {bytes}")
}

impl fmt::Display for Inspection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.path)?;
        for (what, value) in self.figures() {
            writeln!(f, "  {what:<11} {value}")?;
        }
        let about_up = (!self.up.given).then_some(("up", &self.up.evidence));
        let about_unit = match (&self.sized, &self.unit) {
            (Some(sized), _) => Some(&sized.evidence),
            (None, unit) => unit.as_ref().map(|unit| &unit.evidence),
        };
        for (what, why) in about_up.into_iter().chain(about_unit.map(|why| ("unit", why))) {
            writeln!(f, "  why {what:<7} {why}")?;
        }
        writeln!(f, "capture effects, severity 0 to 5 (no: below its threshold)")?;
        for line in self.effects.to_string().lines() {
            writeln!(f, "  {line}")?;
        }
        if self.findings.is_empty() {
            write!(f, "no findings")?;
        } else {
            write!(f, "{}", plural(self.findings.len(), "finding"))?;
        }
        for finding in self.findings.iter().chain(&self.notes) {
            for line in finding.lines(LINE) {
                write!(f, "\n  {line}")?;
            }
        }
        Ok(())
    }
}

impl Finding {
    /// All of it in one line.
    pub fn lines_joined(&self) -> String {
        self.lines(usize::MAX).iter().map(|l| l.trim()).collect::<Vec<_>>().join("; ")
    }

    /// Name, count and first row, in a few words.
    pub(super) fn head(&self) -> String {
        let mut head = format!("{} {}: ", self.severity.name(), self.name);
        if self.count > 0 {
            head.push_str(&plural(self.count, "row"));
            if let Some(first) = self.first_row {
                head.push_str(&format!(", first {first}"));
            }
            if !self.example.is_empty() {
                head.push_str(&format!(" ({})", self.example));
            }
        } else {
            head.push_str(&self.message);
        }
        head
    }

    /// Lines of at most about `width` letters.
    pub(super) fn lines(&self, width: usize) -> Vec<String> {
        let mut head = self.head();
        if self.count > 0 {
            head.push_str(". ");
            head.push_str(&self.message);
        }
        let mut lines = wrap(&head, width);
        if !self.help.is_empty() {
            lines.extend(wrap(&format!("help: {}", self.help), width));
        }
        // All but the first line are indented.
        lines.iter_mut().skip(1).for_each(|l| l.insert_str(0, "    "));
        lines
    }
}

/// Breaks a text at spaces.
pub(super) fn wrap(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.chars().count() + word.chars().count() < width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

fn sides(extent: [f64; 3]) -> String {
    extent.map(short).join(" x ")
}

fn five(values: &Distribution, unit: &str) -> String {
    let Some(Quantiles { p5, p50, p95, .. }) = values.quantiles else {
        return "-".to_owned();
    };
    format!("{} / {} / {}{unit} (5, 50, 95 %)", short(p5), short(p50), short(p95))
}

fn sure(confidence: f64) -> String {
    let word = match confidence {
        c if c >= 0.6 => "quite sure",
        c if c >= 0.3 => "likely",
        c if c >= 0.25 => "perhaps",
        _ => "a guess",
    };
    format!("{word} ({confidence:.2})")
}

/// Seconds as people say them.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 0.95 => format!("{s:.1} s"),
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// `1 finding`, `2 findings`.
pub(super) fn plural(count: usize, what: &str) -> String {
    format!("{} {what}{}", thousands(count), if count == 1 { "" } else { "s" })
}

pub(super) fn thousands(value: usize) -> String {
    crate::preview::thousands(value as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inspect::Severity;

    #[test]
    fn lines_are_broken_and_lose_no_word() {
        let finding = Finding {
            name: "floaters".to_owned(),
            severity: Severity::Warning,
            count: 12_345,
            first_row: Some(7),
            example: "x".repeat(200),
            message: "many words ".repeat(30),
            help: "remove them".to_owned(),
        };
        let lines = finding.lines(60);
        assert!(lines[0].starts_with("warning floaters: 12 345 rows, first 7"), "{lines:?}");
        assert!(lines[1..].iter().all(|l| l.starts_with("    ")));
        let words = |t: &str| t.split_whitespace().count();
        assert_eq!(lines.iter().map(|l| words(l)).sum::<usize>(), 7 + 1 + 60 + 3);
        // Only a word that is longer by itself may stick out.
        assert!(lines.iter().all(|l| l.len() <= 64 || l.contains("xxx")), "{lines:?}");
    }

    #[test]
    fn times_and_numbers() {
        assert_eq!(duration(0.31), "0.3 s");
        assert_eq!(duration(47.7), "48 s");
        assert_eq!(duration(3_000.0), "50 min");
        assert_eq!(duration(9_000.0), "2.5 h");
        assert_eq!(short(1234.5), "1234");
        assert_eq!(short(0.000_012), "1.20e-5");
        assert_eq!(short(f64::INFINITY), "-");
        assert_eq!(thousands(1_500_000), "1 500 000");
    }
}
