//! Runs a network over a scene, and reports how.

use super::{FeatureSource, Session};
use crate::flags::Inference;
use crate::progress::interrupted;
use anyhow::{Context, Result};
use scenesplat::inference::{EncodeError, Fidelity};
use scenesplat::input::read_features;
use scenesplat::outputs::OpenedScene;
use scenesplat::{Network, SceneEncoder, SceneFeatures};
use scenesplat_lab::compensation::{Compensation, tiles_section};

impl Session<'_> {
    /// The features of a scene from their source; `about`: the rows that a network does not read.
    pub fn features(
        &self,
        opened: &OpenedScene,
        source: &FeatureSource,
        inference: &Inference,
        about: &Compensation,
    ) -> Result<SceneFeatures> {
        let scene = &opened.loaded.scene;
        match source {
            FeatureSource::Network(network) => self.encode(opened, network, inference, about),
            FeatureSource::File(path) => Ok(read_features(path, &opened.loaded)?),
            FeatureSource::Codes => {
                SceneFeatures::from_codes(scene).context("the scene carries no language codes")
            }
        }
    }

    /// Runs the network over the rows of a scene that `about` keeps.
    pub fn encode(
        &self,
        opened: &OpenedScene,
        network: &Network,
        inference: &Inference,
        about: &Compensation,
    ) -> Result<SceneFeatures> {
        let scene = &opened.loaded.scene;
        let encoder = self.encoder(network, inference);
        let alignment = self.alignment_of(opened, inference, network)?;
        let _stage = self.receipt.stage("network");
        self.tell_alignment(&alignment, inference.as_is);
        self.tell_floor(&alignment, network.input().reads_height(), inference.floor)?;
        self.note_encoder(&encoder, inference);
        let kept = about.kept(scene.len());
        let features = encoder.encode_kept(scene, alignment, &kept, &mut |at| {
            if interrupted() {
                return Err(EncodeError::Stopped);
            }
            let part = |name: &str, number: usize, of: usize| match of {
                0 | 1 => String::new(),
                of => format!(", {name} {number}/{of}"),
            };
            let step = part("pass", at.pass, at.passes) + &part("tile", at.tile, at.tiles);
            self.progress.advance(&format!("network{step}"), at.done);
            Ok(())
        });
        self.progress.finish();
        let features = features.map_err(|error| match error {
            EncodeError::Memory { .. } => anyhow::Error::from(error).context("--max-memory"),
            other => other.into(),
        })?;
        let tiles = tiles_section(&features.summary, inference.max_memory.is_some());
        self.receipt.plan(scene.len(), tiles);
        self.tell_features(&features);
        Ok(features)
    }

    pub(super) fn encoder<'n>(
        &self,
        network: &'n Network,
        inference: &Inference,
    ) -> SceneEncoder<'n> {
        let encoder = SceneEncoder {
            fidelity: if inference.exact { Fidelity::Exact } else { Fidelity::Fast },
            grid_size: inference.grid_size.unwrap_or(network.grid_size()),
            max_memory: inference.max_memory.map(|b| b.0),
            halo: inference.halo,
            shuffle_orders: inference.shuffle_orders.then_some(inference.seed),
            spill_folder: self.shared.out.clone(),
            ..SceneEncoder::new(network)
        };
        inference.effective.apply_to_encoder(encoder)
    }

    fn note_encoder(&self, encoder: &SceneEncoder<'_>, inference: &Inference) {
        let why = "fast: one Gaussian a voxel; exact: a sampling at half the voxel size, averaged";
        let fidelity = match encoder.fidelity {
            Fidelity::Fast => "fast".to_owned(),
            Fidelity::Passes(passes) => format!("at most {passes} passes of exact"),
            Fidelity::Exact => "exact".to_owned(),
        };
        self.receipt.setting("fidelity", fidelity, why);
        self.receipt.setting("grid_size", encoder.grid_size, "meters");
        if inference.shuffle_orders {
            self.receipt.setting("shuffle_orders", inference.seed, "seed");
        }
    }

    fn tell_features(&self, features: &SceneFeatures) {
        let (receipt, s) = (&self.receipt, features.summary);
        if s.tiles > s.passes {
            let why = match s.limited_by_device {
                true => "the scene was cut to what one array of the device holds",
                false => "the scene was cut to stay below --max-memory",
            };
            receipt.setting("tiles", s.tiles, why);
            receipt.setting("halo", s.smallest_halo, "narrowest context around a tile, voxels");
        }
        if s.shrunk_halos > 0 {
            let mend = match s.limited_by_device {
                true => "the device's arrays allow no more; the cpu does",
                false => "allow more memory",
            };
            self.warn(format!(
                "{} tiles had to narrow their halo to as little as {} voxels; features near their \
                 borders differ from an untiled run ({mend})",
                s.shrunk_halos, s.smallest_halo
            ));
        }
        self.progress.detail(format!(
            "{} Gaussians, {} voxels, {} passes, {} tiles, {} voxels computed",
            features.len(),
            s.voxels,
            s.passes,
            s.tiles,
            s.voxels_computed
        ));
        if !features.calibrated.is_empty() {
            let each = features.calibrated.iter();
            let shares = each.map(|(name, kept)| format!("{:.2} % in {name}", 100.0 * kept));
            let text = shares.collect::<Vec<_>>().join(", ");
            self.progress.detail(format!("rank: convolutions keep {text}"));
            receipt.setting("rank_keeps", text, "of their variance, on a part of the scene");
        }
        if let Some(codes) = features.codes() {
            let text = format!("{:.2} %", 100.0 * codes.kept);
            self.progress.detail(format!(
                "codes: {} of {} numbers keep {text} of the features' squared length",
                codes.codes(),
                codes.width
            ));
            receipt.setting("codes_keep", text, "of the features' squared length");
        }
    }
}
