//! Where networks compute: the processor, or a graphics processor.
//!
//! A program with the feature `cuda` is built without any toolkit and starts without any driver: CUDA's libraries
//! are loaded when a device is opened, and the kernels are compiled then. So "there is no such device" is an answer
//! that [`DeviceChoice::open`] gives, with the reason.

#[cfg(feature = "cuda")]
mod cuda;
#[cfg(feature = "emulation")]
pub(crate) mod emulated;
#[cfg(feature = "cuda")]
pub(crate) mod launcher;
pub(crate) mod launches;

use candle_core::Device;
use std::fmt;
use std::str::FromStr;

/// A device as it is asked for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum DeviceChoice {
    /// The processor.
    #[default]
    Cpu,
    /// The CUDA device of this number.
    Cuda(usize),
    /// The Metal device of this number.
    Metal(usize),
    /// The first CUDA or Metal device; the processor if there is none.
    Auto,
}

/// A device that is ready, and what there is to say about it.
#[derive(Debug, Clone)]
pub struct OpenDevice {
    /// The device.
    pub device: Device,
    /// What it calls itself, or `cpu`.
    pub name: String,
    /// Why it is the processor, where another one was looked for.
    pub fell_back: Option<DeviceError>,
}

/// Why a device cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DeviceError {
    /// The program has no code for it.
    #[error(
        "{device}: this program was built without {what}; build it with the feature {feature}, or compute on cpu"
    )]
    NotBuilt {
        /// What was asked for.
        device: DeviceChoice,
        /// The interface.
        what: &'static str,
        /// The feature that adds it.
        feature: &'static str,
    },
    /// There is no such interface on this system.
    #[error("{device}: {what} is there on {systems} alone; compute on cpu")]
    OtherSystem {
        /// What was asked for.
        device: DeviceChoice,
        /// The interface.
        what: &'static str,
        /// Where it is.
        systems: &'static str,
    },
    /// A library was not found.
    #[error("{device}: {library} was not found; {help}, or compute on cpu")]
    NoLibrary {
        /// What was asked for.
        device: DeviceChoice,
        /// Its name.
        library: &'static str,
        /// Where to get it.
        help: &'static str,
    },
    /// There is no such device, or it does not answer.
    #[error("{device}: {problem}; compute on cpu, or see what nvidia-smi says")]
    Unusable {
        /// What was asked for.
        device: DeviceChoice,
        /// What the driver said.
        problem: String,
    },
    /// The kernels could not be made ready.
    #[error("{device}: the kernels cannot be made ready: {problem}")]
    Kernels {
        /// What was asked for.
        device: DeviceChoice,
        /// Which, and why.
        problem: String,
    },
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Cuda(n) => write!(f, "cuda:{n}"),
            Self::Metal(n) => write!(f, "metal:{n}"),
            Self::Auto => f.write_str("auto"),
        }
    }
}

impl FromStr for DeviceChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let problem = || {
            format!("{text:?} is no device; write cpu, cuda:0 (or another number), metal:0 or auto")
        };
        let (name, number) = text.split_once(':').map_or((text, None), |(name, n)| (name, Some(n)));
        let number = match number {
            // Digits alone: a number may not be written in several ways.
            Some(n) if !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()) => {
                Some(n.parse().map_err(|_| problem())?)
            }
            Some(_) => return Err(problem()),
            None => None,
        };
        match (name, number) {
            ("cpu", None) => Ok(Self::Cpu),
            ("auto", None) => Ok(Self::Auto),
            ("cuda", number) => Ok(Self::Cuda(number.unwrap_or(0))),
            ("metal", number) => Ok(Self::Metal(number.unwrap_or(0))),
            _ => Err(problem()),
        }
    }
}

impl DeviceChoice {
    /// Makes the device ready: finds libraries and driver, compiles the kernels or takes them from the cache.
    ///
    /// # Errors
    /// Why that is not possible. [`Auto`](Self::Auto) gives the processor then, and the reason with it.
    pub fn open(self) -> Result<OpenDevice, DeviceError> {
        match self {
            Self::Cpu => Ok(cpu(None)),
            Self::Cuda(number) => cuda(self, number),
            Self::Metal(number) => metal(self, number),
            Self::Auto => {
                let first = if cfg!(target_vendor = "apple") {
                    metal(Self::Metal(0), 0)
                } else {
                    cuda(Self::Cuda(0), 0)
                };
                Ok(first.unwrap_or_else(|why| cpu(Some(why))))
            }
        }
    }
}

/// Names of the families of candle's CUDA kernels that were asked for and that this program has not; an operation has failed
/// then, with an error of the driver that does not say it.
pub fn missing_kernels() -> Vec<&'static str> {
    #[cfg(feature = "cuda")]
    return candle_core::cuda_backend::kernels::asked_in_vain()
        .into_iter()
        .map(|id| id.name())
        .collect();
    #[cfg(not(feature = "cuda"))]
    Vec::new()
}

/// Whether tensors there are not the CPU's: packed weights and the kernels of the CPU are not for them.
pub(crate) fn off_host(device: &Device) -> bool {
    #[cfg(feature = "emulation")]
    if emulated::is_emulated() {
        return true;
    }
    !device.is_cpu()
}

fn cpu(fell_back: Option<DeviceError>) -> OpenDevice {
    OpenDevice { device: Device::Cpu, name: "cpu".to_owned(), fell_back }
}

#[cfg(feature = "cuda")]
fn cuda(choice: DeviceChoice, number: usize) -> Result<OpenDevice, DeviceError> {
    cuda::open(choice, number)
}

#[cfg(not(feature = "cuda"))]
fn cuda(device: DeviceChoice, _: usize) -> Result<OpenDevice, DeviceError> {
    Err(DeviceError::NotBuilt { device, what: "CUDA", feature: "cuda" })
}

#[cfg(all(feature = "metal", target_vendor = "apple"))]
fn metal(device: DeviceChoice, number: usize) -> Result<OpenDevice, DeviceError> {
    let opened = Device::new_metal(number);
    let problem = |error: candle_core::Error| error.to_string();
    let opened = opened.map_err(|e| DeviceError::Unusable { device, problem: problem(e) })?;
    Ok(OpenDevice { device: opened, name: device.to_string(), fell_back: None })
}

#[cfg(not(all(feature = "metal", target_vendor = "apple")))]
fn metal(device: DeviceChoice, _: usize) -> Result<OpenDevice, DeviceError> {
    Err(match cfg!(target_vendor = "apple") {
        true => DeviceError::NotBuilt { device, what: "Metal", feature: "metal" },
        false => DeviceError::OtherSystem { device, what: "Metal", systems: "Apple's systems" },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_devices() {
        for (text, choice) in [
            ("cpu", DeviceChoice::Cpu),
            ("auto", DeviceChoice::Auto),
            ("cuda", DeviceChoice::Cuda(0)),
            ("cuda:3", DeviceChoice::Cuda(3)),
            ("metal:0", DeviceChoice::Metal(0)),
        ] {
            assert_eq!(text.parse::<DeviceChoice>().unwrap(), choice);
        }
        assert_eq!(DeviceChoice::Cuda(3).to_string(), "cuda:3");
        for wrong in
            ["", "gpu", "cpu:0", "auto:1", "cuda:", "cuda:-1", "cuda:+1", "cuda:1 ", "CUDA:0"]
        {
            let error = wrong.parse::<DeviceChoice>().unwrap_err();
            assert!(error.contains("cuda:0") && error.contains("cpu"), "{error}");
        }
    }

    #[test]
    fn what_is_not_there_is_said() {
        assert!(DeviceChoice::Cpu.open().unwrap().fell_back.is_none());
        if !cfg!(feature = "cuda") {
            let error = DeviceChoice::Cuda(1).open().unwrap_err();
            assert!(error.to_string().starts_with("cuda:1: "), "{error}");
            assert!(matches!(error, DeviceError::NotBuilt { feature: "cuda", .. }));
        }
        if !cfg!(target_vendor = "apple") {
            let error = DeviceChoice::Metal(0).open().unwrap_err();
            assert!(matches!(error, DeviceError::OtherSystem { .. }));
            assert!(error.to_string().contains("Apple"), "{error}");
        } else if !cfg!(feature = "metal") {
            let error = DeviceChoice::Metal(0).open().unwrap_err();
            assert!(matches!(error, DeviceError::NotBuilt { feature: "metal", .. }));
        }
        // Whatever this machine has: a device that is not the processor, or the processor and a reason.
        let auto = DeviceChoice::Auto.open().unwrap();
        assert_eq!(auto.device.is_cpu(), auto.fell_back.is_some());
    }
}
