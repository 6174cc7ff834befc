//! Every operation of percept, written once, whichever door was used.
//!
//! Comes in: checked domain types. Goes out: answers, or an [`Error`] with code, reason and field. It knows
//! nothing of protobuf, HTTP, gRPC or zenoh. Start with [`Service`], then `ops/`, one file a noun;
//! `session/` holds the actor that owns one robot's pipeline.

mod compute;
mod error;
mod limits;
mod ops;
mod session;

pub use compute::ComputePool;
pub use error::{Error, ErrorCode, Result, check_id};
pub use limits::Limits;
pub use ops::evaluation::{self, TrajectoryComparison};
pub use ops::maps::{self, CloudAnswer, GridAnswer, MapFile, MapFormat, MapSummary};
pub use ops::navigation::{self, Navigation, Plan, PlanRequest};
pub use ops::pictures;
pub use ops::sessions::{NewSession, Page};
pub use ops::toolbox;
pub use session::events::{Event, EventKind};
pub use session::handle::{Moved, Pending, Processed, Session, Ticket, Vetoed};
pub use session::meta::{OverloadPolicy, SensorDeclaration, SessionMeta, SessionMode};
pub use session::sensor_book::SensorStatus;

use percept_geometry::SensorFrame;
use session::registry::Registry;
use std::sync::Arc;

/// A frame as it came through a door.
#[derive(Debug, Clone)]
pub struct IncomingFrame {
    /// Session that it is for.
    pub session: String,
    /// The sender's running number, 0 if not numbered.
    pub sequence: u64,
    /// The frame.
    pub frame: SensorFrame,
}

/// All operations. Cheap to clone; every door holds one.
#[derive(Clone)]
pub struct Service {
    pub(crate) registry: Arc<Registry>,
    pub(crate) compute: ComputePool,
    pub(crate) limits: Arc<Limits>,
    pub(crate) kept: Arc<toolbox::KeptClouds>,
}

impl Service {
    /// Opens the service over a store: sessions found there sleep until they are used.
    ///
    /// # Errors
    /// `INTERNAL`, `UNAVAILABLE` if the catalogue cannot be read.
    pub async fn open(
        store: Arc<dyn percept_store::Store>,
        compute: ComputePool,
        limits: Limits,
        defaults: percept_pipeline::PipelineParams,
    ) -> Result<Self> {
        let limits = Arc::new(limits);
        let registry = Registry::open(store, compute.clone(), Arc::clone(&limits), defaults).await?;
        let kept = toolbox::KeptClouds::open(&limits);
        Ok(Self { registry: Arc::new(registry), compute, limits, kept })
    }

    /// The limits in force.
    pub fn limits(&self) -> &Arc<Limits> {
        &self.limits
    }

    /// Stops taking frames, finishes and stores what was accepted, ends watches.
    pub async fn stop(&self) {
        self.registry.stop().await;
    }
}
