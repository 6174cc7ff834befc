//! Lidars of the simulator: `lidar-sim PATTERN [seconds=S] [seed=S] [hand=SWING] [rooms=N] [...]`, and
//! `planar-sim [seconds=S] [seed=S] [rooms=N] [speed=V] [turn=W] [frozen=1]`, whose beams are taken while the robot moves on.

use super::{Run, measure, read::Failure};
use nalgebra::Point3;
use percept_geometry::{Pose, SensorData};
use percept_sim::{
    HandheldParams, Lidar2dParams, Lidar3dParams, RobotParams, ScanPattern, SensorSuite, SimParams, Simulation,
    WorldParams,
};
use percept_slam::{CloudScan, KeyframeParams, OdometryKind, PlanarScan, Scan, keyframe::keyframe_scan};
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
    measure::drift(&truth, &estimate);
    measure::consistency(&truth, &run.estimates);
    Ok(())
}

/// A planar lidar alone: errors of the trajectory, and how far the ends of beams that keyframes keep are from the surface in
/// their direction, beside the same of scans as they came.
pub(crate) fn planar(args: &[String]) -> Result<(), Failure> {
    let value = |name, default| option(args, name).unwrap_or(default);
    let lidar2d = Lidar2dParams { motion_distortion: option(args, "frozen").is_none(), ..Lidar2dParams::default() };
    let simulation = Simulation::new(SimParams {
        world: WorldParams {
            seed: value("seed", 1.0) as u64,
            rooms: value("rooms", 4.0) as usize,
            person: false,
            ..WorldParams::default()
        },
        robot: RobotParams {
            speed_m_per_s: value("speed", 1.0),
            turn_rate_rad_per_s: value("turn", std::f64::consts::FRAC_PI_2),
            ..RobotParams::default()
        },
        sensors: SensorSuite { lidar2d: Some(lidar2d), ..SensorSuite::none() },
        duration_s: Some(value("seconds", 60.0)),
        ..SimParams::default()
    })?;
    let t_base_sensor = simulation.sensors().first().map_or_else(Pose::identity, |s| s.t_base_sensor);
    let mut run = Run::new(OdometryKind::Lidar2d);
    let (mut truth, mut kept_off, mut raw_off) = (vec![], vec![], vec![]);
    for frame in simulation.frames() {
        let SensorData::Scan(laser) = frame.frame.data else { continue };
        let scan = Scan::Planar(PlanarScan { scan: Arc::new(laser), t_base_sensor });
        let (stamp, sensor) = (frame.frame.stamp, frame.frame.sensor);
        run.step(stamp, &scan, None);
        truth.push(frame.t_world_base);
        let t_world_sensor = frame.t_world_base * t_base_sensor;
        let origin = Point3::from(t_world_sensor.translation.vector);
        let off = |p: &Point3<f32>| {
            let end = frame.t_world_base * p.cast::<f64>() - origin;
            let hit = simulation.world().cast(&origin, &end.normalize(), frame.measured_s, 20.0)?;
            Some((hit.distance - end.norm()).abs())
        };
        let kept = run.odometry.keyframe_scan(stamp, &sensor, &scan);
        kept_off.extend(kept.hits.positions.iter().filter_map(off));
        let still = nalgebra::Vector6::zeros();
        let raw = keyframe_scan(&KeyframeParams::default(), stamp, &sensor, &scan, &still);
        raw_off.extend(raw.hits.positions.iter().filter_map(off));
    }
    let estimate: Vec<Pose> = run.estimates.iter().map(|e| e.t_odom_base).collect();
    run.report();
    measure::report(&truth, &estimate);
    measure::drift(&truth, &estimate);
    measure::consistency(&truth, &run.estimates);
    for (name, mut off) in [("kept", kept_off), ("as they came", raw_off)] {
        off.sort_by(f64::total_cmp);
        let at = |share: f64| off.get((off.len() as f64 * share) as usize).copied().unwrap_or(0.0);
        println!("ends of beams, {name}: off by {:.4} m (p50), {:.4} (p90), {:.4} (p99)", at(0.5), at(0.9), at(0.99));
    }
    Ok(())
}
