//! What the program says about itself.

use crate::config::{LogFormat, LogLevel};
use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

/// Sends the log to standard error. `RUST_LOG`, if set, takes the place of `level`, e.g. `percept=debug,zenoh=warn`.
/// Call it once, first of all; later calls do nothing.
pub(crate) fn init(level: LogLevel, format: LogFormat) {
    let filter = match std::env::var(EnvFilter::DEFAULT_ENV) {
        Ok(directives) if !directives.is_empty() => EnvFilter::new(directives),
        _ => filter(level),
    };
    let lines = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    // A second subscriber is refused: the first one stays, as in tests.
    let _ = match format {
        LogFormat::Text => {
            lines.with_ansi(std::io::stderr().is_terminal()).with_target(level >= LogLevel::Debug).try_init()
        }
        LogFormat::Json => lines.json().flatten_event(true).try_init(),
    };
}

/// The libraries below speak of their own affairs at `info`: they are kept one step quieter.
fn filter(level: LogLevel) -> EnvFilter {
    let (ours, theirs) = match level {
        LogLevel::Error => (LevelFilter::ERROR, "error"),
        LogLevel::Warn => (LevelFilter::WARN, "error"),
        LogLevel::Info => (LevelFilter::INFO, "warn"),
        LogLevel::Debug => (LevelFilter::DEBUG, "info"),
        LogLevel::Trace => (LevelFilter::TRACE, "debug"),
    };
    let libraries = ["zenoh", "slatedb", "h2", "hyper", "tower", "tonic"];
    libraries
        .iter()
        .filter_map(|library| format!("{library}={theirs}").parse().ok())
        .fold(EnvFilter::default().add_directive(ours.into()), EnvFilter::add_directive)
}
