//! A disk that is really full: a file system of a few megabytes where one can be mounted, objects that end after so
//! many bytes everywhere.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use bytes::Bytes;
use object_store::ObjectStoreExt;
use percept_store::{BlobId, RootConfig, Store, StoreError};

use crate::faulty::{Faulty, Plan};
use crate::{Opened, key, open_with};

/// A file system in memory, unmounted at the end.
struct SmallDisk(tempfile::TempDir);

impl SmallDisk {
    fn mount() -> Option<Self> {
        let directory = tempfile::tempdir().unwrap();
        let mut command = Command::new("mount");
        command.args(["-t", "tmpfs", "-o", "size=24m", "tmpfs"]).arg(directory.path());
        let mounted = command.stderr(std::process::Stdio::null()).status().is_ok_and(|status| status.success());
        mounted.then_some(Self(directory))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0.path()).status();
    }
}

/// Fills with blobs and then with records until nothing goes in any more.
async fn fill(store: &Opened) -> (Vec<BlobId>, u64) {
    let mut kept: Vec<BlobId> = Vec::new();
    let full = loop {
        match store.put_blob(Bytes::from(vec![kept.len() as u8; 1 << 20])).await {
            Ok(id) => kept.push(id),
            Err(error) => break error,
        }
        assert!(kept.len() < 200, "not a small disk");
    };
    assert!(matches!(full, StoreError::Full), "{full:?}");
    let mut written = 0;
    let full = loop {
        let record = (key("r").numbered(written).unwrap(), Bytes::from(vec![1; 100_000]));
        match store.put_batch(vec![record], vec![]).await {
            Ok(()) => written += 1,
            Err(error) => break error,
        }
    };
    assert!(matches!(full, StoreError::Full), "{full:?}");
    (kept, written)
}

/// Writes as a caller would that retries, opens again and looks at everything that was acknowledged.
async fn goes_on(store: Opened, config: RootConfig, kept: &[BlobId], written: u64) {
    let mut tries = 0;
    while store.put(key("after"), Bytes::from_static(b"1")).await.is_err() {
        tries += 1;
        assert!(tries < 100, "never recovered");
    }
    store.close().await.unwrap();
    drop(store);
    let store = open_with(config).await;
    assert!(store.scan_all(&key("r").prefix()).await.unwrap().len() as u64 >= written);
    assert!(store.get(&key("after")).await.unwrap().is_some());
    for &id in kept {
        store.get_blob(id).await.unwrap();
    }
}

async fn on_disk(disk: &Path) {
    let directory = tempfile::tempdir_in(disk).unwrap();
    let config = RootConfig::directory(directory.path());
    let store = open_with(config.clone()).await;
    let (mut kept, written) = fill(&store).await;
    let freed = kept.pop().unwrap().to_string();
    std::fs::remove_file(store.folder().join("blobs").join(freed)).unwrap();
    goes_on(store, config, &kept, written).await;
}

/// `PERCEPT_SMALL_DISK` may name a directory on a small file system; without it one is mounted, if that is permitted.
#[tokio::test]
async fn a_really_full_disk_loses_nothing() {
    if let Ok(disk) = std::env::var("PERCEPT_SMALL_DISK") {
        on_disk(Path::new(&disk)).await;
    } else if let Some(disk) = SmallDisk::mount() {
        on_disk(disk.0.path()).await;
    } else {
        println!("no file system can be mounted here; only the objects that end after so many bytes were tried");
    }
}

#[tokio::test]
async fn objects_that_end_after_so_many_bytes_lose_nothing() {
    let objects = Faulty::new();
    let config = RootConfig::objects(Arc::new(objects.clone()));
    let store = open_with(config.clone()).await;
    objects.set(Plan::FullAfter { bytes: 10 << 20 });
    let (mut kept, written) = fill(&store).await;
    let freed = kept.pop().unwrap();
    let path = ["sessions", "s", store.place.generation(), "blobs", &freed.to_string()];
    objects.delete(&object_store::path::Path::from_iter(path)).await.unwrap();
    objects.set(Plan::FullAfter { bytes: 1 << 20 });
    goes_on(store, config, &kept, written).await;
}
