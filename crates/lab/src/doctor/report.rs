//! All verdicts together, as a table and as JSON.

use super::case::Level;
use super::verdict::Verdict;
use scenesplat::machine::Machine;
use scenesplat::memory::{Bytes, machine_memory};
use scenesplat_kernels::simd::Isa;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Where the cases ran.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Surroundings {
    /// Processor, cores, system and version; the instruction set is the one in use.
    pub machine: Machine,
    /// Instruction sets that could be used here, slowest first.
    pub instruction_sets: Vec<String>,
    /// Threads that everything was computed with, and has the same bits.
    pub threads: [usize; 2],
    /// Memory of the machine or container, bytes; 0 if the system does not tell.
    pub memory_bytes: u64,
    /// Whether checks of a debug build are on.
    pub debug_build: bool,
}

impl Surroundings {
    /// Those of this process, with so many threads at most.
    pub fn detect(threads: usize) -> Self {
        let isa = Isa::current();
        let sets = Isa::ALL.into_iter().filter(|set| *set <= isa);
        Self {
            machine: Machine { simd: isa.name().to_owned(), threads, ..Machine::detect() },
            instruction_sets: sets.map(|set| set.name().to_owned()).collect(),
            threads: [1, threads],
            memory_bytes: machine_memory().map_or(0, |bytes| bytes.0),
            debug_build: cfg!(debug_assertions),
        }
    }
}

impl fmt::Display for Surroundings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [one, many] = self.threads;
        write!(f, "{}", self.machine)?;
        write!(f, "\ninstruction sets: {}", self.instruction_sets.join(", "))?;
        write!(f, "; threads: {one} and {many}")?;
        if self.memory_bytes > 0 {
            write!(f, "; memory: {}", Bytes(self.memory_bytes))?;
        }
        if self.debug_build { write!(f, "; debug build") } else { Ok(()) }
    }
}

/// Verdicts of the operators on another instruction set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IsaReport {
    /// Name of the instruction set.
    pub isa: String,
    /// One verdict for each operator.
    pub verdicts: Vec<Verdict>,
}

/// What a run of the cases found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DoctorReport {
    /// Number of cases that ran.
    pub cases: usize,
    /// Those that passed.
    pub passed: usize,
    /// Those that did not, on this instruction set or another.
    pub failed: usize,
    /// How long all of it took.
    pub seconds: f64,
    /// Where.
    pub surroundings: Surroundings,
    /// What became of each case.
    pub verdicts: Vec<Verdict>,
    /// The operators on the other instruction sets, if that was asked for.
    pub other_instruction_sets: Vec<IsaReport>,
}

impl DoctorReport {
    /// Of these verdicts. A case that fails on any instruction set has failed.
    pub fn new(
        surroundings: Surroundings,
        verdicts: Vec<Verdict>,
        other_instruction_sets: Vec<IsaReport>,
        seconds: f64,
    ) -> Self {
        let elsewhere = |name: &str| {
            let all = other_instruction_sets.iter().flat_map(|report| &report.verdicts);
            all.filter(|v| v.name == name).all(|v| v.passed)
        };
        let passed = verdicts.iter().filter(|v| v.passed && elsewhere(&v.name)).count();
        let cases = verdicts.len();
        Self {
            cases,
            passed,
            failed: cases - passed,
            seconds,
            surroundings,
            verdicts,
            other_instruction_sets,
        }
    }

    /// Failures on any instruction set, each with its name.
    fn failures(&self) -> impl Iterator<Item = (&str, &Verdict)> {
        let here = self.surroundings.machine.simd.as_str();
        let own = self.verdicts.iter().map(move |v| (here, v));
        let others = self.other_instruction_sets.iter();
        let others = others.flat_map(|report| report.verdicts.iter().map(|v| (&*report.isa, v)));
        own.chain(others).filter(|(_, v)| !v.passed)
    }
}

impl fmt::Display for DoctorReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.surroundings)?;
        let width = self.verdicts.iter().map(|v| v.name.chars().count()).max().unwrap_or(0);
        for level in Level::ALL {
            let mut area = "";
            let of_level = self.verdicts.iter().filter(|v| v.level == level);
            for (i, v) in of_level.enumerate() {
                if i == 0 {
                    writeln!(f, "\nlevel {}: {level}", level.number())?;
                }
                if v.area != area {
                    area = &v.area;
                    writeln!(f, "  {area}")?;
                }
                let mark = if v.passed { "ok" } else { "FAILED" };
                let error = match v.error {
                    Some(error) if v.tolerance > 0.0 => {
                        format!("{error:.1e} of {:.0e}", v.tolerance)
                    }
                    _ => String::new(),
                };
                let measures = v.measures.to_string();
                let line = format!(
                    "    {:<width$}  {:<8}  {mark:<6}  {error:<16}  {measures}",
                    v.name,
                    v.policy.name()
                );
                writeln!(f, "{}", line.trim_end())?;
            }
        }
        for report in &self.other_instruction_sets {
            let passed = report.verdicts.iter().filter(|v| v.passed).count();
            writeln!(f, "\non {}: {passed} of {} operators", report.isa, report.verdicts.len())?;
        }
        for (isa, v) in self.failures() {
            let why = v.failure.as_deref().unwrap_or("without a word");
            writeln!(f, "\nFAILED {} ({isa}): {why}\n  from: {}", v.name, v.origin)?;
        }
        if let Some((v, share)) = self.tightest() {
            writeln!(
                f,
                "\nnearest to its tolerance: {}, {:.0} % of it ({})",
                v.name,
                100.0 * share,
                v.worst
            )?;
        }
        let Self { cases, passed, failed, seconds, .. } = self;
        write!(f, "{cases} cases, {passed} passed, {failed} failed, {seconds:.1} s")
    }
}

impl DoctorReport {
    /// The case that passed with the largest part of its tolerance.
    fn tightest(&self) -> Option<(&Verdict, f64)> {
        let shares = self.verdicts.iter().filter(|v| v.passed && v.tolerance > 0.0);
        let shares = shares.filter_map(|v| Some((v, v.error? / v.tolerance)));
        shares.max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, share)| *share > 0.0)
    }
}
