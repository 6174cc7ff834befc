//! The percept binary: the server and the tools around it. Start with [`cli`], then [`doors`].

mod cli;
mod config;
mod doors;
mod provider;
mod storage;
mod telemetry;

use std::process::ExitCode;

/// Clouds and images of megabytes come and go with every call. The system's allocator gives such memory back at once and
/// fetches it anew, a fault a page: a quarter of the time of a nearest-neighbour search.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    cli::run()
}
