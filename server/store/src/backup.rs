//! Brings a copy of all sessions up to date, wherever it is.

use std::collections::{BTreeMap, BTreeSet};

use crate::archive::READS;
use crate::blob_id::BlobId;
use crate::catalogue::{self, CatalogueEntry, SessionPlace};
use crate::check::{Fault, Progress, RecordReader};
use crate::error::StoreError;
use crate::files::DETECTORS;
use crate::keys::Key;
use crate::lease::Claim;
use crate::reader::SessionReader;
use crate::root::DataRoot;
use crate::store::{Record, Store};

/// Changes are written in batches of at most this size; a session that changed by less is there as of one moment or the
/// other, whenever the backup breaks off.
const BATCH_BYTES: usize = 16 << 20;

/// What a backup did.
#[derive(Debug, Clone, Default)]
pub struct BackupReport {
    /// Sessions that are in the copy as they were.
    pub num_sessions: usize,
    /// Records written or deleted.
    pub num_records: u64,
    /// Blobs copied.
    pub num_blobs: u64,
    /// Their bytes.
    pub num_bytes: u64,
    /// Files of tenants copied.
    pub num_files: u64,
    /// Sessions that are damaged, and how. What can be read of them is in the copy, beside what it had before.
    pub damaged: Vec<(String, Vec<Fault>)>,
}

/// Copies what `to` does not have yet. Sessions that are in use may go on: each is copied as of one moment. Sessions
/// that are no longer in `from` stay in the copy, unless they go while they are copied; one that has the id of another is
/// replaced. A session that is damaged keeps no other from being copied.
///
/// # Errors
/// Those of listing `from` and of writing to `to`; what was copied until then is used by the next backup.
pub async fn backup(
    from: &DataRoot,
    to: &DataRoot,
    read: RecordReader<'_>,
    progress: &mut (dyn FnMut(Progress) + Send),
) -> Result<BackupReport, StoreError> {
    // Files go before the sessions that may name them.
    let mut report = BackupReport { num_files: from.copy_files(DETECTORS, to).await?, ..BackupReport::default() };
    let mut sessions = Vec::new();
    for entry in from.list().await? {
        match entry {
            CatalogueEntry::Created { place, record } => sessions.push((place, record)),
            CatalogueEntry::Damaged { place } => {
                report.damaged.push((place.id().to_owned(), vec![Fault::CatalogueDamaged]));
            }
            CatalogueEntry::Deleted { .. } => {}
        }
    }
    for (number, (place, record)) in sessions.iter().enumerate() {
        let (copy, is_known) = find_or_reserve(to, place).await?;
        let faults = copy_session(from, place, to, &copy, read, &mut report).await?;
        let is_there = catalogue::is_there(from.objects().as_ref(), place).await?;
        match (is_there, is_known) {
            (true, true) => {}
            (true, false) => to.publish(&copy, record).await?,
            // It was deleted meanwhile: whatever was read of it need not be whole.
            (false, true) => {
                to.bury(&copy).await?;
                to.purge(&copy).await?;
            }
            (false, false) => to.remove_folder(&copy.folder()).await?,
        }
        if is_there && faults.is_empty() {
            report.num_sessions += 1;
        } else if is_there {
            report.damaged.push((place.id().to_owned(), faults));
        }
        progress(Progress { id: place.id().to_owned(), num_done: number + 1, num_sessions: sessions.len() });
    }
    Ok(report)
}

/// The place of just this session's copy, and whether the catalogue there has it; another one's of the same id makes room.
async fn find_or_reserve(to: &DataRoot, place: &SessionPlace) -> Result<(SessionPlace, bool), StoreError> {
    let objects = to.objects().as_ref();
    match catalogue::newest(objects, place.id()).await? {
        Some(CatalogueEntry::Created { place: found, .. }) if found.generation == place.generation => {
            return Ok((found, true));
        }
        Some(CatalogueEntry::Created { place: found, .. } | CatalogueEntry::Damaged { place: found }) => {
            to.bury(&found).await?;
            to.purge(&found).await?;
        }
        _ => {}
    }
    let number = catalogue::free_number(objects, place.id()).await?;
    // A copy that broke off before it was known is found again by its generation.
    Ok((SessionPlace { number, ..place.clone() }, false))
}

/// What a session has and its copy has not, as of one moment.
struct Difference {
    /// What the session's records name.
    named: BTreeSet<BlobId>,
    blobs: Vec<BlobId>,
    puts: Vec<Record>,
    deletes: Vec<Key>,
    /// What is wrong with the session.
    faults: Vec<Fault>,
}

async fn compare(
    reader: &SessionReader,
    there: &SessionReader,
    read: RecordReader<'_>,
) -> Result<Difference, StoreError> {
    let mut found = Difference { named: BTreeSet::new(), blobs: vec![], puts: vec![], deletes: vec![], faults: vec![] };
    // First the records: whatever they name is there already, and is copied before they are.
    let records = match reader.records().await {
        Ok(records) => records,
        Err(error) => {
            found.faults.push(Fault::Records(error));
            return Ok(found);
        }
    };
    for (key, value) in &records {
        match read(key, value) {
            Ok(named) => found.named.extend(named),
            Err(why) => found.faults.push(Fault::Record(key.clone(), why)),
        }
    }
    // Records of kinds that this version does not know may name what else is there.
    let listed: BTreeMap<BlobId, u64> = match reader.blobs().await {
        Ok(listed) => listed.into_iter().collect(),
        Err(error) => {
            found.faults.push(Fault::Records(error));
            BTreeMap::new()
        }
    };
    let have: BTreeMap<BlobId, u64> = there.blobs().await?.into_iter().collect();
    let is_missing = |id: &&BlobId| match (listed.get(id), have.get(id)) {
        (Some(size), Some(copied)) => size != copied,
        (_, copied) => copied.is_none(),
    };
    let all: BTreeSet<&BlobId> = found.named.iter().chain(listed.keys()).collect();
    found.blobs = all.into_iter().filter(is_missing).copied().collect();
    let mut old: BTreeMap<Key, _> = there.records().await?.into_iter().collect();
    found.puts = records.into_iter().filter(|(key, value)| old.remove(key).as_ref() != Some(value)).collect();
    // What was the same, or is written anew, is no longer among the old ones.
    found.deletes = old.into_keys().collect();
    Ok(found)
}

/// Brings one session's copy up to date. What is wrong with the session is returned and ends nothing; errors are the
/// copy's.
async fn copy_session(
    from: &DataRoot,
    place: &SessionPlace,
    to: &DataRoot,
    copy: &SessionPlace,
    read: RecordReader<'_>,
    report: &mut BackupReport,
) -> Result<Vec<Fault>, StoreError> {
    let (reader, there) = (from.read_session(place), to.read_session(copy));
    let mut faults = Vec::new();
    for reads_left in (0..READS).rev() {
        let difference = compare(&reader, &there, read).await?;
        let is_same = difference.blobs.is_empty() && difference.puts.is_empty() && difference.deletes.is_empty();
        if is_same {
            faults = difference.faults;
            break;
        }
        if let Claim::Elsewhere { address } = to.claim(copy).await? {
            return Err(StoreError::Elsewhere { address });
        }
        let store = to.open_session(copy).await?;
        let written = write(&store, &reader, difference, reads_left == 0, report).await;
        let closed = store.close().await;
        let written = written?;
        closed?;
        to.release(copy).await?;
        if let Some(found) = written {
            faults = found;
            break;
        }
    }
    match from.summary(place).await {
        Ok(Some(summary)) => to.set_summary(copy, summary).await?,
        Ok(None) => {}
        // What lists say; waking the copy writes it anew.
        Err(error) => tracing::warn!(id = place.id(), %error, "a session's summary was not copied"),
    }
    Ok(faults)
}

/// Writes blobs, then records. What is wrong with the session; none, with the records left out, if a blob that they name
/// has gone meanwhile and this is not the last try.
async fn write(
    store: &dyn Store,
    reader: &SessionReader,
    difference: Difference,
    is_last_try: bool,
    report: &mut BackupReport,
) -> Result<Option<Vec<Fault>>, StoreError> {
    let Difference { named, blobs, puts, mut deletes, mut faults } = difference;
    for id in blobs {
        match reader.get_blob(id).await {
            Ok(bytes) => {
                report.num_blobs += 1;
                report.num_bytes += bytes.len() as u64;
                store.put_blob(bytes).await?;
            }
            Err(StoreError::BlobMissing { .. }) if !named.contains(&id) => {}
            Err(StoreError::BlobMissing { .. }) if !is_last_try => return Ok(None),
            Err(StoreError::BlobMissing { .. }) => faults.push(Fault::BlobMissing(id)),
            Err(StoreError::BlobCorrupt { .. }) => faults.push(Fault::BlobDamaged(id)),
            Err(error) => faults.push(Fault::Blob(id, error)),
        }
    }
    report.num_records += (puts.len() + deletes.len()) as u64;
    let (mut batch, mut num_bytes) = (Vec::new(), 0);
    for (key, value) in puts {
        let size = key.as_str().len() + value.len();
        if num_bytes + size > BATCH_BYTES {
            store.put_batch(std::mem::take(&mut batch), std::mem::take(&mut deletes)).await?;
            num_bytes = 0;
        }
        num_bytes += size;
        batch.push((key, value));
    }
    if !(batch.is_empty() && deletes.is_empty()) {
        store.put_batch(batch, deletes).await?;
    }
    Ok(Some(faults))
}
