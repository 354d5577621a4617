//! Short language codes: what travels with a scene where 768 numbers a Gaussian would not.

use crate::SceneError;
use half::f16;

/// Turns codes back into language features: `feature = mean + Σ codeⱼ · axisⱼ`; a code of zeros
/// means that there is no feature.
#[derive(Debug, Clone, PartialEq)]
pub struct LanguageCodebook {
    /// What all features have in common. `[D]`
    pub mean: Vec<f32>,
    /// What one unit of each number of a code adds, row by row. `[k, D]`
    pub axes: Vec<f32>,
}

/// One code per Gaussian with the codebook that decodes it.
#[derive(Debug, Clone, PartialEq)]
pub struct LanguageCode {
    /// Codes, row by row. `[N, k]`
    pub values: Vec<f16>,
    /// What they mean.
    pub codebook: LanguageCodebook,
}

impl LanguageCodebook {
    /// Width of a feature, D.
    pub fn feature_width(&self) -> usize {
        self.mean.len()
    }

    /// Width of a code, k.
    pub fn code_width(&self) -> usize {
        if self.mean.is_empty() { 0 } else { self.axes.len() / self.mean.len() }
    }

    /// Checks that the shapes fit and every number is finite.
    ///
    /// # Errors
    /// Says which is not.
    pub fn check(&self) -> Result<(), SceneError> {
        let width = self.mean.len();
        if width == 0 || self.axes.is_empty() || !self.axes.len().is_multiple_of(width) {
            return Err(SceneError::RowCount {
                field: "language codebook",
                expected: width,
                got: self.axes.len(),
            });
        }
        let finite = self.mean.iter().chain(&self.axes).position(|v| !v.is_finite());
        if let Some(at) = finite {
            return Err(SceneError::Classes {
                problem: format!("the language codebook holds a number that is not finite ({at})"),
                help: "compute the codes again".to_owned(),
            });
        }
        Ok(())
    }
}

impl LanguageCode {
    /// Width of a code, k.
    pub fn width(&self) -> usize {
        self.codebook.code_width()
    }

    /// The language feature of a row, into `out` of D numbers, zeros if it has none; sums in f32, in
    /// the order of the code.
    ///
    /// # Panics
    /// If `row` is out of range or `out` is not D wide.
    pub fn decode(&self, row: usize, out: &mut [f32]) {
        let k = self.width();
        let width = self.codebook.feature_width();
        let code = &self.values[row * k..(row + 1) * k];
        if code.iter().all(|v| *v == f16::ZERO) {
            return out.fill(0.0);
        }
        out.copy_from_slice(&self.codebook.mean);
        for (value, axis) in code.iter().zip(self.codebook.axes.chunks_exact(width)) {
            let value = value.to_f32();
            for (o, a) in out.iter_mut().zip(axis) {
                *o += value * a;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_is_a_sum_of_axes() {
        let codebook =
            LanguageCodebook { mean: vec![1.0, 2.0, 3.0], axes: vec![1., 0., 0., 0., 1., 1.] };
        codebook.check().unwrap();
        let values = [0.5, -2.0, 0.0, 0.0].map(f16::from_f32).to_vec();
        let code = LanguageCode { values, codebook };
        assert_eq!(code.width(), 2);
        let mut out = [0.0; 3];
        code.decode(0, &mut out);
        assert_eq!(out, [1.5, 0.0, 1.0]);
        code.decode(1, &mut out);
        assert_eq!(out, [0.0; 3], "zeros are no feature");
    }

    #[test]
    fn ragged_and_infinite_codebooks_are_refused() {
        let ragged = LanguageCodebook { mean: vec![0.0; 3], axes: vec![0.0; 4] };
        assert!(ragged.check().is_err());
        let empty = LanguageCodebook { mean: vec![], axes: vec![] };
        assert!(empty.check().is_err());
        let nan = LanguageCodebook { mean: vec![0.0; 2], axes: vec![0.0, f32::NAN] };
        assert!(nan.check().unwrap_err().to_string().contains("(3)"));
    }
}
