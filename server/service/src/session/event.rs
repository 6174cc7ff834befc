//! What happens in a session.

use percept_geometry::Timestamp;

/// What happened.
#[derive(Debug, Clone)]
pub enum EventKind {
    /// A frame was registered.
    Pose(Box<percept_pipeline::PoseEstimate>),
    /// A frame became a keyframe.
    Keyframe(percept_pipeline::KeyframeInfo),
    /// An object changed; with it as it is now, if it is still there.
    Object(Box<(percept_scene::ObjectChange, Option<percept_scene::Object>)>),
    /// A loop was found or changed its state.
    Loop(Box<percept_pipeline::Loop>),
    /// The map has a new version.
    MapVersion(u64),
    /// Events are missing; how many.
    Resync(u64),
}

/// An event with its place in the order.
#[derive(Debug, Clone)]
pub struct Event {
    /// Grows by one with every event.
    pub token: u64,
    /// Stamp of the frame that caused it.
    pub stamp: Timestamp,
    /// What happened.
    pub kind: EventKind,
}
