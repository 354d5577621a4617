//! An experiment on less data than there is.

use scenesplat_datasets::{Amount, BatchLoader, LimitedLoader, TrainBatch};
use scenesplat_kernels::settings;

settings! {
    /// Less data than there is: for a quick look, or to see whether a network can learn at all.
    #[derive(Copy)]
    pub struct LimitsConfig {
        /// Batches of each epoch: a number, or a share such as 0.1.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub train: Option<Amount> = None,
        /// Scenes of each evaluation: a number, or a share.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub evaluate: Option<Amount> = None,
        /// Trains on so many batches again and again: the first ones of the first epoch, with the same augmentation. All
        /// evaluations read the scenes of these batches in place of their own.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub overfit: Option<usize> = None,
    }
}

impl LimitsConfig {
    /// Whether all data are used.
    pub fn is_off(&self) -> bool {
        *self == Self::default()
    }

    /// The loader with these limits.
    pub(super) fn of_loader(
        &self,
        loader: Box<dyn BatchLoader<TrainBatch>>,
    ) -> Box<dyn BatchLoader<TrainBatch>> {
        match (self.overfit, self.train) {
            (Some(batches), _) => Box::new(LimitedLoader::same(loader, batches)),
            (None, Some(amount)) => {
                let batches = amount.of(loader.batches_per_epoch());
                Box::new(LimitedLoader::first(loader, batches))
            }
            (None, None) => loader,
        }
    }
}
