//! Sizes that come from outside, multiplied without wrapping around.

/// Values of an array with these sides.
///
/// Lengths of slices are compared with this before anything is read through a pointer: a product
/// that wrapped around would let a short slice pass for a long one.
///
/// # Panics
/// If there are more than a `usize` can count.
#[inline]
#[track_caller]
pub(crate) fn elements<const N: usize>(sides: [usize; N]) -> usize {
    let product = sides.iter().try_fold(1usize, |product, &side| product.checked_mul(side));
    assert!(product.is_some(), "sizes {sides:?} overflow");
    product.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_up_to_the_last() {
        assert_eq!(elements([3, 4, 5]), 60);
        assert_eq!(elements([usize::MAX, 1]), usize::MAX);
        assert_eq!(elements([]), 1);
        for sides in [[1 << 32, 1 << 32], [usize::MAX, 2]] {
            assert!(std::panic::catch_unwind(|| elements(sides)).is_err());
        }
    }
}
