//! Requests for pictures of paths and of what changed, and those.

use super::{maps, navigation, required};
use crate::{params, v1};
use nalgebra::Point2;
use percept_pipeline::PipelineParams;
use percept_planning::{PlanParams, Pose2};
use percept_service::path_picture::PathQuantity;
use percept_service::{
    Drawing, DrawnPath, Error, Limits, MapBefore, MapComparison, PathOptions, PathPicture, Result, reason,
};

/// What the colours along a path mean.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn quantity(colouring: i32) -> Result<PathQuantity> {
    match v1::PathColouring::try_from(colouring) {
        Ok(v1::PathColouring::Unspecified | v1::PathColouring::Clearance) => Ok(PathQuantity::Clearance),
        Ok(v1::PathColouring::Cost) => Ok(PathQuantity::Cost),
        Ok(v1::PathColouring::Speed) => Ok(PathQuantity::Speed),
        Err(_) => Err(super::unknown_enum("colouring", colouring)),
    }
}

/// What is drawn over a session's map.
///
/// # Errors
/// As for a path that is planned; `FIELD_MISSING` without goal and poses.
pub fn drawing(r: &v1::DrawPathRequest, session: &PipelineParams) -> Result<Drawing> {
    let quantity = quantity(r.colouring)?;
    let (sent, asked) = (r.params.as_ref(), r.options.as_ref());
    let path = if r.poses.is_empty() {
        goal_or_poses(r.goal.as_ref())?;
        DrawnPath::Planned(navigation::request(r.start.as_ref(), r.goal.as_ref(), sent, asked, session)?)
    } else {
        let params = Some(params::planning(sent, &session.planning)?);
        DrawnPath::Given { poses: navigation::poses(&r.poses)?, params, options: navigation::options(asked)? }
    };
    Ok(Drawing { path, quantity })
}

/// What is drawn over a map that came with the question.
pub enum OnMap {
    /// Start and goal of a path that is planned.
    Planned(Point2<f64>, Point2<f64>),
    /// Poses as they are.
    Given(Vec<Pose2>),
}

/// The same with parameters and options.
///
/// # Errors
/// As for a path that is planned; `FIELD_MISSING` without start, goal and poses.
pub fn on_map(r: &v1::DrawPathOnMapRequest, defaults: &PlanParams) -> Result<(OnMap, PlanParams, PathOptions)> {
    let (params, options) =
        (params::planning(r.params.as_ref(), defaults)?, navigation::options_on_map(r.options.as_ref())?);
    if !r.poses.is_empty() {
        return Ok((OnMap::Given(navigation::poses(&r.poses)?), params, options));
    }
    goal_or_poses(r.goal.as_ref())?;
    let point = |field, value: Option<&v1::Vector2>| super::geometry::point2(field, required(field, value)?);
    Ok((OnMap::Planned(point("start", r.start.as_ref())?, point("goal", r.goal.as_ref())?), params, options))
}

fn goal_or_poses(goal: Option<&v1::Vector2>) -> Result<()> {
    let words = "there is neither a goal nor poses; give a goal to plan to, or the poses of a path";
    goal.map(|_| ()).ok_or_else(|| Error::invalid(reason::FIELD_MISSING, "goal", words))
}

/// A path over a session's map as a picture.
pub fn drawn_to(picture: PathPicture, is_given: bool) -> v1::DrawPathResponse {
    use v1::draw_path_response::Outcome;
    let outcome =
        (!is_given).then(|| navigation::planned_to(&picture.plan).map_or_else(Outcome::NoPath, Outcome::Path));
    v1::DrawPathResponse {
        outcome,
        misfit: picture.misfit.as_ref().map(|m| navigation::misfit_to(m, None)),
        stamp: Some(maps::stamp_to(picture.plan.map_version, picture.plan.stamp)),
        png: picture.png.into(),
    }
}

/// A path over a map that came with the question as a picture.
pub fn drawn_on_map_to(picture: PathPicture) -> v1::DrawPathOnMapResponse {
    use v1::draw_path_on_map_response::Outcome;
    let outcome = picture.plan.outcome.as_ref().map(|o| navigation::outcome_to(o, None));
    v1::DrawPathOnMapResponse {
        outcome: outcome.map(|o| o.map_or_else(Outcome::NoPath, Outcome::Path)),
        misfit: picture.misfit.as_ref().map(|m| navigation::misfit_to(m, None)),
        png: picture.png.into(),
    }
}

/// What a map is compared with.
///
/// # Errors
/// `FIELD_MISSING`, `SIZE_MISMATCH`, `OUT_OF_RANGE`, `FILE_INVALID`, `GRID_TOO_LARGE`.
pub fn before(r: v1::CompareMapsRequest, limits: &Limits) -> Result<MapBefore> {
    use v1::compare_maps_request::Before as B;
    Ok(match required("before", r.before)? {
        B::Nav2(files) => MapBefore::Grid(navigation::nav2(&files, limits).map_err(|e| e.within("nav2"))?),
        B::Grid(grid) => MapBefore::Grid(navigation::grid(&grid).map_err(|e| e.within("grid"))?),
        B::SessionId(id) => MapBefore::Session(id),
    })
}

/// What became of a place, as a message.
pub fn comparison_to(found: MapComparison) -> v1::CompareMapsResponse {
    v1::CompareMapsResponse {
        num_appeared: found.changes.num_appeared as u64,
        num_gone: found.changes.num_gone as u64,
        num_newly_seen: found.changes.num_newly_seen as u64,
        cell_area_m2: found.changes.cell_area_m2,
        stamp: Some(maps::stamp_to(found.map_version, found.stamp)),
        png: found.png.into(),
    }
}
