//! Whether a path in space may begin and end where it is to.

use super::field::Field;
use super::{DenseVoxels, FlightParams};
use crate::{CellState, NoPathReason};
use nalgebra::Point3;

/// What stands in the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlightBlocking {
    /// Where the ball does not fit, map frame, metres.
    pub position: Point3<f64>,
    /// Centre of the nearest voxel that blocks it.
    pub obstacle: Point3<f64>,
    /// What is there: `Occupied`, `KeepOut`, or `Unknown` (so is what lies outside of the box).
    pub state: CellState,
}

/// Why there is no path, and what is in the way if that is known.
#[derive(Debug, Clone, Copy)]
pub(super) struct Refusal {
    pub(super) reason: NoPathReason,
    pub(super) blocking: Option<FlightBlocking>,
}

impl From<NoPathReason> for Refusal {
    fn from(reason: NoPathReason) -> Self {
        Self { reason, blocking: None }
    }
}

/// A start that is nearer to an obstacle touches it, voxels.
const LEAST_CLEARANCE: f64 = 1e-6;

/// The voxel from which a path goes on from the start, or to which it leads before the goal; positions in voxels.
pub(super) fn check_start(
    field: &mut Field<'_>,
    voxels: &DenseVoxels,
    start: &Point3<f64>,
    params: &FlightParams,
) -> Result<usize, Refusal> {
    let index = field.index_at(start).ok_or(NoPathReason::StartOutsideMap)?;
    let tolerance = params.start_tolerance_m / voxels.voxel_size_m;
    let is_known = !field.is_unknown(index) || field.within(start, tolerance).iter().any(|i| !field.is_unknown(*i));
    if !params.allow_unknown && !is_known {
        return Err(NoPathReason::StartUnknown.into());
    }
    match field.state(index) {
        CellState::Free => {}
        CellState::Unknown => return Err(NoPathReason::StartUnknown.into()),
        CellState::KeepOut => return Err(NoPathReason::StartInKeepOut.into()),
        CellState::Occupied => return Err(NoPathReason::StartOccupied.into()),
    }
    if !field.is_height_allowed(start.z, params) {
        return Err(NoPathReason::StartInKeepOut.into());
    }
    let clearance = field.segment_clearance(start, start, field.radius);
    if clearance < field.radius * (1.0 - 1e-9) {
        if clearance < LEAST_CLEARANCE || tolerance == 0.0 {
            return Err(field.refusal(NoPathReason::StartDoesNotFit, start));
        }
        field.open_around(start, clearance, tolerance, params);
    }
    anchor(field, start, clearance).ok_or_else(|| field.refusal(NoPathReason::StartDoesNotFit, start))
}

/// As [`check_start`], without tolerance.
pub(super) fn check_goal(field: &Field<'_>, goal: &Point3<f64>, params: &FlightParams) -> Result<usize, Refusal> {
    let index = field.index_at(goal).ok_or(NoPathReason::GoalOutsideMap)?;
    match field.state(index) {
        CellState::Free => {}
        CellState::Unknown => return Err(NoPathReason::GoalUnknown.into()),
        CellState::KeepOut => return Err(NoPathReason::GoalInKeepOut.into()),
        CellState::Occupied => return Err(NoPathReason::GoalOccupied.into()),
    }
    if !field.is_height_allowed(goal.z, params) {
        return Err(NoPathReason::GoalInKeepOut.into());
    }
    let clearance = field.segment_clearance(goal, goal, field.radius);
    let found = (clearance >= field.radius * (1.0 - 1e-9)).then(|| anchor(field, goal, clearance)).flatten();
    found.ok_or_else(|| field.refusal(NoPathReason::GoalDoesNotFit, goal))
}

/// The nearest open voxel, of the point's own and the 26 around it, to whose centre the straight way comes no nearer to
/// obstacles than the point is.
fn anchor(field: &Field<'_>, p: &Point3<f64>, clearance: f64) -> Option<usize> {
    let mut near: Vec<(f64, usize)> =
        field.within(p, 3f64.sqrt() * 1.5).into_iter().map(|i| ((field.center(i) - p).norm(), i)).collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    let needed = clearance * (1.0 - 1e-9);
    let is_clear = |i: usize| needed > 0.0 && field.segment_clearance(p, &field.center(i), clearance) >= needed;
    near.into_iter().map(|(_, i)| i).find(|i| field.is_open(*i) && is_clear(*i))
}

impl Field<'_> {
    /// A refusal that names what is nearest.
    pub(super) fn refusal(&self, reason: NoPathReason, p: &Point3<f64>) -> Refusal {
        let nearest = self.nearest_obstacle(p, self.radius + 1.0);
        let blocking = nearest.map(|(center, index)| FlightBlocking {
            position: self.placed(p),
            obstacle: self.placed(&center),
            state: index.map_or_else(|| self.state_beyond(&center).unwrap_or(CellState::Unknown), |i| self.state(i)),
        });
        Refusal { reason, blocking }
    }
}
