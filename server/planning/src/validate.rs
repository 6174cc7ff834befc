//! Whether a path can still be driven.

use crate::answer::Blocking;
use crate::fit::{Fit, Motion};
use crate::steering::Arc;
use crate::{Costmap, HybridParams, PathRequest, PlanError, Planner, Pose2};
use percept_geometry::se3::wrap_angle;
use percept_mapping::DenseGrid;

/// The first place of a path that does not fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misfit {
    /// Index of the pose that does not fit, or of the one before the motion that does not.
    pub pose_index: usize,
    /// Where the robot is then, map frame.
    pub pose: Pose2,
    /// Why.
    pub reason: MisfitReason,
}

/// Why a pose or a motion does not fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MisfitReason {
    /// The base is outside of the map.
    OutsideMap,
    /// The footprint overlaps something.
    Blocked(Blocking),
    /// No arc as wide as the turning radius leads to the next pose, only by [`Planner::Hybrid`].
    NotSteerable,
    /// The next pose is behind, and driving backwards is not allowed, only by [`Planner::Hybrid`].
    Backwards,
}

/// How far the heading of a motion may be off the arc between two poses, radians: poses that went through messages and
/// files are rounded.
const HEADING_SLACK: f64 = 1e-3;

/// Looks along a path for the first pose, or motion to the next one, that the robot cannot drive; none if all of it fits.
///
/// The request says footprint, zones, planner and parameters; its start and goal are not looked at. From pose to pose the
/// robot moves on an arc if there is one, else in a straight line, turning evenly. By `Grid` and `AnyAngle` the footprint is
/// the smallest disc that holds it, as it is when they plan. What is checked is the same code that planning checks with. A
/// path of theirs may begin nearer to obstacles than the robot fits, within `start_tolerance_m`, as long as it comes no nearer.
///
/// # Errors
/// As [`plan_path`](crate::plan_path), and `NotFinite` for a pose.
pub fn validate_path(
    grid: &DenseGrid,
    poses: &[Pose2],
    request: &PathRequest<'_>,
) -> Result<Option<Misfit>, PlanError> {
    let Some(&first) = poses.first() else { return Ok(None) };
    for pose in poses {
        if let Some(&value) = pose.position.iter().chain([&pose.yaw_rad]).find(|v| !v.is_finite()) {
            return Err(PlanError::NotFinite { field: "poses", value });
        }
    }
    let request = PathRequest { start: first, ..*request };
    request.check_grid(grid)?;
    let footprint = request.planned_footprint();
    let costmap = Costmap::with_zones(grid, &first.position, request.params, request.zones, request.masks);
    let fit = Fit::new(&costmap, &footprint);
    let room = |pose: &Pose2| costmap.clearance_near(&pose.position).0;
    let room_at_start = room(&first);
    let starts_tight = !matches!(request.planner, Planner::Hybrid(_))
        && room_at_start > 0.0
        && costmap.cell(&first.position).is_some()
        && fit.obstacle_within(&first, 0.0).is_some();
    let is_excused = |pose: &Pose2| {
        starts_tight
            && (pose.position - first.position).norm() <= request.params.start_tolerance_m
            && room(pose) >= room_at_start
    };
    let look = |pose_index: usize| {
        let pose = poses[pose_index];
        let misfit = |pose: Pose2, reason| Some(Misfit { pose_index, pose, reason });
        if costmap.cell(&pose.position).is_none() {
            return misfit(pose, MisfitReason::OutsideMap);
        }
        let blocked = |pose: Pose2| {
            let obstacle = fit.obstacle_within(&pose, 0.0)?;
            misfit(pose, MisfitReason::Blocked(costmap.blocking(&pose.position, obstacle)?))
        };
        if let Some(found) = blocked(pose).filter(|_| !is_excused(&pose)) {
            return Some(found);
        }
        let next = poses.get(pose_index + 1)?;
        let arc = arc_between(&pose, next);
        if let Planner::Hybrid(hybrid) = &request.planner
            && let Some(reason) = unsteerable(&pose, next, arc.as_ref(), hybrid)
        {
            return misfit(pose, reason);
        }
        let motion = arc.map_or(Motion::Straight(*next), Motion::Arc);
        fit.first_overlap(&pose, &motion, is_excused).and_then(blocked)
    };
    Ok((0..poses.len()).find_map(look))
}

/// The arc that leads from one pose to the other, if there is one.
fn arc_between(from: &Pose2, to: &Pose2) -> Option<Arc> {
    let chord = to.position - from.position;
    let turned = wrap_angle(to.yaw_rad - from.yaw_rad);
    let half = 0.5 * turned;
    // The chord of an arc lies half way between the tangents at its ends.
    let off = wrap_angle(chord.y.atan2(chord.x) - from.yaw_rad - half);
    let direction = if off.abs() > std::f64::consts::FRAC_PI_2 { -1.0 } else { 1.0 };
    let off = if direction < 0.0 { wrap_angle(off - std::f64::consts::PI) } else { off };
    if chord.norm() < 1e-9 || off.abs() > HEADING_SLACK {
        return None;
    }
    let length = if half.abs() < 1e-9 { chord.norm() } else { chord.norm() * half / half.sin() };
    Some(Arc { curvature: direction * turned / length, length: direction * length })
}

fn unsteerable(from: &Pose2, to: &Pose2, arc: Option<&Arc>, hybrid: &HybridParams) -> Option<MisfitReason> {
    let Some(arc) = arc else {
        let stays = (to.position - from.position).norm() < 1e-9 && wrap_angle(to.yaw_rad - from.yaw_rad).abs() < 1e-9;
        return (!stays).then_some(MisfitReason::NotSteerable);
    };
    // The slack in heading bends a short arc more than a long one.
    let tightest = 1.0 / hybrid.turning_radius_m + HEADING_SLACK / arc.length.abs();
    if arc.curvature.abs() > tightest {
        return Some(MisfitReason::NotSteerable);
    }
    (arc.length < 0.0 && !hybrid.allow_reverse).then_some(MisfitReason::Backwards)
}
