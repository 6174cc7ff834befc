//! `percept fly`: a path in space, through an OctoMap file without a server, or through the voxels of a session of a running one.

use super::client::{AccessArgs, RemoteSession, answered, connect};
use super::{Failure, files, input, plan};
use nalgebra::Point3;
use percept_formats::{FormatError, Limits as FileLimits, OctreeMap, octomap, read_file};
use percept_geometry::{Aabb3, Timestamp, Voxel};
use percept_planning::flight::{DenseVoxels, FlightRequest, plan_flight};
use percept_service::Explored;
use percept_wire::convert::exploration as convert;
use percept_wire::v1::plan_flight_response::Outcome;
use percept_wire::{json, v1};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use v1::navigation_service_client::NavigationServiceClient;

/// Voxels of a file's box: 3 GB while a path is looked for in them.
const MAX_VOXELS: usize = 128 << 20;

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Planner {
    /// Lazy Theta*: legs at any angle.
    AnyAngle,
    /// A* from voxel to voxel, 26 neighbours: the shortest of such ways.
    Lattice,
}

#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("where").required(true).args(["map", "server"]))]
pub(crate) struct FlyArgs {
    /// A map to plan in without a server: an OctoMap, .bt or .ot.
    map: Option<PathBuf>,
    /// Plan through the voxels of a session of the server at this gRPC address.
    #[arg(long, requires = "session")]
    server: Option<String>,
    #[command(flatten)]
    access: AccessArgs,
    /// Id of the session.
    #[arg(long, requires = "server")]
    session: Option<String>,
    /// Where from, X,Y,Z of the ball's centre, metres, map frame; through a session's map: none, where base is.
    #[arg(long, value_parser = input::parse_position, allow_hyphen_values = true, required_unless_present = "server")]
    start: Option<Point3<f64>>,
    /// Where to, X,Y,Z, metres, map frame.
    #[arg(long, value_parser = input::parse_position, allow_hyphen_values = true)]
    goal: Point3<f64>,
    /// The robot is a ball of this radius, metres. None: 0.3.
    #[arg(long)]
    radius: Option<f64>,
    /// How it is searched.
    #[arg(long, value_enum, default_value = "any-angle")]
    planner: Planner,
    /// Fly through voxels that were never seen.
    #[arg(long)]
    allow_unknown: bool,
    /// The ball's centre keeps at or above this height, metres, map frame.
    #[arg(long, allow_hyphen_values = true)]
    min_z: Option<f64>,
    /// The ball's centre keeps at or below this height, metres, map frame.
    #[arg(long, allow_hyphen_values = true)]
    max_z: Option<f64>,
    /// Lowest corner of the part of the map that is searched, X,Y,Z, metres. None: all of it.
    #[arg(long, value_parser = input::parse_position, allow_hyphen_values = true, requires = "high")]
    low: Option<Point3<f64>>,
    /// Highest corner of it.
    #[arg(long, value_parser = input::parse_position, allow_hyphen_values = true, requires = "low")]
    high: Option<Point3<f64>>,
    /// End with the best path so far after so many milliseconds; 0: when it is done
    #[arg(long, default_value_t = 0)]
    deadline_ms: u32,
    /// Write the corners of the path to this file: .csv, or .json with all that is known of it.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print the answer as JSON, also where there is no path.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: FlyArgs) -> Result<(), Failure> {
    let as_csv = args.out.as_deref().map(plan::is_csv).transpose()?;
    let answer = match &args.map {
        Some(map) => on_file(&args, map)?,
        None => super::serve::runtime()?.block_on(on_server(&args))?,
    };
    if args.json {
        println!("{}", serde_json::to_string(&json::to_json("PlanFlightResponse", &answer)?)?);
    }
    match &answer.outcome {
        Some(Outcome::Path(path)) => {
            match (&args.out, as_csv) {
                (Some(file), Some(true)) => files::write(file, csv(path).as_bytes())?,
                (Some(file), _) => {
                    files::write(file, &serde_json::to_vec_pretty(&json::to_json("FlightPath", path)?)?)?;
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

fn request(args: &FlyArgs) -> v1::PlanFlightRequest {
    let vector = |p: &Point3<f64>| v1::Vector3 { x: p.x, y: p.y, z: p.z };
    let corners = args.low.as_ref().zip(args.high.as_ref());
    let planner = match args.planner {
        Planner::AnyAngle => v1::FlightPlanner::AnyAngle,
        Planner::Lattice => v1::FlightPlanner::Lattice,
    };
    v1::PlanFlightRequest {
        source: None,
        start: args.start.as_ref().map(vector),
        goal: Some(vector(&args.goal)),
        region: corners.map(|(low, high)| v1::Box3 { min: Some(vector(low)), max: Some(vector(high)) }),
        options: Some(v1::FlightOptions {
            planner: planner.into(),
            robot_radius_m: args.radius,
            allow_unknown: args.allow_unknown,
            min_z_m: args.min_z,
            max_z_m: args.max_z,
            deadline_ms: args.deadline_ms,
            ..Default::default()
        }),
    }
}

fn on_file(args: &FlyArgs, file: &Path) -> Result<v1::PlanFlightResponse, Failure> {
    let map = octomap::decode(&read_file(file, &FileLimits::default())?, &FileLimits::default())?;
    let mut asked = convert::flight(&request(args))?;
    asked.params.max_voxels = MAX_VOXELS;
    let voxels = voxels_of(&map, asked.region.as_ref())?;
    let begun = Instant::now();
    let stop = asked.deadline.map(|deadline: Duration| move || begun.elapsed() >= deadline);
    let start = asked.start.ok_or("a path through a map file needs a --start")?;
    let request = FlightRequest {
        planner: asked.planner,
        stop: stop.as_ref().map(|stop| stop as &(dyn Fn() -> bool + Sync)),
        ..FlightRequest::new(start, asked.goal, &asked.params)
    };
    let outcome = plan_flight(&voxels, &request)?;
    // A file has no versions.
    Ok(convert::flown_to(&Explored { outcome: Some(outcome), map_version: 0, stamp: Timestamp::default() }))
}

/// The voxels of an octree within a box, or all that it knows.
fn voxels_of(map: &OctreeMap, region: Option<&Aabb3>) -> Result<DenseVoxels, Failure> {
    let edge = map.resolution_m();
    let mut around = Aabb3::empty();
    for leaf in map.leaves() {
        let low = leaf.lowest_voxel();
        let corner = |by: f64| Point3::new(f64::from(low.x) + by, f64::from(low.y) + by, f64::from(low.z) + by) * edge;
        // A little less, so that what only touches the next voxel is not in it.
        around.grow(&corner(1e-6));
        around.grow(&corner(f64::from(leaf.edge_voxels()) - 1e-6));
    }
    if around.is_empty() {
        return Err(FormatError::Missing { format: "OctoMap", field: "leaves" }.into());
    }
    let mut out = DenseVoxels::unknown(edge, region.unwrap_or(&around), MAX_VOXELS)?;
    let (low, size) = (out.low, out.size);
    for leaf in map.leaves() {
        let percent = (100.0 / (1.0 + (-f64::from(leaf.log_odds)).exp())).round() as i8;
        let at = leaf.lowest_voxel();
        let along = |at: i32, low: i32, size: usize| {
            let (from, to) = (i64::from(at), i64::from(at) + i64::from(leaf.edge_voxels()));
            // Numbers of voxels are those of 16 bits, the box's of 32.
            (from.max(i64::from(low)) as i32)..(to.min(i64::from(low) + size as i64) as i32)
        };
        for z in along(at.z, low.z, size[2]) {
            for y in along(at.y, low.y, size[1]) {
                for x in along(at.x, low.x, size[0]) {
                    if let Some(index) = out.index(Voxel::new(x, y, z)) {
                        out.percent[index] = percent;
                    }
                }
            }
        }
    }
    Ok(out)
}

async fn on_server(args: &FlyArgs) -> Result<v1::PlanFlightResponse, Failure> {
    let channel = connect(args.server.as_deref().unwrap_or_default(), &args.access).await?;
    let session = RemoteSession { channel, id: args.session.clone().unwrap_or_default() };
    let request = v1::PlanFlightRequest { source: Some(session.source()), ..request(args) };
    answered(NavigationServiceClient::new(session.channel.clone()).plan_flight(request).await)
}

fn tell(path: &v1::FlightPath) {
    println!("{:>10}  {:.2} m, {} corners", "path", path.length_m, path.waypoints.len());
    match path.min_clearance_m {
        Some(least) => println!("{:>10}  never nearer than {least:.2} m to an obstacle", "clearance"),
        None => println!("{:>10}  no obstacle near", "clearance"),
    }
    if !path.is_final {
        println!(
            "{:>10}  the search was ended before it was done; over voxels this is at most {:.2} times as long as need be",
            "not final", path.bound
        );
    }
}

fn words_of(none: &v1::NoFlight) -> String {
    let name = none.reason().as_str_name().trim_start_matches("NO_PATH_REASON_").to_lowercase();
    let mut words = format!("no path: {} ({name})", none.detail);
    if let Some(p) = none.obstacle.as_ref() {
        let state = none.state().as_str_name().trim_start_matches("BLOCKING_STATE_").to_lowercase();
        let _ =
            write!(words, "; blocked at ({:.2}, {:.2}, {:.2}), which is {}", p.x, p.y, p.z, state.replace('_', " "));
    }
    words
}

fn csv(path: &v1::FlightPath) -> String {
    let mut out = "x_m,y_m,z_m\n".to_owned();
    for p in &path.waypoints {
        let _ = writeln!(out, "{},{},{}", p.x, p.y, p.z);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_formats::OctreeLeaf;

    #[test]
    fn leaves_of_any_size_fill_their_voxels_and_no_others() {
        let voxel = |x, y, z, log_odds| OctreeLeaf::of_voxel(Voxel::new(x, y, z), log_odds).unwrap();
        let large = OctreeLeaf { depth: 14, ..voxel(-4, 0, 4, -2.0) };
        let map = OctreeMap::new(0.5, vec![large, voxel(1, 1, 1, 0.85)]).unwrap();
        let voxels = voxels_of(&map, None).unwrap();
        assert_eq!((voxels.low, voxels.size), (Voxel::new(-4, 0, 1), [6, 4, 7]));
        let of = |value| voxels.percent.iter().filter(|v| **v == value).count();
        assert_eq!((of(12), of(70), of(-1)), (64, 1, 6 * 4 * 7 - 65));
        let part = Aabb3 { min: Point3::new(-1.9, 0.1, 2.1), max: Point3::new(-1.1, 0.4, 2.4) };
        let voxels = voxels_of(&map, Some(&part)).unwrap();
        assert_eq!((voxels.size, voxels.percent), ([2, 1, 1], vec![12, 12]));
        assert!(voxels_of(&OctreeMap::new(0.5, vec![]).unwrap(), None).is_err());
    }
}
