//! `--setting` among the other flags.

use crate::error::{WrongUse, refuse};
use crate::flags::{Inference, NetworkArgs};
use anyhow::Result;
use scenesplat::Setting;
use scenesplat::embedded;
use scenesplat::metrics::MAX_VOTERS;
use scenesplat::network::{NetworkChoice, Weights};
use scenesplat::setting::Passes;
use std::fmt::Display;
use std::path::PathBuf;

pub use scenesplat::labels::VOTE_K;

impl Inference {
    /// The flags with the parts of `--setting` among them, and `--vote-k` too.
    ///
    /// # Errors
    /// If a flag says otherwise than the setting.
    pub fn settled(&self, vote_k: Option<usize>) -> Result<(Self, usize)> {
        let setting = self.setting.clone().unwrap_or_default();
        let k = one("--vote-k", vote_k, "k", setting.k)?;
        if let Some(k) = k.filter(|k| *k > MAX_VOTERS) {
            refuse!("--vote-k {k}: at most {MAX_VOTERS} neighbors vote");
        }
        if let (true, Some(passes @ Passes::Count(_))) = (self.exact, setting.passes) {
            return Err(contradiction("--exact", "passes", &passes));
        }
        let exact = self.exact || setting.passes == Some(Passes::All);
        let settled = Self {
            network: self.network.with_net(setting.net.as_deref())?,
            grid_size: one("--grid-size", self.grid_size, "voxel", setting.voxel)?,
            precision: one("--precision", self.precision, "precision", setting.precision)?,
            exact,
            ..self.clone()
        };
        let flags = Setting {
            voxel: self.grid_size,
            precision: self.precision,
            passes: self.exact.then_some(Passes::All),
            k,
            ..Setting::default()
        };
        Ok((Self { effective: setting.or(&flags), ..settled }, k.unwrap_or(VOTE_K)))
    }

    /// A part of `--setting` that only means something to a network.
    pub fn network_part(&self) -> Option<&'static str> {
        let parts = self.setting.as_ref().map(Setting::parts).unwrap_or_default();
        parts.into_iter().map(|(key, _)| key).find(|key| *key != "k")
    }
}

impl NetworkArgs {
    /// The network of a setting.
    ///
    /// # Errors
    /// If a flag names another one, or there is none of this name.
    pub fn with_net(&self, net: Option<&str>) -> Result<Self> {
        let Some(net) = net else { return Ok(self.clone()) };
        let mut args = self.clone();
        if let (false, Ok(choice)) = (net == embedded::NAME, net.parse::<NetworkChoice>()) {
            args.config = one("--config", self.config.clone(), "net", Some(choice))?;
            return Ok(args);
        }
        let weights = if net == embedded::NAME {
            Weights::Embedded
        } else {
            let path = PathBuf::from(net);
            if !path.exists() {
                let names = NetworkChoice::NAMED.map(|(name, _)| name).join(", ");
                refuse!(
                    "--setting net={net}: there is no such file or folder, and no network of that \
                     name ({}, {names})",
                    embedded::NAME
                );
            }
            Weights::File(path)
        };
        if self.weights.as_ref().is_some_and(|given| *given != weights) {
            return Err(contradiction("--weights", "net", &net));
        }
        if let (Weights::Embedded, Some(config)) = (&weights, &self.config) {
            return Err(contradiction(&format!("--config {config}"), "net", &net));
        }
        args.weights = Some(weights);
        Ok(args)
    }
}

/// What a flag or the setting says, if both do not disagree.
fn one<T: PartialEq + Display>(
    flag: &str,
    given: Option<T>,
    key: &str,
    part: Option<T>,
) -> Result<Option<T>> {
    match (given, part) {
        (Some(given), Some(part)) if given != part => {
            Err(contradiction(&format!("{flag} {given}"), key, &part))
        }
        (given, part) => Ok(given.or(part)),
    }
}

fn contradiction(flag: &str, key: &str, part: &dyn Display) -> anyhow::Error {
    WrongUse(format!("{flag} contradicts --setting {key}={part}: leave one of them out")).into()
}
