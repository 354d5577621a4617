//! The `scenesplat` program.

mod allocator;
mod signals;

/// Keeps pages between the large short-lived buffers of a network.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    allocator::keep_pages();
    signals::prepare();
    scenesplat_cli::run(std::env::args_os()).into()
}
