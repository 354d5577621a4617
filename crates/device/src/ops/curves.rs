//! Codes of space-filling curves, and the orders they make.

use super::{kernels, radix_sort, rows};
use crate::launch::{Items::PerThread, Launcher, Scalar::U32};

kernels! { "curves":
    /// Codes of cells along one of four curves.
    CURVE_CODES = curve_codes, 256, PerThread;
}

/// Most bits that a grid coordinate may have.
pub const MAX_DEPTH: u32 = 21;

/// One space-filling curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Curve {
    /// Morton order, x most significant.
    Z,
    /// Morton order of (y, x, z).
    ZTrans,
    /// Hilbert order.
    Hilbert,
    /// Hilbert order of (y, x, z).
    HilbertTrans,
}

impl Curve {
    fn number(self) -> u32 {
        match self {
            Self::Z => 0,
            Self::ZTrans => 1,
            Self::Hilbert => 2,
            Self::HilbertTrans => 3,
        }
    }
}

/// Codes of cells, `depth` bits an axis.
///
/// # Shapes
/// `cells`: `[N, 3]` of `i32`, each in 0..2^depth · `out`: `[N]` of `u64`
///
/// # Errors
/// Those of the launcher.
///
/// # Panics
/// If the depth is above [`MAX_DEPTH`].
pub fn codes<L: Launcher>(
    l: &L,
    curve: Curve,
    cells: &L::Buffer,
    n: u32,
    depth: u32,
    out: &mut L::Buffer,
) -> Result<(), L::Error> {
    assert!(depth <= MAX_DEPTH, "curve codes: {depth} bits");
    l.expect::<[i32; 3]>("cells", cells, n.into());
    l.expect::<u64>("codes", out, n.into());
    l.run(&CURVE_CODES, n.into(), &[cells], &mut [out], &[U32(n), U32(curve.number()), U32(depth)])
}

/// An order along a curve.
#[derive(Debug)]
pub struct Order<B> {
    /// Row at each position. `[N]` of `u32`
    pub order: B,
    /// Position of each row. `[N]` of `u32`
    pub inverse: B,
}

/// Rows of one scene in the order of their codes, equal codes in the order of rows.
///
/// # Shapes
/// `cells`: `[N, 3]` of `i32`, each in 0..2^depth
///
/// # Errors
/// Those of the launcher.
pub fn order<L: Launcher>(
    l: &L,
    curve: Curve,
    cells: &L::Buffer,
    n: u32,
    depth: u32,
) -> Result<Order<L::Buffer>, L::Error> {
    let mut codes_of = l.alloc_values::<u64>(n as usize)?;
    codes(l, curve, cells, n, depth, &mut codes_of)?;
    let sorted = radix_sort::sort(l, codes_of, n, 3 * depth)?;
    let mut inverse = l.alloc_values::<u32>(n as usize)?;
    rows::invert(l, &sorted.rows, n, &mut inverse)?;
    Ok(Order { order: sorted.rows, inverse })
}
