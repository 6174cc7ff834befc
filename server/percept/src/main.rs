//! The percept binary: the server and the tools around it. Start with [`cli`], then [`doors`].

mod cli;
mod config;
mod doors;
mod telemetry;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run()
}
