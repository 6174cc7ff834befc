//! Sensors err as much as they say, and not more.

use crate::sim_params;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use percept_geometry::sensor::ImuSample;
use percept_geometry::{SensorData, se3};
use percept_sim::{
    DepthCameraParams, HandheldParams, ImuParams, Lidar2dParams, Lidar3dParams, OdometryParams, ScanPattern,
    SensorSuite, SimParams, Simulation,
};

fn simulation(sensors: SensorSuite, seconds: f64) -> Simulation {
    Simulation::new(SimParams { sensors, duration_s: Some(seconds), ..sim_params(2) }).unwrap()
}

fn camera(params: DepthCameraParams) -> SensorSuite {
    SensorSuite { depth_camera: Some(params), ..SensorSuite::none() }
}

/// Depth images of the first `seconds`, one after the other.
fn depths(params: DepthCameraParams, seconds: f64) -> Vec<f32> {
    simulation(camera(params), seconds)
        .frames()
        .flat_map(|f| match f.frame.data {
            SensorData::Rgbd(depth, _) | SensorData::Depth(depth) => depth.data().to_vec(),
            _ => vec![],
        })
        .collect()
}

#[test]
fn depth_errs_as_nguyen_measured() {
    // Level, so that the upper half of the image sees walls and furniture, mostly straight on.
    let level = |params| DepthCameraParams { rate_hz: 1.0, pitch_rad: 0.0, baseline_m: 0.0, ..params };
    let base = level(DepthCameraParams::default());
    let truth = depths(level(DepthCameraParams { range_max_m: 50.0, ..DepthCameraParams::ideal() }), 6.0);
    // Without steps of a millimetre, which a median would fall onto.
    let noisy = depths(DepthCameraParams { edge_effects: false, quantum_m: 0.0, ..base.clone() }, 6.0);
    let upper_half = |i: usize| i % (640 * 480) < 640 * 240;
    for (near, far) in [(1.5, 2.5), (2.5, 4.0), (4.0, 6.0)] {
        let ratios: Vec<f64> = truth
            .iter()
            .zip(&noisy)
            .enumerate()
            .filter(|&(i, _)| upper_half(i))
            .map(|(_, (&z, &n))| (f64::from(z), f64::from(n)))
            .filter(|&(z, n)| z > near && z < far && n > 0.0)
            .map(|(z, n)| (n - z) / base.sigma_m(z))
            .collect();
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        // By the median, which the few surfaces slanted beyond 60 degrees hardly move.
        let mut sizes: Vec<f64> = ratios.iter().map(|r| r.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let sigma = sizes[sizes.len() / 2] / 0.6745;
        assert!(ratios.len() > 10_000 && mean.abs() < 0.03, "{mean} of {}", ratios.len());
        assert!((0.98..1.06).contains(&sigma), "{near} to {far} m: {sigma}");
    }
    let lost = noisy.iter().zip(&truth).filter(|&(&n, &z)| n == 0.0 && z > 0.5 && z < 7.0).count();
    let share = lost as f64 / truth.iter().filter(|&&z| z > 0.5 && z < 7.0).count() as f64;
    assert!((share - base.dropout_rate).abs() < 0.0005, "{share}");
}

#[test]
fn depth_has_holes_and_flying_pixels_at_edges_only() {
    let base = DepthCameraParams { rate_hz: 1.0, ..DepthCameraParams::default() };
    let truth = depths(DepthCameraParams { rate_hz: 1.0, ..DepthCameraParams::ideal() }, 4.0);
    let noisy = depths(base.clone(), 4.0);
    assert!(noisy.iter().all(|n| (n * 1000.0 - (n * 1000.0).round()).abs() < 1e-2));
    let holes = noisy.iter().zip(&truth).filter(|&(&n, &z)| n == 0.0 && z > 0.0).count();
    let off = |n: f32, z: f32| f64::from((n - z).abs()) > 6.0 * base.sigma_m(f64::from(z)) + 0.02;
    let flying = noisy.iter().zip(&truth).filter(|&(&n, &z)| n > 0.0 && z > 0.0 && off(n, z)).count();
    let (holes, flying) = (holes as f64 / truth.len() as f64, flying as f64 / truth.len() as f64);
    assert!((0.003..0.15).contains(&holes), "{holes}");
    assert!((0.0003..0.02).contains(&flying), "{flying}");
}

#[test]
fn deskewed_lidar_points_lie_on_surfaces() {
    for pattern in [ScanPattern::Spinning, ScanPattern::Rosette] {
        let params = Lidar3dParams { pattern, columns: 600, rosette_points: 9600, ..Lidar3dParams::default() };
        let t_base_sensor = params.t_base_sensor();
        let sim = simulation(SensorSuite { lidar3d: Some(params), ..SensorSuite::none() }, 8.0);
        let (mut square, mut count, mut worst_rigid) = (0.0, 0, 0.0f64);
        for f in sim.frames().step_by(16) {
            let t = sim.seconds_at(f.frame.stamp);
            let SensorData::Cloud(cloud) = f.frame.data else { panic!("a cloud") };
            cloud.validate().unwrap();
            let offsets = cloud.time_offsets_s.unwrap();
            assert!(offsets.is_sorted() && offsets.iter().all(|o| (0.0..0.1).contains(o)));
            assert!(cloud.positions.len() > 9000, "{}", cloud.positions.len());
            for (p, offset) in cloud.positions.iter().zip(&offsets) {
                let at = t + f64::from(*offset);
                let d = sim.world().surface_distance_at(&(sim.path().pose_at(at) * t_base_sensor * p.cast()), at);
                assert!(d < 0.1, "{d} m off");
                square += d * d;
                count += 1;
                let rigid = f.t_world_base * t_base_sensor * p.cast::<f64>();
                worst_rigid = worst_rigid.max(sim.world().surface_distance_at(&rigid, t));
            }
        }
        // Noise runs along the beam; the distance is what is left of it along the normal.
        let rms = (square / f64::from(count)).sqrt();
        assert!((0.01..0.02).contains(&rms), "{pattern:?}: {rms}");
        assert!(worst_rigid > 0.1, "motion does not show: {worst_rigid}");
    }
}

#[test]
fn a_rosette_does_not_repeat_and_stays_in_its_cone() {
    let params = Lidar3dParams { pattern: ScanPattern::Rosette, ..Lidar3dParams::default() };
    let half_angle = params.rosette_half_angle_rad;
    let sim = simulation(SensorSuite { lidar3d: Some(params), ..SensorSuite::none() }, 0.2);
    let mut seen = std::collections::BTreeSet::new();
    let mut counts = vec![];
    for f in sim.frames() {
        let SensorData::Cloud(cloud) = f.frame.data else { panic!("a cloud") };
        for p in &cloud.positions {
            let d = p.coords.cast::<f64>().normalize();
            assert!(d.x.acos() <= half_angle + 1e-6);
            seen.insert(((d.y * 200.0) as i32, (d.z * 200.0) as i32));
        }
        counts.push(seen.len());
    }
    assert!(counts[1] as f64 > 1.3 * counts[0] as f64, "{counts:?}");
}

#[test]
fn scan_beams_err_by_a_centimetre() {
    let params = Lidar2dParams { fov_rad: 1.5 * std::f64::consts::PI, range_max_m: 3.0, ..Lidar2dParams::default() };
    let t_base_sensor = params.t_base_sensor();
    let sim = simulation(SensorSuite { lidar2d: Some(params), ..SensorSuite::none() }, 20.0);
    let (mut square, mut hits, mut lost, mut beams) = (0.0, 0, 0, 0);
    for f in sim.frames() {
        let t = sim.seconds_at(f.frame.stamp);
        let SensorData::Scan(scan) = f.frame.data else { panic!("a scan") };
        assert!((scan.angle(359) - 0.75 * std::f64::consts::PI).abs() < 1e-9);
        let sensor = f.t_world_base * t_base_sensor;
        for (i, &r) in scan.ranges_m.iter().enumerate() {
            let direction = Vector3::new(scan.angle(i).cos(), scan.angle(i).sin(), 0.0);
            let origin = Point3::from(sensor.translation.vector);
            let truth = sim.world().cast(&origin, &(sensor.rotation * direction), t, 100.0).unwrap().distance;
            beams += 1;
            if r.is_nan() {
                lost += 1;
            } else if r == f32::INFINITY {
                assert!(truth > 2.94, "{truth}");
            } else {
                square += (f64::from(r) - truth).powi(2);
                hits += 1;
            }
        }
    }
    let sigma = (square / f64::from(hits)).sqrt();
    assert!((sigma - 0.01).abs() < 0.0005, "{sigma}");
    assert!((f64::from(lost) / f64::from(beams) - 0.005).abs() < 0.001, "{lost} of {beams}");
}

#[test]
fn odometry_errs_as_its_covariance_says_and_drifts() {
    let params = OdometryParams { distance_scale_sigma: 0.0, angle_scale_sigma: 0.0, ..OdometryParams::default() };
    let sim = Simulation::new(SimParams {
        sensors: SensorSuite { odometry: Some(params), ..SensorSuite::none() },
        ..sim_params(2)
    })
    .unwrap();
    let (mut square, mut count) = ([0.0; 3], 0);
    let mut last: Option<(percept_geometry::Pose, percept_geometry::Pose)> = None;
    for f in sim.frames() {
        let SensorData::Odometry(sample) = f.frame.data else { panic!("odometry") };
        let covariance = sample.covariance.unwrap();
        if let Some((truth, odom)) = last {
            let step = truth.inverse() * f.t_world_base;
            let error = se3::log(&(step.inverse() * (odom.inverse() * sample.t_odom_base)));
            if step.translation.vector.norm() > 0.005 {
                for (s, i) in square.iter_mut().zip([0, 1, 5]) {
                    *s += error[i] * error[i] / covariance[(i, i)];
                }
                count += 1;
            }
        } else {
            assert_eq!(sample.t_odom_base, percept_geometry::Pose::identity());
        }
        last = Some((f.t_world_base, sample.t_odom_base));
    }
    assert!(count > 1000);
    for s in square {
        assert!((s / f64::from(count) - 1.0).abs() < 0.15, "{square:?} of {count}");
    }
    let (truth, odom) = last.unwrap();
    let drift = (sim.t_world_start().inverse() * truth).inverse() * odom;
    let metres = drift.translation.vector.norm();
    assert!((0.02..15.0).contains(&metres), "{metres}");
}

/// An inertial sensor without faults.
fn ideal_imu(rate_hz: f64) -> ImuParams {
    ImuParams {
        rate_hz,
        gyro_noise_rad_per_s: 0.0,
        gyro_bias_rad_per_s: 0.0,
        gyro_walk_rad_per_s: 0.0,
        accel_noise_m_per_s2: 0.0,
        accel_bias_m_per_s2: 0.0,
        accel_walk_m_per_s2: 0.0,
    }
}

#[test]
fn an_imu_without_faults_adds_up_to_the_pose() {
    let carried = HandheldParams { swing_rad: 1.3, ..HandheldParams::default() };
    for hand in [None, Some(carried)] {
        let mut params = sim_params(2);
        params.robot.handheld = hand;
        params.sensors = SensorSuite { imu: Some(ideal_imu(1000.0)), ..SensorSuite::none() };
        let sim = Simulation::new(SimParams { duration_s: Some(10.0), ..params }).unwrap();
        let t_base_imu = sim.sensors()[0].t_base_sensor;
        let start = sim.t_world_start() * t_base_imu;
        let (mut r, mut p, mut v) = (start.rotation, start.translation.vector, Vector3::zeros());
        let mut before: Option<ImuSample> = None;
        for f in sim.frames() {
            let SensorData::Imu(now) = f.frame.data else { panic!("imu") };
            if let Some(last) = before {
                // Trapezoids: the lane's acceleration jumps where its pieces meet, which leaves up to a centimetre a second; a force
                // that is wrong by as little as 0.01 m/s^2 leaves half a metre.
                let turn = (last.angular_velocity + now.angular_velocity) * 0.5e-3;
                let next = r * UnitQuaternion::from_scaled_axis(turn);
                let force = (r * last.linear_acceleration + next * now.linear_acceleration) * 0.5;
                let a = force - Vector3::z() * 9.81;
                p += v * 1e-3 + a * 0.5e-6;
                v += a * 1e-3;
                r = next;
            }
            before = Some(now);
            let truth = f.t_world_base * t_base_imu;
            assert!(r.angle_to(&truth.rotation) < 2e-3, "{} rad", r.angle_to(&truth.rotation));
            assert!((p - truth.translation.vector).norm() < 0.15, "{}", (p - truth.translation.vector).norm());
        }
    }
}

#[test]
fn an_imu_errs_as_it_says() {
    let said = ImuParams { gyro_bias_rad_per_s: 0.0, accel_bias_m_per_s2: 0.0, ..ImuParams::default() };
    let samples = |imu| {
        let sensors = SensorSuite { imu: Some(imu), ..SensorSuite::none() };
        let of = |f: percept_sim::SimFrame| match f.frame.data {
            SensorData::Imu(sample) => sample,
            _ => panic!("imu"),
        };
        simulation(sensors, 200.0).frames().map(of).collect::<Vec<_>>()
    };
    let truth = samples(ideal_imu(said.rate_hz));
    let off: Vec<[Vector3<f64>; 2]> = samples(said.clone())
        .iter()
        .zip(&truth)
        .map(|(a, b)| [a.angular_velocity - b.angular_velocity, a.linear_acceleration - b.linear_acceleration])
        .collect();
    let noise = [said.gyro_noise_rad_per_s, said.accel_noise_m_per_s2];
    let walk = [said.gyro_walk_rad_per_s, said.accel_walk_m_per_s2];
    for k in 0..2 {
        // What differs between neighbours is noise; what is left of a second's mean is the walk.
        let n = (3 * (off.len() - 1)) as f64;
        let between: f64 = off.windows(2).map(|w| (w[1][k] - w[0][k]).norm_squared()).sum();
        assert!(((between / (2.0 * n)).sqrt() / noise[k] - 1.0).abs() < 0.02);
        let means: Vec<Vector3<f64>> =
            off.chunks(100).map(|c| c.iter().map(|o| o[k]).sum::<Vector3<f64>>() / 100.0).collect();
        let apart: f64 = means.windows(11).map(|w| (w[10] - w[0]).norm_squared()).sum::<f64>();
        let sigma = (apart / (3 * (means.len() - 10)) as f64).sqrt();
        // Ten seconds of walk, and the noise of two means of a hundred samples.
        let expected = (10.0 * walk[k] * walk[k] + 0.02 * noise[k] * noise[k]).sqrt();
        assert!((0.6..1.5).contains(&(sigma / expected)), "{sigma} {expected}");
    }
}
