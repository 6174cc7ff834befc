//! The percept binary: the server and the tools around it. Start with [`cli`], then [`doors`].

mod cli;
mod config;
mod detectors;
mod doors;
mod provider;
mod storage;
mod telemetry;

use std::process::ExitCode;

/// Clouds and images of megabytes come and go with every call, and are handed from thread to thread. The system's allocator
/// gives such memory back at once and fetches it anew, a fault a page: a quarter of the time of a nearest-neighbour search.
/// mimalloc keeps it for good where another thread frees it: 220 MB after the last of 650 sessions was deleted, 80 here.
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

/// Huge pages where the kernel has them: else large memory that has to be zero is fetched anew with a fault a page, a fifth of
/// the time of a nearest-neighbour search. A thread of its own gives back what nobody used for half a second: with the ten seconds
/// that are usual twenty samples of 64 MB left 500 to 900 MB behind, with a half 200 to 400; one that waits longer than a call
/// for the next costs the toolbox nothing, and one that never waits a fifth to three quarters of its time.
// The allocator reads it, by this name, before `main`: jemalloc(3), "Tuning".
#[allow(unsafe_code)]
#[unsafe(export_name = "_rjem_malloc_conf")]
pub static ALLOCATOR_OPTIONS: &[u8; 53] = b"thp:always,background_thread:true,dirty_decay_ms:500\0";

fn main() -> ExitCode {
    cli::run()
}
