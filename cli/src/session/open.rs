//! Opens scenes, and chooses where their features come from.

use super::Session;
use crate::error::refuse;
use crate::flags::Inference;
use anyhow::Result;
use scenesplat::Network;
use scenesplat::input::open_input;
use scenesplat::lifted::clusters_beside;
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::ReadOptions;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where features come from.
pub enum FeatureSource {
    /// A network that is run over the scene.
    Network(Arc<Network>),
    /// The language codes of the scene.
    Codes,
    /// A file with a row per Gaussian.
    File(PathBuf),
}

impl FeatureSource {
    /// The network, if it is one with classes of its own.
    pub fn classifier(&self) -> Option<&Network> {
        match self {
            Self::Network(network) if network.is_classifier() => Some(network),
            _ => None,
        }
    }

    /// Whether a network is run.
    pub fn is_network(&self) -> bool {
        matches!(self, Self::Network(_))
    }

    /// Whether the features come from seeded weights, and mean nothing.
    pub fn has_random_weights(&self) -> bool {
        matches!(self, Self::Network(network) if network.has_random_weights())
    }

    /// What to add to a title where the result means nothing.
    pub fn remark(&self) -> &'static str {
        if self.has_random_weights() { " (seeded weights: no meaning)" } else { "" }
    }
}

impl Session<'_> {
    /// Reads a scene as a network's flags say; a labeled point cloud is turned into Gaussians.
    pub fn open(&self, path: &Path, inference: &Inference) -> Result<OpenedScene> {
        self.open_with(path, &inference.source.options())
    }

    /// Reads a scene, reports what was wrong with it, and records it; a labeled point cloud is turned into
    /// Gaussians.
    pub fn open_with(&self, path: &Path, options: &ReadOptions) -> Result<OpenedScene> {
        let _stage = self.receipt.stage("read");
        if let Some(opened) = self.take_held(path) {
            // Who holds it knows what it is, and was told what was repaired.
            return Ok(opened);
        }
        let opened = self.read(path, options)?;
        self.receipt.add_rows_in(opened.loaded.source_rows());
        if !opened.loaded.report.is_clean() {
            self.warn(opened.loaded.report.to_string());
        } else if opened.loaded.scene.has_origin() {
            self.progress.say(opened.loaded.report.to_string());
        }
        self.receipt.fingerprint("input", path)?;
        Ok(opened)
    }

    /// A scene that the caller holds, the first time that it is asked for.
    fn take_held(&self, path: &Path) -> Option<OpenedScene> {
        let mut scenes = self.held.as_ref()?.scenes.borrow_mut();
        let at = scenes.iter().position(|scene| scene.loaded.path == path)?;
        Some(scenes.remove(at))
    }

    /// Reads a scene without a report of its values; a labeled point cloud is turned into Gaussians.
    pub fn read(&self, path: &Path, options: &ReadOptions) -> Result<OpenedScene> {
        if let Some(opened) = self.take_held(path) {
            return Ok(opened);
        }
        self.outputs.reads(path)?;
        self.progress.detail(format!("reading {}", path.display()));
        let before = self.input.take().filter(|(opened, _)| opened.loaded.path == path);
        let (opened, remark) = before.map_or_else(|| open_input(path, options), Ok)?;
        if let Some(text) = remark {
            self.progress.say(text);
            self.receipt.setting("input", "point cloud", "points were turned into Gaussians");
        }
        Ok(opened)
    }

    /// Reads a scene and decides where its features come from: from the network of --weights, or,
    /// without that, from the language codes that the scene carries. `check` may refuse the
    /// network before the scene is read.
    pub fn open_with_source(
        &self,
        path: &Path,
        inference: &Inference,
        file: Option<&Path>,
        check: impl FnOnce(&Network) -> Result<()>,
    ) -> Result<(OpenedScene, FeatureSource)> {
        if let Some(file) = file {
            if inference.network.weights.is_some() || inference.network.config.is_some() {
                refuse!("--features are there already: leave out --weights and --config");
            }
            if let Some(flag) = inference.network_flag() {
                refuse!("{flag} is about the network, which --features replace");
            }
            self.outputs.reads(file)?;
            self.receipt.fingerprint("features", file)?;
            if let Some(clusters) = clusters_beside(file) {
                self.outputs.reads(&clusters)?;
                self.receipt.fingerprint("clusters", &clusters)?;
            }
            return Ok((self.open(path, inference)?, FeatureSource::File(file.to_owned())));
        }
        if inference.network.weights.is_some() {
            let network = self.network(inference)?;
            check(&network)?;
            return Ok((self.open(path, inference)?, FeatureSource::Network(network)));
        }
        if self.held.is_none() && !path.exists() {
            // The missing file is the better message.
            return self.open(path, inference).map(|opened| (opened, FeatureSource::Codes));
        }
        let opened = self.open(path, inference)?;
        let Some(code) = &opened.loaded.scene.lang_code else {
            let network = self.network(inference)?;
            check(&network)?;
            return Ok((opened, FeatureSource::Network(network)));
        };
        if let Some(flag) = inference.network_flag() {
            refuse!("{flag} is about the network; give --weights too");
        }
        if inference.network.config.is_some() {
            refuse!("--config names a network; give --weights too");
        }
        self.progress.say(format!(
            "no --weights: using the language codes of the scene, {} numbers a Gaussian",
            code.width()
        ));
        self.receipt.setting("features", "codes", "language codes that the scene carries");
        Ok((opened, FeatureSource::Codes))
    }
}
