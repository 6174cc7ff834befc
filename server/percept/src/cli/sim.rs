//! `percept sim`: a simulated robot that streams its sensors into a server.

use super::client::{AccessArgs, RemoteSession, connect};
use super::{Failure, files, input};
use percept_sim::{SensorSuite, SimParams, Simulation, WorldParams};
use serde_json::json;
use std::path::PathBuf;
use std::time::{Duration, Instant};

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Suite {
    /// Depth camera with colour, planar lidar, wheels.
    Default,
    /// Everything: camera, both lidars, wheels, IMU.
    All,
    /// Depth camera alone.
    Camera,
    /// Camera without depth alone.
    Images,
    /// Camera without depth, and wheels.
    ImagesWheels,
    /// 3D lidar alone.
    Lidar3d,
    /// Planar lidar alone.
    Lidar2d,
}

#[derive(Debug, clap::Args)]
pub(crate) struct SimArgs {
    /// gRPC address of the server.
    #[arg(long, default_value = "http://127.0.0.1:50051")]
    server: String,
    #[command(flatten)]
    access: AccessArgs,
    /// Id of the session; none: one is chosen.
    #[arg(long, default_value = "")]
    session: String,
    /// Stream into this session, which exists.
    #[arg(long, value_name = "SESSION", conflicts_with = "session")]
    into: Option<String>,
    /// World and noise; the same seed gives the same bytes.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Rooms of the world, 1 to 256.
    #[arg(long, default_value_t = 4)]
    rooms: usize,
    /// Laps through all rooms.
    #[arg(long, default_value_t = 1)]
    laps: usize,
    /// What the robot carries.
    #[arg(long, value_enum, default_value = "default")]
    sensors: Suite,
    /// Stop after so many seconds of driving.
    #[arg(long)]
    duration_s: Option<f64>,
    /// Send at the pace of a real robot instead of as fast as the server takes it.
    #[arg(long)]
    realtime: bool,
    /// Write the truth (trajectory in the map frame, objects) to this JSON file.
    #[arg(long)]
    truth: Option<PathBuf>,
}

pub(crate) fn run(args: SimArgs) -> Result<(), Failure> {
    let sensors = match args.sensors {
        Suite::Default => SensorSuite::default(),
        Suite::All => SensorSuite::all(),
        Suite::Camera => SensorSuite::only_depth_camera(),
        Suite::Images => SensorSuite::only_camera(),
        Suite::ImagesWheels => SensorSuite { odometry: SensorSuite::all().odometry, ..SensorSuite::only_camera() },
        Suite::Lidar3d => SensorSuite::only_lidar3d(),
        Suite::Lidar2d => SensorSuite::only_lidar2d(),
    };
    let params = SimParams {
        world: WorldParams { seed: args.seed, rooms: args.rooms, ..WorldParams::default() },
        sensors,
        seed: args.seed,
        laps: args.laps,
        duration_s: args.duration_s,
        ..SimParams::default()
    };
    let simulation = Simulation::new(params)?;
    if let Some(path) = &args.truth {
        files::write(path, serde_json::to_vec_pretty(&truth(&simulation))?)?;
    }
    let runtime = super::serve::runtime()?;
    runtime.block_on(drive(&args, &simulation))
}

fn truth(simulation: &Simulation) -> serde_json::Value {
    let t_map_world = simulation.t_world_start().inverse();
    let pose = |t: &percept_geometry::Pose| {
        let v = t.translation.vector;
        json!({"translation": [v.x, v.y, v.z], "rotation_xyzw": percept_geometry::se3::quaternion_xyzw(t)})
    };
    let trajectory: Vec<_> = simulation
        .truth(10.0)
        .iter()
        .map(|p| json!({"stamp_ns": p.stamp.nanos(), "t_map_base": pose(&(t_map_world * p.value))}))
        .collect();
    let start = simulation.params().start_stamp;
    let objects: Vec<_> = simulation
        .objects_at(start)
        .iter()
        .map(|o| {
            let b = o.bbox.transformed(&t_map_world);
            json!({"id": o.id, "class": o.class.name(), "moving": o.moving,
                   "t_map_box": pose(&b.t_frame_box), "size_m": [b.size.x, b.size.y, b.size.z]})
        })
        .collect();
    json!({"trajectory": trajectory, "objects": objects})
}

async fn drive(args: &SimArgs, simulation: &Simulation) -> Result<(), Failure> {
    let channel = connect(&args.server, &args.access).await?;
    let session = match &args.into {
        Some(id) => RemoteSession::join(channel, id, &simulation.sensors()).await?,
        None => RemoteSession::create(channel, &args.session, "simulated robot", &simulation.sensors(), None).await?,
    };
    println!("session {} on {}: driving {:.0} s", session.id, args.server, simulation.duration_s());
    let frames = simulation.frames();
    let bar = super::progress(frames.total(), "sim");
    let (start, first, realtime) = (Instant::now(), simulation.params().start_stamp, args.realtime);
    let paced = frames.map(move |f| {
        if realtime {
            let due = Duration::from_secs_f64(f.frame.stamp.seconds_since(first).max(0.0));
            std::thread::sleep(due.saturating_sub(start.elapsed()));
        }
        Ok::<_, Failure>(f.frame)
    });
    let outcome = session.stream(input::read_ahead_async(paced), |_| bar.inc(1)).await?;
    bar.finish_and_clear();
    for e in outcome.rejections.iter().take(5) {
        eprintln!("percept: frame refused: {} ({})", e.message, e.reason);
    }
    println!(
        "{} frames acknowledged, {} durable, {} refused",
        outcome.acknowledged,
        outcome.durable,
        outcome.rejections.len()
    );
    Ok(())
}
