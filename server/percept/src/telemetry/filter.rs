//! What of the log is written.

use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

/// These speak of their own affairs at `info`: under a plain level they are kept one step quieter.
const LIBRARIES: [&str; 5] = ["h2", "hyper", "slatedb", "tonic", "tower"];
/// It warns of each try to reach a router that is not there, with lines of its source. The doors say that by themselves, once in a
/// while and in words, so that under a plain `info` it speaks of errors alone.
const ZENOH: &str = "zenoh";

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
    let zenoh = if ours == LevelFilter::INFO { "error" } else { theirs };
    let levels = LIBRARIES.iter().map(|library| (*library, theirs)).chain([(ZENOH, zenoh)]);
    let quieter = levels.filter_map(|(library, level)| format!("{library}={level}").parse().ok());
    Ok(quieter.fold(EnvFilter::default().add_directive(ours.into()), EnvFilter::add_directive))
}
