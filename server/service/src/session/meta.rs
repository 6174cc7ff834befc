//! What a session was created with: the record in the catalogue.

use percept_geometry::SensorSpec;
use percept_pipeline::PipelineParams;
use serde::{Deserialize, Serialize};

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
}

/// Tenant of sessions that nobody in particular owns.
pub const DEFAULT_TENANT: &str = "default";
