//! An open graphics processor: its kernels, its memory, the commands of one scene.

use crate::adapter::{AdapterInfo, Choice, find, largest_array};
use crate::error::{GpuError, Result};
use crate::shader::expand;
use bytemuck::Pod;
use std::collections::HashMap;
use std::fmt;
use std::marker::PhantomData;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Invocations of the largest workgroup that kernels use.
const INVOCATIONS: u32 = 256;
/// Workgroup memory that kernels use, bytes.
const WORKGROUP_MEMORY: u32 = 16 << 10;
/// Arrays that one kernel reads and writes.
const ARRAYS: u32 = 8;
/// Kernels of one command buffer at most. Drivers reset a device whose buffer takes seconds.
const DISPATCHES: usize = 32;

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An open graphics processor. Clones share it.
#[derive(Clone)]
pub struct Gpu {
    inner: Arc<Inner>,
    largest_array: u64,
}

struct Inner {
    device: wgpu::Device,
    queue: wgpu::Queue,
    info: AdapterInfo,
    kernels: Mutex<HashMap<String, Arc<Kernel>>>,
    problems: Arc<Mutex<Problems>>,
    memory: Arc<Mutex<Memory>>,
}

/// What went wrong on a device. Nobody takes it away: whoever began before a problem came fails.
#[derive(Debug, Default)]
struct Problems {
    count: u64,
    last: Option<GpuError>,
    /// Why the device is gone for good.
    lost: Option<GpuError>,
}

/// Bytes of arrays on the device.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Memory {
    /// Now.
    pub live: u64,
    /// The most at once.
    pub peak: u64,
}

impl fmt::Debug for Gpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Gpu").field("info", &self.inner.info).finish_non_exhaustive()
    }
}

impl Gpu {
    /// Opens a graphics processor.
    ///
    /// # Errors
    /// If there is none, it lacks something that the kernels need, or its driver refuses.
    pub fn open(choice: &Choice) -> Result<Self> {
        let found = find(choice)?;
        let (adapter, info) = (found.adapter, found.info);
        let limits = adapter.limits();
        let needs = [
            (
                "invocations of a workgroup",
                limits.max_compute_invocations_per_workgroup,
                INVOCATIONS,
            ),
            (
                "bytes of workgroup memory",
                limits.max_compute_workgroup_storage_size,
                WORKGROUP_MEMORY,
            ),
            ("arrays of a kernel", limits.max_storage_buffers_per_shader_stage, ARRAYS),
        ];
        for (what, has, needs) in needs {
            if has < needs {
                let adapter = info.name;
                return Err(GpuError::TooSmall {
                    adapter,
                    what,
                    has: has.into(),
                    needs: needs.into(),
                });
            }
        }
        let required_features = adapter.features() & wgpu::Features::SHADER_F16;
        let descriptor = wgpu::DeviceDescriptor {
            label: None,
            required_features,
            required_limits: limits.clone(),
            experimental_features: wgpu::ExperimentalFeatures::disabled(),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            trace: wgpu::Trace::Off,
        };
        let opened = pollster::block_on(adapter.request_device(&descriptor));
        let unusable = |problem: String| GpuError::Unusable { adapter: info.name.clone(), problem };
        let (device, queue) = opened.map_err(|error| unusable(error.to_string()))?;
        let problems: Arc<Mutex<Problems>> = Arc::default();
        let (errors, lost) = (Arc::clone(&problems), Arc::clone(&problems));
        let name = info.name.clone();
        device.on_uncaptured_error(Arc::new(move |error| {
            let error = match error {
                wgpu::Error::OutOfMemory { .. } => GpuError::OutOfMemory(name.clone()),
                other => GpuError::Refused(other.to_string()),
            };
            let mut problems = lock(&errors);
            problems.count += 1;
            problems.last = Some(error);
        }));
        device.set_device_lost_callback(move |reason, message| {
            // Dropping the device says the same; then nobody asks any more.
            let message = format!("{reason:?} {message}").trim().to_owned();
            lock(&lost).lost = Some(GpuError::Lost(message));
        });
        let largest_array = largest_array(&limits);
        let (kernels, memory) = (Mutex::default(), Arc::default());
        let inner = Inner { device, queue, info, kernels, problems, memory };
        Ok(Self { inner: Arc::new(inner), largest_array })
    }

    /// The same device with smaller arrays, as a smaller device has them.
    #[must_use]
    pub fn limited_to(&self, largest_array: u64) -> Self {
        let largest_array = self.largest_array.min(largest_array);
        Self { inner: Arc::clone(&self.inner), largest_array }
    }

    /// What it is.
    pub fn info(&self) -> &AdapterInfo {
        &self.inner.info
    }

    /// Whether it computes with 16-bit floating-point numbers.
    pub fn has_f16(&self) -> bool {
        self.inner.info.f16
    }

    /// The largest array, bytes.
    pub fn largest_array(&self) -> u64 {
        self.largest_array
    }

    /// Bytes of all arrays, now and at most.
    pub fn memory(&self) -> Memory {
        *lock(&self.inner.memory)
    }

    /// Counts the most bytes at once anew.
    pub fn reset_peak(&self) {
        let mut memory = lock(&self.inner.memory);
        memory.peak = memory.live;
    }

    /// Takes the device away as a driver does that resets it. For tests of what follows.
    pub fn lose(&self) {
        self.inner.device.destroy();
    }

    /// How many problems there were.
    fn problems(&self) -> u64 {
        lock(&self.inner.problems).count
    }

    /// The last problem, if there were more than `before`; a lost device stays lost.
    fn check(&self, before: u64) -> Result<()> {
        let problems = lock(&self.inner.problems);
        if let Some(lost) = &problems.lost {
            return Err(lost.clone());
        }
        let Some(last) = problems.last.clone().filter(|_| problems.count != before) else {
            return Ok(());
        };
        drop(problems);
        // A device that is gone refuses commands before it says that it is.
        _ = self.wait(wgpu::PollType::Poll);
        Err(lock(&self.inner.problems).lost.clone().unwrap_or(last))
    }

    /// Waits for the device. wgpu panics where a driver lost it.
    fn wait(&self, how: wgpu::PollType) -> Result<()> {
        let poll = || self.inner.device.poll(how);
        match std::panic::catch_unwind(std::panic::AssertUnwindSafe(poll)) {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(error)) => Err(GpuError::Lost(error.to_string())),
            Err(_) => {
                let error = GpuError::Lost("the driver does not answer".to_owned());
                lock(&self.inner.problems).lost.get_or_insert(error.clone());
                Err(error)
            }
        }
    }

    /// A kernel, compiled at first use. `name` says which file and case it is.
    pub(crate) fn kernel(
        &self,
        name: &str,
        text: &str,
        flags: &[&str],
        constants: &[(&str, u32)],
    ) -> Arc<Kernel> {
        let key = format!("{name} {flags:?} {constants:?}");
        if let Some(kernel) = lock(&self.inner.kernels).get(&key) {
            return Arc::clone(kernel);
        }
        let before = self.problems();
        let text = expand(text, flags, constants);
        let wgsl = text.clone();
        let module = self.inner.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(name),
            source: wgpu::ShaderSource::Wgsl(text.into()),
        });
        let pipeline =
            self.inner.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(&key),
                layout: None,
                module: &module,
                entry_point: Some("main"),
                compilation_options: wgpu::PipelineCompilationOptions {
                    // Every kernel writes its workgroup memory before it reads it.
                    zero_initialize_workgroup_memory: false,
                    ..Default::default()
                },
                cache: None,
            });
        let layout = pipeline.get_bind_group_layout(0);
        let kernel = Arc::new(Kernel { name: key.clone(), wgsl, pipeline, layout });
        if self.problems() != before {
            // It did not compile, and the next one who asks shall hear it too.
            return kernel;
        }
        lock(&self.inner.kernels).entry(key).or_insert(kernel).clone()
    }

    /// The kernels that were compiled, each with its flags and constants, and its text in WGSL; sorted.
    pub fn compiled_kernels(&self) -> Vec<(String, String)> {
        let kernels = lock(&self.inner.kernels);
        let mut all: Vec<(String, String)> =
            kernels.iter().map(|(name, kernel)| (name.clone(), kernel.wgsl.clone())).collect();
        all.sort_unstable();
        all
    }

    /// An array with these values that lives until it is dropped: weights.
    ///
    /// # Errors
    /// If it is too large for the device.
    pub fn upload<T: Pod>(&self, what: &str, values: &[T]) -> Result<Array<T>> {
        let before = self.problems();
        let storage = self.allocate(what, size_of_val(values) as u64, true)?;
        if let Some(buffer) = &storage.buffer
            && !values.is_empty()
        {
            let bytes: &[u8] = bytemuck::cast_slice(values);
            match buffer.get_mapped_range_mut(..) {
                Ok(mut view) => {
                    view.slice(..bytes.len()).copy_from_slice(bytes);
                    drop(view);
                }
                Err(error) => {
                    return Err(self.or_problem(before, GpuError::Refused(error.to_string())));
                }
            }
        }
        if let Some(buffer) = &storage.buffer {
            buffer.unmap();
        }
        self.check(before)?;
        Ok(Array { storage: Arc::new(storage), len: values.len(), of: PhantomData })
    }

    /// The reported problem, or this one if none was reported.
    fn or_problem(&self, before: u64, error: GpuError) -> GpuError {
        // A device that is gone gives buffers that cannot be used before it says that it is.
        _ = self.wait(wgpu::PollType::Poll);
        self.check(before).err().unwrap_or(error)
    }

    fn allocate(&self, what: &str, bytes: u64, mapped: bool) -> Result<Storage> {
        if let Some(lost) = &lock(&self.inner.problems).lost {
            return Err(lost.clone());
        }
        if bytes > self.largest_array {
            let (what, adapter) = (what.to_owned(), self.inner.info.name.clone());
            return Err(GpuError::TooLarge { what, bytes, limit: self.largest_array, adapter });
        }
        let usage = wgpu::BufferUsages::STORAGE
            | wgpu::BufferUsages::COPY_SRC
            | wgpu::BufferUsages::COPY_DST;
        // Kernels cannot bind an array of no bytes.
        let bytes = bytes.max(16).next_multiple_of(16);
        let buffer = self.inner.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: bytes,
            usage,
            mapped_at_creation: mapped,
        });
        let mut memory = lock(&self.inner.memory);
        memory.live += bytes;
        memory.peak = memory.peak.max(memory.live);
        drop(memory);
        let (memory, pool) = (Arc::clone(&self.inner.memory), None);
        Ok(Storage { buffer: Some(buffer), bytes, memory, pool })
    }

    /// Begins the commands of a scene.
    pub fn commands(&self) -> Commands {
        Commands {
            gpu: self.clone(),
            encoder: None,
            pass: None,
            pool: Arc::default(),
            before: self.problems(),
            dispatches: 0,
            reads: 0,
            waiting: 0,
        }
    }
}

/// A compiled kernel.
pub(crate) struct Kernel {
    name: String,
    wgsl: String,
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

/// Buffers that commands gave back, by size.
type Pool = Mutex<HashMap<u64, Vec<Storage>>>;

struct Storage {
    /// `None` once it is given back.
    buffer: Option<wgpu::Buffer>,
    bytes: u64,
    memory: Arc<Mutex<Memory>>,
    /// Where it goes when nothing uses it any more.
    pool: Option<std::sync::Weak<Pool>>,
}

impl Drop for Storage {
    fn drop(&mut self) {
        let Some(buffer) = self.buffer.take() else { return };
        let (bytes, memory) = (self.bytes, Arc::clone(&self.memory));
        if let Some(pool) = self.pool.take().and_then(|pool| pool.upgrade()) {
            // Without a pool of its own: when the pool is dropped, so is the buffer.
            let storage = Self { buffer: Some(buffer), bytes, memory, pool: None };
            lock(&pool).entry(bytes).or_default().push(storage);
            return;
        }
        let mut memory = lock(&memory);
        memory.live = memory.live.saturating_sub(bytes);
    }
}

/// Values on the device. Clones share them.
pub struct Array<T> {
    storage: Arc<Storage>,
    len: usize,
    of: PhantomData<T>,
}

impl<T> Clone for Array<T> {
    fn clone(&self) -> Self {
        Self { storage: Arc::clone(&self.storage), len: self.len, of: PhantomData }
    }
}

impl<T> fmt::Debug for Array<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Array").field("len", &self.len).finish_non_exhaustive()
    }
}

impl<T> Array<T> {
    /// Number of values.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
}

/// What a kernel reads or writes, whatever its type.
pub(crate) trait Bound {
    fn buffer(&self) -> Option<&wgpu::Buffer>;
}

impl<T> Bound for Array<T> {
    fn buffer(&self) -> Option<&wgpu::Buffer> {
        self.storage.buffer.as_ref()
    }
}

/// The commands of one scene, recorded one after the other. They run on the device in parts, the last of them when a result
/// is read.
///
/// An array that is dropped gives its memory to the arrays that later commands of the same scene ask for.
pub struct Commands {
    gpu: Gpu,
    /// Declared before the encoder: a pass ends before its encoder does.
    pass: Option<wgpu::ComputePass<'static>>,
    encoder: Option<wgpu::CommandEncoder>,
    pool: Arc<Pool>,
    /// Problems of the device when the commands began.
    before: u64,
    dispatches: usize,
    reads: usize,
    /// Kernels that were not given to the device yet.
    waiting: usize,
}

impl fmt::Debug for Commands {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Commands").field("dispatches", &self.dispatches).finish_non_exhaustive()
    }
}

impl Commands {
    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Kernels started so far.
    pub fn dispatches(&self) -> usize {
        self.dispatches
    }

    /// Results read so far; each waits for the device.
    pub fn reads(&self) -> usize {
        self.reads
    }

    /// An array for a kernel to fill; its values are anything until then.
    ///
    /// # Errors
    /// If it is too large for the device.
    pub fn array<T: Pod>(&mut self, what: &str, len: usize) -> Result<Array<T>> {
        let bytes = (len as u64).saturating_mul(size_of::<T>() as u64);
        // A few sizes only, so that arrays of neighboring sizes share memory.
        let step = (bytes.next_power_of_two() / 8).max(256);
        let limit = self.gpu.largest_array;
        let rounded = bytes.div_ceil(step).saturating_mul(step).max(256);
        let bytes = if rounded > limit { bytes } else { rounded };
        let spare = lock(&self.pool).get_mut(&bytes).and_then(Vec::pop);
        let mut storage = match spare {
            Some(storage) => storage,
            None => self.gpu.allocate(what, bytes, false)?,
        };
        storage.pool = Some(Arc::downgrade(&self.pool));
        Ok(Array { storage: Arc::new(storage), len, of: PhantomData })
    }

    fn encoder(&mut self) -> &mut wgpu::CommandEncoder {
        let device = &self.gpu.inner.device;
        self.encoder.get_or_insert_with(|| device.create_command_encoder(&Default::default()))
    }

    /// Runs a kernel over so many workgroups. `params` stands at binding 0, each array at its own.
    pub(crate) fn run<P: Pod>(
        &mut self,
        kernel: &Kernel,
        params: &P,
        arrays: &[(u32, &dyn Bound)],
        workgroups: u64,
    ) -> Result<()> {
        if workgroups == 0 {
            return Ok(());
        }
        let limits = self.gpu.inner.device.limits();
        let most = u64::from(limits.max_compute_workgroups_per_dimension);
        // Kernels count workgroups over both dimensions and leave those out that are too many.
        let (x, y) = if workgroups <= most {
            (workgroups, 1)
        } else {
            let y = workgroups.div_ceil(most);
            (workgroups.div_ceil(y), y)
        };
        if y > most {
            return Err(GpuError::Shape(format!("{}: {workgroups} workgroups", kernel.name)));
        }
        let bytes = bytemuck::bytes_of(params);
        let size = (bytes.len() as u64).next_multiple_of(16);
        let uniform = self.gpu.inner.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size,
            usage: wgpu::BufferUsages::UNIFORM,
            mapped_at_creation: true,
        });
        match uniform.get_mapped_range_mut(..) {
            Ok(mut view) => view.slice(..bytes.len()).copy_from_slice(bytes),
            Err(error) => {
                let error = GpuError::Refused(error.to_string());
                return Err(self.gpu.or_problem(self.before, error));
            }
        }
        uniform.unmap();
        let mut entries =
            vec![wgpu::BindGroupEntry { binding: 0, resource: uniform.as_entire_binding() }];
        for (binding, array) in arrays {
            let Some(buffer) = array.buffer() else { continue };
            let resource = buffer.as_entire_binding();
            entries.push(wgpu::BindGroupEntry { binding: *binding, resource });
        }
        let group = self.gpu.inner.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(&kernel.name),
            layout: &kernel.layout,
            entries: &entries,
        });
        if self.pass.is_none() {
            let pass = self.encoder().begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            self.pass = Some(pass.forget_lifetime());
        }
        if let Some(pass) = &mut self.pass {
            pass.set_pipeline(&kernel.pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups(x as u32, y as u32, 1);
        }
        self.dispatches += 1;
        self.waiting += 1;
        if self.waiting >= DISPATCHES {
            self.submit();
        }
        self.gpu.check(self.before)
    }

    /// Sets all bytes of an array to 0.
    pub(crate) fn clear<T>(&mut self, array: &Array<T>) {
        self.pass = None;
        if let Some(buffer) = &array.storage.buffer {
            let buffer = buffer.clone();
            self.encoder().clear_buffer(&buffer, 0, None);
        }
    }

    /// Runs all that was recorded, waits, and gives the values of an array.
    ///
    /// # Errors
    /// Whatever went wrong on the device since the last result.
    pub fn read<T: Pod>(&mut self, array: &Array<T>) -> Result<Vec<T>> {
        let bytes = (array.len * size_of::<T>()) as u64;
        if bytes == 0 {
            return Ok(Vec::new());
        }
        self.pass = None;
        let staging = self.gpu.inner.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: bytes.next_multiple_of(4),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        if let Some(buffer) = &array.storage.buffer {
            let buffer = buffer.clone();
            self.encoder().copy_buffer_to_buffer(
                &buffer,
                0,
                &staging,
                0,
                bytes.next_multiple_of(4),
            );
        }
        self.submit();
        self.reads += 1;
        let (sender, receiver) = std::sync::mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, .., move |result| {
            // Nobody listens if the wait below failed.
            _ = sender.send(result);
        });
        let waited = self.gpu.wait(wgpu::PollType::wait_indefinitely());
        self.gpu.check(self.before)?;
        waited?;
        // Another thread that waited for the device may be the one that calls back, a moment later.
        match receiver.recv() {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(GpuError::Lost(error.to_string())),
            Err(_) => return Err(GpuError::Lost("no answer".to_owned())),
        }
        let view =
            staging.get_mapped_range(..).map_err(|error| GpuError::Lost(error.to_string()))?;
        let mut values = vec![T::zeroed(); array.len];
        bytemuck::cast_slice_mut::<T, u8>(&mut values).copy_from_slice(&view[..bytes as usize]);
        Ok(values)
    }

    fn submit(&mut self) {
        self.pass = None;
        if let Some(encoder) = self.encoder.take() {
            self.gpu.inner.queue.submit([encoder.finish()]);
            self.waiting = 0;
        }
    }
}
