//! A run on the screen: a bar on a terminal, plain lines elsewhere.

use crate::TrainError;
use crate::event::{Callback, End, Event, Flow, Progress};
use indicatif::{HumanDuration, ProgressBar, ProgressStyle};
use scenesplat_metrics::Measurement;
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// Between two plain lines of steps.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// Shows a run on standard error, with the time it will take.
#[derive(Debug)]
pub struct Console {
    bar: Option<ProgressBar>,
    began: Option<(Instant, u64)>,
    last_line: Option<Instant>,
}

impl Console {
    /// A bar if standard error is a terminal, lines otherwise.
    pub fn new() -> Self {
        let bar = std::io::stderr().is_terminal().then(ProgressBar::no_length);
        Self { bar, began: None, last_line: None }
    }

    fn say(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.println(line),
            // A closed standard error is no reason to end a run.
            None => _ = writeln!(std::io::stderr(), "{line}"),
        }
    }

    /// Time until the end, from the speed so far; candle-free and good enough after some steps.
    fn remaining(&self, at: Progress) -> Option<Duration> {
        let (began, first) = self.began?;
        let done = at.step.checked_sub(first).filter(|d| *d > 0)?;
        let rest = at.total_steps.saturating_sub(at.step);
        Some(began.elapsed().mul_f64(rest as f64 / done as f64))
    }

    fn step(&mut self, measurements: &[Measurement], at: Progress) {
        let find = |name: &str| measurements.iter().find(|m| m.name == name).map(|m| m.value);
        let Some(loss) = find("train/loss") else { return };
        let mut text = format!("loss {loss:.4}");
        if let Some(norm) = find("train/grad_norm") {
            text.push_str(&format!(", gradient {norm:.3}"));
        }
        if let Some(bar) = &self.bar {
            bar.set_position(at.step);
            bar.set_message(text);
            return;
        }
        let due = self.last_line.is_none_or(|t| t.elapsed() >= LINE_EVERY);
        if due || at.step == at.total_steps {
            self.last_line = Some(Instant::now());
            let rest = self
                .remaining(at)
                .map_or(String::new(), |d| format!(", {} to go", HumanDuration(d)));
            self.say(&format!("step {}/{}: {text}{rest}", at.step, at.total_steps));
        }
    }
}

impl Default for Console {
    fn default() -> Self {
        Self::new()
    }
}

impl Callback for Console {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        match event {
            Event::FitStart { parameters, steps_per_epoch, leftover_batches } => {
                self.began = Some((Instant::now(), at.step));
                if let Some(bar) = &self.bar {
                    bar.set_length(at.total_steps);
                    if let Ok(style) =
                        ProgressStyle::with_template("{bar:30} {pos}/{len}, {eta} to go, {msg}")
                    {
                        bar.set_style(style);
                    }
                    bar.set_position(at.step);
                    bar.reset_eta();
                }
                let from =
                    if at.step > 0 { format!(" from step {}", at.step) } else { String::new() };
                self.say(&format!(
                    "training {parameters} parameters, {} steps ({steps_per_epoch} an epoch){from}",
                    at.total_steps
                ));
                if *leftover_batches > 0 {
                    self.say(&format!(
                        "{leftover_batches} batches of each epoch are left out: they fill no step"
                    ));
                }
            }
            Event::Evaluated { .. } => {}
            Event::Step { measurements } => self.step(measurements, at),
            Event::Eval { name, measurements } => {
                let prefix = format!("{name}/");
                let short = |n: &str| n.strip_prefix(&prefix).unwrap_or(n).to_owned();
                let values: Vec<String> = measurements
                    .iter()
                    .map(|m| format!("{} {:.4}", short(&m.name), m.value))
                    .collect();
                self.say(&format!("step {}: {name}: {}", at.step, values.join(", ")));
            }
            Event::Alarm { message } => self.say(&format!("step {}: warning: {message}", at.step)),
            Event::Checkpoint { dir, best } => {
                let best = if *best { " (best so far)" } else { "" };
                self.say(&format!("step {}: saved {}{best}", at.step, dir.display()));
            }
            Event::FitEnd { end } => {
                if let Some(bar) = &self.bar {
                    bar.finish_and_clear();
                }
                let took = self.began.map_or(Duration::ZERO, |(t, _)| t.elapsed());
                let how = match end {
                    End::Finished => "done",
                    End::Stopped => "stopped",
                };
                self.say(&format!(
                    "{how} at step {} of {} after {}",
                    at.step,
                    at.total_steps,
                    HumanDuration(took)
                ));
            }
        }
        Ok(Flow::Continue)
    }
}
