//! Detections in, understanding out: objects with an identity, their relations, the scene graph.
//!
//! Comes in: what was detected in the map frame, with a stamp, and a way to ask whether a place was seen
//! through. Goes out: tracked objects and what changed ([`Tracker::update`]), and a graph of them and the robot
//! ([`SceneGraph::build`]). Nothing is detected here, and no map is kept. Start with [`tracker`].
//!
//! All boxes are upright in the map frame (z up). The same detections give the same objects, in whatever order
//! a frame lists them.

mod annotation;
pub mod assignment;
mod association;
mod belief;
mod correction;
mod motion;
mod node;
pub mod object;
mod object_filter;
mod object_id;
pub mod overlap;
mod params;
mod passing;
mod relation_filter;
pub mod relations;
pub mod rooms;
pub mod scene_graph;
mod track;
pub mod tracker;

pub use annotation::Annotation;
pub use belief::ClassBelief;
pub use correction::{Correction, CorrectionError, MAX_PIECES};
pub use node::{Node, RoomNode};
pub use object::{Object, ObjectChange, ObjectChangeKind, ObjectState, Observation, PastState, Visibility};
pub use object_filter::ObjectFilter;
pub use object_id::ObjectId;
pub use params::TrackerParams;
pub use relation_filter::RelationFilter;
pub use relations::{Directions, NodeId, Related, Relation, RelationFrame, RelationKind, RelationParams};
pub use scene_graph::{SceneGraph, SceneView};
pub use tracker::Tracker;

/// Why a request to this crate cannot be served.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// A parameter is out of its bounds.
    #[error("{field}: {value} is not {requirement}")]
    InvalidParam {
        /// Parameter name.
        field: &'static str,
        /// The value as given.
        value: f64,
        /// What it has to be.
        requirement: &'static str,
    },
}

/// Holds if `value` is a number within `[low, high]`.
fn within(field: &'static str, value: f64, low: f64, high: f64, requirement: &'static str) -> Result<(), SceneError> {
    if value >= low && value <= high { Ok(()) } else { Err(SceneError::InvalidParam { field, value, requirement }) }
}
