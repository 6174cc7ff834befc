//! What a session was created with: the record in the catalogue.

use super::annotations::{RoomName, SessionZone};
use crate::SessionMask;
use percept_geometry::SensorSpec;
use percept_perception::detection::ClassExample;
use percept_pipeline::PipelineParams;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What a session does with its frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SessionMode {
    /// SLAM, maps, objects, scene.
    #[default]
    Mapping,
    /// Frames are decoded, checked and counted, nothing more.
    IngestOnly,
}

/// What happens to frames that come faster than they are processed, where the door cannot make the sender wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OverloadPolicy {
    /// The sender waits.
    Block,
    /// The oldest waiting frame of the sensor is dropped and counted.
    #[default]
    DropOldest,
}

/// A sensor as the session knows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorDeclaration {
    /// Kind, extrinsics, intrinsics.
    pub spec: SensorSpec,
    /// What to do under overload.
    pub overload: OverloadPolicy,
}

/// What a session is: as it was created, and as it was changed since.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionMeta {
    /// Identifier.
    pub id: String,
    /// Whose it is.
    pub tenant: String,
    /// For people.
    pub display_name: String,
    /// For programs: by which lists are filtered.
    pub labels: BTreeMap<String, String>,
    /// What it does with frames.
    pub mode: SessionMode,
    /// Server's clock, nanoseconds since the Unix epoch.
    pub create_time_ns: i64,
    /// Of the creating call; empty if none.
    pub request_id: String,
    /// Every parameter.
    pub params: PipelineParams,
    /// Sensors by name.
    pub sensors: Vec<SensorDeclaration>,
    /// Areas that paths keep to.
    pub zones: Vec<SessionZone>,
    /// The same cell by cell.
    pub zone_masks: Vec<SessionMask>,
    /// What people call rooms.
    pub room_names: Vec<RoomName>,
    /// Things that people named, from which classes are learned.
    pub class_examples: Vec<ClassExample>,
    /// Grows with every change of all this.
    pub revision: u64,
}

impl SessionMeta {
    /// Names this state of what callers set. No other session under the same id ever has the same.
    pub fn etag(&self) -> String {
        etag(self.create_time_ns, self.revision)
    }
}

/// Names a state of what callers set of a session.
pub(crate) fn etag(create_time_ns: i64, revision: u64) -> String {
    format!("{create_time_ns:x}-{revision}")
}

impl SensorDeclaration {
    /// Names this declaration: the same for the same content.
    ///
    /// Source: FNV-1a with 64 bits (Fowler, Noll, Vo), over the record.
    pub fn etag(&self) -> String {
        let record = serde_json::to_vec(self).unwrap_or_default();
        let fold = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        format!("{:016x}", record.iter().fold(0xcbf2_9ce4_8422_2325, fold))
    }
}

/// Tenant of sessions that nobody in particular owns.
pub const DEFAULT_TENANT: &str = "default";
