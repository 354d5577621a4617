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
        let room = ((high - low) * 0.08).max(high.abs() * 0.01).max(1e-6);
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
}
