//! The `scenesplat` program.

use scenesplat_cli::{allocator, signals};

/// Keeps pages between the large short-lived buffers of a network.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    allocator::keep_pages();
    // SAFETY: no other thread runs yet that could read the environment. Panics still show where they
    // came from; errors name the file and the value, a list of functions would hide them.
    unsafe { std::env::set_var("RUST_LIB_BACKTRACE", "0") };
    signals::say_when_a_file_is_cut();
    scenesplat_cli::run(std::env::args_os()).into()
}
