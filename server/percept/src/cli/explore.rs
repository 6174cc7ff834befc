//! `percept coverage` and `percept frontiers`: on a map file, without a server, or through the map of a session of a running server.

use super::client::{AccessArgs, Connection, RemoteSession, answered, connect};
use super::{Failure, files, input, plan};
use nalgebra::Point2;
use percept_geometry::Timestamp;
use percept_mapping::DenseGrid;
use percept_planning::{PlanParams, Pose2};
use percept_service::path_picture::{self, PathQuantity};
use percept_service::{Explored, PathOptions, exploration};
use percept_wire::convert::{exploration as convert, navigation};
use percept_wire::parts::InParts;
use percept_wire::v1::plan_coverage_response::Outcome;
use percept_wire::{json, params, v1};
use std::path::{Path, PathBuf};
use v1::navigation_service_client::NavigationServiceClient;

/// Which map, and which robot.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("where").required(true).args(["map", "server"]))]
struct Ground {
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
    /// The robot is a disc of this radius, metres. None: the session's, or 0.22.
    #[arg(long, conflicts_with = "footprint")]
    radius: Option<f64>,
    /// The robot's outline in base, X,Y corners in order with spaces between, metres: planned for as the smallest disc that holds it.
    #[arg(long, value_parser = input::parse_polygon, allow_hyphen_values = true)]
    footprint: Option<input::Polygon>,
    /// How fast the robot drives at most, m/s.
    #[arg(long, default_value_t = 0.5)]
    max_speed: f64,
    /// A mask of nav2's keep-out filter, its yaml file: no part of the robot enters its occupied cells. On a map file.
    #[arg(long, conflicts_with = "server")]
    keep_out: Option<PathBuf>,
    /// A mask of nav2's speed filter, its yaml file of mode scale or raw: values are per cent of --max-speed. On a map file.
    #[arg(long, conflicts_with = "server")]
    speed_mask: Option<PathBuf>,
    /// Print the answer as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
pub(crate) struct CoverageArgs {
    #[command(flatten)]
    ground: Ground,
    /// The tool covers a disc of this width around the base, metres. None: 0.4.
    #[arg(long)]
    tool_width: Option<f64>,
    /// Share of the tool's width by which neighbouring lanes overlap at least. None: 0.1.
    #[arg(long)]
    overlap: Option<f64>,
    /// Share of what can be covered at which it is enough. None: 0.99.
    #[arg(long)]
    enough: Option<f64>,
    /// Plan through cells that were never seen.
    #[arg(long)]
    allow_unknown: bool,
    /// Give up after so many milliseconds; 0: when it is done.
    #[arg(long, default_value_t = 0)]
    deadline_ms: u32,
    /// Write the waypoints to this file: .csv, or .json with all that is known of the path.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Draw the map with the path to this PNG file.
    #[arg(long)]
    picture: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
pub(crate) struct FrontierArgs {
    #[command(flatten)]
    ground: Ground,
    /// Those of less length are left out, metres. None: 0.5.
    #[arg(long)]
    min_length: Option<f64>,
    /// How many metres of way a metre of frontier is worth. 0: the nearest first; 1 to 3: scraps are passed by for large openings.
    #[arg(long, default_value_t = 0.0)]
    gain: f64,
    /// Write them to this file: .csv with a row each, or .json with their cells.
    #[arg(long)]
    out: Option<PathBuf>,
}

type Client = NavigationServiceClient<Connection>;

impl Ground {
    fn options(&self, deadline_ms: u32) -> v1::PathOptions {
        let usual = percept_planning::SpeedLimits::default();
        let corners = self.footprint.iter().flat_map(|polygon| &polygon.0);
        v1::PathOptions {
            footprint: corners.map(vector).collect(),
            speed: Some(v1::SpeedLimits {
                max_speed_mps: self.max_speed,
                max_accel_mps2: usual.max_accel_mps2,
                max_turn_rate_radps: usual.max_turn_rate_radps,
            }),
            deadline_ms,
            ..Default::default()
        }
    }

    /// A map file, and what is asked of it.
    fn read(
        &self,
        map: &Path,
        sent: &v1::PlanningParams,
        options: &v1::PathOptions,
    ) -> Result<(DenseGrid, Point2<f64>, PlanParams, PathOptions), Failure> {
        let grid = plan::read(map)?;
        // One's own machine has no other users; frontiers are looked for on a rim around the map, too.
        let max_cells = 2 * grid.cells.len() + 1_000_000;
        let params = PlanParams { max_cells, ..params::planning(Some(sent), &PlanParams::default())? };
        let masks = plan::masks(self.keep_out.as_deref(), self.speed_mask.as_deref())?;
        let options = PathOptions { masks, ..navigation::options(Some(options))? };
        Ok((grid, self.start.ok_or("a question about a map file needs a --start")?, params, options))
    }

    async fn connected(&self) -> Result<(Client, Option<v1::MapSource>), Failure> {
        let channel = connect(self.server.as_deref().unwrap_or_default(), &self.access).await?;
        let session = RemoteSession { channel, id: self.session.clone().unwrap_or_default() };
        Ok((NavigationServiceClient::new(session.channel.clone()), Some(session.source())))
    }
}

fn vector(p: &Point2<f64>) -> v1::Vector2 {
    v1::Vector2 { x: p.x, y: p.y }
}

/// Of a map file, which has no versions.
fn explored<T>(outcome: T) -> Explored<T> {
    Explored { outcome: Some(outcome), map_version: 0, stamp: Timestamp::default() }
}

pub(crate) fn coverage(args: CoverageArgs) -> Result<(), Failure> {
    let as_csv = args.out.as_deref().map(plan::is_csv).transpose()?;
    let (answer, png) = match &args.ground.map {
        Some(map) => coverage_on_file(&args, map)?,
        None => super::serve::runtime()?.block_on(coverage_on_server(&args))?,
    };
    if let (Some(file), Some(png)) = (&args.picture, png) {
        files::write(file, &png)?;
    }
    if args.ground.json {
        println!("{}", serde_json::to_string(&json::to_json("PlanCoverageResponse", &answer)?)?);
    }
    match &answer.outcome {
        Some(Outcome::Path(covering)) => {
            let path = covering.path.as_ref().ok_or("the answer has no path")?;
            match (&args.out, as_csv) {
                (Some(file), Some(true)) => files::write(file, plan::csv(path).as_bytes())?,
                (Some(file), _) => {
                    files::write(file, &serde_json::to_vec_pretty(&json::to_json("CoveragePath", covering)?)?)?;
                }
                (None, _) => {}
            }
            if !args.ground.json {
                plan::tell(path);
                let (share, area) = (100.0 * covering.covered_share, covering.coverable_m2);
                println!("{:>10}  {share:.1} % of the {area:.1} m^2 that can be", "covers");
            }
            Ok(())
        }
        Some(Outcome::NoPath(none)) => Err(plan::words_of(none).into()),
        None => Err("the server answered without an outcome".into()),
    }
}

fn coverage_options(args: &CoverageArgs) -> v1::CoverageOptions {
    v1::CoverageOptions {
        tool_width_m: args.tool_width,
        overlap: args.overlap,
        enough: args.enough,
        ..Default::default()
    }
}

type Covered = (v1::PlanCoverageResponse, Option<Vec<u8>>);

fn coverage_on_file(args: &CoverageArgs, map: &Path) -> Result<Covered, Failure> {
    let sent = plan::planning_params(args.ground.radius, args.allow_unknown);
    let (grid, start, params, options) = args.ground.read(map, &sent, &args.ground.options(args.deadline_ms))?;
    let how = convert::coverage(Some(&coverage_options(args)))?;
    let outcome = exploration::coverage_on(&grid, (start, 0.0), &how, &params, &options)?;
    let png = match (&args.picture, &outcome) {
        (Some(_), percept_planning::CoverageOutcome::Path(covering)) => {
            let pose = |w: &percept_planning::Waypoint| Pose2 { position: w.position, yaw_rad: w.yaw_rad };
            let poses: Vec<Pose2> = covering.path.waypoints.iter().map(pose).collect();
            let title = map.file_stem().unwrap_or_default().to_string_lossy();
            let quantity = PathQuantity::Clearance;
            Some(path_picture::given(&grid, &poses, &params, &options, quantity, &title)?.png)
        }
        _ => None,
    };
    Ok((v1::PlanCoverageResponse { stamp: None, ..convert::covered_to(&explored(outcome)) }, png))
}

async fn coverage_on_server(args: &CoverageArgs) -> Result<Covered, Failure> {
    let (mut client, source) = args.ground.connected().await?;
    let params = Some(plan::planning_params(args.ground.radius, args.allow_unknown));
    let options = Some(args.ground.options(args.deadline_ms));
    let request = v1::PlanCoverageRequest {
        source: source.clone(),
        start: args.ground.start.as_ref().map(vector),
        params,
        options: options.clone(),
        coverage: Some(coverage_options(args)),
    };
    let answer = answered(client.plan_coverage(request).await)?;
    let path = match &answer.outcome {
        Some(Outcome::Path(covering)) if args.picture.is_some() => covering.path.as_ref(),
        _ => None,
    };
    let Some(path) = path else { return Ok((answer, None)) };
    let pose = |w: &v1::Waypoint| v1::Pose2 { x_m: w.x_m, y_m: w.y_m, yaw_rad: w.yaw_rad };
    let poses = path.waypoints.iter().map(pose).collect();
    let request = v1::DrawPathRequest { source, params, options, poses, ..Default::default() };
    let mut stream = answered(client.draw_path(request).await)?;
    let mut parts = vec![];
    while let Some(part) = stream.message().await? {
        parts.push(part);
    }
    Ok((answer, Some(v1::DrawPathResponse::joined(parts).png.to_vec())))
}

pub(crate) fn frontiers(args: FrontierArgs) -> Result<(), Failure> {
    let as_csv = args.out.as_deref().map(plan::is_csv).transpose()?;
    let answer = match &args.ground.map {
        Some(map) => frontiers_on_file(&args, map)?,
        None => super::serve::runtime()?.block_on(frontiers_on_server(&args))?,
    };
    let row = |f: &v1::Frontier| {
        let goal = f.goal.unwrap_or_default();
        format!("{},{},{},{}\n", goal.x, goal.y, f.length_m, f.cost)
    };
    let whole = || json::to_json("FindFrontiersResponse", &answer);
    match (&args.out, as_csv) {
        (Some(file), Some(true)) => {
            let rows: String = answer.frontiers.iter().map(row).collect();
            files::write(file, format!("goal_x_m,goal_y_m,length_m,cost_m\n{rows}").as_bytes())?;
        }
        (Some(file), _) => files::write(file, &serde_json::to_vec_pretty(&whole()?)?)?,
        (None, _) => {}
    }
    if args.ground.json {
        println!("{}", serde_json::to_string(&whole()?)?);
        return Ok(());
    }
    if answer.frontiers.is_empty() {
        println!("none: all that the robot reaches is known");
    }
    for f in &answer.frontiers {
        let goal = f.goal.unwrap_or_default();
        println!("{:8.2} m wide, {:.2} m to go, from ({:.2}, {:.2})", f.length_m, f.cost, goal.x, goal.y);
    }
    Ok(())
}

fn frontier_request(args: &FrontierArgs, source: Option<v1::MapSource>) -> v1::FindFrontiersRequest {
    v1::FindFrontiersRequest {
        source,
        start: args.ground.start.as_ref().map(vector),
        params: Some(plan::planning_params(args.ground.radius, false)),
        min_length_m: args.min_length,
        gain: args.gain,
        options: Some(args.ground.options(0)),
    }
}

fn frontiers_on_file(args: &FrontierArgs, map: &Path) -> Result<v1::FindFrontiersResponse, Failure> {
    let sent = frontier_request(args, None);
    let asked = convert::frontier_request(&sent, &percept_pipeline::PipelineParams::default())?;
    let (sent_params, sent_options) = (sent.params.unwrap_or_default(), sent.options.unwrap_or_default());
    let (grid, start, params, options) = args.ground.read(map, &sent_params, &sent_options)?;
    exploration::check_free(&grid, &start, &params)?;
    let found = exploration::frontiers_on(&grid, start, (asked.min_length_m, asked.gain), &params, &options)?;
    Ok(v1::FindFrontiersResponse { stamp: None, ..convert::frontiers_to(&explored(found)) })
}

async fn frontiers_on_server(args: &FrontierArgs) -> Result<v1::FindFrontiersResponse, Failure> {
    let (mut client, source) = args.ground.connected().await?;
    answered(client.find_frontiers(frontier_request(args, source)).await)
}
