//! Looks at everything that is stored, and mends nothing.

use std::collections::HashSet;

use crate::blob_id::BlobId;
use crate::catalogue::{CatalogueEntry, SessionPlace};
use crate::error::StoreError;
use crate::keys::Key;
use crate::root::DataRoot;

/// Reads a record as its owner would: the blobs that it names, or why it cannot be read.
pub type RecordReader<'a> = &'a (dyn Fn(&Key, &[u8]) -> Result<Vec<BlobId>, String> + Send + Sync);

/// How far a long operation has come, told after each session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Progress {
    /// The session that was just done.
    pub id: String,
    /// Sessions done so far.
    pub num_done: usize,
    /// Sessions in all; 0 if that is not known.
    pub num_sessions: usize,
}

/// What is wrong with a session.
#[derive(Debug, Clone)]
pub enum Fault {
    /// Its entry in the catalogue cannot be read.
    CatalogueDamaged,
    /// Its records cannot be read.
    Records(StoreError),
    /// One record is not what its owner would have written.
    Record(Key, String),
    /// A record names a blob that is not there.
    BlobMissing(BlobId),
    /// A blob's content is not what its name says.
    BlobDamaged(BlobId),
    /// A blob cannot be read.
    Blob(BlobId, StoreError),
}

/// What was found of one session.
#[derive(Debug, Clone)]
pub struct SessionReport {
    /// Where it is.
    pub place: SessionPlace,
    /// Records that could be read.
    pub num_records: usize,
    /// Blobs that are whole.
    pub num_blobs: usize,
    /// Blobs that no record names.
    pub num_unnamed: usize,
    /// Bytes of the blobs.
    pub num_bytes: u64,
    /// What is wrong; nothing if it is empty.
    pub faults: Vec<Fault>,
}

/// Reads every catalogue entry, every record and every blob. Sessions that are in use may go on; what a session writes
/// while it is looked at may be seen or not.
///
/// # Errors
/// [`StoreError::Io`] if the catalogue cannot be listed; what is wrong with a session is in its report.
pub async fn check(
    root: &DataRoot,
    read: RecordReader<'_>,
    progress: &mut (dyn FnMut(Progress) + Send),
) -> Result<Vec<SessionReport>, StoreError> {
    let entries = root.list().await?;
    let num_sessions = entries.len();
    let mut reports = Vec::new();
    for (number, entry) in entries.into_iter().enumerate() {
        let (place, faults) = match entry {
            CatalogueEntry::Created { place, .. } => (place, Vec::new()),
            CatalogueEntry::Damaged { place } => (place, vec![Fault::CatalogueDamaged]),
            CatalogueEntry::Deleted { .. } => continue,
        };
        let id = place.id().to_owned();
        let empty = SessionReport { place, num_records: 0, num_blobs: 0, num_unnamed: 0, num_bytes: 0, faults };
        reports.push(check_session(root, empty, read).await);
        progress(Progress { id, num_done: number + 1, num_sessions });
    }
    Ok(reports)
}

async fn check_session(root: &DataRoot, mut report: SessionReport, read: RecordReader<'_>) -> SessionReport {
    let reader = root.read_session(&report.place);
    let records = match reader.records().await {
        Ok(records) => records,
        Err(error) => {
            report.faults.push(Fault::Records(error));
            Vec::new()
        }
    };
    report.num_records = records.len();
    // After the records, so that all that they name are listed.
    let blobs = match reader.blobs().await {
        Ok(blobs) => blobs,
        Err(error) => {
            report.faults.push(Fault::Records(error));
            return report;
        }
    };
    let mut named = HashSet::new();
    for (key, value) in &records {
        match read(key, value) {
            Ok(blobs) => named.extend(blobs),
            Err(why) => report.faults.push(Fault::Record(key.clone(), why)),
        }
    }
    for (id, num_bytes) in blobs {
        report.num_bytes += num_bytes;
        report.num_unnamed += usize::from(!named.remove(&id));
        match reader.get_blob(id).await {
            Ok(_) => report.num_blobs += 1,
            Err(StoreError::BlobCorrupt { .. }) => report.faults.push(Fault::BlobDamaged(id)),
            Err(StoreError::BlobMissing { .. }) => {}
            Err(error) => report.faults.push(Fault::Blob(id, error)),
        }
    }
    report.faults.extend(named.into_iter().map(Fault::BlobMissing));
    report
}
