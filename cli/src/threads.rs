//! How many threads work, and which.

use crate::commands::WrongUse;
use anyhow::Result;

/// Threads beyond the cores only cost memory and time; so many are allowed for tests in any case.
const THREADS_ALWAYS: usize = 64;

/// Takes that many threads, or as many as there are cores. The calling thread is one of them: work that it hands to the
/// others and then waits for costs two switches of threads, which small scenes and small networks have thousands of
/// in a second. So no other thread may need the pool while this one waits for it by other means than the pool's.
///
/// # Errors
/// If it is 0, above four times the cores (and above 64), or more than the system gives.
pub fn set_threads(threads: Option<usize>) -> Result<()> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let most = cores.saturating_mul(4).max(THREADS_ALWAYS);
    if let Some(n) = threads.filter(|n| !(1..=most).contains(n)) {
        let text = format!("--threads {n}: 1 to {most} are possible on {cores} cores");
        return Err(WrongUse(text).into());
    }
    // 0 is what the environment says (RAYON_NUM_THREADS), or the number of cores. Fails if the system gives no such number
    // of threads, or a pool exists already.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0));
    let built = pool.use_current_thread().build_global();
    if let (Err(_), Some(n)) = (built, threads.filter(|n| *n != rayon::current_num_threads())) {
        anyhow::bail!("--threads {n}: the system does not allow that many");
    }
    Ok(())
}
