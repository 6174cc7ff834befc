//! What holds along a path: for pictures and tables of it.

use crate::by_cells::sized;
use crate::{Costmap, PathRequest, PlanError, Pose2, Waypoint};
use nalgebra::Point2;
use percept_geometry::se3::wrap_angle;
use percept_mapping::DenseGrid;

/// Samples of a path, about: a longer one has them farther apart than a cell.
const ABOUT_MOST: f64 = 4_000.0;

/// A place of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathSample {
    /// Map frame, metres.
    pub pose: Pose2,
    /// Distance of the base from the nearest obstacle, metres, or up to a cell's diagonal less; none if there is none.
    pub clearance_m: Option<f64>,
    /// What a metre costs there, in metres of free way; infinite off the map.
    pub cost: f64,
    /// How fast the robot is from here to the next sample, m/s; the last keeps that of the one before.
    pub speed_mps: f64,
}

/// A path (map frame) as samples about a cell apart, its own poses among them: in straight lines from pose to pose, turning evenly, as
/// its time is counted. The request says footprint, zones, planner and parameters; its start and goal are not looked at.
///
/// # Errors
/// As [`plan_path`](crate::plan_path), and `NotFinite` for a pose.
pub fn samples_along(
    grid: &DenseGrid,
    poses: &[Pose2],
    request: &PathRequest<'_>,
) -> Result<Vec<PathSample>, PlanError> {
    let Some(&first) = poses.first() else { return Ok(vec![]) };
    for pose in poses {
        if let Some(&value) = pose.position.iter().chain([&pose.yaw_rad]).find(|v| !v.is_finite()) {
            return Err(PlanError::NotFinite { field: "poses", value });
        }
    }
    let request = PathRequest { start: first, ..*request };
    request.check_grid(grid)?;
    let params = sized(&request, &request.planned_footprint());
    let costmap = Costmap::with_zones(grid, &first.position, &params, request.zones, request.masks);
    let length: f64 = poses.windows(2).map(|p| (p[1].position - p[0].position).norm()).sum();
    let apart = grid.geometry.resolution_m.max(length / ABOUT_MOST);
    let waypoints: Vec<Waypoint> = between(poses, apart).iter().map(|(p, r)| Waypoint::at(&costmap, p, *r)).collect();
    let times = request.speed.times(&costmap, &waypoints);
    let speed_from = |i: usize| {
        let gone = (waypoints[i + 1].position - waypoints[i].position).norm();
        let seconds = times[i + 1] - times[i];
        if seconds > 0.0 { gone / seconds } else { 0.0 }
    };
    let last = waypoints.len() - 1;
    let speed_at = |i: usize| if last == 0 { 0.0 } else { speed_from(i.min(last - 1)) };
    let sample = |(i, w): (usize, &Waypoint)| PathSample {
        pose: Pose2 { position: w.position, yaw_rad: w.yaw_rad },
        clearance_m: w.clearance_m,
        cost: cost_at(&costmap, &w.position),
        speed_mps: speed_at(i),
    };
    Ok(waypoints.iter().enumerate().map(sample).collect())
}

/// The poses with others between them, and whether the robot drives backwards from each.
fn between(poses: &[Pose2], apart: f64) -> Vec<(Pose2, bool)> {
    let mut out = Vec::with_capacity(poses.len());
    let mut is_reverse = false;
    for (from, to) in poses.iter().zip(&poses[1..]) {
        let along = to.position - from.position;
        let turned = wrap_angle(to.yaw_rad - from.yaw_rad);
        let ahead = from.yaw_rad + 0.5 * turned;
        is_reverse = along.x * ahead.cos() + along.y * ahead.sin() < 0.0;
        let pieces = (along.norm() / apart).ceil().max(1.0);
        for i in 0..pieces as usize {
            let share = i as f64 / pieces;
            let pose = Pose2 { position: from.position + along * share, yaw_rad: from.yaw_rad + turned * share };
            out.push((pose, is_reverse));
        }
    }
    out.extend(poses.last().map(|pose| (*pose, is_reverse)));
    out
}

fn cost_at(costmap: &Costmap, p: &Point2<f64>) -> f64 {
    let inside = |v: i32, size: usize| usize::try_from(v).ok().filter(|v| *v < size);
    let cell = costmap.geometry().cell(p);
    let index =
        cell.and_then(|c| Some(inside(c.y, costmap.height())? * costmap.width() + inside(c.x, costmap.width())?));
    index.map_or(f64::INFINITY, |i| f64::from(costmap.factors()[i]))
}
