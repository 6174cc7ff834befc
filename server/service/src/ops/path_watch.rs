//! A path that is kept: told anew when the map breaks it, or a clearly better one opens.

use super::navigation::{misfit_on, plan};
use crate::{PathCheck, PathOptions, Plan, PlanRequest, Result, Service, Zones};
use nalgebra::Point2;
use percept_geometry::Timestamp;
use percept_pipeline::Snapshot;
use percept_planning::{PlanOutcome, Pose2};

/// A way is looked for that is better than what was told once a second of the session's time.
const LOOKED_FOR_EVERY_NS: i64 = 1_000_000_000;
/// What the newest frames see is looked at so often, session's time: a robot at 1 m/s goes 0.25 m meanwhile.
const SEEN_EVERY_NS: i64 = 250_000_000;
/// One that costs less than this share of what is left is clearly better: what a path costs changes by some percent with each frame, and
/// a robot that is sent to and fro arrives nowhere.
const BETTER: f64 = 0.8;

/// Why something is told.
#[derive(Debug, Clone)]
pub enum PathChange {
    /// It is the first answer.
    First,
    /// What was told cannot be driven any more.
    Blocked(PathCheck),
    /// Another way costs clearly less than what is left of the path that was told.
    Better,
    /// There was no path, and there is one now.
    Opened,
    /// There is still none, for another reason.
    OtherReason,
}

/// What is told.
#[derive(Debug, Clone)]
pub struct PathUpdate {
    /// Why.
    pub change: PathChange,
    /// The path, or why there is none.
    pub plan: Plan,
}

/// A question for a path that goes on.
#[derive(Debug, Clone)]
pub struct PathWatch {
    request: PlanRequest,
    told: Option<Plan>,
    /// The session's, when it was looked at last.
    zones: Zones,
    /// Version of the map that was looked at last, and when a way was looked for.
    looked_at: Option<u64>,
    looked_for: Timestamp,
    /// Stamp of the newest frame that was looked at.
    seen: Timestamp,
}

impl PathWatch {
    /// From where the robot is, each time; a start that is given counts for the first answer only.
    pub fn new(request: PlanRequest) -> Self {
        Self {
            request,
            told: None,
            zones: Zones::default(),
            looked_at: None,
            looked_for: Timestamp(0),
            seen: Timestamp(0),
        }
    }

    /// Whether there is nothing new to look at.
    fn is_up_to_date(&self, snapshot: &Snapshot, zones: &Zones) -> bool {
        self.is_of(snapshot, zones) && !self.is_due(snapshot) && !self.sees_anew(snapshot)
    }

    /// Whether map and zones are those that were looked at last.
    fn is_of(&self, snapshot: &Snapshot, zones: &Zones) -> bool {
        self.looked_at == Some(snapshot.map_version) && self.zones == *zones
    }

    /// Whether the newest frames may have seen who has stepped into the way.
    fn sees_anew(&self, snapshot: &Snapshot) -> bool {
        let seen = snapshot.live.stamp().filter(|_| !self.request.options.is_map_only);
        seen.is_some_and(|seen| seen.0.saturating_sub(self.seen.0) >= SEEN_EVERY_NS)
    }

    /// Whether a better way is to be looked for.
    fn is_due(&self, snapshot: &Snapshot) -> bool {
        stamp(snapshot).0.saturating_sub(self.looked_for.0) >= LOOKED_FOR_EVERY_NS
    }

    /// Looks at the path as the map and the zones of the session are now; none if there is nothing to tell.
    ///
    /// # Errors
    /// As for planning.
    pub fn look(&mut self, snapshot: &Snapshot, zones: Zones, max_cells: usize) -> Result<Option<PathUpdate>> {
        let Some(told) = &self.told else {
            self.zones = zones;
            return self.tell(PathChange::First, snapshot, max_cells).map(Some);
        };
        if self.is_up_to_date(snapshot, &zones) {
            return Ok(None);
        }
        let (is_news, due) = (!self.is_of(snapshot, &zones), self.is_due(snapshot));
        let is_zoned_anew = self.zones != zones;
        (self.zones, self.looked_at) = (zones, Some(snapshot.map_version));
        self.seen = snapshot.live.stamp().unwrap_or(self.seen);
        let Some(PlanOutcome::Path(path)) = &told.outcome else {
            if !is_news && !due {
                return Ok(None);
            }
            let reason = reason_of(told);
            let plan = self.planned(snapshot, max_cells)?;
            let change = match &plan.outcome {
                Some(PlanOutcome::Path(_)) => PathChange::Opened,
                _ if reason_of(&plan) != reason => PathChange::OtherReason,
                _ => return Ok(None),
            };
            return Ok(Some(self.told(change, plan)));
        };
        let tolerance = self.request.params.unwrap_or(snapshot.params.planning).start_tolerance_m;
        // Where zones have changed, what is near the robot counts as well: one may lie around it.
        let tolerance = if is_zoned_anew { 0.0 } else { tolerance };
        let left = left_of(&path.waypoints, robot(snapshot), tolerance);
        let check = misfit_on(snapshot, &left, self.request.params, &self.options(), max_cells)?;
        if check.misfit.is_some() {
            return self.tell(PathChange::Blocked(check), snapshot, max_cells).map(Some);
        }
        if !due {
            return Ok(None);
        }
        // As the path costs per metre on the whole.
        let cost = path.cost * length_of(&left) / path.length_m.max(f64::MIN_POSITIVE);
        let plan = self.planned(snapshot, max_cells)?;
        let is_better = matches!(&plan.outcome, Some(PlanOutcome::Path(other)) if other.cost < BETTER * cost);
        Ok(is_better.then(|| self.told(PathChange::Better, plan)))
    }

    fn tell(&mut self, change: PathChange, snapshot: &Snapshot, max_cells: usize) -> Result<PathUpdate> {
        let plan = self.planned(snapshot, max_cells)?;
        Ok(self.told(change, plan))
    }

    fn planned(&mut self, snapshot: &Snapshot, max_cells: usize) -> Result<Plan> {
        (self.looked_at, self.looked_for) = (Some(snapshot.map_version), stamp(snapshot));
        let options = self.options();
        plan(snapshot, &PlanRequest { options, ..self.request.clone() }, max_cells)
    }

    fn options(&self) -> PathOptions {
        self.request.options.clone().in_zones(&self.zones)
    }

    fn told(&mut self, change: PathChange, plan: Plan) -> PathUpdate {
        self.request.start = None;
        self.told = Some(plan.clone());
        PathUpdate { change, plan }
    }
}

fn stamp(snapshot: &Snapshot) -> Timestamp {
    super::maps::stamp_of(snapshot)
}

fn reason_of(plan: &Plan) -> Option<percept_planning::NoPathReason> {
    match &plan.outcome {
        Some(PlanOutcome::NoPath { reason, .. }) => Some(*reason),
        _ => None,
    }
}

fn robot(snapshot: &Snapshot) -> Option<Point2<f64>> {
    snapshot.pose.as_ref().map(|p| p.t_map_base.translation.vector.xy().into())
}

/// What is left of a path: the waypoints after the one that is nearest to the robot, but for those within `tolerance` (m) of it: there
/// planning allows the robot to be nearer to obstacles.
fn left_of(waypoints: &[percept_planning::Waypoint], robot: Option<Point2<f64>>, tolerance: f64) -> Vec<Pose2> {
    let pose = |w: &percept_planning::Waypoint| Pose2 { position: w.position, yaw_rad: w.yaw_rad };
    let Some(robot) = robot else { return waypoints.iter().map(pose).collect() };
    let away = |w: &percept_planning::Waypoint| (w.position - robot).norm();
    let nearest = (0..waypoints.len()).min_by(|a, b| away(&waypoints[*a]).total_cmp(&away(&waypoints[*b])));
    let from = nearest.unwrap_or_default();
    waypoints[from..].iter().skip_while(|w| away(w) <= tolerance).map(pose).collect()
}

fn length_of(poses: &[Pose2]) -> f64 {
    poses.windows(2).map(|pair| (pair[1].position - pair[0].position).norm()).sum()
}

impl Service {
    /// Looks at a watched path, on the pool, as the map is now: the watch, and what is to be told if anything is.
    ///
    /// # Errors
    /// As for planning; `SESSION_NOT_FOUND`.
    pub async fn look_at_path(&self, session: &str, mut watch: PathWatch) -> Result<(PathWatch, Option<PathUpdate>)> {
        let (snapshot, zones) = self.snapshot_with_zones(session).await?;
        if watch.told.is_some() && watch.is_up_to_date(&snapshot, &zones) {
            return Ok((watch, None));
        }
        let max_cells = self.limits.max_planning_cells;
        let work = move || watch.look(&snapshot, zones, max_cells).map(|update| (watch, update));
        self.compute.query(&self.asker(session)?, work).await?
    }
}
