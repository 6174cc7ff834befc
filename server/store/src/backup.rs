//! Brings a copy of all sessions up to date, wherever it is.

use std::collections::{BTreeMap, HashSet};

use crate::archive::chosen;
use crate::blobs::BlobId;
use crate::catalogue::{self, CatalogueEntry, SessionPlace};
use crate::check::Progress;
use crate::error::StoreError;
use crate::keys::Key;
use crate::lease::Claim;
use crate::reader::SessionReader;
use crate::root::DataRoot;
use crate::store::{Record, Store};

/// Changes are written in batches of at most this size; a session that changed by less is there as of one moment or the
/// other, whenever the backup breaks off.
const BATCH_BYTES: usize = 16 << 20;

/// What a backup did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BackupReport {
    /// Sessions that are in the copy as they were.
    pub num_sessions: usize,
    /// Records written or deleted.
    pub num_records: u64,
    /// Blobs copied.
    pub num_blobs: u64,
    /// Their bytes.
    pub num_bytes: u64,
}

/// Copies what `to` does not have yet. Sessions that are in use may go on: each is copied as of one moment. Sessions
/// that are no longer in `from` stay in the copy, unless they go while they are copied; one that has the id of another is
/// replaced.
///
/// # Errors
/// Those of reading and writing; what was copied until then is used by the next backup.
pub async fn backup(
    from: &DataRoot,
    to: &DataRoot,
    progress: &mut (dyn FnMut(Progress) + Send),
) -> Result<BackupReport, StoreError> {
    let sessions = chosen(from, None).await?;
    let mut report = BackupReport::default();
    for (number, (place, record)) in sessions.iter().enumerate() {
        let copy = find_or_make(to, place, record).await?;
        let copied = copy_session(from, place, to, &copy, &mut report).await;
        if catalogue::is_there(from.objects().as_ref(), place).await? {
            copied?;
            report.num_sessions += 1;
        } else {
            // It was deleted meanwhile: whatever was read of it need not be whole.
            to.bury(&copy).await?;
            to.purge(&copy).await?;
        }
        progress(Progress { id: place.id().to_owned(), num_done: number + 1, num_sessions: sessions.len() });
    }
    Ok(report)
}

/// The copy of just this session; another one's of the same id makes room.
async fn find_or_make(to: &DataRoot, place: &SessionPlace, record: &[u8]) -> Result<SessionPlace, StoreError> {
    let objects = to.objects().as_ref();
    match catalogue::newest(objects, place.id()).await? {
        Some(CatalogueEntry::Created { place: found, .. }) if found.generation == place.generation => return Ok(found),
        Some(CatalogueEntry::Created { place: found, .. } | CatalogueEntry::Damaged { place: found }) => {
            to.bury(&found).await?;
            to.purge(&found).await?;
        }
        _ => {}
    }
    let number = catalogue::free_number(objects, place.id()).await?;
    let copy = SessionPlace { number, ..place.clone() };
    to.publish(&copy, record).await?;
    Ok(copy)
}

async fn copy_session(
    from: &DataRoot,
    place: &SessionPlace,
    to: &DataRoot,
    copy: &SessionPlace,
    report: &mut BackupReport,
) -> Result<(), StoreError> {
    let reader = from.read_session(place);
    let there = to.read_session(copy);
    // First the records: whatever they name is there already, and is copied before they are.
    let records = reader.records().await?;
    let mut old: BTreeMap<Key, _> = there.records().await?.into_iter().collect();
    let have: HashSet<_> = there.blobs().await?.into_iter().collect();
    let blobs: Vec<_> = reader.blobs().await?.into_iter().filter(|blob| !have.contains(blob)).collect();
    let puts: Vec<Record> =
        records.into_iter().filter(|(key, value)| old.remove(key).as_ref() != Some(value)).collect();
    // What was the same, or is written anew, is no longer among the old ones.
    let deletes: Vec<Key> = old.into_keys().collect();
    if !(blobs.is_empty() && puts.is_empty() && deletes.is_empty()) {
        if let Claim::Elsewhere { address } = to.claim(copy).await? {
            return Err(StoreError::Elsewhere { address });
        }
        let store = to.open_session(copy).await?;
        let written = write(&store, &reader, blobs, puts, deletes, report).await;
        let closed = store.close().await;
        written.and(closed)?;
        to.release(copy).await?;
    }
    if let Some(summary) = from.summary(place).await? {
        to.set_summary(copy, summary).await?;
    }
    Ok(())
}

async fn write(
    store: &dyn Store,
    reader: &SessionReader,
    blobs: Vec<(BlobId, u64)>,
    puts: Vec<Record>,
    deletes: Vec<Key>,
    report: &mut BackupReport,
) -> Result<(), StoreError> {
    for (id, num_bytes) in blobs {
        match reader.get_blob(id).await {
            Ok(bytes) => {
                store.put_blob(bytes).await?;
            }
            // It was garbage, or is damaged: a copy would be no better, and the check says so.
            Err(StoreError::BlobMissing { .. } | StoreError::BlobCorrupt { .. }) => continue,
            Err(error) => return Err(error),
        }
        report.num_blobs += 1;
        report.num_bytes += num_bytes;
    }
    report.num_records += (puts.len() + deletes.len()) as u64;
    let (mut batch, mut num_bytes, mut deletes) = (Vec::new(), 0, deletes);
    for (key, value) in puts {
        let size = key.as_str().len() + value.len();
        if num_bytes + size > BATCH_BYTES {
            store.put_batch(std::mem::take(&mut batch), std::mem::take(&mut deletes)).await?;
            num_bytes = 0;
        }
        num_bytes += size;
        batch.push((key, value));
    }
    if batch.is_empty() && deletes.is_empty() { Ok(()) } else { store.put_batch(batch, deletes).await }
}
