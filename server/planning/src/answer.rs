//! What comes of a question for a path.

use crate::Costmap;
use crate::Pose2;
use crate::hybrid::DrivingCost;
use crate::steering::Arc;
use nalgebra::Point2;
use percept_geometry::se3::wrap_angle;

/// A point of a path and the heading towards the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Waypoint {
    /// Map frame, metres.
    pub position: Point2<f64>,
    /// Direction in which the robot looks, (-pi, pi]. On paths of straight legs it is that to the next waypoint; the last
    /// keeps that of the one before, 0 if the path has no length.
    pub yaw_rad: f64,
    /// Whether the robot drives backwards from here to the next waypoint; the last keeps that of the one before.
    pub is_reverse: bool,
}

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
}

/// Why there is no path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoPathReason {
    /// The start is beyond what the map covers.
    StartOutsideMap,
    /// The start is in an obstacle, or so near to some that the robot cannot get free.
    StartOccupied,
    /// The start is in unknown space, and so is all within `start_tolerance_m`.
    StartUnknown,
    /// The goal is beyond what the map covers.
    GoalOutsideMap,
    /// The goal, or the centre of its cell, is in an obstacle or nearer to one than the robot's radius.
    GoalOccupied,
    /// The same for unknown space, where that is not allowed.
    GoalUnknown,
    /// Start and goal are free, and no way of the robot's width joins them.
    Unreachable,
    /// The search ended at `max_expansions`: there may be a path.
    SearchLimit,
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
    },
}

impl Path {
    /// Along straight legs.
    pub(crate) fn of_legs(costmap: &Costmap, mut points: Vec<Point2<f64>>, expansions: usize) -> Self {
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
            waypoints.push(Waypoint { position: leg[0], yaw_rad, is_reverse: false });
        }
        let yaw_rad = waypoints.last().map_or(0.0, |w| w.yaw_rad);
        waypoints.push(Waypoint { position: last, yaw_rad, is_reverse: false });
        let min_clearance_m = nearest.is_finite().then_some(nearest);
        Path { waypoints, length_m: length, cost, min_clearance_m, expansions }
    }

    /// Along arcs, from a pose to a position.
    pub(crate) fn of_arcs(
        cost: &DrivingCost<'_>,
        (start, goal): (&Pose2, Point2<f64>),
        arcs: &[(Pose2, Arc)],
        spacing: f64,
        expansions: usize,
    ) -> Self {
        let costmap = cost.costmap;
        let mut waypoints = Vec::new();
        let mut nearest = f64::INFINITY;
        let mut last = *start;
        for (from, arc) in arcs {
            let pieces = (arc.length.abs() / spacing).ceil().max(1.0);
            let along = |i: f64| arc.after(from, arc.length * (i / pieces));
            waypoints.extend((0..pieces as usize).map(|i| Waypoint::at(&along(i as f64), arc.length < 0.0)));
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
            waypoints.push(Waypoint::at(start, false));
        }
        waypoints.push(Waypoint { position: goal, ..Waypoint::at(&last, is_reverse) });
        Self {
            waypoints,
            length_m: arcs.iter().map(|(_, arc)| arc.length.abs()).sum(),
            cost: cost.of_arcs(arcs, None),
            min_clearance_m: nearest.is_finite().then_some(nearest),
            expansions,
        }
    }
}

impl Waypoint {
    fn at(pose: &Pose2, is_reverse: bool) -> Self {
        Self { position: pose.position, yaw_rad: wrap_angle(pose.yaw_rad), is_reverse }
    }
}
