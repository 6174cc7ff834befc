//! 3D lidars of the simulator: `lidar-sim PATTERN [seconds=S] [seed=S] [hand=SWING] [rooms=N] [...]`.

use super::{Run, measure, read::Failure};
use percept_geometry::{Pose, SensorData};
use percept_sim::{
    HandheldParams, Lidar3dParams, RobotParams, ScanPattern, SensorSuite, SimParams, Simulation, WorldParams,
};
use percept_slam::{CloudScan, OdometryKind, Scan};
use std::sync::Arc;

/// `name=value` among the arguments.
fn option(args: &[String], name: &str) -> Option<f64> {
    args.iter().find_map(|a| a.strip_prefix(name)?.strip_prefix('=')?.parse().ok())
}

pub(crate) fn simulation(args: &[String]) -> Result<Simulation, Failure> {
    let pattern = args.first().map_or("spinning", String::as_str);
    let value = |name, default| option(args, name).unwrap_or(default);
    let lidar = Lidar3dParams {
        pattern: if pattern == "rosette" { ScanPattern::Rosette } else { ScanPattern::Spinning },
        rings: value("rings", 16.0) as usize,
        columns: value("columns", 900.0) as usize,
        rosette_points: value("points", 20_000.0) as usize,
        rosette_half_angle_rad: value("half_angle", 0.6),
        motion_distortion: option(args, "frozen").is_none(),
        range_noise_m: value("noise", 0.02),
        ..Lidar3dParams::default()
    };
    let handheld = option(args, "hand").map(|swing_rad| HandheldParams {
        swing_rad,
        tilt_rad: value("tilt", 0.2),
        ..HandheldParams::default()
    });
    Ok(Simulation::new(SimParams {
        world: WorldParams {
            seed: value("seed", 1.0) as u64,
            rooms: value("rooms", 4.0) as usize,
            room_min_m: value("room", 4.4),
            room_max_m: value("room", 4.4).max(6.0),
            corridor_m: option(args, "corridor"),
            ..WorldParams::default()
        },
        robot: RobotParams { speed_m_per_s: value("speed", 0.6), handheld, ..RobotParams::default() },
        sensors: SensorSuite { lidar3d: Some(lidar), ..SensorSuite::none() },
        duration_s: Some(value("seconds", 60.0)),
        ..SimParams::default()
    })?)
}

pub(crate) fn lidar(args: &[String]) -> Result<(), Failure> {
    let simulation = simulation(args)?;
    let t_base_sensor = simulation.sensors().first().map_or_else(Pose::identity, |s| s.t_base_sensor);
    let mut run = Run::new(OdometryKind::Lidar3d);
    if let Some(size) = option(args, "size") {
        let mut params = percept_slam::OdometryParams::default();
        params.lidar3d.voxel_size_m = Some(size);
        run.odometry = percept_slam::Odometry::new(OdometryKind::Lidar3d, params);
    }
    let mut truth = vec![];
    for frame in simulation.frames() {
        let SensorData::Cloud(mut cloud) = frame.frame.data else { continue };
        if args.iter().any(|a| a == "--no-times") {
            cloud.time_offsets_s = None;
        }
        let scan = Scan::Cloud(CloudScan { cloud: Arc::new(cloud), t_base_sensor });
        run.step(frame.frame.stamp, &scan, None);
        truth.push(frame.t_world_base);
        if let (Some(t), Some(e), true) = (truth.last(), run.estimates.last(), std::env::var_os("VERBOSE").is_some()) {
            let d = (truth[0].inverse() * t).inverse() * e.t_odom_base;
            let r = d.rotation.scaled_axis().map(f64::to_degrees);
            let p = t.translation.vector;
            println!(
                "   off {:.3} m {:.3} deg rpy {:.3} {:.3} {:.3} xyz {:.3} {:.3} {:.3} at {:.2} {:.2} {:.0}",
                d.translation.vector.norm(),
                d.rotation.angle().to_degrees(),
                r.x,
                r.y,
                r.z,
                d.translation.x,
                d.translation.y,
                d.translation.z,
                p.x,
                p.y,
                t.rotation.euler_angles().2.to_degrees()
            );
        }
    }
    let estimate: Vec<Pose> = run.estimates.iter().map(|e| e.t_odom_base).collect();
    run.report();
    measure::report(&truth, &estimate);
    measure::consistency(&truth, &run.estimates);
    Ok(())
}
