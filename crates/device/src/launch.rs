//! How kernels are described and started.

/// What items of work a block takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Items {
    /// One for each thread.
    PerThread,
    /// One for each warp of 32 threads.
    PerWarp,
    /// As many for each block.
    PerBlock(u32),
}

/// A kernel of a module.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KernelEntry {
    /// Name of the function.
    pub name: &'static str,
    /// Name of its [`KernelModule`].
    pub module: &'static str,
    /// Threads of a block, a multiple of 32; the text was written for this number.
    pub threads: u32,
    /// How the number of blocks follows from the number of items.
    pub items: Items,
    /// Shared memory that the launch must add to what the text declares, bytes.
    pub shared: u32,
}

/// A text that is compiled as a whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KernelModule {
    /// Name, that of its file.
    pub name: &'static str,
    /// The whole text, headers included.
    pub source: &'static str,
    /// Its kernels.
    pub entries: &'static [KernelEntry],
}

/// Size of a launch; grids and blocks have one dimension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LaunchPlan {
    /// Blocks.
    pub blocks: u32,
    /// Threads of a block.
    pub threads: u32,
    /// Shared memory beside what the text declares, bytes.
    pub shared: u32,
}

/// Threads of a warp.
pub const WARP: u32 = 32;
/// Most blocks of a grid.
pub const MOST_BLOCKS: u64 = (1 << 31) - 1;

/// More items than a grid has room for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "kernel {kernel}: {items} items need {blocks} blocks, at most {MOST_BLOCKS} are possible (split the scene)"
)]
pub struct TooManyItems {
    /// The kernel.
    pub kernel: &'static str,
    /// Items asked for.
    pub items: u64,
    /// Blocks they would need.
    pub blocks: u64,
}

impl KernelEntry {
    /// A kernel whose text declares all the shared memory it uses.
    pub const fn new(module: &'static str, name: &'static str, threads: u32, items: Items) -> Self {
        Self { name, module, threads, items, shared: 0 }
    }

    /// Items that a block takes.
    pub const fn items_per_block(&self) -> u64 {
        match self.items {
            Items::PerThread => self.threads as u64,
            Items::PerWarp => (self.threads / WARP) as u64,
            Items::PerBlock(items) => items as u64,
        }
    }

    /// Size of the launch for this many items; nothing is to be launched for none.
    ///
    /// # Errors
    /// If a grid has no room for as many blocks.
    pub fn plan(&self, items: u64) -> Result<Option<LaunchPlan>, TooManyItems> {
        let blocks = items.div_ceil(self.items_per_block());
        if blocks > MOST_BLOCKS {
            return Err(TooManyItems { kernel: self.name, items, blocks });
        }
        Ok((blocks > 0).then_some(LaunchPlan {
            blocks: blocks as u32,
            threads: self.threads,
            shared: self.shared,
        }))
    }
}

/// A number that a kernel gets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scalar {
    /// `u32`
    U32(u32),
    /// `u64`
    U64(u64),
    /// `i32`
    I32(i32),
    /// `float`
    F32(f32),
    /// `double`
    F64(f64),
}

/// An argument of a kernel.
#[derive(Debug)]
pub enum Arg<'a, B> {
    /// An array that is read only.
    In(&'a B),
    /// An array that is written.
    Out(&'a mut B),
    /// A number.
    Scalar(Scalar),
}

/// What kernels run on: a graphics processor, or its emulation in the tests.
///
/// Launches happen in the order in which they are asked for, and [`Self::download`] waits for them.
pub trait Launcher {
    /// An array in the device's memory: bytes without a type.
    type Buffer;
    /// What can go wrong.
    type Error: std::error::Error + From<TooManyItems>;

    /// An array of any contents. No bytes are a buffer too.
    ///
    /// # Errors
    /// If there is no memory.
    fn alloc(&self, bytes: usize) -> Result<Self::Buffer, Self::Error>;

    /// Bytes of an array.
    fn bytes(&self, buffer: &Self::Buffer) -> usize;

    /// Sets every byte.
    ///
    /// # Errors
    /// If the device reports one.
    fn fill(&self, buffer: &mut Self::Buffer, byte: u8) -> Result<(), Self::Error>;

    /// A new array with these contents.
    ///
    /// # Errors
    /// If there is no memory, or the device reports an error.
    fn upload(&self, bytes: &[u8]) -> Result<Self::Buffer, Self::Error>;

    /// Copies the first `to.len()` bytes of an array.
    ///
    /// # Errors
    /// If the device reports one, for this or a launch before.
    ///
    /// # Panics
    /// If the array is shorter (a bug of the caller).
    fn download(&self, buffer: &Self::Buffer, to: &mut [u8]) -> Result<(), Self::Error>;

    /// Starts a kernel. The arguments must be those of its text, in order.
    ///
    /// # Errors
    /// If the kernel does not compile or start.
    fn launch(
        &self,
        kernel: &'static KernelEntry,
        plan: LaunchPlan,
        args: &mut [Arg<'_, Self::Buffer>],
    ) -> Result<(), Self::Error>;

    /// Starts a kernel for a number of items; for none, nothing. Its text takes arrays to read, arrays to write and numbers, in
    /// that order.
    ///
    /// # Errors
    /// As [`Self::launch`], or if the items are too many.
    fn run(
        &self,
        kernel: &'static KernelEntry,
        items: u64,
        inputs: &[&Self::Buffer],
        outputs: &mut [&mut Self::Buffer],
        scalars: &[Scalar],
    ) -> Result<(), Self::Error> {
        let Some(plan) = kernel.plan(items)? else { return Ok(()) };
        let mut args: Vec<_> = inputs.iter().map(|buffer| Arg::In(*buffer)).collect();
        args.extend(outputs.iter_mut().map(|buffer| Arg::Out(*buffer)));
        args.extend(scalars.iter().map(|scalar| Arg::Scalar(*scalar)));
        self.launch(kernel, plan, &mut args)
    }

    /// An array of `count` values of a type.
    ///
    /// # Errors
    /// If there is no memory.
    fn alloc_values<T: bytemuck::Pod>(&self, count: usize) -> Result<Self::Buffer, Self::Error> {
        self.alloc(count * size_of::<T>())
    }

    /// A new array with these values.
    ///
    /// # Errors
    /// As [`Self::upload`].
    fn upload_values<T: bytemuck::Pod>(&self, values: &[T]) -> Result<Self::Buffer, Self::Error> {
        self.upload(bytemuck::cast_slice(values))
    }

    /// The first `count` values of an array.
    ///
    /// # Errors
    /// As [`Self::download`].
    fn download_values<T: bytemuck::Pod>(
        &self,
        buffer: &Self::Buffer,
        count: usize,
    ) -> Result<Vec<T>, Self::Error> {
        let mut values = vec![T::zeroed(); count];
        self.download(buffer, bytemuck::cast_slice_mut(&mut values))?;
        Ok(values)
    }

    /// Checks that an array holds this many values of a type.
    ///
    /// # Panics
    /// If it holds fewer (a bug of the caller).
    fn expect<T>(&self, what: &str, buffer: &Self::Buffer, count: u64) {
        let (got, want) = (self.bytes(buffer) as u64, count * size_of::<T>() as u64);
        assert!(got >= want, "{what}: an array of {got} bytes, {want} are needed");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const THREAD: KernelEntry = KernelEntry::new("m", "k", 256, Items::PerThread);
    const WARPS: KernelEntry = KernelEntry::new("m", "w", 128, Items::PerWarp);
    const BLOCKS: KernelEntry = KernelEntry::new("m", "b", 64, Items::PerBlock(1024));

    #[test]
    fn grids_follow_from_items() {
        let blocks = |k: &KernelEntry, n| k.plan(n).unwrap().map(|p| p.blocks);
        assert_eq!(blocks(&THREAD, 0), None);
        assert_eq!([1, 256, 257].map(|n| blocks(&THREAD, n)), [Some(1), Some(1), Some(2)]);
        assert_eq!([1, 4, 5].map(|n| blocks(&WARPS, n)), [Some(1), Some(1), Some(2)]);
        assert_eq!([1, 1024, 1025].map(|n| blocks(&BLOCKS, n)), [Some(1), Some(1), Some(2)]);
        let plan = BLOCKS.plan(5000).unwrap();
        assert_eq!(plan, Some(LaunchPlan { blocks: 5, threads: 64, shared: 0 }));
    }

    #[test]
    fn what_no_grid_holds_is_refused() {
        assert_eq!(THREAD.plan(MOST_BLOCKS * 256).unwrap().map(|p| p.blocks), Some(2_147_483_647));
        let error = THREAD.plan(MOST_BLOCKS * 256 + 1).unwrap_err();
        assert_eq!(error.blocks, 1 << 31);
        assert!(error.to_string().contains("split the scene"), "{error}");
    }
}
