//! The right-hand side of a product, packed into panels.

use super::bf16;
use super::int8::{self, Quads};
use super::micro::PANEL;
use crate::Precision;
use crate::shape::elements;
use crate::simd::Isa;

/// What multiplies: follows from the precision and the CPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unit {
    /// Multiply–adds of f32.
    Vector,
    /// Multiply–adds of f32 that were rounded to bf16.
    RoundedVector,
    /// Dot products of bf16 pairs in vector registers.
    Pairs,
    /// The same on both parts of each f32: high·high + high·low + low·high. Slower than f32; it is
    /// there to check the parts on CPUs without tiles.
    #[cfg_attr(not(test), expect(dead_code, reason = "for tests"))]
    SplitPairs,
    /// Dot products of four 8-bit integers.
    Quads,
    /// The same on tiles.
    QuadTiles,
    /// Products of bf16 tiles.
    Tiles,
    /// The same on both parts of each f32.
    SplitTiles,
}

impl Unit {
    /// The fastest way to the precision on this CPU, for `k` values a sum and `n` columns.
    pub(crate) fn of(precision: Precision, k: usize, n: usize) -> Self {
        match (precision, Isa::current()) {
            (Precision::Int8, _) if k.min(n) < int8::LEAST_CHANNELS => Self::Vector,
            #[cfg(all(target_arch = "x86_64", target_os = "linux"))]
            (Precision::Int8, Isa::Amx) if super::amx::has_bytes() => Self::QuadTiles,
            (Precision::Int8, _) => Self::Quads,
            (Precision::Bf16, Isa::Amx) => Self::Tiles,
            (Precision::Bf16, Isa::Avx512Bf16) => Self::Pairs,
            (Precision::Bf16, _) => Self::RoundedVector,
            (Precision::F32Split, Isa::Amx) => Self::SplitTiles,
            // Three dot products of pairs take longer than one of f32.
            (Precision::F32Split | Precision::F32 | Precision::F16, _) => Self::Vector,
        }
    }

    /// Steps of the inner loop for sums over `k` values.
    pub(crate) fn steps(self, k: usize) -> usize {
        let pairs = k.div_ceil(2);
        // A tile takes 16 pairs.
        let tiles = pairs.next_multiple_of(16);
        match self {
            Self::Vector | Self::RoundedVector => k,
            Self::Pairs => pairs,
            Self::Quads => k.div_ceil(4),
            Self::QuadTiles => k.div_ceil(4).next_multiple_of(16),
            Self::SplitPairs => 3 * pairs,
            Self::Tiles => tiles,
            Self::SplitTiles => 3 * tiles,
        }
    }

    /// Words of a left-hand row of `steps` steps.
    pub(crate) fn row_words(self, steps: usize) -> usize {
        steps + self.scale_words()
    }

    /// Words behind those of the steps: the scale of integers, and what keeps rows of tiles in whole
    /// cache lines.
    fn scale_words(self) -> usize {
        match self {
            Self::Quads => 1,
            Self::QuadTiles => 16,
            _ => 0,
        }
    }

    /// Writes a left-hand row as pairs or integers. `to`: `[row_words]`
    pub(crate) fn prepare_words(self, from: &[f32], to: &mut [u32]) {
        match self {
            Self::Quads | Self::QuadTiles => {
                let (integers, behind) = to.split_at_mut(to.len() - self.scale_words());
                behind[0] = int8::quantize(from, integers).to_bits();
            }
            Self::SplitPairs | Self::SplitTiles => {
                // [high, high, low] meets [high, low, high].
                let (high, rest) = to.split_at_mut(to.len() / 3);
                let (again, low) = rest.split_at_mut(high.len());
                bf16::split_pairs(from, high, low);
                again.copy_from_slice(high);
            }
            _ => bf16::round_pairs(from, to),
        }
    }
}

#[derive(Debug, Clone)]
pub(crate) enum Values {
    Single(Vec<f32>),
    Pairs(Vec<u32>),
    /// In a box: it has more parts than the others, and layers lie in enumerations.
    Quads(Box<Quads>),
}

/// A `[k, n]` matrix packed for the right-hand side of a product.
#[derive(Debug, Clone)]
pub struct PackedMatrix {
    pub(super) values: Values,
    pub(super) unit: Unit,
    k: usize,
    n: usize,
    steps: usize,
}

impl PackedMatrix {
    /// Packs a matrix given by strides: element `(p, j)` is `values[p·k_stride + j·n_stride]`.
    ///
    /// A weight stored `[out, in]` for `y = x·Wᵀ` is packed with `k = in`, `n = out`,
    /// `k_stride = 1`, `n_stride = in`.
    ///
    /// # Panics
    /// If an element is not in `values` (a bug of the caller).
    pub fn from_strided(
        values: &[f32],
        k: usize,
        n: usize,
        k_stride: usize,
        n_stride: usize,
    ) -> Self {
        Self::from_strided_with(Precision::F32, values, k, n, k_stride, n_stride)
    }

    /// [`PackedMatrix::from_strided`] for products of another precision.
    ///
    /// # Panics
    /// As [`PackedMatrix::from_strided`].
    pub fn from_strided_with(
        precision: Precision,
        values: &[f32],
        k: usize,
        n: usize,
        k_stride: usize,
        n_stride: usize,
    ) -> Self {
        Self::for_unit(Unit::of(precision, k, n), values, k, n, k_stride, n_stride)
    }

    pub(crate) fn for_unit(
        unit: Unit,
        values: &[f32],
        k: usize,
        n: usize,
        k_stride: usize,
        n_stride: usize,
    ) -> Self {
        let mut packed = Self::empty_for(unit);
        packed.fill(values, k, n, k_stride, n_stride);
        packed
    }

    /// A buffer for [`repack_with`].
    pub(crate) fn empty() -> Self {
        Self::empty_for(Unit::Vector)
    }

    fn empty_for(unit: Unit) -> Self {
        let values = match unit {
            Unit::Vector | Unit::RoundedVector => Values::Single(Vec::new()),
            Unit::Quads | Unit::QuadTiles => Values::Quads(Box::default()),
            _ => Values::Pairs(Vec::new()),
        };
        Self { values, unit, k: 0, n: 0, steps: 0 }
    }

    fn fill(&mut self, values: &[f32], k: usize, n: usize, k_stride: usize, n_stride: usize) {
        if k > 0 && n > 0 {
            let last = elements([k - 1, k_stride]).checked_add(elements([n - 1, n_stride]));
            let inside = last.is_some_and(|last| last < values.len());
            assert!(inside, "packed matrix: [{k}, {n}] with strides {k_stride}, {n_stride}");
            // The three parts of a split matrix, and padding to whole tiles and panels.
            elements([k.max(32), n.max(16), 16]);
        }
        (self.k, self.n, self.steps) = (k, n, self.unit.steps(k));
        let (len, unit, steps) = (self.steps * self.padded_n(), self.unit, self.steps);
        match &mut self.values {
            Values::Single(packed) => {
                packed.clear();
                packed.resize(len, 0.0);
                pack(packed, k, n, (values, k_stride, n_stride), |x| x);
                if unit == Unit::RoundedVector {
                    packed.iter_mut().for_each(|v| *v = bf16::widen(bf16::round(*v)));
                }
            }
            Values::Pairs(packed) => {
                packed.clear();
                packed.resize(len, 0);
                pack_pairs(packed, unit, steps, (k, n), (values, k_stride, n_stride));
            }
            Values::Quads(packed) => packed.fill(steps, (k, n), (values, k_stride, n_stride)),
        }
    }

    #[cfg(test)]
    pub(super) fn unit(&self) -> Unit {
        self.unit
    }

    /// Length of the sums.
    pub fn k(&self) -> usize {
        self.k
    }

    /// Number of columns.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Columns with padding.
    pub(crate) fn padded_n(&self) -> usize {
        self.n.next_multiple_of(16)
    }

    /// Steps of the inner loop.
    pub(crate) fn steps(&self) -> usize {
        self.steps
    }

    /// Words of a left-hand row that was prepared for this matrix.
    pub(crate) fn row_words(&self) -> usize {
        self.unit.row_words(self.steps)
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        match &self.values {
            Values::Single(v) => size_of_val(v.as_slice()),
            Values::Pairs(v) => size_of_val(v.as_slice()),
            Values::Quads(quads) => quads.bytes(),
        }
    }
}

/// Packs another matrix into the same buffer; arguments as [`PackedMatrix::from_strided_with`].
pub(crate) fn repack_with(
    into: &mut PackedMatrix,
    precision: Precision,
    values: &[f32],
    k: usize,
    n: usize,
    k_stride: usize,
    n_stride: usize,
) {
    let unit = Unit::of(precision, k, n);
    if into.unit != unit {
        *into = PackedMatrix::empty_for(unit);
    }
    into.fill(values, k, n, k_stride, n_stride);
}

/// A matrix by its values and the strides of its rows and columns.
type Strided<'a, T> = (&'a [T], usize, usize);

/// Packs into panels of [`PANEL`] columns (the last one of the next multiple of 16), row by row.
fn pack<T: Copy, U: Copy>(
    packed: &mut [U],
    k: usize,
    n: usize,
    (values, k_stride, n_stride): Strided<'_, T>,
    convert: impl Fn(T) -> U,
) {
    let padded_n = n.next_multiple_of(16);
    let mut start = 0;
    while start < padded_n {
        let width = PANEL.min(padded_n - start);
        let panel = &mut packed[start * k..(start + width) * k];
        let filled = width.min(n - start);
        if n_stride == 1 {
            for p in 0..k {
                let from = &values[p * k_stride + start..][..filled];
                for (to, from) in panel[p * width..p * width + filled].iter_mut().zip(from) {
                    *to = convert(*from);
                }
            }
        } else {
            // Blocks of 16 rows of the panel: reads run along k, writes stay in 16 cache lines.
            for first in (0..k).step_by(16) {
                let last = (first + 16).min(k);
                for j in 0..filled {
                    let from = (start + j) * n_stride;
                    for p in first..last {
                        panel[p * width + j] = convert(values[from + p * k_stride]);
                    }
                }
            }
        }
        start += width;
    }
}

/// Packs pairs of neighbors along k, panel by panel. `packed` starts zeroed.
fn pack_pairs(
    packed: &mut [u32],
    unit: Unit,
    steps: usize,
    (k, n): (usize, usize),
    (values, k_stride, n_stride): Strided<'_, f32>,
) {
    let split = matches!(unit, Unit::SplitPairs | Unit::SplitTiles);
    let part = if split { steps / 3 } else { steps };
    let padded_n = n.next_multiple_of(16);
    let mut start = 0;
    while start < padded_n {
        let width = PANEL.min(padded_n - start);
        let panel = &mut packed[start * steps..(start + width) * steps];
        // Eight pairs at a time: reads stay in few cache lines whichever stride is 1.
        for first in (0..k.div_ceil(2)).step_by(8) {
            let last = (first + 8).min(k.div_ceil(2));
            for j in 0..width.min(n - start) {
                let column = (start + j) * n_stride;
                for p in first..last {
                    let even = values[column + 2 * p * k_stride];
                    let odd =
                        if 2 * p + 1 < k { values[column + (2 * p + 1) * k_stride] } else { 0.0 };
                    let at = p * width + j;
                    if split {
                        let (even, odd) = (bf16::split(even), bf16::split(odd));
                        let high = even.0 | odd.0 << 16;
                        panel[at] = high;
                        panel[part * width + at] = even.1 | odd.1 << 16;
                        panel[2 * part * width + at] = high;
                    } else {
                        panel[at] = bf16::round(even) | bf16::round(odd) << 16;
                    }
                }
            }
        }
        start += width;
    }
}
