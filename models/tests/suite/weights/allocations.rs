//! The largest piece of memory that a thread asked for.

use std::alloc::{GlobalAlloc, Layout, System};
use std::backtrace::Backtrace;
use std::cell::Cell;
use std::sync::Once;

thread_local! {
    static LARGEST: Cell<usize> = const { Cell::new(0) };
}

struct Watch;

fn note(size: usize) {
    // Not there any more while a thread ends.
    _ = LARGEST.try_with(|l| l.set(l.get().max(size)));
}

// SAFETY: every call goes on to the system's allocator; noting a size allocates nothing.
unsafe impl GlobalAlloc for Watch {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note(layout.size());
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        note(layout.size());
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note(size);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.realloc(at, layout, size) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static WATCH: Watch = Watch;

/// What `f` gives, and the largest piece of memory it asked for on this thread, in bytes.
pub fn largest<R>(f: impl FnOnce() -> R) -> (R, usize) {
    // With RUST_BACKTRACE=1 the first error that has a backtrace reads the tables of the program, on its own thread.
    static READ: Once = Once::new();
    READ.call_once(|| drop(Backtrace::capture().to_string()));
    LARGEST.with(|l| l.set(0));
    let result = f();
    (result, LARGEST.with(Cell::get))
}
