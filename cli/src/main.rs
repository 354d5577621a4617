//! The `scenesplat` program.

mod allocator;
mod bench;
mod budget;
mod commands;
mod duration;
mod effects;
mod flags;
mod outputs;
mod progress;
mod receipt;
mod session;
mod setting;
mod signals;
mod surfaces;
mod terminal;
mod threads;

/// Keeps pages between the large short-lived buffers of a network.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    allocator::keep_pages();
    signals::prepare();
    commands::run(std::env::args_os())
}
