//! How the program's allocator treats memory that is given back.

use libmimalloc_sys as mimalloc;

/// Numbers of options that the bindings do not name, as the allocator's header counts them.
const ALLOW_LARGE_OS_PAGES: mimalloc::mi_option_t = 6;
const PURGE_DELAY: mimalloc::mi_option_t = 15;
const ARENA_RESERVE: mimalloc::mi_option_t = 23;
/// The numbers above belong to the version with this many options.
const _: () = assert!(mimalloc::_mi_option_last == 47);

/// Address space that is taken at a time, KiB. Only pages that are used count as memory.
const RESERVED: std::ffi::c_long = 4 << 20;

/// Lets the allocator keep what is freed, in large pages where the system has them.
///
/// A network gives back and takes again buffers of up to a gigabyte in each block. Returned to the
/// system in between, their pages are cleared and mapped anew each time: half of the time of a
/// training step of the segmentation network. The peak stays what it is, within 5 %.
///
/// To be called before anything large is allocated.
pub fn keep_pages() {
    // SAFETY: plain setters of numbers; the options exist, see above.
    unsafe {
        mimalloc::mi_option_set(PURGE_DELAY, -1);
        mimalloc::mi_option_set(ALLOW_LARGE_OS_PAGES, 1);
        if cfg!(target_pointer_width = "64") {
            mimalloc::mi_option_set(ARENA_RESERVE, RESERVED);
        }
    }
}
