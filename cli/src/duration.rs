//! Lengths of time as people write them.

/// A time above 0, seconds.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Seconds(pub f64);

/// Reads `500ms`, `2s`, `1.5m`, `2min`, `2h`; a number alone is seconds.
pub fn parse_duration(text: &str) -> Result<Seconds, String> {
    let lower = text.trim().to_ascii_lowercase();
    // `nan` and `inf` are numbers, if no times.
    let alone = lower.parse::<f64>().is_ok();
    let number =
        if alone { &lower } else { lower.trim_end_matches(|c: char| c.is_ascii_alphabetic()) };
    let factor = match lower[number.len()..].trim() {
        "" | "s" | "sec" => 1.0,
        "ms" => 1e-3,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        unit => {
            return Err(format!(
                "{text:?}: {unit:?} is no unit of time; write 500ms, 2s, 10m or 2h"
            ));
        }
    };
    let number: Result<f64, _> = number.trim().parse();
    let seconds = number.map_err(|_| format!("{text:?} is no time; write 500ms, 2s, 10m or 2h"))?;
    if !(seconds.is_finite() && seconds > 0.0) {
        return Err(format!("{text:?}: a time above 0 is expected"));
    }
    Ok(Seconds(seconds * factor))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_as_they_are_written() {
        let read = |text: &str| parse_duration(text).unwrap().0;
        assert_eq!(
            ["2s", "500ms", "1.5m", "2 min", "2h", "3"].map(read),
            [2.0, 0.5, 90.0, 120.0, 7200.0, 3.0]
        );
        for bad in ["", "s", "0", "0s", "-1s", "nan", "inf", "2 parsecs", "1e400s"] {
            assert!(parse_duration(bad).is_err(), "{bad}");
        }
    }
}
