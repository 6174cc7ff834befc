//! Paths through maps that come with the question: decode, call, encode.

use percept_planning::PlanParams;
use percept_service::toolbox::Toolbox;
use percept_service::{Result, navigation as ops, path_picture};
use percept_wire::convert::drawing::{self, OnMap};
use percept_wire::convert::{geometry, navigation, required};
use percept_wire::{params, v1};

operations! {
    toolbox_planning_service_server::ToolboxPlanningService, "ToolboxPlanningService/*",
    one {
        plan_on_map(PlanOnMapRequest) -> PlanOnMapResponse,
        validate_on_map(ValidateOnMapRequest) -> ValidateOnMapResponse,
    }
    parts {
        draw_path_on_map(DrawPathOnMapRequest) -> DrawPathOnMapResponse as DrawPathOnMapStream,
    }
}

/// Over pictures of maps that have no name.
const TITLE: &str = "Path";

fn params_of(t: &Toolbox, sent: Option<&v1::PlanningParams>) -> Result<PlanParams> {
    let params = params::planning(sent, &PlanParams::default())?;
    Ok(PlanParams { max_cells: params.max_cells.min(t.limits().max_planning_cells), ..params })
}

fn plan_on_map(t: &Toolbox, r: v1::PlanOnMapRequest) -> Result<v1::PlanOnMapResponse> {
    let grid = navigation::given_map(r.map.as_ref(), t.limits())?;
    let start = geometry::point2("start", &required("start", r.start)?)?;
    let goal = geometry::point2("goal", &required("goal", r.goal)?)?;
    let (params, options) = (params_of(t, r.params.as_ref())?, navigation::options_on_map(r.options.as_ref())?);
    Ok(navigation::on_map_to(&ops::on_grid(&grid, (start, 0.0), goal, &params, &options)?))
}

fn draw_path_on_map(t: &Toolbox, r: v1::DrawPathOnMapRequest) -> Result<v1::DrawPathOnMapResponse> {
    let quantity = drawing::quantity(r.colouring)?;
    let grid = navigation::given_map(r.map.as_ref(), t.limits())?;
    let max_cells = PlanParams::default().max_cells.min(t.limits().max_planning_cells);
    let (path, params, options) = drawing::on_map(&r, &PlanParams::default())?;
    let params = PlanParams { max_cells: params.max_cells.min(max_cells), ..params };
    let picture = match path {
        OnMap::Planned(start, goal) => {
            path_picture::planned(&grid, Some((start, None)), goal, &params, &options, quantity, TITLE)?
        }
        OnMap::Given(poses) => path_picture::given(&grid, &poses, &params, &options, quantity, TITLE)?,
    };
    Ok(drawing::drawn_on_map_to(picture))
}

fn validate_on_map(t: &Toolbox, r: v1::ValidateOnMapRequest) -> Result<v1::ValidateOnMapResponse> {
    let grid = navigation::given_map(r.map.as_ref(), t.limits())?;
    let (params, options) = (params_of(t, r.params.as_ref())?, navigation::options_on_map(r.options.as_ref())?);
    let misfit = ops::misfit(&grid, &navigation::poses(&r.poses)?, &params, &options)?;
    Ok(v1::ValidateOnMapResponse { misfit: misfit.map(|m| navigation::misfit_to(&m, None)) })
}
