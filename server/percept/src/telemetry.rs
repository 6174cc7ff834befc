//! What the program says about itself.

use crate::config::LogFormat;
use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

/// These speak of their own affairs at `info`: under a plain level they are kept one step quieter.
const LIBRARIES: [&str; 6] = ["h2", "hyper", "slatedb", "tonic", "tower", "zenoh"];

/// Sends the log to standard error. `RUST_LOG`, if set, takes the place of `level`; what is no level nor directive
/// in either is left out. Call it once, first of all; later calls do nothing.
pub(crate) fn init(level: &str, format: LogFormat) {
    let filter = match std::env::var(EnvFilter::DEFAULT_ENV) {
        Ok(directives) if !directives.is_empty() => EnvFilter::new(directives),
        _ => filter(level).unwrap_or_else(|_| EnvFilter::new(level)),
    };
    let lines = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    // A second subscriber is refused: the first one stays, as in tests.
    let _ = match format {
        LogFormat::Text => lines.with_ansi(std::io::stderr().is_terminal()).try_init(),
        LogFormat::Json => lines.json().flatten_event(true).try_init(),
    };
}

/// The filter of a plain level, or of directives such as `info,percept=debug`.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn filter(level: &str) -> Result<EnvFilter, String> {
    if level.contains('=') {
        return EnvFilter::try_new(level).map_err(|e| e.to_string());
    }
    let ours: LevelFilter = level.parse().map_err(|_| "it is no level".to_owned())?;
    let theirs = match ours {
        LevelFilter::TRACE => "debug",
        LevelFilter::DEBUG => "info",
        LevelFilter::INFO => "warn",
        LevelFilter::OFF => "off",
        _ => "error",
    };
    let quieter = LIBRARIES.iter().filter_map(|library| format!("{library}={theirs}").parse().ok());
    Ok(quieter.fold(EnvFilter::default().add_directive(ours.into()), EnvFilter::add_directive))
}
