//! What comes of a question for a path.

use crate::costmap::{CellState, Costmap};
use crate::hybrid::DrivingCost;
use crate::steering::Arc;
use crate::{Pose2, SpeedLimits, Waypoint};
use nalgebra::Point2;
use percept_geometry::se3::wrap_angle;

/// A path that the robot can drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    /// From exactly the start to exactly the goal; straight in between, or, by [`Planner::Hybrid`](crate::Planner::Hybrid),
    /// on arcs of constant curvature.
    pub waypoints: Vec<Waypoint>,
    /// Length, metres.
    pub length_m: f64,
    /// Length, with metres near obstacles counted more: what the search kept small.
    pub cost: f64,
    /// Smallest distance of the robot's centre from an obstacle (or from unknown cells, unless allowed) along the way,
    /// metres, exact; none if the map has no obstacle.
    pub min_clearance_m: Option<f64>,
    /// Cells, or poses, that the search expanded.
    pub expansions: usize,
    /// What the cost is made of.
    pub cost_parts: CostParts,
    /// How long it takes from rest to rest, seconds.
    pub duration_s: f64,
    /// By [`Planner::Hybrid`](crate::Planner::Hybrid), before shortcuts: its cost over the least estimate that was left open,
    /// at least 1. The least possible cost is hardly less than `cost` over this. By
    /// [`Planner::Grid`](crate::Planner::Grid) that may be stopped, by [`Planner::AnyAngle`](crate::Planner::AnyAngle) that was
    /// stopped, and by [`plan_anytime`](crate::plan_anytime): what its cost over cells, before it is smoothed, is at most in times
    /// the least.
    pub bound: Option<f64>,
    /// Whether the search went on until it was done; false if the caller or `max_expansions` ended it, with this as the best
    /// so far.
    pub is_final: bool,
}

/// The terms of a path's cost, metres.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CostParts {
    /// Its length.
    pub length: f64,
    /// Extra near obstacles and in speed zones.
    pub clearance: f64,
    /// Extra for turning, for driving backwards, and for changes of direction.
    pub steering: f64,
}

/// Why there is no path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoPathReason {
    /// The start is beyond what the map covers.
    StartOutsideMap,
    /// The start is in an obstacle.
    StartOccupied,
    /// The start is free, and the robot does not fit there, or so near to obstacles that it cannot get free.
    StartDoesNotFit,
    /// The start is in a keep-out zone.
    StartInKeepOut,
    /// The start is in unknown space, and so is all within `start_tolerance_m`.
    StartUnknown,
    /// The goal is beyond what the map covers.
    GoalOutsideMap,
    /// The goal is in an obstacle.
    GoalOccupied,
    /// The goal is in unknown space, and that is not allowed.
    GoalUnknown,
    /// The goal is free, and the robot does not fit there, or not on the centre of its cell.
    GoalDoesNotFit,
    /// The goal is in a keep-out zone.
    GoalInKeepOut,
    /// Start and goal are free, and no way of the robot's width joins them.
    Unreachable,
    /// A way over cells joins them that is wide enough for the disc within the footprint, and none that can be steered with
    /// this footprint and turning radius.
    NotSteerable,
    /// The search ended at `max_expansions`: there may be a path.
    SearchLimit,
    /// The caller ended the search: there may be a path.
    Stopped,
}

/// What stands in the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blocking {
    /// Where the robot does not fit, map frame, metres: its base there would be in what blocks it or too near.
    pub position: Point2<f64>,
    /// Centre of the cell that blocks it.
    pub obstacle: Point2<f64>,
    /// What is there: never free.
    pub state: CellState,
}

/// The answer to a question for a path.
#[derive(Debug, Clone, PartialEq)]
pub enum PlanOutcome {
    /// There it is.
    Path(Path),
    /// There is none.
    NoPath {
        /// Why.
        reason: NoPathReason,
        /// Of an end where the robot does not fit: what is too near. Of `Unreachable`: the first place that blocks the way
        /// which crosses least of such places.
        blocking: Option<Blocking>,
    },
}

impl Path {
    /// Along straight legs.
    pub(crate) fn of_legs(
        costmap: &Costmap,
        mut points: Vec<Point2<f64>>,
        speed: &SpeedLimits,
        expansions: usize,
    ) -> Self {
        let (first, last) = (points[0], points[points.len() - 1]);
        points.dedup_by(|b, a| a == b);
        if points.len() == 1 {
            points = vec![first, last];
        }
        let mut nearest = f64::INFINITY;
        let (mut length, mut cost) = (0.0, 0.0);
        let mut waypoints: Vec<Waypoint> = Vec::with_capacity(points.len());
        for leg in points.windows(2) {
            let along = leg[1] - leg[0];
            length += along.norm();
            cost += costmap.segment_cost(&leg[0], &leg[1]);
            nearest = costmap.segment_clearance(&leg[0], &leg[1], nearest);
            let yaw_rad = wrap_angle(along.y.atan2(along.x));
            waypoints.push(Waypoint::at(costmap, &Pose2 { position: leg[0], yaw_rad }, false));
        }
        let yaw_rad = waypoints.last().map_or(0.0, |w| w.yaw_rad);
        waypoints.push(Waypoint::at(costmap, &Pose2 { position: last, yaw_rad }, false));
        let min_clearance_m = nearest.is_finite().then_some(nearest);
        let cost_parts = CostParts { length, clearance: cost - length, steering: 0.0 };
        let path =
            Self { waypoints, length_m: length, cost, min_clearance_m, expansions, ..Self::timeless(cost_parts) };
        path.timed(costmap, speed)
    }

    /// Along arcs, from a pose to a position.
    pub(crate) fn of_arcs(
        cost: &DrivingCost<'_>,
        (start, goal): (&Pose2, Point2<f64>),
        arcs: &[(Pose2, Arc)],
        spacing: f64,
        speed: &SpeedLimits,
    ) -> Self {
        let costmap = cost.costmap;
        let mut waypoints = Vec::new();
        let mut nearest = f64::INFINITY;
        let mut last = *start;
        for (from, arc) in arcs {
            let pieces = (arc.length.abs() / spacing).ceil().max(1.0);
            let along = |i: f64| arc.after(from, arc.length * (i / pieces));
            let waypoint = |i: usize| Waypoint::at(costmap, &along(i as f64), arc.length < 0.0);
            waypoints.extend((0..pieces as usize).map(waypoint));
            // Chords of half a cell are as good as the arc.
            let chords = (2.0 * arc.length.abs() / costmap.geometry().resolution_m).ceil().max(1.0);
            let along = |i: f64| arc.after(from, arc.length * (i / chords)).position;
            for i in 0..chords as usize {
                nearest = costmap.segment_clearance(&along(i as f64), &along(i as f64 + 1.0), nearest);
            }
            last = arc.after(from, arc.length);
        }
        let is_reverse = waypoints.last().is_some_and(|w| w.is_reverse);
        if arcs.is_empty() {
            nearest = costmap.segment_clearance(&goal, &goal, nearest);
            waypoints.push(Waypoint::at(costmap, start, false));
        }
        waypoints.push(Waypoint { position: goal, ..Waypoint::at(costmap, &last, is_reverse) });
        let length_m = arcs.iter().map(|(_, arc)| arc.length.abs()).sum();
        let weighted: f64 = arcs.iter().map(|(from, arc)| cost.weighted_length(from, arc)).sum();
        let all = cost.of_arcs(arcs, None);
        let cost_parts = CostParts { length: length_m, clearance: weighted - length_m, steering: all - weighted };
        let min_clearance_m = nearest.is_finite().then_some(nearest);
        let path = Self { waypoints, length_m, cost: all, min_clearance_m, ..Self::timeless(cost_parts) };
        path.timed(costmap, speed)
    }

    fn timeless(cost_parts: CostParts) -> Self {
        Self {
            waypoints: vec![],
            length_m: 0.0,
            cost: 0.0,
            min_clearance_m: None,
            expansions: 0,
            cost_parts,
            duration_s: 0.0,
            bound: None,
            is_final: true,
        }
    }

    fn timed(mut self, costmap: &Costmap, speed: &SpeedLimits) -> Self {
        let times = speed.times(costmap, &self.waypoints);
        self.duration_s = times.last().copied().unwrap_or_default();
        self.waypoints.iter_mut().zip(times).for_each(|(waypoint, time_s)| waypoint.time_s = time_s);
        self
    }
}
