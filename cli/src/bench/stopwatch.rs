//! How often a row is timed.

use super::{Measured, Request};
use crate::receipt::Receipt;
use anyhow::Result;
use std::time::{Duration, Instant};

/// A pass longer than this is its own warm-up: what is cold at its begin is warm for nearly all of it.
const OWN_WARM_UP: Duration = Duration::from_millis(700);
/// A pass longer than this is timed once.
const ONCE: Duration = Duration::from_secs(3);

/// Times `pass` as often as the request allows, and notes the memory.
///
/// Short rows: one pass to warm up, then three to twenty samples within two seconds. Long rows:
/// three passes, or one of three seconds or more. A patient request: at least five, within eight
/// seconds more. A quick one: five, and long rows once. With one pass asked for, there is one sample.
pub(super) fn time(request: &Request, mut pass: impl FnMut() -> Result<()>) -> Result<Measured> {
    let mut once = || -> Result<Duration> {
        let began = Instant::now();
        pass()?;
        Ok(began.elapsed())
    };
    let first = once()?;
    let mut samples = Vec::new();
    if request.one_pass || first >= OWN_WARM_UP {
        samples.push(first);
    }
    let (least, budget) = match (request.patient, request.quick) {
        _ if request.one_pass => (1, Duration::ZERO),
        (_, true) if first >= OWN_WARM_UP => (1, Duration::ZERO),
        (_, true) => (5, Duration::from_millis(200)),
        (true, false) => (5, Duration::from_secs(8)),
        (false, false) if first >= ONCE => (1, Duration::ZERO),
        (false, false) => (3, Duration::from_secs(2)),
    };
    let began = Instant::now();
    while samples.len() < least || (samples.len() < 20 && began.elapsed() < budget) {
        samples.push(once()?);
    }
    Ok(Measured {
        size: 0,
        seconds: samples.iter().map(Duration::as_secs_f64).collect(),
        peak_bytes: Receipt::new("").finish().peak_memory_bytes,
        flop: 0,
        bytes: 0,
        accuracy: None,
        speeds: Vec::new(),
    })
}
