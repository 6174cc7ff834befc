//! A network of zenoh that percept joins: as a client of its router, in a session of its own, so that nothing passes from one
//! network to another.
//!
//! A client declares anew what it wants when its router comes back. Between routers that is not so: zenoh 1.10 works out
//! at most every 100 ms whom a router has beside it, by an index that a router which left hands on to the one that comes;
//! what it leaves and comes back in between is never told again, and percept would hear nothing.

use super::{Attended, Failure, open};
use std::time::Duration;
use tokio::sync::watch;

/// How long it takes at least to try again what failed.
const PAUSE: Duration = Duration::from_secs(1);

/// Serves what is behind a router, whenever that is there, until the server stops.
pub(super) async fn join(
    config: zenoh::Config,
    router: String,
    attended: Attended,
    mut stopping: watch::Receiver<bool>,
) {
    loop {
        let Err(error) = serve(&config, &router, &attended, &mut stopping).await else { return };
        if let Some(untold) = attended.names.api.service.faults().admit(&format!("zenoh {router}")) {
            tracing::warn!(router, untold, %error, "the zenoh network is not there; it is tried again");
        }
        if tokio::time::timeout(PAUSE, stopping.wait_for(|s| *s)).await.is_ok() {
            return;
        }
    }
}

async fn serve(
    config: &zenoh::Config,
    router: &str,
    attended: &Attended,
    stopping: &mut watch::Receiver<bool>,
) -> Result<(), Failure> {
    let mut config = config.clone();
    config.insert_json5("mode", "\"client\"")?;
    config.insert_json5("connect/endpoints", &serde_json::to_string(&[router])?)?;
    let session = tokio::select! {
        opened = open(config) => opened?,
        _ = stopping.wait_for(|s| *s) => return Ok(()),
    };
    tracing::info!(router, "the zenoh network is joined");
    let served = tokio::select! {
        served = attended.to(&session) => served,
        _ = stopping.wait_for(|s| *s) => Ok(()),
    };
    session.close().await?;
    served
}
