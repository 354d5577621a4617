//! How many threads work, and which.

use crate::error::refuse;
use anyhow::{Result, bail};

/// Threads beyond the cores only cost memory and time; so many are allowed for tests in any case.
const THREADS_ALWAYS: usize = 64;

/// Takes that many threads, or as many as there are cores; of a caller that runs in a pool of its own, the threads of
/// that pool. The calling thread is one of them: work that it hands to the others and then waits for costs two
/// switches of threads, which small scenes and small networks have thousands of in a second. So no other thread may
/// need the pool while this one waits for it by other means than the pool's.
///
/// # Errors
/// If it is 0, above four times the cores (and above 64), or more than the system or the caller's pool gives.
pub fn set_threads(threads: Option<usize>) -> Result<()> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let most = cores.saturating_mul(4).max(THREADS_ALWAYS);
    if let Some(n) = threads.filter(|n| !(1..=most).contains(n)) {
        refuse!("--threads {n}: 1 to {most} are possible on {cores} cores");
    }
    if rayon::current_thread_index().is_none() {
        // 0 is what the environment says (RAYON_NUM_THREADS), or the number of cores. Fails if the system gives no such
        // number of threads, or a pool exists already.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0));
        let _ = pool.use_current_thread().build_global();
    }
    match threads {
        Some(n) if n != rayon::current_num_threads() => {
            bail!("--threads {n}: the system does not allow that many")
        }
        _ => Ok(()),
    }
}
