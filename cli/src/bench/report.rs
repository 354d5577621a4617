//! What was measured, as JSON and as a table.

use super::{RowKind, Settings, Work};
use crate::receipt::Receipt;
use scenesplat::kernels::Precision;
use scenesplat::kernels::simd::Isa;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Times of one row, from the process that measured it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Rows of the input.
    pub size: usize,
    /// Seconds of each sample.
    pub seconds: Vec<f64>,
    /// Largest resident memory of the process until the last sample, bytes.
    pub peak_bytes: Option<u64>,
    /// Operations of a pass; a multiply–add counts as two.
    pub flop: u64,
    /// Bytes that a pass must at least read and write.
    pub bytes: u64,
    /// How far the result is from a better one.
    pub accuracy: Option<Accuracy>,
    /// What the processor gave before and after the row.
    pub speeds: Vec<Speeds>,
}

/// Operations a second of all threads in registers, at one moment.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Speeds {
    /// f32.
    pub f32_flop_s: f64,
    /// bf16; `None` without such instructions.
    pub bf16_flop_s: Option<f64>,
    /// 8-bit integers; `None` without such instructions.
    pub int8_op_s: Option<f64>,
}

/// How far a result is from a better one on the same input.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Root of the summed squares of the differences over that of the better result; for tables the
    /// share of wrong entries.
    pub max_error: f64,
    /// What it was compared with.
    pub against: String,
    /// Median over the rows of the cosine between both results.
    pub cosine_median: Option<f64>,
    /// One row in a hundred has a smaller cosine.
    pub cosine_p01: Option<f64>,
}

/// Where it ran, and the most it can do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MachineSpeeds {
    /// Name of the processor.
    pub cpu: String,
    /// Cores that the process may use.
    pub cores: usize,
    /// Threads that worked.
    pub threads: usize,
    /// Instruction set of the kernels.
    pub simd: String,
    /// Operating system and architecture.
    pub os: String,
    /// Version of this program.
    pub version: String,
    /// f32 operations a second of all threads, in registers: the most seen in the whole run.
    pub peak_f32_flop_s: f64,
    /// The same in bf16; `None` without such instructions.
    pub peak_bf16_flop_s: Option<f64>,
    /// The same of 8-bit integers; `None` without such instructions.
    pub peak_int8_op_s: Option<f64>,
    /// Bytes a second that all threads together read from memory, by the median.
    pub bandwidth_bytes_s: f64,
}

/// A row of the table. Field names are stable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// What was measured.
    pub name: String,
    /// Precision of the matrix products.
    pub precision: String,
    /// Threads that worked.
    pub threads: usize,
    /// Whether the input was small (`--quick`).
    pub quick: bool,
    /// Rows of the input: voxels, points; words for `bandwidth`; 0 without input.
    pub size: usize,
    /// Median of the samples, seconds.
    pub median_s: f64,
    /// Shortest sample, seconds.
    pub min_s: f64,
    /// Samples.
    pub samples: usize,
    /// Largest resident memory of the row's process, bytes; `None` where the system does not tell.
    pub peak_bytes: Option<u64>,
    /// Operations of a pass; a multiply–add counts as two.
    pub flop: u64,
    /// Bytes that a pass must at least read and write.
    pub bytes: u64,
    /// See [`Accuracy::max_error`]; `None` where there is nothing better to compare with.
    pub max_error: Option<f64>,
    /// What it was compared with.
    pub error_against: Option<String>,
    /// Networks in less than f32: see [`Accuracy::cosine_median`].
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub cosine_median: Option<f64>,
    /// Networks in less than f32: see [`Accuracy::cosine_p01`].
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub cosine_p01: Option<f64>,
    /// The longer of operations over the peak of this machine and bytes over its bandwidth, seconds.
    pub floor_s: f64,
    /// Median over floor.
    pub ratio: f64,
    /// What the processor gave before and after the row, the smaller, over the most it gave in the
    /// run: below 0.85 something else was running, and the row is too slow.
    pub steady: f64,
}

/// A row that could not be measured.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Name of the row.
    pub name: String,
    /// Its precision.
    pub precision: String,
    /// Why.
    pub reason: String,
}

/// All rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Where it ran.
    pub machine: MachineSpeeds,
    /// Whether inputs were small.
    pub quick: bool,
    /// Time of the whole run, seconds.
    pub seconds: f64,
    /// What was measured.
    pub rows: Vec<Row>,
    /// What could not be measured.
    pub failed: Vec<Failure>,
}

impl MachineSpeeds {
    /// Names and counts; the speeds are 0 until [`MachineSpeeds::note`].
    pub(super) fn detect(threads: usize) -> Self {
        let machine = Receipt::new("").finish().machine;
        Self {
            cpu: machine.cpu,
            cores: machine.cores,
            threads,
            simd: Isa::current().name().to_owned(),
            os: machine.os,
            version: machine.version,
            peak_f32_flop_s: 0.0,
            peak_bf16_flop_s: None,
            peak_int8_op_s: None,
            bandwidth_bytes_s: 0.0,
        }
    }

    /// Takes over the speeds seen with a row, where they are the best so far.
    pub(super) fn note(&mut self, work: Work, measured: &Measured) {
        let shortest = shortest(&measured.seconds);
        let flop_s = measured.flop as f64 / shortest;
        // A single pass may find a part of the array in a cache of the host; most do not.
        let bytes_s = measured.bytes as f64 / median(&measured.seconds);
        match work {
            Work::PeakF32 => self.peak_f32_flop_s = self.peak_f32_flop_s.max(flop_s),
            Work::PeakBf16 => raise(&mut self.peak_bf16_flop_s, Some(flop_s)),
            Work::PeakInt8 => raise(&mut self.peak_int8_op_s, Some(flop_s)),
            Work::Bandwidth => self.bandwidth_bytes_s = self.bandwidth_bytes_s.max(bytes_s),
            _ => {}
        }
        for seen in &measured.speeds {
            self.peak_f32_flop_s = self.peak_f32_flop_s.max(seen.f32_flop_s);
            raise(&mut self.peak_bf16_flop_s, seen.bf16_flop_s);
            raise(&mut self.peak_int8_op_s, seen.int8_op_s);
        }
    }

    /// The least seconds for so many operations and bytes.
    fn floor(&self, precision: &str, flop: u64, bytes: u64) -> f64 {
        let peak = match (precision, self.peak_bf16_flop_s) {
            // Of a network also what it leaves in bf16 and f32: a bound that it cannot reach.
            ("int8", _) => self.peak_int8_op_s.unwrap_or(self.peak_f32_flop_s),
            ("bf16", Some(peak)) => peak,
            // Three products of bf16 parts on tiles; without them f32.
            ("split", Some(peak)) if self.simd == Isa::Amx.name() => peak / 3.0,
            _ => self.peak_f32_flop_s,
        };
        (flop as f64 / peak).max(bytes as f64 / self.bandwidth_bytes_s)
    }
}

/// Keeps the larger one.
fn raise(most: &mut Option<f64>, seen: Option<f64>) {
    // Nothing is less than any number.
    if seen > *most {
        *most = seen;
    }
}

fn shortest(seconds: &[f64]) -> f64 {
    seconds.iter().copied().fold(f64::INFINITY, f64::min)
}

fn median(seconds: &[f64]) -> f64 {
    let mut sorted = seconds.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => sorted[n / 2],
        n => (sorted[n / 2 - 1] + sorted[n / 2]) / 2.0,
    }
}

impl Row {
    pub(super) fn new(
        kind: &RowKind,
        precision: &str,
        settings: &Settings,
        measured: &Measured,
        machine: &MachineSpeeds,
    ) -> Self {
        let Measured { size, seconds, peak_bytes, flop, bytes, accuracy, speeds } =
            measured.clone();
        let (median_s, min_s) = (median(&seconds), shortest(&seconds));
        let floor_s = machine.floor(precision, flop, bytes);
        let least = speeds.iter().map(|s| s.f32_flop_s).fold(f64::INFINITY, f64::min);
        let steady = (least / machine.peak_f32_flop_s).min(1.0);
        let (max_error, error_against, cosine_median, cosine_p01) = match accuracy {
            Some(a) => (Some(a.max_error), Some(a.against), a.cosine_median, a.cosine_p01),
            None => (None, None, None, None),
        };
        Self {
            name: kind.name.to_owned(),
            precision: precision.to_owned(),
            threads: settings.threads,
            quick: settings.quick,
            size,
            median_s,
            min_s,
            samples: seconds.len(),
            peak_bytes,
            flop,
            bytes,
            max_error,
            error_against,
            cosine_median,
            cosine_p01,
            floor_s,
            ratio: median_s / floor_s,
            steady,
        }
    }

    /// Whether the processor was there for the row alone.
    pub fn is_steady(&self) -> bool {
        self.steady >= 0.85
    }

    /// Operations or bytes a second, with the unit.
    pub fn speed(&self) -> String {
        match self.flop {
            0 => format!("{:.1} GB/s", self.bytes as f64 / self.median_s / 1e9),
            flop => {
                let unit =
                    if self.precision == Precision::Int8.name() { "GOP/s" } else { "GFLOP/s" };
                format!("{:.0} {unit}", flop as f64 / self.median_s / 1e9)
            }
        }
    }

    fn cells(&self) -> [String; 10] {
        [
            self.name.clone(),
            self.precision.clone(),
            self.size.to_string(),
            self.samples.to_string(),
            format!("{}{}", if self.is_steady() { "" } else { "! " }, seconds_text(self.median_s)),
            seconds_text(self.floor_s),
            format!("{:.2}", self.ratio),
            self.speed(),
            self.peak_bytes.map_or_else(|| "–".to_owned(), |b| format!("{:.0}", b as f64 / 1e6)),
            match (self.max_error, self.cosine_p01) {
                (None, _) => "–".to_owned(),
                (Some(error), None) => format!("{error:.1e}"),
                (Some(error), Some(low)) => format!("{error:.1e}, cosine ≥ {low:.5}"),
            },
        ]
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let samples = match self.samples {
            1 => "1 sample".to_owned(),
            n => format!("median of {n}"),
        };
        let (time, ratio) = (seconds_text(self.median_s), self.ratio);
        write!(f, "{} {}: {time} ({samples}), {ratio:.2} × the floor", self.name, self.precision)
    }
}

/// Seconds with a unit that suits them.
fn seconds_text(seconds: f64) -> String {
    match seconds {
        s if s >= 10.0 => format!("{s:.1} s"),
        s if s >= 1.0 => format!("{s:.2} s"),
        s if s >= 1e-3 => format!("{:.3} ms", s * 1e3),
        s => format!("{:.1} µs", s * 1e6),
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let m = &self.machine;
        write!(
            f,
            "{}, {} cores, {} threads, {}, {}, scenesplat {}\n{:.0} GFLOP/s f32",
            m.cpu,
            m.cores,
            m.threads,
            m.simd,
            m.os,
            m.version,
            m.peak_f32_flop_s / 1e9
        )?;
        if let Some(peak) = m.peak_bf16_flop_s {
            write!(f, ", {:.0} GFLOP/s bf16", peak / 1e9)?;
        }
        if let Some(peak) = m.peak_int8_op_s {
            write!(f, ", {:.0} GOP/s int8", peak / 1e9)?;
        }
        writeln!(f, ", {:.1} GB/s", m.bandwidth_bytes_s / 1e9)?;
        if self.quick {
            writeln!(f, "quick: inputs are smaller than the names say")?;
        }
        let head =
            ["", "", "rows", "samples", "median", "floor", "ratio", "speed", "peak MB", "error"];
        let mut lines = vec![head.map(str::to_owned)];
        lines.extend(self.rows.iter().map(Row::cells));
        let width = |column: usize| {
            lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0)
        };
        let widths: [usize; 10] = std::array::from_fn(width);
        for line in &lines {
            let mut text = String::new();
            for (i, (cell, width)) in line.iter().zip(widths).enumerate() {
                match i {
                    0 | 1 => text += &format!("{cell:width$}  "),
                    9 => text += cell,
                    _ => text += &format!("{cell:>width$}  "),
                }
            }
            writeln!(f, "{}", text.trim_end())?;
        }
        if let Some(least) = self.rows.iter().map(|r| r.steady).min_by(f64::total_cmp)
            && self.rows.iter().any(|r| !r.is_steady())
        {
            writeln!(
                f,
                "! something else was running: the processor gave as little as {:.0} % of its peak",
                least * 100.0
            )?;
        }
        for failure in &self.failed {
            writeln!(f, "{} {} failed: {}", failure.name, failure.precision, failure.reason)?;
        }
        write!(f, "{:.0} s in all", self.seconds)
    }
}
