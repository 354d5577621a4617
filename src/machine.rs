//! Where a program runs: what its times depend on.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fmt;

/// Where a command ran.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
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
    /// Number type of the computation.
    pub dtype: String,
}

impl Machine {
    /// This machine; number type and instruction set are for those to say who know them.
    pub fn detect() -> Self {
        Self {
            cpu: cpu_name().unwrap_or_else(|| "unknown processor".to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            threads: rayon::current_num_threads(),
            os: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            ..Self::default()
        }
    }

    /// SHA-256 of what times depend on: processor, cores, threads, instruction set, system and version
    /// of the program. Hexadecimal, 16 digits.
    pub fn fingerprint(&self) -> String {
        let Self { cpu, cores, threads, simd, os, version, .. } = self;
        let text = format!("{cpu}\n{cores}\n{threads}\n{simd}\n{os}\n{version}");
        let hash = Sha256::digest(text.as_bytes());
        hash.iter().take(8).map(|byte| format!("{byte:02x}")).collect()
    }
}

impl fmt::Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { cpu, cores, threads, simd, os, version, dtype } = self;
        write!(f, "{cpu}, {cores} cores, {threads} threads")?;
        for part in [simd, dtype, os] {
            if !part.is_empty() {
                write!(f, ", {part}")?;
            }
        }
        write!(f, ", scenesplat {version}")
    }
}

/// Largest resident memory of this process so far, bytes; `None` if the system does not report it.
pub fn peak_memory_bytes() -> Option<u64> {
    status_bytes("VmHWM:")
}

/// Resident memory of this process now, bytes; `None` if the system does not report it.
pub fn resident_memory_bytes() -> Option<u64> {
    status_bytes("VmRSS:")
}

fn status_bytes(field: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(field))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib * 1024)
}

fn cpu_name() -> Option<String> {
    let info = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = info.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fingerprint_tells_machines_and_versions_apart() {
        let here = Machine::detect();
        assert_eq!(here.fingerprint(), Machine::detect().fingerprint());
        assert_eq!(here.fingerprint().len(), 16);
        let others = [
            Machine { version: "0.0.0".to_owned(), ..here.clone() },
            Machine { threads: here.threads + 1, ..here.clone() },
            Machine { cpu: "abacus".to_owned(), ..here.clone() },
        ];
        for other in others {
            assert_ne!(other.fingerprint(), here.fingerprint(), "{other}");
        }
        // The number type is a part of the setting, not of the machine.
        let dtype = Machine { dtype: "bf16".to_owned(), ..here.clone() };
        assert_eq!(dtype.fingerprint(), here.fingerprint());
    }
}
