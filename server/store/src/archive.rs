//! Sessions as one stream of bytes, and back.
//!
//! The framing is that of [`crate::export`] with version 2: before a session's records and blobs stands
//!
//! ```text
//! 'S'  u32 id length   u32 record length   id   record      a session begins; the creator's record
//! ```
//!
//! and the end counts the sessions, too:
//!
//! ```text
//! 'E'  u64 sessions    u64 records   u64 blobs   32 bytes SHA-256 of everything before this 'E'
//! ```
//!
//! A stream of version 1 holds all sessions of a store of format 1, with their ids in the keys.

use std::collections::{BTreeMap, HashMap};

use bytes::Bytes;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt};

use crate::blobs::BlobId;
use crate::catalogue::{CatalogueEntry, SessionPlace};
use crate::check::{Progress, RecordReader};
use crate::error::StoreError;
use crate::export::{Batch, Input, MAGIC, Output, length};
use crate::keys::Key;
use crate::root::DataRoot;
use crate::slate::SlateStore;
use crate::store::Store;

/// The version that is written.
const VERSION: u32 = 2;
/// Longest creator's record.
const MAX_RECORD_BYTES: u64 = 64 << 20;

/// Writes sessions: those named, or all that the catalogue has. They may be in use.
///
/// # Errors
/// [`StoreError::NoSession`]; those of reading; [`StoreError::Full`] or [`StoreError::Io`] of the writer. A session
/// that is damaged cannot be exported: the error says how.
pub async fn export_sessions(
    root: &DataRoot,
    ids: Option<&[String]>,
    writer: &mut (dyn AsyncWrite + Unpin + Send),
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
        let reader = root.read_session(place);
        for (key, value) in reader.records().await? {
            out.record(&key, &value).await?;
            num_records += 1;
        }
        for (id, _) in reader.blobs().await? {
            out.blob(id, &reader.get_blob(id).await?).await?;
            num_blobs += 1;
        }
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

/// The sessions asked for, in the order of ids.
pub(crate) async fn chosen(root: &DataRoot, ids: Option<&[String]>) -> Result<Vec<(SessionPlace, Bytes)>, StoreError> {
    let entries = root.list().await?.into_iter();
    let all = entries.filter_map(|entry| match entry {
        CatalogueEntry::Created { place, record } => Some((place.id().to_owned(), (place, record))),
        _ => None,
    });
    let mut all: BTreeMap<_, _> = all.collect();
    let Some(ids) = ids else { return Ok(all.into_values().collect()) };
    let missing = |id: &String| StoreError::NoSession { id: id.clone() };
    ids.iter().map(|id| all.remove(id).ok_or_else(|| missing(id))).collect()
}

/// Reads sessions; each is there when it is whole, none that was there is touched. Ids of what was imported.
///
/// # Errors
/// [`StoreError::AlreadyExists`], [`StoreError::ExportMalformed`], [`StoreError::FormatTooNew`],
/// [`StoreError::BlobCorrupt`]; those of writing; [`StoreError::Io`] of the reader. Sessions that were whole before the
/// error stay.
pub async fn import_sessions(
    root: &DataRoot,
    reader: &mut (dyn AsyncRead + Unpin + Send),
    read: RecordReader<'_>,
    progress: &mut (dyn FnMut(Progress) + Send),
) -> Result<Vec<String>, StoreError> {
    let mut input = Input::new(reader);
    if input.bytes(MAGIC.len() as u64).await? != MAGIC {
        return Err(input.malformed("not an export of percept"));
    }
    let mut import = Import { root, read, progress, open: BTreeMap::new(), places: HashMap::new(), done: Vec::new() };
    let outcome = match input.u32().await? {
        1 => import.version_1(&mut input).await,
        VERSION => import.version_2(&mut input).await,
        found => Err(StoreError::FormatTooNew { found, supported: VERSION }),
    };
    if outcome.is_err() {
        for session in std::mem::take(&mut import.open).into_values() {
            session.abandon(root).await;
        }
    }
    outcome.map(|()| import.done)
}

/// A session that is being imported: nobody knows of it yet.
struct Session {
    place: SessionPlace,
    record: Bytes,
    store: SlateStore,
    batch: Batch,
}

impl Session {
    async fn abandon(self, root: &DataRoot) {
        let _ = self.store.close().await;
        if let Err(error) = root.remove_folder(&self.place.folder()).await {
            tracing::warn!(%error, id = self.place.id(), "a part of an import stays behind");
        }
    }
}

struct Import<'a> {
    root: &'a DataRoot,
    read: RecordReader<'a>,
    progress: &'a mut (dyn FnMut(Progress) + Send),
    open: BTreeMap<String, Session>,
    /// Version 1: which sessions name a blob.
    places: HashMap<BlobId, Vec<String>>,
    done: Vec<String>,
}

impl Import<'_> {
    async fn begin(&mut self, id: &str, record: Bytes) -> Result<(), StoreError> {
        let place = self.root.reserve(id).await?;
        let store = self.root.open_session(&place).await?;
        self.open.insert(id.to_owned(), Session { place, record, store, batch: Batch::default() });
        Ok(())
    }

    /// Everything of the sessions that are open is there: makes them known.
    async fn finish(&mut self) -> Result<(), StoreError> {
        while let Some((id, mut session)) = self.open.pop_first() {
            let stored = async {
                session.batch.flush(&session.store).await?;
                session.store.close().await?;
                self.root.publish(&session.place, &session.record).await
            };
            if let Err(error) = stored.await {
                session.abandon(self.root).await;
                return Err(error);
            }
            self.done.push(id.clone());
            (self.progress)(Progress { id, num_done: self.done.len(), num_sessions: 0 });
        }
        Ok(())
    }

    async fn version_2(&mut self, input: &mut Input<'_>) -> Result<(), StoreError> {
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
                    let Some(session) = self.open.values_mut().next() else {
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

    async fn version_1(&mut self, input: &mut Input<'_>) -> Result<(), StoreError> {
        let (mut num_records, mut num_blobs) = (0, 0);
        loop {
            let hash = input.hash();
            match input.array::<1>().await? {
                [b'R'] => {
                    let (key, value) = input.record().await?;
                    let segments: Vec<_> = key.segments().collect();
                    match segments[..] {
                        ["catalog", id] => self.begin(id, value).await?,
                        ["sessions", id, ..] if self.open.contains_key(id) => self.record_1(id, &key, value).await?,
                        _ => {}
                    }
                    num_records += 1;
                }
                [b'B'] => {
                    let (id, bytes) = input.blob().await?;
                    for session in self.places.get(&id).into_iter().flatten() {
                        if let Some(session) = self.open.get(session)
                            && session.store.put_blob(bytes.clone()).await? != id
                        {
                            return Err(StoreError::BlobCorrupt { id });
                        }
                    }
                    num_blobs += 1;
                }
                [b'L'] => {
                    input.u64().await?;
                    input.array::<32>().await?;
                    num_blobs += 1;
                }
                [b'E'] => {
                    let counts = (input.u64().await?, input.u64().await?);
                    if counts != (num_records, num_blobs) || input.array::<32>().await? != hash {
                        return Err(input.malformed("counts or checksum do not fit"));
                    }
                    return self.finish().await;
                }
                _ => return Err(input.malformed("unknown frame")),
            }
        }
    }

    async fn record_1(&mut self, id: &str, key: &Key, value: Bytes) -> Result<(), StoreError> {
        let key = Key::new(key.segments().skip(2))?;
        // One that cannot be read is kept as it is; what it named is not known.
        for blob in (self.read)(&key, &value).unwrap_or_default() {
            let sessions = self.places.entry(blob).or_default();
            if sessions.last().is_none_or(|last| last != id) {
                sessions.push(id.to_owned());
            }
        }
        match self.open.get_mut(id) {
            Some(session) => session.batch.add(&session.store, (key, value)).await,
            None => Ok(()),
        }
    }
}
