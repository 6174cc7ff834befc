//! Figures of the odometries on recorded data: `evaluate SET PATH [options]`.
//!
//! `rgbd DIR`, `redwood DIR`, `slambook DIR`, `rgbd-sim SEED [--seconds N] [--no-color] [--loops] [--person] [--sift]`,
//! `rgbd-sizes WIDTHxHEIGHT SEED SEED ...`, `looks DIR` (as `rgbd`), `looks-places DIR`, `unrelated DIR DIR ...` (images),
//! `mono DIR [STRIDE]`, `mono-sim SEED [--no-loops] [--wheels] [--depth] [--second MM] [--laps N]`, `kitti-tracking DIR`, `kitti-pair DIR`, `handheld DIR`, `carmen LOG [RELATIONS] [--no-prior]`,
//! `lidar-sim spinning|rosette [name=value ...]`, `planar-sim [name=value ...]`, `submaps DIR [SCANS_ELSEWHERE]`,
//! `graph FILE [name=value ...]`.

mod camera;
mod depth;
mod graphs;
mod looks;
mod mapping;
mod measure;
mod places;
mod read;
mod simulated;
mod sizes;

use percept_geometry::{Pose, SensorSpec, Timestamp, se3};
use percept_slam::{
    CloudScan, DepthScan, MotionPrior, Odometry, OdometryEstimate, OdometryKind, OdometryParams, PlanarScan, Scan,
};
use read::Failure;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().collect();
    let path = Path::new(args.get(2).ok_or("usage: evaluate SET PATH")?);
    match args[1].as_str() {
        "rgbd" => rgbd(path, args.get(3).and_then(|s| s.parse().ok()).unwrap_or(1)),
        "looks" => looks::compare(path),
        "looks-places" => looks::places(path),
        "unrelated" => looks::unrelated(&args[2..]),
        "rgbd-sim" => depth::simulated(args[2].parse()?, &args),
        "rgbd-sizes" => sizes::compare(&args[2..]),
        "redwood" => depth::redwood(path),
        "slambook" => depth::slambook(path),
        "mono" => camera::recorded(path, args.get(3).and_then(|s| s.parse().ok()).unwrap_or(1)),
        "mono-sim" => camera::simulated(&args[2..]),
        "kitti-tracking" => kitti_tracking(path),
        "kitti-pair" => kitti_pair(path),
        "handheld" => handheld(path),
        "submaps" => places::submaps(path, args.get(3).map(Path::new)),
        "graph" => graphs::compare(path, &args[3..]),
        "lidar-sim" => simulated::lidar(&args[2..]),
        "planar-sim" => simulated::planar(&args[2..]),
        "carmen" => {
            let relations = args.get(3).filter(|a| !a.starts_with("--")).map(Path::new);
            carmen(path, relations, !args.iter().any(|a| a == "--no-prior"))
        }
        other => Err(format!("unknown set {other}").into()),
    }
}

/// Registers and times; the timed part is `register` alone.
pub(crate) struct Run {
    pub(crate) odometry: Odometry,
    milliseconds: Vec<f64>,
    cpu_ticks: u64,
    pub(crate) estimates: Vec<OdometryEstimate>,
}

impl Run {
    pub(crate) fn new(kind: OdometryKind) -> Self {
        Self::with(kind, OdometryParams::default())
    }

    pub(crate) fn with(kind: OdometryKind, params: OdometryParams) -> Self {
        Self { odometry: Odometry::new(kind, params), milliseconds: vec![], cpu_ticks: 0, estimates: vec![] }
    }

    pub(crate) fn step(&mut self, stamp: Timestamp, scan: &Scan, prior: Option<&MotionPrior>) {
        let (start, ticks) = (Instant::now(), cpu_ticks());
        let e = self.odometry.register(stamp, scan, prior);
        self.cpu_ticks += cpu_ticks() - ticks;
        self.milliseconds.push(start.elapsed().as_secs_f64() * 1e3);
        if std::env::var_os("VERBOSE").is_some() {
            let s = |i| e.covariance[(i, i)].max(0.0f64).sqrt();
            println!(
                "{} {:?} inl {:.2} rmse {:.4} it {} ms {:.1} sigma {:.4} {:.5} deg {:?}",
                self.estimates.len(),
                e.state,
                e.inlier_ratio,
                e.rmse_m,
                e.iterations,
                self.milliseconds.last().unwrap_or(&0.0),
                s(0),
                s(5),
                e.degenerate_axes
            );
        }
        self.estimates.push(e);
    }

    /// When the frames were taken, seconds.
    pub(crate) fn stamps_s(&self) -> Vec<f64> {
        let first = self.estimates.first().map_or_else(Timestamp::default, |e| e.stamp);
        self.estimates.iter().map(|e| e.stamp.seconds_since(first)).collect()
    }

    pub(crate) fn report(&self) {
        let mut ms = self.milliseconds.clone();
        ms.sort_by(f64::total_cmp);
        let at = |q: f64| ms[((ms.len() - 1) as f64 * q) as usize];
        let tracked = self.estimates.iter().filter(|e| !e.state.is_lost()).count();
        let sum: f64 = ms.iter().sum();
        println!(
            "tracked {tracked}/{}  ms p50 {:.2} p99 {:.2} mean {:.2} ({:.0}/s), cpu {:.1}",
            ms.len(),
            at(0.5),
            at(0.99),
            sum / ms.len() as f64,
            1e3 * ms.len() as f64 / sum,
            10.0 * self.cpu_ticks as f64 / ms.len() as f64
        );
    }
}

/// Hundredths of a second that this process has computed, all threads (Linux; else 0).
fn cpu_ticks() -> u64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    stat.rsplit(')')
        .next()
        .map_or(0, |s| s.split_whitespace().skip(11).take(2).filter_map(|w| w.parse::<u64>().ok()).sum())
}

fn rgbd(dir: &Path, stride: usize) -> Result<(), Failure> {
    let k = read::numbers(&dir.join("camera-intrinsics.txt"))?;
    let intrinsics = percept_geometry::CameraIntrinsics::pinhole(640, 480, k[0], k[4], k[2], k[5]);
    let mut names: Vec<_> = std::fs::read_dir(dir)?
        .filter_map(|e| e.ok()?.file_name().into_string().ok()?.strip_suffix(".pose.txt").map(String::from))
        .collect();
    names.sort();
    // As on a robot: the optical frame is not base.
    let t_base_camera = Pose::from_parts(nalgebra::Translation3::new(0.1, 0.0, 0.3), SensorSpec::optical_rotation());
    let mut run = Run::new(OdometryKind::Rgbd);
    let mut truth = vec![];
    for (i, name) in names.iter().enumerate().step_by(stride) {
        let scan = Scan::Depth(DepthScan {
            depth: Arc::new(read::depth_png(&dir.join(format!("{name}.depth.png")), 0.001)?),
            color: Some(Arc::new(read::color(&dir.join(format!("{name}.color.jpg")))?)),
            intrinsics,
            t_base_sensor: t_base_camera,
        });
        truth.push(read::pose_3x4(&read::numbers(&dir.join(format!("{name}.pose.txt")))?)?);
        run.step(Timestamp::from_secs_f64(i as f64 / 15.0), &scan, None);
    }
    let estimate: Vec<Pose> = run.estimates.iter().map(|e| e.t_odom_base * t_base_camera).collect();
    run.report();
    measure::report(&truth, &estimate);
    let truth: Vec<Pose> = truth.iter().map(|t| t * t_base_camera.inverse()).collect();
    measure::drift(&truth, &run.estimates.iter().map(|e| e.t_odom_base).collect::<Vec<_>>());
    measure::consistency(&truth, &run.estimates);
    measure::motion(&run.stamps_s(), &truth, false);
    Ok(())
}

fn kitti_tracking(dir: &Path) -> Result<(), Failure> {
    let truth = read::poses_3x4(&dir.join("poses_reference_gicp.txt"))?;
    let mut run = Run::new(OdometryKind::Lidar3d);
    for i in 0..truth.len() {
        let cloud = read::pcd_xyzi(&dir.join(format!("velodyne/{i:010}.pcd")))?;
        let scan = Scan::Cloud(CloudScan { cloud: Arc::new(cloud), t_base_sensor: Pose::identity() });
        run.step(Timestamp::from_secs_f64(i as f64 * 0.1), &scan, None);
    }
    let estimate: Vec<Pose> = run.estimates.iter().map(|e| e.t_odom_base).collect();
    run.report();
    measure::report(&truth, &estimate);
    measure::drift(&truth, &estimate);
    measure::consistency(&truth, &run.estimates);
    measure::motion(&run.stamps_s(), &truth, false);
    if let (Some(a), Some(b)) = (truth.last(), estimate.last()) {
        let d = a.inverse() * b;
        println!("end off by {:.4} m, {:.3} deg", d.translation.vector.norm(), d.rotation.angle().to_degrees());
    }
    Ok(())
}

/// Clouds, and a `groundtruth.tum` whose rows are theirs in order.
fn handheld(dir: &Path) -> Result<(), Failure> {
    let mut files: Vec<_> =
        std::fs::read_dir(dir.join("clouds"))?.map(|f| Ok(f?.path())).collect::<Result<_, Failure>>()?;
    files.sort();
    let rows = std::fs::read_to_string(dir.join("groundtruth.tum"))?;
    let rows = rows.lines().filter(|l| !l.starts_with('#') && !l.trim().is_empty());
    let (mut run, mut truth) = (Run::new(OdometryKind::Lidar3d), vec![]);
    for (file, row) in files.iter().zip(rows) {
        let n: Vec<f64> = row.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let [stamp, x, y, z, qx, qy, qz, qw] = n[..] else { return Err(format!("{row}: not eight numbers").into()) };
        truth.push(Pose::from_parts(
            nalgebra::Translation3::new(x, y, z),
            nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(qw, qx, qy, qz)),
        ));
        let cloud = Arc::new(read::pcd_xyzi(file)?);
        run.step(
            Timestamp::from_secs_f64(stamp),
            &Scan::Cloud(CloudScan { cloud, t_base_sensor: Pose::identity() }),
            None,
        );
    }
    let estimate: Vec<Pose> = run.estimates.iter().map(|e| e.t_odom_base).collect();
    run.report();
    measure::report(&truth, &estimate);
    measure::drift(&truth, &estimate);
    measure::motion(&run.stamps_s(), &truth, false);
    Ok(())
}

fn kitti_pair(dir: &Path) -> Result<(), Failure> {
    let poses = read::poses_3x4(&dir.join("poses_00.txt"))?;
    let tr = read::pose_3x4(&read::numbers(&dir.join("calib_Tr.txt"))?)?;
    let truth = |i: usize| tr.inverse() * poses[i] * tr;
    for (a, b) in [(94, 95), (0, 1), (1, 2)] {
        let mut run = Run::new(OdometryKind::Lidar3d);
        for (k, i) in [a, b].into_iter().enumerate() {
            let bytes = std::fs::read(dir.join(format!("velodyne/{i:06}.bin")))?;
            let cloud = Arc::new(read::kitti_bin(&bytes));
            let scan = Scan::Cloud(CloudScan { cloud, t_base_sensor: Pose::identity() });
            run.step(Timestamp::from_secs_f64(k as f64 * 0.1), &scan, None);
        }
        let expected = truth(a).inverse() * truth(b);
        let got = run.estimates[0].t_odom_base.inverse() * run.estimates[1].t_odom_base;
        let d = expected.inverse() * got;
        println!(
            "{a} -> {b}: off by {:.4} m, {:.4} deg; moved {:.3} m, truth {:.3} m; ms {:.1}",
            d.translation.vector.norm(),
            d.rotation.angle().to_degrees(),
            got.translation.vector.norm(),
            expected.translation.vector.norm(),
            run.milliseconds[1]
        );
    }
    Ok(())
}

fn carmen(path: &Path, relations: Option<&Path>, use_prior: bool) -> Result<(), Failure> {
    let log = read::carmen(path, 80.0)?;
    let mut run = Run::new(OdometryKind::Lidar2d);
    let mut last: Option<Pose> = None;
    let mut mapping = mapping::Mapping::new(OdometryKind::Lidar2d).ok_or("no place recognition")?;
    for row in &log {
        let scan = Scan::Planar(PlanarScan { scan: Arc::new(row.scan.clone()), t_base_sensor: Pose::identity() });
        let prior = last.filter(|_| use_prior).map(|last| measure::wheel_prior(&(last.inverse() * row.t_odom_base)));
        run.step(row.stamp, &scan, prior.as_ref());
        if let Some(e) = run.estimates.last() {
            mapping.frame(&run.odometry, e, &scan);
        }
        last = Some(row.t_odom_base);
    }
    let estimate = mapping.finish();
    run.report();
    mapping.report();
    let stamps: Vec<f64> = log.iter().map(|r| r.logged_s).collect();
    let drifting: Vec<Pose> = run.estimates.iter().map(|e| e.t_odom_base).collect();
    if let Some(relations) = relations {
        let rows = read::numbers(relations)?;
        let raw: Vec<Pose> = log.iter().map(|r| r.t_odom_base).collect();
        println!("wheels:   {}", measure::relations(&rows, &stamps, &raw));
        println!("odometry: {}", measure::relations(&rows, &stamps, &drifting));
        println!("loops:    {}", measure::relations(&rows, &stamps, &estimate));
    }
    // Loops closed it is ten times better than odometry alone.
    measure::drift(&estimate, &drifting);
    println!("wheels:");
    measure::drift(&estimate, &log.iter().map(|r| r.t_odom_base).collect::<Vec<_>>());
    measure::motion(&stamps, &estimate, true);
    measure::consistency(&estimate, &run.estimates);
    if let Ok(out) = std::env::var("TUM") {
        measure::write_tum(&out, &stamps, &estimate)?;
        measure::write_tum(&format!("{out}.odom"), &stamps, &drifting)?;
    }
    if let Ok(out) = std::env::var("MAP_PNG") {
        let scans: Vec<_> = log.iter().map(|r| r.scan.hits()).collect();
        measure::map_png(&out, &scans, &estimate)?;
    }
    if std::env::var_os("STEPS").is_some() {
        for (i, w) in run.estimates.windows(2).enumerate() {
            let got = w[0].t_odom_base.inverse() * w[1].t_odom_base;
            let wheels = log[i].t_odom_base.inverse() * log[i + 1].t_odom_base;
            let d = se3::log(&(wheels.inverse() * got));
            if d.norm() > 0.2 {
                let dt = log[i + 1].stamp.seconds_since(log[i].stamp);
                println!("{} {:?} dt {dt:.3} off {:.2} {:.2} {:.2}", i + 1, w[1].state, d[0], d[1], d[5]);
            }
        }
    }
    Ok(())
}
