//! Lidars with an IMU: quick turns, open directions, and IMUs that something is the matter with.

use nalgebra::{UnitQuaternion, Vector3};
use percept_geometry::sensor::ImuSample;
use percept_geometry::{Pose, SensorData, Timestamp};
use percept_sim::{
    Disturbances, HandheldParams, ImuParams, Lidar3dParams, Pause, RobotParams, ScanPattern, SensorSuite, SimParams,
    Simulation, WorldParams,
};
use percept_slam::{CloudScan, ImuBuffer, Odometry, OdometryKind, OdometryParams, Scan};
use std::collections::VecDeque;
use std::sync::Arc;

/// A lidar in the hand that turns by up to 180 degrees a second, after two seconds of rest.
fn session(lidar: Lidar3dParams, seconds: f64) -> Simulation {
    let hand = HandheldParams { swing_rad: 1.3, ..HandheldParams::default() };
    Simulation::new(SimParams {
        world: WorldParams { rooms: 2, ..WorldParams::default() },
        robot: RobotParams { handheld: Some(hand), look_around: false, ..RobotParams::default() },
        sensors: SensorSuite { lidar3d: Some(lidar), imu: Some(ImuParams::default()), ..SensorSuite::none() },
        disturbances: Disturbances { pauses: vec![Pause { at_s: 0.0, lasts_s: 2.0 }], ..Disturbances::default() },
        duration_s: Some(seconds),
        ..SimParams::default()
    })
    .unwrap()
}

fn spinning() -> Lidar3dParams {
    Lidar3dParams { columns: 360, ..Lidar3dParams::default() }
}

fn rosette() -> Lidar3dParams {
    Lidar3dParams { pattern: ScanPattern::Rosette, ..Lidar3dParams::default() }
}

/// What becomes of a sample on its way; none is lost.
type Spoil = dyn Fn(f64, Timestamp, ImuSample) -> Option<(Timestamp, ImuSample)>;

/// How far each pose is off from the truth, seen from the first, metres; and the share of frames that were placed.
fn followed(simulation: &Simulation, imu: Option<&Spoil>) -> (Vec<f64>, f64) {
    followed_over_a_restart(simulation, imu, f64::MAX)
}

/// The same; at a time nothing is left but the newest keyframes and where the robot was.
fn followed_over_a_restart(simulation: &Simulation, imu: Option<&Spoil>, restart_s: f64) -> (Vec<f64>, f64) {
    let sensors = simulation.sensors();
    let mount = |id: &str| sensors.iter().find(|s| s.id.0 == id).unwrap().t_base_sensor;
    let (mut buffer, mut odometry) =
        (ImuBuffer::default(), Odometry::new(OdometryKind::Lidar3d, OdometryParams::default()));
    let (mut off, mut placed, mut last, start) = (vec![], 0, None, simulation.t_world_start());
    let (mut kept, mut runs) = (VecDeque::new(), true);
    for f in simulation.frames() {
        if let Some(last) = last.filter(|_| runs && f.measured_s > restart_s) {
            let t_odom_base = *odometry.t_odom_base();
            (buffer, odometry) =
                (ImuBuffer::default(), Odometry::new(OdometryKind::Lidar3d, OdometryParams::default()));
            odometry.seed(&t_odom_base, kept.make_contiguous(), last);
            runs = false;
        }
        match f.frame.data {
            SensorData::Imu(sample) => {
                if let Some((stamp, sample)) = imu.and_then(|spoil| spoil(f.measured_s, f.frame.stamp, sample)) {
                    buffer.push(stamp, &sample, &mount("imu"));
                }
            }
            SensorData::Cloud(cloud) => {
                let scan = Scan::Cloud(CloudScan { cloud: Arc::new(cloud), t_base_sensor: mount("lidar") });
                let prior = last.and_then(|last| buffer.between(last, f.frame.stamp));
                let before = *odometry.t_odom_base();
                let e = odometry.register_with_imu(f.frame.stamp, &scan, prior.as_ref(), imu.map(|_| &buffer));
                if let Some(last) = last.filter(|_| e.state.is_tracking()) {
                    buffer.learn(last, f.frame.stamp, &(before.rotation.inverse() * e.t_odom_base.rotation), false);
                }
                last = Some(f.frame.stamp);
                if off.len() % 4 == 0 {
                    let seen = odometry.keyframe_scan(f.frame.stamp, &f.frame.sensor, &scan);
                    kept.push_back((e.t_odom_base, Arc::new(seen)));
                    kept.drain(..kept.len().saturating_sub(20));
                }
                placed += usize::from(!e.state.is_lost());
                off.push((start.inverse() * f.t_world_base).inv_mul(&e.t_odom_base).translation.vector.norm());
            }
            _ => {}
        }
    }
    let share = placed as f64 / off.len() as f64;
    (off, share)
}

fn rms(off: &[f64]) -> f64 {
    (off.iter().map(|o| o * o).sum::<f64>() / off.len() as f64).sqrt()
}

fn as_it_is(_: f64, stamp: Timestamp, sample: ImuSample) -> Option<(Timestamp, ImuSample)> {
    Some((stamp, sample))
}

#[test]
fn quick_turns_of_a_narrow_view_are_followed_with_an_imu_and_not_without() {
    let simulation = session(rosette(), 12.0);
    let (with, share) = followed(&simulation, Some(&as_it_is));
    let (without, _) = followed(&simulation, None);
    // Ranges good to 2 cm, a local map that starts with a narrow view: centimetres.
    assert!(rms(&with) < 0.06 && share == 1.0, "{}", rms(&with));
    assert!(rms(&without) > 2.0 * rms(&with), "{} without, {} with", rms(&without), rms(&with));
}

#[test]
fn after_a_restart_amid_quick_turns_an_imu_is_made_use_of_again() {
    let simulation = session(spinning(), 12.0);
    let (off, share) = followed_over_a_restart(&simulation, Some(&as_it_is), 6.0);
    // Velocity, biases and gravity are gone; a second later they are known again.
    assert!(rms(&off[70..]) < 0.06 && share == 1.0, "{}", rms(&off[70..]));
}

#[test]
fn an_imu_that_something_is_the_matter_with_does_no_harm() {
    let simulation = session(spinning(), 12.0);
    let (without, _) = followed(&simulation, None);
    let turned = |sample: ImuSample, r: UnitQuaternion<f64>| ImuSample {
        angular_velocity: r * sample.angular_velocity,
        linear_acceleration: r * sample.linear_acceleration,
    };
    let sideways = UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::FRAC_PI_2);
    let wrong: [(&str, Box<Spoil>); 6] = [
        ("mounted sideways", Box::new(move |_, t, s| Some((t, turned(s, sideways))))),
        (
            "in multiples of g",
            Box::new(|_, t, s| Some((t, ImuSample { linear_acceleration: s.linear_acceleration / 9.81, ..s }))),
        ),
        ("a third of a second missing", Box::new(|at, t, s| (at % 3.0 < 2.7).then_some((t, s)))),
        (
            "at the end of its range",
            Box::new(|_, t, s| {
                Some((t, ImuSample { angular_velocity: s.angular_velocity.map(|w| w.clamp(-1.5, 1.5)), ..s }))
            }),
        ),
        (
            "with biases that jump",
            Box::new(|at, t, s| {
                let (w, a) = if at > 6.0 {
                    (Vector3::new(0.1, -0.05, 0.1), Vector3::new(1.0, 0.5, -1.0))
                } else {
                    Default::default()
                };
                let (w, a) = (s.angular_velocity + w, s.linear_acceleration + a);
                Some((t, ImuSample { angular_velocity: w, linear_acceleration: a }))
            }),
        ),
        ("with a clock that is 0.1 s late", Box::new(|_, t, s| Some((t.plus_seconds(0.1), s)))),
    ];
    for (what, spoil) in &wrong {
        let (off, share) = followed(&simulation, Some(spoil.as_ref()));
        assert!(
            rms(&off) < 1.3 * rms(&without) + 0.01 && share == 1.0,
            "{what}: {} m, {} without",
            rms(&off),
            rms(&without)
        );
    }
}

#[test]
fn keyframes_hold_the_deskewed_sweep() {
    let simulation = session(spinning(), 8.0);
    let sensors = simulation.sensors();
    let (mut buffer, mut odometry) =
        (ImuBuffer::default(), Odometry::new(OdometryKind::Lidar3d, OdometryParams::default()));
    let (mut worst, mut count) = (0.0f64, 0);
    for f in simulation.frames() {
        let mount: Pose = sensors.iter().find(|s| s.id == f.frame.sensor).unwrap().t_base_sensor;
        match f.frame.data {
            SensorData::Imu(sample) => buffer.push(f.frame.stamp, &sample, &mount),
            SensorData::Cloud(cloud) => {
                let scan = Scan::Cloud(CloudScan { cloud: Arc::new(cloud), t_base_sensor: mount });
                odometry.register_with_imu(f.frame.stamp, &scan, None, Some(&buffer));
                if f.measured_s < 4.0 {
                    continue;
                }
                let kept = odometry.keyframe_scan(f.frame.stamp, &f.frame.sensor, &scan);
                let off = |p: &nalgebra::Point3<f32>| {
                    simulation.world().surface_distance_at(&(f.t_world_base * p.cast::<f64>()), f.measured_s)
                };
                let mut distances: Vec<f64> = kept.hits.positions.iter().map(off).collect();
                distances.sort_by(f64::total_cmp);
                worst = worst.max(distances[distances.len() * 9 / 10]);
                count += 1;
            }
            _ => {}
        }
    }
    // Nine of ten points within two standard deviations of the range; a turn of 3 rad/s smears a wall at 5 m by a metre.
    assert!(worst < 0.045 && count > 30, "{worst} in {count}");
}
