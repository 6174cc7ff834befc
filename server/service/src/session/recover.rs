//! Brings a session back from its records: all of it, or what of it is whole.

use super::fault::{Fault, Trouble};
use super::keyframe_codec;
use super::meta::SessionMeta;
use super::records::{KeyframeRecord, MergedRecord, MetaRecord, StateRecord, TrajectoryRecord, parse};
use super::scratch::Scratch;
use super::shelf::Shelf;
use super::writer::Stored;
use crate::reason;
use crate::{ComputePool, Error};
use futures::stream::{StreamExt, TryStreamExt};
use percept_geometry::{KeyframeId, Pose, SensorId, Timestamp};
use percept_pipeline::{
    Loop, Merged, Pipeline, PipelineParams, Restored, RestoredContent, RestoredKeyframe, TrajectoryEntry,
};
use percept_scene::Object;
use percept_store::{BlobId, Record, Store, StoreError, keys};
use std::collections::HashSet;
use std::sync::Arc;

/// Scans read and decoded at a time.
const SCANS_AT_ONCE: usize = 16;

/// Callers may have been told of so many versions of a map more than are stored when a server is killed: a few for each frame
/// that waits for the disk, of which there are 256 at most.
const NOT_STORED: u64 = 1000;

/// A session as it was stored.
pub(super) struct Recovered {
    pub(super) meta: SessionMeta,
    pub(super) pipeline: Pipeline,
    pub(super) stored: Stored,
    pub(super) scratch: Arc<Scratch>,
    /// What is missing of it, if it is not whole: it is not to be written then.
    pub(super) damage: Option<Fault>,
}

/// Reads a session. What is damaged is left out and told; `created` is its record in the catalogue; what of
/// its map has no room in memory goes to the scratch file.
///
/// # Errors
/// [`Trouble::Passing`] for faults of the storage, [`Trouble::Lasting`] if nothing of it can be read.
pub(super) async fn recover(
    store: Arc<dyn Store>,
    (compute, shelf): (&ComputePool, &Shelf),
    created: MetaRecord,
    defaults: &PipelineParams,
    scratch: Arc<Scratch>,
) -> Result<Recovered, Trouble> {
    let mut damage = Damage::default();
    let meta = match store.get(&keys::meta()).await? {
        Some(bytes) => damage.unless(parse("meta", &bytes)).unwrap_or(created),
        None => created,
    };
    let meta = meta.into_meta(defaults)?;
    let mut stored = Stored::default();
    let trajectory = read_trajectory(store.as_ref(), &mut stored, &mut damage).await?;
    let loops = read_loops(store.as_ref(), &mut damage).await?;
    let objects = read_objects(store.as_ref(), &mut stored, &mut damage).await?;
    if let Some(bytes) = store.get(&keys::state()).await? {
        stored.state = damage.unless(parse("state", &bytes)).unwrap_or_default();
    }
    let keyframes = read_keyframes(&store, &trajectory, &mut damage).await?;
    let state: StateRecord = stored.state.clone();
    let whole: HashSet<KeyframeId> = keyframes
        .iter()
        .enumerate()
        .filter(|(_, k)| matches!(k.content, RestoredContent::Scan(_)))
        .map(|(i, _)| KeyframeId(i as u64))
        .collect();
    let mut restored = Restored {
        keyframes,
        trajectory,
        loops,
        objects,
        next_loop_id: state.next_loop_id,
        next_object_id: state.next_object_id,
        last_stamps: state.last_stamps,
        start: state.start,
        map_version: if state.map_version > 0 { state.map_version + NOT_STORED } else { 0 },
    };
    if damage.first.is_some() {
        restored.loops.retain(|l| whole.contains(&l.closure.from) && whole.contains(&l.closure.to));
    }
    let (params, sensors) = (meta.params.clone(), meta.sensors.clone());
    let image_detectors = shelf.named(&meta.tenant, &meta.params.detection.learned);
    if !meta.params.detection.learned.is_empty() && image_detectors.iter().next().is_none() {
        let detector = meta.params.detection.learned.as_str();
        tracing::warn!(session = meta.id, detector, "the learned detector that the session names is not there");
    }
    let class_examples = Arc::new(meta.class_examples.clone());
    let sender = compute.admission().sender(&meta.tenant, &meta.id);
    let executor = compute.beside_frames(&sender);
    let map_store = Arc::clone(&scratch);
    let built = compute.run_for(&sender, move || {
        let mut pipeline = Pipeline::new(params).map_err(|e| crate::ops::params_error(&e))?;
        if let Some(executor) = executor {
            pipeline.work_beside_frames(executor);
        }
        pipeline.set_map_store(map_store);
        sensors.into_iter().for_each(|s| pipeline.declare_sensor(s.spec));
        pipeline.set_image_detectors(image_detectors);
        pipeline.set_class_examples(class_examples);
        pipeline.restore(restored);
        Ok::<_, Error>(pipeline)
    });
    let pipeline = built.await.and_then(|built| built).map_err(|e| {
        Trouble::Lasting(Fault::new(
            reason::NOT_RESTORABLE,
            format!("its map cannot be built from what is stored: {e}"),
        ))
    })?;
    let damage = damage.fault();
    Ok(Recovered { meta, pipeline, stored, scratch, damage })
}

/// What was found to be damaged.
#[derive(Default)]
struct Damage {
    first: Option<String>,
    count: usize,
}

impl Damage {
    fn note(&mut self, what: impl std::fmt::Display) {
        self.count += 1;
        self.first.get_or_insert_with(|| what.to_string());
    }

    fn unless<T>(&mut self, read: Result<T, impl std::fmt::Display>) -> Option<T> {
        read.map_err(|e| self.note(e)).ok()
    }

    fn fault(self) -> Option<Fault> {
        let first = self.first?;
        let more = if self.count > 1 { format!(", and {} more like it", self.count - 1) } else { String::new() };
        Some(Fault::new(reason::DATA_DAMAGED, format!("stored data are damaged: {first}{more}")))
    }
}

async fn read_trajectory(
    store: &dyn Store,
    stored: &mut Stored,
    damage: &mut Damage,
) -> Result<Vec<TrajectoryEntry>, Trouble> {
    let mut entries: Vec<TrajectoryEntry> = Vec::new();
    for (key, bytes) in store.scan_all(&keys::trajectories()).await? {
        let Some(record) = damage.unless(parse("a part of the trajectory", &bytes)) else { continue };
        // A write that broke off may have left an entry that is in a chunk as well.
        let is_new = |last: Option<&TrajectoryEntry>, e: &TrajectoryEntry| last.is_none_or(|l| e.stamp > l.stamp);
        match record {
            TrajectoryRecord::One(entry) if is_new(entries.last(), &entry) => {
                entries.push(entry);
                stored.tail.extend(key.number().map(|ticket| (ticket, entry)));
            }
            TrajectoryRecord::One(_) => {}
            TrajectoryRecord::Chunk(chunk) => {
                stored.tail.clear();
                for entry in chunk {
                    if is_new(entries.last(), &entry) {
                        entries.push(entry);
                    }
                }
            }
        }
    }
    Ok(entries)
}

async fn read_loops(store: &dyn Store, damage: &mut Damage) -> Result<Vec<Loop>, Trouble> {
    let records = store.scan_all(&keys::loop_closures()).await?;
    Ok(records.iter().filter_map(|(_, bytes)| damage.unless(parse("a loop", bytes))).collect())
}

async fn read_objects(store: &dyn Store, stored: &mut Stored, damage: &mut Damage) -> Result<Vec<Object>, Trouble> {
    let records = store.scan_all(&keys::objects()).await?;
    let mut objects: Vec<Object> =
        records.iter().filter_map(|(_, bytes)| damage.unless(parse("an object", bytes))).collect();
    if let Some(bytes) = store.get(&keys::objects_in_one()).await? {
        stored.objects_in_one = true;
        objects = damage.unless(parse("the objects", &bytes)).unwrap_or_default();
    }
    stored.objects = objects.iter().map(|o| (o.id, o.clone())).collect();
    Ok(objects)
}

/// Keyframes from number 0 on. One whose record or scan is damaged hangs on the nearest that is whole.
async fn read_keyframes(
    store: &Arc<dyn Store>,
    trajectory: &[TrajectoryEntry],
    damage: &mut Damage,
) -> Result<Vec<RestoredKeyframe>, Trouble> {
    let records = store.scan_all(&keys::keyframes()).await?;
    let reads = records.into_iter().map(|record| read_keyframe(Arc::clone(store), record));
    let read: Vec<(u64, Read)> = futures::stream::iter(reads).buffered(SCANS_AT_ONCE).try_collect().await?;
    let mut slots: Vec<Read> = Vec::new();
    for (number, read) in read {
        let Ok(number) = usize::try_from(number) else { continue };
        // Numbers have no gaps unless a record is lost; one that is far off is no number of ours.
        if number > slots.len() + trajectory.len() {
            damage.note(format!("keyframe {number} follows {}", slots.len()));
            continue;
        }
        while slots.len() < number {
            slots.push(Read::damaged("a keyframe's record is missing"));
        }
        slots.push(read);
    }
    slots.iter().filter_map(|s| s.damage.as_ref()).for_each(|what| damage.note(what));
    if slots.iter().all(|s| s.keyframe.is_some()) {
        return Ok(slots.into_iter().filter_map(|s| s.keyframe).collect());
    }
    let whole: Vec<(usize, RestoredKeyframe)> =
        slots.iter().enumerate().filter_map(|(i, s)| Some((i, s.keyframe.clone()?))).collect();
    let stands_in = |i: usize, pose: Option<Pose>| {
        let (into, neighbour) = whole.iter().min_by_key(|(j, _)| i.abs_diff(*j))?;
        let id = KeyframeId(i as u64);
        let entry = trajectory.iter().find(|e| e.is_keyframe && e.anchor == Some(id));
        let (stamp, sensor) = place_in_time(neighbour);
        let t_map_base = pose.unwrap_or(neighbour.t_map_base);
        let t_into_base = neighbour.t_map_base.inverse() * t_map_base;
        let merged = Merged { into: KeyframeId(*into as u64), t_into_base };
        let content = RestoredContent::Merged { stamp: entry.map_or(stamp, |e| e.stamp), sensor, merged };
        Some(RestoredKeyframe { t_map_base, t_odom_base: neighbour.t_odom_base, after_gap: false, content })
    };
    let filled: Option<Vec<RestoredKeyframe>> =
        slots.into_iter().enumerate().map(|(i, s)| s.keyframe.or_else(|| stands_in(i, s.t_map_base))).collect();
    filled.ok_or_else(|| Trouble::Lasting(Fault::new(reason::DATA_DAMAGED, "none of its keyframes can be read")))
}

fn place_in_time(k: &RestoredKeyframe) -> (Timestamp, SensorId) {
    match &k.content {
        RestoredContent::Scan(scan) => (scan.stamp, scan.sensor.clone()),
        RestoredContent::Merged { stamp, sensor, .. } => (*stamp, sensor.clone()),
    }
}

/// A keyframe as far as it could be read.
struct Read {
    keyframe: Option<RestoredKeyframe>,
    t_map_base: Option<Pose>,
    damage: Option<String>,
}

impl Read {
    fn damaged(what: impl Into<String>) -> Self {
        Self { keyframe: None, t_map_base: None, damage: Some(what.into()) }
    }
}

async fn read_keyframe(store: Arc<dyn Store>, (key, bytes): Record) -> Result<(u64, Read), Trouble> {
    let number = key.number().unwrap_or(u64::MAX);
    let record: KeyframeRecord = match parse("a keyframe", &bytes) {
        Ok(record) => record,
        Err(unreadable) => return Ok((number, Read::damaged(unreadable.to_string()))),
    };
    let (t_map_base, t_odom_base, after_gap) = (record.t_map_base, record.t_odom_base, record.after_gap);
    let content = match (record.blob, record.merged) {
        (_, Some(MergedRecord { stamp, sensor, merged })) => Ok(RestoredContent::Merged { stamp, sensor, merged }),
        (Some(blob), None) => read_scan(store, &blob).await?,
        (None, None) => Err("a keyframe's record names neither what it saw nor another".to_owned()),
    };
    let t = Some(t_map_base);
    Ok((
        number,
        match content {
            Ok(content) => {
                let keyframe = RestoredKeyframe { t_map_base, t_odom_base, after_gap, content };
                Read { keyframe: Some(keyframe), t_map_base: t, damage: None }
            }
            Err(damage) => Read { keyframe: None, t_map_base: t, damage: Some(damage) },
        },
    ))
}

/// A scan, decoded away from the threads that answer; inside, what is wrong with it.
async fn read_scan(store: Arc<dyn Store>, blob: &str) -> Result<Result<RestoredContent, String>, Trouble> {
    let Ok(blob) = blob.parse::<BlobId>() else { return Ok(Err(format!("{blob:?} names no scan"))) };
    let bytes = match store.get_blob(blob).await {
        Ok(bytes) => bytes,
        Err(e @ (StoreError::BlobMissing { .. } | StoreError::BlobCorrupt { .. })) => return Ok(Err(e.to_string())),
        Err(e) => return Err(e.into()),
    };
    let decoded = tokio::task::spawn_blocking(move || keyframe_codec::decode(&bytes)).await.map_err(Error::internal)?;
    Ok(decoded.map(|scan| RestoredContent::Scan(Arc::new(scan))).map_err(|e| e.to_string()))
}
