//! Brings a session back from its records.

use super::keyframe_codec;
use super::meta::SessionMeta;
use super::persist::{KeyframeRecord, MergedRecord, StateRecord, key, store_error};
use crate::{ComputePool, Error, Result};
use percept_pipeline::{Pipeline, Restored, RestoredContent, RestoredKeyframe};
use percept_scene::Object;
use percept_store::{BlobId, SessionKeys, Store};
use std::sync::Arc;

/// The pipeline as the store has it, and how far the session had come.
///
/// # Errors
/// Faults of the storage; `INTERNAL` for damaged records.
pub(crate) async fn recover(
    store: &Arc<dyn Store>,
    compute: &ComputePool,
    meta: &SessionMeta,
) -> Result<(Pipeline, StateRecord)> {
    let keys = SessionKeys::new(&meta.id).map_err(|e| store_error(&e))?;
    let mut restored = Restored::default();
    for (_, bytes) in store.scan_all(&keys.keyframes()).await.map_err(|e| store_error(&e))? {
        let record: KeyframeRecord = parse(&bytes)?;
        let content = match (record.blob, record.merged) {
            (_, Some(MergedRecord { stamp, sensor, merged })) => RestoredContent::Merged { stamp, sensor, merged },
            (Some(blob), None) => {
                let blob: BlobId = blob.parse().map_err(|e| store_error(&e))?;
                let bytes = store.get_blob(blob).await.map_err(|e| store_error(&e))?;
                RestoredContent::Scan(Arc::new(keyframe_codec::decode(&bytes).map_err(Error::internal)?))
            }
            (None, None) => return Err(Error::internal("a keyframe's record names neither what it saw nor another")),
        };
        let (t_map_base, t_odom_base, after_gap) = (record.t_map_base, record.t_odom_base, record.after_gap);
        restored.keyframes.push(RestoredKeyframe { t_map_base, t_odom_base, after_gap, content });
    }
    for (_, bytes) in store.scan_all(&keys.trajectories()).await.map_err(|e| store_error(&e))? {
        restored.trajectory.push(parse(&bytes)?);
    }
    for (_, bytes) in store.scan_all(&keys.loop_closures()).await.map_err(|e| store_error(&e))? {
        restored.loops.push(parse(&bytes)?);
    }
    let get = |name| {
        let key = key(&meta.id, name);
        async move { store.get(&key?).await.map_err(|e| store_error(&e)) }
    };
    restored.objects = get("objects").await?.map(|b| parse::<Vec<Object>>(&b)).transpose()?.unwrap_or_default();
    let state: StateRecord = get("state").await?.map(|b| parse(&b)).transpose()?.unwrap_or_default();
    restored.last_stamps = state.last_stamps.clone();
    restored.next_object_id = state.next_object_id;
    restored.next_loop_id = state.next_loop_id;
    let (params, sensors) = (meta.params.clone(), meta.sensors.clone());
    let pipeline = compute
        .run(move || {
            let mut pipeline = Pipeline::new(params).map_err(|e| crate::ops::params_error(&e))?;
            sensors.into_iter().for_each(|s| pipeline.declare_sensor(s.spec));
            pipeline.restore(restored);
            Ok::<_, Error>(pipeline)
        })
        .await??;
    Ok((pipeline, state))
}

fn parse<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> Result<T> {
    serde_json::from_slice(bytes).map_err(Error::internal)
}
