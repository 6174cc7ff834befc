//! What goes wrong goes wrong as told, and nothing else does.

use percept_geometry::{SensorData, SensorKind, se3};
use percept_sim::{
    Blackout, ClockJump, Disturbances, Kidnap, Lidar2dParams, MainSensor, OdometryParams, Pause, Scenario, SensorSuite,
    SimFrame, SimParams, Simulation,
};

/// A planar lidar and exact wheels.
fn simulation(disturbances: Disturbances, seconds: f64) -> Simulation {
    let exact = OdometryParams {
        distance_scale_sigma: 0.0,
        angle_scale_sigma: 0.0,
        distance_noise: 0.0,
        angle_noise: 0.0,
        angle_noise_per_distance: 0.0,
        ..OdometryParams::default()
    };
    let lidar = Lidar2dParams { beams: 16, ..Lidar2dParams::default() };
    let sensors = SensorSuite { odometry: Some(exact), lidar2d: Some(lidar), ..SensorSuite::none() };
    let params = SimParams { sensors, disturbances, duration_s: Some(seconds), ..crate::sim_params(2) };
    Simulation::new(params).unwrap()
}

fn of_kind(frames: &[SimFrame], kind: SensorKind) -> Vec<&SimFrame> {
    frames.iter().filter(|f| f.frame.data.kind() == kind).collect()
}

#[test]
fn a_kidnapped_robot_is_elsewhere_and_neither_wheels_nor_lidar_saw_the_way() {
    let kidnaps = vec![Kidnap { at_s: 10.0, carried_s: 4.0, ahead_s: 40.0 }];
    let sim = simulation(Disturbances { kidnaps, ..Disturbances::default() }, 20.0);
    let frames: Vec<SimFrame> = sim.frames().collect();
    let scans = of_kind(&frames, SensorKind::Lidar2d);
    let second = |f: &SimFrame| sim.seconds_at(f.frame.stamp);
    assert!(scans.iter().all(|f| second(f) < 10.0 || second(f) >= 14.0));
    assert_eq!(scans.len(), 160);
    let put_down = scans.iter().find(|f| second(f) >= 14.0).unwrap();
    assert_eq!(put_down.t_world_base, sim.path().pose_at(50.0));
    let wheels = of_kind(&frames, SensorKind::Odometry);
    let turned = |from: f64, to: f64| {
        let at = |s: f64| wheels.iter().find(|f| second(f) >= s - 1e-6).unwrap();
        let odom = |f: &SimFrame| match &f.frame.data {
            SensorData::Odometry(o) => o.t_odom_base,
            _ => panic!("wheels"),
        };
        (odom(at(from)).inverse() * odom(at(to)), at(from).t_world_base.inverse() * at(to).t_world_base)
    };
    let (carried, _) = turned(10.0, 14.0);
    assert!(se3::log(&carried).norm() < 1e-9);
    let (odom, truth) = turned(14.0, 19.0);
    assert!(truth.translation.vector.norm() > 0.1 || truth.rotation.angle() > 0.1);
    assert!(se3::log(&(odom.inverse() * truth)).norm() < 1e-6);
}

#[test]
fn a_pause_begins_at_a_stop_and_the_drive_goes_on_where_it_stood() {
    let pauses = vec![Pause { at_s: 5.0, lasts_s: 60.0 }];
    let sim = simulation(Disturbances { pauses, ..Disturbances::default() }, 200.0);
    let truth = sim.truth(10.0);
    let still = truth.windows(2).filter(|p| p[0].value == p[1].value).count();
    assert!((598..=602).contains(&still), "{still}");
    // No jump: the robot is never faster than 0.6 m/s.
    let fastest = truth.windows(2).map(|p| (p[1].value.translation.vector - p[0].value.translation.vector).norm());
    assert!(fastest.fold(0.0, f64::max) < 0.0601);
}

#[test]
fn in_the_dark_only_the_wheels_send() {
    let blackouts = vec![Blackout { at_s: 3.0, lasts_s: 5.0 }];
    let sim = simulation(Disturbances { blackouts, ..Disturbances::default() }, 10.0);
    let frames: Vec<SimFrame> = sim.frames().collect();
    assert_eq!(of_kind(&frames, SensorKind::Lidar2d).len(), 50);
    assert_eq!(of_kind(&frames, SensorKind::Odometry).len(), 200);
}

#[test]
fn a_set_clock_moves_stamps_and_not_the_robot() {
    let clock_jumps = vec![ClockJump { at_s: 2.0, by_s: 30.0 }];
    let sim = simulation(Disturbances { clock_jumps, ..Disturbances::default() }, 4.0);
    let plain = simulation(Disturbances::default(), 4.0);
    for (jumped, plain) in sim.frames().zip(plain.frames()) {
        let ahead_ns = jumped.frame.stamp.nanos() - plain.frame.stamp.nanos();
        assert_eq!(ahead_ns, if plain.measured_s < 2.0 { 0 } else { 30_000_000_000 });
        assert_eq!(jumped.t_world_base, plain.t_world_base);
    }
}

#[test]
fn frames_are_lost_late_and_jittered_at_the_rates_asked_for() {
    let scans = |disturbances| {
        let frames: Vec<SimFrame> = simulation(disturbances, 200.0).frames().collect();
        assert_eq!(of_kind(&frames, SensorKind::Odometry).len(), 4000);
        frames.into_iter().filter(|f| f.frame.data.kind() == SensorKind::Lidar2d).collect::<Vec<_>>()
    };
    // 2000 scans: three standard deviations of the share of 0.3 are 0.031, of 0.1 are 0.02.
    let kept = scans(Disturbances { drop_rate: 0.3, ..Disturbances::default() }).len();
    assert!((1338..=1462).contains(&kept), "{kept}");
    let late = scans(Disturbances { late_rate: 0.1, ..Disturbances::default() });
    assert!(late.len() >= 1999);
    let backwards = late.windows(2).filter(|f| f[1].frame.stamp < f[0].frame.stamp).count();
    // One that is late while another is held comes in time.
    assert!((140..=240).contains(&backwards), "{backwards}");
    let jittered = scans(Disturbances { stamp_jitter_s: 0.01, ..Disturbances::default() });
    let plain = scans(Disturbances::default());
    let off: Vec<f64> = jittered.iter().zip(&plain).map(|(a, b)| a.frame.stamp.seconds_since(b.frame.stamp)).collect();
    let sigma = (off.iter().map(|o| o * o).sum::<f64>() / off.len() as f64).sqrt();
    assert!((sigma - 0.01).abs() < 0.0005, "{sigma}");
    assert!(jittered.iter().zip(&plain).all(|(a, b)| a.t_world_base == b.t_world_base));
}

#[test]
fn a_corridor_shows_nothing_but_two_walls() {
    let params = Scenario::Corridor.params(MainSensor::Lidar2d, 4, 60.0, 1).unwrap();
    let sim = Simulation::new(params).unwrap();
    assert_eq!((sim.world().rooms().len(), sim.world().doors().len()), (1, 0));
    assert!(sim.world().objects_at(0.0).is_empty());
    let middle = |f: &SimFrame| (f.t_world_base.translation.x - 30.0).abs() < 10.0;
    let mut seen = 0;
    for frame in sim.frames().filter(middle) {
        let SensorData::Scan(scan) = &frame.frame.data else { continue };
        let t = frame.t_world_base;
        for p in scan.hits() {
            let world = t * nalgebra::Point3::from(p.cast::<f64>());
            let inside = sim.world().rooms()[0];
            let away = (world.y - inside.min.y).abs().min((world.y - inside.max.y).abs());
            assert!(away < 0.1, "{world}");
            seen += 1;
        }
    }
    assert!(seen > 10_000, "{seen}");
}

#[test]
fn every_scenario_can_be_driven_with_every_sensor_and_repeats_itself() {
    let scenarios = [
        Scenario::Loops,
        Scenario::Kidnap { trials: 2 },
        Scenario::Blackout,
        Scenario::Jump,
        Scenario::Corridor,
        Scenario::Still,
        Scenario::Drop { percent: 50 },
        Scenario::Disorder,
        Scenario::Jitter,
        Scenario::Extrinsics,
    ];
    for scenario in scenarios {
        for sensor in [MainSensor::Lidar2d, MainSensor::Lidar3d, MainSensor::Rosette, MainSensor::Rgbd] {
            let params = scenario.params(sensor, 4, 600.0, 1).unwrap();
            let sim = Simulation::new(params).unwrap();
            let mains =
                sim.sensors().iter().filter(|s| s.kind != SensorKind::Odometry && s.kind != SensorKind::Imu).count();
            assert_eq!(mains, 1 + usize::from(scenario == Scenario::Extrinsics));
            let stamps = || sim.frames().take(3).map(|f| f.frame.stamp).collect::<Vec<_>>();
            assert_eq!(stamps(), stamps());
        }
    }
}
