//! How well effects are found by the Gaussians of a scene alone: on synthetic rooms with each effect at each
//! severity, a table of recall, false alarms and rank correlation, which detector fires on which effect, and ROC
//! curves.

use crate::Arguments;
use anyhow::Result;
use scenesplat::datasets::effects::profile::{EffectProfile, profile};
use scenesplat::datasets::effects::{Effect, EffectSet, MOST_SEVERE, simulate};
use scenesplat::metrics::rank_correlation;
use scenesplat::page_kit::drawing::{Anchor, Color, Drawing};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use std::fmt::Write;
use std::path::PathBuf;

/// Gaussians of the rooms, in turn.
const COUNTS: [usize; 4] = [15_000, 30_000, 60_000, 120_000];
/// From this severity on an effect has to be found.
const HAS_TO_BE_FOUND: f64 = 2.0;

/// A look at a room with one effect, or none.
struct Look {
    seed: u64,
    done: Option<Effect>,
    severity: f64,
    seen: EffectProfile,
}

impl Look {
    fn measure(&self, effect: Effect) -> f64 {
        self.seen.of(effect).measure.as_ref().map_or(0.0, |m| m.value)
    }

    fn has(&self, effect: Effect) -> bool {
        self.done == Some(effect) && self.severity >= HAS_TO_BE_FOUND
    }
}

pub fn run(mut args: Arguments) -> Result<()> {
    let out: PathBuf = args.needed("which folder?")?;
    let first: u64 = args.needed("which seed comes first?")?;
    let rooms: u64 = args.needed("how many rooms?")?;
    let damages: Vec<Effect> = match args.word() {
        Some(names) => names.split(',').map(Effect::named).collect::<Result<_, _>>()?,
        None => Effect::ALL.to_vec(),
    };
    std::fs::create_dir_all(&out)?;
    let mut looks = Vec::new();
    for seed in first..first + rooms {
        let settings = SyntheticRoomSettings::with_count(COUNTS[(seed % 4) as usize], seed);
        let room = generate(&settings)?.scene;
        looks.push(Look { seed, done: None, severity: 0.0, seen: profile(&room, 1.0) });
        for &effect in &damages {
            for severity in 1..=MOST_SEVERE as u32 {
                let severity = f64::from(severity);
                let set = EffectSet::default().with(effect, severity)?;
                let seen = profile(&simulate(&room, &set, seed)?.scene, 1.0);
                looks.push(Look { seed, done: Some(effect), severity, seen });
            }
        }
        eprintln!("room {seed}");
    }
    std::fs::write(out.join("effects.csv"), csv(&looks))?;
    let text = table(&looks);
    println!("{text}");
    std::fs::write(out.join("effects.md"), text)?;
    std::fs::write(out.join("effects-roc.svg"), roc_svg(&looks))?;
    Ok(())
}

/// Everything, a line for each look and detector.
fn csv(looks: &[Look]) -> String {
    let mut text =
        String::from("seed,effect,severity,detector,measure,present,found_severity,more\n");
    for look in looks {
        let done = look.done.map_or("none", Effect::name);
        for effect in Effect::ALL {
            let (m, e) = (look.measure(effect), look.seen.of(effect));
            let more: Vec<String> =
                e.more.iter().map(|f| format!("{}={:.6}", f.name, f.value)).collect();
            let more = more.join(" ");
            let _ = writeln!(
                text,
                "{},{done},{},{},{m:.6},{},{:.3},{more}",
                look.seed,
                look.severity,
                effect.name(),
                e.present,
                e.severity
            );
        }
    }
    text
}

fn share(looks: &[&Look], effect: Effect) -> f64 {
    let on = looks.iter().filter(|look| look.seen.of(effect).present).count();
    on as f64 / looks.len().max(1) as f64
}

/// The tables of docs/effects.md.
fn table(looks: &[Look]) -> String {
    let clean: Vec<&Look> = looks.iter().filter(|look| look.done.is_none()).collect();
    let mut text = String::from(
        "| effect | found at 1 | at 2 | at 3 | at 4 | at 5 | from 2 on | false alarms | rank correlation | \
         area under ROC |\n|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for effect in Effect::ALL {
        let _ = write!(text, "| `{}` |", effect.name());
        for severity in 1..=MOST_SEVERE as u32 {
            let at = |l: &&Look| l.done == Some(effect) && l.severity == f64::from(severity);
            let at: Vec<&Look> = looks.iter().filter(at).collect();
            let _ = write!(text, " {:.2} |", share(&at, effect));
        }
        let damaged: Vec<&Look> = looks.iter().filter(|look| look.has(effect)).collect();
        let own = |l: &&Look| l.done == Some(effect) || l.done.is_none();
        let (truth, found): (Vec<f64>, Vec<f64>) =
            looks.iter().filter(own).map(|l| (l.severity, l.seen.of(effect).severity)).unzip();
        let _ = writeln!(
            text,
            " **{:.2}** | {:.2} | {:.2} | {:.2} |",
            share(&damaged, effect),
            share(&clean, effect),
            rank_correlation(&truth, &found).unwrap_or(f64::NAN),
            area(&roc(looks, effect))
        );
    }
    text.push_str("\nShare of rooms in which a detector (columns) fires, by what was done at 2 or more:\n\n| done |");
    Effect::ALL.iter().for_each(|e| text += &format!(" `{}` |", e.name()));
    text += &format!("\n|---|{}\n| nothing |", "---|".repeat(Effect::ALL.len()));
    Effect::ALL.iter().for_each(|e| text += &format!(" {:.2} |", share(&clean, *e)));
    for done in Effect::ALL {
        let damaged: Vec<&Look> = looks.iter().filter(|look| look.has(done)).collect();
        let _ = write!(text, "\n| `{}` |", done.name());
        Effect::ALL.iter().for_each(|e| text += &format!(" {:.2} |", share(&damaged, *e)));
    }
    text.push('\n');
    text
}

/// Shares of false alarms and of rooms found, as the threshold falls.
fn roc(looks: &[Look], effect: Effect) -> Vec<[f64; 2]> {
    let mut of: Vec<(f64, bool)> = looks
        .iter()
        .filter(|l| l.has(effect) || l.done.is_none())
        .map(|l| (l.measure(effect), l.done.is_some()))
        .collect();
    of.sort_by(|a, b| b.0.total_cmp(&a.0));
    let there = of.iter().filter(|(_, there)| *there).count().max(1) as f64;
    let clean = (of.len() as f64 - there).max(1.0);
    let mut at = [0.0, 0.0];
    let mut curve = vec![at];
    for (i, (value, is_there)) in of.iter().enumerate() {
        if *is_there {
            at[1] += 1.0 / there;
        } else {
            at[0] += 1.0 / clean;
        }
        // Equal measures fall together.
        if of.get(i + 1).is_none_or(|next| next.0 != *value) {
            curve.push(at);
        }
    }
    curve
}

fn area(curve: &[[f64; 2]]) -> f64 {
    curve.windows(2).map(|w| (w[1][0] - w[0][0]) * 0.5 * (w[0][1] + w[1][1])).sum()
}

const COLORS: [Color; 7] = [
    [27, 108, 168],
    [209, 73, 91],
    [102, 161, 130],
    [237, 174, 73],
    [106, 76, 147],
    [68, 68, 68],
    [0, 121, 140],
];

/// The curves as a picture, with a dot where the thresholds are.
fn roc_svg(looks: &[Look]) -> String {
    let clean: Vec<&Look> = looks.iter().filter(|look| look.done.is_none()).collect();
    let place = |[x, y]: [f64; 2]| [60.0 + 400.0 * x, 430.0 - 400.0 * y];
    let (grid, ink) = ([221; 3], [0; 3]);
    let mut drawing = Drawing::new(640, 480);
    for tick in (0..=5).map(|tick| f64::from(tick) / 5.0) {
        let text = tick.to_string();
        drawing.line(place([tick, 0.0]), place([tick, 1.0]), 1.0, grid);
        drawing.line(place([0.0, tick]), place([1.0, tick]), 1.0, grid);
        drawing.text([60.0 + 400.0 * tick, 436.0], 1, ink, Anchor::Middle, &text);
        drawing.text([52.0, 426.0 - 400.0 * tick], 1, ink, Anchor::End, &text);
    }
    let names = "false alarms on clean rooms (across), found at severity 2 to 5 (up)";
    drawing.text([60.0, 460.0], 1, ink, Anchor::Start, names);
    drawing.text([480.0, 36.0], 1, ink, Anchor::Start, "area under curve");
    for (i, (effect, color)) in Effect::ALL.into_iter().zip(COLORS).enumerate() {
        let curve = roc(looks, effect);
        for pair in curve.windows(2) {
            drawing.line(place(pair[0]), place(pair[1]), 2.0, color);
        }
        let damaged: Vec<&Look> = looks.iter().filter(|look| look.has(effect)).collect();
        let at = place([share(&clean, effect), share(&damaged, effect)]);
        drawing.disc(at, 4.0, color, color);
        let text = format!("{} {:.2}", effect.name(), area(&curve));
        drawing.text([480.0, 60.0 + 24.0 * i as f64], 1, color, Anchor::Start, &text);
    }
    drawing.to_svg()
}
