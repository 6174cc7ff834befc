//! IMUs that something is the matter with: what the session says of them, and what becomes of the pose.

use crate::drive::empty;
use nalgebra::{UnitQuaternion, Vector3};
use percept_geometry::sensor::ImuSample;
use percept_geometry::{SensorData, SensorFrame, SensorId, SensorSpec, Timestamp};
use percept_pipeline::{ImuFault, Pipeline, PipelineParams};
use percept_sim::{
    HandheldParams, ImuParams, Lidar3dParams, RobotParams, SensorSuite, SimParams, Simulation, WorldParams,
};
use std::f64::consts::{FRAC_PI_2, PI};

/// A lidar in a hand that swings so far, radians, with an IMU.
fn hand(lidar: Lidar3dParams, swing_rad: f64, seconds: f64) -> Simulation {
    let sensors = SensorSuite { lidar3d: Some(lidar), imu: Some(ImuParams::default()), ..SensorSuite::none() };
    let handheld = Some(HandheldParams { swing_rad, ..HandheldParams::default() });
    let robot = RobotParams { handheld, look_around: false, ..RobotParams::default() };
    drive(sensors, robot, seconds)
}

/// A cart with a planar lidar, an IMU, and wheels or none.
fn cart(has_wheels: bool, seconds: f64) -> Simulation {
    let odometry = SensorSuite::default().odometry.filter(|_| has_wheels);
    let sensors = SensorSuite { imu: Some(ImuParams::default()), odometry, ..SensorSuite::only_lidar2d() };
    drive(sensors, RobotParams::default(), seconds)
}

fn drive(sensors: SensorSuite, robot: RobotParams, seconds: f64) -> Simulation {
    let world = WorldParams { seed: 5, rooms: 1, person: false, ..WorldParams::default() };
    let duration_s = Some(seconds);
    Simulation::new(SimParams { world, robot, sensors, duration_s, seed: 5, ..SimParams::default() }).unwrap()
}

/// What becomes of a sample on its way.
type Spoil = dyn Fn(Timestamp, ImuSample) -> Option<(Timestamp, ImuSample)>;

fn as_it_is(stamp: Timestamp, sample: ImuSample) -> Option<(Timestamp, ImuSample)> {
    Some((stamp, sample))
}

/// The session after a drive in which each IMU's samples were spoiled so.
fn driven(simulation: &Simulation, imus: &[(&str, &Spoil)]) -> Pipeline {
    let mut pipeline = empty(simulation, PipelineParams::default());
    let mount = simulation.sensors().into_iter().find(|s| s.id.0 == "imu").unwrap();
    for (name, _) in imus {
        pipeline.declare_sensor(SensorSpec { id: SensorId((*name).to_owned()), ..mount.clone() });
    }
    for timed in simulation.frames() {
        let SensorData::Imu(sample) = &timed.frame.data else {
            pipeline.process(&timed.frame).unwrap();
            continue;
        };
        for (name, spoil) in imus {
            let Some((stamp, sample)) = spoil(timed.frame.stamp, *sample) else { continue };
            let sensor = SensorId((*name).to_owned());
            pipeline.process(&SensorFrame { sensor, stamp, data: SensorData::Imu(sample) }).unwrap();
        }
    }
    pipeline
}

fn faults(pipeline: &Pipeline, imu: &str) -> Vec<ImuFault> {
    pipeline.snapshot().imu_faults.get(&SensorId(imu.to_owned())).cloned().unwrap_or_default()
}

/// Root mean square distance of the poses from the truth, metres.
fn off(simulation: &Simulation, pipeline: &Pipeline) -> f64 {
    let t_map_world = simulation.t_world_start().inverse();
    let snapshot = pipeline.snapshot();
    let squares: Vec<f64> = snapshot
        .trajectory()
        .map(|(t, e)| {
            (t.translation.vector - (t_map_world * simulation.pose_at(e.stamp)).translation.vector).norm_squared()
        })
        .collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

fn turned(sample: ImuSample, r: UnitQuaternion<f64>) -> ImuSample {
    let (angular_velocity, linear_acceleration) = (r * sample.angular_velocity, r * sample.linear_acceleration);
    ImuSample { angular_velocity, linear_acceleration }
}

#[test]
fn what_is_wrong_with_an_imu_in_the_hand_is_said() {
    let simulation = hand(Lidar3dParams { columns: 360, ..Lidar3dParams::default() }, 0.6, 14.0);
    let of = |spoil: &Spoil| faults(&driven(&simulation, &[("imu", spoil)]), "imu");
    assert_eq!(of(&as_it_is), []);
    let on_its_side = UnitQuaternion::from_scaled_axis(Vector3::x() * FRAC_PI_2);
    let told = of(&move |t, s| Some((t, turned(s, on_its_side))));
    let [ImuFault::TurnsAboutOtherAxes { angle_rad, axis }] = told[..] else { panic!("{told:?}") };
    // What turns the declared mount into the right one.
    assert!((axis * angle_rad + Vector3::x() * FRAC_PI_2).norm() < 0.1, "{told:?}");
    let told = of(&|t, s| Some((t, ImuSample { linear_acceleration: s.linear_acceleration / 9.81, ..s })));
    assert!(matches!(told[..], [ImuFault::ForceUnlikeGravity { mean }] if (mean - 1.0).abs() < 0.2), "{told:?}");
    let told = of(&|t, s| Some((t, ImuSample { angular_velocity: s.angular_velocity * 20.0, ..s })));
    assert!(matches!(told[..], [ImuFault::TurnsScaled { factor }] if (factor - 20.0).abs() < 2.0), "{told:?}");
    let told =
        of(&|t, _| Some((t, ImuSample { angular_velocity: Vector3::zeros(), linear_acceleration: Vector3::zeros() })));
    let is_nothing = |f: &ImuFault| match f {
        ImuFault::TurnsScaled { factor } => *factor < 0.1,
        ImuFault::ForceUnlikeGravity { mean } => *mean < 0.1,
        _ => false,
    };
    assert!(told.len() == 2 && told.iter().all(is_nothing), "{told:?}");
    let told = of(&|t, s| {
        let (angular_velocity, linear_acceleration) = (s.linear_acceleration, s.angular_velocity);
        Some((t, ImuSample { angular_velocity, linear_acceleration }))
    });
    assert!(told.iter().any(|f| matches!(f, ImuFault::ForceUnlikeGravity { .. })) && told.len() == 2, "{told:?}");
    // Samples 0.12 s apart.
    let told = of(&|t, s| (t.nanos() / 10_000_000 % 12 == 0).then_some((t, s)));
    assert!(matches!(told[..], [ImuFault::Uncovered { .. }]), "{told:?}");
    // They come half a second after the frames that need them.
    let told = of(&|t, s| Some((t.plus_seconds(-2.5), s)));
    assert!(matches!(told[..], [ImuFault::Uncovered { behind_s }] if behind_s > 2.0), "{told:?}");
}

#[test]
fn of_two_imus_the_one_that_is_right_is_used_whatever_its_name() {
    // So quick that without an IMU the turns of a sweep are followed badly.
    let simulation = hand(Lidar3dParams { columns: 360, ..Lidar3dParams::default() }, 2.6, 20.0);
    let without = off(&simulation, &driven(&simulation, &[]));
    let with = off(&simulation, &driven(&simulation, &[("imu", &as_it_is)]));
    let on_its_side = UnitQuaternion::from_scaled_axis(Vector3::x() * FRAC_PI_2);
    let wrong = move |t: Timestamp, s: ImuSample| Some((t, turned(s, on_its_side)));
    let both = driven(&simulation, &[("a_wrong_one", &wrong), ("imu", &as_it_is)]);
    let told = (faults(&both, "a_wrong_one"), faults(&both, "imu"));
    assert!(!told.0.is_empty() && told.1.is_empty(), "{told:?}");
    let both = off(&simulation, &both);
    println!("wrong {}", off(&simulation, &driven(&simulation, &[("imu", &wrong)])));
    println!("{with} with the right one, {without} with none, {both} with both");
    // It has to prove itself first, so that a part is left of what no IMU leaves.
    assert!(both < without, "{with} with the right one, {without} with none, {both} with both");
}

#[test]
fn on_a_cart_a_gyro_mounted_otherwise_is_said_and_does_no_harm_beside_wheels() {
    for has_wheels in [false, true] {
        let simulation = cart(has_wheels, 20.0);
        let right = driven(&simulation, &[("imu", &as_it_is)]);
        assert_eq!(faults(&right, "imu"), [], "wheels: {has_wheels}");
        for r in [Vector3::y() * FRAC_PI_2, Vector3::x() * PI] {
            let r = UnitQuaternion::from_scaled_axis(r);
            let wrong = driven(&simulation, &[("imu", &move |t, s| Some((t, turned(s, r))))]);
            let told = faults(&wrong, "imu");
            let [ImuFault::TurnsAboutOtherAxes { angle_rad, .. }] = told[..] else {
                panic!("wheels: {has_wheels}: {told:?}");
            };
            assert!((angle_rad - r.angle()).abs() < 0.1, "wheels: {has_wheels}: {told:?}");
            let (right, wrong) = (off(&simulation, &right), off(&simulation, &wrong));
            assert!(wrong < 1.5 * right + 0.01, "wheels: {has_wheels}: {wrong}, with the right one {right}");
        }
    }
}
