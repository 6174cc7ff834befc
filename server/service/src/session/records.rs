//! The records of a session: what is stored of it, and how records of other versions of this program are read.
//!
//! Fields that a record lacks get their default, fields that it has too many are passed over. A record that is still
//! not readable is damage of its session and of no other.

use super::annotations::{RoomName, SessionZone};
use super::meta::{DEFAULT_TENANT, SensorDeclaration, SessionMeta, SessionMode};
use crate::SessionMask;
use bytes::Bytes;
use percept_geometry::{Pose, SensorId, Timestamp};
use percept_perception::detection::ClassExample;
use percept_pipeline::{Merged, PipelineParams, TrajectoryEntry};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// A record that cannot be read: damage.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{what}: {why}")]
pub(crate) struct Unreadable {
    what: String,
    why: String,
}

impl Unreadable {
    pub(crate) fn new(what: &str, why: impl std::fmt::Display) -> Self {
        Self { what: what.to_owned(), why: why.to_string() }
    }
}

/// Reads a record.
pub(crate) fn parse<T: DeserializeOwned>(what: &str, bytes: &[u8]) -> Result<T, Unreadable> {
    serde_json::from_slice(bytes).map_err(|e| Unreadable::new(what, e))
}

/// Serialises a record; our own types always can.
pub(crate) fn json(value: &impl Serialize) -> crate::Result<Bytes> {
    serde_json::to_vec(value).map(Bytes::from).map_err(crate::Error::internal)
}

fn default_tenant() -> String {
    DEFAULT_TENANT.to_owned()
}

/// [`SessionMeta`] as stored.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct MetaRecord {
    pub(crate) id: String,
    #[serde(default = "default_tenant")]
    pub(crate) tenant: String,
    #[serde(default)]
    pub(crate) display_name: String,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub(crate) labels: BTreeMap<String, String>,
    #[serde(default)]
    pub(crate) revision: u64,
    #[serde(default)]
    pub(crate) mode: SessionMode,
    #[serde(default)]
    pub(crate) create_time_ns: i64,
    #[serde(default)]
    pub(crate) request_id: String,
    /// As written, also by a version with other parameters.
    #[serde(default)]
    params: Value,
    #[serde(default)]
    sensors: Vec<Value>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    zones: Vec<Value>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    zone_masks: Vec<Value>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    room_names: Vec<Value>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    class_examples: Vec<Value>,
}

impl MetaRecord {
    /// For the store.
    pub(crate) fn of(meta: &SessionMeta) -> crate::Result<Self> {
        let value = |v: serde_json::Result<Value>| v.map_err(crate::Error::internal);
        Ok(Self {
            id: meta.id.clone(),
            tenant: meta.tenant.clone(),
            display_name: meta.display_name.clone(),
            labels: meta.labels.clone(),
            revision: meta.revision,
            mode: meta.mode,
            create_time_ns: meta.create_time_ns,
            request_id: meta.request_id.clone(),
            params: value(serde_json::to_value(&meta.params))?,
            sensors: meta.sensors.iter().map(|s| value(serde_json::to_value(s))).collect::<crate::Result<_>>()?,
            zones: meta.zones.iter().map(|z| value(serde_json::to_value(z))).collect::<crate::Result<_>>()?,
            zone_masks: meta.zone_masks.iter().map(|m| value(serde_json::to_value(m))).collect::<crate::Result<_>>()?,
            room_names: meta.room_names.iter().map(|n| value(serde_json::to_value(n))).collect::<crate::Result<_>>()?,
            class_examples: (meta.class_examples.iter().map(|e| value(serde_json::to_value(e))))
                .collect::<crate::Result<_>>()?,
        })
    }

    /// As the session has it. Parameters that are stored stand; those that this version does not know are left out, and
    /// those that an older one did not know get their default.
    pub(crate) fn into_meta(self, defaults: &PipelineParams) -> Result<SessionMeta, Unreadable> {
        let read = |v: Value| serde_json::from_value::<SensorDeclaration>(v);
        let unreadable = |e: serde_json::Error| Unreadable::new("a sensor", e);
        let sensors = self.sensors.into_iter().map(read).collect::<Result<_, _>>().map_err(unreadable)?;
        let zone = |v: Value| serde_json::from_value::<SessionZone>(v).map_err(|e| Unreadable::new("a zone", e));
        let zones = self.zones.into_iter().map(zone).collect::<Result<_, _>>()?;
        let mask = |v: Value| serde_json::from_value::<SessionMask>(v).map_err(|e| Unreadable::new("a zone mask", e));
        let zone_masks = self.zone_masks.into_iter().map(mask).collect::<Result<_, _>>()?;
        let name = |v: Value| serde_json::from_value::<RoomName>(v).map_err(|e| Unreadable::new("a room's name", e));
        let room_names = self.room_names.into_iter().map(name).collect::<Result<_, _>>()?;
        let example = |v: Value| {
            serde_json::from_value::<ClassExample>(v).map_err(|e| Unreadable::new("an example of a class", e))
        };
        let class_examples = self.class_examples.into_iter().map(example).collect::<Result<_, _>>()?;
        Ok(SessionMeta {
            params: params_of(&self.id, self.params, defaults),
            id: self.id,
            tenant: self.tenant,
            display_name: self.display_name,
            labels: self.labels,
            revision: self.revision,
            mode: self.mode,
            create_time_ns: self.create_time_ns,
            request_id: self.request_id,
            sensors,
            zones,
            zone_masks,
            room_names,
            class_examples,
        })
    }
}

/// Parameters that were stored, perhaps by an older version: what they do not have, and what does not fit any more, is as in `defaults`;
/// `id` is the session, for the log.
pub fn params_of(id: &str, stored: Value, defaults: &PipelineParams) -> PipelineParams {
    let Ok(mut value) = serde_json::to_value(defaults) else { return defaults.clone() };
    lay_over(&mut value, &stored);
    if let Ok(params) = serde_json::from_value(value) {
        return params;
    }
    // Some value is of another type by now: section by section, so that only its own is lost.
    let mut params = defaults.clone();
    for (name, section) in stored.as_object().into_iter().flatten() {
        let Ok(mut value) = serde_json::to_value(&params) else { continue };
        lay_over(&mut value, &serde_json::json!({ name: section }));
        match serde_json::from_value(value) {
            Ok(read) => params = read,
            Err(error) => tracing::warn!(session = id, section = name, %error, "stored parameters do not fit any more"),
        }
    }
    params
}

/// Lays what both have over `value`.
fn lay_over(value: &mut Value, stored: &Value) {
    match (value, stored) {
        (Value::Object(value), Value::Object(stored)) => {
            for (name, value) in value {
                if let Some(stored) = stored.get(name) {
                    lay_over(value, stored);
                }
            }
        }
        (value, stored) if !stored.is_null() || value.is_null() => *value = stored.clone(),
        _ => {}
    }
}

/// What is known of a session while it sleeps, beside its catalogue entry. It may be older than the session.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct SummaryRecord {
    pub(crate) meta: MetaRecord,
    #[serde(default)]
    pub(crate) counts: Counts,
    #[serde(default)]
    pub(crate) last_stamps: BTreeMap<SensorId, Timestamp>,
    #[serde(default)]
    pub(crate) frame_counts: BTreeMap<SensorId, FrameCounts>,
}

/// How much a session has gathered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Counts {
    /// Keyframes that the map is made of.
    pub num_keyframes: u64,
    /// Objects that are there.
    pub num_objects: u64,
    /// Version of the map.
    pub map_version: u64,
    /// Stamp of the newest frame that moved the pose, nanoseconds; 0 if there is none.
    pub last_stamp_ns: i64,
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
#[serde(default)]
pub(crate) struct StateRecord {
    pub(crate) ticket: u64,
    pub(crate) last_stamps: BTreeMap<SensorId, Timestamp>,
    pub(crate) next_object_id: u64,
    pub(crate) next_loop_id: u64,
    /// Of the map that callers were told of.
    pub(crate) map_version: u64,
    pub(crate) frame_counts: BTreeMap<SensorId, FrameCounts>,
    /// Where the robot starts in a map that was given, base to map, if that was told.
    pub(crate) start: Option<Pose>,
}

/// What was counted of a sensor's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct FrameCounts {
    pub(crate) accepted: u64,
    pub(crate) rejected: u64,
    pub(crate) dropped: u64,
    pub(crate) gaps: u64,
}

/// A record of the trajectory: an entry as its frame left it, or a chunk of those.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum TrajectoryRecord {
    One(TrajectoryEntry),
    Chunk(Vec<TrajectoryEntry>),
}

#[cfg(test)]
mod tests {
    use super::*;

    fn meta() -> SessionMeta {
        SessionMeta {
            id: "a".to_owned(),
            tenant: "site".to_owned(),
            display_name: "A".to_owned(),
            labels: BTreeMap::from([("site".to_owned(), "north".to_owned())]),
            zones: Vec::new(),
            zone_masks: Vec::new(),
            room_names: Vec::new(),
            class_examples: Vec::new(),
            revision: 3,
            mode: SessionMode::Mapping,
            create_time_ns: 7,
            request_id: String::new(),
            params: PipelineParams::default(),
            sensors: vec![],
        }
    }

    #[test]
    fn a_record_is_read_as_it_was_written() {
        let mut meta = meta();
        meta.params.map.cloud.voxel_size_m = 0.2;
        let bytes = json(&MetaRecord::of(&meta).unwrap()).unwrap();
        let read: MetaRecord = parse("meta", &bytes).unwrap();
        assert_eq!(read.into_meta(&PipelineParams::default()).unwrap(), meta);
    }

    #[test]
    fn fields_of_other_versions_are_passed_over_or_get_their_default() {
        let mut value = serde_json::to_value(MetaRecord::of(&meta()).unwrap()).unwrap();
        value["colour"] = "red".into();
        value["params"]["map"]["cloud"]["voxel_size_m"] = 0.3.into();
        value["params"]["map"]["cloud"]["sparkle"] = true.into();
        value["params"]["magic"] = serde_json::json!({ "wand": 1 });
        value["params"]["map"]["occupancy"] = Value::Null;
        value.as_object_mut().unwrap().remove("tenant");
        let read: MetaRecord = serde_json::from_value(value).unwrap();
        let read = read.into_meta(&PipelineParams::default()).unwrap();
        assert_eq!(read.tenant, DEFAULT_TENANT);
        let mut expected = PipelineParams::default();
        expected.map.cloud.voxel_size_m = 0.3;
        assert_eq!(read.params, expected);
    }

    #[test]
    fn a_parameter_of_another_type_costs_its_section_alone() {
        let mut value = serde_json::to_value(MetaRecord::of(&meta()).unwrap()).unwrap();
        value["params"]["map"]["cloud"]["voxel_size_m"] = "fine".into();
        value["params"]["detection"]["enabled"] = false.into();
        let read: MetaRecord = serde_json::from_value(value).unwrap();
        let params = read.into_meta(&PipelineParams::default()).unwrap().params;
        assert_eq!(params.map, PipelineParams::default().map);
        assert!(!params.detection.enabled);
    }
}
