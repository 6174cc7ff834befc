//! Makes what frames did durable, in their order, many at a time, and says how far it has come.

use super::keyframe_codec;
use crate::{Error, ErrorCode, Result};
use bytes::Bytes;
use percept_geometry::{KeyframeId, Pose, SensorId, Timestamp};
use percept_pipeline::{KeyframeInfo, Loop, LoopId, Merged, NewKeyframe, TrajectoryEntry};
use percept_scene::Object;
use percept_store::{Key, Record, SessionKeys, Store, StoreError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

/// Frames that may wait for the disk before ingest waits, too.
const BACKLOG: usize = 256;
/// First and longest pause between tries after a fault of the storage.
const RETRY: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(5));

/// What one frame, or a change of the map without one, left behind.
#[derive(Default)]
pub(crate) struct Job {
    /// Whose frame it was, and when.
    pub(crate) frame: Option<(SensorId, Timestamp)>,
    pub(crate) entry: Option<TrajectoryEntry>,
    /// New keyframes, by number.
    pub(crate) keyframes: Vec<NewKeyframe>,
    /// Loops that were found or changed their state.
    pub(crate) loops: Vec<Loop>,
    /// All objects and the number that the next one gets, if any changed.
    pub(crate) objects: Option<(Arc<Vec<Object>>, u64)>,
    /// Keyframes that a correction moved.
    pub(crate) corrected: BTreeMap<KeyframeId, Pose>,
    /// Keyframes that others stand for from now on.
    pub(crate) merged: Vec<(KeyframeInfo, Merged)>,
    /// Loops that went with them.
    pub(crate) dissolved: Vec<LoopId>,
}

/// Record of a keyframe; what it saw is in the blob, unless another one stands for it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct KeyframeRecord {
    pub(crate) t_map_base: Pose,
    pub(crate) t_odom_base: Pose,
    /// Whether nothing measured ties it to the keyframe before.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(crate) after_gap: bool,
    /// SHA-256 of the encoded scan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) blob: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) merged: Option<MergedRecord>,
}

/// What is left of a keyframe that another one stands for.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct MergedRecord {
    pub(crate) stamp: Timestamp,
    pub(crate) sensor: SensorId,
    pub(crate) merged: Merged,
}

/// Record of how far a session has come.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct StateRecord {
    pub(crate) ticket: u64,
    pub(crate) last_stamps: BTreeMap<SensorId, Timestamp>,
    pub(crate) next_object_id: u64,
    #[serde(default)]
    pub(crate) next_loop_id: u64,
}

/// `sessions/<id>/<name>`.
pub(crate) fn key(session: &str, name: &str) -> Result<Key> {
    Key::new(["sessions", session, name]).map_err(|e| store_error(&e))
}

/// Serialises a record; our own types always can.
pub(crate) fn json(value: &impl Serialize) -> Result<Bytes> {
    serde_json::to_vec(value).map(Bytes::from).map_err(Error::internal)
}

/// The storage's facts in the caller's words.
pub(crate) fn store_error(e: &StoreError) -> Error {
    match e {
        StoreError::Full => Error::exhausted("STORAGE_FULL", "", "no space left where the data live; free some"),
        StoreError::Fenced { .. } => Error::new(
            ErrorCode::Unavailable,
            "STORAGE_FENCED",
            "another server has taken over the data; talk to that one",
        ),
        StoreError::Closed => Error::new(ErrorCode::Unavailable, "STOPPING", "the server is stopping; try again"),
        StoreError::Stalled { .. } | StoreError::Io { .. } => {
            tracing::error!(error = ?e, "storage fault");
            Error::new(
                ErrorCode::Unavailable,
                "STORAGE_FAULT",
                "the storage does not take data; the server's log has the cause",
            )
        }
        other => Error::internal(other),
    }
}

/// Sends jobs to the task that stores them.
pub(crate) struct Persister {
    jobs: mpsc::Sender<(u64, Job)>,
    next_ticket: u64,
    durable: watch::Receiver<u64>,
    fault: watch::Receiver<Option<Error>>,
    task: Option<JoinHandle<()>>,
}

impl Persister {
    /// Starts the task for a session whose stored state is given.
    pub(crate) fn start(store: Arc<dyn Store>, session: &str, state: StateRecord) -> Result<Self> {
        let keys = SessionKeys::new(session).map_err(|e| store_error(&e))?;
        let (jobs, queue) = mpsc::channel(BACKLOG);
        let (durable_tx, durable) = watch::channel(state.ticket);
        let (fault_tx, fault) = watch::channel(None);
        let next_ticket = state.ticket + 1;
        let writer = Writer {
            store,
            keys,
            state_key: key(session, "state")?,
            objects_key: key(session, "objects")?,
            state,
            keyframes: BTreeMap::new(),
        };
        let task = Some(tokio::spawn(writer.run(queue, durable_tx, fault_tx)));
        Ok(Self { jobs, next_ticket, durable, fault, task })
    }

    pub(crate) fn durable(&self) -> watch::Receiver<u64> {
        self.durable.clone()
    }

    pub(crate) fn fault(&self) -> watch::Receiver<Option<Error>> {
        self.fault.clone()
    }

    /// Queues a job; waits when the backlog is full. Answers with its ticket.
    pub(crate) async fn submit(&mut self, job: Job) -> u64 {
        let ticket = self.next_ticket;
        self.next_ticket += 1;
        let _ = self.jobs.send((ticket, job)).await;
        ticket
    }

    /// The newest ticket.
    pub(crate) fn newest(&self) -> u64 {
        self.next_ticket - 1
    }

    /// Stores what is queued, then ends; gives up on a storage that does not recover.
    pub(crate) async fn finish(&mut self) {
        let (closed, _) = mpsc::channel(1);
        self.jobs = closed;
        if let Some(task) = self.task.take() {
            let abort = task.abort_handle();
            if tokio::time::timeout(Duration::from_secs(10), task).await.is_err() {
                tracing::error!("storage does not take the last frames; giving up");
                abort.abort();
            }
        }
    }
}

struct Writer {
    store: Arc<dyn Store>,
    keys: SessionKeys,
    state_key: Key,
    objects_key: Key,
    state: StateRecord,
    /// Records of keyframes written by this run, to be rewritten by corrections without a read.
    keyframes: BTreeMap<KeyframeId, KeyframeRecord>,
}

impl Writer {
    async fn run(
        mut self,
        mut queue: mpsc::Receiver<(u64, Job)>,
        durable: watch::Sender<u64>,
        fault: watch::Sender<Option<Error>>,
    ) {
        let mut batch = Vec::new();
        while queue.recv_many(&mut batch, BACKLOG).await > 0 {
            let mut pause = RETRY.0;
            loop {
                match self.write(&batch).await {
                    Ok(()) => break,
                    Err(e) => {
                        let _ = fault.send(Some(e));
                        tokio::time::sleep(pause).await;
                        pause = (pause * 2).min(RETRY.1);
                    }
                }
            }
            fault.send_if_modified(|f| f.take().is_some());
            if let Some((ticket, _)) = batch.last() {
                let _ = durable.send(*ticket);
            }
            batch.clear();
        }
    }

    /// Blobs first, then one batch of records that names them.
    async fn write(&mut self, batch: &[(u64, Job)]) -> Result<()> {
        let mut records: Vec<Record> = Vec::new();
        let mut deletes: Vec<Key> = Vec::new();
        for (ticket, job) in batch {
            for keyframe in &job.keyframes {
                records.push(self.keyframe(keyframe).await?);
            }
            for found in &job.loops {
                self.state.next_loop_id = self.state.next_loop_id.max(found.id.0 + 1);
                records.push((self.keys.loop_closure(found.id.0), json(found)?));
            }
            for (id, t_map_base) in &job.corrected {
                let moved = |record| KeyframeRecord { t_map_base: *t_map_base, ..record };
                records.extend(self.rewritten(*id, moved).await?);
            }
            for (info, merged) in &job.merged {
                let rest = MergedRecord { stamp: info.stamp, sensor: info.sensor.clone(), merged: *merged };
                let t_map_base = info.t_map_base;
                let left = |record| KeyframeRecord { t_map_base, blob: None, merged: Some(rest), ..record };
                records.extend(self.rewritten(info.id, left).await?);
            }
            deletes.extend(job.dissolved.iter().map(|id| self.keys.loop_closure(id.0)));
            if let Some(entry) = &job.entry {
                records.push((self.keys.trajectory(*ticket), json(entry)?));
            }
            self.state.last_stamps.extend(job.frame.clone());
            self.state.ticket = *ticket;
        }
        if let Some((objects, next_id)) = batch.iter().rev().find_map(|(_, job)| job.objects.as_ref()) {
            self.state.next_object_id = *next_id;
            records.push((self.objects_key.clone(), json(objects.as_ref())?));
        }
        records.push((self.state_key.clone(), json(&self.state)?));
        // A loop that one job found and a later one dissolved is in both: what is deleted stays so.
        records.retain(|(key, _)| !deletes.contains(key));
        self.store.put_batch(records, deletes).await.map_err(|e| store_error(&e))
    }

    async fn keyframe(&mut self, k: &NewKeyframe) -> Result<Record> {
        let bytes = Bytes::from(keyframe_codec::encode(&k.scan));
        let blob = self.store.put_blob(bytes).await.map_err(|e| store_error(&e))?;
        let (t_map_base, t_odom_base, after_gap) = (k.info.t_map_base, k.t_odom_base, k.after_gap);
        let record = KeyframeRecord { t_map_base, t_odom_base, after_gap, blob: Some(blob.to_string()), merged: None };
        let out = (self.keys.keyframe(k.info.id.0), json(&record)?);
        self.keyframes.insert(k.info.id, record);
        Ok(out)
    }

    async fn rewritten(
        &mut self,
        id: KeyframeId,
        change: impl FnOnce(KeyframeRecord) -> KeyframeRecord,
    ) -> Result<Option<Record>> {
        let key = self.keys.keyframe(id.0);
        let known = match self.keyframes.get(&id) {
            Some(record) => Some(record.clone()),
            None => match self.store.get(&key).await.map_err(|e| store_error(&e))? {
                Some(bytes) => Some(serde_json::from_slice(&bytes).map_err(Error::internal)?),
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
