//! Where networks compute: the processor, a CUDA device, or a graphics processor of any maker.
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
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
pub enum DeviceChoice {
    /// The processor.
    #[default]
    Cpu,
    /// The CUDA device of this number.
    Cuda(usize),
    /// A graphics processor of any maker, for inference.
    Gpu(GpuName),
    /// The first CUDA device, else the first graphics processor that is no program on the CPU; the processor if there is
    /// none.
    Auto,
}

/// Which graphics processor.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
pub enum GpuName {
    /// The best for computing.
    #[default]
    Best,
    /// Of this number in the system's list, the best first.
    Number(usize),
    /// Whose name contains this text.
    Named(String),
}

/// A device that is ready, and what there is to say about it.
#[derive(Debug, Clone)]
pub struct OpenDevice {
    /// Where tensors are: the processor for a graphics processor without tensors.
    pub device: Device,
    /// The graphics processor that runs networks.
    #[cfg(feature = "wgpu")]
    pub gpu: Option<scenesplat_gpu::Gpu>,
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
    /// There is no such graphics processor, or it cannot run the kernels.
    #[error("{device}: {problem}")]
    Gpu {
        /// What was asked for.
        device: DeviceChoice,
        /// Why.
        problem: String,
    },
    /// Tensors cannot be there, only networks for inference.
    #[error("{device}: it runs networks for inference; train on cpu or cuda:0")]
    NoTensors {
        /// What was asked for.
        device: DeviceChoice,
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
            Self::Gpu(GpuName::Best) => f.write_str("gpu"),
            Self::Gpu(GpuName::Number(n)) => write!(f, "gpu:{n}"),
            Self::Gpu(GpuName::Named(name)) => write!(f, "gpu:{name}"),
            Self::Auto => f.write_str("auto"),
        }
    }
}

impl FromStr for DeviceChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let problem = || {
            format!(
                "{text:?} is no device; write cpu, cuda:0 (or another number), gpu, gpu:1, gpu:NAME or auto"
            )
        };
        let (name, number) = text.split_once(':').map_or((text, None), |(name, n)| (name, Some(n)));
        // Digits alone: a number may not be written in several ways.
        let is_number = |n: &str| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit());
        let parsed = |n: &str| n.parse().map_err(|_| problem());
        match (name, number) {
            ("cpu", None) => Ok(Self::Cpu),
            ("auto", None) => Ok(Self::Auto),
            ("cuda", None) => Ok(Self::Cuda(0)),
            ("cuda", Some(n)) if is_number(n) => Ok(Self::Cuda(parsed(n)?)),
            ("gpu", None) => Ok(Self::Gpu(GpuName::Best)),
            ("gpu", Some(n)) if is_number(n) => Ok(Self::Gpu(GpuName::Number(parsed(n)?))),
            ("gpu", Some(part)) if part.bytes().any(|b| b.is_ascii_alphabetic()) => {
                Ok(Self::Gpu(GpuName::Named(part.to_owned())))
            }
            _ => Err(problem()),
        }
    }
}

impl DeviceChoice {
    /// Makes the device ready: finds libraries and driver, compiles the kernels or takes them from the cache.
    ///
    /// # Errors
    /// Why that is not possible. [`Auto`](Self::Auto) gives the processor then, and the reason with it.
    pub fn open(&self) -> Result<OpenDevice, DeviceError> {
        match self {
            Self::Cpu => Ok(OpenDevice::default()),
            Self::Cuda(number) => cuda(self, *number),
            Self::Gpu(name) => gpu(self, name),
            Self::Auto => {
                let found = cuda(&Self::Cuda(0), 0).or_else(|cuda| {
                    // Of two reasons the one that is of this machine, not of the program.
                    hardware_gpu().map_err(|gpu| match gpu {
                        DeviceError::NotBuilt { .. } => cuda,
                        gpu => gpu,
                    })
                });
                Ok(found.unwrap_or_else(|why| OpenDevice {
                    fell_back: Some(why),
                    ..OpenDevice::default()
                }))
            }
        }
    }

    /// As [`open`](Self::open), for training.
    ///
    /// # Errors
    /// As there, and of a graphics processor that runs networks for inference only.
    pub fn open_for_training(&self) -> Result<OpenDevice, DeviceError> {
        match self {
            Self::Gpu(_) => Err(DeviceError::NoTensors { device: self.clone() }),
            Self::Auto => Ok(cuda(&Self::Cuda(0), 0).unwrap_or_else(|why| OpenDevice {
                fell_back: Some(why),
                ..OpenDevice::default()
            })),
            Self::Cpu | Self::Cuda(_) => self.open(),
        }
    }
}

impl Default for OpenDevice {
    /// The processor.
    fn default() -> Self {
        Self::of_tensors(Device::Cpu, "cpu".to_owned())
    }
}

impl OpenDevice {
    fn of_tensors(device: Device, name: String) -> Self {
        Self {
            device,
            #[cfg(feature = "wgpu")]
            gpu: None,
            name,
            fell_back: None,
        }
    }

    /// Whether it is the processor.
    pub fn is_cpu(&self) -> bool {
        #[cfg(feature = "wgpu")]
        if self.gpu.is_some() {
            return false;
        }
        self.device.is_cpu()
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

#[cfg(feature = "cuda")]
fn cuda(choice: &DeviceChoice, number: usize) -> Result<OpenDevice, DeviceError> {
    cuda::open(choice, number)
}

#[cfg(not(feature = "cuda"))]
fn cuda(choice: &DeviceChoice, _: usize) -> Result<OpenDevice, DeviceError> {
    Err(DeviceError::NotBuilt { device: choice.clone(), what: "CUDA", feature: "cuda" })
}

#[cfg(feature = "wgpu")]
fn gpu(choice: &DeviceChoice, name: &GpuName) -> Result<OpenDevice, DeviceError> {
    let wanted = match name {
        GpuName::Best => scenesplat_gpu::Choice::Best,
        GpuName::Number(number) => scenesplat_gpu::Choice::Number(*number),
        GpuName::Named(name) => scenesplat_gpu::Choice::Named(name.clone()),
    };
    let problem = |error: scenesplat_gpu::GpuError| DeviceError::Gpu {
        device: choice.clone(),
        problem: error.to_string(),
    };
    Ok(of_gpu(scenesplat_gpu::Gpu::open(&wanted).map_err(problem)?))
}

#[cfg(feature = "wgpu")]
fn of_gpu(gpu: scenesplat_gpu::Gpu) -> OpenDevice {
    let name = gpu.info().to_string();
    OpenDevice { gpu: Some(gpu), name, ..OpenDevice::default() }
}

#[cfg(not(feature = "wgpu"))]
fn gpu(choice: &DeviceChoice, _: &GpuName) -> Result<OpenDevice, DeviceError> {
    let what = "kernels for graphics processors of any maker";
    Err(DeviceError::NotBuilt { device: choice.clone(), what, feature: "wgpu" })
}

/// The best graphics processor that is no program on the CPU: that would compute the same, slower.
fn hardware_gpu() -> Result<OpenDevice, DeviceError> {
    let found = gpu(&DeviceChoice::Gpu(GpuName::Best), &GpuName::Best)?;
    #[cfg(feature = "wgpu")]
    if found.gpu.as_ref().is_some_and(|gpu| gpu.info().software) {
        let problem = format!("{} is a program on the cpu", found.name);
        return Err(DeviceError::Gpu { device: DeviceChoice::Gpu(GpuName::Best), problem });
    }
    Ok(found)
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
            ("gpu", DeviceChoice::Gpu(GpuName::Best)),
            ("gpu:2", DeviceChoice::Gpu(GpuName::Number(2))),
            ("gpu:llvmpipe", DeviceChoice::Gpu(GpuName::Named("llvmpipe".to_owned()))),
        ] {
            assert_eq!(text.parse::<DeviceChoice>().unwrap(), choice);
            let same = choice.to_string().parse::<DeviceChoice>().unwrap();
            assert_eq!(same, choice, "{text}");
        }
        for wrong in [
            "", "gpu:", "gpu:-1", "metal:0", "cpu:0", "auto:1", "cuda:", "cuda:-1", "cuda:1 ",
            "CUDA:0",
        ] {
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
        let gpu = DeviceChoice::Gpu(GpuName::Number(99));
        let error = gpu.open().unwrap_err();
        assert!(error.to_string().starts_with("gpu:99: "), "{error}");
        assert_eq!(cfg!(feature = "wgpu"), matches!(error, DeviceError::Gpu { .. }));
        let error = gpu.open_for_training().unwrap_err();
        assert!(error.to_string().contains("train on cpu"), "{error}");
        // Whatever this machine has: a device that is not the processor, or the processor and a reason.
        let auto = DeviceChoice::Auto.open().unwrap();
        assert_eq!(auto.is_cpu(), auto.fell_back.is_some());
    }
}
