//! How many rows a format cannot hold as they are.

/// Rows that a limit concerns, counted in parallel and merged.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LimitTally {
    pub(crate) rows: usize,
    pub(crate) first_row: usize,
    pub(crate) largest_change: f64,
}

impl Default for LimitTally {
    fn default() -> Self {
        Self { rows: 0, first_row: usize::MAX, largest_change: 0.0 }
    }
}

impl LimitTally {
    /// Counts a row that changes by `change`.
    pub(crate) fn add(&mut self, row: usize, change: f64) {
        self.rows += 1;
        self.first_row = self.first_row.min(row);
        // A change from infinity to a number is infinite; NaN never is the larger one.
        self.largest_change = self.largest_change.max(change);
    }

    /// The rows of both.
    pub(crate) fn merge(self, other: Self) -> Self {
        Self {
            rows: self.rows + other.rows,
            first_row: self.first_row.min(other.first_row),
            largest_change: self.largest_change.max(other.largest_change),
        }
    }
}

/// Tallies of the limits of a format, in the order of its table of limits.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits<const N: usize>(pub(crate) [LimitTally; N]);

impl<const N: usize> Default for Limits<N> {
    fn default() -> Self {
        Self([LimitTally::default(); N])
    }
}

impl<const N: usize> Limits<N> {
    /// The rows of both.
    pub(crate) fn merge(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i].merge(other.0[i])))
    }
}
