//! `percept plan`: a path on a map file, without a server, or through the map of a session of a running server.

use super::client::{AccessArgs, RemoteSession, answered, connect};
use super::{Failure, files, input};
use nalgebra::Point2;
use percept_formats::{Limits as FileLimits, nav2};
use percept_mapping::DenseGrid;
use percept_planning::PlanParams;
use percept_service::path_picture::{self, PathQuantity};
use percept_service::{Limits, MaskCells, MaskMeaning, PathOptions, SessionMask, SpeedUnit, navigation};
use percept_wire::convert::navigation as convert;
use percept_wire::parts::InParts;
use percept_wire::v1::plan_on_map_response::Outcome;
use percept_wire::{json, params, v1};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use v1::navigation_service_client::NavigationServiceClient;

/// A robot that is larger than the usual distance that is kept from obstacles keeps so much more than its radius, metres.
const KEPT_OFF_M: f64 = 0.3;

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Planner {
    /// A* over cells, shortened and smoothed: for a robot that turns on the spot.
    Grid,
    /// Lazy Theta*: legs at any angle.
    AnyAngle,
    /// Hybrid A*: for a robot that steers, and for a footprint that only fits in some headings.
    Hybrid,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Coloring {
    /// Distance to the nearest obstacle.
    Clearance,
    /// What a metre costs.
    Cost,
    /// How fast the robot is.
    Speed,
}

#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("where").required(true).args(["map", "server"]))]
pub(crate) struct PlanArgs {
    /// A map to plan on without a server: the yaml file of nav2's map server, with its image beside it.
    map: Option<PathBuf>,
    /// Plan through the map of a session of the server at this gRPC address.
    #[arg(long, requires = "session")]
    server: Option<String>,
    #[command(flatten)]
    access: AccessArgs,
    /// Id of the session.
    #[arg(long, requires = "server")]
    session: Option<String>,
    /// Where from, X,Y, metres, map frame; through a session's map: none, where its robot is.
    #[arg(long, value_parser = input::parse_point, allow_hyphen_values = true, required_unless_present = "server")]
    start: Option<Point2<f64>>,
    /// Where to, X,Y, metres, map frame.
    #[arg(long, value_parser = input::parse_point, allow_hyphen_values = true)]
    goal: Point2<f64>,
    /// Heading to begin with, radians; for hybrid.
    #[arg(long, allow_hyphen_values = true)]
    start_yaw: Option<f64>,
    /// Heading to end with, radians; for hybrid. None: any.
    #[arg(long, allow_hyphen_values = true)]
    goal_yaw: Option<f64>,
    /// The robot is a disc of this radius, metres. None: the session's, or 0.22.
    #[arg(long, conflicts_with = "footprint")]
    radius: Option<f64>,
    /// The robot's outline in base, X,Y corners in order with spaces between, metres: "0.4,0.2 -0.4,0.2 -0.4,-0.2 0.4,-0.2".
    #[arg(long, value_parser = input::parse_polygon, allow_hyphen_values = true)]
    footprint: Option<input::Polygon>,
    /// How it is searched.
    #[arg(long, value_enum, default_value = "grid")]
    planner: Planner,
    /// Least radius that the robot drives, metres; for hybrid. None: 0.8.
    #[arg(long)]
    turning_radius: Option<f64>,
    /// The robot drives forwards only; for hybrid.
    #[arg(long)]
    no_reverse: bool,
    /// How fast the robot drives at most, m/s.
    #[arg(long, default_value_t = 0.5)]
    max_speed: f64,
    /// Plan through cells that were never seen.
    #[arg(long)]
    allow_unknown: bool,
    /// A mask of nav2's keep-out filter, its yaml file: no part of the robot enters its occupied cells. On a map file.
    #[arg(long, conflicts_with = "server")]
    keep_out: Option<PathBuf>,
    /// A mask of nav2's speed filter, its yaml file of mode scale or raw: values are per cent of --max-speed. On a map file.
    #[arg(long, conflicts_with = "server")]
    speed_mask: Option<PathBuf>,
    /// Give up, or end with the best path so far, after so many milliseconds; 0: when it is done.
    #[arg(long, default_value_t = 0)]
    deadline_ms: u32,
    /// Write the waypoints to this file: .csv, or .json with all that is known of the path.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Draw the map with the path, or with what blocks the way, to this PNG file.
    #[arg(long)]
    picture: Option<PathBuf>,
    /// What the colours along the drawn path mean.
    #[arg(long, value_enum, default_value = "clearance")]
    coloring: Coloring,
    /// Print the answer as JSON, also where there is no path.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: PlanArgs) -> Result<(), Failure> {
    let as_csv = args.out.as_deref().map(is_csv).transpose()?;
    let (outcome, png) = match &args.map {
        Some(map) => on_file(&args, map)?,
        None => super::serve::runtime()?.block_on(on_server(&args))?,
    };
    if let (Some(file), Some(png)) = (&args.picture, png) {
        files::write(file, &png)?;
    }
    let answer = v1::PlanOnMapResponse { outcome: Some(outcome) };
    if args.json {
        println!("{}", serde_json::to_string(&json::to_json("PlanOnMapResponse", &answer)?)?);
    }
    match &answer.outcome {
        Some(Outcome::Path(path)) => {
            match (&args.out, as_csv) {
                (Some(file), Some(true)) => files::write(file, csv(path).as_bytes())?,
                (Some(file), _) => {
                    files::write(file, &serde_json::to_vec_pretty(&json::to_json("Path", path)?)?)?;
                }
                (None, _) => {}
            }
            if !args.json {
                tell(path);
            }
            Ok(())
        }
        Some(Outcome::NoPath(none)) => Err(words_of(none).into()),
        None => Err("the server answered without an outcome".into()),
    }
}

type Found = (Outcome, Option<Vec<u8>>);

fn on_file(args: &PlanArgs, map: &Path) -> Result<Found, Failure> {
    let grid = read(map)?;
    let sent = planning_params(args.radius, args.allow_unknown);
    // One's own machine has no other users.
    let params =
        PlanParams { max_cells: grid.cells.len().max(1), ..params::planning(Some(&sent), &PlanParams::default())? };
    let masks = masks(args.keep_out.as_deref(), args.speed_mask.as_deref())?;
    let options = PathOptions { masks, ..convert::options(Some(&path_options(args)))? };
    let start = args.start.ok_or("a path on a map file needs a --start")?;
    if args.picture.is_none() {
        let outcome = navigation::on_grid(&grid, (start, 0.0), args.goal, &params, &options)?;
        let outcome = convert::on_map_to(&outcome).outcome.ok_or("the planner gave no outcome")?;
        return Ok((outcome, None));
    }
    let quantity = match args.coloring {
        Coloring::Clearance => PathQuantity::Clearance,
        Coloring::Cost => PathQuantity::Cost,
        Coloring::Speed => PathQuantity::Speed,
    };
    let title = map.file_stem().unwrap_or_default().to_string_lossy();
    let drawn = path_picture::planned(&grid, Some((start, None)), args.goal, &params, &options, quantity, &title)?;
    let outcome = drawn.plan.outcome.as_ref().ok_or("the planner gave no outcome")?;
    Ok((convert::on_map_to(outcome).outcome.ok_or("the planner gave no outcome")?, Some(drawn.png)))
}

async fn on_server(args: &PlanArgs) -> Result<Found, Failure> {
    let server = args.server.as_deref().unwrap_or_default();
    let channel = connect(server, &args.access).await?;
    let session = RemoteSession { channel, id: args.session.clone().unwrap_or_default() };
    let mut client = NavigationServiceClient::new(session.channel.clone());
    let point = |p: &Point2<f64>| v1::Vector2 { x: p.x, y: p.y };
    let (source, start, goal) = (Some(session.source()), args.start.as_ref().map(point), Some(point(&args.goal)));
    let (params, options) = (Some(planning_params(args.radius, args.allow_unknown)), Some(path_options(args)));
    if args.picture.is_none() {
        use v1::plan_path_response::Outcome as O;
        let request = v1::PlanPathRequest { source, start, goal, params, options };
        let answer = answered(client.plan_path(request).await)?;
        let outcome = match answer.outcome.ok_or("the server answered without an outcome")? {
            O::Path(path) => Outcome::Path(path),
            O::NoPath(none) => Outcome::NoPath(none),
        };
        return Ok((outcome, None));
    }
    let colouring = match args.coloring {
        Coloring::Clearance => v1::PathColouring::Clearance,
        Coloring::Cost => v1::PathColouring::Cost,
        Coloring::Speed => v1::PathColouring::Speed,
    };
    let request =
        v1::DrawPathRequest { source, start, goal, params, options, poses: vec![], colouring: colouring.into() };
    let mut stream = answered(client.draw_path(request).await)?;
    let mut parts = vec![];
    while let Some(part) = stream.message().await? {
        parts.push(part);
    }
    let drawn = v1::DrawPathResponse::joined(parts);
    let outcome = match drawn.outcome.ok_or("the server answered without an outcome")? {
        v1::draw_path_response::Outcome::Path(path) => Outcome::Path(path),
        v1::draw_path_response::Outcome::NoPath(none) => Outcome::NoPath(none),
    };
    Ok((outcome, Some(drawn.png.to_vec())))
}

pub(super) fn read(yaml: &Path) -> Result<DenseGrid, Failure> {
    let nav2::GridMap { geometry, width, height, cells } = nav2::read(yaml, &FileLimits::default())?;
    Ok(DenseGrid { geometry, width, height, cells })
}

pub(super) fn masks(keep_out: Option<&Path>, speed_mask: Option<&Path>) -> Result<Vec<SessionMask>, Failure> {
    let limits = Limits { max_planning_cells: usize::MAX, ..Limits::default() };
    let speed = MaskMeaning::Speed { base: 0.0, multiplier: 1.0, unit: SpeedUnit::Percent };
    let mut out = vec![];
    for (file, meaning) in [(keep_out, MaskMeaning::KeepOut), (speed_mask, speed)] {
        let Some(file) = file else { continue };
        let in_file = |e: percept_service::Error| format!("{}: {e}", file.display());
        let cells = Arc::new(MaskCells::new(read(file)?, &limits).map_err(in_file)?);
        out.push(SessionMask::new(file.display().to_string(), meaning, cells).map_err(in_file)?);
    }
    Ok(out)
}

pub(super) fn planning_params(radius: Option<f64>, allow_unknown: bool) -> v1::PlanningParams {
    let usual = PlanParams::default().inflation_radius_m;
    v1::PlanningParams {
        robot_radius_m: radius,
        inflation_radius_m: radius.filter(|radius| *radius > usual).map(|radius| radius + KEPT_OFF_M),
        allow_unknown: allow_unknown.then_some(true),
        ..Default::default()
    }
}

fn path_options(args: &PlanArgs) -> v1::PathOptions {
    let planner = match args.planner {
        Planner::Grid => v1::Planner::Grid,
        Planner::AnyAngle => v1::Planner::AnyAngle,
        Planner::Hybrid => v1::Planner::Hybrid,
    };
    let usual = percept_planning::SpeedLimits::default();
    let corners = args.footprint.iter().flat_map(|polygon| &polygon.0);
    v1::PathOptions {
        planner: planner.into(),
        start_yaw_rad: args.start_yaw,
        goal_yaw_rad: args.goal_yaw,
        footprint: corners.map(|p| v1::Vector2 { x: p.x, y: p.y }).collect(),
        speed: Some(v1::SpeedLimits {
            max_speed_mps: args.max_speed,
            max_accel_mps2: usual.max_accel_mps2,
            max_turn_rate_radps: usual.max_turn_rate_radps,
        }),
        steering: Some(v1::SteeringOptions {
            turning_radius_m: args.turning_radius,
            allow_reverse: args.no_reverse.then_some(false),
            ..Default::default()
        }),
        deadline_ms: args.deadline_ms,
        ..Default::default()
    }
}

pub(super) fn tell(path: &v1::Path) {
    println!("{:>10}  {:.2} m, {} waypoints", "path", path.length_m, path.waypoints.len());
    println!("{:>10}  {:.1} s from rest to rest", "takes", path.duration_s);
    println!("{:>10}  {:.2} m", "cost", path.cost);
    match path.min_clearance_m {
        Some(least) => println!("{:>10}  never nearer than {least:.2} m to an obstacle", "clearance"),
        None => println!("{:>10}  there is no obstacle", "clearance"),
    }
    if !path.is_final {
        println!("{:>10}  the search was ended before it was done; this is the best so far", "not final");
    }
}

/// Why there is no path, and what is in the way.
pub(super) fn words_of(none: &v1::NoPath) -> String {
    let name = none.reason().as_str_name().trim_start_matches("NO_PATH_REASON_").to_lowercase();
    let mut words = format!("no path: {} ({name})", none.detail);
    if let Some((blocking, p)) = none.blocking.as_ref().and_then(|b| Some((b, b.obstacle?))) {
        let state = blocking.state().as_str_name().trim_start_matches("BLOCKING_STATE_").to_lowercase();
        let _ = write!(words, "; first blocked at ({:.2}, {:.2}), which is {}", p.x, p.y, state.replace('_', " "));
    }
    words
}

/// Whether a file is for rows; if not, it is for JSON.
pub(super) fn is_csv(file: &Path) -> Result<bool, Failure> {
    match file.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("csv") => Ok(true),
        Some("json") => Ok(false),
        _ => Err(format!("--out is {}; call it .csv or .json", file.display()).into()),
    }
}

pub(super) fn csv(path: &v1::Path) -> String {
    let mut out = "x_m,y_m,yaw_rad,time_s,clearance_m,is_reverse\n".to_owned();
    for w in &path.waypoints {
        let clearance = w.clearance_m.map_or(String::new(), |c| c.to_string());
        let _ = writeln!(out, "{},{},{},{},{clearance},{}", w.x_m, w.y_m, w.yaw_rad, w.time_s, w.is_reverse);
    }
    out
}
