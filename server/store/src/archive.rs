//! Sessions as one stream of bytes, and back.
//!
//! Framing, all numbers little-endian:
//!
//! ```text
//! "PERCEPT-STORE\n"  u32 version = 2
//! 'S'  u32 id length   u32 record length  id   record    a session begins; the creator's record
//! 'B'  u64 length      32 bytes SHA-256   bytes          one of its blobs
//! 'R'  u32 key length  u32 value length   key   value    one of its records, in the order of the keys
//! 'E'  u64 sessions  u64 records  u64 blobs  32 bytes SHA-256 of everything before this 'E'
//! ```
//!
//! A session's records are those of one moment, and every blob that they name is there. Readers take its records and blobs
//! in any order.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use bytes::Bytes;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt};

use crate::blob_id::BlobId;
use crate::catalogue::{CatalogueEntry, SessionPlace};
use crate::check::{Progress, RecordReader};
use crate::error::StoreError;
use crate::framing::{Batch, Input, MAGIC, Output, length};
use crate::root::DataRoot;
use crate::slate::SlateStore;
use crate::store::{Record, Store};

/// The version that is written.
const VERSION: u32 = 2;
/// Longest creator's record.
const MAX_RECORD_BYTES: u64 = 64 << 20;

/// A session that goes on while it is copied may give up scans that its records named a moment ago; then the records are
/// read anew, so often.
pub(crate) const READS: usize = 4;

/// Writes sessions: those named, or all that the catalogue has. They may be in use.
///
/// # Errors
/// [`StoreError::NoSession`]; those of reading; [`StoreError::Full`] or [`StoreError::Io`] of the writer. A session
/// that is damaged cannot be exported: the error says how.
pub async fn export_sessions(
    root: &DataRoot,
    ids: Option<&[String]>,
    writer: &mut (dyn AsyncWrite + Unpin + Send),
    read: RecordReader<'_>,
    progress: &mut (dyn FnMut(Progress) + Send),
) -> Result<(), StoreError> {
    let sessions = chosen(root, ids).await?;
    let mut out = Output::new(writer);
    let (mut num_records, mut num_blobs) = (0u64, 0u64);
    out.write(MAGIC).await?;
    out.write(&VERSION.to_le_bytes()).await?;
    for (number, (place, record)) in sessions.iter().enumerate() {
        out.write(b"S").await?;
        out.write(&length(place.id().len())).await?;
        out.write(&length(record.len())).await?;
        out.write(place.id().as_bytes()).await?;
        out.write(record).await?;
        let (records, blobs) = export_session(root, place, &mut out, read).await.map_err(|error| {
            let id = place.id().to_owned();
            StoreError::InSession { id, source: Box::new(error) }
        })?;
        num_records += records;
        num_blobs += blobs;
        progress(Progress { id: place.id().to_owned(), num_done: number + 1, num_sessions: sessions.len() });
    }
    let hash = out.hash();
    out.write(b"E").await?;
    for count in [sessions.len() as u64, num_records, num_blobs] {
        out.write(&count.to_le_bytes()).await?;
    }
    out.write(&hash).await?;
    out.writer.flush().await.map_err(|error| StoreError::from_io("write the export", error))
}

/// Writes a session's blobs, then its records; how many of each.
async fn export_session(
    root: &DataRoot,
    place: &SessionPlace,
    out: &mut Output<'_>,
    read: RecordReader<'_>,
) -> Result<(u64, u64), StoreError> {
    let reader = root.read_session(place);
    let mut written = BTreeSet::new();
    let mut reads_left = READS;
    let records = loop {
        reads_left -= 1;
        let records = reader.records().await?;
        let mut is_whole = true;
        for id in named(&records, read) {
            if written.contains(&id) {
                continue;
            }
            match reader.get_blob(id).await {
                Ok(bytes) => out.blob(id, &bytes).await?,
                Err(StoreError::BlobMissing { .. }) if reads_left > 0 => {
                    is_whole = false;
                    continue;
                }
                Err(error) => return Err(error),
            }
            written.insert(id);
        }
        if is_whole {
            break records;
        }
    };
    // Records of kinds that this version does not know may name what else is there.
    for (id, _) in reader.blobs().await? {
        if written.contains(&id) {
            continue;
        }
        match reader.get_blob(id).await {
            Ok(bytes) => out.blob(id, &bytes).await?,
            Err(StoreError::BlobMissing { .. } | StoreError::BlobCorrupt { .. }) => continue,
            Err(error) => return Err(error),
        }
        written.insert(id);
    }
    for (key, value) in &records {
        out.record(key, value).await?;
    }
    Ok((records.len() as u64, written.len() as u64))
}

/// The blobs that records name, as far as they can be read.
fn named(records: &[Record], read: RecordReader<'_>) -> BTreeSet<BlobId> {
    records.iter().flat_map(|(key, value)| read(key, value).unwrap_or_default()).collect()
}

/// The sessions asked for, in the order of ids.
async fn chosen(root: &DataRoot, ids: Option<&[String]>) -> Result<Vec<(SessionPlace, Bytes)>, StoreError> {
    let entries = root.list().await?.into_iter();
    let mut all: BTreeMap<String, Result<_, StoreError>> = BTreeMap::new();
    for entry in entries {
        match entry {
            CatalogueEntry::Created { place, record } => all.insert(place.id().to_owned(), Ok((place, record))),
            CatalogueEntry::Damaged { place } => all.insert(place.id().to_owned(), Err(unreadable(&place))),
            CatalogueEntry::Deleted { .. } => None,
        };
    }
    let Some(ids) = ids else { return all.into_values().collect() };
    let missing = |id: &String| Err(StoreError::NoSession { id: id.clone() });
    ids.iter().map(|id| all.remove(id).unwrap_or_else(|| missing(id))).collect()
}

fn unreadable(place: &SessionPlace) -> StoreError {
    let source = Arc::new(std::io::Error::other("its catalogue entry cannot be read"));
    let source = Box::new(StoreError::Corrupt { operation: "read the catalogue", source });
    StoreError::InSession { id: place.id().to_owned(), source }
}

/// Reads sessions; none is there before all were read and the checksum fits, none that was there is touched. Ids of what
/// was imported.
///
/// # Errors
/// [`StoreError::AlreadyExists`], [`StoreError::ExportMalformed`], [`StoreError::ExportVersion`],
/// [`StoreError::BlobCorrupt`]; those of writing; [`StoreError::Io`] of the reader.
pub async fn import_sessions(
    root: &DataRoot,
    reader: &mut (dyn AsyncRead + Unpin + Send),
    progress: &mut (dyn FnMut(Progress) + Send),
) -> Result<Vec<String>, StoreError> {
    let mut input = Input::new(reader);
    if input.bytes(MAGIC.len() as u64).await? != MAGIC {
        return Err(input.malformed("not an export of percept"));
    }
    let found = input.u32().await?;
    if found != VERSION {
        return Err(StoreError::ExportVersion { found, supported: VERSION });
    }
    let mut import = Import { root, progress, open: None, stored: Vec::new() };
    let outcome = match import.run(&mut input).await {
        Ok(()) => import.publish().await,
        Err(error) => Err(error),
    };
    import.abandon().await;
    outcome
}

/// A session that is being imported: nobody knows of it yet.
struct Session {
    place: SessionPlace,
    record: Bytes,
    store: SlateStore,
    batch: Batch,
}

struct Import<'a> {
    root: &'a DataRoot,
    progress: &'a mut (dyn FnMut(Progress) + Send),
    open: Option<Session>,
    /// Stored, and not known to anybody before the checksum was seen to fit.
    stored: Vec<(SessionPlace, Bytes)>,
}

impl Import<'_> {
    async fn begin(&mut self, id: &str, record: Bytes) -> Result<(), StoreError> {
        let place = self.root.reserve(id).await?;
        let store = self.root.open_session(&place).await?;
        self.open = Some(Session { place, record, store, batch: Batch::default() });
        Ok(())
    }

    /// Everything of the session that is open is there.
    async fn finish(&mut self) -> Result<(), StoreError> {
        let Some(mut session) = self.open.take() else { return Ok(()) };
        let stored = async {
            session.batch.flush(&session.store).await?;
            session.store.close().await
        };
        let stored = stored.await;
        let id = session.place.id().to_owned();
        self.stored.push((session.place, session.record));
        stored?;
        (self.progress)(Progress { id, num_done: self.stored.len(), num_sessions: 0 });
        Ok(())
    }

    /// Makes known what was stored.
    async fn publish(&mut self) -> Result<Vec<String>, StoreError> {
        let mut done = Vec::new();
        while let Some((place, record)) = self.stored.pop() {
            if let Err(error) = self.root.publish(&place, &record).await {
                self.stored.push((place, record));
                return Err(error);
            }
            done.push(place.id().to_owned());
        }
        done.reverse();
        Ok(done)
    }

    /// Removes what nobody knows of.
    async fn abandon(mut self) {
        if let Some(session) = self.open.take() {
            let _ = session.store.close().await;
            self.stored.push((session.place, session.record));
        }
        for (place, _) in self.stored {
            if let Err(error) = self.root.remove_folder(&place.folder()).await {
                tracing::warn!(%error, id = place.id(), "a part of an import stays behind");
            }
        }
    }

    async fn run(&mut self, input: &mut Input<'_>) -> Result<(), StoreError> {
        let (mut num_sessions, mut num_records, mut num_blobs) = (0, 0, 0);
        loop {
            let hash = input.hash();
            match input.array::<1>().await? {
                [b'S'] => {
                    self.finish().await?;
                    let (id, record) = input.text_and_bytes(MAX_RECORD_BYTES).await?;
                    self.begin(&id, record).await?;
                    num_sessions += 1;
                }
                [tag @ (b'R' | b'B')] => {
                    let Some(session) = &mut self.open else {
                        return Err(input.malformed("records before a session"));
                    };
                    if tag == b'R' {
                        session.batch.add(&session.store, input.record().await?).await?;
                        num_records += 1;
                    } else {
                        let (id, bytes) = input.blob().await?;
                        if session.store.put_blob(bytes).await? != id {
                            return Err(StoreError::BlobCorrupt { id });
                        }
                        num_blobs += 1;
                    }
                }
                [b'E'] => {
                    let counts = [input.u64().await?, input.u64().await?, input.u64().await?];
                    if counts != [num_sessions, num_records, num_blobs] || input.array::<32>().await? != hash {
                        return Err(input.malformed("counts or checksum do not fit"));
                    }
                    return self.finish().await;
                }
                _ => return Err(input.malformed("unknown frame")),
            }
        }
    }
}
