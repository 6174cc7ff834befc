//! What the program says about itself: its log, its metrics, the traces of its requests.
//!
//! [`log`] is set up first of all; [`requests`] watches every request of a door and [`export`] sends their traces away;
//! [`process`] reads what the system knows of this process. What is counted is declared in `percept_service::observe`.

mod export;
mod filter;
mod log;
pub(crate) mod operations;
mod process;
pub(crate) mod requests;

use crate::config;
use percept_service::observe;
use std::sync::Once;

pub(crate) use filter::filter;
pub(crate) use log::init;

/// The sources that the program was built from, if the build said so.
pub(crate) const COMMIT: &str = match option_env!("PERCEPT_BUILD_COMMIT") {
    Some(commit) => commit,
    None => "",
};

/// Begins to count and to export, as `config` has it. Within the runtime.
pub(crate) fn begin(config: &config::Telemetry) {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        observe::prepare();
        observe::add(process::Process::new());
        export::begin(config);
    });
    requests::log_share(config.access_log);
}

/// Sends what is still to be exported; at the end of all.
pub(crate) async fn end() {
    let _ = tokio::task::spawn_blocking(export::end).await;
}

/// Takes over what may change while the program runs: level of the log, share of the access log.
///
/// # Errors
/// What is wrong with the level; nothing changed then.
pub(crate) fn reload(config: &config::Config) -> Result<(), String> {
    log::set_level(&config.log.level)?;
    requests::log_share(config.telemetry.access_log);
    Ok(())
}
