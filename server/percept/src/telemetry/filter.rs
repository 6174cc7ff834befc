//! What of the log is written.

use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

/// These speak of their own affairs at `info`: under a plain level they are kept one step quieter.
const LIBRARIES: [&str; 6] = ["h2", "hyper", "slatedb", "tonic", "tower", "zenoh"];

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
