//! A machine whose clock stands before what it has stored goes on storing.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use percept_store::{DataRoot, RootConfig, Store};
use slatedb::Db;
use slatedb::object_store::ObjectStore;
use slatedb::object_store::local::LocalFileSystem;
use slatedb_common::clock::{DefaultSystemClock, SystemClock};

use crate::{key, value};

/// The machine's clock with two days more: what is written by it comes from the future.
#[derive(Debug, Default)]
struct Ahead(DefaultSystemClock);

const DAYS: Duration = Duration::from_secs(2 * 86_400);

impl SystemClock for Ahead {
    fn now(&self) -> chrono::DateTime<chrono::Utc> {
        self.0.now() + DAYS
    }

    fn sleep<'a>(&'a self, duration: Duration) -> std::pin::Pin<Box<dyn Future<Output = ()> + Send + 'a>> {
        self.0.sleep(duration)
    }

    fn ticker<'a>(&'a self, duration: Duration) -> slatedb_common::clock::SystemClockTicker<'a> {
        slatedb_common::clock::SystemClockTicker::new(self, duration)
    }
}

/// Writes into a session as a process did whose clock was ahead; `cleanly` says whether it closed its store.
async fn written_ahead(cleanly: bool) {
    let directory = tempfile::tempdir().unwrap();
    let root = DataRoot::open(RootConfig::directory(directory.path())).await.unwrap();
    let place = root.create("robot", b"").await.unwrap();
    let folder = directory.path().join("sessions").join(place.id()).join(place.generation());
    std::fs::create_dir_all(&folder).unwrap();
    let files: Arc<dyn ObjectStore> = Arc::new(LocalFileSystem::new_with_prefix(&folder).unwrap());
    let db = Db::builder("records", files).with_system_clock(Arc::new(Ahead::default())).build().await.unwrap();
    db.put(b"a", b"1").await.unwrap();
    db.flush().await.unwrap();
    if cleanly {
        db.close().await.unwrap();
    } else {
        // As after a kill: nothing of it is merged. The files' times are of the clock that was ahead.
        drop(db);
        let then = SystemTime::now() + DAYS;
        for kind in ["wal", "manifest"] {
            for file in std::fs::read_dir(folder.join("records").join(kind)).unwrap() {
                std::fs::File::options().append(true).open(file.unwrap().path()).unwrap().set_modified(then).unwrap();
            }
        }
    }
    let opened = root.open_session(&place).await.unwrap();
    opened.put(key("b"), value("2")).await.unwrap();
    opened.close().await.unwrap();
    let opened = root.open_session(&place).await.unwrap();
    assert_eq!(opened.get(&key("a")).await.unwrap(), Some(value("1")));
    assert_eq!(opened.get(&key("b")).await.unwrap(), Some(value("2")));
    opened.put(key("c"), value("3")).await.unwrap();
    opened.close().await.unwrap();
}

#[tokio::test]
async fn a_clock_that_was_set_back_does_not_stop_the_storing() {
    written_ahead(true).await;
}

#[tokio::test]
async fn a_machine_that_lost_power_and_the_time_goes_on_storing() {
    written_ahead(false).await;
}
