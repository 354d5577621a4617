//! How exactly the network's products are computed.

use std::fmt;
use std::str::FromStr;

/// Form of the operands of matrix products, convolutions and attention.
///
/// Sums are f32 in all of them (of integers i32 first), and so are softmax, norms and everything between the products.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, PartialOrd, Ord)]
pub enum Precision {
    /// f32 operands.
    #[default]
    F32,
    /// Each f32 operand as the sum of two bf16 numbers, three products instead of one: an error of
    /// at most 2⁻¹⁵ of the sum of the products' magnitudes, typically below 1e-6. ±∞ gives NaN. Only where the CPU has bf16 tiles (AMX) is that faster than
    /// [`Precision::F32`]; elsewhere this computes exactly as `F32` does.
    F32Split,
    /// Operands rounded to bf16 (8 bits of mantissa): relative error about 3e-3 of the result. Uses
    /// AMX or AVX512-BF16; elsewhere the operands are rounded alike and multiplied in f32, which
    /// gives the same accuracy without the speed.
    Bf16,
    /// For inference only. Linear layers and convolutions of 64 channels and more multiply integers
    /// in −127..=127, rows and columns (output channels; of convolutions for each tap) each with a
    /// scale of their own, summed exactly in i32: relative error about 1e-2 of the result, a row's
    /// outliers at the cost of its other values. Narrower layers compute as [`F32`](Self::F32), the
    /// core of attention as [`Bf16`](Self::Bf16).
    ///
    /// Uses AMX, AVX512-VNNI or AVX-VNNI; elsewhere the same integers are multiplied without speed. The
    /// products have the same bits on every CPU. A row with a NaN or ±∞ gives NaN in all columns.
    Int8,
    /// Rows and weights stored in 16 bits (11 bits of mantissa, largest value 65,504), products of f32. For inference on
    /// graphics processors alone: networks on the CPU refuse it, and its kernels compute it as [`F32`](Self::F32).
    F16,
}

impl Precision {
    /// All of the CPU, most exact first.
    pub const ALL: [Self; 4] = [Self::F32, Self::F32Split, Self::Bf16, Self::Int8];

    /// Whether networks can be trained in it; [`Precision::Int8`] and [`Precision::F16`] have no gradient.
    pub fn has_gradient(self) -> bool {
        !matches!(self, Self::Int8 | Self::F16)
    }

    /// That of gradients, where this one is asked for.
    pub(crate) fn of_gradients(self) -> Self {
        if self.has_gradient() { self } else { Self::F32 }
    }

    /// As [`FromStr`], and `f16` as well: for networks that may be on a graphics processor.
    ///
    /// # Errors
    /// If there is no such name.
    pub fn of_any_device(name: &str) -> Result<Self, String> {
        match name {
            "f16" => Ok(Self::F16),
            name => name.parse().map_err(|problem| format!("{problem}; f16 with --device gpu")),
        }
    }

    /// Name as [`FromStr`] reads it, which reads those of the CPU.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F32Split => "split",
            Self::Bf16 => "bf16",
            Self::Int8 => "int8",
            Self::F16 => "f16",
        }
    }
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Precision {
    type Err = String;
    fn from_str(name: &str) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|p| p.name() == name);
        known.ok_or_else(|| format!("unknown precision {name:?}: choose f32, split, bf16 or int8"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        for p in Precision::ALL {
            assert_eq!(p.to_string().parse(), Ok(p));
        }
        for p in Precision::ALL.into_iter().chain([Precision::F16]) {
            assert_eq!(Precision::of_any_device(p.name()), Ok(p));
        }
        assert!(Precision::of_any_device("f64").unwrap_err().contains("f16 with --device gpu"));
        assert!("f16".parse::<Precision>().unwrap_err().contains("choose"));
    }
}
