//! The log: where it goes, how it looks, and what of it is written, which may change while the program runs.

use super::filter::filter;
use crate::config::LogFormat;
use std::io::IsTerminal;
use std::sync::OnceLock;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer, Registry, reload};

static FILTER: OnceLock<reload::Handle<EnvFilter, Registry>> = OnceLock::new();

/// Sends the log to standard error. `RUST_LOG`, if set, takes the place of `level`; what is no level nor directive
/// in either is left out. Call it once, first of all; later calls do nothing.
pub(crate) fn init(level: &str, format: LogFormat) {
    let wanted = match environment() {
        Some(directives) => EnvFilter::new(directives),
        None => filter(level).unwrap_or_else(|_| EnvFilter::new(level)),
    };
    let (wanted, handle) = reload::Layer::new(wanted);
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr);
    let lines = match format {
        LogFormat::Text => lines.with_ansi(std::io::stderr().is_terminal()).boxed(),
        LogFormat::Json => lines.json().flatten_event(true).boxed(),
    };
    // A second subscriber is refused: the first one stays, as in tests.
    if tracing_subscriber::registry().with(wanted).with(lines).try_init().is_ok() {
        let _ = FILTER.set(handle);
    }
}

/// Changes what is logged from now on. Nothing changes while `RUST_LOG` is set, which goes over every level.
///
/// # Errors
/// What is wrong with `level`, or that nothing is logged yet.
pub(super) fn set_level(level: &str) -> Result<(), String> {
    let wanted = filter(level)?;
    if environment().is_some() {
        return Ok(());
    }
    let handle = FILTER.get().ok_or("nothing is logged yet")?;
    handle.reload(wanted).map_err(|e| e.to_string())
}

fn environment() -> Option<String> {
    std::env::var(EnvFilter::DEFAULT_ENV).ok().filter(|directives| !directives.is_empty())
}
