//! A run on the screen: one line that is written again and again on a terminal, lines elsewhere.

use crate::TrainError;
use crate::event::{Callback, End, Event, Flow, Progress};
use scenesplat_datasets::LeftOut;
use scenesplat_metrics::Measurement;
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// Goes to the start of the line and empties it.
const CLEAR: &str = "\r\x1b[2K";
/// Between two plain lines of steps.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// Shows a run on standard error, with the time it will take.
#[derive(Debug)]
pub struct Console {
    /// Whether a line can be written over.
    terminal: bool,
    /// Whether there is one to write over.
    open_line: bool,
    began: Option<(Instant, u64)>,
    last_line: Option<Instant>,
}

impl Console {
    /// A line that changes if standard error is a terminal, one after the other otherwise.
    pub fn new() -> Self {
        let terminal = std::io::stderr().is_terminal();
        Self { terminal, open_line: false, began: None, last_line: None }
    }

    /// Writes a line that stays.
    fn say(&mut self, line: &str) {
        let clear = if self.open_line { CLEAR } else { "" };
        self.open_line = false;
        // A closed standard error is no reason to end a run.
        _ = writeln!(std::io::stderr(), "{clear}{line}");
    }

    /// Writes a line that the next one replaces.
    fn say_for_now(&mut self, line: &str) {
        self.open_line = true;
        let mut stderr = std::io::stderr();
        _ = write!(stderr, "{CLEAR}{line}").and_then(|()| stderr.flush());
    }

    /// What of the data was left out, the first scenes with their reasons.
    fn data(&mut self, name: &str, left_out: &LeftOut, at: Progress) {
        const SHOWN: usize = 5;
        let lines = left_out.lines();
        for line in lines.iter().take(SHOWN) {
            self.say(&format!("step {}: {name}: {line}", at.step));
        }
        if lines.len() > SHOWN {
            let more = lines.len() - SHOWN;
            self.say(&format!(
                "step {}: {name}: {more} more scenes were repaired or left out",
                at.step
            ));
        }
        let (lacking, of) = (left_out.without_labels.len(), left_out.scenes);
        if lacking > 0 {
            self.say(&format!("step {}: {name}: {lacking} of {of} scenes have no labels", at.step));
        }
        // Where none has features, they are not what is trained on.
        let lacking = left_out.without_features.len();
        if lacking > 0 && lacking < of {
            let what = "have no language features";
            self.say(&format!("step {}: {name}: {lacking} of {of} scenes {what}", at.step));
        }
    }

    /// Time until the end, from the speed so far; good enough after some steps.
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
        let rest = self.remaining(at).map_or(String::new(), |d| format!(", {} to go", human(d)));
        let line = format!("step {}/{}: {text}{rest}", at.step, at.total_steps);
        if self.terminal && at.step < at.total_steps {
            self.say_for_now(&format!("{} {line}", bar(at)));
            return;
        }
        let due = self.last_line.is_none_or(|t| t.elapsed() >= LINE_EVERY);
        if due || at.step == at.total_steps {
            self.last_line = Some(Instant::now());
            self.say(&line);
        }
    }
}

/// How much of the training is done, as a bar.
fn bar(at: Progress) -> String {
    const LENGTH: u64 = 24;
    let done = (LENGTH * at.step / at.total_steps.max(1)).min(LENGTH) as usize;
    format!("[{:-<24}]", "=".repeat(done))
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
            Event::Data { name, left_out } => self.data(name, left_out, at),
            Event::Step { measurements } => self.step(measurements, at),
            Event::Eval { name, measurements } => {
                let prefix = format!("{name}/");
                let short = |n: &str| n.strip_prefix(&prefix).unwrap_or(n).to_owned();
                // What labels would give that nothing loses: the log has it.
                let is_oracle = |m: &&Measurement| m.name.split('/').any(|part| part == "oracle");
                let values: Vec<String> = measurements
                    .iter()
                    .filter(|m| !is_oracle(m))
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
                let took = self.began.map_or(Duration::ZERO, |(t, _)| t.elapsed());
                let how = match end {
                    End::Finished => "done",
                    End::Stopped => "stopped",
                };
                self.say(&format!(
                    "{how} at step {} of {} after {}",
                    at.step,
                    at.total_steps,
                    human(took)
                ));
            }
        }
        Ok(Flow::Continue)
    }
}

/// A duration in its two largest units.
fn human(duration: Duration) -> String {
    match duration.as_secs() {
        s if s < 60 => format!("{s} s"),
        s if s < 3600 => format!("{} min {} s", s / 60, s % 60),
        s if s < 86_400 => format!("{} h {} min", s / 3600, s % 3600 / 60),
        s => format!("{} d {} h", s / 86_400, s % 86_400 / 3600),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_is_as_long_as_what_is_done() {
        let at = |step, total_steps| bar(Progress { step, total_steps, ..Progress::default() });
        assert_eq!(at(0, 300), format!("[{}]", "-".repeat(24)));
        assert_eq!(at(150, 300), format!("[{}{}]", "=".repeat(12), "-".repeat(12)));
        assert_eq!([at(300, 300), at(9, 0)], [(); 2].map(|()| format!("[{}]", "=".repeat(24))));
    }

    #[test]
    fn durations_have_two_units() {
        let text = |s| human(Duration::from_secs(s));
        assert_eq!([text(0), text(59)], ["0 s", "59 s"]);
        assert_eq!([text(61), text(3600)], ["1 min 1 s", "1 h 0 min"]);
        assert_eq!([text(86_399), text(90_000)], ["23 h 59 min", "1 d 1 h"]);
    }
}
