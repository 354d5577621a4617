//! Launches on a processor of NVIDIA's.

use crate::launch::{Arg, KernelEntry, LaunchPlan, Launcher, Scalar, TooManyItems};
use crate::modules::module_of;
use crate::nvrtc::{Architecture, Cache, Compiled, NvrtcError, compile};
use cudarc::driver::{
    CudaFunction, CudaModule, CudaSlice, CudaStream, DevicePtr, DevicePtrMut, DriverError,
    LaunchConfig, PushKernelArg, sys,
};
use cudarc::nvrtc::Ptx;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// What can go wrong on the device.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CudaError {
    /// No driver.
    #[error("no CUDA driver (libcuda.so.1) is installed here")]
    NoDriver,
    /// The driver reports an error.
    #[error("CUDA driver: {0}")]
    Driver(#[from] DriverError),
    /// A text does not compile.
    #[error(transparent)]
    Nvrtc(#[from] NvrtcError),
    /// A launch of too many items.
    #[error(transparent)]
    TooManyItems(#[from] TooManyItems),
    /// A kernel that no text has.
    #[error("no text has the kernel {0}")]
    Unknown(&'static str),
}

/// Whether the driver is installed. Without this the bindings would end the program.
pub fn has_driver() -> bool {
    // SAFETY: loading the driver's library runs what it does when it is loaded, and nothing else.
    unsafe { sys::is_culib_present() }
}

/// Memory of the device.
#[derive(Debug)]
pub enum CudaBuffer {
    /// Freed when dropped, in the order of the stream.
    Owned(CudaSlice<u8>),
    /// No bytes.
    Empty,
    /// Somebody else's, see [`CudaBuffer::borrowed`].
    Borrowed {
        /// Where it begins.
        at: sys::CUdeviceptr,
        /// Its length.
        bytes: usize,
    },
}

impl CudaBuffer {
    /// Memory that belongs to somebody else, such as a tensor.
    ///
    /// # Safety
    /// The memory must be there until the launches that use this buffer are done, and be used in the order of the
    /// launcher's stream only.
    pub unsafe fn borrowed(at: sys::CUdeviceptr, bytes: usize) -> Self {
        if bytes == 0 { Self::Empty } else { Self::Borrowed { at, bytes } }
    }

    /// Length in bytes.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Owned(slice) => slice.len(),
            Self::Empty => 0,
            Self::Borrowed { bytes, .. } => *bytes,
        }
    }
}

/// Launches on one stream; texts are compiled when a kernel of theirs is first started.
pub struct CudaLauncher {
    stream: Arc<CudaStream>,
    architecture: Architecture,
    cache: Cache,
    loaded: Mutex<Loaded>,
}

#[derive(Default)]
struct Loaded {
    modules: HashMap<&'static str, Arc<CudaModule>>,
    functions: HashMap<(&'static str, &'static str), CudaFunction>,
    /// Texts whose code could not be kept, and why.
    not_kept: Vec<String>,
}

impl CudaLauncher {
    /// Launches on this stream.
    ///
    /// # Errors
    /// If the driver does not say which processor it has.
    pub fn new(stream: Arc<CudaStream>, cache: Cache) -> Result<Self, CudaError> {
        let (major, minor) = stream.context().compute_capability()?;
        let architecture =
            Architecture { major: major.unsigned_abs(), minor: minor.unsigned_abs() };
        Ok(Self { stream, architecture, cache, loaded: Mutex::default() })
    }

    /// The stream.
    pub fn stream(&self) -> &Arc<CudaStream> {
        &self.stream
    }

    /// What could not be kept in the cache, and why: it will be compiled again next time.
    pub fn not_kept(&self) -> Vec<String> {
        self.loaded.lock().unwrap_or_else(PoisonError::into_inner).not_kept.clone()
    }

    fn function(&self, kernel: &'static KernelEntry) -> Result<CudaFunction, CudaError> {
        let mut loaded = self.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (kernel.module, kernel.name);
        if let Some(function) = loaded.functions.get(&key) {
            return Ok(function.clone());
        }
        let module = match loaded.modules.get(kernel.module) {
            Some(module) => module.clone(),
            None => {
                let text = module_of(kernel).ok_or(CudaError::Unknown(kernel.name))?;
                let Compiled { ptx, not_kept, .. } = compile(text, self.architecture, &self.cache)?;
                loaded.not_kept.extend(not_kept);
                let module = self.stream.context().load_module(Ptx::from_src(ptx))?;
                loaded.modules.insert(kernel.module, module.clone());
                module
            }
        };
        let function = module.load_function(kernel.name)?;
        loaded.functions.insert(key, function.clone());
        Ok(function)
    }

    fn pointer(&self, buffer: &CudaBuffer) -> sys::CUdeviceptr {
        match buffer {
            // The guard records an event for other streams; there is one stream only.
            CudaBuffer::Owned(slice) => slice.device_ptr(&self.stream).0,
            CudaBuffer::Empty => 0,
            CudaBuffer::Borrowed { at, .. } => *at,
        }
    }

    fn pointer_mut(&self, buffer: &mut CudaBuffer) -> sys::CUdeviceptr {
        match buffer {
            CudaBuffer::Owned(slice) => slice.device_ptr_mut(&self.stream).0,
            CudaBuffer::Empty => 0,
            CudaBuffer::Borrowed { at, .. } => *at,
        }
    }
}

/// An argument as the driver reads it.
enum Value {
    Pointer(sys::CUdeviceptr),
    Scalar(Scalar),
}

impl Launcher for CudaLauncher {
    type Buffer = CudaBuffer;
    type Error = CudaError;

    fn alloc(&self, bytes: usize) -> Result<CudaBuffer, CudaError> {
        if bytes == 0 {
            return Ok(CudaBuffer::Empty);
        }
        // SAFETY: kernels write it before they read it, as the emulation shows; bytes have any value.
        Ok(CudaBuffer::Owned(unsafe { self.stream.alloc::<u8>(bytes) }?))
    }

    fn bytes(&self, buffer: &CudaBuffer) -> usize {
        buffer.bytes()
    }

    fn fill(&self, buffer: &mut CudaBuffer, byte: u8) -> Result<(), CudaError> {
        let (at, bytes) = (self.pointer_mut(buffer), buffer.bytes());
        if bytes > 0 {
            self.stream.context().bind_to_thread()?;
            // SAFETY: the memory has as many bytes.
            unsafe {
                cudarc::driver::result::memset_d8_async(at, byte, bytes, self.stream.cu_stream())
            }?;
        }
        Ok(())
    }

    fn upload(&self, bytes: &[u8]) -> Result<CudaBuffer, CudaError> {
        if bytes.is_empty() {
            return Ok(CudaBuffer::Empty);
        }
        Ok(CudaBuffer::Owned(self.stream.clone_htod(bytes)?))
    }

    fn download(&self, buffer: &CudaBuffer, to: &mut [u8]) -> Result<(), CudaError> {
        assert!(to.len() <= buffer.bytes(), "{} bytes of {}", to.len(), buffer.bytes());
        if !to.is_empty() {
            self.stream.context().bind_to_thread()?;
            let from = self.pointer(buffer);
            // SAFETY: both have as many bytes, and the stream is waited for below.
            unsafe {
                cudarc::driver::result::memcpy_dtoh_async(to, from, self.stream.cu_stream())
            }?;
        }
        Ok(self.stream.synchronize()?)
    }

    fn launch(
        &self,
        kernel: &'static KernelEntry,
        plan: LaunchPlan,
        args: &mut [Arg<'_, CudaBuffer>],
    ) -> Result<(), CudaError> {
        let function = self.function(kernel)?;
        let values: Vec<Value> = args
            .iter_mut()
            .map(|arg| match arg {
                Arg::In(buffer) => Value::Pointer(self.pointer(buffer)),
                Arg::Out(buffer) => Value::Pointer(self.pointer_mut(buffer)),
                Arg::Scalar(scalar) => Value::Scalar(*scalar),
            })
            .collect();
        let mut builder = self.stream.launch_builder(&function);
        for value in &values {
            match value {
                Value::Pointer(v) => builder.arg(v),
                Value::Scalar(Scalar::U32(v)) => builder.arg(v),
                Value::Scalar(Scalar::U64(v)) => builder.arg(v),
                Value::Scalar(Scalar::I32(v)) => builder.arg(v),
                Value::Scalar(Scalar::F32(v)) => builder.arg(v),
                Value::Scalar(Scalar::F64(v)) => builder.arg(v),
            };
        }
        let config = LaunchConfig {
            grid_dim: (plan.blocks, 1, 1),
            block_dim: (plan.threads, 1, 1),
            shared_mem_bytes: plan.shared,
        };
        // SAFETY: the arguments are those of the text, which the emulation checks by number and the operations by
        // length; buffers live in the order of the stream.
        unsafe { builder.launch(config) }?;
        Ok(())
    }
}
