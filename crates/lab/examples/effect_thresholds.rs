//! How well effects are found by the Gaussians of a scene alone: on synthetic rooms with each effect at each
//! severity, a table of recall, false alarms and rank correlation, which detector fires on which effect, and ROC
//! curves.
//!
//! `cargo run --release -p scenesplat-lab --example effect_thresholds -- OUT 3000 60` looks at 60 rooms from
//! seed 3000 on (thresholds were fitted on 40 from seed 0 on) and writes `effects.csv`, `effects.md` and
//! `effects-roc.svg`. A fourth argument such as `holes,glass` damages rooms by these effects alone.

use scenesplat::datasets::effects::profile::{EffectProfile, profile};
use scenesplat::datasets::effects::{Effect, EffectSet, MOST_SEVERE, simulate};
use scenesplat::metrics::rank_correlation;
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

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let out = PathBuf::from(args.next().ok_or("which folder?")?);
    let first: u64 = args.next().ok_or("which seed comes first?")?.parse()?;
    let rooms: u64 = args.next().ok_or("how many rooms?")?.parse()?;
    let damages: Vec<Effect> = match args.next() {
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

const COLORS: [&str; 7] =
    ["#1b6ca8", "#d1495b", "#66a182", "#edae49", "#6a4c93", "#444444", "#00798c"];

/// The curves as a picture, with a dot where the thresholds are.
fn roc_svg(looks: &[Look]) -> String {
    let clean: Vec<&Look> = looks.iter().filter(|look| look.done.is_none()).collect();
    let x = |v: f64| 60.0 + 400.0 * v;
    let y = |v: f64| 430.0 - 400.0 * v;
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"640\" height=\"480\" font-family=\"sans-serif\" \
         font-size=\"13\"><rect width=\"640\" height=\"480\" fill=\"white\"/>\n",
    );
    for tick in 0..=5 {
        let v = f64::from(tick) / 5.0;
        let _ = writeln!(
            svg,
            "<path d=\"M{0:.0} {1:.0}V{2:.0}M{3:.0} {4:.0}H{5:.0}\" stroke=\"#ddd\"/><text x=\"{0:.0}\" y=\"447\" \
             text-anchor=\"middle\">{v}</text><text x=\"52\" y=\"{6:.0}\" text-anchor=\"end\">{v}</text>",
            x(v),
            y(0.0),
            y(1.0),
            x(0.0),
            y(v),
            x(1.0),
            y(v) + 4.0
        );
    }
    svg += "<text x=\"260\" y=\"470\" text-anchor=\"middle\">false alarms on clean rooms</text>\
            <text x=\"18\" y=\"230\" text-anchor=\"middle\" transform=\"rotate(-90 18 230)\">found at severity 2 \
            to 5</text>\n";
    for (i, effect) in Effect::ALL.into_iter().enumerate() {
        let curve = roc(looks, effect);
        let points: Vec<String> =
            curve.iter().map(|p| format!("{:.1},{:.1}", x(p[0]), y(p[1]))).collect();
        let damaged: Vec<&Look> = looks.iter().filter(|look| look.has(effect)).collect();
        let (color, row) = (COLORS[i % COLORS.len()], 60.0 + 24.0 * i as f64);
        let _ = writeln!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\"/><circle cx=\"{:.1}\" \
             cy=\"{:.1}\" r=\"4\" fill=\"{color}\"/><text x=\"480\" y=\"{row:.0}\" fill=\"{color}\">{} \
             {:.2}</text>",
            points.join(" "),
            x(share(&clean, effect)),
            y(share(&damaged, effect)),
            effect.name(),
            area(&curve)
        );
    }
    svg += "<text x=\"480\" y=\"36\">area under curve</text></svg>\n";
    svg
}
