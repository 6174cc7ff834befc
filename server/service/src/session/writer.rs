//! Turns what frames did into records and blobs: blobs first, then one batch of records that names them.

use super::fault::Trouble;
use super::job::Job;
use super::keyframe_codec;
use super::records::{KeyframeRecord, MergedRecord, MetaRecord, StateRecord, TrajectoryRecord, json, parse};
use crate::observe;
use bytes::Bytes;
use futures::stream::{StreamExt, TryStreamExt};
use percept_geometry::{KeyframeId, KeyframeScan};
use percept_pipeline::{NewKeyframe, TrajectoryEntry};
use percept_scene::{Object, ObjectId};
use percept_store::{BlobId, Mark, Record, Store, StoreError, keys};
use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Entries of the trajectory that become one record.
const CHUNK: usize = 256;
/// Blobs written at a time.
const BLOBS_AT_ONCE: usize = 4;
/// Bytes of records in one batch, well below what the store takes.
const BATCH_BYTES: usize = 8 << 20;
/// Keyframes that lost their scan before those scans are removed.
const TIDY_AFTER: usize = 64;
/// Blobs that nobody names stay for so long: one may have been stored for a record that is still to come.
pub(super) const GRACE: Duration = Duration::from_secs(120);

/// Entries of the trajectory with their tickets.
type Chunk = Vec<(u64, TrajectoryEntry)>;

/// What is in the store when a session wakes, as far as the writer has to know it.
#[derive(Default)]
pub(crate) struct Stored {
    pub(crate) state: StateRecord,
    /// Tickets and entries at the end of the trajectory that are in no chunk.
    pub(crate) tail: Chunk,
    pub(crate) objects: BTreeMap<ObjectId, Object>,
    /// Whether all objects are in one record, as older sessions have it.
    pub(crate) objects_in_one: bool,
}

/// Writes one session's records.
pub(super) struct Writer {
    store: Arc<dyn Store>,
    stored: Stored,
    /// Records of keyframes written by this run, to be rewritten by corrections without a read.
    keyframes: BTreeMap<KeyframeId, KeyframeRecord>,
    num_merged: usize,
}

impl Writer {
    pub(super) fn new(store: Arc<dyn Store>, stored: Stored) -> Self {
        Self { store, stored, keyframes: BTreeMap::new(), num_merged: 0 }
    }

    /// Makes jobs durable. Done again after it failed, it ends in the same records.
    pub(super) async fn write(&mut self, batch: &[(u64, Job)]) -> Result<(), Trouble> {
        let mut out = Batch::default();
        let blobs = self.put_scans(batch).await?;
        let mut blobs = blobs.into_iter();
        let mut state = self.stored.state.clone();
        let mut tail = self.stored.tail.clone();
        let mut sealed = BTreeMap::new();
        let mut num_merged = 0;
        for (ticket, job) in batch {
            for (k, blob) in job.keyframes.iter().zip(&mut blobs) {
                out.put(self.keyframe(k, blob)?);
            }
            for found in &job.loops {
                state.next_loop_id = state.next_loop_id.max(found.id.0 + 1);
                out.put((keys::loop_closure(found.id.0), json(found)?));
            }
            for (id, t_map_base) in &job.corrected {
                let moved = |record| KeyframeRecord { t_map_base: *t_map_base, ..record };
                out.extend(self.rewritten(*id, moved).await?);
            }
            for (info, merged) in &job.merged {
                let rest = MergedRecord { stamp: info.stamp, sensor: info.sensor.clone(), merged: *merged };
                let t_map_base = info.t_map_base;
                let left = |record| KeyframeRecord { t_map_base, blob: None, merged: Some(rest), ..record };
                out.extend(self.rewritten(info.id, left).await?);
                num_merged += 1;
            }
            job.dissolved.iter().for_each(|id| out.delete(keys::loop_closure(id.0)));
            if !job.mended.is_empty() {
                self.mend(&job.mended, (&mut sealed, &mut tail), &mut out).await?;
            }
            if let Some(entry) = job.entry {
                tail.push((*ticket, entry));
                out.put((keys::trajectory(*ticket), json(&entry)?));
                if tail.len() >= CHUNK {
                    sealed.extend(seal(&mut tail, &mut out)?);
                }
            }
            if let Some(meta) = &job.meta {
                out.put((keys::meta(), json(&MetaRecord::of(meta)?)?));
            }
            state.start = job.start.or(state.start);
            state.last_stamps.extend(job.frame.clone());
            state.frame_counts.extend(job.frame_counts.clone());
            state.map_version = state.map_version.max(job.map_version);
            state.ticket = *ticket;
        }
        let objects = batch.iter().rev().find_map(|(_, job)| job.objects.as_ref());
        if let Some((objects, next_id)) = objects {
            state.next_object_id = *next_id;
            self.changed_objects(objects, &mut out)?;
        }
        out.put((keys::state(), json(&state)?));
        out.commit(self.store.as_ref()).await?;
        (self.stored.state, self.stored.tail) = (state, tail);
        if let Some((objects, _)) = objects {
            self.stored.objects = objects.iter().map(|o| (o.id, o.clone())).collect();
            self.stored.objects_in_one = false;
        }
        self.num_merged += num_merged;
        Ok(())
    }

    /// Stores what new keyframes saw, a few at a time; in their order.
    async fn put_scans(&self, batch: &[(u64, Job)]) -> Result<Vec<BlobId>, Trouble> {
        let mut puts = Vec::new();
        for k in batch.iter().flat_map(|(_, job)| &job.keyframes) {
            puts.push(put_scan(Arc::clone(&self.store), Arc::clone(&k.scan)));
        }
        futures::stream::iter(puts).buffered(BLOBS_AT_ONCE).try_collect().await
    }

    /// Removes scans that no keyframe names any more, once there are some; a failure is tried again later.
    pub(super) async fn tidy(&mut self) {
        if self.num_merged < TIDY_AFTER {
            return;
        }
        self.num_merged = 0;
        // Every scan that this writer has stored is named by what it has written.
        let mark = self.store.mark();
        if let Err(error) = collect_garbage(self.store.as_ref(), mark, GRACE).await {
            tracing::warn!(?error, "scans that nobody needs were not removed");
        }
    }

    /// Rewrites entries of the trajectory, by their stamps: those at its end, in chunks of this batch, and in those before.
    async fn mend(
        &self,
        mended: &[TrajectoryEntry],
        (sealed, tail): (&mut BTreeMap<u64, Chunk>, &mut Chunk),
        out: &mut Batch,
    ) -> Result<(), Trouble> {
        let better = |e: &mut TrajectoryEntry| {
            let known = mended.binary_search_by_key(&e.stamp, |m| m.stamp).ok().and_then(|k| mended.get(k));
            known.filter(|m| *m != e).map(|m| *e = *m).is_some()
        };
        for (ticket, entry) in tail {
            if better(entry) {
                out.put((keys::trajectory(*ticket), json(entry)?));
            }
        }
        let mut changed = vec![];
        for (key, bytes) in self.store.scan_all(&keys::trajectories()).await? {
            let Some(ticket) = key.number().filter(|ticket| !sealed.contains_key(ticket)) else { continue };
            let TrajectoryRecord::Chunk(mut entries) = parse("a part of the trajectory", &bytes)? else { continue };
            if entries.iter_mut().filter_map(|e| better(e).then_some(())).count() > 0 {
                changed.push((ticket, entries));
            }
        }
        for (ticket, chunk) in sealed {
            if chunk.iter_mut().filter_map(|(_, e)| better(e).then_some(())).count() > 0 {
                changed.push((*ticket, chunk.iter().map(|(_, e)| *e).collect()));
            }
        }
        for (ticket, entries) in changed {
            out.put((keys::trajectory(ticket), json(&TrajectoryRecord::Chunk(entries))?));
        }
        Ok(())
    }

    fn changed_objects(&self, objects: &[Object], out: &mut Batch) -> Result<(), Trouble> {
        for object in objects.iter().filter(|o| self.stored.objects.get(&o.id) != Some(o)) {
            out.put((keys::object(object.id.0), json(object)?));
        }
        let there: HashSet<ObjectId> = objects.iter().map(|o| o.id).collect();
        self.stored.objects.keys().filter(|id| !there.contains(id)).for_each(|id| out.delete(keys::object(id.0)));
        if self.stored.objects_in_one {
            for object in objects {
                out.put((keys::object(object.id.0), json(object)?));
            }
            out.delete(keys::objects_in_one());
        }
        Ok(())
    }

    fn keyframe(&mut self, k: &NewKeyframe, blob: BlobId) -> Result<Record, Trouble> {
        let (t_map_base, t_odom_base, after_gap) = (k.info.t_map_base, k.t_odom_base, k.after_gap);
        let record = KeyframeRecord { t_map_base, t_odom_base, after_gap, blob: Some(blob.to_string()), merged: None };
        let out = (keys::keyframe(k.info.id.0), json(&record)?);
        self.keyframes.insert(k.info.id, record);
        Ok(out)
    }

    async fn rewritten(
        &mut self,
        id: KeyframeId,
        change: impl FnOnce(KeyframeRecord) -> KeyframeRecord,
    ) -> Result<Option<Record>, Trouble> {
        let key = keys::keyframe(id.0);
        let known = match self.keyframes.get(&id) {
            Some(record) => Some(record.clone()),
            None => match self.store.get(&key).await? {
                Some(bytes) => Some(parse("a keyframe", &bytes)?),
                None => None,
            },
        };
        let Some(record) = known else { return Ok(None) };
        let record = change(record);
        let out = (key, json(&record)?);
        self.keyframes.insert(id, record);
        Ok(Some(out))
    }
}

/// One record of the entries in `tail`, under the ticket of the first.
fn seal(tail: &mut Chunk, out: &mut Batch) -> Result<Option<(u64, Chunk)>, Trouble> {
    let entries = std::mem::take(tail);
    let Some((first, _)) = entries.first() else { return Ok(None) };
    let first = *first;
    entries.iter().filter(|(ticket, _)| *ticket != first).for_each(|(ticket, _)| out.delete(keys::trajectory(*ticket)));
    let chunk = TrajectoryRecord::Chunk(entries.iter().map(|(_, entry)| *entry).collect());
    out.put((keys::trajectory(first), json(&chunk)?));
    Ok(Some((first, entries)))
}

/// Encodes and stores what a keyframe saw, away from the threads that answer.
async fn put_scan(store: Arc<dyn Store>, scan: Arc<KeyframeScan>) -> Result<BlobId, Trouble> {
    let encoded = tokio::task::spawn_blocking(move || Bytes::from(keyframe_codec::encode(&scan)));
    let bytes = encoded.await.map_err(crate::Error::internal)?;
    let size = bytes.len();
    let id = store.put_blob(bytes).await?;
    observe::store_blob(size);
    Ok(id)
}

/// Removes the blobs of a session that none of its keyframes names, of those stored before `mark`.
pub(super) async fn collect_garbage(store: &dyn Store, mark: Mark, grace: Duration) -> Result<(), Trouble> {
    let mut live = HashSet::new();
    for (_, bytes) in store.scan_all(&keys::keyframes()).await? {
        let record: KeyframeRecord = parse("a keyframe", &bytes)?;
        if let Some(blob) = record.blob {
            live.insert(blob.parse().map_err(StoreError::from)?);
        }
    }
    let report = store.collect_garbage(&live, mark, grace).await?;
    observe::store_garbage(report.num_deleted, report.deleted_bytes);
    if report.num_deleted > 0 {
        tracing::debug!(blobs = report.num_deleted, bytes = report.deleted_bytes, "removed scans that nobody needs");
    }
    Ok(())
}

/// Records to be written together, the last word for a key standing.
#[derive(Default)]
struct Batch {
    changes: BTreeMap<percept_store::Key, Option<Bytes>>,
}

impl Batch {
    fn put(&mut self, (key, value): Record) {
        self.changes.insert(key, Some(value));
    }

    fn extend(&mut self, record: Option<Record>) {
        if let Some(record) = record {
            self.put(record);
        }
    }

    fn delete(&mut self, key: percept_store::Key) {
        self.changes.insert(key, None);
    }

    /// All of it in one step. What is too much for one goes in several, each of which leaves the session readable: the
    /// state, which says how far it has come, goes last.
    async fn commit(self, store: &dyn Store) -> Result<(), StoreError> {
        let last = keys::state();
        let (mut puts, mut deletes, mut size) = (Vec::new(), Vec::new(), 0);
        let (mut end, mut written) = (None, 0);
        let began = Instant::now();
        for (key, value) in self.changes {
            written += value.as_ref().map_or(0, Bytes::len);
            match value {
                Some(value) if key == last => end = Some((key, value)),
                Some(value) => {
                    size += value.len();
                    puts.push((key, value));
                }
                None => deletes.push(key),
            }
            if size >= BATCH_BYTES {
                store.put_batch(std::mem::take(&mut puts), Vec::new()).await?;
                size = 0;
            }
        }
        puts.extend(end);
        store.put_batch(puts, deletes).await?;
        observe::store_commit(began.elapsed(), written);
        Ok(())
    }
}
