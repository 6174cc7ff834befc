//! SlateDB's time: this machine's, but never behind what is stored already.
//!
//! SlateDB stamps what it writes and refuses to write with a stamp before the newest one. A machine without a battery for its
//! clock wakes up in the past, and one whose clock was ahead is set back: neither may keep a robot from storing. Only
//! SlateDB's own stamps are meant here; nothing else is read from them.

use std::pin::Pin;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use chrono::{DateTime, TimeDelta, Utc};
use futures::TryStreamExt;
use object_store::ObjectStore;
use object_store::path::Path;
use slatedb_common::clock::{DefaultSystemClock, SystemClock, SystemClockTicker};

use crate::error::StoreError;

/// File systems stamp with a clock that may stand still for some milliseconds, and a stamp is taken before its write.
const MARGIN_MS: i64 = 1000;

/// The machine's time when it was opened, the time since then, and by how much all of it is ahead.
#[derive(Debug, Default)]
pub(crate) struct Ticks {
    machine: DefaultSystemClock,
    ahead_ms: AtomicI64,
}

impl Ticks {
    /// Not before the newest object below `folder`.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub(crate) async fn after(objects: &dyn ObjectStore, folder: &Path) -> Result<Self, StoreError> {
        let ticks = Self::default();
        let newest = objects
            .list(Some(folder))
            .try_fold(DateTime::<Utc>::MIN_UTC, |newest, meta| async move { Ok(newest.max(meta.last_modified)) });
        let newest = newest.await.map_err(|error| StoreError::from_object("list the records", error))?;
        if newest > ticks.machine.now() {
            ticks.not_before(newest.timestamp_millis() + MARGIN_MS);
        }
        Ok(ticks)
    }

    /// From now on it is later than this time, milliseconds since 1970.
    pub(crate) fn not_before(&self, time_ms: i64) {
        let behind_ms = time_ms.saturating_sub(self.machine.now().timestamp_millis());
        self.ahead_ms.fetch_max(behind_ms, Ordering::Relaxed);
    }
}

impl SystemClock for Ticks {
    fn now(&self) -> DateTime<Utc> {
        let machine = self.machine.now();
        let ahead = TimeDelta::try_milliseconds(self.ahead_ms.load(Ordering::Relaxed)).unwrap_or_default();
        machine.checked_add_signed(ahead).unwrap_or(machine)
    }

    fn sleep<'a>(&'a self, duration: Duration) -> Pin<Box<dyn Future<Output = ()> + Send + 'a>> {
        self.machine.sleep(duration)
    }

    fn ticker<'a>(&'a self, duration: Duration) -> SystemClockTicker<'a> {
        SystemClockTicker::new(self, duration)
    }
}
