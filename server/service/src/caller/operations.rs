//! Each operation: asked for, then done. In the order of the nouns.

use super::Caller;
use super::audit::Act;
use crate::ops::toolbox::{SessionCloud, Toolbox};
use crate::{
    CloudAnswer, CloudDetail, Error, EventLog, FleetFilter, FleetWatch, GridAnswer, IncomingFrame, MapFile, MapFormat,
    MapSummary, Moved, NewSession, Page, Pending, Processed, Result, SensorChanges, SensorDeclaration, SensorStatus,
    Session, SessionChanges, SessionDescription, SessionList, SessionView, TrajectoryComparison, TrajectoryRequest,
    Transform, Vetoed, check_id,
};
use nalgebra::{Point2, Point3};
use percept_evaluation::{
    DetectionScore, FoundObject, PosePair, RelationScore, TrajectoryScore, TrueObject, TrueRelation,
};
use percept_geometry::{Pose, SensorId, Stamped, Timestamp};
use percept_pipeline::{KeyframeInfo, Loop, LoopId, PipelineParams, PoseAt, PoseEstimate, Snapshot, TrajectoryEntry};
use std::sync::Arc;
use std::time::Duration;

/// How often it is asked whether a session that is watched is another server's by now.
const MOVES_ASKED: Duration = Duration::from_secs(5);

/// Sessions.
impl Caller {
    /// The parameters that a session gets where it sets none.
    ///
    /// # Errors
    /// `PERMISSION_DENIED`.
    pub fn default_params(&self) -> Result<&PipelineParams> {
        self.may("SessionsService/GetDefaultParams")?;
        Ok(self.service.default_params())
    }

    /// The same, for a request that does more than to ask for them, and is asked about itself.
    pub fn params_to_fill(&self) -> &PipelineParams {
        self.service.default_params()
    }

    /// Creates a session of the caller's tenant, durably; its id.
    ///
    /// # Errors
    /// Bad ids or parameters, `SESSION_EXISTS`, limits.
    pub async fn create_session(&self, mut new: NewSession) -> Result<String> {
        const NAME: &str = "SessionsService/CreateSession";
        let is_named = new.id.is_some();
        let id = new.id.take().unwrap_or_else(crate::ops::sessions::fresh_id);
        check_id("session_id", &id)?;
        self.anew(NAME, &id).map_err(|e| if is_named { e } else { self.unnamed(e) })?;
        new.id = Some(id.clone());
        let act = Act::begin(&self.context, NAME, &id);
        let created = self.service.create_session(&self.context.principal.tenant, new).await;
        act.end(&created);
        let created = created?;
        // A request that is sent again gives the session of its first time, which may have another id.
        if created != id {
            self.may_with(NAME, &created).await?;
        }
        Ok(created)
    }

    /// A session to read for an operation of the table, woken if it slept.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn session(&self, operation: &'static str, id: &str) -> Result<Arc<Session>> {
        self.may_with(operation, id).await?;
        self.service.session(id).await
    }

    /// Everything that can be said of a session without waking it, for an operation of the table.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`; faults of the storage.
    pub async fn describe_session(&self, operation: &'static str, id: &str) -> Result<SessionDescription> {
        self.may_with(operation, id).await?;
        self.service.describe_session(id).await
    }

    /// Events of a session, awake or not, for an operation of the table.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`; `SESSION_ELSEWHERE`: they are told where it is.
    pub async fn session_events(&self, operation: &'static str, id: &str) -> Result<Arc<EventLog>> {
        self.may_with(operation, id).await?;
        match self.service.registry.elsewhere(id).await {
            Some(elsewhere) => Err(elsewhere),
            None => self.service.session_events(id).await,
        }
    }

    /// Comes when another server has taken a session, of which nothing is told here from then on.
    pub async fn moved(&self, id: &str) -> Error {
        loop {
            tokio::time::sleep(MOVES_ASKED).await;
            if let Some(elsewhere) = self.service.registry.elsewhere(id).await {
                return elsewhere;
            }
        }
    }

    /// Sessions that fit `list`, of those that the caller may read.
    ///
    /// # Errors
    /// `PERMISSION_DENIED`, `PAGE_TOKEN_INVALID`.
    pub async fn list_sessions(&self, list: &SessionList) -> Result<Page<SessionView>> {
        self.may("SessionsService/ListSessions")?;
        let principal = &self.context.principal;
        self.service.list_sessions(list, |view| crate::ops::fleet::may_see(principal, view)).await
    }

    /// Events of all sessions that the caller may read.
    ///
    /// # Errors
    /// `PERMISSION_DENIED`.
    pub fn watch_sessions(&self, filter: FleetFilter) -> Result<FleetWatch> {
        self.may("SessionsService/WatchSessions")?;
        Ok(FleetWatch::new(&self.service.registry.fleet, &self.context, filter))
    }

    /// Where the robot was at a time, and the version of the map that this refers to.
    ///
    /// # Errors
    /// As [`crate::Service::pose_at`].
    pub async fn pose_at(&self, session: &str, at: Timestamp) -> Result<(PoseAt, u64)> {
        self.may_with("SessionsService/GetPose", session).await?;
        self.service.pose_at(session, at).await
    }

    /// Says where the robot is, base to map; where it is by what it sees there, and whether there was anything to compare that with.
    ///
    /// # Errors
    /// As [`crate::Service::set_pose`].
    pub async fn set_pose(&self, session: &str, t_map_base: Pose) -> Result<(PoseEstimate, bool)> {
        const NAME: &str = "SessionsService/SetPose";
        self.may_with(NAME, session).await?;
        let act = Act::begin(&self.context, NAME, session);
        let done = self.service.set_pose(session, t_map_base).await;
        act.end(&done);
        done
    }

    /// Where `source` is, seen from `target`, now or at a time.
    ///
    /// # Errors
    /// As [`crate::Service::lookup_transform`].
    pub async fn lookup_transform(
        &self,
        session: &str,
        target: &str,
        source: &str,
        at: Option<Timestamp>,
    ) -> Result<Transform> {
        self.may_with("SessionsService/LookupTransform", session).await?;
        self.service.lookup_transform(session, target, source, at).await
    }

    /// A part of the trajectory, corrected, in order of time: base to map, frame; and the version of the map.
    ///
    /// # Errors
    /// As [`crate::Service::trajectory`].
    pub async fn trajectory(
        &self,
        session: &str,
        request: TrajectoryRequest,
    ) -> Result<(Page<(Pose, TrajectoryEntry)>, u64)> {
        self.may_with("SessionsService/GetTrajectory", session).await?;
        self.service.trajectory(session, request).await
    }

    /// Changes what callers set of a session, durably.
    ///
    /// # Errors
    /// As [`crate::Service::update_session`].
    pub async fn update_session(&self, id: &str, etag: &str, changes: &SessionChanges) -> Result<SessionDescription> {
        const NAME: &str = "SessionsService/UpdateSession";
        self.may_with(NAME, id).await?;
        let act = Act::begin(&self.context, NAME, id);
        let changed = self.service.update_session(id, etag, changes).await;
        act.end(&changed);
        changed
    }

    /// Keyframes that the map is made of, by number.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `PAGE_TOKEN_INVALID`.
    pub async fn list_keyframes(&self, session: &str, page_size: u32, page_token: &str) -> Result<Page<KeyframeInfo>> {
        self.may_with("SessionsService/ListKeyframes", session).await?;
        self.service.list_keyframes(session, page_size, page_token).await
    }

    /// Deletes a session with all that is stored for it.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, faults of the storage.
    pub async fn delete_session(&self, id: &str) -> Result<()> {
        const NAME: &str = "SessionsService/DeleteSession";
        self.may_with(NAME, id).await?;
        let act = Act::begin(&self.context, NAME, id);
        let deleted = self.service.delete_session(id).await;
        act.end(&deleted);
        deleted
    }

    /// The newest snapshot of a session, for an operation of the table.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn snapshot(&self, operation: &'static str, session: &str) -> Result<Arc<Snapshot>> {
        self.may_with(operation, session).await?;
        self.service.snapshot(session).await
    }
}

/// Sensors.
impl Caller {
    /// Declares a sensor of a session, durably.
    ///
    /// # Errors
    /// `SENSOR_IN_USE`, `TOO_MANY_SENSORS`, `SESSION_NOT_FOUND`.
    pub async fn declare_sensor(&self, session: &str, declaration: SensorDeclaration) -> Result<SensorStatus> {
        const NAME: &str = "SensorsService/DeclareSensor";
        self.may_with(NAME, session).await?;
        let act = Act::begin(&self.context, NAME, session);
        let declared = self.service.declare_sensor(session, declaration).await;
        act.end(&declared);
        declared
    }

    /// Changes the declaration of a sensor, durably.
    ///
    /// # Errors
    /// As [`crate::Service::update_sensor`].
    pub async fn update_sensor(
        &self,
        session: &str,
        sensor: &SensorId,
        etag: &str,
        changes: &SensorChanges,
    ) -> Result<SensorStatus> {
        const NAME: &str = "SensorsService/UpdateSensor";
        self.may_with(NAME, session).await?;
        let act = Act::begin(&self.context, NAME, session);
        let changed = self.service.update_sensor(session, sensor, etag, changes).await;
        act.end(&changed);
        changed
    }

    /// Health of one sensor of a session, without waking it.
    ///
    /// # Errors
    /// `SENSOR_NOT_FOUND`, `SESSION_NOT_FOUND`; faults of the storage.
    pub async fn sensor(&self, session: &str, sensor: &SensorId) -> Result<SensorStatus> {
        self.may_with("SensorsService/GetSensor", session).await?;
        self.service.sensor(session, sensor).await
    }

    /// Takes one frame and answers when it was processed and is durable.
    ///
    /// # Errors
    /// What is wrong with the frame; limits; faults of the storage.
    pub async fn send_frame(&self, incoming: IncomingFrame) -> Result<(Arc<Session>, Processed)> {
        self.may_with("SensorsService/SendFrame", &incoming.session).await?;
        self.service.send_frame(incoming).await
    }

    /// Takes one frame of a stream; waits for room in the session's queue. The answer comes through what is returned.
    ///
    /// # Errors
    /// As [`Session::submit`]; `SESSION_NOT_FOUND`.
    pub async fn submit(&self, incoming: IncomingFrame) -> Result<(Arc<Session>, Pending)> {
        self.may_with("SensorsService/StreamFrames", &incoming.session).await?;
        self.service.submit_frame(incoming).await
    }

    /// Takes a frame from a door that cannot answer.
    ///
    /// # Errors
    /// Why it was not taken.
    pub async fn offer_frame(&self, incoming: IncomingFrame) -> Result<()> {
        self.may_with("SensorsService/StreamFrames", &incoming.session).await?;
        self.service.offer_frame(incoming).await
    }

    /// Counts a frame that a door refused, if the caller may send to that session.
    pub async fn rejected(&self, session: &str, sensor: &SensorId, because: &Error) {
        if self.may_with("SensorsService/StreamFrames", session).await.is_ok() {
            self.service.count_rejected(session, sensor, because).await;
        }
    }

    /// Notes what a door has to say of a stream, if the caller may send to that session; none if there is nothing any more.
    pub async fn note_stream(&self, session: &str, stream: &str, message: Option<String>) {
        if self.may_with("SensorsService/StreamFrames", session).await.is_ok() {
            self.service.note_stream(session, stream, message).await;
        }
    }

    /// Notes that the driver of a sensor has gone, or is there again, if the caller may send to that session.
    pub async fn note_driver(&self, session: &str, sensor: &SensorId, message: Option<String>) {
        if self.may_with("SensorsService/StreamFrames", session).await.is_ok() {
            self.service.note_driver(session, sensor, message).await;
        }
    }

    /// Health of every sensor of a session, without waking it.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`; faults of the storage.
    pub async fn list_sensors(&self, session: &str) -> Result<Vec<SensorStatus>> {
        self.may_with("SensorsService/ListSensors", session).await?;
        self.service.list_sensors(session).await
    }

    /// The server's clock, nanoseconds since the Unix epoch.
    ///
    /// # Errors
    /// `PERMISSION_DENIED`.
    pub fn clock_ns(&self) -> Result<i64> {
        self.may("SensorsService/SyncTime")?;
        Ok(self.service.clock_ns())
    }

    /// What runs here.
    ///
    /// # Errors
    /// `PERMISSION_DENIED`.
    pub fn server_info(&self) -> Result<crate::ServerInfo> {
        self.may("ServerService/GetServerInfo")?;
        Ok(self.service.server_info())
    }
}

/// Maps.
impl Caller {
    /// Sizes and version of a session's map.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn map_summary(&self, session: &str) -> Result<MapSummary> {
        self.may_with("MapsService/GetMapSummary", session).await?;
        self.service.map_summary(session).await
    }

    /// A part of the occupancy grid; `live`: with what the newest frames see laid over it.
    ///
    /// # Errors
    /// As [`crate::maps::dense`]; `SESSION_NOT_FOUND`.
    pub async fn occupancy_grid(
        &self,
        session: &str,
        region: Option<(Point2<f64>, Point2<f64>)>,
        resolution_m: Option<f64>,
        live: bool,
    ) -> Result<GridAnswer> {
        self.may_with("MapsService/GetOccupancyGrid", session).await?;
        self.service.occupancy_grid(session, region, resolution_m, live).await
    }

    /// The fused cloud, or the part of it around a point (m, map frame; radius m), so finely.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `OUT_OF_RANGE`.
    pub async fn cloud(
        &self,
        session: &str,
        around: Option<(Point3<f64>, f64)>,
        detail: CloudDetail,
    ) -> Result<CloudAnswer> {
        self.may_with("MapsService/GetCloud", session).await?;
        self.service.cloud(session, around, detail).await
    }

    /// Loops by number, those not believed included, and the version of the map that they belong to.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `PAGE_TOKEN_INVALID`.
    pub async fn list_loops(&self, session: &str, page_size: u32, page_token: &str) -> Result<(Page<Loop>, u64)> {
        self.may_with("MapsService/ListLoops", session).await?;
        self.service.list_loops(session, page_size, page_token).await
    }

    /// Takes a loop out of the map, or undoes that; the map follows at once, and it is durable when this answers.
    ///
    /// # Errors
    /// `LOOP_NOT_FOUND`, `SESSION_NOT_FOUND`, `STORAGE_FAULT`.
    pub async fn set_loop_veto(&self, session: &str, id: LoopId, vetoed: bool) -> Result<Vetoed> {
        const NAME: &str = "MapsService/SetLoopVeto";
        self.may_with(NAME, session).await?;
        let act = Act::begin(&self.context, NAME, session);
        let done = self.service.set_loop_veto(session, id, vetoed).await;
        act.end(&done);
        done
    }

    /// Makes the small corrections that wait for more; they are durable when this answers.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `STORAGE_FAULT`.
    pub async fn optimise_map(&self, session: &str) -> Result<Moved> {
        self.may_with("MapsService/OptimiseMap", session).await?;
        self.service.optimise_map(session).await
    }

    /// The map as a file.
    ///
    /// # Errors
    /// `MAP_EMPTY` if nothing was mapped, `GRID_TOO_LARGE`, `SESSION_NOT_FOUND`.
    pub async fn export_map(&self, session: &str, format: MapFormat) -> Result<MapFile> {
        self.may_with("MapsService/ExportMap", session).await?;
        self.service.export_map(session, format).await
    }
}

/// Toolbox and evaluation.
impl Caller {
    /// Runs a toolbox request's work on the pool, for an operation of the table: with the caller's own kept clouds, and
    /// those of sessions that it asks for.
    ///
    /// # Errors
    /// Those of the work; `COMPUTATION_TOO_LONG`; those of [`cloud`](Self::cloud), and `CLOUD_TOO_LARGE`.
    pub async fn toolbox<T: Send + 'static>(
        &self,
        operation: &'static str,
        wanted: Vec<SessionCloud>,
        work: impl FnOnce(&Toolbox) -> Result<T> + Send + 'static,
    ) -> Result<T> {
        self.may(operation)?;
        self.may_use(&wanted).await?;
        let maps = self.service.session_clouds(wanted).await?;
        self.service.toolbox(self.owner(), maps, work).await
    }

    /// Whether these clouds of sessions may be had.
    pub(super) async fn may_use(&self, wanted: &[SessionCloud]) -> Result<()> {
        for wanted in wanted {
            self.may_with("MapsService/GetCloud", &wanted.session).await.map_err(|e| e.within(&wanted.field))?;
        }
        Ok(())
    }

    /// ATE and RPE as evo computes them, drift as KITTI does; the compared poses if they are wanted.
    ///
    /// # Errors
    /// `EVALUATION_INVALID`.
    pub async fn evaluate_trajectory(
        &self,
        comparison: TrajectoryComparison,
    ) -> Result<(TrajectoryScore, Vec<PosePair>)> {
        self.may("EvaluationService/*")?;
        self.service.evaluate_trajectory(&self.owner(), comparison).await
    }

    /// A trajectory (ascending stamps) judged by checked motions.
    ///
    /// # Errors
    /// `EVALUATION_INVALID`.
    pub async fn evaluate_relations(
        &self,
        trajectory: Vec<Stamped<Pose>>,
        relations: Vec<TrueRelation>,
        max_gap_s: Option<f64>,
    ) -> Result<RelationScore> {
        self.may("EvaluationService/*")?;
        self.service.evaluate_relations(&self.owner(), trajectory, relations, max_gap_s).await
    }

    /// Precision and recall of boxes; a pair matches at `min_iou` (0.25 if none).
    ///
    /// # Errors
    /// `EVALUATION_INVALID` for a threshold outside (0, 1].
    pub async fn evaluate_detections(
        &self,
        truth: Vec<TrueObject>,
        found: Vec<FoundObject>,
        min_iou: Option<f64>,
    ) -> Result<DetectionScore> {
        self.may("EvaluationService/*")?;
        self.service.evaluate_detections(&self.owner(), truth, found, min_iou).await
    }
}
