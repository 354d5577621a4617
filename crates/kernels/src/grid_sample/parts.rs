//! Results of several tasks, side by side in one array.

/// Zero, then the sums of the first one, two, … counts.
pub(super) fn running_sum(counts: &[usize]) -> Vec<usize> {
    let mut sum = 0;
    std::iter::once(0)
        .chain(counts.iter().map(|count| {
            sum += count;
            sum
        }))
        .collect()
}

/// Consecutive pieces `ends[i]..ends[i + 1]` of a slice.
pub(super) fn pieces<'a, T>(mut rest: &'a mut [T], ends: &[usize]) -> Vec<&'a mut [T]> {
    ends.windows(2)
        .map(|w| {
            let (piece, after) = std::mem::take(&mut rest).split_at_mut(w[1] - w[0]);
            rest = after;
            piece
        })
        .collect()
}
