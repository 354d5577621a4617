//! Axes: where a value stands, and which values get a mark.

/// An axis of a plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Scale {
    low: f64,
    high: f64,
    logarithmic: bool,
    pixels: [f64; 2],
}

impl Scale {
    /// Holds all finite values with some room around them; logarithmic only where all are above 0.
    pub fn over(values: &[f64], logarithmic: bool, pixels: [f64; 2]) -> Self {
        let finite = || values.iter().copied().filter(|v| v.is_finite());
        let (low, high) = finite()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if !low.is_finite() {
            return Self { low: 0.0, high: 1.0, logarithmic: false, pixels };
        }
        if logarithmic && low > 0.0 {
            // At least half a decade: equal values get a range, too.
            let room = ((high / low).ln() * 0.08).max(0.25).exp();
            return Self { low: low / room, high: high * room, logarithmic: true, pixels };
        }
        let size = low.abs().max(high.abs());
        let room = match high > low {
            // Marks stay apart in 64 bits.
            true => ((high - low) * 0.08).max(size * 1e-12),
            false => (size * 0.01).max(1e-6),
        };
        Self { low: low - room, high: high + room, logarithmic: false, pixels }
    }

    /// Where a value stands, pixels.
    pub fn at(&self, value: f64) -> f64 {
        let share = if self.logarithmic {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        self.pixels[0] + share * (self.pixels[1] - self.pixels[0])
    }

    /// Four to nine values inside, one, two or five times a power of ten each.
    pub fn ticks(&self) -> Vec<f64> {
        let inside = |v: &f64| (self.low..=self.high).contains(v);
        if self.logarithmic {
            let decades = (self.low.log10().floor() as i32)..=(self.high.log10().ceil() as i32);
            let of = |factors: &[f64]| -> Vec<f64> {
                let all =
                    decades.clone().flat_map(|e| factors.iter().map(move |f| f * 10f64.powi(e)));
                all.filter(inside).collect()
            };
            let dense = of(&[1.0, 2.0, 5.0]);
            match dense.len() {
                // Less than a decade.
                0..=2 => {}
                3..=8 => return dense,
                _ => return of(&[1.0]),
            }
        }
        let raw = (self.high - self.low) / 8.0;
        let power = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|f| f * power).into_iter().find(|s| *s >= raw);
        let step = step.unwrap_or(10.0 * power);
        let first = (self.low / step).ceil() as i64;
        (first..).map(|i| i as f64 * step).take_while(|v| *v <= self.high).take(16).collect()
    }
}

/// Texts of [`Scale::ticks`], with the digits that their distance asks for: no two are the same. What takes more than
/// seven letters stands in powers of ten where that is shorter.
pub fn labels(ticks: &[f64]) -> Vec<String> {
    let gaps = ticks.windows(2).map(|two| two[1] - two[0]);
    let gap = gaps.fold(f64::INFINITY, f64::min);
    if gap == f64::INFINITY {
        return ticks.iter().map(f64::to_string).collect();
    }
    let power = |value: f64| (value.log10() + 1e-6).floor() as i32;
    let longest = |texts: &[String]| texts.iter().map(String::len).max().unwrap_or(0);
    let places = usize::try_from(-power(gap)).unwrap_or(0);
    let plain: Vec<String> = ticks.iter().map(|tick| format!("{tick:.places$}")).collect();
    if longest(&plain) <= 7 {
        return plain;
    }
    let size = ticks.iter().map(|tick| tick.abs()).fold(gap, f64::max);
    let digits = usize::try_from(power(size) - power(gap)).unwrap_or(0);
    let powers: Vec<String> = ticks.iter().map(|tick| in_powers(*tick, digits)).collect();
    if longest(&powers) < longest(&plain) { powers } else { plain }
}

/// A number such as `1.5e-6`, of so many digits behind the point at most.
fn in_powers(value: f64, digits: usize) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let text = format!("{value:.digits$e}");
    match text.split_once('e') {
        Some((number, power)) if number.contains('.') => {
            format!("{}e{power}", number.trim_end_matches('0').trim_end_matches('.'))
        }
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_stand_in_order_and_marks_inside() {
        let linear = Scale::over(&[0.40, 0.72, f64::NAN], false, [500.0, 100.0]);
        assert!(linear.at(0.40) > linear.at(0.72) && linear.at(0.72) > 100.0);
        let ticks = linear.ticks();
        assert!((4..=9).contains(&ticks.len()), "{ticks:?}");
        assert!(ticks.iter().all(|t| (100.0..=500.0).contains(&linear.at(*t))));
        let log = Scale::over(&[0.1, 20.0], true, [0.0, 100.0]);
        assert!((log.at(1.0) - log.at(0.1) - (log.at(10.0) - log.at(1.0))).abs() < 1e-9);
        assert!(log.ticks().iter().any(|t| (t - 1.0).abs() < 1e-12), "{:?}", log.ticks());
        for same in
            [Scale::over(&[2.0, 2.0], true, [0.0, 1.0]), Scale::over(&[0.0], false, [0.0, 1.0])]
        {
            assert!(!same.ticks().is_empty() && same.at(same.ticks()[0]).is_finite(), "{same:?}");
        }
        assert_eq!(Scale::over(&[], true, [0.0, 1.0]).at(0.5), 0.5);
    }

    #[test]
    fn no_two_marks_have_the_same_text() {
        let ranges = [
            [0.99998, 1.00002],
            [1.0, 1.0 + 1e-5],
            [1e6, 1e6 + 1.0],
            [-1e6 - 1.0, -1e6],
            [-0.31, -0.29],
            [-2.0, 3.0],
            [99.0, 101.0],
            [0.0, 3.0],
            [0.0, 1.5e6],
            [0.0, 3e-7],
            [1e-7, 1.00001e-7],
            [1e12, 1e12 + 0.01],
            [4.0, 4.0 + 4.0 * f64::EPSILON],
            [0.3, 0.3],
            [0.0, 0.0],
            [-1e6, -1e6],
            [1e-5, 1e-5],
            [7e30, 7e30],
        ];
        for range in ranges {
            let ticks = Scale::over(&range, false, [0.0, 1.0]).ticks();
            let texts = labels(&ticks);
            assert!((4..=9).contains(&texts.len()), "{range:?}: {texts:?}");
            for (i, two) in texts.windows(2).enumerate() {
                assert_ne!(two[0], two[1], "{range:?}: {texts:?}");
                // What is printed is the place of the mark, to a hundredth of their distance.
                let (said, gap) = (two[0].parse::<f64>().unwrap(), ticks[i + 1] - ticks[i]);
                assert!((said - ticks[i]).abs() < 0.01 * gap, "{range:?}: {texts:?} {ticks:?}");
            }
        }
        let of = |range: [f64; 2]| labels(&Scale::over(&range, false, [0.0, 1.0]).ticks());
        assert_eq!(of([0.99998, 1.00002])[..2], ["0.99998", "0.99999"]);
        assert_eq!(of([0.0, 1e5])[..3], ["0", "20000", "40000"]);
        assert_eq!(of([0.0, 1e9])[..3], ["0", "2e8", "4e8"]);
        assert_eq!(of([1e6, 1e6 + 1.0])[..2], ["1000000.0", "1000000.2"]);
        // On a logarithmic axis they are as far apart as the least two.
        let decades = labels(&Scale::over(&[0.001, 2.0], true, [0.0, 1.0]).ticks());
        assert_eq!(decades[..2], ["0.001", "0.010"]);
        assert_eq!(labels(&[0.25]), ["0.25"]);
    }
}
