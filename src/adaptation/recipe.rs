//! The experiment that an adaptation is: the recipe in `configs/adapt.toml`, for one network and one scene.

use super::error::AdaptError;
use super::settings::{AdaptSettings, Folders};
use crate::experiment::ExperimentConfig;
use crate::experiment::config::{TextConfig, TransformList};
use crate::network::NetworkConfig;
use scenesplat_datasets::SourceConfig;
use scenesplat_datasets::transforms::TransformConfig;
use std::path::PathBuf;

const RECIPE: &str = include_str!("../../configs/adapt.toml");

/// The first of the seeds of rooms to learn from; those that figures are of are far from it.
const ROOMS: u64 = 0xADA0_0000;

/// The recipe for so many steps of a network, whose weights are at `start`.
///
/// # Errors
/// If the settings do not fit together.
pub fn experiment(
    network: &NetworkConfig,
    start: PathBuf,
    folders: &Folders,
    settings: &AdaptSettings,
) -> Result<ExperimentConfig, AdaptError> {
    let mut config: ExperimentConfig =
        toml::from_str(RECIPE).map_err(crate::experiment::ExperimentError::from)?;
    let width = network.model.out_channels();
    config.model = network.model.clone();
    config.input = network.input.clone();
    config.init_from = Some(start);
    config.set_seed(settings.seed);
    config.trainer.max_steps = Some(settings.steps);
    let steps = usize::try_from(settings.steps).unwrap_or(usize::MAX);
    // A scene and a room each step; of the rooms every other one is a scan.
    let rooms = [steps - steps / 2, steps / 2];
    let mut nth = 0;
    for entry in &mut config.train {
        match &mut entry.source {
            SourceConfig::Generic(folder) => {
                folder.root = folders.data();
                entry.repeat = steps;
            }
            SourceConfig::Synthetic(source) => {
                source.count = rooms[nth];
                let seed = settings.seed.wrapping_mul(2).wrapping_add(nth as u64);
                source.seed = ROOMS.wrapping_add(seed);
                source.vocabulary = Some(width);
                source.room.num_gaussians = settings.room_gaussians;
                nth += 1;
            }
            _ => {}
        }
        if let TransformList::Steps(steps) = &mut entry.transforms {
            for step in steps {
                if let TransformConfig::GridSample(sample) = step {
                    sample.grid_size = network.model.grid_size;
                }
            }
        }
    }
    config.train.retain(|entry| match &entry.source {
        SourceConfig::Synthetic(source) => source.count > 0,
        _ => true,
    });
    if let Some(TextConfig::Vocabulary { dim, .. }) = &mut config.text {
        *dim = width;
    }
    // The rates of the recipe, in proportion.
    let by = settings.lr / config.optimizer.lr;
    config.optimizer.lr = settings.lr;
    config.optimizer.groups.iter_mut().for_each(|group| group.lr *= by);
    config.check()?;
    Ok(config)
}
