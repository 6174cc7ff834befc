//! Paths, in the name of a caller.

use super::Caller;
use crate::{
    Drawing, Explored, FlightQuestion, FrontierRequest, IncomingFrame, Navigation, PathCheck, PathOptions, PathPicture,
    PathUpdate, PathWatch, Plan, PlanRequest, Result,
};
use percept_planning::flight::FlightOutcome;
use percept_planning::{CoverageOutcome, CoverageParams, Frontier, PlanParams, Pose2};

impl Caller {
    /// A path through a session's map.
    ///
    /// # Errors
    /// Coordinates or parameters out of bounds, `GRID_TOO_LARGE`, `SESSION_NOT_FOUND`.
    pub async fn plan_path(&self, session: &str, request: PlanRequest) -> Result<Plan> {
        self.may_with("NavigationService/PlanPath", session).await?;
        self.service.plan_path(session, request).await
    }

    /// A path through a session's map as a picture.
    ///
    /// # Errors
    /// As for planning; `TOO_MANY_QUERIES`, `PICTURE_TOO_LARGE`.
    pub async fn draw_path(&self, session: &str, drawing: Drawing) -> Result<PathPicture> {
        self.may_with("NavigationService/DrawPath", session).await?;
        self.service.draw_path(session, drawing).await
    }

    /// A sensor message and a goal in; pose, obstacles and path out.
    ///
    /// # Errors
    /// As [`send_frame`](Self::send_frame) and [`plan_path`](Self::plan_path).
    pub async fn navigate(&self, incoming: IncomingFrame, request: PlanRequest) -> Result<Navigation> {
        self.may_with("NavigationService/Navigate", &incoming.session).await?;
        self.service.navigate(incoming, request).await
    }

    /// The first place of a path that the robot cannot drive, as the map is now.
    ///
    /// # Errors
    /// As for planning; `TOO_MANY_QUERIES`.
    pub async fn validate_path(
        &self,
        session: &str,
        poses: Vec<Pose2>,
        params: Option<PlanParams>,
        options: PathOptions,
    ) -> Result<PathCheck> {
        self.may_with("NavigationService/ValidatePath", session).await?;
        self.service.validate_path(session, poses, params, options).await
    }

    /// A path that covers what the robot reaches.
    ///
    /// # Errors
    /// As for planning.
    pub async fn plan_coverage(
        &self,
        session: &str,
        request: PlanRequest,
        coverage: CoverageParams,
    ) -> Result<Explored<CoverageOutcome>> {
        self.may_with("NavigationService/PlanCoverage", session).await?;
        self.service.plan_coverage(session, request, coverage).await
    }

    /// Edges of what is known that the robot reaches.
    ///
    /// # Errors
    /// As for planning.
    pub async fn find_frontiers(&self, session: &str, request: FrontierRequest) -> Result<Explored<Vec<Frontier>>> {
        self.may_with("NavigationService/FindFrontiers", session).await?;
        self.service.find_frontiers(session, request).await
    }

    /// A path in space through the voxels of the map.
    ///
    /// # Errors
    /// `LAYER_OFF`, `MAP_EMPTY`, `GRID_TOO_LARGE`, coordinates or parameters out of bounds, `SESSION_NOT_FOUND`.
    pub async fn plan_flight(&self, session: &str, question: FlightQuestion) -> Result<Explored<FlightOutcome>> {
        self.may_with("NavigationService/PlanFlight", session).await?;
        self.service.plan_flight(session, question).await
    }

    /// Looks at a watched path as the map is now.
    ///
    /// # Errors
    /// As for planning.
    pub async fn look_at_path(&self, session: &str, watch: PathWatch) -> Result<(PathWatch, Option<PathUpdate>)> {
        self.may_with("NavigationService/WatchPath", session).await?;
        self.service.look_at_path(session, watch).await
    }
}
