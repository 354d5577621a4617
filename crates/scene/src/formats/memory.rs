//! Memory for whole scenes: zeroed by the system page by page, as the threads that fill it come by.

use crate::SceneError;
use bytemuck::Zeroable;
use bytemuck::allocation::try_zeroed_vec;
use std::path::Path;

/// `count` zeros; the caller has checked `count` against the file at `path`.
///
/// `vec![0.0; count]` would end the program where memory is short; filling a reserved vector would
/// touch every page on one thread.
pub(crate) fn zeroed<T: Zeroable>(count: usize, path: &Path) -> Result<Vec<T>, SceneError> {
    let zeros = try_zeroed_vec(count).map_err(|()| {
        let problem = format!("{count} rows of {} bytes do not fit into memory", size_of::<T>());
        SceneError::format(path, problem, "split the scene")
    })?;
    Ok(in_large_pages(zeros))
}

/// As it was, with the advice to use large pages; best given before the first write.
pub(crate) fn in_large_pages<T>(mut values: Vec<T>) -> Vec<T> {
    advise_huge_pages(values.as_mut_ptr().cast(), values.len() * size_of::<T>());
    values
}

/// Asks for large pages, with which filling fresh memory takes a fraction of the page faults.
#[cfg(target_os = "linux")]
fn advise_huge_pages(start: *mut u8, bytes: usize) {
    const HUGE: usize = 2 << 20;
    let from = (start as usize).next_multiple_of(HUGE);
    let to = (start as usize + bytes) / HUGE * HUGE;
    if to > from {
        // SAFETY: the range lies within memory of ours, and the advice changes no content. A
        // refusal costs nothing but time.
        unsafe { libc::madvise(from as *mut libc::c_void, to - from, libc::MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn advise_huge_pages(_: *mut u8, _: usize) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zeros_of_any_size_and_refusal_without_panic() {
        for count in [0, 1, 1000, 3 << 20] {
            let mut values = zeroed::<[f32; 3]>(count, Path::new("x")).unwrap();
            assert_eq!(values.len(), count);
            assert!(values.iter().all(|v| *v == [0.0; 3]));
            values.push([1.0; 3]);
        }
        assert!(zeroed::<f32>(usize::MAX / 2, Path::new("x")).is_err());
        assert!(zeroed::<f32>(1 << 55, Path::new("x")).is_err());
    }
}
