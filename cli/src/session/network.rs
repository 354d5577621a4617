//! Loads the network that a command runs.

use super::Session;
use crate::error::{WrongUse, refuse};
use crate::flags::Inference;
use anyhow::{Context, Result};
use scenesplat::Network;
use scenesplat::kernels::simd::Isa;
use scenesplat::models::{Compute, DeviceChoice, LoadPolicy, OpenDevice};
use scenesplat::network::{NetworkError, WeightOptions, Weights, network_of};
use scenesplat::scene::printable;
use std::sync::Arc;

impl Session<'_> {
    /// The network that the flags name: the caller's, or it is loaded, and its weights are reported and recorded.
    pub fn network(&self, inference: &Inference) -> Result<Arc<Network>> {
        let held = self.held.as_ref().and_then(|held| held.network.as_ref());
        held.map_or_else(|| Ok(Arc::new(self.load(inference)?)), |network| Ok(Arc::clone(network)))
    }

    fn load(&self, inference: &Inference) -> Result<Network> {
        let _stage = self.receipt.stage("weights");
        let weights = &inference.network.weights()?;
        if *weights == Weights::Embedded && inference.network.config.is_some() {
            refuse!("--config: the network inside the program has its own; leave it out");
        }
        let precision = inference.precision.unwrap_or_default();
        let compute = Compute { precision, fold: !inference.exact };
        self.receipt.computation(precision.name(), Isa::current().name());
        let why = "form of the numbers that products multiply; sums are f32";
        self.receipt.setting("precision", precision, why);
        let partial = inference.partial_weights;
        let options = WeightOptions {
            policy: if partial { LoadPolicy::Partial } else { LoadPolicy::Strict },
            branch: inference.branch.into(),
            conv_layout: inference.conv_layout.into(),
            head: inference.head.clone(),
        };
        let config = network_of(weights, inference.network.config.as_ref(), &options)?;
        let config = inference.effective.apply_to_network(config.with_compute(compute));
        let config = config.map_err(|error| WrongUse(format!("--setting: {error}")))?;
        let device = self.device(&inference.device)?;
        let network = if inference.device == DeviceChoice::Auto && !device.is_cpu() {
            let loaded = Network::load_on(config.clone(), weights, options.clone(), &device);
            loaded.or_else(|why| {
                let cpu = Network::load_on(config, weights, options, &OpenDevice::default())?;
                self.warn_loudly(format!("--device auto: computing on the cpu: {why}"));
                self.receipt.setting("device", "cpu", "the device cannot run the network");
                Ok::<_, NetworkError>(cpu)
            })?
        } else {
            Network::load_on(config, weights, options, &device)?
        };
        self.note_weights(&network, weights);
        if partial && !network.report().is_complete() {
            self.doubt(format!("partial weights: {}", network.report()));
        }
        Ok(network)
    }

    fn note_weights(&self, network: &Network, weights: &Weights) {
        for (path, sha256) in network.files() {
            self.progress.detail(format!("weights {} sha256 {sha256}", printable(path)));
            let bytes = std::fs::metadata(path).map_or(0, |m| m.len());
            self.receipt.fingerprint_known("weights", path, bytes, sha256);
        }
        match weights {
            Weights::Seeded(seed) => {
                self.warn_loudly(format!(
                    "SEEDED WEIGHTS ({seed}): features, labels and scores mean nothing; they show \
                     the mechanism and its cost"
                ));
                self.receipt.setting("weights", format!("seeded:{seed}"), "values from a hash");
            }
            Weights::Embedded => {
                self.progress.detail(
                    "weights: the small network inside the program, trained on synthetic rooms \
                     (its card: assets/embedded/README.md)",
                );
                let sha256 = scenesplat::embedded::sha256();
                self.receipt.setting("weights", scenesplat::embedded::NAME, &sha256);
            }
            Weights::File(_) => self.progress.detail(format!("weights: {}", network.report())),
        }
    }

    /// Opens the device that --device names, and reports which it is.
    fn device(&self, choice: &DeviceChoice) -> Result<OpenDevice> {
        let opened = choice.open().context("--device")?;
        if *choice != DeviceChoice::Cpu {
            let name = match choice {
                DeviceChoice::Auto => opened.name.as_str().to_owned(),
                choice => format!("{choice} ({})", opened.name),
            };
            self.progress.detail(format!("device: {name}"));
            self.receipt.setting("device", &name, "where the network computes");
        }
        if let Some(why) = &opened.fell_back {
            self.warn_loudly(format!("--device auto: computing on the cpu: {why}"));
        }
        Ok(opened)
    }
}
