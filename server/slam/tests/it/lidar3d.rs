use crate::room::{Noise, Room, drive, velocity};
use percept_geometry::SensorData;
use percept_geometry::{Covariance6, Pose, Timestamp, se3};
use percept_sim::{
    Disturbances, HandheldParams, Kidnap, Lidar3dParams, Pause, RobotParams, ScanPattern, SensorSuite, SimParams,
    Simulation, WorldParams,
};
use percept_slam::{
    CloudScan, LostReason, MotionPrior, Odometry, OdometryEstimate, OdometryKind, OdometryParams, Scan, TrackingState,
};
use std::sync::Arc;

fn run(threads: usize, frames: usize, rings: usize) -> Vec<OdometryEstimate> {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
        let (room, mut noise) = (Room::furnished(), Noise(3));
        let mut odometry = Odometry::new(OdometryKind::Lidar3d, OdometryParams::default());
        (0..frames)
            .map(|i| {
                let scan = room.cloud(&drive(i, 200), rings, &velocity(i, 200), &mut noise);
                odometry.register(Timestamp::from_secs_f64(i as f64 * 0.1), &scan, None)
            })
            .collect()
    })
}

fn check(estimates: &[OdometryEstimate], metres: f64) {
    for (i, e) in estimates.iter().enumerate() {
        let truth: Pose = drive(0, 200).inverse() * drive(i, 200);
        let off = se3::log(&(truth.inverse() * e.t_odom_base));
        assert!(off.fixed_rows::<3>(0).norm() < metres && off.fixed_rows::<3>(3).norm() < 0.01, "frame {i}: {off}");
        assert_eq!(e.state.is_tracking(), i > 0);
    }
}

#[test]
fn thirty_two_rings_in_a_room_are_followed_to_two_centimetres() {
    check(&run(2, 100, 32), 0.02);
}

#[test]
fn sixteen_sparse_rings_are_followed_too() {
    check(&run(2, 100, 16), 0.03);
}

#[test]
fn the_number_of_threads_changes_not_one_bit() {
    assert_eq!(run(1, 6, 16), run(3, 6, 16));
}

/// Distances from the truth of a lidar swung by hand through rooms, metres.
fn carried(lidar: Lidar3dParams, world: WorldParams, hand: HandheldParams, frames: usize) -> Vec<f64> {
    let off = moved(lidar, world, RobotParams { handheld: Some(hand), ..RobotParams::default() }, frames);
    off.iter().map(|t| t.translation.vector.norm()).collect()
}

/// What a lidar that is moved through rooms is off from the truth.
fn moved(lidar: Lidar3dParams, world: WorldParams, robot: RobotParams, frames: usize) -> Vec<Pose> {
    let sensors = SensorSuite { lidar3d: Some(lidar), ..SensorSuite::none() };
    let simulation = Simulation::new(SimParams { world, robot, sensors, ..SimParams::default() }).unwrap();
    let t_base_sensor = simulation.sensors()[0].t_base_sensor;
    let mut odometry = Odometry::new(OdometryKind::Lidar3d, OdometryParams::default());
    let mut off = vec![];
    for frame in simulation.frames().take(frames) {
        let SensorData::Cloud(cloud) = frame.frame.data else { continue };
        let scan = Scan::Cloud(CloudScan { cloud: Arc::new(cloud), t_base_sensor });
        let e = odometry.register(frame.frame.stamp, &scan, None);
        assert!(!e.state.is_lost());
        let truth = simulation.t_world_start().inverse() * frame.t_world_base;
        off.push(truth.inverse() * e.t_odom_base);
    }
    off
}

fn worst(off: &[f64]) -> f64 {
    off.iter().copied().fold(0.0, f64::max)
}

#[test]
fn dense_rings_do_not_turn_the_map_round() {
    // One point of each cell of a grid is one that noise chose: thinned so, this turned by degrees.
    let lidar = Lidar3dParams { rings: 64, columns: 900, ..Lidar3dParams::default() };
    let world = WorldParams { rooms: 2, ..WorldParams::default() };
    let off = moved(lidar, world, RobotParams::default(), 200);
    let metres = off.iter().map(|t| t.translation.vector.norm()).collect::<Vec<_>>();
    let yaw = off.iter().map(|t| se3::yaw(t).abs().to_degrees()).collect::<Vec<_>>();
    assert!(worst(&metres) < 0.03 && worst(&yaw) < 0.4, "{} m, {} degrees", worst(&metres), worst(&yaw));
}

#[test]
fn a_spinning_lidar_swung_by_hand_is_followed() {
    let lidar = Lidar3dParams { columns: 900, ..Lidar3dParams::default() };
    let off = carried(lidar, WorldParams::default(), HandheldParams::default(), 70);
    assert!(worst(&off) < 0.08, "{}", worst(&off));
}

#[test]
fn a_rosette_swung_by_hand_is_followed() {
    let lidar = Lidar3dParams {
        pattern: ScanPattern::Rosette,
        rosette_points: 40_000,
        rosette_half_angle_rad: 0.9,
        ..Lidar3dParams::default()
    };
    let off = carried(lidar, WorldParams::default(), HandheldParams::default(), 50);
    assert!(worst(&off) < 0.15, "{}", worst(&off));
}

#[test]
fn what_a_narrow_view_of_one_wall_leaves_open_does_not_run_on() {
    let lidar = || Lidar3dParams { pattern: ScanPattern::Rosette, ..Lidar3dParams::default() };
    // How far a single one is off is chance, and twice as far with one seed as with the next: 0.1 to 0.66 m.
    let rms = [1, 2, 3, 4, 5, 6, 7, 8].map(|seed| {
        let world = WorldParams { seed, rooms: 2, ..WorldParams::default() };
        let hand = HandheldParams { swing_rad: 0.3, ..HandheldParams::default() };
        let off = carried(lidar(), world, hand, 300);
        (off.iter().map(|d| d * d).sum::<f64>() / off.len() as f64).sqrt()
    });
    assert!(rms.iter().sum::<f64>() / 8.0 < 0.4 && worst(&rms) < 1.0, "{rms:?}");
}

/// The same walls with other furniture.
fn refurnished() -> Room {
    let mut room = Room::furnished();
    room.boxes.iter_mut().for_each(|b| {
        let (min, max) = *b;
        *b = (-max, -min);
        (b.0.z, b.1.z) = (min.z, max.z);
    });
    room
}

/// What is said of the first scan after 4 s without any, seen in another room or the same one, half a metre ahead.
fn after_a_gap(other: Option<Room>) -> TrackingState {
    let (room, mut noise) = (Room::furnished(), Noise(5));
    let mut odometry = Odometry::new(OdometryKind::Lidar3d, OdometryParams::default());
    for i in 0..20 {
        let scan = room.cloud(&drive(i, 200), 16, &velocity(i, 200), &mut noise);
        assert!(!odometry.register(Timestamp::from_secs_f64(i as f64 * 0.1), &scan, None).state.is_lost());
    }
    let t_world_base = drive(19, 200) * se3::from_xy_yaw(0.1, 0.0, 0.05);
    let scan = other.unwrap_or(room).cloud(&t_world_base, 16, &nalgebra::Vector6::zeros(), &mut noise);
    odometry.register(Timestamp::from_secs_f64(6.0), &scan, None).state
}

#[test]
fn a_lidar_that_was_blind_goes_on_in_the_same_room_and_is_lost_in_another_one() {
    assert_eq!(after_a_gap(None), TrackingState::Tracking);
    let mut larger = Room::furnished();
    larger.walls.1.x += 1.5;
    for other in [refurnished(), larger] {
        assert_eq!(after_a_gap(Some(other)), TrackingState::Lost { reason: LostReason::TimeGap });
    }
}

#[test]
fn a_lidar_put_down_elsewhere_begins_a_map_that_is_not_bent_by_what_it_tried_before() {
    let lidar = Lidar3dParams { columns: 900, ..Lidar3dParams::default() };
    let kidnaps = vec![Kidnap { at_s: 3.0, carried_s: 4.0, ahead_s: 12.0 }];
    let simulation = Simulation::new(SimParams {
        sensors: SensorSuite { lidar3d: Some(lidar), ..SensorSuite::none() },
        disturbances: Disturbances { kidnaps, ..Disturbances::default() },
        ..SimParams::default()
    });
    let simulation = simulation.unwrap();
    let t_base_sensor = simulation.sensors()[0].t_base_sensor;
    let mut odometry = Odometry::new(OdometryKind::Lidar3d, OdometryParams::default());
    let (mut last, mut began): (Option<Pose>, Option<(Pose, Pose)>) = (None, None);
    let mut worst: f64 = 0.0;
    for frame in simulation.frames().take(70) {
        let SensorData::Cloud(cloud) = frame.frame.data else { continue };
        let scan = Scan::Cloud(CloudScan { cloud: Arc::new(cloud), t_base_sensor });
        let truth = frame.t_world_base;
        // Wheels measure everything but that the robot is carried.
        let step = last.map(|before| before.inv_mul(&truth)).filter(|s| s.translation.vector.norm() < 0.5);
        let covariance = Covariance6::identity() * 1e-4;
        let prior = last.map(|_| MotionPrior { t_prev_now: step.unwrap_or_else(Pose::identity), covariance });
        let e = odometry.register(frame.frame.stamp, &scan, prior.as_ref());
        if last.is_some() && e.state == TrackingState::Initialising {
            began = Some((truth, e.t_odom_base));
        }
        last = Some(truth);
        let Some((truth_then, t_odom_then)) = began.filter(|_| e.state.is_tracking()) else { continue };
        let off = truth_then.inv_mul(&truth).inv_mul(&t_odom_then.inv_mul(&e.t_odom_base));
        worst = worst.max(off.translation.vector.norm() + off.rotation.angle());
    }
    assert!(began.is_some() && worst < 0.04, "{worst}");
}

#[test]
fn wheels_that_are_a_hundredth_off_do_not_drag_the_map_along() {
    let (room, mut noise) = (Room::furnished(), Noise(7));
    let mut odometry = Odometry::new(OdometryKind::Lidar3d, OdometryParams::default());
    let mut worst: f64 = 0.0;
    for i in 0..150 {
        let scan = room.cloud(&drive(i, 200), 16, &velocity(i, 200), &mut noise);
        let prior = (i > 0).then(|| {
            let step = se3::log(&drive(i - 1, 200).inv_mul(&drive(i, 200)));
            let sigma = |share: f64| (share * 0.01f64).powi(2).max(1e-10);
            let covariance = Covariance6::from_diagonal(&step.map(|_| sigma(0.1)));
            MotionPrior { t_prev_now: se3::exp(&(step * 1.03)), covariance }
        });
        let e = odometry.register(Timestamp::from_secs_f64(i as f64 * 0.1), &scan, prior.as_ref());
        let truth = drive(0, 200).inv_mul(&drive(i, 200));
        worst = worst.max(truth.inv_mul(&e.t_odom_base).translation.vector.norm());
    }
    assert!(worst < 0.03, "{worst}");
}

/// In a corridor of which rings see walls, floor and ceiling alone, wherever the robot is: without wheels nobody can tell how
/// far it has gone.
#[test]
fn a_spinning_lidar_in_a_bare_corridor_says_that_it_does_not_know_how_far_it_went() {
    let world = WorldParams { seed: 1, rooms: 2, person: false, corridor_m: Some(60.0), ..WorldParams::default() };
    let robot = RobotParams { speed_m_per_s: 0.6, look_around: false, ..RobotParams::default() };
    let lidar = Lidar3dParams { columns: 600, ..Lidar3dParams::default() };
    let sensors = SensorSuite { lidar3d: Some(lidar), ..SensorSuite::none() };
    let disturbances = Disturbances { pauses: vec![Pause { at_s: 0.0, lasts_s: 2.0 }], ..Disturbances::default() };
    let params = SimParams { world, robot, sensors, disturbances, duration_s: Some(20.0), ..SimParams::default() };
    let simulation = Simulation::new(params).unwrap();
    let t_base_sensor = simulation.sensors()[0].t_base_sensor;
    let mut odometry = Odometry::new(OdometryKind::Lidar3d, OdometryParams::default());
    let mut is_far = false;
    for frame in simulation.frames() {
        let SensorData::Cloud(cloud) = frame.frame.data else { continue };
        let scan = Scan::Cloud(CloudScan { cloud: Arc::new(cloud), t_base_sensor });
        let e = odometry.register(frame.frame.stamp, &scan, None);
        let truth = simulation.t_world_start().inverse() * frame.t_world_base;
        let off = (e.t_odom_base.inverse() * truth).translation.vector;
        let told = e.covariance[(0, 0)].sqrt();
        is_far |= off.x.abs() > 5.0;
        assert!(off.x.abs() < 0.5 || e.state.is_lost() || off.x.abs() < 4.0 * told, "{off}, told {told}");
        assert!(off.yz().norm() < 0.1, "{off}");
    }
    assert!(is_far, "the robot drives off unseen");
}
