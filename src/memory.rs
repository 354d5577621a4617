//! Amounts of memory as people write them.

use std::fmt;
use std::str::FromStr;

/// A number of bytes, read from `8GB`, `512MiB`, `2.5g`, `1000000`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Bytes(pub u64);

impl FromStr for Bytes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let lower = text.trim().to_ascii_lowercase();
        let digits = lower.trim_end_matches(|c: char| c.is_ascii_alphabetic());
        let unit = &lower[digits.len()..];
        let factor: f64 = match unit {
            // Eight bytes are never meant.
            "" => return Err(format!("{text:?} has no unit; write 8GB or 512MB (B for bytes)")),
            "b" => 1.0,
            "k" | "kb" => 1e3,
            "m" | "mb" => 1e6,
            "g" | "gb" => 1e9,
            "t" | "tb" => 1e12,
            "kib" => 1024.0,
            "mib" => 1024f64.powi(2),
            "gib" => 1024f64.powi(3),
            _ => return Err(format!("{unit:?} is no unit of memory; write 8GB, 512MB or 4GiB")),
        };
        let number: f64 = digits
            .trim()
            .parse()
            .map_err(|_| format!("{text:?} is no amount; write 8GB or 512MB"))?;
        if !(number.is_finite() && number > 0.0) {
            return Err(format!("{text:?} must be above 0"));
        }
        Ok(Self((number * factor) as u64))
    }
}

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let v = self.0 as f64;
        match v {
            v if v >= 1e9 => write!(f, "{:.2} GB", v / 1e9),
            v if v >= 1e6 => write!(f, "{:.1} MB", v / 1e6),
            v if v >= 1e3 => write!(f, "{:.1} kB", v / 1e3),
            _ => write!(f, "{} B", self.0),
        }
    }
}

/// Memory that this machine, or the container that the process runs in, has; `None` if the system
/// does not report it.
pub fn machine_memory() -> Option<Bytes> {
    let kib = |line: &str| line.strip_prefix("MemTotal:")?.trim().strip_suffix(" kB")?.parse().ok();
    let whole = std::fs::read_to_string("/proc/meminfo")
        .ok()?
        .lines()
        .find_map(kib)
        .map(|kib: u64| kib.saturating_mul(1024));
    // "max" where there is no limit.
    let limit = std::fs::read_to_string("/sys/fs/cgroup/memory.max").ok();
    let limit = limit.and_then(|text| text.trim().parse::<u64>().ok());
    whole.into_iter().chain(limit).min().map(Bytes)
}

/// Whether the system gives this process so many bytes now. What runs out of memory later ends without a word.
pub fn can_reserve(bytes: u64) -> bool {
    let mut room: Vec<u8> = Vec::new();
    let got = usize::try_from(bytes).is_ok_and(|bytes| room.try_reserve_exact(bytes).is_ok());
    // Room that nobody looks at would not be asked for.
    std::hint::black_box(&room);
    got
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_what_people_write() {
        for (text, want) in
            [("8GB", 8_000_000_000), ("512MiB", 536_870_912), ("1.5g", 1_500_000_000), ("42B", 42)]
        {
            assert_eq!(text.parse::<Bytes>().unwrap(), Bytes(want));
        }
        for bad in ["", "GB", "-1GB", "8XB", "8", "0GB", "nan", "inf"] {
            assert!(bad.parse::<Bytes>().is_err(), "{bad}");
        }
    }

    #[test]
    fn no_system_gives_all_addresses() {
        assert!(can_reserve(0) && can_reserve(1000));
        assert!(!can_reserve(u64::MAX) && !can_reserve(1 << 62));
    }

    #[test]
    fn a_machine_has_memory() {
        if cfg!(target_os = "linux") {
            assert!(machine_memory().unwrap() > Bytes(16_000_000));
        }
    }
}
