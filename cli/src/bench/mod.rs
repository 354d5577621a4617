//! Speeds of this machine: the networks, their parts and the tables under them, each beside the
//! least time that the processor or the memory would allow.
//!
//! [`measure`] measures one row in this process. [`run`] goes through all rows; `scenesplat bench`
//! gives it a fresh process for each, so that memory is counted by row and no row finds the caches
//! or the heap of another. All inputs are made here from fixed seeds.

mod checks;
mod flop;
mod machine;
mod networks;
pub mod process;
mod products;
mod report;
mod stopwatch;
mod tables;
mod train_step;

pub use machine::speeds;
pub use report::{Accuracy, Failure, MachineSpeeds, Measured, Report, Row, Speeds};

use anyhow::{Result, bail};
use scenesplat::kernels::{Precision, bench_peak};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What a row does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Work {
    PeakF32,
    PeakBf16,
    PeakInt8,
    Bandwidth,
    Serialize,
    GridSample,
    KernelMap,
    Neighbors,
    Product(usize),
    Convolution(usize),
    Attention { channels: usize, heads: usize },
    TrainStep { recompute: bool },
    Segmentation,
    LitePtLanguage,
    Language,
}

/// A row of the table.
#[derive(Debug, Clone, Copy)]
struct RowKind {
    name: &'static str,
    work: Work,
    /// Rows of the input; with `--quick` the second.
    size: [usize; 2],
}

const fn row(name: &'static str, work: Work, full: usize, quick: usize) -> RowKind {
    RowKind { name, work, size: [full, quick] }
}

const ALL: [RowKind; 20] = [
    row("peak_f32", Work::PeakF32, 0, 0),
    row("peak_bf16", Work::PeakBf16, 0, 0),
    row("peak_int8", Work::PeakInt8, 0, 0),
    row("bandwidth", Work::Bandwidth, 1 << 25, 1 << 23),
    row("serialize_4x_1m", Work::Serialize, 1_000_000, 20_000),
    row("grid_sample_1m", Work::GridSample, 1_000_000, 20_000),
    row("kernel_map_k3_100k", Work::KernelMap, 100_000, 5000),
    row("knn25_500k", Work::Neighbors, 500_000, 10_000),
    row("gemm_c768_100k", Work::Product(768), 100_000, 2000),
    row("conv3_c32_100k", Work::Convolution(32), 100_000, 5000),
    row("conv3_c64_100k", Work::Convolution(64), 100_000, 5000),
    row("conv3_c256_100k", Work::Convolution(256), 100_000, 5000),
    row("conv3_c768_100k", Work::Convolution(768), 100_000, 2000),
    row("attention_c64_100k", Work::Attention { channels: 64, heads: 4 }, 100_000, 5000),
    row("attention_c768_100k", Work::Attention { channels: 768, heads: 16 }, 100_000, 2000),
    row("train_step_semseg_50k", Work::TrainStep { recompute: false }, 50_000, 2000),
    row("train_step_recompute_semseg_50k", Work::TrainStep { recompute: true }, 50_000, 2000),
    row("forward_semseg_100k", Work::Segmentation, 100_000, 2000),
    row("forward_litept_s_language_100k", Work::LitePtLanguage, 100_000, 2000),
    row("forward_language_100k", Work::Language, 100_000, 2000),
];

impl RowKind {
    fn find(name: &str) -> Option<Self> {
        ALL.into_iter().find(|r| r.name == name)
    }

    /// Whether there is a choice of precision. The others have one, called f32 after the type of
    /// their coordinates.
    fn has_precisions(&self) -> bool {
        let is_product = matches!(self.work, Work::Product(_) | Work::Convolution(_));
        is_product || matches!(self.work, Work::Attention { .. }) || self.is_compared_with_f32()
    }

    /// The precision of a speed of the machine itself, which all floors need.
    fn peak_of(&self) -> Option<&'static str> {
        match self.work {
            Work::PeakF32 | Work::Bandwidth => Some("f32"),
            Work::PeakBf16 => Some("bf16"),
            Work::PeakInt8 => Some("int8"),
            _ => None,
        }
    }

    /// Whether the processor has instructions for it.
    fn is_there(&self) -> bool {
        match self.work {
            Work::PeakBf16 => bench_peak::bf16_loop().is_some(),
            Work::PeakInt8 => bench_peak::int8_loop().is_some(),
            _ => true,
        }
    }

    /// Whether it can be computed in a precision.
    fn is_in(&self, precision: Precision) -> bool {
        precision.has_gradient() || !matches!(self.work, Work::TrainStep { .. })
    }

    /// Whether its result is compared with that of the same row in f32.
    fn is_compared_with_f32(&self) -> bool {
        matches!(
            self.work,
            Work::TrainStep { .. } | Work::Segmentation | Work::LitePtLanguage | Work::Language
        )
    }
}

/// Names of all rows, in the order in which they run.
pub fn names() -> impl Iterator<Item = &'static str> {
    ALL.iter().map(|r| r.name)
}

/// What one process measures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Name of the row.
    pub name: String,
    /// Precision of the matrix products.
    #[serde(with = "by_name")]
    pub precision: Precision,
    /// Threads.
    pub threads: usize,
    /// Small inputs.
    pub quick: bool,
    /// More samples, also of rows that take long.
    pub patient: bool,
    /// Where a network's result in f32 is kept: an f32 row writes it, another reads it.
    pub rows_file: Option<PathBuf>,
    /// One pass, for its result only.
    pub one_pass: bool,
}

/// Measures a row on the current threads.
///
/// # Errors
/// If there is no such row, or it cannot be computed.
pub fn measure(request: &Request) -> Result<Measured> {
    let Some(row) = RowKind::find(&request.name) else {
        bail!("{:?} is no row", request.name);
    };
    if !row.is_in(request.precision) {
        bail!("{} is for inference: nothing is trained in it", request.precision);
    }
    let n = row.size[usize::from(request.quick)];
    let before = machine::speeds();
    let measured = match row.work {
        Work::PeakF32 => machine::peak(bench_peak::f32_loop(), request),
        Work::PeakBf16 => match bench_peak::bf16_loop() {
            Some(found) => machine::peak(found, request),
            None => bail!("this processor has no instructions for bf16"),
        },
        Work::PeakInt8 => match bench_peak::int8_loop() {
            Some(found) => machine::peak(found, request),
            None => bail!("this processor has no instructions for dot products of 8-bit integers"),
        },
        Work::Bandwidth => machine::bandwidth(n, request),
        Work::Serialize => tables::serialize(n, request),
        Work::GridSample => tables::grid_sample(n, request),
        Work::KernelMap => tables::kernel_map(n, request),
        Work::Neighbors => tables::neighbors(n, request),
        Work::Product(channels) => products::gemm(channels, n, request),
        Work::Convolution(channels) => products::convolution(channels, n, request),
        Work::Attention { channels, heads } => products::attention(channels, heads, n, request),
        Work::TrainStep { recompute } => networks::train_step(n, recompute, request),
        Work::Segmentation => networks::segmentation(n, request),
        Work::LitePtLanguage => networks::litept_language(n, request),
        Work::Language => networks::language(n, request),
    }?;
    Ok(Measured { speeds: vec![before, machine::speeds()], ..measured })
}

/// What to measure.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Rows by name; all if empty. Named rows get more samples.
    pub only: Vec<String>,
    /// Precisions of the rows that have several.
    pub precisions: Vec<Precision>,
    /// Threads.
    pub threads: usize,
    /// Small inputs.
    pub quick: bool,
    /// A folder for what one row hands to another.
    pub scratch: PathBuf,
}

/// What a run says on its way.
#[derive(Debug)]
pub enum Step<'a> {
    /// A row begins: its number from 1, how many there are, its name and precision.
    Begins(usize, usize, &'a str, Precision),
    /// A row is done.
    Done(&'a Row),
    /// A row could not be measured.
    Failed(&'a Failure),
}

/// Measures rows; `measure` gets one request after the other, `say` what happens.
///
/// A row that fails is noted and the others go on.
///
/// # Errors
/// If there is no row of a name, if `measure` says so by [`Stopped`], or if the speed of the machine
/// itself cannot be measured.
pub fn run(
    settings: &Settings,
    measure: &mut dyn FnMut(&Request) -> Result<Measured>,
    say: &mut dyn FnMut(Step<'_>),
) -> Result<Report> {
    let began = std::time::Instant::now();
    for name in &settings.only {
        if RowKind::find(name).is_none() {
            bail!("{name:?} is no row; the rows are {}", names().collect::<Vec<_>>().join(", "));
        }
    }
    // The floors of all others need the speeds of the machine, asked for as rows or not.
    let mut machine = MachineSpeeds::detect(settings.threads);
    let mut done: Vec<(RowKind, &str, Measured)> = Vec::new();
    for row in ALL {
        let Some(shown) = row.peak_of().filter(|_| row.is_there()) else { continue };
        let measured = measure(&settings.request(&row, Precision::F32))?;
        machine.note(row.work, &measured);
        if settings.wants(&row) {
            say(Step::Done(&Row::new(&row, shown, settings, &measured, &machine)));
            done.push((row, shown, measured));
        }
    }
    let jobs = settings.jobs();
    let mut failed = Vec::new();
    for (i, (row, precision)) in jobs.iter().enumerate() {
        say(Step::Begins(i + 1, jobs.len(), row.name, *precision));
        match settings.measured(row, *precision, measure) {
            Ok(measured) => {
                machine.note(row.work, &measured);
                say(Step::Done(&Row::new(row, precision.name(), settings, &measured, &machine)));
                done.push((*row, precision.name(), measured));
            }
            Err(e) if e.downcast_ref::<Stopped>().is_some() => return Err(e),
            Err(e) => {
                failed.push(Failure {
                    name: row.name.to_owned(),
                    precision: precision.name().to_owned(),
                    reason: format!("{e:#}"),
                });
                say(Step::Failed(&failed[failed.len() - 1]));
            }
        }
    }
    // Floors by the most that the processor gave in the whole run: it may have begun slowly.
    let rows = done.iter().map(|(row, name, m)| Row::new(row, name, settings, m, &machine));
    let rows = rows.collect();
    let seconds = began.elapsed().as_secs_f64();
    Ok(Report { machine, quick: settings.quick, seconds, rows, failed })
}

impl Settings {
    fn wants(&self, row: &RowKind) -> bool {
        self.only.is_empty() || self.only.iter().any(|name| name == row.name)
    }

    fn request(&self, row: &RowKind, precision: Precision) -> Request {
        let rows_file = self.scratch.join(format!("{}.f32", row.name));
        Request {
            name: row.name.to_owned(),
            precision,
            threads: self.threads,
            quick: self.quick,
            patient: !self.only.is_empty(),
            rows_file: row.is_compared_with_f32().then_some(rows_file),
            one_pass: false,
        }
    }

    /// The rows beside those of the machine itself, with their precisions.
    fn jobs(&self) -> Vec<(RowKind, Precision)> {
        let rows = ALL.into_iter().filter(|row| row.peak_of().is_none() && self.wants(row));
        rows.flat_map(|row| {
            // What has no choice is measured whatever precision is asked for.
            let precisions = match row.has_precisions() {
                true => self.precisions.as_slice(),
                false => &[Precision::F32],
            };
            // Training is left out where it cannot be, unless it was asked for: then it says so.
            let named = !self.only.is_empty();
            let precisions = precisions.iter().filter(move |&&p| named || row.is_in(p));
            precisions.map(move |&precision| (row, precision))
        })
        .collect()
    }

    /// Measures a row, after the same row in f32 if it is compared with that.
    fn measured(
        &self,
        row: &RowKind,
        precision: Precision,
        measure: &mut dyn FnMut(&Request) -> Result<Measured>,
    ) -> Result<Measured> {
        let request = self.request(row, precision);
        let compared = request.rows_file.as_ref().filter(|_| precision != Precision::F32);
        if compared.is_some_and(|file| !file.exists()) {
            let once = Request { precision: Precision::F32, one_pass: true, ..request.clone() };
            measure(&once)?;
        }
        measure(&request)
    }
}

/// The user asked to stop.
#[derive(Debug, thiserror::Error)]
#[error("stopped")]
pub struct Stopped;

/// Precisions by their names.
mod by_name {
    use scenesplat::kernels::Precision;
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
    pub fn serialize<S: Serializer>(precision: &Precision, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(precision.name())
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Precision, D::Error> {
        String::deserialize(from)?.parse().map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(only: &[&str], precisions: &[Precision]) -> Settings {
        Settings {
            only: only.iter().map(|&name| name.to_owned()).collect(),
            precisions: precisions.to_vec(),
            threads: 2,
            quick: true,
            scratch: PathBuf::from("scratch"),
        }
    }

    fn one_second(request: &Request) -> Result<Measured> {
        let (flop, bytes) = match request.name.as_str() {
            "bandwidth" => (0, 1000),
            _ => (100, 10),
        };
        let accuracy = None;
        // The machine is half as fast at first.
        let f32_flop_s = if request.name.starts_with("peak") { 100.0 } else { 200.0 };
        let speeds = vec![Speeds { f32_flop_s, bf16_flop_s: None, int8_op_s: None }];
        Ok(Measured {
            size: 1,
            seconds: vec![3.0, 1.0, 1.5],
            peak_bytes: None,
            flop,
            bytes,
            accuracy,
            speeds,
        })
    }

    #[test]
    fn floors_come_from_the_machine_and_ratios_from_the_median() {
        let all = settings(&["gemm_c768_100k", "knn25_500k"], &[Precision::F32, Precision::Bf16]);
        let report = run(&all, &mut |r| one_second(r), &mut |_| {}).unwrap();
        assert_eq!(report.machine.peak_f32_flop_s, 200.0);
        assert_eq!(report.machine.bandwidth_bytes_s, 1000.0 / 1.5);
        let seen: Vec<(&str, &str)> =
            report.rows.iter().map(|r| (r.name.as_str(), r.precision.as_str())).collect();
        let gemm = "gemm_c768_100k";
        assert_eq!(seen, [("knn25_500k", "f32"), (gemm, "f32"), (gemm, "bf16")]);
        let row = &report.rows[1];
        assert_eq!((row.min_s, row.median_s, row.floor_s, row.ratio), (1.0, 1.5, 0.5, 3.0));
        assert!(row.is_steady() && !report.to_string().contains('!'));
        let slow = run(&settings(&["peak_f32"], &[]), &mut |r| one_second(r), &mut |_| {}).unwrap();
        assert_eq!((slow.machine.peak_f32_flop_s, slow.rows[0].steady), (200.0, 0.5));
        assert!(slow.to_string().contains("! 1.50 s"), "{slow}");
    }

    #[test]
    fn a_row_that_fails_stops_no_other_and_the_user_stops_all() {
        let two = settings(&["conv3_c32_100k", "conv3_c64_100k"], &[Precision::F32]);
        let mut measure = |r: &Request| {
            anyhow::ensure!(r.name != "conv3_c32_100k", "no memory");
            one_second(r)
        };
        let report = run(&two, &mut measure, &mut |_| {}).unwrap();
        assert_eq!((report.rows.len(), report.failed.len()), (1, 1));
        assert_eq!(report.failed[0].reason, "no memory");
        let mut stop = |r: &Request| {
            if r.name.starts_with("conv3") { Err(Stopped.into()) } else { one_second(r) }
        };
        assert!(run(&two, &mut stop, &mut |_| {}).unwrap_err().is::<Stopped>());
        let unknown = run(&settings(&["conv4"], &[]), &mut stop, &mut |_| {}).unwrap_err();
        assert!(unknown.to_string().contains("conv3_c256_100k"), "{unknown}");
    }
}
