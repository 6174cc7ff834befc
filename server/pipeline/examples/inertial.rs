//! Figures of a pipeline with an IMU and without one: `inertial CASE [name=value ...]`.
//!
//! Cases: `spinning`, `rosette`, `rgbd` (carried by hand with quick turns, up to 180 degrees a second), `corridor` (a spinning
//! lidar on wheels that say nothing, 60 m without features), `corridor-rosette`, `corridor-rgbd`, `planar` (a planar lidar
//! whose beams are taken one after the other, on a robot that turns abruptly: `turn`, rad/s, and `accel`, rad/s2).
//! Values: `seed`, `seconds`, `imu` (0 leaves it out), `rate` (of the IMU, Hz), `swing` (rad), `rooms`, `speed`, and
//! `wrong` (`gaps`, `saturated`, `mount`, `late`, `jump`, `g`: what is the matter with the IMU).

use nalgebra::{UnitQuaternion, Vector3};
use percept_evaluation::{Alignment, PosePair, absolute_error};
use percept_geometry::{SensorData, SensorFrame};
use percept_pipeline::{Pipeline, PipelineParams};
use percept_sim::{HandheldParams, ImuParams, MainSensor, Pause, Scenario, SimParams, Simulation};
use std::time::Instant;

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let case = args.first().ok_or("usage: inertial CASE [name=value ...]")?;
    let text = |name: &str| args.iter().find_map(|a| a.strip_prefix(name)?.strip_prefix('='));
    let value = |name: &str, default: f64| text(name).and_then(|v| v.parse().ok()).unwrap_or(default);
    let simulation = Simulation::new(session(case, &value)?)?;
    let t_start_world = simulation.t_world_start().inverse();
    let mut pipeline = Pipeline::new(PipelineParams::default())?;
    simulation.sensors().into_iter().for_each(|s| pipeline.declare_sensor(s));
    let (mut odom, mut online, mut ms, mut tracked) = (vec![], vec![], vec![], 0);
    let (mut truths, mut worst_along) = (std::collections::BTreeMap::new(), 0.0f64);
    for sim in simulation.frames() {
        let truth = t_start_world * sim.t_world_base;
        let Some(frame) = spoilt(sim.frame, sim.measured_s, text("wrong").unwrap_or("")) else { continue };
        let begun = Instant::now();
        let report = pipeline.process(&frame)?;
        let Some(pose) = report.pose else { continue };
        ms.push(begun.elapsed().as_secs_f64() * 1e3);
        tracked += usize::from(!pose.state.is_lost());
        truths.insert(pose.stamp, truth);
        odom.push(PosePair { stamp: pose.stamp, reference: truth, estimate: pose.t_odom_base });
        online.push(PosePair { stamp: pose.stamp, reference: truth, estimate: pose.t_map_base });
        let first = &odom[0];
        let off = first.reference.inv_mul(&truth).inv_mul(&first.estimate.inv_mul(&pose.t_odom_base));
        worst_along = worst_along.max(off.translation.vector.norm());
        if text("csv").is_some() {
            let (e, r) = (off.translation.vector, off.rotation.scaled_axis());
            let sigma = |k: usize| pose.covariance[(k, k)].sqrt();
            println!(
                "{:.2}, {:.4}, {:.4}, {:.4}, {:.4}, {:.4}, {:.4}, {:?}, {:.4}, {:.4}, {:?}",
                sim.measured_s,
                e.x,
                e.y,
                e.z,
                r.x,
                r.y,
                r.z,
                pose.state,
                sigma(0),
                sigma(5),
                pose.degenerate_axes
            );
        }
    }
    pipeline.settle();
    let snapshot = pipeline.snapshot();
    let corrected: Vec<PosePair> = snapshot
        .trajectory()
        .filter(|(_, entry)| entry.tracked)
        .filter_map(|(estimate, entry)| {
            let reference = *truths.get(&entry.stamp)?;
            Some(PosePair { stamp: entry.stamp, reference, estimate })
        })
        .collect();
    ms.sort_by(f64::total_cmp);
    let at = |q: f64| ms.get((ms.len().saturating_sub(1) as f64 * q) as usize).copied().unwrap_or(0.0);
    println!(
        "{} tracked {tracked}/{}  odometry ATE {:.4} m, online {:.4}, corrected {:.4}; from the start off by {:.3} m at most; \
         ms p50 {:.1} p99 {:.1}",
        args.join(" "),
        odom.len(),
        ate(&odom)?,
        ate(&online)?,
        ate(&corrected)?,
        worst_along,
        at(0.5),
        at(0.99)
    );
    Ok(())
}

fn ate(pairs: &[PosePair]) -> Result<f64, Failure> {
    Ok(absolute_error(pairs, Alignment::Se3)?.translation_m.rmse)
}

fn session(case: &str, value: &impl Fn(&str, f64) -> f64) -> Result<SimParams, Failure> {
    let (seed, rooms) = (value("seed", 1.0) as u64, value("rooms", 2.0) as usize);
    let (sensor, seconds) = match case {
        "spinning" => (MainSensor::Lidar3d, 300.0),
        "rosette" => (MainSensor::Rosette, 300.0),
        "rgbd" => (MainSensor::Rgbd, 60.0),
        "corridor" => (MainSensor::Lidar3d, 130.0),
        "corridor-rosette" => (MainSensor::Rosette, 130.0),
        "corridor-rgbd" => (MainSensor::Rgbd, 130.0),
        "planar" => (MainSensor::Lidar2d, 300.0),
        "corridor-planar" => (MainSensor::Lidar2d, 130.0),
        other => return Err(format!("unknown case {other}").into()),
    };
    let scenario = if case.starts_with("corridor") { Scenario::Corridor } else { Scenario::Loops };
    let mut params = scenario.params(sensor, rooms, value("seconds", seconds), seed)?;
    params.sensors.odometry = None;
    params.sensors.imu =
        (value("imu", 1.0) > 0.0).then(|| ImuParams { rate_hz: value("rate", 200.0), ..ImuParams::default() });
    if let Some(lidar) = &mut params.sensors.lidar3d {
        lidar.columns = value("columns", lidar.columns as f64) as usize;
        lidar.rosette_points = value("points", lidar.rosette_points as f64) as usize;
    }
    if let Some(lidar) = params.sensors.lidar2d.as_mut().filter(|_| case == "planar") {
        lidar.motion_distortion = true;
    }
    params.robot.speed_m_per_s = value("speed", 0.6);
    // Sessions begin at rest; a robot that drives off with its first frame is what simulators make.
    params.disturbances.pauses = vec![Pause { at_s: 0.0, lasts_s: value("rest", 3.0) }];
    if case == "planar" {
        params.robot.turn_rate_rad_per_s = value("turn", 2.5);
        params.robot.turn_acceleration_rad_per_s2 = value("accel", 8.0);
    } else if scenario == Scenario::Loops {
        // Swung at 0.37 Hz: 1.3 rad make 3 rad/s, and the walker's own turning comes on top.
        let hand = HandheldParams { swing_rad: value("swing", 1.3), ..HandheldParams::default() };
        params.robot.handheld = Some(hand);
        params.robot.look_around = false;
    }
    Ok(params)
}

/// A message of the IMU with what is `wrong`; others as they are. None is one that gets lost.
fn spoilt(mut frame: SensorFrame, t_s: f64, wrong: &str) -> Option<SensorFrame> {
    let SensorData::Imu(sample) = &mut frame.data else { return Some(frame) };
    match wrong {
        // A third of a second in every five.
        "gaps" if t_s % 5.0 > 4.7 => return None,
        // A cheap sensor's range.
        "saturated" => {
            sample.angular_velocity = sample.angular_velocity.map(|w| w.clamp(-2.0, 2.0));
            sample.linear_acceleration = sample.linear_acceleration.map(|a| a.clamp(-11.0, 11.0));
        }
        "mount" => {
            let r = UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2);
            (sample.angular_velocity, sample.linear_acceleration) =
                (r * sample.angular_velocity, r * sample.linear_acceleration);
        }
        "tilt" => {
            let r = UnitQuaternion::from_euler_angles(0.15, 0.1, -0.1);
            (sample.angular_velocity, sample.linear_acceleration) =
                (r * sample.angular_velocity, r * sample.linear_acceleration);
        }
        "late" => frame.stamp = frame.stamp.plus_seconds(0.1),
        "jump" if t_s > 20.0 => {
            sample.angular_velocity += Vector3::new(0.05, -0.03, 0.04);
            sample.linear_acceleration += Vector3::new(0.5, 0.3, -0.4);
        }
        "g" => sample.linear_acceleration /= 9.81,
        _ => {}
    }
    Some(frame)
}
