//! Every operation of percept, written once, whichever door was used.
//!
//! Comes in: checked domain types. Goes out: answers, or an [`Error`] with code, reason and field. It knows
//! nothing of protobuf, HTTP, gRPC or zenoh. Start with [`Service`], then `ops/`, one file a noun; [`caller`] asks
//! who may; `session/` holds the actor that owns one robot's pipeline.

pub mod admission;
pub mod caller;
mod clock;
mod compute;
mod error;
mod error_code;
mod flood;
mod health;
mod limits;
pub mod observe;
mod ops;
pub mod reason;
mod session;
pub mod trace;

pub use admission::{Admission, Asker, Quota, Quotas};
pub use caller::{CallContext, Caller, Guarded, OperationStart};
pub use compute::{Alive, ComputePool, ComputeThreads};
pub use error::{Error, Result, check_id};
pub use error_code::ErrorCode;
pub use flood::RateLimitedLog;
pub use health::{HEALTHY, Health, Part, Readiness, Reason, Trouble};
pub use limits::Limits;
pub use ops::changes::{ParamChange, SensorChanges, SessionChanges};
pub use ops::cloud_detail::CloudDetail;
pub use ops::detectors::{DetectorInfo, DetectorOrigin};
pub use ops::evaluation::{self, TrajectoryComparison};
pub use ops::exploration::{self, Explored, FlightQuestion, FrontierRequest};
pub use ops::fleet::{FleetFilter, FleetGroup, FleetWatch};
pub use ops::layers;
pub use ops::map_comparison::{MapBefore, MapComparison};
pub use ops::map_files::{self, MapFile, MapFormat};
pub use ops::map_import::{GivenMap, ImportOptions, ImportedMap};
pub use ops::maps::{self, CloudAnswer, GridAnswer, MapSummary};
pub use ops::navigation::{self, Navigation, PathCheck, PathOptions, Plan, PlanRequest};
pub use ops::operations::{HowFar, NewOperation, Operation, OperationKind, OperationList, OperationState, Progress};
pub use ops::path_picture::{self, Drawing, DrawnPath, PathPicture};
pub use ops::path_watch::{PathChange, PathUpdate, PathWatch};
pub use ops::pictures;
pub use ops::rooms::{self, RoomRoute, RoomWanted, SessionRooms};
pub use ops::scene::{ClassInfo, ObjectQuery};
pub use ops::server::{About, ServerInfo};
pub use ops::session_watch::EventFilter;
pub use ops::sessions::{NewSession, Page, SessionDescription, SessionList, SessionOrder, SessionOrderKey};
pub use ops::toolbox;
pub use ops::transforms::{Moving, TrajectoryRequest, Transform};
pub use ops::zone_masks::{MaskCells, MaskChange, MaskMeaning, SessionMask, SpeedUnit};
pub use ops::zones::Zones;
pub use percept_identity::Pattern;
pub use percept_recorder::RecordingState;
pub use session::annotations::SessionZone;
pub use session::command::{Moved, Pending, Processed, Ticket, Vetoed};
pub use session::event::{Event, EventKind};
pub use session::events::EventLog;
pub use session::fault::Fault;
pub use session::fleet::{FleetEvent, FleetKind, FleetLog};
pub use session::handle::Session;
pub use session::inspect::read_record;
pub use session::listing::SessionView;
pub use session::meta::{DEFAULT_TENANT, OverloadPolicy, SensorDeclaration, SessionMeta, SessionMode};
pub use session::persist::Durable;
pub use session::recording::{RecordingEnd, RecordingInfo, RecordingPhase, RecordingStatus};
pub use session::recordings::{RecordingSettings, StoredRecording};
pub use session::records::{Counts, params_of};
pub use session::sensor_book::{NoPose, Refusal, SensorStatus, StreamNote};
pub use session::shelf::OwnDetectors;
pub use session::state::SessionState;
pub use session::stream_figures::StreamFigures;
pub use session::verdict::{StreamTrouble, Verdict};

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

/// All operations, whoever calls: for the program itself. Cheap to clone; doors hold it [`Guarded`].
#[derive(Clone)]
pub struct Service {
    pub(crate) registry: Arc<Registry>,
    pub(crate) compute: ComputePool,
    pub(crate) faults: Arc<RateLimitedLog>,
    pub(crate) limits: Arc<Limits>,
    pub(crate) kept: Arc<toolbox::KeptClouds>,
    pub(crate) operations: Arc<ops::operations::Operations>,
    pub(crate) health: Health,
    pub(crate) about: Arc<About>,
}

impl Service {
    /// Opens the service over its data: sessions found there sleep until they are used. Of all sessions go the parameters where
    /// their creators send none, and which are recorded.
    ///
    /// # Errors
    /// `INTERNAL`, `UNAVAILABLE` if the catalogue cannot be read.
    pub async fn open(
        data: percept_store::DataRoot,
        compute: ComputePool,
        limits: Limits,
        of_sessions: (percept_pipeline::PipelineParams, RecordingSettings),
        detectors: OwnDetectors,
    ) -> Result<Self> {
        ops::server::started();
        let (limits, health) = (Arc::new(limits), Health::starting());
        let registry =
            session::open::open(data, compute.clone(), Arc::clone(&limits), of_sessions, detectors, health.clone())
                .await?;
        let kept = toolbox::KeptClouds::open(&limits, Arc::clone(compute.admission()));
        let operations = ops::operations::Operations::open(&limits);
        let (faults, about) = (Arc::default(), Arc::default());
        Ok(Self { registry, compute, faults, limits, kept, operations, health, about })
    }

    /// The threads on which doors do what takes computing: decoding, digests, encoding.
    pub fn compute(&self) -> &ComputePool {
        &self.compute
    }

    /// Which of many alike faults are told in the log.
    pub fn faults(&self) -> &Arc<RateLimitedLog> {
        &self.faults
    }

    /// The same, with what the program says of itself.
    #[must_use]
    pub fn described(self, about: About) -> Self {
        Self { about: Arc::new(about), ..self }
    }

    /// Who asks about a session, as its tenant's quotas have it.
    ///
    /// # Errors
    /// `RATE_LIMITED`.
    pub(crate) fn asker(&self, session: &str) -> Result<Asker> {
        let tenant = self.registry.tenant(session).unwrap_or_default();
        self.compute.admission().asker(&tenant, session)
    }

    /// Whether requests are taken; what the service depends on reports to it.
    pub fn health(&self) -> &Health {
        &self.health
    }

    /// The limits in force.
    pub fn limits(&self) -> &Arc<Limits> {
        &self.limits
    }

    /// Puts other quotas of tenants into force.
    pub fn set_quotas(&self, quotas: Quotas) {
        self.compute.admission().set(quotas);
    }

    /// Stops taking frames, finishes and stores what was accepted, ends watches and operations.
    ///
    /// # Errors
    /// The fault of the storage, if something that was accepted could not be stored.
    pub async fn stop(&self) -> Result<()> {
        self.operations.stop();
        self.registry.stop().await
    }
}
