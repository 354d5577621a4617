//! The `scenesplat` program.

mod allocator;

/// Keeps pages between the large short-lived buffers of a network.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    allocator::keep_pages();
    scenesplat::cli::run(std::env::args_os())
}
