//! Depth cameras: short recorded sets, and the simulator's drives with the loops they close.

use super::{Run, measure, read, read::Failure};
use percept_geometry::{
    CameraIntrinsics, Covariance6, FeatureMethod, KeyframeId, Pose, SensorData, SensorSpec, Timestamp, se3,
};
use percept_sim::{DepthCameraParams, SensorSuite, SimParams, Simulation};
use percept_slam::loops::{KeyframePoses, place_recognition};
use percept_slam::{BackEndParams, DepthScan, KeyframePolicy, OdometryKind, OdometryParams, Scan};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Five frames of Redwood with the poses of its log.
pub(crate) fn redwood(dir: &Path) -> Result<(), Failure> {
    let text = read::numbers(&dir.join("trajectory.log"))?;
    let truth: Vec<Pose> = text.chunks_exact(19).map(|r| read::pose_3x4(&r[3..])).collect::<Result<_, _>>()?;
    let scans = (0..truth.len()).map(|i| {
        let depth = dir.join(format!("depth/{i:05}.png"));
        (depth, dir.join(format!("color/{i:05}.jpg")))
    });
    short(scans.collect(), CameraIntrinsics::primesense(), &truth)
}

/// Five frames far apart of slambook2.
pub(crate) fn slambook(dir: &Path) -> Result<(), Failure> {
    let rows = read::numbers(&dir.join("pose.txt"))?;
    let pose = |r: &[f64]| se3::pose_from_parts("pose", [r[0], r[1], r[2]], [r[3], r[4], r[5], r[6]]);
    let truth: Vec<Pose> = rows.chunks_exact(7).map(pose).collect::<Result<_, _>>()?;
    let scans = (1..=truth.len()).map(|i| (dir.join(format!("depth/{i}.pgm")), dir.join(format!("color/{i}.png"))));
    short(scans.collect(), CameraIntrinsics::pinhole(640, 480, 518.0, 519.0, 325.5, 253.5), &truth)
}

fn short(
    files: Vec<(std::path::PathBuf, std::path::PathBuf)>,
    intrinsics: CameraIntrinsics,
    truth: &[Pose],
) -> Result<(), Failure> {
    for with_color in [false, true] {
        let mut run = Run::new(OdometryKind::Rgbd);
        for (i, (depth, color)) in files.iter().enumerate() {
            let scan = Scan::Depth(DepthScan {
                depth: Arc::new(depth_image(depth)?),
                color: if with_color { Some(Arc::new(read::color(color)?)) } else { None },
                intrinsics,
                t_base_sensor: Pose::identity(),
            });
            run.step(Timestamp::from_secs_f64(i as f64 / 5.0), &scan, None);
        }
        println!("{}", if with_color { "depth and colour" } else { "depth alone" });
        run.report();
        measure::report(truth, &run.estimates.iter().map(|e| e.t_odom_base).collect::<Vec<_>>());
    }
    Ok(())
}

/// A drive of the simulator; with `--loops`, what place recognition finds at its keyframes beside the truth.
pub(crate) fn simulated(seed: u64, args: &[String]) -> Result<(), Failure> {
    let has = |name: &str| args.iter().any(|a| a == name);
    let value = |name: &str| args.iter().skip_while(|a| *a != name).nth(1).and_then(|s| s.parse::<f64>().ok());
    let mut params = SimParams { seed, laps: 2, duration_s: value("--seconds"), ..SimParams::default() };
    params.world.seed = seed;
    params.world.person = has("--person");
    params.sensors = SensorSuite {
        depth_camera: Some(DepthCameraParams::default()),
        lidar3d: None,
        lidar2d: None,
        odometry: None,
        imu: None,
    };
    let simulation = Simulation::new(params)?;
    let spec: SensorSpec = simulation.sensors().remove(0);
    let mut params = OdometryParams::default();
    if has("--sift") {
        params.keyframe.features = FeatureMethod::Sift;
    }
    let mut run = Run::with(OdometryKind::Rgbd, params);
    let mut policy = KeyframePolicy::new(OdometryParams::default().keyframe);
    let mut places =
        place_recognition(OdometryKind::Rgbd, &OdometryParams::default(), BackEndParams::default().place_limits())
            .ok_or("no place recognition")?;
    let (mut truth, mut estimate, mut keyframes) = (vec![], vec![], KeyframePoses::new());
    let mut tally = Tally::default();
    for f in simulation.frames() {
        let SensorData::Rgbd(depth, color) = f.frame.data else { continue };
        let scan = Scan::Depth(DepthScan {
            depth: Arc::new(depth),
            color: (!has("--no-color")).then(|| Arc::new(color)),
            intrinsics: DepthCameraParams::default().intrinsics,
            t_base_sensor: DepthCameraParams::default().t_base_sensor(),
        });
        run.step(f.frame.stamp, &scan, None);
        truth.push(f.t_world_base);
        estimate.extend(run.estimates.last().map(|e| e.t_odom_base));
        if let (Some(e), true) = (estimate.last(), std::env::var_os("VERBOSE").is_some()) {
            let off = truth[0].inv_mul(&f.t_world_base).inv_mul(e);
            println!("   off {:.3} m {:.3} deg", off.translation.vector.norm(), off.rotation.angle().to_degrees());
        }
        if has("--loops") && policy.consider(&f.t_world_base) {
            let kept = Arc::new(run.odometry.keyframe_scan(f.frame.stamp, &spec.id, &scan));
            let id = KeyframeId(keyframes.len() as u64);
            keyframes.insert(id, f.t_world_base);
            let start = Instant::now();
            let loops = places.insert(id, &kept.into(), &Covariance6::identity(), &keyframes);
            tally.keyframe(start.elapsed().as_secs_f64() * 1e3);
            for l in loops {
                let expected = keyframes[&l.from].inverse() * keyframes[&l.to];
                tally.found(&(expected.inverse() * l.t_from_to), &l.covariance);
            }
        }
    }
    run.report();
    measure::report(&truth, &estimate);
    measure::drift(&truth, &estimate);
    measure::consistency(&truth, &run.estimates);
    if has("--loops") {
        tally.report();
    }
    Ok(())
}

/// Loops beside the truth.
#[derive(Default)]
struct Tally {
    milliseconds: Vec<f64>,
    metres: Vec<f64>,
    degrees: Vec<f64>,
    sigmas: Vec<f64>,
}

impl Tally {
    fn keyframe(&mut self, ms: f64) {
        self.milliseconds.push(ms);
    }

    fn found(&mut self, off: &Pose, covariance: &Covariance6) {
        self.metres.push(off.translation.vector.norm());
        self.degrees.push(off.rotation.angle().to_degrees());
        let e = se3::log(off);
        self.sigmas.push(covariance.try_inverse().map_or(f64::NAN, |i| (e.dot(&(i * e)) / 6.0).sqrt()));
    }

    fn report(&mut self) {
        let wrong = self.metres.iter().zip(&self.degrees).filter(|(m, d)| **m > 0.2 || **d > 5.0).count();
        let mut at = |v: fn(&mut Self) -> &mut Vec<f64>, q: f64| {
            let v = v(self);
            v.sort_by(f64::total_cmp);
            v.get(((v.len().max(1) - 1) as f64 * q) as usize).copied().unwrap_or(0.0)
        };
        println!(
            "loops p50 {:.4} m {:.3} deg, p95 {:.4} m {:.3} deg, in sigmas p50 {:.2} p95 {:.2}; insert p50 {:.1} ms p99 {:.1} ms",
            at(|t| &mut t.metres, 0.5),
            at(|t| &mut t.degrees, 0.5),
            at(|t| &mut t.metres, 0.95),
            at(|t| &mut t.degrees, 0.95),
            at(|t| &mut t.sigmas, 0.5),
            at(|t| &mut t.sigmas, 0.95),
            at(|t| &mut t.milliseconds, 0.5),
            at(|t| &mut t.milliseconds, 0.99),
        );
        println!("{} keyframes, {} loops, {wrong} wrong", self.milliseconds.len(), self.metres.len());
    }
}

/// A 16-bit PNG or PGM in millimetres.
fn depth_image(path: &Path) -> Result<percept_geometry::DepthImage, Failure> {
    if path.extension().is_none_or(|e| e != "pgm") {
        return read::depth_png(path, 0.001);
    }
    let bytes = std::fs::read(path)?;
    let start = bytes.len().checked_sub(2 * 640 * 480).ok_or("short file")?;
    let units: Vec<u16> = bytes[start..].chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
    Ok(percept_geometry::DepthImage::from_u16(640, 480, &units, 0.001)?)
}
