//! Less data than there is: the first batches of an epoch, the same batches again and again, some scenes of a dataset.

use crate::{BatchLoader, BatchPart, DataError, Dataset, LeftOut, Sample};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

/// How much of something: a number, or a share of all.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Amount {
    /// So many, at least 1.
    Count(usize),
    /// A share, above 0 and at most 1; of anything at least one.
    Share(f64),
}

impl Amount {
    /// How many of `all` that is.
    pub fn of(self, all: usize) -> usize {
        match self {
            Self::Count(count) => count.min(all),
            Self::Share(share) => ((all as f64 * share) as usize).clamp(1, all.max(1)).min(all),
        }
    }

    /// Whether it is in its range.
    pub fn is_valid(self) -> bool {
        match self {
            Self::Count(count) => count > 0,
            Self::Share(share) => share > 0.0 && share <= 1.0,
        }
    }
}

impl FromStr for Amount {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let amount = text.parse().map(Self::Count).or_else(|_| text.parse().map(Self::Share));
        amount.ok().filter(|amount| amount.is_valid()).ok_or_else(|| {
            format!(
                "{text:?}: a number such as 10, or a share above 0 and at most 1.0, such as 0.1"
            )
        })
    }
}

impl fmt::Display for Amount {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count(count) => write!(f, "{count}"),
            // A point tells a share of 1 from one.
            Self::Share(share) => write!(f, "{share:?}"),
        }
    }
}

/// A loader of which only the first batches of each epoch are used.
pub struct LimitedLoader<'a, B> {
    inner: Box<dyn BatchLoader<B> + 'a>,
    batches: usize,
    repeats: bool,
}

impl<'a, B> LimitedLoader<'a, B> {
    /// The first batches of each epoch, or all if there are not so many.
    pub fn first(inner: impl BatchLoader<B> + 'a, batches: usize) -> Self {
        Self { inner: Box::new(inner), batches, repeats: false }
    }

    /// The first batches of the first epoch in every epoch, with the same augmentation: what a network that can learn
    /// at all learns by heart.
    pub fn same(inner: impl BatchLoader<B> + 'a, batches: usize) -> Self {
        Self { inner: Box::new(inner), batches, repeats: true }
    }
}

impl<B> BatchLoader<B> for LimitedLoader<'_, B> {
    fn batches_per_epoch(&self) -> usize {
        self.batches.min(self.inner.batches_per_epoch())
    }

    fn epoch(
        &mut self,
        epoch: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = Result<B, DataError>> + '_> {
        let rest = self.batches_per_epoch().saturating_sub(skip);
        Box::new(self.inner.epoch(if self.repeats { 0 } else { epoch }, skip).take(rest))
    }

    fn epoch_part<'s>(
        &'s mut self,
        epoch: u64,
        skip: usize,
        part: BatchPart,
    ) -> Box<dyn Iterator<Item = Result<B, DataError>> + 's>
    where
        B: 's,
    {
        let held = (skip..self.batches_per_epoch()).filter(|place| part.holds(*place)).count();
        let epoch = if self.repeats { 0 } else { epoch };
        Box::new(self.inner.epoch_part(epoch, skip, part).take(held))
    }

    fn left_out(&self) -> LeftOut {
        self.inner.left_out()
    }
}

impl<B> BatchLoader<B> for Box<dyn BatchLoader<B> + '_> {
    fn batches_per_epoch(&self) -> usize {
        (**self).batches_per_epoch()
    }

    fn epoch(
        &mut self,
        epoch: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = Result<B, DataError>> + '_> {
        (**self).epoch(epoch, skip)
    }

    fn epoch_part<'s>(
        &'s mut self,
        epoch: u64,
        skip: usize,
        part: BatchPart,
    ) -> Box<dyn Iterator<Item = Result<B, DataError>> + 's>
    where
        B: 's,
    {
        (**self).epoch_part(epoch, skip, part)
    }

    fn left_out(&self) -> LeftOut {
        (**self).left_out()
    }
}

/// Some samples of a dataset.
pub struct SomeScenes {
    inner: Arc<dyn Dataset>,
    samples: Vec<usize>,
}

impl SomeScenes {
    /// The samples of these numbers, in this order; those that are not there are left away.
    pub fn new(inner: Arc<dyn Dataset>, samples: impl IntoIterator<Item = usize>) -> Self {
        let count = inner.len();
        let samples = samples.into_iter().filter(|sample| *sample < count).collect();
        Self { inner, samples }
    }

    /// The samples of scenes with these names.
    pub fn named(inner: Arc<dyn Dataset>, is_wanted: impl Fn(&str) -> bool) -> Self {
        let samples = (0..inner.len()).filter(|sample| is_wanted(inner.id(*sample))).collect();
        Self { inner, samples }
    }
}

impl Dataset for SomeScenes {
    fn len(&self) -> usize {
        self.samples.len()
    }

    fn get(&self, epoch: u64, index: usize) -> Result<Sample, DataError> {
        let out = DataError::RowOutOfRange { row: index, rows: self.len() };
        self.inner.get(epoch, *self.samples.get(index).ok_or(out)?)
    }

    fn id(&self, index: usize) -> &str {
        self.samples.get(index).map_or("", |sample| self.inner.id(*sample))
    }

    fn left_out(&self) -> LeftOut {
        self.inner.left_out()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_are_numbers_or_shares() {
        let of = |text: &str, all: usize| text.parse::<Amount>().map(|amount| amount.of(all));
        assert_eq!(of("3", 8), Ok(3));
        assert_eq!(of("30", 8), Ok(8));
        // Rounded down, but never to nothing.
        assert_eq!(of("0.3", 8), Ok(2));
        assert_eq!(of("0.01", 8), Ok(1));
        assert_eq!((of("1.0", 8), of("1", 8)), (Ok(8), Ok(1)));
        assert_eq!(of("1.0", 0), Ok(0));
        for wrong in ["0", "0.0", "1.5", "-1", "-0.5", "nan", "inf", "all", ""] {
            assert!(of(wrong, 8).unwrap_err().contains(wrong), "{wrong}");
        }
        for text in ["7", "1.0", "0.25"] {
            assert_eq!(text.parse::<Amount>().unwrap().to_string(), text);
        }
    }

    /// Batches that are their epoch and place.
    struct Numbered(usize);

    impl BatchLoader<(u64, usize)> for Numbered {
        fn batches_per_epoch(&self) -> usize {
            self.0
        }

        fn epoch(
            &mut self,
            epoch: u64,
            skip: usize,
        ) -> Box<dyn Iterator<Item = Result<(u64, usize), DataError>> + '_> {
            Box::new((skip..self.0).map(move |place| Ok((epoch, place))))
        }
    }

    fn places(
        batches: Box<dyn Iterator<Item = Result<(u64, usize), DataError>> + '_>,
    ) -> Vec<(u64, usize)> {
        batches.map(Result::unwrap).collect()
    }

    #[test]
    fn an_epoch_ends_early_or_begins_again() {
        let mut first = LimitedLoader::first(Numbered(5), 3);
        assert_eq!(first.batches_per_epoch(), 3);
        assert_eq!(places(first.epoch(2, 0)), [(2, 0), (2, 1), (2, 2)]);
        assert_eq!(places(first.epoch(2, 2)), [(2, 2)]);
        assert_eq!(places(first.epoch(2, 3)), []);
        assert_eq!(LimitedLoader::first(Numbered(5), 9).batches_per_epoch(), 5);
        let mut same = LimitedLoader::same(Numbered(5), 2);
        assert_eq!(places(same.epoch(7, 0)), [(0, 0), (0, 1)]);
        assert_eq!(places(same.epoch(7, 1)), [(0, 1)]);
        // The second of two processes.
        let part = BatchPart { group: 2, first: 1, count: 1 };
        assert_eq!(
            places(LimitedLoader::first(Numbered(9), 4).epoch_part(1, 0, part)),
            [(1, 1), (1, 3)]
        );
        assert_eq!(places(same.epoch_part(3, 0, part)), [(0, 1)]);
    }
}
